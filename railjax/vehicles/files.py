"""Vehicle files: TOML with unit-bearing keys, `base = "coach"` plus overrides; everything a user gives is checked here.

A packaged file is found by its name, any other by its path; `base` is looked up beside the file first. An optional part that
the base has and the vehicle has not is taken out with `false`, as in `yaw_damper = false`. An entry of [provenance] that says
`value` (SI) is dropped where the parameter has another one, so that a mark does not outlive the value that it is about.
"""

import dataclasses
import math
import os
import tomllib
from importlib import resources
from pathlib import Path
from typing import Any

import jax
import numpy as np

from ..base.arguments import guarded
from ..base.checks import shown
from ..base.errors import InputError, closest, collecting, nearest
from ..base.fields import given_number, given_value, keys_by_unit
from ..base.units import keys_of
from ..model.consistency import bump_stop_table, consistent
from ..model.contact import kalker
from ..model.vehicle import OPTIONAL, PARTS, Provenance, Vehicle
from .profiles import CLEARANCE, FROM_PROFILES, given_profiles, on_profiles
from .values import Table, hertz, structure

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
PROVENANCE = ("status", "value", "note")
STATUSES = ("published", "recalled", "assumed", "calibrated")
PARAMETERS = [f"{part}.{f.name}" for part, kind in PARTS.items() for f in dataclasses.fields(kind)]
CREEP = kalker.CreepCoefficients._fields


def packaged_vehicles() -> list[str]:
    """Names of the vehicles that come with railjax."""
    return sorted(p.name.removesuffix(".toml") for p in _packaged().iterdir() if p.name.endswith(".toml"))


@guarded()
def load_vehicle(name_or_path: str | Path) -> Vehicle:
    """A packaged vehicle by name ("coach", "coach-table1") or a TOML file by path.

    A file inherits from its `base` all but name, source and note, and the provenance of what it does not give
    itself. Raises `InputError` (one line: file, key, fix) for a missing file, a file that is not TOML, an
    unknown or missing key, a value of the wrong kind or out of range; its `messages` are all that could be found at once.
    """
    try:
        tables, where = _read(str(name_or_path), Path("."), [])
        return _build(tables, where)
    except InputError as error:
        # names of files and keys may hold line breaks
        raise InputError(*(" ".join(message.splitlines()) for message in error.messages)) from None


def source_of(name_or_path: str | Path) -> str:
    """The `source` that a vehicle's file names, or the nearest of its bases; "" where there is none. Errors as `load_vehicle`."""
    load_vehicle(name_or_path)
    name, folder = str(name_or_path), Path(".")
    while True:
        raw, _, folder = _raw(name, folder)
        if "source" in raw or "base" not in raw:
            return raw.get("source", "")
        name = raw["base"]


def _packaged() -> Any:
    return resources.files("railjax") / "vehicles"


def _raw(name: str, beside: Path) -> tuple[Table, str, Path]:
    """A file's TOML, what tells it from others, and its folder."""
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
        near = closest(name, packaged_vehicles(), least=0.6)
        hint = f"; did you mean {near!r}?" if near else ""
        raise InputError(f"no vehicle {name!r}: neither a file nor one of {', '.join(packaged_vehicles())}{hint}")
    try:
        return tomllib.loads(text), key, folder
    except (ValueError, RecursionError) as error:  # integers of over 4300 digits and deep nesting too
        raise InputError(f"{name}: not TOML ({str(error).splitlines()[0]})") from None


def _read(name: str, beside: Path, chain: list[str]) -> tuple[Table, str]:
    """The tables of a file in SI, merged onto those of its bases."""
    raw, key, folder = _raw(name, beside)
    if key in chain:
        raise InputError(f"{name}: 'base' leads back to the file itself; remove the circle")
    tables = _convert(raw, name, folder)
    if "base" in raw:
        below, _ = _read(raw["base"], folder, [*chain, key])
        tables = _merge(below, tables)
    return tables, name


