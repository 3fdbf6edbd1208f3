"""The parameters that are tuned: by dotted name, within bounds, as a unit box."""

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..base.errors import InputError, nearest
from ..base.fields import about_field, is_single, number_names, structure, wrong_sign
from ..base.pytrees import registered
from ..base.typing import Number
from ..model.damper import Damper
from ..model.parameters import bare, get_parameter, set_parameter
from ..model.vehicle import Provenance, Vehicle
from .quantity import Trees

#: a parameter of the damper is written as damper.alpha
OF_DAMPER = "damper."
#: bounds whose ratio is at least this are taken on a logarithmic scale
LOGARITHMIC = 2.0


@registered
@dataclass(frozen=True)
class DesignSpace:
    """Vehicle and damper with some parameters free: x in [0, 1] stands for low to high, evenly or in the logarithm.

    `paths` holds for each parameter the dotted names that share its value.
    """

    vehicle: Vehicle
    damper: Damper
    low: Number
    high: Number
    paths: tuple[tuple[str, ...], ...] = structure(())
    logarithmic: tuple[bool, ...] = structure(())

    @classmethod
    def of(cls, vehicle: Vehicle, damper: Damper, bounds: Mapping[Any, Any]) -> "DesignSpace":
        """From {"primary.stiffness_x": (1e6, 20e6), "damper.alpha": (0.0, 1.5)}, SI.

        A tuple of names as key ties them together; a third entry "log" or "linear" chooses the scale, by default logarithmic for
        positive bounds of ratio 2 or more. Raises `InputError` for unknown names, tables, and bounds that are not finite, not
        ordered or of a sign that the parameter cannot have.
        """
        if not bounds:
            raise InputError("parameters: name at least one to tune, like {'secondary.stiffness_y': (50e3, 400e3)}")
        paths, lows, highs, logarithms, seen = [], [], [], [], set()
        for key, given in bounds.items():
            names = (key,) if isinstance(key, str) else tuple(key)
            low, high, scale = _bounds(" = ".join(names), given)
            for path in names:
                if path in seen:
                    raise InputError(f"parameters: {path} is named twice")
                seen.add(path)
                _check(vehicle, damper, path, low)
            paths.append(names)
            lows.append(low)
            highs.append(high)
            logarithms.append(scale == "log" or (scale is None and low > 0.0 and high / low >= LOGARITHMIC))
        return cls(*bare(vehicle, damper), jnp.asarray(lows), jnp.asarray(highs), tuple(paths), tuple(logarithms))

    @property
    def names(self) -> list[str]:
        """One name per parameter, those of tied ones joined."""
        return [" = ".join(paths) for paths in self.paths]

    def values(self, x: Float[Array, "parameters"]) -> Float[Array, "parameters"]:
        """SI values of a point of the unit box."""
        even = self.low + (self.high - self.low) * x
        safe = jnp.where(jnp.asarray(self.logarithmic), self.low, 1.0)
        return jnp.where(jnp.asarray(self.logarithmic), safe * (jnp.abs(self.high) / safe) ** x, even)

    def position(self, values: Any) -> Float[np.ndarray, "parameters"]:
        """The point of the unit box nearest to SI values."""
        low, high, values = np.asarray(self.low), np.asarray(self.high), np.clip(np.asarray(values, float), self.low, self.high)
        logarithmic = np.asarray(self.logarithmic)
        safe = np.where(logarithmic, low, 1.0)
        logs = np.log(np.where(logarithmic, values, 1.0) / safe) / np.log(np.where(logarithmic, high / safe, 2.0))
        return np.clip(np.where(logarithmic, logs, (values - low) / (high - low)), 0.0, 1.0)

    @property
    def own(self) -> Float[np.ndarray, "parameters"]:
        """The values that vehicle and damper have, of tied parameters the first's."""
        return np.array([float(_get(self.vehicle, self.damper, paths[0])) for paths in self.paths])

    def apply(self, x: Float[Array, "parameters"]) -> Trees:
        """Vehicle and damper at a point of the unit box."""
        return with_values(self.vehicle, self.damper, self.paths, self.values(x))

    def along(self, x: Float[Array, "parameters"]) -> tuple[Trees, Trees]:
        """Vehicle and damper at a point, and their derivatives by x, parameters on the first axis."""
        return _along(self, x)

    def designed(self, vehicle: Vehicle, damper: Damper, x: Any, note: str) -> Trees:
        """The user's own vehicle and damper with plain numbers at a point, and what was tuned marked in the provenance."""
        values = [float(value) for value in self.values(jnp.asarray(x))]
        vehicle, damper = with_values(vehicle, damper, self.paths, values)
        tuned = [path for paths in self.paths for path in paths if not path.startswith(OF_DAMPER)]
        kept = tuple(entry for entry in vehicle.provenance if entry.parameter not in tuned)
        return dataclasses.replace(vehicle, provenance=(*kept, *(Provenance(path, "tuned", note) for path in tuned))), damper


def with_values(vehicle: Vehicle, damper: Damper, paths: tuple[tuple[str, ...], ...], values: Any) -> Trees:
    """Vehicle and damper with a value for each group of paths."""
    for names, value in zip(paths, values, strict=True):
        for path in names:
            if path.startswith(OF_DAMPER):
                damper = dataclasses.replace(damper, **{path.removeprefix(OF_DAMPER): value})  # type: ignore[type-var]
            else:
                vehicle = set_parameter(vehicle, path, value)
    return vehicle, damper


@jax.jit
def _along(space: DesignSpace, x: Float[Array, "parameters"]) -> tuple[Trees, Trees]:
    return space.apply(x), jax.vmap(lambda tangent: jax.jvp(space.apply, (x,), (tangent,))[1])(jnp.eye(x.shape[0]))


def _get(vehicle: Vehicle, damper: Damper, path: str) -> Any:
    if not path.startswith(OF_DAMPER):
        return get_parameter(vehicle, path)
    name = path.removeprefix(OF_DAMPER)
    known = number_names(damper)
    if name not in known:
        hint = nearest(name, known, "damper") if known else ""
        raise InputError(f"parameters: {type(damper).__name__} has no {name!r}{hint}")
    return getattr(damper, name)


def _check(vehicle: Vehicle, damper: Damper, path: str, low: float) -> None:
    value = _get(vehicle, damper, path)
    if value is None:
        raise InputError(f"parameters: {path} is not there (None); give it a value first")
    if not is_single(value):
        raise InputError(f"parameters: {path} must be a single finite number in the vehicle, not {value!r}")
    part = damper if path.startswith(OF_DAMPER) else getattr(vehicle, path.split(".")[0])
    fault = wrong_sign(about_field(part, path.rpartition(".")[2]), low)
    if fault:
        raise InputError(f"parameters: {path} {fault}; its lower bound is {low:g}")


def _bounds(name: str, given: Any) -> tuple[float, float, str | None]:
    try:
        low, high, *scale = given
        low, high = float(low), float(high)
    except (TypeError, ValueError):
        raise InputError(f"parameters: {name} needs (low, high) in SI units, not {given!r}") from None
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise InputError(f"parameters: the bounds of {name} must be two finite numbers, the lower first, not {given!r}")
    if len(scale) > 1 or (scale and scale[0] not in ("log", "linear")):
        raise InputError(f"parameters: the scale of {name} must be 'log' or 'linear', not {scale[0]!r}")
    if scale == ["log"] and low <= 0.0:
        raise InputError(f"parameters: {name} cannot have a logarithmic scale from {low:g} on")
    return low, high, scale[0] if scale else None
