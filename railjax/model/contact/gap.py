"""Wheels over their rails: profiles as tables of cubics, where rails lie on the track, and the gap at places of a wheel.

Both sides are written as the right one: x outwards to the field side, v downwards, the roll of a side positive where it goes up. A wheel
moves rigidly, x = eta + X cos(rho) + V sin(rho), v = Z + V cos(rho) - X sin(rho), with X and V from the wheelset's middle; an inclined
rail is turned by alpha. The gap g is measured in the rail's own frame, where the rail is a function of its lateral position.

Arrays have the sides (right, left) first, then y, then places along the wheel.
"""

import math
from types import ModuleType
from typing import NamedTuple

import numpy as np

from ...base.namespace import constant
from ...base.typing import Values

#: m below the rail's top where gauge is measured
GAUGE_DEPTH = 14e-3
#: 1/m; curvature below which two surfaces are parallel, and the place of the contact between them anywhere
PARALLEL = 1e-3
#: m; gaps that differ by less are the same
ALIKE = 1e-10

Places = Values


class Cubics(NamedTuple):
    """A function of each side in a table of cubics over equal steps, straight beyond its ends."""

    start: Places  # (2,)
    step: Places  # (2,)
    rows: Places  # (2, intervals, 4)

    def _in(self, xp: ModuleType, x: Places) -> tuple[Places, Places, Places]:
        shape = (2,) + (1,) * (x.ndim - 1)
        count = self.rows.shape[1]
        t = (x - self.start.reshape(shape)) / self.step.reshape(shape)
        index = xp.clip(xp.floor(t), 0, count - 1)
        at = index.astype(int) + count * np.arange(2).reshape(shape)
        u = t - index
        return u, xp.moveaxis(xp.take(self.rows.reshape(-1, 4), at, axis=0), -1, 0), self.step.reshape(shape)

    def value(self, xp: ModuleType, x: Places) -> Places:
        """The value alone."""
        u, (a, b, c, d), _ = self._in(xp, x)
        within = xp.clip(u, 0.0, 1.0)
        beyond = u - within
        return a + u * b + within * within * (c + within * d) + beyond * within * (2.0 * c + 3.0 * within * d)

    def __call__(self, xp: ModuleType, x: Places) -> tuple[Places, Places, Places]:
        """Value, slope and second derivative."""
        u, (a, b, c, d), step = self._in(xp, x)
        within = xp.clip(u, 0.0, 1.0)
        slope = b + within * (2.0 * c + 3.0 * within * d)
        value = a + within * (b + within * (c + within * d)) + slope * (u - within)
        second = xp.where(u == within, 2.0 * c + 6.0 * d * within, 0.0)
        return value, slope / step, second / step**2


class Side(NamedTuple):
    """Wheels over their rails, both seen as the right one; (2, ...): right, left."""

    sign: Places  # 1 on the right, -1 on the left
    wheel: Cubics
    rail: Cubics
    places: Places  # (2, places) along the wheel, m
    radius: Places  # nominal, m
    mean: Places  # of the two nominal radii, m
    base: Places  # tread datum from the wheelset's middle, m
    tilt: Places  # angle of the inclination
    outwards: Places  # of the origin of the rail's frame on the track, m
    downwards: Places
    top: Places  # the rail's highest point on the track, outwards, m


class Pose(NamedTuple):
    """Of the wheelset: `height` (m, downwards) of its middle from the mean radius above the rails' tops, and `roll` (rad), right side up."""

    height: Places
    roll: Places


class Moved(NamedTuple):
    """Places of a wheel in the rail's frame, and the angles that took them there."""

    across: Places  # lateral in the rail's frame, m
    below: Places  # downwards in it, m
    outwards: Places  # x on the track, m
    x: Places  # from the wheelset's middle, turned, m
    v: Places
    sine: Places
    cosine: Places
    tilted: Places
    upright: Places


class Gap(NamedTuple):
    """At places of a wheel: the gap, its derivatives, and what they are made of."""

    gap: Places
    along: Places  # dg/ds
    bend: Places  # d²g/ds²
    by_height: Places
    by_roll: Places
    outwards: Places  # x on the track, m
    rise: Places  # h of the wheel
    slope: Places
    wheel_bend: Places
    rail_slope: Places
    rail_bend: Places


def like(of: Places, place: Places) -> Places:
    """A number per side, with the axes of places."""
    return of.reshape((2,) + (1,) * (place.ndim - 1))


