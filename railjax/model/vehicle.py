"""The vehicle: nested parameter pytrees in SI units, with the paper's symbols (Table 1).

Every number is a leaf: a float, or an array with one value per lane of a batch (trailing axis). Structure (how many
bogies and axles, which bodies are held, which laws act) is static. Nothing is validated here, because JAX rebuilds
pytrees with tracers and placeholders; `vehicles.files` validates at the file's boundary, `consistency` where a vehicle is used.

Springs and dampers are per side: a bogie has two secondary corners, a wheelset two axle boxes.
"""

import dataclasses
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

import jax

from ..base.fields import LAWS, optional, parameter, structure, table
from ..base.typing import Number

HELD = "true: it does not move, and its mass and inertias are not needed"


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class CarBody:
    """Car body: lateral y_c, yaw psi_c, roll phi_c. Typical: 25 to 45 t."""

    mass: Number = parameter("kg", "m_c", "car body mass", positive=True)
    roll_inertia: Number = parameter("kg m^2", "I_cx", "car body roll inertia", positive=True)
    yaw_inertia: Number = parameter("kg m^2", "I_cz", "car body yaw inertia", positive=True)
    held: bool = structure(False, HELD)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Bogie:
    """Bogie frame: lateral y_b, yaw psi_b, roll phi_b. Typical: 2 to 4 t."""

    mass: Number = parameter("kg", "m_b", "bogie frame mass", positive=True)
    roll_inertia: Number = parameter("kg m^2", "I_bx", "bogie frame roll inertia", positive=True)
    yaw_inertia: Number = parameter("kg m^2", "I_bz", "bogie frame yaw inertia", positive=True)
    held: bool = structure(False, HELD)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Wheelset:
    """Wheelset: lateral y_i, yaw psi_i. Table 1 lists I_oy and I_ox; they are the yaw and the spin inertia (reading 3)."""

    mass: Number = parameter("kg", "m_o", "wheelset mass", positive=True)
    yaw_inertia: Number = parameter("kg m^2", "I_oy", "wheelset yaw inertia", positive=True)
    wheel_radius: Number = parameter("m", "r_0", "nominal rolling radius", positive=True)
    spin_inertia: Number = parameter("kg m^2", "I_ox", "wheelset spin inertia (gyroscopic terms only)", 0.0)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class PrimarySuspension:
    """Axle suspension, per axle box. Typical: 1 to 40 MN/m longitudinally, 1 to 10 laterally, 0.5 to 1.5 vertically."""

    stiffness_x: Number = parameter("N/m", "k_ox", "primary longitudinal stiffness")
    stiffness_y: Number = parameter("N/m", "k_oy", "primary lateral stiffness")
    stiffness_z: Number = parameter("N/m", "k_oz", "primary vertical stiffness")
    damping_x: Number = parameter("N s/m", "rho_ox", "primary longitudinal damping", 0.0)
    damping_y: Number = parameter("N s/m", "rho_oy", "primary lateral damping", 0.0)
    damping_z: Number = parameter("N s/m", "rho_oz", "primary vertical damping", 0.0)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SecondarySuspension:
    """Central suspension, per side of a bogie; damping_x is the yaw damper. The anti-roll bar is per bogie."""

    stiffness_x: Number = parameter("N/m", "k_cx", "secondary longitudinal stiffness")
    stiffness_y: Number = parameter("N/m", "k_cy", "secondary lateral stiffness")
    stiffness_z: Number = parameter("N/m", "k_cz", "secondary vertical stiffness")
    damping_x: Number = parameter("N s/m", "rho_cx", "secondary longitudinal (yaw) damping", 0.0)
    damping_y: Number = parameter("N s/m", "rho_cy", "secondary lateral damping", 0.0)
    damping_z: Number = parameter("N s/m", "rho_cz", "secondary vertical damping", 0.0)
    anti_roll_stiffness: Number = parameter("N m/rad", "k_ar", "anti-roll bar stiffness", 0.0)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class YawDamper:
    """Yaw dampers (longitudinal, between car body and bogie), one a side, at ±`half_distance`.

    Their valves blow off at `blow_off_velocity`, and rubber ends and bracket give way with `series_stiffness` (Maxwell
    element: one internal state per bogie, the dashpot's elongation). Without the former they are linear, without the latter
    rigidly held. Typical: 0.3 to 5 MN s/m up to 0.01 m/s and 10 to 50 kN s/m beyond, on 5 to 10 MN/m.

    The rounding of the smooth twin reaches the whole law where the two slopes are far apart: keep `blow_off_width` well
    below v_0 √(c_b/c).
    """

    damping: Number = parameter("N s/m", "c_y", "yaw damper's damping up to blow-off", positive=True)
    half_distance: Number = parameter("m", "d_y", "half the lateral distance of the yaw dampers", positive=True)
    blow_off_velocity: Number = optional("m/s", "v_0", "velocity at which the yaw damper blows off", positive=True)
    damping_beyond: Number = optional("N s/m", "c_b", "yaw damper's damping beyond blow-off")
    series_stiffness: Number = optional("N/m", "k_y", "stiffness in series with the yaw damper", positive=True)
    blow_off_width: Number = parameter("m/s", "", "smooth twin: rounding of the blow-off's corners", 1e-4)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class LateralDamper:
    """What sets the secondary lateral dampers (`secondary.damping_y`) apart: blow-off, and points away from the springs.

    Heights as those of the springs in `Geometry`; None is the springs' own. With either given, the damper has a travel of its
    own, which is also that of a controlled damper in its place. The blow-off belongs to the passive damper. Typical: blow-off
    at 0.1 to 0.2 m/s.
    """

    blow_off_velocity: Number = optional("m/s", "v_0", "velocity at which the lateral damper blows off", positive=True)
    damping_beyond: Number = optional("N s/m", "c_b", "lateral damper's damping beyond blow-off")
    carbody_height: Number = optional("m", "h_cd", "car body centre above the lateral damper", signed=True)
    bogie_to_damper: Number = optional("m", "h_bd", "bogie centre to the lateral damper", signed=True)
    blow_off_width: Number = parameter("m/s", "", "smooth twin: rounding of the blow-off's corners", 1e-3)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class BumpStop:
    """Lateral bump stops of a bogie at the height of the secondary springs: force (N, per bogie) over travel (m).

    Straight lines through (0, 0) and the table's points, travel positive and rising; odd; the last slope goes on. Typical:
    free for 20 to 30 mm, then progressive.
    """

    travel: Number = table("m", "", "travels of the bump stop's table")
    force: Number = table("N", "", "forces of the bump stop's table")
    width: Number = parameter("m", "", "smooth twin: rounding of the table's corners", 1e-4)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class CrossBracing:
    """Passive radial steering: the two wheelsets of a bogie tied to each other instead of to the frame (Scheffel; Wickens).

    The shear stiffness, that of the diagonal braces, holds them in line, y_1 - y_2 - a (psi_1 + psi_2); the bending stiffness
    holds them parallel, psi_1 - psi_2, and is what a curve works against. Shear steadies a bogie whose primary springs are soft
    enough to let its wheelsets take the curve's radius. Typical: 1 to 20 MN/m in shear, little in bending.
    """

    shear_stiffness: Number = parameter("N/m", "k_s", "cross bracing's shear stiffness")
    bending_stiffness: Number = parameter("N m/rad", "k_b", "cross bracing's bending stiffness", 0.0)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Geometry:
    """Half distances, heights and the layout: pattern (1, -1) is two bogies (axles) at +l and -l (+a and -a),
    (1, 0, -1) three axles in a bogie, (0,) a single one. Leading ones first. The secondary vertical dampers stand with the
    springs unless `half_vertical_damper` says otherwise; `carbody_to_floor` is where the floor's acceleration is recorded."""

    half_wheelbase: Number = parameter("m", "a", "half the bogie's wheelbase")
    half_pivot_distance: Number = parameter("m", "l", "half the distance between bogies")
    half_gauge: Number = parameter("m", "e", "half the distance between the contact points", positive=True)
    half_primary: Number = parameter("m", "d_o", "half the lateral distance of the primary springs")
    half_secondary: Number = parameter("m", "d_c", "half the lateral distance of the secondary springs")
    carbody_height: Number = parameter("m", "h_cc", "car body centre above the secondary suspension", signed=True)
    bogie_to_primary: Number = parameter("m", "h_ob", "bogie centre to the axle suspension", signed=True)
    bogie_to_secondary: Number = parameter("m", "h_cb", "bogie centre to the secondary suspension", signed=True)
    half_vertical_damper: Number = optional("m", "d_v", "half the lateral distance of the secondary vertical dampers")
    carbody_to_floor: Number = optional("m", "h_cf", "car body centre above the floor")
    bogie_pattern: tuple[float, ...] = structure((1.0, -1.0), "where the bogies are, from front to rear, in half pivot distances")
    axle_pattern: tuple[float, ...] = structure((1.0, -1.0), "where a bogie's axles are, in half wheelbases")


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Contact:
    """Wheel-rail contact, creep coefficients per wheel (Kalker's f_ij), flange per wheelset.

    `law` is "sharp" (Vermeulen-Johnson saturation and dead band as published, for reporting), "smooth" (their twins,
    rounded within `creep_width` and `flange_width`, for gradients through the kinks) or "linear" (Kalker's linear
    creep, no flange: the model of eqs. (2)-(4)).
    """

    creep_longitudinal: Number = parameter("N", "f_11", "longitudinal creep coefficient")
    creep_lateral: Number = parameter("N", "f_33", "lateral creep coefficient")
    conicity: Number = parameter("1", "lambda", "effective conicity", signed=True)
    wheel_load: Number = parameter("N", "Q", "load on one wheel", positive=True)
    friction: Number = parameter("1", "mu", "coefficient of friction", positive=True)
    flange_stiffness: Number = parameter("N/m", "k_f", "flange-rail stiffness")
    flange_clearance: Number = parameter("m", "delta", "half width of the flange's dead band")
    creep_lateral_spin: Number = parameter("N m", "f_12", "lateral/spin creep coefficient", 0.0)
    creep_spin: Number = parameter("N m^2", "f_22", "spin creep coefficient", 0.0)
    creep_width: Number = parameter("1", "", "smooth twin: rounding of u at zero creep", 0.01)
    flange_width: Number = parameter("m", "", "smooth twin: rounding of the dead band's corners", 1e-4)
    law: Literal["sharp", "smooth", "linear"] = structure("sharp", '"sharp", "smooth" or "linear"', (*LAWS, "linear"))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Profiles:
    """Wheel and rail profiles as the equations of motion read them: functions of a wheelset's displacement y on its track, in rows of
    cubics at equal steps. `contact.profile_table` makes it, and `contact.profile_contact` says what the rows hold and reads them."""

    start: Number  # m, of the table
    step: Number  # m
    rows: Number = field(metadata={"axes": 3})  # (intervals, powers of (y - y_i)/step from 0 on, functions), SI
    rest: Number  # m; y of straight running, 0 where both sides are alike
    steepest: Number  # m; y where the lateral force rises most: what bounds the step of RK4
    last: Number  # m; displacement beyond which functions stay as they are and the rail's stiffness k_f acts alone
    given: tuple[tuple[str, Any], ...] = structure(())  # what they were made of, as in [contact.profiles] of a vehicle file

    def __str__(self) -> str:
        given = dict(self.given)
        pairs = [given.get(key, "?") for key in ("wheel", "rail")]
        wheel, rail = (one if isinstance(one, str) else " and ".join(one) for one in pairs)
        slope, gauge = given.get("inclination"), given.get("gauge_mm")
        inclined = f" 1:{slope:g}" if isinstance(slope, float) and slope else ""
        return f"{wheel} on {rail}{inclined}" + (f", gauge {gauge:g} mm" if gauge is not None else "")


