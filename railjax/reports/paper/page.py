"""The report of `railjax reproduce`."""

from collections.abc import Sequence
from typing import Any

from ...base.text import number
from ..vehicle.page import Section, bullets, figure, joined, marked, page, paragraph, png_uri, remarked, table


def render(results: dict[str, Any], pictures: Sequence[dict[str, str]]) -> str:
    """The page for the content of results.json and the pictures (slug, title, caption, alternative, base64 PNG in "png", and the
    "section", "figures" or "beyond" for those that the paper does not have)."""
    compared = [q for q in results["quantities"] if q["paper"] is not None]
    others = [q for q in results["quantities"] if q["paper"] is None]
    figures, beyond = ([p for p in pictures if p["section"] == section] for section in ("figures", "beyond"))
    note = (
        "A fitted number was a target of the calibration: its agreement says nothing about the model. "
        "Everything else follows from the model and the assumptions below."
    )
    sections = [
        Section("comparison", "Paper and railjax", paragraph(note) + _quantities(compared)),
        Section("statements", "What the paper says in words", _statements(results["statements"])),
        Section("figures", "Figures", _figures(figures), _entries(figures)),
        Section("beyond", "Beyond the paper", _figures(beyond), _entries(beyond)),
        Section("numbers", "Numbers that the paper does not give", _numbers(others)),
        Section("assumptions", "Assumptions", bullets(results["assumptions"])),
        Section("time", "What each study took", _time(results)),
    ]
    given = {
        "comparison": compared,
        "statements": results["statements"],
        "figures": figures,
        "beyond": beyond,
        "numbers": others,
        "assumptions": results["assumptions"],
        "time": results["seconds"],
    }
    # of a few studies alone, some are empty
    sections = [part for part in sections if given[part.slug]]
    heading = f"A magneto-rheological hybrid damper for railway vehicle suspensions: reproduced with railjax {results['railjax']}"
    return page("railjax: reproduction", heading, paragraph(results["summary"]), sections, f"JAX {results['jax']}")


def _kind(quantity: dict[str, Any]) -> str:
    return marked("fitted", "fitted") if quantity["fitted"] else "predicted"


def _quantities(quantities: Sequence[dict[str, Any]]) -> str:
    rows = []
    for q in quantities:
        difference = f"{q['computed'] - q['paper']:+.3g}" if q["computed"] is not None else "-"
        verdict = {None: "-", True: marked("yes", "yes"), False: marked("no", "no")}[q["within"]]
        tolerance = "" if q["tolerance"] is None else f" (±{q['tolerance']:g})"
        numbers = number(q["paper"]), number(q["computed"]), difference
        rows.append((remarked(q["name"], q["source"]), *numbers, q["unit"], _kind(q), verdict + tolerance))
    head = ("Quantity", "Paper", "railjax", "Difference", "Unit", "Fitted or predicted", "Within tolerance")
    return table(head, rows, numbers=(1, 2, 3))


def _figures(pictures: Sequence[dict[str, str]]) -> str:
    return joined(figure(p["slug"], p["title"], p["alternative"], p["caption"], png_uri(p["png"])) for p in pictures)


def _entries(pictures: Sequence[dict[str, str]]) -> list[tuple[str, str]]:
    return [(p["slug"], p["title"]) for p in pictures]


def _numbers(quantities: Sequence[dict[str, Any]]) -> str:
    rows = [(remarked(q["name"], q["source"]), number(q["computed"]), q["unit"], _kind(q)) for q in quantities]
    return table(("Quantity", "railjax", "Unit", "Fitted or predicted"), rows, numbers=(1,))


def _statements(statements: Sequence[dict[str, Any]]) -> str:
    verdicts = {True: marked("yes", "agrees"), False: marked("no", "does not agree")}
    rows = [(remarked(s["claim"], s["source"]), verdicts[s["holds"]], s["numbers"]) for s in statements]
    return table(("The paper", "The model", "Numbers"), rows)


def _time(results: dict[str, Any]) -> str:
    """Studies by the name that `--only` takes; those kept from an earlier run with what they took then."""
    seconds, memory = results["seconds"], results["peak_memory_mb"]
    rows = [(name, f"{seconds[name]:.1f}", number(memory[name])) for name in seconds]
    head = ("Study", "Wall time, s", "Largest memory of the process until its end, MB")
    return table(head, [*rows, ("together", f"{sum(seconds.values()):.1f}", "")], numbers=(1, 2))
