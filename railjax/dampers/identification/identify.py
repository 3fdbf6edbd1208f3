"""Identification of a modified Bouc-Wen damper from a test record: many starts in one batch, Levenberg-Marquardt or Adam, a
held-out part, standard errors; beside it the genetic approach that the paper suggests, on the same budget.
"""

import dataclasses
import functools
import time
from collections.abc import Callable, Sequence
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ...base.arguments import guarded
from ...base.checks import FLAG, Kind, Range, whole
from ...base.errors import InputError, NumericalError
from ...base.precision import require_double_precision
from .. import bouc_wen
from ..bouc_wen import BoucWen
from .least_squares import Fit, adam, levenberg_marquardt
from .problem import (
    ITERATIONS,
    Choice,
    Problem,
    Scale,
    as_measured,
    decode,
    decoded,
    error_of,
    problem_of,
    residuals,
    scale_of,
    starts_of,
    unknown_names,
)
from .record import Record, acceleration, joined
from .record_repair import JOLT, jolts, spans, without_offset
from .result import Evolution, Identification
from .uncertainty import BLOCKS, noise_of, uncertainty, weigh_prior

Mask = Bool[np.ndarray, "samples"]
Method = Literal["levenberg-marquardt", "adam"]
VoltageLaw = Literal["saturating", "linear"]


def _records(key: str, value: Any) -> None:
    """A record, or several."""
    for one in value if isinstance(value, (list, tuple)) and value else [value]:
        Kind(Record, "a railjax.Record")(key, one)


