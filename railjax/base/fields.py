"""Fields of dataclasses that are parameters: unit, symbol, meaning, sign and choices declared once, and the one check that reads them.

Constructors take anything, because JAX rebuilds pytrees with tracers and placeholders; functions and files ask here.
"""

import dataclasses
import functools
import math
import sys
from collections.abc import Mapping
from dataclasses import field
from typing import Any, Literal

import jax
import numpy as np
from jaxtyping import Float

from .checks import shown, traced
from .errors import InputError, nearest
from .units import SUFFIXES, keys_of

About = Mapping[str, Any]
Undeclared = Literal["from zero", "signed", "anything"]

#: the law of a part that has a smooth twin, as the value of a field
LAWS = ("sharp", "smooth")

LARGEST = sys.float_info.max


def parameter(
    unit: str, symbol: str, meaning: str, default: float | None = None, positive: bool = False, signed: bool = False
) -> Any:
    """A dataclass field that is a differentiable leaf; its metadata feed the file reader, messages, checks and charts. Neither `positive`
    nor `signed`: 0 or positive."""
    metadata = _about(unit, symbol, meaning, positive, signed)
    return field(metadata=metadata) if default is None else field(default=default, metadata=metadata)


def optional(
    unit: str, symbol: str, meaning: str, positive: bool = False, signed: bool = False, default: float | None = None
) -> Any:
    """A parameter that a part may do without: None, and then no leaf and no code."""
    return field(default=default, metadata=_about(unit, symbol, meaning, positive, signed) | {"optional": True})


def table(unit: str, symbol: str, meaning: str, signed: bool = False) -> Any:
    """A parameter given by several numbers: an array with one axis of its own, before any lanes."""
    return field(metadata=_about(unit, symbol, meaning, False, signed) | {"axes": 1})


def matrix(unit: str, symbol: str, meaning: str) -> Any:
    """Numbers of either sign in an array with two axes of its own, before any lanes; None where there are none yet."""
    return field(default=None, metadata=_about(unit, symbol, meaning, False, True) | {"axes": 2, "optional": True})


def structure(default: Any, meaning: str = "", one_of: tuple = ()) -> Any:
    """A dataclass field that is static, where given `one_of` some values: a change of it compiles anew."""
    return field(default=default, metadata={"static": True, "meaning": meaning, "one_of": one_of})


def twin(default: str = "sharp") -> Any:
    """The field `law` of a part whose law has a smooth twin, for gradients and limit cycles."""
    return structure(default, "the law as it is, or its smooth twin", LAWS)


def _about(unit: str, symbol: str, meaning: str, positive: bool, signed: bool) -> dict[str, Any]:
    return {"unit": unit, "symbol": symbol, "meaning": meaning, "positive": positive, "signed": signed}


def is_number(entry: dataclasses.Field) -> bool:
    """Whether a field declares a number, or several."""
    return "unit" in entry.metadata


def number_names(part: Any) -> list[str]:
    """The fields of a dataclass that may be numbers: all but the static ones; none of what is no dataclass."""
    return (
        [entry.name for entry in dataclasses.fields(part) if not entry.metadata.get("static")]
        if dataclasses.is_dataclass(part)
        else []
    )


def is_single(value: Any) -> bool:
    """Whether a value is one finite number, neither lanes nor a table."""
    number = isinstance(value, (int, float, np.number, np.ndarray, jax.Array)) and not isinstance(value, bool)
    return number and np.ndim(value) == 0 and bool(np.isfinite(value))


def about_field(part: Any, name: str) -> About:
    """What a dataclass declares of a field; nothing of one of somebody else's."""
    return next(entry.metadata for entry in dataclasses.fields(part) if entry.name == name)


def wrong_sign(about: About, least: Any) -> str | None:
    """What a parameter must be where its least value has a sign that it cannot have, as the middle of a message. What declares nothing is
    not negative."""
    if about.get("positive") and not least > 0.0:
        return "must be positive"
    return "must not be negative" if least < 0.0 and not about.get("signed") else None


@functools.cache
def _numbers(kind: type, scattered: bool) -> tuple[tuple[str, float, About], ...]:
    """Name and metadata of each number that a class has, and the least finite float that it may be."""
    lowest = {True: math.nextafter(0.0, 1.0), False: -LARGEST if scattered else 0.0}
    found = []
    for entry in dataclasses.fields(kind):
        about = entry.metadata
        if not about.get("static"):
            signed = about.get("signed", False)
            found.append((entry.name, -LARGEST if signed else lowest[about.get("positive", False)], about))
    return tuple(found)


