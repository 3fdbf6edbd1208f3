"""The sections of a vehicle's report on its data, modes, critical speeds, hunting and sensitivities."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from html import escape
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import numpy as np

from .courses import of_mode
from .errors import NumericalError
from .hunting import Branch, hunting_branch
from .linear import HIGHEST, LinearCritical, Stability, linear_critical, linear_critical_speed
from .modes import Modes, modes, root_locus
from .plots import figure, locus, tornado
from .report_page import figure as picture
from .report_page import paragraph, svg_uri, table
from .sensitivity import changes, fold_gradient, parameter_label
from .top_view import TopView, magnification
from .units import KMH
from .vehicle import Vehicle, get_parameter, parameters

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: of the linear critical speed: the speed at which modes and comfort are given if none is named, and the range of the root locus
SERVICE, LOCUS = 0.75, (0.15, 1.25)
#: m/s; the speed instead, and the top of all ranges, where no linear critical speed is found
NO_CRITICAL = 300.0 / KMH
#: parameters in the chart of sensitivities
BARS = 18


class Absent(Exception):
    """A section that this vehicle cannot have, and why."""


class Part(NamedTuple):
    """What a section says: HTML, the numbers behind it for JSON, and its key figures (name, value, remark)."""

    body: str
    numbers: dict[str, Any]
    headline: Sequence[tuple[str, str, str]] = ()


@dataclass
class Subject:
    """What a report is about, and what several sections need, computed once."""

    vehicle: Vehicle
    asked: float | None  # m/s
    spectrum: str
    _hunting: Any = field(default=None, repr=False)

    @cached_property
    def linear(self) -> LinearCritical:
        """With a result code instead of an error."""
        return linear_critical(self.vehicle)

    @property
    def stable(self) -> bool:
        """Whether no speed makes straight running unstable."""
        return int(self.linear.code) == Stability.STABLE

    @property
    def top(self) -> float:
        """Linear critical speed, or a usual top speed where there is none, m/s."""
        return float(self.linear.speed) if int(self.linear.code) == Stability.OK else NO_CRITICAL

    @property
    def speed(self) -> float:
        """At which modes and comfort are given, m/s: as asked, else three quarters of the critical speed in tens of km/h."""
        return max(round(SERVICE * self.top * KMH, -1), 10.0) / KMH if self.asked is None else self.asked

    def hunting(self) -> Branch:
        """The branch of limit cycles; the same `NumericalError` again where there is none."""
        if self._hunting is None:
            try:
                self._hunting = hunting_branch(self.vehicle)
            except NumericalError as error:
                self._hunting = error
        if isinstance(self._hunting, NumericalError):
            raise self._hunting
        return self._hunting

    def needs_critical_speed(self) -> float:
        """The linear critical speed, m/s; `Absent` for a vehicle that is stable at all speeds, `NumericalError` for none found."""
        if self.stable:
            raise Absent(f"Straight running is stable up to {HIGHEST * KMH:.0f} km/h, so no limit cycle branches off it.")
        return float(linear_critical_speed(self.vehicle))


def drawn(slug: str, alternative: str, caption: str, page: "Figure", tall: bool = False) -> str:
    """A figure of the report, whose title is the section's."""
    return picture(f"{slug}-figure", "", alternative, caption, svg_uri(page), tall)


def shown(value: float, unit: str) -> tuple[str, str]:
    """Value and unit as engineers write them: kN/m or MN/m, mm for what is small."""
    if unit.startswith("N"):
        factor, prefix = next((f, p) for f, p in ((1e6, "M"), (1e3, "k"), (1.0, "")) if abs(value) >= f or f == 1.0)
        return f"{value / factor:.6g}", prefix + unit
    if unit == "m" and 0.0 < abs(value) < 0.05:
        return f"{1e3 * value:.6g}", "mm"
    return f"{value:.6g}", "" if unit == "1" else unit


