"""Minimisation in the unit box under constraints g <= 0 by SciPy's SLSQP; `augmented_lagrangian` takes optax's transformations.

Both get values and exact derivatives from one function, `evaluate(x) -> (values, slopes)`: x of shape (starts, parameters), values
(starts, 1 + constraints) with the objective first, slopes (starts, 1 + constraints, parameters). NaN marks what could not be computed.
"""

import contextlib
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

Evaluate = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]

#: violation (shares of the limit) that counts as none
MET = 1e-4
#: how much worse than anything a point counts that could not be computed
WORSE = 10.0
#: evaluations in a row without a gain worth the tolerance that end a search: a quantity that jumps (a critical speed, where another
#: family of limit cycles becomes the lowest) would have its line search go to and fro for ever
STALLED = 20


class Descent(NamedTuple):
    """One start: the best point found, values there, how many evaluations, all values in order, and why it failed ('' if not)."""

    x: Float[np.ndarray, "parameters"]
    values: Float[np.ndarray, "functions"]
    evaluations: int
    history: Float[np.ndarray, "evaluations functions"]
    failure: str


class _Stalled(Exception):
    """No gain for `STALLED` evaluations."""


class _Counted:
    """One start's evaluations: the last is kept, all values are noted, and the best point so far. Raises `_Stalled`."""

    def __init__(self, evaluate: Evaluate, tolerance: float) -> None:
        self.evaluate, self.tolerance = evaluate, tolerance
        self.history: list[np.ndarray] = []
        self.gained = 0, None  # evaluations at the last gain, and the values then
        self.x: np.ndarray | None = None
        self.finite: tuple[np.ndarray, np.ndarray] | None = None
        self.best: tuple[np.ndarray, np.ndarray] | None = None

    def __call__(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if self.x is None or not np.array_equal(self.x, x):
            values, slopes = (found[0] for found in self.evaluate(x[None]))
            self.history.append(values)
            self.x = x.copy()
            if np.all(np.isfinite(values)) and np.all(np.isfinite(slopes)):
                self.finite = values, slopes
                if self.best is None or better(values, self.best[1]):
                    self.best = x.copy(), values
                    if self.gained[1] is None or _gain(values, self.gained[1]) > self.tolerance:
                        self.gained = len(self.history), values
            elif self.finite is not None:
                # a point that is worse than the last one, so that the step is made shorter
                values, slopes = self.finite[0].copy(), self.finite[1]
                values[0] += WORSE
            self.found = values, slopes
            if self.best is not None and len(self.history) - self.gained[0] >= STALLED:
                raise _Stalled
        return self.found


def better(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether values are preferable: both met, the lower objective; else the lower violation."""
    return _gain(one, other) > 0.0


def _gain(one: np.ndarray, other: np.ndarray) -> float:
    """By how much values are preferable to others."""
    violations = np.array([np.max(values[1:], initial=0.0) for values in (one, other)])  # NaN where one of them is
    if np.all(violations <= MET):
        return float(other[0] - one[0])
    return float(violations[1] - violations[0])


def slsqp(evaluate: Evaluate, start: np.ndarray, tolerance: float, most: int) -> Descent:
    """SciPy's SLSQP with exact derivatives from one start."""
    from scipy.optimize import minimize

    at = _Counted(evaluate, tolerance)
    first = at(start)[0]
    if at.best is None and len(first) > 1 and np.all(np.isfinite(first[1:])):
        start = _towards_constraints(at, start, most)
    if at.best is None:
        return Descent(start, first, len(at.history), np.array(at.history), "the start could not be computed")
    constraints = [] if len(first) == 1 else [{"type": "ineq", "fun": lambda x: -at(x)[0][1:], "jac": lambda x: -at(x)[1][1:]}]
    with contextlib.suppress(_Stalled):
        minimize(
            lambda x: at(x)[0][0],
            start,
            jac=lambda x: at(x)[1][0],
            bounds=[(0.0, 1.0)] * len(start),
            method="SLSQP",
            constraints=constraints,
            options={"ftol": tolerance, "maxiter": most},
        )
    return ended(*at.best, np.array(at.history))


def _towards_constraints(at: _Counted, start: np.ndarray, most: int) -> np.ndarray:
    """From where the objective has no value (a vehicle that hunts) along the constraints that have, until it has one."""
    from scipy.optimize import minimize

    def violation(x: np.ndarray) -> tuple[float, np.ndarray]:
        values, slopes = at(x)
        excess = np.maximum(0.0, values[1:] + 10.0 * MET)
        slope = 2.0 * excess @ slopes[1:]
        return float(excess @ excess), np.where(np.isfinite(slope), slope, 0.0)

    def computed(_: np.ndarray) -> None:
        if at.best is not None:
            raise StopIteration

    with contextlib.suppress(_Stalled):
        minimize(
            violation,
            start,
            jac=True,
            bounds=[(0.0, 1.0)] * len(start),
            method="L-BFGS-B",
            callback=computed,
            options={"maxiter": most},
        )
    return start if at.best is None else at.best[0]


def ended(x: np.ndarray, values: np.ndarray, history: np.ndarray) -> Descent:
    met = len(values) == 1 or np.max(values[1:]) <= 10.0 * MET
    return Descent(x, values, len(history), history, "" if met else "no point that meets the constraints was found")
