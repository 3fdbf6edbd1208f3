"""The least-squares problem of a modified Bouc-Wen damper and a test record: what is unknown, and what remains of the force.

A is not fitted: only the products α A and γ A, β A can be told from a force, as z has no scale of its own.
"""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ...base.typing import Number, Scalar
from .. import bouc_wen
from ..bouc_wen import BoucWen
from .record import Record, acceleration

Unknowns = Float[Array, "unknowns"]
Samples = Float[np.ndarray, "samples"]

#: what one unknown at its scale costs, beside a cost of 1 per sample of residuals as large as the force: it only keeps those
#: that the record does not determine from running away, before the noise is known and `weigh_prior` can say how far they may go
PRIOR = 1e-3

#: standard deviation of the prior: positive quantities lie within a factor of e² of the scaled published damper's
WIDTH = 2.0

#: of Levenberg-Marquardt, from afar
ITERATIONS = 30


class Choice(NamedTuple):
    """What is fitted; static."""

    saturating: bool  # of the voltage law
    inertia: bool
    commanded: bool  # the record's command varies
    stretches: int = 1  # of the record, each with an unknown x - y at its start
    drifting: bool = False  # the displacement is the integral of a velocity whose offset is unknown


class Scale(NamedTuple):
    """Where the unknowns are zero: a damper of about the record's size, and its highest voltage; the size of the motion."""

    reference: BoucWen
    top: Number
    travel: Number  # m, r.m.s.
    speed: Number  # m/s, r.m.s.


class Guess(NamedTuple):
    """What a vector of unknowns says."""

    damper: BoucWen
    inertia: Scalar  # kg
    stretches: Float[Array, "stretches"]  # x - y at the start of each, m
    offset: Scalar  # of the velocity, m/s


def error_of(force: Samples, measured: Samples, part: Bool[np.ndarray, "samples"] | slice) -> float:
    """rms(F_measured - F)/std(F_measured) over a part of the record."""
    return float(np.sqrt(np.mean((measured[part] - force[part]) ** 2)) / np.std(measured[part]))


def scale_of(record: Record) -> Scale:
    """The published damper scaled to the record: 1 kN and 0.1 m/s r.m.s. count as its own, and its 2.25 V as the top voltage."""
    forces, speeds = float(np.std(record.force)) / 1e3, float(np.std(record.velocity)) / 0.1
    top = float(np.max(record.command)) or 2.25
    reference = bouc_wen.scaled(BoucWen(), force=forces, displacement=speeds)
    per_volt = {name: getattr(reference, name) * 2.25 / top for name in ("c0b", "c1b", "alpha_b")}
    return Scale(dataclasses.replace(reference, **per_volt), top, float(np.std(record.displacement)), 0.1 * speeds)


def unknown_names(choice: Choice) -> tuple[str, ...]:
    """What the entries of the vector of unknowns stand for."""
    positive = ["c0a", "c1a", "alpha_a", "k0", "k1", "beta+gamma"]
    positive += ["c0 at top", "c1 at top", "alpha at top", "eta"] if choice.commanded else []
    positive += ["saturation"] if choice.saturating else []
    signed = ["offset force", "(beta-gamma)/(beta+gamma)"] + (["inertia"] if choice.inertia else [])
    signed += ["velocity offset"] if choice.drifting else []
    return (*positive, *signed, *(f"x - y at the start of stretch {index + 1}" for index in range(choice.stretches)))


