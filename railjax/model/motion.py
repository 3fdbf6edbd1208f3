"""Equations of motion: deflections -> element forces -> generalised forces -> accelerations, and what follows from them.

The time simulation, the matrices of eqs. (2)-(4), stability and gradients all go through `motion`.
"""

import functools
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..base.arguments import guarded
from ..base.compilation import fence, one_kernel
from ..base.packing import Packed
from ..base.programs import kept
from ..base.typing import Scalar
from .contact.creep import ContactForce, Creepage, contact_force, creepages
from .contact.profile_contact import OfWheels, profile_contact, seated
from .damper import Damper, PassiveDamper, Seen, answers, law_of
from .kinematics import Groups, damper_point, deflections, join, size, split, transposed
from .parameters import without_labels
from .suspension import bump_stop_force, yaw_damper_force, yaw_damper_states
from .track.curve import Curve
from .vehicle import Vehicle

#: F_d of eq. (1): the vehicle's own rho_cy
PASSIVE = PassiveDamper()


class Motion(NamedTuple):
    """All that is known of the vehicle at an instant; what nobody reads is not computed under `jit`."""

    coordinates: Groups  # q
    rates: Groups  # q'
    accelerations: Groups  # q''
    deflection: Groups
    deflection_rate: Groups
    creepage: Creepage
    contact: ContactForce
    damper_force: Float[Array, "n *lanes"]  # secondary lateral dampers of a bogie, N
    internal_rate: Float[Array, "k n *lanes"]  # rate of the lateral dampers' internal states
    elongation_rate: Float[Array, "s n *lanes"]  # rate of the yaw dampers' internal states, m/s
    alignment: Float[Array, "n m *lanes"]  # eta_i, m
    slowness: Scalar  # 1/v, s/m
    velocity: Float[Array, "n *lanes"]  # q' as it lies in the state
    vehicle: Vehicle  # for what is read off it elsewhere, as on the floor
    specific: Groups  # forces over inertias, what accelerometers in the plane of the track measure: q'' on straight track
    wheels: OfWheels | None = None  # of vehicles with profiles


def inertias(vehicle: Vehicle) -> dict[str, Scalar]:
    """Mass or moment of inertia of each group of coordinates: the diagonal of M."""
    body, bogie, wheelset = vehicle.carbody, vehicle.bogie, vehicle.wheelset
    return {
        "carbody_y": body.mass,
        "carbody_psi": body.yaw_inertia,
        "carbody_phi": body.roll_inertia,
        "bogie_y": bogie.mass,
        "bogie_psi": bogie.yaw_inertia,
        "bogie_phi": bogie.roll_inertia,
        "wheelset_y": wheelset.mass,
        "wheelset_psi": wheelset.yaw_inertia,
    }


def suspension_forces(vehicle: Vehicle, deflection: Groups, rate: Groups) -> Groups:
    """Springs, bump stops, cross bracing and viscous dampers, N (its bending: N m), positive along the deflection; not the secondary lateral and yaw dampers.

    Two elements a side pair everywhere; the bogie's roll works on the springs of all its m axles (4 for two axles).
    """
    primary, secondary, geometry = vehicle.primary, vehicle.secondary, vehicle.geometry
    springs = 2.0 * len(geometry.axle_pattern)
    roll_bar = secondary.anti_roll_stiffness / geometry.half_secondary**2
    # vertical dampers that do not stand with the springs
    apart = {} if geometry.half_vertical_damper is None else {"vertical_damper": (0.0, 2.0 * secondary.damping_z)}
    constants = {
        "secondary_y": (2.0 * secondary.stiffness_y, 0.0),
        "secondary_x": (2.0 * secondary.stiffness_x, 2.0 * secondary.damping_x),
        "secondary_z": (2.0 * secondary.stiffness_z + roll_bar, 0.0 if apart else 2.0 * secondary.damping_z),
        "primary_x": (2.0 * primary.stiffness_x, 2.0 * primary.damping_x),
        "primary_y": (2.0 * primary.stiffness_y, 2.0 * primary.damping_y),
        "primary_z": (springs * primary.stiffness_z, springs * primary.damping_z),
    } | apart
    if vehicle.cross_bracing is not None:
        constants["bracing_shear"] = (vehicle.cross_bracing.shear_stiffness, 0.0)
        constants["bracing_bending"] = (vehicle.cross_bracing.bending_stiffness, 0.0)
    forces = {
        name: stiffness * deflection[name] + damping * rate[name]
        for name, (stiffness, damping) in constants.items()
        if name in deflection
    }
    if vehicle.bump_stop is not None and "secondary_y" in deflection:
        stop = bump_stop_force(vehicle.contact.law, vehicle.bump_stop, deflection["secondary_y"])
        forces["secondary_y"] = forces["secondary_y"] + stop
    return forces


