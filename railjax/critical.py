"""The nonlinear critical speed: the lowest at which a limit cycle exists, the fold of its branch; and its gradient."""

import functools
from enum import IntEnum
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .continuation import (
    MOST_TRIES,
    SETTLING,
    Bracket,
    Walk,
    begun,
    bracket,
    hunting_mode,
    largest_displacement,
    narrowed,
    next_orbit,
    orbit_between,
    resolved,
    settled,
    stuck,
    walked,
)
from .dampers import Damper
from .deflections import labels
from .errors import InputError, NumericalError
from .integrate import STABLE_RADIUS, fastest_rate
from .lanes import count_lanes, one_by_one, own_axes
from .linear import LinearCritical, Stability, linear_critical
from .motion import PASSIVE, state_size, wheelset_shape
from .orbits import (
    BY_SPEED,
    PERIOD,
    SPEED,
    Model,
    Orbit,
    Point,
    Problem,
    Shooting,
    amplitude_index,
    implicit_speed,
    pack,
    rounded,
    row_of,
    solved,
    unpack,
)
from .precision import require_double_precision
from .typing import Scalar
from .vehicle import Vehicle, without_labels

#: the branch is entered this much above the linear critical speed, where the vehicle is drawn to a limit cycle from the critical
#: mode's shape with the flange clearance as amplitude
ENTRY = 1.02
#: longest step down the branch (1 mm or 10 m/s), and how many are tried
LARGEST_STEP, MOST_STEPS = 0.1, 400
#: share of a fold's speed at which it is tried whether one bogie hunts on by itself
BELOW = 0.998
#: and, where there is no fold to start from, the shares of the linear critical speed
APART = (0.99, 0.95, 0.9, 0.85)
#: displacement (share of the clearance) below which a falling branch is taken to have ended in the Hopf point
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
    followed down to its fold; where one bogie then hunts on by itself, that one is followed as well. Where there is no such cycle or
    no fold (bogies that barely feel each other, as with soft secondary dampers, may hunt at two frequencies; a small cycle may end
    in the Hopf point beside a large one) each bogie is tried by itself at 0.99, 0.95, 0.9 and 0.85 of the linear critical speed. So
    what is found is the end of the motions that a vehicle settles on, as a slow ramp down would show.
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
        point, found, vanished = _lowest_fold(fixed, shooting, hopf)
        frequency = 1.0 / (point.unknowns[-2] * PERIOD)
        return Fold(implicit_speed(model, shooting, point), point.amplitude, frequency, found, vanished, point)

    axes = (own_axes(trees[0]), own_axes(trees[1])), jax.tree.map(lambda _: 0, linear)
    return single((trees, linear)) if lanes is None else one_by_one(single, (trees, linear), axes)


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


class Search(NamedTuple):
    """The state of the search: the orbit asked for next, and what is known of the branch."""

    problem: Problem
    walk: Walk
    ends: Bracket
    stage: Int[Array, ""]  # ENTERING, WALKING, FOLDING or one of the results beyond
    lowest: Point  # the lowest fold found so far
    found: Bool[Array, ""]
    alone: Int[Array, ""]  # the bogie that is tried by itself below the lowest fold; -1 before there is one
    periods: Int[Array, ""]  # to simulate before the problem is solved
    vanished: Bool[Array, ""]


ENTERING, WALKING, FOLDING, DONE = range(4)


