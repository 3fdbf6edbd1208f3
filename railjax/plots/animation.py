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
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from ..base.arguments import guarded
from ..base.checks import Kind
from ..base.errors import InputError
from ..base.style import COLOURS, STYLE, figure, legend_above
from ..model.damper import Damper
from ..model.motion import PASSIVE
from ..model.vehicle import Vehicle
from ..simulation.simulate import Simulation
from ..stability.hunting.limit_cycles import LimitCycle
from ..stability.modes import Modes
from .frames import (
    PERIOD_FRAMES,
    RATE,
    SLOW,
    Course,
    largest_displacement,
    of_limit_cycle,
    of_mode,
    of_simulation,
)
from .top_view import TopView, magnification

if TYPE_CHECKING:
    from matplotlib.animation import FuncAnimation

LARGEST_PAGE = 500.0  # MB
SUFFIXES = (".gif", ".mp4", ".html")


@dataclass(frozen=True)
class Film:
    """What `animate` has written: the file, its number of pictures, how many times displacements and yaw are magnified (a mode, whose
    amplitude is arbitrary, is drawn with 8 mm), and how many times slower than the motion it runs."""

    path: Path
    frames: int  # number of pictures
    magnified: float  # ratio
    slow: float  # ratio

    def __str__(self) -> str:
        return f"{self.path}: {self.frames} pictures, displacements magnified {self.magnified:g} times, slow motion 1:{self.slow:.3g}"


def check_name(out: Path) -> None:
    """Refuse, before any work, what no film can be written to."""
    from matplotlib.animation import FFMpegWriter

    if out.suffix not in SUFFIXES:
        raise InputError(f"{out}: an animation's name must end in {', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]}")
    if not out.parent.is_dir():
        raise InputError(f"{out}: cannot be written (there is no folder {out.parent})")
    if out.suffix == ".mp4" and not FFMpegWriter.isAvailable():
        raise InputError(f"{out}: there is no ffmpeg to write .mp4 with; install it, or write a .gif or .html")


MOTION = Kind((Simulation, LimitCycle, Modes), "a Simulation, a LimitCycle of hunting_branch or Modes")


@guarded(motion=MOTION)
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
    """Film the vehicle from above, as a simulation, a limit cycle or a mode moves it.

    A mode is shown as a steady oscillation of arbitrary amplitude.

    Args:
        vehicle: the vehicle that moves.
        motion: a `Simulation` that has recorded `animation_channels(vehicle)`, a `LimitCycle` of `hunting_branch`, of which one
            period is integrated, or `Modes`.
        out: file that is written, .gif, .mp4 (needs ffmpeg) or .html (a page with buttons).
        mode: number of the mode that is shown, from 0, the least damped.
        damper: what the limit cycle belongs to, in place of rho_cy; by default the vehicle's own.
        start: instant at which the film of a simulation begins, s; by default 1.5 s before it ends.
        stop: instant at which it ends, s; by default the last.
        slow: how many times slower than the motion the film runs, dimensionless; by default 5 for a simulation, else one period
            in 2.4 s.
        magnified: how many times larger displacements and yaw angles are drawn, dimensionless, which the picture says; by default
            up to 0.5 m.
        title: stands above the picture; by default what moves.
        progress: called as `progress(done, total)` with the number of pictures.

    Raises:
        InputError: for another suffix, missing channels (named), lanes, an overdamped mode, a span outside the run, and a file
            that cannot be written.
        NumericalError: for a run that diverged.
    """
    out = Path(out)
    check_name(out)
    for name, value in (("slow", slow), ("magnified", magnified)):
        if value is not None and not (np.isfinite(value) and value > 0):
            raise InputError(f"{name} must be a positive number, not {value!r}")
    if isinstance(motion, Simulation):
        course = of_simulation(vehicle, motion, start, stop, SLOW if slow is None else slow)
    elif start is not None or stop is not None:
        raise InputError("start and stop are for a Simulation; a limit cycle or a mode is shown for one period")
    elif isinstance(motion, LimitCycle):
        course = of_limit_cycle(vehicle, motion, damper, slow)
    else:
        course = of_mode(vehicle, motion, mode, slow)
    course = course if title is None else course._replace(title=title)
    usual = SLOW if course.period is None else PERIOD_FRAMES / RATE / course.period
    slower = float(usual if slow is None else slow)
    factor = magnification(largest_displacement(vehicle, course)) if magnified is None else float(magnified)
    rate = RATE if course.period is None else len(course.time) / (course.period * slower)
    _write(Stage(vehicle, course, factor, slower), out, rate, progress)
    return Film(out, len(course.time), factor, slower)


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
        track = None if course.alignment is None else (lambda along: course.alignment(distance + along))  # type: ignore[misc]
        view.show({name: values[frame] for name, values in course.coordinates.items()}, distance, track)
        view.leave_trail(*self._trail(frame))
        self.cursor.set_xdata([course.time[frame]] * 2)

    def _trail(self, frame: int) -> tuple[Float[np.ndarray, "points"], Float[np.ndarray, "points"]]:
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
