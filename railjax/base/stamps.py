"""Stamps of time as files write them, and the even grid that their samples lie on or are put on."""

import re
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from .errors import InputError

Samples = Float[np.ndarray, "samples"]

#: dates that are not ISO 8601; those with a slash say as much forwards as backwards within a day
DATES = (
    "%d.%m.%Y %H:%M:%S.%f",
    "%d.%m.%Y %H:%M:%S",
    "%Y/%m/%d %H:%M:%S.%f",
    "%Y/%m/%d %H:%M:%S",
    "%d/%m/%Y %H:%M:%S.%f",
    "%d/%m/%Y %H:%M:%S",
)
CLOCK = re.compile(r"\d{1,2}:\d{2}(:\d{2}([.,]\d+)?)?")

#: seconds since 1970 of the years 1990 to 2070, by which an epoch is told, in units
EPOCH = (6.3e8, 3.2e9)
EPOCH_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}

#: s; a hole of the record up to it is bridged if nothing else is said
BRIDGE = 0.1

#: share of a sample by which stamps may be off an even grid without being resampled
EVEN = 0.01

#: s; steps of a time whose unit is not said, from which on seconds are doubted: no record of vibrations is sampled so slowly
SLOWEST = 0.1


def seconds_of(texts: list[str], path: str) -> Samples | None:
    """Seconds from the first of the stamps (ISO 8601, a clock time, dates with points or slashes), NaN where one is none; None if
    they are no stamps at all."""
    import pandas as pd

    first = texts[0]
    if ":" not in first:
        return None
    if CLOCK.fullmatch(first):
        whole = [text if text.count(":") == 2 else f"{text}:00" for text in texts]
        clock = (
            pd.to_timedelta(pd.Series(whole).str.replace(",", ".", regex=False), errors="coerce").dt.total_seconds().to_numpy()
        )
        midnight = np.concatenate([[0.0], np.cumsum(np.diff(clock) < -43200.0)])
        return clock - clock[0] + 86400.0 * midnight
    stamps = pd.Series(texts).str.replace(",", ".", regex=False)
    for form in ("ISO8601", *DATES):
        found = pd.to_datetime(stamps, format=form, utc=True, errors="coerce")
        if found.notna().mean() > 0.5:
            return (found - found.iloc[0]).dt.total_seconds().to_numpy()
    raise InputError(f"{path}: stamps of time such as {first!r} are not understood; write them as ISO 8601, or in seconds")


def epoch_unit(time: Samples) -> str | None:
    """The unit of a time that counts from 1970, None if it does not."""
    for unit, factor in EPOCH_UNITS.items():
        if EPOCH[0] < time[0] * factor < EPOCH[1]:
            return unit
    return None


@dataclass(frozen=True)
class Grid:
    """Where samples lie in time: `dt` in s, and where they were not even, their own `stamps` in s from the first; `notes` say what was done."""

    dt: float
    stamps: Samples | None = None
    holes: Bool[np.ndarray, "steps"] | None = None
    notes: tuple[str, ...] = ()

    def even(self, values: Samples) -> Float[np.ndarray, "instants"]:
        """Samples at even instants: cubic between stamps, straight across holes."""
        if self.stamps is None:
            return values
        from scipy.interpolate import CubicSpline

        instants = self.dt * np.arange(int(self.stamps[-1] / self.dt + 1e-6) + 1)
        found = CubicSpline(self.stamps, values)(instants)
        across = self.holes[np.clip(np.searchsorted(self.stamps, instants, side="right") - 1, 0, len(self.holes) - 1)]  # type: ignore[index]
        return np.where(across, np.interp(instants, self.stamps, values), found)


