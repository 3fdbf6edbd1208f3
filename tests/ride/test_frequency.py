"""Forced response in the frequency domain against direct solves, simulations, closed forms and finite differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import railjax
from railjax.model.track.spectra import LONGEST, SHORTEST
from railjax.ride.frequency import excitation, resolvent

SPEED = 200 / 3.6
POSITIONS = np.array([9.88, 7.32, -7.32, -9.88])  # +-l +- a of the coach


#: the same in most tests, so that it is compiled once
RECORD = (
    "carbody_acceleration",
    "carbody_y",
    "wheelset_y",
    "secondary_travel",
    "guiding_force",
    "damper_force",
    "wheelset_on_track",
)


def responding(vehicle, speed, *track, **options):
    return railjax.frequency_response(vehicle, speed, *track, record=RECORD, **options)


@pytest.fixture(scope="module")
def response(coach):
    return responding(coach, SPEED)


def test_transfer_is_that_of_a_direct_solve(coach, response):
    matrix, track = (np.asarray(f(coach, SPEED)) for f in (railjax.state_matrix, railjax.track_matrix))
    for k in (0, 57, 200, 399):
        wavenumber = float(response.excitation.wavenumber[k])
        right = track @ np.exp(1j * wavenumber * POSITIONS)
        x = np.linalg.solve(1j * wavenumber * SPEED * np.eye(34) - matrix, right)
        np.testing.assert_allclose(response.transfer["carbody_y"][k], x[0], rtol=1e-9)
        np.testing.assert_allclose(response.transfer["wheelset_y"][k], x[9:13], rtol=1e-9)
        omega = 2 * np.pi * float(response.frequency[k])
        np.testing.assert_allclose(response.transfer["carbody_acceleration"][k], -(omega**2) * x[0], rtol=1e-8)


def test_long_waves_carry_the_whole_vehicle_along(coach):
    waves = railjax.frequency_response(coach, 10.0, shortest=5e3, longest=50e3, points=16, record=("carbody_y", "wheelset_y"))
    delays = np.exp(1j * np.asarray(waves.excitation.wavenumber)[:, None] * POSITIONS)
    np.testing.assert_allclose(waves.transfer["carbody_y"], 1.0, atol=1e-4)
    np.testing.assert_allclose(waves.transfer["wheelset_y"], delays, atol=1e-4)


def test_a_sine_in_time_settles_on_the_transfer_function(coach):
    linear = railjax.replace(coach, contact__law="linear")
    track = railjax.SinusoidTrack(1e-3, 20.0)
    reduce = ["rms:carbody_acceleration", "rms:guiding_force", "rms:damper_force"]
    period = 20.0 / SPEED
    run = railjax.simulate(
        linear, SPEED, track=track, duration=50 * period, settle=30 * period, dt=period / 500, record=(), reduce=reduce
    )
    at = railjax.ride.frequency.Excitation(jnp.array([2 * jnp.pi / 20.0]), jnp.array([0.5e-6]), jnp.array([1.0]))
    there = responding(coach, SPEED, at)
    for name in (name.removeprefix("rms:") for name in reduce):
        np.testing.assert_allclose(there.rms(name), run[f"rms:{name}"], rtol=2e-5)


def test_rms_on_a_realised_track_is_that_of_a_long_run(coach):
    """A whole period of the track, so that nothing but the transient and RK4 are between the two."""
    linear = railjax.replace(coach, contact__law="linear")
    track = railjax.RandomTrack("erri-high", seed=3, length=4e3)
    period = track.length / SPEED
    dt = period / round(period / 1e-3)
    run = railjax.simulate(
        linear,
        SPEED,
        track=track,
        duration=2 * round(period / dt) * dt,
        settle=round(period / dt) * dt,
        dt=dt,
        record=(),
        reduce=["rms:carbody_acceleration", "rms:secondary_travel", "rms:wheelset_on_track"],
    )
    there = responding(coach, SPEED, track)
    for name in ("carbody_acceleration", "secondary_travel", "wheelset_on_track"):
        np.testing.assert_allclose(there.rms(name), run[f"rms:{name}"], rtol=2e-3)


def test_waves_hold_the_variance_of_the_spectrum():
    for name in ("erri-low", "erri-high", "fra-5"):
        of = railjax.spectrum(name)
        waves = excitation(of)
        exact = float(of.variance(2 * np.pi / LONGEST, 2 * np.pi / SHORTEST))
        np.testing.assert_allclose(float(waves.variance.sum()), exact, rtol=1e-8)


def test_rms_is_the_integral_of_the_spectrum_and_points_enough(coach, response):
    area = np.trapezoid(response.spectrum("carbody_acceleration"), response.frequency)
    np.testing.assert_allclose(response.rms("carbody_acceleration"), np.sqrt(area), rtol=1e-3)
    fine = responding(coach, SPEED, points=3000)
    np.testing.assert_allclose(response.rms("carbody_acceleration"), fine.rms("carbody_acceleration"), rtol=1e-7)


def test_weighted_rms(response):
    waves = response.excitation
    power = np.abs(response.transfer["secondary_travel"]) ** 2 * np.asarray(waves.variance)[:, None]
    weight = np.abs(railjax.weighting("Wd", response.frequency)) ** 2
    np.testing.assert_allclose(response.rms("secondary_travel", "Wd"), np.sqrt((weight[:, None] * power).sum(0)), rtol=1e-12)


def test_comfort_gradient(coach):
    """The bar of comfort tuning: (k_cy, rho_cy), and speed and roughness of the track, both modes, to 1e-6."""

    def comfort(factors):
        stiffness, damping, speed, roughness = factors
        k, rho = coach.secondary.stiffness_y, coach.secondary.damping_y
        vehicle = railjax.replace(coach, secondary__stiffness_y=stiffness * k, secondary__damping_y=damping * rho)
        spectrum = railjax.ErriSpectrum(roughness * 6.125e-7)
        return railjax.frequency_response(vehicle, speed * SPEED, spectrum).rms("carbody_acceleration", "Wd")

    value, h = jax.jit(comfort), 1e-4
    numeric = [(value(1.0 + h * unit) - value(1.0 - h * unit)) / (2 * h) for unit in np.eye(4)]
    for derivative in (jax.grad, jax.jacfwd):
        np.testing.assert_allclose(jax.jit(derivative(comfort))(jnp.ones(4)), numeric, rtol=1e-6)


def test_every_parameter_of_the_vehicle_has_a_finite_derivative(coach):
    slopes = jax.grad(lambda vehicle: railjax.frequency_response(vehicle, SPEED).rms("carbody_acceleration"))(coach)
    leaves = jax.tree.leaves(slopes)
    assert all(np.isfinite(leaf) for leaf in leaves)
    assert sum(leaf != 0.0 for leaf in leaves) > 20


def test_lanes_equal_single_runs(coach):
    speeds = jnp.array([30.0, 50.0, 65.0, 80.0])
    many = responding(coach, speeds)
    assert many.transfer["secondary_travel"].shape == (400, 2, 4)
    assert many.spectrum("secondary_travel").shape == (400, 2, 4)
    for lane, speed in enumerate(speeds[:3]):
        one = responding(coach, float(speed))
        for name in ("carbody_acceleration", "secondary_travel"):
            np.testing.assert_allclose(many.rms(name)[..., lane], one.rms(name), rtol=1e-10)
            np.testing.assert_allclose(many.spectrum(name)[..., lane], one.spectrum(name), rtol=1e-9)
    assert np.isnan(many.rms("carbody_acceleration")[3]), "80 m/s is beyond the critical speed"
    assert float(many.growth[3]) > 0
    assert "unstable, without a stationary response: 1 of 4" in str(many)
    assert many.to_xarray()["secondary_travel_spectrum"].dims == ("wave", "bogie", "lane")


def test_a_damper_with_memory_enters(coach):
    stiff = railjax.MaxwellDamper(coach.secondary.damping_y, series_stiffness=1e11)
    values = [
        float(responding(coach, SPEED, damper=d).rms("carbody_acceleration"))
        for d in (railjax.PassiveDamper(), stiff, railjax.MaxwellDamper(coach.secondary.damping_y, series_stiffness=5e5))
    ]
    np.testing.assert_allclose(values[1], values[0], rtol=1e-3)
    assert abs(values[2] / values[0] - 1) > 0.01


def test_resolvent_of_a_badly_conditioned_matrix():
    """Nearly defective: the eigenvectors' condition number is 1e6, refinement makes up for it."""
    matrix = jnp.array([[-1.0, 1.0, 0.0], [0.0, -1.0 - 1e-6, 1.0], [0.0, 0.0, -2.0]])
    right, omega = jnp.ones((3, 5), complex), jnp.linspace(0.0, 4.0, 5)
    x, growth = resolvent(matrix, omega, right)
    exact = np.stack([np.linalg.solve(1j * w * np.eye(3) - matrix, np.ones(3)) for w in omega], axis=1)
    np.testing.assert_allclose(x, exact, rtol=1e-12)
    assert abs(float(growth) + 1.0) < 1e-12


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"speed": 0.0}, "speed"),
        ({"record": ("carbody_accelaration",)}, "carbody_acceleration"),
        ({"points": 3}, "points"),
        ({"track": "erri-medium"}, "erri"),
        ({"track": railjax.RandomTrack(seed=[1, 2])}, "one realisation"),
    ],
)
def test_bad_input(coach, change, word):
    with pytest.raises(railjax.InputError, match=word):
        railjax.frequency_response(coach, change.pop("speed", SPEED), **change)


def test_no_response_beyond_the_critical_speed(coach):
    with pytest.raises(railjax.NumericalError, match=r"unstable at 252\.0 km/h"):
        responding(coach, 70.0)
