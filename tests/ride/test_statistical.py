"""Statistical linearisation against closed forms, the linear limit and simulations."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import railjax

SPEED = 200 / 3.6
#: the same for all, so that it is compiled once for each law of the damper
RECORD = ("carbody_acceleration", "secondary_travel", "secondary_velocity", "wheelset_on_track")


def found(coach, track="erri-high", damper=None, speed=SPEED):
    damper = railjax.PassiveDamper() if damper is None else damper
    return railjax.statistical_linearisation(coach, speed, track, damper=damper, record=RECORD)


def test_on_a_smooth_track_it_is_the_linear_response(coach):
    gentle = railjax.ErriSpectrum(1e-12)
    one = found(coach, gentle)
    linear = railjax.frequency_response(coach, SPEED, gentle)
    np.testing.assert_allclose(one.response.rms("carbody_acceleration"), linear.rms("carbody_acceleration"), rtol=1e-3)
    np.testing.assert_allclose(one.gains.longitudinal, 1.0, atol=1e-3)
    np.testing.assert_allclose(one.gains.damping, 2 * coach.secondary.damping_y, rtol=1e-12)
    np.testing.assert_allclose(one.gains.flange, 0.0, atol=1e-12)


def test_balance_logic_has_a_closed_form(coach):
    """E[F y]/E[y^2] = -alpha k_cy, E[F v]/E[v^2] = 2 alpha k_cy sigma_y/(pi sigma_v) per bogie, by integration over quadrants."""
    alpha = 0.7
    one = found(coach, damper=railjax.BalanceLogic(alpha))
    k = coach.secondary.stiffness_y
    np.testing.assert_allclose(one.gains.stiffness, -alpha * k, rtol=1e-9)
    ratio = one.response.rms("secondary_travel") / one.response.rms("secondary_velocity")
    np.testing.assert_allclose(one.gains.damping, 2 * alpha * k * ratio / np.pi, rtol=1e-6)


def test_flange_gain_is_the_share_of_time_beyond_the_gap(coach):
    """E[f y]/E[y^2] of a dead-band spring = k erfc(delta/(sigma sqrt 2))."""
    from scipy.special import erfc

    one = found(coach)
    sigma = np.asarray(one.response.rms("wheelset_on_track"))
    exact = erfc(coach.contact.flange_clearance / (sigma * np.sqrt(2)))
    np.testing.assert_allclose(np.ravel(one.gains.flange), exact, rtol=1e-2)


def test_creep_gain_is_that_of_samples(coach):
    """E[g xi^2]/E[xi^2] over Gaussian samples, with an independent factor."""
    from railjax.ride.statistical import _gains

    rng = np.random.default_rng(0)
    x, y, r = 1.1e-3, 0.8e-3, 0.4
    signals = {
        "longitudinal": jnp.full((1, 2, 2), x, complex),
        "lateral": jnp.full((1, 2, 2), y * (r + 1j * np.sqrt(1 - r**2))),
        "on_track": jnp.full((1, 2, 2), 2e-3, complex),
    }
    gains = _gains(coach, railjax.PassiveDamper(), signals, jnp.ones(1))
    z = rng.normal(size=(2, 2_000_000))
    xi_x, xi_y = x * z[0], y * (r * z[0] + np.sqrt(1 - r**2) * z[1])
    c = coach.contact
    u = np.hypot(c.creep_longitudinal * xi_x, c.creep_lateral * xi_y) / (c.friction * c.wheel_load)
    factor = np.where(u < 3, 1 - u / 3 + u**2 / 27, 1 / np.maximum(u, 3))
    np.testing.assert_allclose(gains.longitudinal, (factor * xi_x**2).mean() / x**2, rtol=3e-3)
    np.testing.assert_allclose(gains.lateral, (factor * xi_y**2).mean() / y**2, rtol=3e-3)
    assert float(gains.longitudinal[0, 0]) < 0.95


def test_against_simulation(coach):
    """What the method is worth: 1 % with creep saturation at 160 km/h; balance logic's harmonics escape it, 10 to 25 %."""
    speed, names = 160 / 3.6, ("carbody_acceleration", "secondary_travel")
    track = railjax.RandomTrack("erri-high", seed=1, length=10e3)
    for damper, low, high in ((railjax.PassiveDamper(), -0.02, 0.02), (railjax.BalanceLogic(1.0), -0.25, -0.1)):
        run = railjax.simulate(
            coach,
            speed,
            track=track,
            damper=damper,
            duration=240.0,
            settle=15.0,
            record=(),
            reduce=[f"rms:{name}" for name in names],
        )
        one = found(coach, track, damper, speed).response
        error = float(one.rms("carbody_acceleration") / run["rms:carbody_acceleration"]) - 1
        assert low < error < high
        travel = np.asarray(one.rms("secondary_travel") / run["rms:secondary_travel"]) - 1
        assert np.all(np.abs(travel) < 0.06)


def test_saturation_is_felt_and_differentiable(coach):
    """Rougher track, less creep; derivative with respect to the track's variance against a finite difference, both modes."""

    def rms(scale):
        return found(coach, railjax.ErriSpectrum(scale * 6.125e-7)).response.rms("carbody_acceleration")

    gentle, rough = found(coach, "erri-low").gains, found(coach, "erri-high").gains
    assert np.all(rough.lateral < gentle.lateral)
    h = 1e-4
    numeric = (rms(1 + h) - rms(1 - h)) / (2 * h)
    # linearised once for both
    _, forward = jax.linearize(rms, 1.0)
    (reverse,) = jax.linear_transpose(forward, 1.0)(1.0)
    np.testing.assert_allclose(forward(1.0), numeric, rtol=1e-5)
    np.testing.assert_allclose(reverse, numeric, rtol=1e-5)


def test_it_says_where_it_does_not_hold(coach):
    with pytest.raises(railjax.NumericalError, match="simulate instead"):
        found(coach, speed=75.0)
    for damper in (railjax.Skyhook(), railjax.BalanceLogic(1.0, sensor_lag=5e-3), railjax.HybridDamper()):
        with pytest.raises(railjax.InputError, match="without memory"):
            found(coach, damper=damper)
