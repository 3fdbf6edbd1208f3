"""Values of quantities and their derivatives by the parameters of a design space, each in its own mode."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .design_space import DesignSpace
from .kernels import jit as one_kernel
from .quantities import Quantity, Trees


def differentiated(
    quantity: Quantity, space: DesignSpace, x: Float[np.ndarray, "lanes parameters"]
) -> tuple[Float[np.ndarray, "lanes"], Float[np.ndarray, "lanes parameters"]]:
    """Values and derivatives at points of the unit box.

    In reverse mode all points are one call, and the gradient with respect to everything is formed and projected, so that one
    compilation serves every choice of parameters. In forward mode, through time, points take turns: only what is tuned carries
    tangents, and a run alone is one kernel.
    """
    if quantity.mode == "forward":
        found = [_forward(quantity, space, jnp.asarray(point)) for point in x]
        return np.array([float(value) for value, _ in found]), np.array([np.asarray(slope) for _, slope in found])
    values, slopes = _reverse(quantity, *space.stacked(jnp.asarray(x)))
    return np.array(values), np.array(slopes)


@jax.jit
def _reverse(quantity: Quantity, trees: Trees, tangents: Trees):
    # one after another, as LAPACK's batched calls deadlock when several are at work (`linear`)
    values, gradients = jax.lax.map(jax.value_and_grad(lambda tree: quantity.value(*tree)), trees)
    along = jax.tree.map(lambda g, t: jnp.sum(g[:, None] * t, axis=tuple(range(2, t.ndim))), gradients, tangents)
    return values, sum(jax.tree.leaves(along))


@one_kernel
def _forward(quantity: Quantity, space: DesignSpace, x: Float[Array, "parameters"]):
    def of(x: Float[Array, "parameters"]) -> Float[Array, ""]:
        return quantity.value(*space.apply(x))

    if x.shape[0] == 1:
        value, slope = jax.jvp(of, (x,), (jnp.ones(1),))
        return value, slope[None]
    values, slopes = jax.vmap(lambda tangent: jax.jvp(of, (x,), (tangent,)))(jnp.eye(x.shape[0]))
    return values[0], slopes
