"""One chunk of a sweep, wherever it is computed."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ..base.errors import InputError
from ..simulation.channels import CHANNELS
from ..simulation.simulate import Result, Simulation
from .names import placed
from .ready_made import as_dictionary

Points = dict[str, Float[np.ndarray, "_"]]


class PointCode(IntEnum):
    """What became of a point beside what the study's own code says, from 0 on."""

    NOT_COMPUTED = -3  # not yet
    NOT_A_NUMBER = -2  # a result is NaN and the study has no code of its own
    RAISED = -1  # the study raised an error at this point


class Variable(NamedTuple):
    """One result of a chunk: values with lanes on the last axis, names of the axes before it, unit."""

    values: np.ndarray
    dims: tuple[str, ...]
    unit: str


class Computed(NamedTuple):
    """A chunk's results (None where every point failed), a code per point, and the errors raised by point number."""

    variables: dict[str, Variable] | None
    code: Int[np.ndarray, "_"]
    meanings: dict[int, str]
    errors: dict[int, str]


@dataclass(frozen=True)
class Job:
    """What all chunks of a sweep share: the study, its arguments, how many lanes a full chunk has, units."""

    study: Callable[..., Any]
    given: dict[str, Any]
    lanes: int
    units: dict[str, str]


def compute(job: Job, points: Points, first: bool = False) -> Computed:
    """The results at the points. Where the study raises, the chunk is halved until the points are found that it is about.

    In a `first` chunk an error at its first, middle and last point alike is taken for a fault of the study, and raised.
    """
    count = _count(points)
    try:
        return _run(job, points, job.lanes)
    except Exception as error:
        if first and all(_fails(job, _part(points, k, k + 1)) for k in {0, count // 2, count - 1}):
            raise
        return _narrowed(job, points, error)


def _narrowed(job: Job, points: Points, error: Exception) -> Computed:
    """Two halves by themselves, not filled up: a chunk too large for the memory gets smaller this way."""
    count = _count(points)
    if count == 1:
        text = " ".join(f"{type(error).__name__}: {error}".split())
        return Computed(None, np.full(1, PointCode.RAISED, np.int16), {}, {0: text})
    halves = []
    for half in (_part(points, 0, count // 2), _part(points, count // 2, count)):
        try:
            halves.append(_run(job, half, _count(half)))
        except Exception as reason:
            halves.append(_narrowed(job, half, reason))
    return _joined(halves)


def _joined(halves: list[Computed]) -> Computed:
    there = next((half for half in halves if half.variables is not None), None)
    code = np.concatenate([half.code for half in halves])
    shift = len(halves[0].code)
    errors = halves[0].errors | {k + shift: text for k, text in halves[1].errors.items()}
    if there is None:
        return Computed(None, code, {}, errors)
    variables = {}
    for name, model in there.variables.items():
        pieces = [half.variables[name].values if half.variables else nothing(model, len(half.code)) for half in halves]
        variables[name] = model._replace(values=np.concatenate(pieces, axis=-1))
    return Computed(variables, code, there.meanings, errors)


def nothing(model: Variable, lanes: int) -> np.ndarray:
    """Values of a variable where there are none: NaN, or 0 for integers."""
    kind = model.values.dtype
    return np.full((*model.values.shape[:-1], lanes), np.nan if kind.kind in "fc" else 0, kind)


def _fails(job: Job, points: Points) -> bool:
    try:
        _run(job, points, 1)
    except Exception:
        return True
    return False


def _count(points: Points) -> int:
    return len(next(iter(points.values())))


def _part(points: Points, start: int, stop: int) -> Points:
    return {name: values[start:stop] for name, values in points.items()}


def _run(job: Job, points: Points, lanes: int) -> Computed:
    """The study on a chunk filled up to `lanes` with copies of its last point, so that every chunk has one shape."""
    count = _count(points)
    if getattr(job.study, "traced", True):
        filled: dict[str, Any] = {
            name: jnp.asarray(np.pad(values, (0, lanes - count), mode="edge")) for name, values in points.items()
        }
    else:
        filled, lanes = points, count  # what runs in Python has no shape to keep
    variables, code, meanings = _as_variables(job, job.study(**placed(job.given, filled)), lanes)
    kept = {name: variable._replace(values=variable.values[..., :count]) for name, variable in variables.items()}
    return Computed(kept, code[:count], meanings, {})


def _as_variables(job: Job, result: Any, lanes: int) -> tuple[dict[str, Variable], np.ndarray, dict[int, str]]:
    if isinstance(result, Simulation):
        return _of_simulation(result, lanes)
    given = {name: _with_lanes(name, values, lanes) for name, values in as_dictionary(result).items()}
    code = given.pop("code", None)
    if not given:
        raise InputError("the study returns nothing but a code")
    names = getattr(job.study, "dims", {})
    variables = {}
    for name, values in given.items():
        own = range(values.ndim - 1)
        dims = tuple(names.get(name, [f"{name}_{axis}" for axis in own]))
        variables[name] = Variable(values, dims, job.units.get(name, ""))
    if code is None:
        bad = np.zeros(lanes, bool)
        for values in given.values():
            if values.dtype.kind in "fc":
                bad |= np.isnan(values).reshape(-1, lanes).any(axis=0)
        return variables, np.where(bad, PointCode.NOT_A_NUMBER, 0).astype(np.int16), {0: "ok"}
    codes = getattr(job.study, "codes", ())
    return variables, code.astype(np.int16), {0: "ok"} | {entry.value: entry.name.lower() for entry in codes}


def _of_simulation(run: Simulation, lanes: int) -> tuple[dict[str, Variable], np.ndarray, dict[int, str]]:
    """The reductions of a run; time histories are not for a sweep."""
    if not run.reductions:
        raise InputError('the study returns a run without reductions: give simulate reduce=["rms:carbody_acceleration"]')
    code = _with_lanes("code", run.code, lanes).astype(np.int16)
    variables = {}
    for name, values in run.reductions.items():
        channel = CHANNELS[name.partition(":")[2]]
        found = _with_lanes(name, values, lanes)
        dims = (channel.part,) if found.ndim > 1 else ()
        variables[name.replace(":", "_")] = Variable(np.where(code == Result.OK, found, np.nan), dims, channel.unit)
    return variables, code, {entry.value: entry.name.lower() for entry in Result}


def _with_lanes(name: str, values: Any, lanes: int) -> np.ndarray:
    try:
        array = np.asarray(values)
        found = array.dtype.kind
    except (TypeError, ValueError):
        found = "O"
    if found not in "biufc":
        raise InputError(f"the study's {name!r} is {type(values).__name__}, not an array of numbers")
    if array.ndim == 0:
        return np.full(lanes, array)  # the same at every point
    if array.shape[-1] != lanes:
        raise InputError(
            f"the study's {name!r} has shape {array.shape}, but its last axis must have one value per point ({lanes} here); "
            "wrap a study of a single point in railjax.each_point"
        )
    return array
