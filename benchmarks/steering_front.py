"""The trade-off that decides every bogie: stability on straight track against wear in a curve, with and without cross bracing.

    python benchmarks/steering_front.py --points 20

The fronts of `railjax reproduce --beyond` (railjax/reports/paper/studies/steering.py, where they are drawn; there the bracing's by linear
critical speeds, as its nonlinear one takes longer than 4 minutes): the coach's nonlinear (or, with --linear, linear) critical speed against the wear number in R 500 m over primary stiffnesses and yaw damping; then with a bracing between the
wheelsets of each bogie as well. At most 4 minutes a front on two cores; it is judged by processor time, which others' work does not stretch
and which two cores can only make shorter.
"""

import argparse
import time
from collections.abc import Callable

import railjax
from railjax import objectives as aim
from railjax.reports.paper.studies.steering import FASTEST, braced_front, moved, plain_front

LONGEST = 240.0  # s of processor time a front


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--points", type=int, default=20)
    options.add_argument("--linear", action="store_true")
    given = options.parse_args()
    railjax.use_double_precision()
    railjax.use_all_cores()
    coach = railjax.load_vehicle("coach")
    stability = (aim.linear_critical_speed if given.linear else aim.nonlinear_critical_speed)(highest=FASTEST)
    plain = timed("without bracing", lambda: plain_front(coach, stability, given.points))
    braced = timed("with cross bracing", lambda: braced_front(coach, plain, stability, given.points))
    for speed, without, tied in zip(*moved(plain, braced), strict=True):
        print(f"{speed * 3.6:6.1f} km/h: wear number {without:6.1f} N, braced {tied:6.1f} N ({tied / without - 1:+.0%})")


def timed(name: str, front: Callable[[], railjax.Front]) -> railjax.Front:
    """The front, and how long it took."""
    start, used = time.perf_counter(), time.process_time()
    found = front()
    seconds, used = time.perf_counter() - start, time.process_time() - used
    late = "" if used <= LONGEST else ", too long"
    print(name, found, f"  {used:.0f} s of processor time{late}, {seconds:.0f} s in all", sep="\n", flush=True)
    return found


if __name__ == "__main__":
    main()
