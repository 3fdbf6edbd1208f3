"""Periodic orbits (limit cycles) of straight running, by shooting: Newton on the flow of the project's own RK4.

An orbit is a state on it, its period and the speed at which it exists. The state is taken where the lateral displacement
of one wheelset turns, so that its displacement there is the amplitude. The vehicle is alike to both sides, so a limit
cycle that keeps this symmetry is its own mirror image half a period later, and half a period of integration is enough.
"""

import dataclasses
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float, Int

from .dampers import Damper
from .deflections import layout, size
from .integrate import rk4_in_loop
from .motion import motion, state_rate, state_size, wheelset_shape
from .typing import Scalar
from .vehicle import Vehicle

State = Float[Array, "states"]

#: what counts as one in Newton's norm: 1 mm or mrad, 50 mm/s or mrad/s; 0.1 s of period; 10 m/s of speed
DISPLACEMENT, VELOCITY, PERIOD, SPEED = 1e-3, 5e-2, 0.1, 10.0

#: Newton goes on until all residuals (of the units above) are below the first, and an orbit counts as closed below the second,
#: for at a flange's corner Newton creeps
AIM, CLOSED = 1e-9, 1e-7
MOST_ITERATIONS = 16


@dataclass(frozen=True)
class Shooting:
    """The static part of the boundary-value problem.

    `steps` of RK4 over the half period (over the whole one for orbits that are not `symmetric`); `wheelset`, counted from
    the front, is the one whose lateral displacement measures the amplitude.
    """

    steps: int
    wheelset: int
    symmetric: bool = True


class Model(NamedTuple):
    """What hunts: a vehicle and what takes the place of rho_cy."""

    vehicle: Vehicle
    damper: Damper


class Orbit(NamedTuple):
    """A limit cycle: the state where the wheelset turns, the period (s) and the speed (m/s)."""

    state: State
    period: Scalar
    speed: Scalar


class Problem(NamedTuple):
    """Which orbit is looked for: near `guess` the one with row · unknowns = value.

    `row` picks the orbit from its branch: the amplitude, the speed or a direction between.
    """

    guess: Float[Array, "unknowns"]
    row: Float[Array, "unknowns"]
    value: Float[Array, ""]


class Point(NamedTuple):
    """An orbit on its branch, and what the Jacobian there tells."""

    unknowns: Float[Array, "unknowns"]  # `pack`ed
    direction: Float[Array, "unknowns"]  # of the branch: a unit vector with row · direction > 0
    amplitude: Float[Array, ""]  # lateral displacement of the wheelset at its turning point, m
    monodromy: Float[Array, "states states"]  # of the half (mirrored) or whole period, of the scaled state
    adjoint: State  # change of the speed (in its unit) per residual, with row · unknowns held
    residual: Float[Array, ""]  # the largest, in the units above
    usable: Bool[Array, ""]  # Newton converged to an orbit


#: m and units of u: how finely an orbit sees the corner of a sharp flange, and the kink of creep at zero
FLANGE_CORNER, CREEP_CORNER = 1e-5, 1e-9


def rounded(vehicle: Vehicle) -> Vehicle:
    """The vehicle with sharp laws rounded as finely as steps of fixed length can see; others as they are.

    A sharp corner within an RK4 step makes the flow's derivative jump each time a parameter moves the corner from one step to
    the next, and Newton, folds and gradients stumble over it. Rounding the flange's corner within 0.01 mm, a thousandth of
    the dead band, ends that and moves the coach's fold by 0.02 km/h. Creep is differentiable and stays as it is.
    """
    if vehicle.contact.law != "sharp":
        return vehicle
    contact = dataclasses.replace(vehicle.contact, law="smooth", flange_width=FLANGE_CORNER, creep_width=CREEP_CORNER)
    return dataclasses.replace(vehicle, contact=contact)


def amplitude_index(vehicle: Vehicle, wheelset: int) -> int:
    """Where the wheelset's lateral displacement stands in the state; its rate stands `size(vehicle)` further."""
    before = 0
    for name, shape in layout(vehicle).items():
        if name == "wheelset_y":
            return before + wheelset
        before += int(np.prod(shape))
    raise AssertionError("every vehicle has wheelsets")


def displacements(model: Model) -> slice:
    """Where the lateral displacements of all wheelsets stand in the state."""
    first = amplitude_index(model.vehicle, 0)
    return slice(first, first + int(np.prod(wheelset_shape(model.vehicle))))


def scales(model: Model) -> Float[np.ndarray, "states"]:
    """What counts as one for each state; the dampers' internal states like displacements unless the law says other."""
    n, states = size(model.vehicle), state_size(model.vehicle, model.damper)
    scale = np.full(states, DISPLACEMENT)
    scale[n : 2 * n] = VELOCITY
    return scale


