"""The hybrid damper's hydraulics (section 4 and fig. 11 of the paper): a hydraulic damper whose two chambers are joined by an
orifice, and the pilot piston that opens the orifice against a spring and an MR device.

    velocity -> flow Q = A_p v -> stroke c of the pilot -> opening A_o = L_o c -> drop Δp_d (eq. 9) -> damping force A_p Δp_d

The pilot's piston balances the damper's pressure against spring and MR device, so the valve limits the pressure at
(F_spring + F_MR)/A_pilot, between what its narrowest and its widest opening let through. Inertia and compressibility are left
out. Everything is elementwise, so arguments may carry any lanes.
"""

from dataclasses import dataclass

import jax.numpy as jnp
from jaxtyping import Array, Float

from ...base import smooth
from ...base.fields import parameter
from ...base.pytrees import registered
from ...base.typing import Number, Scalar

#: Pa in the paper's unit of pressure
DAN_PER_CM2 = 1e5

#: Pa; below it `orifice_flow` is laminar. At 3 bar it changes the flow by 3e-12
TRANSITION = 1.0


@registered
@dataclass(frozen=True)
class HydraulicDamper:
    """The passive damper T50/20x210 that the design starts from (Table 2), with its largest force and the velocity of it."""

    piston_diameter: Number = parameter("m", "d_p", "damper's piston diameter", 0.05, positive=True)
    rod_diameter: Number = parameter("m", "d_t", "damper's piston rod diameter", 0.02, positive=True)
    force: Number = parameter("N", "F", "damper's maximal force", 5000.0, positive=True)
    velocity: Number = parameter("m/s", "v_p", "velocity of the maximal force", 0.1, positive=True)


@registered
@dataclass(frozen=True)
class Pilot:
    """The controlled hydraulic resistance: a rectangular opening behind a piston pushed by spring and MR device.

    The spring counts as soft: its force is that of the closed position at every stroke (the paper gives no stiffness).
    """

    diameter: Number = parameter("m", "", "pilot piston diameter", 0.012, positive=True)
    opening_width: Number = parameter("m", "L_o", "opening's leg across the pilot piston", 6e-3, positive=True)
    minimum_drop: Number = parameter("Pa", "", "pressure drop of the free circuit", 3e5, positive=True)
    spring_force: Number = parameter("N", "F_min", "spring force in chamber B", 34.0, positive=True)
    narrowest_stroke: Number = parameter("m", "c_min", "stroke of the narrowest opening", 0.54e-3, positive=True)
    widest_stroke: Number = parameter("m", "", "maximal stroke", 2e-3, positive=True)
    discharge: Number = parameter("1", "c_d", "discharge coefficient of turbulent flow", 0.61, positive=True)
    density: Number = parameter("kg/m^3", "rho", "density of the hydraulic fluid", 880.0, positive=True)
    stroke_width: Number = parameter("m", "", "smooth twin: rounding of the stroke's ends", 1e-5)


@registered
@dataclass(frozen=True)
class PilotSizes:
    """What `size_pilot` finds; each line carries its symbol and SI unit."""

    area: Number = parameter("m^2", "A_p", "damper's active area")
    flow: Number = parameter("m^3/s", "Q", "flow at the maximal force")
    drop: Number = parameter("Pa", "Δp_d", "pressure drop at the maximal force")
    smallest_opening: Number = parameter("m^2", "A_o min", "opening at the maximal force")
    largest_opening: Number = parameter("m^2", "A_o max", "opening of the free circuit")
    smallest_force: Number = parameter("N", "F_min", "force on the pilot, free circuit")
    largest_force: Number = parameter("N", "F_max", "force on the pilot, maximal force")
    narrowest_stroke: Number = parameter("m", "c_min", "stroke at the maximal force")
    widest_stroke: Number = parameter("m", "c_max", "stroke of the free circuit")

    def __str__(self) -> str:
        from ...base.text import described

        return described(self)


def disc_area(diameter: Scalar) -> Scalar:
    """π d²/4, m²."""
    return 0.25 * jnp.pi * diameter**2


def active_area(damper: HydraulicDamper) -> Scalar:
    """A_p = π/4 (d_p² - d_t²), m²: the ring that pushes the fluid."""
    return disc_area(damper.piston_diameter) - disc_area(damper.rod_diameter)


def opening_area(stroke: Scalar, width: Scalar) -> Scalar:
    """A_o = L_o c, m²: the rectangle that a pilot at stroke c (m, >= 0) uncovers of an opening L_o (m) wide."""
    return width * stroke


def opening_stroke(area: Scalar, width: Scalar) -> Scalar:
    """The inverse of `opening_area`: c = A_o/L_o, m."""
    return area / width


