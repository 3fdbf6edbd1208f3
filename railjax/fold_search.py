"""The search for the lowest fold of a vehicle's limit cycles, as one compiled loop.

From all motions to which the vehicle is drawn at some speeds about the linear critical speed, the one at the lowest speed is followed
down to its fold. Then the motions a little below that fold are tried, and so on until none goes on.
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from .attractors import drawn, patterns
from .continuation import (
    MOST_TRIES,
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
    stuck,
    walked,
)
from .lanes import one_by_one, own_axes
from .linear import LinearCritical, Stability
from .orbits import (
    BY_SPEED,
    PERIOD,
    SPEED,
    Model,
    Point,
    Problem,
    Shooting,
    displacements,
    history,
    implicit_speed,
    row_of,
    solved,
    unpack,
)
from .typing import Scalar

#: shares of the linear critical speed at which motions are tried first, and of a fold's speed at which they are tried below it:
#: as many of the ones as of the others, for one loop
ABOUT_HOPF = (0.6, 0.75, 0.85, 0.9, 0.95, 0.99, 1.02)
BELOW_FOLD = (0.8, 0.87, 0.93, 0.97, 0.99, 0.998, 0.9995)
#: displacement, in clearances, with which motions begin, and below which they are taken to have died out
LARGE, SMALL = 1.1, 0.1
#: longest step down the branch (1 mm or 10 m/s), and how many are tried
LARGEST_STEP, MOST_STEPS = 0.1, 400
#: folds one below the other
MOST_FOLDS = 8


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


class Search(NamedTuple):
    """The state of the search: the orbit asked for next, and what is known of the branch."""

    problem: Problem
    walk: Walk
    ends: Bracket
    stage: Int[Array, ""]
    guesses: Float[Array, "starts unknowns"]  # the motions to be tried, those of low speed first
    hunting: Bool[Array, "starts"]  # which of them are left
    lowest: Point  # the lowest fold found so far
    folds: Int[Array, ""]  # how many were found
    vanished: Bool[Array, ""]


SURVEYING, ENTERING, WALKING, FOLDING, DONE = range(5)


def _lowest_fold(model: Model, shooting: Shooting, hopf: Scalar) -> tuple[Point, Bool[Array, ""], Bool[Array, ""]]:
    """The lowest fold, whether one was found, and whether a branch fell into the Hopf point instead.

    One loop with a single call of `solved`, whatever the stage, because that is what takes long to compile.
    """
    shape, omega = hunting_mode(model, shooting, hopf)
    clearance = model.vehicle.contact.flange_clearance
    by_speed = row_of(model, shooting, BY_SPEED)

    def surveyed(search: Search) -> Search:
        """The motions about the Hopf point, made of its mode, or below the lowest fold, made of its orbit."""
        found = search.folds > 0
        orbit = unpack(model, shooting, search.lowest.unknowns)
        states = history(model, shooting, orbit)
        moved = jnp.max(jnp.abs(states[:, displacements(model)]), axis=1)
        state = jnp.where(found, states[jnp.argmax(moved)], shape * clearance)
        starts = patterns(model, state, LARGE * jnp.maximum(clearance, jnp.where(found, jnp.max(moved), 0.0)))
        speeds = jnp.where(found, jnp.asarray(BELOW_FOLD) * orbit.speed, jnp.asarray(ABOUT_HOPF) * hopf)
        period = jnp.where(found, orbit.period, 2.0 * jnp.pi / omega)
        many, each = starts.shape[0], speeds.shape[0]
        end = drawn(model, shooting, jnp.tile(starts, (each, 1)), period, jnp.repeat(speeds, many), SMALL * clearance)
        hunting = end.swings & (end.displacements > SMALL * clearance)
        return tried_next(search._replace(guesses=end.guesses, hunting=hunting))

    def tried_next(search: Search) -> Search:
        """Enters the first of the motions that are left, or ends the search."""
        first = jnp.argmax(search.hunting)
        guess = search.guesses[first]
        stage = jnp.where(search.hunting[first], ENTERING, DONE)
        problem = Problem(guess, by_speed, guess[-1])
        return search._replace(problem=problem, hunting=search.hunting.at[first].set(False), stage=stage)

    def entered(search: Search, point: Point) -> Search:
        hunting = point.usable & (largest_displacement(model, point) > SMALL * clearance)
        walk = begun(point._replace(direction=-point.direction * jnp.sign(point.direction[-1])))
        walking = search._replace(problem=next_orbit(model, shooting, walk), walk=walk, stage=jnp.asarray(WALKING))
        return _where(hunting, walking, tried_next(search))

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
        return _where(lost, tried_next(search), going)

    def tried(search: Search, point: Point) -> Search:
        ends = narrowed(search.ends, point)
        going = search._replace(problem=orbit_between(ends), ends=ends)
        stage = jnp.where(search.folds + 1 < MOST_FOLDS, SURVEYING, DONE)
        folded = search._replace(lowest=ends.best, folds=search.folds + 1, stage=stage)
        gone = ends.tried >= MOST_TRIES
        return _where(resolved(ends), folded, _where(gone, tried_next(search), going))

    def onward(search: Search) -> Search:
        def orbit(search: Search) -> Search:
            point = solved(model, shooting, search.problem)
            return jax.lax.switch(search.stage - ENTERING, (entered, stepped, tried), search, point)

        return jax.lax.cond(search.stage == SURVEYING, surveyed, orbit, search)

    states = shape.shape[0]
    nothing, zero, no = jnp.zeros(states), jnp.zeros(()), jnp.asarray(False)
    start = jnp.append(jnp.zeros(states - 1), jnp.stack([2.0 * jnp.pi / omega / PERIOD, hopf / SPEED]))
    nowhere = Point(start, by_speed, zero, jnp.zeros((states, states)), nothing, zero, no)
    count = len(ABOUT_HOPF) * patterns(model, shape, clearance).shape[0]
    search = Search(
        problem=Problem(start, by_speed, start[-1]),
        walk=begun(nowhere),
        ends=bracket(nowhere, nowhere),
        stage=jnp.asarray(SURVEYING),
        guesses=jnp.zeros((count, states + 1)),
        hunting=jnp.zeros(count, bool),
        lowest=nowhere,
        folds=jnp.asarray(0),
        vanished=no,
    )
    end = jax.lax.while_loop(lambda search: search.stage != DONE, onward, search)
    return end.lowest, end.folds > 0, end.vanished


def _where(condition: Bool[Array, ""], yes: Any, no: Any) -> Any:
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), yes, no)
