"""The nonlinear critical speed: the lowest at which a limit cycle exists, the fold of its branch; and its gradient."""

import functools
from enum import IntEnum
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .dampers import Damper
from .errors import InputError, NumericalError
from .fold_search import Fold, search_fold
from .integrate import STABLE_RADIUS, fastest_rate
from .lanes import count_lanes, one_by_one, own_axes
from .linear import LinearCritical, Stability, linear_critical
from .motion import PASSIVE, wheelset_shape
from .orbits import Shooting, rounded
from .precision import require_double_precision
from .vehicle import Vehicle, bare

#: fewest steps of RK4 in half a period; the fold of the coach moves by less than 1e-4 km/h when they are doubled
FEWEST_STEPS = 200


class Hunting(IntEnum):
    """What the search for the nonlinear critical speed found."""

    OK = 0
    SUPERCRITICAL = 1  # no fold below the linear critical speed, which is then the nonlinear one as well
    STABLE = 2  # straight running is stable up to the highest speed: infinity
    UNSTABLE = 3  # unstable at the lowest speed already: NaN
    FAILED = 4  # no limit cycle was found, or its branch could not be followed to a fold: NaN
    STEP_TOO_LARGE = 5  # RK4 does not hold the step that the period is cut into: give more `steps`; NaN


class NonlinearCritical(NamedTuple):
    """Nonlinear critical speed (m/s); amplitude (m) and frequency (Hz) of the limit cycle at the fold; the linear critical
    speed beside it; a `Hunting` code."""

    speed: Float[Array, "..."]
    amplitude: Float[Array, "..."]
    frequency: Float[Array, "..."]
    linear: LinearCritical
    code: Int[Array, "..."]


def nonlinear_critical_speed(
    vehicle: Vehicle, *, damper: Damper = PASSIVE, wheelset: int | None = None, steps: int | None = None
) -> Float[Array, "..."]:
    """Lowest speed (m/s) at which a limit cycle exists: the fold (saddle-node) of the branch of hunting motions.

    Above it a disturbance that is large enough makes the vehicle hunt; below it none does. Where there is no fold (the branch
    leaves the Hopf point towards higher speeds, supercritical) it is the linear critical speed itself.

    Differentiable with respect to every float of the vehicle, in both modes, by implicit differentiation of the periodic
    orbit at the fold (no simulation is differentiated). With lanes in the vehicle the result has one value per lane: infinity
    where straight running is stable, NaN where no fold could be computed; `nonlinear_critical` tells which. For a single
    vehicle these raise `NumericalError`. Needs double precision. `wheelset` and `steps` as in `nonlinear_critical`.
    """
    found = nonlinear_critical(vehicle, damper=damper, wheelset=wheelset, steps=steps)
    if not isinstance(found.code, jax.core.Tracer) and found.code.ndim == 0:
        refuse(found.code)
    return found.speed


def refuse(code: Int[Array, ""]) -> None:
    """Raise `NumericalError` where there is no nonlinear critical speed."""
    reason = {
        Hunting.STABLE: "straight running is stable at all speeds tried, so no branch of limit cycles leaves it",
        Hunting.UNSTABLE: "straight running is unstable at all speeds tried",
        Hunting.FAILED: "the branch of limit cycles could not be followed to a fold; draw it with hunting_branch",
        Hunting.STEP_TOO_LARGE: "RK4 does not hold that few steps in half a period; give more steps",
    }.get(Hunting(int(code)))
    if reason:
        raise NumericalError(f"no nonlinear critical speed: {reason}")


