"""Runge-Kutta 4 in nested `lax.scan`s: bursts of steps, samples of bursts, checkpointed blocks of samples."""

import functools
from collections.abc import Callable
from math import isqrt
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .channels import CHANNELS, parse_reduction
from .dampers import Damper
from .deflections import layout, size, wheelset_positions
from .motion import Motion, motion, state_matrix, state_rate
from .track import Speed, SpeedProfile, Track
from .typing import Scalar
from .vehicle import Vehicle

State = Float[Array, "states *lanes"]

#: |R(z)| <= 1 for RK4's stability function on every z in the left half plane with |z| <= this (2.6156 at the waist)
STABLE_RADIUS = 2.61

#: steps whose track is sampled together; few, so that the samples stay in the nearest cache
BURST = 10


class Plan(NamedTuple):
    """The static part of a run."""

    samples: int  # recorded instants
    every: int  # steps between them
    record: tuple[str, ...]
    reduce: tuple[str, ...]


class Run(NamedTuple):
    """What a run leaves: records (samples, ..., *lanes), reductions and the final state."""

    records: dict[str, Float[Array, "samples ..."]]
    reductions: dict[str, Float[Array, "..."]]
    final: State
    diverged: Array


class Inputs(NamedTuple):
    """What the outside does to the vehicle at one instant."""

    alignment: Float[Array, "..."]
    slowness: Float[Array, "..."]


def rk4(rate: Callable[[Inputs, State], State], x: State, first: State, dt: Scalar, mid: Inputs, end: Inputs) -> State:
    """One classical Runge-Kutta step; `first` is x' at its start, `mid` and `end` the inputs half a step and a step later."""
    second = rate(mid, x + (0.5 * dt) * first)
    third = rate(mid, x + (0.5 * dt) * second)
    fourth = rate(end, x + dt * third)
    return x + (dt / 6.0) * (first + 2.0 * (second + third) + fourth)


def largest_divisor(number: int, limit: int) -> int:
    """The largest divisor of `number` not above `limit`."""
    return next(d for d in range(min(number, limit), 0, -1) if number % d == 0)


def run(
    vehicle: Vehicle,
    damper: Damper,
    speed: Speed,
    track: Track,
    x: State,
    dt: Scalar,
    settle: Scalar,
    plan: Plan,
) -> Run:
    """Integrate from state x; every leaf may carry trailing lanes. `settle` seconds are left out of the reductions."""
    lanes = x.ndim - 1
    like = jnp.zeros((*layout(vehicle)["wheelset_y"], *x.shape[1:]), x.dtype)
    burst = largest_divisor(plan.every, BURST)
    bursts = plan.every // burst
    inputs = _inputs(vehicle, speed, track, like, dt, burst)
    reductions = [parse_reduction(name) for name in plan.reduce]

    def instant(now: Inputs, x: State) -> Motion:
        return motion(vehicle, damper, now.slowness, now.alignment, x)

    def rate(now: Inputs, x: State) -> State:
        return state_rate(vehicle, instant(now, x))

    def step(carry, now: tuple[Inputs, Inputs, Inputs, Array]):
        x, sums = carry
        start, mid, end, time = now
        at_start = instant(start, x)
        counted = jnp.where(time >= settle, 1.0, 0.0).astype(x.dtype)
        sums = tuple(
            _accumulate(how, total, CHANNELS[channel].read(at_start), counted)
            for (how, channel), total in zip(reductions, sums, strict=True)
        )
        return (rk4(rate, x, state_rate(vehicle, at_start), dt, mid, end), sums), None

    def several_steps(carry, index):
        return jax.lax.scan(step, carry, inputs(index))[0], None

    def sample(carry, index):
        x, _ = carry
        here = jax.tree.map(lambda leaf: leaf[0], inputs(index * bursts)[0])
        at_start = instant(here, x)
        record = {name: CHANNELS[name].read(at_start) for name in plan.record}
        outside = jnp.max(jnp.abs(x[: size(vehicle)]), axis=0)
        carry, _ = jax.lax.scan(several_steps, carry, index * bursts + jnp.arange(bursts))
        return carry, (record, ~(outside < DIVERGED))

    @jax.checkpoint
    def block(carry, indices):
        return jax.lax.scan(sample, carry, indices)

    # two levels of about the same length, so that reverse mode keeps only the square root of the samples
    per_block = largest_divisor(plan.samples, max(1, isqrt(plan.samples)))
    indices = jnp.arange(plan.samples).reshape(-1, per_block)
    here = jax.eval_shape(lambda: instant(jax.tree.map(lambda leaf: leaf[0], inputs(jnp.array(0))[0]), x))
    zeros = tuple(
        jnp.zeros(shape.shape, shape.dtype)
        for shape in (jax.eval_shape(CHANNELS[channel].read, here) for _, channel in reductions)
    )
    (x, sums), (records, outside) = jax.lax.scan(block, (x, zeros), indices)
    records = {name: value.reshape((plan.samples, *value.shape[2:])) for name, value in records.items()}

    steps = plan.samples * plan.every
    counted = jnp.maximum(steps - jnp.ceil(settle / dt - 1e-9), 1.0).astype(x.dtype)
    means = {name: _finish(how, total, counted) for name, (how, _), total in zip(plan.reduce, reductions, sums, strict=True)}
    final_outside = ~(jnp.max(jnp.abs(x[: size(vehicle)]), axis=0) < DIVERGED)
    diverged = jnp.any(outside, axis=(0, 1)) | final_outside
    assert diverged.ndim == lanes
    return Run(records, means, x, diverged)


