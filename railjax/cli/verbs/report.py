"""`railjax report`: one page on any vehicle."""

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
    from ... import vehicle_report
    from ...base.progress import parts_bar
    from ...base.units import KMH
    from ...reports.vehicle.vehicle_report import SECTIONS

    with parts_bar() as report_part:
        made = vehicle_report(
            loaded,
            speed=None if speed_kmh is None else speed_kmh / KMH,
            track=track,
            sections=only or SECTIONS,
            progress=report_part,
        )
    made.save(out)
    show({**made.content, "out": str(out)}, [str(made), f"report: {out}"], as_json)
    if made.failed:
        raise NumericalError(f"{out} lacks {', '.join(f'{slug} ({reason})' for slug, reason in made.failed.items())}")
