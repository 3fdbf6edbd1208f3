"""Equivalent conicity: the wave of a free wheelset on its rails against that of a coned one (EN 15302, UIC 519).

A wheelset that rolls without slip follows y'' = -Delta r(y)/(2 e r_0) (Klingel): a particle in a potential. Its wave between y_min and
y_max has a wavelength L, and the cone of the same wavelength, tan gamma_e = (2 pi/L)^2 e r_0, is the equivalent conicity at the amplitude
(y_max - y_min)/2.
"""

import functools
from types import ModuleType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...base.arguments import guarded
from ...base.checks import Range, Rising, Samples, positive
from ...base.errors import InputError
from ...base.namespace import constant, namespace, repeated
from ...base.typing import Scalar, Values

#: also one number of NumPy

#: nodes of the integral over half a wave; measured Delta r has corners, which is what asks for many
NODES = 400

#: halvings of the interval in which the wave's middle lies: beyond the precision of a double
HALVINGS = 50

#: m; amplitudes between which the nonlinearity parameter is taken (Polach 2010)
NONLINEARITY = 2e-3, 4e-3

_LATERAL = Rising(Range("m", -0.1, 0.1, why="; is it in millimetres?"), 3)
_SAMPLES, _LENGTH = Samples("m"), positive("m", axes=1)


def _displacements(key: str, value: Any) -> None:
    """Lateral displacements that rise."""
    _LATERAL(key, value)


@guarded(
    y=_displacements,
    delta_r=_SAMPLES,
    amplitude=Range("m", 0.0, 0.1, open=True, axes=9, why="; is it in millimetres?"),
    half_distance=_LENGTH,
    radius=_LENGTH,
)
def equivalent_conicity(
    y: Float[Array, "n"] | Float[np.ndarray, "n"],
    delta_r: Float[Array, "..."] | Float[np.ndarray, "..."],
    amplitude: Scalar,
    *,
    half_distance: Scalar = 0.75,
    radius: Scalar = 0.46,
) -> Values:
    """tan gamma_e of a function Delta r(y), EN 15302: (2 pi/L)² e r_0, L the wavelength of the free wheelset's path.

    y'' = -Delta r/(2 e r_0) is integrated over the full period: with V = ∫ Delta r dy, the wave between y_min and y_max, where V is the
    same and (y_max - y_min)/2 the amplitude, has L = 2 √(e r_0) ∫ dy/√(V(y_max) - V(y)). Delta r is a straight line between the samples,
    so V is exact. e and r_0 are in L as in the cone's formula and drop out. A cone gives its own conicity at every amplitude, and 0 says that
    nothing pulls the wheelset back (Delta r = 0). Differentiable with respect to `delta_r` and `amplitude`; `vmap` works.

    Args:
        y: lateral displacement, m, rising; positive to the right
        delta_r: r_R - r_L, m, at each y; not necessarily odd (unequal wheels, asymmetric profiles)
        amplitude: half the width of the wave, m, any shape; EN 15302 takes 3 mm
        half_distance: e, half the distance of the rolling circles, m; 0.75 on standard gauge
        radius: r_0, mean rolling radius, m; 0.46 for new wheels of 920 mm

    Returns:
        tan gamma_e, dimensionless, shaped like `amplitude`; NaN where there is no free wave of that amplitude: Delta r drives the
        wheelset away, or the wave does not fit into y.

    Raises:
        InputError: for lengths that differ, samples that are not finite, and where no amplitude fits into y.
    """
    xp = namespace((y, delta_r, amplitude))
    y, delta_r, amplitude = (xp.asarray(value, float) for value in (y, delta_r, amplitude))
    if y.shape != delta_r.shape:
        raise InputError(f"delta_r must have a value for each y: {delta_r.shape} and {y.shape}")
    if xp is np:
        widest = 0.5 * float(y[-1] - y[0])
        if np.all(np.asarray(amplitude) > widest):
            raise InputError(f"amplitude must be at most {widest:.4g} m, half the range of y, not {np.min(amplitude):.4g}")
        if not np.all(np.isfinite(delta_r)):
            raise InputError("delta_r must be finite numbers (m)")
    return np.asarray(_conicity(np, y, delta_r, amplitude)) if xp is np else _compiled(y, delta_r, amplitude)


