"""What a study or a training is, as text: equal for equal ones, different for different ones, readable where that is possible.

Its file keeps these lines, so that it is only ever continued by what began it and can say what differs.
"""

import contextlib
import dataclasses
import functools
import hashlib
import inspect
import pickle
import types
from collections.abc import Callable, Mapping
from enum import Enum
from typing import Any

import jax
import numpy as np

#: numbers that a line shows one by one; longer arrays are named by their digest
SHOWN = 6
#: differences that a refusal names
MANY = 2


def described(value: Any) -> str:
    """One line for any argument of a study: numbers exactly, long arrays and functions by digest."""
    return _described(value, set())


def lines(prefix: str, value: Any) -> dict[str, str]:
    """`described` for every field of a (nested) dataclass, by its path; one line for anything else."""
    if not dataclasses.is_dataclass(value) or isinstance(value, type) or callable(value):
        return {prefix: described(value)}
    found = {prefix: type(value).__name__}
    for field in dataclasses.fields(value):
        found |= lines(f"{prefix}.{field.name}", getattr(value, field.name))
    return found


def differing(there: Mapping[str, str], here: Mapping[str, str]) -> str:
    """In words, which lines differ, the first few of them; empty where none does."""
    keys = [key for key in {**there, **here} if there.get(key) != here.get(key)]
    told = "; ".join(f"{key} is {_short(there.get(key))} there and {_short(here.get(key))} here" for key in keys[:MANY])
    return told + (f"; and {len(keys) - MANY} more" if len(keys) > MANY else "")


def _short(value: str | None) -> str:
    if value is None:
        return "not given"
    return value if len(value) <= 60 else f"{value[:57]}..."


def _digest(*pieces: bytes) -> str:
    found = hashlib.sha256()
    for piece in pieces:
        found.update(len(piece).to_bytes(8, "big") + piece)
    return found.hexdigest()[:16]


def _described(value: Any, seen: set[int]) -> str:
    if value is None or isinstance(value, (bool, int, float, complex, str, bytes, Enum)):
        return repr(value)
    if isinstance(value, (np.ndarray, np.generic, jax.Array)):
        array = np.asarray(value)
        text = repr(array.tolist()) if array.size <= SHOWN else f"{array.shape} {_digest(array.tobytes())}"
        return f"{array.dtype} {text}"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key!r}: {_described(entry, seen)}" for key, entry in value.items()) + "}"
    if isinstance(value, (tuple, list)):
        return f"{type(value).__name__}({', '.join(_described(entry, seen) for entry in value)})"
    if isinstance(value, (set, frozenset)):
        return f"set({', '.join(sorted(_described(entry, seen) for entry in value))})"
    if isinstance(value, (type, types.ModuleType, types.BuiltinFunctionType)):
        return getattr(value, "__qualname__", value.__name__)
    if isinstance(value, functools.partial):
        return f"partial{_described((value.func, value.args, value.keywords), seen)}"
    if isinstance(value, types.MethodType):
        return f"{value.__func__.__qualname__} of {_described(value.__self__, seen)}"
    wrapped = inspect.unwrap(value) if callable(value) else value
    if isinstance(wrapped, types.FunctionType):
        return _function(wrapped, seen)
    return _object(value, seen)


def _object(value: Any, seen: set[int]) -> str:
    """Its class and fields, and what it does when called, unless that is the library's."""
    kind = type(value)
    if id(value) in seen:
        return kind.__qualname__
    own = ""
    if dataclasses.is_dataclass(value):
        fields = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    elif callable(value) and hasattr(value, "__dict__"):
        fields = vars(value)
    else:
        with contextlib.suppress(Exception):  # a lock or a file holds no number
            return f"{kind.__qualname__} {_digest(pickle.dumps(value))}"
        return kind.__qualname__
    seen = seen | {id(value)}
    if callable(value) and not _of_library(kind.__module__):
        own = f" {_described(kind.__call__, seen)}"
    told = ", ".join(f"{name}={_described(entry, seen)}" for name, entry in fields.items())
    return f"{kind.__qualname__}({told}){own}"


def _function(function: Callable, seen: set[int]) -> str:
    """Its code, defaults and closure, and the values and functions that it names; not what it reaches through a module."""
    if _of_library(function.__module__):
        return f"{function.__module__}.{function.__qualname__}"
    if id(function) in seen:
        return function.__qualname__
    seen.add(id(function))
    pieces = [_code(function.__code__), _described((function.__defaults__, function.__kwdefaults__), seen)]
    pieces += [_described(cell.cell_contents, seen) for cell in function.__closure__ or ()]
    for used in sorted(_names(function.__code__)):
        if used in function.__globals__:
            pieces.append(f"{used}: {_described(function.__globals__[used], seen)}")
    return f"{function.__qualname__} {_digest(*(piece.encode() for piece in pieces))}"


def _of_library(module: str) -> bool:
    """Whether code is told by a release, not by itself."""
    return module.partition(".")[0] in ("railjax", "jax", "jaxlib", "numpy", "scipy")


def _code(code: types.CodeType) -> str:
    constants = [_code(c) if isinstance(c, types.CodeType) else _described(c, set()) for c in code.co_consts]
    return f"{code.co_code.hex()} {constants} {code.co_names} {code.co_varnames}"


def _names(code: types.CodeType) -> set[str]:
    inner = [_names(c) for c in code.co_consts if isinstance(c, types.CodeType)]
    return set(code.co_names).union(*inner)
