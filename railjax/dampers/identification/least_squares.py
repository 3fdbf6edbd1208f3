"""Least squares from several starts at once, driven from Python: one compiled program gives the residuals of a few lanes with their
slopes, and Levenberg-Marquardt, Adam and the standard errors all ask it.
"""

import functools
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .problem import Choice, Problem, Samples, Scale, errors, unknown_names

Lanes = Float[np.ndarray, "lanes unknowns"]
Costs = Float[np.ndarray, "lanes"]

#: what a whole Gauss-Newton step would gain, as a share of the sum of squares, below which a lane has arrived: of some thousand
#: independent samples a few hundredths of a standard error. Closer by, the kinks of the loop's force hide which way is down
ARRIVED = 1e-6

#: change of every unknown below which it has arrived as well: where nothing is left of the residuals
STILL = 1e-7


@functools.partial(jax.jit, static_argnums=1)
def _slopes(problem: Problem, choice: Choice, scale: Scale, unknowns: Float[Array, "lanes unknowns"]) -> tuple[Array, Array]:
    own = functools.partial(errors, problem, choice, scale)
    return jax.vmap(jax.jacfwd(lambda q: (own(q),) * 2, has_aux=True))(unknowns)


@dataclass(frozen=True)
class Fit:
    """A problem, and how many lanes of it are computed at once: all calls run the same program, a lane more costs next to nothing."""

    problem: Problem
    choice: Choice
    scale: Scale
    lanes: int

    @property
    def names(self) -> tuple[str, ...]:
        return unknown_names(self.choice)

    def at(self, unknowns: Lanes) -> tuple[Float[np.ndarray, "lanes samples"], Float[np.ndarray, "lanes samples unknowns"]]:
        """Residuals of the data, and their Jacobian."""
        found = []
        for first in range(0, len(unknowns), self.lanes):
            index = np.minimum(first + np.arange(self.lanes), len(unknowns) - 1)
            jacobian, left = _slopes(self.problem, self.choice, self.scale, jnp.asarray(unknowns[index]))
            kept = min(self.lanes, len(unknowns) - first)
            found.append((np.asarray(left)[:kept], np.asarray(jacobian)[:kept]))
        left, jacobian = (np.concatenate(parts) for parts in zip(*found, strict=True))
        return left, jacobian

    def residual(self, unknowns: Float[np.ndarray, "unknowns"]) -> Samples:
        """Residuals of the samples that count."""
        return self.at(unknowns[None])[0][0][np.flatnonzero(np.asarray(self.problem.weight))]


def levenberg_marquardt(
    fit: Fit, starts: Lanes, iterations: int, unit: float = 1.0, priors: Lanes | None = None, centres: Lanes | None = None
) -> tuple[Lanes, Costs, int]:
    """Where each start leads, the squared error of data and prior there, and how many points were tried.

    The damping is Nielsen's: after a step that did as predicted a third, after one that did not 2, 4, 8 times as much.

    Args:
        fit: the problem.
        starts: unknowns.
        iterations: number of points tried at most, the starts among them.
        unit: what counts as one residual: of `Noise` near the best, where it lets the first steps be whole; from afar these lead to
            dampers without a loop.
        priors: weight of each unknown's distance from `centres`, of each lane; by default the problem's.
        centres: likewise.
    """
    q = np.array(starts, float)
    shape = q.shape
    prior, centre = (
        np.broadcast_to(np.asarray(own if given is None else given), shape)
        for own, given in ((fit.problem.prior, priors), (fit.problem.centre, centres))
    )

    def at(q: Lanes, lanes: np.ndarray) -> tuple[np.ndarray, np.ndarray, Costs]:
        """R and Qᵀ r of residuals with their prior, and the squared error."""
        left, jacobian = fit.at(q)
        left = np.concatenate([left, prior[lanes] * (q - centre[lanes])], axis=1) / unit
        jacobian = np.concatenate([jacobian, prior[lanes][:, :, None] * np.eye(shape[1])], axis=1) / unit
        finite = np.asarray(np.isfinite(left).all(axis=1) & np.isfinite(jacobian).all(axis=(1, 2)))
        orthogonal, triangle = np.linalg.qr(np.where(finite[:, None, None], jacobian, 0.0))
        across = np.einsum("lsu,ls->lu", orthogonal, np.where(finite[:, None], left, 0.0))
        return triangle, across, np.where(finite, np.sum(left**2, axis=1), np.inf)

    lanes = np.arange(len(q))
    triangle, across, cost = at(q, lanes)
    damping, growth, going = np.ones(len(q)), np.full(len(q), 2.0), np.isfinite(cost)
    tried = len(q)
    for _ in range(iterations - 1):
        going = going & (np.sum(across**2, axis=1) > ARRIVED * cost)
        lanes = np.flatnonzero(going)
        if not lanes.size:
            break
        steps = np.stack([_damped(triangle[k], across[k], damping[k]) for k in lanes])
        there = at(q[lanes] + steps, lanes)
        tried += len(lanes)
        for k, step, *new in zip(lanes, steps, *there, strict=True):
            predicted = np.sum(across[k] ** 2) - np.sum((across[k] + triangle[k] @ step) ** 2)
            gain = (cost[k] - new[2]) / predicted
            if gain > 1e-3:
                q[k] += step
                triangle[k], across[k], cost[k] = new
                damping[k] *= max(1.0 / 3.0, 1.0 - (2.0 * gain - 1.0) ** 3)
                growth[k] = 2.0
            else:
                damping[k] *= growth[k]
                growth[k] *= 2.0
            going[k] = np.abs(step).max() > STILL
    return q, cost * unit**2, tried


def _damped(triangle: np.ndarray, across: np.ndarray, damping: float) -> np.ndarray:
    """The step that makes |R s + Qᵀ r|² + damping |s|² least."""
    count = len(across)
    above = np.concatenate([triangle, np.sqrt(damping) * np.eye(count)])
    return -np.linalg.lstsq(above, np.concatenate([across, np.zeros(count)]), rcond=None)[0]


def adam(fit: Fit, starts: Lanes, iterations: int) -> tuple[Lanes, Costs, int]:
    """As `levenberg_marquardt`, by Adam with steps that fall from 0.1 to 0 as a cosine does."""
    import optax

    solver = optax.adam(optax.cosine_decay_schedule(0.1, iterations))
    update = jax.jit(solver.update)
    q, prior, centre = jnp.asarray(starts), np.asarray(fit.problem.prior), np.asarray(fit.problem.centre)
    state = solver.init(q)
    for _ in range(iterations):
        left, jacobian = fit.at(np.asarray(q))
        slope = 2.0 * np.einsum("lsu,ls->lu", jacobian, left) + 2.0 * prior**2 * (np.asarray(q) - centre)
        change, state = update(jnp.asarray(slope), state)
        q = q + change
    ends = np.asarray(q)
    cost = np.sum(fit.at(ends)[0] ** 2, axis=1) + np.sum((prior * (ends - centre)) ** 2, axis=1)
    return ends, cost, len(starts) * (iterations + 1)