#: metres or radians beyond which the small displacements of the model have lost their meaning
DIVERGED = 1.0


def _accumulate(how: str, total: Array, value: Array, counted: Array) -> Array:
    if how == "peak":
        return jnp.maximum(total, jnp.abs(value) * counted)
    return total + counted * (value * value if how == "rms" else value)


def _finish(how: str, total: Array, count: Array) -> Array:
    from .smooth import sqrt_of_square

    if how == "peak":
        return total
    return sqrt_of_square(total / count) if how == "rms" else total / count


def _inputs(
    vehicle: Vehicle, speed: Speed, track: Track, like: Float[Array, "n m *lanes"], dt: Scalar, burst: int
) -> Callable[[Array], tuple[Inputs, Inputs, Inputs, Array]]:
    """Track and speed over the steps of a burst: at the start, the middle and the end of each, and the time of its start."""
    positions = wheelset_positions(vehicle, like)
    halves = 0.5 * jnp.arange(2 * burst + 1, dtype=like.dtype)
    column = halves.reshape((-1,) + (1,) * like.ndim)

    if isinstance(speed, SpeedProfile):
        seen = track.seen_from(positions)

        def sampled(index: Array) -> Inputs:
            time = (index * burst + halves) * dt
            distance, slowness = speed.distance(time), 1.0 / speed.at(time)
            return Inputs(jax.vmap(seen)(distance.astype(like.dtype)), slowness.astype(like.dtype))

    else:
        slowness = 1.0 / jnp.asarray(speed, like.dtype)
        seen_ahead = track.seen_from(speed * (column * dt) + positions)

        def sampled(index: Array) -> Inputs:
            alignment = seen_ahead(jnp.asarray(speed * (index * burst * dt), like.dtype))
            # materialised: XLA would otherwise evaluate the track anew in every kernel that uses it
            alignment = jax.lax.optimization_barrier(jnp.broadcast_to(alignment, (2 * burst + 1, *like.shape)))
            return Inputs(alignment, jnp.broadcast_to(slowness, (2 * burst + 1, *slowness.shape)))

    def inputs(index: Array) -> tuple[Inputs, Inputs, Inputs, Array]:
        now = sampled(index)
        time = ((index * burst + jnp.arange(burst)) * dt).astype(like.dtype)
        start, mid, end = (jax.tree.map(lambda leaf, s=s: leaf[s], now) for s in (slice(0, -1, 2), slice(1, None, 2), slice(2, None, 2)))
        return start, mid, end, time

    return inputs


def fastest_rate(vehicle: Vehicle, speed: Scalar, damper: Damper) -> Float[Array, ""]:
    """Spectral radius of the state matrix with the flange in contact, 1/s, from above by less than 1 %.

    Gelfand: |E^(2^k)|^(1/2^k) by repeated squaring, so that it runs in a batch and on any device.
    """
    matrix = jax.lax.stop_gradient(state_matrix(vehicle, speed, damper, flange=True))
    n = size(vehicle)
    scale = jnp.ones(matrix.shape[0]).at[:n].set(100.0)  # displacements weighed against velocities: about the rates in 1/s
    matrix = matrix * (scale[:, None] / scale)

    def square(carry, _):
        power, logarithm = carry
        norm = jnp.linalg.norm(power)
        power = (power / norm) @ (power / norm)
        return (power, 2.0 * (logarithm + jnp.log(norm))), None

    (power, logarithm), _ = jax.lax.scan(square, (matrix, jnp.zeros(())), length=10)
    return jnp.exp((logarithm + jnp.log(jnp.linalg.norm(power))) / 2.0**10)


@functools.partial(jax.jit, static_argnames=())
def largest_step(vehicle: Vehicle, speed: Scalar, damper: Damper) -> Float[Array, ""]:
    """Largest dt (s) that RK4 holds at this speed: creep damping 2 f/(m v) grows as 1/v, 9 ms at 40 m/s, 1 ms at 5 m/s."""
    return STABLE_RADIUS / fastest_rate(vehicle, speed, damper)
