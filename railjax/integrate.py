"""Runge-Kutta 4 in nested `lax.scan`s: bursts of steps, samples of bursts, checkpointed blocks of samples."""

import functools
import itertools
from collections.abc import Callable
from math import isqrt
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .channels import CHANNELS, parse_reduction
from .dampers import Damper, damper_extremes
from .deflections import layout, size, wheelset_positions
from .elements import extremes
from .kernels import fence
from .motion import Motion, held, motion, state_matrix, state_rate
from .smooth import sqrt_of_square
from .speed_profile import Speed, SpeedProfile
from .track import Track
from .typing import Scalar
from .vehicle import Vehicle

State = Float[Array, "states *lanes"]

#: |R(z)| <= 1 for RK4's stability function on every z in the left half plane with |z| <= this (2.6156 at the waist)
STABLE_RADIUS = 2.61

#: steps whose track is sampled together; few, so that the samples stay in the nearest cache
BURST = 5


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
    slowness: Float[Array, "..."] | None  # None where the speed is constant


@fence
def _advanced(x: Any, rate: Any, dt: Scalar) -> Any:
    return jax.tree.map(lambda x, rate: x + rate * dt, x, rate)


@fence
def _combined(x: Any, first: Any, second: Any, third: Any, fourth: Any, dt: Scalar) -> Any:
    def sum_of(x: Array, first: Array, second: Array, third: Array, fourth: Array) -> Array:
        return x + (dt / 6.0) * (first + 2.0 * (second + third) + fourth)

    return jax.tree.map(sum_of, x, first, second, third, fourth)


def _in_rows(function: Callable[..., Any], x: Any, *rates: Any, dt: Scalar) -> Any:
    """`function` on each array as one long row: a row per state would be a loop over one chunk of lanes, which LLVM unrolls before it
    looks for vectors."""
    long = [jax.tree.map(jnp.ravel, tree) for tree in (x, *rates)]
    return jax.tree.map(lambda row, like: row.reshape(like.shape), function(*long, dt), x)


def rk4(rate: Callable[[Inputs, Any], Any], x: Any, first: Any, dt: Scalar, mid: Inputs, end: Inputs) -> Any:
    """One classical Runge-Kutta step of x, an array or a tree of them; `first` is x' at its start, `mid` and `end` the inputs half a
    step and a step later."""
    second = rate(mid, _in_rows(_advanced, x, first, dt=0.5 * dt))
    third = rate(mid, _in_rows(_advanced, x, second, dt=0.5 * dt))
    fourth = rate(end, _in_rows(_advanced, x, third, dt=dt))
    return _in_rows(_combined, x, first, second, third, fourth, dt=dt)


def rk4_in_loop(rate: Callable[[Any], Any], x: Array, dt: Scalar) -> Array:
    """One step of `rk4` with constant inputs, its stages a loop: compiled in a third of the time, where lanes are few as fast."""

    def stage(carry: tuple[Array, Array], shares: Array) -> tuple[tuple[Array, Array], None]:
        ahead, total = carry
        change = dt * rate(ahead)
        return (x + shares[0] * change, total + shares[1] * change), None

    onward_and_weight = jnp.array([[1 / 2, 1 / 6], [1 / 2, 1 / 3], [1.0, 1 / 3], [0.0, 1 / 6]], x.dtype)
    return jax.lax.scan(stage, (x, x), onward_and_weight)[0][1]


