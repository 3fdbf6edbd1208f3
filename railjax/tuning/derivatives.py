"""Values of quantities and their derivatives by the parameters of a design space, each in its own mode."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..base.compilation import HASTY
from ..base.compilation import jit as one_kernel
from .design_space import DesignSpace
from .quantity import Quantity, Trees


def differentiated(
    quantity: Quantity, space: DesignSpace, x: Float[np.ndarray, "lanes parameters"]
) -> tuple[Float[np.ndarray, "lanes"], Float[np.ndarray, "lanes parameters"]]:
    """Values and derivatives at points of the unit box."""
    return differentiated_to_the_end(quantity, space, x)[:2]


def differentiated_to_the_end(
    quantity: Quantity, space: DesignSpace, x: Float[np.ndarray, "lanes parameters"]
) -> tuple[Float[np.ndarray, "lanes"], Float[np.ndarray, "lanes parameters"], list[Any]]:
    """Values, derivatives and, for each point, the `end` that `Quantity.check` takes.

    Points take turns. In reverse mode the gradient with respect to everything is formed and then projected, so that one compilation
    serves every choice of parameters. In forward mode, through time, only what is tuned carries tangents, and a run alone is one
    kernel.
    """
    if quantity.mode == "forward":
        found = [_forward(quantity, space, jnp.asarray(point)) for point in x]
        values, slopes, ends = zip(*found, strict=True)
        return np.array([float(value) for value in values]), np.array([np.asarray(slope) for slope in slopes]), list(ends)
    values, slopes = np.empty(len(x)), np.empty(x.shape)  # type: ignore[assignment]
    for k, point in enumerate(x):
        trees, tangents = space.along(jnp.asarray(point))
        value, gradients = _reverse(quantity, trees)
        values[k], slopes[k] = float(value), np.asarray(_projected(gradients, tangents))  # type: ignore[index]
    return values, slopes, [None] * len(x)


def _reverse(quantity: Quantity, trees: Trees):
    return (_reverse_compiled if quantity.traced else _value_and_gradient)(quantity, trees)


def _value_and_gradient(quantity: Quantity, trees: Trees):
    return jax.value_and_grad(lambda trees: quantity.value(*trees))(trees)


_reverse_compiled = jax.jit(_value_and_gradient, compiler_options=HASTY)


@jax.jit
def _projected(gradients: Trees, tangents: Trees) -> Float[Array, "parameters"]:
    """Scalar products of a gradient with the tangents, which are first along their axes."""
    along = jax.tree.map(lambda g, t: jnp.sum(g * t, axis=tuple(range(1, t.ndim))), gradients, tangents)
    return sum(jax.tree.leaves(along))


@one_kernel
def _forward(quantity: Quantity, space: DesignSpace, x: Float[Array, "parameters"]):
    def of(x: Float[Array, "parameters"]) -> tuple[Float[Array, ""], Any]:
        return quantity.ended(*space.apply(x))

    if x.shape[0] == 1:
        value, slope, end = jax.jvp(of, (x,), (jnp.ones(1),), has_aux=True)
        return value, slope[None], end
    along = jax.vmap(lambda tangent: jax.jvp(of, (x,), (tangent,), has_aux=True), out_axes=(None, 0, None))
    return along(jnp.eye(x.shape[0]))
