"""Measured tracks: a record of the lateral alignment, from arrays or a file, checked, mended, resampled and filtered."""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import ArrayLike, Float

from ...base.arguments import guarded
from ...base.checks import Range
from ...base.errors import InputError
from ...base.typing import Scalar
from .columns import FEWEST, read_track
from .repair import bridged, restored, spikes
from .sampled import MARGIN, SampledTrack, register
from .spectra import SHORTEST

#: straight track before the record, m, so that the leading wheelset starts on it
LEAD = 20.0

#: m; alignment beyond the first or below the second is a slip of units (or the layout of the line): track is kept within 0.03 m
LARGEST, SMALLEST = 0.2, 1e-6

#: m; a cross level that is farther from its mean is the cant of curves
MOST_CROSS = 0.05

#: the widest grid of the spline, m; the samples' own distance where it is smaller
GRID = SHORTEST / 8

#: zeros before and after the record in which the spline's coefficients die out (0.27 each)
TAIL = 24

#: share of a sample's distance by which even samples may be off, as printed distances are rounded
UNEVEN = 0.01

#: order of the Butterworth filter, which is run forwards and backwards
ORDER = 4


@dataclass(frozen=True)
class MeasuredRecord:
    """What was measured, as it was read, m: the gauge is kept, but the model does not use it."""

    distance: Float[np.ndarray, "..."]
    alignment: Float[np.ndarray, "..."]
    cross_level: Float[np.ndarray, "..."] | None = None
    gauge: Float[np.ndarray, "..."] | None = None
    name: str = "record"
    notes: tuple[str, ...] = field(default=())


