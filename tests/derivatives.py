"""Automatic derivatives against central differences, forward and reverse, for one function of scalars or arrays."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np


def check(function: Callable, *arguments: float, step: float = 1e-6, rtol: float = 1e-6, atol: float = 1e-8) -> None:
    """Both modes against central differences of size `step` (relative above 1), for every argument; nothing may be NaN."""
    arguments = tuple(jnp.asarray(a, float) for a in arguments)

    # compiled once for all arguments, for that is what takes long
    @jax.jit
    def all_of(*at):
        def total(*values):
            return jnp.sum(function(*values))

        def along(index):
            def of_one(a):
                return total(*at[:index], a, *at[index + 1 :])

            return jax.jvp(of_one, (at[index],), (jnp.ones_like(at[index]),))[1]

        indices = range(len(at))
        reverse = jax.grad(total, argnums=tuple(indices))(*at)
        return total(*at), [along(index) for index in indices], [jnp.sum(part) for part in reverse]

    _, forwards, reverses = all_of(*arguments)
    for index, (argument, forward, reverse) in enumerate(zip(arguments, forwards, reverses, strict=True)):
        h = step * max(float(jnp.max(jnp.abs(argument))), 1.0)
        above, below = (all_of(*arguments[:index], argument + by, *arguments[index + 1 :])[0] for by in (h, -h))
        assert np.isfinite(forward), f"argument {index}: forward derivative is {forward}"
        assert np.isfinite(reverse), f"argument {index}: reverse derivative is {reverse}"
        np.testing.assert_allclose(forward, reverse, rtol=1e-10, atol=1e-3 * atol)
        np.testing.assert_allclose(forward, (above - below) / (2 * h), rtol=rtol, atol=atol)
