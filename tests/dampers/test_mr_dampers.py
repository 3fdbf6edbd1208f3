"""Bouc-Wen and hybrid dampers in the suspension: independent solutions, step size, energy, chain of the hybrid by hand."""

import dataclasses

import jax
import jax.numpy as jnp
import laws
import numpy as np
import pytest
import scipy.integrate

import railjax
from railjax.dampers.bouc_wen import BoucWen
from railjax.dampers.bouc_wen_damper import COACH_BOUC_WEN, COACH_FORCE
from railjax.model.damper import Seen
from railjax.simulation.runge_kutta import rk4
from railjax.simulation.step_size import STABLE_RADIUS, largest_step

DAMPER = railjax.BoucWenDamper()
COACH = railjax.load_vehicle("coach")
SEEN = Seen({}, {})  # the MR dampers look at nothing but their own travel


def driven(damper, motion, duration, steps):
    """Force of the pair at the start of every step, for a prescribed travel x(t): the project's RK4 with its hold."""
    dt = duration / steps

    def at(t):
        return jax.jvp(motion, (t,), (1.0,))

    def step(internal, index):
        start = at(index * dt)
        internal = damper.held(COACH, *start, internal, SEEN)

        def stage(k, internal, sums):
            return damper.force(COACH, *at((index + (0.0, 0.5, 0.5, 1.0)[k]) * dt), internal)[1], sums

        return rk4(stage, internal, None, dt)[0], damper.force(COACH, *start, internal)[0]

    internal = jnp.zeros(damper.internal_states)
    return np.asarray(jax.jit(lambda: jax.lax.scan(step, internal, jnp.arange(steps * 1.0))[1])())


def independent(motion, velocity, duration, times, gain, p=BoucWen(), s=COACH_FORCE):  # noqa: B008, frozen
    """Two dampers of eqs. (12)-(18) in NumPy, by SciPy; the force at some times, and the largest |z|. Without gain always at 1 V."""

    def parts(t, state):
        y, z, u = state
        x, v = motion(t), velocity(t)
        alpha, c0, c1 = s * (p.alpha_a + p.alpha_b * u), s * (p.c0a + p.c0b * u), s * (p.c1a + p.c1b * u)
        y_rate = (alpha * z + c0 * v + s * p.k0 * (x - y)) / (c0 + c1)
        return x, v, y_rate, c1

    def rate(t, state):
        _, z, u = state
        x, v, y_rate, _ = parts(t, state)
        r = v - y_rate
        z_rate = -p.gamma * abs(r) * abs(z) ** (p.n - 1) * z - p.beta * r * abs(z) ** p.n + p.A * r
        command = 1.0 if gain is None else min(gain * abs(x), 2.25) if x * v < 0 else 0.0
        return [y_rate, z_rate, p.eta * (command - u)]

    run = scipy.integrate.solve_ivp(
        rate, (0.0, duration), [0.0] * 3, method="LSODA", rtol=1e-8, atol=1e-11, t_eval=times, max_step=1e-4
    )
    force = [2 * (c1 * y_rate + s * p.k1 * x) for x, _, y_rate, c1 in (parts(t, y) for t, y in zip(run.t, run.y.T, strict=True))]
    return np.array(force), np.abs(run.y[1]).max()


@pytest.mark.parametrize("gain", [0.0, 300.0])
def test_bouc_wen_at_one_millisecond_is_the_stiff_solution(gain):
    """Two tones, up to 0.5 m/s: the loop's own rate is 4e4 1/s there. Voltage law held over a step, its lag included."""
    duration, steps = 0.6, 600

    def motion(t, lib=jnp):
        return 0.01 * lib.sin(2 * np.pi * 3.0 * t) + 0.008 * lib.sin(2 * np.pi * 6.2 * t)

    def velocity(t):
        return 2 * np.pi * (0.03 * np.cos(2 * np.pi * 3.0 * t) + 0.008 * 6.2 * np.cos(2 * np.pi * 6.2 * t))

    found = driven(dataclasses.replace(DAMPER, voltage_gain=gain), motion, duration, steps)
    times = np.arange(steps) * duration / steps
    exact, largest = independent(lambda t: motion(t, np), velocity, duration, times, gain)
    assert largest == pytest.approx(np.sqrt(301 / 7.26e6), rel=0.02)  # it yields
    error = np.sqrt(np.mean((found - exact) ** 2) / np.mean(exact**2))
    # a decision held is half a step late
    assert error < (1e-3 if gain == 0.0 else 2e-2), error
    # the smooth law, which integrates eq. (14) itself, at 0.02 ms
    smooth = dataclasses.replace(DAMPER, voltage_gain=gain, law="smooth", velocity_width=1e-3)
    error = driven(smooth, motion, duration, 50 * steps)[::50] - exact
    assert np.sqrt(np.mean(error**2) / np.mean(exact**2)) < 1e-2


