"""`tune`: parameters of a vehicle and its damper for the best objective under constraints, by exact derivatives."""

import dataclasses
import time
from collections.abc import Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..base.arguments import guarded
from ..base.checks import a_table, whole
from ..base.errors import InputError, NumericalError
from ..base.precision import require_double_precision
from ..model.damper import Damper, check_damper
from ..model.motion import PASSIVE
from ..model.parameters import parameters as parameters_of
from ..model.vehicle import Vehicle
from . import minimise
from .augmented_lagrangian import augmented_lagrangian
from .derivatives import differentiated_to_the_end
from .design_space import OF_DAMPER, DesignSpace
from .minimise import Descent
from .quantity import Constraint, Quantity
from .result import Kept, Tuning

#: by default: relative change of the objective that ends a descent, and most steps of one (of a round of the augmented Lagrangian)
TOLERANCE, MOST_STEPS = 1e-6, 200
#: with `tighten`: how often limits are moved by what the sharp laws add to a constraint, and the share added to that
TIGHTENINGS, MARGIN = 4, 1e-3
OPTIMISERS = ("slsqp", "lbfgs", "adam")


class Evaluator:
    """Objective and constraints at points of the unit box, in the units of the optimisers: the objective about 1 at its start
    and falling for the better, constraints as shares of their limits."""

    def __init__(self, space: DesignSpace, objective: Quantity, constraints: Sequence[Constraint]) -> None:
        self.space, self.objective = space, objective
        self.constraints = list(constraints)
        self.scale = 1.0
        self.last: tuple[np.ndarray, list] | None = None
        self.ends: dict[bytes, list] = {}
        self.looked_at = 0  # points outside of descents

    @property
    def cheap(self) -> bool:
        """Whether no quantity is a search on the host."""
        return self.objective.traced and all(entry.quantity.traced for entry in self.constraints)

    def __call__(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if self.last is None or not np.array_equal(self.last[0], x):
            quantities = [self.objective, *(entry.quantity for entry in self.constraints)]
            each = {id(quantity): quantity for quantity in quantities}
            once = {key: differentiated_to_the_end(quantity, self.space, x) for key, quantity in each.items()}
            self.last = x.copy(), [once[id(quantity)] for quantity in quantities]
            self.ends |= {point.tobytes(): [found[2][k] for found in self.last[1]] for k, point in enumerate(x)}
        found = self.last[1]
        values, slopes = (np.stack([pair[k] for pair in found], axis=1) for k in (0, 1))
        sign = -1.0 if self.objective.greatest else 1.0
        values[:, 0], slopes[:, 0] = sign * values[:, 0] / self.scale, sign * slopes[:, 0] / self.scale
        for k, entry in enumerate(self.constraints, 1):
            values[:, k], slopes[:, k] = entry.violation(values[:, k]), entry.sign * slopes[:, k] / entry.scale
        return values, slopes

    def check(self, x: np.ndarray) -> None:
        """Raise `InputError` where a quantity must not be differentiated at a point that has been computed."""
        quantities = [self.objective, *(entry.quantity for entry in self.constraints)]
        for quantity, end in zip(quantities, self.ends[x.tobytes()], strict=True):
            quantity.check(*self.space.apply(jnp.asarray(x)), end)

    def objective_of(self, values: np.ndarray) -> float:
        """The objective in SI."""
        return float((-1.0 if self.objective.greatest else 1.0) * values[0] * self.scale)

    def constraint_of(self, values: np.ndarray, k: int) -> float:
        """The quantity of constraint k in SI."""
        entry = self.constraints[k]
        return float(entry.limit + entry.sign * entry.scale * values[k + 1])


@guarded(parameters=a_table, starts=whole(1))
def tune(
    vehicle: Vehicle,
    parameters: Mapping[Any, Any],
    objective: Any,
    constraints: Any = (),
    *,
    damper: Damper = PASSIVE,
    starts: Any = 1,
    seed: int = 0,
    optimiser: Any = None,
    tolerance: float = TOLERANCE,
    most_steps: int = MOST_STEPS,
    tighten: bool = True,
) -> Tuning:
    """The values of some parameters that make an objective best under constraints.

    With one start and no search on the host among the quantities, the most promising of a few points of the box is a second
    start, unless it lies near the answer: what is found is a local optimum, and more starts find more of them. A start that
    cannot be computed is marked in `descents` and does not disturb the others. Derivatives are exact and of the mode that suits
    each quantity. The answer is checked with the sharp laws.

    Args:
        vehicle: a single vehicle.
        parameters: bounds (low, high) in SI by dotted name ("damper.alpha" for the damper's own); a tuple of names ties them, and
            a third entry "log" or "linear" chooses the scale (by default logarithmic for positive bounds of ratio 2 or more).
        objective: from `railjax.objectives`; critical speeds and damping are made greatest, all else least.
        constraints: `quantity >= limit` or `quantity <= limit`, limits in SI, one or several.
        damper: what takes the place of rho_cy; by default the vehicle's own.
        starts: number of starts; the first is the vehicle itself, the others are drawn by a Sobol sequence.
        seed: of that sequence, a whole number from 0 on.
        optimiser: "slsqp" (SciPy's, the default: one start after another), "lbfgs" (optax's in an augmented Lagrangian, all
            starts as one batch), "adam", or any optax transformation.
        tolerance: relative change of the objective that ends a descent, dimensionless; by default 1e-6.
        most_steps: number of steps that ends a descent (of a round of the augmented Lagrangian); by default 200.
        tighten: where the sharp laws do not meet a constraint, whether the smooth computation's limit is moved by the difference
            and the search goes on from there, up to 4 times.

    Raises:
        InputError: for bad names, bounds and constraints, where a run would be differentiated that hunts, and in single
            precision.
        NumericalError: where no start leads anywhere.

    Examples:
        >>> from railjax import objectives as aim
        >>> railjax.tune(
        ...     coach,
        ...     {"primary.stiffness_x": (1e6, 20e6), "secondary.damping_y": (5e3, 80e3)},
        ...     aim.comfort(220 / 3.6),
        ...     [aim.linear_critical_speed() >= 260 / 3.6, aim.travel(220 / 3.6) <= 0.06],
        ... )  # doctest: +SKIP
    """
    require_double_precision("tune")
    began = time.perf_counter()
    check_damper(damper)
    objective, constraints = checked(objective, constraints, damper)
    space = DesignSpace.of(vehicle, damper, parameters)
    name, run = _engine(optimiser, tolerance, most_steps)
    points = start_points(space, starts, seed)
    evaluate = Evaluator(space, objective.remembering(), [entry.remembering() for entry in constraints])
    first = evaluate.objective_of(evaluate(points)[0][0])
    evaluate.check(points[0])
    evaluate.scale = abs(first) if np.isfinite(first) and first != 0.0 else 1.0
    descents = run(evaluate, points)
    if starts == 1 and optimiser is None and evaluate.cheap and not descents[0].failure:
        descents += [minimise.slsqp(evaluate, x, tolerance, most_steps) for x in promising(evaluate, descents[0].x, seed)[:1]]
    best = _best(descents)
    if best is None:
        raise NumericalError(f"tune: no start could be computed; {_why(evaluate, points[0])}")
    count = evaluate.looked_at + sum(descent.evaluations for descent in descents)
    tuned, kept, sharp = _judged(evaluate, vehicle, damper, descents[best], constraints)
    for _ in range(TIGHTENINGS if tighten else 0):
        if all(entry.met for entry in kept) or descents[best].failure:
            break
        evaluate.constraints = [_tightened(used, entry) for used, entry in zip(evaluate.constraints, kept, strict=True)]
        again = minimise.slsqp(evaluate, descents[best].x, tolerance, most_steps)
        count += again.evaluations
        if again.failure:
            break
        descents[best] = again
        tuned, kept, sharp = _judged(evaluate, vehicle, damper, again, constraints)
    x = descents[best].x
    evaluate.check(x)
    values, own = np.asarray(space.values(jnp.asarray(x))).tolist(), space.own.tolist()
    return Tuning(
        *tuned,
        parameters=dict(zip(space.names, values, strict=True)),
        before=dict(zip(space.names, own, strict=True)),
        units=_units(vehicle, space),
        quantity=objective,
        objective=evaluate.objective_of(descents[best].values),
        objective_sharp=sharp,
        objective_before=first,
        constraints=tuple(kept),
        descents=tuple(descents),
        best=best,
        evaluations=count,
        seconds=time.perf_counter() - began,
        optimiser=name,
        at_bounds=tuple(name for name, at in zip(space.names, x, strict=True) if min(at, 1.0 - at) < 1e-3),
        notes=notes_of(vehicle, space),
        space=space,
    )


def checked(objective: Any, constraints: Any, damper: Damper) -> tuple[Quantity, list[Constraint]]:
    """Both by the methods that suit the damper. Raises `InputError` for what is neither."""
    if not isinstance(objective, Quantity):
        raise InputError(f"objective must be one of railjax.objectives, like objectives.comfort(60.0), not {objective!r}")
    entries = [constraints] if isinstance(constraints, Constraint) else list(constraints)
    for entry in entries:
        if not isinstance(entry, Constraint):
            raise InputError(f"constraints: write them as quantity >= limit or quantity <= limit, not {entry!r}")
    suited = [dataclasses.replace(entry, quantity=entry.quantity.suited(damper)) for entry in entries]
    return objective.suited(damper), suited


def start_points(space: DesignSpace, starts: Any, seed: int) -> Float[np.ndarray, "starts parameters"]:
    """The vehicle's own values, and points of a scrambled Sobol sequence."""
    if not isinstance(starts, int) or starts < 1:
        raise InputError(f"starts must be a positive whole number, not {starts!r}")
    own = space.position(space.own)[None]
    if starts == 1:
        return own
    from scipy.stats import qmc

    power = int(np.ceil(np.log2(starts)))
    drawn = qmc.Sobol(own.shape[1], rng=np.random.default_rng(seed)).random_base2(power)[: starts - 1]
    return np.concatenate([own, drawn])


#: points of the box looked at for a second start (three a parameter at most), and how far from the answer (largest parameter, share of its range) one must lie
LOOKED_AT, ELSEWHERE = 8, 0.15


def promising(
    evaluate: Evaluator, known: Float[np.ndarray, "parameters"], seed: int = 0
) -> list[Float[np.ndarray, "parameters"]]:
    """Points of a Sobol sequence away from a `known` optimum, the best first: those that meet the constraints, then by violation. One by
    one, because a batch of its own would be compiled first."""
    points = start_points(evaluate.space, min(LOOKED_AT, 3 * len(known)) + 1, seed)[1:]
    away = [x for x in points if np.max(np.abs(x - known)) > ELSEWHERE]
    values = [evaluate(x[None])[0][0] for x in away]
    evaluate.looked_at += len(away)
    computed = [k for k, found in enumerate(values) if np.all(np.isfinite(found))]
    merit = lambda k: (max(0.0, *values[k][1:]) if len(values[k]) > 1 else 0.0, values[k][0])  # noqa: E731
    return [away[k] for k in sorted(computed, key=merit)]


def _engine(optimiser: Any, tolerance: float, most: int) -> tuple[str, Any]:
    """The optimiser's name, and a function of the evaluator and the starts."""
    if optimiser in (None, "slsqp"):
        return "SLSQP", lambda evaluate, points: [minimise.slsqp(evaluate, point, tolerance, most) for point in points]
    import optax

    if optimiser == "lbfgs":
        name, rule, search = "L-BFGS, augmented Lagrangian", optax.chain(optax.scale_by_lbfgs(), optax.scale(-1.0)), True
    elif optimiser == "adam":
        name, rule, search = "Adam, augmented Lagrangian", optax.adam(0.02), False
    elif isinstance(optimiser, str):
        raise InputError(f"optimiser must be one of {', '.join(OPTIMISERS)} or an optax transformation, not {optimiser!r}")
    elif not (hasattr(optimiser, "init") and hasattr(optimiser, "update")):
        raise InputError(f"optimiser {optimiser!r} is no optax transformation: it has no init and update")
    else:
        name, rule, search = "optax, augmented Lagrangian", optimiser, False
    return name, lambda evaluate, points: augmented_lagrangian(evaluate, points, rule, search, tolerance, most)


def _best(descents: list[Descent]) -> int | None:
    """The best start; of those that do not meet the constraints the one that violates them least; None if none was computed."""
    best = None
    for k, descent in enumerate(descents):
        if np.all(np.isfinite(descent.values)) and (best is None or minimise.better(descent.values, descents[best].values)):
            best = k
    return best


def _why(evaluate: Evaluator, x: np.ndarray) -> str:
    values = evaluate(x[None])[0][0]
    names = [evaluate.objective.name, *(entry.quantity.name for entry in evaluate.constraints)]
    bad = [name for name, value in zip(names, values, strict=True) if not np.isfinite(value)]
    return f"at the first there is no {', no '.join(bad) or 'derivative'} (unstable there?): start elsewhere or change the bounds"


def _judged(
    evaluate: Evaluator, vehicle: Vehicle, damper: Damper, descent: Descent, wanted: list[Constraint]
) -> tuple[tuple[Vehicle, Damper], list[Kept], float]:
    """The tuned vehicle and damper, the constraints as they were wanted, and the objective by the sharp laws."""
    tuned = evaluate.space.designed(vehicle, damper, descent.x, f"tuned for {evaluate.objective.name}")
    kept = [
        Kept(entry, evaluate.constraint_of(descent.values, k), entry.quantity.sharp(*tuned), bool(descent.values[k + 1] > -1e-3))
        for k, entry in enumerate(wanted)
    ]
    return tuned, kept, evaluate.objective.sharp(*tuned)


def _tightened(used: Constraint, kept: Kept) -> Constraint:
    """The limit moved by as much as the sharp laws are worse than the smooth computation."""
    if kept.met:
        return used
    gap = kept.constraint.sign * (kept.sharp - kept.smooth) + MARGIN * kept.constraint.scale
    return dataclasses.replace(used, limit=kept.constraint.limit - kept.constraint.sign * gap)


def _units(vehicle: Vehicle, space: DesignSpace) -> dict[str, str]:
    known = {path: entry.metadata["unit"] for path, entry in parameters_of(vehicle)}
    return {name: known.get(paths[0], "") for name, paths in zip(space.names, space.paths, strict=True)}


def notes_of(vehicle: Vehicle, space: DesignSpace) -> tuple[str, ...]:
    """What of the vehicle's values was fitted or assumed, and whether it is that which was tuned."""
    tuned = {path for paths in space.paths for path in paths if not path.startswith(OF_DAMPER)}
    doubtful = [entry for entry in vehicle.provenance if entry.status in ("calibrated", "assumed")]
    changed = [f"{entry.parameter} ({entry.status})" for entry in doubtful if entry.parameter in tuned]
    rest = [f"{entry.parameter} ({entry.status})" for entry in doubtful if entry.parameter not in tuned]
    notes = [f"tuned away from values that were not published: {', '.join(changed)}"] if changed else []
    return (*notes, *([f"rests on {', '.join(rest)}"] if rest else []))
