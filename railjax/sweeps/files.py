"""Study files: TOML that names a ready-made study, a vehicle and the parameters to vary, with units in its keys.

Nothing in a file is run as code: studies, tracks and dampers are known by name. Raises `InputError` (one line: file, key, fix).
"""

import dataclasses
import os
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ..base.checks import shown
from ..base.errors import InputError, nearest
from ..base.fields import given_fields, given_number, keys_by_unit
from ..base.units import KMH, keys_of
from ..dampers.named import DAMPERS, FILE, make_damper
from ..model.kinematics import UNITS as COORDINATES
from ..model.track.named import TRACKS, make_track
from ..model.vehicle import PARTS, Vehicle
from ..vehicles.files import load_vehicle
from .points import DESIGNS, MOST_POINTS, SAMPLED, SCALES
from .ready_made import READY_MADE, arguments_of

SPEEDS = {"speed_kmh": 1.0 / KMH, "speed_m_per_s": 1.0}
TOP = ("study", "vehicle", "design", "samples", "seed", "chunk", "options", "track", "damper", "over", *SPEEDS)
RANGE = ("from", "to", "points", "scale")

EXAMPLE = """\
# railjax sweep study.toml --out results.zarr

study = "forced-run"                  # or critical-speed, nonlinear-critical-speed, least-damping, ride-comfort; equivalent-conicity
vehicle = "coach"                     # a packaged vehicle, or a vehicle file beside this one
design = "grid"                       # or points, latin-hypercube, sobol
# samples = 1024                      # of a latin-hypercube or sobol design, whose parameters have from and to only
# seed = 0
# speed_kmh = 200                     # where it does not vary
# chunk = 4096                        # points computed, and written, together

[options]                             # of the study
reduce = ["rms:carbody_acceleration", "peak:guiding_force"]
duration_s = 10
dt_ms = 1
settle_s = 2
# initial = { wheelset_y_mm = 5 }     # else at rest

[track]
kind = "sinusoid"                     # or bump, tangent; random, with spectrum = "erri-high", seed = 0, length_m = 10000
amplitude_mm = 5
wavelength_m = 20

[damper]
kind = "balance-logic"                # as in railjax simulate --damper
alpha = 0.5

[over]                                # what varies: lists, or from ... to, linear or scale = "log"
speed_kmh = { from = 150, to = 250, points = 21 }
"primary.stiffness_x_MN_per_m" = { from = 2, to = 5, points = 7 }
"damper.alpha" = [0.2, 0.5, 1.0]
"""


def read_study(path: str | Path) -> dict[str, Any]:
    """The arguments of `sweep` from a study file."""
    path = Path(path)
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; railjax sweep --example prints one") from None
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{path}: not a TOML file ({' '.join(str(error).split())})") from None
    try:
        return _read(raw, path.parent)
    except InputError as error:
        raise InputError(" ".join(f"{path}: {error}".splitlines())) from None


def _read(raw: dict[str, Any], folder: Path) -> dict[str, Any]:
    for key in raw:
        if key not in TOP:
            raise InputError(f"unknown key {key!r}{nearest(key, TOP)}")
    kind = _one_of(raw, "study", tuple(READY_MADE))
    takes = arguments_of(READY_MADE[kind].__call__)
    found: dict[str, Any] = {"study": _study(kind, _table(raw, "options"))}
    given = [key for key in SPEEDS if key in raw]
    for name, there in (("speed", given), *((name, name in raw) for name in ("vehicle", "track", "damper"))):
        if there and name not in takes:
            raise InputError(f"the study {kind!r} takes no {name}")
    vehicle = None
    if "vehicle" in takes:
        if not isinstance(raw.get("vehicle"), str):
            raise InputError('missing key vehicle, like vehicle = "coach"')
        beside = os.path.join(folder, raw["vehicle"])
        vehicle = load_vehicle(
            beside if os.path.isfile(beside) else raw["vehicle"]
        )  # not Path.is_file, which raises for some names
        found["vehicle"] = vehicle
    if len(given) > 1:
        raise InputError(f"speed is given twice: {' and '.join(given)}; keep one")
    if given:
        found["speed"] = given_number(raw[given[0]], given[0]) * SPEEDS[given[0]]
    if "track" in raw:
        found["track"] = _track(_table(raw, "track"))
    if "damper" in raw and vehicle is not None:
        found["damper"] = _damper(_table(raw, "damper"), vehicle, found.get("speed"))
    found["design"] = _one_of(raw, "design", DESIGNS) if "design" in raw else "grid"
    for key in ("samples", "seed", "chunk"):
        if key in raw:
            if not isinstance(raw[key], int) or isinstance(raw[key], bool):
                raise InputError(f"{key} must be a whole number, not {shown(raw[key])}")
            found[key] = raw[key]
    found["over"] = _over(_table(raw, "over"), found)
    return found


