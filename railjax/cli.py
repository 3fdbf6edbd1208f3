"""The command line `railjax`: exit status 0, 1 (numerical failure) or 2 (bad input, one line), never a traceback."""

import os
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from .cli_acceptance import acceptance
from .cli_animate import animate
from .cli_comfort import comfort
from .cli_common import (
    TRACKS,
    Alpha,
    AsJson,
    DamperName,
    TrackSeed,
    VehicleName,
    calibrated,
    complete_track,
    finite,
    load,
    prepare,
    show,
    working,
)
from .cli_damper import damper_app
from .cli_hunting import hunting
from .cli_report import report
from .cli_simulate import make_damper, make_track
from .cli_sweep import sweep
from .cli_tune import tune
from .cli_vehicles import check, vehicles_app
from .errors import InputError, NumericalError

INTERRUPTED = 130  # exit status after Ctrl-C, as shells give it


class Stopped(Exception):
    """Ctrl-C, with what is kept."""


class Group(TyperGroup):
    """Takes Ctrl-C before typer does, which would end without a word."""

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as stop:
            raise Stopped(str(stop)) from None


app = typer.Typer(
    cls=Group,
    help="Lateral dynamics of rail vehicles: critical speeds, simulation, comfort, tuning, reproduction of a paper.\n\n"
    "Example: railjax critical-speed coach --nonlinear\n\n"
    "Exit status: 0 done; 1 the computation failed; 2 bad input; 130 stopped. One line on standard error says why. "
    "With --json, standard output is one JSON object.",
    epilog="railjax --install-completion lets your shell complete verbs, options, vehicles, dampers and tracks.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)
app.add_typer(vehicles_app, name="vehicles")
app.command()(check)
app.add_typer(damper_app, name="damper")
app.command()(hunting)
app.command()(acceptance)
app.command()(animate)
app.command()(comfort)
app.command()(report)
app.command()(tune)
app.command()(sweep)


def main() -> None:
    """Run the command line and exit with its status."""
    code = status(sys.argv[1:])
    if code == INTERRUPTED:
        # at once: XLA may still be compiling on its threads, and an interpreter that is taken down under them can crash or hang
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    sys.exit(code)


def status(arguments: list[str]) -> int:
    """Run the command line on arguments and return the exit status; errors are one line on standard error."""
    try:
        result = app(arguments, standalone_mode=False, prog_name="railjax")
        return result if isinstance(result, int) else 0
    except InputError as error:
        return _fail(str(error), 2)
    except NumericalError as error:
        return _fail(str(error), 1)
    except (Stopped, typer.Abort) as stop:
        return _fail(str(stop) or "stopped", INTERRUPTED)
    except typer.Exit as stop:
        return stop.exit_code
    except Exception as error:
        # errors of usage carry their own one-line message; typer brings its copy of click, so they are known by their form
        if hasattr(error, "format_message") and hasattr(error, "exit_code"):
            message = " ".join(str(error.format_message()).split())
            return _fail(message, 2) if message else 2
        raise


def _fail(message: str, code: int) -> int:
    print(f"railjax: {message}", file=sys.stderr)
    return code


@app.command()
def modes(
    vehicle: VehicleName,
    speed_kmh: Annotated[float, typer.Option(help="Speed in km/h.")] = 180.0,
    as_json: AsJson = False,
) -> None:
    """Frequencies, damping ratios and names of the modes of straight running.

    Example: railjax modes coach --speed-kmh 245
    """
    from .modes import modes as compute
    from .units import KMH

    finite(speed_kmh=speed_kmh)
    found = compute(load(vehicle), speed_kmh / KMH)
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
    show(content, [str(found)], as_json)


@app.command("critical-speed")
def critical_speed(
    vehicle: VehicleName,
    nonlinear: Annotated[bool, typer.Option("--nonlinear", help="Also the fold of the limit cycles.")] = False,
    as_json: AsJson = False,
) -> None:
    """Linear critical speed, where straight running loses stability; nonlinear, below which nothing makes the vehicle hunt.

    Example: railjax critical-speed coach --nonlinear --json
    """
    from .linear import linear_critical_speed
    from .modes import modes as compute
    from .units import KMH

    loaded = load(vehicle)
    speed = float(linear_critical_speed(loaded))
    critical = compute(loaded, speed)
    fitted = calibrated(loaded)
    found, described = _nonlinear(loaded) if nonlinear else ({}, [])
    content = {
        "vehicle": loaded.name,
        "linear_kmh": speed * KMH,
        "frequency_hz": float(critical.frequency[0]),
        "mode": critical.names[0],
        **found,
        "calibrated": fitted,
        "note": loaded.note,
    }
    lines = [
        f"{loaded.name}: linear critical speed {speed * KMH:.2f} km/h, {critical.frequency[0]:.3f} Hz, {critical.names[0]}",
        *described,
        *([loaded.note] if loaded.note else []),
        *[f"calibrated, not predicted: {entry}" for entry in fitted],
    ]
    show(content, lines, as_json)


def _nonlinear(vehicle: Any) -> tuple[dict[str, Any], list[str]]:
    """Keys and lines of the nonlinear critical speed; without a fold it is the linear one, and amplitude and frequency null."""
    from .critical import Hunting, default_wheelset, nonlinear_critical, refuse
    from .units import KMH

    with working(f"fold of the limit cycles of {vehicle.name}"):
        found = nonlinear_critical(vehicle)
    refuse(found.code)
    folded = int(found.code) == Hunting.OK
    content = {
        "nonlinear_kmh": float(found.speed) * KMH,
        "fold_amplitude_mm": float(found.amplitude) * 1e3 if folded else None,
        "fold_frequency_hz": float(found.frequency) if folded else None,
        "criticality": "subcritical" if folded else "supercritical",
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


@app.command()
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
        typer.Option(help=f"Instead: a random track, {TRACKS}; or a measured one, a .csv file.", autocompletion=complete_track),
    ] = None,
    track_seed: TrackSeed = None,
    duration_s: Annotated[float, typer.Option(help="Duration in s.")] = 10.0,
    dt_s: Annotated[float, typer.Option(help="Step of RK4 in s.")] = 1e-3,
    damper: DamperName = "passive",
    alpha: Alpha = None,
    record: Annotated[str, typer.Option(help="Channels to record, separated by commas.")] = "carbody_acceleration,wheelset_y",
    out: Annotated[Path | None, typer.Option(help="Write the run to a .csv, .nc (netCDF) or .png file.")] = None,
    as_json: AsJson = False,
) -> None:
    """Run a vehicle over a track with an irregularity.

    Example: railjax simulate coach --speed-kmh 220 --amplitude-mm 10 --damper balance-logic --alpha 0.5 --out run.png
    """
    from . import Result
    from . import simulate as run
    from .units import KMH

    finite(speed_kmh=speed_kmh, wavelength_m=wavelength_m, bump_m=bump_m, duration_s=duration_s, dt_s=dt_s)
    finite(positive=False, amplitude_mm=amplitude_mm, alpha=alpha)
    loaded = load(vehicle)
    if out is not None and out.suffix not in (".csv", ".nc", ".png"):
        raise InputError(f"--out {out}: the name must end in .csv, .nc or .png")
    line, assumed = make_track(track, track_seed, amplitude_mm, wavelength_m, bump_m)
    law = make_damper(damper, loaded, speed_kmh / KMH, alpha)
    channels = [name.strip() for name in record.split(",") if name.strip()]
    if not channels:
        raise InputError("--record names no channel; give one, like carbody_acceleration")
    sums = [f"{how}:{name}" for name in channels for how in ("rms", "peak")]
    with working(f"running {duration_s:g} s of {loaded.name}"):
        result = run(loaded, speed_kmh / KMH, track=line, duration=duration_s, dt=dt_s, damper=law, record=channels, reduce=sums)
        code = int(result.code)
    if code == Result.DIVERGED:
        raise NumericalError(f"the run diverged at {speed_kmh:g} km/h: a displacement went beyond 1 m or 1 rad")
    if out is not None:
        _write_run(result, channels, out)
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
    show(content, [str(result)], as_json)


