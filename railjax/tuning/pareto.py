"""Trade-offs: the Pareto front of two quantities, by the epsilon-constraint method with exact derivatives and warm starts."""

import dataclasses
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from ..base.arguments import guarded
from ..base.checks import a_table, whole
from ..base.errors import InputError, NumericalError
from ..base.precision import require_double_precision
from ..model.damper import Damper
from ..model.motion import PASSIVE
from ..model.vehicle import Vehicle
from . import minimise
from .design_space import DesignSpace
from .quantity import Constraint, Quantity
from .tune import Evaluator, checked, notes_of, promising, start_points

if TYPE_CHECKING:
    import xarray
    from matplotlib.axes import Axes

#: relative change that ends the search for a point, and most steps of it
TOLERANCE, MOST_STEPS = 1e-4, 30


@dataclass(frozen=True)
class Front:
    """Points from the best `objective` (first) to the best `against` (last), SI; none is worse than another in both.

    `parameters` holds the values (points,) by name; `met` is False where a search ended off its limit; `evaluations` counts value
    and derivatives of both as one.
    """

    quantity: Quantity
    against_quantity: Quantity
    objective: Float[np.ndarray, "points"]
    against: Float[np.ndarray, "points"]
    parameters: dict[str, Float[np.ndarray, "points"]]
    met: Bool[np.ndarray, "points"]
    own: tuple[float, float]  # objective and against of the vehicle as it is, SI
    evaluations: int
    seconds: float  # s
    vehicle_name: str
    notes: tuple[str, ...]

    def __str__(self) -> str:
        one, other = self.quantity, self.against_quantity
        lines = [f"Pareto front of {self.vehicle_name or 'a vehicle'}: {one.name} against {other.name}"]
        lines += [
            f"  {one.shown(a):>14s}  {other.shown(b):>12s}" + ("" if met else "  (limit not reached)")
            for a, b, met in zip(self.objective, self.against, self.met, strict=True)
        ]
        lines.append(f"  the vehicle itself: {one.shown(self.own[0])}, {other.shown(self.own[1])}")
        lines.append(f"  {len(self.objective)} points, {self.evaluations} evaluations with derivatives, {self.seconds:.1f} s")
        return "\n".join([*lines, *(f"  note: {note}" for note in self.notes)])

    def plot(self, axes: "Axes", label: str = "", colour: str | None = None) -> None:
        """The front, objective upwards over `against`, and the vehicle as it is, a cross; units as printed.

        Args:
            axes: where it is drawn.
            label: of the curve in the legend, without one none.
            colour: of the curve; by default the first of the style's.
        """
        from ..base.style import COLOURS, with_powers

        one, other = self.quantity, self.against_quantity
        colour = colour or COLOURS[0]
        x, y = self.against * other.factor, self.objective * one.factor
        order = np.argsort(self.against)
        order = order[self.met[order]]
        axes.plot(x[order], y[order], "o-", ms=3, color=colour, label=label or None)
        axes.plot(self.own[1] * other.factor, self.own[0] * one.factor, "x", color=colour, label=f"{label}, as it is".strip(", "))
        axes.set(xlabel=f"{other.name}, {with_powers(other.unit)}", ylabel=f"{one.name}, {with_powers(one.unit)}")

    def to_xarray(self) -> "xarray.Dataset":
        """The front as a dataset over its points, in SI."""
        import xarray

        named = {"objective": self.objective, "against": self.against, "met": self.met, **self.parameters}
        return xarray.Dataset({name: ("point", values) for name, values in named.items()})


@guarded(points=whole(2), parameters=a_table)
def pareto(
    vehicle: Vehicle,
    parameters: Mapping[Any, Any],
    objective: Any,
    against: Any,
    constraints: Any = (),
    *,
    damper: Damper = PASSIVE,
    points: int = 20,
    tolerance: float = TOLERANCE,
) -> Front:
    """How much of one quantity must be given for how much of another: the Pareto front, by the epsilon-constraint method.

    The ends are the best of either alone; between them `against` is held at evenly spaced limits and `objective` made best by
    SLSQP with exact derivatives, each from the answer before. Points that another is better than in both are left out.

    Args:
        vehicle: a single vehicle.
        parameters: bounds in SI by dotted name, as in `tune`.
        objective: the one quantity, from `railjax.objectives`.
        against: the other, from `railjax.objectives`.
        constraints: `quantity >= limit` or `quantity <= limit`, one or several, that every point must meet.
        damper: what takes the place of rho_cy; by default the vehicle's own.
        points: number of points, 2 or more.
        tolerance: relative change of what is made best that ends the search for a point, dimensionless; by default 1e-4.

    Raises:
        InputError: as `tune`, and for fewer than 2 points.
        NumericalError: where the vehicle itself has no value of both.
    """
    require_double_precision("pareto")
    if not isinstance(points, int) or points < 2:
        raise InputError(f"points must be a whole number from 2 on, not {points!r}")
    began = time.perf_counter()
    objective, constraints = checked(objective, constraints, damper)
    against, _ = checked(against, (), damper)
    space = DesignSpace.of(vehicle, damper, parameters)
    search = _Descents(space, *_remembering(objective, against, constraints), tolerance)
    low, high = search.ends()
    found = search.between(low, high, points)
    rows = [(*search.values(x), not missed, x) for x, missed in found]
    worse = dominated(
        np.array([row[0] for row in rows]), np.array([row[1] for row in rows]), objective.greatest, against.greatest
    )
    notes = notes_of(vehicle, space)
    if np.any(worse):
        notes = (*notes, f"{np.sum(worse)} of {points} points were left out: another of the front is better in both")
        rows = [row for row, out in zip(rows, worse, strict=True) if not out]
    values = np.array([np.asarray(space.values(jnp.asarray(row[3]))) for row in rows])
    return Front(
        objective,
        against,
        np.array([row[0] for row in rows]),
        np.array([row[1] for row in rows]),
        dict(zip(space.names, values.T, strict=True)),
        np.array([row[2] for row in rows]),
        search.own,
        search.count,
        time.perf_counter() - began,
        vehicle.name,
        notes,
    )


