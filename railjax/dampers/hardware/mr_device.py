"""The MR piloting device (section 4, Tables 3-5): a double-ended piston that drives MR fluid past a solenoid in a cylinder.

The duct is the ring between poles and bore, of gap h, much thinner than its radius: parallel plates of width
w = π (d - h), the mean circumference, in which the fluid is a Bingham solid. Two forces add up,

    yield force      F_τ = c τ_y L A_p/h,    c = 2.07 + 12 Q η/(12 Q η + 0.4 w h² τ_y)    over the poles, where there is field
    viscous force    F_η = 12 η Q L A_p/(w h³) (1 + w h v/(2 Q))                          over poles and coil

with Q = A_p v (Yang, Spencer, Carlson, Sain, Eng. Struct. 24 (2002) 309; c approximates the exact flow between plates).
The last bracket is there only if a wall of the duct moves with the piston. The solenoid of the paper is fixed: the piston
fills the bore, A_p = π/4 (d² - d_b²), and no wall moves. `moving=True` is the other construction, solenoid on the piston:
A_p = π/4 ((d - 2h)² - d_b²), and the bracket counts.
"""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...base.errors import InputError
from ...base.fields import parameter, structure
from ...base.pytrees import registered
from ...base.smooth import TINY
from ...base.typing import Number, Scalar
from .hydraulics import disc_area


@registered
@dataclass(frozen=True)
class MrFluid:
    """MRF-132LD as the paper uses it (Table 4): yield stress at the field that the device is designed for.

    The viscosity is the supplier's at a shear rate of 140 1/s. `volume_fraction` (of iron; recalled, by the product's name)
    sets the magnetic curves of `magnetic_circuit`.
    """

    yield_stress: Number = parameter("Pa", "tau_c", "yield stress at the design field", 44.1e3, positive=True)
    field: Number = parameter("A/m", "H", "design field in the gap", 250e3, positive=True)
    viscosity: Number = parameter("Pa s", "eta", "MR fluid viscosity", 0.25, positive=True)
    volume_fraction: Number = parameter("1", "Phi", "volume fraction of iron", 0.32, positive=True)


@registered
@dataclass(frozen=True)
class MrDevice:
    """Geometry of Tables 3 and 5; core, case and turns are not in the paper.

    `core_diameter` leaves room for three full layers of wire, the fewest that reach the design field at 1.5 A
    (`design.wind` finds it); `turns` fills them. `core_bore` is a non-magnetic hole in the core: 0 says that the piston rod in it is of
    magnetic steel and carries flux. `case_diameter` is assumed. `friction` of the seals is unknown and left out.
    """

    bore: Number = parameter("m", "d", "interior diameter of the device", 22e-3, positive=True)
    rod_diameter: Number = parameter("m", "d_b", "device's piston rod diameter", 8e-3, positive=True)
    gap: Number = parameter("m", "h", "thickness of the gap", 0.4e-3, positive=True)
    pole_width: Number = parameter("m", "", "pole width", 2e-3, positive=True)
    coil_diameter: Number = parameter("m", "", "maximal solenoid diameter", 16e-3, positive=True)
    coil_length: Number = parameter("m", "", "solenoid length", 30e-3, positive=True)
    wire_diameter: Number = parameter("m", "", "wire diameter", 0.6e-3, positive=True)
    core_diameter: Number = parameter("m", "", "diameter of the solenoid's core", 12.4e-3, positive=True)
    core_bore: Number = parameter("m", "", "non-magnetic bore of the core", 0.0)
    case_diameter: Number = parameter("m", "", "outer diameter of the case", 26e-3, positive=True)
    turns: Number = parameter("1", "N", "turns of the solenoid", 150.0, positive=True)
    friction: Number = parameter("N", "F_f", "friction of the seals", 0.0)
    poles: int = structure(2)
    moving: bool = structure(False)


@registered
@dataclass(frozen=True)
class DeviceForces:
    """What `analyse` finds; each line carries its symbol and SI unit."""

    yield_force: Number = parameter("N", "F_tau", "controllable (yield) force")
    viscous_force: Number = parameter("N", "F_eta", "viscous force")
    total_force: Number = parameter("N", "F", "total force")
    dynamic_range: Number = parameter("1", "D", "dynamic range")
    active_volume: Number = parameter("m^3", "V", "active fluid volume")
    minimum_volume: Number = parameter("m^3", "V_min", "least active fluid volume for this range and power")
    plate_coefficient: Number = parameter("1", "c", "coefficient of the yield force")
    wall_shear_rate: Number = parameter("1/s", "", "shear rate at the poles' walls, no field")

    def __str__(self) -> str:
        from ...base.text import described

        return described(self)


