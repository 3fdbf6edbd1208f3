"""Figures of a `ContactGeometry` (`found`): where wheel and rail touch, Delta r, angles, conicity."""

from typing import TYPE_CHECKING, Any

import numpy as np

from ...base.style import COLOURS, STYLE
from .conicity import equivalent_conicity

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: m by which the wheel is drawn above the rail, and displacements whose contacts are joined
RAISED, JOINED = 12e-3, 1e-3
#: m
AMPLITUDES = np.arange(2, 33) * 0.25e-3
SIDES = ("right", "left")


def geometry(found: Any, axes: Any = None) -> Any:
    """The contacts, Delta r, the contact angles and the equivalent conicity, into four axes or a figure of its own, which is returned."""
    if axes is None:
        import matplotlib as mpl
        from matplotlib.figure import Figure

        with mpl.rc_context(STYLE):
            page = Figure(figsize=(9.0, 7.0), layout="constrained")
            geometry(found, page.subplots(2, 2).ravel())
        return page
    contact_pair(axes[0], found)
    rolling_radii(axes[1], found)
    angles(axes[2], found)
    conicity(axes[3], found)
    return axes[0].figure


def contact_pair(axes: "Axes", found: Any, side: int = 0) -> None:
    """A wheel drawn above its rail at y = 0, the places joined that touch at whole millimetres of y (positive: towards this wheel's flange)."""
    wheel, rail = (pair[side] for pair in found.profiles)
    sides, sign = found.sides, 1.0 - 2.0 * side
    base, tilt, top = (float(of[side]) for of in (sides.base, sides.tilt, sides.top))
    across, down = rail.drawn[0], rail.drawn[1]
    right = across * np.cos(tilt) + down * np.sin(tilt) + float(sides.outwards[side]) - top
    below = down * np.cos(tilt) - across * np.sin(tilt) + float(sides.downwards[side])
    axes.plot(1e3 * right, -1e3 * below, color="0.15")
    shift = base - top
    axes.plot(1e3 * (wheel.drawn[0] + shift), 1e3 * (RAISED - wheel.drawn[1]), color="0.15")
    y = np.asarray(found.y)
    order = np.argsort(right)
    for at in np.arange(np.ceil(y[0] / JOINED), np.floor(y[-1] / JOINED) + 1) * JOINED:
        k = int(np.argmin(np.abs(y - at)))
        s, u = float(found.wheel_position[k, side]), float(found.rail_position[k, side])
        height = np.interp(s, wheel.lateral, wheel.height), np.interp(u, right[order], below[order])
        colour = COLOURS[0] if sign * at > 0 else COLOURS[1] if at else COLOURS[6]
        axes.plot(1e3 * np.array([s + shift, u]), 1e3 * np.array([RAISED - height[0], -height[1]]), color=colour, linewidth=0.7)
        axes.annotate(
            f"{1e3 * sign * at:.0f}",
            (1e3 * (s + shift), 1e3 * (RAISED - height[0])),
            (0, 4),
            textcoords="offset points",
            fontsize=5.5,
            ha="center",
            color=colour,
        )
    axes.set(
        xlabel="from the rail's top, mm",
        ylabel="up, mm",
        title=f"{wheel.name} on {rail.name}, {SIDES[side]}; contacts at y in mm",
        aspect="equal",
        xlim=(-60.0, 45.0),
        ylim=(-25.0, 25.0),
    )


def rolling_radii(axes: "Axes", found: Any) -> None:
    """Delta r over y, sharp with its jumps marked, and smooth."""
    y = 1e3 * np.asarray(found.y)
    axes.plot(y, 1e3 * np.asarray(found.delta_r), color=COLOURS[0], label="sharp")
    axes.plot(y, 1e3 * np.asarray(found.smooth.delta_r), color=COLOURS[1], linestyle="--", label="smooth")
    for k, at in enumerate(found.jumps):
        axes.axvline(1e3 * at, color="0.5", linewidth=0.7, linestyle=":", label="jumps" if not k else None)
    axes.set(xlabel="lateral displacement y, mm", ylabel=r"$\Delta r$, mm", xlim=(y[0], y[-1]))
    axes.legend(loc="upper left")


def angles(axes: "Axes", found: Any) -> None:
    """Contact angles of both wheels over y."""
    y = 1e3 * np.asarray(found.y)
    for side, name in enumerate(SIDES):
        axes.plot(y, np.degrees(found.contact_angle[:, side]), color=COLOURS[side], label=name)
        axes.plot(y, np.degrees(found.smooth.contact_angle[:, side]), color=COLOURS[side], linestyle="--", linewidth=0.9)
    axes.set(xlabel="lateral displacement y, mm", ylabel="contact angle, degrees", xlim=(y[0], y[-1]))
    axes.legend(loc="upper center")


def conicity(axes: "Axes", found: Any) -> None:
    """Equivalent conicity over amplitude, of the sharp and of the smooth Delta r; that at 3 mm marked."""
    y = np.asarray(found.y)
    amplitudes = np.array([a for a in AMPLITUDES if a <= 0.5 * (y[-1] - y[0])])
    for function, name, style in ((found, "sharp", "-"), (found.smooth, "smooth", "--")):
        value = equivalent_conicity(y, np.asarray(function.delta_r), amplitudes)
        axes.plot(1e3 * amplitudes, value, style, color=COLOURS[0 if style == "-" else 1], label=name)
    at = float(equivalent_conicity(y, np.asarray(found.delta_r), 3e-3))
    axes.plot([3.0], [at], "o", color=COLOURS[0], label=f"{at:.3f} at 3 mm")
    axes.set(xlabel="amplitude, mm", ylabel=r"equivalent conicity tan $\gamma_e$", xlim=(0.0, 8.0))
    axes.set_ylim(bottom=0.0)
    axes.legend(loc="upper center")