def _remembering(
    objective: Quantity, against: Quantity, constraints: list[Constraint]
) -> tuple[Quantity, Quantity, list[Constraint]]:
    """All of them for the trials of one search; what is named twice remembers, and is computed, once."""
    trials: dict[int, Quantity] = {}

    def once(quantity: Quantity) -> Quantity:
        return trials.setdefault(id(quantity), quantity.remembering())

    kept = [dataclasses.replace(entry, quantity=once(entry.quantity)) for entry in constraints]
    return once(objective), once(against), kept


class _Descents:
    """The descents that make a front, from the vehicle itself on, and how many evaluations they took."""

    def __init__(
        self, space: DesignSpace, objective: Quantity, against: Quantity, constraints: list[Constraint], tolerance: float
    ) -> None:
        self.space, self.objective, self.against, self.constraints = space, objective, against, constraints
        self.tolerance, self.start = tolerance, start_points(space, 1, 0)[0]
        self.bound = Constraint(against, 0.0, against.greatest)
        self.both, self.count = Evaluator(space, objective, [self.bound, *constraints]), 0
        self.own = self.values(self.start)
        if not np.all(np.isfinite(self.own)):
            raise NumericalError("pareto: the vehicle itself has no value of both; start from one that has")
        self.scales = tuple(abs(value) or 1.0 for value in self.own)
        self.both.scale = self.scales[0]

    def values(self, x: np.ndarray) -> tuple[float, float]:
        """Objective and `against` at a design, SI, checked."""
        self.count += 1
        values = self.both(x[None])[0][0]
        found = self.both.objective_of(values), self.both.constraint_of(values, 0)
        if np.all(np.isfinite(found)):
            self.both.check(x)
        return found

    def alone(self, of: Quantity, under: list[Constraint]) -> Evaluator:
        """Of one of the two quantities."""
        evaluate = Evaluator(self.space, of, under)
        evaluate.scale = self.scales[0 if of is self.objective else 1]
        return evaluate

    def best(self, of: Quantity, under: list[Constraint], x: np.ndarray) -> minimise.Descent:
        """The best of one quantity from the start x, the others held."""
        found = minimise.slsqp(self.alone(of, under), x, self.tolerance, MOST_STEPS)
        self.count += found.evaluations
        return found

    def end(self, of: Quantity, starts: list[np.ndarray]) -> minimise.Descent:
        """The best of either alone may be one of many: from the given starts, and from the most promising of some points."""
        evaluate = self.alone(of, self.constraints)
        if evaluate.cheap:
            starts = [*starts, *promising(evaluate, self.start)[:1]]
            self.count += evaluate.looked_at
        return min((self.best(of, self.constraints, x) for x in starts), key=_merit)

    def ends(self) -> tuple[minimise.Descent, minimise.Descent]:
        """The best objective, and the best of what it is held against."""
        high = self.end(self.against, [self.start])
        low = self.end(self.objective, [self.start, high.x])
        return low, min(high, self.best(self.against, self.constraints, low.x), key=_merit)

    def between(self, low: minimise.Descent, high: minimise.Descent, points: int) -> list[tuple[np.ndarray, bool]]:
        """Designs from one end to the other, `points` in number, and which missed their constraints."""
        limits = [self.values(end.x)[1] for end in (low, high)]
        found = [(low.x, bool(low.failure))]
        for limit in np.linspace(limits[0], limits[1], points)[1:-1]:
            under = [dataclasses.replace(self.bound, limit=float(limit)), *self.constraints]
            before = [x for x, _ in found[-2:]]
            # on from the two points before
            point = self.best(self.objective, under, np.clip(2.0 * before[-1] - before[0], 0.0, 1.0))
            if point.failure:
                point = self.best(self.objective, under, before[-1])
            found.append((point.x, bool(point.failure)))
        # the best `against` may be had with more than one design: the best objective of these
        under = [dataclasses.replace(self.bound, limit=limits[1]), *self.constraints]
        last = self.best(self.objective, under, high.x)
        return [*found, (high.x if last.failure else last.x, False)]


def _merit(found: minimise.Descent) -> tuple[bool, float]:
    return bool(found.failure), float(found.values[0])


def dominated(
    objective: Float[np.ndarray, "points"], against: Float[np.ndarray, "points"], most: bool, most_against: bool
) -> Bool[np.ndarray, "points"]:
    """Whether another point is better in both; `most`: the greatest objective (`against`) is the best."""
    one, other = (-objective if most else objective), (-against if most_against else against)
    return np.any((one < one[:, None]) & (other < other[:, None]), axis=1)
