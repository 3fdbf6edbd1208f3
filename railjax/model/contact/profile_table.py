"""A vehicle on wheel and rail profiles: the contact geometry as the table of functions that `profile_contact` reads.

Rails give way to the flange: beyond some lateral force F_0 their heads move by u = (√(F² + F_0²) - F_0)/k_f, and the wheelset's
displacement is y = y_c + u with y_c that of the rigid geometry. So what would be a wall in y has the flange's stiffness k_f.
"""

import dataclasses
from types import ModuleType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ...base.arguments import guarded
from ...base.checks import FLAG, traced
from ...base.errors import InputError
from ...base.namespace import constant, known, namespace, repeated
from ...base.precision import require_double_precision
from ...base.typing import Scalar, Values
from ..consistency import VEHICLE
from ..vehicle import Profiles, Vehicle
from .cubics import cubic_rows
from .gap import Pose, Side
from .geometry import FLATTEST, SPREAD, Pair, both_sides, contact_geometry, laid_out, steps_to
from .kalker import creep_coefficients
from .placing import PLACED
from .points import Lean, leaning, posed, risen
from .profile_contact import FUNCTIONS, OF_WHEEL, ROLL, SHARED
from .table import slopes_of

#: m; displacements of the table's intervals
Y = np.linspace(-12e-3, 12e-3, 481)
#: share of the axle load that is F_0: more than treads give, less than flanges do
GIVES_WAY = 0.2
#: lateral force of the normals over the axle load that only a flange gives
FLANGE = 0.5
#: lateral force of the normals over the axle load at which one rail carries most of it
LEANING = 0.1
#: m to which y_c is found, and most steps of false position for it
CLOSE, MOST = 1e-10, 40
#: of these where numbers are traced
TRACED = 12

#: relative difference of what counts as alike on both sides
ODD = 1e-6
#: place of the lateral force among the functions
NORMAL = SHARED.index("normal")

#: sign of each function in the mirror, where wheels change places
MIRRORED = np.array([-1.0, -1.0, 1.0, -1.0] + [1.0] * 2 * len(OF_WHEEL))
#: powers of 1 - t in powers of t
REVERSED = np.array([[1.0, 1.0, 1.0, 1.0], [0.0, -1.0, -2.0, -3.0], [0.0, 0.0, 1.0, 3.0], [0.0, 0.0, 0.0, -1.0]])
SWAPPED = np.array([*range(len(SHARED)), *(len(SHARED) + 2 * k + 1 - w for k in range(len(OF_WHEEL)) for w in range(2))])


@guarded(vehicle=VEHICLE, **PLACED, simplified=FLAG)
def with_profiles(
    vehicle: Vehicle,
    wheel: Pair = "S1002",
    rail: Pair = "60E1",
    *,
    gauge: Scalar = 1.435,
    flange_back: Scalar = 1.36,
    tread_datum: Scalar = 0.07,
    radius: Scalar | tuple | list | None = None,
    inclination: Scalar | tuple | list = 1 / 40,
    simplified: bool = False,
) -> Vehicle:
    """The vehicle on profiles instead of a constant conicity: conicity, contact angles, creep coefficients, flange and all.

    What was the constant conicity, Kalker's coefficients and the clearance of the flange in `contact` becomes what the profiles have at
    rest, for information. Friction, wheel load and k_f, the rails' stiffness against the flange, stay. Differentiable in
    gauge, inclination, radii and the heights of profiles, inside `jit` too, in double precision.

    Args:
        vehicle: a single vehicle, without lanes
        wheel: as for `contact_geometry`
        rail: as for `contact_geometry`
        gauge: m, 14 mm below the rails' tops
        flange_back: m, between the backs of the flanges
        tread_datum: m, from the back of the flange to the tread datum
        radius: m, at the tread datum, (right, left) for unequal wheels; None: the vehicle's
        inclination: slope of the rails, dimensionless; (right, left) if they differ
        simplified: leave out what a constant conicity leaves out (geometric spin, roll, normal forces): to compare the two

    Raises:
        InputError: as `contact_geometry`.
    """
    millimetres = {"gauge_mm": gauge, "flange_back_mm": flange_back, "tread_datum_mm": tread_datum}
    numbers = {key: value if traced(value) else 1e3 * value for key, value in millimetres.items()}
    if radius is not None and not traced(radius):
        numbers["wheel_diameter_mm"] = 2e3 * np.asarray(radius, float)
    radius = vehicle.wheelset.wheel_radius if radius is None else radius
    load, stiffness = vehicle.contact.wheel_load, vehicle.contact.flange_stiffness
    if any(np.ndim(one) for one in (load, stiffness)):
        raise InputError(
            "with_profiles takes one vehicle, without lanes; make each vehicle by itself, or map over it with jax.vmap"
        )
    placed = wheel, rail, gauge, flange_back, tread_datum, radius, inclination, load, None
    given = both_sides(*placed), stiffness
    if traced(given):
        require_double_precision("a vehicle on traced profiles")
        values = _compiled(given)
    else:
        # what is no geometry is refused
        geometry = contact_geometry(
            wheel, rail, gauge=gauge, flange_back=flange_back, tread_datum=tread_datum, radius=radius, inclination=inclination, y=Y, load=load
        )  # fmt: skip
        pose = Pose(geometry.smooth.height, geometry.smooth.roll)
        # Kalker's coefficients in double precision whatever the process uses
        with jax.enable_x64(True):
            values = _values(np, *known((geometry.sides, SPREAD * geometry.approach, pose, load, stiffness)))
    alike = not any(isinstance(one, (tuple, list)) or np.ndim(one) for one in (wheel, rail, radius, inclination))
    xp = namespace(values)
    angle = xp.min(xp.stack([xp.arctan(xp.max(-one.slope)) for one in given[0][0]]))
    return _carried(vehicle, values, angle, alike, simplified, _given(wheel, rail, numbers, inclination))


