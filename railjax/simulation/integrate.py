"""Runge-Kutta 4: bursts of steps and samples of bursts, in checkpointed `lax.scan`s for what is transformed (`run`), in loops of any
length for what is not (`advance`); channels read off states (`read`)."""

import math
from collections.abc import Callable
from math import isqrt
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..base.batches import own_axes
from ..base.compilation import fence
from ..base.failed_lanes import nan_unless, no_number, without_nan
from ..base.smooth import sqrt_of_square
from ..base.typing import Scalar
from ..model.damper import Damper
from ..model.kinematics import layout, size, wheelset_positions
from ..model.motion import Motion, held, motion, state_rate
from ..model.track.curve import Curve
from ..model.track.layout import Layout
from ..model.track.shapes import Track
from ..model.vehicle import Vehicle
from .channels import CHANNELS, parse_reduction, rows_of_motion, shape_of
from .runge_kutta import rk4
from .speed import Speed, SpeedProfile

State = Float[Array, "states *lanes"]
Carry = tuple[list[Array], tuple[Array, ...]]

#: steps whose track is sampled together; few, so that the samples stay in the nearest cache
BURST = 5


class Plan(NamedTuple):
    """The static part of a run."""

    samples: int  # recorded instants
    every: int  # steps between them
    record: tuple[str, ...]
    reduce: tuple[str, ...]


class Integrated(NamedTuple):
    """What a run leaves: records (samples, ..., *lanes), reductions and the final state."""

    records: dict[str, Float[Array, "samples ..."]]
    reductions: dict[str, Float[Array, "..."]]
    final: State
    diverged: Array


class Inputs(NamedTuple):
    """What the outside does to the vehicle at one instant."""

    alignment: Float[Array, "..."]
    slowness: Float[Array, "..."] | None  # None where the speed is constant
    curve: Curve | None = None  # None on straight lines


def largest_divisor(number: int, limit: int) -> int:
    """The largest divisor of `number` not above `limit`."""
    return next(d for d in range(min(number, limit), 0, -1) if number % d == 0)  # at most 1e5 trials: limits are roots


class Block(NamedTuple):
    """The static part of an `advance`: neither how many samples are taken nor how far they are apart."""

    samples: int  # room for so many
    burst: int  # steps whose track is sampled together
    record: tuple[str, ...] | None  # channels; None: the states
    reduce: tuple[str, ...]


class Progress(NamedTuple):
    """Where a run stands between two blocks."""

    x: State
    sums: tuple[Float[Array, "..."], ...]
    diverged: Bool[Array, "..."]


def burst_of(every: int) -> int:
    """Steps whose track is sampled together, where samples are `every` steps apart."""
    return largest_divisor(every, BURST)


