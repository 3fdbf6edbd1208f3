"""Where a wheelset touches its rails: roll and height for which both wheels touch, sharply or through the elastic approach.

The wheelset's height Z and roll phi follow from D_R = D_L = 0, where D is the least gap, or its soft twin -epsilon ln ∫ exp(-g_n/epsilon) dl
over the surface (g_n along the normal), whose weights exp(-g_n/epsilon) are those of the contact. By the envelope theorem a derivative of D
is that of g at the contact point (its weighted mean), so the last Newton step, taken from a point held constant, carries the derivatives.

Arrays have the sides (right, left) first, then y, then places along the wheel.
"""

import functools
from collections.abc import Callable
from types import ModuleType
from typing import NamedTuple

import numpy as np

from ...base.namespace import constant, followed, repeated
from .gap import ALIKE, PARALLEL, Gap, Places, Pose, Side, gap_at, moved_to, over_places

#: m between the steps by which the wheelset is moved outwards to find where it rolls to
STEP = 0.1e-3
#: Newton steps of the height and roll at each y, and how often they are taken at rest
AT_Y, AT_REST = 2, 4
#: m and rad; the most that one Newton step may move the wheelset
MOST_HEIGHT, MOST_ROLL = 2e-3, 3e-3
#: m²; least variance of a contact, of one that is a single place
LEAST = 1e-12
#: m; width of a contact whose soft least is its sharp one
REFERENCE = 5e-3


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


def _coarse(xp: ModuleType, side: Side, y: Places, pose: Pose) -> Places:
    """The place where the gap is least, or the middle of those where it is."""
    y, pose, places = over_places(side, y, pose)
    at = moved_to(xp, side, y, pose, places, side.wheel.value(xp, places))
    gap = side.rail.value(xp, at.across) - at.below
    alike = gap <= xp.min(gap, axis=2, keepdims=True) + ALIKE
    return xp.sum(xp.where(alike, places, 0.0), axis=2) / xp.sum(alike, axis=2)


def _place(xp: ModuleType, side: Side, y: Places, pose: Pose) -> Places:
    """The same between the places, by Newton steps."""
    apart = side.places[:, 1:2] - side.places[:, :1]

    def step(place: Places) -> Places:
        at = gap_at(xp, side, y, pose, place)
        change = -at.along / xp.where(at.bend > PARALLEL, at.bend, xp.inf)
        return xp.clip(place + xp.clip(change, -apart, apart), side.places[:, :1], side.places[:, -1:])

    return repeated(xp, 2, step, _coarse(xp, side, y, pose))


def _sharply(xp: ModuleType, find: Callable[..., Places], side: Side, y: Places, pose: Pose) -> tuple[Places, Places, Places]:
    """D and its derivatives with respect to height and roll at the places that `find` finds."""
    at = gap_at(xp, side, y, pose, find(xp, side, y, pose))
    return at.gap, at.by_height, at.by_roll


class _Spread(NamedTuple):
    """The contact's share at each place, D, and what else is known there."""

    share: Places  # (2, y, places)
    least: Places  # (2, y)
    at: Gap
    cosine: Places  # (2, 1, places) of the wheel's surface


def _spread(xp: ModuleType, side: Side, y: Places, pose: Pose, width: Places) -> _Spread:
    y, pose, places = over_places(side, y, pose)
    at = gap_at(xp, side, y, pose, places)
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
    near = gap_at(xp, side, y, pose, place)
    pose = _carried(xp, pose, (near.gap, near.by_height, near.by_roll))
    near = gap_at(xp, side, y, pose, place)
    bend = constant(xp, near.bend)
    place = place - xp.where(bend > PARALLEL, near.along / xp.where(bend > PARALLEL, bend, 1.0), 0.0)
    at = gap_at(xp, side, y, pose, place)
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
