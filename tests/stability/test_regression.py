"""A batched critical-speed sweep keeps its lead over NumPy's eigenvalues in a loop: a loss of 1.5 fails.

Ratios are kept in critical_sweep.json, by JAX release series, with how they were taken; after a change that is meant to be faster, or on
another kind of machine:

    PYTHONPATH=. python tests/stability/test_regression.py

records those of the JAX that runs it. CPU times are compared, not wall times, so that other work on the machine matters little,
and the best of several alternations counts, because disturbances only ever take time.
"""

import json
import platform
import sys
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import railjax

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks"))

import rivals

KEPT = Path(__file__).with_name("critical_sweep.json")
SERIES = ".".join(jax.__version__.split(".")[:2])
#: half-way between no loss and one of 1.5
ALLOWED = 1.5**0.5
VARIANTS, RIVAL_VARIANTS, ALTERNATIONS, TRIES = 128, 2, 5, 3


class Sweep:
    """The pair, compiled and checked against each other."""

    def __init__(self) -> None:
        coach = railjax.load_vehicle("coach")
        scale = np.geomspace(0.6, 1.6, VARIANTS)
        self.k_ox, self.k_oy = coach.primary.stiffness_x * scale, coach.primary.stiffness_y * scale[::-1]
        self.search = rivals.critical_speed_search()

        @jax.jit
        def speeds(k_ox: jax.Array, k_oy: jax.Array) -> jax.Array:
            vehicle = railjax.replace(coach, primary__stiffness_x=k_ox, primary__stiffness_y=k_oy)
            return railjax.linear_critical(vehicle).speed

        self.speeds, self.arguments = speeds, (jnp.asarray(self.k_ox), jnp.asarray(self.k_oy))
        self.chosen = np.linspace(0, VARIANTS - 1, RIVAL_VARIANTS).round().astype(int)
        np.testing.assert_allclose(np.asarray(self.ours())[self.chosen], self.theirs(), rtol=1e-6)

    def ours(self) -> jax.Array:
        return jax.block_until_ready(self.speeds(*self.arguments))

    def theirs(self) -> list[float]:
        return [self.search(self.k_ox[k], self.k_oy[k]) for k in self.chosen]

    def ratio(self, calls: float = 1.0) -> float:
        """How many times less CPU time a variant takes in the batch than in the loop; `calls` > 1 as if the batch were slower."""
        ours, theirs = [], []
        for _ in range(ALTERNATIONS):
            start = time.process_time()
            self.ours()
            ours.append(calls * (time.process_time() - start) / VARIANTS)
            # of this thread: idle threads of LAPACK may spin
            start = time.thread_time()
            self.theirs()
            theirs.append((time.thread_time() - start) / RIVAL_VARIANTS)
        return min(theirs) / min(ours)


def kept() -> float:
    """The recorded ratio; the smallest one for a JAX that none was recorded for."""
    ratios = json.loads(KEPT.read_text())["ratios"]
    return ratios.get(SERIES, min(ratios.values()))


def passes(sweep: Sweep, calls: float = 1.0) -> tuple[bool, float]:
    best = 0.0
    for _ in range(TRIES):
        best = max(best, sweep.ratio(calls))
        if best * ALLOWED >= kept():
            return True, best
    return False, best


def test_the_critical_speed_sweep_keeps_its_lead():
    sweep = Sweep()
    good, ratio = passes(sweep)
    assert good, f"{ratio:.3g} times faster than the loop over eigenvalues, {kept():.3g} were recorded (JAX {SERIES})"


if __name__ == "__main__":
    railjax.use_double_precision()
    railjax.use_all_cores()
    pair = Sweep()
    if sys.argv[1:] == ["--try"]:
        for calls in (1.0, 1.5):
            print("as it is" if calls == 1.0 else "slowed 1.5-fold", *(f"{pair.ratio(calls):.3g}" for _ in range(12)))
        print("passes", passes(pair), "slowed 1.5-fold", passes(pair, 1.5))
    else:
        record = json.loads(KEPT.read_text()) if KEPT.exists() else {"ratios": {}}
        record["how"] = (
            "median of 9 times Sweep.ratio of tests/stability/test_regression.py, CPU time per variant, loop over batch; the batch proves that no crossing is lower, the loop does not"
        )
        record["machine"] = f"{platform.machine()}, {jax.local_device_count()} core(s)"
        record["ratios"][SERIES] = round(float(np.median([pair.ratio() for _ in range(9)])), 3)
        KEPT.write_text(json.dumps(record, indent=1) + "\n")
        print(KEPT.read_text())
