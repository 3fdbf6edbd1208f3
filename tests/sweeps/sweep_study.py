"""A sweep for processes of their own, which tests kill, interrupt or run side by side; and what it computes.

    python sweep_study.py OUT SECONDS                      the sweep into OUT, a pause of SECONDS in every chunk
    python sweep_study.py OUT SECONDS HOST:PORT K        as the K-th of two processes of jax.distributed

Prints the points done after every chunk.
"""

import sys
import time

import numpy as np

import railjax

SPEEDS, STIFFNESSES = np.linspace(40.0, 80.0, 20), np.linspace(2e6, 5e6, 6)


class Slow(railjax.LeastDamping):
    """Least damping with a pause, so that a kill lands in the middle; the numbers are not touched by it."""

    pause = 0.0

    def __call__(self, vehicle, speed):
        time.sleep(Slow.pause)
        return super().__call__(vehicle, speed)


def run(vehicle, **options):
    """The sweep: 120 points in chunks of 12."""
    over = {"speed": SPEEDS, "primary.stiffness_x": STIFFNESSES}
    return railjax.sweep(Slow(), over, vehicle=vehicle, chunk=12, **options)


def main(out, pause, *how):
    railjax.use_double_precision()
    railjax.use_all_cores()
    Slow.pause = float(pause)
    if how:
        import jax
        from jax.experimental import multihost_utils

        address, process = how
        jax.distributed.initialize(address, num_processes=2, process_id=int(process))
    data = run(railjax.load_vehicle("coach"), out=out, progress=lambda at: print(at.done, flush=True))
    if how:
        multihost_utils.sync_global_devices("swept")
        print("codes", *np.unique(data["code"].values))


if __name__ == "__main__":
    main(*sys.argv[1:])
