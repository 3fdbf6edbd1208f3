"""Contact of wheelsets on rails with profiles: creepages and creep forces of each wheel, the forces of the inclined normals, wheel loads.

Signs as in `creep`: forces are resistances, positive along the deflection. Wheels are the leading axis, (right, left). The functions of y
stand in the table of the vehicle's `Profiles`; only its rows are read here, no contact is looked for.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...base import smooth
from ...base.compilation import fence
from ...base.typing import Scalar
from ..vehicle import Profiles, Vehicle
from .creep import ContactForce, Creepage, saturation_factor

Wheelsets = Float[Array, "..."]
Wheels = Float[Array, "..."]

#: functions of a table, in the order of its rows' last axis; those of wheels for the right and then for the left one
SHARED = ("radius", "normal", "acting", "roll")
OF_WHEEL = ("moved", "sine", "secant", "longitudinal", "lateral", "lateral_spin", "spin")
# 18: XLA makes vectors of a row of so many, which of 12 or 16 it does not
FUNCTIONS = len(SHARED) + 2 * len(OF_WHEEL)

ROLL = SHARED.index("roll")

#: share of the static load below which no wheel comes, and above which none, as far as creep forces go
LEAST_LOAD, MOST_LOAD = 0.05, 1.95
#: of its load without creep forces that the normal force is divided by at least, as where climbing jams
LEAST_SHARE = 0.5


class ContactAt(NamedTuple):
    """What the contact is where the wheelsets are."""

    radius: Wheelsets  # (r_R - r_L)/2, m
    normal: Wheelsets  # lateral resistance of the normal forces over the axle load: what lifts the wheelset
    acting: Wheelsets  # share of lateral creep forces that acts on y: 1 + r_0 roll' on rails that do not give way
    roll: Wheelsets  # from that at rest, rad, right side up
    moved: Wheels  # lateral way of the wheel's surface over its rail by dy: 1 - u' + r_0 roll'
    sine: Wheels  # sin of the contact angle, positive where the wheel rises towards its flange
    secant: Wheels  # 1/cos of it
    longitudinal: Wheels  # Kalker's f_11 of a wheel, N
    lateral: Wheels  # f_33, N
    lateral_spin: Wheels  # f_12, N m
    spin: Wheels  # f_22, N m^2


class OfWheels(NamedTuple):
    """What is known of each wheel beside the wheelset's `ContactForce`, (2, n, m, *lanes); the last, of wheelsets, is (n, m, *lanes)."""

    lateral: Wheels  # creepage xi_y
    spin: Wheels  # xi_s, 1/m
    longitudinal_force: Wheels  # resistance to xi_x, N
    lateral_force: Wheels  # resistance to xi_y in the plane of the contact, N
    tangent: Wheels  # tan of the contact angle
    rolled: Wheelsets  # roll moment of the suspension on the wheelset, N m


def contact_at(profiles: Profiles, y: Wheelsets) -> ContactAt:
    """The functions at displacements y (m) on the track, (n, m, *lanes); beyond the table's ends those of the ends."""
    count = jnp.shape(profiles.rows)[0]
    # not within an interval, at whose ends the derivative of `clip` is halved
    place = jnp.clip((y - profiles.start) / profiles.step, 0.0, float(count))
    index = jnp.clip(jnp.floor(place), 0.0, count - 1.0)
    within = place - index
    read = _shared if jnp.ndim(profiles.rows) == 3 else _of_lanes
    values = read(profiles.rows, index.astype(jnp.int32), within)
    of = jnp.moveaxis(values, -1, 0)
    first = len(SHARED)
    wheels = of[first:].reshape((len(OF_WHEEL), 2, *of.shape[1:]))
    return ContactAt(*(of[k] for k in range(first)), *(wheels[k] for k in range(len(OF_WHEEL))))


def seated(vehicle: Vehicle, y_rel: Wheelsets, y_rate: Wheelsets) -> tuple[ContactAt, Wheelsets, Wheelsets]:
    """The contact at y on the track, and the roll that it gives the wheelsets and its rate, rad and rad/s.

    Args:
        vehicle: one with `profiles`
        y_rel: displacements on the track, m, (n, m, *lanes)
        y_rate: m/s; the track's own slope plays no part in the roll
    """
    linear = vehicle.contact.law == "linear"
    at = contact_at(vehicle.profiles, _tangent_at(vehicle, y_rel) if linear else y_rel)
    slope = roll_slope(vehicle, at)
    return at, slope * y_rel if linear else at.roll, slope * y_rate


def roll_slope(vehicle: Vehicle, at: ContactAt) -> Wheelsets:
    """d roll/dy, rad/m: on rigid rails it is (acting - 1)/r_0, times what is left of dy when the rail has given way, which the ways of both
    wheels over their rails say together. (Reading it from the table takes a third of a run's time.)"""
    rigid = at.acting - 1.0
    return rigid / vehicle.wheelset.wheel_radius * (_both(at.moved) - 1.0) / (1.0 + 2.0 * rigid)


