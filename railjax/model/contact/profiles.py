"""Wheel and rail profiles: smooth functions of the lateral position in tables, from the standards, points and files; pytrees in m."""

import dataclasses
import functools
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ...base.arguments import guarded
from ...base.checks import FLAG, OneOf, Range, Samples, a_name, a_path, traced
from ...base.errors import InputError
from ...base.namespace import namespace
from ...base.typing import Number
from . import profile_shapes
from .cubics import cubic_rows
from .profile_files import Read, read_profile
from .profile_points import STEEPEST, Outline, Source, outline

#: m; step of the tables, and of the places along a wheel at which contact is looked for
STEP, SEARCHED = 0.1e-3, 0.15e-3
#: packaged wheels
WHEELS = ("S1002",)
#: m; what is shorter in a file of points is noise
SMOOTHING = 2e-3

_WIDTH = Range("m", 0.0, 0.02, why="; is it in millimetres?")
_ANY_SIDE = OneOf((True, False, None))


def _numbers(key: str, value: Any) -> None:
    """Points: known numbers along one axis."""
    Samples("m")(key, value)
    if traced(value) or np.ndim(value) != 1:
        raise InputError(f"{key} must be one row of known numbers (m); a profile of derivatives is made with changed()")


@dataclass(frozen=True)
class _Profile:
    """What wheels and rails share: height and slope over `lateral`, at equal steps, and cubics between (Hermite)."""

    lateral: Number  # (n,) m, at equal steps
    height: Number  # (n,) m, downwards
    slope: Number  # (n,) dz/dy
    drawn: Number  # (2, k) m: lateral and height along the whole outline, walls and back of the flange included
    name: str = dataclasses.field(default="", metadata={"static": True})
    notes: tuple[str, ...] = dataclasses.field(default=(), metadata={"static": True})

    def __str__(self) -> str:
        low, high = 1e3 * float(self.lateral[0]), 1e3 * float(self.lateral[-1])
        notes = "".join(f"; {note}" for note in self.notes)
        return f"{self.name}: {'wheel' if isinstance(self, WheelProfile) else 'rail'} from {low:.1f} to {high:.1f} mm{notes}"

    def cubics(self, xp: ModuleType) -> Float[Array, "intervals 4"] | Float[np.ndarray, "intervals 4"]:
        """Coefficients of each interval in powers of (y - y_i)/step, from 1 on: a row to fetch."""
        return cubic_rows(xp, self.height, self.slope * (self.lateral[1] - self.lateral[0]))

    @classmethod
    def _of(cls, found: Outline, name: str, **more: Any) -> Any:
        """The part of an outline that is a function of the lateral position, in a table."""
        first, last = cls._running(found, name)
        x, z, slope = (values[first : last + 1] for values in (found.lateral, found.height, found.slope))
        if np.any(np.diff(x) <= 0.0):
            raise InputError(
                f"{name}: goes back at {1e3 * x[int(np.argmax(np.diff(x) <= 0.0))]:.2f} mm on the running surface; smooth it over more than it does"
            )
        count = int((x[-1] - x[0]) / STEP)
        at = x[0] + (x[-1] - x[0]) / count * np.arange(count + 1)
        return cls(at, *_hermite(at, x, z, slope), np.stack([found.lateral, found.height]), name=name, notes=found.notes, **more)

    @staticmethod
    def _running(found: Outline, name: str) -> tuple[int, int]:
        raise NotImplementedError


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class WheelProfile(_Profile):
    """A wheel's profile: `height` (m, the radius less the nominal one, so positive is a larger radius) over `lateral` (m from the tread
    datum, the field side positive, the flange negative), from the tip of the flange to the end of the tread. A pytree; lanes stack.

    `WheelProfile.load("S1002")`, or a file; `WheelProfile.from_points`, `WheelProfile.cone`; `changed` adds control heights.
    """

    searched: Number = dataclasses.field(default=None, kw_only=True)  # m: places of equal distance along the surface

    @classmethod
    @guarded(name_or_path=a_path, smoothing=_WIDTH, mirrored=_ANY_SIDE, columns=None, unit=None)
    def load(
        cls,
        name_or_path: str | Path,
        *,
        smoothing: float | None = None,
        mirrored: bool | None = None,
        columns: Mapping[str, str] | None = None,
        unit: str | None = None,
    ) -> "WheelProfile":
        """A packaged profile (S1002) or a file: SIMPACK's .prw, or lateral position and height in two columns of a table.

        Args:
            name_or_path: "S1002" or a file
            smoothing: m; waves of the points of this length are halved, shorter ones go; None: 2 mm for tables, 0 for .prw and .prr
            mirrored: whether the flange is on the positive side; None: it is looked for, and what is found is in `notes`
            columns: names or numbers of the columns "lateral" and "height" of a table
            unit: of the numbers, if the file does not say it; mm if nobody does

        Raises `InputError` with the line of a fault: no number, a hole, points that cross, a kink that is not smoothed.
        """
        if str(name_or_path).upper() in WHEELS:
            return _s1002()
        read = read_profile(_file(name_or_path, WHEELS), True, columns, unit)
        return cls._of_points(read, _width(read, smoothing), mirrored)

    @classmethod
    @guarded(lateral=_numbers, height=_numbers, smoothing=_WIDTH, mirrored=_ANY_SIDE, name=a_name)
    def from_points(
        cls,
        lateral: ArrayLike | Sequence,
        height: ArrayLike | Sequence,
        *,
        smoothing: float = 0.0,
        mirrored: bool | None = None,
        name: str = "wheel",
    ) -> "WheelProfile":
        """A profile through points, or smooth ones near them.

        Args:
            lateral: m from the tread datum, the field side positive, along the profile in either direction
            height: m; positive is a larger radius, or all the other way round
            smoothing: m; waves of this length are halved; 0: through the points
            mirrored: as in `load`
            name: for messages and figures
        """
        return cls._of_points(_given(lateral, height, name), smoothing, mirrored)

    @classmethod
    @guarded(conicity=Range("1", 0.0, 1.0))
    def cone(cls, conicity: float) -> "WheelProfile":
        """A straight tread of this `conicity` (a number) and no flange: what a vehicle without profiles has."""
        lateral, height = profile_shapes.cone(conicity)
        return cls._made(outline(lateral, height, True, 0.0, Source("cone"), False), f"cone {conicity:g}")

    @guarded(at=_numbers, by=Samples("m"))
    def changed(
        self, at: ArrayLike | Sequence, by: Float[Array, "..."] | Float[np.ndarray, "..."] | list[float]
    ) -> "WheelProfile":
        """The profile with a cubic spline added that has the heights `by` (m, positive is a larger radius) at the positions `at` (m, rising,
        known numbers). It fades to zero over one more step at each end. Differentiable with respect to `by`.
        """
        from scipy.interpolate import CubicSpline

        knots = np.asarray(at, float)
        if knots.size < 2 or np.any(np.diff(knots) <= 0.0):
            raise InputError("at must be at least two positions in rising order (m)")
        if np.shape(by) != knots.shape:
            raise InputError(f"by must have a height for each of the {knots.size} positions, not the shape {np.shape(by)}")
        ends = 2 * knots[0] - knots[1], 2 * knots[-1] - knots[-2]
        unit = np.pad(np.eye(knots.size), ((1, 1), (0, 0)))
        shape = CubicSpline(np.array([ends[0], *knots, ends[1]]), unit, bc_type="clamped")
        where = np.asarray(self.lateral)
        inside = ((where >= ends[0]) & (where <= ends[1]))[:, None]
        heights = namespace(by).asarray(by, float)  # known ones in double precision, whatever JAX's is
        rise, turn = (np.where(inside, shape(where, order), 0.0) @ heights for order in (0, 1))
        return dataclasses.replace(self, height=self.height + rise, slope=self.slope + turn)

    @classmethod
    def _of_points(cls, read: Read, smoothing: float, mirrored: bool | None) -> "WheelProfile":
        found = outline(read.lateral, read.height, True, smoothing, read.source, mirrored)
        return cls._made(found._replace(notes=(*read.notes, *found.notes)), read.source.name)

    @classmethod
    def _made(cls, found: Outline, name: str) -> "WheelProfile":
        made = cls._of(found, name)
        along = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(made.lateral), np.diff(made.height)))])
        even = np.linspace(0.0, along[-1], int(along[-1] / SEARCHED) + 1)
        return dataclasses.replace(made, searched=np.interp(even, along, made.lateral))

    @guarded(depth=Range("m", 0.0, 0.05, why="; is it in millimetres?"))
    def flange_face(self, depth: float) -> float:
        """How far from the tread datum the flange's face is, m towards the back, `depth` (m) below the tread; inf without a flange."""
        deep = np.flatnonzero((np.asarray(self.lateral) < 0.0) & (np.asarray(self.height) >= depth))
        if not deep.size:
            return np.inf
        last = deep[-1]
        return -float(np.interp(depth, self.height[last : last + 2][::-1], self.lateral[last : last + 2][::-1]))

    @staticmethod
    def _running(found: Outline, name: str) -> tuple[int, int]:
        """From the tip of the flange, or where it becomes a wall, to the end of the tread, or where its chamfer does."""
        datum = int(np.argmin(np.abs(found.lateral)))
        if not found.lateral[0] < 0.0 < found.lateral[-1]:
            raise InputError(
                f"{name}: the tread datum (lateral position 0) is not among the points; shift them so that the tread is there"
            )
        tip = int(np.argmax(found.height[: datum + 1]))
        walls = np.flatnonzero((np.abs(found.slope) > STEEPEST) | (np.gradient(found.lateral) <= 0.0))
        before, after = walls[walls < datum], walls[walls > datum]
        return max(tip, int(before[-1]) + 1 if before.size else 0), int(after[0]) - 1 if after.size else len(found.lateral) - 1


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class RailProfile(_Profile):
    """A rail's head, upright: `height` (m, downwards from anywhere) over `lateral` (m, the field side positive, the gauge side negative),
    between the walls of its sides. Where it lies on the track follows from gauge and inclination. A pytree; lanes stack.

    `RailProfile.load("60E1")`, "60E2", "UIC60-Manchester" or a file; `RailProfile.from_points`.
    """

    @classmethod
    @guarded(name_or_path=a_path, smoothing=_WIDTH, mirrored=FLAG, columns=None, unit=None)
    def load(
        cls,
        name_or_path: str | Path,
        *,
        smoothing: float | None = None,
        mirrored: bool = False,
        columns: Mapping[str, str] | None = None,
        unit: str | None = None,
    ) -> "RailProfile":
        """A packaged profile (60E1, 60E2, UIC60-Manchester) or a file: SIMPACK's .prr, or lateral position and height in two columns of a table.

        Args:
            name_or_path: "60E1", "60E2", "UIC60-Manchester" (of the benchmarks) or a file; one measured as it lies in the track is used with an inclination of 0
            smoothing: m; waves of the points of this length are halved, shorter ones go; None: 2 mm for tables, 0 for .prw and .prr
            mirrored: whether the gauge side is the positive one
            columns: names or numbers of the columns "lateral" and "height" of a table
            unit: of the numbers, if the file does not say it; mm if nobody does

        Raises `InputError` with the line of a fault, as `WheelProfile.load` does.
        """
        if str(name_or_path).upper() in profile_shapes.RAIL_HEADS:
            return _rail_head(str(name_or_path).upper())
        read = read_profile(_file(name_or_path, profile_shapes.RAIL_HEADS), False, columns, unit)
        return cls._of_points(read, _width(read, smoothing), mirrored)

    @classmethod
    @guarded(lateral=_numbers, height=_numbers, smoothing=_WIDTH, mirrored=FLAG, name=a_name)
    def from_points(
        cls,
        lateral: ArrayLike | Sequence,
        height: ArrayLike | Sequence,
        *,
        smoothing: float = 0.0,
        mirrored: bool = False,
        name: str = "rail",
    ) -> "RailProfile":
        """A profile through points, or smooth ones near them; its gauge side must reach as far down as gauge is measured, 14 mm.

        Args:
            lateral: m, the field side positive, along the profile in either direction
            height: m, downwards, or all the other way round
            smoothing: m; waves of this length are halved; 0: through the points
            mirrored: as in `load`
            name: for messages and figures
        """
        return cls._of_points(_given(lateral, height, name), smoothing, mirrored)

    @classmethod
    def _of_points(cls, read: Read, smoothing: float, mirrored: bool) -> "RailProfile":
        found = outline(read.lateral, read.height, False, smoothing, read.source, mirrored)
        return cls._of(found._replace(notes=(*read.notes, *found.notes)), read.source.name)

    @staticmethod
    def _running(found: Outline, name: str) -> tuple[int, int]:
        """Between the walls on both sides of the top."""
        top = int(np.argmin(found.height))
        walls = np.flatnonzero((np.abs(found.slope) > STEEPEST) | (np.gradient(found.lateral) <= 0.0))
        before, after = walls[walls < top], walls[walls > top]
        return int(before[-1]) + 1 if before.size else 0, int(after[0]) - 1 if after.size else len(found.lateral) - 1


