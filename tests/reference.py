"""The coach's equations of motion a second time, in NumPy, coordinate by coordinate: written from Lagrange's equations of
the paper and not from railjax, so that agreement means something."""

import math

import numpy as np

# Table 1, SI
M_C, I_CX, I_CZ = 30760.0, 53596.0, 1661732.0
M_B, I_BX, I_BZ = 2300.0, 2240.0, 2965.0
M_O, I_O = 1410.0, 980.0
K_CX, K_CY, K_CZ, C_CX, C_CY, C_CZ = 133e3, 133e3, 473e3, 0.0, 25e3, 18e3
K_OZ, C_OZ = 904e3, 3.67e3
A, L, D_O, D_C, E = 1.28, 8.6, 1.0, 1.0, 0.7175
H_CC, H_OB, H_CB, R_0 = 1.24, 0.01, 0.06, 0.46
F_11, F_12, F_22, F_33, CONICITY, WHEEL_LOAD = 9.43e6, 1200.0, 1000.0, 10.25e6, 0.14, 51250.0
# calibrated or assumed
K_OX, K_OY, C_OX, C_OY = 3227.632e3, 11158.024e3, 0.0, 0.0
MU, K_F, DELTA = 0.412426, 14.6e6, 8.74112e-3
CREEP_WIDTH, FLANGE_WIDTH = 0.01, 1e-4


def flange(y: float, law: str) -> float:
    if law == "linear":
        return 0.0
    if law == "sharp":
        return K_F * (max(y - DELTA, 0.0) + min(y + DELTA, 0.0))
    ramp = lambda s: 0.5 * (s + math.sqrt(s * s + FLANGE_WIDTH**2))  # noqa: E731
    return K_F * (ramp(y - DELTA) - ramp(-y - DELTA))


def creep_factor(force_x: float, force_y: float, law: str) -> float:
    if law == "linear":
        return 1.0
    u = math.hypot(force_x, force_y) / (MU * WHEEL_LOAD)
    if law == "smooth":
        u = math.sqrt(u * u + CREEP_WIDTH**2) - CREEP_WIDTH
    return 1.0 - u / 3.0 + u * u / 27.0 if u < 3.0 else 1.0 / u


def rate(x: np.ndarray, eta: np.ndarray, v: float, law: str = "sharp") -> np.ndarray:
    """x' for x = [q, q'], q = y_c psi_c phi_c, y_b1 y_b2, psi_b1 psi_b2, phi_b1 phi_b2, y_1..4, psi_1..4."""
    q, w = x[:17], x[17:]
    y_c, psi_c, phi_c = q[:3]
    vy_c, vpsi_c, vphi_c = w[:3]
    f = np.zeros(17)
    for j, side in enumerate((1.0, -1.0)):
        y_b, psi_b, phi_b = q[3 + j], q[5 + j], q[7 + j]
        vy_b, vpsi_b, vphi_b = w[3 + j], w[5 + j], w[7 + j]
        travel = y_c + H_CC * phi_c + side * L * psi_c - y_b + H_CB * phi_b
        speed = vy_c + H_CC * vphi_c + side * L * vpsi_c - vy_b + H_CB * vphi_b
        lateral = 2 * K_CY * travel + 2 * C_CY * speed
        roll = 2 * D_C**2 * (K_CZ * (phi_c - phi_b) + C_CZ * (vphi_c - vphi_b))
        yaw = 2 * D_C**2 * (K_CX * (psi_c - psi_b) + C_CX * (vpsi_c - vpsi_b))
        f[0] -= lateral
        f[1] -= side * L * lateral + yaw
        f[2] -= H_CC * lateral + roll
        f[3 + j] += lateral
        f[5 + j] += yaw
        f[7 + j] += roll - H_CB * lateral - 4 * D_O**2 * (K_OZ * phi_b + C_OZ * vphi_b)
        for k, ahead in enumerate((1.0, -1.0)):
            i = 2 * j + k
            y, psi, vy, vpsi = q[9 + i], q[13 + i], w[9 + i], w[13 + i]
            lateral = 2 * K_OY * (y_b + ahead * A * psi_b + H_OB * phi_b - y)
            lateral += 2 * C_OY * (vy_b + ahead * A * vpsi_b + H_OB * vphi_b - vy)
            yaw = 2 * D_O**2 * (K_OX * (psi_b - psi) + C_OX * (vpsi_b - vpsi))
            f[3 + j] -= lateral
            f[5 + j] -= ahead * A * lateral + yaw
            f[7 + j] -= H_OB * lateral
            y_rel = y - eta[i]
            xi_x = E * vpsi / v + CONICITY * y_rel / R_0
            xi_y = vy / v - psi
            xi_s = vpsi / v
            factor = creep_factor(F_11 * xi_x, F_33 * xi_y, law)
            f[9 + i] = lateral - 2 * factor * (F_33 * xi_y + F_12 * xi_s) - flange(y_rel, law)
            f[13 + i] = yaw + factor * (-2 * E * F_11 * xi_x + 2 * F_12 * xi_y - 2 * F_22 * xi_s)
    mass = np.array([M_C, I_CZ, I_CX, M_B, M_B, I_BZ, I_BZ, I_BX, I_BX, *[M_O] * 4, *[I_O] * 4])
    return np.concatenate([w, f / mass])


def acceleration(x: np.ndarray) -> float:
    """Eq. (5) with its last term corrected to phi_b (reading 1)."""
    y_c, phi_c, vy_c, vphi_c = x[0], x[2], x[17], x[19]
    y_b, phi_b, vy_b, vphi_b = x[3:5], x[7:9], x[20:22], x[24:26]
    own = 2 * (C_CY * vy_c + K_CY * y_c + H_CC * (C_CY * vphi_c + K_CY * phi_c))
    bogies = C_CY * vy_b.sum() + K_CY * y_b.sum() - H_CB * (C_CY * vphi_b.sum() + K_CY * phi_b.sum())
    return -2.0 / M_C * (own - bogies)
