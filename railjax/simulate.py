"""`simulate`: one run or a batch of runs over time, and its result."""

import functools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int

from .channels import CHANNELS, PLACES, check_channel, parse_reduction
from .dampers import Damper, check_damper
from .deflections import join, layout
from .errors import InputError
from .integrate import STABLE_RADIUS, Plan, Run, fastest_rate, run
from .kernels import one_kernel
from .lanes import alone, by_device, chunk_for, count_lanes, each_lane, over_lanes, own_axes
from .motion import PASSIVE, state_size
from .speed_profile import Speed, SpeedProfile
from .track import TangentTrack, Track, check_track
from .typing import Number, Scalar
from .units import KMH
from .vehicle import Vehicle, structure, without_labels

if TYPE_CHECKING:
    import xarray


class Result(IntEnum):
    """What became of a lane."""

    OK = 0
    DIVERGED = 1  # a displacement beyond 1 m or 1 rad, or not a number
    STEP_TOO_LARGE = 2  # dt beyond what RK4 holds at this speed: numbers are not to be used


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Simulation:
    """Result of `simulate`. Arrays have time first, then floor point, bogie or wheelset (n·m), then lanes.

    `channels` holds the recorded time histories, `reductions` the sums over the run ("rms:carbody_acceleration"), `final` the
    state at the end, `code` a `Result` per lane. Indexing by name reads either.
    """

    time: Float[Array, "samples"]  # s
    channels: dict[str, Float[Array, "samples ..."]]  # SI, units as in `railjax.CHANNELS`
    reductions: dict[str, Float[Array, "..."]]  # SI
    final: Float[Array, "states ..."]  # SI: m, rad, m/s, rad/s
    code: Int[Array, "..."]
    speed: Number  # m/s
    dt: Number  # s
    vehicle_name: str = structure("")

    def __getitem__(self, name: str) -> Float[Array, "..."]:
        return self.channels[name] if name in self.channels else self.reductions[name]

    @property
    def ok(self) -> Array:
        """True where the lane's numbers can be used."""
        return self.code == Result.OK

    def __str__(self) -> str:
        shape = self.code.shape
        duration = float(self.time[-1] + (self.time[1] - self.time[0] if len(self.time) > 1 else 0.0))
        lanes = f"{shape[0]} lanes, " if shape else ""
        lines = [f"Simulation of {self.vehicle_name or 'a vehicle'}: {lanes}{duration:g} s in steps of {float(self.dt):g} s"]
        if not isinstance(self.speed, SpeedProfile):
            low, high = float(jnp.min(self.speed)) * KMH, float(jnp.max(self.speed)) * KMH
            lines[0] += f", {low:.1f} km/h" if low == high else f", {low:.1f} to {high:.1f} km/h"
        for name, values in self.channels.items():
            peak = float(jnp.nanmax(jnp.abs(values)))
            lines.append(f"  {name} {tuple(values.shape)}: peak {peak:.4g} {CHANNELS[name].unit}")
        for name, values in self.reductions.items():
            low, high = float(jnp.nanmin(values)), float(jnp.nanmax(values))
            span = f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}"
            lines.append(f"  {name}: {span} {CHANNELS[name.split(':')[1]].unit}")
        for result in Result:
            count = int(jnp.sum(self.code == result))
            if result is not Result.OK and count:
                lines.append(f"  {result.name.lower().replace('_', ' ')}: {count} of {self.code.size} lane(s)")
        return "\n".join(lines)

    def to_xarray(self) -> "xarray.Dataset":
        """A labelled dataset: dimensions time (s), floor, bogie, wheelset, lane; units in the attributes."""
        import xarray

        lane = ("lane",) if self.code.ndim else ()
        variables: dict[str, Any] = {}
        for name, values in (self.channels | self.reductions).items():
            how, _, channel = name.rpartition(":")
            unit, part, _ = CHANNELS[channel]
            time = () if how else ("time",)
            inner = (part,) if values.ndim > len(time) + len(lane) else ()
            variables[name.replace(":", "_")] = ((*time, *inner, *lane), np.asarray(values), {"units": unit})
        variables["code"] = (
            lane,
            np.asarray(self.code),
            {"meaning": ", ".join(f"{r.value} {r.name.lower()}" for r in Result)},
        )
        coordinates: dict[str, Any] = {"time": ("time", np.asarray(self.time), {"units": "s"})}
        dimensions = {name for names, *_ in variables.values() for name in names}
        coordinates |= {part: list(names) for part, names in PLACES.items() if part in dimensions}
        if not isinstance(self.speed, SpeedProfile):
            speed = np.asarray(self.speed)
            coordinates["speed"] = (lane if speed.ndim else (), speed, {"units": "m/s"})
        attributes = {"vehicle": self.vehicle_name, "dt": float(self.dt)}
        return xarray.Dataset(variables, coordinates, attributes)