def nonlinear_critical(
    vehicle: Vehicle, *, damper: Damper = PASSIVE, wheelset: int | None = None, steps: int | None = None
) -> NonlinearCritical:
    """As `nonlinear_critical_speed`, with amplitude, frequency and result code instead of errors.

    The amplitude is that of one `wheelset`, counted from the front; by default the leading one of the trailing bogie, as in
    the paper's fig. 6. `steps` of RK4 cut half a period; by default enough for the fastest motion of the vehicle, at least 200.

    The vehicle is simulated from large disturbances (both bogies hunting in phase, opposite, or one of them) at shares of 0.6 to
    1.02 of the linear critical speed, all at once. The limit cycle at the lowest speed is followed down to its fold; then the same
    is done at shares of 0.8 to 0.9995 of the fold's speed, until no motion goes on below a fold. So what is found is the end of the
    motions that a vehicle settles on, as a slow ramp down would show.
    """
    require_double_precision("the nonlinear critical speed")
    trees = bare(rounded(vehicle), damper)
    axes = own_axes(trees[0]), own_axes(trees[1])
    lanes = count_lanes(trees, axes)
    linear = linear_critical(vehicle, damper=damper)
    if steps is None:
        steps = _enough_steps(trees, axes, lanes, linear)
    shooting = Shooting(steps, default_wheelset(vehicle, wheelset))
    fold = search_fold(trees, linear, shooting, lanes)
    # where no fold was found it is at the Hopf point that the step is judged
    speed = jnp.where(fold.found, fold.speed, linear.speed)
    frequency = jnp.where(fold.found, fold.frequency, linear.frequency)
    rates = _fastest(trees, jax.lax.stop_gradient(speed), lanes)
    return _judged(linear, fold, 0.5 / frequency / shooting.steps * rates <= STABLE_RADIUS)


def default_wheelset(vehicle: Vehicle, wheelset: int | None) -> int:
    """The leading wheelset of the trailing bogie, or the one given, checked."""
    bogies, axles = wheelset_shape(vehicle)
    if wheelset is None:
        return (bogies - 1) * axles
    if not 0 <= wheelset < bogies * axles:
        raise InputError(f"wheelset must lie between 0 and {bogies * axles - 1}, counted from the front, not {wheelset}")
    return wheelset


def default_steps(vehicle: Vehicle, damper: Damper, linear: LinearCritical) -> int:
    """Steps in half a period of hunting for the fastest motion of the vehicle; among lanes the most that one needs.

    Where the vehicle is being traced nothing is known of it: the fewest.
    """
    trees = bare(vehicle, damper)
    axes = own_axes(trees[0]), own_axes(damper)
    return _enough_steps(trees, axes, count_lanes(trees, axes), linear)


def _enough_steps(trees: tuple, axes: tuple, lanes: int | None, linear: LinearCritical) -> int:
    # half the speed, for the branch may lead far down
    rates = _fastest(trees, 0.5 * linear.speed, lanes)
    if isinstance(rates, jax.core.Tracer) or isinstance(linear.frequency, jax.core.Tracer):
        return FEWEST_STEPS
    radii = np.atleast_1d(np.asarray(rates) * 0.5 / np.asarray(linear.frequency))
    needed = np.max(radii[np.isfinite(radii)], initial=0.0) / STABLE_RADIUS
    return max(FEWEST_STEPS, 100 * int(np.ceil(needed / 100.0)))


@functools.partial(jax.jit, static_argnums=2)
def _fastest(trees: tuple, speed: Float[Array, "..."], lanes: int | None) -> Float[Array, "..."]:
    def single(given: tuple) -> Float[Array, ""]:
        (vehicle, damper), speed = given
        return fastest_rate(vehicle, speed, damper)

    axes = (own_axes(trees[0]), own_axes(trees[1])), 0
    return single((trees, speed)) if lanes is None else one_by_one(single, (trees, speed), axes)


@jax.jit
def _judged(linear: LinearCritical, fold: Fold, holds: Bool[Array, "..."]) -> NonlinearCritical:
    """Result codes, and values only where there are any."""
    code = jnp.where(fold.vanished, int(Hunting.SUPERCRITICAL), int(Hunting.FAILED))
    below = fold.speed < linear.speed
    code = jnp.where(fold.found, jnp.where(below, int(Hunting.OK), int(Hunting.SUPERCRITICAL)), code)
    code = jnp.where(holds, code, int(Hunting.STEP_TOO_LARGE))
    for stability, result in (
        (Stability.STABLE, Hunting.STABLE),
        (Stability.UNSTABLE, Hunting.UNSTABLE),
        (Stability.FAILED, Hunting.FAILED),
    ):
        code = jnp.where(linear.code == stability, int(result), code)
    folded, at_hopf = code == Hunting.OK, code == Hunting.SUPERCRITICAL
    nothing = jnp.where(code == Hunting.STABLE, jnp.inf, jnp.nan)
    return NonlinearCritical(
        jnp.where(folded, fold.speed, jnp.where(at_hopf, linear.speed, nothing)),
        jnp.where(folded, fold.amplitude, jnp.where(at_hopf, 0.0, jnp.nan)),
        jnp.where(folded, fold.frequency, jnp.where(at_hopf, linear.frequency, jnp.nan)),
        linear,
        code,
    )