def orifice_flow(area: Scalar, drop: Scalar, discharge: Scalar = 0.61, density: Scalar = 880.0) -> Float[Array, "..."]:
    """Eq. (9): Q = c_d A_o √(2 Δp_d/ρ), m³/s, with the sign of the drop (Pa).

    The root's infinite slope at Δp_d = 0 is rounded off within `TRANSITION`, where real flow is laminar.
    """
    drop = jnp.asarray(drop, float)
    return discharge * area * jnp.sqrt(2.0 / density) * drop * (drop**2 + TRANSITION**2) ** -0.25


def orifice_drop(area: Scalar, flow: Scalar, discharge: Scalar = 0.61, density: Scalar = 880.0) -> Scalar:
    """Eq. (9) solved for Δp_d = ρ Q|Q|/(2 c_d² A_o²), Pa: smooth through zero flow, where its derivative is 0."""
    return 0.5 * density * flow * jnp.abs(flow) / (discharge * area) ** 2


def orifice_area(flow: Scalar, drop: Scalar, discharge: Scalar = 0.61, density: Scalar = 880.0) -> Float[Array, "..."]:
    """Eq. (9) solved for A_o, m², of a flow >= 0 at a drop > 0."""
    return flow / orifice_flow(1.0, drop, discharge, density)


def size_pilot(damper: HydraulicDamper, pilot: Pilot, *, flow: Scalar | None = None, drop: Scalar | None = None) -> PilotSizes:
    """Openings, strokes and forces of the pilot that let the damper reach its maximal force, and the free circuit's.

    `flow` (m³/s) and `drop` (Pa) replace A_p v_p and F/A_p: the paper goes on with rounded values (Q = 1.65e-4 m³/s,
    Δp_d = 30.31 daN/cm²), and then prints A_o max = 10.36 mm² where the unrounded chain prints 10.35.
    """
    area = active_area(damper)
    flow = area * damper.velocity if flow is None else flow
    drop = damper.force / area if drop is None else drop
    smallest, largest = (orifice_area(flow, p, pilot.discharge, pilot.density) for p in (drop, pilot.minimum_drop))
    piston = disc_area(pilot.diameter)
    return PilotSizes(
        area=area,
        flow=flow,
        drop=drop,
        smallest_opening=smallest,
        largest_opening=largest,
        smallest_force=pilot.minimum_drop * piston,
        largest_force=drop * piston,
        narrowest_stroke=opening_stroke(smallest, pilot.opening_width),
        widest_stroke=opening_stroke(largest, pilot.opening_width),
    )


def held_drop(pilot: Pilot, mr_force: Scalar) -> Scalar:
    """Δp at which the pilot opens, Pa: spring and MR device (N, >= 0) together over the piston's area."""
    return (pilot.spring_force + mr_force) / disc_area(pilot.diameter)


def mr_force_for(pilot: Pilot, drop: Scalar) -> Scalar:
    """The inverse of `held_drop`: the MR device's force, N, that holds a drop (Pa); negative below the spring's."""
    return drop * disc_area(pilot.diameter) - pilot.spring_force


def pilot_stroke(pilot: Pilot, flow: Scalar, mr_force: Scalar, law: str = "sharp") -> Float[Array, "..."]:
    """Where the pilot comes to rest, m: at the opening that lets `flow` (m³/s, either sign) through at the held drop, between
    its narrowest and its widest. `law` "smooth" rounds the two ends within `stroke_width`.
    """
    area = orifice_area(jnp.abs(jnp.asarray(flow, float)), held_drop(pilot, mr_force), pilot.discharge, pilot.density)
    wanted = opening_stroke(area, pilot.opening_width)
    middle = 0.5 * (pilot.widest_stroke + pilot.narrowest_stroke)
    half = 0.5 * (pilot.widest_stroke - pilot.narrowest_stroke)
    # what is left of a number without its part beyond a band lies within the band
    return wanted - smooth.beyond(law, wanted - middle, half, pilot.stroke_width)


def damping_force(
    damper: HydraulicDamper, pilot: Pilot, velocity: Scalar, mr_force: Scalar, law: str = "sharp"
) -> Float[Array, "..."]:
    """The hybrid damper's force, N, with the sign of `velocity` (m/s), at an MR force (N, >= 0; 0 without current).

    At low velocity the narrowest opening damps with v², then the pilot holds the pressure, and beyond its widest opening the
    force grows with v² again. Quasi-static; derivatives are finite everywhere.
    """
    area = active_area(damper)
    flow = area * velocity
    opening = opening_area(pilot_stroke(pilot, flow, mr_force, law), pilot.opening_width)
    return area * orifice_drop(opening, flow, pilot.discharge, pilot.density)