def simulate(
    vehicle: Vehicle,
    speed: Speed,
    *,
    track: Track | None = None,
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

    Arguments (SI): `speed` in m/s, a number or a `SpeedProfile`; `track` (default tangent); `damper` in place of rho_cy (default
    the vehicle's own); `duration` and `dt` in s; `initial`, a state x of shape (states,) or coordinates by name
    ({"wheelset_y": 5e-3}; 0 where not given); `record`, channels stored every `sample` seconds (default 10 dt; a multiple of dt)
    at the instants 0, sample, 2 sample, ...; `reduce`, sums such as "rms:carbody_acceleration" taken over every step after
    `settle` seconds and not stored. `railjax.CHANNELS` lists the channels.

    A batch: any number in vehicle, speed, track, damper or initial may be an array of one axis of lanes; the others are
    shared. Lanes run in chunks of `chunk` in number (default: what is quickest) on all devices (`use_all_cores`). Inside `jax.vmap` or `jax.grad` it works as well.

    A single run whose dt is beyond what RK4 holds raises `InputError`; in a batch (or inside a transformation) such a lane is
    marked in `code` and the others are kept. Differentiable in forward and reverse mode (checkpointed), but never
    differentiate a long hunting run: its phase pollutes the gradient.
    """
    track = TangentTrack() if track is None else track
    check_track(track)
    check_damper(damper)
    check_speed(speed)
    plan = _plan(vehicle, duration, dt, sample, tuple(record), tuple(reduce), settle)
    x = initial_state(vehicle, damper, initial)
    chunk = chunk_for(x.dtype) if chunk is None else chunk
    bare = without_labels(vehicle)
    if isinstance(speed, SpeedProfile):
        speed = SpeedProfile(jnp.asarray(speed.time, float), jnp.asarray(speed.speed, float))
    trees = (bare, damper, speed, track, x, dt, settle)
    traced = any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(trees))
    fastest = _fastest(bare, speed, damper, STABLE_RADIUS / dt, spread=not traced)
    too_large = dt * fastest > STABLE_RADIUS
    if not isinstance(too_large, jax.core.Tracer) and too_large.ndim == 0 and bool(too_large):
        slowest = float(jnp.min(speed.speed if isinstance(speed, SpeedProfile) else speed))
        if not math.isfinite(fastest):
            raise InputError("the state matrix is not finite; look for a mass or stiffness that is far from any vehicle's")
        raise InputError(
            f"dt = {dt:g} s is too large for RK4 at {slowest:g} m/s, where creep damping grows as 1/v: "
            f"use dt <= {STABLE_RADIUS / float(fastest):.2g} s"
        )
    axes = _axes(*trees)
    lanes = _lanes(trees, axes)
    function = _run(plan)
    if lanes is not None:
        result, code = over_lanes(function, trees, axes, lanes, chunk, spread=True)
    else:
        # in a transformation it is the outermost function that can be one kernel (`railjax.jit`)
        single = alone(function, _axes, chunk, spread=True) if traced else _one_run(plan)
        result, code = single(jax.tree.map(lambda leaf: jnp.asarray(leaf, x.dtype), trees) if traced else trees)
    code = jnp.where(too_large, int(Result.STEP_TOO_LARGE), code)
    time = jnp.arange(plan.samples) * (plan.every * dt)
    return Simulation(time, result.records, result.reductions, result.final, code, speed, jnp.asarray(dt), vehicle.name)


def _axes(vehicle: Vehicle, damper: Damper, speed: Speed, track: Track, *_: Any) -> tuple:
    """Axes of their own, before lanes, of the leaves of vehicle, damper, speed, track, state, dt and settle."""
    of_speed = jax.tree.map(lambda _: 1, speed) if isinstance(speed, SpeedProfile) else 0
    return own_axes(vehicle), own_axes(damper), of_speed, own_axes(track), 1, 0, 0


def _lanes(trees: tuple, axes: tuple) -> int | None:
    *parameters, x, _, _ = trees
    if x.ndim == 1 and all(isinstance(leaf, float) for leaf in jax.tree.leaves(parameters)):
        return None  # the common case, without a look at every leaf's shape
    return count_lanes(trees, axes)


@functools.cache
def _run(plan: Plan) -> Callable[[tuple], tuple[Run, Array]]:
    """One run, or all lanes of a chunk together; the same object for the same plan."""

    @jax.jit
    def function(trees: tuple) -> tuple[Run, Array]:
        axes = _axes(*trees)
        x = trees[4]
        *parameters, dt, settle = (jax.tree.map(lambda leaf: jnp.asarray(leaf, x.dtype), tree) for tree in trees)
        vehicle, damper, speed, track, _ = parameters
        shape = jnp.broadcast_shapes(*[_lane_shape(t, a) for t, a in zip(trees, axes, strict=True)])
        x = jnp.broadcast_to(x.reshape(x.shape + (1,) * (len(shape) + 1 - x.ndim)), (x.shape[0], *shape))
        result = _wheelsets_flat(run(vehicle, damper, speed, track, x, dt, settle, plan), len(shape))
        return result, jnp.where(result.diverged, int(Result.DIVERGED), int(Result.OK))

    return function


@functools.cache
def _one_run(plan: Plan) -> Callable[[tuple], tuple[Run, Array]]:
    return jax.jit(one_kernel(_run(plan)))


#: lanes whose dt is checked together: their matrices stay in cache
CHECKED = 8


@functools.partial(jax.jit, static_argnames="spread")
def _fastest(vehicle: Vehicle, speed: Speed, damper: Damper, enough: Scalar, spread: bool = False) -> Array:
    """Fastest rate of each lane, 1/s, at the lowest speed; loosely where it is surely below `enough`. With `spread` on all devices."""
    slowest = jnp.min(speed.speed) if isinstance(speed, SpeedProfile) else speed
    trees = jax.tree.map(lambda leaf: jax.lax.stop_gradient(jnp.asarray(leaf, float)), (vehicle, slowest, damper, enough))
    axes = _rate_axes(*trees)
    lanes = count_lanes(trees, axes)
    if lanes is None:
        return alone(_fastest_of, _rate_axes, CHECKED, spread=False)(trees)
    if spread:
        return by_device(_fastest_of, trees, axes, CHECKED)
    return over_lanes(_fastest_of, trees, axes, lanes, CHECKED)


def _rate_axes(vehicle: Vehicle, slowest: Scalar, damper: Damper, enough: Scalar) -> tuple:
    return own_axes(vehicle), 0, own_axes(damper), 0


def _fastest_of(trees: tuple) -> Array:
    axes = _rate_axes(*trees)
    return fastest_rate(*trees) if count_lanes(trees, axes) is None else each_lane(fastest_rate, trees, axes)


def _lane_shape(tree: Any, axes: Any) -> tuple[int, ...]:
    shapes = [jnp.shape(leaf)[own:] for leaf, own in zip(jax.tree.leaves(tree), jax.tree.leaves(axes), strict=True)]
    return jnp.broadcast_shapes(*shapes) if shapes else ()


def _wheelsets_flat(result, lanes: int):
    """Records and reductions with wheelsets (n, m) as one axis n·m."""

    def flat(name: str, values: Array, lead: int) -> Array:
        channel = name.rpartition(":")[2]
        if CHANNELS[channel].part != "wheelset":
            return values
        return values.reshape((*values.shape[:lead], -1, *values.shape[values.ndim - lanes :]))

    records = {name: flat(name, values, 1) for name, values in result.records.items()}
    reductions = {name: flat(name, values, 0) for name, values in result.reductions.items()}
    return result._replace(records=records, reductions=reductions)


def initial_state(vehicle: Vehicle, damper: Damper, initial: Mapping[str, Any] | ArrayLike | None) -> Float[Array, "states ..."]:
    """State x from None (rest), an array, or coordinates and rates by name ({"wheelset_y": 5e-3, "bogie_y_rate": ...})."""
    states = state_size(vehicle, damper)
    if initial is None:
        return jnp.zeros(states)
    if not isinstance(initial, Mapping):
        x = jnp.asarray(initial, float)
        if x.ndim not in (1, 2) or x.shape[0] != states:
            raise InputError(f"initial must have {states} states along its first axis for this vehicle, not shape {x.shape}")
        return x
    shapes = layout(vehicle)
    known = [name + suffix for name in shapes for suffix in ("", "_rate")]
    for name in initial:
        if name not in known:
            raise InputError(f"initial: unknown coordinate {name!r}; this vehicle has {', '.join(known)}")
    pieces = []
    for suffix in ("", "_rate"):
        groups = {}
        for name, shape in shapes.items():
            value = jnp.asarray(initial.get(name + suffix, 0.0), float)
            try:
                groups[name] = jnp.broadcast_to(value.reshape(shape) if value.size == math.prod(shape) else value, shape)
            except ValueError:
                raise InputError(f"initial: {name}{suffix} needs one value or {math.prod(shape)}") from None
        pieces += join(vehicle, groups)
    x = jnp.concatenate(pieces)
    return jnp.concatenate([x, jnp.zeros(states - x.shape[0], x.dtype)])


#: more than a day of computing; a longer run is a slip of the keyboard
MOST_STEPS = 1e10


def check_speed(speed: Speed) -> None:
    """Refuse speeds that are not positive and finite, where they are known."""
    values = speed.speed if isinstance(speed, SpeedProfile) else speed
    if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(values)):
        return
    # NumPy, because under `jit` even constants become tracers of jax.numpy
    array = np.asarray(values, float)
    if not np.all(np.isfinite(array) & (array > 0)):
        raise InputError(f"speed must be positive (m/s), not {np.min(array):g}: creepage is a ratio to the speed")


def _plan(
    vehicle: Vehicle,
    duration: float,
    dt: float,
    sample: float | None,
    record: tuple,
    reduce: tuple,
    settle: float,
) -> Plan:
    for key, value in (("duration", duration), ("dt", dt)):
        if not (isinstance(value, (int, float)) and math.isfinite(value) and value > 0):
            raise InputError(f"{key} must be a positive number of seconds, not {value!r}")
    if not 0 <= settle < duration:
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
    shapes = layout(vehicle)
    parts = {name.split("_")[0] for name in shapes} | ({"bogie", "floor"} if "carbody_y" in shapes else set())
    for name in [check_channel(name) for name in record] + [parse_reduction(name)[1] for name in reduce]:
        if CHANNELS[name].part not in parts or (name in UNAVAILABLE and len(parts) == 1):
            raise InputError(f"channel {name!r}: this vehicle's {CHANNELS[name].part} is held")
    return Plan(steps // every, every, record, reduce)


#: channels of the bogie's suspension that a lone wheelset lacks
UNAVAILABLE = ("secondary_travel", "secondary_velocity", "damper_force")
