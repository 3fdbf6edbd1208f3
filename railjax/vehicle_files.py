"""Vehicle files: TOML with unit-bearing keys, `base = "coach"` plus overrides; everything a user gives is checked here.

A packaged file is found by its name, any other by its path; `base` is looked up beside the file first.
"""

import dataclasses
import difflib
import math
import os
import tomllib
from importlib import resources
from pathlib import Path
from typing import Any

import jax

from . import kalker
from .errors import InputError
from .units import keys_of
from .vehicle import Contact, Geometry, Provenance, Vehicle

Table = dict[str, Any]

#: keys of a file beside the tables of parameters
TOP = {
    "name": str,
    "base": str,
    "source": str,
    "note": str,
    "gyroscopic": bool,
    "gravitational": bool,
    "provenance": dict,
}
KINDS = {str: "a string", bool: "true or false", dict: "a table"}
OWN = ("name", "source", "note")  # true of one file only, so not inherited from its base
STATUSES = ("published", "recalled", "assumed", "calibrated")
PARTS = {f.name: f.type for f in dataclasses.fields(Vehicle) if dataclasses.is_dataclass(f.type)}
PARAMETERS = [f"{part}.{f.name}" for part, kind in PARTS.items() for f in dataclasses.fields(kind)]
CREEP = kalker.CreepCoefficients._fields


def packaged_vehicles() -> list[str]:
    """Names of the vehicles that come with railjax."""
    return sorted(p.name.removesuffix(".toml") for p in _packaged().iterdir() if p.name.endswith(".toml"))


def load_vehicle(name_or_path: str | Path) -> Vehicle:
    """A packaged vehicle by name ("coach", "coach-table1") or a TOML file by path.

    A file inherits from its `base` all but name, source and note, and the provenance of what it does not give
    itself. Raises `InputError` (one line: file, key, fix) for a missing file, a file that is not TOML, an
    unknown or missing key, a value of the wrong kind or out of range.
    """
    try:
        tables, where = _read(str(name_or_path), Path("."), [])
        return _build(tables, where)
    except InputError as error:
        # names of files and keys may hold line breaks
        raise InputError(" ".join(str(error).splitlines())) from None


def _packaged() -> Any:
    return resources.files("railjax") / "vehicles"


