"""Identification of a modified Bouc-Wen damper from a test record: many starts in one batch, Levenberg-Marquardt or Adam, a
held-out part, standard errors; beside it the genetic approach that the paper suggests, on the same budget.

A is not fitted: only the products α A and γ A, β A can be told from a force, as z has no scale of its own.
"""

import dataclasses
import functools
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from . import bouc_wen
from .bouc_wen import BoucWen
from .errors import InputError, NumericalError
from .precision import require_double_precision
from .record import Record, acceleration
from .typing import Number, Scalar

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Unknowns = Float[Array, "unknowns"]
Samples = Float[np.ndarray, "samples"]
Method = Literal["levenberg-marquardt", "adam"]
VoltageLaw = Literal["saturating", "linear"]

#: what one unknown at its scale costs, beside a cost of 1 per sample of residuals as large as the force: it only keeps those
#: that the record does not determine from running away
PRIOR = 1e-2

#: residuals are correlated over tens of milliseconds; standard errors treat blocks of the record as independent, not samples
BLOCKS = 60


class Choice(NamedTuple):
    """What is fitted; static."""

    saturating: bool  # of the voltage law
    inertia: bool
    commanded: bool  # the record's command varies


class Scale(NamedTuple):
    """Where the unknowns are zero: a damper of about the record's size, and its highest voltage."""

    reference: BoucWen
    top: Number


@dataclass(frozen=True)
class Evolution:
    """What SciPy's differential evolution made of the same budget of simulated records."""

    fit_error: float
    heldout_error: float
    heldout_correlation: float
    simulations: int
    seconds: float


@dataclass(frozen=True)
class Identification:
    """A damper fitted to one record. `parameters` go into any damper that takes `BoucWen`.

    Errors are rms(F_measured - F)/std(F_measured). `standard_errors` are by name; `correlations` is the matrix in the order of
    `names`. `inertia` (kg) is that of the moving parts between damper and load cell: the test rig's, so no part of `parameters`.
    `starts` are the fit errors that each start reached; `simulations` counts simulated records, each tangent as one.
    """

    parameters: BoucWen
    inertia: float
    names: tuple[str, ...]
    standard_errors: dict[str, float]
    correlations: Float[np.ndarray, "names names"]
    fit_error: float  # relative
    heldout_error: float  # relative
    heldout_correlation: float  # dimensionless
    published_heldout_error: float  # relative; of the published parameters, scaled to the record
    starts: tuple[float, ...]
    method: str
    simulations: int
    seconds: float  # s
    record: Record = field(repr=False)
    force: Samples = field(repr=False)  # of the fitted damper, N
    fitted_samples: slice = field(repr=False)
    evolution: Evolution | None = None

    @property
    def values(self) -> dict[str, float]:
        """Every parameter by name, `inertia` among them where it was fitted."""
        own = {f.name: float(getattr(self.parameters, f.name)) for f in bouc_wen.leaves(self.parameters)}
        return own | ({"inertia": self.inertia} if "inertia" in self.names else {})

    @property
    def warnings(self) -> list[str]:
        """Parameters that the record leaves open, and pairs that it cannot tell apart."""
        loose = [
            f"{name}: standard error above half its value; the record hardly determines it"
            for name, error in self.standard_errors.items()
            if not error < 0.5 * abs(self.values[name])
        ]
        rows, columns = np.nonzero(np.triu(np.abs(self.correlations) > 0.95, 1))
        pairs = [
            f"{self.names[i]} and {self.names[j]}: correlation {self.correlations[i, j]:+.3f}"
            for i, j in zip(rows, columns, strict=True)
        ]
        return loose + pairs

    def to_json(self) -> dict[str, Any]:
        """As `railjax damper identify --json` prints it."""
        plain = {
            key: getattr(self, key) for key in ("fit_error", "heldout_error", "heldout_correlation", "published_heldout_error")
        }
        return {
            "parameters": self.values | {"n": float(self.parameters.n)},
            **plain,
            "standard_errors": self.standard_errors,
            "correlations": {"names": list(self.names), "matrix": self.correlations.tolist()},
            "warnings": self.warnings,
            "fitted": FITTED.format(self.record.name),
            "notes": list(self.record.notes),
            "method": self.method,
            "starts": list(self.starts),
            "simulations": self.simulations,
            "seconds": self.seconds,
            "evolution": None if self.evolution is None else dataclasses.asdict(self.evolution),
        }

    def __str__(self) -> str:
        units = {f.name: f.metadata["unit"] for f in bouc_wen.leaves(self.parameters)} | {"inertia": "kg"}
        lines = [
            FITTED.format(self.record.name),
            f"error rms/std: fitted part {self.fit_error:.4f}, held-out part {self.heldout_error:.4f} "
            f"(published parameters: {self.published_heldout_error:.4f}); held-out correlation {self.heldout_correlation:.4f}",
            f"{self.method}, {len(self.starts)} starts that reached {min(self.starts):.4f} to {max(self.starts):.4f}; {self.seconds:.1f} s",
        ]
        for name, value in self.values.items():
            error = self.standard_errors.get(name)
            lines.append(
                f"  {name:10s} {value:12.5g} " + ("  fixed " if error is None else f"± {error:<8.2g}") + f" {units[name]}"
            )
        lines += [f"  beware: {entry}" for entry in self.warnings]
        if self.evolution is not None:
            e = self.evolution
            lines.append(
                f"differential evolution with as many simulations ({e.simulations}): fitted part {e.fit_error:.4f}, held-out part "
                f"{e.heldout_error:.4f}, correlation {e.heldout_correlation:.4f}; {e.seconds:.1f} s"
            )
        return "\n".join([*lines, *[f"note: {entry}" for entry in self.record.notes]])

    def plot(self, axes: "Axes", residual: "Axes | None" = None, seconds: float = 1.0) -> None:
        """Measured and fitted force over the first held-out seconds, and the whole residual where axes are given for it."""
        time, force = self.record.time, self.record.force
        begin = time[self.fitted_samples.stop - 1]
        shown = (time > begin) & (time <= begin + seconds)
        axes.plot(time[shown], 1e-3 * force[shown], color="0.35", label="measured")
        axes.plot(time[shown], 1e-3 * self.force[shown], "--", label=f"fitted damper, held-out error {self.heldout_error:.3f}")
        axes.set(xlabel="time, s", ylabel="force, kN", xlim=(time[shown][0], time[shown][-1]))
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, borderaxespad=0.2)
        if residual is not None:
            residual.plot(time, 1e-3 * (force - self.force), linewidth=0.5)
            residual.axvline(begin, color="0.35", linestyle=":", label="held out from here")
            residual.set(xlabel="time, s", ylabel="measured - fitted, kN", xlim=(0.0, time[-1]))
            residual.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), borderaxespad=0.2)


