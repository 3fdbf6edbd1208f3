"""Test records of dampers: a CSV file with motion, command and force, read and checked; every fault is one line."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from .csv_columns import Samples, read_columns
from .errors import InputError

#: per quantity: the names by which a column is found without being told, and the factors of its units to SI
NAMES = {
    "time": ("time", "t"),
    "displacement": ("displacement", "x", "stroke"),
    "velocity": ("velocity", "v", "speed"),
    "command": ("command", "voltage", "current", "u"),
    "force": ("force", "f"),
}
UNITS = {
    "time": {"s": 1.0, "ms": 1e-3},
    "displacement": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "in": 25.4e-3},
    "velocity": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3, "in/s": 25.4e-3},
    "command": {"V": 1.0, "mV": 1e-3, "A": 1.0, "mA": 1e-3},
    "force": {"N": 1.0, "kN": 1e3, "lbf": 4.4482216152605},
}

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

    def until(self, last: int) -> "Record":
        """The samples before number `last`."""
        return self._picked([slice(s.start, min(s.stop, last)) for s in self.stretches if s.start < last], self.dt)

    def share(self, share: float) -> "Record":
        """The first share of each stretch."""
        return self._picked([slice(s.start, s.start + int(share * (s.stop - s.start))) for s in self.stretches], self.dt)

    def every(self, stride: int) -> "Record":
        """Every `stride`-th sample of each stretch: coarser steps over the same motion."""
        return self._picked([slice(s.start, s.stop, stride) for s in self.stretches], self.dt * stride)

    def _picked(self, parts: list[slice], dt: float) -> "Record":
        lengths = [len(range(part.start, part.stop, part.step or 1)) for part in parts]
        begins = tuple(int(number) for number in np.cumsum([0, *lengths[:-1]]))
        columns = (self.displacement, self.velocity, self.command, self.force)
        picked = [np.concatenate([values[part] for part in parts]) for values in columns]
        return Record(*picked, dt, self.name, self.notes, begins, self.integrated)


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
    return Record(
        *(np.concatenate([getattr(record, name) for record in records]) for name in columns),
        first.dt,
        ", ".join(dict.fromkeys(record.name for record in records)),
        tuple(dict.fromkeys(note for record in records for note in record.notes)),
        begins,
        any(record.integrated for record in records),
    )


def read_record(
    path: str | Path,
    *,
    columns: dict[str, str | None] | None = None,
    units: dict[str, str | None] | None = None,
    sample_rate: float | None = None,
) -> Record:
    """Read a record from a CSV file with a header.

    `columns` names the column of "time", "displacement", "velocity", "command" and "force", `units` their units; what is not
    named is looked up in the header, which may give units as in "force (kN)". Of displacement and velocity one is enough, and
    the time column may be left out where `sample_rate` (Hz) is given. Without a command the record is taken as one at 0 V.
    Negative commands count as zero, as the current driver has one polarity. Where the time begins anew a new stretch begins.

    Raises `InputError` for a file that cannot be read, an unknown or missing column or unit, a cell that is no finite number,
    time that does not increase or is uneven by more than half a sample, and units of displacement and velocity that disagree.
    """
    path = Path(path)
    found, notes = read_columns(path, NAMES, UNITS, columns=columns, given=units, at_least=SHORTEST, purpose="identify a damper")
    pieces = [_assemble(piece, sample_rate, path, list(notes)) for piece in _at_restarts(found)]
    return joined(pieces)


#: a time that falls below the stretch's second sample begins anew, if so many samples follow
AFTER_RESTART = 100


def _at_restarts(found: dict[str, Samples]) -> list[dict[str, np.ndarray]]:
    """The columns in pieces, cut where the time begins anew."""
    time = found.get("time")
    if time is None:
        return [found]
    begins = [0]
    for fall in np.flatnonzero(np.diff(time) < 0.0) + 1:
        if time[fall] <= time[begins[-1] + 1] and min(fall - begins[-1], len(time) - fall) >= AFTER_RESTART:
            begins.append(int(fall))
    return [{name: values[slice(*ends)] for name, values in found.items()} for ends in itertools.pairwise([*begins, len(time)])]


def _assemble(found: dict[str, Samples], sample_rate: float | None, path: Path, notes: list[str]) -> Record:
    if "force" not in found:
        raise InputError(f"{path}: no column of the force; name it with --force")
    if "displacement" not in found and "velocity" not in found:
        raise InputError(f"{path}: no column of displacement or velocity; name one with --displacement or --velocity")
    dt = sampling_interval(found.get("time"), sample_rate, path)
    x, v, command = found.get("displacement"), found.get("velocity"), found.get("command")
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
        command = np.zeros_like(x)
        notes.append("command: none in the record, taken as 0 throughout")
    elif np.any(command < 0):
        notes.append("command: negative values count as 0 (assumed: the driver has one polarity)")
    for name, values in (("force", found["force"]), ("velocity", v)):
        if np.std(values) == 0.0:
            raise InputError(f"{path}: the {name} never changes; such a record identifies nothing")
    integrated = "displacement" not in found
    return Record(x, v, np.maximum(command, 0.0), found["force"], dt, path.name, tuple(notes), integrated=integrated)


def sampling_interval(time: Samples | None, sample_rate: float | None, path: Path, option: str = "--sample-rate") -> float:
    """The sampling interval in s; a printed time may be rounded, so it need only lie within half a sample of an even one.

    `option` is how the user gives `sample_rate` (Hz), for the messages.
    """
    if time is None:
        if sample_rate is None:
            raise InputError(f"{path}: no column of the time; name it 'time', or give {option} in Hz")
        return 1.0 / sample_rate
    falls = np.flatnonzero(np.diff(time) <= 0.0)
    if falls.size:
        raise InputError(f"{path}: time does not increase from sample {falls[0] + 1} ({time[falls[0]]:g} s) to the next")
    dt = float(time[-1] - time[0]) / (len(time) - 1)
    off = np.abs(time - time[0] - dt * np.arange(len(time)))
    if np.max(off) > 0.5 * dt:
        raise InputError(f"{path}: samples are not evenly spaced (near {time[np.argmax(off)]:g} s); resample the record first")
    if sample_rate is not None and abs(dt * sample_rate - 1.0) > 0.01:
        raise InputError(f"{path}: {option} {sample_rate:g} Hz, but the time column says {1.0 / dt:.6g} Hz")
    return dt if sample_rate is None else 1.0 / sample_rate


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
