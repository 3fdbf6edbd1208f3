"""Functions with kinks, written so that values and gradients are finite everywhere; the one home for them.

Sharp laws are for reporting, their smooth twins (each with a stated width) for gradients through the kink.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from .typing import Scalar

#: smallest square told from zero; its root is far below any creep force in adhesion units
TINY = 1e-30

#: |q| below which tanh(√q)/√q and its like are summed as series of four terms, exact to 1e-13
SERIES = 1e-3


def sqrt_of_square(square: Float[Array, "..."]) -> Float[Array, "..."]:
    """√s for s >= 0 with derivative 0 instead of infinity at s = 0: the norm of a vector whose s = |F|² vanishes.

    Right wherever the norm only enters multiplied by F itself, as in a saturation factor.
    """
    return jnp.sqrt(jnp.maximum(square, TINY))


def smooth_norm(square: Float[Array, "..."], width: Scalar) -> Float[Array, "..."]:
    """√(s + w²) − w: the norm rounded within `width` of zero; infinitely often differentiable, at most w below √s."""
    return jnp.sqrt(square + width**2) - width


def dead_band(x: Float[Array, "..."], half_width: Scalar) -> Float[Array, "..."]:
    """How far x is outside ±δ (signed): 0 inside, x ∓ δ outside. Kinks at ±δ."""
    return x - jnp.clip(x, -half_width, half_width)


def smooth_ramp(x: Float[Array, "..."], width: Scalar) -> Float[Array, "..."]:
    """Twin of max(x, 0): (x + √(x² + w²))/2, which is w/2 at x = 0 and within w²/(4|x|) of max(x, 0) elsewhere."""
    return 0.5 * (x + jnp.sqrt(x**2 + width**2))


def smooth_dead_band(x: Float[Array, "..."], half_width: Scalar, width: Scalar) -> Float[Array, "..."]:
    """Twin of `dead_band`: an odd sum of two smooth ramps, off by at most `width`/2 (at ±δ)."""
    return smooth_ramp(x - half_width, width) - smooth_ramp(-x - half_width, width)


def odd_power(x: Float[Array, "..."], exponent: float) -> Float[Array, "..."]:
    """|x|^(n-1) x for n >= 1, with derivative 0 at x = 0 for n > 1 where the power's own would be NaN."""
    if exponent == 1:
        return x
    apart = jnp.where(x == 0.0, 1.0, jnp.abs(x))
    return jnp.where(x == 0.0, 0.0, apart ** (exponent - 1.0)) * x


def tanhc(square: Float[Array, "..."]) -> Float[Array, "..."]:
    """tanh(√q)/√q, which is tan(√-q)/√-q for q < 0 and 1 at q = 0: smooth there. Needs q > -π²/4."""
    q = square
    series = 1.0 - q / 3.0 + 2.0 * q**2 / 15.0 - 17.0 * q**3 / 315.0
    root = jnp.sqrt(jnp.where(jnp.abs(q) < SERIES, 1.0, jnp.abs(q)))
    return jnp.where(jnp.abs(q) < SERIES, series, jnp.where(q > 0.0, jnp.tanh(root), jnp.tan(root)) / root)


def artanhc(square: Float[Array, "..."]) -> Float[Array, "..."]:
    """artanh(√q)/√q, which is arctan(√-q)/√-q for q < 0 and 1 at q = 0: smooth there. Needs q < 1."""
    q = square
    series = 1.0 + q / 3.0 + q**2 / 5.0 + q**3 / 7.0
    near = jnp.abs(q) < SERIES
    root = jnp.sqrt(jnp.where(near, 0.25, jnp.abs(q)))
    within = jnp.where(q > 0.0, root, 0.25)  # or artanh beyond 1 would leave NaN in the derivative
    return jnp.where(near, series, jnp.where(q > 0.0, jnp.arctanh(within), jnp.arctan(root)) / root)


def expm1c(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """(1 - e^-x)/x, 1 at x = 0: smooth there."""
    near = jnp.abs(x) < SERIES
    apart = jnp.where(near, 1.0, x)
    return jnp.where(near, 1.0 - x / 2.0 + x**2 / 6.0 - x**3 / 24.0, -jnp.expm1(-apart) / apart)


def log1pc(x: Float[Array, "..."]) -> Float[Array, "..."]:
    """-ln(1 - x)/x, 1 at x = 0: smooth there. Needs x < 1."""
    near = jnp.abs(x) < SERIES
    apart = jnp.where(near, 0.5, x)
    return jnp.where(near, 1.0 + x / 2.0 + x**2 / 3.0 + x**3 / 4.0, -jnp.log1p(-apart) / apart)


def beyond(law: str, x: Float[Array, "..."], half_width: Scalar, width: Scalar) -> Float[Array, "..."]:
    """The dead band by a vehicle's law: "sharp", its "smooth" twin of `width`, or "linear", whose slope is that of rest: 0, or 1
    where the band is negative, which is beyond its corners already."""
    if law == "linear":
        return jnp.where(jnp.asarray(half_width) < 0.0, x, jnp.zeros_like(x))
    if law == "smooth":
        return smooth_dead_band(x, half_width, width)
    return dead_band(x, half_width)


def smooth_sign(x: Float[Array, "..."], width: Scalar) -> Float[Array, "..."]:
    """Twin of sgn x: x/√(x² + w²), which has the sign of x and is within w²/(2x²) of ±1."""
    return x / jnp.sqrt(x**2 + width**2)


def smooth_abs(x: Float[Array, "..."], width: Scalar) -> Float[Array, "..."]:
    """Twin of |x|: x²/√(x² + w²), zero at zero and below |x| by less than 0.31 w."""
    return x * smooth_sign(x, width)


def agreement(law: str, one: Float[Array, "..."], other: Float[Array, "..."]) -> Float[Array, "..."]:
    """1 where two numbers have the same sign, 0 where they have not or one is zero; of the smooth twin, "smooth", the numbers
    are to be `smooth_sign`s and the result is (1 + product)/2, which goes from 0 to 1 within their widths."""
    product = one * other
    return 0.5 * (1.0 + product) if law == "smooth" else jnp.where(product > 0.0, 1.0, 0.0).astype(product.dtype)
