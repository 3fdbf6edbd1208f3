"""Tuning by gradient against its rivals (`tuning_rivals`), as ratios."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import tuning_rivals as rivals

import railjax
from railjax.reports.paper.studies.tuning import gains_over, trade_off


def test_gain(benchmark: Any, note: Callable, coach: railjax.Vehicle) -> None:
    rivals.tuned_gain(coach), rivals.grid_of_gains(coach)  # compile
    found = benchmark.pedantic(lambda: rivals.tuned_gain(coach), rounds=5)
    # processor time, for the grid has all cores and a run alone one
    spent = {"ours": [], "grid": []}
    for _ in range(5):
        for name, run in (("ours", rivals.tuned_gain), ("grid", rivals.grid_of_gains)):
            began = time.process_time()
            result = run(coach)
            spent[name].append(time.process_time() - began)
    ratio, best = min(spent["grid"]) / min(spent["ours"]), rivals.GAINS[result.argmin()]
    note(
        gain=found.parameters["damper.alpha"],
        gain_of_grid=float(best),
        evaluations=found.evaluations,
        seconds=benchmark.stats.stats.median,
        processor_seconds=min(spent["ours"]),
        processor_seconds_of_grid=min(spent["grid"]),
        ratio=ratio,
    )
    assert abs(found.parameters["damper.alpha"] - best) <= 1.5 / 400
    assert ratio >= 10.0


def test_eight_parameters(benchmark: Any, note: Callable, coach: railjax.Vehicle) -> None:
    began = time.perf_counter()
    rivals.tuned_suspension(coach)
    with_compilation = time.perf_counter() - began
    found = benchmark.pedantic(lambda: rivals.tuned_suspension(coach), rounds=3)
    seconds = benchmark.stats.stats.median
    results = rivals.rivals_of_suspension(coach, found.objective)
    nonlinear = float(railjax.nonlinear_critical_speed(found.vehicle)) * 3.6
    note(objective=found.objective, evaluations=found.evaluations, seconds=seconds, seconds_with_compilation=with_compilation)
    note(nonlinear_critical_kmh=nonlinear)
    for name, result in results.items():
        note(**{f"{name.replace(' ', '_')}_{key}": value for key, value in result.items()})
    assert found.met
    assert np.isfinite(nonlinear)
    # "same or better": none of them is ahead of us by more than the tolerance
    assert all(result["best"] >= found.objective * (1 - 1e-3) for result in results.values())
    evolution = results["differential evolution"]
    assert evolution["evaluations"] >= 50 * found.evaluations
    assert evolution["seconds"] >= 10.0 * seconds


def test_fronts(benchmark: Any, note: Callable, coach: railjax.Vehicle) -> None:
    """Comfort against the nonlinear critical speed, 20 points without and 20 with control, compilation included."""
    fronts = benchmark.pedantic(lambda: trade_off(coach, 20), rounds=1)
    passive, controlled = fronts["passive"], fronts["balance logic"]
    gains = gains_over(controlled, passive)
    for name, front in fronts.items():
        note(
            **{
                f"{name}, evaluations": front.evaluations,
                f"{name}, seconds": front.seconds,
                f"{name}, points met": int(front.met.sum()),
            }
        )
    note(seconds=benchmark.stats.stats.median, least_gain=float(gains.min()), largest_gain=float(gains.max()))
    assert len(passive.objective) == len(controlled.objective) == 20
    assert np.all(gains > -1e-3)
    assert benchmark.stats.stats.median <= 180.0
