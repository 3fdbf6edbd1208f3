"""Self-contained HTML pages in one style, for a screen, a phone and in print: what `railjax reproduce` and `railjax report` share."""

import base64
import io
from collections.abc import Iterable, Sequence
from html import escape
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CSS = """
:root { color-scheme: light; }
* { box-sizing: border-box; }
body { font: 16px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 0 auto; padding: 1rem; color: #1a1a1a; overflow-wrap: break-word; }
h1 { line-height: 1.2; margin: .5rem 0; } h2 { margin-top: 2.4rem; border-bottom: 2px solid #0072b2; line-height: 1.3; }
h3 { margin: 1.6rem 0 .4rem; } a { color: #00588a; } small { color: #555; }
nav { border: 1px solid #ddd; border-radius: .4rem; padding: .2rem 1rem; margin: 1.2rem 0; }
nav ul { padding-left: 1.1rem; margin: .5rem 0; } nav > ul { columns: 17rem 2; } nav ul ul { font-size: .9rem; } nav ul ul li { break-inside: avoid; }
.scroll { overflow-x: auto; margin: 1rem 0; } table { border-collapse: collapse; width: 100%; font-size: .92rem; }
th, td { padding: .3rem .6rem; border-bottom: 1px solid #e3e3e3; text-align: left; vertical-align: top; overflow-wrap: normal; }
th { border-bottom: 2px solid #bbb; } td:first-child { min-width: 9rem; } tr { break-inside: avoid; }
th.number, td.number { text-align: right; font-variant-numeric: tabular-nums; } td.number { white-space: nowrap; }
figure { margin: 1.5rem 0; break-inside: avoid; } figure img { display: block; width: 100%; height: auto; }
figcaption { font-size: .92rem; color: #444; margin-top: .4rem; }
.key { display: grid; grid-template-columns: repeat(auto-fit, minmax(10.5rem, 1fr)); gap: .7rem; margin: 1.2rem 0; }
.key div { border: 1px solid #ddd; border-radius: .4rem; padding: .5rem .8rem; break-inside: avoid; }
.key dt { font-size: .85rem; color: #444; } .key dd { margin: 0; font-size: 1.35rem; font-weight: 600; line-height: 1.3; }
.key dd small { font-size: .8rem; font-weight: 400; display: block; }
.fitted, .calibrated, .assumed, .recalled, .tuned { color: #8a4b00; } .no { color: #a00000; } .yes { color: #00603f; }
.failed, .absent { border-left: .3rem solid #a00000; background: #fbf0ef; padding: .5rem .8rem; } .absent { border-color: #888; background: #f3f3f3; }
footer { margin-top: 3rem; border-top: 1px solid #ddd; font-size: .85rem; color: #555; }
@media screen and (max-width: 40rem) { .scroll.plot img { min-width: 30rem; } td, th { padding: .3rem .4rem; }
  td:last-child:not(.number, :nth-child(-n+3)) { min-width: 12rem; } }
@media print { body { max-width: none; font-size: 10.5pt; padding: 0; } nav { display: none; } h2, h3 { break-after: avoid; }
  table { font-size: 9pt; } .scroll { overflow: visible; break-inside: avoid; } figure img { max-height: 19cm; width: auto; max-width: 100%; } a { color: inherit; text-decoration: none; } }
"""


class Section(NamedTuple):
    """A part of a page: `body` is HTML; `entries` are (id, title) of what the table of contents names below it."""

    slug: str
    title: str
    body: str
    entries: Sequence[tuple[str, str]] = ()


def page(title: str, heading: str, lead: str, sections: Sequence[Section], footer: str = "") -> str:
    """The whole page; `lead` and `footer` are HTML, title and heading are text."""
    contents = "".join(f"<li>{_link(part.slug, part.title)}{_below(part.entries)}</li>" for part in sections)
    body = "".join(
        f'<section id="{escape(part.slug)}"><h2>{escape(part.title)}</h2>\n{part.body}</section>\n' for part in sections
    )
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta name="viewport" content="width=device-width, initial-scale=1"><title>{escape(title)}</title>'
        f"<style>{CSS}</style></head>\n<body><header><h1>{escape(heading)}</h1>\n{lead}</header>\n"
        f'<nav aria-label="Contents"><ul>{contents}</ul></nav>\n<main>{body}</main>'
        f"{f'<footer>{footer}</footer>' if footer else ''}</body></html>\n"
    )


def _link(slug: str, title: str) -> str:
    return f'<a href="#{escape(slug)}">{escape(title)}</a>'


def _below(entries: Sequence[tuple[str, str]]) -> str:
    return f"<ul>{''.join(f'<li>{_link(*entry)}</li>' for entry in entries)}</ul>" if entries else ""


def paragraph(text: str, kind: str = "") -> str:
    """Text; of kind "failed" or "absent" for what could not be made."""
    return f"<p{f' class={chr(34)}{kind}{chr(34)}' if kind else ''}>{escape(text)}</p>\n"


def table(head: Sequence[str], rows: Iterable[Sequence[str]], numbers: Sequence[int] = ()) -> str:
    """A table of HTML cells, `numbers` the columns that are aligned to the right; wide ones scroll by themselves."""
    kinds = [' class="number"' if column in numbers else "" for column in range(len(head))]

    def row(cells: Sequence[str], tag: str) -> str:
        return "<tr>" + "".join(f"<{tag}{kind}>{cell}</{tag}>" for cell, kind in zip(cells, kinds, strict=True)) + "</tr>"

    body = "\n".join(row(cells, "td") for cells in rows)
    return f'<div class="scroll"><table><thead>{row(head, "th")}</thead>\n<tbody>{body}</tbody></table></div>\n'


def key_figures(entries: Iterable[tuple[str, str, str]]) -> str:
    """Name, value and remark of the few numbers that a reader looks for first."""
    shown = "".join(
        f"<div><dt>{escape(name)}</dt><dd>{escape(value)}<small>{escape(remark)}</small></dd></div>"
        for name, value, remark in entries
    )
    return f'<dl class="key">{shown}</dl>\n'


def figure(slug: str, title: str, alternative: str, caption: str, source: str) -> str:
    """A figure from a data URI; without a title where the section's own says it."""
    heading = f"<h3>{escape(title)}</h3>" if title else ""
    return (
        f'<figure id="{escape(slug)}">{heading}<div class="scroll plot">'
        f'<img alt="{escape(alternative)}" src="{source}"></div>'
        f"<figcaption>{escape(caption)}</figcaption></figure>\n"
    )


def bullets(entries: Iterable[str]) -> str:
    """A list of texts."""
    return "<ul>" + "".join(f"<li>{escape(entry)}</li>" for entry in entries) + "</ul>\n"


def png_uri(content: str) -> str:
    """The data URI of a PNG in base64."""
    return f"data:image/png;base64,{content}"


def svg_uri(drawing: "Figure") -> str:
    """The figure as SVG in a data URI, the same for the same figure."""
    import matplotlib as mpl

    stream = io.BytesIO()
    with mpl.rc_context({"svg.hashsalt": "railjax"}):
        drawing.savefig(stream, format="svg", metadata={"Date": None})
    return f"data:image/svg+xml;base64,{base64.b64encode(stream.getvalue()).decode()}"
