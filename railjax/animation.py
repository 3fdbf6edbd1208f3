"""Animations: the vehicle from above on its track, as a simulation, a limit cycle or a mode moves it, as GIF, MP4 or HTML.

railjax.animate(coach, railjax.modes(coach, 68.2), "mode.gif")
railjax.animate(coach, railjax.hunting_branch(coach).at(66.0), "hunting.gif")
run = railjax.simulate(coach, 66.0, damper=railjax.BalanceLogic(), record=railjax.animation_channels(coach))
railjax.animate(coach, run, "controlled.gif")
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .dampers import Damper
from .deflections import layout, split
from .errors import InputError, NumericalError
from .hunting import LimitCycle
from .integrate import largest_step
from .modes import Modes
from .motion import PASSIVE
from .plots import COLOURS, STYLE, figure, legend_above
from .simulate import Result, Simulation, simulate
from .speed_profile import SpeedProfile
from .top_view import TopView, magnification, seen_coordinates
from .units import KMH
from .vehicle import Vehicle

if TYPE_CHECKING:
    from matplotlib.animation import FuncAnimation

#: pictures of one period of a limit cycle or mode, and each second of film
PERIOD_FRAMES, RATE = 48, 20.0
#: of a simulation: the last seconds that are shown, and how many times slower than they were
LAST, SLOW = 1.5, 5.0
#: m; largest displacement of a mode, which has none of its own
MODE_AMPLITUDE = 8e-3
MOST_FRAMES = 2000
LARGEST_PAGE = 500.0  # MB
SUFFIXES = (".gif", ".mp4", ".html")


class Course(NamedTuple):
    """A motion as it is filmed: coordinates by group, (frames, parts); along the track, and what is said of it."""

    time: Float[np.ndarray, "frames"]  # s
    distance: Float[np.ndarray, "frames"]  # m
    coordinates: dict[str, Float[np.ndarray, "frames parts"]]  # m, rad
    alignment: Callable[[np.ndarray], np.ndarray] | None  # m, at distances from the start; None: even track
    period: float | None  # s, of a motion that repeats itself
    title: str
    scaled: bool = True  # whether amplitudes mean anything


@dataclass(frozen=True)
class Film:
    """What `animate` has written: the file, its number of pictures, how many times displacements and yaw are magnified (a mode, whose
    amplitude is arbitrary, is drawn with 8 mm), and how many times slower than the motion it runs."""

    path: Path
    frames: int
    magnified: float
    slow: float

    def __str__(self) -> str:
        return f"{self.path}: {self.frames} pictures, displacements magnified {self.magnified:g} times, slow motion 1:{self.slow:.3g}"


def animation_channels(vehicle: Vehicle) -> tuple[str, ...]:
    """What `simulate` must record for `animate`: all lateral displacements and yaw angles, and the track's alignment."""
    return (*seen_coordinates(vehicle), "alignment")


def animate(
    vehicle: Vehicle,
    motion: Simulation | LimitCycle | Modes,
    out: str | Path,
    *,
    mode: int = 0,
    damper: Damper = PASSIVE,
    start: float | int | None = None,
    stop: float | int | None = None,
    slow: float | int | None = None,
    magnified: float | int | None = None,
    title: str | None = None,
    progress: Callable[[int, int], Any] | None = None,
) -> Film:
    """Film the vehicle from above and write it to `out`: .gif, .mp4 (needs ffmpeg) or .html (a page with buttons).

    `motion` is a `Simulation` that has recorded `animation_channels(vehicle)` (of which `start` to `stop` s are shown, default the
    last 1.5), a `LimitCycle` of `hunting_branch` (one period, integrated with the `damper` that it belongs to), or `Modes`, of which the
    one numbered `mode` is shown as a steady oscillation of arbitrary amplitude. The film runs `slow` times slower than the motion
    (default 5 for a simulation; else one period in 2.4 s); displacements and yaw angles are drawn `magnified` times (default up to 0.4 m), which the
    picture says. `progress(done, total)` is called for every picture.

    Raises `InputError` for another suffix, missing channels (named), lanes, an overdamped mode, a span outside the run;
    `NumericalError` for a run that diverged.
    """
    out = Path(out)
    if out.suffix not in SUFFIXES:
        raise InputError(f"{out}: an animation's name must end in {', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]}")
    for name, value in (("slow", slow), ("magnified", magnified)):
        if value is not None and not (np.isfinite(value) and value > 0):
            raise InputError(f"{name} must be a positive number, not {value!r}")
    if isinstance(motion, Simulation):
        course = of_simulation(vehicle, motion, start, stop, SLOW if slow is None else slow)
    elif start is not None or stop is not None:
        raise InputError("start and stop are for a Simulation; a limit cycle or a mode is shown for one period")
    elif isinstance(motion, LimitCycle):
        course = of_limit_cycle(vehicle, motion, damper)
    else:
        course = of_mode(vehicle, motion, mode)
    course = course if title is None else course._replace(title=title)
    if course.period is None:
        slower = SLOW if slow is None else slow
    else:
        slower = PERIOD_FRAMES / RATE / course.period if slow is None else slow
    factor = magnification(_largest(vehicle, course)) if magnified is None else float(magnified)
    rate = RATE if course.period is None else len(course.time) / (course.period * slower)
    _write(Stage(vehicle, course, factor, slower), out, rate, progress)
    return Film(out, len(course.time), factor, float(slower))


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
    frames = int((stop - start) * slow * RATE) + 1
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
        leading = np.max(_positions(vehicle))
        met, height = run_by(recorded) + leading, np.asarray(run["alignment"], float).reshape(len(recorded), -1)[:, 0]

        def alignment(distance: np.ndarray) -> np.ndarray:
            return np.interp(distance, met, height)

    speed = "" if isinstance(run.speed, SpeedProfile) else f" at {float(run.speed) * KMH:.1f} km/h"
    return Course(time, run_by(time), coordinates, alignment, None, f"{vehicle.name or 'Vehicle'}{speed}")


