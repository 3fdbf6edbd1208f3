"""`SteadyCurving`: what `curving` returns; it prints and draws itself."""

from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
from jaxtyping import Array, Float, Int

from ...base.errors import InputError
from ...base.failed_lanes import ends
from ...base.fields import structure
from ...base.typing import Number
from ...base.units import KMH

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class Equilibrium(IntEnum):
    """What the search for the equilibrium found."""

    OK = 0
    FAILED = 1  # no equilibrium: none was found, it is beyond the model's small displacements, or a parameter is not a number
    LIFTED = 2  # an equilibrium in which a wheel's load would be negative: numbers are there, but the vehicle tips over


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SteadyCurving:
    """Steady running in an arc, as `curving` finds it; SI. Wheelsets are the first axis, front first, then wheels (left, right: outer,
    inner in a right-hand curve), then lanes; y and lateral forces are positive to the right, in the frame of the track at each place.

    `guiding_force` is the force of the rail on each wheel and `sum_y` that on the wheelset; `angle_of_attack` is positive where the
    wheelset runs against the outer rail; `y_over_q` is positive where the wheel presses its rail outwards. `wear_number` is T gamma of
    all wheels, `wheel_wear` of each. `carbody_acceleration` is what passengers feel, v² kappa - g (theta - phi_c), positive to the
    inside of a right-hand curve.
    """

    wheelset_y: Float[Array, "wheelsets ..."]  # m
    wheelset_psi: Float[Array, "wheelsets ..."]  # rad
    angle_of_attack: Float[Array, "wheelsets ..."]  # rad
    guiding_force: Float[Array, "wheelsets wheels ..."]  # Y, N
    sum_y: Float[Array, "wheelsets ..."]  # N
    wheel_load: Float[Array, "wheelsets wheels ..."]  # Q with the load transfer, N
    load_transfer: Float[Array, "wheelsets ..."]  # to the left wheel, N
    y_over_q: Float[Array, "wheelsets wheels ..."]  # dimensionless
    longitudinal_creep_force: Float[Array, "wheelsets wheels ..."]  # N, forwards
    lateral_creep_force: Float[Array, "wheelsets wheels ..."]  # N
    saturation: Float[Array, "wheelsets ..."]  # u = |F_linear|/(mu Q): 3 and more is sliding, dimensionless
    wheel_wear: Float[Array, "wheelsets wheels ..."]  # T gamma, N
    wear_number: Float[Array, "..."]  # N
    bogie_yaw: Float[Array, "bogies ..."]  # rad; 0 where it is held
    carbody_acceleration: Float[Array, "..."]  # m/s^2
    carbody_roll: Float[Array, "..."]  # phi_c, rad: outwards in a right-hand curve; 0 where it is held
    state: Float[Array, "states ..."]  # x, m and rad: from it a run or a linearisation begins
    code: Int[Array, "..."]  # `Equilibrium`
    speed: Number  # m/s
    radius: Number  # m
    cant: Number  # m
    cant_deficiency: Float[Array, "..."]  # m over the base of 1.5 m
    vehicle_name: str = structure("")
    positions: tuple[float, ...] = structure(())  # of wheelsets ahead of the middle, m, for drawing
    clearance: float = structure(0.0)  # of the flange, m, for drawing

    @property
    def ok(self) -> Array:
        """True where the lane's numbers can be used."""
        return self.code == Equilibrium.OK

    def __str__(self) -> str:
        code, shape = np.asarray(self.code), self.code.shape
        if shape:
            return "\n".join(self._of_lanes(code))
        radius = float(self.radius)
        line = "straight track" if np.isinf(radius) else f"R {abs(radius):g} m to the {'right' if radius > 0 else 'left'}"
        lines = [
            f"Steady curving of {self.vehicle_name or 'a vehicle'}: {line}, {float(self.speed) * KMH:.1f} km/h, cant "
            f"{float(self.cant) * 1e3:.0f} mm, cant deficiency {float(self.cant_deficiency) * 1e3:.0f} mm"
        ]
        if int(code) == Equilibrium.FAILED:
            return "\n".join([*lines, "  no equilibrium found"])
        lines.append("  wheelset    y mm  attack mrad   ΣY kN  Y left  Y right  Q left  Q right   Y/Q  Tγ N      u")
        columns = [
            (1e3 * self.wheelset_y, 1e3 * self.angle_of_attack, 1e-3 * self.sum_y),
            (1e-3 * self.guiding_force, 1e-3 * self.wheel_load, self.y_over_q, self.wheel_wear, self.saturation),
        ]
        (y, attack, total), (force, load, quotient, wear, u) = [[np.asarray(v) for v in part] for part in columns]
        for k in range(len(y)):
            lines.append(
                f"  {k + 1:8d} {y[k]:7.3f} {attack[k]:12.3f} {total[k]:7.2f} {force[k, 0]:7.2f} {force[k, 1]:8.2f} {load[k, 0]:7.1f}"
                f" {load[k, 1]:8.1f} {np.max(quotient[k]):5.2f} {np.sum(wear[k]):5.1f} {u[k]:6.2f}"
            )
        lines.append(
            f"  wear number {float(self.wear_number):.1f} N; car body: {float(self.carbody_acceleration):.3f} m/s², roll "
            f"{float(self.carbody_roll) * 1e3:.2f} mrad"
        )
        if int(code) == Equilibrium.LIFTED:
            lines.append("  a wheel lifts: beyond the model")
        return "\n".join(lines)

    def _of_lanes(self, code: Int[np.ndarray, "..."]) -> list[str]:
        lines = [f"Steady curving of {self.vehicle_name or 'a vehicle'}: {code.size} curves"]
        for name, values, unit, factor in (
            ("largest displacement of a wheelset", np.max(np.abs(self.wheelset_y), axis=0), "mm", 1e3),
            ("largest angle of attack", np.max(self.angle_of_attack, axis=0), "mrad", 1e3),
            ("largest guiding force", np.max(np.abs(self.guiding_force), axis=(0, 1)), "kN", 1e-3),
            ("wear number", np.asarray(self.wear_number), "N", 1.0),
        ):
            low, high = ends(values)
            lines.append(f"  {name}: {low * factor:.4g} to {high * factor:.4g} {unit}")
        for result in Equilibrium:
            count = int(np.sum(code == result))
            if result is not Equilibrium.OK and count:
                lines.append(f"  {result.name.lower()}: {count} of {code.size} lane(s)")
        return lines

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers and lists, for JSON, in mm, mrad and kN; of one curve."""
        self._single("as_dict")

        def listed(values: Any, factor: float = 1.0) -> Any:
            return (factor * np.asarray(values)).tolist()

        return {
            "radius_m": float(self.radius),
            "speed_kmh": float(self.speed) * KMH,
            "cant_mm": float(self.cant) * 1e3,
            "cant_deficiency_mm": float(self.cant_deficiency) * 1e3,
            "result": Equilibrium(int(self.code)).name.lower(),
            "wheelset_y_mm": listed(self.wheelset_y, 1e3),
            "wheelset_yaw_mrad": listed(self.wheelset_psi, 1e3),
            "angle_of_attack_mrad": listed(self.angle_of_attack, 1e3),
            "guiding_force_kN": listed(self.guiding_force, 1e-3),
            "sum_y_kN": listed(self.sum_y, 1e-3),
            "wheel_load_kN": listed(self.wheel_load, 1e-3),
            "y_over_q": listed(self.y_over_q),
            "longitudinal_creep_force_kN": listed(self.longitudinal_creep_force, 1e-3),
            "lateral_creep_force_kN": listed(self.lateral_creep_force, 1e-3),
            "saturation": listed(self.saturation),
            "wheel_wear_N": listed(self.wheel_wear),
            "wear_number_N": float(self.wear_number),
            "carbody_acceleration": float(self.carbody_acceleration),
            "carbody_roll_mrad": float(self.carbody_roll) * 1e3,
        }

    def plot(self, axes: "Axes | None" = None) -> Any:
        """The vehicle's bogies in the curve from above, the rails' forces on the wheels as arrows; or, of lanes, what the wheels do over
        the radius (or what else varies). Into the given `axes`, or a figure of its own, which is returned."""
        from . import drawing

        return drawing.curve(self, axes) if not self.code.shape else drawing.over_lanes(self, axes)

    def _single(self, what: str) -> None:
        if self.code.shape:
            raise InputError(f"{what} is for one curve, and this result has {self.code.size} lanes")
