"""The MR device's magnetic circuit: core, two poles, case and the fluid in the gaps, in series around the coil.

    N I = Σ H_k l_k,    flux Φ = B_k A_k the same in every part

Written from the field in the gap to the ampere turns, which is explicit; `gap_field` goes the other way. Leakage is left out.
Magnetic curves are smooth formulas, recalled, not read at their source.
"""

from dataclasses import dataclass

import jax.numpy as jnp
from jaxtyping import Array, Float

from ...base.errors import InputError
from ...base.fields import parameter
from ...base.pytrees import registered
from ...base.smooth import TINY
from ...base.typing import Number, Scalar
from .hydraulics import disc_area
from .mr_device import MrDevice, MrFluid, duct_width, total_force

MU_0 = 4e-7 * jnp.pi  # V s/(A m)


@registered
@dataclass(frozen=True)
class Steel:
    """Low-carbon steel by Fröhlich's curve B = μ_0 H + J H/(H + a); values assumed for AISI 1010 (1.5 T at 1.2 kA/m)."""

    saturation: Number = parameter("T", "J", "saturation polarisation of the steel", 1.95, positive=True)
    knee: Number = parameter("A/m", "a", "field of half the saturation", 350.0, positive=True)


@registered
@dataclass(frozen=True)
class Circuit:
    """State of the circuit at a field in the gap; each line carries its symbol and SI unit."""

    field: Number = parameter("A/m", "H", "field in the gap")
    ampere_turns: Number = parameter("A", "N I", "ampere turns")
    flux: Number = parameter("V s", "Phi", "flux")
    gap_density: Number = parameter("T", "B", "flux density in the fluid")
    core_density: Number = parameter("T", "", "flux density in the core")
    root_density: Number = parameter("T", "", "flux density at the poles' root")
    case_density: Number = parameter("T", "", "flux density in the case")
    gap_share: Number = parameter("1", "", "share of the fluid in the ampere turns")

    def __str__(self) -> str:
        from ...base.text import described

        return described(self)


def carlson_yield_stress(field: Scalar, volume_fraction: Scalar) -> Float[Array, "..."]:
    """τ_y = 271.7 kPa Φ^1.5239 tanh(6.33e-6 H), Pa, of a hydrocarbon-based fluid (H in A/m, >= 0).

    J. D. Carlson, MR fluids and devices in the real world, Int. J. Mod. Phys. B 19 (2005) 1463 (recalled). 32 % of iron at
    250 kA/m give 44.0 kPa, the paper's Table 4 44.1.
    """
    return 271.7e3 * volume_fraction**1.5239 * jnp.tanh(6.33e-6 * field)


def yield_stress(fluid: MrFluid, field: Scalar) -> Float[Array, "..."]:
    """τ_y at a field (A/m, >= 0), Pa: Carlson's shape through the fluid's own value at its design field."""
    shape = [carlson_yield_stress(h, fluid.volume_fraction) for h in (field, fluid.field)]
    return fluid.yield_stress * shape[0] / shape[1]


def fluid_density(fluid: MrFluid, field: Scalar) -> Float[Array, "..."]:
    """B = 1.91 T Φ^1.133 (1 - exp(-10.97 μ_0 H)) + μ_0 H of the MR fluid (H in A/m, >= 0); Carlson (2005), recalled."""
    return 1.91 * fluid.volume_fraction**1.133 * (1.0 - jnp.exp(-10.97 * MU_0 * field)) + MU_0 * field


def steel_field(steel: Steel, density: Scalar) -> Float[Array, "..."]:
    """H of the steel, A/m, at a flux density (T, >= 0): Fröhlich's curve solved for H, in the form that keeps its digits."""
    rest = steel.saturation + MU_0 * steel.knee - density
    return 2.0 * steel.knee * density / (rest + jnp.sqrt(rest**2 + 4.0 * MU_0 * steel.knee * density))


def circuit(device: MrDevice, fluid: MrFluid, steel: Steel, field: Scalar) -> Circuit:
    """Ampere turns and flux densities that belong to a field in the gap (A/m, >= 0).

    Paths: core and case from the middle of one pole to that of the other, poles from core to face at their mean area, as many
    gaps as poles.
    """
    face = device.bore - 2.0 * device.gap
    between = device.coil_length + device.pole_width
    density = fluid_density(fluid, field)
    flux = density * duct_width(device) * device.pole_width
    core = flux / (disc_area(device.core_diameter) - disc_area(device.core_bore))
    case = flux / (disc_area(device.case_diameter) - disc_area(device.bore))
    root = flux / (jnp.pi * device.core_diameter * device.pole_width)
    pole = flux / (0.5 * jnp.pi * (device.core_diameter + face) * device.pole_width)
    gaps = device.poles * device.gap * field
    steels = (
        steel_field(steel, core) * between
        + steel_field(steel, case) * between
        + device.poles * steel_field(steel, pole) * 0.5 * (face - device.core_diameter)
    )
    return Circuit(
        field=field,
        ampere_turns=gaps + steels,
        flux=flux,
        gap_density=density,
        core_density=core,
        root_density=root,
        case_density=case,
        gap_share=gaps / (gaps + steels + TINY),
    )


def gap_field(device: MrDevice, fluid: MrFluid, steel: Steel, current: Scalar) -> Float[Array, ""]:
    """Field in the gap, A/m, at a current (A, >= 0): `circuit` solved for the field; one lane, `vmap` for more.

    Bisection between no field and the field of ideal iron, differentiated implicitly.
    """
    import optimistix  # heavy, and wanted by nothing else here

    wanted = jnp.asarray(device.turns * current, float)
    # in units of the field of ideal iron plus a little, so that zero current is inside the bracket
    scale = (wanted + 1.0) / (device.poles * device.gap)

    def excess(share: Float[Array, ""], _: None) -> Float[Array, ""]:
        return (circuit(device, fluid, steel, share * scale).ampere_turns - wanted) / (wanted + 1.0)

    solver = optimistix.Bisection(rtol=1e-12, atol=1e-12)  # type: ignore[call-arg, var-annotated]
    options = {"lower": jnp.zeros_like(scale) - 1e-9, "upper": jnp.ones_like(scale)}
    found = optimistix.root_find(excess, solver, jnp.asarray(0.5, scale.dtype), options=options, max_steps=100, throw=False)  # type: ignore[var-annotated]
    return found.value * scale


def force_of_current(
    device: MrDevice, fluid: MrFluid, steel: Steel, current: Scalar, velocity: Scalar = 0.015
) -> Float[Array, ""]:
    """The MR device's force, N, at a current (A, >= 0) and piston velocity (m/s): current -> field -> yield stress -> force."""
    return total_force(device, fluid, velocity, yield_stress(fluid, gap_field(device, fluid, steel, current)))


def turns_per_layer(device: MrDevice) -> int:
    """Whole turns that lie side by side on the solenoid's length (concrete numbers only)."""
    # a ratio of decimals like 30/0.6 may come out just below the whole number
    fitting = int(device.coil_length / device.wire_diameter + 1e-9)
    if fitting < 1:
        raise InputError(f"wire_diameter {1e3 * device.wire_diameter:g} mm is wider than coil_length; choose a thinner wire")
    return fitting