def motion(
    vehicle: Vehicle,
    damper: Damper,
    slowness: Scalar,
    alignment: Float[Array, "n m *lanes"],
    x: Float[Array, "states *lanes"],
    curve: Curve | None = None,
) -> Motion:
    """Eqs. (2) and (6) at an instant: M q'' = -G^T f(G q, G q', ...), at 1/v = `slowness` (s/m) on the track eta_i (m).

    In a `curve` the coordinates are those in the frames of the line at each body's place, and M q'' has the line's acceleration taken off.
    """
    flat, flat_rates, internal, elongation = _pieces(vehicle, damper, x)
    q, rates = split(vehicle, flat), split(vehicle, flat_rates)

    with jax.named_scope("deflections"):
        seat, rolled, rolling = None, {}, {}
        if vehicle.profiles is not None:
            seat, roll, roll_rate = seated(vehicle, q["wheelset_y"] - alignment, rates["wheelset_y"])
            rolled, rolling = {"wheelset_phi": roll}, {"wheelset_phi": roll_rate}
        deflection, rate = deflections(vehicle, q | rolled), deflections(vehicle, rates | rolling)
        turning = rate["contact_psi"]
        if curve is not None:
            deflection, rate = curve.added(vehicle, deflection, rate)
            turning = turning + curve.curvature / slowness
    with jax.named_scope("suspension"):
        forces = suspension_forces(vehicle, deflection, rate)
    with jax.named_scope("damper"):
        if "secondary_y" in deflection:
            at = damper_point(deflection)
            damper_force, internal_rate = law_of(damper, Seen(q, rates, elongation))(vehicle, deflection[at], rate[at], internal)
            forces[at] = forces[at] + damper_force if at in forces else damper_force
        else:
            damper_force, internal_rate = jnp.zeros_like(q["wheelset_y"][:, 0]), jnp.zeros_like(internal)
        elongation_rate = jnp.zeros_like(elongation)
        if "yaw_damper" in deflection:
            forces["yaw_damper"], elongation_rate = yaw_damper_force(
                vehicle.contact.law, vehicle.yaw_damper, deflection["yaw_damper"], rate["yaw_damper"], elongation
            )
    with jax.named_scope("contact"):
        y_rel, psi = deflection["contact_y"] - alignment, deflection["contact_psi"]
        wheels = None
        if vehicle.profiles is None:
            creepage = creepages(vehicle, slowness, y_rel, psi, rate["contact_y"], turning)
            contact = contact_force(vehicle, creepage, y_rel, psi)
        else:
            creepage, contact, wheels = profile_contact(vehicle, slowness, seat, y_rel, psi, rate["contact_y"], turning, forces)
        forces["contact_y"], forces["contact_psi"] = contact.lateral, contact.yaw
        if vehicle.gyroscopic and vehicle.profiles is None:
            spin = gyroscopic_coupling(vehicle, slowness)
            forces["contact_y"] = forces["contact_y"] - spin * turning
            forces["contact_psi"] = forces["contact_psi"] + spin * rate["contact_y"]
    with jax.named_scope("accelerations"):
        generalised = transposed(vehicle, q)(forces)
        inertia = inertias(vehicle)
        accelerations = specific = {name: force * (-1.0 / inertia[name]) for name, force in generalised.items()}
        if curve is not None:
            line = curve.acceleration
            accelerations = {name: value - line[name] if name in line else value for name, value in specific.items()}
    return Motion(
        q,
        rates,
        accelerations,
        deflection,
        rate,
        creepage,
        contact,
        damper_force,
        internal_rate,
        elongation_rate,
        alignment,
        slowness,
        flat_rates,
        vehicle,
        specific,
        wheels,
    )


def _pieces(vehicle: Vehicle, damper: Damper, x: Float[Array, "states *lanes"]) -> list[Float[Array, "..."]]:
    """q and q' as they lie in the state, and the internal states of lateral and yaw dampers, (k, n, *lanes)."""
    count, shape = size(vehicle), (len(vehicle.geometry.bogie_pattern), *x.shape[1:])
    states = damper.internal_states, yaw_damper_states(vehicle)
    flat, flat_rates, *internal = jax.lax.split(x, (count, count, *(k * shape[0] for k in states)))
    return [flat, flat_rates, *(piece.reshape((k, *shape)) for k, piece in zip(states, internal, strict=True))]