class _Place(NamedTuple):
    """Rigid displacements tried, the pose there, and how far y is off."""

    y: Values
    pose: Pose
    off: Values


#: below and above the y that is looked for, and the last one tried
Ends = tuple[_Place, _Place, _Place]


def _yielded(xp: ModuleType, force: Values, load: Values, stiffness: Values) -> Values:
    """u of a lateral force, m, odd and smooth."""
    begins = GIVES_WAY * 2.0 * load
    return xp.sign(force) * (xp.sqrt(force**2 + begins**2) - begins) / stiffness


def _traced_values(given: tuple) -> Values:
    placed, stiffness = given
    side, approach = laid_out(jnp, placed)
    pose = posed(jnp, constant(jnp, side), Y, steps_to(Y))
    return _values(jnp, side, SPREAD * approach, pose, placed[-2], stiffness)


_compiled = jax.jit(_traced_values)


def _values(xp: ModuleType, side: Side, width: Values, pose: Pose, load: Values, stiffness: Values) -> Values:
    """The functions at `Y`, (y, functions)."""
    still, fixed, weight, rail = constant(xp, (side, width, load, stiffness))

    def rigid(of: Side, spread: Values, q: Values, k: Values, y: Values, pose: Pose) -> tuple[Values, Lean]:
        lean = leaning(xp, of, y, pose, spread)
        return y + _yielded(xp, 2.0 * q * lean.rise, q, k), lean

    def tried(y: Values, pose: Pose, wanted: Values) -> _Place:
        rise, pose = risen(xp, still, y, pose, fixed)
        return _Place(y, pose, y + _yielded(xp, 2.0 * weight * rise, weight, rail) - wanted)

    found = _found(xp, tried, Y, constant(xp, pose))
    if xp is jnp:
        # the implicit function's derivative by a Newton step that changes nothing
        y, pose = constant(xp, (found.y, found.pose))
        slope = constant(xp, jax.jvp(lambda y: rigid(still, fixed, weight, rail, y, pose)[0], (y,), (jnp.ones_like(y),))[1])
        at = y - (rigid(side, width, load, stiffness, y, pose)[0] - Y) / slope
        lean = leaning(xp, side, at, pose, width)
    else:
        at, lean = found.y, leaning(xp, side, found.y, found.pose, width)
    return _functions(xp, at, lean, load, side.radius)


def _found(xp: ModuleType, tried: Any, y: Values, pose: Pose) -> _Place:
    """y_c of each y, by false position between the neighbours among the rigid displacements between which it lies."""
    there = tried(y, repeated(xp, 2, lambda pose: tried(y, pose, 0.0).pose, pose), 0.0)
    middle = len(y) // 2
    right, left = _rising(xp, there.off[middle:]), -_rising(xp, -there.off[: middle + 1][::-1])[::-1]
    reached = xp.concatenate([left[:-1], right])
    index = xp.clip(xp.searchsorted(reached, y), 1, len(y) - 1)

    def end(k: Values) -> _Place:
        return _Place(y[k] if xp is np else jnp.asarray(y)[k], Pose(there.pose.height[k], there.pose.roll[k]), there.off[k] - y)

    ends = end(index - 1), end(index), end(index)
    if xp is not np:
        return jax.lax.fori_loop(0, TRACED, lambda _, three: _nearer(jnp, tried, three, jnp.asarray(y)), ends)[2]
    active = np.arange(len(y))
    for _ in range(MOST):
        some = _nearer(np, tried, _taken(ends, active), y[active])
        for whole, part in zip(jax.tree.leaves(ends), jax.tree.leaves(some), strict=True):
            whole[active] = part
        active = active[np.abs(ends[2].off[active]) > CLOSE]
        if not active.size:
            break
    return ends[2]


