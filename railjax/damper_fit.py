"""The least-squares problem of a modified Bouc-Wen damper and a test record: what is unknown, and what remains of the force.

A is not fitted: only the products α A and γ A, β A can be told from a force, as z has no scale of its own.
"""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from . import bouc_wen
from .bouc_wen import BoucWen
from .record import Record, acceleration
from .typing import Number, Scalar

Unknowns = Float[Array, "unknowns"]
Samples = Float[np.ndarray, "samples"]

#: what one unknown at its scale costs, beside a cost of 1 per sample of residuals as large as the force: it only keeps those
#: that the record does not determine from running away
PRIOR = 1e-2


class Choice(NamedTuple):
    """What is fitted; static."""

    saturating: bool  # of the voltage law
    inertia: bool
    commanded: bool  # the record's command varies


class Scale(NamedTuple):
    """Where the unknowns are zero: a damper of about the record's size, and its highest voltage."""

    reference: BoucWen
    top: Number


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


def problem_of(record: Record, choice: Choice, first: int) -> Problem:
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
    return np.asarray(_simulate_once(problem_of(record, Choice(False, True, True), 0), damper, inertia))


def residuals(problem: Problem, choice: Choice, scale: Scale, unknowns: Unknowns) -> Float[Array, "residuals"]:
    """What is minimised: the squares add up to the squared error of the fitted part, and next to nothing for the prior."""
    damper, mass = decode(choice, scale, unknowns)
    error = (simulated(problem, damper, mass) - problem.force) * problem.weight
    return jnp.concatenate([error, PRIOR * unknowns / jnp.sqrt(jnp.sum(problem.weight > 0))])
