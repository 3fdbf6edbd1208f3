"""`railjax reproduce`: run every study of the paper, keep what is finished, write results.json, figures and the report."""

import base64
import dataclasses
import hashlib
import importlib
import json
import time
from collections.abc import Callable, Iterator
from importlib import resources
from pathlib import Path
from typing import Any

import jax

from . import report
from .errors import InputError
from .precision import require_double_precision
from .study import STUDIES, Context, Outcome, Study
from .vehicle_files import load_vehicle

#: modules that define studies, in the paper's order
MODULES = (
    "railjax.paper_passive",
    "railjax.paper_hunting",
    "railjax.paper_influence",
    "railjax.paper_damper",
    "railjax.paper_characteristics",
    "railjax.paper_semiactive",
    "railjax.paper_gain",
    "railjax.paper_controlled_hunting",
    "railjax.paper_comfort",
    "railjax.paper_acceptance",
    "railjax.paper_tuning",
)

Progress = Callable[[str, int, int], None]


def studies() -> list[Study]:
    """All studies, in the order of their definition."""
    for module in MODULES:
        importlib.import_module(module)
    return list(STUDIES)


def reproduce(
    out: str | Path,
    *,
    only: list[str] | None = None,
    fresh: bool = False,
    progress: Progress = lambda *_: None,
) -> dict[str, Any]:
    """Run the studies and write OUT/report.html, OUT/figures/*.png and OUT/results.json; returns the latter's content.

    Each finished study is kept in OUT/parts, so that a run which was stopped goes on where it was; parts made by other code or
    another JAX are made anew (all of them with `fresh`). `only` names the studies to run. `progress(title, done, total)` is
    called before each study and once at the end. Needs double precision.
    """
    require_double_precision("reproduce")
    chosen = studies()
    if only:
        names = [study.name for study in chosen]
        for name in only:
            if name not in names:
                raise InputError(f"no study {name!r}; there are {', '.join(names)}")
        chosen = [study for study in chosen if study.name in only]
    out = Path(out)
    parts, figures = out / "parts", out / "figures"
    try:
        for folder in (parts, figures):
            folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"--out {out}: cannot be made a folder ({error.strerror})") from None
    context = Context(load_vehicle("coach"), load_vehicle("coach-table1"))
    fingerprint = _fingerprint()
    found = []
    for index, study in enumerate(chosen):
        progress(study.title, index, len(chosen))
        path = parts / f"{study.name}.json"
        part = None if fresh else _kept(path, fingerprint, figures)
        if part is None:
            path.unlink(missing_ok=True)  # or a stop here would leave an old part with half of a new figure
            started = time.perf_counter()
            outcome = study.run(context)
            part = _write(study, outcome, figures, fingerprint, time.perf_counter() - started)
            _replace(path, json.dumps(part, indent=1))
        found.append(part)
    progress("report", len(chosen), len(chosen))
    results = report.without_nan(_collect(found))
    pictures = [
        {**picture, "png": base64.b64encode((figures / f"{picture['slug']}.png").read_bytes()).decode()}
        for part in found
        for picture in part["pictures"]
    ]
    _replace(out / "results.json", json.dumps(results, indent=1) + "\n")
    _replace(out / "report.html", report.render(results, pictures))
    return results


def _fingerprint() -> str:
    """Changes with railjax's own files and JAX's version: what a kept part must have been made with."""
    digest = hashlib.sha256(jax.__version__.encode())
    for path in sorted(_files(resources.files("railjax")), key=str):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _files(folder: Any) -> Iterator[Any]:
    for entry in folder.iterdir():
        if entry.is_dir() and entry.name != "__pycache__":
            yield from _files(entry)
        elif entry.name.endswith((".py", ".toml")):
            yield entry


def _kept(path: Path, fingerprint: str, figures: Path) -> dict[str, Any] | None:
    try:
        part = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    if not isinstance(part, dict) or part.get("fingerprint") != fingerprint:
        return None
    drawn = all((figures / f"{picture['slug']}.png").is_file() for picture in part["pictures"])
    return part if drawn else None


def _write(study: Study, outcome: Outcome, figures: Path, fingerprint: str, seconds: float) -> dict[str, Any]:
    for picture in outcome.pictures:
        picture.figure.savefig(figures / f"{picture.slug}.png")
    return {
        "study": study.name,
        "fingerprint": fingerprint,
        "seconds": round(seconds, 3),
        "quantities": [quantity.to_json() for quantity in outcome.quantities],
        "statements": [dataclasses.asdict(statement) for statement in outcome.statements],
        "pictures": [
            {key: getattr(picture, key) for key in ("slug", "title", "caption", "alternative")} for picture in outcome.pictures
        ],
        "assumptions": outcome.assumptions,
    }


def _replace(path: Path, text: str) -> None:
    """Write all or nothing, so that a run stopped here leaves no half file."""
    beside = path.with_suffix(path.suffix + ".tmp")
    beside.write_text(text, encoding="utf-8")
    beside.replace(path)


def _collect(parts: list[dict[str, Any]]) -> dict[str, Any]:
    from . import __version__

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
    }
