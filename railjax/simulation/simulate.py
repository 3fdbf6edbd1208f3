"""`simulate`: one run or a batch of runs over time, and its result."""

import functools
import math
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ..base.arguments import guarded
from ..base.batches import Batch, alone, chunk_for, with_derivative_of
from ..base.checks import traced
from ..base.compilation import QUICK, hasty
from ..base.errors import InputError
from ..base.packing import as_numbers
from ..base.precision import require_double_precision
from ..base.typing import Scalar
from ..model.damper import Damper
from ..model.kinematics import join, layout
from ..model.motion import PASSIVE, state_size
from ..model.parameters import without_labels
from ..model.track.layout import Layout
from ..model.track.segments import Segment
from ..model.track.shapes import TangentTrack, Track
from ..model.vehicle import Vehicle
from .blocks import Sampled, finished, lane_shape, wheelsets_flat
from .channels import absent, check_channel, has_channel, parse_reduction
from .integrate import Integrated, Plan, integrated
from .result import Result, Simulation
from .speed import Speed, SpeedProfile, a_speed
from .step_size import STABLE_RADIUS, fastest_rate, fastest_rate_on_host


@guarded(speed=a_speed)
def simulate(
    vehicle: Vehicle,
    speed: Speed,
    *,
    track: Track | None = None,
    layout: Layout | None = None,
    damper: Damper = PASSIVE,
    duration: float = 10.0,
    dt: float = 1e-3,
    initial: Mapping[str, Any] | ArrayLike | None = None,
    record: tuple[str, ...] | list[str] = ("carbody_acceleration", "wheelset_y"),
    sample: float | None = None,
    reduce: tuple[str, ...] | list[str] = (),
    settle: float = 0.0,
    chunk: int | None = None,
) -> Simulation:
    """Run the vehicle over a track: RK4 with fixed step.

    A batch: any number in vehicle, speed, track, damper or initial may be an array of one axis of lanes; the others are shared.
    Lanes run on all devices (`use_all_cores`). Inside `jax.vmap` or `jax.grad` it works as well. A run alone, or a small batch,
    keeps its states, and any channel can be read off them afterwards: `run["bogie_y"]`.

    A single run whose dt is beyond what RK4 holds is refused; in a batch (or inside a transformation) such a lane is marked in
    `code` and the others are kept. A run that diverges is marked, alone as well: its history tells how. Failed lanes leave the
    derivatives of what they share with others alone. Differentiable in forward and reverse mode (checkpointed), but never
    differentiate a long hunting run: its phase pollutes the gradient.

    Args:
        vehicle: what runs, as `load_vehicle` gives it.
        speed: v, m/s, or a `SpeedProfile`.
        track: the alignment that is met; by default tangent track. A `Layout` is one as well.
        layout: curvature and cant of the line, upon which the `track` lies; by default straight.
        damper: what takes the place of rho_cy; by default the vehicle's own.
        duration: s, a whole number of steps and of samples.
        dt: step of RK4, s.
        initial: state at the start, SI: x of shape `(states,)` or `(states, lanes)`, or coordinates and rates by name
            ({"wheelset_y": 5e-3, "bogie_y_rate": 0.1}), 0 where not given; by default rest.
        record: channels that are stored, from `railjax.CHANNELS`.
        sample: interval between stored instants 0, sample, 2 sample, ..., s, a multiple of dt; by default 10 dt, or the most
            steps below that which divide the run.
        reduce: "rms:", "mean:" or "peak:" and a channel, such as "rms:carbody_acceleration": taken over every step, without
            storing it.
        settle: time at the start that `reduce` leaves out, s.
        chunk: number of lanes that run together; by default what is quickest.

    Raises:
        InputError: for a dt that RK4 does not hold, times that are no whole number of steps, channels that do not exist or are
            those of a body that is held, coordinates that do not exist, an initial state of another length, and times that are
            traced.
    """
    if layout is None and getattr(track, "cross", None) is not None:
        layout = Layout([Segment.straight(1.0)])  # what rolls the track is met on a layout
    if layout is not None:
        track = layout if track is None else layout.with_irregularity(track)
    track = TangentTrack() if track is None else track
    if isinstance(track, Layout):
        require_double_precision("a layout, or a cross level (leave it out by rolls=False)")
    plan = _plan(vehicle, duration, dt, sample, tuple(record), tuple(reduce), settle)
    x = initial_state(vehicle, damper, initial)
    chunk = chunk_for(x.dtype) if chunk is None else chunk
    # the state is an array of jax.numpy, so that under `jit` it is a tracer
    unknown = traced((vehicle, speed, damper, track, x, dt))
    if isinstance(speed, SpeedProfile):
        asarray = jnp.asarray if unknown else np.asarray
        speed = SpeedProfile(asarray(speed.time, float), asarray(speed.speed, float))
    parameters = as_numbers((without_labels(vehicle), damper, speed, track))
    run = _traced if unknown else _known
    result, code, sampled = run(parameters, x, dt, settle, plan, chunk)
    time = np.arange(plan.samples) * (plan.every * dt)
    # `device_put` compiles nothing, where `jnp.asarray` does
    time, result, code = jax.tree.map(
        lambda leaf: leaf if isinstance(leaf, jax.Array) else jax.device_put(leaf), (time, result, code)
    )
    return Simulation(time, result.records, result.reductions, result.final, code, speed, dt, sampled, vehicle.name)