def _tangent_at(vehicle: Vehicle, like: Wheelsets) -> Wheelsets:
    """Where the law "linear" is the tangent of the contact: at rest; with a negative clearance at the flange held in contact."""
    profiles = vehicle.profiles
    flange = jnp.asarray(vehicle.contact.flange_clearance) < 0.0
    return jnp.zeros_like(like) + jnp.where(flange, profiles.steepest, profiles.rest)


@fence
def _shared(rows: Array, index: Array, within: Array) -> Array:
    """One slice a wheelset; functions last, so that a row lies in one piece."""
    found = rows.reshape(rows.shape[0], -1).at[index].get(mode="promise_in_bounds")
    return _cubic(found.reshape((*index.shape, *rows.shape[1:])), within)


def _of_lanes(rows: Array, index: Array, within: Array) -> Array:
    """Each lane has a table of its own, on the last axis."""
    lanes = jnp.arange(rows.shape[-1])
    return _cubic(jnp.moveaxis(rows, -1, 1).at[index, lanes].get(mode="promise_in_bounds"), within)


def _cubic(row: Array, within: Array) -> Array:
    t = within[..., None]
    return row[..., 0, :] + t * (row[..., 1, :] + t * (row[..., 2, :] + t * row[..., 3, :]))


class _Seen(NamedTuple):
    """What the contact of a wheelset depends on."""

    y: Wheelsets  # m, on the track
    psi: Wheelsets  # rad
    drift: Wheelsets  # y'/v
    turn: Wheelsets  # psi'/v, 1/m, with a curve's curvature
    guided: Wheelsets  # lateral force of the primary suspension on the wheelset, N
    rolled: Wheelsets  # its roll moment, N m, right side up


def profile_contact(
    vehicle: Vehicle,
    slowness: Scalar,
    at: ContactAt,
    y_rel: Wheelsets,
    psi: Wheelsets,
    y_rate: Wheelsets,
    turning: Wheelsets,
    suspension: dict[str, Float[Array, "..."]],
) -> tuple[Creepage, ContactForce, OfWheels]:
    """Creep of each wheel, the normals' lateral force and yaw moment, and the rail beyond the last contact.

    With roll' and the sine of the contact angle delta as functions of y, upper signs on the right:

        xi_x = ±(e psi'/v + (r_R - r_L)/(2 r_0)),  xi_y = ((1 - u' + r_0 roll') y'/v - psi)/cos delta,  xi_s = psi'/v ∓ sin delta/r_0

    where u' is how far the rail gives way by dy. Kalker's forces f_11 xi_x and f_33 xi_y + f_12 xi_s are saturated together per wheel at mu N
    (Shen, Hedrick and Elkins). The normal force N follows from the wheel's load Q_s and what creep carries of it, Q_s from the moments about
    the wheelset's axis. By virtual work lateral creep forces T act on y with (1 + r_0 roll')T/cos delta, roll' of rigid rails, which contains
    what the load that they transfer does to the normals; these resist with W d(rise)/dy on y, and on psi with
    -e psi (Q_R tan delta_R + Q_L tan delta_L). So does the roll moment M of the primary springs, which is -M roll' of y's resistance.

    The contact law "linear" is the tangent of all that at rest.

    Args:
        vehicle: one with `profiles`
        slowness: 1/v, s/m
        at: as `seated` finds it
        y_rel: displacements on the track, m, (n, m, *lanes)
        psi: yaw, rad
        y_rate: m/s
        turning: psi', rad/s, in a curve with v times its curvature
        suspension: forces of the primary suspension, by the names of their deflections
    """
    guided = suspension["primary_y"]
    rolled = roll_moment(vehicle, suspension, guided)
    seen = _Seen(y_rel, psi, y_rate * slowness, turning * slowness, guided, rolled)
    if vehicle.contact.law != "linear":
        return _forces(vehicle, slowness, at, seen)

    def anywhere(seen: _Seen) -> tuple[Creepage, ContactForce, OfWheels]:
        return _forces(vehicle, slowness, contact_at(vehicle.profiles, seen.y), seen)

    still = jax.tree.map(jnp.zeros_like, seen)._replace(y=_tangent_at(vehicle, y_rel))
    return jax.jvp(anywhere, (still,), (seen,))[1]


def roll_moment(vehicle: Vehicle, suspension: dict[str, Float[Array, "..."]], like: Wheelsets) -> Wheelsets:
    """Roll moment of the primary springs on each wheelset, N m, right side up, shaped as `like`; none where the bogie is held.

    Args:
        vehicle: for its geometry
        suspension: forces of the primary suspension, N, by the names of their deflections
        like: an array with an entry per wheelset; its values do not matter, dimensionless
    """
    still = jnp.zeros_like(like)
    if "primary_z" not in suspension:
        return still
    share = vehicle.geometry.half_primary / len(vehicle.geometry.axle_pattern)
    return still + share * suspension["primary_z"][:, None]


