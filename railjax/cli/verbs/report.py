"""`railjax report`: one page on any vehicle."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from ...base.errors import InputError, NumericalError
from ..common import AsJson, VehicleName, finite, load, show


def report(
    vehicle: VehicleName,
    out: Annotated[Path, typer.Option(help="The page: an .html file.")] = Path("report.html"),
    speed_kmh: Annotated[
        float | None, typer.Option(help="Speed of modes and comfort in km/h (default three quarters of the critical speed).")
    ] = None,
    track: Annotated[str, typer.Option(help="Spectrum of the track: erri-low, erri-high, fra-1 to fra-6.")] = "erri-high",
    only: Annotated[list[str] | None, typer.Option(help="Make only this section (may be repeated).")] = None,
    as_json: AsJson = False,
) -> None:
    """One self-contained page on a vehicle: modes, critical speeds, bifurcation, sensitivities, comfort, semi-active dampers.

    Example: railjax report coach --out coach.html

    Example: railjax report my.toml --speed-kmh 160 --track erri-low --only modes --only comfort --out ride.html
    """
    finite(speed_kmh=speed_kmh)
    if out.suffix not in (".html", ".htm"):
        raise InputError(f"--out {out}: the name must end in .html")
    if not out.parent.is_dir():
        raise InputError(f"--out {out}: there is no folder {out.parent}")
    loaded = load(vehicle)
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    from ... import vehicle_report
    from ...base.units import KMH
    from ...reports.vehicle.vehicle_report import SECTIONS

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    # not into a file or a pipe, where errors are to be the only line
    with Progress(*columns, console=Console(stderr=True), disable=not sys.stderr.isatty()) as bar:
        task = bar.add_task("", total=None)
        made = vehicle_report(
            loaded,
            speed=None if speed_kmh is None else speed_kmh / KMH,
            track=track,
            sections=only or SECTIONS,
            progress=lambda title, done, total: bar.update(task, description=title, completed=done, total=total),
        )
    made.save(out)
    show({**made.content, "out": str(out)}, [str(made), f"report: {out}"], as_json)
    if made.failed:
        raise NumericalError(f"{out} lacks {', '.join(f'{slug} ({reason})' for slug, reason in made.failed.items())}")