def of_limit_cycle(vehicle: Vehicle, cycle: LimitCycle, damper: Damper = PASSIVE) -> Course:
    """One period of a limit cycle."""
    if not cycle.amplitude > 0.0:
        raise InputError("the Hopf point itself has no amplitude; take a limit cycle beside it")
    period = 1.0 / cycle.frequency
    every = int(np.ceil(period / PERIOD_FRAMES / (0.5 * float(largest_step(vehicle, jnp.asarray(cycle.speed), damper)))))
    sample = period / PERIOD_FRAMES
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
    coordinates = {name: np.asarray(run[name], float).reshape(PERIOD_FRAMES, -1) for name in names}
    kind = "stable" if cycle.stable else "unstable"
    title = (
        f"{vehicle.name or 'Vehicle'}: {kind} limit cycle at {cycle.speed * KMH:.1f} km/h, {1e3 * cycle.amplitude:.2f} mm, "
        f"{cycle.frequency:.2f} Hz"
    )
    time = np.asarray(run.time, float)
    return Course(time, cycle.speed * time, coordinates, None, period, title)


def of_mode(vehicle: Vehicle, found: Modes, mode: int = 0) -> Course:
    """One period of a mode as a steady oscillation."""
    count = len(found.names)
    if not 0 <= mode < count:
        raise InputError(f"mode must lie between 0 and {count - 1}, counted from the least damped, not {mode}")
    frequency = float(found.frequency[mode])
    if not frequency > 0.0:
        raise InputError(f"mode {mode}, {found.names[mode]}, does not oscillate, so there is nothing to film")
    time = np.arange(PERIOD_FRAMES) / PERIOD_FRAMES / frequency
    turning = np.exp(2j * np.pi * frequency * time)
    shape = jnp.asarray(found.shapes[:, mode])
    pieces = {name: np.ravel(np.asarray(part)) for name, part in split(vehicle, shape).items()}
    coordinates = {name: np.real(turning[:, None] * pieces[name]) for name in seen_coordinates(vehicle)}
    title = (
        f"{vehicle.name or 'Vehicle'} at {found.speed * KMH:.1f} km/h: {found.names[mode]}, {frequency:.2f} Hz, "
        f"damping {100.0 * float(found.damping_ratio[mode]):.1f} %"
    )
    course = Course(time, found.speed * time, coordinates, None, 1.0 / frequency, title, scaled=False)
    largest = _largest(vehicle, course)
    return course._replace(coordinates={name: MODE_AMPLITUDE / largest * values for name, values in coordinates.items()})


def _positions(vehicle: Vehicle) -> Float[np.ndarray, "wheelsets"]:
    geometry = vehicle.geometry
    bogies = np.asarray(geometry.bogie_pattern) * float(geometry.half_pivot_distance)
    return (bogies[:, None] + np.asarray(geometry.axle_pattern) * float(geometry.half_wheelbase)).ravel()


def _largest(vehicle: Vehicle, course: Course) -> float:
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


#: part -> label in the time histories, colour; the first bogie and wheelset
DRAWN = {
    "carbody_y": ("car body", COLOURS[0]),
    "bogie_y": ("leading bogie", COLOURS[2]),
    "wheelset_y": ("leading wheelset", "0.1"),
}