def _lowest_fold(model: Model, shooting: Shooting, hopf: Scalar) -> tuple[Point, Bool[Array, ""], Bool[Array, ""]]:
    """The lowest fold, whether one was found, and whether the branch fell into the Hopf point instead.

    Down the branch of the attracting limit cycle to its fold. A little below it all bogies but one are put at rest: where the
    one hunts on by itself, that branch is followed down as well, and so on.

    One loop with a single call of `solved`, whatever the stage, because that is what takes long to compile.
    """
    shape, omega = hunting_mode(model, shooting, hopf)
    clearance = model.vehicle.contact.flange_clearance
    bogies = wheelset_shape(model.vehicle)[0]
    tries = bogies if bogies > 1 else 0
    masks = jnp.asarray(np.array([_bogie_alone(model, k) for k in range(bogies)]))
    apart = jnp.asarray(APART)
    first_wheelset = amplitude_index(model.vehicle, 0)
    displacements = slice(first_wheelset, first_wheelset + int(np.prod(wheelset_shape(model.vehicle))))

    def below(search: Search, alone: Int[Array, ""]) -> Search:
        """One bogie by itself a little below the lowest fold, or the Hopf point; ends the search after the last."""
        orbit = unpack(model, shooting, search.lowest.unknowns)
        state = orbit.state * masks[alone % bogies]
        # the mode, or the hunting of the other bogie, may hardly move this one
        moved = jnp.max(jnp.abs(state[displacements]))
        state = jnp.where(moved < 0.5 * clearance, clearance / moved, 1.0) * state
        speed = jnp.where(search.found, BELOW, apart[jnp.clip(alone // bogies, 0, len(APART) - 1)] / ENTRY) * orbit.speed
        problem = Problem(pack(model, shooting, orbit._replace(state=state, speed=speed)), by_speed, speed / SPEED)
        stage = jnp.where(alone < jnp.where(search.found, tries, tries * len(APART)), ENTERING, DONE)
        return search._replace(problem=problem, alone=alone, stage=stage, periods=jnp.asarray(SETTLING))

    def entered(search: Search, point: Point) -> Search:
        hunting = point.usable & (largest_displacement(model, point) > SMALL * clearance)
        walk = begun(point._replace(direction=-point.direction * jnp.sign(point.direction[-1])))
        walking = search._replace(problem=next_orbit(model, shooting, walk), walk=walk, stage=jnp.asarray(WALKING))
        walking = walking._replace(periods=jnp.asarray(0))
        return _where(hunting, walking, below(search, search.alone + 1))

    def stepped(search: Search, point: Point) -> Search:
        walk = walked(search.walk, point, LARGEST_STEP)
        turned = (walk.before.direction[-1] < 0.0) & (walk.point.direction[-1] >= 0.0)
        ends = bracket(walk.before, walk.point)
        vanished = ~turned & (largest_displacement(model, walk.point) < SMALL * clearance)
        lost = ~turned & (vanished | stuck(walk) | (walk.tried >= MOST_STEPS))
        problem = _where(turned, orbit_between(ends), next_orbit(model, shooting, walk))
        stage = jnp.where(turned, FOLDING, WALKING)
        going = search._replace(problem=problem, walk=walk, ends=ends, stage=stage)
        search = search._replace(vanished=search.vanished | vanished)
        return _where(lost, below(search, search.alone + 1), going)

    def tried(search: Search, point: Point) -> Search:
        ends = narrowed(search.ends, point)
        going = search._replace(problem=orbit_between(ends), ends=ends)
        found, gone = resolved(ends), ends.tried >= MOST_TRIES
        # a fold starts the trials below it anew
        folded = below(search._replace(lowest=ends.best, found=jnp.asarray(True)), jnp.asarray(0))
        return _where(found, folded, _where(gone, below(search, search.alone + 1), going))

    def onward(search: Search) -> Search:
        orbit = unpack(model, shooting, search.problem.guess)
        drawn = settled(model, shooting, orbit.state, orbit.period, orbit.speed, search.periods)
        problem = _where(search.periods > 0, drawn, search.problem)
        point = solved(model, shooting, problem)
        return jax.lax.switch(search.stage, (entered, stepped, tried), search, point)

    by_speed = row_of(model, shooting, BY_SPEED)
    start = pack(model, shooting, Orbit(shape * clearance, 2.0 * jnp.pi / omega, ENTRY * hopf))
    states = shape.shape[0]
    nothing, zero, no = jnp.zeros(states), jnp.zeros(()), jnp.asarray(False)
    nowhere = Point(start, by_speed, zero, jnp.zeros((states, states)), nothing, zero, no)
    first = Problem(start, by_speed, ENTRY * hopf / SPEED)
    entering, periods = jnp.asarray(ENTERING), jnp.asarray(SETTLING)
    search = Search(first, begun(nowhere), bracket(nowhere, nowhere), entering, nowhere, no, jnp.asarray(-1), periods, no)
    end = jax.lax.while_loop(lambda search: search.stage != DONE, onward, search)
    return end.lowest, end.found, end.vanished


def _where(condition: Bool[Array, ""], yes: Any, no: Any) -> Any:
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), yes, no)


def _bogie_alone(model: Model, bogie: int) -> Float[np.ndarray, "states"]:
    """1 for the states of the car body and of one bogie with its wheelsets, 0 for the other bogies'."""
    names = labels(model.vehicle)
    axles = wheelset_shape(model.vehicle)[1]

    def own(name: str) -> bool:
        part, _, index = name.partition("[")
        if part.startswith("carbody"):
            return True
        return int(index[:-1]) // (axles if part.startswith("wheelset") else 1) == bogie

    mask = np.array([float(own(name)) for name in names])
    return np.concatenate([mask, mask, np.ones(state_size(model.vehicle, model.damper) - 2 * len(mask))])
