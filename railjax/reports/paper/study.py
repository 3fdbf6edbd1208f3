"""What a study of the paper hands in: quantities, statements and figures; and the list of all studies.

To add one, write a function in a module that `reproduce.GROUPS` names, with `beyond=True` where the paper has no such figure,
number or statement:

    @study("fig-5", "Fig. 5: axle displacement at the stability limit")
    def axle_displacement(context: Context) -> Outcome:
        ...
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from ...model.vehicle import Vehicle

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Compared:
    """A number of the paper beside ours. `fitted`: it was a target of the calibration, so it says nothing about the model."""

    name: str
    source: str
    paper: float | None
    computed: float
    unit: str
    fitted: bool
    tolerance: float | None  # in the unit; None where the paper gives no number to compare with

    @property
    def within(self) -> bool | None:
        """Whether the two agree within the tolerance; None where there is nothing to compare."""
        if self.paper is None or self.tolerance is None:
            return None
        return bool(abs(self.computed - self.paper) <= self.tolerance)

    def as_dict(self) -> dict[str, Any]:
        """As results.json holds it."""
        return {
            "name": self.name,
            "source": self.source,
            "paper": self.paper,
            "computed": self.computed,
            "unit": self.unit,
            "fitted": self.fitted,
            "tolerance": self.tolerance,
            "within": self.within,
        }


@dataclass(frozen=True)
class Statement:
    """A claim of the paper in words, whether the model agrees, and the numbers that say so."""

    claim: str
    source: str
    holds: bool
    numbers: str


@dataclass(frozen=True)
class Picture:
    """A figure with its caption and a text for those who cannot see it."""

    slug: str
    title: str
    caption: str
    alternative: str
    figure: "Figure"


@dataclass(frozen=True)
class Outcome:
    """What a study found."""

    quantities: list[Compared] = field(default_factory=list)
    statements: list[Statement] = field(default_factory=list)
    pictures: list[Picture] = field(default_factory=list)
    assumptions: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Context:
    """What a study works on."""

    coach: Vehicle
    literal: Vehicle  # the coach of Table 1 to the letter


@dataclass(frozen=True)
class Study:
    """A study by name; `run` does the work. What goes `beyond` the paper is made only where it is asked for."""

    name: str
    title: str
    run: Callable[[Context], Outcome]
    beyond: bool = False


STUDIES: list[Study] = []


def study(
    name: str, title: str, *, beyond: bool = False
) -> Callable[[Callable[[Context], Outcome]], Callable[[Context], Outcome]]:
    """Register a function as a study; they run in the order of their definition."""

    def register(function: Callable[[Context], Outcome]) -> Callable[[Context], Outcome]:
        STUDIES.append(Study(name, title, function, beyond))
        return function

    return register
