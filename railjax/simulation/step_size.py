"""The largest step that RK4 holds: from the spectral radius of state matrices, inside a program or on the host."""

import itertools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..base.typing import Scalar
from ..model.damper import Damper, damper_extremes
from ..model.kinematics import size
from ..model.motion import state_matrices, state_matrix
from ..model.suspension import extremes
from ..model.vehicle import Vehicle

#: |R(z)| <= 1 for RK4's stability function on every z in the left half plane with |z| <= this (2.6156 at the waist)
STABLE_RADIUS = 2.61


def fastest_rate(vehicle: Vehicle, speed: Scalar, damper: Damper, enough: Scalar = 0.0) -> Float[Array, ""]:
    """Largest spectral radius of the state matrix with the flanges free and in contact, 1/s: an upper bound, within 1 % or below
    `enough`; infinite where the matrix is beyond floating point.

    Both, because the flange's spring slows the overdamped creep modes of low speed and quickens the others; and likewise
    within and beyond the corners of the other elements (`extremes`) and of the damper (`damper_extremes`). Gelfand: |E^(2^k)|^(1/2^k) by repeated squaring, so that
    it runs in a batch and on any device.
    """
    cases = itertools.product(extremes(vehicle), damper_extremes(vehicle, damper), (False, True))
    matrices = [state_matrix(one, speed, law, flange=flange) for one, law, flange in cases]
    largest = max(len(matrix) for matrix in matrices)
    matrices = [jnp.pad(matrix, (0, largest - len(matrix))) for matrix in matrices]  # laws differ in their internal states
    matrix, enough = jax.lax.stop_gradient((jnp.stack(matrices), enough))
    return _radius(matrix, size(vehicle), enough)


def fastest_rate_on_host(
    vehicle: Vehicle, speed: Scalar, damper: Damper, enough: float = 0.0, matrices: Callable[..., np.ndarray] = state_matrices
) -> float:
    """`fastest_rate` of one vehicle of known numbers, by NumPy from compiled state matrices: those of `matrices`, or of what gives the
    same by another program."""
    cases = itertools.product(extremes(vehicle), damper_extremes(vehicle, damper))
    with np.errstate(all="ignore"):
        return float(max(_radius(matrices(one, speed, law), size(vehicle), enough) for one, law in cases))


def _radius(matrix: Any, n: int, enough: Scalar) -> Any:
    """The largest spectral radius of matrices, (k, states, states), by NumPy or JAX as they are."""
    host = isinstance(matrix, np.ndarray)
    xp: Any = np if host else jnp
    scale = np.where(np.arange(matrix.shape[-1]) < n, 100.0, 1.0).astype(
        matrix.dtype
    )  # displacements against velocities: about the rates
    matrix = matrix * (scale[:, None] / scale)

    def norm(power: Any) -> Any:
        return xp.sqrt(xp.sum(power**2, axis=(-2, -1), keepdims=True))

    def bound(power: Any, logarithm: Any, doublings: Any) -> Any:
        return xp.max(xp.exp((logarithm + xp.log(norm(power))) / 2.0**doublings))

    def square(carry: tuple) -> tuple:
        power, logarithm, doublings = carry
        size_now = norm(power)
        power = (power / size_now) @ (power / size_now)
        return power, 2.0 * (logarithm + xp.log(size_now)), doublings + 1

    def loose(carry: tuple) -> Any:
        return (carry[2] < 10) & (bound(*carry) > enough)

    carry = matrix, xp.zeros((len(matrix), 1, 1), matrix.dtype), xp.asarray(0)
    if host:
        while loose(carry):
            carry = square(carry)
    else:
        carry = jax.lax.while_loop(loose, square, carry)
    rate = bound(*carry)
    return xp.where(xp.isnan(rate), xp.inf, rate)  # a norm that overflows


@jax.jit
def largest_step(vehicle: Vehicle, speed: Scalar, damper: Damper) -> Float[Array, ""]:
    """Largest dt (s) that RK4 holds at this speed: creep damping 2 f/(m v) grows as 1/v, 9 ms at 40 m/s, 1 ms at 5 m/s."""
    return STABLE_RADIUS / fastest_rate(vehicle, speed, damper)
