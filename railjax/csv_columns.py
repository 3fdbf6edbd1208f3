"""Columns of a CSV file: found by name, units from the header ("force (kN)") or as told; every fault is one line."""

import csv
import re
from pathlib import Path

import numpy as np
from jaxtyping import Float

from .errors import InputError

Samples = Float[np.ndarray, "samples"]

#: per quantity, the names by which its column is found without being told; and the factors of its units to SI, SI first
Names = dict[str, tuple[str, ...]]
Units = dict[str, dict[str, float]]


def read_columns(
    path: Path,
    names: Names,
    units: Units,
    *,
    columns: dict[str, str | None] | None = None,
    given: dict[str, str | None] | None = None,
    at_least: int = 2,
    purpose: str = "be of use",
    options: tuple[str, str] = ("--{}", "--{}-unit"),
) -> tuple[dict[str, Samples], list[str]]:
    """Read the quantities of `names` from a CSV file with a header, in SI, and notes on what was assumed.

    `columns` names a quantity's column and `given` its unit; what is not named is looked up in the header, and a quantity
    without a column is left out. `at_least` samples it takes to `purpose`; `options` are how the user names a quantity's column
    and its unit (on the command line or in Python), for the messages.

    Raises `InputError` for a file that cannot be read, too few samples, an unknown column or unit, and a cell that is no
    finite number.
    """
    rows = _rows(path)
    if len(rows) < at_least + 1:
        raise InputError(f"{path}: {max(len(rows) - 1, 0)} samples are too few to {purpose}; it takes {at_least}")
    columns, given = columns or {}, given or {}
    header = [cell.strip() for cell in rows[0][1]]
    found, notes = {}, []
    for kind in columns.keys() | given.keys():
        if kind not in names:
            raise InputError(f"no quantity {kind!r} in such a file; there are {', '.join(names)}")
    for kind in names:
        index, unit = _column(header, kind, names[kind], units[kind], columns.get(kind), given.get(kind), path, options)
        if index is None:
            continue
        if unit is None:
            unit = next(iter(units[kind]))
            told = options[1].format(kind)
            notes.append(f"unit of {kind} ({header[index]!r}): {unit} (assumed; neither the header nor {told} says it)")
        found[kind] = _values(rows[1:], index, header[index], path) * units[kind][unit]
    return found, notes


def _rows(path: Path) -> list[tuple[int, list[str]]]:
    """Line numbers and cells of the lines that are not empty."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            return [(number, row) for number, row in enumerate(csv.reader(file), 1) if any(cell.strip() for cell in row)]
    except (OSError, ValueError, csv.Error) as error:
        raise InputError(f"{path}: cannot be read as CSV ({getattr(error, 'strerror', None) or type(error).__name__})") from None


def _column(
    header: list[str],
    kind: str,
    names: tuple[str, ...],
    units: dict[str, float],
    name: str | None,
    unit: str | None,
    path: Path,
    options: tuple[str, str],
) -> tuple[int | None, str | None]:
    """Index of a quantity's column and its unit, as far as they are known."""
    told = options[1].format(kind)
    if unit is not None and unit not in units:
        raise InputError(f"{told} must be one of {', '.join(units)}, not {unit!r}")
    # up to the last bracket, as units may have their own: "density (m^2/(rad/m))"
    split = [re.fullmatch(r"(.*?)\s*[\(\[](.*)[\)\]]", cell) for cell in header]
    bare = [match.group(1) if match else cell for match, cell in zip(split, header, strict=True)]
    if name is not None:
        index = next((i for i, cell in enumerate(header) if name in (cell, bare[i])), None)
        if index is None:
            there = ", ".join(cell for cell in header if cell)
            raise InputError(f"{path}: no column {name!r} for {options[0].format(kind)}; there are {there}")
    else:
        index = next((i for known in names for i, cell in enumerate(bare) if cell.lower() == known), None)
        if index is None:
            return None, None
    written = split[index].group(2).strip() if split[index] else None
    if unit is None and written is not None and written not in units:
        raise InputError(
            f"{path}: unit {written!r} of column {header[index]!r} is not known; use one of {', '.join(units)}, or {told}"
        )
    return index, unit or written


def _values(rows: list[tuple[int, list[str]]], index: int, name: str, path: Path) -> Samples:
    values = np.empty(len(rows))
    for k, (line, row) in enumerate(rows):
        try:
            values[k] = float(row[index])
        except (IndexError, ValueError):
            cell = row[index].strip() if index < len(row) else ""
            raise InputError(f"{path}, line {line}: column {name!r} holds {cell[:40]!r}, not a number") from None
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        raise InputError(
            f"{path}, line {rows[bad[0]][0]}: column {name!r} is {values[bad[0]]}; cut such samples out of the record"
        )
    return values
