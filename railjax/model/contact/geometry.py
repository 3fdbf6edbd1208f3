"""Contact geometry of a wheelset on its rails over its lateral displacement, sharply with its jumps and as elastic contact smooths them."""

import functools
from dataclasses import dataclass
from types import ModuleType
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...base.arguments import guarded
from ...base.checks import Range, Rising, positive, traced
from ...base.errors import InputError
from ...base.namespace import known
from ...base.precision import require_double_precision
from ...base.typing import Number, Scalar, Values
from .gap import Cubics, Side, laid
from .jumps import jumps_of
from .kalker import STEEL_POISSON, STEEL_YOUNG, ContactEllipse, CreepCoefficients, contact_ellipse, creep_coefficients
from .placing import PLACED, refuse_unfit
from .points import STEP, Contacts, contacts
from .profiles import RailProfile, WheelProfile

if TYPE_CHECKING:
    import xarray

Pair = WheelProfile | RailProfile | str | tuple | list
PerY = Float[Array, "..."] | Float[np.ndarray, "..."]

#: m; displacements at which the geometry is computed unless others are asked for
LATERAL = np.linspace(-10e-3, 10e-3, 201)
#: share of Hertz's approach over which the soft contact spreads: with it the variance along the surface is that of Hertz's ellipse, b²/5
SPREAD = 0.2
#: 1/m; flatter gaps are taken as this one in Hertz's theory, whose ellipse would be wider than any rail
FLATTEST = 0.5


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ContactFunctions:
    """Functions of the lateral displacement y (m, positive to the right); pairs are (right, left). The contact angle is that of the contact
    plane against the axle, positive where the wheel rises towards its flange: against the track it is delta_R + roll and delta_L - roll."""

    y: Number  # (y,) m, of the wheelset's middle at the height of its axle
    rolling_radius: Number  # (y, 2) r_R, r_L, m
    contact_angle: Number  # (y, 2) delta_R, delta_L, rad
    roll: Number  # (y,) phi, rad, positive where the right side goes up
    height: Number  # (y,) m, of the wheelset's middle, downwards from the mean radius above the rails
    wheel_position: Number  # (y, 2) m from the tread datum, the field side positive
    rail_position: Number  # (y, 2) m from the rail's highest point, the field side positive
    curvature: Number  # (y, 2) 1/m, of the gap across the rail: wheel's and rail's together

    @property
    def delta_r(self) -> PerY:
        """r_R - r_L, m."""
        return self.rolling_radius[..., 0] - self.rolling_radius[..., 1]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ContactGeometry(ContactFunctions):
    """What `contact_geometry` returns: the sharp (rigid) functions, and the `smooth` ones. Prints itself; `plot`; `to_xarray`."""

    wheel_curvature: Number  # (y, 2) 1/m, convex positive
    rail_curvature: Number  # (y, 2) 1/m
    smooth: ContactFunctions  # means over the elastic contact, without jumps: what dynamics use
    profiles: tuple[tuple[WheelProfile, WheelProfile], tuple[RailProfile, RailProfile]]  # wheels and rails, (right, left)
    sides: Side
    approach: Number  # m, of wheel and rail, over which the smooth form spreads

    @property
    def half_distance(self) -> Values:
        """e, half the distance of the tread datums, m."""
        return self.sides.base[0]

    @property
    def jumps(self) -> Float[np.ndarray, "jumps"]:
        """y (m) at which a contact jumps from one place of a wheel to another, in rising order; known numbers only."""
        return self._jumps[0]

    @property
    def jump_sizes(self) -> Float[np.ndarray, "jumps"]:
        """By how much Delta r jumps there, m."""
        return self._jumps[1]

    @functools.cached_property
    def _jumps(self) -> tuple[Float[np.ndarray, "jumps"], Float[np.ndarray, "jumps"]]:
        return jumps_of(self)

    @guarded()
    def ellipses(self, load: Scalar = 50e3) -> ContactEllipse:
        """Semi-axes (m; a along the rail, b across), (y, 2), of Hertz's ellipse at the sharp contacts under the normal force `load` (N), of
        wheel and rail of steel. Where the gap is flatter than a radius of 2 m, it is taken as that."""
        return self._under(load, contact_ellipse)

    @guarded()
    def creep_coefficients(self, load: Scalar = 50e3) -> CreepCoefficients:
        """Kalker's f_11, f_33 (N), f_12 (N m), f_22 (N m^2), (y, 2), of these ellipses under the normal force `load` (N). Ellipses longer than
        10:1, as on the flange, have the coefficients of 10:1, where Kalker's table ends."""
        return self._under(load, creep_coefficients)

    def _under(self, load: Scalar, theory: Any) -> Any:
        along = self.rolling_radius / jnp.cos(self.contact_angle)
        shape = jnp.shape(along)
        load = jnp.broadcast_to(jnp.asarray(load, float), shape)
        # in jit, where the table's ends are kept instead of refused
        found = jax.jit(theory)(*(jnp.ravel(one) for one in (load, along, 1.0 / jnp.maximum(self.curvature, FLATTEST))))
        return type(found)(*(part.reshape(shape) for part in found))

    def to_xarray(self) -> "xarray.Dataset":
        """Everything over y (m) and side, with units and meanings."""
        import xarray

        def variables(found: ContactFunctions, prefix: str) -> dict[str, Any]:
            return {
                prefix + name: (("y", "side")[: np.ndim(value)], np.asarray(value), {"units": unit, "long_name": meaning})
                for name, (unit, meaning) in QUANTITIES.items()
                if (value := getattr(found, name, None)) is not None
            }

        return xarray.Dataset(
            variables(self, "") | variables(self.smooth, "smooth_"),
            {"y": ("y", np.asarray(self.y), {"units": "m", "long_name": "lateral displacement"}), "side": ["right", "left"]},
            {
                "wheels": ", ".join(wheel.name for wheel in self.profiles[0]),
                "rails": ", ".join(rail.name for rail in self.profiles[1]),
                "approach_m": float(self.approach),
                "jumps_m": self.jumps,
            },
        )

    def plot(self, axes: Any = None) -> Any:
        """The pair in contact, Delta r, angles and the places of contact, as a figure; `axes`: four of Matplotlib's, or None."""
        from .profile_plots import geometry

        return geometry(self, axes)

    def __str__(self) -> str:
        from .conicity import equivalent_conicity

        def names(pair: tuple[Any, Any]) -> str:
            return pair[0].name if pair[0].name == pair[1].name else f"{pair[0].name} (right) and {pair[1].name} (left)"

        y, delta_r = np.asarray(self.y), np.asarray(self.delta_r)
        amplitudes = [a for a in (1e-3, 2e-3, 3e-3, 4e-3, 5e-3) if a <= 0.5 * (y[-1] - y[0])]
        conicity: Any = np.asarray(equivalent_conicity(y, delta_r, np.array(amplitudes))) if amplitudes else []
        lines = [
            f"{names(self.profiles[0])} on {names(self.profiles[1])}, y from {1e3 * y[0]:g} to {1e3 * y[-1]:g} mm",
            *[f"equivalent conicity at {1e3 * a:g} mm: {c:.3f}" for a, c in zip(amplitudes, conicity, strict=True)],
        ]
        jumps = [f"{1e3 * at:.2f} mm ({1e3 * size:+.2f} mm)" for at, size in zip(*self._jumps, strict=True)]
        lines.append(f"Delta r jumps at {', '.join(jumps)}" if jumps else "no jumps of the contact")
        return "\n".join(lines)


