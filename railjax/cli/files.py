"""Options of the command line about files of data: columns, units, what is done to a track."""

import re
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..base.errors import InputError
from .common import finite

if TYPE_CHECKING:
    from ..model.track.shapes import Track

Columns = Annotated[
    str | None,
    typer.Option(
        help="Columns of the file, as 'lateral=Ay,vertical=Az' or, of a track, 'distance=km,alignment=3' (numbers count from 1)."
    ),
]
Units = Annotated[
    list[str] | None,
    typer.Option("--unit", help="Unit of a column, as lateral=g (may be repeated); g alone is of all accelerations."),
]
TimeUnit = Annotated[
    str | None, typer.Option(help="Unit of the file's time: s, ms, us, ns, min, ... (default: from the header).")
]
ChordM = Annotated[
    float | None, typer.Option(help="The track's file holds versines over chords of this length in m: restore the alignment.")
]
LongestM = Annotated[float | None, typer.Option(help="Filter away longer waves of the track's file, in m.")]
ShortestM = Annotated[float | None, typer.Option(help="Filter away shorter waves of the track's file, in m.")]
BridgeM = Annotated[float | None, typer.Option(help="Bridge spikes and holes of the track's file up to this length in m.")]
BridgeS = Annotated[float | None, typer.Option(help="Bridge holes of the record up to this many s; 0.1 if not given.")]


def named(option: str, texts: Iterable[str], kinds: Iterable[str], left: str = "direction") -> dict[str, str | None]:
    """What 'kind=value,kind=value' says; a name may hold commas. Raises `InputError`."""
    kinds = list(kinds)
    found: dict[str, str | None] = {}
    boundary = "|".join(map(re.escape, kinds)) + r"|\w+"
    for text in texts:
        for part in re.split(rf",(?=\s*(?:{boundary})\s*=|\s*$|\s*\w+\s*$)", text):
            kind, equals, value = (piece.strip() for piece in part.partition("="))
            if kind and (not equals or kind not in kinds or not value):
                raise InputError(f"{option} {part.strip()!r}: write {left}=name, with {', '.join(kinds)} on the left")
            found |= {kind: value} if kind else {}
    return found


def units_of(
    texts: list[str] | None, kinds: Iterable[str], time_unit: str | None = None, known: dict[str, float] | None = None
) -> dict:
    """Units by quantity: a unit alone is that of all but the time. `known` are the units that such a one may be. Raises `InputError`."""
    from ..base.file_units import factor

    kinds, found = list(kinds), {}  # type: ignore[var-annotated]
    for text in texts or ():
        if "=" in text:
            found |= named("--unit", [text], kinds, "quantity")
        elif known is None:
            raise InputError(f"--unit {text!r}: write quantity=unit, with {', '.join(kinds)} on the left")
        elif factor(text, known) is None:
            raise InputError(f"--unit must be one of {', '.join(known)}, not {text!r}")
        else:
            found = {kind: text for kind in kinds if kind not in ("time", "roll rate")} | found
    return found | ({} if time_unit is None else {"time": time_unit})


def track_file(
    track: str | None,
    columns: str | None,
    unit: list[str] | None,
    chord_m: float | None,
    longest_m: float | None,
    shortest_m: float | None,
    bridge_m: float | None,
) -> dict[str, Any]:
    """How the file of `--track` is to be read, for `make_track`. Raises `InputError` where there is none to read."""
    from ..base.text_table import is_table
    from ..model.track import columns as track_columns
    from ..model.track import spectra

    finite(chord_m=chord_m, longest_m=longest_m, shortest_m=shortest_m, bridge_m=bridge_m)
    options = {"chord": chord_m, "longest": longest_m, "shortest": shortest_m, "bridge": bridge_m}
    given = [f"--{key}-m" for key, value in options.items() if value is not None]
    given += [option for option, value in (("--columns", columns), ("--unit", unit)) if value]
    if given and not (track and is_table(track)):
        raise InputError(f"{given[0]} is for a track's file, like --track line.csv")
    kinds = [*track_columns.NAMES, *spectra.NAMES]
    return {"columns": named("--columns", [columns or ""], kinds, "quantity"), "units": units_of(unit, kinds), **options}


def track_of_file(name: str, seed: int | None, length: float, options: dict[str, Any]) -> "Track":
    """The measured track in a file, or a random one of the spectrum in it. Raises `InputError`."""
    from .. import MeasuredTrack, RandomTrack, TableSpectrum
    from ..base.csv_columns import quantities
    from ..model.track import columns as track_columns
    from ..model.track import spectra

    columns, units = options.get("columns", {}), options.get("units", {})
    told = set(columns) | set(units)
    of_track = quantities(Path(name), track_columns.NAMES, track_columns.UNITS, columns)
    of_spectrum = quantities(Path(name), spectra.NAMES, spectra.UNITS, columns)
    if (of_spectrum == set(spectra.NAMES) and not of_track & {"alignment", "left", "right"}) or told & set(spectra.NAMES):
        rest = [key for key in ("chord", "longest", "shortest", "bridge") if options.get(key) is not None]
        if rest:
            raise InputError(f"{name} holds a spectrum, --{rest[0]}-m is for a measured track")
        return RandomTrack(TableSpectrum.from_csv(name, columns=columns, units=units), seed=seed or 0, length=length)
    if seed is not None:
        raise InputError("--track-seed is for a random track, like --track erri-high")
    return MeasuredTrack.from_csv(name, **options)
