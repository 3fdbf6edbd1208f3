"""Signal processing of running tests: filters, means over distance, percentiles of sections, the hunting frequency."""

import numpy as np
from jaxtyping import Float

Signal = Float[np.ndarray, "samples parts"]

#: of each of the two passes
ORDER = 4

#: percentiles F1 and F2, %
PERCENTILES = (0.15, 99.85)

#: where the hunting frequency is looked for, Hz: from car-body hunting to stiffly guided wheelsets
HUNTING_BAND = (1.0, 12.0)


def filtered(values: Signal, rate: float, low: float | None, high: float) -> Signal:
    """Band-pass from `low` to `high` Hz (`low` None: low-pass) of samples at `rate` Hz, without shifting the phase.

    UIC 518 and EN 14363 ask of the magnitude only (recalled): -3 dB at the corner, at least 24 dB an octave beyond, within
    0.5 dB of the nominal curve up to it. Here a Butterworth filter of order 4 runs forwards and backwards, so that a peak keeps
    its place in the run, with its corners moved such that both passes together have the -3 dB where they are to be:

        |H| = 1/(1 + (√2 - 1) x^8),  x = f/f_2,  or of a band  x = (f^2 - f_1 f_2)/(f (f_2 - f_1)),

    f on the warped axis tan(π f/rate) of the bilinear transformation: within 0.15 dB of a fourth-order Butterworth filter up to
    the corner, 38 dB down in the octave beyond.
    """
    from scipy.signal import butter, sosfiltfilt

    share = (np.sqrt(2.0) - 1.0) ** (0.5 / ORDER)
    upper = np.tan(np.pi * high / rate)
    if low is None:
        corners, kind, slowest = upper / share, "lowpass", high
    else:
        lower, kind, slowest = np.tan(np.pi * low / rate), "bandpass", low
        width = (upper - lower) / share
        first = 0.5 * (np.sqrt(width**2 + 4.0 * lower * upper) - width)
        corners = np.array([first, first + width])
    sections = butter(ORDER, np.arctan(corners) * rate / np.pi, kind, fs=rate, output="sos")
    # two periods of the slowest: beyond it nothing is felt of the ends
    return sosfiltfilt(sections, values, axis=0, padlen=min(len(values) - 1, round(2.0 * rate / slowest)))


def sliding_mean(
    values: Signal, spacing: float, window: float, step: float
) -> tuple[Float[np.ndarray, "windows"], Float[np.ndarray, "windows parts"]]:
    """Starts (m from the first sample) and means of windows of `window` m every `step` m; samples every `spacing` m.

    Mean of the cubic spline through the samples: exact to a fourth order, whatever the spacing has to do with the step.
    """
    from scipy.interpolate import CubicSpline

    integral = CubicSpline(spacing * np.arange(len(values)), values).antiderivative()
    length = spacing * (len(values) - 1)
    starts = step * np.arange(np.floor((length - window) / step + 1e-9) + 1)
    return starts, (integral(starts + window) - integral(starts)) / window


def sliding_rms(
    values: Signal, spacing: float, window: float, step: float
) -> tuple[Float[np.ndarray, "windows"], Float[np.ndarray, "windows parts"]]:
    """As `sliding_mean`, the root mean square of each window."""
    starts, squares = sliding_mean(values**2, spacing, window, step)
    return starts, np.sqrt(np.maximum(squares, 0.0))


def by_section(
    values: Signal,
    position: Float[np.ndarray, "samples"],
    starts: Float[np.ndarray, "sections"],
    ends: Float[np.ndarray, "sections"],
    statistic: str,
) -> Float[np.ndarray, "sections parts"]:
    """Of each section the "rms", the absolute "median", or of the "percentiles" the larger of |F1| and |F2|; shape (sections, parts).

    `position` of the samples, `starts` and `ends` in m from the same place. Percentiles are interpolated linearly between samples.
    """
    pieces = [values[slice(*np.searchsorted(position, pair))] for pair in zip(starts, ends, strict=True)]
    if statistic == "rms":
        return np.array([np.sqrt(np.mean(piece**2, axis=0)) for piece in pieces])
    if statistic == "median":
        return np.array([np.abs(np.median(piece, axis=0)) for piece in pieces])
    return np.array([np.abs(np.percentile(piece, PERCENTILES, axis=0)).max(axis=0) for piece in pieces])


def hunting_frequency(values: Signal, rate: float) -> float:
    """Frequency f0 of the highest peak of the spectrum, Hz, within `HUNTING_BAND`: of a hunting vehicle that of its limit cycle.

    Welch's spectrum in windows of 10 s, added up over the parts; the peak by the parabola through three logarithms.
    """
    from scipy.signal import welch

    frequency, density = welch(values, rate, nperseg=min(len(values), round(10.0 * rate)), axis=0, detrend="constant")
    power = np.log(density.sum(axis=1) + np.finfo(float).tiny)
    inside = np.flatnonzero((frequency >= HUNTING_BAND[0]) & (frequency <= HUNTING_BAND[1]))
    peak = inside[np.argmax(power[inside])]
    before, at, after = power[peak - 1 : peak + 2]
    bend = before - 2.0 * at + after
    offset = 0.5 * (before - after) / bend if bend < 0.0 else 0.0
    return float(frequency[peak] + np.clip(offset, -0.5, 0.5) * frequency[1])