def wheel_loads(vehicle: Vehicle, lateral: Wheelsets, rolled: Wheelsets) -> Wheels:
    """Q_R and Q_L, N: e (Q_R - Q_L) = r_0 F - M with the lateral force F that the rails carry and the suspension's roll moment M."""
    transfer = (vehicle.wheelset.wheel_radius * lateral - rolled) / (2.0 * vehicle.geometry.half_gauge)
    return vehicle.contact.wheel_load + _signs(lateral) * transfer


def guiding_forces(vehicle: Vehicle, force: ContactForce, wheels: OfWheels | None) -> tuple[Wheels, Wheels]:
    """Q and Y of each wheel on its rail, N, (2, n, m, *lanes); Y is positive outwards, to the field side.

    Q holds the roll against the lateral force that the wheelset, its inertia included, has on the rails: Y_R = T_R/cos delta_R + Q_R tan
    delta_R of the creep force T that acts in the plane of the contact, and on the left likewise outwards.
    """
    assert wheels is not None
    load, signs = wheel_loads(vehicle, force.lateral, wheels.rolled), _signs(force.lateral)
    return load, signs * wheels.lateral_force * jnp.sqrt(1.0 + wheels.tangent**2) + load * wheels.tangent


def _signs(like: Wheelsets) -> Wheels:
    """1 for the right wheel, -1 for the left one, before the axes of wheelsets."""
    return jnp.asarray(np.array([1.0, -1.0]).reshape((2,) + (1,) * like.ndim), like.dtype)


def _forces(vehicle: Vehicle, slowness: Scalar, at: ContactAt, seen: _Seen) -> tuple[Creepage, ContactForce, OfWheels]:
    contact, half_gauge, radius = vehicle.contact, vehicle.geometry.half_gauge, vehicle.wheelset.wheel_radius
    signs = _signs(seen.y)
    tangent = at.sine * at.secant
    across = (at.moved * seen.drift - seen.psi) * at.secant
    spin = seen.turn - signs * at.sine / radius
    along = half_gauge * seen.turn + at.radius / radius
    longitudinal = at.longitudinal * along
    lateral = at.lateral * across + at.lateral_spin * spin

    load = contact.wheel_load
    loads = jnp.clip(wheel_loads(vehicle, seen.guided, seen.rolled), LEAST_LOAD * load, MOST_LOAD * load)
    normal = loads * at.secant
    most = contact.friction * normal
    u, factor = _saturated(_norm(vehicle, (longitudinal**2 + lateral**2) / most**2))
    # creep forces on inclined contacts carry some of the load, and are as the normal force is
    factor = factor / jnp.maximum(1.0 - signs * factor * lateral / normal * tangent, LEAST_SHARE)
    longitudinal, lateral = factor * longitudinal, factor * lateral
    turned = factor * (at.spin * spin - at.lateral_spin * across) - half_gauge * seen.psi * (loads * tangent)
    # the springs' moment by the roll on rails that do not give way, as creep forces
    lifting = seen.rolled * ((at.acting - 1.0) / radius)
    guiding = 2.0 * load * at.normal - lifting + contact.flange_stiffness * _beyond(vehicle, seen.y)
    force, moment = at.acting * _both(at.secant * lateral) + guiding, _both(half_gauge * longitudinal + turned)
    if vehicle.gyroscopic:
        # the spin v/r_0 turns with the roll, as in `motion.gyroscopic_coupling`
        coupled = vehicle.wheelset.spin_inertia / (slowness**2 * radius) * roll_slope(vehicle, at)
        force, moment = force - coupled * seen.turn, moment + coupled * seen.drift
    return (
        Creepage(along, seen.drift - seen.psi, seen.turn),
        ContactForce(force, moment, guiding, jnp.max(u, axis=0)),
        OfWheels(across, spin, longitudinal, lateral, tangent, seen.rolled),
    )


def _both(wheels: Wheels) -> Wheelsets:
    return wheels[0] + wheels[1]


def _norm(vehicle: Vehicle, square: Wheels) -> Wheels:
    if vehicle.contact.law == "smooth":
        return smooth.smooth_norm(square, vehicle.contact.creep_width)
    return smooth.sqrt_of_square(square)


@fence
def _saturated(u: Wheels) -> tuple[Wheels, Wheels]:
    """u and the factor of each wheel, once for all that depends on them."""
    return u, saturation_factor(u)


def _beyond(vehicle: Vehicle, y: Wheelsets) -> Wheelsets:
    """How far beyond the last contact, m; of a tangent none, as the table has the flange's stiffness."""
    law = vehicle.contact.law
    if law == "linear":
        return jnp.zeros_like(y)
    return smooth.beyond(law, y, vehicle.profiles.last, vehicle.contact.flange_width)
