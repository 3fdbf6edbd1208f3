"""How well a record determines a fitted damper: errors by the data alone and with the prior, correlated residuals, profile likelihoods."""

import dataclasses
import functools
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .. import bouc_wen
from .least_squares import Fit, levenberg_marquardt
from .problem import ITERATIONS, WIDTH, Choice, Problem, Samples, Scale, Unknowns, decode, decoded

Matrix = Float[np.ndarray, "rows columns"]
Vector = Float[np.ndarray, "unknowns"]

#: residuals are correlated over tens of milliseconds; standard errors treat blocks of the record as independent, not samples
BLOCKS = 60

#: error of an unknown (of a positive quantity: relative) by the data alone beyond which the likelihood is followed, not linearised
LOOSE = 0.25

#: unknowns in which the force is linear, near enough
LINEAR = ("offset force", "inertia", "velocity offset")

#: where an unknown is held for its profile, in its own standard errors by the data alone (or widths of the prior, if these are less)
RAYS = (-2.0, -1.0, 1.0, 2.0)


class Noise(NamedTuple):
    """Of the residuals, in shares of the force's standard deviation."""

    deviation: float
    independent: float  # samples that tell as much as all of the correlated ones

    @property
    def unit(self) -> float:
        """What counts as one residual: squares in these units add up to twice the logarithm of a likelihood."""
        return float(self.deviation / np.sqrt(self.independent))


@dataclass(frozen=True)
class Uncertainty:
    """By the order of `names`; `intervals` (two standard errors to either side, where likelihoods were followed) by name."""

    names: tuple[str, ...]
    data: Float[np.ndarray, "names"]
    posterior: Float[np.ndarray, "names"]
    correlations: Float[np.ndarray, "names names"]
    intervals: dict[str, tuple[float, float]]


