"""Where a wheelset touches its rails: roll and height for which both wheels touch, sharply or through the elastic approach.

Both sides are written as the right one: x outwards to the field side, v downwards, the roll of a side positive where it goes up. A wheel
moves rigidly, x = eta + X cos(rho) + V sin(rho), v = Z + V cos(rho) - X sin(rho), with X and V from the wheelset's middle; an inclined
rail is turned by alpha. The gap g is measured in the rail's own frame, where the rail is a function of its lateral position.

The wheelset's height Z and roll phi follow from D_R = D_L = 0, where D is the least gap, or its soft twin -epsilon ln ∫ exp(-g_n/epsilon) dl
over the surface (g_n along the normal), whose weights exp(-g_n/epsilon) are those of the contact. By the envelope theorem a derivative of D
is that of g at the contact point (its weighted mean), so the last Newton step, taken from a point held constant, carries the derivatives.

Arrays have the sides (right, left) first, then y, then places along the wheel.
"""

import functools
import math
from collections.abc import Callable
from types import ModuleType
from typing import NamedTuple

import numpy as np

from ...base.namespace import constant, followed, repeated
from ...base.typing import Values

#: m below the rail's top where gauge is measured
GAUGE_DEPTH = 14e-3
#: m between the steps by which the wheelset is moved outwards to find where it rolls to
STEP = 0.1e-3
#: Newton steps of the height and roll at each y, and how often they are taken at rest
AT_Y, AT_REST = 2, 4
#: 1/m; curvature below which two surfaces are parallel, and the place of the contact between them anywhere
PARALLEL = 1e-3
#: m; gaps that differ by less are the same
ALIKE = 1e-10
#: m and rad; the most that one Newton step may move the wheelset
MOST_HEIGHT, MOST_ROLL = 2e-3, 3e-3
#: m²; least variance of a contact, of one that is a single place
LEAST = 1e-12
#: m; width of a contact whose soft least is its sharp one
REFERENCE = 5e-3

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


class Contacts(NamedTuple):
    """What the contacts are, (2, y) but for the pose."""

    pose: Pose
    position: Places  # on the wheel, from its datum, m
    rail_position: Places  # from the rail's highest point, m
    radius: Places  # rolling, m
    angle: Places  # of the contact plane against the axle, rad
    curvature: Places  # of the gap across the rail, 1/m
    wheel_curvature: Places | None = None  # convex positive, 1/m
    rail_curvature: Places | None = None


class _Moved(NamedTuple):
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


class _Gap(NamedTuple):
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


def _like(of: Places, place: Places) -> Places:
    """A number per side, with the axes of places."""
    return of.reshape((2,) + (1,) * (place.ndim - 1))


def _moved(xp: ModuleType, side: Side, y: Places, pose: Pose, place: Places, rise: Places) -> _Moved:
    sign = _like(side.sign, place)
    out, down = _like(side.base, place) + place, _like(side.radius, place) + rise
    sine, cosine = xp.sin(sign * pose.roll), xp.cos(sign * pose.roll)
    x, v = out * cosine + down * sine, down * cosine - out * sine
    outwards = sign * y + x
    across = outwards - _like(side.outwards, place)
    below = v + (pose.height - _like(side.mean, place) - _like(side.downwards, place))
    tilted, upright = _like(xp.sin(side.tilt), place), _like(xp.cos(side.tilt), place)
    return _Moved(
        across * upright - below * tilted, across * tilted + below * upright, outwards, x, v, sine, cosine, tilted, upright
    )


