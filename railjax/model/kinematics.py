"""Coordinates and linear kinematics: how far each element is deflected. The only place where geometry enters.

Order of q: car body y_c, psi_c, phi_c; bogies y_b (n), psi_b (n), phi_b (n); wheelsets y (n·m), psi (n·m), leading ones
first; coordinates of held bodies are left out. A state is x = [q, q', internal states of the secondary lateral dampers (k·n),
elongations of the yaw dampers' dashpots (n)], along the leading axis; any trailing axes are lanes of a batch.
"""

import math
from collections.abc import Callable, Mapping

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..base.typing import Scalar
from .vehicle import Vehicle

#: coordinates by name; car body (*lanes), bogies (n, *lanes), wheelsets (n, m, *lanes)
Groups = dict[str, Float[Array, "..."]]

#: group of coordinates -> unit
UNITS = {
    "carbody_y": "m",
    "carbody_psi": "rad",
    "carbody_phi": "rad",
    "bogie_y": "m",
    "bogie_psi": "rad",
    "bogie_phi": "rad",
    "wheelset_y": "m",
    "wheelset_psi": "rad",
}


def layout(vehicle: Vehicle) -> dict[str, tuple[int, ...]]:
    """Shape of each group of free coordinates, in the order of q."""
    n, m = len(vehicle.geometry.bogie_pattern), len(vehicle.geometry.axle_pattern)
    shapes: dict[str, tuple[int, ...]] = {}
    if not vehicle.carbody.held:
        shapes |= {name: () for name in UNITS if name.startswith("carbody")}
    if not vehicle.bogie.held:
        shapes |= {name: (n,) for name in UNITS if name.startswith("bogie")}
    return shapes | {name: (n, m) for name in UNITS if name.startswith("wheelset")}


def size(vehicle: Vehicle) -> int:
    """Number of coordinates: 17 for the coach."""
    return sum(math.prod(shape) for shape in layout(vehicle).values())


def split(vehicle: Vehicle, q: Float[Array, "n *lanes"]) -> Groups:
    """The flat vector q by groups."""
    shapes = layout(vehicle)
    # `lax.split`, because its transpose is one concatenation where slices would give a padded sum each
    pieces = jax.lax.split(q, [math.prod(shape) for shape in shapes.values()])
    return {name: piece.reshape(shape + q.shape[1:]) for (name, shape), piece in zip(shapes.items(), pieces, strict=True)}


def join(vehicle: Vehicle, groups: Mapping[str, Float[Array | np.ndarray, "..."]]) -> list[Float[Array | np.ndarray, "..."]]:
    """The groups as flat pieces in the order of q, to be concatenated once."""
    pieces = []
    for name, shape in layout(vehicle).items():
        lanes = groups[name].shape[len(shape) :]
        pieces.append(groups[name].reshape((math.prod(shape), *lanes)))
    return pieces


def labels(vehicle: Vehicle) -> list[str]:
    """A name for every coordinate, in the order of q: carbody_y, ..., wheelset_y[3]."""
    names = []
    for name, shape in layout(vehicle).items():
        count = math.prod(shape)
        names += [name] if not shape else [f"{name}[{i}]" for i in range(count)]
    return names


def _along(pattern: tuple[float, ...], like: Float[Array, "..."], axes: int) -> Float[Array, "..."]:
    """A static pattern as a column before `axes` trailing axes, in the dtype of `like`."""
    return jnp.asarray(np.asarray(pattern).reshape((-1,) + (1,) * axes), like.dtype)


def bogie_positions(vehicle: Vehicle, like: Float[Array, "n m *lanes"]) -> Float[Array, "n *#lanes"]:
    """x_j = ±l, longitudinal positions of the bogies ahead of the car body's centre, m."""
    return _along(vehicle.geometry.bogie_pattern, like, like.ndim - 2) * vehicle.geometry.half_pivot_distance


def axle_positions(vehicle: Vehicle, like: Float[Array, "n m *lanes"]) -> Float[Array, "m *#lanes"]:
    """±a, longitudinal positions of the axles ahead of their bogie's centre, m."""
    return _along(vehicle.geometry.axle_pattern, like, like.ndim - 2) * vehicle.geometry.half_wheelbase


