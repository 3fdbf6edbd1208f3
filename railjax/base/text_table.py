"""Tables of text as people have them: encoding, separator, decimal mark, comments, header and row of units are found, or what is wrong is said."""

import io
import re
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from .errors import InputError

#: separators as they are looked for, and how messages name them
SEPARATORS = {"\t": "a tab", ";": "';'", "|": "'|'", ",": "','", " ": "blanks", "": "nothing, a single column"}

#: by these a line is a comment
COMMENTS = ("#", "%", "//", "!", "*", "'")

#: how files of data are called
SUFFIXES = (".csv", ".txt", ".dat", ".tsv", ".tab", ".asc", ".prn", ".log")

#: a number with either decimal mark, a stamp of time (with a date or not), and what stands for no value
NUMBER = re.compile(r"[+-]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eEdD][+-]?\d+)?|[+-]?(?:nan|inf(?:inity)?)", re.IGNORECASE)
STAMP = re.compile(
    r"(?:\d{1,4}[-./]\d{1,2}[-./]\d{1,4}[T ]?)?\s*(?:\d{1,2}:\d{2}(?::\d{2}(?:[.,]\d+)?)?)?\s*(?:Z|[+-]\d{2}:?\d{2})?"
)
NOTHING = ("", "-", "--", "na", "n/a", "null", "none")

#: lines that are looked at for the form, and characters for the encoding
LOOKED_AT, SAMPLE = 200, 1 << 16


@dataclass(frozen=True)
class TextTable:
    """The rows of a file and what their columns are called: `names` as written (their numbers, from "1", where there is no header),
    `units` of a row of units or None. Columns become numbers when they are asked for."""

    path: Path
    names: tuple[str, ...]
    units: tuple[str | None, ...]
    has_header: bool
    rows: list[str] = field(repr=False)
    lines: Int[np.ndarray, "rows"] = field(repr=False)  # of each row, from 1
    separator: str
    decimal: str

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def form(self) -> str:
        """In words, for messages."""
        decimal = " with decimal commas" if self.decimal == "," else ""
        return f"cells separated by {SEPARATORS[self.separator]}{decimal}" if self.separator else f"a single column{decimal}"

    def cell(self, row: int, column: int) -> str:
        """A cell as it is written, without blanks and quotes around it; empty where its line ends before."""
        cells = split(self.rows[row], self.separator)
        return cells[column] if column < len(cells) else ""

    def numbers(self, columns: Iterable[int]) -> dict[int, Float[np.ndarray, "rows"]]:
        """Columns as numbers, NaN where a cell is none. Raises `InputError` for a line with more cells than the table has."""
        wanted = sorted(set(columns))
        frame = self._parsed([*wanted, len(self.names)], None)
        beyond = frame.pop(len(self.names)).notna().to_numpy()
        if beyond.any():
            self._refuse_long(int(np.argmax(beyond)))
        return {index: self._as_numbers(frame[index]) for index in wanted}

    def texts(self, column: int) -> list[str]:
        """A column as it is written."""
        return self._parsed([column], str)[column].fillna("").str.strip().tolist()

    def _parsed(self, columns: list[int], dtype: type | None) -> Any:
        import pandas as pd

        blanks, count = self.separator == " ", len(self.names) + 1
        separator = self.separator or "\0"  # which no text holds
        # a first row with a cell more, so that pandas finds what is beyond the last column
        text = "\n".join([separator.join("0" * count), *self.rows])
        try:
            frame = pd.read_csv(
                io.StringIO(text),
                sep=r"\s+" if blanks else separator,
                decimal=self.decimal,
                header=None,
                names=list(range(count)),
                usecols=columns,
                index_col=False,
                skipinitialspace=not blanks,
                skip_blank_lines=False,
                dtype=dtype,
                keep_default_na=dtype is None,
                low_memory=False,
            )
        except pd.errors.ParserError as error:
            if opened := re.search(r"EOF inside string starting at row (\d+)", str(error)):
                raise self._unclosed(int(opened.group(1)) - 1) from None
            raise InputError(f"{self.path}: cannot be read as CSV ({str(error).splitlines()[0]})") from None
        if len(frame) != len(self.rows) + 1:
            raise self._unclosed(next((k for k, row in enumerate(self.rows) if row.count('"') % 2), 0))
        return frame[1:]

    def _unclosed(self, row: int) -> InputError:
        return InputError(f"{self.path}, line {self.lines[row]}: a quotation mark that is not closed")

    def _refuse_long(self, row: int) -> None:
        cells, named = len(split(self.rows[row], self.separator)), "the header" if self.has_header else "most lines"
        raise InputError(
            f"{self.path}, line {self.lines[row]}: {cells} cells, where {named} has {len(self.names)} ({self.form}); "
            f"decimal commas between commas, or a line of something else?"
        )

    def _as_numbers(self, column: Any) -> Float[np.ndarray, "rows"]:
        import pandas as pd

        if not pd.api.types.is_numeric_dtype(column.dtype):
            texts = column.astype(str).str.strip()
            if self.decimal == ",":
                # a point is none of its marks: a group of thousands, or another column's way
                texts = texts.mask(texts.str.contains(".", regex=False), "").str.replace(",", ".", regex=False)
            column = pd.to_numeric(texts, errors="coerce")
        return column.to_numpy(float)