class _Stepper:
    """What `run` and `advance` repeat: a burst of steps, with what is summed up on the way."""

    def __init__(
        self, vehicle: Vehicle, damper: Damper, speed: Speed, track: Track, x: State, dt: Scalar, settle: Scalar, burst: int,
        reduce: tuple[str, ...], looped: bool, straight: Array | None = None,
    ) -> None:  # fmt: skip
        self.vehicle, self.damper, self.dt, self.settle, self.looped = vehicle, damper, dt, settle, looped
        like = jnp.zeros((*layout(vehicle)["wheelset_y"], *x.shape[1:]), x.dtype)
        self.curved = isinstance(track, Layout)
        self.inputs = _inputs(vehicle, speed, track, like, dt, burst, straight)
        self.slowness = None if isinstance(speed, SpeedProfile) else 1.0 / jnp.asarray(speed, x.dtype)
        self.reductions = [parse_reduction(name) for name in reduce]

    def instant(self, now: Inputs, x: State) -> Motion:
        slowness = self.slowness if now.slowness is None else now.slowness
        return motion(self.vehicle, self.damper, slowness, now.alignment, x, now.curve)

    def apart(self, x: State) -> list[Array]:
        """q, q' and internal states each in an array of its own: then q' of a stage is also the rate of its q, and is never copied."""
        count = size(self.vehicle)
        return jax.lax.split(x, (count, count, x.shape[0] - 2 * count))

    def start(self, x: State, curve: Curve | None) -> list[Array]:
        return self.apart(held(self.vehicle, self.damper, x, curve))

    def curve(self, burst: int | Array) -> Curve | None:
        """The line's at the start of a burst."""
        return jax.tree.map(lambda leaf: leaf[0, 0], self.inputs(jnp.asarray(burst))[0].curve) if self.curved else None

    def sample(self, record: tuple[str, ...], burst: Array, x: State) -> dict[str, Array]:
        """Channels at the start of a burst."""
        at_start = self.instant(jax.tree.map(lambda leaf: leaf[0, 0], self.inputs(burst)[0]), x)
        return {name: CHANNELS[name].read(at_start) for name in record}

    def steps(self, carry: Carry, burst: Array) -> Carry:
        """A burst of steps. Reverse mode keeps x of every step and nothing else, and computes the stages again."""
        return jax.lax.scan(jax.checkpoint(self._step, prevent_cse=False), carry, self.inputs(burst))[0]

    def _step(self, carry: Carry, now: tuple[Inputs, Array]) -> tuple[Carry, None]:
        inputs, time = now
        counted = jnp.where(time >= self.settle, 1.0, 0.0).astype(time.dtype) if self.reductions else None

        def stage(k: Any, parts: list[Array], sums: tuple[Array, ...]) -> tuple[list[Array], tuple[Array, ...]]:
            at = self.instant(jax.tree.map(lambda leaf: leaf[(k + 1) // 2], inputs), jnp.concatenate(parts))
            if self.reductions and (self.looped or k == 0):
                here = jnp.where(k == 0, counted, 0.0) if self.looped else counted
                sums = tuple(
                    _accumulate(how, total, CHANNELS[channel].read(at), here)
                    for (how, channel), total in zip(self.reductions, sums, strict=True)
                )
            return self.apart(state_rate(self.vehicle, at)), sums

        parts, sums = rk4(stage, *carry, self.dt, self.looped)
        curve = jax.tree.map(lambda leaf: leaf[2], inputs.curve)
        return (self.start(jnp.concatenate(parts), curve), sums), None

    def zeros(self, x: State) -> tuple[Array, ...]:
        shapes = (shape_of(channel, self.vehicle) for _, channel in self.reductions)
        return tuple(jnp.zeros((*shape, *x.shape[1:]), x.dtype) for shape in shapes)

    def totals(
        self, reduce: tuple[str, ...], sums: tuple[Array, ...], steps: int | Int[Array, ""], dtype: Any
    ) -> dict[str, Array]:
        counted = jnp.maximum(steps - jnp.ceil(self.settle / self.dt - 1e-9), 1.0).astype(dtype)
        return {name: _finish(how, total, counted) for name, (how, _), total in zip(reduce, self.reductions, sums, strict=True)}


def _no_number(vehicle: Vehicle, damper: Damper, speed: Speed, track: Track, *rest: Scalar) -> Bool[Array, "..."]:
    """Whether a parameter is not a number. It also gives each one a use: XLA aborts on an argument of its kernel that it can do without."""
    given = vehicle, damper, speed, track, *rest
    return no_number(given, own_axes(given))


def _within(parts: list[Array]) -> Bool[Array, "..."]:
    """False for NaN as well."""
    return jnp.max(jnp.abs(parts[0]), axis=0) < DIVERGED


def _sound(parts: list[Array]) -> Bool[Array, "..."]:
    """Whether a run can begin there: no number whose square is too large."""
    return _within(parts) & (jnp.max(jnp.abs(parts[1]), axis=0) < FASTEST) & jnp.all(jnp.isfinite(parts[2]), axis=0)


def integrated(
    vehicle: Vehicle,
    damper: Damper,
    speed: Speed,
    track: Track,
    x: State,
    dt: Scalar,
    settle: Scalar,
    plan: Plan,
    holds: Bool[Array, "..."] | None = None,
) -> Integrated:
    """Integrate from state x; every leaf may carry trailing lanes. `settle` seconds are left out of the reductions.

    For what is transformed: differentiable in reverse mode, a length compiled on its own. A lane without a number or from far beyond
    the model's motions is NaN, one that leaves them is so from then on. Given where the step `holds`, a lane that fails for any of
    these reasons spoils no derivative of what is shared; without derivatives it is not worth the wait.
    """
    burst = burst_of(plan.every)
    bursts = plan.every // burst
    n = size(vehicle)
    sound = ~_no_number(vehicle, damper, speed, track, dt, settle) & _sound([x[:n], x[n : 2 * n], x[2 * n :]])
    guarded = holds is not None
    if guarded:
        # a failed lane stays at rest on straight track, where all is finite whatever its parameters
        sound &= holds  # type: ignore[operator]
        vehicle, damper, speed, track = without_nan((vehicle, damper, speed, track))
        x = jnp.where(sound, x, 0.0)
    straight = ~sound if guarded else None
    stepper = _Stepper(vehicle, damper, speed, track, x, dt, settle, burst, plan.reduce, looped=False, straight=straight)

    def several_steps(carry: Carry, index: Array) -> tuple[Carry, None]:
        return stepper.steps(carry, index), None

    def sample(state: tuple[Carry, Array], index: Array) -> tuple[tuple[Carry, Array], dict[str, Array]]:
        (parts, sums), sound = state
        record = stepper.sample(plan.record, index * bursts, jnp.concatenate(parts)) if plan.record else {}
        record, within = nan_unless(sound, record), _within(parts)
        if guarded:  # what has left the model's motions goes on from rest, or it would end in numbers that are none
            parts = [jnp.where(within, part, 0.0) for part in parts]
        carry: Carry = parts, sums
        carry, _ = jax.lax.scan(several_steps, carry, index * bursts + jnp.arange(bursts))
        return (carry, sound & within), record

    def block(state: tuple[Carry, Array], indices: Array) -> tuple[tuple[Carry, Array], dict[str, Array]]:
        return jax.lax.scan(sample, state, indices)

    if plan.samples * plan.every * x.size * x.dtype.itemsize > KEPT_BYTES:
        block = jax.checkpoint(block)
    # two levels of about the same length, so that reverse mode keeps only the square root of the samples
    per_block = largest_divisor(plan.samples, max(1, isqrt(plan.samples)))
    indices = jnp.arange(plan.samples).reshape(-1, per_block)
    begun = (stepper.start(x, stepper.curve(0)), stepper.zeros(x)), sound
    ((parts, sums), sound), records = jax.lax.scan(block, begun, indices)
    records = {name: value.reshape((plan.samples, *value.shape[2:])) for name, value in records.items()}
    totals = stepper.totals(plan.reduce, sums, plan.samples * plan.every, x.dtype)
    totals, x = nan_unless(sound, (totals, jnp.concatenate(parts)))
    return Integrated(records, totals, x, ~(sound & _within(parts)))


def advance(
    vehicle: Vehicle,
    damper: Damper,
    speed: Speed,
    track: Track,
    progress: Progress,
    dt: Scalar,
    settle: Scalar,
    first: Int[Array, ""],
    count: Int[Array, ""],
    bursts: Int[Array, ""],
    block: Block,
) -> tuple[Integrated, Progress]:
    """`integrated` from the sample `first` on for `count` samples, `bursts` bursts apart: of any length, but without a reverse mode.

    The records have room for `block.samples`, of which the first `count` are filled.
    """
    x = progress.x
    stepper = _Stepper(vehicle, damper, speed, track, x, dt, settle, block.burst, block.reduce, looped=x.ndim == 1)

    def sample(i: Array, carry: tuple[Carry, Array, dict[str, Array]]) -> tuple[Carry, Array, dict[str, Array]]:
        (parts, sums), diverged, records = carry
        index, x = (first + i) * bursts, jnp.concatenate(parts)
        now = {STATES: x} if block.record is None else stepper.sample(block.record, index, x) if block.record else {}
        records = {name: jax.lax.dynamic_update_index_in_dim(records[name], now[name], i, 0) for name in records}
        after = jax.lax.fori_loop(index, index + bursts, lambda burst, carry: stepper.steps(carry, burst), (parts, sums))
        return after, diverged | ~_within(parts), records

    shapes = {STATES: x.shape[:1]} if block.record is None else {name: shape_of(name, vehicle) for name in block.record}
    records = {name: jnp.zeros((block.samples, *shape, *x.shape[1:]), x.dtype) for name, shape in shapes.items()}
    start = (stepper.start(x, stepper.curve(first * bursts)), progress.sums), progress.diverged, records
    (parts, sums), diverged, records = jax.lax.fori_loop(0, count, sample, start)
    totals = stepper.totals(block.reduce, sums, (first + count) * bursts * block.burst, x.dtype)
    x, diverged = jnp.concatenate(parts), diverged | ~_within(parts) | _no_number(vehicle, damper, speed, track, dt, settle)
    return Integrated(records, totals, x, diverged), Progress(x, sums, diverged)


def read(
    vehicle: Vehicle,
    damper: Damper,
    speed: Speed,
    track: Track,
    states: Float[Array, "samples states *lanes"],
    dt: Scalar,
    first: Int[Array, ""],
    count: Int[Array, ""],
    every: Int[Array, ""],
) -> Float[Array, "samples rows *lanes"]:
    """All channels that are not coordinates or rates, one below the other in the order of `rows_of_motion`, at the samples from
    `first` on, `every` steps apart; the first `count` of them are read, each as `integrated` would have done."""
    names = tuple(rows_of_motion(vehicle))
    stepper = _Stepper(vehicle, damper, speed, track, states[0], dt, 0.0, 1, (), looped=True)

    def sample(i: Array, rows: Array) -> Array:
        found = stepper.sample(names, (first + i) * every, states[i])
        lanes = states.shape[2:]
        now = jnp.concatenate([jnp.broadcast_to(found[n], (*shape_of(n, vehicle), *lanes)).reshape((-1, *lanes)) for n in names])
        return jax.lax.dynamic_update_index_in_dim(rows, now, i, 0)

    # what is not read stays 0, or NaN where a parameter is: a use for each
    unread = jnp.where(_no_number(vehicle, damper, speed, track, dt) | (first < 0) | (every < 0), jnp.nan, 0.0).astype(
        states.dtype
    )
    height = sum(math.prod(shape_of(name, vehicle)) for name in names)
    return jax.lax.fori_loop(0, count, sample, jnp.broadcast_to(unread, (states.shape[0], height, *states.shape[2:])))


#: what reverse mode may keep of a run, bytes; beyond that it keeps blocks of steps and computes the steps again (20 % slower)
KEPT_BYTES = 2**26


#: name of the states among the records
STATES = "states"

#: metres or radians beyond which the small displacements of the model have lost their meaning
DIVERGED = 1.0
#: m/s or rad/s with which no run begins; with more, squares and their like are no numbers before a displacement is seen to be too large
FASTEST = 1e6


def _accumulate(how: str, total: Array, value: Array, counted: Array) -> Array:
    if how == "peak":
        return jnp.maximum(total, jnp.abs(value) * counted)
    return total + counted * (value * value if how == "rms" else value)


def _finish(how: str, total: Array, count: Array) -> Array:
    if how == "peak":
        return total
    return sqrt_of_square(total / count) if how == "rms" else total / count


def _inputs(
    vehicle: Vehicle, speed: Speed, track: Track, like: Float[Array, "n m *lanes"], dt: Scalar, burst: int, straight: Array | None
) -> Callable[[Array], tuple[Inputs, Array]]:
    """Track and speed over the steps of a burst: at the start, the middle and the end of each, and the time of its start. The track is
    without irregularity in lanes that have it `straight`.

    Leaves have the shape (burst, 3, ...)."""
    positions = wheelset_positions(vehicle, like)
    halves = 0.5 * jnp.arange(2 * burst + 1, dtype=like.dtype)
    varying = isinstance(speed, SpeedProfile)
    if not varying:
        column = halves.reshape((-1,) + (1,) * like.ndim)
        positions = speed * (column * dt) + positions  # type: ignore[assignment, operator]
    # sampled once for all that use it
    rough = track.seen_from(positions)
    seen = fence(rough if straight is None else lambda start: jnp.where(straight, 0.0, rough(start)))

    def line(distance: Array, speed: Array, gain: Array) -> Curve | None:
        """The curves at several distances, (k, *lanes)."""
        if not isinstance(track, Layout):
            return None
        found = jax.vmap(lambda at, v, gain: track.curve_at(vehicle, at, v, gain, like))(distance, speed, gain)
        return found if straight is None else jax.tree.map(lambda leaf: jnp.where(straight, 0.0, leaf), found)

    def sampled(index: Array) -> Inputs:
        if varying:
            time = (index * burst + halves) * dt
            distance = speed.distance(time).astype(like.dtype)  # type: ignore[union-attr]
            alignment = jax.vmap(seen)(distance)
            now = (1.0 / speed.at(time)).astype(like.dtype)  # type: ignore[operator]
            return Inputs(alignment, now, line(distance, *_gaining(speed, time)) if isinstance(track, Layout) else None)
        alignment = seen(jnp.asarray(speed * (index * burst * dt), like.dtype))  # type: ignore[operator]
        curve = None
        if isinstance(track, Layout):
            now = jnp.broadcast_to(jnp.asarray(speed, like.dtype), (2 * burst + 1, *like.shape[2:]))
            along = (index * burst + halves).reshape((-1,) + (1,) * len(like.shape[2:])) * dt
            curve = line(now * along, now, jnp.zeros_like(now))
        return Inputs(jnp.broadcast_to(alignment, (2 * burst + 1, *like.shape)), None, curve)

    def inputs(index: Array) -> tuple[Inputs, Array]:
        parts = slice(0, -1, 2), slice(1, None, 2), slice(2, None, 2)
        of_steps = jax.tree.map(lambda leaf: jnp.stack([leaf[part] for part in parts], axis=1), sampled(index))
        return of_steps, ((index * burst + jnp.arange(burst)) * dt).astype(like.dtype)

    return inputs


def _gaining(speed: Speed, time: Float[Array, "k"]) -> tuple[Float[Array, "k"], Float[Array, "k"]]:
    """v and v' of a speed profile, m/s and m/s²."""
    return jax.jvp(speed.at, (time,), (jnp.ones_like(time),))  # type: ignore[union-attr]
