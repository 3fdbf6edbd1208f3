"""Creep coefficients from the contact ellipse: Hertz's theory and Kalker's linear theory of rolling contact.

With these another wheel load, wheel radius or rail head gives its own f_ij; everything is differentiable.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...base.arguments import guarded
from ...base.checks import traced
from ...base.errors import InputError
from ...base.typing import Scalar

STEEL_YOUNG = 2.1e11  # Pa
STEEL_POISSON = 0.27

#: log10-symmetric abscissae: a/b = 0.1 ... 1, then b/a = 0.9 ... 0.1, as the table is printed
_RATIOS = np.concatenate([np.arange(1, 11) / 10, 10 / np.arange(9, 0, -1)])
_POISSON = np.array([0.0, 0.25, 0.5])

# Kalker, Three-Dimensional Elastic Bodies in Rolling Contact (1990), Table E3: rows a/b as above, columns nu = 0, 1/4, 1/2
# fmt: off
_C11 = np.array([
    [2.51, 3.31, 4.85], [2.59, 3.37, 4.81], [2.68, 3.44, 4.80], [2.78, 3.53, 4.82], [2.88, 3.62, 4.83],
    [2.98, 3.72, 4.91], [3.09, 3.81, 4.97], [3.19, 3.91, 5.05], [3.29, 4.01, 5.12], [3.40, 4.12, 5.20],
    [3.51, 4.22, 5.30], [3.65, 4.36, 5.42], [3.82, 4.54, 5.58], [4.06, 4.78, 5.80], [4.37, 5.10, 6.11],
    [4.84, 5.57, 6.57], [5.57, 6.34, 7.34], [6.96, 7.78, 8.82], [10.7, 11.7, 12.9]])
_C22 = np.array([
    [2.51, 2.52, 2.53], [2.59, 2.63, 2.66], [2.68, 2.75, 2.81], [2.78, 2.88, 2.98], [2.88, 3.01, 3.14],
    [2.98, 3.14, 3.31], [3.09, 3.28, 3.48], [3.19, 3.41, 3.65], [3.29, 3.54, 3.82], [3.40, 3.67, 3.98],
    [3.51, 3.81, 4.16], [3.65, 3.99, 4.39], [3.82, 4.21, 4.67], [4.06, 4.50, 5.04], [4.37, 4.90, 5.56],
    [4.84, 5.48, 6.31], [5.57, 6.40, 7.51], [6.96, 8.14, 9.79], [10.7, 12.8, 16.0]])
_C23 = np.array([
    [0.334, 0.473, 0.731], [0.483, 0.603, 0.809], [0.607, 0.715, 0.889], [0.720, 0.823, 0.977], [0.827, 0.929, 1.07],
    [0.930, 1.03, 1.18], [1.03, 1.14, 1.29], [1.13, 1.25, 1.40], [1.23, 1.36, 1.51], [1.33, 1.47, 1.63],
    [1.44, 1.59, 1.77], [1.58, 1.75, 1.94], [1.76, 1.95, 2.18], [2.01, 2.23, 2.50], [2.35, 2.62, 2.96],
    [2.88, 3.24, 3.70], [3.79, 4.32, 5.01], [5.72, 6.63, 7.89], [12.2, 14.6, 18.0]])
# Recalled, not checked at its source (the spin moment of pure spin; it hardly matters for lateral dynamics)
_C33 = np.array([
    [6.42, 8.28, 11.7], [3.46, 4.27, 5.66], [2.49, 2.96, 3.72], [2.02, 2.32, 2.77], [1.74, 1.93, 2.22],
    [1.56, 1.68, 1.86], [1.43, 1.50, 1.60], [1.34, 1.37, 1.42], [1.27, 1.27, 1.27], [1.21, 1.19, 1.16],
    [1.16, 1.11, 1.06], [1.10, 1.04, 0.954], [1.05, 0.965, 0.852], [1.01, 0.892, 0.751], [0.958, 0.819, 0.650],
    [0.912, 0.747, 0.549], [0.868, 0.674, 0.446], [0.828, 0.601, 0.341], [0.795, 0.526, 0.228]])
# fmt: on


class KalkerCoefficients(NamedTuple):
    """C_11 (longitudinal), C_22 (lateral), C_23 (lateral/spin), C_33 (spin): F_x = -G ab C_11 xi_x, and so on."""

    c11: Float[Array, "..."]
    c22: Float[Array, "..."]
    c23: Float[Array, "..."]
    c33: Float[Array, "..."]


class ContactEllipse(NamedTuple):
    """Semi-axes, m: a along the rail, b across it."""

    a: Float[Array, "..."]
    b: Float[Array, "..."]


class CreepCoefficients(NamedTuple):
    """Fields of `Contact`: f_11, f_33 (N), f_12 (N m), f_22 (N m^2), per wheel."""

    creep_longitudinal: Float[Array, "..."]
    creep_lateral: Float[Array, "..."]
    creep_lateral_spin: Float[Array, "..."]
    creep_spin: Float[Array, "..."]


@guarded()
def kalker_coefficients(ratio: Scalar, poisson: Scalar = STEEL_POISSON) -> KalkerCoefficients:
    """Kalker's table at a/b = `ratio` and Poisson's ratio `poisson` (0 to 0.5); exact at the table's entries.

    Linear in log(a/b) between rows, through the three columns by Lagrange's parabola in nu. A ratio outside of 0.1 to 10, where the
    table ends, is refused; inside a transformation, where it is not known, the end rows are kept.
    """
    ratio, poisson = jnp.asarray(ratio, float), jnp.asarray(poisson, float)
    abscissa = jnp.log(ratio)
    weights = [
        jnp.prod(
            jnp.stack([(poisson - _POISSON[j]) / (_POISSON[i] - _POISSON[j]) for j in range(3) if j != i]),
            axis=0,
        )
        for i in range(3)
    ]

    def read(table: np.ndarray) -> Float[Array, "..."]:
        # logarithms, because the ends of the table grow like powers of a/b
        columns = [jnp.interp(abscissa, np.log(_RATIOS), np.log(table[:, i])) for i in range(3)]
        return jnp.exp(sum(w * c for w, c in zip(weights, columns, strict=True)))

    return KalkerCoefficients(read(_C11), read(_C22), read(_C23), read(_C33))


@guarded()
def contact_ellipse(
    load: Scalar,
    wheel_radius: Scalar,
    rail_head_radius: Scalar,
    wheel_profile_radius: Scalar = jnp.inf,
    youngs_modulus: Scalar = STEEL_YOUNG,
    poisson: Scalar = STEEL_POISSON,
) -> ContactEllipse:
    """Hertz: semi-axes (m) of the contact of a wheel on a rail head, both of the same material.

    Curvatures A = 1/(2 r_0) along, B = (1/R_rail + 1/R_wheel)/2 across. With the effective modulus E' = E/(2(1 - nu²)) and the
    eccentricity k² of the ellipse, A/B fixes k and the load the size: Johnson, Contact Mechanics (1985), sec. 4.2. Every number
    may have one value per lane.

    Args:
        load: P on the wheel, N; about 51e3 for a coach.
        wheel_radius: rolling radius r_0, m; about 0.46.
        rail_head_radius: R_rail, m; about 0.3.
        wheel_profile_radius: R_wheel of the profile, m: infinite for a cone, negative if hollow.
        youngs_modulus: E, Pa; by default steel's, 2.1e11.
        poisson: Poisson's ratio nu, dimensionless, 0 to 0.5; by default steel's, 0.27.

    Raises:
        InputError: for a hollow wheel that is not wider than the rail head.
    """
    if not traced((rail_head_radius, wheel_profile_radius)):
        curvature = 1.0 / np.asarray(rail_head_radius, float) + 1.0 / np.asarray(wheel_profile_radius, float)
        if not np.all(curvature > 0.0):
            raise InputError("wheel_profile_radius: a hollow wheel must be wider than the rail head")
    along = jnp.asarray(0.5 / wheel_radius, float)
    across = jnp.asarray(0.5 * (1.0 / rail_head_radius + 1.0 / wheel_profile_radius), float)
    modulus = youngs_modulus / (2.0 * (1.0 - poisson**2))
    # the longer semi-axis lies in the direction of the smaller curvature
    small, large = jnp.minimum(along, across), jnp.maximum(along, across)
    k = _axis_ratio(large / small)  # minor / major
    _, second = _elliptic_integrals(1.0 - k**2)
    # a³ = 3 P E(m)/(2 pi E' k² (A + B)), a the major semi-axis, m = 1 - k²
    major = (3.0 * load * second / (2.0 * jnp.pi * modulus * k**2 * (small + large))) ** (1.0 / 3.0)
    minor = k * major
    return ContactEllipse(jnp.where(along <= across, major, minor), jnp.where(along <= across, minor, major))


@guarded()
def creep_coefficients(
    load: Scalar,
    wheel_radius: Scalar,
    rail_head_radius: Scalar,
    wheel_profile_radius: Scalar = jnp.inf,
    youngs_modulus: Scalar = STEEL_YOUNG,
    poisson: Scalar = STEEL_POISSON,
) -> CreepCoefficients:
    """f_11 = G ab C_11, f_33 = G ab C_22, f_12 = G (ab)^1.5 C_23, f_22 = G (ab)² C_33, with G = E/(2(1 + nu)).

    f_11 and f_33 in N, f_12 in N m, f_22 in N m^2, for the ellipse of `contact_ellipse` and Kalker's table. A coach wheel (51 kN,
    r_0 0.46 m, rail head 0.3 m) gives about 10 MN; measured values are often a third lower (contaminated rail). Every number may
    have one value per lane.

    Args:
        load: P on the wheel, N.
        wheel_radius: rolling radius r_0, m.
        rail_head_radius: R_rail, m.
        wheel_profile_radius: R_wheel of the profile, m: infinite for a cone, negative if hollow.
        youngs_modulus: E, Pa; by default steel's, 2.1e11.
        poisson: Poisson's ratio nu, dimensionless, 0 to 0.5; by default steel's, 0.27.

    Raises:
        InputError: for a hollow wheel that is not wider than the rail head, and an ellipse with a/b outside of 0.1 to 10, where
            the table ends.
    """
    a, b = contact_ellipse(load, wheel_radius, rail_head_radius, wheel_profile_radius, youngs_modulus, poisson)
    c = kalker_coefficients(a / b, poisson)
    shear = youngs_modulus / (2.0 * (1.0 + poisson))
    area = a * b
    return CreepCoefficients(shear * area * c.c11, shear * area * c.c22, shear * area**1.5 * c.c23, shear * area**2 * c.c33)


def _elliptic_integrals(m: Float[Array, "..."]) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """Complete elliptic integrals K(m) and E(m), 0 <= m < 1, by the arithmetic-geometric mean (Abramowitz & Stegun 17.6)."""
    a, g = jnp.ones_like(m), jnp.sqrt(1.0 - m)
    power, total = 0.5, 0.5 * m
    for _ in range(6):  # quadratic convergence: double precision down to 1 - m = 1e-9
        a, g, c = 0.5 * (a + g), jnp.sqrt(a * g), 0.5 * (a - g)
        power *= 2.0
        total = total + power * c**2
    first = jnp.pi / (2.0 * a)
    return first, first * (1.0 - total)


def _curvature_ratio(k: Float[Array, "..."]) -> Float[Array, "..."]:
    """Ratio of the larger to the smaller relative curvature that makes an ellipse of minor/major = k."""
    first, second = _elliptic_integrals(1.0 - k**2)
    return (second / k**2 - first) / (first - second)


def _too_round(log_k: Float[Array, "..."], ratio: Float[Array, "..."]) -> Float[Array, "..."]:
    """Zero at the ellipse of this ratio of curvatures; a function of the module, so that JAX compiles it once."""
    return jnp.log(_curvature_ratio(jnp.exp(log_k))) - jnp.log(ratio)


def _axis_ratio(curvatures: Float[Array, "..."]) -> Float[Array, "..."]:
    """Minor/major semi-axis for a ratio of curvatures >= 1: Newton in log k from k = ratio^(-2/3)."""
    import optimistix

    circle = curvatures <= 1.0 + 1e-9
    safe = jnp.where(circle, 2.0, curvatures)

    tolerance = float(jnp.finfo(safe.dtype).eps) ** 0.75
    solver = optimistix.Newton(rtol=tolerance, atol=tolerance)  # type: ignore[var-annotated]
    log_k = optimistix.root_find(_too_round, solver, -(2.0 / 3.0) * jnp.log(safe), args=safe, max_steps=50).value
    return jnp.where(circle, curvatures ** (-2.0 / 3.0), jnp.exp(log_k))
