"""The result of an assessment: findings by criterion, printed and as JSON."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from ...base.arguments import guarded
from ...base.checks import whole
from ...base.errors import InputError
from ...base.units import KMH
from .criteria import CRITERIA, NO_WHEELS, NOT_ASSESSED, PLACES, RMS_OVER, Criterion

Values = Float[np.ndarray, "..."]

#: of the forces of single wheels, which vehicles on profiles have
OF_WHEELS = ("derailment", "guiding_force_quasistatic")

#: SI unit -> printed unit and factor
PRINTED = {"N": ("kN", 1e-3), "m/s^2": ("m/s^2", 1.0), "1": ("1", 1.0)}


@dataclass(frozen=True)
class Finding:
    """One quantity of the standard, arrays (*lanes).

    `value` is what is compared with `limit`: the largest of the parts' estimated maxima, or the largest sliding r.m.s. (NaN
    where there is none). `largest` is the largest value of a single section or window, which was found at `part` (wheelset, axle
    or bogie, 1 in front) and begins `position` m from the start of the record. `verdict`: "met", "exceeded", "not determined".
    """

    value: Values
    limit: Values
    largest: Values
    part: Int[np.ndarray, "..."]
    position: Values
    verdict: Shaped[np.ndarray, "..."]


@dataclass(frozen=True)
class Acceptance:
    """Result of `acceptance`: `findings` by the keys of `CRITERIA`, for a run or for each lane of a batch; prints itself."""

    findings: dict[str, Finding]
    speed: Values  # m/s
    hunting_frequency: Values  # f0, Hz
    sections: Int[np.ndarray, "..."]  # number of them
    section_length: Values  # m
    minimum_sections: int  # number that a full assessment needs
    ok: Bool[np.ndarray, "..."]
    name: str = ""
    criteria: Mapping[str, Criterion] = field(default_factory=lambda: CRITERIA)

    @property
    def verdict(self) -> Shaped[np.ndarray, "..."]:
        """Over all quantities in the record: "exceeded" if any is, "met" if all are."""
        each = np.array([finding.verdict for finding in self.findings.values()])
        return np.where(
            (each == "exceeded").any(axis=0), "exceeded", np.where((each == "met").all(axis=0), "met", "not determined")
        )

    @guarded(index=whole(0))
    def lane(self, index: int) -> "Acceptance":
        """The result of a single lane, that of number `index`."""
        if index >= np.size(self.ok):
            raise InputError(f"index must be below the number of lanes, {np.size(self.ok)}, not {index}")
        findings = {key: Finding(*(np.asarray(a[index]) for a in vars(f).values())) for key, f in self.findings.items()}
        arrays = (self.speed, self.hunting_frequency, self.sections, self.section_length)
        own = (np.asarray(a[index]) for a in arrays)
        return Acceptance(findings, *own, self.minimum_sections, np.asarray(self.ok[index]), self.name, self.criteria)  # type: ignore[call-arg]

    def notes(self) -> list[str]:
        """What has to be known beside the numbers."""
        few = self.ok & (self.sections < self.minimum_sections)
        wheels = () if "derailment" in self.findings else (NO_WHEELS,)
        absent = [criterion.name for key, criterion in self.criteria.items() if key not in self.findings and key not in OF_WHEELS]
        return [
            "In the manner of UIC 518 / EN 14363; no certificate. Limits and factors k are recalled; as_dict() names the sources.",
            *([f"No sound run (diverged, or dt too large): {np.sum(~self.ok)} lane(s)."] if not np.all(self.ok) else []),
            *([f"Fewer than {self.minimum_sections} sections: too few to estimate a maximum."] if np.any(few) else []),
            *([f"Not in the record: {', '.join(absent)}."] if absent else []),
            *(f"Not assessed: {entry}." for entry in (*wheels, *NOT_ASSESSED)),
        ]

    def __str__(self) -> str:
        return "\n".join([table_of(self), *(f"  {note}" for note in self.notes())])

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers and texts for JSON, SI units: of a batch {"lanes": [...], ...}, of a run the quantities themselves."""
        return plain(self)

    to_dict = as_dict  # its name until 0.3