def noise_of(residual: Samples) -> Noise:
    """Residuals as `residuals` weighs them (of the samples that count, in order): their size, and by their autocorrelation how many
    independent ones they are worth."""
    count = len(residual)
    centred = residual - np.mean(residual)
    spectrum = np.abs(np.fft.rfft(centred, 2 * count)) ** 2
    correlation = np.fft.irfft(spectrum)[: count // 4]
    correlation = correlation / correlation[0]
    ends = np.flatnonzero(correlation < 0.05)
    time = 1.0 + 2.0 * np.sum(correlation[1 : ends[0] if ends.size else None])
    return Noise(float(np.sqrt(np.sum(residual**2))), float(count / max(time, 1.0)))


def weigh_prior(problem: Problem, noise: Noise, widths: float = 1.0) -> Problem:
    """The prior as weak beside data of this noise as its width (times `widths`) says."""
    return problem._replace(prior=jnp.full_like(problem.prior, noise.unit / (WIDTH * widths)))


def names_of(choice: Choice, example: bouc_wen.BoucWen) -> tuple[str, ...]:
    """The physical parameters that are fitted."""
    left_out = {"A"} | (set() if choice.commanded else {"c0b", "c1b", "alpha_b", "eta"})
    own = tuple(f.name for f in bouc_wen.leaves(example) if f.name not in left_out)
    return own + (("inertia",) if choice.inertia else ())


@functools.partial(jax.jit, static_argnums=(0, 2))
def _physical(
    choice: Choice, scale: Scale, names: tuple[str, ...], unknowns: Float[Array, "lanes unknowns"]
) -> tuple[Float[Array, "lanes names"], Float[Array, "lanes names unknowns"]]:
    """The parameters of these names, and their Jacobian."""

    def values(unknowns: Unknowns) -> Float[Array, "names"]:
        guess = decode(choice, scale, unknowns)
        return jnp.stack([jnp.asarray(guess.inertia if name == "inertia" else getattr(guess.damper, name)) for name in names])

    return jax.vmap(values)(unknowns), jax.vmap(jax.jacfwd(values))(unknowns)


def covariances(fit: Fit, unknowns: Vector) -> tuple[Matrix, Matrix]:
    """Of the unknowns, by the data alone and with the prior: H⁻¹ S H⁻¹, where S is Σ g_b g_bᵀ with the gradients g_b of blocks of the record,
    which holds for residuals that are correlated within a block; in each direction at least what residuals of one size, correlated as
    they are, make of it, as a few blocks may agree by chance."""
    left, jacobian = (part[0] for part in fit.at(unknowns[None]))
    counted = np.flatnonzero(np.asarray(fit.problem.weight))
    blocks = np.array_split(counted, max(BLOCKS, 2 * len(unknowns)))
    gradients = np.array([jacobian[block].T @ left[block] for block in blocks])
    gradients = gradients - gradients.mean(axis=0)  # where the prior pulls they do not add up to 0
    few = len(gradients) / (len(gradients) - len(unknowns))
    own = jacobian[counted].T @ jacobian[counted]
    values, vectors = np.linalg.eigh(own)
    values = np.maximum(values, 1e-14 * values[-1])
    inverse = vectors / values @ vectors.T
    # in units of evenly large residuals, where their S is 1
    white = vectors / np.sqrt(values) / noise_of(left[counted]).unit
    sizes, axes = np.linalg.eigh(few * white.T @ (gradients.T @ gradients) @ white)
    back = np.linalg.inv(white)
    spread = back.T @ (axes * np.maximum(sizes, 1.0)) @ axes.T @ back
    weights = np.asarray(fit.problem.prior) ** 2
    both = np.linalg.inv(own + np.diag(weights))
    return inverse @ spread @ inverse, both @ (spread + np.diag(weights**2 * WIDTH**2)) @ both


def uncertainty(fit: Fit, unknowns: Vector, coarse: Fit) -> Uncertainty:
    """Standard errors and correlations of the parameters. What the data hardly determine is followed along its likelihood, on the
    thinned record of `coarse`."""
    names = names_of(fit.choice, decoded(fit.choice, fit.scale, jnp.asarray(unknowns)).damper)
    values, slopes = (np.asarray(part)[0] for part in _physical(fit.choice, fit.scale, names, jnp.asarray(unknowns)[None]))
    data, posterior = covariances(fit, unknowns)
    by_data, by_both = (slopes @ matrix @ slopes.T for matrix in (data, posterior))
    errors, shrunk = (np.sqrt(np.diag(matrix)) for matrix in (by_data, by_both))
    own = np.sqrt(np.diag(data))
    # of the unknowns that do not enter linearly
    bent = np.array([name not in LINEAR and not name.startswith("x - y") for name in fit.names])
    hanging = np.flatnonzero(bent & (own > LOOSE))
    loose = np.any(np.abs(slopes[:, hanging]) * own[hanging] > 0.5 * errors[:, None], axis=1)
    intervals = {}
    if np.any(loose):
        low, high = _profiles(coarse, unknowns, data, hanging, names)
        for index in np.flatnonzero(loose):
            intervals[names[index]] = float(low[index]), float(high[index])
            reach = max(high[index] - values[index], values[index] - low[index])
            errors[index] = max(0.5 * reach, min(errors[index], reach))
    return Uncertainty(names, errors, shrunk, by_both / np.outer(shrunk, shrunk), intervals)


def _profiles(
    fit: Fit, best: Vector, data: Matrix, hanging: np.ndarray, names: tuple[str, ...]
) -> tuple[Float[np.ndarray, "names"], Float[np.ndarray, "names"]]:
    """The least and the largest of each parameter where twice the logarithm of the likelihood ratio is 4, over all profiles."""
    noise = noise_of(fit.residual(best))
    problem = weigh_prior(fit.problem, noise, widths=3.0)
    prior, centre = np.asarray(problem.prior), np.asarray(problem.centre)
    starts, priors, centres = [best], [prior], [centre]
    for index in hanging:
        for ray in RAYS:
            own = np.sqrt(data[index, index])
            # the others go with it as their covariance says, within what the prior thinks likely
            start = best + ray * min(own, WIDTH) * np.clip(data[index] / own**2, -1.0, 1.0)
            starts.append(start)
            held = np.arange(len(best)) == index
            priors.append(np.where(held, 1e3 * prior[0], prior))
            centres.append(np.where(held, start[index], centre))
    fit = dataclasses.replace(fit, problem=problem)
    ends, *_ = levenberg_marquardt(fit, np.stack(starts), ITERATIONS, noise.unit, np.stack(priors), np.stack(centres))
    costs = np.sum(fit.at(ends)[0] ** 2, axis=1)
    deviance = np.maximum(costs - np.min(costs), 0.0) / noise.unit**2
    reached = np.asarray(_physical(fit.choice, fit.scale, names, jnp.asarray(ends))[0])
    low, high = reached[0].copy(), reached[0].copy()
    for first in range(1, len(ends), len(RAYS)):
        for side in ((1, 0), (2, 3)):
            along = [0, *(first + np.array(side))]
            roots, places = np.sqrt(deviance[along]), reached[along]
            for k in range(1, len(along)):
                if not np.all(np.isfinite(places[k])) or not np.isfinite(roots[k]):
                    break
                share = 1.0 if roots[k] <= 2.0 else np.clip((2.0 - roots[k - 1]) / (roots[k] - roots[k - 1] + 1e-12), 0.0, 1.0)
                place = places[k - 1] + share * (places[k] - places[k - 1])
                low, high = np.minimum(low, place), np.maximum(high, place)
                if roots[k] > 2.0:
                    break
    return low, high