@guarded(
    record=_records,
    leave_out_jolts=FLAG,
    starts=whole(1),
    iterations=whole(1),
    fit_share=Range("1", 0.1, 0.95),
    evolution=FLAG,
    inertia=FLAG,
)
def identify_damper(
    record: Record | Sequence[Record],
    *,
    voltage_law: VoltageLaw = "saturating",
    inertia: bool = True,
    method: Method = "levenberg-marquardt",
    starts: int = 4,
    iterations: int | None = None,
    fit_share: float = 0.7,
    settle: float = 1.0,
    leave_out_jolts: bool = False,
    evolution: bool = False,
    seed: int = 0,
) -> Identification:
    """Fit a modified Bouc-Wen damper (n = 2) to the first part of a record, and score it on the rest.

    All starts are optimised in one batch on a record thinned to about 1 ms (the published parameters, scaled to the record's
    force and velocity, and random ones around them), the best goes on with the full record by Levenberg-Marquardt. Samples are
    cut as finely as the integrator's own error asks.

    x - y at the start of each stretch, which takes 6 to 15 s to relax, is fitted. The velocity is given the mean that the
    displacement has; where the displacement is the velocity's integral, the velocity's offset is fitted. Stretches with
    accelerations far beyond the usual, as of a rig in its stops, are named.

    c_0, c_1 and α are fitted by their values at rest and at the highest voltage, which stay positive; so do k_0, k_1, β, γ, η and
    u_s.

    Args:
        record: of a test; of several, or of one whose time begins anew, the first part of each stretch is fitted, as one fit.
        voltage_law: "linear", eqs. (15)-(17), or "saturating", the same of u_s tanh(u/u_s).
        inertia: whether the mass (kg) of the rig's moving parts, between damper and load cell, is fitted.
        method: of the batch, "levenberg-marquardt" or "adam".
        starts: number of starts of the batch, 1 or more.
        iterations: number of the batch's iterations; by default 30 of Levenberg-Marquardt, 300 of Adam.
        fit_share: share of each stretch that is fitted, dimensionless, 0.1 to 0.95.
        settle: time at the start of each stretch that is not scored, s, because z and u are unknown at first.
        leave_out_jolts: whether jolted stretches are neither fitted nor scored.
        evolution: whether differential evolution gets as many simulations, for comparison.
        seed: of all that is drawn, a whole number from 0 on.

    Raises:
        InputError: for a record too short, records that are not sampled alike, options out of range, and in single precision.
        NumericalError: where no start leads anywhere.
    """
    require_double_precision("identify_damper")
    if not 0.1 <= fit_share <= 0.95:
        raise InputError(f"fit_share must lie between 0.1 and 0.95, not {fit_share:g}")
    if starts < 1:
        raise InputError(f"starts must be at least 1, not {starts}")
    record = without_offset(record if isinstance(record, Record) else joined(record))
    jolted = jolts(record, acceleration(record))
    record = _named(record, jolted, leave_out_jolts)
    fitted, apart = _parts(record, fit_share, settle, jolted if leave_out_jolts else np.zeros_like(jolted))
    if settle < 0 or np.sum(fitted) < 10 * BLOCKS or np.sum(apart) < BLOCKS:
        raise InputError(
            f"settle {settle:g} s and fit_share {fit_share:g} leave too little of a record of {record.time[-1]:.3g} s"
        )
    began = time.perf_counter()
    moved = bool(np.ptp(record.command) > 0)
    choice = Choice(voltage_law == "saturating" and moved, inertia, moved, len(record.begins), record.integrated)
    scale = scale_of(record)
    names = unknown_names(choice)
    count = len(names)

    whole, counted = record.share(fit_share), _of_share(record, fitted, fit_share)
    thin = max(1, round(1e-3 / record.dt))
    coarse_counted = np.concatenate([counted[stretch][::thin] for stretch in whole.stretches])
    coarse = _cut(problem_of(whole.every(thin), choice, coarse_counted), scale.reference, 1e-2)
    spread = 0.7 * np.random.default_rng(seed).standard_normal((starts, count))
    spread[0] = 0.0
    rough = Fit(coarse, choice, scale, starts)
    ends, costs, tried = METHODS[method](rough, spread, iterations or DEFAULT_ITERATIONS[method])
    errors = np.sqrt(np.where(np.isfinite(costs), costs, np.inf))
    if not np.isfinite(errors.min()):
        raise NumericalError("no start of the identification led to a finite force; check the units of the record")
    best = ends[np.argmin(errors)]
    # what is as long is computed by the same program
    fit = rough if thin == 1 else Fit(problem_of(whole, choice, counted, int(coarse.parts)), choice, scale, 1)
    for _ in range(2):
        # as the noise is known, so is the prior, and the error of the integrator that all samples together do not see
        noise = noise_of(fit.residual(best))
        tolerance = np.clip(0.5 * noise.unit, 1e-5, 1e-3)
        fine = _cut(weigh_prior(fit.problem, noise), decoded(choice, scale, jnp.asarray(best)).damper, tolerance)
        fit = dataclasses.replace(fit, problem=fine)
        ends, _, polishing = levenberg_marquardt(fit, best[None], POLISH, noise.unit)
        best, tried = ends[0], tried + thin * polishing
    seconds = time.perf_counter() - began

    # each of the points is a simulation of the record and its tangents; a polishing one is `thin` times as long
    simulations = tried * (count + 1)
    known = uncertainty(fit, best, rough)
    guess = jax.tree.map(float, decoded(choice, scale, jnp.asarray(best))._replace(stretches=()))
    stretches = np.asarray(decoded(choice, scale, jnp.asarray(best)).stretches)
    parts = int(fit.problem.parts)
    force = as_measured(record, guess.damper, guess.inertia, stretches, guess.offset, parts)
    published = as_measured(record, BoucWen(), parts=parts)
    rival = None
    if evolution:
        rival = _evolve(coarse, choice, scale, simulations, record, fitted, apart, seed)
    return Identification(
        parameters=guess.damper,
        inertia=guess.inertia,
        names=known.names,
        standard_errors=dict(zip(known.names, known.data.tolist(), strict=True)),
        posterior_errors=dict(zip(known.names, known.posterior.tolist(), strict=True)),
        intervals=known.intervals,
        correlations=known.correlations,
        fit_error=error_of(force, record.force, fitted),
        heldout_error=error_of(force, record.force, apart),
        heldout_correlation=float(np.corrcoef(force[apart], record.force[apart])[0, 1]),
        published_heldout_error=error_of(published, record.force, apart),
        starts=tuple(errors.tolist()),
        method=method,
        simulations=simulations,
        seconds=seconds,
        record=record,
        force=force,
        fitted_samples=fitted,
        heldout_samples=apart,
        stretches=tuple(stretches.tolist()),
        velocity_offset=guess.offset,
        parts=parts,
        evolution=rival,
    )


