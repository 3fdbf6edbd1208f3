"""Identification of a modified Bouc-Wen damper from a test record: many starts in one batch, Levenberg-Marquardt or Adam, a
held-out part, standard errors; beside it the genetic approach that the paper suggests, on the same budget.
"""

import functools
import time
from collections.abc import Callable
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from . import bouc_wen
from .bouc_wen import BoucWen
from .checks import FLAG, Kind, Range, guarded, whole
from .damper_fit import (
    Choice,
    Problem,
    Scale,
    Unknowns,
    as_measured,
    decode,
    error_of,
    problem_of,
    residuals,
    scale_of,
    unknown_names,
)
from .errors import InputError, NumericalError
from .identification import Evolution, Identification
from .precision import require_double_precision
from .record import Record

Method = Literal["levenberg-marquardt", "adam"]
VoltageLaw = Literal["saturating", "linear"]

#: residuals are correlated over tens of milliseconds; standard errors treat blocks of the record as independent, not samples
BLOCKS = 60


@guarded(
    record=Kind("record.Record", "a railjax.Record"),
    starts=whole(1),
    iterations=whole(1),
    fit_share=Range("1", 0.1, 0.95),
    evolution=FLAG,
    inertia=FLAG,
)
def identify_damper(
    record: Record,
    *,
    voltage_law: VoltageLaw = "saturating",
    inertia: bool = True,
    method: Method = "levenberg-marquardt",
    starts: int = 4,
    iterations: int | None = None,
    fit_share: float = 0.7,
    settle: float = 1.0,
    evolution: bool = False,
    seed: int = 0,
) -> Identification:
    """Fit a modified Bouc-Wen damper (n = 2) to the first part of a record, the share `fit_share`, and score it on the rest.

    All `starts` are optimised in one batch on a record thinned to about 1 ms (the published parameters, scaled to the record's
    force and velocity, and random ones around them), the best goes on with the full record by Levenberg-Marquardt. `iterations` of the batch: 30 of
    Levenberg-Marquardt by default, 300 of Adam. The first `settle` seconds are not scored, because the state at the start is
    unknown. `voltage_law`: eqs. (15)-(17), or the same of u_s tanh(u/u_s). `inertia`: of the rig's moving parts, between damper
    and load cell. `seed` is that
    of all that is drawn. With `evolution`, differential evolution gets as many simulations, for comparison.

    c_0, c_1 and α are fitted by their values at rest and at the highest voltage, which stay positive; so do k_0, k_1, β, γ, η
    and u_s. Raises `InputError` for a record too short or options out of range, `NumericalError` where no start leads anywhere.
    """
    require_double_precision("identify_damper")
    if not 0.1 <= fit_share <= 0.95:
        raise InputError(f"fit_share must lie between 0.1 and 0.95, not {fit_share:g}")
    if starts < 1:
        raise InputError(f"starts must be at least 1, not {starts}")
    split, first = int(fit_share * len(record)), round(settle / record.dt)
    if settle < 0 or split - first < 10 * BLOCKS or len(record) - split < BLOCKS:
        raise InputError(
            f"settle {settle:g} s and fit_share {fit_share:g} leave too little of a record of {record.time[-1]:.3g} s"
        )
    began = time.perf_counter()
    choice = Choice(voltage_law == "saturating" and np.ptp(record.command) > 0, inertia, bool(np.ptp(record.command) > 0))
    scale = scale_of(record)
    count = len(unknown_names(choice))

    thin = max(1, round(1e-3 / record.dt))
    coarse = problem_of(record.until(split).every(thin), choice, first // thin)
    spread = 0.7 * np.random.default_rng(seed).standard_normal((starts, count))
    spread[0] = 0.0
    iterations = iterations or (30 if method == "levenberg-marquardt" else 300)
    ends, costs = _minimise(method, coarse, choice, scale, jnp.asarray(spread), iterations)
    errors = np.sqrt(np.where(np.isfinite(costs), costs, np.inf))
    if not np.isfinite(errors.min()):
        raise NumericalError("no start of the identification led to a finite force; check the units of the record")
    fine = problem_of(record.until(split), choice, first)
    best, polishing = ends[np.argmin(errors)], 0
    if thin > 1:
        best, polishing = _minimise("levenberg-marquardt", fine, choice, scale, best[None], POLISH)[0][0], POLISH
    seconds = time.perf_counter() - began

    # each iteration simulates the record and its tangents; a polishing one is `thin` times as long
    simulations = (starts * iterations + polishing * thin) * (count + 1)
    names, standard, correlations = _uncertainty(fine, choice, scale, best)
    damper, mass = decode(choice, scale, best)
    force = as_measured(record, damper, mass)
    fitted, held = slice(first, split), slice(split, None)
    published = as_measured(record, BoucWen())
    rival = None
    if evolution:
        rival = _evolve(coarse, choice, scale, simulations, record, fitted, held, seed)
    return Identification(
        parameters=jax.tree.map(float, damper),
        inertia=float(mass),
        names=names,
        standard_errors=dict(zip(names, standard.tolist(), strict=True)),
        correlations=correlations,
        fit_error=error_of(force, record.force, fitted),
        heldout_error=error_of(force, record.force, held),
        heldout_correlation=float(np.corrcoef(force[held], record.force[held])[0, 1]),
        published_heldout_error=error_of(published, record.force, held),
        starts=tuple(errors.tolist()),
        method=method,
        simulations=simulations,
        seconds=seconds,
        record=record,
        force=force,
        fitted_samples=fitted,
        evolution=rival,
    )


#: iterations on the full record, from where the batch ended
POLISH = 12


def _minimise(
    method: Method, problem: Problem, choice: Choice, scale: Scale, starts: Float[Array, "starts unknowns"], iterations: int
) -> tuple[Float[Array, "starts unknowns"], Float[np.ndarray, "starts"]]:
    """Where each start leads, and its squared error there."""
    minimise = {"levenberg-marquardt": _levenberg_marquardt, "adam": _adam}[method]
    ends, costs = minimise(problem, choice, scale, starts, iterations)
    return ends, np.asarray(costs)


@functools.partial(jax.jit, static_argnums=(1, 4))
def _levenberg_marquardt(problem: Problem, choice: Choice, scale: Scale, starts: Array, iterations: int) -> tuple[Array, Array]:
    import optimistix

    solver = optimistix.LevenbergMarquardt(rtol=1e-7, atol=1e-7)

    force = _with_jacobian(problem, choice, scale)

    def one(start: Unknowns) -> tuple[Unknowns, Array]:
        found = optimistix.least_squares(
            lambda q, _: force(q), solver, start, options={"jac": "fwd"}, max_steps=iterations, throw=False
        )
        return found.value, jnp.sum(force(found.value) ** 2)

    return jax.vmap(one)(starts)


def _with_jacobian(problem: Problem, choice: Choice, scale: Scale) -> Callable[[Unknowns], Array]:
    """`residuals` of the unknowns alone, whose Jacobian is computed once, however often and by whatever tangents it is asked for.

    Not as one kernel: with arrays of a record's length JAX 0.10.1 cannot compile one for several threads.
    """

    def plain(problem: Problem, scale: Scale, q: Unknowns) -> Array:
        return residuals(problem, choice, scale, q)

    def both(problem: Problem, scale: Scale, q: Unknowns) -> tuple[Array, Array]:
        value = functools.partial(plain, problem, scale)
        return jax.jacfwd(lambda q: (value(q),) * 2, has_aux=True)(q)

    @jax.custom_jvp
    def own(q: Unknowns) -> Array:
        return plain(problem, scale, q)

    @own.defjvp
    def own_jvp(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
        jacobian, value = both(problem, scale, *primals)
        return value, jacobian @ tangents[0]

    return own


@functools.partial(jax.jit, static_argnums=(1, 4))
def _adam(problem: Problem, choice: Choice, scale: Scale, starts: Array, iterations: int) -> tuple[Array, Array]:
    import optax

    solver = optax.adam(optax.cosine_decay_schedule(0.1, iterations))

    force = _with_jacobian(problem, choice, scale)

    def cost(q: Unknowns) -> Float[Array, ""]:
        return jnp.sum(force(q) ** 2)

    def one(start: Unknowns) -> tuple[Unknowns, Array]:
        def update(carry: tuple, _: None) -> tuple[tuple, None]:
            q, state = carry
            change, state = solver.update(jax.jacfwd(cost)(q), state)
            return (optax.apply_updates(q, change), state), None

        (q, _), _ = jax.lax.scan(update, (start, solver.init(start)), length=iterations)
        return q, cost(q)

    return jax.vmap(one)(starts)


@functools.partial(jax.jit, static_argnums=1)
def _slopes(problem: Problem, choice: Choice, scale: Scale, unknowns: Unknowns) -> tuple[Array, Array]:
    """The residuals' Jacobian and themselves."""
    own = functools.partial(residuals, problem, choice, scale)
    return jax.jacfwd(lambda q: (own(q),) * 2, has_aux=True)(unknowns)


def _uncertainty(
    problem: Problem, choice: Choice, scale: Scale, unknowns: Unknowns
) -> tuple[tuple[str, ...], Float[np.ndarray, "names"], Float[np.ndarray, "names names"]]:
    """Standard errors and correlations of the parameters: H⁻¹ (Σ g_b g_bᵀ) H⁻¹ with the gradients g_b of blocks of the record,
    which holds for residuals that are correlated within a block.
    """

    left_out = {"A"} | (set() if choice.commanded else {"c0b", "c1b", "alpha_b", "eta"})
    example, _ = decode(choice, scale, unknowns)
    own_names = tuple(f.name for f in bouc_wen.leaves(example) if f.name not in left_out)

    def physical(q: Unknowns) -> Array:
        damper, mass = decode(choice, scale, q)
        values = [jnp.asarray(getattr(damper, name)) for name in own_names]
        return jnp.stack(values + ([mass] if choice.inertia else []))

    jacobian, left = (np.asarray(part) for part in _slopes(problem, choice, scale, unknowns))
    counted = np.flatnonzero(np.asarray(problem.weight))
    gradients = np.array(
        [jacobian[block].T @ left[block] for block in np.array_split(counted, max(BLOCKS, 2 * len(unknowns)))],
    )
    inverse = np.linalg.inv(jacobian.T @ jacobian)
    few = len(gradients) / (len(gradients) - len(unknowns))
    covariance = few * inverse @ (gradients.T @ gradients) @ inverse
    slopes = np.asarray(jax.jit(jax.jacfwd(physical))(unknowns))
    covariance = slopes @ covariance @ slopes.T
    standard = np.sqrt(np.diag(covariance))
    names = own_names + (("inertia",) if choice.inertia else ())
    return names, standard, covariance / np.outer(standard, standard)


#: differential evolution's box around the scaled published damper: a factor of e^±3 for positive quantities
BOX = 3.0


def _evolve(
    coarse: Problem, choice: Choice, scale: Scale, simulations: int, record: Record, fitted: slice, held: slice, seed: int
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
    force = as_measured(record, *decode(choice, scale, jnp.asarray(found.x)))
    return Evolution(
        fit_error=error_of(force, record.force, fitted),
        heldout_error=error_of(force, record.force, held),
        heldout_correlation=float(np.corrcoef(force[held], record.force[held])[0, 1]),
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
