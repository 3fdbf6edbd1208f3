"""Columns of a file of numbers: found by name, number or unit, in SI; every fault is one line that names it."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from . import file_units
from .errors import InputError
from .stamps import epoch_unit, seconds_of
from .text_table import TextTable, is_number, open_table

Samples = Float[np.ndarray, "samples"]

#: per quantity, the names by which its column is found without being told; and the factors of its usual units to SI, SI first
Names = dict[str, tuple[str, ...]]
Units = dict[str, dict[str, float]]

#: names and units of the time, which every record of it shares
TIME_NAMES = (
    "time", "t", "timestamp", "time stamp", "elapsed time", "elapsed", "seconds elapsed", "seconds", "datetime", "date time",
    "date and time", "utc", "unix time", "epoch", "zeit", "temps", "tiempo", "cas",
)  # fmt: skip
TIME_UNITS = {"s": 1.0, "ms": 1e-3}

#: numbers by which files say that there is none: nines, where all others are far from them
SENTINELS = np.array([999.0, 999.9, 999.99, 999.25, 9999.0, 9999.9, 9999.99, 99999.0, 999999.0, 9999999.0])


@dataclass(frozen=True)
class Columns:
    """What was read: `found` by quantity, in SI, and its columns' `names` and `units`; `notes` of what was assumed; the columns that
    do not say their unit (`assumed`); by quantity the first line without a value (`lacking`), of those that may lack some; what else is there."""

    found: dict[str, Samples]
    names: dict[str, str]
    units: dict[str, str]
    notes: list[str]
    assumed: dict[str, str]
    lacking: dict[str, str]
    unused: tuple[str, ...]
    there: str = field(repr=False)


#: how the columns and units are named in a call from Python, for messages
IN_PYTHON = ("columns['{}']", "units['{}']")


def read_columns(
    path: Path,
    names: Names,
    units: Units,
    *,
    columns: Mapping[str, str | None] | None = None,
    given: Mapping[str, str | None] | None = None,
    at_least: int = 2,
    purpose: str = "be of use",
    options: tuple[str, str] = ("--{}", "--{}-unit"),
    lenient: Iterable[str] = (),
) -> Columns:
    """Read the quantities of `names` from a file of numbers, in SI, and notes on what was assumed.

    Separators, decimal marks, encodings, comments and a row of units are found (`text_table`). `columns` names a quantity's
    column, or gives its number from 1, and `given` its unit, in any spelling that `pint` knows; what is not named is looked up
    in the header, and a quantity without a column is left out. `at_least` samples it takes to `purpose`; `options` are how the
    user names a quantity's column and its unit (on the command line or in Python), for the messages. Quantities in `lenient` may
    lack values, which are NaN.

    Raises `InputError` for a file that cannot be read, too few samples, an unknown column or unit, and a cell that is no
    finite number or a sentinel (-999), in a column that is used.
    """
    columns, given = columns or {}, given or {}
    for kind in columns.keys() | given.keys():
        if kind not in names:
            raise InputError(f"no quantity {kind!r} in such a file; there are {', '.join(names)}")
    for kind, unit in given.items():
        if unit is not None and file_units.factor(unit, units[kind]) is None:
            raise InputError(f"{options[1].format(kind)} must be one of {', '.join(units[kind])}, not {unit!r}")
    table = _table(path, names, columns)
    there = ", ".join(name for name in table.names if name)
    if len(table) < at_least:
        raise InputError(f"{path}: {len(table)} samples are too few to {purpose}; it takes {at_least}")
    every = {kind: _place(table, kind, names[kind], units[kind], columns.get(kind), options[0]) for kind in names}
    places = {kind: index for kind, index in every.items() if index is not None}
    if not places and not table.has_header:
        raise InputError(
            f"{path}: has no header, only {len(table.names)} column(s), {table.form}; name them by number: {options[0].format(next(iter(names)))}"
            + ("1" if options[0].endswith("=") else " 1")
        )
    values = table.numbers(places.values())
    found, used, notes, assumed, lacking = {}, {}, [], {}, {}
    for kind, index in places.items():
        told = options[1].format(kind)
        unit = given.get(kind) or _written_unit(table, index, kind, names[kind], units[kind], told)
        if kind == "time" and (seconds := _stamps(table, index)) is not None:
            found[kind] = seconds
            continue
        column, missing = values[index], _missing(values[index])
        if missing.any():
            fault = _fault(table, int(np.argmax(missing)), index)
            if kind not in lenient:
                raise InputError(fault)
            column, lacking[kind] = np.where(missing, np.nan, column), fault
        if unit is None:
            unit = (epoch_unit(column) if kind == "time" else None) or next(iter(units[kind]))
            assumed[kind] = table.names[index]
            notes.append(f"unit of {kind} ({table.names[index]!r}): {unit} (assumed; neither the header nor {told} says it)")
        if unit.lower().strip() == "tonf":
            notes.append(f"unit of {kind}: tonf, taken as 2000 lbf (the metric one is tf)")
        used[kind] = unit
        scale = file_units.factor(unit, units[kind])
        found[kind] = column * (np.nan if scale is None else scale)
    unused = tuple(name for k, name in enumerate(table.names) if k not in places.values())
    called = {kind: table.names[index] for kind, index in places.items()}
    form = f"there are {there} ({table.form})" if table.has_header else f"no header ({table.form})"
    return Columns(found, called, used, notes, assumed, lacking, unused, form)


def quantities(path: Path, names: Names, units: Units, columns: Mapping[str, str | None] | None = None) -> set[str]:
    """Which quantities of `names` have a column in the file, or are told to have one."""
    table = _table(path, names, {})
    told = {kind for kind, name in (columns or {}).items() if name and kind in names}
    return told | {kind for kind in names if _place(table, kind, names[kind], units[kind], None, "") is not None}


def _table(path: Path, names: Names, columns: Mapping[str, str | None]) -> TextTable:
    known = {name for own in names.values() for name in own} | {file_units.plain(name) for name in columns.values() if name}

    def names_one(cell: str) -> bool:
        return file_units.plain(cell) in known or any(
            file_units.plain(name) in known and (bracket or file_units.is_unit(unit))
            for name, unit, bracket in file_units.splits(cell)
        )

    return open_table(path, names_one, tuple(name for name in columns.values() if name))


def _place(
    table: TextTable, kind: str, names: tuple[str, ...], units: dict[str, float], told: str | None, option: str
) -> int | None:
    """Index of a quantity's column, None if there is none."""
    if told is not None:
        if told in table.names:
            return table.names.index(told)
        if told.isdecimal() and 0 < int(told) <= len(table.names):
            return int(told) - 1
        names = (file_units.plain(told),)
    whole = [file_units.plain(cell) for cell in table.names]
    for name in names:
        places = [k for k, own in enumerate(whole) if own == name]
        places = places or [k for k, cell in enumerate(table.names) if _named(cell, name, units)]
        if len(places) > 1:
            cells = " and ".join(repr(table.names[k]) for k in places)
            raise InputError(f"{table.path}: columns {cells} may all be the {kind}; name one with {option.format(kind)}")
        if places:
            return places[0]
    if told is not None:
        there = ", ".join(name for name in table.names if name)
        raise InputError(f"{table.path}: no column {told!r} for {option.format(kind)}; there are {there}")
    return None


