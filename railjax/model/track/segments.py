"""Segments of a line (straight, transition, arc) and samples along it as pieces of cubics, on the host: what a `Layout` is made of."""

import itertools
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from ...base.arguments import guarded
from ...base.checks import Range, positive
from ...base.errors import InputError

#: m; cant that no line has
LARGEST_CANT = 0.2
#: m; half the length over which corners of linear ramps, and jumps where a transition is missing, are rounded, as rails round them
ROUNDING = 2.0

A_LENGTH = positive("m")
A_CANT = Range("m", -2.0 * LARGEST_CANT, 2.0 * LARGEST_CANT, why="; is it in millimetres?")


def a_radius(key: str, value: Any) -> None:
    """A radius of 1 m at least, to either side."""
    Range("m", why=", positive to the right")(key, value)
    if abs(value) < 1.0:
        raise InputError(f"{key} must be a radius in m, positive to the right, not {value:g}")


Pieces = Float[np.ndarray, "pieces 4"]


@dataclass(frozen=True)
class Segment:
    """A part of a line's layout, made by `straight`, `transition` or `arc`.

    A transition leads from the curvature and cant of the segment before to those of the next, straight track at the line's ends.
    """

    kind: str
    length: float  # m
    radius: float = np.inf  # m, positive to the right
    cant: float = 0.0  # m over 1.5 m, of the outer rail

    @classmethod
    @guarded(length=A_LENGTH)
    def straight(cls, length: float) -> "Segment":
        """Straight track without cant, of `length` (m)."""
        return cls("straight", float(length))

    @classmethod
    @guarded(length=A_LENGTH)
    def transition(cls, length: float) -> "Segment":
        """A clothoid with a ramp of cant, of `length` (m)."""
        return cls("transition", float(length))

    @classmethod
    @guarded(length=A_LENGTH, radius=a_radius, cant=A_CANT)
    def arc(cls, length: float, radius: float, cant: float = 0.0) -> "Segment":
        """An arc.

        Args:
            length: m.
            radius: R, m, positive to the right, negative to the left.
            cant: of the outer rail over a base of 1.5 m, m.
        """
        return cls("arc", float(length), float(radius), float(cant))


class Line(NamedTuple):
    """Curvature kappa (1/m) and cant angle theta (rad) over the distance: cubics from each knot (m) to the next; constant beyond the ends."""

    knots: Float[np.ndarray, "pieces"]
    curvature: Pieces  # powers of s - s_k from 0 on
    cant: Pieces
    notes: tuple[str, ...]


class _Step(NamedTuple):
    """A change of both from `begin` on over `length`."""

    begin: float
    length: float
    change: Float[np.ndarray, "2"]


def of_segments(segments: Sequence[Segment], ramp: str, start: float, base: float) -> Line:
    """The line of segments from the distance `start` on (m), its ramps "linear", with rounded corners, or "smooth" (3 u² - 2 u³, Bloss).

    Args:
        segments: in their order.
        ramp: of transitions.
        start: m.
        base: of the cant, m.
    """
    notes, steps = [], []
    first = np.zeros(2) if segments[0].kind == "transition" else _values(segments[0], base)
    begin, now = start, first
    for k, (segment, after) in enumerate(itertools.pairwise([*segments, Segment.straight(1.0)])):
        if segment.kind == "transition":
            if after.kind == "transition":
                raise InputError(
                    f"layout: segments {k + 1} and {k + 2} are both transitions; put an arc or straight track between them"
                )
            steps.append(_Step(begin, segment.length, (goal := _values(after, base)) - now))
        else:
            goal = _values(segment, base)
            if np.any(goal != now):
                notes.append(
                    f"segment {k + 1}: curvature or cant jumps at {begin:g} m without a transition; rounded over {2 * ROUNDING:g} m"
                )
                steps.append(_Step(begin - 0.5 * ROUNDING, ROUNDING, goal - now))
            if abs(segment.cant) > LARGEST_CANT:
                notes.append(
                    f"segment {k + 1}: cant of {1e3 * segment.cant:.0f} mm, where lines have up to {1e3 * LARGEST_CANT:.0f}"
                )
        begin, now = begin + segment.length, goal
    for note in notes:
        warnings.warn(f"layout: {note}", RuntimeWarning, stacklevel=4)
    knots = {start - 1.0, begin}
    for step in steps:
        corner = _corner(step, ramp)
        knots |= {step.begin + side * corner for side in (-1, 0, 1)} | {
            step.begin + step.length + side * corner for side in (-1, 0, 1)
        }
    at = np.array(sorted(knots))
    at = at[np.concatenate([[True], np.diff(at) > 1e-9])]
    coefficients = np.zeros((2, len(at), 4))
    coefficients[:, :, 0] = first[:, None]
    middle = np.append(0.5 * (at[1:] + at[:-1]), at[-1] + 1.0)
    for step in steps:
        coefficients += step.change[:, None, None] * _at_knots(_share(step, ramp, middle), at - middle)
    return Line(at, coefficients[0], coefficients[1], tuple(notes))