def _file(name_or_path: str | Path, packaged: Collection[str]) -> Path:
    """The file of a profile; a name that is neither packaged nor a file is refused with those that are."""
    path = Path(name_or_path)
    if not path.suffix and path.name == str(name_or_path) and not path.exists():
        raise InputError(f"no profile {str(name_or_path)!r}: packaged are {', '.join(packaged)}; otherwise give a file of points")
    return path


def _given(lateral: ArrayLike | Sequence, height: ArrayLike | Sequence, name: str) -> Read:
    lateral, height = np.asarray(lateral, float), np.asarray(height, float)
    if lateral.shape != height.shape:
        raise InputError(f"height must have a value for each lateral position: {height.size} and {lateral.size}")
    return Read(lateral, height, Source(name), (), True)


def _width(read: Read, smoothing: float | None) -> float:
    if smoothing is not None:
        return smoothing
    return 0.0 if read.exact else SMOOTHING


def _hermite(
    at: Float[np.ndarray, "n"], x: Float[np.ndarray, "m"], z: Float[np.ndarray, "m"], slope: Float[np.ndarray, "m"]
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    from scipy.interpolate import CubicHermiteSpline

    curve = CubicHermiteSpline(x, z, slope)
    return curve(at), curve(at, 1)


@functools.cache
def _s1002() -> WheelProfile:
    return WheelProfile._made(outline(*profile_shapes.s1002(), True, 0.0, Source("S1002"), False), "S1002")


@functools.cache
def _rail_head(name: str) -> RailProfile:
    return RailProfile._of(outline(*profile_shapes.rail_head(name), False, 0.0, Source(name), False), name)
