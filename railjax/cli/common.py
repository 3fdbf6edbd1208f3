"""What the modules of the command line share."""

import contextlib
import json
import math
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from ..base.errors import InputError
from ..dampers.named import DAMPERS, WITH_ALPHA
from .out import JSON, Writer, write_out


def completing(names: Callable[[], Iterable[str]]) -> Callable[[str], list[str]]:
    """What a shell offers for an argument of these names; where none fits, it offers files."""

    def complete(incomplete: str) -> list[str]:
        return [name for name in names() if name.startswith(incomplete)]

    return complete


def _vehicles() -> list[str]:
    from ..vehicles.files import packaged_vehicles

    return packaged_vehicles()


def _spectra() -> list[str]:
    from ..model.track.spectra import NAMED

    return list(NAMED)


def _tracks() -> list[str]:
    from ..model.track.named import TRACKS

    return [*_spectra(), *(f"{kind}:" for kind in TRACKS)]


complete_vehicle, complete_spectrum, complete_track = completing(_vehicles), completing(_spectra), completing(_tracks)
VehicleName = Annotated[
    str,
    typer.Argument(
        metavar="VEHICLE",
        help="A packaged vehicle (see 'railjax vehicles') or a TOML file.",
        autocompletion=complete_vehicle,
    ),
]
DamperName = Annotated[
    str,
    typer.Option(
        help=f"Secondary lateral damper: {', '.join(DAMPERS)}; or the file of a law (.npz).",
        autocompletion=completing(lambda: DAMPERS),
    ),
]
Alpha = Annotated[float | None, typer.Option(help=f"Gain α of the dampers {' and '.join(WITH_ALPHA)}.")]
TRACKS = "erri-low, erri-high, fra-1 to fra-6"
OTHER_TRACKS = "the file of a measured one, or of a spectrum; or a kind with its numbers, as bump:amplitude_mm=5,length_m=10"
TrackName = Annotated[
    str,
    typer.Option(
        help=f"A random track, {TRACKS}; or the file of a measured one, or of a spectrum.", autocompletion=complete_spectrum
    ),
]
LayoutFile = Annotated[
    Path | None,
    typer.Option(
        "--layout", help="The line's layout, on which the track lies: a TOML file of segments, or samples; straight if not given."
    ),
]
TrackSeed = Annotated[int | None, typer.Option(help="Which random track; 0 if not given.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object on standard output and nothing else.")]


def prepare() -> None:
    """JAX as the command line uses it: double precision, all cores, and what an earlier command compiled is not compiled again."""
    from .. import keep_compiled, use_all_cores, use_double_precision

    use_double_precision()
    use_all_cores()
    keep_compiled(whole=True)


def load(name: str) -> Any:
    """Prepare JAX and load the vehicle."""
    from .. import load_vehicle

    prepare()
    return load_vehicle(name)


def calibrated(vehicle: Any) -> list[str]:
    """What of the vehicle was fitted, a line each."""
    return [f"{p.parameter}: {p.note}" for p in vehicle.provenance if p.status == "calibrated"]


def show(
    content: dict[str, Any], lines: list[str], as_json: bool, out: Path | None = None, forms: Mapping[str, Writer] | None = None
) -> None:
    """Print the content as one JSON object, or the lines; write it to the file of `--out`, too, in one of the forms or as that object."""
    from ..base.text import without_nan

    def text() -> str:
        return json.dumps(without_nan(content), allow_nan=False)

    write_out(out, {JSON: lambda out: out.write_text(text() + "\n", encoding="utf-8"), **(forms or {})})
    if as_json or lines:
        print(text() if as_json else "\n".join(lines))


def finite(positive: bool = True, **options: float | None) -> None:
    """Refuse options that are not finite (and positive); None is an option that was not given."""
    for name, value in options.items():
        if value is not None and not (math.isfinite(value) and (value > 0 or not positive)):
            kind = "a positive, finite number" if positive else "a finite number"
            raise InputError(f"--{name.replace('_', '-')} must be {kind}, not {value:g}")


@contextlib.contextmanager
def working(what: str) -> Iterator[None]:
    """Say on standard error, if that is a terminal, what is being computed and for how long."""
    # not into a file or a pipe, where errors are to be the only line
    if not sys.stderr.isatty():
        yield
        return
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as spinner:
        spinner.add_task(what, total=None)
        yield