def decode(choice: Choice, scale: Scale, unknowns: Unknowns) -> Guess:
    """The damper, the rig's inertia and the rest of a vector of unknowns, which is zero at the scaled published damper.

    Positive quantities are exponentials of their unknown, (β - γ)/(β + γ) is the tanh of its. The offset force is k_1 x_0; inertia counts in c_0a
    times 1 ms, x - y in the displacement's r.m.s., the velocity's offset in 1 % of its r.m.s.
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
    return Guess(
        dataclasses.replace(r, **changes),
        q["inertia"] * 1e-3 * r.c0a if choice.inertia else jnp.zeros(()),
        unknowns[len(names) - choice.stretches :] * scale.travel,
        q["velocity offset"] * 1e-2 * scale.speed if choice.drifting else jnp.zeros(()),
    )


#: the same as one program: its operations one by one take a second to compile
decoded = jax.jit(decode, static_argnums=0)


class Problem(NamedTuple):
    """A record as JAX sees it, and what is thought of the unknowns beforehand."""

    motion: bouc_wen.Motion
    time: Array  # s, from the start of each stretch
    at_first: Array  # command at the start of each stretch, V
    force: Array
    acceleration: Array
    dt: Number
    parts: Array  # of each sample, for the integrator
    weight: Array  # 1/(std √samples) where residuals count, else 0
    prior: Array  # weight of each unknown's distance from `centre`
    centre: Array


def problem_of(record: Record, choice: Choice, counted: Bool[np.ndarray, "samples"], parts: int = 1) -> Problem:
    """`counted` are the samples whose residuals count; `parts` as `bouc_wen.parts_needed` says."""
    number = np.sum(counted)
    rates = acceleration(record) if choice.inertia else np.zeros(len(record))
    unknowns = len(unknown_names(choice))
    return Problem(
        motion=motion_of(record),
        time=jnp.asarray(np.concatenate([np.arange(s.stop - s.start) * record.dt for s in record.stretches])),
        at_first=jnp.asarray(record.command[list(record.begins)]),
        force=jnp.asarray(record.force),
        acceleration=jnp.asarray(rates),
        dt=record.dt,
        parts=jnp.asarray(parts),
        weight=jnp.asarray(counted / ((np.std(record.force[counted]) or 1.0) * np.sqrt(number))),
        prior=jnp.full(unknowns, PRIOR / np.sqrt(number)),
        centre=jnp.zeros(unknowns),
    )


def motion_of(record: Record) -> bouc_wen.Motion:
    """The record's stretches one after the other."""
    columns = (record.displacement, record.velocity, record.command)
    pieces = [
        bouc_wen.motion_of(*(jnp.asarray(values[stretch]) for values in columns), stretch=index)  # type: ignore[misc]
        for index, stretch in enumerate(record.stretches)
    ]
    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *pieces)


def starts_of(stretches: Float[Array, "stretches"], at_first: Float[Array, "stretches"]) -> Float[Array, "stretches 3"]:
    """x - y as given, z = 0, which is right within 0.1 mm of motion, and the driver settled at its first command."""
    return jnp.stack([stretches, jnp.zeros_like(stretches), at_first], axis=1)


def simulated(problem: Problem, guess: Guess) -> Float[Array, "samples"]:
    """F of eqs. (12)-(17) over the record's motion and the inertia force beside it, N."""
    motion, offset = problem.motion, guess.offset
    motion = motion._replace(
        x=motion.x - offset * problem.time,
        velocity=motion.velocity - offset,
        travel=motion.travel - offset * jnp.array([0.0, 0.0, 0.0, 1.0, 0.0]),
    )
    starts = starts_of(guess.stretches, problem.at_first)
    return bouc_wen.march(guess.damper, motion, problem.dt, problem.parts, starts) + guess.inertia * problem.acceleration


_simulate_once = jax.jit(simulated)


def as_measured(
    record: Record,
    damper: BoucWen,
    inertia: Scalar = 0.0,
    stretches: Float[np.ndarray, "stretches"] | None = None,
    offset: Scalar = 0.0,
    parts: int = 1,
) -> Samples:
    """Force of a damper over a record's motion, N: also to score parameters found elsewhere. `stretches`: x - y at the start of each
    stretch, 0 without; `offset` of the velocity."""
    count = len(record.begins)
    guess = Guess(damper, inertia, np.zeros(count) if stretches is None else stretches, offset)
    guess = jax.tree.map(lambda leaf: np.asarray(leaf, float), guess)  # numbers and arrays alike, for one program
    problem = problem_of(record, Choice(False, True, True, count), np.ones(len(record), bool), parts)
    return np.asarray(_simulate_once(problem, guess))


def errors(problem: Problem, choice: Choice, scale: Scale, unknowns: Unknowns) -> Float[Array, "samples"]:
    """Residuals of the data: the squares add up to the squared error of the fitted part."""
    return (simulated(problem, decode(choice, scale, unknowns)) - problem.force) * problem.weight


def residuals(problem: Problem, choice: Choice, scale: Scale, unknowns: Unknowns) -> Float[Array, "residuals"]:
    """What is minimised: those of the data, and next to nothing for the prior."""
    return jnp.concatenate([errors(problem, choice, scale, unknowns), problem.prior * (unknowns - problem.centre)])