class Stage:
    """The figure of a course: the view from above, what is said of it, and the time histories with a cursor."""

    def __init__(self, vehicle: Vehicle, course: Course, magnified: float, slow: float) -> None:
        self.course = course
        with figure(rows=2, height=2.0) as (page, axes):
            self.page = page
            self.view = TopView(axes[0, 0], vehicle, magnified)
            top, below = axes[:, 0]
            compact = self.view.compact
            page.set_size_inches(7.2, 5.2 if compact else 4.0)
            top.get_gridspec().set_height_ratios((3.0, 1.0) if compact else (1.7, 1.0))
            said = f"displacements and yaw magnified {magnified:g} times" if course.scaled else "amplitude arbitrary"
            text = f"{course.title}\n{said}; running to the right; slow motion 1:{slow:.3g}"
            page.suptitle(text, x=0.01, ha="left", fontsize=9.5)
            if course.scaled:
                # at least 0.1 m in the drawing
                self.view.scale_bar(float(10.0 ** np.ceil(np.log10(0.1 / magnified))))
            factor = 1e3 if course.scaled else 1.0
            for name, (label, colour) in DRAWN.items():
                if name in course.coordinates:
                    below.plot(course.time, factor * course.coordinates[name][:, 0], color=colour, label=label)
            self.cursor = below.axvline(course.time[0], color=COLOURS[1], linewidth=1.2)
            below.set(
                xlabel="time, s", ylabel="lateral, mm" if course.scaled else "lateral", xlim=(course.time[0], course.time[-1])
            )
            if not course.scaled:
                below.set_yticks([0.0], ["0"])
            legend_above(below)
            self.show(0)
            # laid out once, not for every picture
            page.draw_without_rendering()
            page.set_layout_engine("none")

    def show(self, frame: int) -> None:
        """Move everything to a picture of the course."""
        course, view = self.course, self.view
        distance = float(course.distance[frame])
        track = None if course.alignment is None else (lambda along: course.alignment(distance + along))
        view.show({name: values[frame] for name, values in course.coordinates.items()}, distance, track)
        view.leave_trail(*self._trail(frame))
        self.cursor.set_xdata([course.time[frame]] * 2)

    def _trail(self, frame: int) -> tuple[np.ndarray, np.ndarray]:
        """Where the leading wheelset's centre has been, ahead of the car body's centre (m), and its displacement there."""
        course, leading = self.course, float(np.max(self.view.bogies) + np.max(self.view.axles))
        distance, lateral = course.distance, course.coordinates["wheelset_y"][:, 0]
        if course.period is not None:
            # the motion has always been going on
            length = course.period * (distance[1] - distance[0]) / (course.time[1] - course.time[0])
            turns = int(np.ceil(2.0 * self.view.reach / length)) + 1
            distance = np.concatenate([distance - turn * length for turn in range(turns, -1, -1)])
            lateral = np.tile(lateral, turns + 1)
            frame += turns * len(course.time)
        along = leading + distance[: frame + 1] - distance[frame]
        seen = along > -self.view.reach - 1.0
        return along[seen], lateral[: frame + 1][seen]

    def film(self, rate: float) -> "FuncAnimation":
        """All pictures, `rate` of them each second."""
        from matplotlib.animation import FuncAnimation

        return FuncAnimation(self.page, self.show, frames=len(self.course.time), interval=1e3 / rate, repeat=True)


#: the buttons' symbols, of a font that matplotlib's page would fetch from elsewhere
SYMBOLS = {
    "minus": "−",
    "fast-backward": "⏮",
    "step-backward": "‹",
    "play fa-flip-horizontal": "◀",
    "pause": "❚❚",
    "play": "▶",
    "step-forward": "›",
    "fast-forward": "⏭",
    "plus": "+",
}


def _write(stage: Stage, out: Path, rate: float, progress: Callable[[int, int], Any] | None) -> None:
    import matplotlib as mpl
    from matplotlib.animation import FFMpegWriter, HTMLWriter, PillowWriter

    if out.suffix == ".mp4" and not FFMpegWriter.isAvailable():
        raise InputError(f"{out}: there is no ffmpeg to write .mp4 with; install it, or write a .gif or .html")
    count = len(stage.course.time)
    tell = None if progress is None else (lambda done, _: progress(done + 1, count))
    writers = {
        ".gif": lambda: PillowWriter(fps=rate),
        ".mp4": lambda: FFMpegWriter(fps=rate),
        ".html": lambda: HTMLWriter(fps=rate, embed_frames=True, embed_limit=LARGEST_PAGE),
    }
    try:
        with mpl.rc_context(STYLE):
            writer = writers[out.suffix]()
            stage.film(rate).save(out, writer=writer, dpi=110, progress_callback=tell)
            if out.suffix == ".html":
                out.write_text(_self_contained(out.read_text(encoding="utf-8"), stage.course.title), encoding="utf-8")
    except OSError as error:
        raise InputError(f"{out}: cannot be written ({error.strerror})") from None


def _self_contained(page: str, title: str) -> str:
    """matplotlib's page without what it would fetch, with a title and a text for those who cannot see it."""
    page = re.sub(r"<link[^>]*>", "", page)
    for name, symbol in SYMBOLS.items():
        page = page.replace(f'<i class="fa fa-{name}"></i>', symbol)
    text = f"Animation, seen from above. {title}".replace("&", "&amp;").replace('"', "&quot;").replace("<", "&lt;")
    page = page.replace("<img id=", f'<img alt="{text}" style="max-width: 100%; height: auto" id=', 1)
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{text}</title></head><body>\n{page}</body></html>\n'
    )