def _gap(xp: ModuleType, side: Side, y: Places, pose: Pose, place: Places) -> _Gap:
    """The gap between wheel and rail; y, pose and places broadcast."""
    rise, slope, wheel_bend = side.wheel(xp, place)
    at = _moved(xp, side, y, pose, place, rise)
    height, rail_slope, rail_bend = side.rail(xp, at.across)

    def change(dx: Places | float, dv: Places | float) -> Places:
        return rail_slope * (dx * at.upright - dv * at.tilted) - (dx * at.tilted + dv * at.upright)

    dx, dv = at.cosine + slope * at.sine, slope * at.cosine - at.sine
    return _Gap(
        height - at.below,
        change(dx, dv),
        rail_bend * (dx * at.upright - dv * at.tilted) ** 2 + change(wheel_bend * at.sine, wheel_bend * at.cosine),
        change(0.0, 1.0),
        _like(side.sign, place) * change(at.v, -at.x),
        at.outwards,
        rise,
        slope,
        wheel_bend,
        rail_slope,
        rail_bend,
    )


def _over_places(side: Side, y: Places, pose: Pose) -> tuple[Places, Pose, Places]:
    """y, pose and places with an axis for the places."""
    return y[:, None], Pose(pose.height[:, None], pose.roll[:, None]), side.places[:, None]


def _coarse(xp: ModuleType, side: Side, y: Places, pose: Pose) -> Places:
    """The place where the gap is least, or the middle of those where it is."""
    y, pose, places = _over_places(side, y, pose)
    at = _moved(xp, side, y, pose, places, side.wheel.value(xp, places))
    gap = side.rail.value(xp, at.across) - at.below
    alike = gap <= xp.min(gap, axis=2, keepdims=True) + ALIKE
    return xp.sum(xp.where(alike, places, 0.0), axis=2) / xp.sum(alike, axis=2)


def _place(xp: ModuleType, side: Side, y: Places, pose: Pose) -> Places:
    """The same between the places, by Newton steps."""
    apart = side.places[:, 1:2] - side.places[:, :1]

    def step(place: Places) -> Places:
        at = _gap(xp, side, y, pose, place)
        change = -at.along / xp.where(at.bend > PARALLEL, at.bend, xp.inf)
        return xp.clip(place + xp.clip(change, -apart, apart), side.places[:, :1], side.places[:, -1:])

    return repeated(xp, 2, step, _coarse(xp, side, y, pose))


def _sharply(xp: ModuleType, find: Callable[..., Places], side: Side, y: Places, pose: Pose) -> tuple[Places, Places, Places]:
    """D and its derivatives with respect to height and roll at the places that `find` finds."""
    at = _gap(xp, side, y, pose, find(xp, side, y, pose))
    return at.gap, at.by_height, at.by_roll


class _Spread(NamedTuple):
    """The contact's share at each place, D, and what else is known there."""

    share: Places  # (2, y, places)
    least: Places  # (2, y)
    at: _Gap
    cosine: Places  # (2, 1, places) of the wheel's surface


def _spread(xp: ModuleType, side: Side, y: Places, pose: Pose, width: Places) -> _Spread:
    y, pose, places = _over_places(side, y, pose)
    at = _gap(xp, side, y, pose, places)
    cosine = 1.0 / xp.sqrt(1.0 + at.slope**2)
    exponent = -at.gap * (cosine / width)
    highest = constant(xp, xp.max(exponent, axis=2, keepdims=True))
    share = xp.exp(exponent - highest) * (xp.gradient(side.places, axis=1)[:, None] / cosine)
    total = xp.sum(share, axis=2, keepdims=True)
    least = -width * (highest + xp.log(total / REFERENCE))
    return _Spread(share / total, least[..., 0], at, cosine)


def _softly(xp: ModuleType, width: Places, side: Side, y: Places, pose: Pose) -> tuple[Places, Places, Places]:
    """D and its derivatives with respect to height and roll, of the soft least."""
    found = _spread(xp, side, y, pose, width)
    share = found.share * found.cosine
    return found.least, xp.sum(share * found.at.by_height, axis=2), xp.sum(share * found.at.by_roll, axis=2)


def _newton(parts: tuple[Places, Places, Places]) -> tuple[Places, Places]:
    """The change of height and roll towards D_R = D_L = 0."""
    (d, e), (a, c), (b, f) = parts
    determinant = a * f - b * c
    return (b * e - f * d) / determinant, (c * d - a * e) / determinant


