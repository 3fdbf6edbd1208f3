"""Minimisation in the unit box under constraints g <= 0: SciPy's SLSQP, or any optax transformation within an augmented Lagrangian.

Both get values and exact derivatives from one function, `evaluate(x) -> (values, slopes)`: x of shape (starts, parameters), values
(starts, 1 + constraints) with the objective first, slopes (starts, 1 + constraints, parameters). NaN marks what could not be computed.
"""

import contextlib
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
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
        self.evaluate, self.history, self.tolerance = evaluate, [], tolerance
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
    return _ended(*at.best, np.array(at.history))


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


def _ended(x: np.ndarray, values: np.ndarray, history: np.ndarray) -> Descent:
    met = len(values) == 1 or np.max(values[1:]) <= 10.0 * MET
    return Descent(x, values, len(history), history, "" if met else "no point that meets the constraints was found")


#: rounds of the augmented Lagrangian, first penalty (the objective is about 1), and its growth where a constraint is not met
ROUNDS, PENALTY, GROWTH = 6, 10.0, 4.0
#: shortest step of the line search, and the decrease it asks for (Armijo)
SHORTEST, DECREASE = 2.0**-12, 1e-4


def augmented_lagrangian(
    evaluate: Evaluate, starts: np.ndarray, optimiser: Any, line_search: bool, tolerance: float, most: int
) -> list[Descent]:
    """All starts as one batch, each with multipliers and penalty of its own (Powell, Hestenes, Rockafellar).

    L = f + sum (max(0, m + r g)^2 - m^2)/(2 r), minimised over z with x = (1 - cos pi z)/2, so that bounds need no care; after each
    of at most `ROUNDS` rounds m = max(0, m + r g). `optimiser` is an optax transformation; with `line_search` its steps are
    halved until L falls. A lane whose step cannot be computed halves it, one whose start cannot is left out.
    """
    count = len(starts)
    z = np.arccos(1.0 - 2.0 * np.clip(starts, 0.01, 0.99)) / np.pi
    begin, update = jax.jit(jax.vmap(optimiser.init)), jax.jit(jax.vmap(optimiser.update))
    histories: list[list[np.ndarray]] = [[] for _ in range(count)]
    best: list[tuple[np.ndarray, np.ndarray] | None] = [None] * count

    def at(z: np.ndarray, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x = 0.5 * (1.0 - np.cos(np.pi * z))
        values, slopes = evaluate(x)
        for lane in np.flatnonzero(wanted):
            histories[lane].append(values[lane])
            finite = np.all(np.isfinite(values[lane])) and np.all(np.isfinite(slopes[lane]))
            if finite and (best[lane] is None or better(values[lane], best[lane][1])):
                best[lane] = x[lane].copy(), values[lane].copy()
        return values, slopes * (0.5 * np.pi * np.sin(np.pi * z))[:, None, :]

    values, slopes = at(z, np.ones(count, bool))
    alive = np.array([entry is not None for entry in best])
    multiplier, penalty = np.zeros((count, values.shape[1] - 1)), np.full((count, 1), PENALTY)
    rounds = ROUNDS if values.shape[1] > 1 else 1
    for _ in range(rounds):
        state, going = begin(jnp.asarray(z)), alive.copy()
        total, gradient = _lagrangian(values, slopes, multiplier, penalty)
        length, fresh, quiet = np.ones(count), np.ones(count, bool), np.zeros(count, int)
        moves = np.zeros_like(z)
        for _ in range(most):
            if not np.any(going):
                break
            if np.any(fresh):
                safe = np.where(np.isfinite(gradient), gradient, 0.0)
                new, after = update(jnp.asarray(safe), state, jnp.asarray(z))
                keep = jnp.asarray(fresh)
                state = jax.tree.map(
                    lambda a, b, keep=keep: jnp.where(keep.reshape((-1,) + (1,) * (a.ndim - 1)), a, b), after, state
                )
                moves = np.where(fresh[:, None], np.asarray(new), moves)
                if line_search:
                    uphill = np.sum(moves * safe, axis=1) >= 0.0
                    moves = np.where(uphill[:, None], -safe, moves)
                    # no first step of a lane beyond a quarter of the box
                    length = np.where(fresh, np.minimum(1.0, 0.25 / np.maximum(np.max(np.abs(moves), axis=1), 1e-12)), length)
                else:
                    length = np.where(fresh, 1.0, length)
            trial = np.where(going[:, None], z + length[:, None] * moves, z)
            new_values, new_slopes = at(trial, going)
            new_total, new_gradient = _lagrangian(new_values, new_slopes, multiplier, penalty)
            fine = np.isfinite(new_total) & np.all(np.isfinite(new_gradient), axis=1)
            if line_search:
                fine &= new_total <= total + DECREASE * length * np.sum(moves * gradient, axis=1)
            taken = going & fine
            small = np.abs(total - new_total) < tolerance * (1.0 + np.abs(new_total))
            quiet = np.where(taken, np.where(small, quiet + 1, 0), quiet)
            z = np.where(taken[:, None], trial, z)
            values, slopes = np.where(taken[:, None], new_values, values), np.where(taken[:, None, None], new_slopes, slopes)
            total, gradient = np.where(taken, new_total, total), np.where(taken[:, None], new_gradient, gradient)
            length, fresh = np.where(taken, 1.0, 0.5 * length), taken
            going &= (quiet < (1 if line_search else 5)) & (length > SHORTEST)
        violation = np.maximum(values[:, 1:], -multiplier / penalty)
        pushed = np.maximum(0.0, multiplier + penalty * values[:, 1:])
        settled = np.max(np.abs(pushed - multiplier), axis=1, initial=0.0) < 1e-3
        settled &= np.max(np.maximum(values[:, 1:], 0.0), axis=1, initial=0.0) <= MET
        multiplier = pushed
        penalty = np.where(np.max(np.abs(violation), axis=1, initial=0.0)[:, None] > MET, penalty * GROWTH, penalty)
        alive &= ~settled
        if not np.any(alive):
            break
    found = []
    for lane in range(count):
        history = np.array(histories[lane])
        if best[lane] is None:
            found.append(Descent(starts[lane], history[0], len(history), history, "the start could not be computed"))
        else:
            found.append(_ended(*best[lane], history))
    return found


def _lagrangian(
    values: np.ndarray, slopes: np.ndarray, multiplier: np.ndarray, penalty: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """L and its gradient, lanes first."""
    push = np.maximum(0.0, multiplier + penalty * values[:, 1:])
    total = values[:, 0] + np.sum((push**2 - multiplier**2) / (2.0 * penalty), axis=1)
    return total, slopes[:, 0] + np.einsum("lc,lcp->lp", push, slopes[:, 1:])