def _merge(below: Table, above: Table) -> Table:
    contact = above.get("contact", {})
    given = {f"{part}.{name}" for part in PARTS for name in above.get(part) or ()}
    removed = tuple(f"{part}." for part in OPTIONAL if above.get(part) is False)
    if "hertz" in contact:
        given |= {f"contact.{name}" for name in CREEP}
    profiles, others = contact.get("profiles"), below.get("contact", {}).get("profiles")
    if profiles:
        given |= {f"contact.{name}" for name in (*FROM_PROFILES, "flange_clearance")}
    merged = {key: value for key, value in below.items() if key not in OWN}
    sources = below.get("provenance", {})
    kept = {name: entry for name, entry in sources.items() if name not in given and not name.startswith(removed)}
    merged["provenance"] = kept
    for key, value in above.items():
        merged[key] = {**(merged.get(key) or {}), **value} if isinstance(value, dict) else value
    if profiles and others:
        merged["contact"]["profiles"] = {**others, **profiles}
    # an ellipse or coefficients given above take the place of the other below
    if any(name in contact for name in CREEP):
        merged["contact"].pop("hertz", None)
    return merged


def _convert(raw: Table, where: str, folder: Path) -> Table:
    """Keys without units, values in SI; every key and value checked."""
    tables: Table = {}
    faults: list[str] = []
    for key, value in raw.items():
        with collecting(faults):
            if key in TOP:
                if not isinstance(value, TOP[key]):
                    raise InputError(f"{where}: {key} must be {KINDS[TOP[key]]}, not {shown(value)}")
                tables[key] = value
            elif key in OPTIONAL and value is False:
                tables[key] = value
            elif key in PARTS:
                if not isinstance(value, dict):
                    raise InputError(f"{where}: {key} must be a table, written [{key}]")
                tables[key] = _convert_part(key, value, where, folder)
            else:
                raise InputError(f"{where}: unknown key {key!r}{nearest(key, [*TOP, *PARTS])}")
    for parameter, entry in tables.get("provenance", {}).items():
        with collecting(faults):
            _check_provenance(parameter, entry, where)
    if faults:
        raise InputError(*faults)
    return tables


def _check_provenance(parameter: str, entry: Any, where: str) -> None:
    name = f'{where}: provenance."{parameter}"'
    if parameter not in PARAMETERS:
        near = nearest(f'"{parameter}"', [f'"{known}"' for known in PARAMETERS])
        raise InputError(f"{name} names no parameter{near} (with the quotes)")
    if not isinstance(entry, dict) or entry.get("status") not in STATUSES:
        raise InputError(f"{name} needs a table with status = one of {', '.join(STATUSES)}")
    for key in entry:
        if key not in PROVENANCE:
            raise InputError(f"{name}: unknown key {key!r}{nearest(key, PROVENANCE)}")
    if "value" in entry:
        given_number(entry["value"], f"{name}.value")
    if not isinstance(entry.get("note", ""), str):
        raise InputError(f"{name}.note must be a string, not {shown(entry['note'])}")


def _convert_part(part: str, table: Table, where: str, folder: Path) -> Table:
    values: Table = {}
    faults: list[str] = []
    for key, value in table.items():
        with collecting(faults):
            _convert_value(part, key, value, values, where, folder)
    if faults:
        raise InputError(*faults)
    twice = [name for name in CREEP if name in values and "hertz" in values]
    if twice:
        raise InputError(f"{where}: contact.{twice[0]} is given beside [contact.hertz], its source; keep one")
    source = "profiles" if values.get("profiles") else None
    also = [key for key in (*FROM_PROFILES, "hertz") if source and key in values]
    if also:
        raise InputError(f"{where}: contact.{also[0]} is given beside [contact.profiles], its source; keep one")
    return values


