"""`railjax acceptance`: running safety and ride on a random track on the command line."""

import math
from typing import Annotated

import typer

from .cli_common import Alpha, AsJson, DamperName, TrackName, TrackSeed, VehicleName, calibrated, finite, load, show, working
from .cli_inputs import make_damper, make_track
from .cli_out import OutJson, check_out
from .errors import InputError, NumericalError


def acceptance(
    vehicle: VehicleName,
    speed_kmh: Annotated[list[float], typer.Option(help="Speed in km/h; may be repeated.")] = [200.0],  # noqa: B006
    track: TrackName = "erri-high",
    track_seed: TrackSeed = None,
    length_m: Annotated[
        float | None, typer.Option(help="Length of the run in m (default: 25 sections and the margins; all of a measured track).")
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

    Exit status 0 also where a limit is exceeded: that is a result.

    Example: railjax acceptance coach --speed-kmh 160 --speed-kmh 200 --track erri-high
    """
    import jax.numpy as jnp

    from . import simulate
    from .acceptance import MARGIN, default_section
    from .acceptance import acceptance as assess
    from .acceptance_criteria import SAMPLING, SECTIONS, SHORTEST
    from .acceptance_record import acceptance_channels
    from .units import KMH

    for speed in speed_kmh:
        finite(speed_kmh=speed)
    finite(length_m=length_m, section_m=section_m, prudhomme_factor=prudhomme_factor, dt_s=dt_s)
    finite(hunting_frequency_hz=hunting_frequency_hz)
    finite(positive=False, alpha=alpha)
    check_out(out)
    every = math.floor(1.0 / (SAMPLING * dt_s) + 1e-9)
    if every < 1:
        raise InputError(f"--dt-s must be {1.0 / SAMPLING:g} or less, for a sampling rate of {SAMPLING:g} Hz")
    if damper == "clipped-lqr" and len(speed_kmh) > 1:
        raise InputError("--damper clipped-lqr is designed for one speed; give --speed-kmh once")
    loaded = load(vehicle)
    speeds = [speed / KMH for speed in speed_kmh]
    law = make_damper(damper, loaded, speeds[0], alpha)
    if section_m is not None and section_m < SHORTEST:
        raise InputError(f"--section-m must be {SHORTEST:g} or more, not {section_m:g}")
    sections = [section_m or float(default_section(speed)) for speed in speeds]
    ends = [2.0 * MARGIN * speed for speed in speeds]
    line = None
    if track.lower().endswith(".csv"):
        line, _ = make_track(track, track_seed)
        # beyond its end the track is straight, which would pass as smooth
        whole = float(line.label.distance[-1] - line.label.distance[0])
        if len(speeds) > 1 or (length_m or 0.0) > whole:
            raise InputError(f"--track {track} is {whole:g} m long: give a --length-m within it and one --speed-kmh")
        length_m = length_m or whole
    if length_m is None:
        # a metre more, so that rounding leaves all sections whole
        length_m = max(SECTIONS * section + end for section, end in zip(sections, ends, strict=True)) + 1.0
    shortest = max(section + end for section, end in zip(sections, ends, strict=True))
    if length_m < shortest:
        raise InputError(f"--length-m {length_m:g} does not hold a section and the margins; give {math.ceil(shortest)} or more")
    samples = math.ceil(length_m / (min(speeds) * every * dt_s))
    if line is None:
        line, _ = make_track(track, track_seed, length=max(1000.0, 100.0 + samples * every * dt_s * max(speeds)))
    with working(f"running {samples * every * dt_s:.0f} s of {loaded.name}"):
        run = simulate(
            loaded,
            speeds[0] if len(speeds) == 1 else jnp.asarray(speeds),
            track=line,
            damper=law,
            duration=samples * every * dt_s,
            dt=dt_s,
            sample=every * dt_s,
            record=acceptance_channels(loaded),
        )
        run.code.block_until_ready()
    if not bool(run.ok.any()):
        raise NumericalError(f"the run diverged at {min(speed_kmh):g} km/h: a displacement went beyond 1 m or 1 rad")
    found = assess(
        loaded, run, prudhomme_factor=prudhomme_factor, section_length=section_m, hunting_frequency=hunting_frequency_hz
    )
    content = {**found.to_dict(), "track": str(line).splitlines()[0], "damper": damper, "calibrated": calibrated(loaded)}
    place = f"track: {content['track']}; damper: {damper}"
    show(content, [str(found), place, *[f"calibrated, not predicted: {entry}" for entry in content["calibrated"]]], as_json, out)
