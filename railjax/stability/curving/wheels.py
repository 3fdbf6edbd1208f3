"""What the wheels do in a curve: guiding forces, loads, creep forces and wear of each, read off the vehicle's `Motion`.

Wheelsets are one axis, front first; wheels the next one: the left, which is the outer one in a right-hand curve, then the right.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from ...model.contact.creep import creep_forces
from ...model.motion import Motion, suspension_forces

Wheelsets = Float[Array, "wheelsets *lanes"]
Wheels = Float[Array, "wheelsets 2 *lanes"]


class WheelForces(NamedTuple):
    """Forces on the wheels, N; lateral ones are positive to the right, longitudinal ones forwards."""

    guiding: Wheels
    load: Wheels
    longitudinal_creep: Wheels
    lateral_creep: Wheels
    wear: Wheels  # T gamma
    y_over_q: Wheels  # positive where the wheel presses its rail outwards


def wheel_forces(instant: Motion) -> WheelForces:
    """Of each wheel at an instant of steady running.

    The flange's force is that of the wheel whose flange it is, all other lateral forces are shared alike. The wheels' loads change with
    the moment that the primary springs pass on and that of the lateral forces at the height of the axle, r_0:
    dQ = (M_phi/m + r_0 ΣY)/(2 e) to the left. T gamma = T_x xi_x + T_y xi_y, without the spin's moment.
    """
    vehicle, contact, creepage = instant.vehicle, instant.contact, instant.creepage
    flange = contact.flange
    shared = -0.5 * (contact.lateral - flange)
    guiding = _wheels(shared - jnp.minimum(flange, 0.0), shared - jnp.maximum(flange, 0.0))
    along, across = creep_forces(vehicle, creepage, contact.saturation)
    wear = along * creepage.longitudinal + across * creepage.lateral
    transfer = vehicle.wheelset.wheel_radius * -contact.lateral
    if "primary_z" in instant.deflection:
        springs = suspension_forces(vehicle, instant.deflection, instant.deflection_rate)["primary_z"]
        transfer = transfer + (vehicle.geometry.half_primary * springs / contact.lateral.shape[1])[:, None]
    transfer = transfer / (2.0 * vehicle.geometry.half_gauge)
    load = _wheels(vehicle.contact.wheel_load + transfer, vehicle.contact.wheel_load - transfer)
    outwards = guiding * jnp.array([1.0, -1.0], guiding.dtype).reshape((2,) + (1,) * (guiding.ndim - 2))
    # a wheel that has lifted guides nothing
    quotient = outwards / jnp.where(load > 0.0, load, jnp.inf)
    return WheelForces(guiding, load, _wheels(-along, along), _wheels(-across, -across), _wheels(wear, wear), quotient)


def in_a_row(values: Float[Array, "n m *lanes"]) -> Wheelsets:
    """Wheelsets as one axis, front first."""
    return values.reshape((-1, *values.shape[2:]))


def _wheels(left: Float[Array, "n m *lanes"], right: Float[Array, "n m *lanes"]) -> Wheels:
    return jnp.stack([in_a_row(left), in_a_row(right)], axis=1)
