"""The report of `railjax reproduce`: one self-contained HTML page, readable on a phone and in print."""

import math
from collections.abc import Sequence
from html import escape
from typing import Any

CSS = """
:root { color-scheme: light; }
body { font: 16px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 0 auto; padding: 1rem; color: #1a1a1a; }
h1 { line-height: 1.2; } h2 { margin-top: 2.2rem; border-bottom: 1px solid #ddd; }
.scroll { overflow-x: auto; } table { border-collapse: collapse; width: 100%; font-size: .92rem; }
th, td { padding: .35rem .6rem; border-bottom: 1px solid #e3e3e3; text-align: left; vertical-align: top; }
td.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
figure { margin: 1.5rem 0; break-inside: avoid; } img { max-width: 100%; height: auto; }
figcaption { font-size: .9rem; color: #444; } .fitted { color: #8a4b00; } .no { color: #a00000; } .yes { color: #00603f; }
@media print { body { max-width: none; font-size: 11pt; } nav { display: none; } }
"""


def render(results: dict[str, Any], pictures: Sequence[dict[str, str]]) -> str:
    """The page for the content of results.json and the pictures (title, caption, alternative, base64 PNG in "png")."""
    sections = [
        ("comparison", "Paper and railjax", _quantities(results["quantities"])),
        ("statements", "What the paper says in words", _statements(results["statements"])),
        ("figures", "Figures", "\n".join(_picture(picture) for picture in pictures)),
        ("assumptions", "Assumptions", _list(results["assumptions"])),
    ]
    contents = "".join(f'<li><a href="#{name}">{escape(title)}</a></li>' for name, title, _ in sections)
    body = "".join(f'<section id="{name}"><h2>{escape(title)}</h2>{content}</section>' for name, title, content in sections)
    return (
        f'<!DOCTYPE html><html lang="en"><head><meta charset="utf-8">'
        f'<meta name="viewport" content="width=device-width, initial-scale=1"><title>railjax: reproduction</title>'
        f"<style>{CSS}</style></head><body><h1>A magneto-rheological hybrid damper for railway vehicle suspensions: "
        f"reproduced with railjax {escape(results['railjax'])}</h1>"
        f"<p>{escape(results['summary'])}</p><nav><ul>{contents}</ul></nav>{body}</body></html>\n"
    )


def without_nan(content: Any) -> Any:
    """The content with None for NaN and infinities, which JSON cannot hold."""
    if isinstance(content, dict):
        return {key: without_nan(value) for key, value in content.items()}
    if isinstance(content, list):
        return [without_nan(value) for value in content]
    return None if isinstance(content, float) and not math.isfinite(content) else content


def number(value: float | None) -> str:
    """As the report prints it: six digits, a dash where there is none."""
    if value is None:
        return "-"
    return f"{value:.6g}"


def _quantities(quantities: Sequence[dict[str, Any]]) -> str:
    rows = []
    for q in quantities:
        both = q["paper"] is not None and q["computed"] is not None
        difference = f"{q['computed'] - q['paper']:+.3g}" if both else "-"
        kind = '<span class="fitted">fitted</span>' if q["fitted"] else "predicted"
        verdict = {None: "-", True: '<span class="yes">yes</span>', False: '<span class="no">no</span>'}[q["within"]]
        tolerance = "" if q["tolerance"] is None else f" (±{q['tolerance']:g})"
        rows.append(
            f"<tr><td>{escape(q['name'])}<br><small>{escape(q['source'])}</small></td>"
            f'<td class="number">{number(q["paper"])}</td><td class="number">{number(q["computed"])}</td>'
            f'<td class="number">{difference}</td><td>{escape(q["unit"])}</td><td>{kind}</td><td>{verdict}{tolerance}</td></tr>'
        )
    head = "<tr><th>Quantity</th><th>Paper</th><th>railjax</th><th>Difference</th><th>Unit</th><th>Fitted or predicted</th><th>Within tolerance</th></tr>"
    note = (
        "<p>A fitted number was a target of the calibration: its agreement says nothing about the model. "
        "Everything else follows from the model and the assumptions below.</p>"
    )
    return f'{note}<div class="scroll"><table>{head}{"".join(rows)}</table></div>'


def _statements(statements: Sequence[dict[str, Any]]) -> str:
    rows = []
    for s in statements:
        verdict = '<span class="yes">agrees</span>' if s["holds"] else '<span class="no">does not agree</span>'
        rows.append(
            f"<tr><td>{escape(s['claim'])}<br><small>{escape(s['source'])}</small></td><td>{verdict}</td><td>{escape(s['numbers'])}</td></tr>"
        )
    head = "<tr><th>The paper</th><th>The model</th><th>Numbers</th></tr>"
    return f'<div class="scroll"><table>{head}{"".join(rows)}</table></div>'


def _picture(picture: dict[str, str]) -> str:
    return (
        f'<figure id="{escape(picture["slug"])}"><h3>{escape(picture["title"])}</h3>'
        f'<img alt="{escape(picture["alternative"])}" src="data:image/png;base64,{picture["png"]}">'
        f"<figcaption>{escape(picture['caption'])}</figcaption></figure>"
    )


def _list(entries: Sequence[str]) -> str:
    return "<ul>" + "".join(f"<li>{escape(entry)}</li>" for entry in entries) + "</ul>"
