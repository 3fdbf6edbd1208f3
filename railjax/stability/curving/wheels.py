"""What the wheels do in a curve: guiding forces, loads, creep forces and wear of each, read off the vehicle's `Motion`.

Wheelsets are one axis, front first; wheels the next one: the left, which is the outer one in a right-hand curve, then the right.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from ...model.contact.creep import creep_forces
from ...model.contact.profile_contact import guiding_forces, roll_moment, wheel_loads
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

    The wheels' loads change with the roll moment M that the suspension passes on and that of the lateral forces at the height of the axle,
    r_0: dQ = (M + r_0 ΣY)/(2 e) to the left. T gamma = T_x xi_x + T_y xi_y, without the spin's moment.

    Without profiles the flange's force is that of the wheel whose flange it is, and all other lateral forces are shared alike. With them each
    contact plane, inclined by delta, gives Y = T_y/cos delta ± Q tan delta; what the rails' own stiffness adds is the leaning wheel's.
    """
    vehicle, contact, creepage = instant.vehicle, instant.contact, instant.creepage
    if instant.wheels is None:
        along, across = (jnp.stack([part, part]) for part in creep_forces(vehicle, creepage, contact.saturation))
        slip = jnp.stack([creepage.lateral, creepage.lateral])
        springs = suspension_forces(vehicle, instant.deflection, instant.deflection_rate)
        load = wheel_loads(vehicle, contact.lateral, roll_moment(vehicle, springs, contact.lateral))
    else:
        along, across = instant.wheels.longitudinal_force, instant.wheels.lateral_force
        slip = instant.wheels.lateral
        load, outwards = guiding_forces(vehicle, contact, instant.wheels)
    signs = jnp.array([1.0, -1.0], load.dtype).reshape((2,) + (1,) * (load.ndim - 1))
    if instant.wheels is None:
        guiding = -0.5 * (contact.lateral - contact.flange) - signs * jnp.maximum(signs * contact.flange, 0.0)
    else:
        guiding = -signs * outwards
        rest = -contact.lateral - jnp.sum(guiding, axis=0)
        guiding = guiding + jnp.where(signs * contact.flange > 0.0, rest, 0.0)
    # a wheel that has lifted guides nothing
    quotient = -signs * guiding / jnp.where(load > 0.0, load, jnp.inf)
    wear = along * creepage.longitudinal + across * slip
    return WheelForces(*map(_left_first, (guiding, load, signs * along, -across, wear, quotient)))


def _left_first(wheels: Float[Array, "2 n m *lanes"]) -> Wheels:
    return jnp.stack([in_a_row(wheels[1]), in_a_row(wheels[0])], axis=1)


def in_a_row(values: Float[Array, "n m *lanes"]) -> Wheelsets:
    """Wheelsets as one axis, front first."""
    return values.reshape((-1, *values.shape[2:]))
