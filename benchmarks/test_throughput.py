"""The closed loop in batches against C, Numba and SciPy; `throughput.py` makes the whole table and the figure."""

import os
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import pytest
import rivals
import throughput
from throughput import contenders, lanes, measure, ratio

BATCH, STEPS, ROUNDS = 1024, 2000, 7
SLOWER_JAX = jax.__version__.startswith("0.10.")


def test_closed_loop_batch(benchmark: Any, note: Callable) -> None:
    """Balance logic, float64, all cores, pair by pair; the user's own `jax.vmap` as well."""
    shown = ("railjax", "C", "Numba")
    results = measure([one for one in contenders() if one.name.startswith(shown)], BATCH, STEPS, ROUNDS)
    ours = results["railjax"]
    benchmark.pedantic(throughput.railjax_batch(), args=(*lanes(BATCH), STEPS), rounds=3)
    # how many times faster than railjax's float64 batch
    speed = {name: 1.0 / ratio(ours, one) for name, one in results.items()}
    note(M_steps_per_s=BATCH * STEPS / min(ours.wall) / 1e6, **{f"{name}, over railjax": value for name, value in speed.items()})
    note(**{f"{name}, difference": one.difference for name, one in results.items()})
    assert speed["railjax, float32"] >= 2.0
    assert min(speed["railjax, jax.vmap"], speed["railjax, jax.jit(jax.vmap)"]) >= 0.5


def test_closed_loop_batch_against_programs(benchmark: Any, note: Callable, tmp_path: Path) -> None:
    """The yardsticks that the bars were set for: RAILJAX_C_RIVAL and RAILJAX_NUMBA_RIVAL name their sources."""
    bars = {}
    if (source := os.environ.get("RAILJAX_C_RIVAL")) and (program := rivals.compiled(source, tmp_path)):
        bars["C"] = [str(program)], 0.4 if SLOWER_JAX else 0.5
    if source := os.environ.get("RAILJAX_NUMBA_RIVAL"):
        bars["Numba"] = [sys.executable, source], 3.5 if SLOWER_JAX else 4.0
    if not bars:
        pytest.skip("neither RAILJAX_C_RIVAL (with gcc) nor RAILJAX_NUMBA_RIVAL names a program")
    ours = throughput.railjax_batch()
    ours(*lanes(BATCH), STEPS)  # compiles
    benchmark.pedantic(ours, args=(*lanes(BATCH), STEPS), rounds=3)
    found = {}
    for name, (command, _) in bars.items():
        ratios = []
        for _ in range(ROUNDS):
            start = time.perf_counter()
            ours(*lanes(BATCH), STEPS)
            rate = BATCH * STEPS / (time.perf_counter() - start)
            ratios.append(rate / rivals.printed_rate(command, BATCH, STEPS))
        found[name] = statistics.median(ratios)
    note(**{f"railjax over {name}": value for name, value in found.items()})
    for name, (_, bar) in bars.items():
        assert found[name] >= bar, name


def test_many_runs_against_scipy(benchmark: Any, note: Callable) -> None:
    """4096 runs of 10 s, against LSODA run by run; the controller is the continuous one."""
    pytest.importorskip("numba", reason="the rival's right-hand side is compiled by Numba: pip install '.[benchmarks]'")
    figures = benchmark.pedantic(throughput.against_scipy, args=(4096, 10.0, 5, 3), rounds=1)
    note(**figures)
    assert figures["scipy_numba_difference"] < 1e-3
    assert figures["scipy_numpy_difference"] < 1e-3
    assert figures["ratio_to_scipy_numba"] >= 100.0
    assert figures["ratio_to_scipy_numpy"] >= 1000.0