def wheelset_positions(vehicle: Vehicle, like: Float[Array, "n m *lanes"]) -> Float[Array, "n m *#lanes"]:
    """s_i = ±l ± a, longitudinal positions of the wheelsets ahead of the car body's centre, m."""
    return bogie_positions(vehicle, like)[:, None] + axle_positions(vehicle, like)


def has_own_heights(vehicle: Vehicle) -> bool:
    """Whether the secondary lateral dampers have points, and so a deflection, apart from the springs'."""
    damper = vehicle.lateral_damper
    return damper is not None and not (damper.carbody_height is None and damper.bogie_to_damper is None)


def lateral_of_carbody(q: Groups, along: Float[Array, "..."] | float, below: Scalar) -> Float[Array, "..."]:
    """y_c + h phi_c + x psi_c, the lateral motion of the car body's point x = `along` (m) ahead of its centre and h = `below`
    (m) under it: a displacement, a velocity or an acceleration, as `q` is."""
    return q["carbody_y"] + below * q["carbody_phi"] + along * q["carbody_psi"]


#: m; assumed for vehicles without `carbody_to_floor`: a coach's centre of gravity 1.8 m above the rail, its floor 1.2 m
CARBODY_TO_FLOOR = 0.6

#: points of the floor at which comfort is measured (EN 12299)
FLOOR_POINTS = ("leading bogie", "centre", "trailing bogie")


def is_one_stage(vehicle: Vehicle) -> bool:
    """Whether the vehicle is one body on wheelsets, as a two-axle wagon: its only "bogie", under a held car body."""
    return vehicle.carbody.held and not vehicle.bogie.held and len(vehicle.geometry.bogie_pattern) == 1


def lateral_of_floor(vehicle: Vehicle, q: Groups) -> Float[Array, "points *lanes"]:
    """Lateral motion of the floor over the leading bogie, in the centre and over the trailing bogie; of a vehicle with one stage of
    suspension, whose only "bogie" is its body, over the leading axle, in the centre and over the trailing axle."""
    geometry = vehicle.geometry
    if is_one_stage(vehicle):
        first, *_, last = (*geometry.axle_pattern, geometry.axle_pattern[-1])
        q = {f"carbody_{name}": q[f"bogie_{name}"][0] for name in ("y", "psi", "phi")}
        spread = geometry.half_wheelbase
    else:
        first, *_, last = (*geometry.bogie_pattern, geometry.bogie_pattern[-1])
        spread = geometry.half_pivot_distance
    below = CARBODY_TO_FLOOR if geometry.carbody_to_floor is None else geometry.carbody_to_floor
    along = _along((first, 0.0, last), q["carbody_y"], q["carbody_y"].ndim) * spread
    return lateral_of_carbody(q, along, below)


