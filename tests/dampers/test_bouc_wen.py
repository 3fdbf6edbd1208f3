"""The modified Bouc-Wen damper against eqs. (12)-(17) written anew in NumPy and integrated by SciPy's LSODA."""

import dataclasses

import derivatives
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.special
from scipy.integrate import solve_ivp

import railjax
from railjax.base import smooth
from railjax.dampers import bouc_wen, power_loop
from railjax.dampers.bouc_wen import BoucWen

PUBLISHED = BoucWen()
#: a larger damper's published loop; its other springs and dashpots are those of the prototype, times 3
LARGE = BoucWen(
    c0a=44.0, c0b=440.0, c1a=85e3, c1b=900.0, alpha_a=1.0872e6, alpha_b=4.9616e6, x0=0.0, gamma=300.0, beta=300.0, A=1.2, n=1.0
)


def travel(t, times=1.0):
    """A secondary suspension at speed: 10 mm at 1.3 Hz, 1.2 mm at 5.7 Hz; 0.12 m/s. Displacement and velocity."""
    waves = ((10e-3, 1.3, 0.0), (1.2e-3, 5.7, 1.0))
    return (
        sum(times * a * np.sin(2 * np.pi * f * t + phase) for a, f, phase in waves),
        sum(times * 2 * np.pi * f * a * np.cos(2 * np.pi * f * t + phase) for a, f, phase in waves),
    )


def reference(p, time, voltage, times=1.0):
    """Force of eqs. (12)-(17) at a constant voltage, from y = z = 0."""
    c0, c1, alpha = p.c0a + p.c0b * voltage, p.c1a + p.c1b * voltage, p.alpha_a + p.alpha_b * voltage

    def inner(t, y, z):
        x, v = travel(t, times)
        return (alpha * z + c0 * v + p.k0 * (x - y)) / (c0 + c1)

    def rate(t, state):
        y, z = state
        y_dot = inner(t, y, z)
        w = travel(t, times)[1] - y_dot
        return [y_dot, -p.gamma * abs(w) * abs(z) ** (p.n - 1) * z - p.beta * w * abs(z) ** p.n + p.A * w]

    found = solve_ivp(rate, (0, time[-1]), [0, 0], "LSODA", time, rtol=1e-9, atol=1e-12, max_step=2e-4)
    assert found.success
    return c1 * inner(time, *found.y) + p.k1 * (travel(time, times)[0] - p.x0)


def stepped(p, time, voltage, steps=1):
    """The same by `bouc_wen.step`, one step a sample."""
    x, v = (jnp.asarray(values) for values in travel(np.asarray(time)))
    dt = time[1] - time[0]

    def one(state, ends):
        after = bouc_wen.step(p, *ends, *state, voltage, dt, steps)
        return after, after

    zero = jnp.zeros(jnp.broadcast_shapes(jnp.shape(p.alpha_a), jnp.shape(voltage)))
    _, (y, z) = jax.lax.scan(one, (zero, zero), (x[:-1], x[1:]))
    y, z = (jnp.concatenate([zero[None], values]) for values in (y, z))
    wide = (slice(None), *[None] * zero.ndim)
    return bouc_wen.force(p, x[wide], v[wide], y, z, voltage)


def error(found, expected):
    return np.sqrt(np.mean((np.asarray(found) - expected) ** 2)) / np.std(expected)


@jax.jit
def stepped_at_1_ms(p, voltage):
    return stepped(p, 1e-3 * np.arange(1201), voltage)


@pytest.mark.parametrize(
    ("voltage", "shape"), [(0.0, (0.5, 1.5)), (0.0, (1.0, 1.0)), (2.25, (1.5, 0.5)), (5.0, (1.0, 1.0)), (5.0, (0.5, 1.5))]
)
def test_steps_of_1_ms_follow_the_equations(voltage, shape):
    """Published loop, and both signs of beta - gamma, where unloading is no straight line."""
    p = dataclasses.replace(PUBLISHED, gamma=shape[0] * PUBLISHED.gamma, beta=shape[1] * PUBLISHED.beta)
    expected = reference(p, 1e-3 * np.arange(1201), voltage)
    assert error(stepped_at_1_ms(p, voltage), expected) < (6e-4 if voltage < 5 else 1.5e-3)