def _taken(ends: Ends, index: Values) -> Ends:
    return jax.tree.map(lambda leaf: leaf[index], ends)


def _rising(xp: ModuleType, values: Values) -> Values:
    return np.maximum.accumulate(values) if xp is np else jax.lax.cummax(values)


def _nearer(xp: ModuleType, tried: Any, ends: Ends, y: Values) -> Ends:
    """One step of false position (Illinois: an end that stays twice counts half)."""
    low, high, best = ends
    apart = high.off - low.off
    share = xp.clip(xp.where(apart == 0.0, 0.5, -low.off / xp.where(apart == 0.0, 1.0, apart)), 0.0, 1.0)
    pose = Pose(*(a + share * (b - a) for a, b in zip(low.pose, high.pose, strict=True)))
    here = tried(low.y + share * (high.y - low.y), pose, y)
    below = here.off < 0.0
    stays = _chosen(xp, below, high, low)
    stays = stays._replace(off=xp.where(below == (best.off < 0.0), 0.5, 1.0) * stays.off)
    return _chosen(xp, below, here, stays), _chosen(xp, below, stays, here), here


def _chosen(xp: ModuleType, first: Values, one: _Place, other: _Place) -> _Place:
    return jax.tree.map(lambda a, b: xp.where(first, a, b), one, other)


def _functions(xp: ModuleType, at: Values, lean: Lean, load: Values, radii: Values) -> Values:
    """The columns of `profile_contact`, and behind them y_c."""
    found, slopes = lean.contacts, slopes_of(len(Y), Y[1] - Y[0])
    cosine = xp.cos(found.angle)
    along, across = found.radius / cosine, 1.0 / xp.maximum(found.curvature, FLATTEST)
    creep = jax.jit(creep_coefficients)(*(xp.ravel(one) for one in (load / cosine, along, across)))
    creep = [xp.reshape(xp.asarray(one), cosine.shape) for one in creep]
    roll_rate, yielding = slopes @ found.pose.roll, 1.0 - slopes @ at
    # the rail that is leant on gives way
    share = 0.5 + 0.5 * xp.stack([lean.rise, -lean.rise]) / xp.sqrt(lean.rise**2 + LEANING**2)
    moved = 1.0 - share * yielding + xp.mean(radii) * roll_rate
    shared = 0.5 * (found.radius[0] - found.radius[1]), lean.rise, 1.0 + xp.mean(radii) * lean.roll, found.pose.roll
    wheels = moved, xp.sin(found.angle), 1.0 / cosine, *creep
    return xp.stack([*shared, *(one[k] for one in wheels for k in range(2)), at], axis=1)


def _carried(vehicle: Vehicle, found: Values, angle: Values, alike: bool, simplified: bool, given: tuple) -> Vehicle:
    """The vehicle with the functions in a table."""
    xp = np if isinstance(found, np.ndarray) else jnp
    values, rigid = found[:, :FUNCTIONS], found[:, -1]
    if alike:
        # to the last digit
        values = 0.5 * (values + MIRRORED * values[::-1, SWAPPED])
    if simplified:
        # no normal force, roll or contact angle; wheels move as the wheelset does
        kept, plain = np.ones(FUNCTIONS), np.zeros(FUNCTIONS)
        kept[1 : len(SHARED) + 6] = 0.0
        plain[[SHARED.index("acting"), len(SHARED), len(SHARED) + 1, len(SHARED) + 4, len(SHARED) + 5]] = 1.0
        values = kept * values + plain
    step = Y[1] - Y[0]
    slope = step * (slopes_of(len(Y), step) @ values)
    rows = cubic_rows(xp, values, slope, axis=1)
    rest = _rest(xp, rows)
    if not alike:
        # springs are without force at rest
        level = np.zeros(rows.shape[1:])
        level[0, ROLL] = 1.0
        rows = rows - level * _interpolated(xp, rest, values[:, ROLL])

    normal, by_y = constant(xp, (values[:, NORMAL], slope[:, NORMAL]))
    flanged = (normal[0] < -FLANGE) & (normal[-1] > FLANGE)
    # where the flanges touch: a scale of motions, without derivative
    touching = 0.5 * constant(xp, rigid[xp.argmax(normal > FLANGE)] - rigid[len(Y) - 1 - xp.argmax(normal[::-1] < -FLANGE)])
    clearance = vehicle.contact.flange_clearance
    profiles = Profiles(
        start=Y[0],
        step=step,
        rows=rows,
        rest=rest,
        steepest=xp.asarray(Y)[xp.argmax(by_y)],
        last=xp.where(flanged, Y[-1], clearance),
        flange_angle=angle,
        given=given,
    )

    def at_rest(column: Values) -> Values:
        return _interpolated(xp, profiles.rest, column)

    def of_wheels(name: str) -> Values:
        first = len(SHARED) + 2 * OF_WHEEL.index(name)
        return 0.5 * (at_rest(values[:, first]) + at_rest(values[:, first + 1]))

    contact = dataclasses.replace(
        vehicle.contact,
        conicity=at_rest(slope[:, 0] / step),
        creep_longitudinal=of_wheels("longitudinal"),
        creep_lateral=of_wheels("lateral"),
        creep_lateral_spin=of_wheels("lateral_spin"),
        creep_spin=of_wheels("spin"),
        flange_clearance=xp.where(flanged, touching, clearance),
    )
    if xp is np:
        contact, profiles = (
            jax.tree.map(lambda leaf: leaf if np.ndim(leaf) else float(leaf), part) for part in (contact, profiles)
        )
    return dataclasses.replace(vehicle, contact=contact, profiles=profiles)


