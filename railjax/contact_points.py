"""Where a wheelset touches its rails: roll and height for which both wheels touch, sharply or through the elastic approach.

Both sides are written as the right one: x outwards to the field side, v downwards, the roll of a side positive where it goes up. A wheel
moves rigidly, x = eta + X cos(rho) + V sin(rho), v = Z + V cos(rho) - X sin(rho), with X and V from the wheelset's middle; an inclined
rail is turned by alpha. The gap g is measured in the rail's own frame, where the rail is a function of its lateral position.

The wheelset's height Z and roll phi follow from D_R = D_L = 0, where D is the least gap, or its soft twin -epsilon ln ∫ exp(-g_n/epsilon) dl
over the surface (g_n along the normal), whose weights exp(-g_n/epsilon) are those of the contact. By the envelope theorem a derivative of D
is that of g at the contact point (its weighted mean), so the last Newton step, taken from a point held constant, carries the derivatives.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

#: m below the rail's top where gauge is measured
GAUGE_DEPTH = 14e-3
#: m between the steps by which the wheelset is moved outwards to find where it rolls to
STEP = 0.1e-3
#: Newton steps of the height and roll: at rest, on the way outwards, and at each y
AT_REST, OUTWARDS, AT_Y = 8, 3, 3
#: 1/m; curvature below which two surfaces are parallel, and the place of the contact between them anywhere
PARALLEL = 1e-3
#: m; gaps that differ by less are the same
ALIKE = 1e-10
#: m and rad; the most that one Newton step may move the wheelset
MOST_HEIGHT, MOST_ROLL = 2e-3, 3e-3
#: m; width of a contact whose soft least is its sharp one
REFERENCE = 5e-3

Places = Float[Array, "..."]


class Cubics(NamedTuple):
    """A function in a table of cubics over equal steps, straight beyond its ends."""

    start: Float[Array, ""]
    step: Float[Array, ""]
    rows: Float[Array, "intervals 4"]

    def __call__(self, x: Places) -> tuple[Places, Places, Places]:
        """Value, slope and second derivative."""
        t = (x - self.start) / self.step
        count = self.rows.shape[0]
        index = jnp.clip(jnp.floor(t), 0, count - 1)
        row = self.rows[index.astype(int)]
        u = t - index
        within = jnp.clip(u, 0.0, 1.0)
        a, b, c, d = (row[..., k] for k in range(4))
        slope = b + within * (2.0 * c + within * 3.0 * d)
        value = a + within * (b + within * (c + within * d)) + slope * (u - within)
        second = jnp.where(u == within, 2.0 * c + 6.0 * d * within, 0.0)
        return value, slope / self.step, second / self.step**2


class Side(NamedTuple):
    """A wheel over its rail, both seen as the right ones; the arrays of the two sides are stacked along a leading axis, right and left."""

    sign: Float[Array, ""]  # 1 on the right, -1 on the left
    wheel: Cubics
    rail: Cubics
    places: Float[Array, "places"]  # along the wheel, m
    radius: Float[Array, ""]  # nominal, m
    mean: Float[Array, ""]  # of the two nominal radii, m
    base: Float[Array, ""]  # tread datum from the wheelset's middle, m
    tilt: Float[Array, ""]  # angle of the inclination
    origin: Float[Array, "2"]  # of the rail's frame on the track: outwards, downwards, m
    top: Float[Array, ""]  # the rail's highest point on the track, outwards, m


class Pose(NamedTuple):
    """Of the wheelset: `height` (m, downwards) of its middle from the mean radius above the rails' tops, and `roll` (rad), right side up."""

    height: Float[Array, "y"]
    roll: Float[Array, "y"]


class Contacts(NamedTuple):
    """What the contacts are; per side (right, left) along a leading axis but for the pose."""

    pose: Pose
    position: Float[Array, "2 y"]  # on the wheel, from its datum, m
    rail_position: Float[Array, "2 y"]  # from the rail's highest point, m
    radius: Float[Array, "2 y"]  # rolling, m
    angle: Float[Array, "2 y"]  # of the contact plane against the axle, rad
    curvature: Float[Array, "2 y"]  # of the gap across the rail, 1/m
    wheel_curvature: Float[Array, "2 y"] | None = None  # convex positive, 1/m
    rail_curvature: Float[Array, "2 y"] | None = None


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


def _gap(side: Side, y: Places, pose: Pose, place: Places) -> _Gap:
    """The gap between wheel and rail; y, pose and places broadcast."""
    rise, slope, wheel_bend = side.wheel(place)
    out, down = side.base + place, side.radius + rise
    sine, cosine = jnp.sin(side.sign * pose.roll), jnp.cos(side.sign * pose.roll)
    x, v = out * cosine + down * sine, down * cosine - out * sine
    outwards = side.sign * y + x
    across, below = outwards - side.origin[0], v + pose.height - side.mean - side.origin[1]
    tilted, upright = jnp.sin(side.tilt), jnp.cos(side.tilt)
    height, rail_slope, rail_bend = side.rail(across * upright - below * tilted)

    def change(dx: Places, dv: Places) -> Places:
        return rail_slope * (dx * upright - dv * tilted) - (dx * tilted + dv * upright)

    dx, dv = cosine + slope * sine, slope * cosine - sine
    return _Gap(
        height - across * tilted - below * upright,
        change(dx, dv),
        rail_bend * (dx * upright - dv * tilted) ** 2 + change(wheel_bend * sine, wheel_bend * cosine),
        change(jnp.zeros_like(v), jnp.ones_like(v)),
        side.sign * change(v, -x),
        outwards,
        rise,
        slope,
        wheel_bend,
        rail_slope,
        rail_bend,
    )


