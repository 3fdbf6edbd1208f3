"""Motions as they are filmed: of a simulation, a limit cycle or a mode, pictures at equal intervals of time."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..base.arguments import guarded
from ..base.errors import InputError, NumericalError
from ..base.units import KMH
from ..model.damper import Damper
from ..model.kinematics import layout, split, wheelset_positions
from ..model.motion import PASSIVE, wheelset_shape
from ..model.vehicle import Vehicle
from ..simulation.simulate import Result, Simulation, simulate
from ..simulation.speed import SpeedProfile
from ..simulation.step_size import largest_step
from ..stability.hunting.limit_cycles import LimitCycle
from ..stability.modes import Modes
from .top_view import seen_coordinates

#: pictures of one period of a limit cycle or mode, and each second of film
PERIOD_FRAMES, RATE = 48, 20.0
#: of a simulation: the last seconds that are shown, and how many times slower than they were
LAST, SLOW = 1.5, 5.0
FEWEST_FRAMES, MOST_FRAMES = 16, 2000
#: 1/s; GIFs cannot be shown faster
FASTEST_RATE = 50.0
#: m; largest displacement of a mode, which has none of its own
MODE_AMPLITUDE = 8e-3


class Course(NamedTuple):
    """A motion as it is filmed: coordinates by group, (frames, parts); along the track, and what is said of it."""

    time: Float[np.ndarray, "frames"]  # s
    distance: Float[np.ndarray, "frames"]  # m
    coordinates: dict[str, Float[np.ndarray, "frames parts"]]  # m, rad
    alignment: Callable[[np.ndarray], np.ndarray] | None  # m, at distances from the start; None: even track
    period: float | None  # s, of a motion that repeats itself
    title: str
    scaled: bool = True  # whether amplitudes mean anything


@guarded()
def animation_channels(vehicle: Vehicle) -> tuple[str, ...]:
    """What `simulate` must record for `animate`: all lateral displacements and yaw angles, and the track's alignment."""
    return (*seen_coordinates(vehicle), "alignment")


def of_simulation(vehicle: Vehicle, run: Simulation, start: Any = None, stop: Any = None, slow: float | int = SLOW) -> Course:
    """The pictures of a run between two instants (s)."""
    missing = [name for name in seen_coordinates(vehicle) if name not in run.channels]
    if missing:
        raise InputError(
            f"the simulation has not recorded {', '.join(missing)}: simulate(..., record=railjax.animation_channels(vehicle))"
        )
    if run.code.ndim:
        raise InputError(f"the simulation has {run.code.shape[0]} lanes; animate shows one: simulate it alone")
    if int(run.code) != Result.OK:
        raise NumericalError(f"the run cannot be shown: {Result(int(run.code)).name.lower().replace('_', ' ')}")
    recorded = np.asarray(run.time, float)
    last = recorded[-1]
    stop = last if stop is None else float(stop)
    start = max(stop - LAST, 0.0) if start is None else float(start)
    if not 0.0 <= start < stop <= last * (1.0 + 1e-9):
        raise InputError(f"start and stop must lie within the run, 0 to {last:g} s, not {start:g} and {stop:g}")
    frames = int((stop - start) * slow * RATE + 1e-6) + 1
    if not 2 <= frames <= MOST_FRAMES:
        raise InputError(f"{stop - start:g} s, {slow:g} times slower, are {frames} pictures; 2 to {MOST_FRAMES} can be made")
    time = start + np.arange(frames) / (slow * RATE)

    def at(values: Any) -> np.ndarray:
        table = np.asarray(values, float).reshape(len(recorded), -1)
        return np.column_stack([np.interp(time, recorded, column) for column in table.T])

    shapes = layout(vehicle)
    coordinates = {name: at(run[name]) for name in seen_coordinates(vehicle)}
    for name, values in coordinates.items():
        if values.shape[1] != int(np.prod(shapes[name])):
            raise InputError(f"the simulation is of another vehicle: its {name} has {values.shape[1]} parts")

    def run_by(instants: np.ndarray) -> np.ndarray:
        if isinstance(run.speed, SpeedProfile):
            return np.asarray(run.speed.distance(jnp.asarray(instants)))
        return float(run.speed) * instants

    alignment = None
    if "alignment" in run.channels and np.any(np.asarray(run["alignment"])):
        # what the leading wheelset has met is the track
        leading = float(np.max(wheelset_positions(vehicle, jnp.zeros(wheelset_shape(vehicle)))))
        met, height = run_by(recorded) + leading, np.asarray(run["alignment"], float).reshape(len(recorded), -1)[:, 0]

        def alignment(distance: np.ndarray) -> np.ndarray:
            return np.interp(distance, met, height)

    speed = "" if isinstance(run.speed, SpeedProfile) else f" at {float(run.speed) * KMH:.1f} km/h"
    return Course(time, run_by(time), coordinates, alignment, None, f"{vehicle.name or 'Vehicle'}{speed}")