def test_bouc_wen_of_exponent_1():
    """The published loop of a larger damper, its accumulator left out."""
    p = BoucWen(44.0, 440.0, 85e3, 900.0, 1.0872e6, 4.9616e6, 14e3, 0.0, 0.0, 300.0, 300.0, 1.2, n=1.0)
    wave = 2 * np.pi * 3.0
    damper = dataclasses.replace(DAMPER, parameters=p, voltage_gain=0.0, voltage=1.0)
    found = driven(damper, lambda t: 0.01 * jnp.sin(wave * t), 0.6, 600)
    times = np.arange(600) * 1e-3
    motion = lambda t: 0.01 * np.sin(wave * t)  # noqa: E731
    always = lambda t: 0.01 * wave * np.cos(wave * t)  # noqa: E731
    exact, _ = independent(motion, always, 0.6, times, None, p, 1.0)
    assert np.sqrt(np.mean((found - exact) ** 2) / np.mean(exact**2)) < 1e-3


def test_bouc_wen_force_in_the_coach_does_not_depend_on_the_step(coach):
    """1 ms against 0.05 ms to 1 %, periodic track at 220 km/h with flange contact."""
    options = {"track": railjax.SinusoidTrack(10e-3, 20.0), "damper": DAMPER, "duration": 2.0, "sample": 1e-2}
    coarse, fine = (
        np.asarray(railjax.simulate(coach, 220 / 3.6, dt=dt, record=["damper_force"], **options)["damper_force"])
        for dt in (1e-3, 5e-5)
    )
    assert np.sqrt(np.mean((coarse - fine) ** 2) / np.mean(fine**2)) < 0.01


def test_order_of_the_closed_form_loop():
    """At constant voltage: 1e-6 at 1 ms while the damper moves on; through its turns, where z' jumps within a step, order 2."""
    damper = dataclasses.replace(DAMPER, voltage_gain=0.0, voltage=1.0)

    def errors(frequency, duration, counts):
        motion = lambda t: 0.01 * jnp.sin(2 * np.pi * frequency * t)  # noqa: E731
        *last, exact = (driven(damper, motion, duration * (n + 1) / n, n + 1)[-1] for n in [*counts, 20_000])
        return np.abs(np.array(last) / exact - 1.0)

    assert errors(1.0, 0.12, [120]).max() < 1e-6
    counts = np.round(np.geomspace(60, 1000, 6)).astype(int)
    found = errors(5.0, 0.33, counts.tolist())
    assert found.max() < 5e-4
    assert -np.polyfit(np.log(counts), np.log(found), 1)[0] > 1.6


