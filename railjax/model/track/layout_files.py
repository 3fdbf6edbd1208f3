"""Layouts from files: segments in TOML, samples in any file of numbers."""

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...base.csv_columns import IN_PYTHON, read_columns
from ...base.errors import InputError, nearest
from ...base.fields import given_number
from ...base.units import KMH
from .curve import cant_in_balance
from .segments import Segment

#: per quantity: the names by which a column is found without being told, and the factors of its units to SI
NAMES = {
    "distance": ("distance", "chainage", "station", "position", "s", "x", "km"),
    "curvature": ("curvature", "kappa", "k"),
    "radius": ("radius", "r", "curve radius"),
    "cant": ("cant", "superelevation", "cross level", "crosslevel"),
    "gauge": ("gauge", "track gauge", "gage"),
}
_SMALL = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "in": 25.4e-3}
UNITS = {
    "distance": {"m": 1.0, "km": 1e3, "ft": 0.3048},
    "curvature": {"1/m": 1.0, "1/km": 1e-3, "rad/km": 1e-3, "rad/m": 1.0},
    "radius": {"m": 1.0, "km": 1e3, "ft": 0.3048},
    "cant": _SMALL,
    "gauge": _SMALL,
}
#: keys of a file and of its segments
TOP = ("ramp", "start_m", "segment")
KEYS = {
    "straight": ("kind", "length_m"),
    "transition": ("kind", "length_m"),
    "arc": ("kind", "length_m", "radius_m", "cant_mm", "cant_deficiency_mm", "speed_kmh"),
}


class FromFile(NamedTuple):
    """What a file says: segments with their ramp and start (m), or samples: distance (m), curvature (1/m) and perhaps cant (m)."""

    segments: list[Segment] | None
    ramp: str = "linear"
    start: float = 0.0
    samples: tuple = ()


def read_layout(path: Path, columns: Mapping[str, str], units: Mapping[str, str]) -> FromFile:
    """What a layout's file says. Raises `InputError`.

    Args:
        path: .toml for segments, else samples.
        columns: of the quantities, as `Layout.load` has them.
        units: of the quantities.
    """
    if path.suffix != ".toml":
        return FromFile(None, samples=_samples(path, columns, units))
    try:
        given = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"no TOML: {' '.join(str(error).split())}") from None
    for key in given:
        if key not in TOP:
            raise InputError(f"unknown key {key}{nearest(key, TOP)}")
    segments = given.get("segment")
    if not isinstance(segments, list) or not segments or not all(isinstance(one, dict) for one in segments):
        raise InputError("a layout is a list of tables [[segment]] with kind, length_m and more")
    made = [_segment(one, f"segment {k + 1}") for k, one in enumerate(segments)]
    return FromFile(made, given.get("ramp", "linear"), given_number(given.get("start_m", 0.0), "start_m"))


def _segment(given: dict[str, Any], where: str) -> Segment:
    kind = given.get("kind")
    if kind not in KEYS:
        raise InputError(f"{where}.kind must be one of {', '.join(KEYS)}, not {kind!r}")
    for key in given:
        if key not in KEYS[kind]:
            raise InputError(f"unknown key {where}.{key}{nearest(key, KEYS[kind], where)}")
    numbers = {key: given_number(value, f"{where}.{key}") for key, value in given.items() if key != "kind"}
    for key in ("length_m", "radius_m") if kind == "arc" else ("length_m",):
        if key not in numbers:
            raise InputError(f"missing key {where}.{key}")
    try:
        if kind != "arc":
            return getattr(Segment, kind)(numbers["length_m"])
        radius = numbers["radius_m"]
        if "cant_deficiency_mm" in numbers:
            if "cant_mm" in numbers or "speed_kmh" not in numbers or radius == 0.0:
                raise InputError("give cant_mm, or cant_deficiency_mm with speed_kmh")
            balanced = cant_in_balance(numbers["speed_kmh"] / KMH, radius)
            return Segment.arc(numbers["length_m"], radius, balanced - 1e-3 * numbers["cant_deficiency_mm"])
        return Segment.arc(numbers["length_m"], radius, 1e-3 * numbers.get("cant_mm", 0.0))
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def _samples(path: Path, columns: Mapping[str, str], units: Mapping[str, str]) -> tuple:
    read = read_columns(
        path,
        NAMES,
        UNITS,
        columns=columns,
        given=units,
        at_least=4,
        purpose="make a layout",
        options=IN_PYTHON,
        lenient=("gauge", "radius"),
    )
    found = read.found
    if "distance" not in found or not {"curvature", "radius"} & set(found):
        raise InputError(f"a layout needs columns of the distance and of the curvature (1/m) or radius (m); {read.there}")
    if "curvature" in found:
        curvature = found["curvature"]
    else:
        # straight track is written as 0, as nothing, or as a very large radius
        radius = found["radius"]
        curvature = np.where(np.isfinite(radius) & (radius != 0.0), 1.0 / np.where(radius == 0.0, np.inf, radius), 0.0)
    return found["distance"], curvature, found.get("cant")