def held(
    vehicle: Vehicle, damper: Damper, x: Float[Array, "states *lanes"], curve: Curve | None = None
) -> Float[Array, "states *lanes"]:
    """The state between two steps, with what the damper holds until the next: `Law.held`. Doing it twice changes nothing."""
    law = answers(damper)
    if not law.decides:
        return x
    flat, flat_rates, internal, elongation = _pieces(vehicle, damper, x)
    q, rates = split(vehicle, flat), split(vehicle, flat_rates)
    deflection, rate = deflections(vehicle, q), deflections(vehicle, rates)
    if "secondary_y" not in deflection:
        return x
    if curve is not None:
        deflection, rate = curve.added(vehicle, deflection, rate)
    at = damper_point(deflection)
    internal = law.held(vehicle, deflection[at], rate[at], internal, Seen(q, rates, elongation))
    pieces = [piece.reshape((-1, *x.shape[1:])) for piece in (internal, elongation)]
    return jnp.concatenate([flat, flat_rates, *pieces])


def gyroscopic_coupling(vehicle: Vehicle, slowness: Scalar) -> Scalar:
    """I_ox (v/r_0)(lambda/e): spin v/r_0 times the roll per lateral displacement of a coned wheelset, N s.

    Rolling makes the wheelset's spin axis follow y (roll = lambda y/e), so yawing pushes sideways and moving sideways
    yaws: a skew pair that does no work.
    """
    wheelset = vehicle.wheelset
    rolling = 1.0 / (slowness * wheelset.wheel_radius)
    return wheelset.spin_inertia * rolling * vehicle.contact.conicity / vehicle.geometry.half_gauge


def state_rate(vehicle: Vehicle, instant: Motion) -> Float[Array, "states *lanes"]:
    """x' = [q', q'', rates of the internal states: lateral dampers, yaw dampers] of a `Motion`."""
    pieces = [instant.velocity, _joined(join(vehicle, instant.accelerations))]
    for internal in (instant.internal_rate, instant.elongation_rate):
        if internal.shape[0]:
            pieces.append(internal.reshape((-1, *internal.shape[2:])))
    return jnp.concatenate(pieces)


@fence
def _joined(pieces: list[Array]) -> Array:
    return jnp.concatenate(pieces)


def state_size(vehicle: Vehicle, damper: Damper) -> int:
    """Length of x: twice the coordinates and the internal states of lateral and yaw dampers."""
    internal = damper.internal_states + yaw_damper_states(vehicle)
    return 2 * size(vehicle) + internal * len(vehicle.geometry.bogie_pattern)


def wheelset_shape(vehicle: Vehicle) -> tuple[int, int]:
    """(n, m): bogies, axles per bogie."""
    return len(vehicle.geometry.bogie_pattern), len(vehicle.geometry.axle_pattern)


def linearised(
    vehicle: Vehicle,
    speed: Scalar,
    damper: Damper,
    read: Callable[[Motion], Any],
    *,
    flange: bool | Bool[Array, ""] = False,
) -> Any:
    """What each state, then the alignment under each wheelset, does to `read` near straight running with linear creep.

    `read` gives arrays with lanes last, in any tree; the result has a column there per entry of x, then per wheelset.
    With `flange` the flange is held in contact: k_f acts on y from zero displacement on.
    """
    states, (n, m) = state_size(vehicle, damper), wheelset_shape(vehicle)
    columns = states + n * m
    # one lane per column
    unit = jnp.eye(columns, dtype=jnp.result_type(float))
    return _along(vehicle, speed, damper, read, unit[:states], unit[states:].reshape((n, m, columns)), flange)


def _along(
    vehicle: Vehicle,
    speed: Scalar,
    damper: Damper,
    read: Callable[[Motion], Any],
    x: Float[Array, "states columns"],
    alignment: Float[Array, "n m columns"],
    flange: bool | Bool[Array, ""],
) -> Any:
    """Derivative of `read` near straight running along columns of states and alignments."""
    # within the flange's dead band, or beyond its corners already
    clearance = jnp.where(flange, -1.0, 1.0).astype(x.dtype)
    vehicle = replace(vehicle, contact=replace(vehicle.contact, law="linear", flange_clearance=clearance))
    slowness = 1.0 / jnp.asarray(speed, x.dtype)

    def of(x: Float[Array, "states columns"], alignment: Float[Array, "n m columns"]) -> Any:
        return read(motion(vehicle, damper, slowness, alignment, x))

    units = x, alignment
    return jax.jvp(of, jax.tree.map(jnp.zeros_like, units), units)[1]


