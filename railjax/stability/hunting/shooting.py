"""Newton's method for one limit cycle, and what its Jacobian tells of the branch there; on the host.

35 unknowns make a linear system of microseconds: compiled are only the flow and its derivatives (`orbits`).
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ...base.typing import Number
from .adjoint import weighted
from .orbits import (
    DISPLACEMENT,
    SPEED,
    Model,
    Shooting,
    Unknowns,
    by_parameters,
    orbit_derivatives,
    residual,
    unpack,
)

#: Newton goes on until all residuals (of the units above) are below the first, and an orbit counts as closed below the second,
#: for at a flange's corner Newton creeps
AIM, CLOSED = 1e-9, 1e-7
#: Newton gives up after so many steps; one that does not make the residual smaller is halved so often
MOST_ITERATIONS, MOST_HALVINGS = 16, 6
#: so often the whole step is taken all the same, where it leads to a residual of less than the second: out of a trap that a flange's
#: corner between two steps of RK4 can make
MOST_LEAPS, LEAP = 6, 0.5


#: residual and condition of a packed orbit
Residual = Callable[[np.ndarray], np.ndarray]


class OrbitProblem(NamedTuple):
    """Which orbit is looked for: near `guess` the one with row · unknowns = value.

    `row` picks the orbit from its branch: the amplitude, the speed or a direction between.
    """

    guess: Float[np.ndarray, "unknowns"]
    row: Float[np.ndarray, "unknowns"]
    value: float


class Point(NamedTuple):
    """An orbit on its branch, and what the Jacobian there tells."""

    unknowns: Float[np.ndarray, "unknowns"]  # `pack`ed
    direction: Float[np.ndarray, "unknowns"]  # of the branch: a unit vector with row · direction > 0
    amplitude: float  # lateral displacement of the wheelset at its turning point, m
    peaks: Float[np.ndarray, "wheelsets"]  # largest lateral displacement of each wheelset over the period, m
    jacobian: Float[np.ndarray, "states unknowns"]
    monodromy: Float[np.ndarray, "states states"]  # of the half (mirrored) or whole period, of the scaled state
    adjoint: Float[np.ndarray, "states"]  # change of the speed (in its unit) per residual, with row · unknowns held
    residual: float  # the largest, in the units above
    usable: bool  # Newton converged to an orbit

    @property
    def slope(self) -> float:
        """Of the speed (10 m/s) along the branch's unit vector: 0 at a fold."""
        return float(self.direction[-1])


def solved(
    model: Model, shooting: Shooting, problem: OrbitProblem, near: Point | None = None, most: int = MOST_ITERATIONS
) -> Point:
    """Newton from the guess, and what the Jacobian tells of the orbit found: direction of the branch, monodromy, adjoint.

    With a neighbouring point `near`, its Jacobian is tried first, improved from step to step (Broyden), and formed anew only at the end.
    At `most` so many steps are taken.
    """

    def off(x: np.ndarray) -> np.ndarray:
        return np.append(residual(model, shooting, x), problem.row @ x - problem.value)

    here = problem.guess if near is None else _with_old_jacobian(off, problem, near)
    leaps = 0
    for count in range(most + 1):
        equations = orbit_derivatives(model, shooting, here)
        there = np.append(equations.residual, problem.row @ here - problem.value)
        bordered, error = np.vstack([equations.jacobian, problem.row]), float(np.max(np.abs(there)))
        if not error > AIM or count == most:  # NaN is finished
            break
        step = -solution(bordered, there)
        shorter = _shortened(off, here, step, error)
        if shorter is None:
            leaps += 1
            if leaps > MOST_LEAPS or not np.max(np.abs(off(here + step))) < LEAP:
                break
        here = here + (step if shorter is None else shorter)
    last = np.zeros(len(here))
    last[-1] = 1.0
    tangent = solution(bordered, last)
    # the speed is the last unknown
    adjoint = solution(bordered.T, last)[:-1]
    orbit = unpack(model, shooting, here)
    usable = error <= CLOSED and bool(np.all(np.isfinite(tangent))) and orbit.speed > 0.0 and orbit.period > 0.0
    return Point(
        here,
        tangent / np.linalg.norm(tangent),
        float(orbit.state[model.amplitude_index(shooting.wheelset)]),
        equations.peaks,
        equations.jacobian,
        equations.monodromy,
        adjoint,
        error,
        bool(usable),
    )


