"""What `comfort` finds, printed and as plain numbers; classes of ride comfort (EN 12299, recalled)."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import ArrayLike, Float

from ..base.failed_lanes import ends
from ..base.style import legend_above
from .indices import FLOOR
from .vibration import BLOCK, THIRD_OCTAVES

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Values = Float[np.ndarray, "*lanes"]

#: direction -> its symbol and its weighting (EN 12299): on the floor, on the seat, at its back
DIRECTIONS = {
    **{"longitudinal": ("x", "Wd"), "lateral": ("y", "Wd"), "vertical": ("z", "Wb")},
    **{"seat lateral": ("yA", "Wd"), "seat vertical": ("zA", "Wb"), "backrest longitudinal": ("xD", "Wc")},
}

#: indices of several directions, as printed
INDICES = {
    "a_v": "vector sum a_v (ISO 2631-1)",
    "N_VA": "seated comfort N_VA (EN 12299)",
    "N_VD": "standing comfort N_VD (EN 12299)",
}

#: upper bounds of each class and its name (EN 12299, recalled): mean comfort, and continuous comfort (m/s^2) across and upwards
MEAN_SCALE = (
    (1.5, "very comfortable"),
    (2.5, "comfortable"),
    (3.5, "medium"),
    (4.5, "uncomfortable"),
    (np.inf, "very uncomfortable"),
)
CONTINUOUS_SCALE = ((0.20, "very comfortable"), (0.30, "comfortable"), (0.40, "medium"), (np.inf, "less comfortable"))


@dataclass(frozen=True)
class Comfort:
    """Result of `comfort`; arrays by direction ("lateral", ...), of the record's shape without time (`lanes`).

    `rms` a_w (m/s^2), `blocks` the r.m.s. of successive 5 s (C_Cy and its like; blocks first; m/s^2), `percentile` their 95th
    percentile, `sperling` Wz and `sperling_bands` Wz_i (bands first), `dose` VDV (m/s^1.75), `running` MTVV (m/s^2), `crest`
    the crest factor, `mean` N_MV over all directions of the floor given, or None. `indices`: a_v (m/s^2), N_VA, N_VD, as far as
    their channels are given; `events` P_DE and `curves` P_CT (transitions first), in %, "standing" and "seated", where the
    lateral acceleration was measured. `places` names the lanes, `notes` say what to mind.
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
    indices: dict[str, Values] = field(default_factory=dict)
    events: dict[str, Values] = field(default_factory=dict)  # P_DE, % (dimensionless)
    curves: dict[str, Float[np.ndarray, "transitions *lanes"]] = field(default_factory=dict)  # P_CT, % (dimensionless)

    def __str__(self) -> str:
        lines = [f"Ride comfort: {self.duration:g} s at {self.sampling_rate:g} Hz, {', '.join(self.rms)}"]
        if self.places:
            lines.append(f"  at {', '.join(self.places)}")
        if self.mean is not None:
            floor = [name for name in self.rms if name in FLOOR]
            of_parts = "" if len(floor) == 3 else f", the {' and '.join(floor)} part alone"
            lines.append(f"  mean comfort N_MV (EN 12299{of_parts}): {span(self.mean)}, {words(self.mean, MEAN_SCALE)}")
        for key, name in INDICES.items():
            if key in self.indices:
                unit = f" m/s^2 ({', '.join(self.weightings[d] for d in FLOOR if d in self.rms)})" if key == "a_v" else ""
                lines.append(f"  {name}: {span(self.indices[key])}{unit}")
        for key, found in (("discrete events P_DE", self.events), ("curve transitions P_CT", self.curves)):
            if found:
                lines.append(f"  {key} (EN 12299): " + ", ".join(f"{who} {span(value)} %" for who, value in found.items()))
        for direction, weighted in self.rms.items():
            symbol = DIRECTIONS[direction][0]
            name = self.weightings[direction]
            lines.append(f"  {direction} ({name}):")
            lines.append(f"    weighted r.m.s. a_w: {span(weighted)} m/s^2")
            blocks = self.blocks[direction]
            if len(blocks):
                classes = f"{shares(blocks)}; " if direction in ("lateral", "vertical") else ""  # no scale for C_Cx
                lines.append(f"    continuous comfort C_C{symbol}: {classes}largest {span(blocks.max(axis=0))} m/s^2")
            if self.percentile is not None:
                lines.append(f"    95th percentile of the 5 s values: {span(self.percentile[direction])} m/s^2")
            lines.append(f"    MTVV {span(self.running[direction])} m/s^2, VDV {span(self.dose[direction])} m/s^1.75")
            lines.append(f"    crest factor {span(self.crest[direction])}")
            if direction in self.sperling:
                by_band = np.nan_to_num(self.sperling_bands[direction], nan=-1.0)
                worst = np.unravel_index(np.argmax(by_band), by_band.shape)[0]
                exponent, power = self.sperling_exponents
                lines.append(
                    f"    Sperling Wz: {span(self.sperling[direction])}, most at {10 ** (THIRD_OCTAVES[worst] / 10):.3g} Hz "
                    f"((aB)^(2 x {exponent:.4g}) per band, powers of {power:g} added)"
                )
        return "\n".join([*lines, *(f"  note: {note}" for note in self.notes)])

    def plot(self, axes: "Axes", bands: "Axes | None" = None) -> None:
        """Weighted r.m.s. of successive 5 s over time; Sperling's index by third octaves where axes are given for it."""

        def lines(direction: str, values: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
            columns = values.reshape(len(values), -1).T
            of = [f", {place}" for place in self.places] if len(self.places) == len(columns) else [""] * len(columns)
            return zip([direction + place for place in of], columns, strict=True)

        for direction, blocks in self.blocks.items():
            for name, values in lines(direction, blocks):
                axes.stairs(
                    values, BLOCK * np.arange(len(values) + 1), baseline=None, label=f"{name} ({self.weightings[direction]})"
                )
        axes.set(xlabel="time, s", ylabel="weighted r.m.s. of 5 s, m/s²", ylim=(0.0, None))
        legend_above(axes, 2)
        if bands is None:
            return
        for direction, parts in self.sperling_bands.items():
            for (name, values), whole in zip(lines(direction, parts), self.sperling[direction].flat, strict=True):
                bands.semilogx([10.0 ** (n / 10.0) for n in THIRD_OCTAVES], values, ".-", label=f"{name}, $W_z$ = {whole:.2f}")
        bands.set(xlabel="third octave, Hz", ylabel="Sperling's index of the band", ylim=(0.0, None))
        bands.set_xticks([0.5, 1, 2, 4, 8, 16, 31.5], ["0.5", "1", "2", "4", "8", "16", "31.5"])
        bands.minorticks_off()
        legend_above(bands, 2)

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
            "mean_comfort_scale": None if self.mean is None else words(self.mean, MEAN_SCALE),
            "third_octaves_hz": [10 ** (n / 10) for n in THIRD_OCTAVES],
            "indices": {key: value.tolist() for key, value in self.indices.items()},
            "discrete_events_percent": {who: value.tolist() for who, value in self.events.items()},
            "curve_transitions_percent": {who: value.tolist() for who, value in self.curves.items()},
            "places": list(self.places),
            "directions": directions,
            "notes": list(self.notes),
        }


def span(values: ArrayLike) -> str:
    """A few values one by one, many as their range; NaN where a lane failed."""
    flat = np.ravel(values)
    if flat.size <= 4:
        return ", ".join(f"{value:.4g}" for value in flat)
    low, high = ends(flat)
    return f"{low:.4g} to {high:.4g}"


def words(values: ArrayLike, scale: tuple) -> str:
    """The scale's words for the least and the greatest value."""
    finite = np.ravel(values)[np.isfinite(np.ravel(values))]
    found = (
        [next(word for bound, word in scale if value < bound) for value in (finite.min(), finite.max())] if finite.size else []
    )
    return " to ".join(dict.fromkeys(found)) or "no number"


def shares(blocks: Float[np.ndarray, "blocks *lanes"]) -> str:
    """How much of the time is in each class of the continuous scale."""
    finite, lower, parts = blocks[np.isfinite(blocks)], -np.inf, []
    for bound, word in CONTINUOUS_SCALE:
        share = np.mean((finite >= lower) & (finite < bound)) if finite.size else 0.0
        parts += [f"{share:.0%} {word}"] if share else []
        lower = bound
    return ", ".join(parts) or "no number"
