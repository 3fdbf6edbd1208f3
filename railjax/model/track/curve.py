"""What a curve does to a vehicle at an instant: curvature under the wheelsets, where the line lies under each body, how it accelerates.

Right-hand curve: curvature kappa > 0, y to the right (inwards), cant angle theta > 0 (inner rail lower). Each body's coordinates are
those in the frame of the line at its own place. `motion` adds three things: kappa to psi'/v of each wheelset; to the deflections, which
are linear in all that moves, those of the line's own differences between these places; and the line's acceleration to the inertia of
each body.
"""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...base.fields import parameter, table
from ...base.typing import Number, Scalar
from ..kinematics import Groups, bogie_positions, deflections, wheelset_positions
from ..vehicle import Vehicle

#: m/s², as rules on cant take it
GRAVITY = 9.81

#: m; distance of the rails over which cant is measured: theta = cant/1.5 m
CANT_BASE = 1.5


def cant_in_balance(speed: Any, radius: Any) -> Any:
    """The cant (m) at which an arc of `radius` (m) leaves no lateral acceleration at a `speed` (m/s): 1.5 m v²/(g R)."""
    return CANT_BASE / GRAVITY * speed**2 / abs(radius)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Curve:
    """The line under a vehicle, by groups of coordinates as `kinematics` names them, seen from its frame at the car body's centre.

    Groups that are not there are zero: a coordinate of the line, its rate or its acceleration. `rate` is None in an arc.
    """

    curvature: Float[Array, "n m *lanes"]  # kappa under each wheelset, 1/m
    place: Groups  # of the line at each body: y m, psi and phi rad; "wheelset_phi" is the roll of the rails
    acceleration: Groups  # v² kappa - g theta and what a ramp adds, m/s²; yaw and roll, rad/s²
    rate: Groups | None = None  # of `place`, m/s and rad/s

    def added(self, vehicle: Vehicle, deflection: Groups, rate: Groups) -> tuple[Groups, Groups]:
        """Deflections and their rates with the line's own; a wheelset's on its rails stay as they are."""
        found = _with_line(vehicle, deflection, self.place, self.curvature)
        return found, rate if self.rate is None else _with_line(vehicle, rate, self.rate, self.curvature)


def _with_line(vehicle: Vehicle, deflection: Groups, line: Groups, like: Float[Array, "n m *lanes"]) -> Groups:
    still = jnp.zeros_like(like)
    of_line = deflections(vehicle, {"wheelset_y": still, "wheelset_psi": still} | line)
    return {name: value if name.startswith("contact") else value + of_line[name] for name, value in deflection.items()}


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class BalancedArc:
    """An arc whose cant follows the speed, so that what is left of the lateral acceleration stays; with the state of steady running in it,
    which then is the same at all speeds."""

    curvature: Number = parameter("1/m", "kappa", "curvature, to the right", signed=True)
    sideways: Number = parameter("m/s^2", "", "v² kappa - g theta", signed=True)
    state: Number = table("1", "x", "state of steady running, SI", signed=True)

    def curve(self, vehicle: Vehicle, like: Float[Array, "n m *lanes"]) -> Curve:
        """The line under the vehicle, with the shapes of `like`."""
        return _arc(vehicle, self.curvature, self.sideways, like)


def arc(vehicle: Vehicle, speed: Scalar, curvature: Scalar, cant_angle: Scalar, like: Float[Array, "n m *lanes"]) -> Curve:
    """An arc of constant curvature and cant: a body at the distance x ahead of the car body's centre finds the line turned by kappa x
    and aside by kappa x²/2.

    Args:
        vehicle: gives the places of its bodies.
        speed: v, m/s.
        curvature: kappa, 1/m, positive to the right.
        cant_angle: theta, rad, positive where the right rail is lower.
        like: an array with an entry per wheelset, and lanes; its values do not matter, dimensionless.

    Returns:
        The curve, with the shapes of `like`; `speed`, `curvature` and `cant_angle` are numbers, or have its lanes.
    """
    return _arc(vehicle, curvature, speed**2 * curvature - GRAVITY * cant_angle, like)


def _arc(vehicle: Vehicle, curvature: Scalar, sideways: Scalar, like: Float[Array, "n m *lanes"]) -> Curve:
    bogies, wheelsets = bogie_positions(vehicle, like), wheelset_positions(vehicle, like)
    place = {
        "bogie_y": 0.5 * curvature * bogies**2,
        "bogie_psi": curvature * bogies,
        "wheelset_y": 0.5 * curvature * wheelsets**2,
        "wheelset_psi": curvature * wheelsets,
    }
    shapes = {"carbody": like.shape[2:], "bogie": (like.shape[0], *like.shape[2:]), "wheelset": like.shape}
    place = {name: jnp.broadcast_to(value, shapes[name.split("_")[0]]) for name, value in place.items()}
    acceleration = {f"{body}_y": jnp.broadcast_to(sideways, shape).astype(like.dtype) for body, shape in shapes.items()}
    return Curve(jnp.broadcast_to(curvature, like.shape).astype(like.dtype), place, acceleration)
