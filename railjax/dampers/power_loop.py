"""The loop of eq. (14) for any exponent n >= 1, scaled: dζ/dσ = 1 - κ ζ^n from ζ = 0 on, solved both ways.

σ is ζ 2F1(1, 1/n; 1 + 1/n; κ ζ^n). Two polynomials, fitted once for each n, stand for the hypergeometric function: one of q = κ ζ^n up to
1/2, and beyond it one of 1 - q beside the logarithm that it has at saturation. Exact to 1e-9.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..base import smooth

Values = Float[Array, "..."]

#: κ ζ^n stays below 1 by this: 34 lengths of relaxation from where the loop is saturated
BELOW_ONE = 1e-15

#: Newton iterations of `reached`: 5 reach 1e-12 for every n from 1 to 10, κ from -1 to 1
ITERATIONS = 5


def path_to(zeta: Values, kappa: Values, n: float) -> Values:
    """σ from 0 to ζ, 0 <= ζ <= 1, for κ of -1 to 1."""
    q = jnp.minimum(kappa * zeta**n, 1.0 - BELOW_ONE)
    if n == 1:
        return zeta * smooth.log1pc(q)
    near, far = _polynomials(n)
    beyond = q > 0.5
    scale = jnp.where(beyond, kappa, 1.0) ** (-1.0 / n)
    return jnp.where(beyond, scale * (_at(far, 1.0 - q) - jnp.log1p(-q) / n), zeta * _at(near, q))


def reached(sigma: Values, kappa: Values, n: float) -> Values:
    """ζ after the path σ >= 0 from 0: the inverse of `path_to`."""
    if n == 1:
        return sigma * smooth.expm1c(kappa * sigma)
    known, k = jax.lax.stop_gradient((sigma, kappa))
    # Newton's method climbs from below in θ = -ln(1 - κ ζ^n)/κ, of which σ is a concave function, almost straight near saturation
    zeta = known * smooth.expm1c(jnp.maximum(k, 0.0) * known)
    for _ in range(ITERATIONS):
        power = zeta**n
        theta = power * smooth.log1pc(jnp.minimum(k * power, 1.0 - BELOW_ONE))
        theta = theta + (known - path_to(zeta, k, n)) * n * zeta ** (n - 1.0)
        zeta = jnp.maximum(theta * smooth.expm1c(k * theta), 0.0) ** (1.0 / n)
    # a last step, in ζ, which has the derivatives of the solution
    return zeta - (path_to(zeta, kappa, n) - sigma) * (1.0 - kappa * zeta**n)


@functools.cache
def _polynomials(n: float) -> tuple[np.polynomial.Polynomial, np.polynomial.Polynomial]:
    from numpy.polynomial import Chebyshev, Polynomial
    from scipy.special import hyp2f1

    def sum_of(q: np.ndarray) -> np.ndarray:
        return hyp2f1(1.0, 1.0 / n, 1.0 + 1.0 / n, q)

    def beside_logarithm(left: np.ndarray) -> np.ndarray:
        return (1.0 - left) ** (1.0 / n) * sum_of(1.0 - left) + np.log(left) / n

    fits = Chebyshev.interpolate(sum_of, 20, [-1.0, 0.5]), Chebyshev.interpolate(beside_logarithm, 13, [1e-9, 0.5])
    return tuple(fit.convert(kind=Polynomial, domain=fit.domain) for fit in fits)


def _at(polynomial: np.polynomial.Polynomial, x: Values) -> Values:
    """By Horner's rule, in the variable that the polynomial's domain makes -1 to 1."""
    offset, slope = polynomial.mapparms()
    t, coefficients = offset + slope * x, list(polynomial.coef[::-1])
    total = jnp.full_like(t, coefficients[0])
    for coefficient in coefficients[1:]:
        total = total * t + coefficient
    return total
