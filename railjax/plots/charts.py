"""One style for all figures: colour-blind safe, km/h where engineers read km/h, the paper's value beside ours."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ..ride.comfort_result import Comfort
    from ..simulation.simulate import Simulation
    from ..stability.hunting.limit_cycles import Branch
    from ..stability.hunting.ramp import Ramp
    from ..stability.modes import RootLocus

#: Okabe and Ito's palette, told apart with every common colour blindness
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
PAPER = {"color": "0.35", "linestyle": (0, (1, 1.5)), "linewidth": 1.2}

STYLE = {
    "axes.grid": True,
    "axes.prop_cycle": f"cycler('color', {list(COLOURS)})",
    "axes.spines.right": False,
    "axes.spines.top": False,
    "font.size": 9.5,
    "grid.alpha": 0.3,
    "grid.linewidth": 0.6,
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "lines.linewidth": 1.4,
    "savefig.dpi": 160,
}


@contextmanager
def figure(rows: int = 1, columns: int = 1, height: float = 3.4, share_x: bool = False) -> Iterator[tuple["Figure", np.ndarray]]:
    """A figure of the house style and its axes as an array (rows, columns); made without touching global state."""
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        page = Figure(figsize=(7.2, height * rows), layout="constrained")
        yield page, page.subplots(rows, columns, squeeze=False, sharex=share_x)


def mark_paper(axes: "Axes", value: float, text: str, horizontal: bool = True) -> None:
    """A value of the paper as a labelled dotted line."""
    draw = axes.axhline if horizontal else axes.axvline
    draw(value, label=text, **PAPER)


def histories(
    axes: "Axes",
    run: "Simulation",
    channels: dict[str, str],
    scale: float,
    unit: str,
    last: float | None = None,
) -> None:
    """Time histories of some channels (first entry of bogie and wheelset channels) over the last seconds of a run."""
    time = np.asarray(run.time)
    shown = time >= (time[-1] - last if last else 0.0)
    for channel, label in channels.items():
        values = np.asarray(run[channel]) * scale
        axes.plot(time[shown], values[shown] if values.ndim == 1 else values[shown, 0], label=label)
    axes.set(xlabel="time, s", ylabel=unit, xlim=(time[shown][0], time[-1]))
    legend_above(axes)


def with_powers(unit: str) -> str:
    """A unit as figures write it: m/s² for m/s^2."""
    return unit.replace("^2", "²")


def legend_above(axes: "Axes", columns: int | None = None) -> None:
    """The legend outside, above the axes, where it hides nothing."""
    handles, _ = axes.get_legend_handles_labels()
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=columns or len(handles), borderaxespad=0.2)


def locus(axes: "Axes", result: "RootLocus", limit: float = 0.6, marks: Mapping[str, float] | None = None) -> None:
    """Damping ratio over speed of the modes that are ever less damped than `limit`; speeds in km/h marked by name."""
    from ..base.units import KMH

    damping = result.damping_ratio
    order = np.argsort(damping.min(axis=0))
    colours: dict[str, str] = {}
    for k in [k for k in order if damping[:, k].min() < limit]:
        # twins, alike but for the phase of the bogies, share a colour
        kind, _, phase = result.names[k].partition(", ")
        if kind not in colours and len(colours) == len(COLOURS):
            break
        colour = colours.setdefault(kind, COLOURS[len(colours) % len(COLOURS)])
        style = (0, (4, 3)) if phase.startswith("bogies in opposition") else "-"
        axes.plot(result.speeds * KMH, 100 * damping[:, k], color=colour, linestyle=style, label=result.names[k])
    axes.axhline(0.0, color="0.2", linewidth=0.8)
    for (name, speed), style in zip((marks or {}).items(), (":", "-."), strict=False):
        axes.axvline(speed, color="0.35", linestyle=style, linewidth=1.2, label=f"{name}, {speed:.1f} km/h")
    axes.set(
        xlabel="speed, km/h",
        ylabel="damping ratio, %",
        xlim=(result.speeds[0] * KMH, result.speeds[-1] * KMH),
    )
    legend_above(axes, 2)


def tornado(axes: "Axes", labels: list[str], changes: dict[str, np.ndarray], unit: str) -> None:
    """Horizontal bars about zero, one row per label, the first on top; the kinds of `changes` side by side in a row."""
    rows, height = np.arange(len(labels)), 0.8 / len(changes)
    for k, (kind, values) in enumerate(changes.items()):
        axes.barh(rows + (k - 0.5 * (len(changes) - 1)) * height, values, height, label=kind, color=COLOURS[k])
    axes.axvline(0.0, color="0.2", linewidth=0.8)
    axes.set_yticks(rows, labels)
    axes.set(xlabel=unit, ylim=(len(labels) - 0.4, -0.6))
    axes.grid(visible=False, axis="y")
    # the smallest bars are at the bottom
    axes.legend(loc="lower right")


def bifurcation(axes: "Axes", branch: "Branch", ramp: "Ramp | None" = None) -> None:
    """Amplitude over speed: stable limit cycles solid, unstable ones dashed, straight running on the axis, jumps as arrows."""
    from ..base.units import KMH

    hopf = float(branch.hopf.speed) * KMH
    named: set[bool] = set()
    for piece in branch.pieces:
        for stable, points in _runs(piece):
            speeds, heights = (np.array([getattr(p, name) for p in points]) for name in ("speed", "amplitude"))
            label = ("stable limit cycle" if stable else "unstable limit cycle") if stable not in named else None
            named.add(stable)
            style = "-" if stable else (0, (4, 2.5))
            axes.plot(speeds * KMH, heights * 1e3, color=COLOURS[0], linestyle=style, label=label)
    left, right = branch.speed.min() * KMH - 8.0, branch.speed.max() * KMH
    axes.plot([left, min(hopf, right)], [0, 0], color=COLOURS[0], clip_on=False, zorder=3)
    if np.isfinite(hopf):
        axes.plot([hopf, right], [0, 0], color=COLOURS[0], linestyle=(0, (4, 2.5)), clip_on=False, zorder=3)
        axes.plot(hopf, 0, "o", color=COLOURS[1], clip_on=False, zorder=4, label=f"Hopf point, {hopf:.1f} km/h")
    fold = branch.fold
    arrow = {"arrowstyle": "-|>", "color": "0.45", "linewidth": 1.0, "shrinkA": 0, "shrinkB": 3}
    if fold is not None:
        speed, height = fold.speed * KMH, fold.amplitude * 1e3
        axes.plot(speed, height, "s", color=COLOURS[1], zorder=4, label=f"fold, {speed:.1f} km/h and {height:.2f} mm")
        axes.annotate("", (speed, 0.0), (speed, height), arrowprops=arrow)
        above = [p for p in branch.points if p.stable and p.amplitude > 0]
        if above and np.isfinite(hopf):
            landing = np.interp(hopf, *np.array(sorted((p.speed * KMH, p.amplitude * 1e3) for p in above)).T)
            axes.annotate("", (hopf, landing), (hopf, 0.0), arrowprops=arrow)
    if ramp is not None:
        axes.plot(ramp.down_speed * KMH, ramp.down_amplitude * 1e3, ".", ms=2.5, color=COLOURS[2], label="simulated ramp down")
        axes.plot(ramp.up_speed * KMH, ramp.up_amplitude * 1e3, ".", ms=2.5, color=COLOURS[4], label="simulated ramp up")
    axes.set(
        xlabel="speed, km/h",
        ylabel=f"amplitude of wheelset {branch.wheelset + 1}, mm",
        xlim=(left, right),
        ylim=(0.0, None),
    )
    legend_above(axes, 3)


def comfort(axes: "Axes", bands: "Axes | None", found: "Comfort") -> None:
    """Weighted r.m.s. of successive 5 s over time, and Sperling's index by third octaves; a line per direction and place or lane."""
    from ..ride.vibration import BLOCK, THIRD_OCTAVES

    def lines(direction: str, values: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
        columns = values.reshape(len(values), -1).T
        of = [f", {place}" for place in found.places] if len(found.places) == len(columns) else [""] * len(columns)
        return zip([direction + place for place in of], columns, strict=True)

    for direction, blocks in found.blocks.items():
        for name, values in lines(direction, blocks):
            axes.stairs(
                values, BLOCK * np.arange(len(values) + 1), baseline=None, label=f"{name} ({found.weightings[direction]})"
            )
    axes.set(xlabel="time, s", ylabel="weighted r.m.s. of 5 s, m/s²", ylim=(0.0, None))
    legend_above(axes, 2)
    if bands is None:
        return
    for direction, parts in found.sperling_bands.items():
        for (name, values), whole in zip(lines(direction, parts), found.sperling[direction].flat, strict=True):
            bands.semilogx([10.0 ** (n / 10.0) for n in THIRD_OCTAVES], values, ".-", label=f"{name}, $W_z$ = {whole:.2f}")
    bands.set(xlabel="third octave, Hz", ylabel="Sperling's index of the band", ylim=(0.0, None))
    bands.set_xticks([0.5, 1, 2, 4, 8, 16, 31.5], ["0.5", "1", "2", "4", "8", "16", "31.5"])
    bands.minorticks_off()
    legend_above(bands, 2)


def _runs(piece: tuple) -> Iterator[tuple[bool, list]]:
    """Stretches of like stability, each with the first point of the next so that no gap shows."""
    start = 0
    for k in range(1, len(piece) + 1):
        if k == len(piece) or piece[k].stable != piece[start].stable:
            yield piece[start].stable, list(piece[start : k + 1])
            start = k
