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
    radius_m: Annotated[float | None, typer.Option(help="Also that in a curve of this radius in m.")] = None,
    cant_mm: Annotated[float | None, typer.Option(help="Cant of that curve in mm.")] = None,
    cant_deficiency_mm: Annotated[
        float | None,
        typer.Option(help="Instead of its cant: its cant deficiency in mm, at every speed; 100 if neither is given."),
    ] = None,
    out: Annotated[Path | None, out_option("the result, or the modes' damping over speed, drawn,", *PICTURES)] = None,
    as_json: AsJson = False,
) -> None:
    """Linear critical speed, where straight running loses stability; nonlinear, below which nothing makes the vehicle hunt.

    Example: railjax critical-speed coach --nonlinear --json

    Example: railjax critical-speed coach --radius-m 1000 --cant-deficiency-mm 130
    """
    from ...base.units import KMH
    from ...stability.hunting.nonlinear_critical import nonlinear_critical, refuse, told
    from ...stability.linear_critical import HIGHEST, Stability, linear_critical, linear_critical_speed
    from ...stability.modes import modes as compute

    finite(False, radius_m=radius_m, cant_mm=cant_mm, cant_deficiency_mm=cant_deficiency_mm)
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
    if radius_m is not None:
        in_curve, said = _in_curve(loaded, radius_m, cant_mm, cant_deficiency_mm)
        found, described = found | in_curve, [*described, said]
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


def _in_curve(
    vehicle: Any, radius_m: float, cant_mm: float | None, cant_deficiency_mm: float | None
) -> tuple[dict[str, Any], str]:
    """The linear critical speed in a curve, for JSON and in words."""
    from ...base.units import KMH
    from ...stability.curving.critical import curve_critical
    from ...stability.linear_critical import Stability

    if cant_mm is None and cant_deficiency_mm is None:
        cant_deficiency_mm = 100.0
    cant, deficiency = (None if value is None else 1e-3 * value for value in (cant_mm, cant_deficiency_mm))
    with working(f"critical speed of {vehicle.name} in a curve"):
        found = curve_critical(vehicle, radius=radius_m, cant=cant, cant_deficiency=deficiency)
        code = Stability(int(found.code))
    tilt = f"cant deficiency {cant_deficiency_mm:g} mm" if cant is None else f"cant {cant_mm:g} mm"
    where = f"in R {abs(radius_m):g} m, {tilt}"
    there = code in (Stability.OK, Stability.UNPROVED)
    content = {
        "curve_linear_kmh": float(found.speed) * KMH if there else None,
        "curve_frequency_hz": float(found.frequency) if there else None,
        "curve_result": code.name.lower(),
    }
    words = {
        Stability.STABLE: f"{where}: stable up to the highest speed at which it can run there",
        Stability.UNSTABLE: f"{where}: unstable at the lowest speed already",
        Stability.FAILED: f"{where}: no equilibrium at the lowest speed",
    }
    return content, words.get(
        code, f"{where}: linear critical speed {float(found.speed) * KMH:.2f} km/h, {float(found.frequency):.3f} Hz"
    )


def _damping(axes: Any, vehicle: Any, highest_kmh: float, marks: dict[str, float]) -> None:
    """Damping ratio of the modes up to a speed, and speeds marked in it."""
    import numpy as np

    from ...base.units import KMH
    from ...stability.modes import root_locus

    root_locus(vehicle, np.linspace(0.2, 1.0, 45) * highest_kmh / KMH).plot(axes, marks=marks)
