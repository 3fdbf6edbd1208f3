"""The sections of a vehicle's report on critical speeds, limit cycles, and what decides them."""

from typing import Any

import jax
import numpy as np

from ....base.errors import NumericalError
from ....base.style import figure
from ....base.units import KMH
from ....model.parameters import parameters
from ....plots.charts import tornado
from ....stability.hunting.sensitivity import changes, fold_gradient, parameter_label
from ....stability.linear_critical import HIGHEST, linear_critical_speed
from ....stability.modes import modes
from ..page import paragraph, table
from ..subject import Part, Subject, drawn

#: most parameters in the chart of sensitivities, and the share of the longest bar below which they are left out
BARS, LEAST = 18, 5e-3


def critical_speeds(subject: Subject) -> Part:
    """Linear and nonlinear; where the latter fails, what is known."""
    numbers: dict[str, Any] = {"linear_kmh": None}
    rows: list[tuple[str, str, str, str]] = []
    speed = subject.top
    if subject.stable:
        headline = [("linear critical speed", "none", f"stable up to {HIGHEST * KMH:.0f} km/h")]
    else:
        speed = subject.needs_critical_speed()
        at = modes(subject.vehicle, speed)
        frequency, name = float(at.frequency[0]), at.names[0]
        kmh = f"{speed * KMH:.1f} km/h"
        numbers = {"linear_kmh": speed * KMH, "frequency_hz": frequency, "mode": name}
        rows = [("linear: straight running loses its stability", kmh, f"{frequency:.2f} Hz", name)]
        headline = [("linear critical speed", kmh, f"{name}, {frequency:.2f} Hz")]
    try:
        branch = subject.hunting()
    except NumericalError as error:
        numbers["nonlinear_kmh"] = None
        if subject.stable:
            text = f"Straight running is stable, and no limit cycle was found, up to {HIGHEST * KMH:.0f} km/h: no critical speed."
            return Part(
                paragraph(text), {"linear_kmh": None}, [("critical speed", "none", f"stable up to {HIGHEST * KMH:.0f} km/h")]
            )
        said = paragraph(f"The nonlinear critical speed was not found: {error}.", "failed")
    else:
        fold = branch.fold
        folded = fold is not None and (subject.stable or fold.speed < speed)
        lowest = fold.speed if folded else speed
        numbers |= {"nonlinear_kmh": lowest * KMH, "criticality": branch.criticality}
        numbers |= {"fold_amplitude_mm": 1e3 * fold.amplitude, "fold_frequency_hz": fold.frequency} if folded else {}
        of = f"{fold.frequency:.2f} Hz" if folded else "-"
        what = f"fold of the limit cycles at {1e3 * fold.amplitude:.2f} mm" if folded else "no fold: that of the linear theory"
        rows.append(("nonlinear: below it nothing makes the vehicle hunt", f"{lowest * KMH:.1f} km/h", of, what))
        headline.append(("nonlinear critical speed", f"{lowest * KMH:.1f} km/h", what))
        said = paragraph(
            "Straight running is stable at all speeds, but from there on a disturbance that is large enough makes the vehicle hunt: linear theory does not see it."
            if subject.stable
            else f"Between the two a disturbance that is large enough makes the vehicle hunt, a small one dies out: {(speed - lowest) * KMH:.3g} km/h that "
            "linear theory does not see."
            if folded
            else "Limit cycles leave the linear critical speed towards higher speeds (supercritical), so it is the nonlinear one as well."
        )
    fitted = [p.parameter for p in subject.vehicle.provenance if p.status == "calibrated"]
    numbers["calibrated"] = fitted
    warned = paragraph(f"They rest on calibrated values: {', '.join(fitted)}.") if fitted else ""
    body = table(("Critical speed", "Speed", "Frequency", "Motion"), rows, numbers=(1, 2))
    return Part(body + said + warned, numbers, headline)