@functools.cache
def _choices(kind: type) -> tuple[tuple[str, tuple], ...]:
    return tuple((entry.name, choices) for entry in dataclasses.fields(kind) if (choices := entry.metadata.get("one_of")))


def check_numbers(part: Any, where: str, scattered: bool = False, undeclared: Undeclared = "from zero") -> bool:
    """Refuse what its fields do not allow of a dataclass, where it is known; whether all of it is. Raises `InputError`.

    Args:
        part: the dataclass; those within it are checked as well.
        where: what it is called in messages.
        scattered: what may be zero may be negative, as differences step to both sides of zero, and a lane may be NaN, as results mark it.
        undeclared: what the numbers of fields may be that declare nothing, of a class of somebody else's.
    """
    known = True
    # nearly all numbers are floats; the rest would take ten times as long
    for name, least, about in _numbers(type(part), scattered):
        value = getattr(part, name)
        if value.__class__ is float and least <= value <= LARGEST:
            continue
        if "unit" in about:
            known &= check_number(f"{where}.{name}", value, about, scattered)
        elif undeclared != "anything":
            known &= _undeclared(f"{where}.{name}", value, undeclared)
    for name, choices in _choices(type(part)):
        a_choice(f"{where}.{name}", getattr(part, name), choices)
    return known


def a_choice(key: str, value: Any, choices: tuple) -> None:
    """One of some values."""
    if value not in choices:
        raise InputError(f"{key} must be one of {', '.join(map(str, choices))}, not {shown(value)}")


def check_number(key: str, value: Any, about: About, scattered: bool = False) -> bool:
    """Refuse a value that its field does not allow, where it is known; whether it is. Otherwise as `check_numbers`."""
    if value is None and about.get("optional"):
        return True
    if isinstance(value, jax.core.Tracer) or (isinstance(value, (list, tuple, dict)) and traced(value)):
        return False
    unit, why = (
        "" if about["unit"] == "1" else f" ({about['unit']})",
        f"; it is the {about['meaning']}" if about["meaning"] else "",
    )
    own = about.get("axes", 0)
    try:
        array = np.asarray(value)
        wrong = array.dtype.kind not in "iuf" or array.ndim > own + 1 or not array.size
    except (TypeError, ValueError, OverflowError):
        wrong = True
    if wrong:
        if own == 0 and getattr(value, "ndim", 0) > 1:
            raise InputError(f"{key}: an array of shape {value.shape} has more than one axis of lanes; flatten the grid first")
        raise InputError(f"{key} must be a number{unit}, not {shown(value)}{why}")
    array = array.astype(float, copy=False)
    if scattered and array.ndim == own + 1:
        array = array[~np.isnan(array)]
    bad = array[~np.isfinite(array)]
    if bad.size:
        raise InputError(f"{key} must be finite{unit}, not {bad[0]:g}{why}")
    if about["signed"] or not array.size:
        return True
    least = np.min(array)
    fault = wrong_sign(about, least)
    if fault == "must be positive":
        raise InputError(f"{key} {fault}{unit}, not {least:g}{why}")
    if fault and not scattered:
        raise InputError(f"{key} {fault} ({least:g}){why}")
    return True


def _undeclared(key: str, value: Any, allowed: Undeclared) -> bool:
    """A field of somebody else's class: its numbers are finite, and single ones "from zero" not negative; arrays of more axes are tables, and
    a dataclass within declares for itself."""
    if dataclasses.is_dataclass(value):
        return check_numbers(value, key, undeclared="signed")
    leaves, known = jax.tree.leaves(value), True
    if isinstance(value, (list, dict)) and not leaves:
        raise InputError(f"{key} must be a number, not {shown(value)}")
    for leaf in leaves:
        if isinstance(leaf, jax.core.Tracer):
            known = False
            continue
        try:
            # NumPy, because under `jit` even constants become tracers of jax.numpy
            array = np.asarray(leaf, float)
        except (TypeError, ValueError):
            raise InputError(f"{key} must be a number, not {shown(value)}") from None
        if not array.size:
            raise InputError(f"{key} must be a number, not {shown(value)}")
        bad = array[~np.isfinite(array)]
        if bad.size:
            raise InputError(f"{key} must be finite, not {bad[0]:g}")
        if allowed == "from zero" and np.any(array < 0.0) and np.ndim(value) < 2:
            raise InputError(f"{key} must not be negative ({np.min(array):g})")
    return known


