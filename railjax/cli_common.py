"""What the modules of the command line share."""

import json
import math
from typing import Annotated, Any

import typer

from .errors import InputError



def complete_vehicle(incomplete: str) -> list[str]:
    """Packaged vehicles for the shell's completion; where none fits, the shell completes files."""
    from .vehicle_files import packaged_vehicles

    return [name for name in packaged_vehicles() if name.startswith(incomplete)]


VehicleName = Annotated[
    str,
    typer.Argument(
        metavar="VEHICLE",
        help="A packaged vehicle (see 'railjax vehicles') or a TOML file.",
        autocompletion=complete_vehicle,
    ),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object on standard output and nothing else.")]


def load(name: str) -> Any:
    """Prepare JAX (double precision, all cores) and load the vehicle."""
    from . import load_vehicle, use_all_cores, use_double_precision

    use_double_precision()
    use_all_cores()
    return load_vehicle(name)


def calibrated(vehicle: Any) -> list[str]:
    """What of the vehicle was fitted, a line each."""
    return [f"{p.parameter}: {p.note}" for p in vehicle.provenance if p.status == "calibrated"]


def show(content: dict[str, Any], lines: list[str], as_json: bool) -> None:
    """Print the content as one JSON object, or the lines."""
    from .report import without_nan

    print(json.dumps(without_nan(content), allow_nan=False) if as_json else "\n".join(lines))


def finite(positive: bool = True, **options: float | None) -> None:
    """Refuse options that are not finite (and positive); None is an option that was not given."""
    for name, value in options.items():
        if value is not None and not (math.isfinite(value) and (value > 0 or not positive)):
            kind = "a positive, finite number" if positive else "a finite number"
            raise InputError(f"--{name.replace('_', '-')} must be {kind}, not {value:g}")
