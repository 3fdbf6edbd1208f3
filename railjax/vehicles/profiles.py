"""[contact.profiles] of vehicle files: which wheel runs on which rail, and how they lie."""

import dataclasses
import functools
import os
from pathlib import Path
from typing import Any

from ..base.checks import shown
from ..base.errors import InputError, nearest
from ..base.fields import given_number
from ..model.contact.profile_table import with_profiles
from ..model.contact.profiles import RailProfile, WheelProfile
from ..model.vehicle import Vehicle
from .values import Table

#: key -> what it is
PROFILE_KEYS = {
    "wheel": "S1002 or a file; [right, left] if they differ",
    "rail": "60E1, 60E2, UIC60-Manchester or a file; [right, left] if they differ",
    "inclination": "of the rails, 40 for 1:40, 0 for none",
    "gauge_mm": "14 mm below the rails' tops",
    "flange_back_mm": "between the backs of the flanges",
    "tread_datum_mm": "from the back of the flange to the tread datum",
    "wheel_diameter_mm": "at the tread datum; [right, left] if they differ; else twice wheelset.wheel_radius",
}
#: what follows from profiles
FROM_PROFILES = ("conicity", "creep_longitudinal", "creep_lateral", "creep_lateral_spin", "creep_spin")
#: m; clearance of vehicles whose profiles have no flange and whose file gives none: usual on 1435 mm gauge
CLEARANCE = 8e-3


def given_profiles(table: Any, name: str, folder: Path) -> Table:
    """The table, checked; names of files beside the vehicle's as paths."""
    if not isinstance(table, dict):
        raise InputError(f"{name} must be a table, written [contact.profiles], or false")
    found: Table = {}
    for key, value in table.items():
        if key not in PROFILE_KEYS:
            raise InputError(f"{name}: unknown key {key!r}{nearest(key, PROFILE_KEYS)}")
        found[key] = _pair(
            value, f"{name}.{key}", functools.partial(_profile, folder) if key in ("wheel", "rail") else given_number
        )
    ratios = found.get("inclination", 0.0)
    for ratio in ratios if isinstance(ratios, tuple) else (ratios,):
        if ratio and abs(ratio) < 5.0:
            raise InputError(f"{name}.inclination {ratio:g} is 1:{ratio:g}; write 40 for 1:40, and 0 for none")
    return found


def _pair(value: Any, name: str, one: Any) -> Any:
    if not isinstance(value, list):
        return one(value, name)
    if len(value) != 2:
        raise InputError(f"{name} must be one or two, [right, left], not {shown(value)}")
    return tuple(one(each, name) for each in value)


def _profile(folder: Path, value: Any, name: str) -> str:
    if not isinstance(value, str) or not value:
        raise InputError(f"{name} must be the name of a profile or a file, not {shown(value)}")
    beside = folder / value
    return str(beside) if os.path.isfile(beside) else value


def on_profiles(vehicle: Vehicle, table: Table, where: str) -> Vehicle:
    """The vehicle on the profiles of its file; those of the last few are kept, as each takes seconds."""
    for key in ("wheel", "rail"):
        if key not in table:
            raise InputError(f"{where}: missing key contact.profiles.{key} ({PROFILE_KEYS[key]})")
    names = [name for key in ("wheel", "rail") for name in (table[key] if isinstance(table[key], tuple) else (table[key],))]
    changed = tuple(os.stat(name).st_mtime_ns for name in names if os.path.isfile(name))
    contact, plain = vehicle.contact, dataclasses.replace(vehicle, name="", note="", provenance=())
    try:
        found = _made(_Key(plain, (contact.wheel_load, contact.flange_stiffness, contact.flange_clearance, vehicle.wheelset.wheel_radius, tuple(table.items()), changed)))  # fmt: skip
    except InputError as error:
        raise InputError(f"{where}: contact.profiles: {error}") from None
    new = {name: getattr(found.contact, name) for name in (*FROM_PROFILES, "flange_clearance")}
    return dataclasses.replace(vehicle, contact=dataclasses.replace(contact, **new), profiles=found.profiles)


@dataclasses.dataclass(frozen=True)
class _Key:
    """A vehicle, and what of it and its file profiles depend on."""

    vehicle: Vehicle = dataclasses.field(compare=False)
    about: tuple


@functools.lru_cache(maxsize=8)
def _made(key: _Key) -> Vehicle:
    table = dict(key.about[4])

    def each(value: Any, function: Any) -> Any:
        return tuple(map(function, value)) if isinstance(value, tuple) else function(value)

    options = {name: table[f"{name}_mm"] / 1e3 for name in ("gauge", "flange_back", "tread_datum") if f"{name}_mm" in table}
    if "inclination" in table:
        options["inclination"] = each(table["inclination"], lambda ratio: 1.0 / ratio if ratio else 0.0)
    if "wheel_diameter_mm" in table:
        options["radius"] = each(table["wheel_diameter_mm"], lambda diameter: 0.5e-3 * diameter)
    wheel, rail = each(table["wheel"], WheelProfile.load), each(table["rail"], RailProfile.load)
    found = with_profiles(key.vehicle, wheel, rail, **options)
    # as the file says it, so that it can be written again
    assert found.profiles is not None
    return dataclasses.replace(found, profiles=dataclasses.replace(found.profiles, given=tuple(table.items())))
