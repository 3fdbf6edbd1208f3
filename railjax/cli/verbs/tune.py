"""`railjax tune`: parameters of a vehicle and its damper for an objective under constraints, on the command line."""

import difflib
import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ...base.errors import InputError
from ..common import Alpha, AsJson, DamperName, TrackName, VehicleName, completing, finite, load, show, working
from ..inputs import chosen_damper
from ..out import PICTURES, as_picture, check_out, out_option

if TYPE_CHECKING:
    from ...model.vehicle import Vehicle
    from ...tuning.quantity import Constraint, Quantity

#: what can be an objective or a constraint, and from its unit on the command line to SI
NAMES = {
    "comfort": 1.0,
    "travel-mm": 1e-3,
    "guiding-force-kN": 1e3,
    "critical-speed": 1.0 / 3.6,
    "nonlinear-critical-speed": 1.0 / 3.6,
    "least-damping": 0.01,
    "limit-cycle-mm": 1e-3,
}


def tune(
    vehicle: VehicleName,
    parameter: Annotated[
        list[str],
        typer.Option(
            help="Name with unit and bounds, as secondary.stiffness_y_kN_per_m=50:400 or damper.alpha=0:1.5 (may be repeated)."
        ),
    ],
    objective: Annotated[
        str, typer.Option(help=f"One of {', '.join(NAMES)}.", autocompletion=completing(lambda: NAMES))
    ] = "comfort",
    speed_kmh: Annotated[list[float] | None, typer.Option(help="Speed in km/h (may be repeated); 200 if not given.")] = None,
    track: TrackName = "erri-high",
    constraint: Annotated[
        list[str] | None,
        typer.Option(
            help='As "critical-speed>=260" (km/h), "travel-mm<=60", "least-damping>=5" (%), "comfort<=0.1" (may be repeated).'
        ),
    ] = None,
    damper: DamperName = "passive",
    alpha: Alpha = None,
    starts: Annotated[int, typer.Option(help="Starts: the vehicle itself and random ones.")] = 1,
    seed: Annotated[int, typer.Option(help="Of the random starts.")] = 0,
    optimiser: Annotated[
        str | None,
        typer.Option(help="slsqp, lbfgs or adam.", autocompletion=completing(lambda: ("slsqp", "lbfgs", "adam"))),
    ] = None,
    out: Annotated[Path | None, out_option("the history, drawn, or the result", *PICTURES)] = None,
    as_json: AsJson = False,
) -> None:
    """Tune parameters by exact gradients for the best objective under constraints.

    Example: railjax tune coach --parameter secondary.stiffness_y_kN_per_m=50:400 --parameter primary.stiffness_x_MN_per_m=1:20
    --objective comfort --speed-kmh 220 --track erri-high --constraint "critical-speed>=260" --json
    """
    speeds = speed_kmh or [200.0]
    for speed in speeds:
        finite(speed_kmh=speed)
    finite(positive=False, alpha=alpha)
    check_out(out, *PICTURES)
    loaded = load(vehicle)
    from ... import tune as run

    law = chosen_damper(damper, loaded, max(speeds) / 3.6, alpha)
    bounds = dict(_parameter(loaded, text) for text in parameter)
    if len(bounds) < len(parameter):
        raise InputError("--parameter: each may be given once")
    wanted = [_constraint(text, speeds, track) for text in constraint or ()]
    with working(f"tuning {loaded.name}"):
        found = run(
            loaded,
            bounds,
            _quantity("--objective", objective, speeds, track),
            wanted,
            damper=law,
            starts=starts,
            seed=seed,
            optimiser=optimiser,
        )
    plain = found.as_dict()
    content = {
        "vehicle": loaded.name,
        "damper": damper,
        **plain,
        "objective": found.objective_sharp,
        "objective_name": found.quantity.name,
    }
    content |= {"objective_smooth": found.objective, "objective_before": found.objective_before, "met": found.met}
    show(content, [str(found)], as_json, out, as_picture(lambda axes: found.plot(axes[0, 0])))


def _parameter(vehicle: "Vehicle", text: str) -> tuple[str, tuple[float, float]]:
    """Dotted name and bounds in SI of "primary.stiffness_x_MN_per_m=1:20"."""
    from ...base.units import keys_of
    from ...model.parameters import parameters

    name, equals, bounds = (piece.strip() for piece in text.partition("="))
    ends = bounds.split(":")
    try:
        low, high = (float(end) for end in ends)
    except ValueError:
        raise InputError(f"--parameter {text!r}: write name=low:high, like secondary.stiffness_y_kN_per_m=50:400") from None
    if not equals:
        raise InputError(f"--parameter {text!r}: write name=low:high, like secondary.stiffness_y_kN_per_m=50:400")
    if name.startswith("damper."):
        return name, (low, high)
    known = {
        f"{path.split('.')[0]}.{key}": (path, factor)
        for path, entry in parameters(vehicle)
        for key, factor in keys_of(entry.name, entry.metadata["unit"]).items()
    }
    if name not in known:
        near = difflib.get_close_matches(name, known, n=1, cutoff=0.0)[0]
        raise InputError(f"--parameter {name!r}: this vehicle has no such number; did you mean {near}?")
    path, factor = known[name]
    return path, (low * factor, high * factor)


def _quantity(option: str, name: str, speeds: list[float], track: str) -> "Quantity":
    """A quantity by its name on the command line."""
    from ...tuning import objectives as aim

    if name not in NAMES:
        near = difflib.get_close_matches(name, NAMES, n=1, cutoff=0.0)[0]
        raise InputError(f"{option} {name!r} is not known; did you mean {near}?")
    fast = max(speeds) / 3.6
    return {
        "comfort": lambda: aim.comfort([speed / 3.6 for speed in speeds], track),
        "travel-mm": lambda: aim.travel([speed / 3.6 for speed in speeds], track),
        "guiding-force-kN": lambda: aim.guiding_force([speed / 3.6 for speed in speeds], track),
        "critical-speed": aim.linear_critical_speed,
        "nonlinear-critical-speed": aim.nonlinear_critical_speed,
        "least-damping": lambda: aim.least_damping(fast),
        "limit-cycle-mm": lambda: aim.limit_cycle_amplitude(fast),
    }[name]()


def _constraint(text: str, speeds: list[float], track: str) -> "Constraint":
    """ "critical-speed>=260" with its limit in SI."""
    parts = re.fullmatch(r"\s*([\w-]+)\s*(>=|<=)\s*(\S+)\s*", text)
    if parts is None:
        raise InputError(f'--constraint {text!r}: write name>=limit or name<=limit, like "critical-speed>=260"')
    name, sense, number = parts.groups()
    quantity: Any = _quantity("--constraint", name, speeds, track)
    try:
        limit = float(number) * NAMES[name]
    except ValueError:
        raise InputError(f"--constraint {text!r}: {number!r} is not a number") from None
    return quantity >= limit if sense == ">=" else quantity <= limit
