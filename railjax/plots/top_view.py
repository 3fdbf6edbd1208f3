"""A vehicle and its track drawn from above, displacements magnified: what animations and pictures of mode shapes show."""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from ..base.style import COLOURS
from ..model.kinematics import layout
from ..model.vehicle import Vehicle

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

#: m; what a vehicle file does not give and no motion depends on: overhang beyond the outer wheelsets, half the car body's width,
#: half the wheel's width, half the rail head's, sleepers
OVERHANG, HALF_BODY, HALF_WHEEL, HALF_RAIL, HALF_SLEEPER, SLEEPERS = 2.6, 1.4, 0.07, 0.035, 1.25, 1.2
#: m; half of what is shown at least, which the drawing's height suits
LONG = 4.2
#: how far, in m of the drawing, the largest displacement is to be seen
SEEN = 0.5

#: lateral alignment (m) at distances (m) ahead of the car body's centre
Alignment = Callable[[Float[np.ndarray, "points"]], Float[np.ndarray, "points"]]
Coordinates = Mapping[str, Float[np.ndarray, "..."]]


def seen_coordinates(vehicle: Vehicle) -> list[str]:
    """The groups of coordinates that can be seen from above: lateral displacement and yaw of every body that is not held."""
    return [name for name in layout(vehicle) if not name.endswith("_phi")]


def magnification(largest: float) -> float:
    """1, 2 or 5 times a power of ten by which a displacement of `largest` m is drawn up to 0.5 m; 1 where nothing moves."""
    if not largest > 0.0:
        return 1.0
    exponent, power = SEEN / largest, 10.0 ** np.floor(np.log10(SEEN / largest))
    return float(power * max(digit for digit in (1.0, 2.0, 5.0) if digit * power <= exponent * (1.0 + 1e-9)))