def _convert_value(part: str, key: str, value: Any, values: Table, where: str, folder: Path) -> None:
    """Put one key's value into `values`, by its field and in SI."""
    accepted = keys_by_unit(PARTS[part])
    others = {f.name: f for f in dataclasses.fields(PARTS[part]) if f.metadata.get("static")}
    name = f"{where}: {part}.{key}"
    if key in accepted:
        field, factor = accepted[key]
        if field.name in values:
            raise InputError(f"{name}: {field.name} is given twice, in two units; keep one")
        values[field.name] = given_value(value, factor, field, name)
    elif key in others:
        values[key] = structure(others[key], value, name)
    elif part == "contact" and key == "hertz":
        values[key] = hertz(value, name)
    elif part == "contact" and key == "profiles":
        values[key] = value if value is False else given_profiles(value, name, folder)
    else:
        # `mass` or `mass_g`: the field is known, the unit is not
        known = {field.name for field, _ in accepted.values()}
        meant = max((f for f in known if key == f or key.startswith(f + "_")), key=len, default=None)
        keys = [k for k, (field, _) in accepted.items() if field.name == meant]
        if keys and not any(key.startswith(longer + "_") for longer in keys):
            raise InputError(f"{name}: the key must name its unit: {' or '.join(keys)}")
        raise InputError(f"{where}: unknown key {part}.{key}{nearest(key, [*accepted, *others], part)}")


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


def _part(part: str, values: Table | bool | None, where: str) -> Any:
    """A part from its values; an optional one that no table or `false` gives is None."""
    if part in OPTIONAL and not isinstance(values, dict):
        return None
    values = dict(values or {})
    missing = [f for f in dataclasses.fields(PARTS[part]) if f.name not in values and f.default is dataclasses.MISSING]
    if missing and not values.get("held"):
        keys = [(next(iter(keys_of(field.name, field.metadata["unit"]))), field.metadata["meaning"]) for field in missing]
        raise InputError(*(f"{where}: missing key {part}.{key} ({meaning})" for key, meaning in keys))
    values |= dict.fromkeys((field.name for field in missing), 1.0)  # a held body's inertia is never read
    return PARTS[part](**values)


def _of(parts: Table, parameter: str) -> Any:
    """A parameter's value, None where the vehicle does without it."""
    part, name = parameter.split(".")
    return getattr(parts[part], name, None)


def _build(tables: Table, where: str) -> Vehicle:
    tables = {key: dict(value) if isinstance(value, dict) else value for key, value in tables.items()}
    profiles = tables.get("contact", {}).pop("profiles", None)
    if profiles:
        # what they give themselves
        tables["contact"] |= dict.fromkeys(FROM_PROFILES, 1.0)
        tables["contact"].pop("hertz", None)
        tables["contact"].setdefault("flange_clearance", CLEARANCE)
    elif "hertz" in tables.get("contact", {}):
        tables["contact"] |= _creep(tables, where)
        del tables["contact"]["hertz"]
    parts: Table = {}
    faults: list[str] = []
    for part in PARTS:
        with collecting(faults):
            parts[part] = _part(part, tables.get(part), where)
    if faults:
        raise InputError(*faults)
    consistent(parts, where)
    if parts["bump_stop"] is not None:
        parts["bump_stop"] = bump_stop_table(parts["bump_stop"], where)
    provenance = tuple(
        Provenance(parameter, entry["status"], entry.get("note", ""))
        for parameter, entry in tables.get("provenance", {}).items()
        if "value" not in entry or np.array_equal(entry["value"], _of(parts, parameter))
    )
    vehicle = Vehicle(
        **parts,
        gyroscopic=tables.get("gyroscopic", False),
        gravitational=tables.get("gravitational", False),
        name=tables.get("name", Path(where).stem),
        note=tables.get("note", ""),
        provenance=provenance,
    )
    return on_profiles(vehicle, profiles, where) if profiles else vehicle
