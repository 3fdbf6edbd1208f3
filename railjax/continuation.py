"""Following a branch of limit cycles: where it can be entered, single steps along its tangent, and its folds.

A branch is entered at the Hopf point, with the shape of the mode that loses its stability there, or on a limit cycle to which the
vehicle is drawn (`attractors`). Everything here poses the next `Problem` and judges its solution, and `orbits.solved` is
called by who needs it: the bifurcation diagram (`hunting`), whose loop is Python's, and the search for the nonlinear critical
speed (`fold_search`), whose loop is compiled.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from .kernels import eig
from .motion import state_matrix
from .orbits import (
    BY_AMPLITUDE,
    DISPLACEMENT,
    Model,
    Orbit,
    Point,
    Problem,
    Shooting,
    amplitude_index,
    displacements,
    pack,
    plane,
    row_of,
)
from .typing import Scalar

#: steps along the branch, measured in the plane of the diagram (amplitude in mm, speed in 10 m/s)
FIRST_STEP, SMALLEST_STEP = 0.1, 2e-4
#: a step over which the branch turns by more than this (cosine) is taken again with half the length...
STRAIGHT = 0.9
#: ...unless it is this short: where a flange begins to touch the branch has a corner
CORNER = 4e-3
#: longest step that may lead over a fold: a longer one can end on a neighbouring branch
FOLD_STEP = 0.06


def hunting_mode(model: Model, shooting: Shooting, speed: Scalar) -> tuple[Float[Array, "states"], Float[Array, ""]]:
    """Shape x of the least damped oscillating mode at the Hopf point, and its angular frequency (rad/s).

    The shape is the state where the wheelset turns, for an amplitude of 1 m: the real part of the eigenvector that is 1 there.
    """
    values, vectors = eig(state_matrix(model.vehicle, speed, model.damper))
    oscillating = values.imag > 1e-6 * jnp.max(jnp.abs(values))
    chosen = jnp.argmin(jnp.where(oscillating, -values.real, jnp.inf))
    vector = vectors[:, chosen]
    return (vector / vector[amplitude_index(model.vehicle, shooting.wheelset)]).real, values.imag[chosen]


def near_hopf(
    model: Model, shooting: Shooting, shape: Float[Array, "states"], omega: Scalar, speed: Scalar, amplitude: Scalar
) -> Problem:
    """The orbit of a given amplitude (m) that grows out of a mode; its direction is that of rising amplitude."""
    guess = pack(model, shooting, Orbit(shape * amplitude, 2.0 * jnp.pi / omega, jnp.asarray(speed)))
    return Problem(guess, row_of(model, shooting, BY_AMPLITUDE), jnp.asarray(amplitude) / DISPLACEMENT)


def largest_displacement(model: Model, point: Point) -> Float[Array, ""]:
    """Largest lateral displacement of any wheelset at the instant of the point, m."""
    return jnp.max(jnp.abs(point.unknowns[displacements(model)])) * DISPLACEMENT


class Walk(NamedTuple):
    """How far a branch has been followed: its last two points, the next step and the count of the steps tried."""

    before: Point
    point: Point
    step: Float[Array, ""]
    tried: Int[Array, ""]


def begun(point: Point) -> Walk:
    """A walk at its first point, onwards in the point's direction."""
    return Walk(point, point, jnp.asarray(FIRST_STEP), jnp.asarray(0))


def next_orbit(model: Model, shooting: Shooting, walk: Walk) -> Problem:
    """Pseudo-arclength continuation: along the tangent, the step measured in the plane of the diagram."""
    shadow = jnp.linalg.norm(plane(model, shooting, walk.point.direction))
    # where the branch stands steep on that plane the step is bounded in the space of all unknowns
    guess = walk.point.unknowns + walk.step / jnp.maximum(shadow, 0.05) * walk.point.direction
    return Problem(guess, walk.point.direction, walk.point.direction @ guess)


def walked(walk: Walk, ahead: Point, largest: Scalar) -> Walk:
    """A walk one step on, or (where the step cannot be kept) at the same point with a step half as long."""
    straight = ahead.direction @ walk.point.direction > STRAIGHT
    folded = ahead.direction[-1] * walk.point.direction[-1] < 0.0
    kept = ahead.usable & (straight | (walk.step <= CORNER)) & (~folded | (walk.step <= FOLD_STEP))
    point, before = (
        jax.tree.map(lambda new, old: jnp.where(kept, new, old), *pair)
        for pair in ((ahead, walk.point), (walk.point, walk.before))
    )
    step = jnp.where(kept, jnp.minimum(1.5 * walk.step, largest), 0.5 * walk.step)
    return Walk(before, point, step, walk.tried + 1)


