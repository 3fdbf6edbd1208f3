"""`railjax modes` and `railjax critical-speed`: straight running and its limits, on the command line."""

from pathlib import Path
from typing import Annotated, Any

import typer

from ..common import AsJson, VehicleName, calibrated, finite, load, show, working
from ..out import PICTURES, TABLE, as_picture, as_table, check_out, out_option


def modes(
    vehicle: VehicleName,
    speed_kmh: Annotated[float, typer.Option(help="Speed in km/h.")] = 180.0,
    out: Annotated[Path | None, out_option("the modes, or their damping up to this speed, drawn,", TABLE, *PICTURES)] = None,
    as_json: AsJson = False,
) -> None:
    """Frequencies, damping ratios and names of the modes of straight running.

    Example: railjax modes coach --speed-kmh 245

    Example: railjax modes coach --speed-kmh 245 --out modes.csv
    """
    from ...base.units import KMH
    from ...stability.modes import modes as compute

    finite(speed_kmh=speed_kmh)
    check_out(out, TABLE, *PICTURES)
    loaded = load(vehicle)
    found = compute(loaded, speed_kmh / KMH)
    content = {"vehicle": vehicle, **found.as_dict(), "speed_kmh": speed_kmh}
    forms = as_table(content["modes"]) | as_picture(lambda axes: _damping(axes[0, 0], loaded, speed_kmh, {}), height=4.4)
    show(content, [str(found)], as_json, out, forms)


def critical_speed(
    vehicle: VehicleName,
    nonlinear: Annotated[bool, typer.Option("--nonlinear", help="Also the fold of the limit cycles.")] = False,
    out: Annotated[Path | None, out_option("the result, or the modes' damping over speed, drawn,", *PICTURES)] = None,
    as_json: AsJson = False,
) -> None:
    """Linear critical speed, where straight running loses stability; nonlinear, below which nothing makes the vehicle hunt.

    Example: railjax critical-speed coach --nonlinear --json
    """
    from ...base.units import KMH
    from ...stability.hunting.nonlinear_critical import nonlinear_critical, refuse, told
    from ...stability.linear_critical import HIGHEST, Stability, linear_critical, linear_critical_speed
    from ...stability.modes import modes as compute

    check_out(out, *PICTURES)
    loaded = load(vehicle)
    linear = linear_critical(loaded)
    # without a linear critical speed limit cycles may exist all the same
    stable = int(linear.code) == Stability.STABLE
    speed = HIGHEST if stable and nonlinear else float(linear_critical_speed(loaded))
    critical = compute(loaded, speed)
    fitted = calibrated(loaded)
    found, described = {}, []
    if nonlinear:
        with working(f"fold of the limit cycles of {loaded.name}"):
            fold = nonlinear_critical(loaded)
        refuse(fold.code)
        found, described = fold.as_dict(), [told(fold, loaded)]
    content = {
        "vehicle": loaded.name,
        "linear_kmh": None if stable else speed * KMH,
        "frequency_hz": None if stable else float(critical.frequency[0]),
        "mode": None if stable else critical.names[0],
        **found,
        "calibrated": fitted,
        "note": loaded.note,
    }
    lines = [
        f"{loaded.name}: straight running is stable up to {speed * KMH:.0f} km/h"
        if stable
        else f"{loaded.name}: linear critical speed {speed * KMH:.2f} km/h, {critical.frequency[0]:.3f} Hz, {critical.names[0]}",
        *described,
        *([loaded.note] if loaded.note else []),
        *[f"calibrated, not predicted: {entry}" for entry in fitted],
    ]
    marks = {} if stable else {"linear critical speed": speed * KMH}
    marks |= {"nonlinear": found["nonlinear_kmh"]} if nonlinear else {}
    drawn = as_picture(lambda axes: _damping(axes[0, 0], loaded, (1.0 if stable else 1.1) * speed * KMH, marks), height=4.4)
    show(content, lines, as_json, out, drawn)


def _damping(axes: Any, vehicle: Any, highest_kmh: float, marks: dict[str, float]) -> None:
    """Damping ratio of the modes up to a speed, and speeds marked in it."""
    import numpy as np

    from ...base.units import KMH
    from ...stability.modes import root_locus

    root_locus(vehicle, np.linspace(0.2, 1.0, 45) * highest_kmh / KMH).plot(axes, marks=marks)
