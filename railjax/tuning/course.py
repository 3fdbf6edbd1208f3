"""Where a training stands: weights, the optimiser's memory, prices and the best so far; and its file, from which it goes on."""

import dataclasses
import io
import json
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..base.errors import InputError
from ..base.fingerprint import differing
from ..base.whole_file import write_whole
from ..dampers.control.learned import LearnedDamper

#: trained as their logarithm
POSITIVE = ("time_constants",)

Weights = dict[str, Float[Array, "..."]]


class Course(NamedTuple):
    """Where training stands between two episodes."""

    weights: Weights
    memory: Any  # of the optimiser
    prices: dict[str, Any]  # of what has a limit: Lagrange's multipliers
    aims: dict[str, Any]  # what training holds instead of each limit, times it: so that validation rides hold the limit
    best: Weights
    best_score: float
    stale: int  # validations since then
    episode: int
    history: list[tuple[float, ...]]


def weights_of(law: LearnedDamper) -> Weights:
    """What training changes, times as their logarithms."""
    found = {name: getattr(law, name) for name in LearnedDamper.TRAINED if getattr(law, name) is not None}
    return {name: jnp.log(value) if name in POSITIVE else jnp.asarray(value) for name, value in found.items()}


def with_weights(law: LearnedDamper, weights: Weights) -> LearnedDamper:
    """The law with these."""
    return dataclasses.replace(law, **{name: jnp.exp(value) if name in POSITIVE else value for name, value in weights.items()})


def _leaves_of(course: Course) -> tuple:
    return course.weights, course.memory, course.prices, course.aims, course.best


def kept(path: str | Path, course: Course, fingerprint: dict[str, str]) -> None:
    """Write where training stands."""
    leaves, written = jax.tree.leaves(_leaves_of(course)), io.BytesIO()
    numbers = {f"leaf_{k}": np.asarray(leaf) for k, leaf in enumerate(leaves)}
    np.savez(
        written, fingerprint=json.dumps(fingerprint), history=np.array(course.history), counts=np.array([course.episode, course.stale]),
        best_score=course.best_score, **numbers,
    )  # fmt: skip
    write_whole(Path(path), written.getvalue())


def taken_up(path: str | Path, course: Course, fingerprint: dict[str, str]) -> Course:
    """Where a training that was stopped stood; the beginning where there is no file."""
    if not Path(path).exists():
        return course
    with np.load(path, allow_pickle=False) as kept:
        if different := differing(json.loads(str(kept["fingerprint"])), fingerprint):
            raise InputError(f"{path} is of another training: {different}; give keep= another name")
        structure = jax.tree.structure(_leaves_of(course))
        weights, memory, prices, aims, best = structure.unflatten(
            [jnp.asarray(kept[f"leaf_{k}"]) for k in range(structure.num_leaves)]
        )
        episode, stale = (int(number) for number in kept["counts"])
        history = [tuple(float(number) for number in row) for row in kept["history"]]
        return Course(weights, memory, prices, aims, best, float(kept["best_score"]), stale, episode, history)
