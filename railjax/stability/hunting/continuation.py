"""Following a branch of limit cycles: where it can be entered at the Hopf point, steps along its tangent, and its folds."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from ...model.kinematics import size
from .adjoint import along
from .orbits import DISPLACEMENT, Model, Orbit, Shooting, matrix_at, pack
from .settling import displaced_wheelsets
from .shooting import BY_AMPLITUDE, OrbitProblem, Point, plane, row_of, solution, solved

#: steps along the branch, measured in the plane of the diagram (amplitude in mm, speed in 10 m/s)
FIRST_STEP, SMALLEST_STEP = 0.1, 2e-4
#: a step over which the branch turns by more than this (cosine) is taken again with half the length...
STRAIGHT = 0.9
#: ...unless it is this short: where a flange begins to touch the branch has a corner
CORNER = 4e-3
#: longest step that may lead over a fold: a longer one can end on a neighbouring branch
FOLD_STEP = 0.06
#: a fold is found when its speed is known to this (10 m/s), and so its amplitude to some 1e-7 mm, after so many orbits at most
FOLD_TOLERANCE, MOST_TRIES = 1e-13, 40


def hunting_mode(model: Model, shooting: Shooting, speed: float) -> tuple[Float[np.ndarray, "states"], float]:
    """Shape x of the least damped oscillating mode at the Hopf point's `speed` (m/s), and its angular frequency (rad/s).

    The shape is the state where the wheelset turns, for an amplitude of 1 m: the real part of the eigenvector that is 1 there.
    """
    values, vectors = np.linalg.eig(matrix_at(model, speed))
    oscillating = values.imag > 1e-6 * np.max(np.abs(values))
    return _shape(model, shooting, values, vectors, oscillating)


def _shape(
    model: Model, shooting: Shooting, values: np.ndarray, vectors: np.ndarray, among: np.ndarray
) -> tuple[Float[np.ndarray, "states"], float]:
    chosen = int(np.argmin(np.where(among, -values.real, np.inf)))
    vector = vectors[:, chosen]
    return (vector / vector[model.amplitude_index(shooting.wheelset)]).real, float(values.imag[chosen])


#: share of the largest displacement in a mode that a wheelset has at least where the wheelsets, not the car body, move; rad/s between which
#: vehicles hunt; and a usual value
MOVED, HUNTING, USUAL = 0.3, (3.0, 80.0), 25.0


def wheelset_mode(model: Model, shooting: Shooting, speed: float) -> tuple[Float[np.ndarray, "states"], float]:
    """As `hunting_mode`, away from the Hopf point, where the least damped mode may be another: the least damped one in which the wheelsets
    move as slowly as vehicles hunt; all of them displaced where there is none."""
    values, vectors = np.linalg.eig(matrix_at(model, speed))
    coordinates = np.abs(vectors[: size(model.vehicle)])
    moving = np.max(coordinates[model.displacements], axis=0) >= MOVED * np.max(coordinates, axis=0)
    among = moving & (values.imag > HUNTING[0]) & (values.imag < HUNTING[1])
    if among.any():
        return _shape(model, shooting, values, vectors, among)
    return displaced_wheelsets(model), USUAL


def near_hopf(
    model: Model, shooting: Shooting, shape: Float[np.ndarray, "states"], omega: float, speed: float, amplitude: float
) -> OrbitProblem:
    """The orbit of a given amplitude (m) that grows out of a mode; its direction is that of rising amplitude."""
    guess = pack(model, shooting, Orbit(shape * amplitude + model.rest, 2.0 * np.pi / omega, speed))
    return OrbitProblem(
        guess, row_of(model, shooting, BY_AMPLITUDE), (amplitude + model.offset[shooting.wheelset]) / DISPLACEMENT
    )


def next_orbit(model: Model, shooting: Shooting, point: Point, step: float) -> OrbitProblem:
    """Pseudo-arclength continuation: along the tangent, the step measured in the plane of the diagram."""
    shadow = float(np.hypot(*plane(model, shooting, point.direction)))
    # where the branch stands steep on that plane the step is bounded in the space of all unknowns
    guess = point.unknowns + step / max(shadow, 0.05) * point.direction
    return OrbitProblem(guess, point.direction, float(point.direction @ guess))


def follow(
    model: Model, shooting: Shooting, start: Point, largest_step: float, most: int | None = None
) -> Iterator[tuple[Point, Point]]:
    """Limit cycles along a branch from `start` in its direction, for as long as the caller asks.

    Yields each point with the one before it. Ends where no step is short enough for Newton to converge, or after `most` tries.
    """
    point, step, tried = start, FIRST_STEP, 0
    while step >= SMALLEST_STEP and tried != most:
        tried += 1
        ahead = solved(model, shooting, next_orbit(model, shooting, point, step), point)
        straight = ahead.direction @ point.direction > STRAIGHT
        folded = ahead.slope * point.slope < 0.0
        if ahead.usable and (straight or step <= CORNER) and (not folded or step <= FOLD_STEP):
            before, point, step = point, ahead, min(1.5 * step, largest_step)
            yield point, before
        else:
            step *= 0.5


def fold_between(model: Model, shooting: Shooting, low: Point, high: Point) -> Point | None:
    """The orbit between two neighbouring points of a branch at which the speed is stationary; None where none is found.

    The secant method for the slope along the chord; bisection where that leads out, or where it does not soon halve the interval, for
    the slope jumps where a flange begins to touch. Of own code: bisection alone would take three times as many orbits, and
    SciPy's methods take longer to import than this runs.
    """
    chord = high.unknowns - low.unknowns
    row = chord / max(chord @ chord, 1e-30)
    left, right, width = 0.0, 1.0, 1.0
    (before, down), (last, slope) = (0.0, _slope(row, low)), (1.0, _slope(row, high))
    falls, known = down, {left: low, right: high}
    for tried in range(1, MOST_TRIES + 1):
        share = last - slope * (last - before) / (slope - down) if slope != down else left
        if tried % 3 == 0:
            share, width = (0.5 * (left + right) if right - left > 0.5 * width else share), right - left
        if not left < share < right:
            share = 0.5 * (left + right)
        nearest = min(known, key=lambda there: abs(there - share))
        found = _orbit_at(model, shooting, low, row, share, known[nearest])
        if not found.usable:  # nearer to an orbit that is known Newton has a better guess
            share = 0.5 * (share + nearest)
            found = _orbit_at(model, shooting, low, row, share, known[nearest])
        if not found.usable:
            return None
        before, down, last, slope = last, slope, share, _slope(row, found)
        known[share] = found
        if slope**2 * abs(last - before) < FOLD_TOLERANCE * abs(slope - down):
            return found
        left, right = (share, right) if slope * falls > 0.0 else (left, share)
    return None


def _orbit_at(
    model: Model, shooting: Shooting, low: Point, row: Float[np.ndarray, "unknowns"], share: float, nearest: Point
) -> Point:
    """The orbit at a share of the chord from `low` on, predicted by the tangent at a point near it."""
    ahead = share - row @ (nearest.unknowns - low.unknowns)
    guess = nearest.unknowns + ahead * nearest.direction / (row @ nearest.direction)
    return solved(model, shooting, OrbitProblem(guess, row, float(row @ low.unknowns + share)), nearest)


def _slope(row: Float[np.ndarray, "unknowns"], point: Point) -> float:
    """dv/ds along the chord."""
    return point.slope / float(row @ point.direction)


#: of a fold looked for from a neighbour's: shortest share of the way between the vehicles, first step along the branch, longest way
#: there (mm), and most orbits
SHORTEST, NEAR_STEP, NEAR, NEAR_TRIES = 0.2, 0.02, 2.0, 12
#: steps of Newton after which such an orbit is taken to be too far
FEW_ITERATIONS = 5


def fold_near(model: Model, shooting: Shooting, other: Model, fold: Point) -> Point | None:
    """The fold of a vehicle that is little different from the `other`, whose `fold` is given; None where it is not near that."""
    start = _carried_over(model, shooting, other, fold)
    return None if start is None else fold_beside(model, shooting, start)


def fold_beside(model: Model, shooting: Shooting, start: Point) -> Point | None:
    """The fold near an orbit of the same branch, by the secant method for the slope along the direction that the branch has there; None
    where it is not near."""
    row, nearest, share = start.direction, start, 0.0
    before: tuple[float, float] | None = None
    for _ in range(NEAR_TRIES):
        point = start if before is None else _orbit_at(model, shooting, start, row, share, nearest)
        if not (point.usable and point.direction @ row > STRAIGHT):
            return None
        slope = _slope(row, point)
        if before is None:
            ahead = -NEAR_STEP if slope > 0.0 else NEAR_STEP  # the speed has its minimum at a fold that limits hunting
        else:
            bend = (slope - before[1]) / (share - before[0])
            if not bend > 0.0:
                return None
            if slope**2 < FOLD_TOLERANCE * bend:
                return point
            ahead = share - slope / bend
        if not abs(ahead) < NEAR:
            return None
        before, share, nearest = (share, slope), ahead, point
    return None


def _carried_over(model: Model, shooting: Shooting, other: Model, point: Point) -> Point | None:
    """The orbit into which another vehicle's turns when its parameters become, step by step, those of this one: predicted by the
    derivatives by all of them, its distance along the other's branch held."""
    row, done, step = point.direction, 0.0, 1.0
    change = model.numbers - other.numbers
    while done < 1.0:
        ahead = min(done + step, 1.0)
        here, there = (between(other, model, share) for share in (done, ahead))
        pushed = along(here, shooting, point.unknowns, change) * (ahead - done)
        guess = point.unknowns - solution(np.vstack([point.jacobian, row]), np.append(pushed, 0.0))
        found = solved(there, shooting, OrbitProblem(guess, row, float(row @ point.unknowns)), point, FEW_ITERATIONS)
        if found.usable and found.direction @ point.direction > STRAIGHT:
            point, done = found, ahead
        else:
            step *= 0.5
            if step < SHORTEST:
                return None
    return point


def between(one: Model, other: Model, share: float) -> Model:
    """The vehicle at a share of the way from one to another of the same form."""
    return other if share == 1.0 else one.form.tree(one.numbers + share * (other.numbers - one.numbers))
