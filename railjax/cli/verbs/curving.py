"""`railjax curving`: steady running in an arc, on the command line."""

from pathlib import Path
from typing import Annotated, Any

import typer

from ...base.errors import InputError, NumericalError
from ..common import Alpha, AsJson, DamperName, VehicleName, calibrated, finite, load, show, working
from ..inputs import chosen_damper
from ..out import PICTURES, TABLE, as_table, check_out, out_option


def curving(
    vehicle: VehicleName,
    radius_m: Annotated[float, typer.Option(help="Radius in m; negative for a left-hand curve.")],
    speed_kmh: Annotated[
        float | None, typer.Option(help="Speed in km/h; left out: that of both cant and cant deficiency.")
    ] = None,
    cant_mm: Annotated[float | None, typer.Option(help="Cant in mm over 1500 mm; 0 if not given.")] = None,
    cant_deficiency_mm: Annotated[
        float | None, typer.Option(help="Instead of the cant (or of the speed): cant deficiency in mm.")
    ] = None,
    friction: Annotated[float | None, typer.Option(help="Coefficient of friction instead of the vehicle's own.")] = None,
    damper: DamperName = "passive",
    alpha: Alpha = None,
    out: Annotated[Path | None, out_option("the wheelsets, or a drawing of them in the curve,", TABLE, *PICTURES)] = None,
    as_json: AsJson = False,
) -> None:
    """Steady running in a curve: displacements, angles of attack, guiding forces, loads and wear of the wheels.

    Example: railjax curving coach --radius-m 500 --cant-mm 100 --speed-kmh 90

    Example: railjax curving coach --radius-m 500 --cant-mm 150 --cant-deficiency-mm 130 --out curve.png
    """
    from ... import curving as compute
    from ... import replace
    from ...base.units import KMH
    from ...stability.curving.result import Equilibrium

    finite(speed_kmh=speed_kmh, friction=friction)
    finite(False, cant_mm=cant_mm, cant_deficiency_mm=cant_deficiency_mm, radius_m=radius_m)
    check_out(out, TABLE, *PICTURES)
    speed, cant = _speed_and_cant(radius_m, speed_kmh, cant_mm, cant_deficiency_mm)
    loaded = load(vehicle)
    if friction is not None:
        loaded = replace(loaded, contact__friction=friction)
    law = chosen_damper(damper, loaded, speed, alpha)
    with working(f"{loaded.name} in a curve of {abs(radius_m):g} m"):
        found = compute(loaded, speed, radius=radius_m, cant=cant, damper=law)
        code = int(found.code)
    if code == Equilibrium.FAILED:
        raise NumericalError(
            f"no equilibrium found at {speed * KMH:.0f} km/h, cant deficiency {1e3 * float(found.cant_deficiency):.0f} mm"
        )
    fitted = calibrated(loaded)
    content = {"vehicle": vehicle, "damper": damper, **found.as_dict(), "calibrated": fitted}
    lines = [str(found), *(f"calibrated, not predicted: {entry}" for entry in fitted)]
    forms = as_table(_rows(content)) | dict.fromkeys(PICTURES, lambda path: found.plot().savefig(path))
    show(content, lines, as_json, out, forms)


def _speed_and_cant(
    radius_m: float, speed_kmh: float | None, cant_mm: float | None, cant_deficiency_mm: float | None
) -> tuple[float, float]:
    """m/s and m, out of two of the three options."""
    from ...base.units import KMH
    from ...model.track.curve import cant_in_balance

    if radius_m == 0.0:
        raise InputError("--radius-m must not be 0")
    per_square = 1e3 * cant_in_balance(1.0, radius_m)  # mm of cant in balance per (m/s)²
    if speed_kmh is None:
        if cant_deficiency_mm is None:
            raise InputError("give --speed-kmh, or --cant-deficiency-mm, from which the speed follows")
        balanced = (cant_mm or 0.0) + cant_deficiency_mm
        if balanced <= 0.0:
            raise InputError("--cant-mm and --cant-deficiency-mm must add up to more than 0, or there is no such speed")
        return (balanced / per_square) ** 0.5, 1e-3 * (cant_mm or 0.0)
    speed = speed_kmh / KMH
    if cant_deficiency_mm is None:
        return speed, 1e-3 * (cant_mm or 0.0)
    if cant_mm is not None:
        raise InputError("--speed-kmh, --cant-mm and --cant-deficiency-mm exclude each other: give two of them")
    return speed, 1e-3 * (speed**2 * per_square - cant_deficiency_mm)


def _rows(content: dict[str, Any]) -> list[dict[str, Any]]:
    """A row a wheel."""
    of_wheelset = ("wheelset_y_mm", "wheelset_yaw_mrad", "angle_of_attack_mrad", "sum_y_kN", "saturation")
    of_wheel = (
        "guiding_force_kN",
        "wheel_load_kN",
        "y_over_q",
        "longitudinal_creep_force_kN",
        "lateral_creep_force_kN",
        "wheel_wear_N",
    )
    return [
        {"wheelset": k + 1, "wheel": side}
        | {key: content[key][k] for key in of_wheelset}
        | {key: content[key][k][at] for key in of_wheel}
        for k in range(len(content["wheelset_y_mm"]))
        for at, side in enumerate(("left", "right"))
    ]
