"""`railjax train`: a law of the secondary lateral dampers by gradients through the vehicle, on the command line."""

from pathlib import Path
from typing import Annotated

import typer

from ...base.errors import InputError
from ..common import AsJson, VehicleName, complete_spectrum, completing, finite, load, show

LAWS = ("learned", "linear")
ESTIMATORS = ("kalman", "complementary")
#: hidden units and memories (s) of a learned law: a Kalman filter's states remember by themselves
ON = {"kalman": (16, (0.3,)), "complementary": (24, (0.08, 0.4))}


def train(
    vehicle: VehicleName,
    out: Annotated[Path, typer.Option(help="File of the trained law (.npz), which --damper takes wherever a damper is named.")],
    law: Annotated[
        str,
        typer.Option(
            help="learned (a small network beside a linear law), linear (that alone), or the file of a law to go on from.",
            autocompletion=completing(lambda: LAWS),
        ),
    ] = "learned",
    estimator: Annotated[
        str,
        typer.Option(
            help="What it knows the motion by: kalman (a filter of the whole vehicle at the highest speed) or complementary (no vehicle in it).",
            autocompletion=completing(lambda: ESTIMATORS),
        ),
    ] = "kalman",
    track: Annotated[
        list[str] | None,
        typer.Option(
            help="Spectrum of the tracks; erri-low and erri-high if not given (may be repeated).",
            autocompletion=complete_spectrum,
        ),
    ] = None,
    speed_kmh: Annotated[
        list[float] | None, typer.Option(help="Lowest and highest speed in km/h, or each of several; 120 to 220 if not given.")
    ] = None,
    skyhook_kNs_per_m: Annotated[
        float, typer.Option("--skyhook-kNs-per-m", help="Damping per damper of the skyhook law that it begins as.")
    ] = 100.0,
    travel_ratio: Annotated[
        float,
        typer.Option(
            help="Largest secondary travel (r.m.s.), times that of the skyhook law that it begins as.",
        ),
    ] = 1.05,
    episodes: Annotated[int, typer.Option(help="Rides of 12 s of all lanes, five steps each.")] = 60,
    lanes: Annotated[int, typer.Option(help="Rides at once.")] = 32,
    seed: Annotated[int, typer.Option(help="Of tracks, speeds, noise and first weights.")] = 0,
    keep: Annotated[Path | None, typer.Option(help="File (.npz) from which a training that was stopped goes on.")] = None,
    c_file: Annotated[Path | None, typer.Option("--c", help="Also write the law in C99 to this file.")] = None,
    as_json: AsJson = False,
) -> None:
    """Train a law for the valves of the secondary lateral dampers, from what accelerometers and the dampers' travel tell, with all their noise.

    Example: railjax train coach --law learned --out law.npz

    Then: railjax comfort coach --speed-kmh 200 --damper law.npz
    """
    finite(skyhook_kNs_per_m=skyhook_kNs_per_m, travel_ratio=travel_ratio)
    speeds = sorted(speed_kmh or [120.0, 220.0])
    for speed in speeds:
        finite(speed_kmh=speed)
    if len(speeds) < 2 or speeds[0] == speeds[-1]:
        raise InputError("--speed-kmh: give the lowest and the highest, each with the option")
    if estimator not in ESTIMATORS:
        raise InputError(f"--estimator {estimator!r} must be one of {', '.join(ESTIMATORS)}")
    if out.suffix != ".npz":
        raise InputError(f"--out {out}: the law's file ends in .npz, by which --damper knows it")
    for file in (out, keep, c_file):
        if file is not None and not file.parent.is_dir():
            raise InputError(f"{file}: the folder {file.parent} does not exist")
    loaded = load(vehicle)
    from ... import ComplementaryFilter, Controller, Device, KalmanFilter, LearnedDamper, Sensors, Skyhook, load_law
    from ... import train as run
    from ...base.progress import bar, when_stopped
    from ...base.units import KMH

    if law in LAWS:
        hidden, memories = ON[estimator]
        sensors = Sensors.typical()
        known = ComplementaryFilter() if estimator == "complementary" else KalmanFilter.design(loaded, speeds[-1] / KMH, sensors)
        classical = Controller(Skyhook(damping=1e3 * skyhook_kNs_per_m), sensors=sensors, estimator=known, device=Device())
        begun = LearnedDamper.of(classical, loaded, hidden=hidden if law == "learned" else 0, time_constants=memories, seed=seed)
    elif law.endswith(".npz"):
        begun = load_law(law)
    else:
        raise InputError(f"--law {law!r} must be one of {', '.join(LAWS)}, or the file of a law (.npz)")
    said = (
        "stopped; nothing is kept"
        if keep is None
        else f"stopped; what is done is kept in {keep}, and the same command goes on there"
    )
    with bar(True, f"training on {loaded.name}") as report, when_stopped(said):
        found = run(
            loaded,
            begun,
            tracks=track or ["erri-low", "erri-high"],
            speeds=[speed / KMH for speed in speeds],
            limits={"secondary_travel": travel_ratio},
            episodes=episodes,
            lanes=lanes,
            seed=seed,
            keep=keep,
            progress=report,
        )
    found.law.save(out)
    if c_file is not None:
        found.law.export_c(c_file, vehicle=loaded)
    content = {
        "vehicle": loaded.name,
        "law": str(out),
        "begun_as": found.law.origin,
        "comfort_ratio": found.comfort,
        "limited_ratios": found.limited,
        "limits": found.limits,
        "quiet_kmh": dict(zip(("small", "large"), (float(speed) * KMH for speed in found.quiet), strict=True)),
        "episodes": found.episodes,
        "seconds": found.seconds,
        "finished": found.finished,
    }
    show(content, [str(found), f"law: {out}"], as_json)
