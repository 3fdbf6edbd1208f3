"""Robust tuning: the expected or the worst value of a quantity over scattered parameters, as an objective or constraint.

>>> scatter = Scatter({"contact.conicity": (0.05, 0.4)}, {"carbody.mass": (0.9, 1.2)})  # doctest: +SKIP
>>> railjax.tune(coach, bounds, expected(aim.comfort(50.0), scatter), [worst(aim.linear_critical_speed(), scatter) >= 65.0])  # doctest: +SKIP
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..base.arguments import ARGUMENTS, guarded
from ..base.checks import Kind
from ..base.errors import InputError
from ..base.fields import structure
from ..base.pytrees import registered
from ..base.typing import Number
from ..model.damper import Damper
from ..model.parameters import get_parameter, set_parameter
from ..model.vehicle import Vehicle
from .quantity import Quantity, Trees

#: of the worst value: the width of the smooth maximum, in shares of the mean value
WIDTH = 0.01


@dataclass(frozen=True)
class Scatter:
    """Parameters that vary evenly between bounds, independently: `values` in SI, and `factors` on what the vehicle (as tuned) has.

    `samples` points of a Latin hypercube of `seed`, the same for every trial, so that the objective stays smooth.
    """

    values: Mapping[str, tuple[float, float]] | None = None
    factors: Mapping[str, tuple[float, float]] | None = None
    samples: int = 16
    seed: int = 0

    def drawn(self) -> tuple[tuple[str, ...], tuple[bool, ...], Float[np.ndarray, "parameters samples"]]:
        """Names, which are factors, and the samples. Raises `InputError` for empty or bad scatter."""
        from scipy.stats import qmc

        given = {**(self.values or {}), **(self.factors or {})}
        if not given or len(given) != len(self.values or {}) + len(self.factors or {}):
            raise InputError("scatter: name at least one parameter, each once, like {'contact.conicity': (0.05, 0.4)}")
        if not isinstance(self.samples, int) or self.samples < 2:
            raise InputError(f"scatter: samples must be a whole number from 2 on, not {self.samples!r}")
        for name, ends in given.items():
            if len(ends) != 2 or not np.all(np.isfinite(ends)) or not ends[0] < ends[1]:
                raise InputError(f"scatter: {name} needs (low, high), not {ends!r}")
        low, high = np.array(list(given.values()), float).T
        points = qmc.LatinHypercube(len(given), rng=np.random.default_rng(self.seed)).random(self.samples)
        return tuple(given), tuple(name in (self.factors or {}) for name in given), (low + (high - low) * points).T


ARGUMENTS["scatter"] = Kind(Scatter, "a railjax.Scatter")


@guarded()
def expected(quantity: Quantity, scatter: Scatter) -> Quantity:
    """The mean over the scatter. NaN where one sample has no value (hunts)."""
    return _over(quantity, scatter, "expected")


@guarded()
def worst(quantity: Quantity, scatter: Scatter) -> Quantity:
    """The worst value over the scatter (of a critical speed the lowest); smooth within 1 % of the mean, on the safe side, and exact in the final check."""
    return _over(quantity, scatter, "worst")


def scattered(
    vehicle: Vehicle, paths: tuple[str, ...], factors: tuple[bool, ...], samples: Float[Array | np.ndarray, "parameters lanes"]
) -> Vehicle:
    """A vehicle with one lane per sample.

    Args:
        vehicle: a single vehicle.
        paths: dotted names of what is scattered.
        factors: which of them are times what the vehicle has.
        samples: values in SI or factors, shape `(parameters, lanes)`.
    """
    for path, is_factor, values in zip(paths, factors, samples, strict=True):
        vehicle = set_parameter(vehicle, path, values * get_parameter(vehicle, path) if is_factor else values)
    return vehicle


def _over(quantity: Quantity, scatter: Scatter, how: str) -> Quantity:
    paths, factors, samples = scatter.drawn()
    return Robust(quantity, jnp.asarray(samples), paths, factors, how)


@registered
@dataclass(frozen=True, eq=False)
class Robust(Quantity):
    """See `expected` and `worst`."""

    quantity: Quantity
    samples: Number
    paths: tuple[str, ...] = structure(())
    factors: tuple[bool, ...] = structure(())
    how: str = structure("expected")

    @property
    def mode(self) -> str:  # type: ignore[override]
        return self.quantity.mode

    @property
    def traced(self) -> bool:  # type: ignore[override]
        return self.quantity.traced

    @property
    def unit(self) -> str:  # type: ignore[override]
        return self.quantity.unit

    @property
    def factor(self) -> float:  # type: ignore[override]
        return self.quantity.factor

    @property
    def greatest(self) -> bool:  # type: ignore[override]
        return self.quantity.greatest

    @property
    def name(self) -> str:
        return f"{self.how} {self.quantity.name}"

    def suited(self, damper: Damper) -> "Robust":
        """By the quantity's own method for this damper."""
        return replace(self, quantity=self.quantity.suited(damper))

    def remembering(self) -> "Robust":
        """That remembers what the quantity does."""
        return replace(self, quantity=self.quantity.remembering())

    def scattered(self, vehicle: Vehicle) -> Vehicle:
        """The vehicle with one lane per sample."""
        return scattered(vehicle, self.paths, self.factors, jnp.asarray(self.samples))

    def value(self, vehicle: Vehicle, damper: Damper) -> Float[Array, ""]:
        return self._summed(self.quantity.each(self.scattered(vehicle), damper))

    def _summed(self, values: Float[Array, "samples"]) -> Float[Array, ""]:
        if self.how == "expected":
            return jnp.mean(values)
        width = WIDTH * jax.lax.stop_gradient(jnp.mean(jnp.abs(values)))
        sign = -1.0 if self.quantity.greatest else 1.0
        return sign * width * jax.nn.logsumexp(sign * values / width)

    def sharp(self, vehicle: Vehicle, damper: Damper) -> float:
        """Of the samples' sharp values, one after another."""
        found = np.array([self.quantity.sharp(*tree) for tree in self._apart(vehicle, damper)])
        if self.how == "expected":
            return float(np.mean(found))
        return float(np.min(found) if self.quantity.greatest else np.max(found))

    def check(self, vehicle: Vehicle, damper: Damper, end: Any = None) -> None:
        """Raise `InputError` where the quantity of a sample must not be differentiated."""
        if self.quantity.mode == "forward":
            for tree in self._apart(vehicle, damper):
                self.quantity.check(*tree)

    def _apart(self, vehicle: Vehicle, damper: Damper) -> list[Trees]:
        samples: list[Any] = []
        for k in range(np.shape(self.samples)[1]):
            one = replace(self, samples=np.asarray(self.samples)[:, k : k + 1]).scattered(vehicle)
            for path in self.paths:
                one = set_parameter(one, path, float(get_parameter(one, path)[0]))
            samples.append((one, damper))
        return samples