def table_of(result: Acceptance) -> str:
    """Head and a table: quantity, value, limit, verdict, where in the run; of a batch a lane a row."""
    if result.speed.ndim:
        return several_runs(result)
    rows = [("quantity", "value", "limit", "unit", "of limit", "verdict", "largest in")]
    for key, found in result.findings.items():
        criterion = result.criteria[key]
        unit, factor = PRINTED[criterion.unit]
        extent = RMS_OVER[0] if criterion.statistic == "sliding rms" else float(result.section_length)
        start = float(found.position)
        where = f"{PLACES[criterion.signal]} {int(found.part)}, {start:.0f} to {start + extent:.0f} m" if result.ok else "-"
        value, limit = float(found.value), float(found.limit)
        shown = [f"{v * factor:.3g}" if np.isfinite(v) else "-" for v in (value, limit)]
        share = f"{100 * value / limit:.0f} %" if np.isfinite(value) else "-"
        rows.append((criterion.name, *shown, unit, share, str(found.verdict), where))
    head = (
        f"Running behaviour of {result.name or 'a vehicle'} at {float(result.speed) * KMH:.1f} km/h: {result.verdict}; "
        f"{int(result.sections)} sections of {float(result.section_length):g} m, f0 = {float(result.hunting_frequency):.2f} Hz"
    )
    return "\n".join([head, *_aligned(rows)])


def several_runs(result: Acceptance) -> str:
    """A lane a row, a quantity a column: per cent of the limit; * beyond it, ? where it is not determined."""
    keys = list(result.findings)
    rows = [("lane", "km/h", "f0, Hz", "sections", *keys, "verdict")]
    mark = {"met": "", "exceeded": " *", "not determined": " ?"}
    for lane, speed in enumerate(result.speed):
        shares = []
        for found in result.findings.values():
            value = found.value[lane] if np.isfinite(found.value[lane]) else found.largest[lane]
            share = f"{100 * value / found.limit[lane]:.0f}" if np.isfinite(value) else "-"
            shares.append(share + mark[str(found.verdict[lane])])
        f0 = result.hunting_frequency[lane]
        first = (str(lane), f"{speed * KMH:.1f}", f"{f0:.2f}" if np.isfinite(f0) else "-", str(result.sections[lane]))
        rows.append((*first, *shares, str(result.verdict[lane]) if result.ok[lane] else "no sound run"))
    head = f"Running behaviour of {result.name or 'a vehicle'}, {len(result.speed)} lanes: per cent of the limit (* exceeded, ? not determined)"
    return "\n".join([head, *_aligned(rows)])


def plain(result: Acceptance) -> dict[str, Any]:
    """The content of `Acceptance.as_dict`."""
    if result.speed.ndim:
        return {"vehicle": result.name, "lanes": [plain(result.lane(k)) for k in range(len(result.speed))]}
    quantities = {}
    for key, found in result.findings.items():
        criterion = result.criteria[key]
        quantities[key] = {
            "name": criterion.name,
            "unit": criterion.unit,
            "value": float(found.value),
            "limit": float(found.limit),
            "verdict": str(found.verdict),
            "largest": float(found.largest),
            PLACES[criterion.signal]: int(found.part),
            "position_m": float(found.position),
            "statistic": criterion.statistic,
            "band_hz": list(criterion.band) if criterion.band else "f0 +- 2",
            "k": criterion.k,
            "sources": criterion.sources,
        }
    return {
        "vehicle": result.name,
        "speed_kmh": float(result.speed) * KMH,
        "verdict": str(result.verdict),
        "ok": bool(result.ok),
        "hunting_frequency_hz": float(result.hunting_frequency),
        "sections": int(result.sections),
        "section_length_m": float(result.section_length),
        "quantities": quantities,
        "notes": result.notes(),
    }


def _aligned(rows: list[tuple[str, ...]]) -> list[str]:
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return ["  " + "  ".join(f"{cell:{width}s}" for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
