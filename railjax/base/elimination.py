"""Many small systems of linear equations at once, lanes last: Gauss and Jordan with row pivots.

LAPACK's threads deadlock with those of programs at work on two CPU devices or called from two threads (seen with JAX 0.10.1).
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def eliminated(matrix: Float[Array, "n n *lanes"], right: Float[Array, "n m *lanes"]) -> Float[Array, "n m *lanes"]:
    """A^-1 B of each lane; not finite where A is singular. Rows are scaled by their largest entries before pivots are compared."""
    n = matrix.shape[0]
    rows = jnp.arange(n).reshape((n,) + (1,) * (matrix.ndim - 2))
    largest = jnp.max(jnp.abs(matrix), axis=1, keepdims=True)
    whole = jnp.concatenate([matrix, right], axis=1) / jnp.where(largest > 0.0, largest, 1.0)

    def step(k: Array, whole: Array) -> Array:
        column = jax.lax.dynamic_index_in_dim(whole, k, 1, keepdims=False)
        chosen = (rows == jnp.argmax(jnp.where(rows >= k, jnp.abs(column), -1.0), axis=0))[:, None]
        pivot = jnp.sum(jnp.where(chosen, whole, 0.0), axis=0)
        pivot = pivot / jax.lax.dynamic_index_in_dim(pivot, k, 0)
        # the pivot's row changes places with row k, which is then all zeros but for its own column
        swapped = jnp.where(chosen, jax.lax.dynamic_index_in_dim(whole, k, 0), whole)
        factor = jax.lax.dynamic_index_in_dim(swapped, k, 1)
        return jnp.where((rows == k)[:, None], pivot, swapped - factor * pivot)

    return jax.lax.fori_loop(0, n, step, whole)[:, n:]


def inverse(matrix: Float[Array, "n n *lanes"]) -> Float[Array, "n n *lanes"]:
    """A^-1 of each lane."""
    n = matrix.shape[0]
    unit = jnp.eye(n, dtype=matrix.dtype).reshape((n, n) + (1,) * (matrix.ndim - 2))
    return eliminated(matrix, jnp.broadcast_to(unit, matrix.shape))