def _one_of(table: dict[str, Any], key: str, known: tuple[str, ...], prefix: str = "") -> str:
    value = table.get(key)
    if not isinstance(value, str) or value not in known:
        hint = nearest(value, known) if isinstance(value, str) else ""
        raise InputError(f"{prefix}{key} must be one of {', '.join(known)}{hint}")
    return value


def _table(raw: dict[str, Any], key: str) -> dict[str, Any]:
    table = raw.get(key, {})
    if not isinstance(table, dict):
        raise InputError(f"{key} must be a table, written [{key}]")
    return table


def _study(kind: str, options: dict[str, Any]) -> Any:
    values: dict[str, Any] = {}
    if "initial" in options and "initial" in {f.name for f in dataclasses.fields(READY_MADE[kind])}:
        values["initial"] = _initial(options["initial"])
        options = {key: value for key, value in options.items() if key != "initial"}
    if options and not dataclasses.fields(READY_MADE[kind]):
        raise InputError(f"unknown key options.{next(iter(options))}: the study {kind!r} has no options")
    return READY_MADE[kind](**values, **given_fields(READY_MADE[kind], options, "options"))


def _initial(table: Any) -> dict[str, float]:
    """Coordinates (and rates) at the start, by name: wheelset_y_mm, bogie_psi_mrad, carbody_y_rate_m_per_s."""
    if not isinstance(table, dict):
        raise InputError("options.initial must be a table of coordinates, like { wheelset_y_mm = 5 }")
    accepted = {}
    for name, unit in COORDINATES.items():
        for prefix, factor in (("", 1.0), ("m", 1e-3)):
            accepted[f"{name}_{prefix}{unit}"] = name, factor
            accepted[f"{name}_rate_{prefix}{unit}_per_s"] = f"{name}_rate", factor
    values: dict[str, float] = {}
    for key, value in table.items():
        if key not in accepted:
            raise InputError(f"unknown key options.initial.{key}{nearest(key, accepted, 'options.initial')}")
        name, factor = accepted[key]
        _once(values, name, f"options.initial.{key}")
        values[name] = given_number(value, f"options.initial.{key}") * factor
    return values


def _once(values: dict[str, Any], name: str, key: str) -> None:
    if name in values:
        raise InputError(f"{key}: {name} is given twice, in two units; keep one")


def _track(table: dict[str, Any]) -> Any:
    name = _one_of(table, "kind", tuple(TRACKS), "track.")
    return make_track(name, {key: value for key, value in table.items() if key != "kind"})


def _damper(table: dict[str, Any], vehicle: Vehicle, speed: float | None) -> Any:
    kind = str(table.get("kind"))
    kind = kind if kind.endswith(FILE) else _one_of(table, "kind", DAMPERS, "damper.")
    damper: Any = make_damper(kind, vehicle, speed)
    rest = {key: value for key, value in table.items() if key != "kind"}
    return dataclasses.replace(damper, **given_fields(damper, rest, "damper", also=("kind",)))


