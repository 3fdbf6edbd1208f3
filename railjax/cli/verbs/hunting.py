"""`railjax hunting`: the bifurcation diagram on the command line."""

from pathlib import Path
from typing import Annotated

import typer

from ..common import AsJson, VehicleName, calibrated, finite, load, show, working
from ..out import PICTURES, TABLE, as_picture, as_table, check_out, out_option


def hunting(
    vehicle: VehicleName,
    highest_speed_kmh: Annotated[
        float | None, typer.Option(help="How far to go in km/h (default 1.25 times the Hopf speed).")
    ] = None,
    wheelset: Annotated[
        int | None, typer.Option(help="Wheelset whose amplitude counts, 1 in front (default: leading one of the trailing bogie).")
    ] = None,
    steps: Annotated[int | None, typer.Option(help="RK4 steps in half a period (default: as many as needed).")] = None,
    ramp: Annotated[bool, typer.Option("--ramp", help="Simulate a slow speed ramp down and up beside it.")] = False,
    out: Annotated[Path | None, out_option("the diagram or its points", *PICTURES, TABLE)] = None,
    as_json: AsJson = False,
) -> None:
    """Limit cycles over speed: Hopf point, folds, stability (the bifurcation diagram).

    Example: railjax hunting coach --out diagram.png
    """
    from ... import hunting_branch, speed_ramp
    from ...base.units import KMH

    finite(highest_speed_kmh=highest_speed_kmh, steps=steps)
    check_out(out, *PICTURES, TABLE)
    loaded = load(vehicle)
    highest = None if highest_speed_kmh is None else highest_speed_kmh / KMH
    index = None if wheelset is None else wheelset - 1
    with working(f"limit cycles of {loaded.name}"):
        branch = hunting_branch(loaded, highest_speed=highest, wheelset=index, steps=steps)
    isolated, slow = branch.criticality == "isolated", None
    if ramp:
        with working(f"slow ramp of {loaded.name}"):
            top = branch.speed.max() if isolated else 1.05 * float(branch.hopf.speed)
            slow = speed_ramp(loaded, 0.98 * branch.speed.min(), float(top), wheelset=index)
    fitted = calibrated(loaded)
    content = {**branch.as_dict(), "calibrated": fitted}
    lines = [str(branch)]
    if slow is not None:
        content["ramp"] = slow.as_dict()
        lines.append(str(slow))
    if branch.fold is None:
        lines.append(
            "no fold: limit cycles leave the Hopf point towards higher speeds, so it is the nonlinear critical speed as well"
        )
    lines += [f"calibrated, not predicted: {entry}" for entry in fitted]
    forms = as_picture(lambda axes: branch.plot(axes[0, 0], slow), height=4.4) | as_table(
        [point.as_dict() for point in branch.points]
    )
    show(content, lines, as_json, out, forms)