@register
@dataclass(frozen=True, init=False, repr=False)
class MeasuredTrack(SampledTrack):
    """Measured lateral alignment over the distance, from 20 m in front of a run's start.

    The samples, their mean taken out, are put on an even grid by a cubic spline, filtered (Butterworth, 4th order, forwards and
    backwards: no phase, half the amplitude at the wavelength) and faded at the ends. Beyond both ends the track is straight. A
    record that holds the layout of the line needs `longest`, say 200 m.

    The cross level, treated likewise, rolls the track under the wheelsets as cant does (`Layout.curve_at`): with it the run needs double
    precision, and takes as long as on a layout.

    Versines are restored to the space curve: waves of half the chord, a quarter, ... are lost. Without `bridge` spikes and short
    gaps are named in `notes` and the rest is refused.

    Args:
        distance: shape `(samples,)`, m, rising, any spacing.
        alignment: shape `(samples,)`, m; with `chord` versines in the middle of chords.
        cross_level: shape `(samples,)`, m over 1.5 m, positive where the left rail is higher; by default none.
        gauge: shape `(samples,)`, m; kept as read, and the model does not use it.
        shortest: shorter waves are filtered away, m; by default none.
        longest: longer waves are filtered away, m; by default none, with a `chord` those longer than ten chords, 200 m at most.
        chord: length of the chords, m: 10, or 31, 62, 124 ft in m; by default the alignment is the space curve.
        bridge: samples without a value (NaN), single-sample spikes and gaps of the distance up to this length are bridged by
            straight lines, m; by default none.
        fade: over which the alignment rises from straight track at the start and returns to it at the end, m.
        rolls: False leaves the cross level out of the run.
        amplitude: factor on all, dimensionless, one or one per lane.
        name: of the record, for messages.
        notes: what was assumed in reading it.

    Raises:
        InputError: for fewer than 16 samples, values that are not finite, distance that does not rise, a gap, a record too short
            for its fades or filter, an alignment beyond 0.2 m or below 1 µm, which is a slip of units, and a cross level 50 mm from its
            mean, which is the cant of curves.
    """

    #: the cross level in the place of the alignment, m; None where it does not roll the track
    cross: "MeasuredTrack | None" = field(default=None)

    def __init__(
        self,
        distance: ArrayLike | Sequence,
        alignment: ArrayLike | Sequence,
        *,
        cross_level: ArrayLike | Sequence | None = None,
        gauge: ArrayLike | Sequence | None = None,
        shortest: float | None = None,
        longest: float | None = None,
        chord: float | None = None,
        bridge: float | None = None,
        fade: float = 50.0,
        rolls: bool = True,
        amplitude: Scalar = 1.0,
        name: str = "record",
        notes: tuple[str, ...] = (),
    ) -> None:
        kept = [None if values is None else np.asarray(values, float) for values in (distance, alignment, cross_level, gauge)]
        record = _mended(MeasuredRecord(*kept, name, notes), bridge)  # type: ignore[call-arg]
        samples, spacing = _even(record.distance, record.alignment)
        cross = None
        if rolls and record.cross_level is not None and np.ptp(record.cross_level) > SMALLEST:
            cross = self._rolling(record, shortest, longest, fade, amplitude)
        if chord is not None:
            samples, lost = restored(samples, spacing, chord, longest, name)
            record, longest = dataclasses.replace(record, notes=(*record.notes, *lost)), None
        samples = _checked(_filtered(samples, spacing, shortest, longest, name), longest, name)
        self._lay(_tapered(samples, spacing, fade, name), spacing, amplitude)
        self._set(cross=cross, label=record)

    def _lay(self, samples: Float[np.ndarray, "points"], spacing: float, amplitude: Scalar) -> None:
        """Make it the track of these samples."""
        self._set(
            coefficients=_coefficients(samples),
            spacing=spacing,
            start=LEAD - TAIL * spacing,
            amplitude=amplitude,
            fade=None,
            periodic=False,
        )

    @staticmethod
    def _rolling(
        record: MeasuredRecord, shortest: float | None, longest: float | None, fade: float, amplitude: Scalar
    ) -> "MeasuredTrack":
        """The cross level over the distance."""
        samples, spacing = _even(record.distance, record.cross_level)  # type: ignore[arg-type]
        samples = _filtered(samples, spacing, shortest, longest, record.name)
        if (peak := float(np.max(np.abs(samples)))) > MOST_CROSS:
            raise InputError(
                f"{record.name}: the cross level reaches {1e3 * peak:.3g} mm from its mean, which is the cant of curves: take it out by longest=200.0, "
                "or leave it out by rolls=False"
            )
        made = object.__new__(MeasuredTrack)
        made._lay(_tapered(samples, spacing, fade, record.name), spacing, amplitude)
        made._set(cross=None, label=None)
        return made

    @guarded(amplitude=Range("1", axes=1))
    def scaled(self, amplitude: Scalar) -> "MeasuredTrack":
        """The same track with this `amplitude`, a factor, instead of its own, also of the cross level; one value, or one per lane."""
        found = super().scaled(amplitude)
        found._set(cross=None if self.cross is None else self.cross.scaled(amplitude))
        return found

    @classmethod
    def from_csv(
        cls,
        path: str | Path,
        *,
        columns: Mapping[str, str] | None = None,
        units: Mapping[str, str] | None = None,
        shortest: float | None = None,
        longest: float | None = None,
        chord: float | None = None,
        bridge: float | None = None,
        fade: float = 50.0,
        rolls: bool = True,
        amplitude: Scalar = 1.0,
    ) -> "MeasuredTrack":
        """The track of a file of numbers, of any separator, decimal mark and encoding.

        It holds the distance, the alignment (or that of the left and right rail, whose mean is taken), and where there are any,
        cross level and gauge, which are left out if values are missing. A record against the kilometres is turned round. `notes`
        say what was assumed and done.

        Args:
            path: the file.
            columns: name, or number from 1, of the column of "distance", "alignment", "left", "right", "cross_level" and "gauge";
                what is not named is looked up in the header.
            units: unit of each, as `pint` writes it; what is not named is looked up in the header, as in "alignment (mm)".
            shortest: shorter waves are filtered away, m; by default none.
            longest: longer waves are filtered away, m; by default none, with a `chord` those longer than ten chords, 200 m at
                most.
            chord: length of the chord where the alignment is versines in its middle, which are restored, m; 10, or 62 ft in m.
            bridge: samples without a value, spikes and gaps up to this length are bridged, m; by default none.
            fade: over which the alignment rises from straight track and returns to it at the ends, m.
            rolls: False leaves the cross level out of the run.
            amplitude: factor on all, dimensionless, one or one per lane.

        Raises:
            InputError: for a file that cannot be read, columns that are missing or whose numbers no track has in their unit,
                versines without a `chord`, and what `MeasuredTrack` refuses.
        """
        path = Path(path)
        found, notes = read_track(path, columns or {}, units or {}, chord is not None, bridge is not None)
        return cls(
            **found,
            shortest=shortest,
            longest=longest,
            chord=chord,
            bridge=bridge,
            fade=fade,
            rolls=rolls,
            amplitude=amplitude,
            name=str(path),
            notes=tuple(sorted(notes)),
        )

    @property
    def cross_level(self) -> Float[np.ndarray, "samples"] | None:
        """Cross level of the record over its own distances, m; None where there is none, or JAX has rebuilt the track."""
        return self.label and self.label.cross_level

    @property
    def gauge(self) -> Float[np.ndarray, "samples"] | None:
        """Track gauge of the record over its own distances, m; None as for `cross_level`."""
        return self.label and self.label.gauge

    @property
    def notes(self) -> tuple[str, ...]:
        """What was assumed in reading the record."""
        return self.label.notes if self.label else ()

    def __str__(self) -> str:
        made = ""
        if self.label is not None:
            d = self.label.distance
            made = f" of {self.label.name}, {d.size} samples from {d[0]:g} to {d[-1]:g} m"
        lines = [f"MeasuredTrack{made}, points every {self.spacing:g} m"]
        return "\n".join(lines + [f"  {note}" for note in self.notes])

    __repr__ = __str__


