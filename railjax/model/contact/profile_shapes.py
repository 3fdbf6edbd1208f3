"""Nominal profiles of the standards as points, m: wheels from the tread datum, the field side positive, radius downwards; rails from the middle
of the head, down from its top. Everything in this module is in mm but what the functions return."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

Samples = Float[np.ndarray, "..."]
#: (lateral, height) in m
Points = tuple[Samples, Samples]

#: mm along the profile between two points
SPACING = 0.1

#: S1002, UIC 510-2 and EN 13715: (from, to) along the tread, the field side positive; height downwards
S1002_TREAD = -3.358537058e-2, 1.565681624e-3, -2.810427944e-5, 5.844240864e-8, -1.562379023e-8, 5.309217349e-15, -5.957839843e-12, 2.646656573e-13  # fmt: skip
S1002_FILLET = -4.320221063e3, -1.038384026e3, -1.065501873e2, -6.051367875, -2.054332446e-1, -4.169739389e-3, -4.687195829e-5, -2.252755540e-7  # fmt: skip
S1002: tuple[tuple[float, float, Callable[[Samples], Samples]], ...] = (
    (-70.0, -62.764705882, lambda s: 9.519259302 + np.sqrt(20.5**2 - (s + 49.5) ** 2)),  # H: back of the flange
    (-62.764705882, -49.662510381, lambda s: 16.0 + np.sqrt(12.0**2 - (s + 55.0) ** 2)),  # G: its tip
    (-49.662510381, -39.764473993, lambda s: 8.834924130 + np.sqrt(20.0**2 - (s + 58.558326413) ** 2)),  # F
    (-39.764473993, -38.426669071, lambda s: -93.576667419 - 2.747477419 * s),  # E: the face, 70 degrees
    (-38.426669071, -35.0, lambda s: 16.446 - np.sqrt(13.0**2 - (s + 26.210665) ** 2)),  # D: the root
    (-35.0, -26.0, lambda s: np.polynomial.polynomial.polyval(s, S1002_FILLET)),  # C
    (-26.0, 32.15796, lambda s: np.polynomial.polynomial.polyval(s, (0.0, *S1002_TREAD))),  # B: the tread
    (32.15796, 60.0, lambda s: 1.364323640 - 0.066666667 * s),  # A: 1:15
)

#: heads of EN 13674-1: (radius, half the width at which its arc ends) from the top outwards, then to the side, 1:20; and that of the
#: Manchester benchmarks, whose file "UIC60" differs from 60E1: its arcs end at widths of 20.98 and 51.96 mm, as fitted to 0.02 mm to that file's angles
RAIL_HEADS = {
    "60E1": ((300.0, 20.456 / 2), (80.0, 52.053 / 2), (13.0, None)),
    "UIC60-MANCHESTER": ((300.0, 20.98 / 2), (80.0, 51.96 / 2), (13.0, None)),
    "60E2": ((200.0, 23.778 / 2), (70.0, 48.913 / 2), (16.0, 70.774 / 2), (8.0, None)),
}
SIDE = 20.0
#: mm below the top down to which the side is taken; gauge is measured at 14
DEPTH = 22.0


def s1002() -> Points:
    """The wheel profile S1002, flange 32.5 mm thick, from the back of the flange to the chamfer of the tread."""
    fine = np.concatenate([np.linspace(start, end, max(int((end - start) / 2e-3), 50)) for start, end, _ in S1002])
    # the back starts with a vertical tangent, where a step along it is no step sideways
    fine = np.unique(np.round(np.concatenate([-70.0 + np.geomspace(1e-6, 0.1, 200), fine]), 9))
    height = np.piecewise(fine, [(fine >= start) & (fine <= end) for start, end, _ in S1002], [piece for *_, piece in S1002])
    return _evenly(fine, height)


def rail_head(name: str) -> Points:
    """The head of a rail of `RAIL_HEADS`, symmetric, down to 22 mm below its top."""
    x, z, angle = [np.zeros(1)], [np.zeros(1)], 0.0
    for radius, width in RAIL_HEADS[name]:
        centre = x[-1][-1] - radius * np.sin(angle), z[-1][-1] + radius * np.cos(angle)
        end = np.arctan(SIDE) if width is None else np.arcsin((width - centre[0]) / radius)
        turned = np.linspace(angle, end, max(int(radius * (end - angle) / 2e-3), 50))[1:]
        x, z, angle = [*x, centre[0] + radius * np.sin(turned)], [*z, centre[1] - radius * np.cos(turned)], end
    down = np.linspace(z[-1][-1], DEPTH, 200)[1:]
    x, z = [*x, x[-1][-1] + (down - z[-1][-1]) / SIDE], [*z, down]
    right, below = np.concatenate(x), np.concatenate(z)
    return _evenly(np.concatenate([-right[:0:-1], right]), np.concatenate([below[:0:-1], below]))


def cone(conicity: float) -> Points:
    """A straight tread from 55 mm on the flange's side to 60 mm, without a flange."""
    s = np.array([-55.0, 60.0])
    return _evenly(s, -conicity * s)


def _evenly(lateral: Samples, height: Samples) -> Points:
    """Points at even distances along a fine polygon, m."""
    from scipy.interpolate import PchipInterpolator

    along = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(lateral), np.diff(height)))])
    at = np.linspace(0.0, along[-1], round(along[-1] / SPACING) + 1)
    # not by straight lines, whose corners would be seen in the curvature
    x, z = PchipInterpolator(along, np.stack([lateral, height], axis=1))(at).T
    return 1e-3 * x, 1e-3 * z
