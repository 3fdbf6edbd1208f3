"""Parameters by name, wherever they are: "speed", "primary.stiffness_x" (of the vehicle), "track.amplitude", "damper.alpha"."""

import dataclasses
from typing import Any

import numpy as np

from ..base.errors import InputError, closest
from ..base.fields import check_number
from ..model.damper import check_damper
from ..model.parameters import get_parameter, set_parameter
from ..model.track.shapes import check_track
from ..model.vehicle import PARTS


def owner(name: str) -> str | None:
    """The argument that a parameter belongs to: "vehicle", "speed", "track", "damper", or None for one of the study's own."""
    head = name.partition(".")[0]
    if head in PARTS:
        return "vehicle"
    return head if name == "speed" or ("." in name and head in ("track", "damper")) else None


def field_of(given: dict[str, Any], name: str) -> dataclasses.Field | None:
    """The dataclass field behind a name; None for "speed" and a study's own arguments.

    Raises `InputError` for a name that is not there, and for one that is no single number.
    """
    whose = owner(name)
    if whose in (None, "speed"):
        return None
    part = given.get(whose)
    if part is None:
        raise InputError(f"{name} is to vary, but the study has no {whose}: give {whose}=")
    if whose == "vehicle":
        get_parameter(part, name)  # its message for a path that does not exist names the nearest one
    path = name.split(".") if whose == "vehicle" else name.split(".")[1:]
    field = None
    for step in path:
        fields = {f.name: f for f in dataclasses.fields(part)} if dataclasses.is_dataclass(part) else {}
        if step not in fields:
            near = closest(step, fields)
            hint = f"; did you mean {near!r}?" if near else ""
            raise InputError(f"no parameter {name!r}: {type(part).__name__} has no {step!r}{hint}")
        field, part = fields[step], getattr(part, step)
    if field is None or field.metadata.get("static") or field.metadata.get("axes") or dataclasses.is_dataclass(part):
        raise InputError(f"{name!r} is not a single number, so it cannot vary in a sweep")
    return field


def unit_of(given: dict[str, Any], name: str) -> str:
    """SI unit of a parameter, "" where none is known."""
    if name == "speed":
        return "m/s"
    field = field_of(given, name)
    return "" if field is None else field.metadata.get("unit", "")


def placed(given: dict[str, Any], values: dict[str, Any]) -> dict[str, Any]:
    """The arguments of a study with values (arrays with lanes) put in by name."""
    given = dict(given)
    for name, value in values.items():
        whose = owner(name)
        if whose == "vehicle":
            given["vehicle"] = set_parameter(given["vehicle"], name, value)
        elif whose in ("track", "damper"):
            given[whose] = _set(given[whose], name.split(".")[1:], value)
        else:
            given[name] = value
    return given


def _set(part: Any, path: list[str], value: Any) -> Any:
    head, *rest = path
    return dataclasses.replace(part, **{head: _set(getattr(part, head), rest, value) if rest else value})


def check_range(given: dict[str, Any], name: str, low: float, high: float) -> None:
    """Refuse values from `low` to `high` that the parameter cannot take (sign, range), naming it."""
    field = field_of(given, name)
    if name == "speed" and not low > 0:
        raise InputError(f"speed must be positive (m/s), not {low:g}: creepage is a ratio to the speed")
    if owner(name) == "vehicle":
        check_number(name, np.array([low, high]), field.metadata)
    elif field is not None:
        ends = placed(given, {name: np.array([low, high])})
        check_track(ends["track"]) if owner(name) == "track" else check_damper(ends["damper"])