def sampling(
    time: Samples | None,
    sample_rate: float | None,
    path: object,
    option: str = "--sample-rate",
    *,
    unit_assumed: bool = False,
    bridge: float = BRIDGE,
    there: str = "",
    unit_option: str = "--time-unit",
) -> Grid:
    """The grid of samples with stamps `time` (s), or of those at `sample_rate` (Hz), which `option` gives and which has the last word.

    Stamps may be rounded, even so coarsely that several samples share one; those of a clock that jitters are resampled at their
    median step, and holes up to `bridge` s are bridged. Raises `InputError` for stamps that fall and for longer holes.
    """
    if sample_rate is not None:
        return Grid(1.0 / sample_rate, notes=_told(time, sample_rate, option))
    if time is None:
        raise InputError(
            f"{path}: no column of the time; name it 'time', or give {option} in Hz" + (f"; {there}" if there else "")
        )
    steps = np.diff(time)
    if unit_assumed and np.median(steps) >= SLOWEST and epoch_unit(time) is None:
        raise InputError(
            f"{path}: a sample every {np.median(steps):g} s, if the time is in s; give its unit by {unit_option}, or {option}"
        )
    resolution = _resolution(time)
    dt = _rounded(time, resolution)
    if dt is not None:
        note = f"time: stamps are rounded to {resolution:g} s, taken as even at {1.0 / dt:.6g} Hz"
        return Grid(dt, notes=(note,) if resolution > dt else ())
    falls = np.flatnonzero(steps <= 0.0)
    if falls.size:
        raise InputError(
            f"{path}: time does not increase from sample {falls[0] + 1} ({time[falls[0]]:g} s) to the next; "
            f"{option} takes the samples as even"
        )
    median = float(np.median(steps))
    holes = steps > max(1.5 * median, np.quantile(steps, 0.9) * 1.5)
    longest = int(np.argmax(steps))
    if holes.any() and steps[longest] > bridge + 1e-9:
        raise InputError(
            f"{path}: samples are not evenly spaced: a hole of {steps[longest]:.4g} s after {time[longest]:g} s; "
            f"holes up to {bridge:g} s are bridged, cut the record there, say how much (bridge, --bridge-s), or give {option} to take its samples as even"
        )
    if np.quantile(steps[~holes], 0.99) > 4.0 * median or np.quantile(steps, 0.01) < 0.05 * median:
        worst = int(np.argmax(np.abs(steps - median)))
        raise InputError(f"{path}: samples are not evenly spaced (near {time[worst]:g} s); resample the record first")
    step = float(np.mean(steps[~holes]))
    dt = _round_rate(step)
    off = float(np.max(np.abs(steps[~holes] - step))) / step
    notes = [
        f"time: stamps up to {off:.0%} of a step off, resampled at {1.0 / dt:.6g} Hz (cubic); {option} takes the samples as even"
    ]
    if holes.any():
        notes.append(
            f"time: {int(holes.sum())} hole(s) up to {steps[holes].max():.4g} s bridged, the first after {time[int(np.argmax(holes))]:g} s"
        )
    return Grid(dt, time - time[0], holes, tuple(notes))


def _told(time: Samples | None, rate: float, option: str) -> tuple[str, ...]:
    if time is None or len(time) < 2 or not np.all(np.isfinite(time)) or time[-1] <= time[0]:
        return ()
    own = (len(time) - 1) / float(time[-1] - time[0])
    return () if abs(own / rate - 1.0) <= 0.01 else (f"{option} {rate:g} Hz as told, though the time column says {own:.6g} Hz",)


def _resolution(time: Samples) -> float:
    """What stamps are rounded to: the greatest number of which all steps are multiples, as far as their digits go."""
    steps = np.diff(time)
    apart = np.abs(steps[steps != 0.0])
    if not apart.size:
        return 0.0
    quantum = 10.0 ** np.ceil(np.log10(max(1e-9 * apart.max(), 4.0 * np.spacing(np.max(np.abs(time))))))
    return float(np.gcd.reduce(np.round(apart / quantum).astype(np.int64))) * float(quantum)


def _rounded(time: Samples, resolution: float) -> float | None:
    """The interval if the stamps are those of even samples, rounded or cut to their resolution; else None."""
    steps = np.diff(time)
    dt = float(time[-1] - time[0]) / (len(time) - 1)
    if dt <= 0.0 or np.any(steps < 0.0):
        return None
    numbers = np.arange(len(time))
    if np.max(np.abs(time - time[0] - dt * numbers)) <= EVEN * dt:
        return dt
    if np.any(steps == 0.0) and resolution < 1.001 * dt:
        return None
    if resolution > dt:
        # coarse stamps are surest where they change
        changes = np.flatnonzero(steps) + 1
        if len(changes) < 2:
            return None
        dt = _round_rate(float(time[changes[-1]] - time[changes[0]]) / float(changes[-1] - changes[0]))
    else:
        # the line through all stamps is surer than its ends
        dt = float(np.polyfit(numbers - numbers.mean(), time - time.mean(), 1)[0])
    return dt if np.ptp(time - dt * numbers) <= 1.02 * resolution + (2.0 * dt if resolution > dt else 0.0) else None


def _round_rate(dt: float) -> float:
    """An interval whose rate is within 0.1 % of a whole number of Hz, as that."""
    rate = round(1.0 / dt)
    return 1.0 / rate if rate and abs(rate * dt - 1.0) < 1e-3 else dt
