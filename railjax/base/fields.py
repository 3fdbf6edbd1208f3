"""Fields of dataclasses that are parameters: a number with unit, symbol, meaning and sign, or a choice that is no number."""

from dataclasses import field
from typing import Any


def quantity(
    unit: str, symbol: str, meaning: str, default: float | None = None, positive: bool = False, signed: bool = False
) -> Any:
    """A dataclass field that is a differentiable leaf; its metadata feed the file reader, messages, checks and charts. Neither `positive`
    nor `signed`: 0 or positive."""
    metadata = {"unit": unit, "symbol": symbol, "meaning": meaning, "positive": positive, "signed": signed}
    return field(metadata=metadata) if default is None else field(default=default, metadata=metadata)


def optional(unit: str, symbol: str, meaning: str, positive: bool = False, signed: bool = False) -> Any:
    """A quantity that a part may do without: None, and then no leaf and no code."""
    metadata = {"unit": unit, "symbol": symbol, "meaning": meaning, "positive": positive, "signed": signed}
    return field(default=None, metadata=metadata)


def table(unit: str, symbol: str, meaning: str) -> Any:
    """A quantity given by several numbers: an array with one axis of its own, before any lanes."""
    return field(metadata={"unit": unit, "symbol": symbol, "meaning": meaning, "positive": False, "signed": False, "axes": 1})


def structure(default: Any, meaning: str = "") -> Any:
    """A dataclass field that is static: a change of it compiles anew."""
    return field(default=default, metadata={"static": True, "meaning": meaning})
