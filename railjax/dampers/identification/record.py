"""Test records of dampers: a file with motion, command and force, read and checked; every fault is one line."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ...base import file_units
from ...base.arguments import guarded
from ...base.checks import Range, a_path, from_zero, whole
from ...base.csv_columns import TIME_NAMES, TIME_UNITS, Columns, Samples, read_columns
from ...base.errors import InputError
from ...base.stamps import BRIDGE, sampling

#: per quantity: the names by which a column is found without being told, and the factors of its usual units to SI
NAMES = {
    "time": TIME_NAMES,
    "displacement": ("displacement", "x", "stroke", "disp", "displ", "travel", "position"),
    "velocity": ("velocity", "v", "speed", "vel"),
    "command": (
        "command", "voltage", "current", "u", "cmd", "volt", "volts", "i", "input", "control", "amps", "ampere", "excitation",
        "command voltage", "command current", "coil current", "coil voltage", "control voltage", "control current", "input voltage",
        "input current", "voltage cmd", "cmd voltage",
    ),
    "force": ("force", "f", "load", "damper force", "damping force"),
}  # fmt: skip
UNITS = {
    "time": TIME_UNITS,
    "displacement": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "in": 25.4e-3},
    "velocity": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3, "in/s": 25.4e-3},
    "command": {"V": 1.0, "mV": 1e-3, "A": 1.0, "mA": 1e-3},
    "force": {"N": 1.0, "kN": 1e3, "lbf": 4.4482216152605},
}

#: SI, the range of what dampers do: where no unit is said, numbers beyond it are in another one
PLAUSIBLE = {"displacement": (1e-5, 0.3), "velocity": (1e-5, 4.0), "force": (5.0, 2e5)}

#: what names the column of a quantity that the record lacks
NONE = "none"
#: quartics over 2 m + 1 samples, of which the shortest is taken that leaves less noise than this share of the velocity's r.m.s.
HALF_WIDTHS, NOISE = (2, 3, 4, 6, 9, 13, 20), 2e-3

#: samples below which thirteen parameters and a held-out part make no sense
SHORTEST = 500


@dataclass(frozen=True)
class Record:
    """A test of a damper, sampled evenly: displacement in m, velocity in m/s, command (V or A, not below zero), force in N.

    `notes` say what was assumed in reading it. `begins` are the numbers of the samples at which a stretch begins that does not go on
    from the one before (`joined`); `integrated` says that the displacement is the velocity's integral, and drifts with its offset.
    """

    displacement: Samples
    velocity: Samples
    command: Samples
    force: Samples
    dt: float  # s
    name: str = "record"
    notes: tuple[str, ...] = field(default=())
    begins: tuple[int, ...] = (0,)
    integrated: bool = False

    def __len__(self) -> int:
        return len(self.force)

    @property
    def time(self) -> Samples:
        """Seconds from the first sample; stretches one after the other."""
        return np.arange(len(self)) * self.dt

    @property
    def stretches(self) -> list[slice]:
        """The samples of each stretch."""
        return [slice(*ends) for ends in itertools.pairwise((*self.begins, len(self)))]

    @guarded(last=whole(1))
    def until(self, last: int) -> "Record":
        """The samples before number `last`."""
        return self._picked([slice(s.start, min(s.stop, last)) for s in self.stretches if s.start < last], self.dt)

    @guarded(share=Range("1", 0.0, 1.0))
    def share(self, share: float) -> "Record":
        """The first share of each stretch."""
        return self._picked([slice(s.start, s.start + int(share * (s.stop - s.start))) for s in self.stretches], self.dt)

    @guarded(stride=whole(1))
    def every(self, stride: int) -> "Record":
        """Every `stride`-th sample of each stretch: coarser steps over the same motion."""
        return self._picked([slice(s.start, s.stop, stride) for s in self.stretches], self.dt * stride)

    def _picked(self, parts: list[slice], dt: float) -> "Record":
        lengths = [len(range(part.start, part.stop, part.step or 1)) for part in parts]
        begins = tuple(int(number) for number in np.cumsum([0, *lengths[:-1]]))
        columns = (self.displacement, self.velocity, self.command, self.force)
        picked = [np.concatenate([values[part] for part in parts]) for values in columns]
        return Record(*picked, dt, self.name, self.notes, begins, self.integrated)  # type: ignore[call-arg]


def joined(records: Sequence[Record]) -> Record:
    """Several tests of one damper as one record, whose stretches have nothing to do with each other. Raises `InputError` unless they are
    sampled alike, within 0.1 %."""
    first, *others = records
    for other in others:
        if abs(other.dt / first.dt - 1.0) > 1e-3:
            raise InputError(
                f"{other.name} is sampled at {1 / other.dt:.6g} Hz, {first.name} at {1 / first.dt:.6g} Hz: thin one, Record.every(...)"
            )
    if not others:
        return first
    columns = ("displacement", "velocity", "command", "force")
    lengths = np.cumsum([0, *map(len, records[:-1])])
    begins = tuple(int(at + begin) for at, record in zip(lengths, records, strict=True) for begin in record.begins)
    return Record(  # type: ignore[call-arg]
        *(np.concatenate([getattr(record, name) for record in records]) for name in columns),
        first.dt,
        ", ".join(dict.fromkeys(record.name for record in records)),
        tuple(dict.fromkeys(note for record in records for note in record.notes)),
        begins,
        any(record.integrated for record in records),
    )


@guarded(path=a_path, bridge=from_zero("s"))
def read_record(
    path: str | Path,
    *,
    columns: dict[str, str | None] | None = None,
    units: dict[str, str | None] | None = None,
    sample_rate: float | None = None,
    bridge: float = BRIDGE,
) -> Record:
    """Read a record from a file of numbers: any separator, decimal mark, encoding, with comments and a header or without.

    Of displacement and velocity one is enough. Stamps that jitter are resampled; where the time begins anew a new stretch begins.
    Without a command the record is taken as one at 0 V. Negative commands count as zero, as the current driver has one polarity.

    Args:
        path: the file.
        columns: name, or number from 1, of the column of "time", "displacement", "velocity", "command" and "force"; what is not
            named is looked up in the header. {"command": "none"} says that there is none, where other columns could be it.
        units: unit of each, as `pint` writes it; what is not named is looked up in the header, as in "force (kN)".
        sample_rate: Hz; has the last word over the time, which then may be missing.
        bridge: holes up to this length are bridged, s; by default 0.1.

    Raises:
        InputError: for a file that cannot be read, an unknown or missing column or unit, a cell that is no finite number, time
            that does not increase, longer holes, units of displacement and velocity that disagree, and numbers without a unit
            that no damper reaches in SI.
    """
    path, told = Path(path), dict(columns or {})
    without = (told.get("command") or "").lower() == NONE
    names = {kind: own for kind, own in NAMES.items() if not (without and kind == "command")}
    if without:
        told.pop("command")
    given = {kind: unit for kind, unit in (units or {}).items() if kind in names or kind not in NAMES}
    read = read_columns(
        path,
        names,
        UNITS,
        columns=told,
        given=given,
        at_least=SHORTEST,
        purpose="identify a damper",
        lenient=() if sample_rate is None else ("time",),
    )
    return joined([_assemble(piece, sample_rate, path, bridge, without) for piece in _at_restarts(read)])


#: a time that falls below the stretch's second sample begins anew, if so many samples follow
AFTER_RESTART = 100


def _at_restarts(read: Columns) -> list[Columns]:
    """The columns in pieces, cut where the time begins anew."""
    time = read.found.get("time")
    if time is None:
        return [read]
    begins = [0]
    for fall in np.flatnonzero(np.diff(time) < 0.0) + 1:
        if time[fall] <= time[begins[-1] + 1] and min(fall - begins[-1], len(time) - fall) >= AFTER_RESTART:
            begins.append(int(fall))
    pieces = (
        {name: values[slice(*ends)] for name, values in read.found.items()} for ends in itertools.pairwise([*begins, len(time)])
    )
    return [replace(read, found=piece, notes=list(read.notes)) for piece in pieces]


def _assemble(read: Columns, sample_rate: float | None, path: Path, bridge: float, without_command: bool) -> Record:
    found, notes = read.found, read.notes
    if "force" not in found:
        raise InputError(f"{path}: no column of the force; name it with --force; {read.there}")
    if "displacement" not in found and "velocity" not in found:
        raise InputError(
            f"{path}: no column of displacement or velocity; name one with --displacement or --velocity; {read.there}"
        )
    grid = sampling(
        found.pop("time", None), sample_rate, path, unit_assumed="time" in read.assumed, bridge=bridge, there=read.there
    )
    found, dt = {kind: grid.even(values) for kind, values in found.items()}, grid.dt
    notes.extend(grid.notes)
    for kind, (least, largest) in PLAUSIBLE.items():
        reached = float(np.max(np.abs(found[kind]))) if kind in read.assumed else largest
        if reached > largest or 0.0 < reached < least:
            si, *others = UNITS[kind]
            raise InputError(
                f"{path}: a {kind} of {reached:.3g} {si} (column {read.assumed[kind]!r}, which says no unit) is none of a "
                f"damper; give its unit, --{kind}-unit {others[0]} or another"
            )
    x, v, command = found.get("displacement"), found.get("velocity"), found.get("command")
    if command is None and not without_command:
        _refuse_overlooked(read, path)
    if v is None:
        v, window = derivative(x, dt)
        notes.append(f"velocity: derivative of the displacement (quartics over {window} samples)")
    elif x is None:
        x = np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1])) * dt])
        notes.append("displacement: integral of the velocity, from 0")
    else:
        slope = float(np.dot(derivative(x, dt)[0], v) / np.dot(v, v)) if np.any(v) else np.nan
        if not 0.5 < slope < 2.0:
            raise InputError(
                f"{path}: the displacement changes {slope:.3g} times as fast as the velocity says; check --displacement-unit and --velocity-unit"
            )
    if command is None:
        command = np.zeros_like(found["force"])
        notes.append("command: none in the record, taken as 0 throughout")
    elif np.any(command < 0):
        notes.append("command: negative values count as 0 (assumed: the driver has one polarity)")
    for name, values in (("force", found["force"]), ("velocity", v)):
        if np.std(values) == 0.0:
            raise InputError(f"{path}: the {name} never changes; such a record identifies nothing")
    integrated = "displacement" not in found
    return Record(x, v, np.maximum(command, 0.0), found["force"], dt, path.name, tuple(notes), integrated=integrated)


def _refuse_overlooked(read: Columns, path: Path) -> None:
    """Refuse a record whose command may be a column that is not known by name."""
    left = [name for name in read.unused if name and not _says_other_unit(name)]
    if left:
        raise InputError(
            f"{path}: no column of the command is known, and it may be {' or '.join(map(repr, left))}; name it with --command, "
            f"or say --command {NONE}"
        )


def _says_other_unit(name: str) -> bool:
    """Whether a header's cell says a unit that no command has."""
    units = [unit for _, unit, bracket in file_units.splits(name) if bracket]
    return bool(units) and all(file_units.factor(unit, UNITS["command"]) is None for unit in units)


def derivative(values: Samples, dt: float) -> tuple[Samples, int]:
    """The rate of a sampled quantity and the number of samples of each quartic that gave it."""
    from scipy.signal import savgol_coeffs, savgol_filter

    # sixth differences leave nothing of the motion, and of white noise 924 times its variance
    noise = np.std(np.diff(values, 6)) / np.sqrt(924.0)
    for half in HALF_WIDTHS:
        window = 2 * half + 1
        rate = savgol_filter(values, window, 4, deriv=1, delta=dt)
        left = noise * np.linalg.norm(savgol_coeffs(window, 4, deriv=1, delta=dt))
        if left < NOISE * np.std(rate):
            break
    return rate, window


def acceleration(record: Record) -> Samples:
    """x'' in m/s^2: derivative of the velocity (cubics over about 10 ms), of each stretch by itself."""
    from scipy.signal import savgol_filter

    window = 2 * max(2, round(5e-3 / record.dt)) + 1
    rates = [savgol_filter(record.velocity[stretch], window, 3, deriv=1, delta=record.dt) for stretch in record.stretches]
    return np.concatenate(rates)
