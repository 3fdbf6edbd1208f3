"""What of the site is made while it is built, as a hook of mkdocs: the first page from the README, with the figure that its first
example draws; the notebooks as text; tables of fields, parameters and channels with their units.
"""

import dataclasses
import functools
import inspect
import json
import os
import re
import tempfile
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.nav import Page

import railjax
from railjax.model.vehicle import PARTS

ROOT = Path(__file__).resolve().parents[1]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
FIGURE = "run.png"


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """The notebooks' place in the navigation."""
    pages: list = [{title(path): f"{path.stem}.md"} for path in NOTEBOOKS]
    config["nav"] = [{"Notebooks": pages} if entry == {"Notebooks": "NOTEBOOKS"} else entry for entry in config["nav"]]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Pages and the figure that are not files of the repository."""
    generated: dict[str, str | bytes] = {"index.md": front_page(), "changelog.md": (ROOT / "CHANGELOG.md").read_text("utf-8")}
    generated |= {f"{path.stem}.md": as_text(path) for path in NOTEBOOKS}
    generated[FIGURE] = drawn()
    for name, content in generated.items():
        files.append(File.generated(config, name, content=content))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Tables in place of their markers, and of its fields after every class."""
    markdown = markdown.replace("<!-- parameters -->", parameters()).replace("<!-- channels -->", channels())
    markdown = re.sub(r"\]\(\.\./([\w-]+)\.ipynb\)", r"](\1.md)", markdown)
    return re.sub(r"^::: (railjax\.\S+)$", lambda found: found[0] + fields_table(found[1]), markdown, flags=re.MULTILINE)


def front_page() -> str:
    """The README, its links turned to the site's pages, with the figure of its first example."""
    text = (ROOT / "README.md").read_text("utf-8")
    text = re.sub(r"\]\(notebooks/(?:pages/)?([\w-]+)\.(?:md|ipynb)\)", r"](\1.md)", text)
    text = re.sub(r"\]\(notebooks/pages/([\w-]+\.(?:svg|gif))\)", r"](\1)", text)
    text = text.replace("](CHANGELOG.md)", "](changelog.md)")
    first = re.search(r"```python\n.*?```\n", text, flags=re.DOTALL)
    assert first
    return text[: first.end()] + f"\n![What the example draws: see the text]({FIGURE})\n" + text[first.end() :]


def drawn() -> bytes:
    """The figure of the README's first example, which is run for it."""
    code = re.search(r"```python\n(.*?)```", (ROOT / "README.md").read_text("utf-8"), flags=re.DOTALL)
    assert code
    here = os.getcwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            exec(compile(code[1].replace("railjax.use_all_cores()", ""), "README.md", "exec"), {})
            return Path(FIGURE).read_bytes()
        finally:
            os.chdir(here)


def title(path: Path) -> str:
    """The title of a notebook, from its first cell."""
    return json.loads(path.read_text("utf-8"))["cells"][0]["source"][0].strip("# \n")


def as_text(path: Path) -> str:
    """A notebook's text and code; it is committed without results."""
    cells = json.loads(path.read_text("utf-8"))["cells"]
    parts = ["".join(cell["source"]) for cell in cells]
    code = [cell["cell_type"] == "code" for cell in cells]
    found = [f"```python\n{part}\n```" if is_code else part for part, is_code in zip(parts, code, strict=True)]
    return "\n\n".join([*found, f"*This is `notebooks/{path.name}`; run it with Jupyter to see its figures.*"])


def resolved(path: str) -> Any:
    """The object of a public name, railjax.NAME or railjax.objectives.NAME."""
    return functools.reduce(getattr, path.split(".")[1:], railjax)


def fields_of(kind: Any) -> list[tuple[str, str, str]]:
    """(name, unit, meaning) of the fields of a dataclass or named tuple: from the metadata, else the comment beside it."""
    if dataclasses.is_dataclass(kind):
        metadata = {field.name: field.metadata for field in dataclasses.fields(kind)}
    else:
        metadata = {name: {} for name in getattr(kind, "_fields", ())}
    comments: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        if base.__module__.startswith("railjax"):
            comments |= dict(re.findall(r"^    (\w+): [^#\n]*#:? (.*)$", inspect.getsource(base), flags=re.MULTILINE))
    return [
        (
            name,
            about.get("unit", ""),
            ", ".join(filter(None, [about.get("meaning", ""), about.get("symbol", ""), comments.get(name, "")])),
        )
        for name, about in metadata.items()
        if not name.startswith("_")
    ]


def fields_table(path: str) -> str:
    """Those of a class that says something of them, as Markdown after its entry."""
    found = resolved(path)
    rows = [row for row in fields_of(found) if row[1] or row[2]] if inspect.isclass(found) else []
    return "\n\n" + table(("field", "unit", "meaning"), rows) + "\n" if rows else ""


def table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    """Rows under a head, as a table in Markdown."""
    clean = [" | ".join(str(cell).replace("|", "\\|") for cell in (f"`{row[0]}`", *row[1:])) for row in rows]
    return "\n".join([f"| {' | '.join(head)} |", "|---" * len(head) + "|", *(f"| {row} |" for row in clean)])


def parameters() -> str:
    """All numbers that a vehicle may have, with the coach's and where they come from."""
    coach = railjax.load_vehicle("coach")
    sources = {entry.parameter: entry.status for entry in coach.provenance}
    rows = []
    for part, kind in PARTS.items():
        own = getattr(coach, part)
        for name, unit, meaning in fields_of(kind):
            value = None if own is None else getattr(own, name)
            shown = f"{value:g}" if isinstance(value, (int, float)) and not isinstance(value, bool) else ""
            if unit:
                rows.append((f"{part}.{name}", unit, meaning, shown, sources.get(f"{part}.{name}", "published" if shown else "")))
    return table(("parameter", "unit", "meaning, symbol", "coach", "source"), rows)


def channels() -> str:
    """What `simulate` records."""
    shapes = {
        "carbody": "of the car body",
        "floor": "at 3 points of the floor",
        "bogie": "of n bogies",
        "wheelset": "of n m wheelsets",
        "wheel": "of n m wheelsets, right and left wheel",
    }
    return table(
        ("channel", "unit", "shape"), [(name, entry.unit, shapes[entry.part]) for name, entry in railjax.CHANNELS.items()]
    )
