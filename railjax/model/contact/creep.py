"""Wheel-rail contact: creepages, Kalker's linear creep forces, Vermeulen-Johnson saturation, the flange.

Signs: forces returned are the resistance that the contact offers, positive along the deflection, like a spring's.
Both wheels of a wheelset are alike in this model (longitudinal creepage differs in sign only), hence the factor 2.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from ...base import smooth
from ...base.compilation import fence
from ...base.typing import Scalar
from ..vehicle import Contact, Vehicle

Wheelsets = Float[Array, "..."]


class Creepage(NamedTuple):
    """Relative slip of one wheel, dimensionless; spin in 1/m."""

    longitudinal: Wheelsets  # xi_x, of opposite sign on the two wheels
    lateral: Wheelsets  # xi_y
    spin: Wheelsets  # xi_s


class ContactForce(NamedTuple):
    """What the contact does to a wheelset, as resistance: lateral force N, yaw moment N m; and the saturation."""

    lateral: Wheelsets
    yaw: Wheelsets
    flange: Wheelsets  # part of `lateral` that comes from the flange
    saturation: Wheelsets  # u = |F_linear| / (mu Q)


def creepages(
    vehicle: Vehicle,
    slowness: Scalar,
    y_rel: Wheelsets,
    psi: Wheelsets,
    y_rate: Wheelsets,
    psi_rate: Wheelsets,
) -> Creepage:
    """xi_x = e psi'/v + lambda y_rel/r_0,  xi_y = y'/v - psi,  xi_s = psi'/v, with y_rel the displacement on the track, m.

    `slowness` is 1/v in s/m: one reciprocal per run instead of a division per stage.
    """
    spin = psi_rate * slowness
    gain = vehicle.contact.conicity / vehicle.wheelset.wheel_radius
    return Creepage(vehicle.geometry.half_gauge * spin + gain * y_rel, y_rate * slowness - psi, spin)


def saturation_factor(u: Wheelsets) -> Wheelsets:
    """Vermeulen-Johnson without spin: |F|/|F_linear| = 1 - u/3 + u²/27 for u < 3 and 1/u beyond; C2 at u = 3."""
    below = u < 3.0
    # not maximum(u, 3), whose derivative is halved where the two are equal
    return jnp.where(below, 1.0 - u * (1.0 / 3.0) + u * u * (1.0 / 27.0), 1.0 / jnp.where(below, 3.0, u))


def saturation(contact: Contact, longitudinal: Wheelsets, lateral: Wheelsets) -> Wheelsets:
    """u = √((f11 xi_x)² + (f33 xi_y)²)/(mu Q), sharp or rounded within `creep_width` of zero."""
    scale = 1.0 / (contact.friction * contact.wheel_load)
    square = (longitudinal * scale) ** 2 + (lateral * scale) ** 2
    if contact.law == "smooth":
        return smooth.smooth_norm(square, contact.creep_width)
    return smooth.sqrt_of_square(square)


def flange_force(contact: Contact, y_rel: Wheelsets) -> Wheelsets:
    """Spring with dead band: k_f (y_rel ∓ delta) outside ±delta, N."""
    outside = smooth.beyond(contact.law, y_rel, contact.flange_clearance, contact.flange_width)
    return contact.flange_stiffness * outside


@fence
def _saturated(contact: Contact, longitudinal: Wheelsets, lateral: Wheelsets) -> tuple[Wheelsets, Wheelsets]:
    """u and the factor of both wheels, evaluated once for all that depends on them."""
    u = saturation(contact, longitudinal, lateral)
    return u, 2.0 * saturation_factor(u)


def contact_force(vehicle: Vehicle, creepage: Creepage, y_rel: Wheelsets, psi: Wheelsets) -> ContactForce:
    """Creep of both wheels, flange and (if asked for) gravitational stiffness of a wheelset.

    Linear (Kalker), resistances of both wheels: lateral 2 (f33 xi_y + f12 xi_s), yaw 2 e f11 xi_x - 2 f12 xi_y + 2 f22 xi_s.
    Saturated: every creep force times the factor of `saturation_factor`, as the tractions all share the adhesion limit.
    Gravitational stiffness of a coned wheelset under axle load W = 2 Q: lateral W lambda/e, yaw -W e lambda.
    """
    contact, half_gauge = vehicle.contact, vehicle.geometry.half_gauge
    longitudinal = contact.creep_longitudinal * creepage.longitudinal
    lateral = contact.creep_lateral * creepage.lateral
    u, factor = _saturated(contact, longitudinal, lateral)
    if contact.law == "linear":
        factor = 2.0  # type: ignore[assignment]
    flange = flange_force(contact, y_rel)
    force = factor * (lateral + contact.creep_lateral_spin * creepage.spin) + flange
    moment = factor * (
        half_gauge * longitudinal - contact.creep_lateral_spin * creepage.lateral + contact.creep_spin * creepage.spin
    )
    if vehicle.gravitational:
        weight = 2.0 * contact.wheel_load * contact.conicity
        force = force + weight / half_gauge * y_rel
        moment = moment - weight * half_gauge * psi
    return ContactForce(force, moment, flange, u)


def creep_forces(vehicle: Vehicle, creepage: Creepage, u: Wheelsets) -> tuple[Wheelsets, Wheelsets]:
    """Creep of one wheel, N, along its longitudinal and lateral creepage, at the saturation u: what `contact_force` sums up for both.

    The right wheel is pushed forwards by the former, the left one backwards.
    """
    contact = vehicle.contact
    factor = 1.0 if contact.law == "linear" else saturation_factor(u)
    lateral = contact.creep_lateral * creepage.lateral + contact.creep_lateral_spin * creepage.spin
    return factor * contact.creep_longitudinal * creepage.longitudinal, factor * lateral