FITTED = "modified Bouc-Wen damper, fitted to this record ({}): fitted, not predicted; valid for its motions and voltages"


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
    coarse = _problem(record.until(split).every(thin), choice, first // thin)
    spread = 0.7 * np.random.default_rng(seed).standard_normal((starts, count))
    spread[0] = 0.0
    iterations = iterations or (30 if method == "levenberg-marquardt" else 300)
    ends, costs = _minimise(method, coarse, choice, scale, jnp.asarray(spread), iterations)
    errors = np.sqrt(np.where(np.isfinite(costs), costs, np.inf))
    if not np.isfinite(errors.min()):
        raise NumericalError("no start of the identification led to a finite force; check the units of the record")
    fine = _problem(record.until(split), choice, first)
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


def error_of(force: Samples, measured: Samples, part: slice) -> float:
    """rms(F_measured - F)/std(F_measured) over a part of the record."""
    return float(np.sqrt(np.mean((measured[part] - force[part]) ** 2)) / np.std(measured[part]))


def scale_of(record: Record) -> Scale:
    """The published damper scaled to the record: 1 kN and 0.1 m/s r.m.s. count as its own, and its 2.25 V as the top voltage."""
    forces, speeds = float(np.std(record.force)) / 1e3, float(np.std(record.velocity)) / 0.1
    top = float(np.max(record.command)) or 2.25
    reference = bouc_wen.scaled(BoucWen(), force=forces, displacement=speeds)
    per_volt = {name: getattr(reference, name) * 2.25 / top for name in ("c0b", "c1b", "alpha_b")}
    return Scale(dataclasses.replace(reference, **per_volt), top)


def unknown_names(choice: Choice) -> tuple[str, ...]:
    """What the entries of the vector of unknowns stand for."""
    positive = ["c0a", "c1a", "alpha_a", "k0", "k1", "beta+gamma"]
    positive += ["c0 at top", "c1 at top", "alpha at top", "eta"] if choice.commanded else []
    positive += ["saturation"] if choice.saturating else []
    signed = ["offset force", "(beta-gamma)/(beta+gamma)"] + (["inertia"] if choice.inertia else [])
    return (*positive, *signed)


def decode(choice: Choice, scale: Scale, unknowns: Unknowns) -> tuple[BoucWen, Scalar]:
    """The damper and the rig's inertia (kg) of a vector of unknowns, which is zero at the scaled published damper.

    Positive quantities are exponentials of their unknown, (β - γ)/(β + γ) is the tanh of its. The offset force is k_1 x_0; inertia counts in c_0a times 1 ms.
    """
    r, names = scale.reference, unknown_names(choice)
    q = dict(zip(names, unknowns, strict=True))

    def grown(name: str, value: Scalar) -> Scalar:
        return value * jnp.exp(q[name])

    saturation = grown("saturation", scale.top) if choice.saturating else None
    width = bouc_wen.effective(scale.top, saturation)
    changes = {}
    for own, base in (("c0", "c0"), ("c1", "c1"), ("alpha", "alpha_")):
        rest = grown("alpha_a" if own == "alpha" else f"{own}a", getattr(r, f"{base}{'a'}"))
        changes[f"{base}a"] = rest
        top = getattr(r, f"{base}a") + getattr(r, f"{base}b") * scale.top
        changes[f"{base}b"] = (grown(f"{own} at top", top) - rest) / width if choice.commanded else 0.0
    stiffness = grown("k1", r.k1)
    loop, shape = grown("beta+gamma", r.beta + r.gamma), jnp.tanh(q["(beta-gamma)/(beta+gamma)"])
    changes |= {"k0": grown("k0", r.k0), "k1": stiffness, "saturation": saturation}
    changes |= {"x0": r.k1 * r.x0 * (1.0 + q["offset force"]) / stiffness}
    changes |= {"beta": 0.5 * loop * (1.0 + shape), "gamma": 0.5 * loop * (1.0 - shape)}
    if choice.commanded:
        changes["eta"] = grown("eta", r.eta)
    return dataclasses.replace(r, **changes), q["inertia"] * 1e-3 * r.c0a if choice.inertia else jnp.zeros(())


class Problem(NamedTuple):
    """A record as JAX sees it."""

    displacement: Array
    velocity: Array
    command: Array
    force: Array
    acceleration: Array
    dt: Number
    weight: Array  # 1/(std √samples) where residuals count, else 0


def _problem(record: Record, choice: Choice, first: int) -> Problem:
    weight = np.zeros(len(record))
    weight[first:] = 1.0 / ((np.std(record.force[first:]) or 1.0) * np.sqrt(len(record) - first))
    rates = acceleration(record) if choice.inertia else np.zeros(len(record))
    columns = (record.displacement, record.velocity, record.command, record.force, rates)
    return Problem(*map(jnp.asarray, columns), record.dt, jnp.asarray(weight))


def simulated(problem: Problem, damper: BoucWen, mass: Scalar) -> Float[Array, "samples"]:
    """F of eqs. (12)-(17) over the record's motion and the inertia force beside it, N."""
    force = bouc_wen.response(damper, problem.displacement, problem.velocity, problem.command, problem.dt)
    return force + mass * problem.acceleration


_simulate_once = jax.jit(simulated)


def as_measured(record: Record, damper: BoucWen, inertia: Scalar = 0.0) -> Samples:
    """Force of a damper over a record's motion, N: also to score parameters found elsewhere."""
    return np.asarray(_simulate_once(_problem(record, Choice(False, True, True), 0), damper, inertia))


def residuals(problem: Problem, choice: Choice, scale: Scale, unknowns: Unknowns) -> Float[Array, "residuals"]:
    """What is minimised: the squares add up to the squared error of the fitted part, and next to nothing for the prior."""
    damper, mass = decode(choice, scale, unknowns)
    error = (simulated(problem, damper, mass) - problem.force) * problem.weight
    return jnp.concatenate([error, PRIOR * unknowns / jnp.sqrt(jnp.sum(problem.weight > 0))])


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

    own = functools.partial(residuals, problem, choice, scale)
    jacobian = np.asarray(jax.jit(jax.jacfwd(own))(unknowns))
    left = np.asarray(jax.jit(own)(unknowns))
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
