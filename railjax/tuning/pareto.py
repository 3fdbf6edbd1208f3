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
        """The front, objective upwards, and the vehicle as it is; `label` and `colour` of the curve."""
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
        """Over the points."""
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
    """How much of `objective` must be given for how much of `against`, over the `parameters` (as in `railjax.tune`).

    The ends are the best of either alone; between them `against` is held at evenly spaced limits and `objective` made best by
    SLSQP with exact derivatives, each from the answer before: so many `points` in number, each under the `constraints` and to the
    relative `tolerance` of `tune`. Raises as `tune`.
    """
    require_double_precision("pareto")
    if not isinstance(points, int) or points < 2:
        raise InputError(f"points must be a whole number from 2 on, not {points!r}")
    began = time.perf_counter()
    objective, constraints = checked(objective, constraints, damper)
    against, _ = checked(against, (), damper)
    space = DesignSpace.of(vehicle, damper, parameters)
    start = start_points(space, 1, 0)[0]
    bound = Constraint(against, 0.0, against.greatest)
    evaluate, count = Evaluator(space, objective, [bound, *constraints]), 0
    first = evaluate(start[None])[0][0]
    own = evaluate.objective_of(first), evaluate.constraint_of(first, 0)
    if not np.all(np.isfinite(own)):
        raise NumericalError("pareto: the vehicle itself has no value of both; start from one that has")
    evaluate.check(start)
    evaluate.scale = abs(own[0]) or 1.0

    def best(of: Quantity, held: list[Constraint], x: np.ndarray) -> minimise.Descent:
        nonlocal count
        alone = Evaluator(space, of, held)
        alone.scale = evaluate.scale if of is objective else abs(own[1]) or 1.0
        found = minimise.slsqp(alone, x, tolerance, MOST_STEPS)
        count += found.evaluations
        return found

    def end(of: Quantity, starts: list[np.ndarray]) -> minimise.Descent:
        """The best of either alone may be one of many: from the given starts, and from the most promising of some points."""
        nonlocal count
        alone = Evaluator(space, of, constraints)
        if alone.cheap:
            alone.scale = evaluate.scale if of is objective else abs(own[1]) or 1.0
            starts = [*starts, *promising(alone, start)[:1]]
            count += alone.looked_at
        return min((best(of, constraints, x) for x in starts), key=lambda found: (bool(found.failure), found.values[0]))

    high = end(against, [start])
    low = end(objective, [start, high.x])
    high = min(high, best(against, constraints, low.x), key=lambda found: (bool(found.failure), found.values[0]))
    ends = [float(evaluate.constraint_of(evaluate(end.x[None])[0][0], 0)) for end in (low, high)]
    count, failed = count + 3, [bool(low.failure)]
    found = [low.x]
    for limit in np.linspace(ends[0], ends[1], points)[1:-1]:
        held = [dataclasses.replace(bound, limit=float(limit)), *constraints]
        # on from the two points before
        start = found[-1] if len(found) == 1 else np.clip(2.0 * found[-1] - found[-2], 0.0, 1.0)
        point = best(objective, held, start)
        if point.failure:
            point = best(objective, held, found[-1])
        failed.append(bool(point.failure))
        found.append(point.x)
    # the best `against` may be had with more than one design: the best objective of these
    held = [dataclasses.replace(bound, limit=ends[1]), *constraints]
    last = best(objective, held, high.x)
    found.append(high.x if last.failure else last.x)
    failed.append(False)
    rows = []
    for x, missed in zip(found, failed, strict=True):
        values = evaluate(x[None])[0][0]
        evaluate.check(x)
        rows.append((evaluate.objective_of(values), evaluate.constraint_of(values, 0), not missed, x))
    count += len(rows)
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
        own,
        count,
        time.perf_counter() - began,
        vehicle.name,
        notes,
    )


def dominated(
    objective: Float[np.ndarray, "points"], against: Float[np.ndarray, "points"], most: bool, most_against: bool
) -> Bool[np.ndarray, "points"]:
    """Whether another point is better in both; `most`: the greatest objective (`against`) is the best."""
    one, other = (-objective if most else objective), (-against if most_against else against)
    return np.any((one < one[:, None]) & (other < other[:, None]), axis=1)
