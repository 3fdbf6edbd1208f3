"""`railjax reproduce`: run every study of the paper, keep what is finished, write results.json, figures and the report."""

import base64
import dataclasses
import importlib
import itertools
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax

from ...base.errors import InputError
from ...base.precision import require_double_precision
from ...base.programs import forget_compiled, return_memory
from ...base.source import digest_of_source
from ...base.text import without_nan
from ...base.whole_file import write_whole
from ...vehicles.files import load_vehicle
from . import page as report
from .study import STUDIES, Context, Outcome, Study

#: modules that define studies, in the paper's order; what one group has compiled is of no use to the next
GROUPS = (
    ("railjax.reports.paper.studies.passive",),
    ("railjax.reports.paper.studies.hunting", "railjax.reports.paper.studies.influence"),
    ("railjax.reports.paper.studies.damper", "railjax.reports.paper.studies.characteristics"),
    (
        "railjax.reports.paper.studies.semiactive",
        "railjax.reports.paper.studies.gain",
        "railjax.reports.paper.studies.controlled_hunting",
        "railjax.reports.paper.studies.comfort",
        "railjax.reports.paper.studies.acceptance",
    ),
    ("railjax.reports.paper.studies.tuning", "railjax.reports.paper.studies.steering"),
    ("railjax.reports.paper.studies.wheel_profile",),
)

Progress = Callable[[str, int, int], None]


def studies() -> list[Study]:
    """All studies, in the order of their modules and of their definition there, whoever imported them first."""
    modules = list(itertools.chain(*GROUPS))
    for module in modules:
        importlib.import_module(module)
    return sorted(STUDIES, key=lambda study: modules.index(study.run.__module__))


def reproduce(
    out: str | Path,
    *,
    only: list[str] | None = None,
    beyond: bool = False,
    fresh: bool = False,
    progress: Progress = lambda *_: None,
) -> dict[str, Any]:
    """Run the studies and write OUT/report.html, OUT/figures/*.png and OUT/results.json; returns the latter's content.

    The paper's own figures, numbers and statements; with `beyond` also what the paper does not have. `only` names the studies to
    run instead, of either kind. Each finished study is kept in OUT/parts, so that a run which was stopped goes on where it was, and what an
    earlier run made beyond the paper stays in the report; parts made by other code or another JAX are made anew (all that
    are run with `fresh`). `progress(title, done, total)` is called before each study and once at the end. Needs double precision.
    """
    require_double_precision("reproduce")
    listed = studies()
    names = [study.name for study in listed]
    for name in only or []:
        if name not in names:
            raise InputError(f"no study {name!r}; there are {', '.join(names)}")
    chosen = [study for study in listed if (study.name in only if only else beyond or not study.beyond)]
    out = Path(out)
    parts, figures = out / "parts", out / "figures"
    try:
        for folder in (parts, figures):
            folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--out {out}: cannot be made a folder ({error.strerror})") from None
    context = Context(load_vehicle("coach"), load_vehicle("coach-table1"))
    fingerprint = _fingerprint()
    made = {}
    for index, study in enumerate(chosen):
        progress(study.title, index, len(chosen))
        path = parts / f"{study.name}.json"
        part = None if fresh else _kept(path, fingerprint, figures)
        if part is None:
            path.unlink(missing_ok=True)  # or a stop here would leave an old part with half of a new figure
            started = time.perf_counter()
            part = _write(study, study.run(context), figures, fingerprint)
            part |= {"seconds": round(time.perf_counter() - started, 3), "peak_memory_mb": _peak_memory()}
            write_whole(path, json.dumps(part, indent=1))
            last_of_group = index + 1 == len(chosen) or _group(chosen[index + 1]) != _group(study)
            (forget_compiled if last_of_group else return_memory)()
        made[study.name] = part
    progress("report", len(chosen), len(chosen))
    if not only:
        made |= {
            study.name: part
            for study in listed
            if study.name not in made and (part := _kept(parts / f"{study.name}.json", fingerprint, figures)) is not None
        }
    found = [(study, made[study.name]) for study in listed if study.name in made]
    results = without_nan(_collect([part for _, part in found]))
    pictures = [
        {
            **picture,
            "png": base64.b64encode((figures / f"{picture['slug']}.png").read_bytes()).decode(),
            "section": "beyond" if study.beyond else "figures",
        }
        for study, part in found
        for picture in part["pictures"]
    ]
    write_whole(out / "results.json", json.dumps(results, indent=1) + "\n")
    write_whole(out / "report.html", report.render(results, pictures))
    return results


def _group(study: Study) -> int:
    return next((k for k, modules in enumerate(GROUPS) if study.run.__module__ in modules), -1)


def _peak_memory() -> float | None:
    """Largest resident memory of this process so far, MB; None where the system does not say."""
    try:
        import resource
    except ImportError:  # Windows
        return None
    unit = 1 if sys.platform == "darwin" else 1024
    return float(round(unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6))


def _fingerprint() -> str:
    """Changes with railjax's own files and JAX's version: what a kept part must have been made with."""
    return f"{digest_of_source('cli')} {jax.__version__}"


def _kept(path: Path, fingerprint: str, figures: Path) -> dict[str, Any] | None:
    try:
        part = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    if not isinstance(part, dict) or part.get("fingerprint") != fingerprint:
        return None
    drawn = all((figures / f"{picture['slug']}.png").is_file() for picture in part["pictures"])
    return part if drawn else None


def _write(study: Study, outcome: Outcome, figures: Path, fingerprint: str) -> dict[str, Any]:
    for picture in outcome.pictures:
        picture.figure.savefig(figures / f"{picture.slug}.png")
    return {
        "study": study.name,
        "fingerprint": fingerprint,
        "quantities": [quantity.as_dict() for quantity in outcome.quantities],
        "statements": [dataclasses.asdict(statement) for statement in outcome.statements],
        "pictures": [
            {key: getattr(picture, key) for key in ("slug", "title", "caption", "alternative")} for picture in outcome.pictures
        ],
        "assumptions": outcome.assumptions,
    }


def _collect(parts: list[dict[str, Any]]) -> dict[str, Any]:
    from ...base.version import __version__

    quantities = [quantity for part in parts for quantity in part["quantities"]]
    statements = [statement for part in parts for statement in part["statements"]]
    assumptions = list(dict.fromkeys(entry for part in parts for entry in part["assumptions"]))
    predicted = [q for q in quantities if q["within"] is not None and not q["fitted"]]
    fitted = sum(q["fitted"] for q in quantities)
    summary = (
        f"{sum(q['within'] for q in predicted)} of {len(predicted)} predicted quantities lie within their tolerance, {fitted} more "
        f"{'was' if fitted == 1 else 'were'} fitted; {sum(s['holds'] for s in statements)} of {len(statements)} statements of the paper agree with the model."
    )
    return {
        "railjax": __version__,
        "jax": jax.__version__,
        "summary": summary,
        "quantities": quantities,
        "statements": statements,
        "figures": [picture["slug"] for part in parts for picture in part["pictures"]],
        "assumptions": assumptions,
        "seconds": {part["study"]: part["seconds"] for part in parts},
        "peak_memory_mb": {part["study"]: part["peak_memory_mb"] for part in parts},
    }
