"""The closed loop in batches against C, Numba and SciPy; `throughput.py` makes the whole table and the figure."""

from collections.abc import Callable
from typing import Any

import jax
import pytest
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
    if "C" in speed:
        assert 1.0 / speed["C"] >= (0.4 if SLOWER_JAX else 0.5)
    if "Numba" in speed:
        assert 1.0 / speed["Numba"] >= (3.5 if SLOWER_JAX else 4.0)


def test_many_runs_against_scipy(benchmark: Any, note: Callable) -> None:
    """4096 runs of 10 s, against LSODA run by run; the controller is the continuous one."""
    pytest.importorskip("numba", reason="the rival's right-hand side is compiled by Numba: pip install '.[benchmarks]'")
    figures = benchmark.pedantic(throughput.against_scipy, args=(4096, 10.0, 5, 3), rounds=1)
    note(**figures)
    assert figures["scipy_numba_difference"] < 1e-3
    assert figures["scipy_numpy_difference"] < 1e-3
    assert figures["ratio_to_scipy_numba"] >= 100.0
    assert figures["ratio_to_scipy_numpy"] >= 1000.0
