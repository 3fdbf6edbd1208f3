"""The trade-off that decides every bogie: stability on straight track against wear in a curve, with and without cross bracing.

    python benchmarks/steering_front.py --points 20 --out fronts.png

The Pareto fronts of the coach's nonlinear (or, with --linear, linear) critical speed against the wear number in R 500 m over primary
stiffnesses and yaw damping; then with a bracing between the wheelsets of each bogie as well. At most 4 minutes a front on two cores.
"""

import argparse
import dataclasses
import time
from pathlib import Path

import numpy as np

import railjax
from railjax import objectives as aim

BOUNDS = {"primary.stiffness_x": (0.3e6, 20e6), "primary.stiffness_y": (1e6, 20e6), "secondary.damping_x": (0.0, 100e3)}
BRACING = {"cross_bracing.shear_stiffness": (0.0, 20e6), "cross_bracing.bending_stiffness": (0.0, 5e6)}
LONGEST = 240.0  # s a front


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--points", type=int, default=20)
    options.add_argument("--radius", type=float, default=500.0, help="m")
    options.add_argument("--linear", action="store_true")
    options.add_argument("--out", type=Path)
    given = options.parse_args()
    railjax.use_double_precision()
    railjax.use_all_cores()
    coach = railjax.load_vehicle("coach")
    stability = aim.linear_critical_speed() if given.linear else aim.nonlinear_critical_speed()
    plain = front_of("without bracing", coach, BOUNDS, stability, given)
    # from the middle of that front, so that the search does not end in worse bogies than those without
    middle = {name.replace(".", "__"): float(values[len(values) // 2]) for name, values in plain.parameters.items()}
    start = dataclasses.replace(
        railjax.replace(coach, **middle), cross_bracing=railjax.CrossBracing(shear_stiffness=1e5, bending_stiffness=1e4)
    )
    braced = front_of("with cross bracing", start, BOUNDS | BRACING, stability, given)
    fronts, one = {"without bracing": plain, "with cross bracing": braced}, plain
    for speed in np.linspace(*np.percentile(plain.objective, [10, 90]), 6):
        without, tied = (float(np.interp(speed, *_rising(front))) for front in (plain, braced))
        # a bracing of no stiffness is none, so that the better of both counts
        print(
            f"{speed * 3.6:6.1f} km/h: wear number {without:6.1f} N, braced {min(tied, without):6.1f} N ({min(tied / without - 1, 0):+.0%})"
        )
    if given.out is not None:
        from railjax.plots import figure

        with figure() as (page, axes):
            for name, front in fronts.items():
                axes[0, 0].plot(3.6 * front.objective, front.against, "o-", markersize=3, label=name)
            axes[0, 0].plot(3.6 * one.own[0], one.own[1], "k*", label="the coach")
            kind = "linear" if given.linear else "nonlinear"
            axes[0, 0].set(xlabel=f"{kind} critical speed, km/h", ylabel=f"wear number in R {given.radius:g} m, N")
            axes[0, 0].legend()
            page.savefig(given.out)


def front_of(name: str, vehicle: railjax.Vehicle, bounds: dict, stability: object, given: argparse.Namespace) -> railjax.Front:
    """The front, and how long it took."""
    start = time.perf_counter()
    front = railjax.pareto(vehicle, bounds, stability, aim.wear(given.radius), points=given.points)
    seconds = time.perf_counter() - start
    print(name, front, f"  {seconds:.0f} s{'' if seconds <= LONGEST else ', too long'}", sep="\n")
    return front


def _rising(front: railjax.Front) -> tuple[np.ndarray, np.ndarray]:
    order = np.argsort(front.objective)
    return np.asarray(front.objective)[order], np.asarray(front.against)[order]


if __name__ == "__main__":
    main()