def _named(cell: str, name: str, units: dict[str, float]) -> bool:
    """Whether a header's cell is this name and a unit."""
    return any(
        file_units.plain(own) == name and (bracket or file_units.factor(unit, units) is not None)
        for own, unit, bracket in file_units.splits(cell)
    )


def _written_unit(
    table: TextTable, index: int, kind: str, names: tuple[str, ...], units: dict[str, float], told: str
) -> str | None:
    """The unit that the header or the row of units says; None if they say none."""
    cell, below = table.names[index], table.units[index]
    splits = list(file_units.splits(cell))
    for _, unit, _ in splits:
        if file_units.factor(unit, units) is not None:
            return unit
    if below is not None and file_units.factor(below, units) is not None:
        return below
    written = below or next((unit for name, unit, bracket in splits if bracket and file_units.plain(cell) not in names), None)
    if written is not None:
        raise InputError(
            f"{table.path}: unit {written!r} of column {cell!r} is not known; use one of {', '.join(units)}, or {told}"
        )
    return None


def _stamps(table: TextTable, index: int) -> Samples | None:
    """Seconds from the first stamp where the time is written as dates or clock times, else None."""
    if is_number(table.cell(0, index)):
        return None
    texts = table.texts(index)
    seconds = seconds_of(texts, str(table.path))
    if seconds is not None and not np.all(np.isfinite(seconds)):
        row = int(np.argmax(~np.isfinite(seconds)))
        raise InputError(
            f"{table.path}, line {table.lines[row]}: column {table.names[index]!r} holds {texts[row][:40]!r}, no stamp of time"
        )
    return seconds


def _missing(values: Samples) -> Bool[np.ndarray, "samples"]:
    """No finite number, or a sentinel beyond all others by half their range."""
    missing = ~np.isfinite(values)
    nines = np.isin(np.abs(values), SENTINELS)
    if nines.any() and not (nines | missing).all():
        others = values[~(nines | missing)]
        margin = 0.5 * np.ptp(others)
        missing |= nines & ((values < others.min() - margin) | (values > others.max() + margin))
    return missing


def _fault(table: TextTable, row: int, index: int) -> str:
    cell, where = table.cell(row, index), f"{table.path}, line {table.lines[row]}: column {table.names[index]!r}"
    if not is_number(cell):
        return f"{where} holds {cell[:40]!r}, not a number"
    value = float(cell.replace(",", ".")) if cell.count(",") + cell.count(".") < 2 else np.nan
    if np.isfinite(value) and not np.isin(abs(value), SENTINELS):
        return f"{where} holds {cell[:40]!r}, not a number ({table.form})"
    if np.isfinite(value):
        return f"{where} holds {cell}, which says that there is no value; cut such samples out of the record"
    return f"{where} is {value}; cut such samples out of the record"