def _named(record: Record, jolted: Mask, left_out: bool) -> Record:
    """The record with a note of its jolts."""
    if not np.any(jolted):
        return record
    when = ", ".join(f"{begin:.4g} to {end:.4g} s" for begin, end in spans(record, jolted))
    what = "left out" if left_out else "fitted and scored all the same; leave_out_jolts (--leave-out-jolts) leaves them out"
    note = f"accelerations more than {JOLT:g} times the usual at {when}, as of a rig in its stops: {what}"
    return dataclasses.replace(record, notes=(*record.notes, note))


def _parts(record: Record, fit_share: float, settle: float, left_out: Mask) -> tuple[Mask, Mask]:
    """Samples that are fitted, and those held out, of each stretch."""
    fitted, apart = np.zeros(len(record), bool), np.zeros(len(record), bool)
    for stretch in record.stretches:
        split = stretch.start + int(fit_share * (stretch.stop - stretch.start))
        fitted[stretch.start + round(max(settle, 0.0) / record.dt) : split] = True
        apart[split : stretch.stop] = True
    return fitted & ~left_out, apart & ~left_out


def _of_share(record: Record, mask: Mask, share: float) -> Bool[np.ndarray, "first"]:
    """A mask of the samples that `Record.share` keeps."""
    return np.concatenate([mask[stretch][: int(share * (stretch.stop - stretch.start))] for stretch in record.stretches])


def _cut(problem: Problem, damper: BoucWen, tolerance: float) -> Problem:
    """The problem with samples cut as finely as a damper's motion asks."""
    starts = starts_of(jnp.zeros_like(problem.at_first), problem.at_first)
    parts = bouc_wen.parts_needed(damper, problem.motion, problem.dt, starts, tolerance)
    return problem._replace(parts=jnp.asarray(parts))


#: points at most on the full record, from where the batch ended
POLISH = 100

METHODS = {"levenberg-marquardt": levenberg_marquardt, "adam": adam}
DEFAULT_ITERATIONS = {"levenberg-marquardt": ITERATIONS, "adam": 300}


#: differential evolution's box around the scaled published damper: a factor of e^±3 for positive quantities
BOX = 3.0


def _evolve(
    coarse: Problem, choice: Choice, scale: Scale, simulations: int, record: Record, fitted: Mask, apart: Mask, seed: int
) -> Evolution:
    """SciPy's differential evolution over the same unknowns with as many simulations of the thinned record."""
    from scipy.optimize import differential_evolution

    count = len(unknown_names(choice))
    lanes = max(8, min(4 * count, simulations // 3))
    objective = _population_cost(choice)
    began, used = time.perf_counter(), 0

    def costs(population: np.ndarray) -> np.ndarray:
        nonlocal used
        used += population.shape[1]
        # always as many lanes, so that it compiles once
        filled = np.resize(population.T, (lanes, count)).T
        return np.asarray(objective(coarse, scale, jnp.asarray(filled)))[: population.shape[1]]

    random = np.random.default_rng(seed)
    first = random.uniform(-BOX, BOX, (lanes, count))
    found = differential_evolution(
        costs,
        [(-BOX, BOX)] * count,
        init=first,
        maxiter=max(1, simulations // lanes - 1),
        tol=0.0,
        polish=False,
        vectorized=True,
        updating="deferred",
        rng=random,
    )
    guess = decode(choice, scale, jnp.asarray(found.x))
    force = as_measured(record, guess.damper, guess.inertia, np.asarray(guess.stretches), guess.offset, int(coarse.parts))
    return Evolution(
        fit_error=error_of(force, record.force, fitted),
        heldout_error=error_of(force, record.force, apart),
        heldout_correlation=float(np.corrcoef(force[apart], record.force[apart])[0, 1]),
        simulations=used,
        seconds=time.perf_counter() - began,
    )


@functools.cache
def _population_cost(choice: Choice) -> Callable[..., Array]:
    def cost(problem: Problem, scale: Scale, population: Float[Array, "unknowns lanes"]) -> Float[Array, "lanes"]:
        one = functools.partial(residuals, problem, choice, scale)
        values = jax.vmap(lambda q: jnp.sum(one(q) ** 2), in_axes=1)(population)
        return jnp.where(jnp.isfinite(values), values, 1e6)

    return jax.jit(cost)
