"""Periodic orbits (limit cycles) of straight running as a boundary-value problem: the flow of the project's own RK4, and its derivatives.

An orbit is a state on it, its period and the speed at which it exists. The state is taken where the lateral displacement
of one wheelset turns, so that its displacement there is the amplitude. The vehicle is alike to both sides, so a limit
cycle that keeps this symmetry is its own mirror image half a period later, and half a period of integration is enough.

Only this is compiled; what decides what is integrated next (`shooting`, `continuation`, `fold_search`) is plain Python on NumPy's arrays.
"""

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ...base.compilation import QUICK, one_kernel, options
from ...base.packing import Form, numbers_of
from ...base.programs import kept
from ...base.typing import Number, Scalar
from ...model.contact.profile_table import is_odd
from ...model.damper import Damper, answers
from ...model.kinematics import layout, size
from ...model.motion import motion, state_rate, state_size, wheelset_shape
from ...model.parameters import without_labels
from ...model.track.curve import BalancedArc
from ...model.vehicle import Vehicle
from ...simulation.runge_kutta import rk4_in_loop
from ...simulation.step_size import fastest_rate_on_host
from ..along_speed import both_at

State = Float[Array, "states"] | Float[np.ndarray, "states"]
Unknowns = Float[Array, "unknowns"] | Float[np.ndarray, "unknowns"]

#: what counts as one in Newton's norm: 1 mm or mrad, 50 mm/s or mrad/s; 0.1 s of period; 10 m/s of speed
DISPLACEMENT, VELOCITY, PERIOD, SPEED = 1e-3, 5e-2, 0.1, 10.0


@dataclass(frozen=True)
class Shooting:
    """What of the boundary-value problem is chosen.

    `steps` of RK4 over the half period (over the whole one for orbits that are not `symmetric`); `wheelset`, counted from
    the front, is the one whose lateral displacement measures the amplitude.
    """

    steps: int
    wheelset: int
    symmetric: bool = True

    @property
    def halves(self) -> int:
        """Half periods of integration."""
        return 1 if self.symmetric else 2


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Model:
    """What hunts: a vehicle and what takes the place of rho_cy; and where things stand in its state."""

    vehicle: Vehicle
    damper: Damper
    arc: BalancedArc | None = None  # None: straight track

    @functools.cached_property
    def form(self) -> Form:
        """Everything of the model but its numbers."""
        return Form.of(self)

    @functools.cached_property
    def numbers(self) -> Float[np.ndarray, "numbers"]:
        """All numbers, in the order of the leaves."""
        return numbers_of(self)

    @functools.cached_property
    def states(self) -> int:
        """Length of the state."""
        return state_size(self.vehicle, self.damper)

    @functools.cached_property
    def displacements(self) -> slice:
        """Where the lateral displacements of all wheelsets stand in the state; their rates stand `size(vehicle)` further."""
        before = itertools.takewhile(lambda entry: entry[0] != "wheelset_y", layout(self.vehicle).items())
        first = sum(math.prod(shape) for _, shape in before)
        return slice(first, first + math.prod(wheelset_shape(self.vehicle)))

    @functools.cached_property
    def scales(self) -> Float[np.ndarray, "states"]:
        """What counts as one for each state: displacements and rates; the dampers' internal states like displacements."""
        n = size(self.vehicle)
        scale = np.full(self.states, DISPLACEMENT)
        scale[n : 2 * n] = VELOCITY
        return scale

    @functools.cached_property
    def mirror(self) -> Float[np.ndarray, "states"]:
        """The motion seen in a mirror along the track: -1 for every coordinate, +1 for internal states that have no side.

        A damper names the latter, like a controller's command, in `even_states`.
        """
        signs = np.full(self.states, -1.0)
        bogies = wheelset_shape(self.vehicle)[0]
        for index in answers(self.damper).even_states:
            start = 2 * size(self.vehicle) + index * bogies
            signs[start : start + bogies] = 1.0
        return signs

    @functools.cached_property
    def apart(self) -> tuple["Model", np.ndarray | None]:
        """The model without the table of its profiles, and that: it is large, and many motions share one."""
        profiles = self.vehicle.profiles
        if profiles is None:
            return self, None
        without = dataclasses.replace(profiles, rows=None)
        return dataclasses.replace(self, vehicle=dataclasses.replace(self.vehicle, profiles=without)), np.asarray(profiles.rows)

    def with_table(self, rows: Any) -> "Model":
        """What `apart` took apart, together again."""
        if rows is None:
            return self
        profiles = dataclasses.replace(self.vehicle.profiles, rows=rows)  # type: ignore[type-var]
        return dataclasses.replace(self, vehicle=dataclasses.replace(self.vehicle, profiles=profiles))

    @functools.cached_property
    def alike(self) -> bool:
        """Whether the vehicle is alike to both sides, as but for its profiles it always is."""
        return self.arc is None and (self.vehicle.profiles is None or is_odd(self.vehicle.profiles))

    @functools.cached_property
    def offset(self) -> Float[np.ndarray, "wheelsets"]:
        """Lateral displacements of the wheelsets of steady running, m: 0 but in curves and for wheels that are not alike."""
        return self.rest[self.displacements]

    @functools.cached_property
    def rest(self) -> Float[np.ndarray, "states"]:
        """The state of steady running, on straight track or in the arc."""
        if self.arc is not None:
            return np.asarray(self.arc.state)
        state = np.zeros(self.states)
        state[self.displacements] = 0.0 if self.alike else float(self.vehicle.profiles.rest)
        return state

    def amplitude_index(self, wheelset: int) -> int:
        """Where the lateral displacement of a wheelset, counted from the front, stands in the state."""
        return self.displacements.start + wheelset