def _known(
    parameters: tuple, x: Array, dt: float, settle: float, plan: Plan, chunk: int
) -> tuple[Integrated, np.ndarray, Sampled | None]:
    """Numbers that are known: what need not be compiled is done by NumPy."""
    vehicle, damper, speed, _ = parameters
    x = np.asarray(x)  # type: ignore[assignment]
    alone = x.ndim == 1 and all(leaf.ndim == 0 for leaf in jax.tree.leaves(parameters))  # mostly; then without a look at the axes
    lanes = None if alone else _batch(*parameters, x).lanes
    slowest = np.min(speed.speed, axis=0) if isinstance(speed, SpeedProfile) else speed
    fastest = _fastest_known(vehicle, slowest, damper, STABLE_RADIUS / dt)
    too_large = dt * fastest > STABLE_RADIUS
    if too_large.ndim == 0 and too_large:
        if not math.isfinite(fastest):
            raise InputError("the state matrix is not finite; look for a mass or stiffness that is far from any vehicle's")
        raise InputError(
            f"dt = {dt:g} s is too large for RK4 at {float(np.min(slowest)):g} m/s, where creep damping grows as 1/v: "
            f"use dt <= {STABLE_RADIUS / float(fastest):.2g} s"
        )
    result, sampled = finished(parameters, x, dt, settle, plan, lanes, chunk)
    code = np.where(result.diverged, int(Result.DIVERGED), int(Result.OK))
    code = np.where(too_large, int(Result.STEP_TOO_LARGE), code)
    return result, code, sampled


def _traced(parameters: tuple, x: Array, dt: float, settle: float, plan: Plan, chunk: int) -> tuple[Integrated, Array, None]:
    """Inside `jit`, `vmap` or `grad`: one program with the rest of what is transformed."""
    vehicle, damper, speed, _ = parameters
    fastest = _fastest(vehicle, speed, damper, STABLE_RADIUS / dt, spread=False)
    holds = dt * fastest <= STABLE_RADIUS  # a number, as all that `alone` takes
    trees = jax.tree.map(lambda leaf: jnp.asarray(leaf, x.dtype), (*parameters, x, dt, settle, holds))
    batch = _batch(*trees)
    # in a transformation it is the outermost function that can be one kernel (`railjax.jit`)
    if batch.lanes is None:
        result, code = alone(_run(plan, False), _run(plan, True), _batch, chunk, spread=True)(*trees)
    else:

        def lanes_of(one: Callable[..., Any]) -> Callable[..., Any]:
            return lambda *given: _batch(*given).in_chunks(one, chunk)

        result, code = with_derivative_of(lanes_of(_run(plan, True)), lanes_of(_run(plan, False)))(*trees)
    return result, jnp.where(holds, code, int(Result.STEP_TOO_LARGE)), None


def _batch(*trees: Any) -> Batch:
    """Of vehicle, damper, speed, track, the state, and numbers."""
    return Batch.of(*trees, own={4: 1})


@functools.cache
def _run(plan: Plan, guarded: bool) -> Callable[[tuple], tuple[Integrated, Array]]:
    """One run, or all lanes of a chunk together; the same object for the same plan. With `guarded` a lane whose dt is too large is not
    computed: it would spoil derivatives. Without them that is not worth the wait for the check of dt."""

    @jax.jit
    def function(*trees: Any) -> tuple[Integrated, Array]:
        axes, x = _batch(*trees).axes, trees[4]
        *parameters, dt, settle, holds = (jax.tree.map(lambda leaf: jnp.asarray(leaf, x.dtype), tree) for tree in trees)
        vehicle, damper, speed, track, _ = parameters
        shape = jnp.broadcast_shapes(*[lane_shape(t, a) for t, a in zip(trees, axes, strict=True)])
        x = jnp.broadcast_to(x.reshape(x.shape + (1,) * (len(shape) + 1 - x.ndim)), (x.shape[0], *shape))
        result = wheelsets_flat(
            integrated(vehicle, damper, speed, track, x, dt, settle, plan, holds > 0.0 if guarded else None), len(shape)
        )
        return result, jnp.where(result.diverged, int(Result.DIVERGED), int(Result.OK))

    return function


#: lanes up to which dt is checked one after the other on the host, which compiles less
FEW_LANES = 16


