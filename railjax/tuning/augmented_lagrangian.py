"""Any optax transformation in the unit box under constraints g <= 0, all starts as one batch (Powell, Hestenes, Rockafellar)."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from .minimise import MET, Descent, Evaluate, better, ended

#: rounds of the augmented Lagrangian, first penalty (the objective is about 1), and its growth where a constraint is not met
ROUNDS, PENALTY, GROWTH = 6, 10.0, 4.0
#: shortest step of the line search, and the decrease it asks for (Armijo)
SHORTEST, DECREASE = 2.0**-12, 1e-4


def augmented_lagrangian(
    evaluate: Evaluate, starts: np.ndarray, optimiser: Any, line_search: bool, tolerance: float, most: int
) -> list[Descent]:
    """The best point of each start, every one with multipliers and penalty of its own.

    L = f + sum (max(0, m + r g)^2 - m^2)/(2 r), minimised over z with x = (1 - cos pi z)/2, so that bounds need no care; after each
    of at most `ROUNDS` rounds m = max(0, m + r g). A lane whose step cannot be computed halves it, one whose start cannot is left out.

    Args:
        evaluate: values and slopes at points, see `minimise`.
        starts: points (starts, parameters) of the unit box.
        optimiser: an optax transformation.
        line_search: whether its steps are halved until L falls.
        tolerance: relative change of L that ends a round.
        most: number of steps of a round.
    """
    lanes = _Lanes(evaluate, starts, optimiser, line_search, tolerance)
    for _ in range(ROUNDS if lanes.multiplier.shape[1] else 1):
        lanes.descend(most)
        lanes.push()
        if not np.any(lanes.alive):
            break
    return lanes.found()


class _Lanes:
    """Where each start has come to: point z, values and slopes there, multipliers and penalty, what was seen and the best of it."""

    def __init__(self, evaluate: Evaluate, starts: np.ndarray, optimiser: Any, line_search: bool, tolerance: float) -> None:
        self.evaluate, self.starts, self.line_search, self.tolerance = evaluate, starts, line_search, tolerance
        self.begin, self.update = jax.jit(jax.vmap(optimiser.init)), jax.jit(jax.vmap(optimiser.update))
        count = len(starts)
        self.histories: list[list[np.ndarray]] = [[] for _ in range(count)]
        self.best: list[tuple[np.ndarray, np.ndarray] | None] = [None] * count
        self.z = np.arccos(1.0 - 2.0 * np.clip(starts, 0.01, 0.99)) / np.pi
        self.values, self.slopes = self.at(self.z, np.ones(count, bool))
        self.alive = np.array([entry is not None for entry in self.best])
        self.multiplier, self.penalty = np.zeros((count, self.values.shape[1] - 1)), np.full((count, 1), PENALTY)

    def at(self, z: np.ndarray, wanted: Bool[np.ndarray, "starts"]) -> tuple[np.ndarray, np.ndarray]:
        """Values and slopes by z; noted for the lanes that are `wanted`."""
        x = 0.5 * (1.0 - np.cos(np.pi * z))
        values, slopes = self.evaluate(x)
        for lane in np.flatnonzero(wanted):
            self.histories[lane].append(values[lane])
            best = self.best[lane]
            finite = np.all(np.isfinite(values[lane])) and np.all(np.isfinite(slopes[lane]))
            if finite and (best is None or better(values[lane], best[1])):
                self.best[lane] = x[lane].copy(), values[lane].copy()
        return values, slopes * (0.5 * np.pi * np.sin(np.pi * z))[:, None, :]

    def lagrangian(self, values: np.ndarray, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """L and its gradient, lanes first."""
        push = np.maximum(0.0, self.multiplier + self.penalty * values[:, 1:])
        total = values[:, 0] + np.sum((push**2 - self.multiplier**2) / (2.0 * self.penalty), axis=1)
        return total, slopes[:, 0] + np.einsum("lc,lcp->lp", push, slopes[:, 1:])

    def descend(self, most: int) -> None:
        """One round: L becomes least, by at most so many steps."""
        count = len(self.z)
        state, going = self.begin(jnp.asarray(self.z)), self.alive.copy()
        total, gradient = self.lagrangian(self.values, self.slopes)
        length, fresh, quiet = np.ones(count), np.ones(count, bool), np.zeros(count, int)
        moves = np.zeros_like(self.z)
        for _ in range(most):
            if not np.any(going):
                break
            if np.any(fresh):
                state, moves, length = self.directed(state, fresh, gradient, moves, length)
            trial = np.where(going[:, None], self.z + length[:, None] * moves, self.z)
            values, slopes = self.at(trial, going)
            new_total, new_gradient = self.lagrangian(values, slopes)
            fine = np.isfinite(new_total) & np.all(np.isfinite(new_gradient), axis=1)
            if self.line_search:
                fine &= new_total <= total + DECREASE * length * np.sum(moves * gradient, axis=1)
            taken = going & fine
            small = np.abs(total - new_total) < self.tolerance * (1.0 + np.abs(new_total))
            quiet = np.where(taken, np.where(small, quiet + 1, 0), quiet)
            self.z = np.where(taken[:, None], trial, self.z)
            self.values = np.where(taken[:, None], values, self.values)
            self.slopes = np.where(taken[:, None, None], slopes, self.slopes)
            total, gradient = np.where(taken, new_total, total), np.where(taken[:, None], new_gradient, gradient)
            length, fresh = np.where(taken, 1.0, 0.5 * length), taken
            going &= (quiet < (1 if self.line_search else 5)) & (length > SHORTEST)

    def directed(
        self, state: Any, fresh: Bool[np.ndarray, "starts"], gradient: np.ndarray, moves: np.ndarray, length: np.ndarray
    ) -> tuple[Any, np.ndarray, Float[np.ndarray, "starts"]]:
        """The optimiser's state, and the moves and first lengths of the lanes that are `fresh`, whose last step was taken."""
        safe = np.where(np.isfinite(gradient), gradient, 0.0)
        new, after = self.update(jnp.asarray(safe), state, jnp.asarray(self.z))
        keep = jnp.asarray(fresh)
        state = jax.tree.map(lambda a, b: jnp.where(keep.reshape((-1,) + (1,) * (a.ndim - 1)), a, b), after, state)
        moves = np.where(fresh[:, None], np.asarray(new), moves)
        if not self.line_search:
            return state, moves, np.where(fresh, 1.0, length)
        uphill = np.sum(moves * safe, axis=1) >= 0.0
        moves = np.where(uphill[:, None], -safe, moves)
        # no first step of a lane beyond a quarter of the box
        longest = np.minimum(1.0, 0.25 / np.maximum(np.max(np.abs(moves), axis=1), 1e-12))
        return state, moves, np.where(fresh, longest, length)

    def push(self) -> None:
        """Multipliers and penalties for the next round; what is settled takes no part in it."""
        over = self.values[:, 1:]
        violation = np.maximum(over, -self.multiplier / self.penalty)
        pushed = np.maximum(0.0, self.multiplier + self.penalty * over)
        settled = np.max(np.abs(pushed - self.multiplier), axis=1, initial=0.0) < 1e-3
        settled &= np.max(np.maximum(over, 0.0), axis=1, initial=0.0) <= MET
        self.multiplier = pushed
        far = np.max(np.abs(violation), axis=1, initial=0.0)[:, None] > MET
        self.penalty = np.where(far, self.penalty * GROWTH, self.penalty)
        self.alive &= ~settled

    def found(self) -> list[Descent]:
        """What each start came to."""
        descents = []
        for start, best, noted in zip(self.starts, self.best, self.histories, strict=True):
            history = np.array(noted)
            if best is None:
                descents.append(Descent(start, history[0], len(history), history, "the start could not be computed"))
            else:
                descents.append(ended(*best, history))
        return descents
