"""Indices of ride comfort that take several directions or the quasi-static part: a_v, N_VA, N_VD, P_CT, P_DE; and gravity in records."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from ..base.errors import InputError
from ..base.file_units import STANDARD_GRAVITY

Values = Float[np.ndarray, "..."]

#: directions of the floor, which N_MV adds up, and of the seat
FLOOR = ("longitudinal", "lateral", "vertical")
SEAT = ("seat lateral", "seat vertical", "backrest longitudinal")

#: constants of P_CT (A and B in % over m/s^2 and m/s^3, C in %, D in s/rad, E) and of P_DE (a, b in % over m/s^2, c in %), EN 12299, recalled;
#: they agree with British Rail's in % of g and deg/s (2.80, 2.03, 11.1, 0.185, 2.283; 1.63, 2.65, 37)
CURVE = {"standing": (28.54, 20.69, 11.1, 3.64, 2.283), "seated": (8.97, 9.68, 5.9, 0.916, 1.626)}
EVENT = {"standing": (16.62, 27.01, 37.0), "seated": (8.46, 13.05, 21.7)}

#: s: of the means in P_CT, how long beyond a transition its acceleration counts, and the window of P_DE; Hz: P_DE's low-pass
CURVE_MEAN, AFTER, EVENT_WINDOW, EVENT_CORNER = 1.0, 1.6, 2.0, 2.0

#: shares of g between which the mean of a record is gravity
GRAVITY = (0.85, 1.1)


def gravity_note(direction: str, record: Values) -> str | None:
    """What to say of gravity in a record of accelerations in m/s^2; None without it. Raises `InputError` for one in another unit."""
    mean = float(np.max(np.abs(record.mean(axis=0))))
    if direction == "vertical" and GRAVITY[0] < mean < GRAVITY[1]:
        raise InputError(f"vertical: its mean is {mean:.3g} m/s^2, which is gravity in g; its unit is g, not m/s^2")
    if mean > GRAVITY[1] * STANDARD_GRAVITY:
        raise InputError(f"{direction}: its mean is {mean:.4g} m/s^2, more than gravity; check its unit")
    if mean > GRAVITY[0] * STANDARD_GRAVITY:
        if direction != "vertical":
            raise InputError(
                f"{direction}: its mean is {mean:.3g} m/s^2, so that gravity lies along it; this is the vertical record"
            )
        return f"vertical: gravity is in the record (mean {mean:.3g} m/s^2), taken off with the mean"
    return None


def combined_indices(rms: Mapping[str, Values], blocks: Mapping[str, Values], percentiles: bool) -> dict[str, Values]:
    """a_v (ISO 2631-1, comfort: factors 1) in m/s^2 of the floor's directions, and N_VA and N_VD (EN 12299, recalled) where the
    channels are there: `rms` weighted, `blocks` of 5 s; the latter two only with `percentiles`."""
    floor, found = [rms[name] for name in FLOOR if name in rms], {}
    if len(floor) > 1:
        found["a_v"] = np.sqrt(np.sum([value**2 for value in floor], axis=0))
    if percentiles:
        at = {name: (np.percentile(own, 50.0, axis=0), np.percentile(own, 95.0, axis=0)) for name, own in blocks.items()}
        if all(name in at for name in FLOOR):
            x, y, z = (at[name] for name in FLOOR)
            found["N_VD"] = 3.0 * np.sqrt(16.0 * x[0] ** 2 + 4.0 * y[0] ** 2 + z[0] ** 2) + 5.0 * y[1]
        if all(name in at for name in ("vertical", *SEAT)):
            z, seat_y, seat_z, back = (at[name][1] for name in ("vertical", *SEAT))
            found["N_VA"] = 4.0 * z + 2.0 * np.sqrt(seat_y**2 + seat_z**2) + 4.0 * back
    return {key: np.asarray(value) for key, value in found.items()}


def discrete_events(lateral: Values, rate: float) -> dict[str, Values]:
    """P_DE in % (EN 12299, recalled), the largest in a record of the floor's lateral acceleration (m/s^2, time first).

    a times the peak-to-peak value plus b times the mean, in windows of 2 s, less c; below 2 Hz. An offset of the sensor counts.
    """
    from scipy.ndimage import maximum_filter1d, minimum_filter1d, uniform_filter1d
    from scipy.signal import butter, sosfiltfilt

    slow = sosfiltfilt(butter(2, EVENT_CORNER, fs=rate, output="sos"), lateral, axis=0)
    window = round(EVENT_WINDOW * rate)
    inner = slice(window // 2, len(lateral) - window // 2)
    peaks = (maximum_filter1d(slow, window, axis=0) - minimum_filter1d(slow, window, axis=0))[inner]
    means = np.abs(uniform_filter1d(slow, window, axis=0))[inner]
    return {who: np.asarray(np.max(np.maximum(a * peaks + b * means - c, 0.0), axis=0)) for who, (a, b, c) in EVENT.items()}


def curve_transitions(
    lateral: Values, roll_rate: Values | None, rate: float, transitions: Sequence[tuple[float, float]]
) -> dict[str, Float[np.ndarray, "transitions ..."]]:
    """P_CT in % (EN 12299, recalled) of each transition curve, from and to its times in s.

    From the means over 1 s of the floor's lateral acceleration (m/s^2), of its change and of the roll rate (rad/s); without the
    latter its part is left out. Raises `InputError` for times outside of the record.
    """
    from scipy.ndimage import uniform_filter1d

    window = round(CURVE_MEAN * rate)
    mean = uniform_filter1d(lateral, window, axis=0, mode="nearest")
    change = np.zeros_like(mean)
    change[window:] = (mean[window:] - mean[:-window]) / CURVE_MEAN
    # the change over the second around an instant
    change = np.roll(change, -(window // 2), axis=0)
    roll = None if roll_rate is None else np.abs(uniform_filter1d(roll_rate, window, axis=0, mode="nearest"))
    found: dict[str, list[Values]] = {who: [] for who in CURVE}
    for start, end in transitions:
        if not (0.0 <= start < end <= len(lateral) / rate):
            raise InputError(
                f"transition {start:g} to {end:g} s: must rise and lie within the record's {len(lateral) / rate:g} s"
            )
        first, last = round(start * rate), round(end * rate)
        beyond = slice(first, last + round(AFTER * rate))
        for who, (a, b, c, d, e) in CURVE.items():
            across = a * np.abs(mean[beyond]).max(axis=0) + b * np.abs(change[first:last]).max(axis=0) - c
            rolled = 0.0 if roll is None else 100.0 * (d * roll[first:last].max(axis=0)) ** e
            found[who].append(np.maximum(across, 0.0) + rolled)
    return {who: np.array(values) for who, values in found.items()}