def _fastest_known(vehicle: Vehicle, slowest: Any, damper: Damper, enough: float) -> Float[np.ndarray, "..."]:
    """`_fastest` of known numbers."""
    batch = Batch.of(vehicle, slowest, damper)
    if batch.lanes is None:
        return np.asarray(fastest_rate_on_host(*batch.trees, enough))  # type: ignore[call-arg]
    if batch.lanes > FEW_LANES:
        one, speeds, law = batch.trees
        return np.asarray(_fastest(one, speeds, law, np.asarray(enough), spread=True))
    return np.array([fastest_rate_on_host(*batch.take(k), enough) for k in range(batch.lanes)])  # type: ignore[call-arg]


#: lanes whose dt is checked together: their matrices stay in cache
CHECKED = 8


@hasty(QUICK, static_argnames="spread")
def _fastest(vehicle: Vehicle, speed: Speed, damper: Damper, enough: Scalar, spread: bool = False) -> Array:
    """Fastest rate of each lane, 1/s, at the lowest speed; loosely where it is surely below `enough`. With `spread` on all devices."""
    slowest = jnp.min(speed.speed) if isinstance(speed, SpeedProfile) else speed
    trees = jax.tree.map(lambda leaf: jax.lax.stop_gradient(jnp.asarray(leaf, float)), (vehicle, slowest, damper, enough))
    batch = Batch.of(*trees)
    if batch.lanes is None:
        return alone(_fastest_of, _fastest_of, Batch.of, CHECKED, spread=False)(*trees)
    return batch.by_device(_fastest_of, CHECKED) if spread else batch.in_chunks(_fastest_of, CHECKED)


def _fastest_of(*trees: Any) -> Array:
    return Batch.of(*trees).each(fastest_rate)


def initial_state(vehicle: Vehicle, damper: Damper, initial: Mapping[str, Any] | ArrayLike | None) -> Float[Array, "states ..."]:
    """State x from None (rest), an array, or coordinates and rates by name ({"wheelset_y": 5e-3, "bogie_y_rate": ...})."""
    states = state_size(vehicle, damper)
    if initial is None:
        return jax.device_put(np.zeros(states))
    if not isinstance(initial, Mapping):
        x = jnp.asarray(initial, float)
        if x.ndim not in (1, 2) or x.shape[0] != states:
            raise InputError(f"initial must have {states} states along its first axis for this vehicle, not shape {x.shape}")
        return x
    # NumPy where nothing is traced: it need not be compiled
    xp: Any = jnp if traced(dict(initial)) else np
    shapes = layout(vehicle)
    known = [name + suffix for name in shapes for suffix in ("", "_rate")]
    for name in initial:
        if name not in known:
            raise InputError(f"initial: unknown coordinate {name!r}; this vehicle has {', '.join(known)}")
    pieces = []
    for suffix in ("", "_rate"):
        groups = {}
        for name, shape in shapes.items():
            value = xp.asarray(initial.get(name + suffix, 0.0), float)
            try:
                groups[name] = xp.broadcast_to(value.reshape(shape) if value.size == math.prod(shape) else value, shape)
            except ValueError:
                raise InputError(f"initial: {name}{suffix} needs one value or {math.prod(shape)}") from None
        pieces += join(vehicle, groups)
    x = xp.concatenate(pieces)
    return jax.device_put(xp.concatenate([x, np.zeros(states - x.shape[0], x.dtype)]))


#: more than a day of computing; a longer run is a slip of the keyboard
MOST_STEPS = 1e10


def _plan(
    vehicle: Vehicle,
    duration: float,
    dt: float,
    sample: float | None,
    record: tuple,
    reduce: tuple,
    settle: float,
) -> Plan:
    for key, value in (("duration", duration), ("dt", dt), ("settle", settle), ("sample", sample)):
        if isinstance(value, jax.core.Tracer):
            raise InputError(
                f"{key} must be known when the run is compiled, for it tells the number of steps; it cannot be traced"
            )
    if not settle < duration:
        raise InputError(f"settle must lie between 0 and the duration {duration:g} s, not {settle!r}")
    if duration / dt > MOST_STEPS:
        raise InputError(f"duration {duration:g} s in steps of {dt:g} s is more than {MOST_STEPS:.0e} steps; run it in parts")
    steps = round(duration / dt)
    if steps < 1 or abs(steps * dt - duration) > 1e-6 * duration:
        raise InputError(f"duration {duration:g} s must be a whole number of steps of {dt:g} s")
    if sample is None:
        every = next(d for d in range(min(10, steps), 0, -1) if steps % d == 0)
    else:
        every = round(sample / dt)
        if every < 1 or abs(every * dt - sample) > 1e-6 * sample:
            raise InputError(f"sample {sample:g} s must be a whole number of steps of {dt:g} s")
        if steps % every:
            raise InputError(f"duration {duration:g} s must be a whole number of samples of {sample:g} s")
    for name in [check_channel(name) for name in record] + [parse_reduction(name)[1] for name in reduce]:
        if not has_channel(vehicle, name):
            raise InputError(f"channel {name!r}: {absent(vehicle, name)}")
    return Plan(steps // every, every, record, reduce)
