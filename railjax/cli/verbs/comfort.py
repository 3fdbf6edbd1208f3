"""`railjax comfort`: ride comfort of a record or of a vehicle simulated over a track, on the command line."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ...base.errors import InputError, NumericalError
from ..common import (
    OTHER_TRACKS,
    TRACKS,
    Alpha,
    AsJson,
    DamperName,
    LayoutFile,
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
from ..files import (
    BridgeM,
    BridgeS,
    ChordM,
    Columns,
    LongestM,
    ShortestM,
    TimeUnit,
    Units,
    named,
    track_file,
    units_of,
)
from ..inputs import chosen_damper, make_track, upon_layout
from ..out import PICTURES, as_picture, check_out, out_option

if TYPE_CHECKING:
    from ...model.track.shapes import Track

#: samples of a simulation each second: N_MV's band to 40 Hz five times over
SAMPLE, SETTLE = 5e-3, 5.0


def comfort(
    source: Annotated[
        str,
        typer.Argument(metavar="FILE|VEHICLE", help="A record, or a vehicle to simulate.", autocompletion=complete_vehicle),
    ],
    fs: Annotated[
        float | None,
        typer.Option("--fs", "--fs-hz", help="Sampling rate of the record in Hz; it has the last word over its time."),
    ] = None,
    columns: Columns = None,
    unit: Units = None,
    time_unit: TimeUnit = None,
    bridge_s: BridgeS = None,
    weighting: Annotated[
        list[str] | None, typer.Option(help="Another weighting than EN 12299's, as vertical=Wk (ISO 2631-1); may be repeated.")
    ] = None,
    transition: Annotated[
        list[str] | None, typer.Option(help="A transition curve of the record for P_CT: start,end in s; may be repeated.")
    ] = None,
    speed_kmh: Annotated[float, typer.Option(help="Speed of the vehicle in km/h.")] = 180.0,
    track: Annotated[
        str | None,
        typer.Option(
            help=f"Its track, {TRACKS} (erri-high if nothing else is given); or {OTHER_TRACKS}.",
            autocompletion=complete_track,
        ),
    ] = None,
    layout: LayoutFile = None,
    track_seed: TrackSeed = None,
    chord_m: ChordM = None,
    longest_m: LongestM = None,
    shortest_m: ShortestM = None,
    bridge_m: BridgeM = None,
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
    """Ride comfort: EN 12299 (N_MV, N_VA, N_VD, C_C, P_DE, P_CT), ISO 2631-1 (r.m.s., a_v, MTVV, VDV), Sperling.

    A record may be separated by commas, semicolons, tabs or blanks, with decimal commas, comments, a row of units, or no header.

    Example: railjax comfort ride.csv --fs 200 --columns lateral=Ay --unit g

    Example: railjax comfort phone.txt --columns lateral=gFx,vertical=gFz --weighting vertical=Wk

    Example: railjax comfort coach --speed-kmh 200 --track erri-high

    With --layout the vehicle runs over that line, even unless an irregularity is given, and P_CT of each transition in the run is formed.

    Example: railjax comfort coach --speed-kmh 90 --layout curve.toml --track erri-low --duration-s 30 --no-mean-comfort
    """
    finite(fs=fs, speed_kmh=speed_kmh, wavelength_m=wavelength_m, duration_s=duration_s, dt_s=dt_s)
    finite(sperling_exponent=sperling_exponent, sperling_power=sperling_power)
    finite(positive=False, amplitude_mm=amplitude_mm, alpha=alpha, bridge_s=bridge_s)
    check_out(out, *PICTURES)
    from ... import MeasuredTrack
    from ...base.text_table import is_table
    from ...base.units import KMH
    from ...model.kinematics import CARBODY_TO_FLOOR, is_one_stage
    from ...ride.comfort import comfort as judge

    prepare()
    options: dict[str, Any] = {"mean": mean_comfort, "sperling_exponent": sperling_exponent, "sperling_power": sperling_power}
    options["weightings"] = _weightings(weighting)
    content: dict[str, Any]
    if is_table(source):
        from ...base.stamps import BRIDGE
        from ...ride.rides import ACCELERATIONS, NAMES, read_ride

        for option, given in (
            ("track", track),
            ("layout", layout),
            ("chord-m", chord_m),
            ("longest-m", longest_m),
            ("bridge-m", bridge_m),
        ):
            if given is not None:
                raise InputError(f"--{option} is for a vehicle on a track, not for the record {source}")
        ride = read_ride(
            source,
            columns=named("--columns", [columns or ""], NAMES),
            units=units_of(unit, NAMES, time_unit, ACCELERATIONS),
            sample_rate=fs,
            bridge=BRIDGE if bridge_s is None else bridge_s,
        )
        found, content = judge(ride.values, ride.rate, transitions=_transitions(transition), **options), {"file": source}
        notes = list(ride.notes)
    else:
        if fs is not None or time_unit is not None or transition or bridge_s is not None:
            raise InputError(
                f"--fs, --time-unit, --bridge-s and --transition are for a record (a file), not for the vehicle {source!r}"
            )
        loaded = load(source)
        if amplitude_mm is None and wavelength_m is None and layout is None:
            track = track or "erri-high"
        # long enough that no part of it is ridden twice
        length = speed_kmh / KMH * (duration_s + SETTLE) + 200.0
        how = track_file(track, columns, unit, chord_m, longest_m, shortest_m, bridge_m)
        road, assumed = make_track(track, track_seed, amplitude_mm, wavelength_m, None, length, how)
        if isinstance(road, MeasuredTrack) and road.length < length - 200.0:
            longest = max(road.length / speed_kmh * KMH - SETTLE, 0.0)
            raise InputError(
                f"--track {track}: {road.length:.0f} m are too short for this ride; --duration-s {longest:.0f} at most"
            )
        line = None
        if layout is not None:
            road, assumed = upon_layout(layout, road, assumed, track, amplitude_mm, wavelength_m)
            line = road
        with working(f"running {duration_s + SETTLE:g} s of {loaded.name}"):
            run = _simulated(loaded, speed_kmh, road, duration_s, dt_s, damper, alpha)
        found = judge(run, settle=SETTLE, layout=line, **options)
        notes = [*assumed, *(f"fitted: {entry}" for entry in calibrated(loaded))]
        if loaded.geometry.carbody_to_floor is None:
            notes.append(f"floor: {CARBODY_TO_FLOOR:g} m below the car body's centre of gravity (assumed)")
        if is_one_stage(loaded):
            notes.append("floor: of the only body, over its outer axles (here called bogies) and in the centre")
        content = {"vehicle": loaded.name, "speed_kmh": speed_kmh, "damper": damper}
    content |= found.as_dict()
    content["notes"] = [*content["notes"], *notes]
    drawn = as_picture(lambda axes: found.plot(axes[0, 0], axes[1, 0]), rows=2, height=2.9)
    show(content, [str(found), *(f"  note: {note}" for note in notes)], as_json, out, drawn)


def _weightings(texts: list[str] | None) -> dict[str, str | None] | None:
    from ...ride.comfort_result import DIRECTIONS
    from ...ride.weightings import WEIGHTINGS

    found = named("--weighting", texts or (), DIRECTIONS)
    for direction, name in found.items():
        if name not in WEIGHTINGS:
            raise InputError(f"--weighting {direction}={name}: {name} is none of {', '.join(WEIGHTINGS)}")
    return found or None


def _transitions(texts: list[str] | None) -> list[tuple[float, float]]:
    found = []
    for text in texts or ():
        try:
            start, end = map(float, text.split(","))
        except ValueError:
            raise InputError(f"--transition {text!r}: write its start and end in s, as 12.5,17") from None
        found.append((start, end))
    return found


def _simulated(vehicle: Any, speed_kmh: float, track: "Track", duration_s: float, dt_s: float, damper: str, alpha: Any) -> Any:
    from ... import Layout, Result, simulate
    from ...base.units import KMH

    law = chosen_damper(damper, vehicle, speed_kmh / KMH, alpha)
    run = simulate(
        vehicle,
        speed_kmh / KMH,
        track=track,
        damper=law,
        duration=duration_s + SETTLE,
        dt=dt_s,
        sample=SAMPLE,
        record=["floor_acceleration", *(["carbody_phi", "carbody_phi_rate"] if isinstance(track, Layout) else [])],
    )
    if int(run.code) == Result.DIVERGED:
        raise NumericalError(f"the run diverged at {speed_kmh:g} km/h: a displacement went beyond 1 m or 1 rad")
    return run