#: name -> (unit, meaning)
QUANTITIES = {
    "delta_r": ("m", "difference of the rolling radii, right less left"),
    "rolling_radius": ("m", "rolling radius"),
    "contact_angle": ("rad", "angle of the contact plane against the axle"),
    "roll": ("rad", "roll, right side up"),
    "height": ("m", "height of the wheelset, downwards"),
    "wheel_position": ("m", "contact on the wheel, from the tread datum"),
    "rail_position": ("m", "contact on the rail, from its highest point"),
    "curvature": ("1/m", "curvature of the gap across the rail"),
    "wheel_curvature": ("1/m", "curvature of the wheel's profile, convex positive"),
    "rail_curvature": ("1/m", "curvature of the rail's profile, convex positive"),
}


@guarded(
    **PLACED,
    y=Rising(Range("m", -0.06, 0.06, why="; is it in millimetres?"), 3),
    load=positive("N"),
    approach=Range("m", 1e-6, 1e-3, why="; is it in millimetres?"),
)
def contact_geometry(
    wheel: Pair,
    rail: Pair,
    *,
    gauge: Scalar = 1.435,
    flange_back: Scalar = 1.36,
    tread_datum: Scalar = 0.07,
    radius: Scalar | tuple | list = 0.46,
    inclination: Scalar | tuple | list = 1 / 40,
    y: Float[np.ndarray, "y"] | None = None,
    load: Scalar = 50e3,
    approach: Scalar | None = None,
) -> ContactGeometry:
    """Rolling radii, contact angles, roll and places of contact of a wheelset over its lateral displacement: rigid, quasi-static.

    For each y the height and roll at which both wheels touch. Two forms: sharp, with the jumps of two-point contact, and `smooth`, the mean
    over the surface weighted by exp(-gap/epsilon), where the contact of elastic bodies spreads and passes from one place to the other. Both
    are differentiable in gauge, inclination, radii and the heights of profiles by the envelope theorem, inside `jit` and `vmap` too, which
    needs double precision. How a jump moves is not in the sharp form's derivative: take the smooth one's where there are jumps.

    Args:
        wheel: a `WheelProfile`, the name or file of one, or (right, left)
        rail: a `RailProfile`, the name or file of one, or (right, left)
        gauge: m, between the rails 14 mm below their tops
        flange_back: m, between the backs of the flanges
        tread_datum: m from the back of the flange to the tread datum, where a profile's lateral position is 0
        radius: r_0, m, at the tread datum; (right, left) for unequal wheels
        inclination: slope of the rails, dimensionless: 1/40, 1/20, or 0 where the profile is that of an inclined rail; (right, left) if they differ
        y: displacements of the wheelset's middle, m, rising, known numbers; None: -10 to 10 mm by 0.1
        load: N, normal force of a wheel from which `approach` follows if it is None
        approach: m, by which wheel and rail come nearer under load; None: Hertz's of a round contact of the wheel's radius, 62 um under 50 kN

    Raises:
        InputError: where the wheelset does not fit into the gauge, a rail does not reach 14 mm below its top, or a contact is
            beyond the end of a profile.
    """
    at = LATERAL if y is None else np.asarray(y, float)
    given = both_sides(wheel, rail, gauge, flange_back, tread_datum, radius, inclination, load, approach)
    steps = steps_to(at)
    if traced(given):
        require_double_precision("the derivative of a contact geometry, or one inside jit,")
        return _compiled(given, at, steps)
    found = _geometry(np, known(given), at, steps)
    refuse_unfit(found, float(gauge))
    return found


