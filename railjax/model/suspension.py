"""Force laws of the elements that a vehicle may have or not: blow-off valves, yaw dampers, bump stops.

Pure functions of deflections and rates, shape (n, *lanes); forces are positive along the deflection, as a spring's. Each
law has the corners of the vehicle's contact law: "sharp", "smooth" (rounded within the part's width) or "linear" (without
corners: the slope at rest goes on).
"""

import dataclasses

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..base import smooth
from ..base.typing import Scalar
from .vehicle import BumpStop, LateralDamper, Vehicle, YawDamper

Bogies = Float[Array, "..."]
Valve = YawDamper | LateralDamper


def blow_off_force(law: str, valve: Valve, damping: Scalar, velocity: Bogies) -> Bogies:
    """Force of one damper, N: c v up to the blow-off velocity v_0, c v_0 + c_b (v - v_0) beyond; odd.

    `damping` is c in N s/m, `velocity` in m/s. Without a blow-off velocity c v.
    """
    force = damping * velocity
    if valve.blow_off_velocity is None:
        return force
    over = smooth.beyond(law, velocity, valve.blow_off_velocity, valve.blow_off_width)
    return force - (damping - valve.damping_beyond) * over


def blow_off_velocity(law: str, valve: Valve, damping: Scalar, force: Bogies) -> Bogies:
    """The inverse, v(F) in m/s: F/c up to F_0 = c v_0, v_0 + (F - F_0)/c_b beyond; needs c and c_b above zero.

    The smooth twin is rounded in F, within c times the width.
    """
    velocity = force / damping
    if valve.blow_off_velocity is None:
        return velocity
    over = smooth.beyond(law, force, damping * valve.blow_off_velocity, damping * valve.blow_off_width)
    return velocity + (1.0 / valve.damping_beyond - 1.0 / damping) * over


def yaw_damper_states(vehicle: Vehicle) -> int:
    """Internal states of the yaw dampers per bogie: the dashpot's elongation if a stiffness is in series, else none."""
    return int(vehicle.yaw_damper is not None and vehicle.yaw_damper.series_stiffness is not None)


def yaw_damper_force(law: str, damper: YawDamper, stretch: Bogies, rate: Bogies, elongation: Bogies) -> tuple[Bogies, Bogies]:
    """Force of a bogie's two yaw dampers, N, and the rate of the internal states.

    `stretch` d = d_y (psi_c - psi_b) in m. Rigidly held: twice `blow_off_force` of d'. With a series stiffness k (Maxwell
    element) the spring passes on k (d - s) and the dashpot, elongated by s, yields at the velocity of that force:
    s' = v(k (d - s)). `elongation` is s, shape (1, n, *lanes), or empty, (0, n, *lanes).
    """
    if damper.series_stiffness is None:
        return 2.0 * blow_off_force(law, damper, damper.damping, rate), elongation
    force = damper.series_stiffness * (stretch - elongation)
    return 2.0 * force[0], blow_off_velocity(law, damper, damper.damping, force)


def bump_stop_force(law: str, stop: BumpStop, travel: Bogies) -> Bogies:
    """Force of a bogie's bump stops, N: first slope times the travel, and from each corner on the change of slope there.

    f(d) = k_1 d + sum_i (k_{i+1} - k_i) b(d; d_i), with b the dead band of ±d_i and k_i the slopes of the table.
    """
    corners, forces = (_before_bogies(jnp.asarray(table), travel) for table in (stop.travel, stop.force))
    slopes = _slopes(corners, forces)
    over = smooth.beyond(law, travel[None], corners[:-1], stop.width)
    return slopes[0] * travel + jnp.sum(jnp.diff(slopes, axis=0) * over, axis=0)


def _slopes(travel: Float[Array, "points ..."], force: Float[Array, "points ..."]) -> Float[Array, "points ..."]:
    """Slopes up to each point of the table, the first from (0, 0), N/m."""
    return jnp.diff(force, axis=0, prepend=0.0) / jnp.diff(travel, axis=0, prepend=0.0)


def _before_bogies(table: Float[Array, "points *lanes"], like: Bogies) -> Float[Array, "points 1 ..."]:
    """A table with an axis for the bogies (and the lanes that it has none of) behind that of its points."""
    points, *lanes = table.shape
    return table.reshape((points, *(1,) * (like.ndim - len(lanes)), *lanes))


def extremes(vehicle: Vehicle) -> list[Vehicle]:
    """The vehicle at rest and with its corners passed, all linear at rest: what bounds the rates of a run.

    Beyond blow-off a dashpot in series with a stiffness yields at the rate k/c_b instead of k/c; a bump stop in contact is
    as stiff as its steepest slope.
    """
    found = [vehicle]
    yaw, stop = vehicle.yaw_damper, vehicle.bump_stop
    if yaw_damper_states(vehicle) and yaw.blow_off_velocity is not None:
        blown = dataclasses.replace(yaw, damping=yaw.damping_beyond, blow_off_velocity=None, damping_beyond=None)  # type: ignore[type-var]
        found += [dataclasses.replace(one, yaw_damper=blown) for one in found]
    if stop is not None:
        travel, force = jnp.asarray(stop.travel), jnp.asarray(stop.force)
        steepest = jnp.max(_slopes(travel, force), axis=0, keepdims=True)
        pressed = dataclasses.replace(stop, travel=jnp.ones_like(steepest), force=steepest)
        found += [dataclasses.replace(one, bump_stop=pressed) for one in found]
    return found
