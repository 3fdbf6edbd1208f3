"""`railjax comfort`: ride comfort of a record or of a vehicle simulated over a track, on the command line."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .cli_common import (
    TRACKS,
    Alpha,
    AsJson,
    DamperName,
    TrackSeed,
    calibrated,
    complete_track,
    complete_vehicle,
    finite,
    load,
    prepare,
    show,
    working,
)
from .cli_inputs import make_damper, make_track
from .cli_out import PICTURES, as_picture, check_out, out_option
from .errors import InputError, NumericalError

if TYPE_CHECKING:
    from .track import Track

#: by these names a column is found without being told
NAMES = {
    "time": ("time", "t"),
    "lateral": ("lateral", "ay", "a_y", "y", "lateral acceleration"),
    "vertical": ("vertical", "az", "a_z", "z", "vertical acceleration"),
    "longitudinal": ("longitudinal", "ax", "a_x", "x", "longitudinal acceleration"),
}
ACCELERATIONS = {"m/s2": 1.0, "m/s^2": 1.0, "m/s²": 1.0, "g": 9.80665, "mg": 9.80665e-3}
UNITS = {"time": {"s": 1.0, "ms": 1e-3}} | dict.fromkeys(("lateral", "vertical", "longitudinal"), ACCELERATIONS)

#: samples of a simulation each second: N_MV's band to 40 Hz five times over
SAMPLE, SETTLE = 5e-3, 5.0


def comfort(
    source: Annotated[
        str,
        typer.Argument(metavar="FILE.csv|VEHICLE", help="A record, or a vehicle to simulate.", autocompletion=complete_vehicle),
    ],
    fs: Annotated[
        float | None, typer.Option("--fs", "--fs-hz", help="Sampling rate of the record in Hz (default: from its time column).")
    ] = None,
    columns: Annotated[
        str | None, typer.Option(help="Columns of the record, as 'lateral=Ay,vertical=Az' (also longitudinal, time).")
    ] = None,
    unit: Annotated[str | None, typer.Option(help="Unit of the accelerations: g or m/s2 (default: from the header).")] = None,
    speed_kmh: Annotated[float, typer.Option(help="Speed of the vehicle in km/h.")] = 180.0,
    track: Annotated[
        str | None,
        typer.Option(
            help=f"Its track, {TRACKS} (erri-high if nothing else is given); or a measured one, a .csv file.",
            autocompletion=complete_track,
        ),
    ] = None,
    track_seed: TrackSeed = None,
    amplitude_mm: Annotated[float | None, typer.Option(help="Instead: amplitude of a sinusoidal alignment in mm.")] = None,
    wavelength_m: Annotated[float | None, typer.Option(help="Its wavelength in m; 20 if not given.")] = None,
    duration_s: Annotated[float, typer.Option(help="Duration in s, after 5 s of settling.")] = 300.0,
    dt_s: Annotated[float, typer.Option(help="Step of RK4 in s.")] = 1e-3,
    damper: DamperName = "passive",
    alpha: Alpha = None,
    mean_comfort: Annotated[bool, typer.Option(help="N_MV as well, which needs 100 s.")] = True,
    sperling_exponent: Annotated[float, typer.Option(help="Sperling's exponent: 1/6.67, or 0.15.")] = 1.0 / 6.67,
    sperling_power: Annotated[float, typer.Option(help="Power by which its bands add: 6.67, or 10.")] = 6.67,
    out: Annotated[Path | None, out_option("the result, drawn or whole,", *PICTURES)] = None,
    as_json: AsJson = False,
) -> None:
    """Ride comfort: EN 12299 (mean and continuous comfort), ISO 2631-1 (r.m.s., MTVV, VDV), Sperling.

    Example: railjax comfort ride.csv --fs 200 --columns lateral=Ay --unit g

    Example: railjax comfort coach --speed-kmh 200 --track erri-high
    """
    finite(fs=fs, speed_kmh=speed_kmh, wavelength_m=wavelength_m, duration_s=duration_s, dt_s=dt_s)
    finite(sperling_exponent=sperling_exponent, sperling_power=sperling_power)
    finite(positive=False, amplitude_mm=amplitude_mm, alpha=alpha)
    check_out(out, *PICTURES)
    from . import MeasuredTrack
    from .comfort import comfort as judge
    from .deflections import CARBODY_TO_FLOOR
    from .units import KMH

    prepare()
    options = {"mean": mean_comfort, "sperling_exponent": sperling_exponent, "sperling_power": sperling_power}
    if source.lower().endswith(".csv"):
        records, rate, notes = _read(Path(source), fs, columns, unit)
        found, content = judge(records, rate, **options), {"file": source}
    else:
        if fs is not None or columns is not None or unit is not None:
            raise InputError(f"--fs, --columns and --unit are for a record (FILE.csv), not for the vehicle {source!r}")
        loaded = load(source)
        if amplitude_mm is None and wavelength_m is None:
            track = track or "erri-high"
        # long enough that no part of it is ridden twice
        length = speed_kmh / KMH * (duration_s + SETTLE) + 200.0
        road, assumed = make_track(track, track_seed, amplitude_mm, wavelength_m, None, length)
        if isinstance(road, MeasuredTrack) and road.length < length - 200.0:
            longest = max(road.length / speed_kmh * KMH - SETTLE, 0.0)
            raise InputError(
                f"--track {track}: {road.length:.0f} m are too short for this ride; --duration-s {longest:.0f} at most"
            )
        with working(f"running {duration_s + SETTLE:g} s of {loaded.name}"):
            run = _simulated(loaded, speed_kmh, road, duration_s, dt_s, damper, alpha)
        found = judge(run, settle=SETTLE, **options)
        notes = [*assumed, *(f"fitted: {entry}" for entry in calibrated(loaded))]
        if loaded.geometry.carbody_to_floor is None:
            notes.append(f"floor: {CARBODY_TO_FLOOR:g} m below the car body's centre of gravity (assumed)")
        content = {"vehicle": loaded.name, "speed_kmh": speed_kmh, "damper": damper}
    content |= found.as_dict()
    content["notes"] = [*content["notes"], *notes]
    drawn = as_picture(lambda axes: found.plot(axes[0, 0], axes[1, 0]), rows=2, height=2.9)
    show(content, [str(found), *(f"  note: {note}" for note in notes)], as_json, out, drawn)


def _read(path: Path, fs: float | None, columns: str | None, unit: str | None) -> tuple[dict[str, Any], float, list[str]]:
    """Accelerations by direction in m/s^2, the sampling rate, and what was assumed."""
    from .csv_columns import read_columns
    from .record import sampling_interval

    named: dict[str, str | None] = {}
    for part in (columns or "").split(","):
        kind, equals, name = (piece.strip() for piece in part.partition("="))
        if kind and (not equals or kind not in NAMES or not name):
            raise InputError(f"--columns {part.strip()!r}: write direction=name, with {', '.join(NAMES)} on the left")
        named |= {kind: name} if kind else {}
    if unit is not None and unit not in ACCELERATIONS:
        raise InputError(f"--unit must be one of {', '.join(ACCELERATIONS)}, not {unit!r}")
    # named accelerations are the only ones
    wanted = [kind for kind in NAMES if kind == "time" or kind in named or not set(named) - {"time"}]
    found, notes = read_columns(
        path,
        {kind: NAMES[kind] for kind in wanted},
        UNITS,
        columns=named,
        given={kind: unit for kind in wanted if kind != "time"},
        purpose="judge comfort",
        options=("--columns {}=", "--unit"),
    )
    rate = 1.0 / sampling_interval(found.pop("time", None), fs, path, "--fs")
    if not found:
        raise InputError(f"{path}: no column of an acceleration; name it, as in --columns lateral=NAME")
    return found, rate, notes


def _simulated(vehicle: Any, speed_kmh: float, track: "Track", duration_s: float, dt_s: float, damper: str, alpha: Any) -> Any:
    from . import Result, simulate
    from .units import KMH

    law = make_damper(damper, vehicle, speed_kmh / KMH, alpha)
    run = simulate(
        vehicle,
        speed_kmh / KMH,
        track=track,
        damper=law,
        duration=duration_s + SETTLE,
        dt=dt_s,
        sample=SAMPLE,
        record=["floor_acceleration"],
    )
    if int(run.code) == Result.DIVERGED:
        raise NumericalError(f"the run diverged at {speed_kmh:g} km/h: a displacement went beyond 1 m or 1 rad")
    return run