class TopView:
    """The drawing, made once; `show` moves it.

    x runs along the track, positive ahead of the car body's centre (the vehicle runs to the right), y to the left of it. Displacements and yaw angles are drawn
    `magnified` times, so a point (x, y) of a body lies at (x - M psi y, y + M (u + psi x)). Held bodies are dashed; dotted lines
    beside the rails show how far the wheels' centre lines can go until the flange touches.
    """

    def __init__(self, axes: "Axes", vehicle: Vehicle, magnified: float) -> None:
        geometry = vehicle.geometry
        self.axes, self.vehicle, self.magnified = axes, vehicle, magnified
        self.bogies = np.asarray(geometry.bogie_pattern) * float(geometry.half_pivot_distance)
        self.axles = np.asarray(geometry.axle_pattern) * float(geometry.half_wheelbase)
        outer = float(np.max(np.abs(self.bogies)) + np.max(np.abs(self.axles)))
        body = outer + OVERHANG
        # whole vehicles are too long to be drawn as long as they are
        self.compact = vehicle.carbody.held and outer < LONG
        self.reach = max(outer + 1.3, LONG) if vehicle.carbody.held else body + 0.3
        self.along = np.linspace(-self.reach - 1.0, self.reach + 1.0, 241)
        gauge, width = float(geometry.half_gauge), max(float(geometry.half_primary), float(geometry.half_gauge) + 0.25)
        self._sleepers = axes.vlines([], -HALF_SLEEPER, HALF_SLEEPER, color="0.88", linewidth=4.0, zorder=0)
        self._rails = []
        for offset, style in ((HALF_RAIL, "-"), (float(magnified * vehicle.contact.flange_clearance), ":")):
            for side in (1.0, -1.0):
                for inner in (-offset, offset) if style == "-" else (offset * side,):
                    line = axes.plot([], [], style, color="0.45", linewidth=0.9, zorder=1)[0]
                    self._rails.append((line, side * gauge + inner))
        self.trail = axes.plot([], [], color=COLOURS[1], linewidth=1.2, alpha=0.7, zorder=1.5)[0]
        self._bodies: list[tuple[Artist, np.ndarray, str, int, float]] = []
        if not vehicle.carbody.held:
            self._body("carbody", 0, 0.0, _box(0.0, 0.0, body, HALF_BODY), COLOURS[0], 4, alpha=0.18)
        for k, position in enumerate(self.bogies):
            frame = _frame(0.55 + np.max(np.abs(self.axles)), width)
            self._body("bogie", k, position, frame, COLOURS[2], 3, alpha=0.55, held=vehicle.bogie.held)
            for i, axle in enumerate(self.axles):
                number, place = k * len(self.axles) + i, position + axle
                half = float(vehicle.wheelset.wheel_radius)
                parts = [_box(0.0, side * gauge, half, HALF_WHEEL) for side in (1.0, -1.0)]
                for shape in (_box(0.0, 0.0, 0.06, gauge + 0.2), *parts):
                    self._body("wheelset", number, place, shape, "0.1", 2)
        axes.set(xlim=(-self.reach - 0.5, self.reach + 0.5), ylim=(-2.3, 2.3))
        axes.set_aspect("equal" if self.compact else "auto")
        axes.set_axis_off()

    def _body(
        self,
        part: str,
        number: int,
        position: float,
        shape: Float[np.ndarray, "corners 2"],
        colour: str,
        order: int,
        alpha: float = 1.0,
        held: bool = False,
    ) -> None:
        from matplotlib.colors import to_rgba
        from matplotlib.patches import Polygon

        look = {"facecolor": to_rgba(colour, alpha), "edgecolor": colour, "linewidth": 1.0}
        look = {"facecolor": "none", "edgecolor": "0.5", "linestyle": "--", "linewidth": 0.9} if held else look
        artist = self.axes.add_patch(Polygon(shape + np.array([position, 0.0]), closed=True, zorder=order, **look))
        if not held:
            self._bodies.append((artist, shape, part, number, position))

    def show(self, coordinates: Coordinates, distance: float = 0.0, track: Alignment | None = None) -> None:
        """Move everything: `coordinates` by group as `kinematics.layout` names them (m, rad; missing ones are at rest), the
        `distance` run (m), the track's alignment about the vehicle (None: even track)."""
        aligned = self.magnified * (np.zeros_like(self.along) if track is None else np.asarray(track(self.along)))
        for line, offset in self._rails:
            line.set_data(self.along, aligned + offset)
        first = -self.reach - 1.0 + (-(distance % SLEEPERS)) % SLEEPERS
        places = np.arange(first, self.reach + 1.0, SLEEPERS)
        middles = np.interp(places, self.along, aligned)
        self._sleepers.set_segments(
            [[(x, y - HALF_SLEEPER), (x, y + HALF_SLEEPER)] for x, y in zip(places, middles, strict=True)]
        )
        for artist, shape, part, number, position in self._bodies:
            y, psi = (
                self.magnified * float(np.ravel(coordinates.get(f"{part}_{name}", np.zeros(number + 1)))[number])
                for name in ("y", "psi")
            )
            moved = [shape[:, 0] - psi * shape[:, 1] + position, shape[:, 1] + y + psi * shape[:, 0]]
            artist.set_xy(np.column_stack(moved))

    def leave_trail(self, along: Float[np.ndarray, "points"], lateral: Float[np.ndarray, "points"]) -> None:
        """The way (m, magnified like everything) that a point has taken, at distances ahead of the car body's centre."""
        self.trail.set_data(along, self.magnified * lateral)

    def scale_bar(self, length: float) -> None:
        """A bar of `length` m of displacement, at the right, and what it stands for."""
        x, middle = self.reach + 0.3, 0.5 * self.magnified * length
        self.axes.plot([x, x], [-middle, middle], color="0.1", linewidth=2.0, solid_capstyle="butt", clip_on=False, zorder=5)
        text = f"{1e3 * length:g} mm" if length >= 1e-3 else f"{1e6 * length:g} µm"
        self.axes.annotate(text, (x, 0.0), (4, 0), textcoords="offset points", va="center", fontsize=8.5, annotation_clip=False)


def _box(x: float, y: float, length: float, width: float) -> Float[np.ndarray, "corners 2"]:
    """A rectangle of half length and half width about (x, y)."""
    return np.array([(x + a * length, y + b * width) for a, b in ((1, 1), (-1, 1), (-1, -1), (1, -1))])


def _frame(length: float, width: float, beam: float = 0.12) -> Float[np.ndarray, "corners 2"]:
    """A bogie frame, an H of half length and half width: two longitudinal beams and a cross beam."""
    outer, inner = width + beam, width - beam
    quarter = [(length, outer), (length, inner), (2.0 * beam, inner), (2.0 * beam, -inner), (length, -inner), (length, -outer)]
    return np.array(quarter + [(-x, -y) for x, y in quarter])