def check(device: MrDevice) -> None:
    """Raise `InputError` where parts of the device do not fit into each other (concrete numbers only)."""
    d = {name: np.asarray(getattr(device, name), float) for name in ("bore", "rod_diameter", "coil_diameter", "core_diameter")}
    face = d["bore"] - 2 * np.asarray(device.gap, float)
    pairs = (
        ("rod_diameter", d["rod_diameter"], "the bore", d["bore"]),
        ("coil_diameter", d["coil_diameter"], "the poles' diameter (bore less two gaps)", face),
        ("core_diameter", d["core_diameter"], "coil_diameter", d["coil_diameter"]),
        ("core_bore", np.asarray(device.core_bore, float), "core_diameter", d["core_diameter"]),
        ("bore", d["bore"], "case_diameter", np.asarray(device.case_diameter, float)),
    )
    for name, inner, outer_name, outer in pairs:
        if not np.all(inner < outer):
            raise InputError(f"{name} {1e3 * np.max(inner):g} mm must be smaller than {outer_name}, {1e3 * np.min(outer):g} mm")


def piston_area(device: MrDevice) -> Scalar:
    """A_p, m²: the ring between bore (or poles, where they move) and rod."""
    outer = device.bore - 2.0 * device.gap if device.moving else device.bore
    return disc_area(outer) - disc_area(device.rod_diameter)


def duct_width(device: MrDevice) -> Scalar:
    """w = π (d - h), m: mean circumference of the gap."""
    return jnp.pi * (device.bore - device.gap)


def active_length(device: MrDevice) -> Scalar:
    """L of all poles, m."""
    return device.poles * device.pole_width


def plate_coefficient(yield_stress: Scalar, flow: Scalar, viscosity: Scalar, width: Scalar, gap: Scalar) -> Scalar:
    """c = 2.07 + 12 Q η/(12 Q η + 0.4 w h² τ_y), between 2.07 (stiff fluid) and 3.07 (weak field), Q >= 0.

    Within 2 % of the exact plane Bingham flow in the pressure it gives.
    """
    viscous = 12.0 * flow * viscosity
    return 2.07 + viscous / (viscous + 0.4 * width * gap**2 * yield_stress + TINY)


def yield_force(yield_stress: Scalar, length: Scalar, area: Scalar, gap: Scalar, coefficient: Scalar) -> Scalar:
    """F_τ = c τ_y L A_p/h, N: what the field adds."""
    return coefficient * yield_stress * length * area / gap


def viscous_force(
    viscosity: Scalar, flow: Scalar, length: Scalar, area: Scalar, width: Scalar, gap: Scalar, wall_velocity: Scalar = 0.0
) -> Scalar:
    """F_η = 12 η L A_p/(w h³) (Q + w h v/2), N; v is the velocity of the wall that moves with the piston, 0 without one."""
    return 12.0 * viscosity * length * area / (width * gap**3) * (flow + 0.5 * width * gap * wall_velocity)


def least_volume(viscosity: Scalar, yield_stress: Scalar, coefficient: Scalar, ratio: Scalar, power: Scalar) -> Scalar:
    """V = k (η/τ_y²) (F_τ/F_η) P_m, m³, k = 12/c²: the least active fluid for a ratio of forces and a power P_m = F_τ v (W)."""
    return 12.0 / coefficient**2 * viscosity / (yield_stress**2 + TINY) * ratio * power


def analyse(device: MrDevice, fluid: MrFluid, velocity: Scalar = 0.015, yield_stress: Scalar | None = None) -> DeviceForces:
    """Forces, dynamic range and fluid volume at a piston velocity (m/s, > 0) and yield stress (Pa; the design field's).

    The viscous force counts the poles, and the coil, where the duct is (d - d_coil)/2 wide. The dynamic range is
    D = 1 + F_τ/(F_η + F_f).
    """
    yield_stress = fluid.yield_stress if yield_stress is None else yield_stress
    area, width, length = piston_area(device), duct_width(device), active_length(device)
    flow = area * velocity
    wall = velocity if device.moving else 0.0
    c = plate_coefficient(yield_stress, flow, fluid.viscosity, width, device.gap)
    controlled = yield_force(yield_stress, length, area, device.gap, c)
    at_poles = viscous_force(fluid.viscosity, flow, length, area, width, device.gap, wall)
    passage = 0.5 * (device.bore - device.coil_diameter)
    at_coil = viscous_force(fluid.viscosity, flow, device.coil_length, area, jnp.pi * (device.bore - passage), passage, wall)
    viscous = at_poles + at_coil
    return DeviceForces(
        yield_force=controlled,
        viscous_force=viscous,
        total_force=controlled + viscous + device.friction,
        dynamic_range=1.0 + controlled / (viscous + device.friction),
        active_volume=length * width * device.gap,
        minimum_volume=least_volume(fluid.viscosity, yield_stress, c, controlled / at_poles, controlled * velocity),
        plate_coefficient=c,
        wall_shear_rate=6.0 * flow / (width * device.gap**2),
    )


def total_force(device: MrDevice, fluid: MrFluid, velocity: Scalar, yield_stress: Scalar | None = None) -> Float[Array, "..."]:
    """F = F_τ + F_η + F_f, N: `analyse` for those who need no more."""
    return jnp.asarray(analyse(device, fluid, velocity, yield_stress).total_force)
