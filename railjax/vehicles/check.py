"""What is doubtful in a vehicle whose file is sound: its values and what follows from them, against plausible ranges."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..base.arguments import guarded
from ..base.errors import InputError, NumericalError
from ..base.precision import require_double_precision
from ..base.units import KMH
from ..model.contact.kalker import creep_coefficients
from ..model.damper import PassiveDamper
from ..model.kinematics import layout
from ..model.motion import matrices, state_matrix
from ..model.parameters import parameters
from ..model.vehicle import Vehicle
from ..simulation.step_size import largest_step
from ..stability.linear_critical import linear_critical_speed
from .ranges import RANGES, Remark

GRAVITY = 9.81
STEP = 1e-3  # s, the default of `simulate`
STANDSTILL = (1.0, 10.0 / KMH)  # m/s
RAIL_HEAD = 0.3  # m, of UIC 60


@dataclass(frozen=True)
class VehicleCheck:
    """What `check_vehicle` found: of the parameters that have a range, and of what follows from them."""

    vehicle: str
    parameters: tuple[Remark, ...]
    derived: tuple[Remark, ...]

    @property
    def warnings(self) -> tuple[Remark, ...]:
        """Those that are doubtful."""
        return tuple(entry for entry in (*self.parameters, *self.derived) if entry.doubtful)

    def as_dict(self) -> dict[str, Any]:
        """Keys "warnings" and "derived", lists of the findings' fields (SI)."""
        return {
            "warnings": [{**entry.as_dict(), "message": str(entry)} for entry in self.warnings],
            "derived": [entry.as_dict() for entry in self.derived],
        }

    def __str__(self) -> str:
        lines = [f"{self.vehicle}: {len(self.warnings) or 'no'} warning{'s' if len(self.warnings) != 1 else ''}"]
        lines += [f"  doubtful: {entry}" for entry in self.warnings]
        lines += [f"  {entry.meaning}: {entry._shown(entry.value)}" for entry in self.derived if not entry.doubtful]
        return "\n".join(lines)


@guarded()
def check_vehicle(vehicle: Vehicle, *, dynamics: bool = True) -> VehicleCheck:
    """Look a vehicle over: parameters, static deflections, weight, radii of gyration, the car body's modes, creep coefficients,
    stability from standstill, linear critical speed, and the step that RK4 holds.

    A plausible vehicle has no `warnings`. Works on one vehicle, without lanes, in double precision, and takes some seconds, most
    of them compilation for what `dynamics=False` leaves out: stability, critical speed and step. Raises `InputError` for a
    vehicle with lanes.
    """
    require_double_precision("the check")
    numbers = {path: np.asarray(getattr(getattr(vehicle, path.split(".")[0]), entry.name)) for path, entry in parameters(vehicle)}
    for path, entry in parameters(vehicle):
        if numbers[path].ndim > entry.metadata.get("axes", 0):
            raise InputError(f"{path} has lanes; check one vehicle at a time")
    with np.errstate(all="ignore"):
        found = [*_mechanical(vehicle), *_carbody_modes(vehicle), *_creep(vehicle)]
        found += _dynamic(vehicle) if dynamics else ()
    return VehicleCheck(vehicle.name, tuple(_values(vehicle)), tuple(found))


def _values(vehicle: Vehicle) -> Iterator[Remark]:
    """Parameters and their ranges; one that is zero by default may stay zero."""
    unused = _unused(vehicle)
    for path, entry in parameters(vehicle):
        if path not in RANGES or path.startswith(unused):
            continue
        low, high, why = RANGES[path]
        value = float(getattr(getattr(vehicle, path.split(".")[0]), entry.name))
        if value == 0.0 and entry.default == 0.0:
            continue
        yield Remark(path, entry.metadata["meaning"], value, low, high, entry.metadata["unit"], why)
    for part, damping in (("yaw_damper", None), ("lateral_damper", vehicle.secondary.damping_y)):
        valve = getattr(vehicle, part)
        if valve is not None and valve.blow_off_velocity is not None:
            slopes = np.divide(valve.damping_beyond, valve.damping if damping is None else damping)
            # a valve that opens for good, c_b = 0, has no second slope to be lost
            high = float(0.5 * valve.blow_off_velocity * np.sqrt(slopes or 1.0))
            why = f"wider than half of v_0{' sqrt(c_b/c)' if slopes else ''}, the smooth twin is another law"
            yield Remark(f"{part}.blow_off_width", "rounding of the blow-off", valve.blow_off_width, 0.0, high, "m/s", why)
    if vehicle.bump_stop is not None:
        travel, force = vehicle.bump_stop.travel, vehicle.bump_stop.force
        yield Remark("bump_stop.travel", "last travel", float(travel[-1]), 0.01, 0.3, "m", "some ten mm are free, then it rises")
        yield Remark("bump_stop.force", "last force", float(force[-1]), 1e3, 5e6, "N", "it stops the car body")