def deflections(vehicle: Vehicle, q: Groups) -> Groups:
    """Deflection of every element, linear in q (eq. 7 and its like); of q' it gives the rates.

    Secondary suspension (n): lateral  y_c + h_cc phi_c + x_j psi_c - y_b + h_cb phi_b,
                              longitudinal  d_c (psi_c - psi_b),  vertical  d_c (phi_c - phi_b).
    Where the vehicle has them (n): vertical damper  d_v (phi_c - phi_b),  yaw damper  d_y (psi_c - psi_b),  lateral damper as
    the secondary lateral one with heights h_cd and h_bd.
    Primary (n, m): lateral  y_b + x_k psi_b + h_ob phi_b - y,  longitudinal  d_o (psi_b - psi);  vertical (n)  d_o phi_b.
    Cross bracing (n): shear  y_1 - y_2 - a (psi_1 + psi_2),  bending  psi_1 - psi_2.
    Contact (n, m): y and psi of the wheelset on the track. Their roll, on profiles and with the rails of a curve's ramp, is no coordinate
    but given as "wheelset_phi": then the primary vertical deflection is  d_o (phi_b - mean of these).
    """
    geometry, rails_phi = vehicle.geometry, q.get("wheelset_phi")
    y, psi = q["wheelset_y"], q["wheelset_psi"]
    still = jnp.zeros(y.shape[:1] + y.shape[2:], y.dtype)
    q = {name: q.get(name, still) for name in UNITS} | {"wheelset_y": y, "wheelset_psi": psi}
    carbody_psi, carbody_phi, bogie_y, bogie_psi, bogie_phi = (
        q[name] for name in ("carbody_psi", "carbody_phi", "bogie_y", "bogie_psi", "bogie_phi")
    )
    deflection = {"contact_y": y, "contact_psi": psi}
    if not vehicle.carbody.held or not vehicle.bogie.held:
        lateral_carbody = lateral_of_carbody(q, bogie_positions(vehicle, y), geometry.carbody_height)
        deflection |= {
            "secondary_y": lateral_carbody - bogie_y + geometry.bogie_to_secondary * bogie_phi,
            "secondary_x": geometry.half_secondary * (carbody_psi - bogie_psi),
            "secondary_z": geometry.half_secondary * (carbody_phi - bogie_phi),
        }
        if geometry.half_vertical_damper is not None:
            deflection["vertical_damper"] = geometry.half_vertical_damper * (carbody_phi - bogie_phi)
        if vehicle.yaw_damper is not None:
            deflection["yaw_damper"] = vehicle.yaw_damper.half_distance * (carbody_psi - bogie_psi)
        if has_own_heights(vehicle):
            above, below = vehicle.lateral_damper.carbody_height, vehicle.lateral_damper.bogie_to_damper
            above = geometry.carbody_height if above is None else above
            below = geometry.bogie_to_secondary if below is None else below
            lateral_carbody = lateral_of_carbody(q, bogie_positions(vehicle, y), above)
            deflection["lateral_damper"] = lateral_carbody - bogie_y + below * bogie_phi
    if not vehicle.bogie.held:
        rolled = bogie_phi if rails_phi is None else bogie_phi - jnp.mean(rails_phi, axis=1)
        deflection["primary_z"] = geometry.half_primary * rolled
    lateral_bogie = bogie_y + geometry.bogie_to_primary * bogie_phi
    deflection["primary_y"] = lateral_bogie[:, None] + axle_positions(vehicle, y) * bogie_psi[:, None] - y
    deflection["primary_x"] = geometry.half_primary * (bogie_psi[:, None] - psi)
    if vehicle.cross_bracing is not None:
        first, last = axle_positions(vehicle, y)
        deflection["bracing_shear"] = y[:, 0] - y[:, 1] - 0.5 * (first - last) * (psi[:, 0] + psi[:, 1])
        deflection["bracing_bending"] = psi[:, 0] - psi[:, 1]
    return deflection


def transposed(vehicle: Vehicle, q: Groups) -> Callable[[Groups], Groups]:
    """Virtual work: the map from element forces f to generalised forces G^T f, with G = d(deflections)/dq."""

    def generalised(forces: Groups) -> Groups:
        (groups,) = jax.linear_transpose(lambda groups: deflections(vehicle, groups), q)(forces)
        return groups

    return generalised


def damper_point(deflection: Groups) -> str:
    """Which deflection is that of the secondary lateral dampers: their own, if they have heights of their own."""
    return "lateral_damper" if "lateral_damper" in deflection else "secondary_y"


def heights(vehicle: Vehicle) -> dict[str, Scalar]:
    """Of the bodies' centres above the rails, m: the primary springs are taken to act at the height of the axles."""
    geometry = vehicle.geometry
    bogie = vehicle.wheelset.wheel_radius + geometry.bogie_to_primary
    return {
        "carbody": bogie + geometry.bogie_to_secondary + geometry.carbody_height,
        "bogie": bogie,
        "wheelset": vehicle.wheelset.wheel_radius,
    }


def of_carbody(vehicle: Vehicle, groups: Groups) -> Float[Array, "n *lanes"]:
    """The car body's share of the secondary lateral dampers' deflection (or of its rate): its own motion at their upper ends."""
    deflection = deflections(vehicle, {name: value for name, value in groups.items() if not name.startswith("bogie")})
    return deflection[damper_point(deflection)]