def bifurcation(subject: Subject) -> Part:
    """The diagram of the limit cycles."""
    branch = subject.needs_hunting()
    with figure(height=4.4) as (page, axes):
        branch.plot(axes[0, 0])
    caption = (
        f"Amplitude of wheelset {branch.wheelset + 1} from the front over speed: stable limit cycles solid, unstable ones dashed. "
        f"{'There is no Hopf point' if subject.stable else f'The Hopf point is {branch.criticality}'}. "
        f"Error of the Floquet multipliers at most {max(point.floquet.error for point in branch.points):.0e}. {branch.note}"
    )
    events = ", ".join(f"{event.kind} at {event.speed * KMH:.1f} km/h" for event in branch.events)
    events = f" Stability also changes here: {events}." if events else ""
    alternative = (
        f"Bifurcation diagram from {branch.speed.min() * KMH:.0f} to {branch.speed.max() * KMH:.0f} km/h, {branch.criticality}."
    )
    points = [
        {
            "speed_kmh": p.speed * KMH,
            "amplitude_mm": 1e3 * p.amplitude,
            "frequency_hz": p.frequency,
            "stable": p.stable,
            "piece": k,
        }
        for k, piece in enumerate(branch.pieces)
        for p in piece
    ]
    return Part(drawn("bifurcation", alternative, caption + events, page), {"criticality": branch.criticality, "branch": points})


def sensitivity(subject: Subject) -> Part:
    """Bars of what ten per cent more of each parameter do to both critical speeds."""
    subject.needs_hunting() if subject.stable else subject.needs_critical_speed()
    vehicle = subject.vehicle
    of = {} if subject.stable else {"linear critical speed": changes(vehicle, jax.grad(linear_critical_speed)(vehicle))}
    missing = ""
    try:
        branch = subject.hunting()
        if branch.fold is not None and (subject.stable or branch.fold.speed < subject.top):
            of["nonlinear critical speed"] = changes(vehicle, fold_gradient(branch))
    except NumericalError as error:
        missing = f" The nonlinear critical speed was not found: {error}."
    size = {path: max(abs(found[path]) for found in of.values()) for path in next(iter(of.values()))}
    paths = sorted(size, key=lambda path: -size[path])
    chosen = [path for path in paths[:BARS] if size[path] > LEAST * size[paths[0]]]
    left_out = paths[len(chosen) :]
    with figure(height=0.8 + 0.3 * len(chosen)) as (page, axes):
        bars = {kind: np.array([found[path] for path in chosen]) for kind, found in of.items()}
        labels = [parameter_label(vehicle, path) for path in chosen]
        tornado(axes[0, 0], labels, bars, "change for 10 % more of the parameter, km/h")
        # beside the labels there is no room for it above the axes, and within them it would hide bars
        axes[0, 0].get_legend().remove()
        page.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper right", ncols=len(bars))
    most = f"moves either by more than {size[left_out[0]]:.2g} km/h" if left_out and size[left_out[0]] else "has any part in them"
    rest = f" None of the other {len(left_out)} parameters {most}." if left_out else ""
    symbols = {path: entry.metadata["symbol"] for path, entry in parameters(vehicle)}
    caption = (
        "Exact gradients (through the fold of the limit cycles by the implicit function) times a tenth of each value, or the stated amount where it is zero. "
        f"Friction and flange have no part in the linear critical speed.{rest}{missing}"
    )
    alternative = f"Bars of the change of the critical speeds in km/h, sorted by size: {', '.join(symbols[path] for path in chosen[:5])} lead."
    first = paths[0]
    leading = next(kind for kind, found in of.items() if abs(found[first]) == size[first])
    entry = dict(parameters(vehicle))[first].metadata["meaning"]
    headline = [("strongest parameter", symbols[first], f"{entry}: {of[leading][first]:+.1f} km/h for 10 % more ({leading})")]
    return Part(drawn("sensitivity", alternative, caption, page), {"change_kmh_per_10_percent": of}, headline)
