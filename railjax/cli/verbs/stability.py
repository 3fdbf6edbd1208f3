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
    content = {
        "vehicle": vehicle,
        "speed_kmh": speed_kmh,
        "modes": [
            {
                "name": name,
                "frequency_hz": float(f),
                "damping_ratio": float(z),
                "growth_per_s": float(value.real),
                "condition": float(c),
            }
            for name, f, z, value, c in zip(
                found.names,
                found.frequency,
                found.damping_ratio,
                found.eigenvalues,
                found.condition,
                strict=True,
            )
        ],
    }
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
    found, described = _nonlinear(loaded) if nonlinear else ({}, [])
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


def _nonlinear(vehicle: Any) -> tuple[dict[str, Any], list[str]]:
    """Keys and lines of the nonlinear critical speed; without a fold it is the linear one, and amplitude and frequency null."""
    from math import isfinite

    from ...base.units import KMH
    from ...stability.hunting.nonlinear_critical import Hunting, default_wheelset, nonlinear_critical, refuse

    with working(f"fold of the limit cycles of {vehicle.name}"):
        found = nonlinear_critical(vehicle)
    refuse(found.code)
    folded = int(found.code) == Hunting.OK
    content = {
        "nonlinear_kmh": float(found.speed) * KMH,
        "fold_amplitude_mm": float(found.amplitude) * 1e3 if folded else None,
        "fold_frequency_hz": float(found.frequency) if folded else None,
        "criticality": ("subcritical" if isfinite(found.linear.speed) else "isolated") if folded else "supercritical",
    }
    if not folded:
        return content, [
            "no fold: limit cycles leave the linear critical speed upwards (supercritical), so it is the nonlinear one"
        ]
    place = f"wheelset {default_wheelset(vehicle, None) + 1} from the front"
    return content, [
        f"nonlinear critical speed {content['nonlinear_kmh']:.2f} km/h: fold of the limit cycles at "
        f"{content['fold_amplitude_mm']:.3f} mm ({place}), {content['fold_frequency_hz']:.3f} Hz"
    ]
