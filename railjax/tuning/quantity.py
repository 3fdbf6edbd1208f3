"""What tuning asks of an objective or a constraint: a number of a vehicle and its damper, how it is differentiated, its sharp twin.

A quantity is a pytree, so that one compilation serves every limit, speed and track of the same kind.
"""

import dataclasses
from dataclasses import dataclass
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..base.arguments import ARGUMENTS
from ..base.batches import Batch
from ..base.checks import Kind
from ..base.errors import InputError
from ..base.units import KMH
from ..model.damper import Damper, with_law
from ..model.vehicle import Vehicle

#: a vehicle and what takes the place of rho_cy
Trees = tuple[Vehicle, Damper]


class Quantity:
    """A number by which a vehicle is judged; compare it with a limit to get a constraint, `quantity >= 72.0`.

    Subclasses are frozen dataclasses and pytrees. `value` is differentiable, in the mode that `mode` names; NaN where there is
    no such number (a vehicle that is unstable at the speed, no fold).
    """

    mode: ClassVar[str] = "reverse"  # or "forward": through time with few parameters
    traced: ClassVar[bool] = True  # False: computed on the host, outside of `jax.jit` (`host`)
    unit: ClassVar[str] = "1"  # as printed
    factor: ClassVar[float] = 1.0  # from SI to it
    greatest: ClassVar[bool] = False  # what is better: more of it?

    @property
    def name(self) -> str:
        """In words, for messages and figures."""
        raise NotImplementedError

    def value(self, vehicle: Vehicle, damper: Damper) -> Float[Array, ""]:
        """The number, SI, with laws smooth enough to be differentiated."""
        raise NotImplementedError

    def each(self, vehicle: Vehicle, damper: Damper) -> Float[Array, "lanes"]:
        """`value` of every lane of a batch, whose leaves have lanes on their last axis; one after another, as LAPACK's batched
        calls deadlock when several are at work (`Batch.in_chunks`)."""
        batch = Batch.of(vehicle, damper)
        return jax.lax.map(lambda lane: self.value(*batch.take(lane)), jnp.arange(batch.lanes))

    def sharp(self, vehicle: Vehicle, damper: Damper) -> float:
        """The number with the laws as they are (sharp saturation, flange and switching), for the final check; SI, NaN where there is none."""
        return float(self.value(vehicle, damper))

    def suited(self, damper: Damper) -> "Quantity":
        """The quantity by a method that the damper's law allows. Raises `InputError` where there is none."""
        return self

    def remembering(self) -> "Quantity":
        """The quantity for the trials of one search, where what one found makes the next cheaper."""
        return self

    def ended(self, vehicle: Vehicle, damper: Damper) -> tuple[Float[Array, ""], Any]:
        """`value`, and what `check` wants to know of its computation; of those in forward mode."""
        return self.value(vehicle, damper), None

    def check(self, vehicle: Vehicle, damper: Damper, end: Any = None) -> None:
        """Raise `InputError` where this vehicle's quantity must not be differentiated; `end` saves computing it again."""

    def shown(self, value: float) -> str:
        """A value in SI as printed."""
        return f"{value * self.factor:.4g} {self.unit}"

    def __ge__(self, limit: Any) -> "Constraint":
        return Constraint(self, _limit(limit), True)

    def __le__(self, limit: Any) -> "Constraint":
        return Constraint(self, _limit(limit), False)


ARGUMENTS["quantity"] = Kind(Quantity, "one of railjax.objectives")


def _limit(limit: Any) -> float:
    if isinstance(limit, bool) or not isinstance(limit, (int, float, np.number)) or not np.isfinite(limit):
        raise InputError(f"a constraint's limit must be a finite number (SI), not {limit!r}")
    return float(limit)


@dataclass(frozen=True)
class Constraint:
    """A quantity that must stay at or above (`above`), or at or below, a limit in SI."""

    quantity: Quantity
    limit: float
    above: bool

    @property
    def sign(self) -> float:
        """-1 where more is better."""
        return -1.0 if self.above else 1.0

    @property
    def scale(self) -> float:
        """What counts as one of the violation."""
        return abs(self.limit) or 1.0

    def remembering(self) -> "Constraint":
        """For the trials of one search."""
        return dataclasses.replace(self, quantity=self.quantity.remembering())

    def violation(self, value: Any) -> Any:
        """In shares of the limit: above 0 the constraint is not met."""
        return self.sign * (value - self.limit) / self.scale

    def __str__(self) -> str:
        return f"{self.quantity.name} {'>=' if self.above else '<='} {self.quantity.shown(self.limit)}"


def smoothed_laws(vehicle: Vehicle, damper: Damper) -> Trees:
    """Both with their sharp laws replaced by the smooth twins."""
    if vehicle.contact.law == "sharp":
        vehicle = dataclasses.replace(vehicle, contact=dataclasses.replace(vehicle.contact, law="smooth"))
    return vehicle, with_law(damper, "smooth")


def sharp_laws(vehicle: Vehicle, damper: Damper) -> Trees:
    """Both with the laws that reports are made with."""
    if vehicle.contact.law == "smooth":
        vehicle = dataclasses.replace(vehicle, contact=dataclasses.replace(vehicle.contact, law="sharp"))
    return vehicle, with_law(damper, "sharp")


def kmh(speeds: Any) -> str:
    """Speeds in m/s as printed."""
    return " and ".join(f"{speed * KMH:.4g}" for speed in np.ravel(speeds)) + " km/h"
