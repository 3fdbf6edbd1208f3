"""The layout of a line: curvature and cant over the distance, and the `Curve` that a vehicle sees of it at an instant."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ...base.arguments import ARGUMENTS, guarded
from ...base.checks import Kind, OneOf
from ...base.errors import InputError
from ...base.fields import matrix, structure, table
from ...base.pytrees import registered_by_name
from ...base.typing import Number, Scalar
from ..kinematics import bogie_positions, heights, wheelset_positions
from ..vehicle import Vehicle
from .curve import CANT_BASE, GRAVITY, Curve
from .layout_files import read_layout
from .segments import A_CANT, A_LENGTH, Line, Segment, a_radius, of_samples, of_segments
from .shapes import Alignment, Distances, Track, a_track

#: share of the line's fastest change of curvature (cant) below which a stretch is no transition
LEAST_CHANGE = 0.02

A_RAMP = OneOf(("linear", "smooth"))


@dataclass(frozen=True, init=False)
class Layout:
    """The layout of a line: straight track, transitions and arcs, with an irregularity upon it if one is given.

    A track like any other: `simulate(vehicle, speed, track=Layout(...))`; the car body's centre starts at the distance 0. Curvature is
    positive to the right. Corners of linear ramps are rounded over 4 m, as rails round them, for a ramp's corner is a blow to whatever has
    height above the rail. Before its start and beyond its end the line goes on as it is there.

    Args:
        segments: `Segment`s in their order.
        ramp: "linear" (clothoids), or "smooth" (3 u² - 2 u³, Bloss), of curvature and cant in all transitions.
        start: distance at which the first segment begins, m.
        irregularity: a track whose alignment is met upon the layout; by default none.

    Raises:
        InputError: for what is no segment, two transitions in a row, and lengths, radii and cants that cannot be. Jumps of curvature and cants
            above 200 mm are warned of.
    """

    knots: Number = table("m", "s_k", "distances at which the pieces begin", signed=True)
    curvature: Number = matrix("1/m", "kappa", "curvature, powers of the distance from the knot on")
    cant_angle: Number = matrix("rad", "theta", "cant angle, powers of the distance from the knot on")
    heading: Number = table("rad", "", "integral of the curvature up to each knot", signed=True)
    aside: Number = table("m", "", "integral of the heading up to each knot", signed=True)
    irregularity: Track | None = field(default=None)
    label: str = structure("")

    def __init__(
        self, segments: Sequence[Segment], *, ramp: str = "linear", start: float = 0.0, irregularity: Track | None = None
    ) -> None:
        A_RAMP("ramp", ramp)
        if not isinstance(segments, Sequence) or not segments or not all(isinstance(one, Segment) for one in segments):
            raise InputError("segments must be a list of railjax.Segment.straight, .transition and .arc")
        length = sum(one.length for one in segments)
        self._set(of_segments(segments, ramp, start, CANT_BASE), irregularity, f"{len(segments)} segments, {length:g} m")

    def _set(self, line: Line, irregularity: Track | None, label: str) -> None:
        steps = np.diff(line.knots)
        powers = np.cumprod(np.broadcast_to(steps[:, None], (len(steps), 5)), axis=1)
        order = np.arange(4)
        of_pieces = line.curvature[:-1]
        turned = np.concatenate([[0.0], np.cumsum(np.sum(of_pieces * powers[:, :4] / (order + 1.0), axis=1))])
        gained = np.sum(of_pieces * powers[:, 1:5] / ((order + 1.0) * (order + 2.0)), axis=1)
        aside = np.concatenate([[0.0], np.cumsum(gained + turned[:-1] * steps)])
        values = (line.knots, line.curvature, line.cant, turned, aside, irregularity, label)
        for name, value in zip(self.__dataclass_fields__, values, strict=True):
            object.__setattr__(self, name, value)

    @classmethod
    @guarded(radius=a_radius, cant=A_CANT, transition=A_LENGTH, arc=A_LENGTH, lead=A_LENGTH, ramp=A_RAMP)
    def curve(
        cls,
        radius: float,
        *,
        cant: float = 0.0,
        transition: float = 100.0,
        arc: float = 300.0,
        lead: float = 50.0,
        ramp: str = "linear",
    ) -> "Layout":
        """Straight track, a transition, an arc, a transition back and straight track.

        Args:
            radius: R, m, positive to the right.
            cant: of the outer rail, m.
            transition: length of each transition, m.
            arc: length of the arc, m.
            lead: length of the straight track in front, m.
            ramp: "linear" or "smooth".
        """
        turn = Segment.transition(transition)
        return cls([Segment.straight(lead), turn, Segment.arc(arc, radius, cant), turn, Segment.straight(lead)], ramp=ramp)

    @classmethod
    @guarded(distance=None, curvature=None, cant=None)
    def from_samples(
        cls, distance: ArrayLike | Sequence, curvature: ArrayLike | Sequence, cant: ArrayLike | Sequence | None = None
    ) -> "Layout":
        """The layout through samples, by cubics without overshoot.

        Args:
            distance: shape `(samples,)`, m, rising.
            curvature: kappa = 1/R with R in m, shape `(samples,)`, positive to the right.
            cant: shape `(samples,)`, m over 1.5 m, positive where the left rail is higher; by default none.

        Raises:
            InputError: for samples that are not numbers, that do not rise or have gaps.
        """
        try:
            given = [
                np.asarray(one, float) for one in (distance, curvature, np.zeros(np.shape(distance)) if cant is None else cant)
            ]
        except (TypeError, ValueError):
            raise InputError("layout: distance, curvature and cant must be numbers") from None
        if (
            given[0].ndim != 1
            or len(given[0]) < 4
            or any(one.shape != given[0].shape or not np.all(np.isfinite(one)) for one in given)
        ):
            raise InputError("layout: distance, curvature and cant must be at least 4 finite numbers each, and as many")
        steps = np.diff(given[0])
        if not np.all(steps > 0.0):
            raise InputError("layout: distance must rise from sample to sample")
        if np.max(steps) > 20.0 * np.median(steps):
            k = int(np.argmax(steps))
            raise InputError(
                f"layout: a gap of {steps[k]:g} m after {given[0][k]:g} m; give it samples, or lay the line in parts"
            )
        made = object.__new__(cls)
        made._set(of_samples(given[0], given[1], given[2] / CANT_BASE), None, f"{len(steps) + 1} samples")
        return made

    @classmethod
    @guarded(path=None, columns=None, units=None)
    def load(
        cls, path: str | Path, *, columns: Mapping[str, str] | None = None, units: Mapping[str, str] | None = None
    ) -> "Layout":
        """A layout from a TOML file of segments or a file of samples (distance; curvature or radius; cant).

        Args:
            path: the file; .toml for segments.
            columns: name, or number from 1, of the column of "distance", "curvature", "radius" and "cant"; else looked up in the header.
            units: unit of each; else looked up in the header.

        Raises:
            InputError: for a file that cannot be read, unknown or missing keys, and what `Layout` refuses.
        """
        try:
            said = read_layout(Path(path), columns or {}, units or {})
            if said.segments is None:
                return cls.from_samples(*said.samples)
            return cls(said.segments, ramp=said.ramp, start=said.start)
        except InputError as error:
            named = str(error).startswith(str(path))
            raise InputError(str(error) if named else f"{path}: {error}") from None

    @guarded(irregularity=a_track)
    def with_irregularity(self, irregularity: Track | None = None) -> "Layout":
        """The same line with the alignment of a track upon it."""
        made = object.__new__(Layout)
        for name in self.__dataclass_fields__:
            object.__setattr__(made, name, irregularity if name == "irregularity" else getattr(self, name))
        return made

    def __str__(self) -> str:
        curvature, cant = np.asarray(self.curvature)[:, 0], np.asarray(self.cant_angle)[:, 0] * CANT_BASE
        sharpest = np.max(np.abs(curvature))
        least = f"least radius {1.0 / sharpest:.0f} m" if sharpest > 0.0 else "straight"
        return f"Layout of {self.label or 'a line'}: {least}, cant up to {1e3 * np.max(np.abs(cant)):.0f} mm"

    def seen_from(self, offset: Distances) -> Alignment:
        """eta(start + offset), m, of the irregularity; 0 without one."""
        if self.irregularity is not None:
            return self.irregularity.seen_from(offset)
        return lambda start: jnp.zeros(jnp.broadcast_shapes(offset.shape, jnp.shape(start)), offset.dtype)

    @guarded()
    def at(self, distance: ArrayLike) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
        """Curvature kappa (1/m) and cant angle theta (rad) at any `distance` (m)."""
        found = self._at(jnp.asarray(distance, float))
        return found["kappa"], found["theta"]

    def transitions(self) -> tuple[tuple[float, float], ...]:
        """From and to the distances (m) of each stretch over which curvature or cant change by more than a fiftieth of the line's fastest
        changes, whose corners' rounding counts."""
        steps = np.diff(np.asarray(self.knots))
        turning = np.zeros(len(steps), bool)
        for powers in (self.curvature, self.cant_angle):
            ends = np.asarray(powers)[:-1, 1:] * np.array([1.0, 2.0, 3.0])
            x = np.stack([0.0 * steps, 0.5 * steps, steps], axis=1)
            fastest = np.max(np.abs(ends[:, :1] + ends[:, 1:2] * x + ends[:, 2:] * x**2), axis=1)
            turning |= fastest > LEAST_CHANGE * np.max(fastest, initial=1e-12)
        edges = np.flatnonzero(np.diff(np.concatenate([[False], turning, [False]])))
        knots = np.asarray(self.knots)
        return tuple((float(knots[first]), float(knots[last])) for first, last in edges.reshape(-1, 2))

    def _at(self, distance: Distances) -> dict[str, Distances]:
        """All that is needed of the line at some places."""
        knots = jnp.asarray(self.knots)
        piece = jnp.clip(jnp.searchsorted(knots, distance, side="right") - 1, 0, knots.shape[0] - 1)
        rows = jnp.concatenate(
            [
                jnp.asarray(self.curvature),
                jnp.asarray(self.cant_angle),
                knots[:, None],
                self.heading[:, None],
                self.aside[:, None],
            ],
            axis=1,
        )
        k0, k1, k2, k3, t0, t1, t2, t3, knot, heading, aside = jnp.moveaxis(rows[piece], -1, 0)
        x = distance - knot
        return {
            "kappa": k0 + x * (k1 + x * (k2 + x * k3)),
            "kappa_rate": k1 + x * (2.0 * k2 + x * 3.0 * k3),
            "heading": heading + x * (k0 + x * (k1 / 2.0 + x * (k2 / 3.0 + x * k3 / 4.0))),
            "aside": aside + x * (heading + x * (k0 / 2.0 + x * (k1 / 6.0 + x * (k2 / 12.0 + x * k3 / 20.0)))),
            "theta": t0 + x * (t1 + x * (t2 + x * t3)),
            "theta_rate": t1 + x * (2.0 * t2 + x * 3.0 * t3),
            "theta_curve": 2.0 * t2 + 6.0 * x * t3,
        }

    def _cross_levels(self, vehicle: Vehicle, centre: Distances, like: Distances) -> dict[str, tuple[Distances, ...]] | None:
        """What the irregularity's cross level adds to the cant angle of each body's frame (rad), and to its derivatives by the distance: of a
        wheelset at its own place, of what rests on several of them their mean; None without one."""
        cross = getattr(self.irregularity, "cross", None)
        if cross is None:
            return None
        level = cross.seen_from(jnp.broadcast_to(wheelset_positions(vehicle, like), like.shape))

        def along(function: Alignment) -> Alignment:
            return lambda s: jax.jvp(function, (s,), (jnp.ones_like(s),))[1]

        orders = [order(centre) / CANT_BASE for order in (level, along(level), along(along(level)))]
        return {
            "wheelset": tuple(orders),
            "bogie": tuple(jnp.mean(angle, axis=1) for angle in orders),
            "carbody": tuple(jnp.mean(angle, axis=(0, 1)) for angle in orders),
        }

    def curve_at(
        self, vehicle: Vehicle, centre: Scalar, speed: Scalar, acceleration: Scalar, like: Float[Array, "n m *lanes"]
    ) -> Curve:
        """What the line does to a vehicle whose car body's centre is at the distance `centre`.

        A body at the distance x ahead of it sees the line turned by the integral of kappa and aside by that of the turn. Seen from the rails a body
        at the height H moves with H theta; a ramp rolls the frames against each other. The cross level of a measured irregularity adds to
        the cant: each body's frame rolls with the mean of the rails under its wheelsets.

        Args:
            vehicle: gives the places and heights of its bodies.
            centre: m.
            speed: v, m/s.
            acceleration: v', m/s².
            like: an array with an entry per wheelset, and lanes, dimensionless; its values do not matter.

        Returns:
            The curve, with the shapes of `like`; `centre` and `speed` are numbers, or have its lanes.
        """
        lanes = like.shape[2:]
        centre = jnp.broadcast_to(jnp.asarray(centre, like.dtype), lanes)
        here, height = self._at(centre), heights(vehicle)
        rolled = self._cross_levels(vehicle, centre, like)
        place: dict[str, Any] = {}
        rate: dict[str, Any] = {}
        forced: dict[str, Any] = {}
        for body, x in (
            ("carbody", jnp.zeros(lanes, like.dtype)),
            ("bogie", jnp.broadcast_to(bogie_positions(vehicle, like), (like.shape[0], *lanes))),
            ("wheelset", jnp.broadcast_to(wheelset_positions(vehicle, like), like.shape)),
        ):
            there, h = self._at(centre + x), height[body]
            if rolled is not None:
                for name, more in zip(("theta", "theta_rate", "theta_curve"), rolled[body], strict=True):
                    there[name] = there[name] + more
                here = there if body == "carbody" else here
            turn = there["heading"] - here["heading"]
            roll, rolling = there["theta"] - here["theta"], speed * (there["theta_rate"] - here["theta_rate"])
            place[f"{body}_y"] = there["aside"] - here["aside"] - x * here["heading"] + h * roll
            rate[f"{body}_y"] = speed * (turn - x * here["kappa"]) + h * rolling
            place[f"{body}_psi"], rate[f"{body}_psi"] = turn, speed * (there["kappa"] - here["kappa"])
            # phi > 0 lifts the right side, theta lowers it
            place[f"{body}_phi"], rate[f"{body}_phi"] = -roll, -rolling
            twisting = speed**2 * there["theta_curve"] + acceleration * there["theta_rate"]
            forced[f"{body}_y"] = speed**2 * there["kappa"] - GRAVITY * there["theta"] + h * twisting
            forced[f"{body}_psi"] = speed**2 * there["kappa_rate"] + acceleration * there["kappa"]
            forced[f"{body}_phi"] = -twisting
            curvature = there["kappa"]
        return Curve(curvature, place, forced, rate)


_LEAVES = [name for name in Layout.__dataclass_fields__ if name != "label"]


def _rebuilt(values: dict[str, Any]) -> Layout:
    layout = object.__new__(Layout)
    for name, value in (values | {"label": ""}).items():
        object.__setattr__(layout, name, value)
    return layout


# the constructor, which makes the pieces, is not called where JAX rebuilds the tree; the label is for printing and lost there
registered_by_name(Layout, _LEAVES, (), _rebuilt)

ARGUMENTS["layout"] = Kind(Layout, "a railjax.Layout")
