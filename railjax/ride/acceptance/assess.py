"""Running safety and ride of one run or many, in the manner of UIC 518 / EN 14363, as far as lateral dynamics gives them.

The run is cut into track sections; every quantity is filtered and has one value x_i per section (a percentile or an r.m.s.);
what is compared with the limit is the estimated maximum x_mean + k s over the sections (one-dimensional method). The
instability criterion is the largest r.m.s. of a sliding window. It is no certificate: `NOT_ASSESSED` says what is missing.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ...base.arguments import guarded
from ...base.checks import Kind, positive
from ...base.errors import InputError
from ...base.typing import Number
from ...base.units import KMH
from ...model.vehicle import Vehicle
from ...simulation.simulate import Simulation
from .criteria import (
    CRITERIA,
    HALF_BAND,
    LOWEST,
    MEAN_OVER,
    RMS_OVER,
    SECTIONS,
    SHORTEST,
    Criterion,
    Given,
    nadal_limit,
)
from .record import RunningRecord, check_record, record_of_run
from .result import Acceptance, Finding, Values
from .signals import by_section, filtered, hunting_frequency, sliding_mean, sliding_rms

#: seconds at either end that are filtered but not assessed
MARGIN = 5.0


def default_section(speed: Number) -> Values:
    """250 m up to 220 km/h and 500 m beyond: straight track, UIC 518 (recalled). Speed in m/s."""
    return np.where(np.asarray(speed) * KMH > 220.0 + 1e-9, 500.0, 250.0)


@guarded()
def acceptance(vehicle: Vehicle, run: Simulation, *, prudhomme_factor: float = 1.0, **options: Any) -> Acceptance:
    """Assess a simulated run, or every lane of a batch: `acceptance_of_record` with the vehicle's axle load and bogie mass.

    P = 2 Q; M is the bogie frame with its wheelsets. On profiles Y/Q of each wheel is assessed by Nadal's limit of the flange's angle and the
    friction.

    Args:
        vehicle: the vehicle that ran.
        run: at constant speed, with `acceptance_channels(vehicle)` recorded at 200 Hz or more (`sample=5e-3`), over 25 sections
            and the margins: about 6.6 km up to 220 km/h, 13 km beyond.
        prudhomme_factor: α of the limit α (10 kN + P/3), dimensionless: 1, for wagons 0.85.
        **options: `section_length` (m), `margin` (s), `hunting_frequency` (Hz) and `minimum_sections` of `acceptance_of_record`.

    Raises:
        InputError: for a run with a `SpeedProfile`, channels that are missing, and what `acceptance_of_record` refuses.
    """
    given = of_vehicle(vehicle) | {"prudhomme_factor": prudhomme_factor}
    return acceptance_of_record(record_of_run(vehicle, run), **given, **options)


def of_vehicle(vehicle: Vehicle) -> dict[str, Number]:
    """Axle load, bogie mass and limit of Y/Q, as `acceptance_of_record` takes them."""
    mass = vehicle.bogie.mass + len(vehicle.geometry.axle_pattern) * vehicle.wheelset.mass
    limit = 0.8
    if vehicle.profiles is not None:
        limit = nadal_limit(vehicle.profiles.flange_angle, vehicle.contact.friction)
    return {"axle_load": 2.0 * vehicle.contact.wheel_load, "bogie_mass": mass, "derailment_limit": limit}


@guarded(record=Kind(RunningRecord, "a railjax.RunningRecord"), derailment_limit=positive(axes=1))
def acceptance_of_record(
    record: RunningRecord,
    *,
    axle_load: Number | None = None,
    bogie_mass: Number | None = None,
    prudhomme_factor: float = 1.0,
    derailment_limit: Number = 0.8,
    section_length: float | None = None,
    margin: float = MARGIN,
    hunting_frequency: float | None = None,
    minimum_sections: int = SECTIONS,
) -> Acceptance:
    """Assess measured or simulated time histories.

    Lanes with `record.ok` False are marked and the others kept.

    Args:
        record: the histories, at 200 Hz or more.
        axle_load: P, N, one or one per lane; needed with guiding forces.
        bogie_mass: M with its wheelsets, kg, one or one per lane; needed with bogie accelerations.
        prudhomme_factor: α of the limit α (10 kN + P/3), dimensionless: 1, for wagons 0.85.
        derailment_limit: of Y/Q, dimensionless, one or one per lane: 0.8 (recalled), or Nadal's.
        section_length: of the track sections, m, 70 or more; by default 250 up to 220 km/h and 500 beyond (UIC 518, recalled).
        margin: at either end, s, filtered but not assessed, for transients of start and filters; by default 5.
        hunting_frequency: f0 of the instability criterion, Hz; by default the highest peak of SumY's spectrum (without SumY, of
            the bogie accelerations).
        minimum_sections: number of sections, by default 25, below which a quantity is "exceeded" if a section is beyond the
            limit, else not determined.

    Raises:
        InputError: for values that are not finite, a load or mass that is needed and missing, a sampling rate below 200 Hz and a
            record shorter than one section.
    """
    signals, lanes, ok = check_record(record)
    given = given_of(signals, lanes, axle_load, bogie_mass, prudhomme_factor, derailment_limit)
    for key, value in (("section_length", section_length), ("hunting_frequency", hunting_frequency)):
        if value is not None:
            _positive(key, value)
    if section_length is not None and section_length < SHORTEST:
        raise InputError(f"section_length must be {SHORTEST:g} m or more for its percentiles, not {section_length:g}")
    if hunting_frequency is not None and hunting_frequency + HALF_BAND >= 0.5 * record.sampling_rate:
        raise InputError(f"hunting_frequency {hunting_frequency:g} Hz is too high for {record.sampling_rate:g} samples a second")
    check_margin(margin)
    speed = _by_lane("speed", record.speed, lanes)
    length = default_section(speed) if section_length is None else np.full(lanes, float(section_length))
    samples = len(next(iter(signals.values())))
    sections = np.floor(speed * (samples / record.sampling_rate - 2.0 * margin) / length + 1e-9).astype(int)
    if np.any(ok & (sections < 1)):
        worst = np.argmin(np.where(ok, sections, sections.max() + 1))
        needed = length[worst] / speed[worst] + 2.0 * margin
        raise InputError(
            f"the record of {samples / record.sampling_rate:g} s at {speed[worst] * KMH:g} km/h is shorter than a section of "
            f"{length[worst]:g} m and the margins; it takes {needed:.0f} s"
        )
    frames = [
        Frame(record.sampling_rate, float(v), margin, float(step), step * np.arange(count), step * np.arange(1, count + 1))
        for v, step, count in zip(speed, length, sections, strict=True)
    ]
    result = assessed(signals, ok, frames, given, CRITERIA, hunting_frequency, minimum_sections, record.name)
    return result if record.lanes else result.lane(0)


def given_of(
    signals: dict[str, Values],
    lanes: int,
    axle_load: Number | None,
    bogie_mass: Number | None,
    prudhomme_factor: Number,
    derailment_limit: Number,
) -> Given:
    """What limits depend on, by lane. Raises `InputError` for what is missing.

    Args:
        signals: that are judged.
        lanes: number of them.
        axle_load: P, N.
        bogie_mass: M with its wheelsets, kg.
        prudhomme_factor: α, dimensionless.
        derailment_limit: of Y/Q, dimensionless.
    """
    given = Given(
        None if axle_load is None else _by_lane("axle_load", axle_load, lanes),
        None if bogie_mass is None else _by_lane("bogie_mass", bogie_mass, lanes),
        _positive("prudhomme_factor", prudhomme_factor),
        _by_lane("derailment_limit", derailment_limit, lanes),
    )
    if "guiding_force" in signals and given.axle_load is None:
        raise InputError("axle_load is needed for the limits of guiding forces, N")
    if "bogie_acceleration" in signals and given.bogie_mass is None:
        raise InputError("bogie_mass is needed for the limits of bogie accelerations, kg with wheelsets")
    return given


def check_margin(margin: float) -> None:
    """Raise `InputError` for a margin (s) that cannot be."""
    if not (np.isfinite(margin) and margin >= 0.0):
        raise InputError(f"margin must be 0 or a positive number of seconds, not {margin}")


class Frame(NamedTuple):
    """Sampling of a lane, and its sections: where they start and end, m from the end of the first margin; `within` which stretches windows
    of the instability criterion must lie (None: all)."""

    rate: float  # Hz
    speed: float  # m/s
    margin: float  # s
    length: float  # of a section, m
    starts: Float[np.ndarray, "sections"]
    ends: Float[np.ndarray, "sections"]
    within: tuple[tuple[float, float], ...] | None = None

    def inner(self, values: Values) -> Values:
        """The samples without those of the margins."""
        cut = round(self.margin * self.rate)
        return values[cut : len(values) - cut]


def assessed(
    signals: dict[str, Values],
    ok: Bool[np.ndarray, "lanes"],
    frames: list[Frame],
    given: Given,
    criteria: Mapping[str, Criterion],
    hunting_frequency: float | None,
    minimum_sections: int,
    name: str,
) -> Acceptance:
    """The criteria whose signals are there, over each lane's sections.

    Args:
        signals: histories of shape `(samples, parts, lanes)`, SI.
        ok: which lanes count.
        frames: one a lane.
        given: what limits depend on.
        criteria: by their keys.
        hunting_frequency: f0, Hz; None: that of the spectrum.
        minimum_sections: number of them that a full assessment takes.
        name: of what ran.
    """
    lanes = len(frames)
    f0 = np.full(lanes, np.nan)
    found = {key: np.full((4, lanes), np.nan) for key, c in criteria.items() if c.signal in signals}
    for lane in np.flatnonzero(ok):
        own = {key: values[..., lane] for key, values in signals.items()}
        f0[lane] = _f0(own, frames[lane]) if hunting_frequency is None else hunting_frequency
        for key in found:
            found[key][:, lane] = _assess(criteria[key], own, frames[lane], float(f0[lane]))
    sections = np.array([len(frame.starts) for frame in frames])
    speed, length = (np.array([getattr(frame, what) for frame in frames]) for what in ("speed", "length"))
    findings = {key: _finding(criteria[key], values, given, sections >= minimum_sections) for key, values in found.items()}
    return Acceptance(findings, speed, f0, np.where(ok, sections, 0), length, minimum_sections, ok, name, criteria)


def _f0(signals: dict[str, Values], frame: Frame) -> float:
    name = next((n for n in ("guiding_force", "bogie_acceleration") if n in signals), None)
    return np.nan if name is None else hunting_frequency(frame.inner(signals[name]), frame.rate)


def _assess(criterion: Criterion, signals: dict[str, Values], frame: Frame, f0: float) -> tuple[float, ...]:
    """What is compared with the limit; the largest value of a section or window, its part (1 in front) and its start in m."""
    low, high = criterion.band or (max(f0 - HALF_BAND, LOWEST), f0 + HALF_BAND)
    values = frame.inner(filtered(signals[criterion.signal], frame.rate, low, high))
    spacing = frame.speed / frame.rate
    if criterion.statistic == "sliding rms":
        starts, per_window = sliding_rms(values, spacing, *RMS_OVER)
        if frame.within is not None:
            kept = np.zeros(len(starts), bool)
            for first, last in frame.within:
                kept |= (starts >= first) & (starts + RMS_OVER[0] <= last)
            starts, per_window = starts[kept], per_window[kept]
        if not len(starts):
            return np.nan, np.nan, np.nan, np.nan
        window, part = np.unravel_index(np.argmax(per_window), per_window.shape)
        worst = per_window[window, part]
        return worst, worst, float(part + 1), frame.margin * frame.speed + starts[window]
    if criterion.statistic != "median" and criterion.signal in ("guiding_force", "derailment_quotient"):
        starts, values = sliding_mean(values, spacing, *MEAN_OVER)
        position = starts + 0.5 * MEAN_OVER[0]
    else:
        position = spacing * np.arange(len(values))  # type: ignore[assignment]
    each = by_section(values, position, frame.starts, frame.ends, criterion.statistic)
    section, part = np.unravel_index(np.argmax(each), each.shape)
    start = frame.margin * frame.speed + frame.starts[section]
    assert criterion.k is not None  # of those without, the largest window has been given back
    estimate = np.max(each.mean(axis=0) + criterion.k * each.std(axis=0, ddof=1)) if len(each) > 1 else np.nan
    return estimate, each[section, part], float(part + 1), start


def _finding(criterion: Criterion, found: Values, given: Given, enough: Bool[np.ndarray, "..."]) -> Finding:
    value, largest, part, position = found
    limit = np.broadcast_to(np.asarray(criterion.limit(given), float), value.shape)
    determined = (enough | (criterion.statistic == "sliding rms")) & np.isfinite(value) & np.isfinite(limit)
    beyond = np.where(determined, value, largest) > limit
    verdict = np.where(beyond, "exceeded", np.where(determined, "met", "not determined"))
    return Finding(value, limit, largest, np.nan_to_num(part).astype(int), position, verdict)


def _positive(key: str, value: Any) -> Any:
    array = np.asarray(value, float)
    if not np.all(np.isfinite(array) & (array > 0)):
        raise InputError(f"{key} must be positive and finite, not {np.min(array):g}")
    return value


def _by_lane(key: str, value: Any, lanes: int) -> Float[np.ndarray, "{lanes}"]:
    array = np.asarray(_positive(key, value), float)
    if array.ndim and array.shape != (lanes,):
        raise InputError(f"{key} must be one number or one for each of {lanes} lane(s), not of shape {array.shape}")
    return np.broadcast_to(array, (lanes,))
