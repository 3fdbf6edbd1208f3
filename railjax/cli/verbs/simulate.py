"""`railjax simulate`: one run over a track, on the command line."""

from pathlib import Path
from typing import Annotated, Any

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
    VehicleName,
    complete_track,
    finite,
    load,
    show,
    working,
)
from ..files import BridgeM, ChordM, Columns, LongestM, ShortestM, Units, track_file
from ..inputs import chosen_damper, make_track, upon_layout
from ..out import PICTURES, TABLE, as_picture, check_out, out_option

NETCDF = ".nc"


def simulate(
    vehicle: VehicleName,
    speed_kmh: Annotated[float, typer.Option(help="Speed in km/h.")] = 180.0,
    amplitude_mm: Annotated[
        float | None, typer.Option(help="Amplitude of the sinusoidal alignment in mm; 5 if not given.")
    ] = None,
    wavelength_m: Annotated[float | None, typer.Option(help="Its wavelength in m; 20 if not given.")] = None,
    bump_m: Annotated[float | None, typer.Option(help="Instead: a single bump of this length in m, at 20 m.")] = None,
    track: Annotated[
        str | None,
        typer.Option(
            help=f"Instead: a random track, {TRACKS}; or {OTHER_TRACKS}.",
            autocompletion=complete_track,
        ),
    ] = None,
    layout: LayoutFile = None,
    track_seed: TrackSeed = None,
    columns: Columns = None,
    unit: Units = None,
    chord_m: ChordM = None,
    longest_m: LongestM = None,
    shortest_m: ShortestM = None,
    bridge_m: BridgeM = None,
    duration_s: Annotated[float, typer.Option(help="Duration in s.")] = 10.0,
    dt_s: Annotated[float, typer.Option(help="Step of RK4 in s.")] = 1e-3,
    damper: DamperName = "passive",
    alpha: Alpha = None,
    record: Annotated[str, typer.Option(help="Channels to record, separated by commas.")] = "carbody_acceleration,wheelset_y",
    out: Annotated[Path | None, out_option("the run (.json: its sums)", TABLE, NETCDF, *PICTURES)] = None,
    as_json: AsJson = False,
) -> None:
    """Run a vehicle over a track with an irregularity.

    With --layout the line is even unless an irregularity is given.

    Example: railjax simulate coach --layout curve.toml --speed-kmh 90 --out curve.png

    Example: railjax simulate coach --speed-kmh 220 --amplitude-mm 10 --damper balance-logic --alpha 0.5 --out run.png
    """
    from ... import Result
    from ... import simulate as run
    from ...base.units import KMH

    finite(speed_kmh=speed_kmh, wavelength_m=wavelength_m, bump_m=bump_m, duration_s=duration_s, dt_s=dt_s)
    finite(positive=False, amplitude_mm=amplitude_mm, alpha=alpha)
    check_out(out, TABLE, NETCDF, *PICTURES)
    loaded = load(vehicle)
    how = track_file(track, columns, unit, chord_m, longest_m, shortest_m, bridge_m)
    line, assumed = make_track(track, track_seed, amplitude_mm, wavelength_m, bump_m, file=how)
    if layout is not None:
        line, assumed = upon_layout(layout, line, assumed, track, amplitude_mm, wavelength_m, bump_m)
    law = chosen_damper(damper, loaded, speed_kmh / KMH, alpha)
    channels = [name.strip() for name in record.split(",") if name.strip()]
    if not channels:
        raise InputError("--record names no channel; give one, like carbody_acceleration")
    sums = [f"{how}:{name}" for name in channels for how in ("rms", "peak")]
    with working(f"running {duration_s:g} s of {loaded.name}"):
        result = run(loaded, speed_kmh / KMH, track=line, duration=duration_s, dt=dt_s, damper=law, record=channels, reduce=sums)
        code = int(result.code)
    if code == Result.DIVERGED:
        raise NumericalError(f"the run diverged at {speed_kmh:g} km/h: a displacement went beyond 1 m or 1 rad")
    content = {
        "vehicle": loaded.name,
        "speed_kmh": speed_kmh,
        "damper": damper,
        "assumed": [
            *assumed,
            *([] if damper == "passive" else ["damper: parameters not in the paper"]),
        ],
        "reductions": {name: values.tolist() for name, values in result.reductions.items()},
    }
    forms = as_picture(lambda axes: _draw(result, channels, axes[:, 0]), rows=len(channels), height=2.4, share_x=True)
    forms[TABLE] = lambda out: _write_table(result, channels, out)
    forms[NETCDF] = lambda out: result.to_xarray().to_netcdf(out, engine="scipy")
    show(content, [str(result)], as_json, out, forms)


def _draw(result: Any, channels: list[str], rows: Any) -> None:
    from ...plots.charts import histories
    from ...simulation.channels import CHANNELS

    for axes, name in zip(rows, channels, strict=True):
        histories(axes, result, {name: name}, 1.0, CHANNELS[name].unit)


def _write_table(result: Any, channels: list[str], out: Path) -> None:
    import numpy as np

    from ...simulation.channels import CHANNELS

    columns, names = [np.asarray(result.time)], ["time (s)"]
    for name in channels:
        values = np.asarray(result[name]).reshape(len(columns[0]), -1)
        columns += list(values.T)
        index = [f"[{i}]" for i in range(values.shape[1])] if values.shape[1] > 1 else [""]
        names += [f"{name}{i} ({CHANNELS[name].unit})" for i in index]
    np.savetxt(out, np.column_stack(columns), delimiter=",", header=",".join(names), comments="")