def model_of(vehicle: Vehicle, damper: Damper) -> Model:
    """As the search for limit cycles takes it: sharp corners `rounded`, without labels, NumPy's numbers."""
    return jax.tree.map(lambda leaf: np.asarray(leaf, float), Model(without_labels(rounded(vehicle)), damper))


class Orbit(NamedTuple):
    """A limit cycle: the state where the wheelset turns, the period (s) and the speed (m/s)."""

    state: State
    period: Number
    speed: Number


#: m and units of u: how finely an orbit sees the corner of a sharp flange, and the kink of creep at zero
FLANGE_CORNER, CREEP_CORNER = 1e-5, 1e-9


def rounded(vehicle: Vehicle) -> Vehicle:
    """The vehicle with sharp laws rounded as finely as steps of fixed length can see; others as they are.

    A sharp corner within an RK4 step makes the flow's derivative jump each time a parameter moves the corner from one step to
    the next, and Newton, folds and gradients stumble over it. Rounding the flange's corner within 0.01 mm, a thousandth of
    the dead band, ends that and moves the coach's fold by 0.02 km/h. The kink of creep at u = 0 is rounded within 1e-9, which changes nothing.
    """
    if vehicle.contact.law != "sharp":
        return vehicle
    contact = dataclasses.replace(vehicle.contact, law="smooth", flange_width=FLANGE_CORNER, creep_width=CREEP_CORNER)
    return dataclasses.replace(vehicle, contact=contact)


def fastest(model: Model, speed: float) -> float:
    """Fastest rate of the vehicle at a speed (m/s), 1/s: what bounds the step of RK4."""
    return fastest_rate_on_host(model.vehicle, speed, model.damper, matrices=both_at)


def pack(model: Model, shooting: Shooting, orbit: Orbit) -> Float[np.ndarray, "unknowns"]:
    """The unknowns as one vector of numbers of about one: all states but the wheelset's rate, which is zero; period; speed."""
    scaled = np.delete(np.asarray(orbit.state) / model.scales, _rate_index(model, shooting))
    return np.append(scaled, [float(orbit.period) / PERIOD, float(orbit.speed) / SPEED])


