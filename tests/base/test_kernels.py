"""The attributes that make XLA compile few, large kernels: still understood, and without effect on the numbers."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import railjax
from railjax.base import compilation as kernels


def loop(x):
    return jax.lax.scan(lambda c, _: (jnp.sin(c) + 0.1 * x, jnp.sum(c)), x, length=50)


def test_one_kernel_reaches_the_compiler_and_keeps_the_numbers():
    x = jnp.arange(5.0)
    compiled = jax.jit(kernels.one_kernel(loop)).lower(x).compile()
    assert "xla_cpu_small_call" in compiled.as_text()
    for a, b in zip(jax.tree.leaves(compiled(x)), jax.tree.leaves(loop(x)), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-14)


def test_fence_is_transparent_to_every_transformation():
    plain = lambda x, y: (x * jnp.sin(y), y**2)  # noqa: E731
    fenced = kernels.fence(plain)
    x, y = jnp.arange(1.0, 4.0), jnp.arange(2.0, 5.0)

    def total(f):
        return lambda x, y: sum(jnp.sum(part) for part in f(x, y))

    for transform in (
        lambda f: f,
        jax.jit,
        lambda f: jax.vmap(f),
        lambda f: jax.grad(total(f), argnums=(0, 1)),
        lambda f: jax.jit(jax.grad(total(f), argnums=(0, 1))),
        lambda f: jax.jacfwd(f, argnums=1),
    ):
        for a, b in zip(jax.tree.leaves(transform(fenced)(x, y)), jax.tree.leaves(transform(plain)(x, y)), strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-14)


@pytest.mark.parametrize(
    "function",
    [
        loop,
        lambda x: jnp.linalg.solve(jnp.diag(x + 1), x),
        lambda x: jnp.sort(-x),
        lambda x: x.at[jnp.array([0, 1])].add(1.0),
        lambda x: jax.pure_callback(np.sin, x, x, vmap_method="sequential"),
        jax.grad(lambda x: jnp.sum(loop(x)[0] ** 2)),
    ],
    ids=["loop", "solve", "sort", "scatter", "callback", "gradient"],
)
def test_railjax_jit_is_jax_jit(function):
    """Also where XLA refuses to make one kernel of it."""
    x = jnp.arange(5.0)
    ours, theirs = railjax.jit(function), jax.jit(function)
    for _ in range(2):
        for a, b in zip(jax.tree.leaves(ours(x)), jax.tree.leaves(theirs(x)), strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-13)
    batched = jax.vmap(ours)(jnp.stack([x, x + 1]))
    for a, b in zip(jax.tree.leaves(batched), jax.tree.leaves(jax.vmap(theirs)(jnp.stack([x, x + 1]))), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-13)


def test_a_parameter_of_no_use_does_no_harm(coach):
    """rho_cy has none beside balance logic; XLA aborts on an argument of its kernel that it can do without."""

    def comfort(secondary):
        vehicle = railjax.replace(coach, secondary=secondary)
        run = railjax.simulate(
            vehicle, 60.0, damper=railjax.BalanceLogic(0.5), duration=0.02, record=(), reduce=["rms:wheelset_y"]
        )
        return run["rms:wheelset_y"]

    moving = jax.tree.map(jnp.asarray, coach.secondary)
    np.testing.assert_array_equal(railjax.jit(comfort)(moving), comfort(coach.secondary))


def test_hasty_functions_are_one_program_and_known_numbers_work_within_another_trace():
    """Their own constants are not computed one by one where nothing else is traced, which took longer than the program."""
    made = []

    @kernels.hasty()
    def function(x):
        made.append(isinstance(jnp.arange(37.0) * 2.0, jax.core.Tracer))
        return x + jnp.arange(37.0) * 2.0

    x = np.linspace(0.0, 1.0, 37)
    expected = x + np.arange(37.0) * 2.0
    np.testing.assert_array_equal(function(x), expected)
    assert made == [True]
    for transform in (jax.jit, jax.vmap, lambda f: jax.jit(jax.vmap(f))):
        np.testing.assert_array_equal(transform(lambda y: function(x)[0] + y)(jnp.ones(1)), [expected[0] + 1.0])
    np.testing.assert_array_equal(jax.jit(function)(x), expected)
