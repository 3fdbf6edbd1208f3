"""`railjax acceptance`: running safety and ride on a random track on the command line."""

import math
from typing import Annotated, Any

import typer

from ...base.errors import InputError, NumericalError
from ...dampers.named import DESIGNED
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
from ..files import BridgeM, BridgeS, ChordM, Columns, LongestM, ShortestM, TimeUnit, Units, named, track_file, units_of
from ..inputs import chosen_damper, load_layout, make_track
from ..out import OutJson, check_out


def acceptance(
    vehicle: Annotated[
        str,
        typer.Argument(
            metavar="FILE|VEHICLE",
            help="The record of a running test, or a vehicle to simulate.",
            autocompletion=complete_vehicle,
        ),
    ],
    speed_kmh: Annotated[list[float], typer.Option(help="Speed in km/h; may be repeated.")] = [200.0],  # noqa: B006
    track: Annotated[
        str | None,
        typer.Option(
            help=f"A random track, {TRACKS} (erri-high if not given); or {OTHER_TRACKS}.",
            autocompletion=complete_track,
        ),
    ] = None,
    track_seed: TrackSeed = None,
    columns: Columns = None,
    unit: Units = None,
    time_unit: TimeUnit = None,
    fs: Annotated[float | None, typer.Option("--fs", "--fs-hz", help="Sampling rate of the record in Hz.")] = None,
    bridge_s: BridgeS = None,
    axle_load_n: Annotated[
        float | None, typer.Option(help="Axle load P of the record's vehicle in N, for guiding forces.")
    ] = None,
    bogie_mass_t: Annotated[float | None, typer.Option(help="Bogie mass M with wheelsets in t, for bogie accelerations.")] = None,
    chord_m: ChordM = None,
    longest_m: LongestM = None,
    shortest_m: ShortestM = None,
    bridge_m: BridgeM = None,
    layout: LayoutFile = None,
    length_m: Annotated[
        float | None,
        typer.Option(help="Length of the run in m (default: 25 sections and the margins; all of a measured track or a layout)."),
    ] = None,
    section_m: Annotated[
        float | None, typer.Option(help="Length of a section in m (default: 250 up to 220 km/h, 500 beyond).")
    ] = None,
    damper: DamperName = "passive",
    alpha: Alpha = None,
    prudhomme_factor: Annotated[float, typer.Option(help="α of the limit α (10 kN + P/3); 0.85 for wagons.")] = 1.0,
    hunting_frequency_hz: Annotated[float | None, typer.Option(help="f0 in Hz (default: from the spectrum of SumY).")] = None,
    dt_s: Annotated[float, typer.Option(help="Step of RK4 in s.")] = 1e-3,
    out: OutJson = None,
    as_json: AsJson = False,
) -> None:
    """Running safety, ride and stability in the manner of UIC 518 / EN 14363, as far as lateral dynamics gives them.

    A record has columns like 'time (s),guiding force 1 (kN),bogie 1 (m/s2),carbody 1 (m/s2)', numbered from the front.

    With --layout the sections are cut out of its straights and arcs, by the test zones 1 to 4 of EN 14363.

    Exit status 0 also where a limit is exceeded: that is a result.

    Example: railjax acceptance coach --speed-kmh 160 --speed-kmh 200 --track erri-high

    Example: railjax acceptance coach-s1002 --layout line.toml --track erri-low --speed-kmh 90
    """
    import jax.numpy as jnp

    from ... import MeasuredTrack, simulate
    from ...base.text_table import is_table
    from ...base.units import KMH
    from ...ride.acceptance.assess import MARGIN, acceptance_of_record, default_section
    from ...ride.acceptance.assess import acceptance as assess
    from ...ride.acceptance.criteria import SAMPLING, SECTIONS, SHORTEST
    from ...ride.acceptance.record import acceptance_channels
    from ...ride.acceptance.zones import zone_acceptance
    from ...ride.rides import ACCELERATIONS, TEST_NAMES, read_running_record

    for speed in speed_kmh:
        finite(speed_kmh=speed)
    finite(length_m=length_m, section_m=section_m, prudhomme_factor=prudhomme_factor, dt_s=dt_s)
    finite(hunting_frequency_hz=hunting_frequency_hz)
    finite(positive=False, alpha=alpha, bridge_s=bridge_s)
    finite(fs=fs, axle_load_n=axle_load_n, bogie_mass_t=bogie_mass_t)
    check_out(out)
    if is_table(vehicle):
        if len(speed_kmh) > 1 or track is not None or layout is not None:
            raise InputError(f"{vehicle} is the record of one run: give one --speed-kmh, no --track and no --layout")
        prepare()
        read = {"sample_rate": fs, **({} if bridge_s is None else {"bridge": bridge_s})}
        record, notes = read_running_record(
            vehicle,
            speed_kmh[0] / KMH,
            columns=named("--columns", [columns or ""], TEST_NAMES),
            units=units_of(unit, TEST_NAMES, time_unit, ACCELERATIONS),
            **read,
        )
        found = acceptance_of_record(
            record,
            axle_load=None if axle_load_n is None else axle_load_n,
            bogie_mass=None if bogie_mass_t is None else 1e3 * bogie_mass_t,
            prudhomme_factor=prudhomme_factor,
            section_length=section_m,
            hunting_frequency=hunting_frequency_hz,
        )
        show(
            {**found.as_dict(), "file": vehicle, "read": list(notes)},
            [str(found), *[f"note: {note}" for note in notes]],
            as_json,
            out,
        )
        return
    for option, value in (("fs", fs), ("time-unit", time_unit), ("axle-load-n", axle_load_n), ("bogie-mass-t", bogie_mass_t)):
        if value is not None:
            raise InputError(f"--{option} is for the record of a test (a file), not for the vehicle {vehicle!r}")
    track = track or "erri-high"
    how = track_file(track, columns, unit, chord_m, longest_m, shortest_m, bridge_m)
    every = math.floor(1.0 / (SAMPLING * dt_s) + 1e-9)
    if every < 1:
        raise InputError(f"--dt-s must be {1.0 / SAMPLING:g} or less, for a sampling rate of {SAMPLING:g} Hz")
    if damper in DESIGNED and len(speed_kmh) > 1:
        raise InputError(f"--damper {damper} is designed for one speed; give --speed-kmh once")
    loaded = load(vehicle)
    speeds = [speed / KMH for speed in speed_kmh]
    law = chosen_damper(damper, loaded, speeds[0], alpha)
    if section_m is not None and section_m < SHORTEST:
        raise InputError(f"--section-m must be {SHORTEST:g} or more, not {section_m:g}")
    sections = [section_m or float(default_section(speed)) for speed in speeds]
    ends = [2.0 * MARGIN * speed for speed in speeds]
    line, laid = None, None
    if layout is not None:
        for option, value in (("section-m", section_m), ("hunting-frequency-hz", hunting_frequency_hz)):
            if value is not None:
                raise InputError(f"--{option} is for straight track: on a --layout zones have sections of their own")
        laid, sections = load_layout(layout), [0.0]
        length_m = length_m or float(laid.knots[-1])
    if is_table(track) and isinstance(read_line := make_track(track, track_seed, file=how)[0], MeasuredTrack):
        line = read_line
        # beyond its end the track is straight, which would pass as smooth
        whole = float(line.label.distance[-1] - line.label.distance[0])
        if len(speeds) > 1 or (length_m or 0.0) > whole:
            raise InputError(f"--track {track} is {whole:g} m long: give a --length-m within it and one --speed-kmh")
        length_m = length_m or whole
    if length_m is None:
        # a metre more, so that rounding leaves all sections whole
        length_m = max(SECTIONS * section + end for section, end in zip(sections, ends, strict=True)) + 1.0
    shortest = max(sections) + max(ends)
    if length_m < shortest:
        raise InputError(f"--length-m {length_m:g} does not hold a section and the margins; give {math.ceil(shortest)} or more")
    samples = math.ceil(length_m / (min(speeds) * every * dt_s))
    if line is None:
        line, _ = make_track(track, track_seed, length=max(1000.0, 100.0 + samples * every * dt_s * max(speeds)), file=how)  # type: ignore[assignment]
    with working(f"running {samples * every * dt_s:.0f} s of {loaded.name}"):
        run = simulate(
            loaded,
            speeds[0] if len(speeds) == 1 else jnp.asarray(speeds),
            track=line,
            damper=law,
            duration=samples * every * dt_s,
            dt=dt_s,
            sample=every * dt_s,
            layout=laid,
            record=acceptance_channels(loaded, curves=laid is not None),
        )
        run.code.block_until_ready()
    if not bool(run.ok.any()):
        raise NumericalError(f"the run diverged at {min(speed_kmh):g} km/h: a displacement went beyond 1 m or 1 rad")
    judged: Any = (
        assess(loaded, run, prudhomme_factor=prudhomme_factor, section_length=section_m, hunting_frequency=hunting_frequency_hz)
        if laid is None
        else zone_acceptance(loaded, run, laid, prudhomme_factor=prudhomme_factor)
    )
    content = {**judged.as_dict(), "track": str(line).splitlines()[0], "damper": damper, "calibrated": calibrated(loaded)}
    if laid is not None:
        content["layout"] = str(laid)
    place = f"track: {content['track']}; damper: {damper}"
    show(content, [str(judged), place, *[f"calibrated, not predicted: {entry}" for entry in content["calibrated"]]], as_json, out)
