"""Self-contained HTML pages in one style, for a screen, a phone and in print: what `railjax reproduce` and `railjax report` share.

The HTML stands in `templates/`. Whatever is given as text is escaped; what these functions return is marked as HTML (`Markup`, a
`str`), stays so when it is added up, and can be a part of the next: a cell, a body.
"""

import base64
import functools
import io
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Section(NamedTuple):
    """A part of a page: `body` is HTML; `entries` are (id, title) of what the table of contents names below it."""

    slug: str
    title: str
    body: str
    entries: Sequence[tuple[str, str]] = ()


@functools.cache
def _template(name: str) -> Any:
    import jinja2

    loader = jinja2.PackageLoader(__package__)
    environment = jinja2.Environment(
        loader=loader, autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, keep_trailing_newline=True
    )
    return environment.get_template(name)


def _part(name: str, *given: Any) -> str:
    """A macro of parts.html."""
    return getattr(_template("parts.html").module, name)(*given)


def page(title: str, heading: str, lead: str, sections: Sequence[Section], footer: str = "") -> str:
    """The whole page; `lead` is HTML, title, heading and footer are text."""
    return _template("page.html").render(title=title, heading=heading, lead=lead, sections=sections, footer=footer)


def joined(parts: Iterable[str]) -> str:
    """Pieces of HTML one after another."""
    from markupsafe import Markup

    return Markup().join(parts)


def paragraph(text: str, kind: str = "") -> str:
    """Text; of kind "failed" or "absent" for what could not be made."""
    return _part("paragraph", text, kind)


def table(head: Sequence[str], rows: Iterable[Sequence[str]], numbers: Sequence[int] = ()) -> str:
    """A table, `numbers` the columns that are aligned to the right; wide ones scroll by themselves."""
    rows = list(rows)
    for cells in rows:
        assert len(cells) == len(head), (head, cells)
    return _part("table", head, rows, numbers)


def key_figures(entries: Iterable[tuple[str, str, str]]) -> str:
    """Name, value and remark of the few numbers that a reader looks for first."""
    return _part("key_figures", entries)


def figure(slug: str, title: str, alternative: str, caption: str, source: str) -> str:
    """A figure from a data URI; without a title where the section's own says it."""
    return _part("figure", slug, title, alternative, caption, source)


def bullets(entries: Iterable[str]) -> str:
    """A list of texts."""
    return _part("bullets", entries)


def marked(kind: str, text: str) -> str:
    """A word in the style of its kind: where a value comes from, yes or no."""
    return _part("marked", kind, text)


def remarked(text: str, remark: str) -> str:
    """A text and, small below it, a remark."""
    return _part("remarked", text, remark)


def indexed(letter: str, index: str) -> str:
    """A symbol with its index below."""
    return _part("indexed", letter, index)


def code(text: str) -> str:
    """A name as a program has it."""
    return _part("code", text)


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
