"""Records of rides: accelerations by direction out of a file, with gravity and missing units told from their means."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..base.csv_columns import TIME_NAMES, TIME_UNITS, Columns, Names, Samples, Units, read_columns
from ..base.errors import InputError
from ..base.file_units import STANDARD_GRAVITY, factor
from ..base.stamps import BRIDGE, sampling
from .acceptance.record import RunningRecord
from .indices import GRAVITY, gravity_note

ACCELERATIONS = {"m/s2": 1.0, "m/s^2": 1.0, "m/s²": 1.0, "g": STANDARD_GRAVITY, "mg": 1e-3 * STANDARD_GRAVITY}

_ACROSS = {"lateral": ("y", "lat"), "vertical": ("z", "vert"), "longitudinal": ("x", "long")}
WORDS = ("acceleration", "acc", "accel")

#: names by which a phone as well as a vehicle's logger may call its axes
LETTERED = re.compile(rf"({'|'.join(WORDS)})?[ _-]?[xyz]\b", re.IGNORECASE)

#: by these names a column is found without being told
NAMES: Names = {
    "time": TIME_NAMES,
    **{
        direction: (
            *(direction, f"a{axis}", f"a {axis}", axis, short),
            *(f"{word} {way}" for word in WORDS for way in (direction, short, axis)),
            *(f"{way} {word}" for word in WORDS for way in (direction, short, axis)),
            *(f"{word}{axis}" for word in WORDS[1:3]),
        )
        for direction, (axis, short) in _ACROSS.items()
    },
    "seat lateral": ("seat lateral", "seat y", "seat ay"),
    "seat vertical": ("seat vertical", "seat z", "seat az"),
    "backrest longitudinal": ("backrest longitudinal", "backrest x", "seat back longitudinal", "seat back x"),
    "roll rate": ("roll rate", "roll velocity", "gyro x", "gyroscope x"),
}  # fmt: skip
ROLL_RATES = {"rad/s": 1.0, "deg/s": np.pi / 180.0, "°/s": np.pi / 180.0}
UNITS: Units = {kind: {"time": TIME_UNITS, "roll rate": ROLL_RATES}.get(kind, ACCELERATIONS) for kind in NAMES}


@dataclass(frozen=True)
class Ride:
    """Accelerations (m/s^2, a roll rate in rad/s) by direction, sampled evenly at `rate` Hz; `notes` say what was assumed."""

    values: dict[str, Samples]
    rate: float
    notes: tuple[str, ...]


def read_ride(
    path: str | Path,
    *,
    columns: Mapping[str, str | None] | None = None,
    units: Mapping[str, str | None] | None = None,
    sample_rate: float | None = None,
    bridge: float = BRIDGE,
    names: Names = NAMES,
    known: Units = UNITS,
    purpose: str = "judge comfort",
) -> Ride:
    """Read a ride: `columns` and `units` by direction ("lateral", ...) or "time", as `read_record` takes them.

    Accelerations that are named are the only ones; the rate (Hz) has the last word over the time. Where the unit is not said, a
    vertical record whose mean is 1 is in g, with gravity in it, and so are those beside it. Raises `InputError`.
    """
    path, told = Path(path), {kind: name for kind, name in (columns or {}).items() if name is not None}
    wanted = [kind for kind in names if kind in ("time", *told) or not set(told) - {"time"}]
    given = {kind: unit for kind, unit in (units or {}).items() if kind in wanted or kind not in names}
    read = read_columns(
        path,
        {kind: names[kind] for kind in wanted},
        known,
        columns=told,
        given=given,
        purpose=purpose,
        options=("--columns {}=", "--unit"),
        lenient=() if sample_rate is None else ("time",),
    )
    found = read.found
    time = found.pop("time", None)
    if not found:
        raise InputError(f"{path}: no column of an acceleration; name it, as in --columns lateral=NAME; {read.there}")
    grid = sampling(time, sample_rate, path, "--fs", unit_assumed="time" in read.assumed, bridge=bridge, there=read.there)
    notes = [*read.notes, *grid.notes]
    lettered = [
        f"{name!r} {kind}" for kind, name in read.names.items() if kind in _ACROSS and kind not in told and LETTERED.match(name)
    ]
    if lettered:
        notes.append(f"axes: {', '.join(lettered)} (assumed: x along the vehicle, y across it, z up; a phone's axes are its own)")
    unsaid = [kind for kind in found if kind in read.assumed and known[kind] is ACCELERATIONS]
    said = {unit for kind, unit in read.units.items() if kind in found and kind not in unsaid and known[kind] is ACCELERATIONS}
    unit, why = _unit_by_gravity(path, read) if unsaid else None, "the vertical mean is 1 g in it"
    if unsaid and unit is None and len(said) == 1:
        unit, why = said.pop(), "the others are in it"
    if unit is not None:
        notes = [note for note in notes if not any(note.startswith(f"unit of {kind} ") for kind in unsaid)]
        notes.append(f"unit of {', '.join(unsaid)}: {unit} (assumed; not said, and {why})")
        found |= {kind: found[kind] * factor(unit, ACCELERATIONS) for kind in unsaid}
    return Ride({kind: grid.even(values) for kind, values in found.items()}, 1.0 / grid.dt, tuple(notes))


def _unit_by_gravity(path: Path, read: Columns) -> str | None:
    """The unit in which the mean of the vertical acceleration is gravity, of a column that does not say its unit; None if it holds none."""
    values = read.found.get("vertical") if "vertical" in read.assumed else None
    if values is None:
        try:
            beside = read_columns(path, {"vertical": NAMES["vertical"]}, UNITS, lenient=("vertical",))
        except InputError:
            return None
        values = beside.found.get("vertical") if "vertical" in beside.assumed else None
    if values is None or not np.isfinite(values).any():
        return None
    mean = abs(float(np.nanmean(values)))
    for unit in ("g", "m/s2"):
        if GRAVITY[0] < mean * ACCELERATIONS[unit] / STANDARD_GRAVITY < GRAVITY[1]:
            return unit
    if mean > 2.0:
        raise InputError(f"{path}: the vertical acceleration has the mean {mean:.4g} and no unit; give it, as in --unit g")
    return None


def _numbered(*stems: str) -> tuple[tuple[str, ...], ...]:
    return tuple(tuple(f"{stem}{gap}{k}" for stem in stems for gap in (" ", "")) for k in range(1, PARTS + 1))


#: as many wheelsets, axles or bogies a record of a running test may have
PARTS = 8

#: columns of a running test, numbered from the front; the lateral acceleration of a ride counts as that over the leading bogie
OF_TEST: dict[str, tuple[tuple[str, ...], ...]] = {
    "guiding force": _numbered("guiding force", "sumy", "sum y", "σy", "guiding force wheelset"),
    "bogie": _numbered("bogie", "bogie acceleration", "bogie frame", "y bogie", "ay bogie"),
    "carbody": _numbered("carbody", "carbody acceleration", "car body", "body", "lateral", "ay", "ay body"),
}
FORCES = {"N": 1.0, "kN": 1e3, "lbf": 4.4482216152605}
TEST_NAMES: Names = {"time": TIME_NAMES} | {f"{part} {k}": own for part, each in OF_TEST.items() for k, own in enumerate(each, 1)}
TEST_NAMES["carbody 1"] += NAMES["lateral"]
TEST_UNITS: Units = {
    kind: TIME_UNITS if kind == "time" else FORCES if kind.startswith("guiding") else ACCELERATIONS for kind in TEST_NAMES
}


def read_running_record(path: str | Path, speed: float, **options: Any) -> tuple[RunningRecord, tuple[str, ...]]:
    """A running test at `speed` (m/s) out of a file, and notes on what was assumed: "guiding force 1", ... of the wheelsets, "bogie 1", ...
    over the axles, "carbody 1", ... over the bogies; `options` are those of `read_ride`. Raises `InputError`."""
    ride = read_ride(path, names=TEST_NAMES, known=TEST_UNITS, purpose="judge a run", **options)
    signals: dict[str, Any] = {}
    for part, key in (("guiding force", "guiding_force"), ("bogie", "bogie_acceleration"), ("carbody", "carbody_acceleration")):
        own = [ride.values[f"{part} {k}"] for k in range(1, PARTS + 1) if f"{part} {k}" in ride.values]
        if own:
            signals[key] = np.stack(own, axis=1)
            if key != "guiding_force":
                for values in own:
                    gravity_note(part, values)
    return RunningRecord(speed, ride.rate, **signals, name=Path(path).name), ride.notes
