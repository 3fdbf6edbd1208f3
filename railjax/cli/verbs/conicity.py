"""`railjax conicity`: equivalent conicity of a wheel on a rail, and their contact geometry, on the command line."""

from pathlib import Path
from typing import Annotated, Any

import typer

from ...base.errors import InputError
from ..common import AsJson, completing, finite, show, working
from ..out import PICTURES, TABLE, as_table, check_out, out_option


def _wheels() -> list[str]:
    from ...model.contact.profiles import WHEELS

    return list(WHEELS)


def _rails() -> list[str]:
    from ...model.contact.profile_shapes import RAIL_HEADS

    return list(RAIL_HEADS)


def conicity(
    wheel: Annotated[
        str, typer.Argument(metavar="WHEEL", help="S1002, a file of points or a .prw.", autocompletion=completing(_wheels))
    ],
    rail: Annotated[
        str,
        typer.Argument(
            metavar="RAIL", help="60E1, 60E2, UIC60-Manchester, a file of points or a .prr.", autocompletion=completing(_rails)
        ),
    ],
    gauge_mm: Annotated[float, typer.Option(help="Gauge, 14 mm below the tops of the rails, in mm.")] = 1435.0,
    inclination: Annotated[
        float, typer.Option(help="40 for rails inclined 1:40; 0 for profiles as they lie in the track.")
    ] = 40.0,
    flange_back_mm: Annotated[float, typer.Option(help="Between the backs of the flanges in mm.")] = 1360.0,
    tread_datum_mm: Annotated[float, typer.Option(help="From the back of a flange to the tread datum in mm.")] = 70.0,
    radius_mm: Annotated[float, typer.Option(help="Rolling radius in mm.")] = 460.0,
    left_radius_mm: Annotated[float | None, typer.Option(help="That of the left wheel in mm, where they differ.")] = None,
    left_wheel: Annotated[str | None, typer.Option(help="Profile of the left wheel, where they differ.")] = None,
    left_rail: Annotated[str | None, typer.Option(help="Profile of the left rail, where they differ.")] = None,
    smoothing_mm: Annotated[
        float | None, typer.Option(help="Length in mm of the waves that are halved in points; 2 for tables, 0 for .prw, .prr.")
    ] = None,
    out: Annotated[
        Path | None, out_option("the conicity over amplitude, or the contact geometry drawn,", TABLE, *PICTURES)
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Equivalent conicity over amplitude (EN 15302) of a pair of profiles, with jumps of the contact and the nonlinearity parameter.

    Example: railjax conicity S1002 60E1 --gauge-mm 1435 --out conicity.png

    Example: railjax conicity wheel.csv rail.prr --inclination 0 --json
    """
    import numpy as np

    from ...model.contact.conicity import equivalent_conicity, nonlinearity_parameter
    from ...model.contact.geometry import contact_geometry
    from ...model.contact.profile_plots import AMPLITUDES
    from ...model.contact.profiles import RailProfile, WheelProfile

    finite(
        gauge_mm=gauge_mm,
        flange_back_mm=flange_back_mm,
        tread_datum_mm=tread_datum_mm,
        radius_mm=radius_mm,
        left_radius_mm=left_radius_mm,
    )
    finite(False, inclination=inclination, smoothing_mm=smoothing_mm)
    if inclination and abs(inclination) < 5.0:
        raise InputError(f"--inclination {inclination:g} is 1:{inclination:g}; write 40 for 1:40, and 0 for none")
    check_out(out, TABLE, *PICTURES)
    smoothing = None if smoothing_mm is None else smoothing_mm / 1e3
    wheels = tuple(WheelProfile.load(one, smoothing=smoothing) for one in (wheel, left_wheel or wheel))
    rails = tuple(RailProfile.load(one, smoothing=smoothing) for one in (rail, left_rail or rail))
    with working(f"contact of {wheel} on {rail}"):
        found = contact_geometry(
            wheels,
            rails,
            gauge=gauge_mm / 1e3,
            flange_back=flange_back_mm / 1e3,
            tread_datum=tread_datum_mm / 1e3,
            radius=(radius_mm / 1e3, (left_radius_mm or radius_mm) / 1e3),
            inclination=1.0 / inclination if inclination else 0.0,
        )
    y, delta_r = np.asarray(found.y), np.asarray(found.delta_r)
    values = equivalent_conicity(y, delta_r, AMPLITUDES)
    nonlinearity = float(nonlinearity_parameter(y, delta_r)) / 1e3
    content: dict[str, Any] = {
        "wheel": wheel,
        "rail": rail,
        "gauge_mm": gauge_mm,
        "inclination": inclination,
        "amplitude_mm": (1e3 * AMPLITUDES).round(6).tolist(),
        "tan_gamma_e": values.tolist(),
        "tan_gamma_e_3mm": float(equivalent_conicity(y, delta_r, 3e-3)),
        "nonlinearity_per_mm": nonlinearity,
        "y_mm": (1e3 * y).round(6).tolist(),
        "delta_r_mm": (1e3 * delta_r).tolist(),
        "jumps_mm": (1e3 * found.jumps).tolist(),
        "jump_sizes_mm": (1e3 * found.jump_sizes).tolist(),
        "notes": list(dict.fromkeys(f"{one.name}: {note}" for one in (*wheels, *rails) for note in one.notes)),
    }
    trend = "stays" if abs(nonlinearity) < 1e-6 else "falls" if nonlinearity < 0.0 else "rises"
    lines = [
        str(found),
        f"nonlinearity parameter {nonlinearity:+.4f} 1/mm: the conicity {trend} from 2 to 4 mm"
        if np.isfinite(nonlinearity)
        else "no nonlinearity parameter: the wheelset has no free wave of 2 and of 4 mm",
        *content["notes"],
    ]
    rows = [{"amplitude_mm": a, "tan_gamma_e": v} for a, v in zip(content["amplitude_mm"], content["tan_gamma_e"], strict=True)]
    show(content, lines, as_json, out, as_table(rows) | dict.fromkeys(PICTURES, lambda path: found.plot().savefig(path)))