def stuck(walk: Walk) -> Bool[Array, ""]:
    """True where no step is short enough for Newton to converge."""
    return walk.step < SMALLEST_STEP


class Bracket(NamedTuple):
    """A fold between two points of a branch: the ends as shares of the chord between the first two, with their slopes."""

    low: Point  # the first ends, between which shares are counted
    row: Float[Array, "unknowns"]
    left: Float[Array, ""]
    right: Float[Array, ""]
    down: Float[Array, ""]  # slope dv/ds at the left end, halved by false position where that end stays
    up: Float[Array, ""]
    near: Point
    far: Point
    best: Point
    tried: Int[Array, ""]


#: a fold is found when its speed is known to this (10 m/s)
FOLD_TOLERANCE = 1e-10
MOST_TRIES = 40


def bracket(low: Point, high: Point) -> Bracket:
    """Two neighbouring points of a branch, between which the speed is stationary."""
    chord = high.unknowns - low.unknowns
    row = chord / jnp.maximum(chord @ chord, 1e-30)
    zero, one = jnp.zeros(()), jnp.ones(())
    return Bracket(low, row, zero, one, _slope(row, low), _slope(row, high), low, high, low, jnp.asarray(0))


def _slope(row: Float[Array, "unknowns"], point: Point) -> Float[Array, ""]:
    """dv/ds along the chord."""
    return point.direction[-1] / (row @ point.direction)


def resolved(ends: Bracket) -> Bool[Array, ""]:
    """Whether the fold's speed is known well enough."""
    spread = (jnp.abs(_slope(ends.row, ends.near)) + jnp.abs(_slope(ends.row, ends.far))) * (ends.right - ends.left)
    return (spread < FOLD_TOLERANCE) & (ends.tried > 0)


def _share(ends: Bracket) -> Float[Array, ""]:
    """Where to try next: false position (Illinois), every third time the middle, for the slope jumps where a flange begins
    to touch. Of own code, because optimistix's bracketing method, bisection, takes three times as many orbits."""
    share = (ends.left * ends.up - ends.right * ends.down) / (ends.up - ends.down)
    share = jnp.where(ends.tried % 3 == 2, 0.5 * (ends.left + ends.right), share)
    margin = 1e-3 * (ends.right - ends.left)
    return jnp.clip(share, ends.left + margin, ends.right - margin)


def orbit_between(ends: Bracket) -> Problem:
    """The next orbit to try for the fold, predicted by the tangent at the nearer end."""
    share = _share(ends)
    closer = share - ends.left < ends.right - share
    nearest = jax.tree.map(lambda a, b: jnp.where(closer, a, b), ends.near, ends.far)
    base = ends.row @ (nearest.unknowns - ends.low.unknowns)
    guess = nearest.unknowns + (share - base) * nearest.direction / (ends.row @ nearest.direction)
    return Problem(guess, ends.row, ends.row @ ends.low.unknowns + share)


def narrowed(ends: Bracket, found: Point) -> Bracket:
    """The bracket with one end moved to the orbit tried; the end that stays counts half (Illinois). An orbit that cannot be
    used counts as a try only, and the next is made elsewhere."""
    share, slope = _share(ends), _slope(ends.row, found)
    below = slope * _slope(ends.row, ends.low) > 0.0
    moved = ends._replace(
        left=jnp.where(below, share, ends.left),
        right=jnp.where(below, ends.right, share),
        down=jnp.where(below, slope, 0.5 * ends.down),
        up=jnp.where(below, 0.5 * ends.up, slope),
        near=jax.tree.map(lambda new, old: jnp.where(below, new, old), found, ends.near),
        far=jax.tree.map(lambda new, old: jnp.where(below, old, new), found, ends.far),
        best=found,
        tried=ends.tried + 1,
    )
    kept = jax.tree.map(lambda new, old: jnp.where(found.usable, new, old), moved, ends)
    return kept._replace(tried=ends.tried + 1)
