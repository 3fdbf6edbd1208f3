"""Steady curving as objectives: wear, guiding force, angle of attack, Y/Q, and the critical speed in the curve."""

from dataclasses import dataclass
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..base.errors import InputError
from ..base.fields import structure
from ..base.pytrees import registered
from ..base.typing import Number
from ..base.units import KMH
from ..model.damper import Damper, with_law
from ..model.track.curve import cant_in_balance
from ..model.vehicle import Vehicle
from ..stability.curving.critical import curve_critical
from ..stability.curving.result import Equilibrium, SteadyCurving
from ..stability.curving.steady import A_CANT, a_radius, curving
from ..stability.linear_critical import HIGHEST, Stability
from .quantity import Quantity, kmh

#: m; of a curve of which no more is said
CANT, CANT_DEFICIENCY = 0.1, 0.1

#: what -> its name, unit, factor from SI, and the worst of it (lanes last)
MEASURES: dict[str, tuple[str, str, float, Any]] = {
    "wear": ("wear number", "N", 1.0, lambda found: found.wear_number),
    "guiding force": ("guiding force", "kN", 1e-3, lambda found: jnp.max(jnp.abs(found.guiding_force), axis=(0, 1))),
    "angle of attack": ("angle of attack", "mrad", 1e3, lambda found: jnp.max(found.angle_of_attack, axis=0)),
    "Y/Q": ("Y/Q", "1", 1.0, lambda found: jnp.max(found.y_over_q, axis=(0, 1))),
}


def in_curve(measure: str, radius: Any, speed: Any, cant: Any, cant_deficiency: Any) -> "InCurve":
    """A quantity of steady curving; the speed follows from cant and deficiency where none is given.

    Args:
        measure: one of `MEASURES`.
        radius: R, m.
        speed: v, m/s, or None.
        cant: of the outer rail, m.
        cant_deficiency: m; None where a speed is given.
    """
    _single("radius", radius)
    a_radius("radius", radius)
    A_CANT("cant", cant)
    if not np.isfinite(radius):
        raise InputError("radius must be finite, for an objective in a curve")
    if speed is None:
        deficiency = CANT_DEFICIENCY if cant_deficiency is None else cant_deficiency
        A_CANT("cant_deficiency", deficiency)
        if cant + deficiency <= 0.0:
            raise InputError("cant and cant_deficiency must add up to more than 0, or there is no such speed")
        speed = np.sqrt((cant + deficiency) / cant_in_balance(1.0, radius))
    elif cant_deficiency is not None:
        raise InputError("speed and cant_deficiency exclude each other: give one of them")
    _single("speed", speed)
    if not (np.isfinite(speed) and speed > 0.0):
        raise InputError(f"speed must be positive (m/s), not {speed}")
    return InCurve(float(radius), float(speed), float(cant), measure)


def critical_in_curve(radius: Any, cant_deficiency: Any) -> "CriticalInCurve":
    """The critical speed at a cant that follows the speed.

    Args:
        radius: R, m.
        cant_deficiency: m.
    """
    _single("radius", radius)
    a_radius("radius", radius)
    A_CANT("cant_deficiency", cant_deficiency)
    return CriticalInCurve(float(radius), float(cant_deficiency))


def _single(key: str, value: Any) -> None:
    if isinstance(value, bool) or not isinstance(value, (int, float, np.number)):
        raise InputError(f"{key} must be one number, not {value!r}")


@registered
@dataclass(frozen=True, eq=False)
class InCurve(Quantity):
    """The worst of all wheels in an arc."""

    radius: Number
    speed: Number
    cant: Number
    measure: str = structure("wear")

    traced: ClassVar[bool] = False

    @property
    def name(self) -> str:
        return f"{MEASURES[self.measure][0]} in R {abs(self.radius):g} m at {kmh(self.speed)}"

    @property
    def unit(self) -> str:  # type: ignore[override]
        return MEASURES[self.measure][1]

    @property
    def factor(self) -> float:  # type: ignore[override]
        return MEASURES[self.measure][2]

    def found(self, vehicle: Vehicle, damper: Damper) -> SteadyCurving:
        """The steady motion."""
        return curving(vehicle, self.speed, radius=self.radius, cant=self.cant, damper=with_law(damper, "smooth"))

    def value(self, vehicle: Vehicle, damper: Damper) -> Float[Array, "..."]:
        found = self.found(vehicle, damper)
        return jnp.where(found.code == int(Equilibrium.FAILED), jnp.nan, MEASURES[self.measure][3](found))

    each = value


@registered
@dataclass(frozen=True, eq=False)
class CriticalInCurve(Quantity):
    """See `curve_critical`."""

    radius: Number
    cant_deficiency: Number

    traced: ClassVar[bool] = False
    unit: ClassVar[str] = "km/h"
    factor: ClassVar[float] = KMH
    greatest: ClassVar[bool] = True

    @property
    def name(self) -> str:
        return f"critical speed in R {abs(self.radius):g} m"

    def value(self, vehicle: Vehicle, damper: Damper) -> Float[Array, "..."]:
        law = with_law(damper, "smooth")
        found = curve_critical(vehicle, radius=self.radius, cant_deficiency=self.cant_deficiency, damper=law)
        return jnp.where(found.code == int(Stability.STABLE), HIGHEST, found.speed)

    each = value