def _interpolated(xp: ModuleType, y: Values, column: Values) -> Values:
    return xp.interp(y, Y, column)


def _rest(xp: ModuleType, rows: Values) -> Values:
    """The y nearest the middle at which both rolling radii are the same; 0 where there is none."""
    count = rows.shape[0]
    low, high = constant(xp, (rows[:, 0, 0], xp.sum(rows[:, :, 0], axis=1)))
    changes = low * high <= 0.0
    at = xp.argmin(xp.where(changes, xp.abs(xp.arange(count) + 0.5 - 0.5 * count), np.inf))
    a, b, c, d = (rows[at, k, 0] for k in range(4))
    apart = high[at] - low[at]
    share = xp.where(apart == 0.0, 0.0, -low[at] / xp.where(apart == 0.0, 1.0, apart))
    for _ in range(3):  # the last step has the derivatives
        share = constant(xp, share)
        slope = constant(xp, b + share * (2.0 * c + 3.0 * share * d))
        flat = slope == 0.0
        share = share - xp.where(flat, 0.0, (a + share * (b + share * (c + share * d))) / xp.where(flat, 1.0, slope))
    return xp.where(xp.any(changes), Y[0] + (Y[1] - Y[0]) * (at + share), 0.0)


def is_odd(profiles: Profiles) -> bool:
    """Whether both sides are alike: then limit cycles may be their own mirror images."""
    values = np.asarray(profiles.rows)[:, 0]
    # first values of the intervals: of y_1 and its mirror image, and so on
    mirror = MIRRORED * values[:0:-1][:, SWAPPED]
    scale = np.max(np.abs(values), axis=0) + np.finfo(float).tiny
    return bool(np.all(np.abs(mirror - values[1:]) <= ODD * scale))


def evened(slopes: Profiles) -> Profiles:
    """Derivatives of something by a table, of which only the half of an orbit was felt that is the mirror image of the other: the mean of
    them and those that the other half feels."""
    rows = np.asarray(slopes.rows)
    mirrored = MIRRORED * np.einsum("kj,ikf->ijf", REVERSED, rows[::-1])[..., SWAPPED]
    return dataclasses.replace(slopes, rows=0.5 * (rows + mirrored))


def _given(wheels: Any, rails: Any, numbers: dict[str, Any], inclination: Any) -> tuple[tuple[str, Any], ...]:
    """What is known of what a table is made of, in the words of a vehicle file."""

    def names(pair: Any) -> Any:
        found = tuple(one if isinstance(one, str) else one.name for one in (pair if isinstance(pair, (tuple, list)) else (pair,)))
        return found[0] if len(set(found)) == 1 else found

    def number(value: Any) -> Any:
        return tuple(map(float, value)) if np.ndim(value) else float(value)

    said: dict[str, Any] = {"wheel": names(wheels), "rail": names(rails)}
    if not traced(inclination):
        slopes = np.atleast_1d(np.asarray(inclination, float))
        ratios = tuple(1.0 / float(slope) if slope else 0.0 for slope in slopes)
        said["inclination"] = ratios[0] if len(set(ratios)) == 1 else ratios
    said |= {key: number(value) for key, value in numbers.items() if value is not None and not traced(value)}
    return tuple(said.items())