def _values(segment: Segment, base: float) -> Float[np.ndarray, "2"]:
    """kappa and theta."""
    return (
        np.array([1.0 / segment.radius, np.sign(segment.radius) * segment.cant / base]) if segment.kind == "arc" else np.zeros(2)
    )


def _corner(step: _Step, ramp: str) -> float:
    return 0.0 if ramp == "smooth" else min(ROUNDING, 0.5 * step.length)


def _share(step: _Step, ramp: str, s: Float[np.ndarray, "pieces"]) -> Pieces:
    """How far the change has come at s, with three derivatives."""
    if ramp == "smooth":
        u = np.clip((s - step.begin) / step.length, 0.0, 1.0)
        on = ((u > 0.0) & (u < 1.0)).astype(float)
        slopes = 6.0 * u * (1.0 - u), on * (6.0 - 12.0 * u), on * -12.0
        return np.column_stack([u**2 * (3.0 - 2.0 * u), *(d / step.length ** (k + 1) for k, d in enumerate(slopes))])
    r = _corner(step, ramp)
    found = np.zeros((len(s), 4))
    for corner, sign in ((step.begin, 1.0), (step.begin + step.length, -1.0)):
        x = s - corner
        inside = np.abs(x) < r
        value = np.where(inside, (x + r) ** 2 / (4.0 * r), np.maximum(x, 0.0))
        slope = np.where(inside, (x + r) / (2.0 * r), (x > 0.0).astype(float))
        found[:, :3] += sign / step.length * np.column_stack([value, slope, inside / (2.0 * r)])
    return found


def _at_knots(derivatives: Pieces, shift: Float[np.ndarray, "pieces"]) -> Pieces:
    """Powers from the knots on, of cubics whose derivatives are known elsewhere, `shift` away."""
    f, d1, d2, d3 = derivatives.T
    h = shift
    moved = [f + h * (d1 + h * (d2 / 2.0 + h * d3 / 6.0)), d1 + h * (d2 + h * d3 / 2.0), 0.5 * (d2 + h * d3), d3 / 6.0]
    return np.column_stack(moved)


def of_samples(
    distance: Float[np.ndarray, "samples"], curvature: Float[np.ndarray, "samples"], angle: Float[np.ndarray, "samples"]
) -> Line:
    """The line through samples, by cubics without overshoot (Fritsch and Carlson).

    Args:
        distance: m, rising.
        curvature: kappa, 1/m.
        angle: theta, rad.
    """
    from scipy.interpolate import PchipInterpolator

    pieces = []
    for values in (curvature, angle):
        rows = PchipInterpolator(distance, values).c[::-1].T
        ends = np.zeros((2, 4))
        ends[:, 0] = values[[0, -1]]
        pieces.append(np.concatenate([ends[:1], rows, ends[1:]]))
    knots = np.concatenate([[distance[0] - 1.0], distance])
    return Line(knots, pieces[0], pieces[1], ())