#: steps with an old Jacobian, what their residual must come to, and by what a step must make it smaller
MOST_OLD, OLD_AIM, OLD_GAIN = 12, 1e-10, 0.5


def _shortened(off: Residual, here: np.ndarray, step: np.ndarray, error: float) -> np.ndarray | None:
    """Newton's step, halved until the residual falls: at a flange's corner the whole step may lead far away. None where none does."""
    for _ in range(MOST_HALVINGS):
        if np.max(np.abs(off(here + step))) < 0.95 * error:
            return step
        step = 0.5 * step
    return None


def _with_old_jacobian(off: Residual, problem: OrbitProblem, near: Point) -> Float[np.ndarray, "unknowns"]:
    """Broyden's method; it ends where a step gains little, and Newton goes on from the best."""
    here, there = problem.guess, off(problem.guess)
    try:
        inverse = np.linalg.inv(np.vstack([near.jacobian, problem.row]))
    except np.linalg.LinAlgError:
        return here
    for _ in range(MOST_OLD):
        step = -inverse @ there
        ahead = off(here + step)
        if not np.max(np.abs(ahead)) < OLD_GAIN * np.max(np.abs(there)):
            break
        pulled = inverse @ (ahead - there)
        inverse += np.outer(step - pulled, step @ inverse) / (step @ pulled)
        here, there = here + step, ahead
        if np.max(np.abs(there)) < OLD_AIM:
            break
    return here


def solution(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """NaN where the matrix is singular."""
    try:
        return np.linalg.solve(matrix, right)
    except np.linalg.LinAlgError:
        return np.full(np.shape(right), np.nan)


def speed_slopes(model: Model, shooting: Shooting, point: Point) -> Model:
    """Derivative of an orbit's speed (m/s) by every number of the model: -adjoint · d residual.

    That of the implicit function, with what the row of the point's problem picks held. At a fold, where the speed is stationary
    along the branch, that is the fold's own.
    """
    return model.form.tree(-weighted(model, shooting, point.unknowns, point.adjoint) * SPEED)


def amplitude_slopes(model: Model, shooting: Shooting, point: Point) -> Model:
    """Derivative of an orbit's amplitude (m) by every number of the model at constant speed."""
    bordered = np.vstack([point.jacobian, row_of(model, shooting, BY_SPEED)])
    index = model.amplitude_index(shooting.wheelset)
    if model.vehicle.profiles is not None:
        adjoint = solution(bordered.T, np.eye(len(bordered))[index])[:-1]
        return model.form.tree(-weighted(model, shooting, point.unknowns, adjoint) * DISPLACEMENT)
    pushed = by_parameters(model, shooting, point.unknowns)
    moved = -solution(bordered, np.vstack([pushed, np.zeros(pushed.shape[1])]))
    return model.form.tree(moved[index] * DISPLACEMENT)


def plane(model: Model, shooting: Shooting, vector: Unknowns) -> tuple[Number, Number]:
    """Amplitude (mm) and speed (10 m/s) of a packed orbit or of a tangent: the plane of the bifurcation diagram."""
    return vector[model.amplitude_index(shooting.wheelset)], vector[-1]


#: directions for `row_of`
BY_AMPLITUDE, BY_SPEED = (1.0, 0.0), (0.0, 1.0)


def row_of(model: Model, shooting: Shooting, direction: tuple[float, float]) -> Float[np.ndarray, "unknowns"]:
    """The row with which `solved` picks an orbit by amplitude and speed: row · unknowns = direction · plane(unknowns)."""
    row = np.zeros(model.states + 1)
    row[[model.amplitude_index(shooting.wheelset), -1]] = direction
    return row


def at_speed(model: Model, shooting: Shooting, guess: Float[np.ndarray, "unknowns"], speed: float) -> OrbitProblem:
    """The orbit near a packed `guess` that exists at a speed (m/s)."""
    return OrbitProblem(guess, row_of(model, shooting, BY_SPEED), float(speed) / SPEED)


def largest_displacement(model: Model, point: Point) -> float:
    """Largest lateral displacement of any wheelset at the instant of the point, m."""
    return float(np.max(np.abs(point.unknowns[model.displacements]))) * DISPLACEMENT
