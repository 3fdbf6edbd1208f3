"""Ride comfort of a record or a simulation: ISO 2631-1, EN 12299 and Sperling, in one report."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ..base.arguments import guarded
from ..base.checks import Rising, Samples, from_zero, positive, shown, traced
from ..base.errors import InputError
from ..base.typing import Scalar
from ..model.kinematics import CARBODY_TO_FLOOR, FLOOR_POINTS, lateral_of_carbody
from ..model.track.layout import Layout
from ..simulation.simulate import Simulation
from .comfort_result import DIRECTIONS, Comfort
from .indices import FLOOR, SEAT, combined_indices, curve_transitions, discrete_events, gravity_note
from .transitions import passage
from .vibration import (
    BLOCK,
    block_rms,
    combined,
    mean_comfort,
    rms,
    running_maximum,
    sperling_bands,
    vibration_dose,
    weighted_acceleration,
)
from .weightings import WEIGHTINGS, check_rate, check_weighting

Values = Float[np.ndarray, "*lanes"]

#: what is no acceleration, rad/s
ROLL_RATE = "roll rate"

#: 5 s blocks of a full test (5 min, EN 12299), and the fewest of which one lies beyond the 95th percentile: 1/(1 - 0.95)
FULL_TEST, FEWEST_BLOCKS = 60, 20

#: records are taken from this rate on, Hz: the third octaves to 31.5 Hz and the weighted band to 40 Hz are in them
LOWEST_RATE = 100.0

#: channels of a simulation in the order in which they are looked for
CHANNELS_OF_COMFORT = ("floor_acceleration", "carbody_acceleration")


def _pairs(key: str, value: Any) -> None:
    """Stretches of time, each from and to."""
    if not isinstance(value, (list, tuple)) or not all(isinstance(pair, (list, tuple)) for pair in value):
        raise InputError(f"{key} must be a list of pairs (from, to) in s, not {shown(value)}")
    for pair in value:
        Rising(from_zero("s"), 2, 2)(key, pair)


def an_acceleration(key: str, value: Any) -> None:
    """A simulation, records by direction, or one record."""
    if not isinstance(value, Simulation):
        for direction, record in value.items() if hasattr(value, "items") else [(key, value)]:
            Samples("m/s²")(direction, record)


@guarded(acceleration=an_acceleration, sperling_exponent=positive(), sperling_power=positive(), transitions=_pairs)
def comfort(
    acceleration: ArrayLike | Simulation | Mapping[str, ArrayLike],
    sampling_rate: float | int | None = None,
    *,
    direction: str = "lateral",
    weightings: Mapping[str, str] | None = None,
    channel: str | None = None,
    place: str | int | None = None,
    mean: bool = True,
    settle: float | int = 0.0,
    transitions: Sequence[tuple[float | int, float | int]] = (),
    layout: Layout | None = None,
    sperling_exponent: float | int = 1.0 / 6.67,
    sperling_power: float | int = 6.67,
) -> Comfort:
    """Ride comfort from accelerations of the floor: a_w, MTVV, VDV, N_MV, Sperling's index and those of several directions.

    N_MV is of the directions given: with the lateral one alone its part of it, which is below the whole. It takes the 95th
    percentile (between order statistics linearly) of successive 5 s; a test has 60 of them (5 min), 20 are the fewest of which
    one can lie beyond that percentile, and less than that is refused unless `mean` is False. Of the floor's directions a_v is the
    vector sum; N_VD takes all three, N_VA the vertical one and those of the seat. A measured lateral record has P_DE, and P_CT of
    each of its `transitions`: both see the quasi-static acceleration, and so an offset of the sensor. A simulation has P_CT of those of
    its `layout`, and needs the car body's roll for it. The mean is taken off a
    record, and gravity in a vertical one with it. Lanes that a simulation marks as failed are NaN. Not differentiable:
    `weighted_rms`, `sperling` and their neighbours in `railjax.ride.vibration` are.

    Args:
        acceleration: samples of shape `(samples, *lanes)`, m/s^2; a mapping of directions to such arrays, with which a "roll
            rate" in rad/s may be; or a `Simulation`.
        sampling_rate: Hz, 100 or more; a simulation knows its own.
        direction: of a single array: "lateral", "vertical", "longitudinal", "seat lateral", "seat vertical" or "backrest
            longitudinal".
        weightings: by direction, other than Wd lateral and longitudinal and Wb vertical (EN 12299), as {"vertical": "Wk"} for ISO
            2631-1.
        channel: of a simulation, a lateral acceleration; by default "floor_acceleration", else "carbody_acceleration".
        place: of the channel: "leading bogie", "centre" or "trailing bogie" of the floor, or its number of the axis, from 0; by
            default all.
        mean: False leaves N_MV out.
        settle: time left out at the start, after the weighting, s.
        transitions: of a measured lateral record, (from, to) of each transition curve, s.
        layout: of a simulation, the line that it ran on.
        sperling_exponent: `exponent` of `sperling`, dimensionless.
        sperling_power: `power` of `sperling`, dimensionless.

    Raises:
        InputError: for anything that is no finite number, rates below 100 Hz, records too short, unknown names, a layout without a
            transition in the run.
    """
    places: tuple[str, ...] = ()
    ok: np.ndarray | bool = True
    if isinstance(acceleration, Simulation):
        run = acceleration
        if sampling_rate is not None:
            raise InputError("sampling_rate: a simulation has its own; leave it out")
        if len(run.time) < 2:
            raise InputError("the simulation has recorded a single instant; record more of it")
        sampling_rate = 1.0 / float(run.time[1] - run.time[0])
        values, places = _of_simulation(run, channel, place)
        found, ok = {"lateral": values}, np.asarray(run.ok)
    elif channel is not None or place is not None:
        raise InputError("channel and place are for a Simulation; pick them out of the array")
    else:
        found = dict(acceleration) if isinstance(acceleration, Mapping) else {direction: acceleration}
    if sampling_rate is None:
        raise InputError("sampling_rate in Hz is missing")
    check_rate(sampling_rate)
    roll = found.pop(ROLL_RATE, None)
    if not found:
        raise InputError("a roll rate alone is no ride; give an acceleration")
    # a simulation's interval is rounded
    if sampling_rate < LOWEST_RATE * (1.0 - 1e-9):
        raise InputError(f"sampling_rate {sampling_rate:g} Hz is too low: comfort to 40 Hz needs {LOWEST_RATE:g} Hz or more")
    records = {name: _checked(name, values, ok) for name, values in found.items()}
    if len({record.shape for record in records.values()}) != 1:
        raise InputError(f"the directions' records differ in shape: {', '.join(f'{n} {r.shape}' for n, r in records.items())}")
    names = {name: (weightings or {}).get(name, DIRECTIONS[name][1]) for name in records}
    for name in names.values():
        if check_weighting(name) not in WEIGHTINGS:
            raise InputError(f"weightings: {name!r} is no weighting of ISO 2631-1; Sperling's index is there without it")
    notes, events, curves = [], {}, {}
    if not isinstance(acceleration, Simulation):
        notes = [note for name, record in records.items() if (note := gravity_note(name, record)) is not None]
    if transitions and (isinstance(acceleration, Simulation) or "lateral" not in records):
        raise InputError("transitions are for a record of the lateral acceleration; a simulation has those of its layout")
    if layout is not None and not isinstance(acceleration, Simulation):
        raise InputError("layout is for a Simulation; of a record give the transitions")
    report = _report(records, names, float(sampling_rate), settle, mean, (sperling_exponent, sperling_power), places, ok)
    if "lateral" in records and not isinstance(acceleration, Simulation):
        lateral, rate = records["lateral"], float(sampling_rate)
        events = discrete_events(lateral, rate)
        if transitions:
            rolled = None if roll is None else _checked(ROLL_RATE, roll, ok)
            curves = curve_transitions(lateral, rolled, rate, transitions)
            notes += [] if roll is not None else ["P_CT: without its part of the roll rate, which is not in the record"]
    if isinstance(acceleration, Simulation) and layout is not None:
        passed = passage(acceleration, layout, records["lateral"])
        curves = curve_transitions(passed.lateral, passed.roll_rate, float(sampling_rate), passed.times)
        curves = {who: np.where(ok, values, np.nan) for who, values in curves.items()}
        notes += passed.notes
    lacking = [name for name in ("vertical", *SEAT) if name not in records]
    if any(name in records for name in SEAT) and lacking:
        notes.append(f"N_VA: not formed, as {', '.join(lacking)} is not in the record")
    return dataclasses.replace(report, notes=(*report.notes, *notes), events=events, curves=curves)


def _report(
    records: dict[str, Float[np.ndarray, "samples *lanes"]],
    names: dict[str, str],
    sampling_rate: float,
    settle: float | int,
    mean: bool,
    exponents: tuple[float | int, float | int],
    places: tuple[str, ...],
    ok: np.ndarray | bool,
) -> Comfort:
    first = next(iter(records.values()))
    skip = round(settle * sampling_rate) if np.isfinite(settle) and settle >= 0 else len(first)
    duration = (len(first) - skip) / sampling_rate
    blocks = int((len(first) - skip) // round(BLOCK * sampling_rate))
    if duration < 2 * BLOCK:
        raise InputError(f"{max(duration, 0):.3g} s after settle = {settle:g} s are too few: 10 s are the least for any figure")
    if mean and blocks < FEWEST_BLOCKS:
        raise InputError(
            f"{duration:.4g} s hold {blocks} blocks of 5 s, too few for the 95th percentile of N_MV, which needs {FEWEST_BLOCKS} "
            f"({FEWEST_BLOCKS * BLOCK:g} s; a full test {FULL_TEST * BLOCK:g} s): a longer record, or leave N_MV out (mean=False)"
        )
    results: dict[str, dict[str, Values]] = {
        key: {} for key in ("rms", "blocks", "percentile", "sperling", "sperling_bands", "dose", "running", "crest")
    }
    notes = []
    if mean and blocks < FULL_TEST:
        notes.append(f"N_MV is of {blocks} blocks of 5 s; a full test has {FULL_TEST} (5 min)")
    if not np.all(ok):
        notes.append(f"{np.sum(~np.asarray(ok))} of {np.size(ok)} lane(s) failed in the simulation and are left out")
    for direction, record in records.items():
        values = _measured(record, sampling_rate, names[direction], direction, skip, mean, exponents)
        for key, value in values.items():
            results[key][direction] = np.where(ok, np.asarray(value), np.nan)
        crest = results["crest"][direction]
        if np.any(crest > 9.0):
            notes.append(f"{direction}: crest factor above 9, where ISO 2631-1 asks for MTVV and VDV beside a_w")
    floor = [value for direction, value in results["percentile"].items() if direction in FLOOR]
    whole = np.asarray(mean_comfort(floor)) if floor else None
    return Comfort(
        sampling_rate,
        duration,
        names,
        mean=whole,
        sperling_exponents=exponents,
        places=places,
        notes=tuple(notes),
        indices=combined_indices(results["rms"], results["blocks"], mean),
        **results if mean else results | {"percentile": None},
    )


def _measured(
    record: Float[np.ndarray, "samples *lanes"],
    sampling_rate: float,
    weighting: str,
    direction: str,
    skip: int,
    mean: bool,
    exponents: tuple[float | int, float | int],
) -> dict[str, Float[np.ndarray, "..."]]:
    """What `Comfort` holds of one direction; by programs that serve all directions and weightings."""
    weighted = weighted_acceleration(record - record.mean(axis=0), sampling_rate, weighting)[skip:]
    found = {
        "rms": rms(weighted),
        "blocks": block_rms(weighted, sampling_rate),
        "dose": vibration_dose(weighted, sampling_rate),
        "running": running_maximum(weighted, sampling_rate),
    }
    if direction in ("lateral", "vertical"):
        found["sperling_bands"] = sperling_bands(record[skip:], sampling_rate, direction, exponents[0])
        found["sperling"] = combined(found["sperling_bands"], exponents[1])
    values = {key: np.asarray(value) for key, value in found.items()}
    values["crest"] = np.max(np.abs(np.asarray(weighted)), axis=0) / values["rms"]
    if mean:
        values["percentile"] = np.percentile(values["blocks"], 95.0, axis=0)
    return values


def _of_simulation(run: Simulation, channel: str | None, place: str | int | None) -> tuple[Array, tuple[str, ...]]:
    """The history and the names of its places."""
    wanted = CHANNELS_OF_COMFORT if channel is None else (channel,)
    name = next((name for name in wanted if name in run.channels), None)
    if name is None:
        raise InputError(f"the simulation has not recorded {' or '.join(wanted)}: simulate(..., record=[{wanted[0]!r}])")
    values = run.channels[name]
    places = FLOOR_POINTS if name == "floor_acceleration" else ()
    if place is None:
        return values, places
    count = values.shape[1] if values.ndim > 1 + run.code.ndim else 0
    index = places.index(place) if place in places else place
    if not isinstance(index, int) or not 0 <= index < count:
        known = ", ".join(places) or (f"0 to {count - 1}" if count else "none")
        raise InputError(f"place {place!r} is not one of {name}'s: {known}")
    return values[:, index], places[index : index + 1]


def _checked(direction: str, values: ArrayLike, ok: np.ndarray | bool) -> Float[np.ndarray, "samples *lanes"]:
    if direction not in (*DIRECTIONS, ROLL_RATE):
        raise InputError(f"direction {direction!r} is not one of {', '.join(DIRECTIONS)}")
    if traced(values):
        raise InputError("comfort reports numbers and has no derivative; inside a transformation use weighted_rms or sperling")
    try:
        record = np.asarray(values, float)
    except (TypeError, ValueError):
        raise InputError(f"{direction}: the acceleration must be an array of numbers in m/s^2") from None
    if record.ndim == 0 or record.size == 0:
        raise InputError(
            f"{direction}: the acceleration must be an array with time along its first axis, not of shape {record.shape}"
        )
    bad = np.argwhere(~np.isfinite(record) & ok)
    if len(bad):
        raise InputError(f"{direction}: sample {bad[0][0] + 1} is {record[tuple(bad[0])]}; cut such samples out of the record")
    record = np.where(np.isfinite(record), record, 0.0)
    if np.any((np.ptp(record, axis=0) == 0.0) & ok):
        raise InputError(f"{direction}: the acceleration never changes; there is no vibration to judge")
    return record


@guarded()
def floor_acceleration(
    run: Simulation, along: Scalar = 0.0, height: Scalar = -CARBODY_TO_FLOOR
) -> Float[Array, "samples *lanes"]:
    """Lateral acceleration at any point of the car body: y_c'' + x psi_c'' - z phi_c''.

    Differentiable. Over the bogies and in the centre the channel "floor_acceleration" is the same without the three that this
    reads, at the height -`geometry.carbody_to_floor`.

    Args:
        run: with "carbody_y_acceleration", "carbody_psi_acceleration" and "carbody_phi_acceleration" recorded.
        along: x ahead of the body's centre, m, one or one per lane.
        height: z above its centre of gravity, m, one or one per lane; by default 0.6 below, assumed: the paper gives no floor.

    Returns:
        The acceleration, shape `(samples, *lanes)`, m/s^2.

    Raises:
        InputError: for a run that lacks one of the channels.
    """
    names = [f"carbody_{coordinate}" for coordinate in ("y", "psi", "phi")]
    missing = [f"{name}_acceleration" for name in names if f"{name}_acceleration" not in run.channels]
    if missing:
        raise InputError(f"the simulation has not recorded {', '.join(missing)}: name them in simulate(..., record=[...])")
    return lateral_of_carbody({name: run.channels[f"{name}_acceleration"] for name in names}, along, -height)
