"""Design of the hybrid damper and its MR piloting device: required force and space -> gap, poles and winding (section 4).

The paper maximises the dynamic range D and minimises the volume V of the MR fluid. At a given force both grow as h², so the
compromise is

    minimise  -log D + weight log V   over gap and pole width, for every whole number of layers of wire,
    subject to  total force >= required,  N I at the design field <= turns x current,  flux density of the iron <= limit.

So a small weight (up to 0.8 here) makes the gap as wide as the winding can magnetise, a large one as narrow as is allowed; nothing
in between. With the paper's space, wire and current the winding decides, and gives gap and poles near Table 5's.
"""

import dataclasses
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from ...base.errors import InputError, NumericalError
from ...base.fields import parameter, structure
from ...base.precision import require_double_precision
from ...base.pytrees import registered
from ...base.typing import Number
from .hydraulics import HydraulicDamper, Pilot, PilotSizes, size_pilot
from .magnetic_circuit import Circuit, Steel, circuit, turns_per_layer
from .mr_device import DeviceForces, MrDevice, MrFluid, analyse, check


@registered
@dataclass(frozen=True)
class Requirements:
    """What the device must do, and the limits of making it. Iron limit, gap's and poles' limits are assumed, not the paper's."""

    force: Number = parameter("N", "F_max", "required force of the MR device", 343.0, positive=True)
    velocity: Number = parameter("m/s", "v_max", "maximal velocity of the device's piston", 0.015, positive=True)
    current: Number = parameter("A", "I", "maximal current", 1.5, positive=True)
    iron_limit: Number = parameter("T", "B_max", "flux density allowed in the iron", 1.5, positive=True)
    narrowest_gap: Number = parameter("m", "", "narrowest gap", 0.2e-3, positive=True)
    widest_gap: Number = parameter("m", "", "widest gap", 2e-3, positive=True)
    narrowest_pole: Number = parameter("m", "", "narrowest pole", 0.5e-3, positive=True)
    widest_pole: Number = parameter("m", "", "widest pole", 10e-3, positive=True)
    weight: float = structure(0.5)


@dataclass(frozen=True)
class DeviceDesign:
    """A device with what it does at the design field, and how many layers its winding has."""

    device: MrDevice
    forces: DeviceForces
    circuit: Circuit
    layers: int
    needed_turns: float

    def __str__(self) -> str:
        from ...base.text import described

        head = f"{self.layers} full layers of wire; {self.needed_turns:.1f} turns needed, {float(self.device.turns):g} wound"
        return "\n".join([head, described(self.device), str(self.forces), str(self.circuit)])


def with_layers(device: MrDevice, layers: int) -> MrDevice:
    """The device with so many full layers of wire: their turns, and the core inside them."""
    core = device.coil_diameter - 2.0 * layers * device.wire_diameter
    return dataclasses.replace(device, core_diameter=core, turns=float(layers * turns_per_layer(device)))


def wind(device: MrDevice, fluid: MrFluid, steel: Steel, current: float = 1.5, velocity: float = 0.015) -> DeviceDesign:
    """The device with the fewest full layers that reach the design field at a current (A), its forces at a velocity (m/s).

    Raises `InputError` if no number of layers does: each further layer thins the core.
    """
    for layers in range(1, _most_layers(device) + 1):
        wound = with_layers(device, layers)
        state = circuit(wound, fluid, steel, fluid.field)
        needed = float(state.ampere_turns) / current
        if needed <= wound.turns:
            return DeviceDesign(wound, analyse(wound, fluid, velocity), state, layers, needed)
    raise InputError(
        f"no winding of full layers reaches {1e-3 * fluid.field:g} kA/m in the gap at {current:g} A: raise current or "
        "coil_diameter, or lower gap, pole_width or field"
    )


def _most_layers(device: MrDevice) -> int:
    room = 0.5 * (device.coil_diameter - device.core_bore) / device.wire_diameter
    return max(int(np.ceil(room - 1e-9)) - 1, 0)


