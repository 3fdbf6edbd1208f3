"""The tracks that files and the command line know by name: the one table. A new kind adds its line here."""

from collections.abc import Mapping
from typing import Any

from ...base.by_name import Maker
from ...base.errors import InputError, nearest
from ...base.fields import given_fields
from .shapes import Track

#: name -> the track, or a dataclass of what may be said of it, with a method `track`
TRACKS = {
    "tangent": Maker("model.track.shapes", "TangentTrack"),
    "sinusoid": Maker("model.track.shapes", "SinusoidTrack"),
    "bump": Maker("model.track.shapes", "BumpTrack"),
    "random": Maker("model.track.random", "RandomOptions"),
}


def make_track(kind: str, table: Mapping[str, Any]) -> Track:
    """The track of a kind with the numbers of a table whose keys name their units, {"amplitude_mm": 5, "wavelength_m": 20}.

    Raises `InputError` for an unknown kind, for keys that it has not or lacks, and for what it refuses.
    """
    if kind not in TRACKS:
        raise InputError(f"track.kind must be one of {', '.join(TRACKS)}{nearest(kind, TRACKS)}")
    made = TRACKS[kind].found()
    values = given_fields(made, table, "track", also=("kind",), needed=True)
    try:
        track = made(**values)
        return track if isinstance(track, Track) else track.track()
    except InputError as error:
        raise InputError(f"track: {error}") from None
