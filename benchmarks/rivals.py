"""What railjax is measured against: the same coach in NumPy and SciPy, and, where given, a C program.

The NumPy coach is tests/reference.py, written from the paper's equations and not from railjax. It is plain Python, number by
number, as an engineer writes a first model; its run time is that of the interpreter.
"""

import importlib.util
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp


def _reference() -> ModuleType:
    path = Path(__file__).resolve().parents[1] / "tests" / "reference.py"
    spec = importlib.util.spec_from_file_location("railjax_reference", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


reference = _reference()
STATES = 34
#: of the wheelsets, from the car body's centre, m
POSITIONS = np.array([side * reference.L + ahead * reference.A for side in (1, -1) for ahead in (1, -1)])


class Run(NamedTuple):
    wheelset_y: np.ndarray  # (samples, 4), m
    carbody_acceleration: np.ndarray  # (samples,), m/s^2
    evaluations: int


def lsoda_run(
    speed: float, amplitude: float, wavelength: float, times: np.ndarray, rtol: float = 1e-6, atol: float = 1e-9
) -> Run:
    """SciPy's LSODA from rest over a sinusoidal track, with the published (sharp) contact laws."""
    wavenumber = 2 * np.pi / wavelength

    def rate(t: float, x: np.ndarray) -> np.ndarray:
        return reference.rate(x, amplitude * np.sin(wavenumber * (speed * t + POSITIONS)), speed)

    found = solve_ivp(rate, (0.0, times[-1]), np.zeros(STATES), "LSODA", t_eval=times, rtol=rtol, atol=atol)
    assert found.success, found.message
    acceleration = np.array([reference.acceleration(x) for x in found.y.T])
    return Run(found.y[9:13].T, acceleration, found.nfev)


def _linear_rate_matrix(k_ox: float, k_oy: float, speed: float) -> np.ndarray:
    """E of x' = E x with linear creep, column by column from the reference."""
    kept = reference.K_OX, reference.K_OY
    reference.K_OX, reference.K_OY = k_ox, k_oy
    try:
        still = np.zeros(4)
        return np.array([reference.rate(unit, still, speed, "linear") for unit in np.eye(STATES)]).T
    finally:
        reference.K_OX, reference.K_OY = kept


def critical_speed_search(
    lowest: float = 3.0, highest: float = 150.0, points: int = 60, tolerance: float = 1e-8
) -> Callable[[float, float], float]:
    """A function (k_ox, k_oy) -> linear critical speed in m/s: eigenvalues over a grid of speeds, then bisection.

    E is linear in k_ox, k_oy and 1/v, so it is put together from four matrices: the search spends its time in LAPACK.
    """
    base = _linear_rate_matrix(0.0, 0.0, 1e30)  # no slip damping at infinite speed
    by_x = (_linear_rate_matrix(1e6, 0.0, 1e30) - base) / 1e6
    by_y = (_linear_rate_matrix(0.0, 1e6, 1e30) - base) / 1e6
    by_slowness = _linear_rate_matrix(0.0, 0.0, 1.0) - base
    speeds = np.linspace(lowest, highest, points)

    def search(k_ox: float, k_oy: float) -> float:
        fixed = base + k_ox * by_x + k_oy * by_y

        def growth(speed: np.ndarray | float) -> np.ndarray:
            slowness = 1.0 / np.asarray(speed, float)[..., None, None]
            return np.linalg.eigvals(fixed + slowness * by_slowness).real.max(axis=-1)

        unstable = growth(speeds) > 0
        if unstable[0] or not unstable.any():
            return np.nan if unstable[0] else np.inf
        first = int(np.argmax(unstable))
        low, high = speeds[first - 1], speeds[first]
        while high - low > tolerance * high:
            middle = 0.5 * (low + high)
            low, high = (low, middle) if growth(middle) > 0 else (middle, high)
        return 0.5 * (low + high)

    return search


def compiled(source: str, folder: Path) -> Path | None:
    """A C program, compiled for this machine; None without gcc."""
    compiler = shutil.which("gcc")
    if compiler is None:
        return None
    program = folder / "rival"
    options = ["-O3", "-march=native", "-ffast-math", "-mprefer-vector-width=512", "-fopenmp"]
    subprocess.run([compiler, *options, source, "-o", str(program), "-lm"], check=True)
    return program


def printed_rate(command: list[str], runs: int, steps: int) -> float:
    """Steps/s that a program prints for `runs` simulations of `steps` steps."""
    printed = subprocess.run([*command, str(runs), str(steps)], check=True, capture_output=True, text=True).stdout
    found = re.search(r"([0-9.eE+-]+)\s+steps/s", printed)
    assert found, f"a rival must print '... X steps/s ...', not {printed!r}"
    return float(found.group(1))


def c_rate(source: str, runs: int, steps: int, folder: Path, repeats: int = 3) -> float | None:
    """Steps/s of a C program (best of a few); None without gcc."""
    program = compiled(source, folder)
    return max(printed_rate([str(program)], runs, steps) for _ in range(repeats)) if program else None
