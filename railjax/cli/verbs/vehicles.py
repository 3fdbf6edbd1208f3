"""`railjax vehicles` and `railjax check`: the packaged vehicles, a vehicle file of one's own, and what is doubtful in it."""

import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from ...base.errors import InputError
from ..common import AsJson, VehicleName, complete_vehicle, show
from ..out import OutJson, check_out


class Listing(TyperGroup):
    """A group of verbs that lists if none is given."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        named = ctx.resilient_parsing or (args and args[0] in (*self.commands, "--help"))
        return super().parse_args(ctx, args if named else ["list", *args])


vehicles_app = typer.Typer(cls=Listing, help="List the packaged vehicles; write a vehicle file of your own (new).")


@vehicles_app.command("list")
def list_vehicles(out: OutJson = None, as_json: AsJson = False) -> None:
    """List the packaged vehicles, also without 'list'.

    Example: railjax vehicles --json
    """
    from ... import load_vehicle, packaged_vehicles

    check_out(out)
    found = {name: load_vehicle(name) for name in packaged_vehicles()}
    content = {"vehicles": [{"name": name, "note": vehicle.note} for name, vehicle in found.items()]}
    show(content, [f"{name:16s} {vehicle.note}" for name, vehicle in found.items()], as_json, out)


@vehicles_app.command()
def new(
    file: Annotated[Path, typer.Argument(metavar="FILE.toml", help="The file to write.")],
    original: Annotated[
        str,
        typer.Option("--from", help="The vehicle to copy: a packaged one or a TOML file.", autocompletion=complete_vehicle),
    ] = "coach",
    force: Annotated[bool, typer.Option("--force", help="Overwrite a file that is there.")] = False,
    as_json: AsJson = False,
) -> None:
    """Write a vehicle file with every key, its unit, its symbol, its meaning and its source, to be edited.

    Example: railjax vehicles new my.toml --from coach
    """
    from ... import load_vehicle
    from ...base.version import __version__
    from ...vehicles.files import source_of
    from ...vehicles.template import vehicle_toml

    if file.suffix != ".toml":
        raise InputError(f"{file}: the name must end in .toml")
    vehicle = load_vehicle(original)
    source = f"copied from {vehicle.name} of railjax {__version__}" + (f": {told}" if (told := source_of(original)) else "")
    text = vehicle_toml(vehicle, name=file.stem, source=source)
    try:
        with file.open("w" if force else "x", encoding="utf-8") as handle:
            handle.write(text)
    except FileExistsError:
        raise InputError(f"{file} is there already; --force overwrites it") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{file}: cannot be written ({getattr(error, 'strerror', None) or error})") from None
    show(
        {"file": str(file), "from": vehicle.name},
        [f"{file}: a copy of {vehicle.name}; edit it, then: railjax check {file}"],
        as_json,
    )


def check(vehicle: VehicleName, out: OutJson = None, as_json: AsJson = False) -> None:
    """What is wrong in a vehicle file (exit status 2) or doubtful (status 0, with a warning for each).

    Example: railjax check my.toml

    Example: railjax check my.toml --json
    """
    from ...vehicles.check import check_vehicle
    from ..common import load

    check_out(out)
    try:
        found = check_vehicle(load(vehicle))
    except InputError as error:
        for message in error.messages:
            print(f"railjax: {message}", file=sys.stderr)
        content = {"vehicle": vehicle, "errors": error.messages, "warnings": [], "derived": []}
        show(content, [], as_json, out)
        raise typer.Exit(2) from None
    show({"vehicle": found.vehicle, "errors": [], **found.as_dict()}, [str(found)], as_json, out)
