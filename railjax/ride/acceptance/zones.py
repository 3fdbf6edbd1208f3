"""Running behaviour by test zones: straight track and curves of a layout, each with its sections, statistics and limits (EN 14363, UIC 518)."""

import dataclasses
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...base.arguments import guarded
from ...base.errors import InputError
from ...model.kinematics import bogie_positions, layout, wheelset_positions
from ...model.track.curve import CANT_BASE, GRAVITY
from ...model.track.layout import Layout
from ...model.vehicle import Vehicle
from ...simulation.channels import has_wheels
from ...simulation.simulate import Simulation
from .assess import MARGIN, Frame, assessed, check_margin, default_section, given_of, of_vehicle
from .criteria import ZONES, Zone
from .record import RunningRecord, acceptance_channels, check_record, record_of_run
from .result import Acceptance, table_of

#: m; radius beyond which track counts as straight
STRAIGHT = 20e3


class Stretch(NamedTuple):
    """Straight track or an arc between transitions, without half the vehicle's length at either end."""

    zone: int | None  # None: of no zone, as an arc below 250 m
    radius: float  # m, infinite for straight track
    start: float  # m from the start of the run
    end: float  # m
    cant: float  # of the outer rail, m


@dataclass(frozen=True)
class ZoneAcceptance:
    """Result of `zone_acceptance`: an `Acceptance` for each zone of which the run has sections, and the stretches that they lie in."""

    zones: dict[int, Acceptance]  # by number of the zone, dimensionless
    stretches: tuple[Stretch, ...]
    notes: tuple[str, ...]

    @property
    def verdict(self) -> Any:
        """Over all zones in the run: "exceeded" if any is, "met" if all are; one per lane."""
        each = np.array([found.verdict for found in self.zones.values()])
        met = np.where((each == "met").all(axis=0), "met", "not determined")
        return np.where((each == "exceeded").any(axis=0), "exceeded", met)

    def __str__(self) -> str:
        lines = []
        for number, found in self.zones.items():
            lines += [f"Zone {number}, {ZONES[number].name}{self._curves(number)}", table_of(found)]
        notes = dict.fromkeys(note for found in self.zones.values() for note in found.notes())
        return "\n".join([*lines, *(f"  {note}" for note in (*self.notes, *notes))])

    def _curves(self, number: int) -> str:
        radii = [stretch.radius for stretch in self.stretches if stretch.zone == number and np.isfinite(stretch.radius)]
        return f", R {min(radii):.0f} to {max(radii):.0f} m" if radii else ""

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers and texts for JSON, SI units."""
        zones = {str(number): {"name": ZONES[number].name, **found.as_dict()} for number, found in self.zones.items()}
        return {"zones": zones, "verdict": self.verdict.tolist(), "notes": list(self.notes)}


@guarded()
def zone_acceptance(
    vehicle: Vehicle,
    run: Simulation,
    layout: Layout,
    *,
    prudhomme_factor: float = 1.0,
    margin: float = MARGIN,
    minimum_sections: int | None = None,
) -> ZoneAcceptance:
    """Assess a run over a layout in the manner of EN 14363 for its test zones: 1 straight, 2 R of 600 m and more, 3 from 400, 4 from 250 m.

    Sections of 250 m (500 beyond 220 km/h), 100, 100 and 70 m are cut out of straight track and full arcs; transitions are left out. Each
    zone has its criteria and limits: ΣY, Y/Q, accelerations of bogies and car body by percentiles and x_mean + k s; in curves the
    quasi-static acceleration of the car body and, of small radii, the guiding force Y of a wheel by medians (k = 0) against 30 kN + 10500
    kN m/R_m; the instability criterion on straight track and in large radii. Accelerations are those that instruments on the bodies feel,
    with g times their roll. Forces of single wheels (Y, Y/Q) are those of vehicles on profiles; vertical dynamics is left out.

    Args:
        vehicle: the vehicle that ran.
        run: at constant speed, with `acceptance_channels(vehicle, curves=True)` recorded at 200 Hz or more.
        layout: the line that it ran on.
        prudhomme_factor: α of the limit α (10 kN + P/3), dimensionless: 1, for wagons 0.85.
        margin: at either end, s, filtered but not assessed.
        minimum_sections: number of sections below which a zone is not determined; by default 25, in zone 3 it is 50.

    Raises:
        InputError: for a run with a `SpeedProfile`, channels that are missing, a sampling rate below 200 Hz, and a run without a section.
    """
    check_margin(margin)
    record = in_curves(vehicle, run, layout)
    signals, lanes, ok = check_record(record)
    given = given_of(signals, lanes, **of_vehicle(vehicle), prudhomme_factor=prudhomme_factor)
    speeds = np.broadcast_to(np.asarray(record.speed, float), (lanes,))
    samples = len(next(iter(signals.values())))
    lasts = speeds * samples / record.sampling_rate
    stretches = stretches_of(vehicle, layout, float(np.max(lasts)))
    zones, notes = {}, []
    for number, zone in ZONES.items():
        frames = [
            _frame(zone, number, stretches, record.sampling_rate, float(v), margin, float(last))
            for v, last in zip(speeds, lasts, strict=True)
        ]
        if not any(len(frame.starts) for frame in frames):
            notes.append(f"Zone {number}, {zone.name}: no section of {frames[0].length:g} m in the run; not assessed.")
            continue
        radii = [stretch.radius for stretch in stretches if stretch.zone == number]
        least = zone.sections if minimum_sections is None else minimum_sections
        sound = ok & np.array([len(frame.starts) > 0 for frame in frames])
        found = assessed(
            signals, sound, frames, given._replace(radius=float(np.mean(radii))), zone.criteria, None, least, record.name
        )
        zones[number] = found if record.lanes else found.lane(0)
    if not zones:
        raise InputError("layout: the run holds no section of any zone; run longer, or on longer arcs")
    sharp = [stretch.radius for stretch in stretches if stretch.zone is None]
    notes += [f"R {min(sharp):.0f} m is below 250 m and of no zone; not assessed."] if sharp else []
    for stretch in stretches:
        if stretch.zone not in (None, 1):
            deficiency = CANT_BASE / GRAVITY * np.max(speeds) ** 2 / stretch.radius - stretch.cant
            notes.append(
                f"Arc of {stretch.radius:.0f} m from {stretch.start:.0f} to {stretch.end:.0f} m: cant deficiency {1e3 * deficiency:.0f} mm at the highest speed."
            )
    return ZoneAcceptance(zones, stretches, tuple(notes))


def in_curves(vehicle: Vehicle, run: Simulation, line: Layout) -> RunningRecord:
    """What instruments on the bodies would have measured: in arcs v² kappa - g theta, and g times the roll, beside the motion in the frame
    of the line. Raises `InputError` where a channel is missing."""
    missing = [name for name in acceptance_channels(vehicle, curves=True) if name not in run.channels]
    if missing:
        raise InputError(
            f"the run lacks {', '.join(missing)}: simulate with record=railjax.acceptance_channels(vehicle, curves=True)"
        )
    record, groups = record_of_run(vehicle, run), layout(vehicle)
    body, bogie = record.carbody_acceleration, record.bogie_acceleration
    if body is not None and "carbody_phi" in groups:
        body = body + GRAVITY * jnp.asarray(run["carbody_phi"])[:, None]
    if bogie is not None:
        speed = jnp.asarray(run.speed)
        time = jnp.asarray(run.time).reshape((-1,) + (1,) * (1 + speed.ndim))
        like = jnp.zeros((len(vehicle.geometry.bogie_pattern), len(vehicle.geometry.axle_pattern), *speed.shape))
        kappa, theta = line.at(speed * time + jnp.broadcast_to(bogie_positions(vehicle, like), (like.shape[0], *speed.shape)))
        felt = speed**2 * kappa - GRAVITY * theta
        felt = felt.reshape(felt.shape + (1,) * (1 + bogie.ndim - 1 - felt.ndim)) if felt.ndim < bogie.ndim else felt
        if "bogie_phi" in groups:
            felt = felt + GRAVITY * jnp.asarray(run["bogie_phi"])
        bogie = bogie + jnp.repeat(felt, like.shape[1], axis=1)
    wheels = jnp.asarray(run["wheel_lateral_force"]) if has_wheels(vehicle) else None
    return dataclasses.replace(record, carbody_acceleration=body, bogie_acceleration=bogie, wheel_lateral_force=wheels)


def stretches_of(vehicle: Vehicle, line: Layout, length: float) -> tuple[Stretch, ...]:
    """Straight track and arcs of the first metres of a line.

    Args:
        vehicle: gives its length.
        line: whose transitions part them.
        length: of the run, m.
    """
    shape = len(vehicle.geometry.bogie_pattern), len(vehicle.geometry.axle_pattern)
    half = float(np.max(np.abs(wheelset_positions(vehicle, jnp.zeros(shape)))))
    turns = line.transitions()
    found = []
    for start, end in zip((0.0, *(last for _, last in turns)), (*(first for first, _ in turns), length), strict=True):
        first, last = (start + half if start > 0.0 else 0.0), min(end - half, length)
        if last <= first:
            continue
        kappa, theta = (float(value) for value in line.at(0.5 * (first + last)))
        radius = 1.0 / abs(kappa) if abs(kappa) > 1.0 / STRAIGHT else np.inf
        cant = CANT_BASE * theta * (np.sign(kappa) if np.isfinite(radius) else 1.0)
        found.append(Stretch(_zone_of(radius), radius, first, last, float(cant)))
    return tuple(found)


def _zone_of(radius: float) -> int | None:
    if not np.isfinite(radius):
        return 1
    return next((number for number, zone in ZONES.items() if zone.radii[0] <= radius < zone.radii[1]), None)


def _frame(
    zone: Zone, number: int, stretches: tuple[Stretch, ...], rate: float, speed: float, margin: float, length: float
) -> Frame:
    """The sections of a zone in a run of so many m."""
    step = float(default_section(speed)) if zone.section is None else zone.section
    own = [
        (max(stretch.start, margin * speed) - margin * speed, min(stretch.end, length - margin * speed) - margin * speed)
        for stretch in stretches
        if stretch.zone == number
    ]
    starts: list[Float[np.ndarray, sections]] = [
        first + step * np.arange(max(int((last - first) / step + 1e-9), 0)) for first, last in own
    ]
    at = np.concatenate([*starts, np.zeros(0)])
    return Frame(rate, speed, margin, step, at, at + step, tuple(own))
