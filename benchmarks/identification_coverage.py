"""How often an identified damper's stated errors hold: known dampers, records as rigs give them.

    python benchmarks/identification_coverage.py --records 40        # a quarter of an hour

Each record is a random motion of 0.1 m/s with steps of voltage, of a damper drawn about the published one; it is cut out of a longer
one, so that the damper's inner displacement is unknown, sampled at 200 to 2000 Hz, with an offset of the velocity of up to 1 % of its
r.m.s., 1 % of noise in the force and a little in the motion. Counted is how often the truth lies within 2 stated errors.
"""

import argparse
import dataclasses
import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from scipy.signal import butter, sosfiltfilt

import railjax
from railjax.dampers import bouc_wen
from railjax.dampers.bouc_wen import BoucWen
from railjax.dampers.identification.record import Record
from railjax.dampers.identification.result import Identification

RATES = (200, 500, 1000, 2000)  # Hz
FINE = 4000  # Hz
DURATION = 14.0  # s
LARGEST_CUT = 8.0  # s


def case(seed: int, rate: int | None = None, duration: float = DURATION) -> tuple[Record, dict[str, float]]:
    """A record and the damper that made it."""
    random = np.random.default_rng(seed)
    rate = rate or RATES[seed % len(RATES)]
    keys = ("c0a", "c0b", "c1a", "alpha_a", "alpha_b", "k0", "k1", "x0", "gamma", "beta", "eta")
    published = BoucWen()
    true = dataclasses.replace(published, **{key: getattr(published, key) * np.exp(random.normal(0.0, 0.3)) for key in keys})
    true = dataclasses.replace(true, saturation=random.uniform(1.2, 4.0))
    mass = random.uniform(0.0, 4.0)

    cut = round(random.uniform(0.0, LARGEST_CUT) * FINE)
    count = round((LARGEST_CUT + duration) * FINE)
    x = sosfiltfilt(butter(4, 6.0, fs=FINE, output="sos"), random.standard_normal(count))
    x *= 0.1 / np.std(np.gradient(x, 1 / FINE))
    v = np.gradient(x, 1 / FINE)
    held = FINE // 5  # a fifth of a second, a whole number of samples at every rate
    command = np.repeat(random.uniform(0.0, 2.25, -(-count // held)), held)[:count]
    cut -= cut % held
    force = np.asarray(_force(true, *(jnp.asarray(values) for values in (x, v, command)))) + mass * np.gradient(v, 1 / FINE)
    kept = slice(cut, cut + round(duration * FINE), FINE // rate)
    x, v, command, force = (values[kept] for values in (x, v, command, force))
    samples = len(x)
    force = force + 0.01 * np.std(force) * random.standard_normal(samples)
    x = x + 5e-4 * np.std(x) * random.standard_normal(samples)
    v = v + np.std(v) * (random.uniform(-0.01, 0.01) + 2e-3 * random.standard_normal(samples))
    truth = {field.name: float(getattr(true, field.name)) for field in bouc_wen.leaves(true)} | {"inertia": mass}
    return Record(x, v, command, force, 1 / rate, f"synthetic record {seed}, {rate} Hz"), truth


@jax.jit
def _force(damper: BoucWen, x: jax.Array, v: jax.Array, command: jax.Array) -> jax.Array:
    return bouc_wen.response(damper, x, v, command, 1 / FINE, 2)


def distances(found: Identification, truth: dict[str, float]) -> dict[str, float]:
    """How many stated errors each parameter lies off."""
    return {name: abs(found.values[name] - truth[name]) / found.standard_errors[name] for name in found.names}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--records", type=int, default=40)
    parser.add_argument("--first", type=int, default=0, help="seed of the first record")
    parser.add_argument("--out", type=Path, help="JSON file of the distances in stated errors")
    options = parser.parse_args()
    railjax.use_double_precision()
    rows = []
    for seed in sorted(range(options.first, options.first + options.records), key=lambda seed: seed % len(RATES)):
        record, truth = case(seed)
        found = railjax.identify_damper(record)
        rows.append(
            {"seed": seed, "held-out": found.heldout_error, "undetermined": list(found.undetermined)} | distances(found, truth)
        )
        off = {name: round(rows[-1][name], 1) for name in found.names if rows[-1][name] > 2.0}
        print(f"{record.name}: held-out error {found.heldout_error:.4f}; beyond 2 errors: {off or 'none'}", flush=True)
    for name in found.names:
        print(f"{name:12s} {np.mean([row[name] <= 2.0 for row in rows]):6.1%}")
    print(f"all together {np.mean([row[name] <= 2.0 for row in rows for name in found.names]):6.1%}")
    if options.out:
        options.out.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