def _place(side: Side, y: Places, pose: Pose) -> Places:
    """Where the gap is least: the least of all places, or the middle of those that are alike, then two Newton steps."""
    gap = _gap(side, y[:, None], Pose(pose.height[:, None], pose.roll[:, None]), side.places).gap
    alike = gap <= jnp.min(gap, axis=1, keepdims=True) + ALIKE
    place = jnp.sum(jnp.where(alike, side.places, 0.0), axis=1) / jnp.sum(alike, axis=1)
    apart = side.places[1] - side.places[0]
    for _ in range(2):
        at = _gap(side, y, pose, place)
        step = -at.along / jnp.where(at.bend > PARALLEL, at.bend, jnp.inf)
        place = jnp.clip(place + jnp.clip(step, -apart, apart), side.places[0], side.places[-1])
    return place


def _least(side: Side, y: Places, pose: Pose) -> tuple[Places, Places, Places]:
    """D and its derivatives with respect to height and roll, sharply."""
    at = _gap(side, y, pose, _place(side, y, pose))
    return at.gap, at.by_height, at.by_roll


def _weights(side: Side, y: Places, pose: Pose, width: Places) -> tuple[_Gap, Places, Places, Places]:
    """At all places: the gap, the cosine of the surface, the contact's weights, and D."""
    at = _gap(side, y[:, None], Pose(pose.height[:, None], pose.roll[:, None]), side.places)
    cosine = 1.0 / jnp.sqrt(1.0 + at.slope**2)  # of the wheel's surface, the same for all y
    exponent = -at.gap * cosine / width
    highest = jax.lax.stop_gradient(jnp.max(exponent, axis=1, keepdims=True))
    spread = jnp.gradient(side.places) / cosine
    share = spread * jnp.exp(exponent - highest)
    total = jnp.sum(share, axis=1)
    return at, cosine, share / total[:, None], -width * (highest[:, 0] + jnp.log(total / REFERENCE))


def _soft(side: Side, y: Places, pose: Pose, width: Places) -> tuple[Places, Places, Places]:
    """D and its derivatives with respect to height and roll, of the soft least."""
    at, cosine, share, least = _weights(side, y, pose, width)
    return least, jnp.sum(share * cosine * at.by_height, axis=1), jnp.sum(share * cosine * at.by_roll, axis=1)


def _step(sides: Side, y: Places, pose: Pose, width: Places | None, held: bool = False) -> Pose:
    """A Newton step towards D_R = D_L = 0. With `held` its matrix is a constant, as it is taken from the solution."""
    parts = jax.vmap(lambda side: _least(side, y, pose) if width is None else _soft(side, y, pose, width))(sides)
    (d, e), (a, c), (b, f) = parts
    if held:
        a, b, c, f = jax.lax.stop_gradient((a, b, c, f))
    determinant = a * f - b * c
    height, roll = (b * e - f * d) / determinant, (c * d - a * e) / determinant
    if not held:  # beyond these the surfaces have turned away from what the step was computed with
        height, roll = jnp.clip(height, -MOST_HEIGHT, MOST_HEIGHT), jnp.clip(roll, -MOST_ROLL, MOST_ROLL)
    return Pose(pose.height + height, pose.roll + roll)


def _outwards(sides: Side, steps: int) -> Pose:
    """Poses at y = 0, ±STEP, ±2 STEP, ..., in rising order: each found from its neighbour nearer the middle."""
    start = Pose(jnp.zeros(2), jnp.zeros(2))
    both = jnp.array([-1.0, 1.0])
    for_y = functools.partial(_step, sides, width=None)
    middle = jax.lax.fori_loop(0, AT_REST, lambda _, pose: for_y(jnp.zeros(2), pose), start)

    def onwards(pose: Pose, k: Array) -> tuple[Pose, Pose]:
        moved = jax.lax.fori_loop(0, OUTWARDS, lambda _, one: for_y(k * STEP * both, one), pose)
        return moved, moved

    _, path = jax.lax.scan(onwards, middle, jnp.arange(1.0, steps + 1))
    return jax.tree.map(lambda at, to: jnp.concatenate([to[::-1, 0], at[:1], to[:, 1]]), middle, path)