def moved_to(xp: ModuleType, side: Side, y: Places, pose: Pose, place: Places, rise: Places) -> Moved:
    """Places of a wheel, `rise` above its radius, in the frame of the rail."""
    sign = like(side.sign, place)
    out, down = like(side.base, place) + place, like(side.radius, place) + rise
    sine, cosine = xp.sin(sign * pose.roll), xp.cos(sign * pose.roll)
    x, v = out * cosine + down * sine, down * cosine - out * sine
    outwards = sign * y + x
    across = outwards - like(side.outwards, place)
    below = v + (pose.height - like(side.mean, place) - like(side.downwards, place))
    tilted, upright = like(xp.sin(side.tilt), place), like(xp.cos(side.tilt), place)
    return Moved(
        across * upright - below * tilted, across * tilted + below * upright, outwards, x, v, sine, cosine, tilted, upright
    )


def gap_at(xp: ModuleType, side: Side, y: Places, pose: Pose, place: Places) -> Gap:
    """The gap between wheel and rail; y, pose and places broadcast."""
    rise, slope, wheel_bend = side.wheel(xp, place)
    at = moved_to(xp, side, y, pose, place, rise)
    height, rail_slope, rail_bend = side.rail(xp, at.across)

    def change(dx: Places | float, dv: Places | float) -> Places:
        return rail_slope * (dx * at.upright - dv * at.tilted) - (dx * at.tilted + dv * at.upright)

    dx, dv = at.cosine + slope * at.sine, slope * at.cosine - at.sine
    return Gap(
        height - at.below,
        change(dx, dv),
        rail_bend * (dx * at.upright - dv * at.tilted) ** 2 + change(wheel_bend * at.sine, wheel_bend * at.cosine),
        change(0.0, 1.0),
        like(side.sign, place) * change(at.v, -at.x),
        at.outwards,
        rise,
        slope,
        wheel_bend,
        rail_slope,
        rail_bend,
    )


def over_places(side: Side, y: Places, pose: Pose) -> tuple[Places, Pose, Places]:
    """y, pose and places with an axis for the places."""
    return y[:, None], Pose(pose.height[:, None], pose.roll[:, None]), side.places[:, None]


def laid(xp: ModuleType, rail: Cubics, drawn: Places, tilt: Places, gauge: Places) -> tuple[Places, Places, Places]:
    """Where the rails lie on the track: origins of their frames outwards and downwards, and their highest points outwards, (2,) m each.

    The tops are at height 0, the gauge sides at half the gauge 14 mm below. `drawn`: outlines, (2, 2, points). NaN where a gauge side does not
    reach so far.
    """
    tilted, upright = xp.sin(tilt), xp.cos(tilt)
    places = rail.start[:, None] + rail.step[:, None] * np.arange(rail.rows.shape[1] + 1.0)
    height = rail.value(xp, places) * upright[:, None] - places * tilted[:, None]
    alike = height <= xp.min(height, axis=1, keepdims=True) + ALIKE
    place = xp.sum(xp.where(alike, places, 0.0), axis=1) / xp.sum(alike, axis=1)
    for _ in range(3):  # as with contacts, the derivatives are those of the last step
        place = constant(xp, place)
        _, slope, bend = rail(xp, place)
        bend = constant(xp, bend)
        curved = bend > PARALLEL
        place = place - xp.where(curved, (slope * upright - tilted) / xp.where(curved, bend * upright, 1.0), 0.0)
    down = rail.value(xp, place)
    top, highest = place * upright + down * tilted, down * upright - place * tilted
    across = drawn[:, 0] * upright[:, None] + drawn[:, 1] * tilted[:, None]
    depth = drawn[:, 1] * upright[:, None] - drawn[:, 0] * tilted[:, None] - highest[:, None]
    # the point nearest the top of those beyond the depth on the gauge side, and its neighbours: outwards as a cubic of the depth
    deep = (depth >= GAUGE_DEPTH) & (across < top[:, None])
    nearest = xp.max(xp.where(deep, np.arange(depth.shape[1]), -1), axis=1)
    four = xp.clip(nearest - 1, 0, depth.shape[1] - 4)[:, None] + np.arange(4)
    across, depth = (xp.take_along_axis(of, four, axis=1) for of in (across, depth))
    side = sum(
        across[:, i] * math.prod((GAUGE_DEPTH - depth[:, j]) / (depth[:, i] - depth[:, j]) for j in range(4) if j != i)
        for i in range(4)
    )
    origin = 0.5 * gauge - xp.where(nearest >= 0, side, xp.nan)
    return origin, -highest, origin + top