def _unused(vehicle: Vehicle) -> tuple[str, ...]:
    """Parameters that nothing depends on: those of held bodies, and distances of a single axle or bogie."""
    geometry = vehicle.geometry
    return (
        *(("carbody.", "geometry.carbody_height") if vehicle.carbody.held else ()),
        *(
            ("bogie.", "secondary.", "geometry.half_secondary", "geometry.bogie_to_", "primary.stiffness_z")
            if vehicle.bogie.held
            else ()
        ),
        *(("geometry.half_wheelbase",) if len(geometry.axle_pattern) == 1 else ()),
        *(("geometry.half_pivot_distance",) if len(geometry.bogie_pattern) == 1 else ()),
    )


def _mechanical(vehicle: Vehicle) -> Iterator[Remark]:
    """Weight, static deflections, radii of gyration; of what moves."""
    carbody, bogie, wheelset, load = vehicle.carbody, vehicle.bogie, vehicle.wheelset, vehicle.contact.wheel_load
    bogies, axles = len(vehicle.geometry.bogie_pattern), len(vehicle.geometry.axle_pattern)
    yield Remark(
        "contact.wheel_load", "axle load", 2.0 * load / GRAVITY, 2e3, 40e3, "kg", "two wheels; 22.5 t is usual at most (recalled)"
    )
    masses = (0.0 if carbody.held else carbody.mass) + bogies * ((0.0 if bogie.held else bogie.mass) + axles * wheelset.mass)
    share = np.divide(masses * GRAVITY, 2.0 * bogies * axles * load)
    why = "all masses times 9.81 m/s^2 rest on the wheels" + (", and what the held bodies weigh" if carbody.held else "")
    yield Remark(
        "contact.wheel_load",
        "weight of the masses over the wheels' load",
        float(share),
        0.0 if carbody.held else 0.93,
        1.07,
        "1",
        why,
    )
    radii = [("wheelset.yaw_inertia", wheelset.yaw_inertia, wheelset.mass, 0.45, 1.1, "most of the mass is in the wheels")]
    radii += (
        [("wheelset.spin_inertia", wheelset.spin_inertia, wheelset.mass, 0.1, 0.5, "within the wheel's radius")]
        if wheelset.spin_inertia
        else []
    )
    if not bogie.held:
        radii.append(("bogie.roll_inertia", bogie.roll_inertia, bogie.mass, 0.3, 1.8, "within the frame's half width, about"))
        radii.append(("bogie.yaw_inertia", bogie.yaw_inertia, bogie.mass, 0.5, 2.5, "within the frame's half length, about"))
        above = 2.0 * axles * load - axles * wheelset.mass * GRAVITY
        yield Remark(
            "primary.stiffness_z", "static deflection of the primary springs", float(np.divide(above, 2.0 * axles * vehicle.primary.stiffness_z)),
            4e-3, 0.12, "m", "under the wheel load without the wheelset; 20 to 60 mm are usual",
        )  # fmt: skip
        yield Remark(
            "secondary.stiffness_z", "static deflection of the secondary springs", float(np.divide(above - bogie.mass * GRAVITY, 2.0 * vehicle.secondary.stiffness_z)),
            0.01, 0.7, "m", "under the car body; 100 to 250 mm for coil springs, up to 0.6 m is what the stiffness of air springs would give",
        )  # fmt: skip
    if not carbody.held:
        radii.append(
            (
                "carbody.roll_inertia",
                carbody.roll_inertia,
                carbody.mass,
                0.7,
                2.2,
                "within half the car body's height and width, about",
            )
        )
        radii.append(("carbody.yaw_inertia", carbody.yaw_inertia, carbody.mass, 1.5, 12.0, "a beam of length L has L/3.5"))
    for key, inertia, mass, low, high, why in radii:
        yield Remark(
            key,
            f"radius of gyration of {key.replace('.', ', ').replace('_inertia', '')}",
            float(np.sqrt(np.divide(inertia, mass))),
            low,
            high,
            "m",
            why,
        )