def _read(name: str, beside: Path, chain: list[str]) -> tuple[Table, str]:
    """The tables of a file in SI, merged onto those of its bases."""
    path = beside / name
    if path.suffix == ".toml" or os.path.isfile(path):  # not path.is_file(), which raises for a name too long
        try:
            text = path.read_text(encoding="utf-8")
        except FileNotFoundError:
            raise InputError(f"{path}: no such file") from None
        except (OSError, ValueError) as error:  # not UTF-8, or a name that no file can have
            raise InputError(f"{path}: cannot be read as text ({type(error).__name__})") from None
        key, folder = str(path.resolve()), path.parent
    elif name in packaged_vehicles():
        text, key, folder = (_packaged() / f"{name}.toml").read_text(encoding="utf-8"), name, Path(".")
    else:
        near = difflib.get_close_matches(name, packaged_vehicles(), n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise InputError(f"no vehicle {name!r}: neither a file nor one of {', '.join(packaged_vehicles())}{hint}")
    if key in chain:
        raise InputError(f"{name}: 'base' leads back to the file itself; remove the circle")
    try:
        raw = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # integers of over 4300 digits and deep nesting too
        raise InputError(f"{name}: not TOML ({str(error).splitlines()[0]})") from None
    tables = _convert(raw, name)
    if "base" in raw:
        below, _ = _read(raw["base"], folder, [*chain, key])
        tables = _merge(below, tables)
    return tables, name


def _merge(below: Table, above: Table) -> Table:
    contact = above.get("contact", {})
    given = {f"{part}.{name}" for part in PARTS for name in above.get(part, {})}
    if "hertz" in contact:
        given |= {f"contact.{name}" for name in CREEP}
    merged = {key: value for key, value in below.items() if key not in OWN}
    sources = below.get("provenance", {})
    merged["provenance"] = {name: entry for name, entry in sources.items() if name not in given}
    for key, value in above.items():
        merged[key] = {**merged.get(key, {}), **value} if isinstance(value, dict) else value
    # an ellipse or coefficients given above take the place of the other below
    if any(name in contact for name in CREEP):
        merged["contact"].pop("hertz", None)
    return merged


def _convert(raw: Table, where: str) -> Table:
    """Keys without units, values in SI; every key and value checked."""
    tables: Table = {}
    for key, value in raw.items():
        if key in TOP:
            if not isinstance(value, TOP[key]):
                raise InputError(f"{where}: {key} must be {KINDS[TOP[key]]}, not {_shown(value)}")
            tables[key] = value
        elif key in PARTS:
            if not isinstance(value, dict):
                raise InputError(f"{where}: {key} must be a table, written [{key}]")
            tables[key] = _convert_part(key, value, where)
        else:
            raise InputError(f"{where}: unknown key {key!r}{_nearest(key, [*TOP, *PARTS])}")
    for parameter, entry in tables.get("provenance", {}).items():
        name = f'{where}: provenance."{parameter}"'
        if parameter not in PARAMETERS:
            near = _nearest(f'"{parameter}"', [f'"{known}"' for known in PARAMETERS])
            raise InputError(f"{name} names no parameter{near} (with the quotes)")
        if not isinstance(entry, dict) or entry.get("status") not in STATUSES:
            raise InputError(f"{name} needs a table with status = one of {', '.join(STATUSES)}")
        for key in entry:
            if key not in ("status", "note"):
                raise InputError(f"{name}: unknown key {key!r}{_nearest(key, ['status', 'note'])}")
    return tables


def _convert_part(part: str, table: Table, where: str) -> Table:
    values: Table = {}
    accepted: dict[str, tuple[dataclasses.Field, float]] = {}
    for field in dataclasses.fields(PARTS[part]):
        if "unit" in field.metadata:
            accepted |= {key: (field, factor) for key, factor in keys_of(field.name, field.metadata["unit"]).items()}
    others = {f.name: f for f in dataclasses.fields(PARTS[part]) if f.metadata.get("static")}
    for key, value in table.items():
        name = f"{where}: {part}.{key}"
        if key in accepted:
            field, factor = accepted[key]
            if field.name in values:
                raise InputError(f"{name}: {field.name} is given twice, in two units; keep one")
            values[field.name] = _converted(value, factor, field, name)
        elif key in others:
            values[key] = _structure(key, value, name)
        elif part == "contact" and key == "hertz":
            values[key] = _hertz(value, name)
        else:
            # `mass` or `mass_g`: the field is known, the unit is not
            known = {field.name for field, _ in accepted.values()}
            meant = max((f for f in known if key == f or key.startswith(f + "_")), key=len, default=None)
            keys = [k for k, (field, _) in accepted.items() if field.name == meant]
            if keys and not any(key.startswith(longer + "_") for longer in keys):
                raise InputError(f"{name}: the key must name its unit: {' or '.join(keys)}")
            raise InputError(f"{where}: unknown key {part}.{key}{_nearest(key, [*accepted, *others], part)}")
    twice = [name for name in CREEP if name in values and "hertz" in values]
    if twice:
        raise InputError(f"{where}: contact.{twice[0]} is given beside [contact.hertz], its source; keep one")
    return values


def _nearest(key: str, known: list[str], part: str = "") -> str:
    near = difflib.get_close_matches(key, known, n=1, cutoff=0.0)[0]
    return f"; did you mean {part + '.' if part else ''}{near}?"


def _shown(value: Any) -> str:
    """A value as messages quote it."""
    try:
        text = repr(value)
    except ValueError:  # Python does not print integers of over 4300 digits
        return "a huge number"
    return text if len(text) <= 60 else f"{text[:57]}..."


def number(value: Any, name: str) -> float:
    """A finite float, or an `InputError` that names the key."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise InputError(f"{name} must be a number, not {_shown(value)}")
    try:
        given = float(value)
    except OverflowError:
        given = math.inf
    if not math.isfinite(given):
        raise InputError(f"{name} must be finite, not {_shown(value)}")
    return given


def _converted(value: Any, factor: float, field: dataclasses.Field, name: str) -> float:
    """In SI, with the sign and the range that the field wants."""
    given = number(value, name)
    converted, meaning = given * factor, field.metadata["meaning"]
    signed = field.name.startswith(("bogie_to_", "carbody_height", "conicity"))
    if field.metadata["positive"] and converted <= 0.0:
        raise InputError(f"{name} must be positive, not {given:g}; it is the {meaning}")
    if converted < 0.0 and not signed:
        raise InputError(f"{name} must not be negative ({given:g}); it is the {meaning}")
    if not math.isfinite(converted):
        raise InputError(f"{name} is too large ({given:g}); it is the {meaning}")
    return converted


def _structure(key: str, value: Any, name: str) -> Any:
    if key.endswith("_pattern"):
        if not isinstance(value, list) or not value:
            raise InputError(f"{name} must be a list of positions from front to rear, like [1, -1]")
        pattern = tuple(number(entry, name) for entry in value)
        if list(pattern) != sorted(pattern, reverse=True) or len(set(pattern)) != len(pattern):
            raise InputError(f"{name} must fall from front to rear, like [1, -1], not {_shown(value)}")
        return pattern
    if key == "held":
        if not isinstance(value, bool):
            raise InputError(f"{name} must be true or false, not {_shown(value)}")
        return value
    laws = ("sharp", "smooth", "linear")
    if value not in laws:
        raise InputError(f"{name} must be one of {', '.join(laws)}, not {_shown(value)}")
    return value


HERTZ_KEYS = {
    "rail_head_radius_m": "rail_head_radius",
    "wheel_profile_radius_m": "wheel_profile_radius",
    "youngs_modulus_GPa": "youngs_modulus",
    "poisson_ratio": "poisson",
}


def _hertz(table: Any, name: str) -> Table:
    if not isinstance(table, dict):
        raise InputError(f"{name} must be a table, written [contact.hertz]")
    values = {}
    for key, value in table.items():
        if key not in HERTZ_KEYS:
            raise InputError(f"{name}: unknown key {key!r}{_nearest(key, list(HERTZ_KEYS))}")
        given = number(value, f"{name}.{key}") * (1e9 if key.endswith("GPa") else 1.0)
        if HERTZ_KEYS[key] == "poisson":
            if not 0.0 <= given <= 0.5:
                raise InputError(f"{name}.{key} must lie between 0 and 0.5, not {given:g}")
        elif given == 0.0 or (given < 0.0 and HERTZ_KEYS[key] != "wheel_profile_radius"):
            raise InputError(f"{name}.{key} must be positive, not {given:g}")
        values[HERTZ_KEYS[key]] = given
    if "rail_head_radius" not in values:
        raise InputError(f"{name} needs rail_head_radius_m (0.3 for a UIC 60 rail)")
    if 1.0 / values["rail_head_radius"] + 1.0 / values.get("wheel_profile_radius", math.inf) <= 0.0:
        raise InputError(f"{name}.wheel_profile_radius_m: a hollow wheel must be wider than the rail head")
    return values


def _creep(tables: Table, where: str) -> dict[str, float]:
    """Creep coefficients of [contact.hertz]; in double precision whatever the process uses."""
    given = []
    for part, key in (("contact", "wheel_load"), ("wheelset", "wheel_radius")):
        if key not in tables.get(part, {}):
            raise InputError(f"{where}: [contact.hertz] also needs {part}.{key}")
        given.append(tables[part][key])
    try:
        with jax.enable_x64(True):
            found = kalker.creep_coefficients(*given, **tables["contact"]["hertz"])
    except RuntimeError:  # the equation of the ellipse has no solution in floating point
        found = kalker.CreepCoefficients(*[math.nan] * len(CREEP))
    values = {name: float(value) for name, value in found._asdict().items()}
    if not all(math.isfinite(value) and value > 0.0 for value in values.values()):
        raise InputError(f"{where}: [contact.hertz] gives no contact ellipse; check radii, load and modulus")
    return values


def _build(tables: Table, where: str) -> Vehicle:
    tables = {key: dict(value) if isinstance(value, dict) else value for key, value in tables.items()}
    if "hertz" in tables.get("contact", {}):
        tables["contact"] |= _creep(tables, where)
        del tables["contact"]["hertz"]
    parts = {}
    held = {part: tables.get(part, {}).get("held", False) for part in ("carbody", "bogie")}
    for part, kind in PARTS.items():
        values = tables.get(part, {})
        for field in dataclasses.fields(kind):
            missing = field.name not in values and field.default is dataclasses.MISSING
            if missing and held.get(part):
                values[field.name] = 1.0  # a held body's inertia is never read
            elif missing:
                key = next(iter(keys_of(field.name, field.metadata["unit"])))
                raise InputError(f"{where}: missing key {part}.{key} ({field.metadata['meaning']})")
        parts[part] = kind(**values)
    _consistent(parts["geometry"], parts["contact"], held, where)
    provenance = tuple(
        Provenance(parameter, entry["status"], str(entry.get("note", "")))
        for parameter, entry in tables.get("provenance", {}).items()
    )
    return Vehicle(
        **parts,
        gyroscopic=tables.get("gyroscopic", False),
        gravitational=tables.get("gravitational", False),
        name=tables.get("name", Path(where).stem),
        note=tables.get("note", ""),
        provenance=provenance,
    )


def _consistent(geometry: Geometry, contact: Contact, held: dict[str, bool], where: str) -> None:
    """What no single key can tell."""
    for key, pattern, spread in (
        ("bogie_pattern", geometry.bogie_pattern, geometry.half_pivot_distance),
        ("axle_pattern", geometry.axle_pattern, geometry.half_wheelbase),
    ):
        if len(pattern) > 1 and spread <= 0.0:
            raise InputError(f"{where}: geometry.{key} has {len(pattern)} entries, so their half distance must be positive")
    if held["bogie"] and not held["carbody"]:
        raise InputError(f"{where}: bogie.held without carbody.held leaves the car body on fixed springs; hold both or none")
    if contact.creep_longitudinal == 0.0 and contact.creep_lateral == 0.0 and contact.law != "linear":
        raise InputError(f"{where}: contact.creep_longitudinal and creep_lateral are both zero; use law = 'linear' for that")