def _mended(record: MeasuredRecord, bridge: float | None) -> MeasuredRecord:
    """The record, checked, with holes and spikes bridged if that is asked for; its notes name them."""
    name, count = record.name, record.distance.size
    if bridge is not None and not (np.isfinite(bridge) and bridge > 0.0):
        raise InputError(f"{name}: bridge must be a positive number of metres, not {bridge!r}")
    for entry in dataclasses.fields(record)[:4]:
        key, values = entry.name, getattr(record, entry.name)
        if values is None:
            continue
        if values.shape != (count,):
            raise InputError(f"{name}: {key} must hold one number for each of the {count} distances, not shape {values.shape}")
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size and not (bridge is not None and key == "alignment"):
            raise InputError(f"{name}: {key} of sample {bad[0] + 1} is {values[bad[0]]}; cut such samples out of the record")
    if count < FEWEST:
        raise InputError(f"{name}: {count} samples are too few to make a track; it takes {FEWEST}")
    steps = np.diff(record.distance)
    falls = np.flatnonzero(steps <= 0.0)
    if falls.size:
        raise InputError(
            f"{name}: distance does not increase from sample {falls[0] + 1} ({record.distance[falls[0]]:g} m) to the next"
        )
    widest, usual = int(np.argmax(steps)), float(np.median(steps))
    if steps[widest] > max(10.0 * usual, SHORTEST) and not (bridge is not None and steps[widest] <= bridge):
        raise InputError(f"{name}: a gap of {steps[widest]:g} m after {record.distance[widest]:g} m; cut the record there")
    notes = []
    if steps[widest] > 3.0 * usual:
        gaps = int(np.sum(steps > 3.0 * usual))
        notes.append(
            f"distance: {gaps} gap(s), the widest of {steps[widest]:g} m after {record.distance[widest]:g} m, splined over"
        )
    alone = spikes(record.alignment)
    if alone.any():
        where = ", ".join(f"{d:g}" for d in record.distance[alone][:5]) + (" m and on" if alone.sum() > 5 else " m")
        verb = "bridged" if bridge is not None else "kept (bridge takes them out)"
        notes.append(f"alignment: {int(alone.sum())} spike(s) of a single sample {verb}, at {where}")
    if bridge is not None:
        lacking = ~np.isfinite(record.alignment)
        _, holes = bridged(record.distance, record.alignment, lacking, bridge, name, "alignment")
        values, _ = bridged(record.distance, record.alignment, lacking | alone, np.inf, name, "alignment")
        if holes:
            notes.append(f"alignment: {holes} hole(s) bridged, the first at {record.distance[int(np.argmax(lacking))]:g} m")
        record = dataclasses.replace(record, alignment=values)
    if np.ptp(record.alignment) == 0.0:
        raise InputError(f"{name}: the alignment never changes; for straight track there is TangentTrack")
    return dataclasses.replace(record, notes=(*record.notes, *notes))