def _cells(vehicle: Vehicle, path: str, entry: Any) -> tuple[str, str, str, str]:
    """Meaning, symbol, value and unit of a parameter, as HTML."""
    about, value = entry.metadata, np.asarray(get_parameter(vehicle, path), float)
    pairs = [shown(float(one), about["unit"]) for one in np.ravel(value)]
    text = ", ".join(number for number, _ in pairs) if len({unit for _, unit in pairs}) == 1 else ", ".join(map(" ".join, pairs))
    unit = pairs[0][1].replace("^2", "²")
    return escape(about["meaning"]), escape(about["symbol"].replace("_", " ").replace(" ", "_")), escape(text), escape(unit)


def about(subject: Subject) -> Part:
    """What the vehicle is, and which of its values are not from its source."""
    vehicle = subject.vehicle
    entries = dict(parameters(vehicle))
    rows = []
    for origin in vehicle.provenance:
        if origin.status != "published" and origin.parameter in entries:
            meaning, symbol, text, unit = _cells(vehicle, origin.parameter, entries[origin.parameter])
            rows.append(
                (meaning, symbol, f"{text} {unit}", f'<span class="{origin.status}">{origin.status}</span>', escape(origin.note))
            )
    lines = "".join(paragraph(line.strip()) for line in str(vehicle).splitlines() if "not from the source" not in line)
    note = paragraph(vehicle.note) if vehicle.note else ""
    if rows:
        kinds = ", ".join(dict.fromkeys(p.status for p in vehicle.provenance if p.status != "published"))
        said = f"{len(rows)} values are not from the vehicle's source ({kinds}). What rests on calibrated values is no prediction of them."
        origin_table = paragraph(said) + table(("Parameter", "Symbol", "Value", "Status", "Why"), rows)
    else:
        origin_table = paragraph("The file says of no value that it is assumed, recalled or calibrated.")
    numbers = {
        "note": vehicle.note,
        "provenance": [{"parameter": p.parameter, "status": p.status, "note": p.note} for p in vehicle.provenance],
    }
    return Part(lines + note + origin_table, numbers)


def all_parameters(subject: Subject) -> Part:
    """Every number of the vehicle."""
    vehicle = subject.vehicle
    status = {origin.parameter: origin.status for origin in vehicle.provenance}
    rows = []
    for path, entry in parameters(vehicle):
        kind = status.get(path, "")
        rows.append((*_cells(vehicle, path, entry), f'<span class="{kind}">{kind}</span>', f"<code>{escape(path)}</code>"))
    body = table(("Parameter", "Symbol", "Value", "Unit", "Status", "Name in railjax"), rows, numbers=(2,))
    note = "Springs and dampers are per side: a bogie has two secondary corners, a wheelset two axle boxes. Creep coefficients are per wheel."
    values = {path: np.asarray(get_parameter(vehicle, path), float).tolist() for path, _ in parameters(vehicle)}
    return Part(paragraph(note) + body, {"si": values})


def modal(subject: Subject) -> Part:
    """Table of the modes at the speed of the report, and the critical mode's shape from above."""
    vehicle, speed = subject.vehicle, subject.speed
    found = modes(vehicle, speed)
    shape = modes(vehicle, subject.top)
    listed = [k for k in range(len(found.names)) if found.frequency[k] > 0.0 and found.damping_ratio[k] < 0.9]
    rows = [
        (
            escape(found.names[k]),
            f"{found.frequency[k]:.3f}",
            f"{100.0 * found.damping_ratio[k]:.2f}",
            f"{found.eigenvalues[k].real:.3f}",
        )
        for k in listed
    ]
    body = table(("Mode", "Frequency, Hz", "Damping, %", "Growth, 1/s"), rows, numbers=(1, 2, 3))
    left_out = len(found.names) - len(listed)
    text = f"At {speed * KMH:.0f} km/h, least damped first." + (f" {left_out} overdamped ones are left out." if left_out else "")
    oscillating = next((k for k in range(len(shape.names)) if shape.frequency[k] > 0.0), None)
    view = "" if oscillating is None else _shape_picture(vehicle, shape, oscillating)
    numbers = [
        {"name": name, "frequency_hz": float(f), "damping_ratio": float(z), "growth_per_s": float(value.real)}
        for name, f, z, value in zip(found.names, found.frequency, found.damping_ratio, found.eigenvalues, strict=True)
    ]
    return Part(paragraph(text) + body + view, {"speed_kmh": speed * KMH, "modes": numbers})