def largest_divisor(number: int, limit: int) -> int:
    """The largest divisor of `number` not above `limit`."""
    return next(d for d in range(min(number, limit), 0, -1) if number % d == 0)  # at most 1e5 trials: limits are roots


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
    like = jnp.zeros((*layout(vehicle)["wheelset_y"], *x.shape[1:]), x.dtype)
    count = size(vehicle)
    burst = largest_divisor(plan.every, BURST)
    bursts = plan.every // burst
    inputs = _inputs(vehicle, speed, track, like, dt, burst)
    slowness = None if isinstance(speed, SpeedProfile) else 1.0 / jnp.asarray(speed, x.dtype)
    reductions = [parse_reduction(name) for name in plan.reduce]

    def instant(now: Inputs, x: State) -> Motion:
        return motion(vehicle, damper, slowness if now.slowness is None else now.slowness, now.alignment, x)

    # q, q' and internal states each in an array of its own: then q' of a stage is also the rate of its q, and is never copied
    def apart(x: State) -> list[Array]:
        return jax.lax.split(x, (count, count, x.shape[0] - 2 * count))

    whole = jnp.concatenate

    def rate(now: Inputs, parts: list[Array]) -> list[Array]:
        return apart(state_rate(vehicle, instant(now, whole(parts))))

    # reverse mode keeps x of every step and nothing else, and computes the stages again
    @functools.partial(jax.checkpoint, prevent_cse=False)
    def step(carry: Carry, now: tuple[Inputs, Inputs, Inputs, Array]) -> tuple[Carry, None]:
        parts, sums = carry
        start, mid, end, time = now
        at_start = instant(start, whole(parts))
        counted = jnp.where(time >= settle, 1.0, 0.0).astype(x.dtype)
        sums = tuple(
            _accumulate(how, total, CHANNELS[channel].read(at_start), counted)
            for (how, channel), total in zip(reductions, sums, strict=True)
        )
        parts = rk4(rate, parts, apart(state_rate(vehicle, at_start)), dt, mid, end)
        return (apart(held(vehicle, damper, whole(parts))), sums), None

    def several_steps(carry: Carry, index: Array) -> tuple[Carry, None]:
        return jax.lax.scan(step, carry, inputs(index))[0], None

    def sample(carry: Carry, index: Array) -> tuple[Carry, tuple[dict[str, Array], Array]]:
        x = whole(carry[0])
        at_start = instant(_first(inputs(index * bursts)), x)
        record = {name: CHANNELS[name].read(at_start) for name in plan.record}
        within = jnp.max(jnp.abs(carry[0][0]), axis=0) < DIVERGED  # False for NaN as well
        carry, _ = jax.lax.scan(several_steps, carry, index * bursts + jnp.arange(bursts))
        return carry, (record, ~within)

    def block(carry: Carry, indices: Array) -> tuple[Carry, tuple[dict[str, Array], Array]]:
        return jax.lax.scan(sample, carry, indices)

    if plan.samples * plan.every * x.size * x.dtype.itemsize > KEPT_BYTES:
        block = jax.checkpoint(block)
    # two levels of about the same length, so that reverse mode keeps only the square root of the samples
    per_block = largest_divisor(plan.samples, max(1, isqrt(plan.samples)))
    indices = jnp.arange(plan.samples).reshape(-1, per_block)
    here = jax.eval_shape(lambda: instant(_first(inputs(jnp.array(0))), x))
    zeros = tuple(
        jnp.zeros(shape.shape, shape.dtype)
        for shape in (jax.eval_shape(CHANNELS[channel].read, here) for _, channel in reductions)
    )
    (parts, sums), (records, outside) = jax.lax.scan(block, (apart(held(vehicle, damper, x)), zeros), indices)
    records = {name: value.reshape((plan.samples, *value.shape[2:])) for name, value in records.items()}

    steps = plan.samples * plan.every
    counted = jnp.maximum(steps - jnp.ceil(settle / dt - 1e-9), 1.0).astype(x.dtype)
    totals = {name: _finish(how, total, counted) for name, (how, _), total in zip(plan.reduce, reductions, sums, strict=True)}
    within = jnp.max(jnp.abs(parts[0]), axis=0) < DIVERGED
    return Run(records, totals, whole(parts), jnp.any(outside, axis=(0, 1)) | ~within)


Carry = tuple[list[Array], tuple[Array, ...]]

#: what reverse mode may keep of a run, bytes; beyond that it keeps blocks of steps and computes the steps again (20 % slower)
KEPT_BYTES = 2**26


def _first(inputs: tuple[Inputs, Inputs, Inputs, Array]) -> Inputs:
    return jax.tree.map(lambda leaf: leaf[0], inputs[0])


#: metres or radians beyond which the small displacements of the model have lost their meaning
DIVERGED = 1.0


def _accumulate(how: str, total: Array, value: Array, counted: Array) -> Array:
    if how == "peak":
        return jnp.maximum(total, jnp.abs(value) * counted)
    return total + counted * (value * value if how == "rms" else value)


def _finish(how: str, total: Array, count: Array) -> Array:
    if how == "peak":
        return total
    return sqrt_of_square(total / count) if how == "rms" else total / count