def test_steps_are_of_second_order_and_can_be_cut():
    voltage, fine = 1.0, np.arange(0.0, 0.8001, 0.25e-3)
    expected = reference(PUBLISHED, fine, voltage)
    # at instants common to all: of 4 ms
    errors = [error(stepped(PUBLISHED, fine[::every], voltage)[:: 16 // every], expected[::16]) for every in (2, 4, 8, 16)]
    assert np.log2(errors[-1] / errors[0]) / 3 == pytest.approx(2.0, abs=0.3)
    # x goes evenly within a step, which costs little beside what is gained
    assert error(stepped(PUBLISHED, fine[::16], 5.0, 4), reference(PUBLISHED, fine, 5.0)[::16]) < 0.06


@pytest.mark.parametrize("dt", [5e-3, 0.1, 10.0])
def test_no_step_is_too_long(dt):
    """Explicit steps of 1 ms leave the loop at 0.3 m/s; here nothing leaves it at 100 m/s."""
    y = z = 0.0
    for start, end in ((0.0, 1.0), (1.0, -1.0), (-1.0, 1.0)):
        y, z = bouc_wen.step(PUBLISHED, start * 100 * dt, end * 100 * dt, y, z, 2.0, dt)
        limit = np.sqrt(PUBLISHED.A / (PUBLISHED.gamma + PUBLISHED.beta))
        assert abs(float(z)) == pytest.approx(limit, rel=1e-9)


def test_the_solution_of_a_step_satisfies_its_equation():
    random = np.random.default_rng(3)
    start, end, y = (jnp.asarray(random.normal(0, 5e-4, 400)) for _ in range(3))
    z = jnp.asarray(random.uniform(-6.4e-3, 6.4e-3, 400))
    u = jnp.asarray(random.uniform(0, 5, 400))
    dt = 1e-3
    after_y, after_z = bouc_wen.step(PUBLISHED, start, end, y, z, u, dt)
    path = (end - after_y) - (start - y)
    np.testing.assert_allclose(after_z, bouc_wen.along_path(PUBLISHED, z, path)[0], rtol=1e-9, atol=1e-12)
    alpha, c0, c1 = bouc_wen.by_voltage(PUBLISHED, u)
    mean_rate = alpha * 0.5 * (z + after_z) + PUBLISHED.k0 * (start - y + 0.5 * path)
    np.testing.assert_allclose((c0 + c1) * path, c1 * (end - start) - dt * mean_rate, atol=1e-9)


def of_exponent(n):
    """The prototype's loop, as high, by another exponent."""
    height = float(bouc_wen.largest(PUBLISHED)) ** (2.0 - n)
    return dataclasses.replace(PUBLISHED, n=n, gamma=PUBLISHED.gamma * height, beta=PUBLISHED.beta * height)


@pytest.mark.parametrize(("n", "voltage"), [(1.0, 1.5), (1.5, 1.5), (3.0, 0.0)])
def test_steps_of_other_exponents_follow_the_equations(n, voltage):
    p, time = of_exponent(n), 1e-3 * np.arange(1201)
    assert error(stepped_at_1_ms(p, voltage), reference(p, time, voltage)) < 1e-3


def test_the_published_loop_of_exponent_1():
    time = 1e-3 * np.arange(1201)
    expected = reference(LARGE, time, 1.0)
    assert error(stepped_at_1_ms(LARGE, 1.0), expected) < 1e-3
    assert error(stepped_at_1_ms(dataclasses.replace(LARGE, n=1.5), 1.0), expected) > 0.05


@pytest.mark.parametrize(("dt", "parts", "n"), [(2e-3, 2, 2.0), (20e-3, 16, 2.0), (5e-3, 8, 1.5)])
def test_a_response_is_cut_as_fine_as_its_own_error_asks(dt, parts, n):
    """0.5 m/s; the driver's lag is out of the way."""
    p = dataclasses.replace(of_exponent(n), eta=1e9)
    time = dt * np.arange(round(0.6 / dt) + 1)
    x, v = map(jnp.asarray, travel(time, 4.1))
    expected = reference(p, time, 1.5, 4.1)
    start = jnp.array([x[0], 0.0, 1.5])  # y = z = 0
    command = jnp.full(len(time), 1.5)
    assert bouc_wen.parts_needed(p, bouc_wen.motion_of(x, v, command), dt, start[None]) == parts
    assert error(bouc_wen.response(p, x, v, command, dt, parts, start), expected) < 1e-3
    assert error(bouc_wen.response(p, x, v, command, dt, 1, start), expected) > 1e-3


@pytest.mark.parametrize("n", [1.2, 1.5, 3.0, 8.0])
def test_the_power_loop_is_the_hypergeometric_function_and_its_inverse(n):
    zeta = jnp.asarray(np.concatenate([np.geomspace(1e-6, 0.9, 20), 1 - np.geomspace(1e-10, 0.1, 20)]))
    for kappa in (-1.0, -0.4, 0.0, 0.6, 1.0):
        there = power_loop.path_to(zeta, jnp.asarray(kappa), n)
        known = scipy.special.hyp2f1(1.0, 1.0 / n, 1.0 + 1.0 / n, kappa * np.asarray(zeta) ** n)
        np.testing.assert_allclose(there, zeta * known, rtol=1e-7)
        np.testing.assert_allclose(power_loop.reached(there, jnp.asarray(kappa), n), zeta, rtol=1e-12)


@pytest.mark.parametrize("n", [1.0, 1.5])
def test_derivatives_along_the_path(n):
    """Forward, reverse and central differences: unloading, through zero, loading, near saturation; finite at rest."""
    p = of_exponent(n)
    z, path = jnp.array([-5e-3, -1e-3, 0.0, 4e-3, -6.43e-3]), jnp.array([1e-5, 3e-5, 2e-5, 1e-5, 2e-4])

    def after(factors, z, path):
        changed = {key: factors[k] * getattr(p, key) for k, key in enumerate(("A", "beta", "gamma"))}
        return jnp.sum(1e3 * bouc_wen.along_path(dataclasses.replace(p, **changed), z, path)[0])

    here = (jnp.array([1.0, 1.0, 0.7]), z, path)
    derivatives.check(
        lambda a, z, s: after(a, 1e-2 * z, 1e-4 * s), here[0], z / 1e-2, path / 1e-4, step=1e-6, rtol=1e-5, atol=1e-6
    )
    for values in jax.jacrev(after, (0, 1, 2))(here[0], 0.0 * z, 0.0 * path):
        assert np.all(np.isfinite(values))


@pytest.mark.parametrize(("shape", "n"), [(1.0, 2.0), (0.3, 2.0), (1.8, 2.0), (0.3, 1.0), (1.8, 1.0), (1.0, 1.5)])
def test_along_path_solves_eq_14(shape, n):
    p = of_exponent(n)
    p = dataclasses.replace(p, gamma=shape * p.gamma)
    for z in np.array([-0.85, -0.15, 0.0, 0.6]) * float(bouc_wen.largest(p)):
        for path in (-8e-5, -1e-7, 2e-5, 1.5e-4):
            found = solve_ivp(
                lambda s, z, path=path: p.A - p.beta * abs(z) ** n - p.gamma * np.sign(path * z) * abs(z) ** n,
                (0, path),
                [z],
                rtol=1e-10,
                atol=1e-14,
                max_step=1e-6,
            )
            after, slope = bouc_wen.along_path(p, jnp.asarray(z), jnp.asarray(path))
            assert float(after) == pytest.approx(found.y[0, -1], rel=1e-5, abs=1e-11)
            h = 1e-9
            numeric = (
                bouc_wen.along_path(p, jnp.asarray(z), jnp.asarray(path + h))[0]
                - bouc_wen.along_path(p, jnp.asarray(z), path - h)[0]
            ) / (2 * h)
            assert float(slope) == pytest.approx(float(numeric), rel=1e-4, abs=1e-3)


@pytest.mark.parametrize("n", [1.0, 1.5, 2.0, 3.0])
def test_rates(n):
    p = dataclasses.replace(PUBLISHED, n=n)
    x, v, y, z, u = 2e-3, 0.05, -1e-3, -3e-3, 1.5
    alpha, c0, c1 = 14000 + 69500 * u, 2100 + 350 * u, 28300 + 295 * u
    y_dot = (alpha * z + c0 * v + 4690 * (x - y)) / (c0 + c1)
    assert float(bouc_wen.y_rate(p, x, v, y, z, u)) == pytest.approx(y_dot, rel=1e-12)
    assert float(bouc_wen.force(p, x, v, y, z, u)) == pytest.approx(c1 * y_dot + 500 * (x - 0.143), rel=1e-12)
    # the other reading of fig. 15: the force of the upper branch is that of the dashpot c_1
    upper = alpha * z + c0 * (v - y_dot) + 4690 * (x - y) + 500 * (x - 0.143)
    assert float(bouc_wen.force(p, x, v, y, z, u)) == pytest.approx(upper, rel=1e-12)
    for w in (0.03, -0.03):
        expected = -3.63e6 * abs(w) * abs(z) ** (n - 1) * z - 3.63e6 * w * abs(z) ** n + 301 * w
        assert float(bouc_wen.z_rate(p, w, z)) == pytest.approx(expected, rel=1e-12)
        derivatives.check(lambda z, w=w: bouc_wen.z_rate(p, w, z), z, step=1e-7, rtol=1e-5, atol=1e-6)
        assert np.isfinite(float(jax.grad(lambda z, w=w: bouc_wen.z_rate(p, w, z))(0.0)))


def test_the_driver_lags():
    u, command, dt = 0.3, 2.0, 4e-3
    found = solve_ivp(lambda t, u: -190 * (u - command), (0, dt), [u], rtol=1e-10, atol=1e-12)
    assert float(bouc_wen.lagged(PUBLISHED, u, command, dt)) == pytest.approx(found.y[0, -1], rel=1e-7)
    assert float(bouc_wen.u_rate(PUBLISHED, u, command)) == pytest.approx(190 * 1.7)


def test_derivatives_of_a_run():
    """Forward, reverse and central differences, by every parameter of the loop."""
    time = np.arange(0.0, 0.3005, 1e-3)
    keys = [field.name for field in bouc_wen.leaves(PUBLISHED) if field.name != "eta"]

    def mean_square(factors):
        changed = {key: factors[index] * getattr(PUBLISHED, key) for index, key in enumerate(keys)}
        return jnp.mean(stepped(dataclasses.replace(PUBLISHED, **changed), time, 1.3) ** 2)

    here, h = jnp.ones(len(keys)), 1e-6
    forward, reverse = jax.jit(jax.jacfwd(mean_square))(here), jax.jit(jax.jacrev(mean_square))(here)
    ends = jax.jit(jax.vmap(mean_square))(jnp.concatenate([here + h * jnp.eye(len(keys)), here - h * jnp.eye(len(keys))]))
    np.testing.assert_allclose(forward, reverse, rtol=1e-9)
    np.testing.assert_allclose(forward, (ends[: len(keys)] - ends[len(keys) :]) / (2 * h), rtol=1e-5, atol=1e-2)
    assert np.all(np.abs(forward) > 1.0)


def test_derivatives_are_finite_at_rest():
    def after(x, y, z):
        return jnp.stack(bouc_wen.step(PUBLISHED, 0.0, x, y, z, 0.0, 1e-3))

    for jacobian in (jax.jacfwd, jax.jacrev):
        for values in jax.jit(jacobian(after, (0, 1, 2)))(0.0, 0.0, 0.0):
            assert np.all(np.isfinite(values))


def test_scaled_damper_is_alike():
    """Half the travel, five times the force: F(x) = 5 F_0(2 x)."""
    time = np.arange(0.0, 0.5005, 1e-3)
    changed = bouc_wen.scaled(PUBLISHED, force=5.0, displacement=2.0)
    x, y, z, v = 1e-3, 2e-4, -2e-3, 0.03
    force = bouc_wen.force(changed, 2 * x, 2 * v, 2 * y, 2 * z, 1.0)
    assert float(force) == pytest.approx(5.0 * float(bouc_wen.force(PUBLISHED, x, v, y, z, 1.0)), rel=1e-12)
    one = bouc_wen.step(PUBLISHED, 0.0, x, y, z, 1.0, time[1])
    other = bouc_wen.step(changed, 0.0, 2 * x, 2 * y, 2 * z, 1.0, time[1])
    assert float(other[0]) == pytest.approx(2 * float(one[0]), rel=1e-10)
    assert float(other[1]) == pytest.approx(2 * float(one[1]), rel=1e-10)
    assert changed.eta == PUBLISHED.eta


def test_lanes_of_parameters():
    time = np.arange(0.0, 0.2005, 1e-3)
    many = dataclasses.replace(PUBLISHED, alpha_b=jnp.array([1e4, 7e4]))
    found = stepped(many, time, jnp.array([1.0, 2.0]))
    for lane, (alpha_b, voltage) in enumerate(((1e4, 1.0), (7e4, 2.0))):
        alone = stepped(dataclasses.replace(PUBLISHED, alpha_b=alpha_b), time, voltage)
        np.testing.assert_allclose(found[:, lane], alone, rtol=1e-10, atol=1e-9)


def test_exponents_below_1_are_refused():
    with pytest.raises(railjax.InputError, match=r"n must be at least 1, not 0\.5"):
        bouc_wen.step(dataclasses.replace(PUBLISHED, n=0.5), 0.0, 1e-3, 0.0, 0.0, 0.0, 1e-3)


def test_even_functions_join_smoothly():
    """Across the bounds of the series, with their derivatives."""
    q = np.array([-2.0, -0.5, -1e-3, -1e-5, 0.0, 1e-5, 1e-3, 0.4, 0.98])
    for own, exact in ((smooth.tanhc, np.tanh), (smooth.artanhc, np.arctanh)):

        def quotient(q, exact=exact):
            root = np.sqrt(np.where(q == 0, 1.0, q).astype(complex))
            return np.where(q == 0, 1.0, (exact(root) / root).real)

        np.testing.assert_allclose(own(jnp.asarray(q)), quotient(q), rtol=1e-12)
        slope = jax.vmap(jax.grad(own))(jnp.asarray(q))
        np.testing.assert_allclose(slope, (quotient(q + 1e-5) - quotient(q - 1e-5)) / 2e-5, rtol=1e-4)