def unpack(model: Model, shooting: Shooting, unknowns: Unknowns) -> Orbit:
    """The orbit of a `pack`ed vector, NumPy's or JAX's."""
    rate, of = _rate_index(model, shooting), unknowns.__array_namespace__()
    state = of.concat([unknowns[:rate], of.zeros(1, dtype=unknowns.dtype), unknowns[rate:-2]]) * model.scales
    return Orbit(state, unknowns[-2] * PERIOD, unknowns[-1] * SPEED)


def _rate_index(model: Model, shooting: Shooting) -> int:
    """Where the rate of the wheelset that measures the amplitude stands in the state."""
    return model.amplitude_index(shooting.wheelset) + size(model.vehicle)


def state_rates(model: Model, slowness: Scalar, lanes: tuple[int, ...] = ()) -> Callable[[Array], Array]:
    """x' of running on even track at 1/v = `slowness` (s/m), as a function of x (states, *lanes)."""
    even = jnp.zeros((*wheelset_shape(model.vehicle), *lanes))
    curve = None if model.arc is None else model.arc.curve(model.vehicle, even)

    def rate(x: Float[Array, "states *lanes"]) -> Float[Array, "states *lanes"]:
        return state_rate(model.vehicle, motion(model.vehicle, model.damper, slowness, even, x, curve))

    return rate


@functools.cache
def _matrix(form: Form) -> Callable[..., Float[Array, "s s"]]:
    return kept(lambda numbers, slowness, x: jax.jacfwd(state_rates(form.tree(numbers), slowness))(x), form)


def matrix_at(model: Model, speed: float) -> Float[np.ndarray, "s s"]:
    """E about steady running at a speed (m/s)."""
    if model.arc is None:
        return both_at(model.vehicle, speed, model.damper)[0]
    return np.asarray(_matrix(model.form)(model.numbers, np.asarray(1.0 / speed), model.rest))


