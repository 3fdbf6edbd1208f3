"""What the sections of a vehicle's report share: the subject, and what a section hands in."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

from ...base.errors import NumericalError
from ...base.units import KMH
from ...model.vehicle import Vehicle
from ...stability.hunting.branch import hunting_branch
from ...stability.hunting.limit_cycles import Branch
from ...stability.linear_critical import HIGHEST, LinearCritical, Stability, linear_critical, linear_critical_speed
from .page import figure, svg_uri

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: of the linear critical speed: the speed at which modes and comfort are given if none is named
SERVICE = 0.75
#: m/s; the speed instead, and the top of all ranges, where no linear critical speed is found
NO_CRITICAL = 300.0 / KMH


class Absent(Exception):
    """A section that this vehicle cannot have, and why."""


class Part(NamedTuple):
    """What a section says: HTML, the numbers behind it for JSON, and its key figures (name, value, remark)."""

    body: str
    numbers: dict[str, Any]
    headline: Sequence[tuple[str, str, str]] = ()


@dataclass
class Subject:
    """What a report is about, and what several sections need, computed once."""

    vehicle: Vehicle
    asked: float | None  # m/s
    spectrum: str
    _hunting: Any = field(default=None, repr=False)

    @cached_property
    def linear(self) -> LinearCritical:
        """With a result code instead of an error."""
        return linear_critical(self.vehicle)

    @property
    def stable(self) -> bool:
        """Whether no speed makes straight running unstable."""
        return int(self.linear.code) == Stability.STABLE

    @property
    def top(self) -> float:
        """Linear critical speed, or a usual top speed where there is none, m/s."""
        return float(self.linear.speed) if int(self.linear.code) == Stability.OK else NO_CRITICAL

    @property
    def speed(self) -> float:
        """At which modes and comfort are given, m/s: as asked, else three quarters of the critical speed in tens of km/h."""
        return max(round(SERVICE * self.top * KMH, -1), 10.0) / KMH if self.asked is None else self.asked

    def hunting(self) -> Branch:
        """The branch of limit cycles; the same `NumericalError` again where there is none."""
        if self._hunting is None:
            try:
                self._hunting = hunting_branch(self.vehicle)
            except NumericalError as error:
                self._hunting = error
        if isinstance(self._hunting, NumericalError):
            raise self._hunting
        return self._hunting

    def needs_critical_speed(self) -> float:
        """The linear critical speed, m/s; `NumericalError` for none found."""
        return float(linear_critical_speed(self.vehicle))

    def needs_hunting(self) -> Branch:
        """The branch of limit cycles; `Absent` for a vehicle that is stable at all speeds and has none."""
        if not self.stable:
            self.needs_critical_speed()
            return self.hunting()
        try:
            return self.hunting()
        except NumericalError:
            raise Absent(f"Straight running is stable up to {HIGHEST * KMH:.0f} km/h, and no limit cycle was found.") from None


def drawn(slug: str, alternative: str, caption: str, page: "Figure") -> str:
    """A figure of the report, whose title is the section's."""
    return figure(f"{slug}-figure", "", alternative, caption, svg_uri(page))