def _carbody_modes(vehicle: Vehicle) -> Iterator[Remark]:
    """The car body on its secondary suspension while the bogies stand still: (lambda^2 M + lambda C + K) q = 0 of its three coordinates."""
    groups = layout(vehicle)
    if "carbody_y" not in groups:
        return
    found = matrices(vehicle, 1.0)
    start = 0
    rows: list[int] = []
    for group, shape in groups.items():
        count = int(np.prod(shape))
        rows += range(start, start + count) if group.startswith("carbody") else ()
        start += count
    mass, damping, stiffness = (np.asarray(matrix)[np.ix_(rows, rows)] for matrix in (found.mass, found.damping, found.stiffness))
    n = len(rows)
    try:
        inverse = np.linalg.inv(mass)
        values, vectors = np.linalg.eig(np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ stiffness, -inverse @ damping]]))
    except np.linalg.LinAlgError:  # singular, or not finite
        yield Remark(
            "carbody", "frequency of the car body's modes", math.nan, 0.2, 4.0, "Hz", "its matrices are beyond floating point"
        )
        return
    energy = np.abs(vectors[:n]) ** 2 * np.diag(mass)[:, None]
    # the yaw mode is damped by yaw dampers at will
    braced = vehicle.yaw_damper is not None or vehicle.secondary.damping_x > 0.0
    for k in np.flatnonzero(values.imag >= 0.0):
        value, of_yaw = values[k], np.argmax(energy[:, k]) == 1
        name = ("sway", "yaw", "roll")[int(np.argmax(energy[:, k]))]
        if value.imag == 0.0 and of_yaw and braced:
            continue
        frequency, ratio = abs(value) / (2.0 * math.pi), -value.real / max(abs(value), 1e-300)
        yield Remark(
            "secondary",
            f"natural frequency of the car body's {name}",
            frequency,
            0.2,
            4.0,
            "Hz",
            "on the secondary suspension, the bogies at rest; 0.4 to 1.5 Hz are usual",
        )
        high = 2.0 if of_yaw and braced else 0.8
        yield Remark(
            "secondary",
            f"damping ratio of the car body's {name}",
            ratio,
            0.03,
            high,
            "1",
            "on the secondary suspension, the bogies at rest; 0.1 to 0.5 are usual",
        )


def _creep(vehicle: Vehicle) -> Iterator[Remark]:
    """Creep coefficients over those of Kalker for the wheel load on a usual rail head."""
    contact = vehicle.contact
    try:
        kalker = creep_coefficients(contact.wheel_load, vehicle.wheelset.wheel_radius, RAIL_HEAD)._asdict()
    except RuntimeError:  # no ellipse in floating point: load or radius are in the warnings
        return
    for name, low, high in (
        ("creep_longitudinal", 0.3, 2.0),
        ("creep_lateral", 0.3, 2.0),
        ("creep_lateral_spin", 0.1, 5.0),
        ("creep_spin", 0.1, 10.0),
    ):
        value = float(getattr(contact, name))
        if value == 0.0 and "spin" in name:
            continue
        yield Remark(
            f"contact.{name}", f"{name.replace('_', ' ')} coefficient over Kalker's", float(np.divide(value, float(kalker[name]))), low, high, "1",
            "Kalker's linear theory for this wheel load on a rail head of 300 mm radius, less with contaminated rails",
        )  # fmt: skip


def _dynamic(vehicle: Vehicle) -> Iterator[Remark]:
    """Stability from standstill, critical speed, step of the integration."""
    for speed in STANDSTILL:
        matrix = np.asarray(state_matrix(vehicle, speed))
        try:
            values = np.linalg.eigvals(matrix)
            growth = float(np.max(values.real))
            growth = 0.0 if abs(growth) <= 1e-9 * np.max(np.abs(values)) else growth  # rigid-body modes
        except np.linalg.LinAlgError:  # not finite, or no convergence
            growth = math.nan
        if not growth <= 0.0:
            why = "straight running is unstable at walking pace; look for a stiffness that is missing or for units"
            yield Remark(
                "vehicle", f"growth of the least damped mode at {speed * KMH:.1f} km/h", growth, -math.inf, 0.0, "1/s", why
            )
            return
    why = "where straight running gets unstable; 200 km/h and more are usual, much less means soft axle guidance or high conicity"
    try:
        critical = float(linear_critical_speed(vehicle)) * KMH
        yield Remark("vehicle", "linear critical speed", critical, 90.0, math.inf, "km/h", why)
    except NumericalError as error:
        if "stable up to" not in str(error):
            yield Remark("vehicle", "linear critical speed", math.nan, 90.0, math.inf, "km/h", str(error))
    low, high = 0.1, 100.0
    for _ in range(20):
        middle = math.sqrt(low * high)
        low, high = (low, middle) if float(largest_step(vehicle, middle, PassiveDamper())) >= STEP else (middle, high)
    why = "below it simulate refuses its default step of 1 ms and wants a smaller dt; creep damping grows as 1/v, and stiff dampers on light parts do it at any speed"
    yield Remark("vehicle", "speed from which RK4 holds steps of 1 ms", high * KMH, 0.0, 45.0, "km/h", why)
