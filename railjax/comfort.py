"""Ride comfort of a record or a simulation: ISO 2631-1, EN 12299 and Sperling, in one report."""

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from .arguments import an_acceleration
from .checks import guarded, positive
from .deflections import CARBODY_TO_FLOOR, FLOOR_POINTS, lateral_of_carbody
from .errors import InputError
from .failed_lanes import ends
from .simulate import Simulation
from .typing import Scalar
from .vibration import (
    BLOCK,
    THIRD_OCTAVES,
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

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Values = Float[np.ndarray, "*lanes"]

#: direction -> its symbol and its weighting on the floor (EN 12299)
DIRECTIONS = {"longitudinal": ("x", "Wd"), "lateral": ("y", "Wd"), "vertical": ("z", "Wb")}

#: upper bounds of each class and its name (EN 12299, recalled): mean comfort, and continuous comfort (m/s^2) across and upwards
MEAN_SCALE = (
    (1.5, "very comfortable"),
    (2.5, "comfortable"),
    (3.5, "medium"),
    (4.5, "uncomfortable"),
    (np.inf, "very uncomfortable"),
)
CONTINUOUS_SCALE = ((0.20, "very comfortable"), (0.30, "comfortable"), (0.40, "medium"), (np.inf, "less comfortable"))

#: 5 s blocks of a full test (5 min, EN 12299), and the fewest of which one lies beyond the 95th percentile: 1/(1 - 0.95)
FULL_TEST, FEWEST_BLOCKS = 60, 20

#: records are taken from this rate on, Hz: the third octaves to 31.5 Hz and the weighted band to 40 Hz are in them
LOWEST_RATE = 100.0

#: channels of a simulation in the order in which they are looked for
CHANNELS_OF_COMFORT = ("floor_acceleration", "carbody_acceleration")


@dataclass(frozen=True)
class Comfort:
    """Result of `comfort`; arrays by direction ("lateral", ...), of the record's shape without time (`lanes`).

    `rms` a_w (m/s^2), `blocks` the r.m.s. of successive 5 s (C_Cy and its like; blocks first; m/s^2), `percentile` their 95th
    percentile, `sperling` Wz and `sperling_bands` Wz_i (bands first), `dose` VDV (m/s^1.75), `running` MTVV (m/s^2), `crest`
    the crest factor, `mean` N_MV over all directions given, or None. `places` names the lanes, `notes` say what to mind.
    """

    sampling_rate: float  # Hz
    duration: float  # s
    weightings: dict[str, str]
    rms: dict[str, Values]
    blocks: dict[str, Float[np.ndarray, "blocks *lanes"]]
    percentile: dict[str, Values] | None
    mean: Values | None  # N_MV, dimensionless
    sperling: dict[str, Values]
    sperling_bands: dict[str, Float[np.ndarray, "bands *lanes"]]
    sperling_exponents: tuple[float | int, float | int]  # numbers: `sperling_exponent`, `sperling_power`
    dose: dict[str, Values]
    running: dict[str, Values]
    crest: dict[str, Values]
    places: tuple[str, ...]
    notes: tuple[str, ...]

    def __str__(self) -> str:
        lines = [f"Ride comfort: {self.duration:g} s at {self.sampling_rate:g} Hz, {', '.join(self.rms)}"]
        if self.places:
            lines.append(f"  at {', '.join(self.places)}")
        if self.mean is not None:
            of_parts = "" if len(self.rms) == 3 else f", the {' and '.join(self.rms)} part alone"
            lines.append(f"  mean comfort N_MV (EN 12299{of_parts}): {_span(self.mean)}, {_words(self.mean, MEAN_SCALE)}")
        for direction, weighted in self.rms.items():
            symbol = DIRECTIONS[direction][0]
            name = self.weightings[direction]
            lines.append(f"  {direction} ({name}):")
            lines.append(f"    weighted r.m.s. a_w: {_span(weighted)} m/s^2")
            blocks = self.blocks[direction]
            if len(blocks):
                shares = f"{_shares(blocks)}; " if direction != "longitudinal" else ""  # no scale for C_Cx
                lines.append(f"    continuous comfort C_C{symbol}: {shares}largest {_span(blocks.max(axis=0))} m/s^2")
            if self.percentile is not None:
                lines.append(f"    95th percentile of the 5 s values: {_span(self.percentile[direction])} m/s^2")
            lines.append(f"    MTVV {_span(self.running[direction])} m/s^2, VDV {_span(self.dose[direction])} m/s^1.75")
            lines.append(f"    crest factor {_span(self.crest[direction])}")
            if direction in self.sperling:
                by_band = np.nan_to_num(self.sperling_bands[direction], nan=-1.0)
                worst = np.unravel_index(np.argmax(by_band), by_band.shape)[0]
                exponent, power = self.sperling_exponents
                lines.append(
                    f"    Sperling Wz: {_span(self.sperling[direction])}, most at {10 ** (THIRD_OCTAVES[worst] / 10):.3g} Hz "
                    f"((aB)^(2 x {exponent:.4g}) per band, powers of {power:g} added)"
                )
        return "\n".join([*lines, *(f"  note: {note}" for note in self.notes)])

    def plot(self, axes: "Axes", bands: "Axes | None" = None) -> None:
        """Weighted r.m.s. of successive 5 s over time; Sperling's index by third octaves where axes are given for it."""
        from .plots import comfort

        comfort(axes, bands, self)

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers and lists, for JSON."""
        directions = {
            direction: {
                "weighting": self.weightings[direction],
                "rms_m_per_s2": self.rms[direction].tolist(),
                "continuous_comfort_m_per_s2": self.blocks[direction].tolist(),
                "percentile_95_m_per_s2": None if self.percentile is None else self.percentile[direction].tolist(),
                "mtvv_m_per_s2": self.running[direction].tolist(),
                "vdv_m_per_s1.75": self.dose[direction].tolist(),
                "crest_factor": self.crest[direction].tolist(),
                "sperling": self.sperling[direction].tolist() if direction in self.sperling else None,
                "sperling_bands": self.sperling_bands[direction].tolist() if direction in self.sperling else None,
            }
            for direction in self.rms
        }
        return {
            "duration_s": self.duration,
            "sampling_rate_hz": self.sampling_rate,
            "mean_comfort": None if self.mean is None else self.mean.tolist(),
            "mean_comfort_scale": None if self.mean is None else _words(self.mean, MEAN_SCALE),
            "third_octaves_hz": [10 ** (n / 10) for n in THIRD_OCTAVES],
            "places": list(self.places),
            "directions": directions,
            "notes": list(self.notes),
        }


@guarded(acceleration=an_acceleration, sperling_exponent=positive(), sperling_power=positive())
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
    sperling_exponent: float | int = 1.0 / 6.67,
    sperling_power: float | int = 6.67,
) -> Comfort:
    """Ride comfort from accelerations of the floor in m/s^2.

    `acceleration`: samples of shape (time,) or (time, ...lanes) in one `direction` ("lateral", "vertical", "longitudinal"), a
    mapping of directions to such arrays, or a `Simulation`, of which the lateral `channel` is read (default
    "floor_acceleration", else "carbody_acceleration") at one `place` of it ("leading bogie", "centre", "trailing bogie", or a
    number; default all). `sampling_rate` in Hz, 100 or more; a simulation knows its own. The mean is taken off a record, and
    `settle` seconds are left out at its start (after the weighting).

    `weightings`: other than Wd lateral and longitudinal and Wb vertical (EN 12299), as {"vertical": "Wk"} for ISO 2631-1.
    N_MV is of the directions given: with the lateral one alone its part of it, which is below the whole. It takes the 95th
    percentile (between order statistics linearly) of successive 5 s; a test has 60 of them (5 min), 20 are the fewest of
    which one can lie beyond that percentile, and less than that is refused unless `mean=False`, which leaves N_MV out.
    `sperling_exponent` and `sperling_power` as `exponent` and `power` of `sperling`. Lanes that a simulation marks as failed are NaN.

    Raises `InputError` for anything that is no finite number, rates below 100 Hz, records too short, unknown names. Not
    differentiable: `weighted_rms`, `sperling` and their neighbours in `railjax.vibration` are.
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
    return _report(records, names, float(sampling_rate), settle, mean, (sperling_exponent, sperling_power), places, ok)


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
    whole = np.asarray(mean_comfort(list(results["percentile"].values()))) if mean else None
    return Comfort(
        sampling_rate,
        duration,
        names,
        mean=whole,
        sperling_exponents=exponents,
        places=places,
        notes=tuple(notes),
        **results if mean else results | {"percentile": None},
    )


# one program instead of some eighty small ones
@functools.partial(jax.jit, static_argnames=("sampling_rate", "weighting", "direction", "skip", "mean", "exponents"))
def _measured(
    record: Float[Array, "samples *lanes"],
    sampling_rate: float,
    weighting: str,
    direction: str,
    skip: int,
    mean: bool,
    exponents: tuple[float | int, float | int],
) -> dict[str, Float[Array, "..."]]:
    """What `Comfort` holds of one direction."""
    weighted = weighted_acceleration(record - record.mean(axis=0), sampling_rate, weighting)[skip:]
    values = {
        "rms": rms(weighted),
        "blocks": block_rms(weighted, sampling_rate),
        "dose": vibration_dose(weighted, sampling_rate),
        "running": running_maximum(weighted, sampling_rate),
    }
    values["crest"] = jnp.max(jnp.abs(weighted), axis=0) / values["rms"]
    if mean:
        values["percentile"] = jnp.percentile(values["blocks"], 95.0, axis=0)
    if direction != "longitudinal":
        values["sperling_bands"] = sperling_bands(record[skip:], sampling_rate, direction, exponents[0])
        values["sperling"] = combined(values["sperling_bands"], exponents[1])
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
    if direction not in DIRECTIONS:
        raise InputError(f"direction {direction!r} is not one of {', '.join(DIRECTIONS)}")
    if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(values)):
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
    """Lateral acceleration (m/s^2) at any point of the car body: y_c'' + x psi_c'' - z phi_c''.

    x = `along` in m ahead of the body's centre, z = `height` in m above its centre of gravity (default 0.6 below, assumed: the
    paper gives no floor). `run` must have recorded "carbody_y_acceleration", "carbody_psi_acceleration" and
    "carbody_phi_acceleration"; `InputError` otherwise. Differentiable. Over the bogies and in the centre the channel
    "floor_acceleration" is the same without them, at the height -`geometry.carbody_to_floor`.
    """
    names = [f"carbody_{coordinate}" for coordinate in ("y", "psi", "phi")]
    missing = [f"{name}_acceleration" for name in names if f"{name}_acceleration" not in run.channels]
    if missing:
        raise InputError(f"the simulation has not recorded {', '.join(missing)}: name them in simulate(..., record=[...])")
    return lateral_of_carbody({name: run.channels[f"{name}_acceleration"] for name in names}, along, -height)


def _span(values: ArrayLike) -> str:
    """A few values one by one, many as their range; NaN where a lane failed."""
    flat = np.ravel(values)
    if flat.size <= 4:
        return ", ".join(f"{value:.4g}" for value in flat)
    low, high = ends(flat)
    return f"{low:.4g} to {high:.4g}"


def _words(values: ArrayLike, scale: tuple) -> str:
    """The scale's words for the least and the greatest value."""
    finite = np.ravel(values)[np.isfinite(np.ravel(values))]
    words = (
        [next(word for bound, word in scale if value < bound) for value in (finite.min(), finite.max())] if finite.size else []
    )
    return " to ".join(dict.fromkeys(words)) or "no number"


def _shares(blocks: Float[np.ndarray, "blocks *lanes"]) -> str:
    """How much of the time is in each class of the continuous scale."""
    finite, lower, shares = blocks[np.isfinite(blocks)], -np.inf, []
    for bound, word in CONTINUOUS_SCALE:
        share = np.mean((finite >= lower) & (finite < bound)) if finite.size else 0.0
        shares += [f"{share:.0%} {word}"] if share else []
        lower = bound
    return ", ".join(shares) or "no number"
