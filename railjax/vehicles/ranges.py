"""Plausible ranges of a vehicle's parameters, and a number beside its range.

The ranges are assumed (generous ones around what textbooks and the packaged vehicles have), but for those that say "recalled".
A value outside of its range is no error: it is worth a second look, first of all at its unit.
"""

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

from ..base.units import handy

#: parameter -> plausible range (SI) and why it is one
RANGES: dict[str, tuple[float, float, str]] = {
    "carbody.mass": (5e3, 120e3, "from an empty four-wheel wagon to a loaded freight wagon"),
    "bogie.mass": (500.0, 12e3, "from a light trailer bogie to a locomotive's"),
    "wheelset.mass": (500.0, 4e3, "with its axle boxes, brake discs or gear"),
    "wheelset.wheel_radius": (0.2, 0.7, "from rolling highways to locomotives"),
    "primary.stiffness_x": (50e3, 200e6, "from coil springs without axle guidance to stiff traction rods"),
    "primary.stiffness_y": (50e3, 100e6, "from coil springs without axle guidance to stiff guidance"),
    "primary.stiffness_z": (100e3, 20e6, "it carries the vehicle's weight"),
    "primary.damping_x": (10.0, 1e6, "rubber has some kN s/m"),
    "primary.damping_y": (10.0, 1e6, "rubber has some kN s/m"),
    "primary.damping_z": (100.0, 1e6, "dampers have some kN s/m to some ten"),
    "secondary.stiffness_x": (10e3, 20e6, "air springs and flexi-coils have 0.1 to 0.3 MN/m, a yaw spring more"),
    "secondary.stiffness_y": (10e3, 5e6, "air springs and flexi-coils have 0.1 to 0.5 MN/m"),
    "secondary.stiffness_z": (50e3, 10e6, "it carries the car body's weight"),
    "secondary.damping_x": (1e3, 20e6, "yaw dampers have 0.1 to 5 MN s/m"),
    "secondary.damping_y": (1e3, 500e3, "lateral dampers have some ten kN s/m"),
    "secondary.damping_z": (1e3, 500e3, "vertical dampers have some ten kN s/m"),
    "secondary.anti_roll_stiffness": (10e3, 20e6, "anti-roll bars have some MN m/rad"),
    "yaw_damper.damping": (10e3, 50e6, "0.1 to 5 MN s/m up to blow-off"),
    "yaw_damper.half_distance": (0.7, 1.7, "at the bogie frame's side"),
    "yaw_damper.blow_off_velocity": (1e-3, 0.2, "about 0.01 m/s"),
    "yaw_damper.series_stiffness": (0.5e6, 100e6, "rubber ends and brackets have 5 to 10 MN/m"),
    "lateral_damper.blow_off_velocity": (5e-3, 1.0, "about 0.1 m/s"),
    "cross_bracing.shear_stiffness": (0.1e6, 200e6, "braces have 1 to 20 MN/m"),
    "geometry.half_wheelbase": (0.5, 3.5, "from a tram's bogie to a six-axle locomotive's"),
    "geometry.half_pivot_distance": (1.5, 14.0, "from a short wagon to a long coach"),
    "geometry.half_gauge": (0.3, 0.9, "from narrow to Indian gauge, and half a rail head; 0.72 to 0.75 m on 1435 mm"),
    "geometry.half_primary": (0.3, 1.4, "at the axle boxes, inside or outside of the wheels"),
    "geometry.half_secondary": (0.3, 1.7, "within the width of a car body"),
    "geometry.carbody_height": (0.05, 2.5, "the car body's centre of gravity lies above its suspension"),
    "geometry.bogie_to_primary": (-0.5, 0.7, "the bogie frame lies about the height of the axles"),
    "geometry.bogie_to_secondary": (-0.7, 1.0, "from the bogie's centre to the secondary springs' middle"),
    "contact.conicity": (
        0.01,
        0.6,
        "1/40 for new cones, 0.1 to 0.4 for worn wheels",
    ),
    "contact.wheel_load": (10e3, 200e3, "half an axle load of 2 to 40 t; 11.25 t on a wheel is usual at most (recalled)"),
    "contact.friction": (0.05, 0.7, "0.1 on wet, 0.3 to 0.5 on dry rails"),
    "contact.flange_stiffness": (1e6, 100e6, "the rail's lateral stiffness, 10 to 50 MN/m; 14.6 is usual for this model"),
    "contact.flange_clearance": (
        2e-3,
        20e-3,
        "1435 mm gauge against 1410 to 1426 mm over the flanges leaves 4.5 to 12.5 mm, and 20 with widened gauge (EN 13848, EN 15313; recalled)",
    ),
    "contact.creep_width": (1e-5, 0.2, "a rounding of the saturation should be narrow"),
    "contact.flange_width": (1e-7, 1e-3, "a rounding of the flange's corner should be narrow against the clearance"),
}


@dataclass(frozen=True)
class Remark:
    """A number (SI) that may or may not lie within its plausible range, and why that is one. NaN where there is no such number."""

    key: str
    meaning: str
    value: float
    low: float
    high: float
    unit: str
    why: str

    @property
    def doubtful(self) -> bool:
        """Outside of the range, or no number."""
        return not self.low <= self.value <= self.high

    def _shown(self, value: float) -> str:
        suffix, factor = handy(value, self.unit)
        return f"{value / factor:.4g} {suffix.replace('_per_', '/')}".strip()

    def __str__(self) -> str:
        low, high = self._shown(self.low), self._shown(self.high)
        ends = f"at least {low}" if self.high == math.inf else f"at most {high}" if self.low == -math.inf else f"{low} to {high}"
        text = f"{self.key}: {self.meaning} {self._shown(self.value)}, plausible {ends}: {self.why}"
        for factor, word in ((1e3, "small"), (1e-3, "large")):
            if self.doubtful and self.low <= self.value * factor <= self.high and self.unit not in ("1", "km/h"):
                text += f" - a thousand times too {word}? look at the unit"
        return text

    def as_dict(self) -> dict[str, Any]:
        """The fields by name, for JSON."""
        return dataclasses.asdict(self)
