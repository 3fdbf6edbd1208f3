"""Points of a profile as they come, put in order: their direction, which side is which, faults with the line that has them, smoothing."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ...base.errors import InputError

Samples = Float[np.ndarray, "..."]

#: m; a profile is some 30 to 140 mm wide, so beyond these it is in another unit
NARROWEST, WIDEST = 0.01, 0.3
#: m between neighbours: more is a hole
HOLE = 8e-3
#: m by which points may go back on the running surface, as noise makes them
BACKWARDS = 0.3e-3
#: radians between neighbouring chords, and the radius (m) of their arc: a sharper corner is a kink
KINK, SHARPEST = np.radians(8.0), 2e-3
#: slope from which a profile is a wall, on which no wheel runs: 80 degrees
STEEPEST = 5.67
#: m; a wheel's flange is higher than this, and a tread is not
FLANGE = 15e-3
#: m along the outline between its samples
SAMPLED = 0.1e-3
FEWEST = 8
#: m; a single point farther off the smooth profile than this, and far more than the others, is a slip
OFF = 0.1e-3


class Outline(NamedTuple):
    """A smooth profile: samples along it, its slope dz/dy at each, and what was done to the points."""

    lateral: Samples
    height: Samples
    slope: Samples
    notes: tuple[str, ...]


class Source(NamedTuple):
    """Where the points are from: a name for messages, and the line of each point if it is a file."""

    name: str
    lines: Int[np.ndarray, "..."] | None = None

    def at(self, index: int | np.integer) -> str:
        """The place of a point, for messages."""
        return f"{self.name}: point {index + 1}" if self.lines is None else f"{self.name}, line {self.lines[index]}"


def outline(
    lateral: Samples, height: Samples, wheel: bool, smoothing: float, source: Source, mirrored: bool | None = None
) -> Outline:
    """Points (m) as a smooth curve, in rising order, a wheel's flange and a rail's gauge side on the negative side, heights downwards.

    Points in falling order and heights upwards are turned round, and so is a wheel whose flange is on the other side (for a rail
    `mirrored` must say it), with a note of it. Raises `InputError` naming the line of a fault: a point that is not finite or goes back, a
    hole, a kink that is not smoothed away; and for what is no profile of that kind.
    """
    notes: list[str] = []
    kind = "wheel" if wheel else "rail"
    if len(lateral) < FEWEST:
        raise InputError(f"{source.name}: {len(lateral)} points are too few for a profile; it takes {FEWEST}")
    for values, what in ((lateral, "lateral position"), (height, "height")):
        if (bad := ~np.isfinite(values)).any():
            raise InputError(f"{source.at(int(np.argmax(bad)))}: the {what} is not a finite number")
    width = np.ptp(lateral)
    if not NARROWEST < width < WIDEST:
        raise InputError(
            f"{source.name}: the points are {1e3 * width:.4g} mm wide, and a {kind} is {1e3 * NARROWEST:.0f} to {1e3 * WIDEST:.0f}; say their unit"
        )
    index = np.arange(len(lateral))
    if lateral[-1] < lateral[0]:
        lateral, height, index = lateral[::-1], height[::-1], index[::-1]
    again = np.concatenate([[True], np.hypot(np.diff(lateral), np.diff(height)) > 1e-9])  # a point written twice
    lateral, height, index = lateral[again], height[again], index[again]
    if (turned := _upwards(lateral, height, wheel)) is not None:
        height = turned
        notes.append("heights taken as positive upwards")
    mirror = bool(mirrored)
    if wheel and mirrored is None and (mirror := _flange_on_the_right(lateral, height)):
        notes.append("mirrored: the flange was on the positive side")
    if mirror:
        lateral, height, index = -lateral[::-1], height[::-1], index[::-1]
    _refuse(lateral, height, index, smoothing, source)
    if wheel and _flange_on_the_right(lateral, height):
        raise InputError(f"{source.name}: the flange is on the field side (positive); turn it round with mirrored")
    if wheel and height[-1] - np.median(height) > FLANGE / 2:
        raise InputError(f"{source.name}: goes down on both sides, as a rail's head does: is it a wheel?")
    if not wheel and height[-1] < np.median(height) - 1e-3 and int(np.argmin(height)) > len(height) - 3:
        raise InputError(f"{source.name}: is highest at its end, as a wheel's tread may be: is it a rail?")
    if not wheel and height[0] - height.min() < FLANGE / 3 and height[-1] - height.min() > FLANGE:
        raise InputError(
            f"{source.name}: the gauge side (negative) ends {1e3 * (height[0] - height.min()):.3g} mm below the top, only the field side goes down; "
            "turn it round with mirrored"
        )
    found, off = _curve(lateral, height, smoothing)
    if (far := off > max(OFF, 6.0 * np.sqrt(np.mean(off**2)))).any():
        at = int(np.argmax(np.where(far, off, 0.0)))
        raise InputError(
            f"{source.at(index[at])}: lies {1e3 * off[at]:.2g} mm off the smooth profile; take the point out, or smooth less"
        )
    if smoothing:
        notes.append(f"smoothed over {1e3 * smoothing:g} mm")
    return Outline(*found, tuple(notes))


def _upwards(lateral: Samples, height: Samples, wheel: bool) -> Samples | None:
    """The heights turned round, where they are positive upwards: a wheel's flange reaches down, and so do a rail's sides."""
    middle = np.median(height)
    if wheel:
        below, above = height.max() - middle, middle - height.min()
        return -height if above > max(below, FLANGE) else None
    ends, top = max(height[0], height[-1]), min(height[0], height[-1])
    return -height if ends < middle and top < middle - 1e-4 else None


def _flange_on_the_right(lateral: Samples, height: Samples) -> bool:
    tip = int(np.argmax(height))
    return bool(height[tip] - np.median(height) > FLANGE and lateral[tip] > 0.5 * (lateral[0] + lateral[-1]))


def _refuse(lateral: Samples, height: Samples, index: Int[np.ndarray, "..."], smoothing: float, source: Source) -> None:
    """Faults between neighbours, the first of them named."""
    along, down = np.diff(lateral), np.diff(height)
    chord = np.hypot(along, down)
    backwards = (along < -(BACKWARDS if smoothing else 1e-6)) & (np.abs(down) < STEEPEST * np.abs(along))
    if backwards.any():
        at = int(np.argmax(backwards))
        raise InputError(
            f"{source.at(index[at + 1])}: goes back by {-1e3 * along[at]:.3g} mm, so that the profile crosses itself; mend the order of the points"
        )
    if (holes := chord > HOLE).any():
        straight = np.zeros(len(chord), bool)
        if len(chord) > 2:  # a straight tread needs no points between
            angle = np.unwrap(np.arctan2(down, along))
            straight[1:-1] = (np.abs(np.diff(angle)[:-1]) < 1e-3) & (np.abs(np.diff(angle)[1:]) < 1e-3)
        if (bare := holes & ~straight).any():
            at = int(np.argmax(bare))
            raise InputError(
                f"{source.at(index[at + 1])}: a hole of {1e3 * chord[at]:.3g} mm before this point; measure it, or put points into it"
            )
    if not smoothing:
        turn = np.abs(np.diff(np.unwrap(np.arctan2(down, along))))
        kinks = (turn > KINK) & (0.5 * (chord[1:] + chord[:-1]) < SHARPEST * turn)
        if kinks.any():
            at = int(np.argmax(kinks))
            raise InputError(
                f"{source.at(index[at + 1])}: a kink of {np.degrees(turn[at]):.3g} degrees; smooth the points, say over 2 mm (smoothing)"
            )


def _curve(lateral: Samples, height: Samples, smoothing: float) -> tuple[tuple[Samples, Samples, Samples], Samples]:
    """Lateral position, height and slope along the curve, and how far the points are off it. Cubic splines along the points, through them or smooth: what minimises Σ distance² d + (w/2π)⁴ ∫ curvature² keeps half of a wave of
    length w, nearly all of a longer and little of a shorter one."""
    from scipy.interpolate import CubicSpline, make_smoothing_spline

    chord = np.hypot(np.diff(lateral), np.diff(height))
    along = 1e3 * np.concatenate([[0.0], np.cumsum(chord)])  # mm, in which the equations are well conditioned
    if smoothing:
        share = np.gradient(along)
        weight = (1e3 * smoothing / (2.0 * np.pi)) ** 4
        x, z = (make_smoothing_spline(along, values, w=share, lam=weight) for values in (lateral, height))
    else:
        x, z = CubicSpline(along, lateral), CubicSpline(along, height)
    at = np.linspace(0.0, along[-1], max(int(along[-1] / (1e3 * SAMPLED)), 100) + 1)
    rate = x.derivative()(at)
    rate = np.where(np.abs(rate) < 1e-9, 1e-9, rate)
    return (x(at), z(at), z.derivative()(at) / rate), np.hypot(x(along) - lateral, z(along) - height)
