"""Columns of a measured track out of a file: what is missing, in another unit or no alignment is said in one line."""

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ...base.csv_columns import IN_PYTHON, Columns, read_columns
from ...base.errors import InputError

#: per quantity: the names by which a column is found without being told, and the factors of its usual units to SI
NAMES = {
    "distance": ("distance", "chainage", "station", "position", "s", "x", "km", "kilometre", "mileage", "milepost", "location"),
    "alignment": ("alignment", "lateral alignment", "alinement", "versine", "versines", "mid chord offset", "mco"),
    "left": ("alignment left", "left alignment", "left", "alignment l"),
    "right": ("alignment right", "right alignment", "right", "alignment r"),
    "cross_level": ("cross level", "crosslevel", "cant", "superelevation"),
    "gauge": ("gauge", "track gauge", "gage", "track gage"),
}
#: of the alignment's names those that say that it is not the space curve
VERSINES = re.compile("versine|chord|mco", re.IGNORECASE)
_SMALL = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "in": 25.4e-3}
UNITS = {"distance": {"m": 1.0, "km": 1e3, "ft": 0.3048}} | {kind: _SMALL for kind in list(NAMES)[1:]}

#: quantities that a track can do without: with a value missing they are left out
BESIDE = ("cross_level", "gauge")

#: samples below which there is no track
FEWEST = 16

#: m; largest alignment where no unit is said, and the finest samples of a track
LARGEST_ASSUMED, FINEST = 0.05, 5e-3


def read_track(
    path: Path, columns: Mapping[str, str], units: Mapping[str, str], chord: bool, bridge: bool
) -> tuple[dict[str, Float[np.ndarray, "samples"]], list[str]]:
    """Distance (rising), alignment and what there is beside them, in m, and notes on what was assumed and done; `columns` and `units` as
    `MeasuredTrack.from_csv` has them. With `chord` the alignment may be versines, with `bridge` it may lack values, which are NaN.
    Raises `InputError`."""
    read = read_columns(
        path,
        NAMES,
        UNITS,
        columns=columns,
        given=units,
        at_least=FEWEST,
        purpose="make a track",
        options=IN_PYTHON,
        lenient=(*BESIDE, "left", "right", "alignment") if bridge else (*BESIDE, "left", "right"),
    )
    found, notes = read.found, read.notes
    if "distance" not in found:
        raise InputError(
            f"{path}: no column of the distance; name it 'distance (m)' in the header, or by columns['distance'] (--columns distance=NAME); {read.there}"
        )
    both = [found.pop(side, None) for side in ("left", "right")]
    if "alignment" not in found:
        if any(side is None for side in both):
            raise InputError(
                f"{path}: no column of the lateral alignment; name it 'alignment (mm)', or both 'alignment left (mm)' and 'alignment right (mm)'; {read.there}"
            )
        if not bridge and (fault := read.lacking.get("left") or read.lacking.get("right")):
            raise InputError(f"{fault}; short holes are bridged by bridge")
        found["alignment"] = 0.5 * (both[0] + both[1])  # type: ignore[operator]
        notes.append("alignment: mean of the left and the right rail's")
    if not chord:
        _refuse_versines(read, path)
    _refuse_units(read, path)
    for kind in sorted(found.keys() & set(BESIDE)):
        word = kind.replace("_", " ")
        if kind in read.lacking:
            del found[kind]
            notes.append(f"{word}: left out ({read.lacking[kind].removeprefix(f'{path}, ')})")
        elif kind == "gauge":
            notes.append("gauge: kept, but the model does not use it")
        else:
            notes.append("cross level: rolls the track, positive where the left rail is higher (assumed)")
    if np.all(np.diff(found["distance"]) < 0.0):
        found = {kind: values[::-1] for kind, values in found.items()}
        notes.append("distance: falls, so the record is turned round (the signs of the alignment are kept)")
    return found, notes


def _refuse_versines(read: Columns, path: Path) -> None:
    """A column of versines is no alignment."""
    versines = [name for kind, name in read.names.items() if kind in ("alignment", "left", "right") and VERSINES.search(name)]
    if versines:
        raise InputError(
            f"{path}: column {versines[0]!r} holds versines over a chord; give the chord's length (chord, --chord-m)"
        )


def _refuse_units(read: Columns, path: Path) -> None:
    """Numbers that no track has in the unit that was assumed for want of one."""
    step = float(np.median(np.abs(np.diff(read.found["distance"]))))
    if "distance" in read.assumed and step < FINEST:
        raise InputError(
            f"{path}: a sample every {step:.3g} m, if column {read.assumed['distance']!r}, which says no unit, is in m; give its unit, as distance=km"
        )
    for kind in read.assumed.keys() & {"alignment", "left", "right"}:
        values = read.found.get(kind, read.found["alignment"])
        if (reached := float(np.nanmax(np.abs(values - np.nanmedian(values))))) > LARGEST_ASSUMED:
            raise InputError(
                f"{path}: {kind} {reached:.3g} m from its middle, if column {read.assumed[kind]!r}, which says no unit, is in m; "
                f"check its unit and give it, as {kind}=mm"
            )
