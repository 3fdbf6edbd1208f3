"""`railjax animate`: the vehicle from above on its track, as a film."""

from pathlib import Path
from typing import Annotated, Any

import typer

from ...base.errors import InputError
from ...dampers.named import DAMPERS
from ..common import AsJson, VehicleName, calibrated, finite, load, show
from ..files import BridgeM, ChordM, Columns, LongestM, ShortestM, Units, track_file
from ..inputs import chosen_damper, make_track


def animate(
    vehicle: VehicleName,
    out: Annotated[Path, typer.Option(help="The film: a .gif, .mp4 (needs ffmpeg) or .html file.")],
    speed_kmh: Annotated[float, typer.Option(help="Speed in km/h.")] = 180.0,
    mode: Annotated[
        int | None, typer.Option(help="Show this mode: 1 for the least damped, as 'railjax modes' lists them.")
    ] = None,
    limit_cycle: Annotated[
        bool,
        typer.Option(
            "--limit-cycle", help="Show the stable limit cycle at this speed; with --damper, how that one takes over from there."
        ),
    ] = False,
    damper: Annotated[
        str, typer.Option(help=f"Secondary lateral damper: {', '.join(DAMPERS)}; or the file of a law (.npz).")
    ] = "passive",
    alpha: Annotated[float | None, typer.Option(help="Gain α of balance logic and hybrid damper.")] = None,
    displaced_mm: Annotated[
        float | None, typer.Option(help="Displacement of all wheelsets at the start in mm; 5 on even track, 0 on others.")
    ] = None,
    track: Annotated[
        str | None,
        typer.Option(
            help="A random track, erri-low, erri-high, fra-1 to fra-6; or the file of a measured one, or of a spectrum."
        ),
    ] = None,
    track_seed: Annotated[int | None, typer.Option(help="Which random track; 0 if not given.")] = None,
    columns: Columns = None,
    unit: Units = None,
    chord_m: ChordM = None,
    longest_m: LongestM = None,
    shortest_m: ShortestM = None,
    bridge_m: BridgeM = None,
    amplitude_mm: Annotated[float | None, typer.Option(help="Instead: amplitude of a sinusoidal alignment in mm.")] = None,
    wavelength_m: Annotated[float | None, typer.Option(help="Its wavelength in m; 20 if not given.")] = None,
    duration_s: Annotated[float, typer.Option(help="Duration of the run in s.")] = 5.0,
    start_s: Annotated[
        float | None, typer.Option(help="Show it from here on (default: the last 1.5 s; with --limit-cycle 0).")
    ] = None,
    stop_s: Annotated[float | None, typer.Option(help="Show it up to here (default: its end; with --limit-cycle 1.5).")] = None,
    slow: Annotated[float | None, typer.Option(help="How many times slower than it was.")] = None,
    magnified: Annotated[float | None, typer.Option(help="How many times displacements are magnified.")] = None,
    as_json: AsJson = False,
) -> None:
    """Film a vehicle from above: running, hunting on its limit cycle, or a mode's shape.

    Example: railjax animate coach --speed-kmh 245 --mode 1 --out mode.gif

    Example: railjax animate coach --speed-kmh 240 --limit-cycle --out hunting.gif

    Example: railjax animate coach --speed-kmh 240 --limit-cycle --damper skyhook --out controlled.gif

    Example: railjax animate coach --speed-kmh 200 --track erri-high --out ride.gif
    """
    finite(speed_kmh=speed_kmh, wavelength_m=wavelength_m, duration_s=duration_s, slow=slow, magnified=magnified)
    finite(positive=False, alpha=alpha, displaced_mm=displaced_mm, amplitude_mm=amplitude_mm, start_s=start_s, stop_s=stop_s)
    how = track_file(track, columns, unit, chord_m, longest_m, shortest_m, bridge_m)
    of_track = {"track": track, "track-seed": track_seed, "amplitude-mm": amplitude_mm, "wavelength-m": wavelength_m}
    tracked = [name for name, value in of_track.items() if value is not None]
    if mode is not None and limit_cycle:
        raise InputError("--mode and --limit-cycle exclude each other: give one")
    periodic = "--mode" if mode is not None else "--limit-cycle" if limit_cycle else ""
    if periodic and (tracked or displaced_mm is not None):
        raise InputError(f"--{tracked[0] if tracked else 'displaced-mm'} is for a run, not for {periodic}: leave one out")
    if (mode is not None or (limit_cycle and damper == "passive")) and (start_s is not None or stop_s is not None):
        raise InputError(f"--start-s and --stop-s are for a run; {periodic} shows one period")
    from ... import animate as film
    from ...base.progress import parts_bar
    from ...base.units import KMH
    from ...plots.animation import check_name
    from ...plots.frames import LAST

    check_name(out)
    loaded = load(vehicle)
    speed = speed_kmh / KMH
    law = chosen_damper(damper, loaded, speed, alpha)
    title = f"{loaded.name} at {speed_kmh:.1f} km/h"
    if mode is not None:
        motion, options, shown = _mode(loaded, speed, law, mode)
    elif limit_cycle:
        motion, options, shown = _limit_cycle(loaded, speed)
        if damper != "passive":
            motion = _taken_over(loaded, motion, law, duration_s)
            begin = 0.0 if start_s is None else start_s
            options = {"start": begin, "stop": min(begin + LAST, duration_s) if stop_s is None else stop_s}
            options["title"] = f"{title}, from its passive limit cycle with {damper}"
            shown["shown"] = "run from the limit cycle"
    else:
        line, assumed = make_track(track, track_seed, amplitude_mm, wavelength_m, file=how) if tracked else (None, [])
        displaced = (0.0 if tracked else 5.0) if displaced_mm is None else displaced_mm
        motion, shown = _run(loaded, speed, law, line, displaced, duration_s), {"shown": "run", "assumed": assumed}
        options = {"start": start_s, "stop": stop_s, "title": f"{title}, {'passive damper' if damper == 'passive' else damper}"}
    with parts_bar() as report:
        made = film(loaded, motion, out, slow=slow, magnified=magnified, progress=lambda *at: report("pictures", *at), **options)
    fitted = calibrated(loaded)
    content = {"vehicle": loaded.name, "speed_kmh": speed_kmh, "damper": damper, **shown, "out": str(made.path)}
    content |= {"frames": made.frames, "magnified": made.magnified, "slow": made.slow, "calibrated": fitted}
    show(content, [str(made), *[f"calibrated, not predicted: {entry}" for entry in fitted]], as_json)


