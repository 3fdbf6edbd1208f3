"""Automatic derivatives against central differences, forward and reverse, for one function of scalars or arrays."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np


def check(function: Callable, *arguments: float, step: float = 1e-6, rtol: float = 1e-6, atol: float = 1e-8) -> None:
    """Both modes against central differences of size `step` (relative above 1), for every argument; nothing may be NaN."""
    arguments = tuple(jnp.asarray(a, float) for a in arguments)
    for index, argument in enumerate(arguments):

        @jax.jit
        def of_one(a, index=index):
            return jnp.sum(function(*arguments[:index], a, *arguments[index + 1 :]))

        forward = float(jax.jvp(of_one, (argument,), (jnp.ones_like(argument),))[1])
        reverse = float(jnp.sum(jax.grad(of_one)(argument)))
        h = step * max(float(jnp.max(jnp.abs(argument))), 1.0)
        numeric = float((of_one(argument + h) - of_one(argument - h)) / (2 * h))
        assert np.isfinite(forward), f"argument {index}: forward derivative is {forward}"
        assert np.isfinite(reverse), f"argument {index}: reverse derivative is {reverse}"
        np.testing.assert_allclose(forward, reverse, rtol=1e-10, atol=1e-3 * atol)
        np.testing.assert_allclose(forward, numeric, rtol=rtol, atol=atol)
