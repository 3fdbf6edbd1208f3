"""`--out` of the verbs: what was found, in a file whose ending tells the form; every verb writes .json."""

import csv
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from ..base.errors import InputError

Writer = Callable[[Path], Any]

JSON, TABLE, PICTURES = ".json", ".csv", (".png", ".svg")
OutJson = Annotated[Path | None, typer.Option("--out", help=f"Also write the result to a {JSON} file.")]


def out_option(what: str, *endings: str) -> Any:
    """The option `--out` for files of these endings and .json."""
    return typer.Option("--out", help=f"Also write {what} to a {_listed(endings)} file.")


def check_out(out: Path | None, *endings: str) -> None:
    """Refuse, before the work, a file of another ending or in a folder that is not there."""
    if out is None:
        return
    if out.suffix not in (*endings, JSON):
        raise InputError(f"--out {out}: the name must end in {_listed(endings)}")
    if not out.parent.is_dir():
        raise InputError(f"--out {out}: cannot be written (No such file or directory: {out.parent})")


def write_out(out: Path | None, forms: Mapping[str, Writer]) -> None:
    """Write the file, if one is asked for, by the writer of its ending."""
    if out is None:
        return
    try:
        forms[out.suffix](out)
    except OSError as error:
        raise InputError(f"--out {out}: cannot be written ({error.strerror})") from None


def as_table(rows: Sequence[dict[str, Any]]) -> dict[str, Writer]:
    """Rows of a table, its head the keys of the first."""

    def write(out: Path) -> None:
        with out.open("w", encoding="utf-8", newline="") as file:
            table = csv.DictWriter(file, rows[0], lineterminator="\n")
            table.writeheader()
            table.writerows(rows)

    return {TABLE: write}


def as_picture(draw: Callable[[Any], Any], **shape: Any) -> dict[str, Writer]:
    """What `draw` draws into the axes (rows, columns) of a `plots.figure` of this shape."""

    def write(out: Path) -> None:
        from ..base.style import figure

        with figure(**shape) as (page, axes):
            draw(axes)
            page.savefig(out)

    return dict.fromkeys(PICTURES, write)


def _listed(endings: Sequence[str]) -> str:
    return f"{', '.join(endings)} or {JSON}" if endings else JSON
