"""The same lines for NumPy and JAX: numbers that are known are computed by NumPy, at once and in double precision; what is traced by JAX.

Functions take the namespace as `xp`. Worth it for what a person asks for once, where compiling would take longer than computing.
"""

from collections.abc import Callable
from types import ModuleType
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from .checks import traced

T = TypeVar("T")


def namespace(values: Any) -> ModuleType:
    """`jax.numpy` if anything in the values is traced, else `numpy`."""
    return jnp if traced(values) else np


def known(values: T) -> T:
    """Arrays of NumPy in the place of JAX's; nothing in them is traced."""
    return jax.tree.map(np.asarray, values)


def constant(xp: ModuleType, values: T) -> T:
    """The values without their derivatives."""
    return values if xp is np else jax.lax.stop_gradient(values)


def repeated(xp: ModuleType, count: int, body: Callable[[T], T], start: T) -> T:
    """`body` applied `count` times."""
    if xp is np:
        for _ in range(count):
            start = body(start)
        return start
    return jax.lax.fori_loop(0, count, lambda _, value: body(value), start)


def followed(xp: ModuleType, body: Callable[[T, Any], T], start: T, over: Any) -> T:
    """The values after each step of `body` over the entries of an array, stacked."""
    if xp is np:
        values = []
        for one in over:
            start = body(start, one)
            values.append(start)
        return jax.tree.map(lambda *parts: np.stack(parts), *values)

    def step(value: T, one: Any) -> tuple[T, T]:
        after = body(value, one)
        return after, after

    return jax.lax.scan(step, start, over)[1]
