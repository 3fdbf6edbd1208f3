"""RK4: observed order on linear, smooth and sharp laws, the bound on the step, energy of the bound's margin, gradients."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference
import scipy.integrate
import scipy.linalg

import railjax
from railjax.model.motion import PASSIVE
from railjax.simulation.runge_kutta import rk4, rk4_in_loop
from railjax.simulation.simulate import initial_state
from railjax.simulation.step_size import STABLE_RADIUS, fastest_rate, fastest_rate_on_host, largest_step

SPEED = 55.0
START = {"wheelset_y": [6e-3, 5e-3, -4e-3, 3e-3], "bogie_psi": [1e-3, -1e-3], "carbody_y": 5e-3}


def final(vehicle, dt, track=None, duration=0.4, start=START):
    run = railjax.simulate(vehicle, SPEED, track=track, duration=duration, dt=dt, sample=duration, record=[], initial=start)
    assert bool(run.ok)
    return np.asarray(run.final)


def weighed(error):
    """Displacements against velocities."""
    return np.linalg.norm(error * np.concatenate([np.full(17, 50.0), np.ones(17)]))


def slope(steps, errors):
    return np.polyfit(np.log(steps), np.log(errors), 1)[0]


#: 0.5 to 0.125 ms: the fastest modes, 30 Hz, well resolved; each number of steps is compiled on its own
STEPS = 0.4 / np.array([800, 1600, 3200])


def test_order_4_on_the_linear_model_against_expm(coach):
    linear = railjax.replace(coach, contact__law="linear")
    exact = scipy.linalg.expm(np.asarray(railjax.state_matrix(coach, SPEED)) * 0.4) @ np.asarray(
        initial_state(linear, PASSIVE, START)
    )
    errors = [weighed(final(linear, dt) - exact) for dt in STEPS]
    assert slope(STEPS, errors) == pytest.approx(4.0, abs=0.1)


def test_order_4_on_the_smooth_laws_against_dop853(smooth):
    """Creep saturated, flange engaged, track moving: an independent right-hand side integrated to 1e-12."""
    # the twins are rounded within widths that a step must resolve before the order can show
    wide = railjax.replace(smooth, contact__flange_width=4e-3, contact__creep_width=0.5)
    amplitude, wavelength = 4e-3, 12.0
    positions = np.array([9.88, 7.32, -7.32, -9.88])

    def rate(t, x):
        eta = amplitude * np.sin(2 * np.pi / wavelength * (SPEED * t + positions))
        return reference.rate(x, eta, SPEED, "smooth")

    start = np.asarray(initial_state(wide, PASSIVE, START))
    widths = reference.FLANGE_WIDTH, reference.CREEP_WIDTH
    reference.FLANGE_WIDTH, reference.CREEP_WIDTH = 4e-3, 0.5
    try:
        solved = scipy.integrate.solve_ivp(rate, (0, 0.4), start, method="DOP853", rtol=1e-12, atol=1e-14)
    finally:
        reference.FLANGE_WIDTH, reference.CREEP_WIDTH = widths
    exact = solved.y[:, -1]
    track = railjax.SinusoidTrack(amplitude, wavelength)
    errors = [weighed(final(wide, dt, track) - exact) for dt in STEPS]
    assert errors[-1] < 1e-5 * weighed(exact)
    assert slope(STEPS, errors) == pytest.approx(4.0, abs=0.1)


def test_order_of_the_sharp_laws_is_lower(coach):
    """The dead band's corners make the second derivative of the state jump: order 2, not 4, is what they leave."""
    track = railjax.SinusoidTrack(8e-3, 12.0)
    steps = 1.0 / np.round(np.geomspace(250, 4000, 7))
    exact = final(coach, 1.0 / 128000, track, duration=1.0)
    errors = [weighed(final(coach, dt, track, duration=1.0) - exact) for dt in steps]
    run = railjax.simulate(coach, SPEED, track=track, duration=1.0, reduce=["peak:flange_force"], initial=START)
    assert float(run["peak:flange_force"].max()) > 1e3, "the flange must be touched"
    observed = slope(steps, errors)
    assert 1.6 < observed < 2.7, observed


