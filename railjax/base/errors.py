"""The two ways in which a call can fail, told apart because their cure differs."""

import contextlib
import difflib
from collections.abc import Iterable, Iterator
from typing import Any


class InputError(ValueError):
    """What the user gave cannot be used; the message is one line that names the key and the fix (exit status 2).

    Where one call finds several faults, `messages` holds a line for each; the error's own is the first.
    """

    def __init__(self, *messages: str):
        super().__init__(*messages[:1])
        self.messages = messages


class NumericalError(RuntimeError):
    """The input is sound but the computation did not succeed; the message says which part and why (exit status 1)."""


@contextlib.contextmanager
def collecting(faults: list[str]) -> Iterator[None]:
    """Put an `InputError` from within into `faults`, so that the next fault can be looked for."""
    try:
        yield
    except InputError as error:
        faults += error.messages


def closest(key: Any, known: Iterable[str], least: float = 0.0) -> str:
    """The known key most like an unknown one; '' where none is as like as `least` (0 to 1)."""
    return next(iter(difflib.get_close_matches(str(key), known, n=1, cutoff=least)), "")


def nearest(key: str, known: Iterable[str], part: str = "") -> str:
    """`closest` as the end of a message."""
    return f"; did you mean {part + '.' if part else ''}{closest(key, known)}?"
