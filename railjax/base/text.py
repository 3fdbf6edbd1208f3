"""Numbers as text: in reports, in JSON, and as the lines of a result that prints itself, in the units of a workshop drawing."""

import dataclasses
import math
from typing import Any

import numpy as np

#: SI unit -> what is printed, and its factor
PRINTED: dict[str, tuple[str, float]] = {
    "m": ("mm", 1e3),
    "m^2": ("mm^2", 1e6),
    "m^3": ("mm^3", 1e9),
    "m^3/s": ("cm^3/s", 1e6),
    "Pa": ("kPa", 1e-3),
    "A/m": ("kA/m", 1e-3),
}


def number(value: float | None) -> str:
    """As the report prints it: six digits, a dash where there is none."""
    if value is None:
        return "-"
    return f"{value:.6g}"


def without_nan(content: Any) -> Any:
    """The content with None for NaN and infinities, which JSON cannot hold."""
    if isinstance(content, dict):
        return {key: without_nan(value) for key, value in content.items()}
    if isinstance(content, list):
        return [without_nan(value) for value in content]
    return None if isinstance(content, float) and not math.isfinite(content) else content


def described(part: Any) -> str:
    """A dataclass of `quantity` fields as lines of meaning, symbol, value and unit; of lanes the smallest and the largest."""
    rows = []
    for entry in dataclasses.fields(part):
        value = getattr(part, entry.name)
        if "unit" not in entry.metadata or value is None:
            continue
        unit, factor = PRINTED.get(entry.metadata["unit"], (entry.metadata["unit"], 1.0))
        values = np.unique([np.min(value) * factor, np.max(value) * factor])
        text = " to ".join(number(float(v)) for v in values)
        rows.append((entry.metadata["meaning"], entry.metadata["symbol"], text, "" if unit == "1" else unit))
    widths = [max(len(row[column]) for row in rows) for column in range(3)]
    return "\n".join(f"{m:{widths[0]}s}  {s:{widths[1]}s}  {t:>{widths[2]}s} {u}".rstrip() for m, s, t, u in rows)
