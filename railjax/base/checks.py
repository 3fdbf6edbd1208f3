"""What the arguments of public functions may be, declared once by their names; `arguments.guarded` refuses the rest before anything is computed.

Only what is known when the function is called: tracers pass, and so does what JAX puts in place of numbers where it rebuilds pytrees
(gradients, axes), which is why the constructors of vehicles, dampers and tracks take anything and the functions that use them refuse.
"""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from .errors import InputError

#: (the argument's name, its value): raises `InputError`
Rule = Callable[[str, Any], None]


def shown(value: Any) -> str:
    """A value as messages quote it, on one line."""
    try:
        text = " ".join(repr(value).split())
    except ValueError:  # Python does not print integers of over 4300 digits
        return "a huge number"
    return text if len(text) <= 60 else f"{text[:57]}..."


def traced(value: Any) -> bool:
    """Whether anything in it is not known yet."""
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(value))


class Range(NamedTuple):
    """Finite numbers (but where `infinite`) from `low` to `high`, the ends excluded where `open`; `whole` ones; of `axes` axes at most
    (lanes, several values). `why` ends the message."""

    unit: str = "1"
    low: float | int = -math.inf
    high: float | int = math.inf
    open: bool = False
    whole: bool = False
    axes: int = 0
    why: str = ""
    infinite: bool = False

    def __call__(self, key: str, value: Any) -> None:
        """Refuse what is out of the range, naming it."""
        if value.__class__ is float and self.low < value < self.high and not self.whole:
            return
        if isinstance(value, (list, tuple, dict)) and traced(value):
            return
        if not isinstance(value, jax.core.Tracer):
            self._check(key, value)

    def _check(self, key: str, value: Any) -> None:
        try:
            array = np.asarray(value)
            wrong = array.dtype.kind not in ("iu" if self.whole else "iuf") or array.ndim > self.axes or not array.size
        except (TypeError, ValueError, OverflowError):
            wrong = True
        if wrong:
            if self.axes == 1 and getattr(value, "ndim", 0) > 1:
                raise InputError(
                    f"{key}: an array of shape {value.shape} has more than one axis of lanes; flatten the grid first"
                )
            raise InputError(f"{key} must be {self}, not {shown(value)}{self.why}")
        array = array.astype(float)
        inside = (array > self.low) & (array < self.high) if self.open else (array >= self.low) & (array <= self.high)
        bad = ~(inside & (np.isfinite(array) | (self.infinite & ~np.isnan(array))))
        if np.any(bad):
            first = array[bad][0]
            raise InputError(f"{key} must be {self}, not {first:g}{self.why}")

    def __str__(self) -> str:
        unit = "" if self.unit == "1" else f" ({self.unit})"
        kind = "a whole number" if self.whole else "a number" if self.infinite or math.isfinite(self.high) else "a finite number"
        if math.isfinite(self.high):
            return (
                f"{kind} between {self.low:g} and {self.high:g}{unit}"
                if math.isfinite(self.low)
                else f"{kind} up to {self.high:g}{unit}"
            )
        if self.low == 0.0:
            positive = "positive" if self.open else "0 or positive"
            return f"{positive}{unit}" if not self.whole else f"{kind} from 0 on{unit}"
        return (
            f"{kind}{unit}"
            if self.low == -math.inf
            else f"{kind} {'above' if self.open else 'from'} {self.low:g}{'' if self.open else ' on'}{unit}"
        )


def positive(unit: str = "1", **more: Any) -> Range:
    """The rule for numbers above zero."""
    return Range(unit, 0.0, open=True, **more)


def from_zero(unit: str = "1", **more: Any) -> Range:
    """The rule for numbers from zero on."""
    return Range(unit, 0.0, **more)


def whole(low: int, high: float | int = math.inf) -> Range:
    """The rule for whole numbers, such as counts."""
    return Range("1", low, high, whole=True)


class Kind(NamedTuple):
    """Objects of a class (or of one of several); `hint` says where they come from."""

    classes: type | tuple[type, ...]
    hint: str

    def __call__(self, key: str, value: Any) -> None:
        """Refuse anything else."""
        if isinstance(value, type) or not isinstance(value, self.classes):
            raise InputError(f"{key} must be {self.hint}, not {shown(value)}")


class OneOf(NamedTuple):
    """The rule for one of some values."""

    values: tuple

    def __call__(self, key: str, value: Any) -> None:
        """Refuse others."""
        if not any(value is one or (isinstance(value, str) and value == one) for one in self.values):
            raise InputError(f"{key} must be one of {', '.join(map(str, self.values))}, not {shown(value)}")


FLAG = OneOf((True, False))


def a_name(key: str, value: Any) -> None:
    """Refuse what is no string."""
    if not isinstance(value, str):
        raise InputError(f"{key} must be a name in quotes, not {shown(value)}")


def some_names(key: str, value: Any) -> None:
    """Refuse what is no tuple or list of strings."""
    if not isinstance(value, (tuple, list)) or not all(isinstance(one, str) for one in value):
        raise InputError(
            f"{key} must be a list of names, like [{value!r}]"
            if isinstance(value, str)
            else f"{key} must be a list of names, not {shown(value)}"
        )


def a_path(key: str, value: Any) -> None:
    """Refuse what is no path of a file or folder."""
    if not isinstance(value, (str, Path)) or not str(value):
        raise InputError(f"{key} must be a path, not {shown(value)}")


def a_function(key: str, value: Any) -> None:
    """Refuse what cannot be called."""
    if not callable(value):
        raise InputError(f"{key} must be a function, not {shown(value)}")


def a_table(key: str, value: Any) -> None:
    """Refuse what is no mapping by names."""
    if not (hasattr(value, "keys") and hasattr(value, "__getitem__")):
        raise InputError(f"{key} must be a dictionary by names, not {shown(value)}")


class Samples(NamedTuple):
    """Real numbers over time or distance, along the first axis; NaN is handed on, as the result then is NaN as well."""

    unit: str

    def __call__(self, key: str, value: Any) -> None:
        """Refuse what is no array of numbers."""
        if traced(value):
            return
        try:
            array = np.asarray(value)
            wrong = array.dtype.kind not in "iuf" or array.ndim == 0 or not array.size
        except (TypeError, ValueError, OverflowError):
            wrong = True
        if wrong:
            raise InputError(f"{key} must be an array of numbers ({self.unit}), not {shown(value)}")


class Rising(NamedTuple):
    """Numbers of a range, each above the one before: at least `fewest`, and not more than `most`."""

    of: Range
    fewest: int = 1
    most: float | int = math.inf

    def __call__(self, key: str, value: Any) -> None:
        """Refuse what does not rise."""
        if traced(value):
            return
        self.of._replace(axes=1)(key, value)
        array = np.asarray(value, float)
        if array.ndim != 1 or not self.fewest <= array.size <= self.most or not np.all(np.diff(array) > 0.0):
            many = "" if self.fewest == 1 else f"{'' if self.fewest == self.most else 'at least '}{self.fewest} "
            raise InputError(f"{key} must be {many}numbers in rising order, not {shown(value)}")