def given_number(value: Any, name: str) -> float:
    """A finite float out of a file, or an `InputError` that names the key."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise InputError(f"{name} must be a number, not {shown(value)}")
    try:
        given = float(value)
    except OverflowError:
        given = math.inf
    if not math.isfinite(given):
        raise InputError(f"{name} must be finite, not {shown(value)}")
    return given


def given_value(value: Any, factor: float, entry: dataclasses.Field, name: str) -> float | Float[np.ndarray, "points"]:
    """What a file gives for a field, in SI, with the sign that the field wants; a list for one that is a table."""
    if "axes" in entry.metadata:
        if not isinstance(value, list) or not value:
            raise InputError(f"{name} must be a list of numbers, like [20, 30, 40], not {shown(value)}")
        return np.array([_in_si(given_number(one, name), factor, entry.metadata, name) for one in value])
    return _in_si(given_number(value, name), factor, entry.metadata, name)


def _in_si(given: float, factor: float, about: About, name: str) -> float:
    """The key names the unit, in which messages then show the value."""
    result, meaning = given * factor, about["meaning"]
    fault = wrong_sign(about, result)
    if fault == "must be positive":
        raise InputError(f"{name} {fault}, not {given:g}; it is the {meaning}")
    if fault:
        raise InputError(f"{name} {fault} ({given:g}); it is the {meaning}")
    if not math.isfinite(result):
        raise InputError(f"{name} is too large ({given:g}); it is the {meaning}")
    return result


def keys_by_unit(part: Any) -> dict[str, tuple[dataclasses.Field, float]]:
    """Every key by which a file may give a number of a dataclass, with the field and the factor to SI: mass_kg, mass_t; of a unit without
    others the unit itself, voltage_gain_V_per_m. What declares no unit is given by its name."""
    found: dict[str, Any] = {}
    for entry in dataclasses.fields(part):
        if entry.metadata.get("static"):
            continue
        unit = entry.metadata.get("unit", "1")
        spelled = unit.replace("/", "_per_").replace(" ", "").replace("^", "")
        keys = keys_of(entry.name, unit) if unit in SUFFIXES else {f"{entry.name}_{spelled}": 1.0}
        found |= {key: (entry, factor) for key, factor in keys.items()}
    return found


def given_fields(
    part: Any, given: Mapping[str, Any], where: str, also: tuple[str, ...] = (), needed: bool = False
) -> dict[str, Any]:
    """Values by the fields of a dataclass, in SI, out of a file's table whose keys name their units. Raises `InputError`.

    Args:
        part: the dataclass or its class.
        given: the table.
        where: what the table is called in messages.
        also: keys that stand beside those of the fields, for the hint at an unknown one.
        needed: refuse a table that lacks a field without default.
    """
    accepted = {key: entry for key, entry in keys_by_unit(part).items() if is_number(entry[0])}
    others = {entry.name: entry for entry in dataclasses.fields(part) if not is_number(entry)}
    values: dict[str, Any] = {}
    for key, value in given.items():
        name = f"{where}.{key}"
        if key in accepted:
            entry, factor = accepted[key]
            if entry.name in values:
                raise InputError(f"{name}: {entry.name} is given twice, in two units; keep one")
            values[entry.name] = given_number(value, name) * factor
        elif key in others and isinstance(others[key].default, (tuple, str, int, type(None))):
            values[key] = _given_choice(others[key], value, name)
        else:
            known = [*also, *accepted, *others]
            raise InputError(f"unknown key {name}" + (nearest(key, known, where) if known else f": there are no {where}"))
    for entry in dataclasses.fields(part) if needed else ():
        if entry.name not in values and entry.default is dataclasses.MISSING:
            key = next(key for key, (one, _) in accepted.items() if one.name == entry.name)
            raise InputError(f"missing key {where}.{key}")
    return values


def _given_choice(entry: dataclasses.Field, value: Any, name: str) -> Any:
    """A value without a unit: one of some, a list of names, a name, or a whole number."""
    if entry.metadata.get("one_of"):
        a_choice(name, value, entry.metadata["one_of"])
        return value
    if isinstance(entry.default, tuple):
        if not isinstance(value, list) or not value or not all(isinstance(one, str) for one in value):
            raise InputError(f'{name} must be a list of names, like ["rms:carbody_acceleration"]')
        return tuple(value)
    if isinstance(entry.default, str):
        if not isinstance(value, str):
            raise InputError(f'{name} must be a name, like "{entry.default}", not {shown(value)}')
        return value
    if not isinstance(value, int) or isinstance(value, bool):
        raise InputError(f"{name} must be a whole number, not {shown(value)}")
    return value