def _shape_picture(vehicle: Vehicle, found: Modes, mode: int) -> str:
    course = of_mode(vehicle, found, mode)
    at = f"{found.names[mode]}, {found.frequency[mode]:.2f} Hz, at {found.speed * KMH:.1f} km/h"
    with figure(rows=2, height=2.0 if not vehicle.carbody.held else 2.6) as (page, axes):
        for row, (frame, title) in enumerate(((0, ""), (len(course.time) // 4, ", a quarter of a period later"))):
            view = TopView(axes[row, 0], vehicle, magnification(8e-3))
            view.show({name: values[frame] for name, values in course.coordinates.items()}, float(course.distance[frame]))
            axes[row, 0].set_title(found.names[mode] + title, loc="left", fontsize=9.5)
    alternative = (
        f"The vehicle from above in the shape of its least damped mode, {at}, at two instants a quarter of a period apart."
    )
    caption = f"The least damped mode ({at}) from above, the vehicle running to the right; its amplitude is arbitrary, yaw on the same scale as displacements."
    return drawn("modes", alternative, caption, page)


def loci(subject: Subject) -> Part:
    """Damping over speed, and the eigenvalues in the complex plane."""
    speeds = np.linspace(*LOCUS, 45) * subject.top
    found = root_locus(subject.vehicle, speeds)
    with figure(rows=2, height=4.2) as (page, axes):
        locus(axes[0, 0], found, limit=0.5)
        axes[0, 0].set_ylim(max(min(-4.0, 100.0 * found.damping_ratio.min()), -30.0), 55.0)
        colours = _plane(axes[1, 0], found)
        page.colorbar(colours, ax=axes[1, 0], label="speed, km/h", pad=0.01)
    crossing = "" if subject.stable else f" The critical mode crosses zero at {subject.top * KMH:.1f} km/h."
    caption = (
        "Above: damping ratio of the modes that are ever damped less than 50 %, tracked by the overlap of their eigenvectors; twins of bogies in phase and in "
        f"opposition share a colour.{crossing} Below: the same eigenvalues in the complex plane; to the right of the line straight running is unstable."
    )
    alternative = f"Damping ratio over speed from {speeds[0] * KMH:.0f} to {speeds[-1] * KMH:.0f} km/h, and root locus with speed as colour."
    tracked = [
        {"name": name, "growth_per_s": column.real.tolist(), "frequency_hz": (np.abs(column.imag) / (2.0 * np.pi)).tolist()}
        for name, column in zip(found.names, found.eigenvalues.T, strict=True)
    ]
    return Part(drawn("root-locus", alternative, caption, page), {"speeds_kmh": (speeds * KMH).tolist(), "modes": tracked})


def _plane(axes: Any, found: Any) -> Any:
    """The root locus of frequencies up to 15 Hz or twice that of the critical mode; returns the colours for their bar."""
    real, frequency = found.eigenvalues.real, np.abs(found.eigenvalues.imag) / (2.0 * np.pi)
    critical = np.unravel_index(np.argmax(real), real.shape)
    highest = max(2.0 * frequency[critical], 3.0)
    speeds = np.broadcast_to(found.speeds[:, None] * KMH, real.shape)
    colours = axes.scatter(real, frequency, c=speeds, s=7, cmap="viridis", linewidths=0)
    axes.axvline(0.0, color="0.2", linewidth=0.8)
    near = (frequency < highest) & (real > -60.0)
    left = max(float(real[near].min()), -30.0) if near.any() else -30.0
    axes.set(
        xlabel="real part, 1/s",
        ylabel="frequency, Hz",
        xlim=(1.05 * left, max(1.15 * float(real.max()), 1.0)),
        ylim=(0.0, highest),
    )
    return colours


def critical_speeds(subject: Subject) -> Part:
    """Linear and nonlinear; where the latter fails, what is known."""
    if subject.stable:
        text = f"Straight running is stable up to {HIGHEST * KMH:.0f} km/h: no critical speed."
        return Part(paragraph(text), {"linear_kmh": None}, [("critical speed", "none", f"stable up to {HIGHEST * KMH:.0f} km/h")])
    speed = subject.needs_critical_speed()
    at = modes(subject.vehicle, speed)
    frequency, name = float(at.frequency[0]), at.names[0]
    kmh = f"{speed * KMH:.1f} km/h"
    numbers: dict[str, Any] = {"linear_kmh": speed * KMH, "frequency_hz": frequency, "mode": name}
    rows = [("linear: straight running loses its stability", kmh, f"{frequency:.2f} Hz", escape(name))]
    headline = [("linear critical speed", kmh, f"{name}, {frequency:.2f} Hz")]
    try:
        branch = subject.hunting()
    except NumericalError as error:
        said = paragraph(f"The nonlinear critical speed was not found: {error}.", "failed")
        numbers["nonlinear_kmh"] = None
    else:
        fold = branch.fold
        folded = fold is not None and fold.speed < speed
        lowest = fold.speed if folded else speed
        numbers |= {"nonlinear_kmh": lowest * KMH, "criticality": branch.criticality}
        numbers |= {"fold_amplitude_mm": 1e3 * fold.amplitude, "fold_frequency_hz": fold.frequency} if folded else {}
        of = f"{fold.frequency:.2f} Hz" if folded else "-"
        what = f"fold of the limit cycles at {1e3 * fold.amplitude:.2f} mm" if folded else "no fold: that of the linear theory"
        rows.append(("nonlinear: below it nothing makes the vehicle hunt", f"{lowest * KMH:.1f} km/h", of, what))
        headline.append(("nonlinear critical speed", f"{lowest * KMH:.1f} km/h", what))
        said = paragraph(
            f"Between the two a disturbance that is large enough makes the vehicle hunt, a small one dies out: {(speed - lowest) * KMH:.1f} km/h that "
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
    subject.needs_critical_speed()
    branch = subject.hunting()
    with figure(height=4.4) as (page, axes):
        branch.plot(axes[0, 0])
    caption = (
        f"Amplitude of wheelset {branch.wheelset + 1} from the front over speed: stable limit cycles solid, unstable ones dashed. The Hopf point is {branch.criticality}. "
        f"Error of the Floquet multipliers at most {max(point.floquet.error for point in branch.points):.0e}. {branch.note}"
    )
    events = "".join(f" {event.kind} at {event.speed * KMH:.1f} km/h." for event in branch.events)
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
    subject.needs_critical_speed()
    vehicle = subject.vehicle
    of = {"linear critical speed": changes(vehicle, jax.grad(linear_critical_speed)(vehicle))}
    missing = ""
    try:
        branch = subject.hunting()
        if branch.fold is not None and branch.fold.speed < subject.top:
            of["nonlinear critical speed"] = changes(vehicle, fold_gradient(branch))
    except NumericalError as error:
        missing = f" The nonlinear critical speed was not found: {error}."
    size = {path: max(abs(found[path]) for found in of.values()) for path in of["linear critical speed"]}
    paths = sorted(size, key=lambda path: -size[path])
    chosen = paths[:BARS]
    with figure(height=0.8 + 0.3 * len(chosen)) as (page, axes):
        bars = {kind: np.array([found[path] for path in chosen]) for kind, found in of.items()}
        tornado(
            axes[0, 0], [parameter_label(vehicle, path) for path in chosen], bars, "change for 10 % more of the parameter, km/h"
        )
    rest = (
        f" The other {len(paths) - BARS} parameters move neither by more than {size[paths[BARS]]:.2g} km/h."
        if len(paths) > BARS
        else ""
    )
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
    return Part(drawn("sensitivity", alternative, caption, page, tall=True), {"change_kmh_per_10_percent": of}, headline)


#: slug, title and function; the ride's follow in `report_ride`
SECTIONS: list[tuple[str, str, Callable[[Subject], Part]]] = [
    ("vehicle", "The vehicle", about),
    ("modes", "Modes", modal),
    ("root-locus", "Root locus", loci),
    ("critical-speeds", "Critical speeds", critical_speeds),
    ("bifurcation", "Bifurcation diagram", bifurcation),
    ("sensitivity", "Which parameters decide the critical speeds", sensitivity),
]
