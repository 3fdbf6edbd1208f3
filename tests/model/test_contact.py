"""Creep, saturation and flange: published values, smoothness, twins, and derivatives at the nasty points."""

import derivatives
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference

import railjax
from railjax.base import smooth
from railjax.model.contact import creep as contact


@pytest.mark.parametrize(
    ("u", "published"),
    [(0.1, 0.0967037), (0.5, 0.4212963), (1.0, 0.7037037), (2.0, 0.9629630), (3.0, 1.0), (5.0, 1.0)],
)
def test_vermeulen_johnson_values(u, published):
    assert u * float(contact.saturation_factor(jnp.array(u))) == pytest.approx(published, abs=5e-8)


def test_saturation_is_twice_continuously_differentiable_at_the_corner():
    force = lambda u: u * contact.saturation_factor(u)  # noqa: E731
    for order in (force, jax.grad(force), jax.grad(jax.grad(force))):
        below, above = float(order(jnp.array(3.0 - 1e-9))), float(order(jnp.array(3.0 + 1e-9)))
        assert below == pytest.approx(above, abs=1e-8)
    third = jax.grad(jax.grad(jax.grad(force)))
    assert float(third(jnp.array(2.9))) == pytest.approx(6 / 27)
    assert float(third(jnp.array(3.1))) == 0.0


def forces(vehicle, y, psi, y_rate, psi_rate, slowness=1 / 60.0):
    creepage = contact.creepages(vehicle, slowness, *(jnp.asarray(a) for a in (y, psi, y_rate, psi_rate)))
    result = contact.contact_force(vehicle, creepage, jnp.asarray(y), jnp.asarray(psi))
    return result.lateral, result.yaw


def test_resultant_creep_never_exceeds_adhesion(coach):
    wide = railjax.replace(coach, contact__flange_clearance=1.0, contact__creep_lateral_spin=0.0, contact__creep_spin=0.0)
    rng = np.random.default_rng(5)
    y, psi, y_rate, psi_rate = rng.normal(size=(4, 2000)) * np.array([[1e-2], [2e-2], [1.0], [1.0]])
    lateral, yaw = forces(wide, y, psi, y_rate, psi_rate)
    resultant = np.hypot(np.asarray(lateral), np.asarray(yaw) / 0.7175)
    limit = 2 * reference.MU * reference.WHEEL_LOAD
    assert resultant.max() <= limit * (1 + 1e-12)
    assert resultant.max() > 0.999 * limit


def test_small_creep_is_kalker_s(coach):
    lateral, yaw = forces(coach, 1e-9, 2e-9, 3e-9, 4e-9)
    xi_x, xi_y, xi_s = 0.7175 * 4e-9 / 60 + 0.14 * 1e-9 / 0.46, 3e-9 / 60 - 2e-9, 4e-9 / 60
    assert float(lateral) == pytest.approx(2 * (10.25e6 * xi_y + 1200 * xi_s), rel=1e-6)
    assert float(yaw) == pytest.approx(2 * 0.7175 * 9.43e6 * xi_x - 2 * 1200 * xi_y + 2 * 1000 * xi_s, rel=1e-6)


NASTY = {
    "zero creep": (0.0, 0.0, 0.0, 0.0),
    "pure lateral": (0.0, 1e-4, 0.0, 0.0),
    "saturation corner": (0.0, 3 * reference.MU * 51250.0 / 10.25e6, 0.0, 0.0),
    "deep slip": (5e-3, 5e-2, 0.3, 0.2),
    "inside the gap": (8.7e-3, 0.0, 0.01, 0.0),
    "flange engaged": (9.5e-3, 1e-3, 0.01, 0.02),
}


@pytest.mark.parametrize("law", ["sharp", "smooth", "linear"])
@pytest.mark.parametrize("point", NASTY)
def test_derivatives_of_the_contact(coach, law, point):
    vehicle = railjax.replace(coach, contact__law=law)
    for k in range(2):
        # derivatives are of order 1e5 to 1e7 N per m or rad; a step of 1e-9 stays on one side of every corner
        derivatives.check(lambda *state, k=k: forces(vehicle, *state)[k], *NASTY[point], step=1e-9, rtol=1e-5, atol=1.0)


def test_derivatives_with_respect_to_contact_parameters_at_rest(coach):
    """At zero creep and zero displacement nothing depends on anything, and no derivative may be NaN."""

    def lateral(vehicle):
        return forces(vehicle, 0.0, 0.0, 0.0, 0.0)[0]

    for law in ("sharp", "smooth", "linear"):
        gradient = jax.grad(lateral)(railjax.replace(coach, contact__law=law))
        for path, _ in railjax.parameters():
            assert float(railjax.get_parameter(gradient, path)) == 0.0, path


def test_flange_at_the_corner_has_a_one_sided_or_mean_slope(coach):
    """At y = delta exactly the sharp law's derivative must lie between those of its two sides, not be NaN."""
    slope = float(jax.grad(lambda y: contact.flange_force(coach.contact, y))(reference.DELTA))
    assert 0.0 <= slope <= 14.6e6


@pytest.mark.parametrize("width", [1e-3, 1e-4, 1e-5])
def test_smooth_flange_is_within_its_stated_width(width):
    y = jnp.linspace(-0.03, 0.03, 20001)
    twin = smooth.smooth_dead_band(y, 9e-3, width)
    error = np.abs(np.asarray(twin - smooth.dead_band(y, 9e-3)))
    assert error.max() <= 0.5 * width * (1 + 1e-9)
    assert error.max() > 0.4 * width
    # odd: no force at the centre
    assert float(smooth.smooth_dead_band(jnp.array(0.0), 9e-3, width)) == 0.0


def test_smooth_norm_is_within_its_stated_width():
    norm = jnp.linspace(0.0, 5.0, 5001)
    error = np.asarray(norm - smooth.smooth_norm(norm**2, 0.01))
    assert error.min() >= -1e-15
    assert error.max() <= 0.01
    third = jax.grad(jax.grad(jax.grad(lambda x: smooth.smooth_norm(x * x, 0.01))))
    assert np.isfinite(float(third(jnp.array(0.0))))


def test_sharp_norm_has_finite_derivatives_at_zero():
    for mode in (jax.grad, jax.jacfwd):
        derivative = mode(lambda f: f * contact.saturation_factor(smooth.sqrt_of_square(f * f)))
        assert float(derivative(jnp.array(0.0))) == pytest.approx(1.0, abs=1e-14)
        assert float(derivative(jnp.array(1e-200))) == pytest.approx(1.0)