@dataclass(frozen=True)
class Provenance:
    """Where a parameter's value comes from: `status` is "published", "recalled", "assumed" or "calibrated"; "tuned" where `tune` chose it."""

    parameter: str
    status: str
    note: str


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Vehicle:
    """One car body on n bogies of m axles each.

    Yaw dampers, bump stops, cross bracing and what is special about the lateral dampers are None where there are none. `gyroscopic` adds the
    spin-yaw coupling of the wheelsets, `gravitational` the contact's gravitational stiffness; both are off for the paper's
    coach, which does not state them. `profiles` take the place of the constant conicity, with its gravitational stiffness and the
    flange: `with_profiles` gives a vehicle such.
    """

    carbody: CarBody
    bogie: Bogie
    wheelset: Wheelset
    primary: PrimarySuspension
    secondary: SecondarySuspension
    geometry: Geometry
    contact: Contact
    yaw_damper: YawDamper | None = None
    lateral_damper: LateralDamper | None = None
    bump_stop: BumpStop | None = None
    cross_bracing: CrossBracing | None = None
    profiles: Profiles | None = None
    gyroscopic: bool = structure(False, "spin-yaw coupling of the wheelsets")
    gravitational: bool = structure(False, "the contact's gravitational stiffness")
    name: str = structure("")
    note: str = structure("")
    provenance: tuple[Provenance, ...] = structure(())

    def __str__(self) -> str:
        bogies, axles = len(self.geometry.bogie_pattern), len(self.geometry.axle_pattern)
        held = [part for part in ("carbody", "bogie") if getattr(self, part).held]
        doubtful = [f"{p.parameter} ({p.status})" for p in self.provenance if p.status != "published"]
        lines = [f"Vehicle {self.name or '(unnamed)'}: {bogies} bogie(s) of {axles} axle(s), {self.contact.law} contact"]
        lines += [f"  held: {', '.join(held)}"] if held else []
        lines += [f"  with {', '.join(self._elements())}"] if self._elements() else []
        lines += [f"  profiles: {self.profiles}"] if self.profiles is not None else []
        lines += [f"  not from the source: {', '.join(doubtful)}"] if doubtful else []
        return "\n".join(lines)

    def _elements(self) -> list[str]:
        """The optional parts that are there, in words."""
        found = []
        if self.yaw_damper is not None:
            traits = {"blow-off": self.yaw_damper.blow_off_velocity, "series stiffness": self.yaw_damper.series_stiffness}
            special = " and ".join(name for name, value in traits.items() if value is not None)
            found.append("yaw dampers" + (f" ({special})" if special else ""))
        if self.lateral_damper is not None:
            special = " with blow-off" if self.lateral_damper.blow_off_velocity is not None else " at heights of their own"
            found.append("lateral dampers" + special)
        if self.bump_stop is not None:
            found.append("bump stops")
        if self.cross_bracing is not None:
            found.append("cross bracing")
        return found


#: part of a vehicle whose numbers are parameters -> its class; a vehicle may do without those in OPTIONAL
PARTS: dict[str, type] = {
    f.name: next(kind for kind in (f.type, *get_args(f.type)) if dataclasses.is_dataclass(kind))  # type: ignore[misc]
    for f in dataclasses.fields(Vehicle)
    if not f.metadata.get("static") and f.name != "profiles"
}
OPTIONAL = tuple(f.name for f in dataclasses.fields(Vehicle) if f.name in PARTS and f.default is None)