def both_sides(wheel: Pair, rail: Pair, *rest: Any) -> tuple:
    """The arguments of `contact_geometry` with the profiles loaded, and what is said once said for both sides."""
    gauge, flange_back, tread_datum, radius, inclination, *others = rest
    numbers = [_two_numbers(key, one) for key, one in (("radius", radius), ("inclination", inclination))]
    return (_two(wheel, WheelProfile), _two(rail, RailProfile), gauge, flange_back, tread_datum, *numbers, *others)


def steps_to(y: PerY) -> int:
    """Steps of `STEP` from the middle that lead beyond all y."""
    return int(np.ceil(np.max(np.abs(y)) / STEP - 1e-9))


def laid_out(xp: ModuleType, given: tuple) -> tuple[Side, Values]:
    """Both sides, and the approach of wheel and rail, of (wheels, rails, gauge, flange back, tread datum, radii, inclinations, load, approach)."""
    wheels, rails, gauge, flange_back, tread_datum, radii, slopes, load, approach = given
    radii, slopes = xp.stack(radii), xp.stack(slopes)
    if approach is None:
        modulus = STEEL_YOUNG / (2.0 * (1.0 - STEEL_POISSON**2))
        approach = (9.0 * load**2 / (16.0 * xp.mean(radii) * modulus**2)) ** (1.0 / 3.0)
    both, heads, tilt = xp.ones(2), _alike(xp, rails), xp.arctan(slopes)
    # of two lengths: what is there twice has no weight
    places = _stacked(xp, [wheel.searched for wheel in wheels])
    drawn = _stacked(xp, [rail.drawn for rail in rails])
    sides = Side(
        np.array([1.0, -1.0]),
        _alike(xp, wheels),
        heads,
        places,
        radii,
        xp.mean(radii) * both,
        (0.5 * flange_back + tread_datum) * both,
        tilt,
        *laid(xp, heads, drawn, tilt, gauge),
    )
    for side, rail in enumerate(rails):
        if xp is np and np.isnan(sides.outwards[side]):
            raise InputError(
                f"{rail.name}: the gauge side does not reach 14 mm below the top, where gauge is measured; the profile is too short"
            )
    return sides, approach