def _over(table: dict[str, Any], found: dict[str, Any]) -> dict[str, Any]:
    if not table:
        raise InputError('missing table [over], like "primary.stiffness_x_MN_per_m" = { from = 2, to = 5, points = 7 }')
    over: dict[str, Any] = {}
    for key, value in _flat(table):
        name, factor = _parameter(key, found)
        _once(over, name, f"over.{key}")
        over[name] = _values(value, factor, found["design"], f"over.{key}")
    return over


def _flat(table: dict[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    """Keys with dots, quoted or not: primary.stiffness_x_MN_per_m is a table in a table to TOML."""
    for key, value in table.items():
        if isinstance(value, dict) and not any(name in value for name in RANGE):
            yield from _flat(value, f"{above}{key}.")
        else:
            yield above + key, value


def _parameter(key: str, found: dict[str, Any]) -> tuple[str, float]:
    """Name of a parameter, and factor to SI, from a key with its unit."""
    if key in SPEEDS:
        return "speed", SPEEDS[key]
    own = _own_keys(found["study"])
    if key in own:
        return own[key]
    *path, last = key.split(".")
    part: Any = PARTS.get(path[0]) if path else None
    if path and path[0] in ("track", "damper"):
        if path[0] not in found:
            raise InputError(f"over.{key}: the file has no [{path[0]}]")
        part = found[path[0]]
    for step in path[1:]:
        part = getattr(part, step, None)
    if not dataclasses.is_dataclass(part):
        examples = [*own, *SPEEDS, *(f"{name}.{k}" for name, kind in PARTS.items() for k in keys_by_unit(kind))]
        raise InputError(f"unknown parameter over.{key}{nearest(key, examples)}")
    accepted = keys_by_unit(part)
    if last not in accepted:
        raise InputError(f"unknown parameter over.{key}{nearest(last, accepted, '.'.join(path))}")
    field, factor = accepted[last]
    return ".".join([*path, field.name]), factor


def _own_keys(study: Any) -> dict[str, tuple[str, float]]:
    """Keys of a study's own arguments, with their units: gauge_mm -> ("gauge", 1e-3)."""
    units = {name: study.units[name] for name in arguments_of(study) if name in getattr(study, "units", {})}
    return {key: (name, factor) for name, unit in units.items() for key, factor in keys_of(name, unit).items()}


def _values(value: Any, factor: float, design: str, name: str) -> Any:
    """Values, or the ends of a range, in SI."""
    sampled = design in SAMPLED
    if isinstance(value, list) and value and not sampled:
        return np.array([given_number(entry, name) for entry in value]) * factor
    needed = ("from", "to") if sampled else ("from", "to", "points")
    if not isinstance(value, dict) or any(key not in value for key in needed):
        if sampled:
            raise InputError(f"{name}: a {design} design needs {{ from = ..., to = ... }}")
        raise InputError(f"{name} must be a list of numbers or {{ from = ..., to = ..., points = ... }}, not {shown(value)}")
    for key in value:
        if key not in (*needed, "scale"):
            raise InputError(f"unknown key {name}.{key}{nearest(key, [*needed, 'scale'])}")
    low, high = (given_number(value[key], f"{name}.{key}") * factor for key in ("from", "to"))
    scale = _one_of(value, "scale", SCALES, f"{name}.") if "scale" in value else "linear"
    if scale == "log" and not min(low, high) > 0:
        raise InputError(f'{name}: a range of scale = "log" must be positive')
    if sampled:
        return (low, high, scale)
    count = value["points"]
    if not isinstance(count, int) or isinstance(count, bool) or not 1 <= count <= MOST_POINTS:
        raise InputError(f"{name}.points must be a whole number from 1 to {MOST_POINTS}, not {shown(count)}")
    return np.geomspace(low, high, count) if scale == "log" else np.linspace(low, high, count)