def mirror(model: Model) -> Float[np.ndarray, "states"]:
    """The motion seen in a mirror along the track: -1 for every coordinate, +1 for internal states that have no side.

    A damper names the latter, like a controller's command, in `even_states`.
    """
    signs = np.full(state_size(model.vehicle, model.damper), -1.0)
    bogies = wheelset_shape(model.vehicle)[0]
    for index in getattr(model.damper, "even_states", ()):
        start = 2 * size(model.vehicle) + index * bogies
        signs[start : start + bogies] = 1.0
    return signs


def pack(model: Model, shooting: Shooting, orbit: Orbit) -> Float[Array, "unknowns"]:
    """The unknowns as one vector of numbers of about one: all states but the wheelset's rate, which is zero; period; speed."""
    rate = amplitude_index(model.vehicle, shooting.wheelset) + size(model.vehicle)
    scaled = jnp.delete(orbit.state / scales(model), np.array(rate))
    return jnp.concatenate([scaled, jnp.stack([orbit.period / PERIOD, orbit.speed / SPEED])])


def unpack(model: Model, shooting: Shooting, unknowns: Float[Array, "unknowns"]) -> Orbit:
    """The orbit of a `pack`ed vector."""
    rate = amplitude_index(model.vehicle, shooting.wheelset) + size(model.vehicle)
    state = jnp.concatenate([unknowns[:rate], jnp.zeros(1, unknowns.dtype), unknowns[rate:-2]]) * scales(model)
    return Orbit(state, unknowns[-2] * PERIOD, unknowns[-1] * SPEED)


def flow(model: Model, orbit: Orbit, duration: Scalar, steps: int) -> tuple[State, Float[Array, "steps states"]]:
    """The state after `duration` of straight running on even track, and the states at the start of every step."""
    even = jnp.zeros(wheelset_shape(model.vehicle), orbit.state.dtype)
    slowness = 1.0 / orbit.speed

    def rate(x: State) -> State:
        return state_rate(model.vehicle, motion(model.vehicle, model.damper, slowness, even, x))

    def step(x: State, _: None) -> tuple[State, State]:
        return rk4_in_loop(rate, x, duration / steps), x

    return jax.lax.scan(step, orbit.state, length=steps)


def section(model: Model, shooting: Shooting, orbit: Orbit) -> State:
    """The scaled state half a period later, mirrored (or a whole period later): a fixed point where the orbit closes."""
    if shooting.symmetric:
        return mirror(model) * flow(model, orbit, 0.5 * orbit.period, shooting.steps)[0] / scales(model)
    return flow(model, orbit, orbit.period, shooting.steps)[0] / scales(model)


class Linearised(NamedTuple):
    """The equations at a point: residual and its derivative by all unknowns and by the whole scaled state."""

    residual: State
    jacobian: Float[Array, "states unknowns"]
    monodromy: Float[Array, "states states"]


def linearised(model: Model, shooting: Shooting, unknowns: Float[Array, "unknowns"]) -> Linearised:
    """Residual and Jacobian by forward mode: one lane per column, which share the flow's own arithmetic."""
    scale = scales(model)

    def of_all(scaled: State, period: Scalar, speed: Scalar) -> tuple[State, State]:
        arrived = section(model, shooting, Orbit(scaled * scale, period * PERIOD, speed * SPEED))
        return arrived, arrived

    start = unpack(model, shooting, unknowns).state / scale
    columns, arrived = jax.jacfwd(of_all, argnums=(0, 1, 2), has_aux=True)(start, unknowns[-2], unknowns[-1])
    monodromy, of_period, of_speed = columns
    rate = amplitude_index(model.vehicle, shooting.wheelset) + size(model.vehicle)
    of_state = jnp.delete(monodromy - jnp.eye(scale.shape[0]), np.array(rate), axis=1)
    return Linearised(arrived - start, jnp.column_stack([of_state, of_period, of_speed]), monodromy)


def solved(model: Model, shooting: Shooting, problem: Problem) -> Point:
    """Newton from the guess, and what the Jacobian tells of the orbit found: direction of the branch, monodromy, adjoint.

    Of own code, because optimistix (0.1.0) does not work under `shard_map`, on which batches rely, and forms the Jacobian anew
    for what is wanted of it at the end.
    """

    class Iterate(NamedTuple):
        here: Float[Array, "unknowns"]
        ahead: Float[Array, "unknowns"]
        equations: Linearised
        error: Float[Array, ""]
        count: Int[Array, ""]

    def unfinished(iterate: Iterate) -> Bool[Array, ""]:
        # NaN is finished
        return (iterate.error > AIM) & (iterate.count < MOST_ITERATIONS)

    def corrected(iterate: Iterate) -> Iterate:
        here = iterate.ahead
        equations = linearised(model, shooting, here)
        off = jnp.append(equations.residual, problem.row @ here - problem.value)
        step = jnp.linalg.solve(jnp.vstack([equations.jacobian, problem.row]), off)
        return Iterate(here, here - step, equations, jnp.max(jnp.abs(off)), iterate.count + 1)

    states = problem.guess.shape[0] - 1
    nothing = Linearised(jnp.zeros(states), jnp.zeros((states, states + 1)), jnp.zeros((states, states)))
    start = Iterate(problem.guess, problem.guess, nothing, jnp.asarray(jnp.inf), jnp.asarray(0))
    unknowns, _, equations, error, _ = jax.lax.while_loop(unfinished, corrected, start)
    bordered = jnp.vstack([equations.jacobian, problem.row])
    last = jnp.zeros(states + 1).at[-1].set(1.0)
    tangent = jnp.linalg.solve(bordered, last)
    # the speed is the last unknown
    adjoint = jnp.linalg.solve(bordered.T, last)[:-1]
    orbit = unpack(model, shooting, unknowns)
    usable = (error <= CLOSED) & jnp.all(jnp.isfinite(tangent)) & (orbit.speed > 0.0) & (orbit.period > 0.0)
    amplitude = orbit.state[amplitude_index(model.vehicle, shooting.wheelset)]
    return Point(unknowns, tangent / jnp.linalg.norm(tangent), amplitude, equations.monodromy, adjoint, error, usable)