def _even(d: Float[np.ndarray, "samples"], values: Float[np.ndarray, "samples"]) -> tuple[Float[np.ndarray, "points"], float]:
    """Values at the distances d without their mean on an even grid, and the grid's spacing; samples that are even stay points of the grid."""
    eta = values - np.mean(values)
    step = float(d[-1] - d[0]) / (d.size - 1)
    even = np.max(np.abs(d - d[0] - step * np.arange(d.size))) < UNEVEN * step
    if not even:
        step = float(np.median(np.diff(d)))
    spacing = step / np.ceil(step / GRID - 1e-6)
    if even and spacing == step:
        return eta, step
    from scipy.interpolate import CubicSpline

    knots = d[0] + step * np.arange(d.size) if even else d
    points = d[0] + spacing * np.arange(int((d[-1] - d[0]) / spacing + 1e-6) + 1)
    return CubicSpline(knots, eta)(points), float(spacing)


def _filtered(
    samples: Float[np.ndarray, "points"], spacing: float, shortest: float | None, longest: float | None, name: str
) -> Float[np.ndarray, "points"]:
    length = spacing * (samples.size - 1)
    for key, wavelength in (("shortest", shortest), ("longest", longest)):
        if wavelength is not None and not 2.0 * spacing < wavelength < length:
            raise InputError(
                f"{name}: {key} must lie between two spacings ({2 * spacing:g} m) and the record's length ({length:g} m), not {wavelength!r}"
            )
    if shortest is not None and longest is not None and not shortest < longest:
        raise InputError(f"{name}: the band is empty: shortest {shortest:g} m is not below longest {longest:g} m")
    if shortest is not None or longest is not None:
        from scipy.signal import butter, sosfiltfilt

        edges = {"highpass": longest, "lowpass": shortest}
        for kind, wavelength in edges.items():
            if wavelength is not None:
                filter_ = butter(ORDER, 1.0 / wavelength, kind, fs=1.0 / spacing, output="sos")
                padding = min(samples.size - 1, round(2.0 * wavelength / spacing))
                samples = sosfiltfilt(filter_, samples, padlen=padding)
    return samples


def _checked(samples: Float[np.ndarray, "points"], longest: float | None, name: str) -> Float[np.ndarray, "points"]:
    """The alignment; refused where no track has it."""
    peak = float(np.max(np.abs(samples)))
    if not SMALLEST < peak < LARGEST:
        cause = "check its unit" + (
            ", and take out the layout of the line by longest=200.0" if peak > 1.0 and longest is None else ""
        )
        raise InputError(f"{name}: the alignment reaches {peak:.3g} m from its mean, which no track has; {cause}")
    return samples


def _tapered(samples: Float[np.ndarray, "points"], spacing: float, fade: float, name: str) -> Float[np.ndarray, "points"]:
    length = spacing * (samples.size - 1)
    if not (isinstance(fade, int | float) and spacing <= fade <= 0.5 * length):
        raise InputError(f"{name}: fade must lie between the spacing and half the record's {length:g} m, not {fade!r}")
    from_ends = spacing * np.minimum(np.arange(samples.size), np.arange(samples.size)[::-1])
    t = np.minimum(from_ends / fade, 1.0)
    return samples * t**3 * (10.0 - 15.0 * t + 6.0 * t**2)


def _coefficients(samples: Float[np.ndarray, "points"]) -> Float[np.ndarray, "k"]:
    """Coefficients of the spline through the samples, with straight track before and after them."""
    values = np.pad(samples, TAIL)
    response = (2.0 + np.cos(2.0 * np.pi * np.arange(values.size // 2 + 1) / values.size)) / 3.0
    coefficients = np.fft.irfft(np.fft.rfft(values) / response, values.size)
    coefficients[:MARGIN] = coefficients[-MARGIN:] = 0.0
    # cell i takes the coefficients i - 1 to i + 2, and the spline's value at its start is sample i
    return np.pad(coefficients, (1, MARGIN - 1))
