"""Cooperrider's bogie in NumPy: the 14 equations as published (bifurcation.de, exd10), with the benchmark's own symbols and
numbers; nothing is taken from railjax."""

import math

import numpy as np

M_W, M_F, I_WY, I_FY, I_FR = 1022.0, 2918.0, 678.0, 6780.0, 6780.0
K1, K2, K3, K4, K5, K6 = 1.823e6, 3.646e6, 3.646e6, 0.1823e6, 0.3333e6, 2.710e6
D1, D2 = 20.0e3, 29.2e3
B, SMALL_D1, SMALL_D2, H1, H2 = 1.074, 0.620, 0.680, 0.0762, 0.6584
A, R_0, CONICITY = 0.7163, 0.4572, 0.05
MU_N, G_PI_A_B, PHI, PSI = 0.15 * 66670.0, 6.563e6, 0.54219, 0.60252
K_0, DEAD_BAND = 14.60e6, 9.1e-3


def flange(y: float) -> float:
    return K_0 * (max(y - DEAD_BAND, 0.0) + min(y + DEAD_BAND, 0.0))


def creep(xi_x: float, xi_y: float) -> tuple[float, float]:
    """X and Y of one wheel; xi_x is the lateral creepage."""
    xi_r = math.hypot(xi_x / PHI, xi_y / PSI)
    u = G_PI_A_B * xi_r / MU_N
    force = MU_N * (u - u**2 / 3 + u**3 / 27) if u < 3 else MU_N
    return xi_x / PHI * force / xi_r, xi_y / PSI * force / xi_r


def rate(q: np.ndarray, w: np.ndarray, v: float) -> np.ndarray:
    """q'' for q = y1, psi1, y2, psi2 of the wheelsets, y, psi, roll of the frame, and w = q'."""
    q1, q2, q3, q4, q5, q6, q7 = q
    a1 = 2 * K1 * (q1 - q5 - B * q6 - H1 * q7)
    a2 = 2 * K2 * SMALL_D1**2 * (q2 - q6)
    a3 = 2 * K1 * (q3 - q5 + B * q6 - H1 * q7)
    a4 = 2 * K2 * SMALL_D1**2 * (q4 - q6)
    a5 = 2 * D2 * (w[4] - H2 * w[6]) + 2 * K4 * (q5 - H2 * q7)
    a6 = K6 * q6
    a7 = 2 * D1 * SMALL_D2**2 * w[6] + 2 * K5 * SMALL_D2**2 * q7 + 4 * K3 * SMALL_D1**2 * q7
    x1, y1 = creep(w[0] / v - q2, A * w[1] / v + CONICITY * q1 / R_0)
    x2, y2 = creep(w[2] / v - q4, A * w[3] / v + CONICITY * q3 / R_0)
    return np.array(
        [
            (-a1 - 2 * x1 - flange(q1)) / M_W,
            (-a2 - 2 * A * y1) / I_WY,
            (-a3 - 2 * x2 - flange(q3)) / M_W,
            (-a4 - 2 * A * y2) / I_WY,
            (a1 + a3 - a5) / M_F,
            (B * a1 - B * a3 + a2 + a4 - a6) / I_FY,
            (H1 * (a1 + a3) + H2 * a5 - a7) / I_FR,
        ]
    )