def implicit_speed(model: Model, shooting: Shooting, point: Point) -> Float[Array, ""]:
    """Speed (m/s) of an orbit, to be differentiated with respect to the model: v - adjoint · residual.

    One step of Newton from the converged orbit; its derivative is that of the implicit function, with what the row of the
    point's problem picks held. At a fold, where the speed is stationary along the branch, that is the fold's own.
    """
    fixed = jax.lax.stop_gradient(point)
    orbit = unpack(model, shooting, fixed.unknowns)
    residual = section(model, shooting, orbit) - orbit.state / scales(model)
    return (fixed.unknowns[-1] - fixed.adjoint @ residual) * SPEED


def plane(model: Model, shooting: Shooting, vector: Float[Array, "unknowns"]) -> Float[Array, "2"]:
    """Amplitude (mm) and speed (10 m/s) of a packed orbit or of a tangent: the plane of the bifurcation diagram."""
    return jnp.stack([vector[amplitude_index(model.vehicle, shooting.wheelset)], vector[-1]])


def row_of(model: Model, shooting: Shooting, direction: tuple[float, float]) -> Float[Array, "unknowns"]:
    """The row with which `solved` picks an orbit by amplitude and speed: row · unknowns = direction · plane(unknowns)."""
    unknowns = state_size(model.vehicle, model.damper) + 1
    row = jnp.zeros(unknowns).at[amplitude_index(model.vehicle, shooting.wheelset)].set(direction[0])
    return row.at[-1].set(direction[1])


#: directions for `row_of`
BY_AMPLITUDE, BY_SPEED = (1.0, 0.0), (0.0, 1.0)


def at_speed(model: Model, shooting: Shooting, guess: Float[Array, "unknowns"], speed: Scalar) -> Problem:
    """The orbit near a packed `guess` that exists at a speed (m/s)."""
    return Problem(guess, row_of(model, shooting, BY_SPEED), jnp.asarray(speed) / SPEED)


def history(model: Model, shooting: Shooting, orbit: Orbit) -> Float[Array, "steps states"]:
    """States of the orbit at the start of every step of the half (or whole) period."""
    duration = 0.5 * orbit.period if shooting.symmetric else orbit.period
    return flow(model, orbit, duration, shooting.steps)[1]


class Floquet(NamedTuple):
    """Floquet multipliers of the whole period, and what they say."""

    multipliers: Complex[np.ndarray, "states"]  # the trivial one first, then by falling magnitude
    error: float  # |mu_1 - 1|: the trivial multiplier's distance from 1, the error bar of the others
    half: Complex[np.ndarray, "states"]  # of the half period with mirror, in the same order (whole period if not symmetric)

    @property
    def largest(self) -> float:
        """Magnitude of the largest multiplier but the trivial one."""
        return float(np.abs(self.multipliers[1])) if len(self.multipliers) > 1 else 0.0

    @property
    def stable(self) -> bool:
        """Whether nearby motions come back to the orbit."""
        return self.largest < 1.0 - 1e-9  # neither at a fold nor at the Hopf point


def floquet(shooting: Shooting, half: Complex[np.ndarray, "states"]) -> Floquet:
    """Multipliers from the eigenvalues of the monodromy matrix, of which a symmetric orbit has that of half a period."""
    trivial = int(np.argmin(np.abs(half - 1.0)))
    rest = np.delete(half, trivial)
    half = np.concatenate([half[trivial : trivial + 1], rest[np.argsort(-np.abs(rest), kind="stable")]])
    multipliers = half**2 if shooting.symmetric else half
    return Floquet(multipliers, float(abs(multipliers[0] - 1.0)), half)


def multipliers_of(shooting: Shooting, monodromy: Float[np.ndarray, "states states"]) -> Floquet:
    """Multipliers from the monodromy matrix."""
    return floquet(shooting, np.linalg.eigvals(monodromy).astype(complex))