def is_table(source: str | Path) -> bool:
    """Whether a text is the name of a file of data: by its ending, or as it is there and no TOML."""
    path = Path(source)
    return path.suffix.lower() in SUFFIXES or (path.suffix.lower() not in ("", ".toml") and path.is_file())


def open_table(path: Path, known: Callable[[str], bool], words: tuple[str, ...] = ()) -> TextTable:
    """The table in a file; `known` says whether a name is one that is looked for, which makes a header of a comment; `words` are names
    that are in it for sure, by which code pages are told apart.

    Raises `InputError` for a file that cannot be read, holds no numbers, or can be read in two ways.
    """
    lines = _joined(_decoded(path, words).split("\n"))
    if lines and lines[0].lower().startswith("sep="):  # as spreadsheets write it
        lines[0] = ""
    comments = {n for n, line in enumerate(lines) if line.startswith(COMMENTS) or line.lstrip().startswith(("#", "//"))}
    kept = [n for n, line in enumerate(lines) if n not in comments and line.strip(' \t;,|"')]
    if not kept:
        raise InputError(f"{path}: holds no numbers")
    # the header and what is before it are short, so that the last of the looked-at lines are numbers
    looked = [lines[n] for n in kept[:LOOKED_AT]]
    tail = looked[len(looked) // 2 :] if len(looked) > 1 else looked
    separator, count = _separator(tail, looked, path)
    numeric = _numeric_columns([split(line, separator) for line in tail], count)
    first = next((k for k, line in enumerate(looked) if _is_data(split(line, separator), numeric)), None)
    if first is None or not numeric.any():
        raise InputError(f"{path}: no rows of numbers, looked for as cells separated by {SEPARATORS[separator]}")
    before = [n for n in range(kept[first]) if lines[n].strip(' \t;,|"')]
    rows = [lines[n] for n in kept[first:]]
    spread = rows[:: len(rows) // LOOKED_AT + 1]
    decimal = "," if _decimal_commas([split(line, separator) for line in spread], numeric) else "."
    names, units, has_header = _header(
        [(n in comments, lines[n].lstrip("".join(COMMENTS) + "/ ") if n in comments else lines[n]) for n in before],
        separator,
        count,
        known,
        path,
    )
    _refuse_double_commas(rows[:LOOKED_AT], separator, has_header, path)
    numbers = np.array(kept[first:]) + 1
    return TextTable(path, names, units, has_header, rows, numbers, separator, decimal)


def split(line: str, separator: str) -> list[str]:
    """The cells of a line, without blanks and quotes around them."""
    if separator == " ":
        cells = line.split() if '"' not in line else re.findall(r'"[^"]*"|\S+', line)
    elif not separator:
        cells = [line]
    elif '"' in line:
        import csv

        try:
            cells = next(csv.reader([line], delimiter=separator, skipinitialspace=True))
        except csv.Error:  # a cell beyond its limit
            cells = line.split(separator)
    else:
        cells = line.split(separator)
    return [cell.strip().strip('"').strip() for cell in cells]


def _decoded(path: Path, words: tuple[str, ...]) -> str:
    """The file's text: by its mark, as UTF-8, as UTF-16 by its zeros, else the likeliest of the western code pages."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read as CSV ({error.strerror or type(error).__name__})") from None
    encoding = "utf-8-sig"
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        encoding = "utf-16"
    elif data[:SAMPLE].count(0) > 0.2 * len(data[:SAMPLE]):
        encoding = "utf-16-le" if data[1:SAMPLE:2].count(0) > data[:SAMPLE:2].count(0) else "utf-16-be"
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError:
        text = data.decode(_code_page(data, path, words), errors="replace")
    if "\0" in text[:SAMPLE] or sum(ord(c) < 32 and c not in "\t\n\r\f" for c in text[:SAMPLE]) > 0.01 * len(text[:SAMPLE]):
        raise InputError(f"{path}: cannot be read as CSV (it is no text)")
    return text.replace("\u2212", "-").replace("\r\n", "\n").replace("\r", "\n")


def _code_page(data: bytes, path: Path, words: tuple[str, ...]) -> str:
    from charset_normalizer import from_bytes

    marked = b"\n".join([line for line in data.splitlines() if not line.isascii()][:LOOKED_AT])
    if sum(byte > 127 for byte in marked) > 0.5 * len(marked):
        raise InputError(f"{path}: cannot be read as CSV (it is no text)")
    found = from_bytes(marked, cp_isolation=["cp1252", "cp1250", "mac_roman", "cp850"])
    ranked = sorted(found, key=lambda match: (round(match.chaos, 2), -_sense(str(match), words), match.encoding != "cp1252"))
    return ranked[0].encoding if ranked else "cp1252"


def _sense(text: str, words: tuple[str, ...]) -> int:
    """How many of the words, and of the marks of units, a text has."""
    return sum(word in text for word in words) + sum(text.count(mark) for mark in "²³µ°·")


def _joined(lines: list[str]) -> list[str]:
    """Lines of which a quoted cell holds an end of line are one; only the first lines, where headers are. The numbers stay."""
    for n in range(min(LOOKED_AT, len(lines)) - 1):
        if lines[n].count('"') % 2 and '"' in "".join(lines[n + 1 : n + 4]):
            lines[n + 1], lines[n] = f"{lines[n]} {lines[n + 1]}", ""
    return lines


def is_number(cell: str) -> bool:
    """Whether a cell holds a number, with either decimal mark."""
    return NUMBER.fullmatch(cell) is not None


def _is_value(cell: str) -> bool:
    return is_number(cell) or ((":" in cell or cell.count("-") > 1) and STAMP.fullmatch(cell) is not None)


def _separator(tail: list[str], looked: list[str], path: Path) -> tuple[str, int]:
    """By which the most cells become numbers, and the number of cells."""
    best, found = 0.0, ("", 1)
    for separator in SEPARATORS:
        if separator and not any((separator in line.strip() or (separator == " " and "\t" in line)) for line in tail):
            continue
        cells = [split(line, separator) for line in tail]
        count, of = Counter(map(len, cells)).most_common(1)[0]
        good = sum(_is_value(cell) for row in cells for cell in row)
        filled = sum(bool(cell) for row in cells for cell in row)
        score = good / max(filled, 1) * of / len(cells)
        if score > best + 1e-9:
            best, found = score, (separator, count)
    if found[0] == "," and found[1] == 2 and all(re.fullmatch(r"[+-]?\d+,\d+", line.strip()) for line in tail):
        # a comma between digits: a single column with decimal commas, if the header is a single name
        head = next((line for line in looked if not re.search(r"^[+-]?\d", line.strip())), None)
        if head is None:
            raise InputError(f"{path}: is {tail[-1].strip()!r} two cells or a decimal comma? Write a header above the columns")
        if len(split(head, ",")) == 1:
            return "", 1
    return found


def _numeric_columns(cells: list[list[str]], count: int) -> Bool[np.ndarray, "columns"]:
    """Which columns hold numbers or stamps of time in most of their filled cells."""
    rows = [row for row in cells if len(row) == count]
    filled = np.array([[cell.lower() not in NOTHING for cell in row] for row in rows]).reshape(-1, count)
    good = np.array([[_is_value(cell) for cell in row] for row in rows]).reshape(-1, count)
    return good.sum(axis=0) >= 0.5 * np.maximum(filled.sum(axis=0), 1)


def _is_data(cells: list[str], numeric: Bool[np.ndarray, "columns"]) -> bool:
    """A row of numbers: not the header, in which they are words; a bad cell or a missing one is found later, with its line."""
    of = [cell for cell, wanted in zip(cells, numeric, strict=False) if wanted and cell.lower() not in NOTHING]
    return sum(map(_is_value, of)) > 0.5 * len(of) if of and len(of) > 0.3 * numeric.sum() else False


def _decimal_commas(cells: list[list[str]], numeric: Bool[np.ndarray, "columns"]) -> bool:
    numbers = [cell for row in cells for cell, wanted in zip(row, numeric, strict=False) if wanted and is_number(cell)]
    return sum("," in cell for cell in numbers) > sum("." in cell for cell in numbers)


def _header(
    before: list[tuple[bool, str]], separator: str, count: int, known: Callable[[str], bool], path: Path
) -> tuple[tuple[str, ...], tuple[str | None, ...], bool]:
    """Names of the columns, their row of units, and whether there are names at all; of the lines before the numbers, and whether
    they are comments."""
    found: list[tuple[int, list[str]]] = []
    for comment, line in reversed(before):
        cells = _header_cells(line, separator, count)
        good = sum(map(known, cells))
        if len(cells) == count and (good or not comment or (not found and _are_units(cells))):
            found.append((good, cells))
        elif not comment and not found and (good or (separator == "," and separator in line)):
            raise InputError(
                f"{path}: the header names {len(cells)} columns, the rows have {count} cells (separated by {SEPARATORS[separator]})"
                + ("; decimal commas between commas?" if separator == "," else "")
            )
        if len(found) == 2:
            break
    nothing = (None,) * count
    if len(found) == 2 and found[1][0] >= found[0][0] and _are_units(found[0][1]):
        return tuple(map(_printable, found[1][1])), tuple(_bare(cell) or None for cell in found[0][1]), True
    if found and (found[0][0] or not before[-1][0]):
        return tuple(map(_printable, found[0][1])), nothing, True
    return tuple(str(k + 1) for k in range(count)), nothing, False


def _header_cells(line: str, separator: str, count: int) -> list[str]:
    if separator != " ":
        cells = split(line, separator)
        while len(cells) > count and not cells[-1]:
            cells.pop()
        return cells
    ways = (r"\s+", r"\s{2,}|\t", r"\s+(?![(\[])", r"[,;]\s*")
    whole = [[cell.strip().strip('"') for cell in re.split(way, line.strip())] for way in ways]
    return next((cells for cells in whole if len(cells) == count), split(line, separator))


def _printable(name: str) -> str:
    """For messages of one line."""
    return "".join(c if c.isprintable() else " " for c in name).strip()


def _bare(unit: str) -> str:
    return unit.strip("()[]{}<> -")


def _are_units(cells: list[str]) -> bool:
    """A row of units: short, of letters and the marks of units, and no words such as 'lateral'."""
    from .file_units import is_unit

    return all(not _bare(cell) or is_unit(_bare(cell)) for cell in cells)


def _refuse_double_commas(rows: list[str], separator: str, has_header: bool, path: Path) -> None:
    """Whole numbers between commas may be halves of decimal numbers where no header counts the columns."""
    if separator != "," or has_header:
        return
    cells = [split(row, ",") for row in rows]
    if len(cells[0]) % 2 or any("." in cell for row in cells for cell in row):
        return
    if all(re.fullmatch(r"\d+", half) for row in cells for half in row[1::2]):
        raise InputError(f"{path}: are the commas of {rows[0]!r} separators or decimal marks? Write a header above the columns")
