"""Files of profiles: tables of lateral position and height as people have them, and SIMPACK's .prw and .prr."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ...base.csv_columns import IN_PYTHON, quantities, read_columns
from ...base.errors import InputError
from ...base.text_table import open_table
from .profile_points import FEWEST, Source

#: per quantity: the names by which a column is found without being told, and factors of units to SI, the usual one first
NAMES = {
    "lateral": ("lateral", "lateral position", "y", "s", "x", "width", "yw", "yr", "y wheel", "y rail"),
    "height": ("height", "vertical", "vertical position", "z", "radius", "zw", "zr", "z wheel", "z rail", "h"),
}
UNITS = {kind: {"mm": 1e-3, "m": 1.0, "cm": 1e-2, "in": 25.4e-3} for kind in NAMES}

#: SIMPACK's files, and what their header calls a wheel
SIMPACK = (".prw", ".prr")
WHEEL = 1
NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d+)?"


class Read(NamedTuple):
    """Points of a file in m, along the profile; where each is from, what was assumed, and whether they are free of noise."""

    lateral: Float[np.ndarray, "points"]
    height: Float[np.ndarray, "points"]
    source: Source
    notes: tuple[str, ...]
    exact: bool


def read_profile(path: Path, wheel: bool, columns: Mapping[str, str] | None = None, unit: str | None = None) -> Read:
    """Points of a profile as they are in a file. Raises `InputError` for one that cannot be read, naming the line."""
    if path.suffix.lower() in SIMPACK:
        return _simpack(path, wheel)
    notes: list[str] = []
    if not columns and quantities(path, NAMES, UNITS) != set(NAMES):
        cells = len(open_table(path, lambda _: False).names)
        if cells != 2:
            raise InputError(
                f"{path}: of {cells} columns none is named as lateral position and height; name them by columns['lateral'] and columns['height']"
            )
        columns = {"lateral": "1", "height": "2"}
        notes = ["the first column taken as the lateral position, the second as the height"]
    given = dict.fromkeys(NAMES, unit)
    read = read_columns(
        path, NAMES, UNITS, columns=columns, given=given, at_least=FEWEST, purpose="make a profile", options=IN_PYTHON
    )
    for kind in NAMES:
        if kind not in read.found:
            raise InputError(f"{path}: no column of the {kind}; name it by columns[{kind!r}]; {read.there}")
    # one unit for both, in one sentence
    assumed = [note for note in read.notes if note.startswith("unit of")]
    notes += [note for note in read.notes if note not in assumed]
    notes += [f"numbers taken as {next(iter(UNITS['lateral']))}"] if assumed else []
    lines = open_table(path, lambda _: False).lines
    return Read(read.found["lateral"], read.found["height"], Source(path.name, lines), tuple(notes), False)


def _simpack(path: Path, wheel: bool) -> Read:
    """SIMPACK's profile: key = value with the processing in the order of its numbers, then points y z between point.begin and point.end."""
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or type(error).__name__})") from None
    keys: dict[str, float] = {}
    points, lines, inside = [], [], False
    for number, line in enumerate(text.splitlines(), 1):
        content = line.split("!", 1)[0].strip()
        if content in ("point.begin", "point.end"):
            inside = content == "point.begin"
        elif inside and content:
            cells = content.replace("D", "E").replace("d", "e").split()
            if len(cells) < 2 or not all(re.fullmatch(NUMBER, cell) for cell in cells[:2]):
                raise InputError(f"{path}, line {number}: {content[:40]!r} is no point (y and z)")
            points.append([float(cell) for cell in cells[:2]])
            lines.append(number)
        elif found := re.fullmatch(rf"([\w.]+)\s*=\s*({NUMBER})", content):
            keys.setdefault(found.group(1), float(found.group(2)))
    if len(points) < FEWEST:
        raise InputError(
            f"{path}: {len(points)} points between point.begin and point.end are too few for a profile; it takes {FEWEST}"
        )
    if keys.get("type", float(wheel)) != (WHEEL if wheel else 0):
        raise InputError(
            f"{path}: is the profile of a {'rail' if wheel else 'wheel'}, by its header (type), not of a {'wheel' if wheel else 'rail'}"
        )
    y, z = np.array(points).T
    rows = np.array(lines)
    y, z = y + keys.get("shift.y", 0.0), z + keys.get("shift.z", 0.0)
    if angle := keys.get("rotate", 0.0) / keys.get("units.ang.f", 1.0):
        y, z = y * np.cos(angle) - z * np.sin(angle), y * np.sin(angle) + z * np.cos(angle)
    for values, name in ((y, "y"), (z, "z")):
        low, high = keys.get(f"bound.{name}.min", 1.0), keys.get(f"bound.{name}.max", 0.0)
        if low < high:  # otherwise there is no bound
            kept = (values >= low) & (values <= high)
            y, z, rows = y[kept], z[kept], rows[kept]
    y = -y if keys.get("mirror.y") else y
    z = -z if keys.get("mirror.z") else z
    if keys.get("inversion"):
        y, z, rows = y[::-1], z[::-1], rows[::-1]
    factor = keys.get("units.len.f", 1.0)
    if not factor > 0.0:
        raise InputError(f"{path}: units.len.f must be positive, the user's units in a metre, not {factor:g}")
    return Read(y / factor, z / factor, Source(path.name, rows), (), True)
