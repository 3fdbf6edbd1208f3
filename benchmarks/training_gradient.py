"""The gradient that trains a law: 32 rides of 2 s through the closed loop, against differences; its time and memory.

python benchmarks/training_gradient.py
"""

import dataclasses
import time

import jax
import numpy as np

import railjax
from railjax.tuning.course import weights_of
from railjax.tuning.teacher import Teacher
from railjax.tuning.train import prepared

LANES, WINDOW = 32, 2.0
STEP = 1e-6


def main() -> None:
    """Prints one line for each figure."""
    railjax.use_double_precision()
    railjax.use_all_cores()
    coach = railjax.load_vehicle("coach")
    # what is quantised has no differences
    sensors = dataclasses.replace(railjax.Sensors.typical(), quantum=np.zeros(3))
    law = railjax.LearnedDamper.of(
        railjax.Controller(railjax.Skyhook(damping=1e5), sensors=sensors, device=railjax.Device()), coach, hidden=24
    )
    teacher = Teacher(
        *prepared(coach, law, ["erri-low", "erri-high"], (120 / 3.6, 220 / 3.6)),
        None,
        {"secondary_travel": 1.0},
        6,
        WINDOW,
        LANES,
        1e-3,
        0,
    )
    rides, rng = teacher.rides(0), np.random.default_rng(0)
    weights = weights_of(law)
    weights = weights | {"hidden_demand": weights["hidden_demand"] + 0.05}
    along = {name: 0.1 * rng.normal(size=np.shape(value)) for name, value in weights.items()}
    base, prices = {name: np.ones(LANES) for name in ("comfort", "secondary_travel")}, {"secondary_travel": np.asarray(0.5)}
    fixed = rides, teacher.start(LANES), teacher.silence(LANES), base, prices

    def at(share: float) -> tuple:
        return {name: np.asarray(weights[name] + share * along[name]) for name in weights}, *fixed

    began = time.perf_counter()
    (_, _), slope = jax.block_until_ready(teacher.gradient(*at(0.0)))
    print(f"compiled in {time.perf_counter() - began:.0f} s")
    wall, processor = time.perf_counter(), time.process_time()
    for _ in range(3):
        jax.block_until_ready(teacher.gradient(*at(0.0)))
    print(
        f"value and gradient: {(time.perf_counter() - wall) / 3:.2f} s, {(time.process_time() - processor) / 3:.2f} s of processor time"
    )
    found = sum(float(np.sum(np.asarray(slope[name]) * along[name])) for name in weights)
    difference = float(teacher.gradient(*at(STEP))[0][0] - teacher.gradient(*at(-STEP))[0][0]) / (2.0 * STEP)
    print(f"along a random direction {found:.9g}, by differences {difference:.9g}: off by {abs(found / difference - 1.0):.1e}")
    plain = jax.jit(jax.value_and_grad(teacher.loss, has_aux=True)).lower(*at(0.0)).compile().memory_analysis()
    print(f"memory of the gradient: {(plain.temp_size_in_bytes + plain.output_size_in_bytes) / 1e6:.0f} MB")


if __name__ == "__main__":
    main()