def flow(
    model: Model, orbit: Orbit, duration: Scalar, steps: int | Int[Array, ""]
) -> tuple[Float[Array, "states"], Float[Array, "wheelsets"]]:
    """The state after `duration`, and each wheelset's largest lateral displacement at the start of a step, m (no derivative).

    The number of steps is no constant of the compiled code.
    """
    rate, at = state_rates(model, 1.0 / orbit.speed), model.displacements

    def step(_: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        x, peaks = carry
        return rk4_in_loop(rate, x, duration / steps), jnp.maximum(peaks, jax.lax.stop_gradient(jnp.abs(x[at])))

    x = jnp.asarray(orbit.state)
    return jax.lax.fori_loop(0, steps, step, (x, jnp.zeros_like(x[at])))


def section(model: Model, shooting: Shooting, orbit: Orbit) -> Float[Array, "states"]:
    """The scaled state half a period later, mirrored (or a whole period later): a fixed point where the orbit closes."""
    return section_of(shooting.symmetric, model, orbit, shooting.steps)[0]


def section_of(symmetric: bool, model: Model, orbit: Orbit, steps: Any) -> tuple[Array, Array]:
    """`section`, and each wheelset's largest lateral displacement, m."""
    share, sign = (0.5, model.mirror) if symmetric else (1.0, 1.0)
    arrived, peaks = flow(model, orbit, share * orbit.period, steps)
    return sign * arrived / model.scales, peaks


def _columns(symmetric: bool, model: Model, orbit: Orbit, steps: Any) -> tuple[Array, Array, Array]:
    """`section_of` with its derivatives by scaled state, period and speed: one lane a column, last, which share the flow's own arithmetic."""
    scale = model.scales
    states = scale.shape[0]

    def of(direction: Float[Array, "columns"]) -> tuple[Array, Array, Array]:
        along = Orbit(direction[:states] * scale, direction[states] * PERIOD, direction[states + 1] * SPEED)
        (arrived, peaks), (moved, _) = jax.jvp(lambda orbit: section_of(symmetric, model, orbit, steps), (orbit,), (along,))
        return arrived, peaks, moved

    return jax.vmap(of, in_axes=-1, out_axes=(None, None, -1))(jnp.eye(states + 2))


def _by_parameters(symmetric: bool, model: Model, orbit: Orbit, steps: Any) -> Float[Array, "states numbers"]:
    """Derivative of `section_of` by every number of the model."""

    def along(direction: Float[Array, "numbers"]) -> Float[Array, "states"]:
        change = model.form.tree(direction)
        return jax.jvp(lambda model: section_of(symmetric, model, orbit, steps)[0], (model,), (change,))[1]

    return jax.vmap(along, in_axes=-1, out_axes=-1)(jnp.eye(sum(math.prod(shape) for shape in model.form.shapes)))


@functools.cache
def _compiled(function: Callable[..., Any], symmetric: bool, form: Form) -> Callable[..., Any]:
    kernel = one_kernel(lambda numbers, *rest: function(symmetric, form.tree(numbers), *rest))
    return kept(kernel, function, symmetric, form, compiler_options=options(QUICK))


def called(function: Callable[..., Any], model: Model, shooting: Shooting, orbit: Orbit, *more: np.ndarray) -> Any:
    """`function` of what the orbit is, compiled once for all models of a form."""
    numbers = Orbit(*(np.asarray(value, float) for value in orbit))
    found = _compiled(function, shooting.symmetric, model.form)(model.numbers, numbers, np.asarray(shooting.steps), *more)
    return jax.tree.map(np.asarray, found)


class Linearised(NamedTuple):
    """The equations at a point: residual, its derivative by all unknowns and by the whole scaled state, wheelsets' peaks (m)."""

    residual: Float[np.ndarray, "states"]
    jacobian: Float[np.ndarray, "states unknowns"]
    monodromy: Float[np.ndarray, "states states"]
    peaks: Float[np.ndarray, "wheelsets"]


def orbit_derivatives(model: Model, shooting: Shooting, unknowns: Float[np.ndarray, "unknowns"]) -> Linearised:
    """Residual and Jacobian at a `pack`ed orbit."""
    orbit = unpack(model, shooting, unknowns)
    arrived, peaks, columns = called(_columns, model, shooting, orbit)
    start, states = orbit.state / model.scales, arrived.shape[0]
    jacobian = columns.copy()
    jacobian[:, :states] -= np.eye(states)
    return Linearised(arrived - start, np.delete(jacobian, _rate_index(model, shooting), axis=1), columns[:, :states], peaks)


def residual(model: Model, shooting: Shooting, unknowns: Float[np.ndarray, "unknowns"]) -> Float[np.ndarray, "states"]:
    """How far a `pack`ed orbit is from closing; a tenth of the time of `linearised`."""
    orbit = unpack(model, shooting, unknowns)
    return called(section_of, model, shooting, orbit)[0] - orbit.state / model.scales


def advanced(model: Model, orbit: Orbit) -> Float[np.ndarray, "states"]:
    """The state after the orbit's "period", here a few steps of RK4, at its speed."""
    mirrored = called(section_of, model, SHORT, Orbit(orbit.state, 2.0 * orbit.period, orbit.speed))[0]
    return model.mirror * mirrored * model.scales


#: the compiled flow over half a "period" serves any time
SHORT = Shooting(8, 0)


def by_parameters(
    model: Model, shooting: Shooting, unknowns: Float[np.ndarray, "unknowns"]
) -> Float[np.ndarray, "states numbers"]:
    """Derivative of the residual by every number of the model, in the order of its leaves."""
    return called(_by_parameters, model, shooting, unpack(model, shooting, unknowns))
