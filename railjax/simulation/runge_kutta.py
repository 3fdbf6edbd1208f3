"""The classical Runge-Kutta step."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

from ..base.compilation import fence
from ..base.typing import Scalar


@fence
def _onward(x: Any, rate: Any, dt: Scalar) -> Any:
    return jax.tree.map(lambda x, rate: x + rate * dt, x, rate)


@fence
def _staged(x: Any, total: Any, rate: Any, weight: Scalar, dt: Scalar) -> tuple[Any, Any]:
    ahead = jax.tree.map(lambda x, rate: x + rate * dt, x, rate)
    return ahead, jax.tree.map(lambda total, rate: total + weight * rate, total, rate)


def _in_rows(function: Callable[..., Any], x: Any, rate: Any, dt: Scalar) -> Any:
    """`function` on each array as one long row: a row per state would be a loop over one chunk of lanes, which LLVM unrolls before it
    looks for vectors."""
    long = [jax.tree.map(jnp.ravel, tree) for tree in (x, rate)]
    return jax.tree.map(lambda row, like: row.reshape(like.shape), function(*long, dt), x)


def rk4(
    stage: Callable[[Any, Any, Any], tuple[Any, Any]], x: Any, sums: Any, dt: Scalar, looped: bool = False
) -> tuple[Any, Any]:
    """One classical Runge-Kutta step of x, an array or a tree of them: x and `sums` after it.

    `stage(k, x, sums)` gives x' and what becomes of `sums` in the stage k: 0 at the start, 1 and 2 in the middle, 3 at the end of
    the step. `looped`: one copy of the stage instead of four, compiled in a third of the time; batches and gradients are slower by 15 %.
    """

    def advanced(k: Any, carry: tuple[Any, Any, Any]) -> tuple[Any, Any, Any]:
        ahead, total, sums = carry
        rate, sums = stage(k, ahead, sums)
        if looped:
            share = jnp.where((k == 1) | (k == 2), dt / 3.0, dt / 6.0), jnp.where(k == 2, dt, 0.5 * dt)
            return *_staged(x, total, rate, *share), sums
        share = dt / (3.0 if k in (1, 2) else 6.0), dt if k == 2 else 0.5 * dt  # type: ignore[assignment]
        total = jax.tree.map(lambda total, rate: total + share[0] * rate, total, rate)
        return (_in_rows(_onward, x, rate, share[1]) if k < 3 else x), total, sums

    carry = x, x, sums
    if looped:
        carry = jax.lax.fori_loop(0, 4, advanced, carry)
    else:
        for k in range(4):
            carry = advanced(k, carry)
    return carry[1:]


def rk4_in_loop(rate: Callable[[Any], Any], x: Array, dt: Scalar) -> Array:
    """One step of `rk4` with constant inputs, its stages a loop."""
    return rk4(lambda _, x, nothing: (rate(x), nothing), x, None, dt, looped=True)[0]
