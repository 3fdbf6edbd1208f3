"""Hunting: the whole bifurcation diagram, from cold and warm, beside a simulated ramp of the speed."""

import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import railjax

COLD = """
import time
start = time.perf_counter()
import railjax
railjax.use_double_precision()
railjax.hunting_branch(railjax.load_vehicle("coach"), highest_speed=300 / 3.6)
print(time.perf_counter() - start)
"""


def test_bifurcation_diagram(benchmark: Any, note: Callable, coach: railjax.Vehicle) -> None:
    cold = float(subprocess.run([sys.executable, "-c", COLD], capture_output=True, text=True, check=True).stdout)
    branch = railjax.hunting_branch(coach, highest_speed=300 / 3.6)  # compiles
    benchmark.pedantic(lambda: railjax.hunting_branch(coach, highest_speed=300 / 3.6), rounds=3)
    warm = benchmark.stats.stats.median

    # what a ramp in steps of this rate sees of the same fold, which it always leaves late
    low, high = 0.985 * branch.fold.speed, 1.05 * branch.fold.speed
    railjax.speed_ramp(coach, low, high, rate=0.02)  # compiles
    start = time.perf_counter()
    ramp = railjax.speed_ramp(coach, low, high, rate=0.02)
    seconds = time.perf_counter() - start

    note(
        limit_cycles=len(branch.points),
        cold_s=cold,
        warm_s=warm,
        ramp_s=seconds,
        ramp_late_kmh=(branch.fold.speed - ramp.stops) * 3.6,
        largest_multiplier_error=max(point.floquet.error for point in branch.points),
    )
    assert cold < 20.0
    assert warm < 3.0
