"""The nonlinear critical speed: the lowest at which a limit cycle exists, the fold of its branch; and its gradient."""

import functools
from enum import IntEnum
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .continuation import (
    MOST_TRIES,
    Bracket,
    Walk,
    attracting,
    begun,
    bracket,
    hunting_modes,
    narrowed,
    next_orbit,
    orbit_between,
    resolved,
    stuck,
    walked,
)
from .dampers import Damper
from .errors import InputError, NumericalError
from .integrate import STABLE_RADIUS, fastest_rate
from .lanes import count_lanes, one_by_one, own_axes
from .linear import LinearCritical, Stability, linear_critical
from .motion import PASSIVE, wheelset_shape
from .orbits import PERIOD, Model, Point, Problem, Shooting, implicit_speed, rounded, solved
from .precision import require_double_precision
from .typing import Scalar
from .vehicle import Vehicle, without_labels

#: the branch is entered this much above the linear critical speed, where the vehicle is drawn to a limit cycle...
ENTRY = 1.02
#: ...from the critical mode's shape with this share of the flange clearance as amplitude
ENTRY_AMPLITUDE = 1.0
#: longest step down the branch (1 mm or 10 m/s), and how many are tried
LARGEST_STEP, MOST_STEPS = 0.1, 400
#: amplitude (share of the clearance) below which a falling branch is taken to have ended in the Hopf point
SMALL = 0.1
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

    The branch is entered from above: 2 % above the linear critical speed the vehicle is drawn to a limit cycle, which is
    followed down to its fold. So what is found is the motion that a vehicle settles on, also where bogies that barely feel
    each other make many branches.
    """
    require_double_precision("the nonlinear critical speed")
    trees = without_labels(rounded(vehicle)), damper
    axes = own_axes(trees[0]), own_axes(damper)
    lanes = count_lanes(trees, axes)
    linear = linear_critical(vehicle, damper=damper)
    if steps is None:
        steps = _enough_steps(trees, axes, lanes, linear)
    shooting = Shooting(steps, default_wheelset(vehicle, wheelset))
    fold = search_fold(trees, linear, shooting, lanes)
    rates = _fastest(trees, fold.speed, lanes)
    return _judged(linear, fold, 0.5 / fold.frequency / shooting.steps * rates <= STABLE_RADIUS)


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
    trees = without_labels(vehicle), damper
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


class Fold(NamedTuple):
    """The fold of a branch: speed (m/s), amplitude (m), frequency (Hz); found, or the branch fell into the Hopf point; the
    orbit itself."""

    speed: Float[Array, "..."]
    amplitude: Float[Array, "..."]
    frequency: Float[Array, "..."]
    found: Bool[Array, "..."]
    vanished: Bool[Array, "..."]
    point: Point


@functools.partial(jax.jit, static_argnums=(2, 3))
def search_fold(trees: tuple, linear: LinearCritical, shooting: Shooting, lanes: int | None) -> Fold:
    """The fold of (vehicle, damper), the vehicle `rounded` and without labels; nothing is judged yet."""

    def single(given: tuple) -> Fold:
        trees, linear = given
        model = Model(*trees)
        fixed = jax.tree.map(lambda leaf: jax.lax.stop_gradient(jnp.asarray(leaf, float)), model)
        # where there is no Hopf point the search runs on a speed that does no harm, and its result is dropped
        hopf = jax.lax.stop_gradient(jnp.where(linear.code == Stability.OK, linear.speed, 50.0))
        point, found, vanished = _fold_from_above(fixed, shooting, hopf)
        frequency = 1.0 / (point.unknowns[-2] * PERIOD)
        return Fold(implicit_speed(model, shooting, point), point.amplitude, frequency, found, vanished, point)

    axes = (own_axes(trees[0]), own_axes(trees[1])), jax.tree.map(lambda _: 0, linear)
    return single((trees, linear)) if lanes is None else one_by_one(single, (trees, linear), axes)


@jax.jit
def _judged(linear: LinearCritical, fold: Fold, holds: Bool[Array, "..."]) -> NonlinearCritical:
    """Result codes, and values only where there are any."""
    code = jnp.where(fold.vanished, int(Hunting.SUPERCRITICAL), int(Hunting.FAILED))
    code = jnp.where(fold.found, jnp.where(holds, int(Hunting.OK), int(Hunting.STEP_TOO_LARGE)), code)
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


class Search(NamedTuple):
    """The state of the search: the orbit asked for next, and what is known of the branch."""

    problem: Problem
    walk: Walk
    ends: Bracket
    stage: Int[Array, ""]  # ENTERING, WALKING, FOLDING or one of the results beyond


ENTERING, WALKING, FOLDING, FOUND, VANISHED, LOST = range(6)


def _fold_from_above(model: Model, shooting: Shooting, hopf: Scalar) -> tuple[Point, Bool[Array, ""], Bool[Array, ""]]:
    """Down the branch of the attracting limit cycle: its fold, whether it was found, and whether the branch fell into the
    Hopf point instead.

    One loop with a single call of `solved`, whatever the stage, because that is what takes long to compile.
    """
    shapes, omegas = hunting_modes(model, shooting, hopf, 1)
    clearance = entry_amplitude(model.vehicle)

    def entered(search: Search, point: Point) -> Search:
        downwards = -jnp.sign(point.direction[-1])
        walk = begun(point._replace(direction=point.direction * downwards))
        stage = jnp.where(point.usable, WALKING, LOST)
        return Search(next_orbit(model, shooting, walk), walk, search.ends, stage)

    def stepped(search: Search, point: Point) -> Search:
        walk = walked(search.walk, point, LARGEST_STEP)
        turned = (walk.before.direction[-1] < 0.0) & (walk.point.direction[-1] >= 0.0)
        ends = bracket(walk.before, walk.point)
        stage = jnp.where(stuck(walk) | (walk.tried >= MOST_STEPS), LOST, WALKING)
        stage = jnp.where(walk.point.amplitude < SMALL * clearance, VANISHED, stage)
        stage = jnp.where(turned, FOLDING, stage)
        ahead = next_orbit(model, shooting, walk)
        problem = jax.tree.map(lambda fold, step: jnp.where(turned, fold, step), orbit_between(ends), ahead)
        return Search(problem, walk, ends, stage)

    def tried(search: Search, point: Point) -> Search:
        ends = narrowed(search.ends, point)
        stage = jnp.where(ends.tried < MOST_TRIES, FOLDING, LOST)
        stage = jnp.where(resolved(ends), FOUND, stage)
        return Search(orbit_between(ends), search.walk, ends, stage)

    def going(search: Search) -> Array:
        return search.stage <= FOLDING

    def onward(search: Search) -> Search:
        point = solved(model, shooting, search.problem)
        return jax.lax.switch(search.stage, (entered, stepped, tried), search, point)

    entry = attracting(model, shooting, shapes[0], omegas[0], ENTRY * hopf, clearance)
    states = shapes.shape[1]
    nowhere = Point(
        entry.guess, entry.row, jnp.zeros(()), jnp.zeros((states, states)), jnp.zeros(states), jnp.zeros(()), jnp.asarray(False)
    )
    start = Search(entry, begun(nowhere), bracket(nowhere, nowhere), jnp.asarray(ENTERING))
    end = jax.lax.while_loop(going, onward, start)
    return end.ends.best, end.stage == FOUND, end.stage == VANISHED


def entry_amplitude(vehicle: Vehicle) -> Scalar:
    """Amplitude (m) with which the motion towards the limit cycle begins."""
    return ENTRY_AMPLITUDE * vehicle.contact.flange_clearance
