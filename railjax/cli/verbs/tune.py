"""`railjax tune`: parameters of a vehicle and its damper for an objective under constraints, on the command line."""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ...base.errors import InputError, closest
from ...base.units import KMH
from ...tuning.named import OBJECTIVES
from ..common import Alpha, AsJson, DamperName, TrackName, VehicleName, completing, finite, load, show, working
from ..inputs import chosen_damper
from ..out import PICTURES, as_picture, check_out, out_option

if TYPE_CHECKING:
    from ...model.damper import Damper
    from ...model.vehicle import Vehicle
    from ...tuning.quantity import Constraint, Quantity


def tune(
    vehicle: VehicleName,
    parameter: Annotated[
        list[str],
        typer.Option(
            help="Name with unit and bounds, as secondary.stiffness_y_kN_per_m=50:400 or damper.alpha=0:1.5 (may be repeated)."
        ),
    ],
    objective: Annotated[
        str, typer.Option(help=f"One of {', '.join(OBJECTIVES)}.", autocompletion=completing(lambda: OBJECTIVES))
    ] = "comfort",
    speed_kmh: Annotated[list[float] | None, typer.Option(help="Speed in km/h (may be repeated); 200 if not given.")] = None,
    track: TrackName = "erri-high",
    radius_m: Annotated[
        float, typer.Option(help="Radius of objectives in a curve, in m, at 100 mm of cant and of cant deficiency.")
    ] = 500.0,
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
    finite(positive=False, alpha=alpha, radius_m=radius_m)
    check_out(out, *PICTURES)
    loaded = load(vehicle)
    from ... import tune as run

    law = chosen_damper(damper, loaded, max(speeds) / KMH, alpha)
    bounds = dict(_parameter(loaded, law, text) for text in parameter)
    if len(bounds) < len(parameter):
        raise InputError("--parameter: each may be given once")
    wanted = [_constraint(text, speeds, track, radius_m) for text in constraint or ()]
    with working(f"tuning {loaded.name}"):
        found = run(
            loaded,
            bounds,
            _quantity("--objective", objective, speeds, track, radius_m),
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


def _parameter(vehicle: "Vehicle", damper: "Damper", text: str) -> tuple[str, tuple[float, float]]:
    """Dotted name and bounds in SI of "primary.stiffness_x_MN_per_m=1:20"; a damper's numbers may leave out their SI units."""
    from ...base.fields import is_number, keys_by_unit
    from ...model.parameters import parameters

    name, equals, bounds = (piece.strip() for piece in text.partition("="))
    ends = bounds.split(":")
    try:
        low, high = (float(end) for end in ends)
    except ValueError:
        raise InputError(f"--parameter {text!r}: write name=low:high, like secondary.stiffness_y_kN_per_m=50:400") from None
    if not equals:
        raise InputError(f"--parameter {text!r}: write name=low:high, like secondary.stiffness_y_kN_per_m=50:400")
    there = [path for path, _ in parameters(vehicle)]
    known = {
        f"{part}.{key}": (path, factor)
        for part in dict.fromkeys(path.split(".")[0] for path in there)
        for key, (entry, factor) in keys_by_unit(getattr(vehicle, part)).items()
        if (path := f"{part}.{entry.name}") in there
    }
    for key, (entry, factor) in keys_by_unit(damper).items():
        if is_number(entry):
            known |= {f"damper.{entry.name}": (f"damper.{entry.name}", 1.0), f"damper.{key}": (f"damper.{entry.name}", factor)}
    if name not in known:
        near = closest(name, known)
        whose = (
            f"{type(damper).__name__} has no {name[7:]!r}" if name.startswith("damper.") else "this vehicle has no such number"
        )
        raise InputError(f"--parameter {name!r}: {whose}; did you mean {near}?")
    path, factor = known[name]
    return path, (low * factor, high * factor)


def _quantity(option: str, name: str, speeds: list[float], track: str, radius: float) -> "Quantity":
    """A quantity by its name on the command line, at speeds in km/h, or in a curve (m)."""
    from ...tuning.named import make_objective

    try:
        return make_objective(name, [speed / KMH for speed in speeds], track, radius)
    except InputError as error:
        raise InputError(f"{option} {error}" if name not in OBJECTIVES else str(error)) from None


def _constraint(text: str, speeds: list[float], track: str, radius: float) -> "Constraint":
    """ "critical-speed>=260" with its limit in SI."""
    parts = re.fullmatch(r"\s*([\w-]+)\s*(>=|<=)\s*(\S+)\s*", text)
    if parts is None:
        raise InputError(f'--constraint {text!r}: write name>=limit or name<=limit, like "critical-speed>=260"')
    name, sense, number = parts.groups()
    quantity = _quantity("--constraint", name, speeds, track, radius)
    try:
        limit = float(number) / quantity.factor
    except ValueError:
        raise InputError(f"--constraint {text!r}: {number!r} is not a number") from None
    return quantity >= limit if sense == ">=" else quantity <= limit
