"""How an `Acceptance` is printed and turned into JSON."""

from typing import TYPE_CHECKING, Any

import numpy as np

from ...base.units import KMH
from .criteria import CRITERIA, PLACES, RMS_OVER

if TYPE_CHECKING:
    from .assess import Acceptance

#: SI unit -> printed unit and factor
PRINTED = {"N": ("kN", 1e-3), "m/s^2": ("m/s^2", 1.0)}


def one_run(result: "Acceptance") -> str:
    """A table: quantity, value, limit, verdict, where in the run."""
    rows = [("quantity", "value", "limit", "unit", "of limit", "verdict", "largest in")]
    for key, found in result.findings.items():
        criterion = CRITERIA[key]
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
    return "\n".join([head, *_aligned(rows), *(f"  {note}" for note in result.notes())])


def several_runs(result: "Acceptance") -> str:
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
    return "\n".join([head, *_aligned(rows), *(f"  {note}" for note in result.notes())])


def plain(result: "Acceptance") -> dict[str, Any]:
    """The content of `Acceptance.to_dict`."""
    if result.speed.ndim:
        return {"vehicle": result.name, "lanes": [plain(result.lane(k)) for k in range(len(result.speed))]}
    quantities = {}
    for key, found in result.findings.items():
        criterion = CRITERIA[key]
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