def _write_run(result: Any, channels: list[str], out: Path) -> None:
    from .channels import CHANNELS
    from .plots import figure, histories

    data = result.to_xarray()
    try:
        if out.suffix == ".nc":
            data.to_netcdf(out, engine="scipy")
        elif out.suffix == ".csv":
            import numpy as np

            columns, names = [np.asarray(result.time)], ["time (s)"]
            for name in channels:
                values = np.asarray(result[name]).reshape(len(columns[0]), -1)
                columns += list(values.T)
                index = [f"[{i}]" for i in range(values.shape[1])] if values.shape[1] > 1 else [""]
                names += [f"{name}{i} ({CHANNELS[name].unit})" for i in index]
            np.savetxt(out, np.column_stack(columns), delimiter=",", header=",".join(names), comments="")
        else:
            with figure(rows=len(channels), height=2.4, share_x=True) as (page, axes):
                for row, name in zip(axes[:, 0], channels, strict=True):
                    histories(row, result, {name: name}, 1.0, CHANNELS[name].unit)
                page.savefig(out)
    except OSError as error:
        raise InputError(f"--out {out}: cannot be written ({error.strerror})") from None


@app.command()
def reproduce(
    out: Annotated[Path, typer.Option(help="Folder for report.html, figures/*.png and results.json.")] = Path("results"),
    only: Annotated[list[str] | None, typer.Option(help="Run only this study (may be repeated).")] = None,
    fresh: Annotated[bool, typer.Option(help="Make every study anew instead of keeping finished ones.")] = False,
    as_json: AsJson = False,
) -> None:
    """Reproduce the paper: every figure and number, beside the paper's own.

    Example: railjax reproduce --out results
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    from .report import number
    from .reproduce import reproduce as run

    prepare()
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    # not into a file or a pipe, where errors are to be the only line
    with Progress(*columns, console=Console(stderr=True), disable=not sys.stderr.isatty()) as bar:
        task = bar.add_task("", total=None)

        def advance(title: str, done: int, total: int) -> None:
            bar.update(task, description=title, completed=done, total=total)

        try:
            results = run(out, only=only, fresh=fresh, progress=advance)
        except KeyboardInterrupt:
            raise KeyboardInterrupt(f"stopped; finished parts are kept in {out}, and the same command goes on there") from None
    lines = [
        f"{q['name']}: {number(q['computed'])} {q['unit']}"
        + ("" if q["paper"] is None else f" (paper {number(q['paper'])})")
        + (" - fitted" if q["fitted"] else "")
        for q in results["quantities"]
    ]
    show(results, [*lines, results["summary"], f"report: {out / 'report.html'}"], as_json)


if __name__ == "__main__":
    main()
