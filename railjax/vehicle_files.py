"""Vehicle files: TOML with unit-bearing keys, `base = "coach"` plus overrides; everything a user gives is checked here.

A packaged file is found by its name, any other by its path; `base` is looked up beside the file first.
"""

import dataclasses
import difflib
import math
import tomllib
from importlib import resources
from pathlib import Path
from typing import Any

from . import kalker
from .errors import InputError
from .units import keys_of
from .vehicle import Contact, Geometry, Provenance, Vehicle

Table = dict[str, Any]

#: keys of a file beside the tables of parameters
TOP = {"name": str, "base": str, "source": str, "note": str, "gyroscopic": bool, "gravitational": bool, "provenance": dict}
STATUSES = ("published", "recalled", "assumed", "calibrated")
PARTS = {f.name: f.type for f in dataclasses.fields(Vehicle) if dataclasses.is_dataclass(f.type)}


def packaged_vehicles() -> list[str]:
    """Names of the vehicles that come with railjax."""
    return sorted(p.name.removesuffix(".toml") for p in _packaged().iterdir() if p.name.endswith(".toml"))


def load_vehicle(name_or_path: str | Path) -> Vehicle:
    """A packaged vehicle by name ("coach", "coach-table1") or a TOML file by path.

    Raises `InputError` (one line: file, key, fix) for a missing file, a file that is not TOML, an unknown or missing key,
    a value of the wrong kind or out of range.
    """
    tables, where = _read(str(name_or_path), Path("."), [])
    return _build(tables, where)


def _packaged() -> Any:
    return resources.files("railjax") / "vehicles"


def _read(name: str, beside: Path, chain: list[str]) -> tuple[Table, str]:
    """The tables of a file in SI, merged onto those of its bases."""
    path = beside / name
    if path.suffix == ".toml" or path.is_file():
        try:
            text = path.read_text(encoding="utf-8")
        except FileNotFoundError:
            raise InputError(f"{path}: no such file") from None
        except (OSError, UnicodeDecodeError) as error:
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
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{name}: not TOML ({str(error).splitlines()[0]})") from None
    tables = _convert(raw, name)
    if "base" in raw:
        below, _ = _read(raw["base"], folder, [*chain, key])
        tables = _merge(below, tables)
    return tables, name


def _merge(below: Table, above: Table) -> Table:
    merged = dict(below)
    for key, value in above.items():
        merged[key] = {**below.get(key, {}), **value} if isinstance(value, dict) else value
    # an ellipse or coefficients given above take the place of the other below
    contact = above.get("contact", {})
    if any(name.startswith("creep_") for name in contact) and "hertz" not in contact:
        merged["contact"].pop("hertz", None)
    return merged


def _convert(raw: Table, where: str) -> Table:
    """Keys without units, values in SI; every key and value checked."""
    tables: Table = {}
    for key, value in raw.items():
        if key in TOP:
            if not isinstance(value, TOP[key]):
                raise InputError(f"{where}: {key} must be a {TOP[key].__name__}, not {value!r}")
            tables[key] = value
        elif key in PARTS:
            if not isinstance(value, dict):
                raise InputError(f"{where}: {key} must be a table, written [{key}]")
            tables[key] = _convert_part(key, value, where)
        else:
            raise InputError(f"{where}: unknown key {key!r}{_nearest(key, [*TOP, *PARTS])}")
    for parameter, entry in tables.get("provenance", {}).items():
        if not isinstance(entry, dict) or entry.get("status") not in STATUSES:
            raise InputError(
                f"{where}: provenance.{parameter!r} needs a table with status = one of {', '.join(STATUSES)}"
            )
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
            values[field.name] = _checked(number(value, name) * factor, field, name)
        elif key in others:
            values[key] = _structure(key, value, name)
        elif part == "contact" and key == "hertz":
            values[key] = _hertz(value, name)
        else:
            # `mass` or `mass_g`: the field is known, the unit is not
            for field_name in {field.name for field, _ in accepted.values()}:
                if key == field_name or key.startswith(field_name + "_"):
                    keys = [k for k, (field, _) in accepted.items() if field.name == field_name]
                    if not any(key.startswith(longer + "_") for longer in keys):
                        raise InputError(f"{name}: the key must name its unit: {' or '.join(keys)}")
            raise InputError(f"{where}: unknown key {part}.{key}{_nearest(key, [*accepted, *others], part)}")
    return values


def _nearest(key: str, known: list[str], part: str = "") -> str:
    near = difflib.get_close_matches(key, known, n=1, cutoff=0.0)[0]
    return f"; did you mean {part + '.' if part else ''}{near}?"


def number(value: Any, name: str) -> float:
    """A finite float, or an `InputError` that names the key."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise InputError(f"{name} must be a number, not {value!r}")
    if not math.isfinite(value):
        raise InputError(f"{name} must be finite, not {value!r}")
    return float(value)


def _checked(value: float, field: dataclasses.Field, name: str) -> float:
    signed = field.name.startswith(("bogie_to_", "carbody_height", "conicity"))
    if field.metadata["positive"] and value <= 0.0:
        raise InputError(f"{name} must be positive, not {value:g}; it is the {field.metadata['meaning']}")
    if value < 0.0 and not signed:
        raise InputError(f"{name} must not be negative ({value:g}); it is the {field.metadata['meaning']}")
    return value


def _structure(key: str, value: Any, name: str) -> Any:
    if key.endswith("_pattern"):
        if not isinstance(value, list) or not value:
            raise InputError(f"{name} must be a list of positions from front to rear, like [1, -1]")
        pattern = tuple(number(entry, name) for entry in value)
        if list(pattern) != sorted(pattern, reverse=True) or len(set(pattern)) != len(pattern):
            raise InputError(f"{name} must fall from front to rear, like [1, -1]; got {value}")
        return pattern
    if key == "held":
        if not isinstance(value, bool):
            raise InputError(f"{name} must be true or false, not {value!r}")
        return value
    laws = ("sharp", "smooth", "linear")
    if value not in laws:
        raise InputError(f"{name} must be one of {', '.join(laws)}, not {value!r}")
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
            raise InputError(f"unknown key {name}.{key}{_nearest(key, list(HERTZ_KEYS), name)}")
        given = number(value, f"{name}.{key}") * (1e9 if key.endswith("GPa") else 1.0)
        if HERTZ_KEYS[key] == "poisson":
            if not 0.0 <= given <= 0.5:
                raise InputError(f"{name}.{key} must lie between 0 and 0.5, not {given:g}")
        elif given == 0.0 or (given < 0.0 and HERTZ_KEYS[key] != "wheel_profile_radius"):
            raise InputError(f"{name}.{key} must be positive, not {given:g}")
        values[HERTZ_KEYS[key]] = given
    if "rail_head_radius" not in values:
        raise InputError(f"{name} needs rail_head_radius_m (0.3 for a UIC 60 rail)")
    return values


def _build(tables: Table, where: str) -> Vehicle:
    tables = {key: dict(value) if isinstance(value, dict) else value for key, value in tables.items()}
    contact, hertz = tables.get("contact", {}), tables.get("contact", {}).pop("hertz", None)
    if hertz is not None:
        given = {"load": contact.get("wheel_load"), "wheel_radius": tables.get("wheelset", {}).get("wheel_radius")}
        for key, value in given.items():
            if value is None:
                raise InputError(f"{where}: [contact.hertz] also needs {key}")
        contact |= kalker.creep_coefficients(**given, **hertz)._asdict()
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
