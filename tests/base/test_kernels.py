"""The attributes that make XLA compile few, large kernels: still understood, and without effect on the numbers."""

import os
import subprocess
import sys

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


RUN = """60.0, damper=railjax.BalanceLogic(0.5), initial={"wheelset_y": 9.5e-3}, duration=0.5, record=(), reduce=["rms:wheelset_y"]"""


def test_a_later_process_finds_what_was_compiled(tmp_path, coach):
    """And says nothing of it, though JAX 0.10 takes wishes of its compiler for features that the processor lacks. XLA's own settings give
    the numbers that those of tests/conftest.py do."""
    code = f"""
import sys, jax, railjax
hits = []
jax.monitoring.register_event_listener(lambda event, **_: hits.append(event) if event.endswith("/cache_hits") else None)
print(railjax.keep_compiled({str(tmp_path / "kept")!r}))
railjax.use_double_precision()
coach = railjax.load_vehicle("coach")
print(railjax.linear_critical_speed(coach))
print(float(railjax.simulate(coach, {RUN})["rms:wheelset_y"][0]))
print(len(hits))
"""
    apart = ("XLA_FLAGS", "JAX_COMPILATION_CACHE_DIR", "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "TF_CPP_MIN_LOG_LEVEL")
    environment = {key: value for key, value in os.environ.items() if key not in apart}
    runs = [subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True) for _ in range(2)]
    assert [(run.returncode, run.stderr) for run in runs] == [(0, ""), (0, "")]
    first, second = (run.stdout.split() for run in runs)
    assert first[0] == str(tmp_path / "kept")
    assert first[:3] == second[:3]
    assert first[3] == "0" < second[3]
    run = eval(f"railjax.simulate(coach, {RUN})", {"railjax": railjax, "coach": coach})
    here = float(railjax.linear_critical_speed(coach)), float(run["rms:wheelset_y"][0])
    np.testing.assert_allclose([float(value) for value in first[1:3]], here, rtol=1e-9)


def test_only_the_false_alarm_is_kept_from_standard_error(capfd):
    alarm = "E1125 15:59:58.341676 10200 cpu_aot_loader.cc:195] Loading XLA:CPU AOT result. Target machine feature {} is not  supported on"

    def load(loud):
        for feature in ("+prefer-no-gather", "+avx512f", "+prefer-no-scatter"):
            os.write(2, f"{alarm.format(feature)} the host machine.\n".encode())
        if loud:
            raise OSError("torn")
        return 1

    quiet = kernels._without_false_alarm(load)
    assert quiet(False) == 1
    with pytest.raises(OSError, match="torn"):
        quiet(True)
    os.write(2, b"after")
    lines = capfd.readouterr().err.splitlines()
    assert len(lines) == 3
    assert all("+avx512f" in line for line in lines[:2])
    assert lines[2] == "after"


def test_what_was_used_longest_ago_is_deleted_where_much_is_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(kernels, "KEPT", 1000)
    kernels._forget(tmp_path / "none")
    for k in range(10):
        (tmp_path / str(k)).write_bytes(bytes(99))
        os.utime(tmp_path / str(k), (1e9 + k, 1e9))
    kernels._forget(tmp_path)
    assert len(list(tmp_path.iterdir())) == 10
    (tmp_path / "10").write_bytes(bytes(99))
    kernels._forget(tmp_path)
    assert sorted(int(file.name) for file in tmp_path.iterdir()) == [6, 7, 8, 9, 10]