def design_device(
    requirements: Requirements | None = None,
    device: MrDevice | None = None,
    fluid: MrFluid | None = None,
    steel: Steel | None = None,
) -> DeviceDesign:
    """Gap, pole width and winding that meet the requirements best; what else the device has is kept.

    SciPy's SLSQP with JAX's gradients for each number of layers, from the middle (geometric) of the limits. Concrete numbers only; needs
    double precision. Raises `InputError` for parts that do not fit, `NumericalError` where nothing meets the requirements,
    naming what is violated least.
    """
    from scipy.optimize import minimize

    require_double_precision("design_device")
    requirements, fluid, steel = requirements or Requirements(), fluid or MrFluid(), steel or Steel()
    device = device or MrDevice()
    limits = [
        (requirements.narrowest_gap, requirements.widest_gap),
        (requirements.narrowest_pole, requirements.widest_pole),
    ]
    for (low, high), name in zip(limits, ("gap", "pole"), strict=True):
        if not low < high:
            raise InputError(f"narrowest_{name} must be smaller than widest_{name}")
    logs = np.log(np.array(limits, float))
    best, nearest = None, (-np.inf, "force")
    for layers in range(1, _most_layers(device) + 1):
        wound = with_layers(device, layers)
        problem = (wound, fluid, steel, requirements)
        # poles must stay outside the coil
        widest = 0.5 * (float(device.bore) - float(device.coil_diameter))
        bounds = [(logs[0, 0], min(logs[0, 1], np.log(widest) - 1e-6)), tuple(logs[1])]
        if bounds[0][0] >= bounds[0][1]:
            check(dataclasses.replace(device, gap=requirements.narrowest_gap, core_diameter=0.5 * device.coil_diameter))
        start = np.array([0.5 * (low + high) for low, high in bounds])
        found = minimize(
            lambda x, p=problem: float(_objective(x, *p)),
            start,
            jac=lambda x, p=problem: np.asarray(_objective_slope(x, *p)),
            bounds=bounds,
            method="SLSQP",
            constraints={
                "type": "ineq",
                "fun": lambda x, p=problem: np.asarray(_margins(x, *p)),
                "jac": lambda x, p=problem: np.asarray(_margins_slope(x, *p)),
            },
            options={"ftol": 1e-12, "maxiter": 200},
        )
        margins = np.asarray(_margins(found.x, *problem))
        worst = int(np.argmin(margins))
        if margins[worst] < -1e-6:
            nearest = max(nearest, (float(margins[worst]), MARGINS[worst]))
        elif best is None or found.fun < best[0]:
            best = (found.fun, _shaped(jnp.asarray(found.x), wound), layers)
    if best is None:
        raise NumericalError(
            f"no device with full layers of wire gives {requirements.force:g} N within its space; the nearest misses its "
            f"{nearest[1]} by {-100 * np.expm1(nearest[0]):.3g} %"
        )
    chosen = jax.tree.map(float, best[1])
    check(chosen)
    state = circuit(chosen, fluid, steel, fluid.field)
    forces = analyse(chosen, fluid, requirements.velocity)
    return DeviceDesign(chosen, forces, state, best[2], float(state.ampere_turns) / requirements.current)


@dataclass(frozen=True)
class HybridDesign:
    """The whole of section 4: what was given, the pilot's sizes, the given MR device with a winding, and the designed one."""

    damper: HydraulicDamper
    pilot: Pilot
    fluid: MrFluid
    steel: Steel
    requirements: Requirements
    sizes: PilotSizes
    given: DeviceDesign
    designed: DeviceDesign

    def __str__(self) -> str:
        parts = {
            "pilot": self.sizes,
            "MR device as given (Table 5)": self.given,
            "MR device designed": self.designed,
        }
        return "\n\n".join(f"{name}\n{part}" for name, part in parts.items())


def design_hybrid(
    damper: HydraulicDamper | None = None,
    pilot: Pilot | None = None,
    device: MrDevice | None = None,
    fluid: MrFluid | None = None,
    steel: Steel | None = None,
    requirements: Requirements | None = None,
) -> HybridDesign:
    """Pilot and MR device of a hydraulic damper; without arguments the paper's.

    `device` is analysed with the gap and poles it has, and gives the space for the designed one; `requirements.force` is replaced
    by the pilot's largest force. Raises as `design_device` and `wind`.
    """
    damper, pilot, device = damper or HydraulicDamper(), pilot or Pilot(), device or MrDevice()
    fluid, steel, requirements = fluid or MrFluid(), steel or Steel(), requirements or Requirements()
    if not damper.rod_diameter < damper.piston_diameter:
        raise InputError(f"rod_diameter {1e3 * damper.rod_diameter:g} mm must be smaller than piston_diameter")
    sizes = jax.tree.map(float, size_pilot(damper, pilot))
    if not sizes.drop > pilot.minimum_drop:
        raise InputError(
            f"minimum_drop {1e-5 * pilot.minimum_drop:g} bar must be below the {1e-5 * sizes.drop:.4g} bar of the maximal force"
        )
    check(dataclasses.replace(device, core_diameter=0.5 * (device.core_bore + device.coil_diameter)))
    given = wind(device, fluid, steel, requirements.current, requirements.velocity)
    requirements = dataclasses.replace(requirements, force=sizes.largest_force)
    designed = design_device(requirements, device, fluid, steel)
    return HybridDesign(damper, pilot, fluid, steel, requirements, sizes, given, designed)


#: what each entry of `_margins` guards
MARGINS = ("force", "ampere turns", "flux density of the core", "flux density at the poles' root", "flux density of the case")


def _shaped(x: jax.Array, device: MrDevice) -> MrDevice:
    """The device with gap and pole width of x, their logarithms."""
    return dataclasses.replace(device, gap=jnp.exp(x[0]), pole_width=jnp.exp(x[1]))


@jax.jit
def _objective(x: jax.Array, device: MrDevice, fluid: MrFluid, steel: Steel, wanted: Requirements) -> jax.Array:
    forces = analyse(_shaped(x, device), fluid, wanted.velocity)
    return wanted.weight * jnp.log(forces.active_volume) - jnp.log(forces.dynamic_range)


@jax.jit
def _margins(x: jax.Array, device: MrDevice, fluid: MrFluid, steel: Steel, wanted: Requirements) -> jax.Array:
    """Logarithms of allowed over used: positive where a requirement is met."""
    shaped = _shaped(x, device)
    force = analyse(shaped, fluid, wanted.velocity).total_force
    state = circuit(shaped, fluid, steel, fluid.field)
    densities = jnp.stack([state.core_density, state.root_density, state.case_density])
    return jnp.concatenate(
        [
            jnp.log(jnp.stack([force / wanted.force, shaped.turns * wanted.current / state.ampere_turns])),
            jnp.log(wanted.iron_limit / densities),
        ]
    )


_objective_slope = jax.jit(jax.grad(_objective))
_margins_slope = jax.jit(jax.jacrev(_margins))
