"""The coach with balance logic, written by hand: in C and Numba (sampled control, RK4), for SciPy and in Diffrax.

Physics and numbers are those of tests/reference.py. Two versions of the controller, as in railjax: "sharp" decides once a step
and holds, "smooth" is continuous (what an adaptive solver needs). All return the r.m.s. lateral acceleration of the car body
in m/s^2 per simulation; wheelsets start off by OFFSET.
"""

import ctypes
import functools
import math
import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from rivals import STATES, reference
from scipy.integrate import solve_ivp
from scipy.optimize import OptimizeResult

# threads that spin after their work would take the cores from the next in turn
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

AMPLITUDE, WAVELENGTH, OFFSET = 5e-3, 20.0, 5e-3  # m
#: railjax.BalanceLogic's: m/s, and m (0.02 of its signal_scale)
VELOCITY_WIDTH, TRAVEL_WIDTH = 5e-3, 0.02 * 0.01

PARAMETERS = {name: value for name, value in vars(reference).items() if name.isupper() and isinstance(value, float)}
GCC = ["-O3", "-march=native", "-ffast-math", "-mprefer-vector-width=512", "-fopenmp", "-Wno-psabi", "-shared", "-fPIC"]

Batch = Callable[[np.ndarray, np.ndarray, int, float], np.ndarray]


@functools.cache
def c_kernel(dtype: str) -> Batch | None:
    """`run(speeds, alphas, steps, dt)` of coach.c in "float32" or "float64", on as many threads as cores; None without gcc."""
    if shutil.which("gcc") is None:
        return None
    real, number = {"float32": ("float", ctypes.c_float), "float64": ("double", ctypes.c_double)}[dtype]
    with tempfile.TemporaryDirectory() as folder:
        lines = [f"#define {name} {value!r}" for name, value in PARAMETERS.items()]
        Path(folder, "parameters.h").write_text("\n".join(lines) + "\n")
        source, library = Path(__file__).with_name("coach.c"), Path(folder) / f"coach_{dtype}.so"
        subprocess.run(["gcc", *GCC, f"-DREAL={real}", f"-I{folder}", str(source), "-o", str(library), "-lm"], check=True)
        function = ctypes.CDLL(str(library)).run
    array = np.ctypeslib.ndpointer(dtype, flags="C_CONTIGUOUS")
    function.argtypes, function.restype = [ctypes.c_int] * 2 + [number] * 4 + [array] * 3, None

    def run(speeds: np.ndarray, alphas: np.ndarray, steps: int, dt: float) -> np.ndarray:
        speeds, alphas = (np.ascontiguousarray(values, dtype) for values in (speeds, alphas))
        rms = np.empty_like(speeds)
        function(len(speeds), steps, dt, AMPLITUDE, WAVELENGTH, OFFSET, speeds, alphas, rms)
        return rms

    return run


