"""Figures of a `SteadyCurving` (`found`): the wheelsets in a curve from above with the rails' forces, and what the wheels do over lanes."""

from typing import Any

import numpy as np

from ...base.style import COLOURS, STYLE, legend_above
from ...base.units import KMH

#: what is drawn of a vehicle, in units of its half gauge: the distance of wheelsets and of bogies, the length of a wheel
AXLES, BOGIES, WHEEL = 1.9, 3.4, 0.55
#: how far the largest displacement, the largest yaw (drawn as an angle, rad) and the largest force are to be seen
ASIDE, TURNED, ARROW = 0.3, 0.25, 0.9


def curve(found: Any, axes: Any = None) -> Any:
    """Wheelsets of one curve from above, running to the right: displacements and yaw magnified, forces on the wheels as arrows. Returns
    the figure."""
    if axes is None:
        import matplotlib as mpl
        from matplotlib.figure import Figure

        with mpl.rc_context(STYLE):
            page = Figure(figsize=(9.0, 4.4), layout="constrained")
            return curve(found, page.subplots())
    y, psi = np.asarray(found.wheelset_y), np.asarray(found.wheelset_psi)
    force, along = np.asarray(found.guiding_force), np.asarray(found.longitudinal_creep_force)
    places = _places(found)
    # y to the right is drawn downwards
    aside = ASIDE / max(np.max(np.abs(y)), 1e-9)
    turned = TURNED / max(np.max(np.abs(psi)), 1e-9)
    largest = max(np.max(np.abs(force)), np.max(np.abs(along)), 1e-9)
    ends = min(places) - 1.6, max(places) + 1.6
    for side in (1.0, -1.0):
        axes.plot(ends, (side, side), color="0.35", linewidth=2.5, zorder=1)
        if found.clearance:
            axes.plot(ends, np.full(2, side + side * aside * found.clearance), ":", color="0.6", linewidth=0.9, zorder=1)
    for k, x in enumerate(places):
        _wheelset(axes, x, -aside * y[k], -turned * psi[k])
        for wheel, side in enumerate((1.0, -1.0)):
            at = x - side * np.sin(-turned * psi[k]), side - aside * y[k]
            # across the rail and along it
            for (dx, dy), colour in (((0.0, -force[k, wheel]), COLOURS[1]), ((along[k, wheel], 0.0), COLOURS[0])):
                size = np.hypot(dx, dy) / largest
                if size > 0.02:
                    end = at[0] + ARROW * dx / largest, at[1] + ARROW * dy / largest
                    axes.annotate("", end, at, arrowprops={"arrowstyle": "-|>", "color": colour, "linewidth": 1.8}, zorder=4)
            text = f"{1e-3 * abs(force[k, wheel]):.1f} kN"
            axes.annotate(text, (x, side * 2.15), ha="center", va="center", color=COLOURS[1], fontsize=8.5)
        axes.annotate(
            f"{k + 1}: {1e3 * y[k]:+.1f} mm, {1e3 * psi[k]:+.2f} mrad", (x, -2.55), ha="center", va="center", fontsize=8.0
        )
    right = float(found.radius) > 0.0
    for side in (1.0, -1.0):
        name = "outer rail" if (side > 0.0) == right else "inner rail"
        axes.annotate(name, (ends[0], side), (0, 4), textcoords="offset points", va="bottom", color="0.35", fontsize=8.5)
    axes.plot([], [], color=COLOURS[1], label="lateral force of the rail on the wheel")
    axes.plot([], [], color=COLOURS[0], label="longitudinal creep force on the wheel")
    axes.set(
        xlim=(ends[0] - 0.1, ends[1] + 0.1), ylim=(-2.8, 2.4), xlabel="running to the right; y and yaw positive to the right"
    )
    axes.set(xticks=[], yticks=[])
    axes.grid(False)
    axes.spines[:].set_visible(False)
    legend_above(axes)
    radius, deficiency = abs(float(found.radius)), 1e3 * float(found.cant_deficiency)
    axes.set_title(
        f"R {radius:g} m, {float(found.speed) * KMH:.0f} km/h, cant deficiency {deficiency:.0f} mm, Tγ {float(found.wear_number):.0f} N",
        loc="right",
        fontsize=9.0,
        pad=22,
    )
    return axes.figure


def _places(found: Any) -> list[float]:
    """Where the wheelsets are drawn along the track: bogies moved together."""
    positions = np.asarray(found.positions) if found.positions else -np.arange(len(found.wheelset_y), dtype=float)
    gaps = -np.diff(positions)
    steps = np.where(gaps > 2.0 * np.min(gaps, initial=np.inf), BOGIES, AXLES)
    places = np.concatenate([[0.0], -np.cumsum(steps)])
    return (places - np.mean(places)).tolist()


def _wheelset(axes: Any, x: float, up: float, angle: float) -> None:
    from matplotlib.patches import Polygon

    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    parts = [_box(0.0, 0.05, 1.0), *(_box(side, 0.5 * WHEEL, 0.08) for side in (1.0, -1.0))]
    for part in parts:
        axes.add_patch(Polygon(part @ turn.T + np.array([x, up]), closed=True, facecolor="0.75", edgecolor="0.1", zorder=2))


def _box(middle: float, half_length: float, half_width: float) -> Any:
    return np.array([(a * half_length, middle + b * half_width) for a, b in ((1, 1), (-1, 1), (-1, -1), (1, -1))])


def over_lanes(found: Any, axes: Any = None) -> Any:
    """Displacement, guiding force and wear over what varies among the lanes, into three axes or a figure of its own, which is returned."""
    if axes is None:
        import matplotlib as mpl
        from matplotlib.figure import Figure

        with mpl.rc_context(STYLE):
            page = Figure(figsize=(7.2, 8.0), layout="constrained")
            return over_lanes(found, page.subplots(3, 1, sharex=True))
    label, along = _varying(found)
    order = np.argsort(along)

    def line(at: int, values: Any, name: str, factor: float) -> None:
        axes[at].plot(along[order], factor * np.asarray(values)[order], label=name)

    for k in range(len(found.wheelset_y)):
        line(0, found.wheelset_y[k], f"wheelset {k + 1}", 1e3)
        outer = np.where(np.asarray(found.radius) < 0.0, 1, 0)
        line(1, np.where(outer == 0, found.guiding_force[k, 0], -found.guiding_force[k, 1]), f"wheelset {k + 1}", 1e-3)
    line(2, found.wear_number, "all wheels", 1.0)
    for place, name in zip(
        axes, ("lateral displacement, mm", "guiding force of the outer wheel, kN", "wear number Tγ, N"), strict=True
    ):
        place.set_ylabel(name)
    axes[2].set_xlabel(label)
    legend_above(axes[0])
    return axes[0].figure


def _varying(found: Any) -> tuple[str, Any]:
    """What the lanes are drawn over: the first that they differ in."""
    lanes = found.code.shape
    for name, values, factor in (
        ("radius, m", found.radius, 1.0),
        ("cant deficiency, mm", found.cant_deficiency, 1e3),
        ("cant, mm", found.cant, 1e3),
    ):
        values = np.broadcast_to(np.asarray(values, float), lanes)
        if np.ptp(values[np.isfinite(values)]) > 0.0:
            return name, factor * values
    return "lane", np.arange(lanes[0], dtype=float)