def _step(xp: ModuleType, least: Callable[..., tuple[Places, Places, Places]], side: Side, y: Places, pose: Pose) -> Pose:
    """A Newton step of bounded length: further off the surfaces have turned away from what it rests on."""
    height, roll = _newton(least(side, y, pose))
    return Pose(pose.height + xp.clip(height, -MOST_HEIGHT, MOST_HEIGHT), pose.roll + xp.clip(roll, -MOST_ROLL, MOST_ROLL))


def _outwards(xp: ModuleType, side: Side, steps: int) -> Pose:
    """Poses at y = 0, ±STEP, ±2 STEP, ..., in rising order: each found from its neighbour nearer the middle."""
    both, rest = np.array([-1.0, 1.0]), Pose(xp.zeros(2), xp.zeros(2))
    step = functools.partial(_step, xp, functools.partial(_sharply, xp, _coarse), side)

    def onwards(pose: Pose, k: Places) -> Pose:
        return repeated(xp, AT_Y, lambda one: step(k * STEP * both, one), pose)

    path = followed(xp, onwards, rest, np.maximum(np.arange(1.0 - AT_REST, steps + 1), 0.0))
    height, roll = (of[AT_REST - 1 :] for of in path)
    return Pose(xp.concatenate([height[:0:-1, 0], height[:, 1]]), xp.concatenate([roll[:0:-1, 0], roll[:, 1]]))


def posed(xp: ModuleType, side: Side, y: Places, steps: int) -> Pose:
    """About where the wheelset lies at y (m) within `steps` of `STEP`."""
    path, grid = _outwards(xp, side, steps), STEP * np.arange(-steps, steps + 1.0)
    return Pose(xp.interp(y, grid, path.height), xp.interp(y, grid, path.roll))


def contacts(xp: ModuleType, side: Side, y: Places, width: Places, steps: int) -> tuple[Contacts, Contacts]:
    """The sharp contacts and the soft ones of `width` epsilon (m), at y (m) within `steps` of `STEP`."""
    still, fixed = constant(xp, (side, width))
    start = posed(xp, still, y, steps)

    def solved(least: Callable[..., tuple[Places, Places, Places]]) -> Pose:
        return constant(xp, repeated(xp, AT_Y, lambda pose: _step(xp, least, still, y, pose), start))

    sharp = solved(functools.partial(_sharply, xp, _place))
    places = constant(xp, _place(xp, still, y, sharp))
    soft = solved(functools.partial(_softly, xp, fixed))
    return _sharp(xp, side, y, sharp, places), _soft(xp, side, y, soft, width)


class Touching(NamedTuple):
    """Sharp contacts of known numbers, found from a pose nearby."""

    y: Places
    pose: Pose
    place: Places  # (2, y)
    rise: Places  # (2, y) of the radius over the nominal one


def touching(side: Side, y: Places, pose: Pose) -> Touching:
    """The sharp contacts at y from poses nearby."""
    least = functools.partial(_sharply, np, _place)
    pose = repeated(np, AT_Y + 1, lambda one: _step(np, least, side, y, one), pose)
    place = _place(np, side, y, pose)
    return Touching(y, pose, place, side.wheel.value(np, place))


def _carried(xp: ModuleType, pose: Pose, parts: tuple[Places, Places, Places]) -> Pose:
    """The pose of the solution with its derivatives: a Newton step, whose matrix is a constant, that changes nothing."""
    height, roll = _newton((parts[0], *constant(xp, parts[1:])))
    return Pose(pose.height + height, pose.roll + roll)


def _sharp(xp: ModuleType, side: Side, y: Places, pose: Pose, place: Places) -> Contacts:
    """The contacts at the least gaps; the last steps of pose and place carry their derivatives."""
    near = _gap(xp, side, y, pose, place)
    pose = _carried(xp, pose, (near.gap, near.by_height, near.by_roll))
    near = _gap(xp, side, y, pose, place)
    bend = constant(xp, near.bend)
    place = place - xp.where(bend > PARALLEL, near.along / xp.where(bend > PARALLEL, bend, 1.0), 0.0)
    at = _gap(xp, side, y, pose, place)
    wheel = -at.wheel_bend / (1.0 + at.slope**2) ** 1.5
    rail = at.rail_bend / (1.0 + at.rail_slope**2) ** 1.5
    return Contacts(
        pose,
        position=place,
        rail_position=at.outwards - side.top[:, None],
        radius=side.radius[:, None] + at.rise,
        angle=-xp.arctan(at.slope),
        curvature=wheel + rail,
        wheel_curvature=wheel,
        rail_curvature=rail,
    )


