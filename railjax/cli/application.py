"""The command line `railjax`: exit status 0, 1 (numerical failure) or 2 (bad input, one line), never a traceback."""

import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from ..base.errors import InputError, NumericalError
from ..base.progress import INTERRUPTED, end_at_ctrl_c, leave, parts_bar, when_stopped
from .common import AsJson, prepare, show
from .verbs.acceptance import acceptance
from .verbs.animate import animate
from .verbs.comfort import comfort
from .verbs.conicity import conicity
from .verbs.curving import curving
from .verbs.damper import damper_app
from .verbs.hunting import hunting
from .verbs.report import report
from .verbs.simulate import simulate
from .verbs.stability import critical_speed, modes
from .verbs.sweep import sweep
from .verbs.train import train
from .verbs.tune import tune
from .verbs.vehicles import check, vehicles_app


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
app.command()(modes)
app.command()(critical_speed)
app.command()(simulate)
app.add_typer(damper_app, name="damper")
app.command()(hunting)
app.command()(acceptance)
app.command()(animate)
app.command()(comfort)
app.command()(conicity)
app.command()(curving)
app.command()(report)
app.command()(tune)
app.command()(train)
app.command()(sweep)


def main() -> None:
    """Run the command line and exit with its status."""
    end_at_ctrl_c()
    code = status(sys.argv[1:])
    if code == INTERRUPTED:
        leave()
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
def reproduce(
    out: Annotated[Path, typer.Option(help="Folder for report.html, figures/*.png and results.json.")] = Path("results"),
    only: Annotated[list[str] | None, typer.Option(help="Run only this study (may be repeated).")] = None,
    beyond: Annotated[bool, typer.Option("--beyond", help="Also make what goes beyond the paper, into the same report.")] = False,
    fresh: Annotated[bool, typer.Option(help="Make every study anew instead of keeping finished ones.")] = False,
    as_json: AsJson = False,
) -> None:
    """Reproduce the paper: every figure, number and statement, beside the paper's own.

    With --beyond also what the paper does not have: comfort and running safety on real tracks over speed, control strategies,
    hunting with the controlled damper, sensitivities, the best gain over speed, comfort against critical speed.

    Example: railjax reproduce --out results
    """
    from ..base.text import number
    from ..reports.paper.reproduce import reproduce as run

    prepare()
    kept = f"stopped; finished parts are kept in {out}, and the same command goes on there"
    with parts_bar(telling=True) as advance, when_stopped(kept):
        results = run(out, only=only, beyond=beyond, fresh=fresh, progress=advance)
    lines = [
        f"{q['name']}: {number(q['computed'])} {q['unit']}"
        + ("" if q["paper"] is None else f" (paper {number(q['paper'])})")
        + (" - fitted" if q["fitted"] else "")
        for q in results["quantities"]
    ]
    seconds = results["seconds"]
    took = f"{sum(seconds.values()):.0f} s in all: " + ", ".join(f"{name} {number(round(s, 1))}" for name, s in seconds.items())
    show(results, [*lines, results["summary"], took, f"report: {out / 'report.html'}"], as_json)
