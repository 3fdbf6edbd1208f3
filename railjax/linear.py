"""Linear stability: the critical speed at which straight running loses stability, and its gradient."""

import functools
from enum import IntEnum
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Complex, Float, Int

from .dampers import Damper
from .errors import NumericalError
from .lanes import count_lanes, each_lane, over_lanes, own_axes
from .motion import PASSIVE, state_matrix
from .precision import require_double_precision
from .typing import Scalar
from .units import KMH
from .vehicle import Vehicle, without_labels

#: speeds (m/s) between which a crossing is looked for, and how many are tried; a window of instability narrower than the
#: spacing (about 2.5 m/s) can be missed: look at `root_locus` when in doubt
LOWEST, HIGHEST, POINTS = 3.0, 150.0, 60


class Stability(IntEnum):
    """What the search for the critical speed found."""

    OK = 0
    STABLE = 1  # no crossing up to the highest speed: the critical speed is given as infinity
    UNSTABLE = 2  # unstable at the lowest speed already: the critical speed is given as NaN
    FAILED = 3  # eigenvalues not finite, or the crossing could not be resolved: the critical speed is given as NaN


class LinearCritical(NamedTuple):
    """Linear critical speed (m/s), frequency of the critical mode (Hz), how fast its growth rate rises with speed
    (1/s per m/s), and a `Stability` code."""

    speed: Float[Array, "..."]
    frequency: Float[Array, "..."]
    growth_per_speed: Float[Array, "..."]
    code: Int[Array, "..."]


def linear_critical_speed(
    vehicle: Vehicle, *, damper: Damper = PASSIVE, lowest: float = LOWEST, highest: float = HIGHEST
) -> Float[Array, "..."]:
    """Speed (m/s) at which straight running first becomes unstable: an eigenvalue of E (eq. 4) crosses the imaginary axis.

    Differentiable once with respect to every float of the vehicle, in both modes (a second derivative raises an error). With
    lanes in the vehicle the result has one value per lane: inf where stable up to `highest`, NaN where unstable at `lowest`
    already or not computable. For a single vehicle these raise `NumericalError`. Needs double precision.
    """
    found = linear_critical(vehicle, damper=damper, lowest=lowest, highest=highest)
    if not isinstance(found.code, jax.core.Tracer) and found.code.ndim == 0:
        if int(found.code) == Stability.STABLE:
            raise NumericalError(f"no linear critical speed: straight running is stable up to {highest * KMH:.0f} km/h")
        if int(found.code) == Stability.UNSTABLE:
            raise NumericalError(f"no linear critical speed: straight running is unstable at {lowest * KMH:.1f} km/h already")
        if int(found.code) == Stability.FAILED:
            raise NumericalError(
                "no linear critical speed: the eigenvalues of the state matrix are not finite or cannot be resolved; "
                "look for a mass or stiffness that is far from any vehicle's"
            )
    return found.speed


def linear_critical(
    vehicle: Vehicle, *, damper: Damper = PASSIVE, lowest: float = LOWEST, highest: float = HIGHEST
) -> LinearCritical:
    """As `linear_critical_speed`, with frequency and result code instead of errors."""
    require_double_precision("the linear critical speed")
    trees = (without_labels(vehicle), damper, lowest, highest)
    axes = (own_axes(vehicle), own_axes(damper), 0, 0)
    lanes = count_lanes(trees, axes)
    return _critical(trees, lanes)


@functools.partial(jax.jit, static_argnames="lanes")
def _critical(trees: tuple, lanes: int | None) -> LinearCritical:
    if lanes is None:
        return _single(*trees)
    axes = (own_axes(trees[0]), own_axes(trees[1]), 0, 0)
    # one lane at a time: LAPACK takes no longer, and several batched calls at work at once deadlock (JAX 0.10.1, two cores)
    return over_lanes(lambda chunk: each_lane(_single, chunk, axes), trees, axes, lanes, chunk=1)


def eigenvalues(vehicle: Vehicle, speed: Scalar, damper: Damper) -> Complex[Array, "states"]:
    """Eigenvalues of E at a speed; their derivatives are JAX's, by left and right eigenvectors."""
    return jnp.linalg.eigvals(state_matrix(vehicle, speed, damper))


def _growth(vehicle: Vehicle, damper: Damper, speed: Scalar) -> Float[Array, ""]:
    """Largest real part: positive means unstable, whichever mode it is."""
    return jnp.max(eigenvalues(vehicle, speed, damper).real)


def _single(vehicle: Vehicle, damper: Damper, lowest: Scalar, highest: Scalar) -> LinearCritical:
    fixed_vehicle, fixed_damper = jax.lax.stop_gradient((vehicle, damper))
    growth = functools.partial(_growth, fixed_vehicle, fixed_damper)
    speeds = jnp.linspace(lowest, highest, POINTS)
    growths = jax.lax.map(growth, speeds)
    unstable = growths > 0
    first = jnp.argmax(unstable)
    code = jnp.where(~jnp.any(unstable), int(Stability.STABLE), jnp.where(first == 0, int(Stability.UNSTABLE), 0))
    code = jnp.where(jnp.all(jnp.isfinite(growths)), code, int(Stability.FAILED))
    bracket = speeds[jnp.maximum(first - 1, 0)], speeds[jnp.maximum(first, 1)]

    # Bisection on the largest real part stays with the first crossing even where modes cross each other below it
    def halve(bracket, _):
        low, high = bracket
        middle = 0.5 * (low + high)
        above = growth(middle) > 0
        return (jnp.where(above, low, middle), jnp.where(above, middle, high)), None

    (low, high), _ = jax.lax.scan(halve, bracket, length=24)
    near = 0.5 * (low + high)
    critical_mode = jnp.argmax(eigenvalues(fixed_vehicle, near, fixed_damper).real)

    # One Newton step on the real part of that mode: it polishes the value, and its derivative is that of the implicit
    # function, dv = -Re(dlambda)/Re(dlambda/dv)
    def mode(vehicle, damper, speed):
        return eigenvalues(vehicle, speed, damper)[critical_mode]

    slope = jax.jvp(lambda v: mode(fixed_vehicle, fixed_damper, v), (near,), (jnp.ones_like(near),))[1].real
    eigenvalue = mode(vehicle, damper, near)
    speed = near - eigenvalue.real / slope
    # the step must stay within the grid's bracket, else the crossing is lost in round-off
    resolved = jnp.abs(speed - near) <= (highest - lowest) / POINTS
    code = jnp.where((code == Stability.OK) & ~resolved, int(Stability.FAILED), code)
    nothing = jnp.where(code == Stability.STABLE, jnp.inf, jnp.nan)
    found = code == Stability.OK
    return LinearCritical(
        jnp.where(found, speed, nothing),
        jnp.where(found, jnp.abs(eigenvalue.imag) / (2.0 * jnp.pi), jnp.nan),
        jnp.where(found, slope, jnp.nan),
        code,
    )