def _geometry(xp: ModuleType, given: tuple, y: PerY, steps: int) -> ContactGeometry:
    sides, approach = laid_out(xp, given)
    wheels, rails = given[:2]
    sharp, smooth = contacts(xp, sides, y, SPREAD * approach, steps)
    return ContactGeometry(
        **_functions(y, sharp),
        wheel_curvature=sharp.wheel_curvature.T,
        rail_curvature=sharp.rail_curvature.T,
        smooth=ContactFunctions(**_functions(y, smooth)),
        profiles=(wheels, rails),
        sides=sides,
        approach=approach,
    )


_compiled = jax.jit(functools.partial(_geometry, jnp), static_argnums=2)


def _stacked(xp: ModuleType, pair: list[Any]) -> PerY:
    longest = max(one.shape[-1] for one in pair)
    return xp.stack([xp.pad(one, [(0, 0)] * (one.ndim - 1) + [(0, longest - one.shape[-1])], mode="edge") for one in pair])


def _functions(y: PerY, found: Contacts) -> dict[str, PerY]:
    return {
        "y": y,
        "rolling_radius": found.radius.T,
        "contact_angle": found.angle.T,
        "roll": found.pose.roll,
        "height": found.pose.height,
        "wheel_position": found.position.T,
        "rail_position": found.rail_position.T,
        "curvature": found.curvature.T,
    }


def _alike(xp: ModuleType, pair: tuple[Any, Any]) -> Cubics:
    """Two tables stacked, the shorter one with straight lines beyond its end."""
    rows = [one.cubics(xp) for one in pair]
    longest = max(map(len, rows))

    def longer(own: PerY) -> PerY:
        a, b, c, d = own[-1]
        slope, beyond = b + 2.0 * c + 3.0 * d, np.arange(longest - len(own))
        straight = xp.stack([a + b + c + d + slope * beyond, slope + 0.0 * beyond], axis=-1)
        return xp.concatenate([own, xp.pad(straight, ((0, 0), (0, 2)))])

    return Cubics(
        xp.stack([one.lateral[0] for one in pair]),
        xp.stack([one.lateral[1] - one.lateral[0] for one in pair]),
        xp.stack(list(map(longer, rows))),
    )


def _two(value: Pair, kind: type) -> tuple[Any, Any]:
    pair = tuple(value) if isinstance(value, (tuple, list)) else (value,)
    loaded = tuple(kind.load(one) if isinstance(one, str) else one for one in pair)
    return loaded * 2 if len(loaded) == 1 else loaded


def _two_numbers(key: str, value: Any) -> tuple[Any, Any]:
    if not isinstance(value, (tuple, list)) and not getattr(value, "ndim", 0):
        return value, value
    if len(value) != 2:
        raise InputError(f"{key} must be a number or two, (right, left), not {len(value)}")
    return value[0], value[1]
