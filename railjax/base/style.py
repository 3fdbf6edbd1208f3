"""One style for all figures: colour-blind safe, the paper's value beside ours. Results draw themselves with it."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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


def with_powers(unit: str) -> str:
    """A unit as figures write it: m/s² for m/s^2."""
    return unit.replace("^2", "²")


def legend_above(axes: "Axes", columns: int | None = None) -> None:
    """The legend outside, above the axes, where it hides nothing."""
    handles, _ = axes.get_legend_handles_labels()
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=columns or len(handles), borderaxespad=0.2)