def contacts(sides: Side, y: Float[Array, "y"], width: Float[Array, ""], steps: int) -> tuple[Contacts, Contacts]:
    """The sharp contacts and the soft ones of `width` epsilon (m), at y (m) within `steps` of `STEP`."""
    still = jax.lax.stop_gradient(sides)
    path, grid = _outwards(still, steps), STEP * jnp.arange(-steps, steps + 1.0)
    start = Pose(jnp.interp(y, grid, path.height), jnp.interp(y, grid, path.roll))
    found = []
    for kind in (None, width):
        pose = jax.lax.fori_loop(0, AT_Y, lambda _, one, kind=kind: _step(still, y, one, kind), start)
        pose = _step(sides, y, jax.lax.stop_gradient(pose), kind, held=True)
        read = (lambda side, pose=pose: _sharp(side, y, pose)) if kind is None else (lambda side, pose=pose: _mean(side, y, pose, width))
        found.append(Contacts(pose, **jax.vmap(read)(sides)))
    return found[0], found[1]


def _sharp(side: Side, y: Places, pose: Pose) -> dict[str, Places]:
    """The contact at the least gap; the last step of its place carries the derivatives."""
    still = jax.lax.stop_gradient((side, pose))
    place = jax.lax.stop_gradient(_place(still[0], y, still[1]))
    near = _gap(side, y, pose, place)
    bend = jax.lax.stop_gradient(near.bend)
    place = place - jnp.where(bend > PARALLEL, near.along / jnp.where(bend > PARALLEL, bend, 1.0), 0.0)
    at = _gap(side, y, pose, place)
    return {
        "position": place,
        "rail_position": at.outwards - side.top,
        "radius": side.radius + at.rise,
        "angle": -jnp.arctan(at.slope),
        "wheel_curvature": -at.wheel_bend / (1.0 + at.slope**2) ** 1.5,
        "rail_curvature": at.rail_bend / (1.0 + at.rail_slope**2) ** 1.5,
        "curvature": at.rail_bend / (1.0 + at.rail_slope**2) ** 1.5 - at.wheel_bend / (1.0 + at.slope**2) ** 1.5,
    }


def _mean(side: Side, y: Places, pose: Pose, width: Places) -> dict[str, Places]:
    """Means over the contact's weights: of the position, the radius and the normal; the curvature is that of a single contact with the
    same variance along the surface, epsilon/kappa."""
    at, cosine, share, _ = _weights(side, y, pose, width)

    def mean(values: Places) -> Places:
        return jnp.sum(share * values, axis=1)

    along = jnp.concatenate([jnp.zeros(1), jnp.cumsum(jnp.diff(side.places) * 0.5 * (1.0 / cosine[1:] + 1.0 / cosine[:-1]))])
    middle = mean(along)
    return {
        "position": mean(side.places),
        "rail_position": mean(at.outwards) - side.top,
        "radius": side.radius + mean(at.rise),
        "angle": jnp.arctan2(mean(-at.slope * cosine), mean(jnp.broadcast_to(cosine, share.shape))),
        "curvature": width / mean((along - middle[:, None]) ** 2),
    }


def laid(rail: Cubics, drawn: Float[Array, "2 k"], tilt: Float[Array, ""], gauge: Float[Array, ""]) -> tuple[Array, Array]:
    """Origin (outwards, downwards) of a rail's frame on the track, and its highest point outwards: the top at height 0, the gauge
    side at half the gauge 14 mm below it. NaN where the gauge side does not reach so far."""
    tilted, upright = jnp.sin(tilt), jnp.cos(tilt)
    places = rail.start + rail.step * jnp.arange(rail.rows.shape[0] + 1.0)
    height = jax.lax.stop_gradient(rail(places)[0] * upright - places * tilted)
    alike = height <= jnp.min(height) + ALIKE
    place = jnp.sum(jnp.where(alike, places, 0.0)) / jnp.sum(alike)
    for _ in range(3):  # as above: the derivatives are those of the last step
        place = jax.lax.stop_gradient(place)
        _, slope, bend = rail(place)
        bend = jax.lax.stop_gradient(bend)
        place = place - jnp.where(bend > PARALLEL, (slope * upright - tilted) / jnp.where(bend > PARALLEL, bend * upright, 1.0), 0.0)
    lateral, down = place, rail(place)[0]
    top = lateral * upright + down * tilted, down * upright - lateral * tilted
    across, below = drawn[0] * upright + drawn[1] * tilted, drawn[1] * upright - drawn[0] * tilted - top[1]
    # the point nearest the top of those beyond the depth on the gauge side, and its neighbours: outwards as a cubic of the depth
    deep = (below >= GAUGE_DEPTH) & (across < top[0])
    index = jnp.clip(jnp.max(jnp.where(deep, jnp.arange(below.size), -1)) - 1, 0, below.size - 4)
    x, depth = (jax.lax.dynamic_slice(values, (index,), (4,)) for values in (across, below))
    weights = [
        jnp.prod(jnp.stack([(GAUGE_DEPTH - depth[j]) / (depth[i] - depth[j]) for j in range(4) if j != i])) for i in range(4)
    ]
    side = jnp.where(jnp.any(deep), jnp.sum(jnp.stack(weights) * x), jnp.nan)
    origin = 0.5 * gauge - side
    return jnp.stack([origin, -top[1]]), origin + top[0]
