"""A vehicle as a commented TOML file: every key with its unit, the paper's symbol, meaning, source and default, to be edited."""

import dataclasses
import inspect
import json
import textwrap
from typing import Any

import numpy as np

from ..base.arguments import guarded
from ..base.units import SUFFIXES, handy
from ..model.consistency import a_vehicle
from ..model.vehicle import PARTS, Vehicle
from .profiles import FROM_PROFILES, PROFILE_KEYS
from .values import HERTZ_KEYS

WIDTH = 110  # of the comments
COLUMN = 44  # where remarks behind a value start

HEAD = """\
A vehicle for railjax, in SI units or those that its keys name: mass_kg or mass_t, lengths _m or _mm, stiffness _N_per_m, \
_kN_per_m or _MN_per_m, and so on; change the number, or number and unit. Behind each value stand the paper's symbol, the meaning, \
and in brackets its status where it is not simply from the source. Lines that start with # are switched off. 'railjax check FILE' looks the file over."""

PROVENANCE = """\
Where values are from: "published", "recalled", "assumed" or "calibrated". An entry with a value (SI) holds only as long as the \
parameter has it, so one that you change above loses its mark; write another if you like."""

PROFILED = "Instead of conicity, creep coefficients and the flange's clearance, from profiles of wheel and rail:"
HERTZ = "Instead of the four creep coefficients, from the contact ellipse of this wheel load:"


@guarded(vehicle=a_vehicle)
def vehicle_toml(vehicle: Vehicle, *, name: str = "", source: str = "") -> str:
    """The text of a vehicle file with every key, commented; `load_vehicle` makes the same vehicle of it.

    The vehicle's note is not written, as it is about the original. Optional parts and values that the vehicle does without are
    there as comments. Marks of provenance are written with the value they are about, so that they end with it. Numbers come in
    the largest unit in which they are not below 1 and that keeps them to the last bit.

    Args:
        vehicle: a single vehicle; one with lanes has no such text.
        name: of the new vehicle.
        source: where its values are from.
    """
    marks = {entry.parameter: entry.status for entry in vehicle.provenance}
    lines = [*_comment(HEAD), "", f"name = {_text(name)}"]
    lines += [f"source = {_text(source)}"] if source else []
    lines.append(_line('note = ""', "a line that is printed with results", off=True))
    for field in dataclasses.fields(vehicle):
        if isinstance(field.default, bool):
            lines.append(_line(f"{field.name} = {_text(getattr(vehicle, field.name))}", field.metadata["meaning"]))
    for part, kind in PARTS.items():
        off = FROM_PROFILES if part == "contact" and vehicle.profiles is not None else ()
        lines += ["", *_comment(inspect.cleandoc(kind.__doc__ or "")), *_part(part, kind, getattr(vehicle, part), marks, off)]
    lines += ["", *_comment(PROFILED), *_profiles(vehicle)]
    lines += ["", *_comment(HERTZ), "# [contact.hertz]", *(f"# {key} =" for key in HERTZ_KEYS)]
    if vehicle.provenance:
        lines += ["", *_comment(PROVENANCE), "[provenance]"]
    for entry in vehicle.provenance:
        value = _value(vehicle, entry.parameter)
        about = f"value = {value!r}, " if isinstance(value, float) else ""
        lines.append(f'"{entry.parameter}" = {{ status = {_text(entry.status)}, {about}note = {_text(entry.note)} }}')
    return "\n".join(lines) + "\n"


def _profiles(vehicle: Vehicle) -> list[str]:
    """[contact.profiles], switched off where the vehicle has none."""
    given = {} if vehicle.profiles is None else dict(vehicle.profiles.given)
    mark = "" if given else "# "
    lines = [f"{mark}[contact.profiles]"]
    for key, meaning in PROFILE_KEYS.items():
        value = given.get(key)
        lines.append(_line(f"{key} =" if value is None else f"{key} = {_text(value)}", meaning, off=value is None))
    return lines


def _part(part: str, kind: type, values: Any, marks: dict[str, str], off_too: tuple[str, ...] = ()) -> list[str]:
    """Table of a part; one that the vehicle does without is switched off, and what is not to be given."""
    off = values is None
    lines = [f"# [{part}]" if off else f"[{part}]"]
    held = getattr(values, "held", False)
    for field in dataclasses.fields(kind):
        about, value = field.metadata, getattr(values, field.name, None)
        if "unit" not in about:
            given = [float(entry) for entry in value] if isinstance(value, tuple) else value
            lines.append(_line(f"{field.name} = {_text(given)}", about["meaning"]))
            continue
        remark = f"{about['symbol']}: {about['meaning']}" if about["symbol"] else about["meaning"]
        if field.default is not dataclasses.MISSING:
            unit = "" if about["unit"] == "1" or not field.default else f" {about['unit']}"
            remark += "; may be left out" if field.default is None else f"; {field.default:g}{unit} if left out"
        mark = marks.get(f"{part}.{field.name}")
        remark += f" ({mark})" if mark and value is not None else ""
        # a held body has 1.0 where its file gives no inertia
        unused = value is None or (held and value == 1.0) or field.name in off_too
        lines.append(_line(_assignment(field.name, None if unused else value, about["unit"]), remark, off=unused))
    return lines


def _assignment(name: str, value: Any, unit: str) -> str:
    """`mass_t = 30.76`: in the handy unit if that gives the value back to the last bit, else in one that does; SI always does."""
    choice = handy(float(np.max(value)) if value is not None else 0.0, unit)
    if value is None:
        return f"{name}_{choice[0]} =" if choice[0] else f"{name} ="
    given = np.ravel(value)
    for suffix, factor in (choice, *SUFFIXES[unit].items()):  # noqa: B007
        texts = [f"{entry / factor:.15g}" for entry in given]
        if all(float(text) * factor == entry for text, entry in zip(texts, given, strict=True)):
            break
    else:
        suffix = next(key for key, one in SUFFIXES[unit].items() if one == 1.0)
        texts = [repr(float(entry)) for entry in given]
    text = f"[{', '.join(texts)}]" if np.ndim(value) else texts[0]
    return f"{name}_{suffix} = {text}" if suffix else f"{name} = {text}"


def _value(vehicle: Vehicle, path: str) -> Any:
    part, name = path.split(".")
    return getattr(getattr(vehicle, part), name, None)


def _text(value: Any) -> str:
    """A value as TOML, whose strings, booleans and lists are JSON's (but for DEL)."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _line(assignment: str, remark: str, off: bool = False) -> str:
    return f"{'# ' if off else ''}{assignment} ".ljust(COLUMN) + f"# {remark}"


def _comment(text: str) -> list[str]:
    """Paragraphs, as lines of a comment."""
    paragraphs = [" ".join(paragraph.split()).replace("`", "") for paragraph in text.split("\n\n")]
    return [f"# {line}" for paragraph in paragraphs for line in textwrap.wrap(paragraph, WIDTH)]
