"""A curve's three additions to straight running, against what the geometry of a circle says."""

import jax.numpy as jnp
import numpy as np
import pytest

import railjax
from railjax.model.damper import PassiveDamper
from railjax.model.kinematics import deflections, heights, size, split
from railjax.model.motion import motion
from railjax.model.track.curve import GRAVITY, arc

KAPPA, THETA, SPEED = 1.0 / 400.0, 0.08, 30.0


def at(vehicle, q, kappa=KAPPA, theta=THETA, speed=SPEED, straight=False):
    even = jnp.zeros((2, 2))
    curve = None if straight else arc(vehicle, speed, kappa, theta, even)
    return motion(vehicle, PassiveDamper(), 1.0 / speed, even, jnp.concatenate([q, jnp.zeros_like(q)]), curve)


@pytest.fixture(scope="module")
def q():
    return jnp.asarray(np.random.default_rng(3).normal(size=17) * 1e-3)


def test_deflections_see_the_line_turn_and_go_aside(coach, q):
    geometry, plain = coach.geometry, deflections(coach, split(coach, q))
    found = at(coach, q).deflection
    x, a = geometry.half_pivot_distance * np.array([1, -1]), geometry.half_wheelbase * np.array([1, -1])
    expected = {
        "secondary_y": -KAPPA * x**2 / 2,
        "secondary_x": -geometry.half_secondary * KAPPA * x,
        "secondary_z": 0.0,
        "primary_y": np.tile(-KAPPA * a**2 / 2, (2, 1)),
        "primary_x": np.tile(-geometry.half_primary * KAPPA * a, (2, 1)),
        "primary_z": 0.0,
        "contact_y": 0.0,
        "contact_psi": 0.0,
    }
    assert found.keys() == expected.keys()
    for name, value in expected.items():
        np.testing.assert_allclose(found[name] - plain[name], value, atol=1e-15, err_msg=name)


def test_a_rigid_vehicle_laid_across_the_circle_is_not_deflected(coach):
    """Its bodies' places seen from their own frames: what is straight lies -kappa x²/2 beside the line, turned by -kappa x."""
    x = coach.geometry.half_pivot_distance * np.array([1, -1])
    s = x[:, None] + coach.geometry.half_wheelbase * np.array([1, -1])
    parts = [np.zeros(3), -KAPPA * x**2 / 2, -KAPPA * x, np.zeros(2), (-KAPPA * s**2 / 2).ravel(), (-KAPPA * s).ravel()]
    found = at(coach, jnp.asarray(np.concatenate(parts))).deflection
    for name in ("secondary_y", "secondary_x", "primary_y", "primary_x"):
        np.testing.assert_allclose(found[name], 0.0, atol=1e-15)


def test_creepage_and_inertia(coach, q):
    curved, straight = at(coach, q), at(coach, q, straight=True)
    e = coach.geometry.half_gauge
    np.testing.assert_allclose(curved.creepage.longitudinal - straight.creepage.longitudinal, e * KAPPA, rtol=1e-12)
    np.testing.assert_allclose(curved.creepage.spin - straight.creepage.spin, KAPPA, rtol=1e-12)
    np.testing.assert_allclose(curved.creepage.lateral, straight.creepage.lateral, atol=0)
    sideways = SPEED**2 * KAPPA - GRAVITY * THETA
    for name, value in curved.accelerations.items():
        expected = sideways if name.endswith("_y") else 0.0
        np.testing.assert_allclose(curved.specific[name] - value, expected, rtol=1e-9, atol=1e-12, err_msg=name)


def test_no_curve_and_a_straight_one_are_alike(coach, q):
    for one, other in zip(
        at(coach, q, 0.0, 0.0).accelerations.values(), at(coach, q, straight=True).accelerations.values(), strict=True
    ):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12)


def test_left_is_right_in_the_mirror(coach, q):
    right, left = at(coach, q), at(coach, -q, -KAPPA, -THETA)
    for one, other in zip(right.accelerations.values(), left.accelerations.values(), strict=True):
        np.testing.assert_array_equal(one, -other)


def test_every_kind_of_vehicle_takes_a_curve():
    """Held bodies run along the line; elements of their own see it as the springs beside them."""
    lone = railjax.load_vehicle("single-wheelset")
    even = jnp.zeros((1, 1))
    found = motion(lone, PassiveDamper(), 1.0 / SPEED, even, jnp.zeros(2 * size(lone)), arc(lone, SPEED, KAPPA, 0.0, even))
    np.testing.assert_allclose(found.accelerations["wheelset_y"] - found.specific["wheelset_y"], -(SPEED**2) * KAPPA)
    dampers = railjax.load_vehicle("coach-mpe2019")
    even, ahead = jnp.zeros((2, 2)), KAPPA * dampers.geometry.half_pivot_distance
    found = motion(dampers, PassiveDamper(), 1.0 / SPEED, even, jnp.zeros(36), arc(dampers, SPEED, KAPPA, 0.0, even))
    np.testing.assert_allclose(found.deflection["yaw_damper"], dampers.yaw_damper.half_distance * ahead * np.array([-1, 1]))
    np.testing.assert_allclose(found.deflection["lateral_damper"], found.deflection["secondary_y"], atol=1e-12)


def test_heights_follow_from_the_springs(coach):
    found, geometry = heights(coach), coach.geometry
    assert found["bogie"] == coach.wheelset.wheel_radius + geometry.bogie_to_primary
    assert found["carbody"] - found["bogie"] == pytest.approx(geometry.bogie_to_secondary + geometry.carbody_height)
    assert 1.2 < found["carbody"] < 2.2