def _inputs(
    vehicle: Vehicle, speed: Speed, track: Track, like: Float[Array, "n m *lanes"], dt: Scalar, burst: int
) -> Callable[[Array], tuple[Inputs, Inputs, Inputs, Array]]:
    """Track and speed over the steps of a burst: at the start, the middle and the end of each, and the time of its start."""
    positions = wheelset_positions(vehicle, like)
    halves = 0.5 * jnp.arange(2 * burst + 1, dtype=like.dtype)
    varying = isinstance(speed, SpeedProfile)
    if not varying:
        column = halves.reshape((-1,) + (1,) * like.ndim)
        positions = speed * (column * dt) + positions
    # sampled once for all that use it
    seen = fence(track.seen_from(positions))

    def sampled(index: Array) -> Inputs:
        if varying:
            time = (index * burst + halves) * dt
            alignment = jax.vmap(seen)(speed.distance(time).astype(like.dtype))
            return Inputs(alignment, (1.0 / speed.at(time)).astype(like.dtype))
        alignment = seen(jnp.asarray(speed * (index * burst * dt), like.dtype))
        return Inputs(jnp.broadcast_to(alignment, (2 * burst + 1, *like.shape)), None)

    def inputs(index: Array) -> tuple[Inputs, Inputs, Inputs, Array]:
        now = sampled(index)
        start, mid, end = (
            jax.tree.map(lambda leaf, part=part: leaf[part], now)
            for part in (slice(0, -1, 2), slice(1, None, 2), slice(2, None, 2))
        )
        return start, mid, end, ((index * burst + jnp.arange(burst)) * dt).astype(like.dtype)

    return inputs


def fastest_rate(vehicle: Vehicle, speed: Scalar, damper: Damper, enough: Scalar = 0.0) -> Float[Array, ""]:
    """Largest spectral radius of the state matrix with the flanges free and in contact, 1/s: an upper bound, within 1 % or below
    `enough`; infinite where the matrix is beyond floating point.

    Both, because the flange's spring slows the overdamped creep modes of low speed and quickens the others; and likewise
    within and beyond the corners of the other elements (`extremes`) and of the damper (`damper_extremes`). Gelfand: |E^(2^k)|^(1/2^k) by repeated squaring, so that
    it runs in a batch and on any device.
    """
    cases = itertools.product(extremes(vehicle), damper_extremes(vehicle, damper), (False, True))
    matrices = [state_matrix(one, speed, law, flange=flange) for one, law, flange in cases]
    largest = max(len(matrix) for matrix in matrices)
    matrices = [jnp.pad(matrix, (0, largest - len(matrix))) for matrix in matrices]  # laws differ in their internal states
    matrix, enough = jax.lax.stop_gradient((jnp.stack(matrices), enough))
    n = size(vehicle)
    scale = jnp.where(jnp.arange(matrix.shape[-1]) < n, 100.0, 1.0)  # displacements against velocities: about the rates
    matrix = matrix * (scale[:, None] / scale)

    def norm(power: Float[Array, "k states states"]) -> Float[Array, "k 1 1"]:
        return jnp.sqrt(jnp.sum(power**2, axis=(-2, -1), keepdims=True))

    def bound(power: Array, logarithm: Array, doublings: Array) -> Array:
        return jnp.max(jnp.exp((logarithm + jnp.log(norm(power))) / 2.0**doublings))

    def square(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        power, logarithm, doublings = carry
        size_now = norm(power)
        power = (power / size_now) @ (power / size_now)
        return power, 2.0 * (logarithm + jnp.log(size_now)), doublings + 1

    def loose(carry: tuple[Array, Array, Array]) -> Array:
        return (carry[2] < 10) & (bound(*carry) > enough)

    rate = bound(*jax.lax.while_loop(loose, square, (matrix, jnp.zeros((len(matrices), 1, 1), matrix.dtype), jnp.array(0))))
    return jnp.where(jnp.isnan(rate), jnp.inf, rate)  # a norm that overflows


@jax.jit
def largest_step(vehicle: Vehicle, speed: Scalar, damper: Damper) -> Float[Array, ""]:
    """Largest dt (s) that RK4 holds at this speed: creep damping 2 f/(m v) grows as 1/v, 9 ms at 40 m/s, 1 ms at 5 m/s."""
    return STABLE_RADIUS / fastest_rate(vehicle, speed, damper)