def _soft(xp: ModuleType, side: Side, y: Places, pose: Pose, width: Places) -> Contacts:
    """Means over the contact's shares: of the position, the radius and the normal; the curvature is that of a single contact whose
    variance along the surface, epsilon/curvature, is the same."""
    pose = _carried(xp, pose, _softly(xp, width, side, y, pose))
    share, _, at, cosine = _spread(xp, side, y, pose, width)
    cosine, slope, rise = (of[:, 0] for of in (cosine, at.slope, at.rise))
    apart = xp.diff(side.places, axis=1) * 0.5 * (1.0 / cosine[:, 1:] + 1.0 / cosine[:, :-1])
    along = xp.concatenate([xp.zeros((2, 1)), xp.cumsum(apart, axis=1)], axis=1)
    # of the wheel, alike for all y: one product of matrices
    wheel = xp.stack([side.places, rise, -slope * cosine, cosine, along, along**2], axis=2)
    place, higher, out, up, middle, square = xp.moveaxis(share @ wheel, 2, 0)
    return Contacts(
        pose,
        position=place,
        rail_position=xp.sum(share * at.outwards, axis=2) - side.top[:, None],
        radius=side.radius[:, None] + higher,
        angle=xp.arctan2(out, up),
        curvature=width / xp.maximum(square - middle**2, LEAST),
    )


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


class Lean(NamedTuple):
    """How a wheelset moves with its displacement on elastic contacts: derivatives by y, and what they belong to."""

    contacts: Contacts
    rise: Places  # d(rise of its middle)/dy: the lateral force of the normals over the axle load
    roll: Places  # d roll/dy, rad/m


def leaning(xp: ModuleType, side: Side, y: Places, pose: Pose, width: Places) -> Lean:
    """The soft contacts at y, from a pose that solves D_R = D_L = 0, with the derivatives by y that keep it so."""
    found = _soft(xp, side, y, pose, width)
    rise, roll, _ = _leant(xp, side, y, found.pose, width)
    return Lean(found, rise, roll)


def risen(xp: ModuleType, side: Side, y: Places, pose: Pose, width: Places) -> tuple[Places, Pose]:
    """`Lean.rise` alone, and the pose at which it is: found by Newton steps from one nearby."""

    def step(reached: tuple[Places, Pose]) -> tuple[Places, Pose]:
        pose = reached[1]
        rise, _, (height, roll) = _leant(xp, side, y, pose, width)
        height, roll = xp.clip(height, -MOST_HEIGHT, MOST_HEIGHT), xp.clip(roll, -MOST_ROLL, MOST_ROLL)
        return rise, Pose(pose.height + height, pose.roll + roll)

    return repeated(xp, AT_Y + 1, step, (pose.roll, pose))


def _leant(xp: ModuleType, side: Side, y: Places, pose: Pose, width: Places) -> tuple[Places, Places, tuple[Places, Places]]:
    """Derivatives of rise and roll by y, and the Newton step of height and roll towards D_R = D_L = 0."""
    found = _spread(xp, side, y, pose, width)
    share = found.share * found.cosine
    across = side.sign[:, None, None] * (
        found.at.rail_slope * xp.cos(side.tilt)[:, None, None] - xp.sin(side.tilt)[:, None, None]
    )
    by_y, by_height, by_roll = (xp.sum(share * of, axis=2) for of in (across, found.at.by_height, found.at.by_roll))
    height, roll = _newton((by_y, by_height, by_roll))
    return -height, roll, _newton((found.least, by_height, by_roll))