def state_product(
    vehicle: Vehicle, speed: Scalar, damper: Damper, x: Float[Array, "states columns"]
) -> Float[Array, "states columns"]:
    """E x for a few columns, without the other columns of E."""
    still = jnp.zeros((*wheelset_shape(vehicle), x.shape[1]), x.dtype)
    return _along(vehicle, speed, damper, functools.partial(state_rate, vehicle), x, still, False)


@guarded(flange=None)
def state_matrix(
    vehicle: Vehicle, speed: Scalar, damper: Damper = PASSIVE, *, flange: bool | Bool[Array, ""] = False
) -> Float[Array, "states states"]:
    """E of eq. (4): the linearisation x' = E x of straight running with linear creep.

    The order is [q, q'], then the internal states of lateral and yaw dampers. Differentiable; `vmap` it over speeds and vehicles.

    Args:
        vehicle: a single vehicle, without lanes.
        speed: v, m/s.
        damper: what takes the place of rho_cy, linearised at rest; by default the vehicle's own.
        flange: True for the flange held in contact, as the bound on the time step needs it.

    Returns:
        E in SI, shape `(states, states)`: (2n, 2n) with n coordinates where no damper has states of its own, 34 x 34 for the
        coach.
    """
    return _rate_matrix(without_labels(vehicle), speed, damper, flange)[:, : state_size(vehicle, damper)]


@guarded()
def track_matrix(vehicle: Vehicle, speed: Scalar, damper: Damper = PASSIVE) -> Float[Array, "states wheelsets"]:
    """B of F*(t) = B eta(t), eq. (3): what the alignment eta_i under each wheelset does to x', with linear creep.

    Args:
        vehicle: a single vehicle, without lanes.
        speed: v, m/s.
        damper: what takes the place of rho_cy, linearised at rest; by default the vehicle's own.

    Returns:
        B, shape `(states, wheelsets)`, the SI unit of x' per m of alignment; rows as in `state_matrix`, wheelsets from the front.
    """
    return _rate_matrix(without_labels(vehicle), speed, damper, False)[:, state_size(vehicle, damper) :]


@jax.jit
def _rate_matrix(
    vehicle: Vehicle, speed: Scalar, damper: Damper, flange: bool | Bool[Array, ""]
) -> Float[Array, "states columns"]:
    return linearised(vehicle, speed, damper, functools.partial(state_rate, vehicle), flange=flange)


@kept
@one_kernel
def _rate_matrices(packed: Packed) -> Float[Array, "2 states columns"]:
    return jax.lax.map(functools.partial(_rate_matrix, *packed.unpacked()), jnp.array([False, True]))


def state_matrices(vehicle: Vehicle, speed: Scalar, damper: Damper) -> Float[np.ndarray, "2 states states"]:
    """`state_matrix` without and with the flanges in contact, of known numbers: one small program for all of a kind."""
    return np.asarray(_rate_matrices(Packed.of((vehicle, speed, damper))))[:, :, : state_size(vehicle, damper)]


class Matrices(NamedTuple):
    """M, C and K of eq. (2), SI; creep is in C and K, so they depend on the speed. Dashpots in series with a stiffness, which
    have a state of their own, are in K as if they held fast."""

    mass: Float[Array, "n n"]
    damping: Float[Array, "n n"]
    stiffness: Float[Array, "n n"]


@guarded()
def matrices(vehicle: Vehicle, speed: Scalar) -> Matrices:
    """M, C, K of eq. (2) at a speed (m/s), out of the same functions: K = -M E_21, C = -M E_22."""
    n = size(vehicle)
    matrix = state_matrix(vehicle, speed)
    ones = {name: jnp.ones_like(group) for name, group in split(vehicle, matrix[:n, 0]).items()}
    diagonal = jnp.concatenate(join(vehicle, {name: inertias(vehicle)[name] * one for name, one in ones.items()}))
    mass = jnp.diag(diagonal)
    below = slice(n, 2 * n)
    return Matrices(mass, -mass @ matrix[below, below], -mass @ matrix[below, :n])
