"""The sections of a vehicle's report on its data and modes."""

from typing import Any

import numpy as np
from jaxtyping import Float

from ....base.style import figure
from ....base.units import KMH
from ....model.parameters import get_parameter, parameters
from ....model.vehicle import Vehicle
from ....plots.frames import MODE_AMPLITUDE, of_mode
from ....plots.top_view import TopView, magnification
from ....stability.modes import Modes, RootLocus, modes, root_locus
from ..page import code, indexed, joined, marked, paragraph, table
from ..subject import Part, Subject, drawn

#: of the linear critical speed: the range of the root locus
LOCUS = (0.15, 1.25)


def shown(value: Float[np.ndarray, "*points"], unit: str) -> tuple[str, str]:
    """Value (or a table's values) and unit as engineers write them: kN/m or MN/m, mm for what is small."""
    values = np.atleast_1d(value)
    largest, factor, name = np.max(np.abs(values)), 1.0, "" if unit == "1" else unit.replace("^2", "²")
    if unit.startswith("N"):
        factor, prefix = next(((f, p) for f, p in ((1e6, "M"), (1e3, "k")) if largest >= f), (1.0, ""))
        name = prefix + name
    elif unit == "m" and 0.0 < largest < 0.1 and (values.size > 1 or largest < 0.05):
        factor, name = 1e-3, "mm"
    return ", ".join(f"{one / factor:.6g}" for one in values), name


def _cells(vehicle: Vehicle, path: str, entry: Any) -> tuple[str, str, str, str]:
    """Meaning, symbol, value and unit of a parameter."""
    text, unit = shown(np.asarray(get_parameter(vehicle, path), float), entry.metadata["unit"])
    return entry.metadata["meaning"], symbol(entry.metadata["symbol"]), text, unit


def symbol(plain: str) -> str:
    """A parameter's symbol as HTML: rho_ox as ρ with its index below."""
    letters = {"rho": "ρ", "mu": "μ", "lambda": "λ", "delta": "δ"}
    name, _, index = plain.partition("_")
    return indexed(letters.get(name, name), index)


def about(subject: Subject) -> Part:
    """What the vehicle is, and which of its values are not from its source."""
    vehicle = subject.vehicle
    entries = dict(parameters(vehicle))
    rows = []
    for origin in vehicle.provenance:
        if origin.status != "published" and origin.parameter in entries:
            meaning, symbol, text, unit = _cells(vehicle, origin.parameter, entries[origin.parameter])
            rows.append((meaning, symbol, f"{text} {unit}", marked(origin.status, origin.status), origin.note))
    lines = joined(paragraph(line.strip()) for line in str(vehicle).splitlines() if "not from the source" not in line)
    note = paragraph(vehicle.note) if vehicle.note else ""
    if rows:
        kinds = ", ".join(dict.fromkeys(p.status for p in vehicle.provenance if p.status != "published"))
        calibrated = " What calibrated values were fitted to is no prediction." if "calibrated" in kinds else ""
        said = f"{len(rows)} values are not from the vehicle's source ({kinds}).{calibrated}"
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
    # the file gives no numbers for bodies that do not move
    free = [
        (path, entry) for path, entry in parameters(vehicle) if not getattr(getattr(vehicle, path.split(".")[0]), "held", False)
    ]
    for path, entry in free:
        kind = status.get(path, "")
        rows.append((*_cells(vehicle, path, entry), marked(kind, kind), code(path)))
    body = table(("Parameter", "Symbol", "Value", "Unit", "Status", "Name in railjax"), rows, numbers=(2,))
    note = "Springs and dampers are per side: a bogie has two secondary corners, a wheelset two axle boxes. Creep coefficients are per wheel."
    values = {path: np.asarray(get_parameter(vehicle, path), float).tolist() for path, _ in free}
    return Part(paragraph(note) + body, {"si": values})


def modal(subject: Subject) -> Part:
    """Table of the modes at the speed of the report, and the critical mode's shape from above."""
    vehicle, speed = subject.vehicle, subject.speed
    found = modes(vehicle, speed)
    shape = modes(vehicle, subject.top)
    listed = [k for k in range(len(found.names)) if found.frequency[k] > 0.0 and found.damping_ratio[k] < 0.9]
    rows = [
        (
            found.names[k],
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
    with figure(rows=2, height=2.8 if vehicle.carbody.held else 2.1) as (page, axes):
        for row, (frame, title) in enumerate(((0, ""), (len(course.time) // 4, ", a quarter of a period later"))):
            view = TopView(axes[row, 0], vehicle, magnification(MODE_AMPLITUDE))
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
    with figure(rows=2, height=3.9) as (page, axes):
        found.plot(axes[0, 0], limit=0.5)
        axes[0, 0].set_ylim(max(min(-4.0, 100.0 * found.damping_ratio.min()), -30.0), 55.0)
        colours = _plane(axes[1, 0], found)
        page.colorbar(colours, ax=axes[1, 0], label="speed, km/h", pad=0.01)
    crossing = "" if subject.stable else f" The critical mode crosses zero at {subject.top * KMH:.1f} km/h."
    caption = (
        "Above: damping ratio of the modes that are ever damped less than 50 %, tracked by the overlap of their eigenvectors; twins of bogies in phase and in "
        f"opposition share a colour.{crossing} Below: the same eigenvalues in the complex plane; those on the right of the line are unstable."
    )
    alternative = f"Damping ratio over speed from {speeds[0] * KMH:.0f} to {speeds[-1] * KMH:.0f} km/h, and root locus with speed as colour."
    tracked = [
        {"name": name, "growth_per_s": column.real.tolist(), "frequency_hz": (np.abs(column.imag) / (2.0 * np.pi)).tolist()}
        for name, column in zip(found.names, found.eigenvalues.T, strict=True)
    ]
    return Part(drawn("root-locus", alternative, caption, page), {"speeds_kmh": (speeds * KMH).tolist(), "modes": tracked})


def _plane(axes: Any, found: RootLocus) -> Any:
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