#: what is filmed, the film's options, and what is said of it
Shown = tuple[Any, dict[str, Any], dict[str, Any]]


def _mode(vehicle: Any, speed: float, damper: Any, mode: int) -> Shown:
    from ... import modes

    found = modes(vehicle, speed, damper)
    if not 1 <= mode <= len(found.names):
        raise InputError(f"--mode must lie between 1 and {len(found.names)} (see 'railjax modes'), not {mode}")
    told = {"shown": "mode", "mode": found.names[mode - 1], "frequency_hz": float(found.frequency[mode - 1])}
    return found, {"mode": mode - 1}, told


def _limit_cycle(vehicle: Any, speed: float) -> Shown:
    """Of the passive vehicle; its branch is followed so far that it holds the speed."""
    from ... import hunting_branch, linear_critical_speed
    from ...stability.hunting.branch import HIGHEST

    highest = 1.02 * speed if speed > HIGHEST * float(linear_critical_speed(vehicle)) else None
    found = hunting_branch(vehicle, highest_speed=highest).at(speed)
    return found, {}, {"shown": "limit cycle", "amplitude_mm": 1e3 * found.amplitude, "frequency_hz": found.frequency}


def _taken_over(vehicle: Any, cycle: Any, damper: Any, duration: float) -> Any:
    """A run from the limit cycle of the passive vehicle with another damper, whose own states begin at rest."""
    import numpy as np

    from ... import animation_channels, simulate
    from ...model.kinematics import size
    from ...model.motion import state_size

    own = state_size(vehicle, damper) - len(cycle.state)
    start = np.insert(cycle.state, 2 * size(vehicle), np.zeros(own))
    record = animation_channels(vehicle)
    return simulate(vehicle, cycle.speed, damper=damper, duration=duration, initial=start, record=record, sample=5e-3)


def _run(vehicle: Any, speed: float, damper: Any, track: Any, displaced: float, duration: float) -> Any:
    """A run from the wheelsets `displaced` by some mm."""
    from ... import animation_channels, simulate

    record, initial = animation_channels(vehicle), {"wheelset_y": 1e-3 * displaced}
    return simulate(vehicle, speed, track=track, damper=damper, duration=duration, initial=initial, record=record, sample=5e-3)
