"""Functions with kinks, written so that values and gradients are finite everywhere; the one home for them.

Sharp laws are for reporting, their smooth twins (each with a stated width) for gradients through the kink.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from .typing import Scalar

#: smallest square told from zero; its root is far below any creep force in adhesion units
TINY = 1e-30


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


def beyond(law: str, x: Float[Array, "..."], half_width: Scalar, width: Scalar) -> Float[Array, "..."]:
    """The dead band by a vehicle's law: "sharp", its "smooth" twin of `width`, or "linear", which never leaves the band."""
    if law == "linear":
        return jnp.zeros_like(x)
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
