"""Faults of test records: an offset of the velocity, rigs that run into their stops."""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float

from .record import Record

Samples = Float[np.ndarray, "samples"]

#: r.m.s. of the velocity beyond which its offset is worth a note
OFFSET = 1e-4

#: a window is a jolt where its peak acceleration is that many times the usual, the upper quartile of all windows' peaks; seconds per window
JOLT, WINDOW = 5.0, 0.2


def without_offset(record: Record) -> Record:
    """The record with each stretch's velocity of the mean that its displacement has; a note says what was taken off."""
    if record.integrated:
        return record
    velocity, taken = record.velocity.copy(), []
    for stretch in record.stretches:
        x, v = record.displacement[stretch], velocity[stretch]
        time = np.arange(len(x)) * record.dt
        apart = np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1])) * record.dt]) - x
        offset = np.polyfit(time, apart, 1)[0]
        velocity[stretch] = v - offset
        taken.append(offset)
    worst = max(taken, key=abs)
    if abs(worst) < OFFSET * np.std(record.velocity):
        return record
    note = f"velocity: {worst:.3g} m/s taken off ({abs(worst) / np.std(record.velocity):.2%} of its r.m.s.), which the displacement does not show"
    return dataclasses.replace(record, velocity=velocity, notes=(*record.notes, note))


def jolts(record: Record, acceleration: Samples) -> Bool[np.ndarray, "samples"]:
    """Samples about which the acceleration (m/s^2) is far beyond the usual: where a rig runs into its stop."""
    length = max(1, round(WINDOW / record.dt))
    starts = np.arange(0, len(record), length)
    peaks = np.maximum.reduceat(np.abs(acceleration), starts)
    hit = peaks > JOLT * np.quantile(peaks, 0.75)
    # with the windows beside it
    wide = np.convolve(hit, np.ones(3), "same") > 0
    return np.repeat(wide, np.diff(np.append(starts, len(record))))


def spans(record: Record, chosen: Bool[np.ndarray, "samples"]) -> list[tuple[float, float]]:
    """From when to when, s, samples are chosen."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], chosen.astype(int), [0]])))
    return [(float(begin * record.dt), float(end * record.dt)) for begin, end in edges.reshape(-1, 2)]