def test_bouc_wen_takes_energy_out_of_every_cycle():
    for law, steps in (("sharp", 400), ("smooth", 20_000)):
        for gain in (0.0, 200.0):
            damper = dataclasses.replace(DAMPER, voltage_gain=gain, law=law)
            force = driven(damper, lambda t: 0.01 * jnp.sin(2 * np.pi * 5.0 * t), 0.4, steps)
            velocity = 0.1 * np.pi * np.cos(2 * np.pi * 5.0 * np.arange(steps) * 0.4 / steps)
            # the second cycle, the first being the virgin curve
            assert np.mean((force * velocity)[steps // 2 :]) > 100.0, (law, gain)


def test_the_coach_s_bouc_wen_damper_is_as_strong_as_table_2_s():
    """5 kN at a steady 0.1 m/s and full voltage, without the springs."""
    stiff = dataclasses.replace(COACH_BOUC_WEN, k0=0.0, k1=0.0)
    force = driven(dataclasses.replace(DAMPER, parameters=stiff, voltage=2.25, voltage_gain=0.0), lambda t: 0.1 * t, 0.4, 400)
    assert force[-1] / 2 == pytest.approx(5e3, rel=2e-3)


def test_lanes_of_the_bouc_wen_damper(coach):
    start = {"wheelset_y": [6e-3, 5e-3, -4e-3, 3e-3], "carbody_y": 5e-3}

    def run(gain):
        damper = dataclasses.replace(DAMPER, voltage_gain=gain)
        return railjax.simulate(coach, 50.0, damper=damper, duration=0.2, initial=start, record=["damper_force"]).final

    np.testing.assert_allclose(run(300.0), run(jnp.array([0.0, 300.0]))[:, 1], rtol=1e-8, atol=1e-12)


def test_bounds_on_the_step(coach):
    """The closed form asks for no more than the vehicle and the series dashpot; the smooth law for its loop's rate."""
    p = COACH_BOUC_WEN
    at_full = (p.alpha_a + 2.25 * p.alpha_b) * p.A / (p.c0a + p.c1a + 2.25 * (p.c0b + p.c1b))
    assert 0.9 < STABLE_RADIUS / float(largest_step(coach, 55.0, DAMPER)) / at_full < 1.2
    smooth = STABLE_RADIUS / float(largest_step(coach, 55.0, dataclasses.replace(DAMPER, law="smooth")))
    assert smooth == pytest.approx(2 * np.sqrt(301 * 7.26e6) * 0.5, rel=0.01)


def hybrid_by_hand(velocity, current):
    """One damper, numbers of section 4."""
    area, pilot = np.pi / 4 * (0.05**2 - 0.02**2), np.pi / 4 * 0.012**2
    held = (34.0 + 406.7 * current / 1.5) / pilot
    wanted = area * np.abs(velocity) / (0.61 * np.sqrt(2 * held / 880.0)) / 6e-3
    opening = 6e-3 * np.clip(wanted, 0.54e-3, 2e-3)
    return np.sign(velocity) * area * 440.0 * (area * velocity / (0.61 * opening)) ** 2


def test_hybrid_from_current_to_force(coach):
    velocity = np.linspace(-0.6, 0.6, 241)
    travel = jnp.full_like(velocity, 0.01)
    damper = railjax.HybridDamper(0.8)
    for current in (0.0, 0.5, 1.5):
        internal = jnp.asarray(np.stack([np.full_like(velocity, current), *np.zeros((2, 241))]))
        force, _ = damper.force(coach, travel, jnp.asarray(velocity), internal)
        np.testing.assert_allclose(force, 2 * hybrid_by_hand(velocity, current), rtol=1e-6, atol=1e-9)
    # the current is the one that makes alpha k |x| per damper, here 1064 N, within what the pilot holds
    internal = damper.held(coach, travel, jnp.asarray(velocity), jnp.zeros((3, 241)), SEEN)
    _, rate = damper.force(coach, travel, jnp.asarray(velocity), internal)
    command = np.asarray(rate[0]) * 5e-3
    np.testing.assert_array_equal(command[velocity >= 0], 0.0)
    area, pilot = np.pi / 4 * (0.05**2 - 0.02**2), np.pi / 4 * 0.012**2
    expected = 1.5 * (0.8 * 133e3 * 0.01 / area * pilot - 34.0) / 406.7
    np.testing.assert_allclose(command[velocity < 0], expected, rtol=1e-9)
    assert abs(hybrid_by_hand(0.1, expected)) == pytest.approx(1064.0, rel=1e-6)


def test_hybrid_without_current_is_a_passive_damper(coach):
    """alpha = 0: no command ever; the same characteristic in both directions and at any travel."""
    damper = railjax.HybridDamper(0.0)
    for seed in range(3):
        travel, velocity, internal, seen = laws.instant(coach, damper, seed)
        force, rate = laws.force(coach, damper, travel, velocity, internal.at[0].set(0.0), seen)
        np.testing.assert_array_equal(rate[:2], 0.0)
        np.testing.assert_allclose(force, 2 * hybrid_by_hand(np.asarray(velocity), 0.0), rtol=1e-6)
