"""Test records of dampers: a CSV file with motion, command and force, read and checked; every fault is one line."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from .checks import a_path, guarded, whole
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

#: samples below which thirteen parameters and a held-out part make no sense
SHORTEST = 500


@dataclass(frozen=True)
class Record:
    """A test of a damper, sampled evenly: displacement in m, velocity in m/s, command (V or A, not below zero), force in N.

    `notes` say what was assumed in reading it.
    """

    displacement: Samples
    velocity: Samples
    command: Samples
    force: Samples
    dt: float  # s
    name: str = "record"
    notes: tuple[str, ...] = field(default=())

    def __len__(self) -> int:
        return len(self.force)

    @property
    def time(self) -> Samples:
        """Seconds from the first sample."""
        return np.arange(len(self)) * self.dt

    @guarded(last=whole(1))
    def until(self, last: int) -> "Record":
        """The samples before number `last`."""
        return self._picked(slice(last), self.dt)

    @guarded(stride=whole(1))
    def every(self, stride: int) -> "Record":
        """Every `stride`-th sample: coarser steps over the same motion."""
        return self._picked(slice(None, None, stride), self.dt * stride)

    def _picked(self, samples: slice, dt: float) -> "Record":
        columns = (self.displacement, self.velocity, self.command, self.force)
        return Record(*(values[samples] for values in columns), dt, self.name, self.notes)


@guarded(path=a_path)
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
    Negative commands count as zero, as the current driver has one polarity.

    Raises `InputError` for a file that cannot be read, an unknown or missing column or unit, a cell that is no finite number,
    time that does not increase or is uneven by more than half a sample, and units of displacement and velocity that disagree.
    """
    path = Path(path)
    found, notes = read_columns(path, NAMES, UNITS, columns=columns, given=units, at_least=SHORTEST, purpose="identify a damper")
    return _assemble(found, sample_rate, path, notes)


def _assemble(found: dict[str, Samples], sample_rate: float | None, path: Path, notes: list[str]) -> Record:
    if "force" not in found:
        raise InputError(f"{path}: no column of the force; name it with --force")
    if "displacement" not in found and "velocity" not in found:
        raise InputError(f"{path}: no column of displacement or velocity; name one with --displacement or --velocity")
    dt = sampling_interval(found.get("time"), sample_rate, path)
    x, v, command = found.get("displacement"), found.get("velocity"), found.get("command")
    if v is None:
        v = _smooth_derivative(x, dt)
        notes.append("velocity: derivative of the displacement (quadratics over 11 samples)")
    elif x is None:
        x = np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1])) * dt])
        notes.append("displacement: integral of the velocity, from 0")
    else:
        slope = float(np.dot(_smooth_derivative(x, dt), v) / np.dot(v, v)) if np.any(v) else np.nan
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
    return Record(x, v, np.maximum(command, 0.0), found["force"], dt, path.name, tuple(notes))


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


def _smooth_derivative(values: Samples, dt: float) -> Samples:
    from scipy.signal import savgol_filter

    return savgol_filter(values, 11, 2, deriv=1, delta=dt)


def acceleration(record: Record) -> Samples:
    """x'' in m/s^2: derivative of the velocity (quadratics over about 10 ms)."""
    from scipy.signal import savgol_filter

    window = 2 * max(2, round(5e-3 / record.dt)) + 1
    return savgol_filter(record.velocity, window, 3, deriv=1, delta=record.dt)
