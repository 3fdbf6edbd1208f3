"""Measured tracks made whole: holes and single-sample spikes found and bridged, versines over chords restored to the space curve."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ...base.errors import InputError

Samples = Float[np.ndarray, "samples"]

#: a spike is a sample off its four neighbours' line by this many times what is usual (robust standard deviations), and this much, m
SPIKE, SPIKE_LEAST = 12.0, 1e-3

#: least share of a wave that a chord must show for it to be restored, at the long end (waves of 10 chords) and near its zeros
SHOWN_LONG, SHOWN = 0.05, 0.15

#: longest wave restored if nothing is said, m: beyond it is layout
LONGEST = 200.0


class Restored(NamedTuple):
    """The space curve and what of it the chord does not show, in words."""

    alignment: Samples
    notes: tuple[str, ...]


def spikes(values: Samples) -> Bool[np.ndarray, "samples"]:
    """Which samples stand alone far off their neighbours, which agree among themselves."""
    found = np.zeros(values.size, bool)
    if values.size < 16:
        return found
    near = np.stack([values[:-4], values[1:-3], values[3:-1], values[4:]])
    off = np.abs(values[2:-2] - np.median(near, axis=0))
    usual = 1.4826 * np.median(np.abs(off))
    found[2:-2] = (off > max(SPIKE * usual, SPIKE_LEAST)) & (off > 4.0 * np.ptp(near, axis=0))
    return found


def bridged(
    distance: Samples, values: Samples, lacking: Bool[np.ndarray, "samples"], longest: float, name: str, key: str
) -> tuple[Samples, int]:
    """The values with straight lines over what is lacking, and the number of holes. Raises `InputError` for one beyond `longest` m."""
    if not lacking.any():
        return values, 0
    there = np.flatnonzero(~lacking)
    if there.size < 2 or lacking[0] or lacking[-1]:
        raise InputError(f"{name}: the {key} lacks its values at an end of the record; cut it there")
    widths = np.diff(distance[there])
    holes = np.diff(there) > 1
    widest = int(np.argmax(np.where(holes, widths, 0.0)))
    if widths[widest] > longest + 1e-9:
        raise InputError(
            f"{name}: the {key} has a hole of {widths[widest]:.4g} m after {distance[there[widest]]:g} m, longer than the {longest:g} m to bridge"
        )
    return np.interp(distance, distance[there], values[there]), int(holes.sum())


def shown(chord: float, wavelength: Float[np.ndarray, "..."] | float) -> Float[np.ndarray, "..."] | float:
    """Share of a wave that is in the versine in a chord's middle, y(s) - (y(s - c/2) + y(s + c/2))/2: 1 - cos(π c/λ)."""
    return 1.0 - np.cos(np.pi * chord / wavelength)


def restored(versines: Samples, spacing: float, chord: float, longest: float | None, name: str) -> Restored:
    """The alignment (m) of which `versines` over a chord of `chord` m were taken, every `spacing` m.

    Divided in the frequency domain by what the chord shows of a wave; waves of which it shows less than 0.15 near its zeros (c/2,
    c/4, ...) fade out, and so do those longer than `longest` m (half the amplitude there, as a 4th-order Butterworth filter run
    both ways), by default 10 chords, at most 200 m. Within `longest` of the record's ends it is less sure.
    """
    length = spacing * (versines.size - 1)
    if not (np.isfinite(chord) and 4.0 * spacing <= chord <= 0.25 * length):
        raise InputError(
            f"{name}: chord must lie between four spacings ({4 * spacing:g} m) and a quarter of the record ({0.25 * length:g} m), not {chord!r}"
        )
    reach = float(np.pi * chord / np.arccos(1.0 - SHOWN_LONG))
    limit = min(reach, LONGEST) if longest is None else longest
    if limit > 2.0 * reach:
        raise InputError(
            f"{name}: of waves of {limit:g} m a chord of {chord:g} m shows {shown(chord, limit):.1%}; longest {2 * reach:.0f} m at most"
        )
    if not chord < limit < length:
        raise InputError(
            f"{name}: longest must lie between the chord ({chord:g} m) and the record's length ({length:g} m), not {limit:g}"
        )
    margin = min(versines.size - 1, round(2.0 * limit / spacing))
    # zeros spoil less of the ends than a reflection, whose corner the gain of long waves would swell
    padded = np.pad(versines - versines.mean(), margin)
    frequency = np.fft.rfftfreq(padded.size, spacing)
    share = shown(chord, 1.0 / np.maximum(frequency, 1e-12))
    # near a zero of short waves; the long end has the filter
    t = np.clip(2.0 * share / SHOWN - 1.0, 0.0, 1.0)
    near = np.where(frequency < 1.0 / chord, 1.0, t**2 * (3.0 - 2.0 * t))
    with np.errstate(divide="ignore", invalid="ignore"):
        gain = np.where((share > 0.0) & (frequency > 0.0), near / share, 0.0) / (
            1.0 + (1.0 / (limit * np.maximum(frequency, 1e-12))) ** 8
        )
    alignment = np.fft.irfft(np.fft.rfft(padded) * gain, padded.size)[margin : margin + versines.size]
    return Restored(alignment, _lost(chord, spacing, limit))


def _lost(chord: float, spacing: float, limit: float) -> tuple[str, ...]:
    half = np.arccos(1.0 - SHOWN) / np.pi
    bands = []
    for n in range(1, 4):
        shorter, longer = chord / (2 * n + half), chord / (2 * n - half)
        if shorter > 2.0 * spacing:
            bands.append(f"{shorter:.3g} to {longer:.3g} m")
    short = f"; waves near {', '.join(bands)}{' and so on' if len(bands) == 3 else ''} are lost, of which it shows less than {SHOWN:.0%}"
    return (
        f"alignment: restored from versines over a chord of {chord:g} m{short if bands else ''}",
        f"alignment: waves longer than {limit:.4g} m are filtered away; the chord shows {shown(chord, limit):.1%} of one, whose noise grows as much; the first and last {limit:.0f} m are less sure",
    )
