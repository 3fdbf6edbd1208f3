"""Dampers and tracks of the command line's options."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..base.errors import InputError

if TYPE_CHECKING:
    from ..model.damper import Damper
    from ..model.track.layout import Layout
    from ..model.track.shapes import Track
    from ..model.vehicle import Vehicle


def chosen_damper(name: str, vehicle: "Vehicle", speed: float, alpha: float | None) -> "Damper":
    """The damper of --damper and --alpha, for a vehicle at a speed (m/s)."""
    from ..dampers.named import make_damper

    try:
        return make_damper(name, vehicle, speed, alpha)
    except InputError as error:
        if str(error).startswith(("damper", "alpha")):  # the names of options
            raise InputError(f"--{error}") from None
        raise


def make_track(
    name: str | None,
    seed: int | None,
    amplitude_mm: float | None = None,
    wavelength_m: float | None = None,
    bump_m: float | None = None,
    length: float = 0.0,
    file: dict[str, Any] | None = None,
) -> tuple["Track", list[str]]:
    """The track of `--track` (a spectrum's name, a file of one or of a measured track, a kind with its numbers as in
    "bump:amplitude_mm=5,length_m=10") or of the other options, and what it rests on.

    A random track repeats itself after `length` m at the earliest; `file` says how to read one (`files.track_file`).
    Raises `InputError`.
    """
    from .. import RandomTrack
    from ..base.text_table import is_table
    from ..model.track import named
    from ..model.track.random import LENGTH
    from .files import track_of_file

    if seed is not None and name is None:
        raise InputError("--track-seed is for a random track, like --track erri-high")
    if name is None:
        kind, of = ("sinusoid", {"wavelength_m": wavelength_m or 20.0}) if bump_m is None else ("bump", {"length_m": bump_m})
        track = named.make_track(kind, {"amplitude_mm": 5.0 if amplitude_mm is None else amplitude_mm} | of)
        return track, ["track: the paper gives no wavelength"]
    for option, value in (("amplitude-mm", amplitude_mm), ("wavelength-m", wavelength_m), ("bump-m", bump_m)):
        if value is not None:
            raise InputError(f"--{option} and --track exclude each other: give one")
    try:
        length = max(length, LENGTH)
        kind, _, numbers = name.partition(":")
        if kind in named.TRACKS and not is_table(name):
            if seed is not None:
                raise InputError("--track-seed is for a random track, like --track erri-high")
            found: Any = named.make_track(kind, dict(map(_number, numbers.split(",") if numbers else ())))
        elif is_table(name):
            found = track_of_file(name, seed, length, file or {})
        else:
            found = RandomTrack(name, seed=seed or 0, length=length)
    except InputError as error:
        raise InputError(f"--track: {error}") from None
    return found, [f"track: {line.strip()}" for line in str(found).splitlines()]


def load_layout(path: Path) -> "Layout":
    """The layout of `--layout`."""
    from .. import Layout

    try:
        return Layout.load(path)
    except InputError as error:
        raise InputError(f"--layout: {error}") from None


def upon_layout(path: Path, line: Any, assumed: list[str], *irregularity: Any) -> tuple[Any, list[str]]:
    """The layout of a file with the irregularity upon it, if one was asked for by any of its options, and what it rests on."""
    found = load_layout(path)
    if all(option is None for option in irregularity):
        return found, [f"layout: {found}"]
    return found.with_irregularity(line), [f"layout: {found}", *assumed]


def _number(text: str) -> tuple[str, Any]:
    """Key and value of "amplitude_mm=5"; what is no number stays a name."""
    key, equals, value = (piece.strip() for piece in text.partition("="))
    if not equals:
        raise InputError(f"write key=value with the unit in the key, as amplitude_mm=5, not {text.strip()!r}")
    for kind in (int, float):
        try:
            return key, kind(value)
        except ValueError:
            continue
    return key, value