@guarded(y=_displacements, delta_r=_SAMPLES, half_distance=_LENGTH, radius=_LENGTH)
def nonlinearity_parameter(
    y: Float[Array, "n"] | Float[np.ndarray, "n"],
    delta_r: Float[Array, "..."] | Float[np.ndarray, "..."],
    *,
    half_distance: Scalar = 0.75,
    radius: Scalar = 0.46,
) -> Values:
    """N_P = (tan gamma_e(4 mm) - tan gamma_e(2 mm))/(2 mm), in 1/m: how the conicity changes with amplitude.

    Where it falls (N_P < 0) limit cycles of small amplitude start below the linear critical speed, where it rises the wheelset hunts hard at
    once but later (Polach, Vehicle System Dynamics 48, 2010 supplement).

    Args:
        y: lateral displacement, m, rising; positive to the right
        delta_r: r_R - r_L, m, at each y
        half_distance: e, half the distance of the rolling circles, m
        radius: r_0, mean rolling radius, m
    """
    low, high = NONLINEARITY
    small, large = equivalent_conicity(y, delta_r, np.array([low, high]), half_distance=half_distance, radius=radius)
    return (large - small) / (high - low)


# by eigenvalues: half of the time of a geometry with its conicity, if anew each time
_gauss_legendre = functools.cache(functools.partial(np.polynomial.legendre.leggauss, NODES))


def _conicity(xp: ModuleType, y: Values, delta_r: Values, amplitude: Values) -> Values:
    potential = _Potential(xp, y, delta_r)
    middle = _middle(xp, potential, amplitude)
    # y = middle + A sin(theta): the ends' 1/√ cancels against cos(theta)
    theta, weight = _gauss_legendre()
    theta, weight = 0.5 * np.pi * theta, 0.5 * np.pi * weight
    sine, cosine, weight = (xp.asarray(part, y.dtype) for part in (np.sin(theta), np.cos(theta), weight))
    inside = middle[..., None] + amplitude[..., None] * sine
    level = 0.5 * (potential(middle + amplitude) + potential(middle - amplitude))
    depth = level[..., None] - potential(inside)
    inside_y = (middle + amplitude <= y[-1]) & (middle - amplitude >= y[0])
    wave, still = xp.all(depth > 0.0, axis=-1), xp.all(depth >= 0.0, axis=-1)
    depth = xp.where(wave[..., None], depth, 1.0)  # a lane without a wave leaves the derivatives of the others alone
    # half the wave over √(e r_0)
    half = xp.sum(weight * amplitude[..., None] * cosine / xp.sqrt(depth), axis=-1)
    # L = 2 √(e r_0) half, so (2 pi/L)² e r_0 = (pi/half)²: e and r_0 drop out
    found = xp.where(wave, (np.pi / half) ** 2, 0.0)  # where nothing pulls the wave is infinitely long
    return xp.where(still & inside_y, found, xp.nan)


def _middle(xp: ModuleType, potential: "_Potential", amplitude: Values) -> Values:
    """Where the wave's middle lies: V(c + A) = V(c - A), whose difference rises with c; halved, then a Newton step for the derivative."""
    ends = potential.y[0] + amplitude, potential.y[-1] - amplitude

    def halve(ends: tuple[Values, Values]) -> tuple[Values, Values]:
        centre = 0.5 * (ends[0] + ends[1])
        right = potential(centre + amplitude) > potential(centre - amplitude)
        return xp.where(right, ends[0], centre), xp.where(right, centre, ends[1])

    low, high = repeated(xp, HALVINGS, halve, ends)
    centre, width = constant(xp, (0.5 * (low + high), amplitude))
    slope = constant(xp, potential.rate(centre + width) - potential.rate(centre - width))
    return centre - (potential(centre + amplitude) - potential(centre - amplitude)) / xp.where(slope > 0.0, slope, 1.0)


class _Potential:
    """V = ∫ Delta r dy of straight lines between the samples, from y_0 on."""

    def __init__(self, xp: ModuleType, y: Values, delta_r: Values):
        step = xp.diff(y)
        self.xp = xp
        self.y, self.values = y, delta_r
        self.slope = xp.diff(delta_r) / step
        self.total = xp.concatenate([xp.zeros(1, y.dtype), xp.cumsum(0.5 * (delta_r[1:] + delta_r[:-1]) * step)])

    def _at(self, y: Values) -> tuple[Any, Values]:
        index = self.xp.clip(self.xp.searchsorted(self.y, y, side="right") - 1, 0, len(self.slope) - 1)
        return index, y - self.y[index]

    def __call__(self, y: Values) -> Values:
        index, beyond = self._at(y)
        return self.total[index] + beyond * (self.values[index] + 0.5 * self.slope[index] * beyond)

    def rate(self, y: Values) -> Values:
        index, beyond = self._at(y)
        return self.values[index] + self.slope[index] * beyond


_compiled = jax.jit(functools.partial(_conicity, jnp))
