"""Charts of more than one kind of result."""

from typing import TYPE_CHECKING

import numpy as np

from ..base.style import COLOURS, legend_above

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..simulation.result import Simulation


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