@functools.cache
def numba_coach() -> tuple[Batch, Callable] | None:
    """`run` as above (a parallel loop over simulations) and `rate(x, t, speed, alpha)`, the smooth law for SciPy; None without Numba."""
    try:
        import numba
    except ImportError:
        return None
    p = reference
    M_C, I_CX, I_CZ, M_B, I_BX, I_BZ, M_O, I_O = p.M_C, p.I_CX, p.I_CZ, p.M_B, p.I_BX, p.I_BZ, p.M_O, p.I_O
    K_CX, K_CY, K_CZ, C_CZ, K_OX, K_OY, K_OZ, C_OZ = p.K_CX, p.K_CY, p.K_CZ, p.C_CZ, p.K_OX, p.K_OY, p.K_OZ, p.C_OZ
    A, L, D_O, D_C, E, H_CC, H_OB, H_CB, R_0 = p.A, p.L, p.D_O, p.D_C, p.E, p.H_CC, p.H_OB, p.H_CB, p.R_0
    F_11, F_12, F_22, F_33, CONICITY = p.F_11, p.F_12, p.F_22, p.F_33, p.CONICITY
    LIMIT, K_F, DELTA = p.MU * p.WHEEL_LOAD, p.K_F, p.DELTA
    WAVENUMBER = 2 * math.pi / WAVELENGTH
    inline = numba.njit(fastmath=True, inline="always")

    @inline
    def secondary(x, at, j, side):
        return x[at] + H_CC * x[at + 2] + side * L * x[at + 1] - x[at + 3 + j] + H_CB * x[at + 7 + j]

    @inline
    def derivative(x, dx, eta, v, damper):
        """`damper`: force of each bogie's dampers, N."""
        for k in range(17):
            dx[k] = x[17 + k]
        f_y = f_psi = f_phi = 0.0
        for j in range(2):
            side = 1.0 - 2.0 * j
            lateral = 2 * K_CY * secondary(x, 0, j, side) + damper[j]
            roll = 2 * D_C**2 * (K_CZ * (x[2] - x[7 + j]) + C_CZ * (x[19] - x[24 + j]))
            yaw = 2 * D_C**2 * K_CX * (x[1] - x[5 + j])
            f_y -= lateral
            f_psi -= side * L * lateral + yaw
            f_phi -= H_CC * lateral + roll
            b_y, b_psi = lateral, yaw
            b_phi = roll - H_CB * lateral - 4 * D_O**2 * (K_OZ * x[7 + j] + C_OZ * x[24 + j])
            for k in range(2):
                i, arm = 2 * j + k, A * (1.0 - 2.0 * k)
                pull = 2 * K_OY * (x[3 + j] + arm * x[5 + j] + H_OB * x[7 + j] - x[9 + i])
                turn = 2 * D_O**2 * K_OX * (x[5 + j] - x[13 + i])
                b_y -= pull
                b_psi -= arm * pull + turn
                b_phi -= H_OB * pull
                relative, spin = x[9 + i] - eta[i], x[30 + i] / v
                along, across = E * spin + CONICITY / R_0 * relative, x[26 + i] / v - x[13 + i]
                u = math.sqrt((F_11 * along) ** 2 + (F_33 * across) ** 2) / LIMIT
                factor = 1.0 - u / 3.0 + u * u / 27.0 if u < 3.0 else 1.0 / u
                flange = K_F * (max(relative - DELTA, 0.0) + min(relative + DELTA, 0.0))
                dx[26 + i] = (pull - 2 * factor * (F_33 * across + F_12 * spin) - flange) / M_O
                dx[30 + i] = (turn + 2 * factor * (F_12 * across - E * F_11 * along - F_22 * spin)) / I_O
            dx[20 + j], dx[22 + j], dx[24 + j] = b_y / M_B, b_psi / I_BZ, b_phi / I_BX
        dx[17], dx[18], dx[19] = f_y / M_C, f_psi / I_CZ, f_phi / I_CX

    @inline
    def aligned(eta, distance):
        for i in range(4):
            position = L * (1 - 2 * (i // 2)) + A * (1 - 2 * (i % 2))
            eta[i] = AMPLITUDE * math.sin(WAVENUMBER * (distance + position))

    @inline
    def force(x, held, damper):
        for j in range(2):
            damper[j] = held[j] * abs(secondary(x, 0, j, 1.0 - 2.0 * j))

    @numba.njit(parallel=True, fastmath=True)
    def batch(speeds, alphas, steps, dt):
        rms = np.empty(speeds.size)
        for lane in numba.prange(speeds.size):
            x, at = np.zeros(34), np.zeros(34)
            k1, k2, k3, k4 = np.zeros(34), np.zeros(34), np.zeros(34), np.zeros(34)
            start, middle, end, held, damper = np.zeros(4), np.zeros(4), np.zeros(4), np.zeros(2), np.zeros(2)
            x[9:13] = OFFSET
            v, total = speeds[lane], 0.0
            aligned(start, 0.0)
            for step in range(steps):
                for j in range(2):
                    side = 1.0 - 2.0 * j
                    travel, velocity = secondary(x, 0, j, side), secondary(x, 17, j, side)
                    held[j] = 2 * K_CY * alphas[lane] * math.copysign(1.0, velocity) if travel * velocity < 0 else 0.0
                aligned(middle, v * (step + 0.5) * dt)
                aligned(end, v * (step + 1) * dt)
                force(x, held, damper)
                derivative(x, k1, start, v, damper)
                total += k1[17] ** 2
                for k in range(34):
                    at[k] = x[k] + dt / 2 * k1[k]
                force(at, held, damper)
                derivative(at, k2, middle, v, damper)
                for k in range(34):
                    at[k] = x[k] + dt / 2 * k2[k]
                force(at, held, damper)
                derivative(at, k3, middle, v, damper)
                for k in range(34):
                    at[k] = x[k] + dt * k3[k]
                force(at, held, damper)
                derivative(at, k4, end, v, damper)
                for k in range(34):
                    x[k] += dt / 6 * (k1[k] + 2 * (k2[k] + k3[k]) + k4[k])
                start[:] = end
            rms[lane] = math.sqrt(total / steps)
        return rms

    @numba.njit(fastmath=True)
    def rate(x, t, v, alpha):
        dx, eta, damper = np.empty(34), np.empty(4), np.empty(2)
        aligned(eta, v * t)
        for j in range(2):
            side = 1.0 - 2.0 * j
            damper[j] = smooth_force(secondary(x, 0, j, side), secondary(x, 17, j, side), alpha)
        derivative(x, dx, eta, v, damper)
        return dx

    smooth_force = numba.njit(fastmath=True, inline="always")(_smooth_force)
    return batch, rate


def _smooth_force(travel: float, velocity: float, alpha: float) -> float:
    """Balance logic, continuous: its signs are x/√(x² + w²)."""
    opposed = -travel / math.sqrt(travel**2 + TRAVEL_WIDTH**2)
    direction = velocity / math.sqrt(velocity**2 + VELOCITY_WIDTH**2)
    return 0.5 * (1.0 + opposed * direction) * 2 * K_CY * alpha * (-travel * opposed) * direction


K_CY = reference.K_CY


def numpy_rate(x: np.ndarray, t: float, speed: float, alpha: float) -> np.ndarray:
    """tests/reference.py without its dampers, and the controlled ones."""
    p = reference
    positions = [side * p.L + ahead * p.A for side in (1, -1) for ahead in (1, -1)]
    eta = AMPLITUDE * np.sin(2 * np.pi / WAVELENGTH * (speed * t + np.array(positions)))
    kept, p.C_CY = p.C_CY, 0.0
    try:
        dx = p.rate(x, eta, speed)
    finally:
        p.C_CY = kept
    for j, side in enumerate((1.0, -1.0)):
        travel, velocity = (
            part[0] + p.H_CC * part[2] + side * p.L * part[1] - part[3 + j] + p.H_CB * part[7 + j] for part in (x[:17], x[17:])
        )
        force = _smooth_force(travel, velocity, alpha)
        dx[17] -= force / p.M_C
        dx[18] -= side * p.L * force / p.I_CZ
        dx[19] -= p.H_CC * force / p.I_CX
        dx[20 + j] += force / p.M_B
        dx[24 + j] -= p.H_CB * force / p.I_BX
    return dx


def lsoda(rate: Callable, speed: float, alpha: float, duration: float) -> OptimizeResult:
    """SciPy's LSODA, rtol 1e-6, of x' = rate(x, t, speed, alpha), with its interpolant."""
    start = np.zeros(STATES)
    start[9:13] = OFFSET
    span = (0.0, duration)
    found = solve_ivp(lambda t, x: rate(x, t, speed, alpha), span, start, "LSODA", rtol=1e-6, atol=1e-9, dense_output=True)
    assert found.success, found.message
    return found


def rms_of(rate: Callable, found: OptimizeResult, speed: float, alpha: float, duration: float, sample: float = 1e-3) -> float:
    """r.m.s. acceleration of a solution of `lsoda`, seen every `sample` seconds as railjax sees it."""
    times = np.arange(round(duration / sample)) * sample
    accelerations = [rate(x, t, speed, alpha)[17] for t, x in zip(times, found.sol(times).T, strict=True)]
    return math.sqrt(np.mean(np.square(accelerations)))
