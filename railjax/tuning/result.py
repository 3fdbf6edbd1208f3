"""What `tune` found: the tuned vehicle, how its constraints are met, and how the search went."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from ..model.damper import Damper
from ..model.vehicle import Vehicle
from . import minimise
from .design_space import DesignSpace
from .minimise import Descent
from .quantity import Constraint, Quantity

if TYPE_CHECKING:
    from matplotlib.axes import Axes


#: share of the objective by which the sharp laws may differ before the answer is called doubtful; statistical linearisation of balance
#: logic is 10 to 22 % too low where it holds
DOUBTFUL = 0.5


@dataclass(frozen=True)
class Kept:
    """A constraint in the answer: its value by the smooth computation and by the sharp laws (SI), and whether each meets it."""

    constraint: Constraint
    smooth: float
    sharp: float
    active: bool

    @property
    def met(self) -> bool:
        """By the sharp laws, to a ten thousandth of the limit."""
        return bool(self.constraint.violation(self.sharp) <= minimise.MET)

    def __str__(self) -> str:
        shown = self.constraint.quantity.shown
        verdict = "met" if self.met else "NOT MET"
        return f"{self.constraint}: {verdict}, {shown(self.sharp)} by the sharp laws ({shown(self.smooth)} smooth){', active' if self.active else ''}"


@dataclass(frozen=True)
class Tuning:
    """Result of `tune`. `vehicle` and `damper` are the tuned ones, with the laws that the given ones had.

    `parameters` and `before` are SI values by name; `objective` and `objective_sharp` the value by the smooth computation and by
    the sharp laws, `objective_before` that of the given vehicle, moved to the bounds where it lies outside (NaN where it has none); `descents` one per start, whose
    `failure` says why it is no candidate; `best` the one taken; `evaluations` of all starts; `at_bounds` the parameters that lie
    on a bound.
    """

    vehicle: Vehicle
    damper: Damper
    parameters: dict[str, float]  # SI
    before: dict[str, float]  # SI
    units: dict[str, str]
    quantity: Quantity
    objective: float  # SI
    objective_sharp: float  # SI
    objective_before: float  # SI
    constraints: tuple[Kept, ...]
    descents: tuple[Descent, ...]
    best: int  # number of the descent
    evaluations: int  # number of them
    seconds: float  # s
    optimiser: str
    at_bounds: tuple[str, ...]
    notes: tuple[str, ...]
    space: DesignSpace

    @property
    def met(self) -> bool:
        """Whether all constraints are met under the sharp laws."""
        return all(kept.met for kept in self.constraints)

    @property
    def x(self) -> Float[np.ndarray, "parameters"]:
        """The answer in the unit box."""
        return self.descents[self.best].x

    def __str__(self) -> str:
        shown = self.quantity.shown
        failed = [descent.failure for descent in self.descents if descent.failure]
        lines = [
            f"Tuning of {self.vehicle.name or 'a vehicle'}: {self.quantity.name}",
            f"  {shown(self.objective_before)} -> {shown(self.objective)} ({shown(self.objective_sharp)} by the sharp laws)",
        ]
        if not abs(self.objective_sharp - self.objective) <= DOUBTFUL * abs(self.objective):
            lines.append(
                '  doubtful: the smooth computation does not hold for this answer; narrow the bounds, or use method="time"'
            )
        for name, value in self.parameters.items():
            bound = " (at its bound)" if name in self.at_bounds else ""
            lines.append(f"  {name}: {self.before[name]:.5g} -> {value:.5g} {self.units[name]}{bound}")
        lines += [f"  {kept}" for kept in self.constraints]
        starts = f"{len(self.descents)} start(s)" + (
            f", {len(failed)} failed: {'; '.join(sorted(set(failed)))}" if failed else ""
        )
        lines.append(f"  {self.optimiser}, {starts}; {self.evaluations} evaluations with derivatives, {self.seconds:.2f} s")
        return "\n".join([*lines, *(f"  note: {note}" for note in self.notes)])

    def plot(self, axes: "Axes") -> None:
        """Objective over evaluations, one line per start; points that violate a constraint are hollow."""
        from ..base.style import COLOURS, with_powers

        factor = self.quantity.factor
        for k, descent in enumerate(self.descents):
            scale = self._scale
            met = np.max(descent.history[:, 1:], axis=1, initial=-np.inf) <= 10.0 * minimise.MET
            values, numbers = descent.history[:, 0] * scale * factor, np.arange(1, len(descent.history) + 1)
            colour = COLOURS[k % len(COLOURS)]
            label = f"start {k + 1}" + (" (failed)" if descent.failure else ", taken" if k == self.best else "")
            axes.plot(numbers, values, color=colour, linewidth=0.8, label=label if k < len(COLOURS) else None)
            axes.plot(numbers[met], values[met], "o", color=colour, ms=3)
            axes.plot(numbers[~met], values[~met], "o", color=colour, ms=3, mfc="none")
        axes.set(xlabel="evaluations", ylabel=f"{self.quantity.name}, {with_powers(self.quantity.unit)}")
        axes.legend()

    @property
    def _scale(self) -> float:
        """SI per unit of the histories' objective."""
        return self.objective / self.descents[self.best].values[0] if self.descents[self.best].values[0] else 1.0

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers, for JSON."""
        return {
            "parameters": self.parameters,
            "before": self.before,
            "units": self.units,
            "objective": {
                "name": self.quantity.name,
                "value": self.objective,
                "sharp": self.objective_sharp,
                "before": self.objective_before,
            },
            "constraints": [
                {
                    "constraint": str(kept.constraint),
                    "limit": kept.constraint.limit,
                    "value": kept.smooth,
                    "sharp": kept.sharp,
                    "met": kept.met,
                    "active": kept.active,
                }
                for kept in self.constraints
            ],
            "evaluations": self.evaluations,
            "seconds": self.seconds,
            "optimiser": self.optimiser,
            "starts": [descent.failure or "ok" for descent in self.descents],
            "at_bounds": list(self.at_bounds),
            "notes": list(self.notes),
        }
