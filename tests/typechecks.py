"""beartype for tests/conftest.py, made once for what is checked alike.

jaxtyping has a checker made of each function's signature alone, anew wherever a function within a function is defined; making one takes
5 ms, a third of the time of a continuation of limit cycles.
"""

import inspect
from collections.abc import Callable

from beartype import beartype

MADE: dict[tuple, Callable] = {}


def checked(function: Callable) -> Callable:
    """As `beartype(function)`; the same one for the same names, annotations and defaults."""
    key = function.__module__, function.__qualname__, inspect.signature(function)
    try:
        if key not in MADE:
            MADE[key] = beartype(function)
    except TypeError:  # a default without a hash
        return beartype(function)
    return MADE[key]
