"""`railjax report`: one self-contained page on any vehicle, and the numbers behind its figures.

report = railjax.vehicle_report(railjax.load_vehicle("coach"))
report.save("report.html")
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax

from ...base.arguments import ONE_SPEED, guarded
from ...base.batches import Batch
from ...base.checks import some_names
from ...base.errors import InputError, NumericalError
from ...base.precision import require_double_precision
from ...base.typing import Scalar
from ...base.units import KMH
from ...model.parameters import without_labels
from ...model.track.spectra import spectrum
from ...model.vehicle import Vehicle
from .page import Section, key_figures, page, paragraph
from .sections.hunting import bifurcation, critical_speeds, sensitivity
from .sections.ride import comfort_over_speed, passive_and_semiactive
from .sections.vehicle import about, all_parameters, loci, modal
from .subject import Absent, Part, Subject

#: name, title and function of each section
ALL: tuple[tuple[str, str, Callable[[Subject], Part]], ...] = (
    ("vehicle", "The vehicle", about),
    ("modes", "Modes", modal),
    ("root-locus", "Root locus", loci),
    ("critical-speeds", "Critical speeds", critical_speeds),
    ("bifurcation", "Bifurcation diagram", bifurcation),
    ("sensitivity", "Which parameters decide the critical speeds", sensitivity),
    ("comfort", "Comfort over speed", comfort_over_speed),
    ("dampers", "Passive against semi-active damper", passive_and_semiactive),
    ("parameters", "All parameters", all_parameters),
)
#: names of the sections, in their order
SECTIONS = tuple(slug for slug, *_ in ALL)


@dataclass(frozen=True)
class VehicleReport:
    """Result of `vehicle_report`: the page, and the numbers behind its figures.

    `content` is what JSON can hold: "vehicle", "speed_kmh", "track" and per section its numbers and "seconds" under "sections". `failed` names the
    sections that a `NumericalError` ended, `absent` those that this vehicle cannot have, each with the reason.
    """

    html: str
    content: dict[str, Any]
    failed: dict[str, str]
    absent: dict[str, str]

    @guarded()
    def save(self, out: str | Path) -> None:
        """Write the page. Raises `InputError` where it cannot be written."""
        try:
            Path(out).write_text(self.html, encoding="utf-8")
        except OSError as error:
            raise InputError(f"{out}: cannot be written ({error.strerror})") from None

    def __str__(self) -> str:
        lines = [f"Report on {self.content['vehicle'] or 'a vehicle'}: {len(self.content['sections'])} sections"]
        lines += [f"  {name}: {value} ({remark})" for name, value, remark in self.content["key_figures"]]
        lines += [f"  {slug} failed: {reason}" for slug, reason in self.failed.items()]
        return "\n".join(lines + [f"  without {slug}: {reason}" for slug, reason in self.absent.items()])


@guarded(speed=ONE_SPEED, track=None, sections=some_names)
def vehicle_report(
    vehicle: Vehicle,
    *,
    speed: Scalar | None = None,
    track: str = "erri-high",
    sections: Sequence[str] = SECTIONS,
    progress: Callable[[str, int, int], Any] | None = None,
) -> VehicleReport:
    """Parameters, modes, root locus, critical speeds, bifurcation diagram, sensitivities, comfort and dampers on one page.

    A section that a `NumericalError` ends is marked in the page and named in `failed`, the others are kept; one that the vehicle
    cannot have says why.

    Args:
        vehicle: a single vehicle, without lanes.
        speed: of modes and comfort, m/s; by default three quarters of the linear critical speed.
        track: spectrum of the ride's alignment, "erri-low", "erri-high" or "fra-1" to "fra-6".
        sections: which of `SECTIONS` the page has; by default all.
        progress: called as `progress(title, done, total)` before each section and once at the end.

    Raises:
        InputError: for lanes, an unknown section or track, a speed that is not positive, and in single precision.
    """
    require_double_precision("the report")
    if Batch.of(without_labels(vehicle)).lanes is not None:
        raise InputError("a report is on one vehicle; this one has lanes")
    for name in sections:
        if name not in SECTIONS:
            raise InputError(f"no section {name!r}; there are {', '.join(SECTIONS)}")
    spectrum(track)
    subject = Subject(vehicle, None if speed is None else float(speed), track)
    chosen = [entry for entry in ALL if entry[0] in sections]
    tell = (lambda *_: None) if progress is None else progress
    parts, failed, absent, seconds = {}, {}, {}, {}
    for done, (slug, title, make) in enumerate(chosen):
        tell(title, done, len(chosen))
        started = time.perf_counter()
        try:
            parts[slug] = make(subject)
        except NumericalError as error:
            failed[slug] = str(error)
        except Absent as reason:
            absent[slug] = str(reason)
        seconds[slug] = round(time.perf_counter() - started, 3)
    tell("page", len(chosen), len(chosen))
    return _put_together(subject, chosen, parts, failed, absent, seconds)


def _put_together(
    subject: Subject,
    chosen: list[tuple[str, str, Callable[[Subject], Part]]],
    parts: dict[str, Part],
    failed: dict[str, str],
    absent: dict[str, str],
    seconds: dict[str, float],
) -> VehicleReport:
    from ...base.version import __version__

    vehicle = subject.vehicle
    name = vehicle.name or "a vehicle"
    headlines = [entry for part in parts.values() for entry in part.headline]
    made = []
    for slug, title, _ in chosen:
        if slug in failed:
            body = paragraph(f"This section failed: {failed[slug]}.", "failed")
        else:
            body = paragraph(absent[slug], "absent") if slug in absent else parts[slug].body
        made.append(Section(slug, title, body))
    lead = paragraph("Lateral dynamics: stability, hunting and ride, computed with railjax.") + key_figures(headlines)
    footer = f"railjax {__version__}, JAX {jax.__version__}; made in {sum(seconds.values()):.0f} s."
    html = page(f"railjax: {name}", f"Report on {name}", lead, made, footer)
    content = {
        "vehicle": vehicle.name,
        "railjax": __version__,
        "jax": jax.__version__,
        "speed_kmh": subject.speed * KMH,
        "track": subject.spectrum,
        "key_figures": [list(entry) for entry in headlines],
        "sections": {slug: {**part.numbers, "seconds": seconds[slug]} for slug, part in parts.items()},
        "failed": failed,
        "absent": absent,
    }
    return VehicleReport(html, content, failed, absent)