def pictures(period: float, slow: float | int | None) -> int:
    """How many a period is cut into: 48, or as many as suit the rate of the film `slow` times slower."""
    if slow is None:
        return PERIOD_FRAMES
    frames = int(np.clip(round(RATE * period * slow), FEWEST_FRAMES, MOST_FRAMES))
    if frames > FASTEST_RATE * period * slow:
        least = FEWEST_FRAMES / FASTEST_RATE / period
        raise InputError(f"slow must be at least {least:.2g} for a motion of {1.0 / period:.2f} Hz, not {slow:g}")
    return frames


def of_limit_cycle(vehicle: Vehicle, cycle: LimitCycle, damper: Damper = PASSIVE, slow: float | int | None = None) -> Course:
    """One period of a limit cycle."""
    if not cycle.amplitude > 0.0:
        raise InputError("the Hopf point itself has no amplitude; take a limit cycle beside it")
    period = 1.0 / cycle.frequency
    frames = pictures(period, slow)
    every = int(np.ceil(period / frames / (0.5 * float(largest_step(vehicle, jnp.asarray(cycle.speed), damper)))))
    sample = period / frames
    names = seen_coordinates(vehicle)
    run = simulate(
        vehicle,
        cycle.speed,
        damper=damper,
        duration=period,
        dt=sample / max(every, 4),
        sample=sample,
        initial=cycle.state,
        record=names,
    )
    coordinates = {name: np.asarray(run[name], float).reshape(frames, -1) for name in names}
    kind = "stable" if cycle.stable else "unstable"
    title = (
        f"{vehicle.name or 'Vehicle'}: {kind} limit cycle at {cycle.speed * KMH:.1f} km/h, {1e3 * cycle.amplitude:.2f} mm, "
        f"{cycle.frequency:.2f} Hz"
    )
    time = np.asarray(run.time, float)
    return Course(time, cycle.speed * time, coordinates, None, period, title)


def of_mode(vehicle: Vehicle, found: Modes, mode: int = 0, slow: float | int | None = None) -> Course:
    """One period of a mode as a steady oscillation."""
    count = len(found.names)
    if not 0 <= mode < count:
        raise InputError(f"mode must lie between 0 and {count - 1}, counted from the least damped, not {mode}")
    frequency = float(found.frequency[mode])
    if not frequency > 0.0:
        raise InputError(f"mode {mode}, {found.names[mode]}, does not oscillate, so there is nothing to film")
    frames = pictures(1.0 / frequency, slow)
    time = np.arange(frames) / frames / frequency
    turning = np.exp(2j * np.pi * frequency * time)
    shape = found.shapes[:, mode]
    parts = split(vehicle, jnp.asarray(np.column_stack([shape.real, shape.imag])))
    pieces = {name: np.asarray(part).reshape(-1, 2) @ np.array([1.0, 1.0j]) for name, part in parts.items()}
    coordinates = {name: np.real(turning[:, None] * pieces[name]) for name in seen_coordinates(vehicle)}
    title = (
        f"{vehicle.name or 'Vehicle'} at {found.speed * KMH:.1f} km/h: {found.names[mode]}, {frequency:.2f} Hz, "
        f"damping {100.0 * float(found.damping_ratio[mode]):.1f} %"
    )
    course = Course(time, found.speed * time, coordinates, None, 1.0 / frequency, title, scaled=False)
    largest = largest_displacement(vehicle, course)
    return course._replace(coordinates={name: MODE_AMPLITUDE / largest * values for name, values in coordinates.items()})


def largest_displacement(vehicle: Vehicle, course: Course) -> float:
    """The largest lateral displacement of any end of a body, m."""
    geometry = vehicle.geometry
    bogie = float(geometry.half_wheelbase) * max(np.abs(geometry.axle_pattern))
    half = {
        "carbody": bogie + float(geometry.half_pivot_distance) * max(np.abs(geometry.bogie_pattern)),
        "bogie": bogie,
        "wheelset": 0.0,
    }
    parts = {name.split("_")[0] for name in course.coordinates}
    return max(
        float(np.max(np.abs(course.coordinates[f"{part}_y"]) + half[part] * np.abs(course.coordinates[f"{part}_psi"])))
        for part in parts
    )
