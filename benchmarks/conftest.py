"""Double precision on all cores, and what the benchmarks compared, printed at the end."""

import os
import platform
from collections.abc import Callable
from typing import Any

import jax
import pytest

import railjax

railjax.use_double_precision()
railjax.use_all_cores()

_noted: dict[str, dict[str, Any]] = {}


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@pytest.fixture(scope="session")
def coach() -> railjax.Vehicle:
    return railjax.load_vehicle("coach")


@pytest.fixture
def note(benchmark: Any, request: pytest.FixtureRequest) -> Callable[..., None]:
    """`note(name=value, ...)` puts figures into benchmark.extra_info, beside the context of the measurement."""
    benchmark.extra_info |= {
        "jax": jax.__version__,
        "python": platform.python_version(),
        "devices": ", ".join(f"{len(jax.devices(kind))} {kind}" for kind in {d.platform for d in jax.devices()}),
        "cores": cores(),
        "float64": bool(jax.config.jax_enable_x64),
    }

    def add(**figures: Any) -> None:
        benchmark.extra_info |= figures
        _noted.setdefault(request.node.name, {}).update(figures)

    return add


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """The figures of `note`, which pytest-benchmark writes to its JSON file only."""
    if not _noted:
        return
    terminalreporter.section(f"figures: jax {jax.__version__}, {jax.device_count()} device(s), {cores()} core(s)")
    for test, figures in _noted.items():
        terminalreporter.write_line(test)
        for name, value in figures.items():
            text = f"{value:.4g}" if isinstance(value, float) else str(value)
            terminalreporter.write_line(f"    {name.replace('_', ' '):44s} {text}")