def test_fastest_rate_is_the_spectral_radius_from_above(coach):
    for speed in (3.0, 20.0, 70.0):
        both = [np.asarray(railjax.state_matrix(coach, speed, flange=flange)) for flange in (False, True)]
        radius = max(np.abs(np.linalg.eigvals(matrix)).max() for matrix in both)
        assert radius <= float(fastest_rate(coach, speed, PASSIVE)) <= 1.01 * radius
        assert radius <= fastest_rate_on_host(coach, speed, PASSIVE) <= 1.01 * radius


def test_the_step_in_a_loop_is_the_other_one():
    def pendulum(x):
        return jnp.stack([x[1], -jnp.sin(x[0])])

    x, dt = jnp.array([1.2, -0.3]), 0.2
    expected, _ = rk4(lambda _, x, nothing: (pendulum(x), nothing), x, None, dt)
    np.testing.assert_allclose(rk4_in_loop(pendulum, x, dt), expected, rtol=1e-15)


def test_stable_radius_is_that_of_rk4():
    angle = np.linspace(np.pi / 2, np.pi, 721)
    z = STABLE_RADIUS * np.exp(1j * angle)
    assert np.abs(1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24).max() <= 1.0 + 1e-12
    z = 1.03 * z
    assert np.abs(1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24).max() > 1.0


@pytest.mark.parametrize("speed", [4.0, 40.0])
def test_bound_on_the_step_is_sharp(coach, speed):
    """Just below it a linear run decays, 10 % above it explodes."""
    linear = railjax.replace(coach, contact__law="linear")
    bound = float(largest_step(linear, speed, PASSIVE))
    held = railjax.simulate(linear, speed, dt=0.98 * bound, duration=0.98 * bound * 400, initial=START)
    assert bool(held.ok)
    both = railjax.simulate(linear, jnp.array([speed, speed]), dt=1.12 * bound, duration=1.12 * bound * 400, initial=START)
    assert [int(code) for code in both.code] == [railjax.Result.STEP_TOO_LARGE] * 2
    assert not np.all(np.abs(np.asarray(both.final)) < 1.0)


PARAMETERS = ("primary.stiffness_x", "secondary.stiffness_y", "secondary.damping_y", "contact.conicity")


def test_gradients_in_time_forward_reverse_and_differences(smooth):
    track = railjax.SinusoidTrack(3e-3, 20.0)

    def objective(values):
        vehicle = smooth
        for path, value in zip(PARAMETERS, values, strict=True):
            vehicle = railjax.set_parameter(vehicle, path, value)
        run = railjax.simulate(
            vehicle,
            50.0,
            track=track,
            duration=1.0,
            record=[],
            sample=0.1,
            reduce=["rms:carbody_acceleration"],
        )
        return run["rms:carbody_acceleration"]

    values = [float(railjax.get_parameter(smooth, path)) for path in PARAMETERS]
    reverse = np.array(railjax.jit(jax.grad(objective))(values))
    forward = np.array(jax.jit(jax.jacfwd(objective))(values))
    np.testing.assert_allclose(forward, reverse, rtol=1e-9)
    objective = jax.jit(objective)
    for k, value in enumerate(values):
        h = 1e-5 * value
        up, down = ([v + s * h * (i == k) for i, v in enumerate(values)] for s in (1, -1))
        numeric = (float(objective(up)) - float(objective(down))) / (2 * h)
        assert reverse[k] == pytest.approx(numeric, rel=1e-5)


def test_nested_checkpoints_give_the_same_gradient(smooth, monkeypatch):
    import railjax.simulation.integrate
    import railjax.simulation.simulate

    def gradient():
        def objective(damping):
            vehicle = railjax.replace(smooth, secondary__damping_y=damping)
            track = railjax.SinusoidTrack(3e-3, 20.0)
            run = railjax.simulate(vehicle, 50.0, track=track, duration=0.5, reduce=["rms:carbody_acceleration"])
            return run["rms:carbody_acceleration"] + jnp.sum(run["wheelset_y"] ** 2)

        return jax.jit(jax.grad(objective)).lower(25e3).compile()

    kept = gradient()
    monkeypatch.setattr(railjax.simulation.integrate, "KEPT_BYTES", 0)
    # else the same function, already traced, is taken again
    railjax.simulation.simulate._run.cache_clear()
    nested = gradient()
    assert float(nested(25e3)) == pytest.approx(float(kept(25e3)), rel=1e-12)
    less = nested.memory_analysis().temp_size_in_bytes / kept.memory_analysis().temp_size_in_bytes
    assert less < 0.6, f"nested checkpoints keep {less:.2f} of the memory"
