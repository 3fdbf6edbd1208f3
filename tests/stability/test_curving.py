"""Steady curving against closed forms, an independent solution in NumPy and SciPy, balances of forces, and differences."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from curve_reference import BASE, G, equations, independent
from derivatives import check

import railjax
from railjax.base.elimination import eliminated, inverse
from railjax.model.contact.profile_table import with_profiles
from railjax.model.kinematics import heights


def test_a_free_wheelset_rolls_without_slip(coach):
    """y = -e r_0 kappa/lambda, psi = 0 at the balanced cant, in curves to both sides."""
    lone = railjax.replace(
        railjax.load_vehicle("single-wheelset"), primary__stiffness_x=0.0, primary__stiffness_y=0.0, contact__law="linear"
    )
    lone = railjax.replace(lone, contact__creep_spin=0.0, contact__creep_lateral_spin=0.0)
    radius = np.array([500.0, -500.0, 2000.0])
    speed = 20.0
    found = railjax.curving(lone, speed, radius=radius, cant=BASE * speed**2 / (G * np.abs(radius)))
    rolling = -lone.geometry.half_gauge * lone.wheelset.wheel_radius / radius / lone.contact.conicity
    np.testing.assert_allclose(found.wheelset_y[0], rolling, rtol=1e-10)
    np.testing.assert_allclose(found.wheelset_psi[0], 0.0, atol=1e-14)
    np.testing.assert_allclose(found.wear_number, 0.0, atol=1e-9)


def test_the_design_s_coach(coach):
    """The independent solution that the design gives: linear creep, R 1000 m, 120 km/h, theta 1/15."""
    found = railjax.curving(railjax.replace(coach, contact__law="linear"), 120 / 3.6, radius=1000.0, cant=0.1)
    np.testing.assert_allclose(1e3 * found.wheelset_y, [-5.921, -2.765, -5.650, -2.676], atol=5.1e-4)
    np.testing.assert_allclose(1e3 * found.wheelset_psi, [-0.0437, 0.5025, -0.1035, 0.5594], atol=5.1e-5)


@pytest.mark.parametrize(
    ("radius", "kmh", "cant", "friction"),
    [
        (1000.0, 120.0, 0.1, None),
        (600.0, 60.0, 0.15, 0.25),
        (300.0, 80.0, 0.1, None),
        (200.0, 50.0, 0.0, 0.2),
        (250.0, 40.0, 0.0, 0.1),
    ],
)
def test_saturated_and_flange_cases_against_an_independent_solution(coach, radius, kmh, cant, friction):
    vehicle = coach if friction is None else railjax.replace(coach, contact__friction=friction)
    found = railjax.curving(vehicle, kmh / 3.6, radius=radius, cant=cant)
    assert found.code == railjax.Equilibrium.OK
    expected = independent(vehicle, kmh / 3.6, radius, cant)
    np.testing.assert_allclose(found.state[:17], expected, atol=1e-9)
    if radius < 400.0:
        assert np.min(found.wheelset_y) < -float(vehicle.contact.flange_clearance)
        assert np.max(found.saturation) > 1.5


def test_forces_and_moments_are_in_balance(coach):
    """ΣY carries all masses, and the load transfer the moments about the rails, whatever the wheels do."""
    speed, radius, cant = 60 / 3.6, np.array([200.0, 400.0, 2000.0]), np.array([0.0, 0.1, 0.15])
    found = railjax.curving(coach, speed, radius=radius, cant=cant)
    sideways = speed**2 / radius - G * cant / BASE
    masses = {"carbody": coach.carbody.mass, "bogie": 2 * coach.bogie.mass, "wheelset": 4 * coach.wheelset.mass}
    np.testing.assert_allclose(np.sum(found.sum_y, axis=0), sum(masses.values()) * sideways, rtol=1e-9)
    moment = sum(masses[body] * height for body, height in heights(coach).items()) * sideways
    np.testing.assert_allclose(np.sum(found.load_transfer, axis=0) * 2 * coach.geometry.half_gauge, moment, rtol=1e-9)
    np.testing.assert_allclose(np.sum(found.wheel_load, axis=(0, 1)), 8 * coach.contact.wheel_load, rtol=1e-12)
    np.testing.assert_allclose(1.5 * sideways / G, found.cant_deficiency, rtol=1e-12)


def test_balanced_cant_and_mirrored_curves(coach):
    speed, radius = 25.0, np.array([600.0, -600.0])
    found = railjax.curving(coach, speed, radius=radius, cant=BASE * speed**2 / (G * 600.0))
    np.testing.assert_allclose(found.carbody_acceleration, 0.0, atol=1e-9)
    np.testing.assert_allclose(found.carbody_roll, 0.0, atol=1e-12)
    np.testing.assert_allclose(found.cant_deficiency, 0.0, atol=1e-12)
    np.testing.assert_allclose(found.wheelset_y[:, 0], -found.wheelset_y[:, 1], rtol=1e-12)
    np.testing.assert_allclose(found.guiding_force[:, :, 0], -found.guiding_force[:, ::-1, 1], rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(found.angle_of_attack[:, 0], found.angle_of_attack[:, 1], rtol=1e-9)
    np.testing.assert_allclose(found.y_over_q[:, :, 0], found.y_over_q[:, ::-1, 1], rtol=1e-9, atol=1e-9)
    straight = railjax.curving(coach, speed, radius=np.inf)
    np.testing.assert_array_equal(straight.state, 0.0)


def test_gradients_of_wear_and_guiding_force(coach):
    """By vehicle, speed, radius and cant, beyond the flange's corner and in saturated creep."""

    def of(stiffness, friction, speed, radius, cant):
        vehicle = railjax.replace(coach, primary__stiffness_x=stiffness * 1e6, contact__friction=friction)
        found = railjax.curving(vehicle, speed, radius=radius * 100.0, cant=cant)
        return jnp.stack([found.wear_number, 1e-3 * found.guiding_force[0, 0], 1e3 * found.angle_of_attack[0]])

    check(of, 3.2, 0.3, 20.0, 3.0, 0.1, rtol=1e-6, atol=1e-5)


def test_hardly_any_friction(coach):
    """Found from where more friction would leave them, each an equilibrium of the independent equations."""
    friction, radius = np.array([0.043, 0.055, 0.034, 0.038]), np.array([346.0, 369.0, 410.0, 358.0])
    cant, speed = np.array([0.078, 0.1, 0.021, 0.038]), np.array([19.7, 18.0, 15.9, 10.8])
    found = railjax.curving(railjax.replace(coach, contact__friction=friction), speed, radius=radius, cant=cant)
    assert found.code.tolist() == [0, 0, 0, 0]
    for k in range(4):
        one = railjax.replace(coach, contact__friction=float(friction[k]))
        left = equations(one, speed[k], radius[k], cant[k])(np.asarray(found.state[:17, k]), 1.0)
        assert np.max(np.abs(left)) < 1e-5


def test_lanes_are_alike_and_failures_are_marked(coach):
    """A lane without equilibrium, or without a number, is NaN; it leaves the others and their derivatives alone."""
    radius, speed = np.array([300.0, 150.0, 300.0, 900.0, 150.0]), np.array([20.0, 80.0, 20.0, 30.0, 30.0])
    friction = np.array([0.4, 0.4, np.nan, 0.4, 0.4])

    def curved(factor=1.0):
        vehicle = railjax.replace(coach, contact__friction=friction, contact__conicity=factor * coach.contact.conicity)
        return railjax.curving(vehicle, speed, radius=radius, cant=0.1)

    found = curved()
    assert found.code.tolist() == [0, 1, 1, 0, 2]
    np.testing.assert_array_equal(np.isnan(found.wear_number), [False, True, True, False, False])
    alone = railjax.curving(railjax.replace(coach, contact__friction=0.4), 30.0, radius=900.0, cant=0.1)
    np.testing.assert_allclose(found.wheelset_y[:, 3], alone.wheelset_y, rtol=1e-9)
    assert alone.code == railjax.Equilibrium.OK
    lanes = np.array([0, 3, 4])
    slopes = [jax.grad(lambda f, of=of: jnp.nansum(curved(f).wear_number[of]))(1.0) for of in (slice(None), lanes)]
    assert np.isfinite(slopes[0])
    np.testing.assert_allclose(slopes[0], slopes[1], rtol=1e-12)
    assert "failed: 2 of 5" in str(found)
    assert "lifted: 1 of 5" in str(found)


def test_internal_states_come_to_rest():
    """Yaw dampers in series with a stiffness let go."""
    dampers = railjax.load_vehicle("coach-mpe2019")
    found = railjax.curving(dampers, 25.0, radius=500.0, cant=0.1)
    elongation, yaw = found.state[-2:], dampers.yaw_damper.half_distance * (found.state[1] - found.bogie_yaw)
    x = dampers.geometry.half_pivot_distance * np.array([1, -1])
    np.testing.assert_allclose(elongation, yaw - dampers.yaw_damper.half_distance * x / 500.0, rtol=1e-8)


def test_small_systems_against_lapack():
    rng = np.random.default_rng(0)
    matrix, right = rng.normal(size=(7, 7, 5)), jnp.asarray(rng.normal(size=(7, 2, 5)))
    matrix[0, 0] = 0.0  # which asks for a pivot
    across, matrix = np.moveaxis(matrix, -1, 0), jnp.asarray(matrix)
    np.testing.assert_allclose(
        np.moveaxis(eliminated(matrix, right), -1, 0), np.linalg.solve(across, np.moveaxis(right, -1, 0)), rtol=1e-9
    )
    np.testing.assert_allclose(np.moveaxis(inverse(matrix), -1, 0), np.linalg.inv(across), rtol=1e-8, atol=1e-12)


def test_verb(run, tmp_path):
    code, out, _ = run("curving", "coach", "--radius-m", 300, "--cant-mm", 100, "--speed-kmh", 80, "--json")
    found = json.loads(out)
    assert code == 0
    assert found["wheelset_y_mm"][0] == pytest.approx(-12.485, abs=1e-3)
    assert {"wheelset_yaw_mrad", "guiding_force_kN", "wear_number_N", "y_over_q"} <= found.keys()
    assert found["cant_deficiency_mm"] == pytest.approx(BASE / G * 1e3 * (80 / 3.6) ** 2 / 300 - 100)
    picture = tmp_path / "curve.png"
    code, text, _ = run("curving", "coach", "--radius-m", 300, "--cant-mm", 100, "--cant-deficiency-mm", 100, "--out", picture)
    assert code == 0
    assert "calibrated" in text
    assert picture.stat().st_size > 10_000
    for wrong, says in (
        (("--radius-m", 300), "give --speed-kmh"),
        (("--radius-m", 0, "--speed-kmh", 80), "--radius-m must not be 0"),
        (("--radius-m", 300, "--speed-kmh", 80, "--cant-mm", 100, "--cant-deficiency-mm", 10), "exclude each other"),
    ):
        code, _, error = run("curving", "coach", *wrong)
        assert code == 2
        assert says in error
    code, _, error = run("curving", "coach", "--radius-m", 150, "--speed-kmh", 250)
    assert code == 1
    assert "no equilibrium" in error


def test_profiles_guide_by_their_contact_angles(coach):
    """S1002 on 60E1: the leading outer wheel is at its flange in R 300 m, in R 1500 m all run freely; ΣY carries all masses."""
    vehicle = with_profiles(coach)
    speed, radius = np.array([80.0, 80.0, 144.0]) / 3.6, np.array([300.0, 600.0, 1500.0])
    found = railjax.curving(vehicle, speed, radius=radius, cant=0.1)
    assert found.code.tolist() == [0, 0, 0]
    mass = coach.carbody.mass + 2 * coach.bogie.mass + 4 * coach.wheelset.mass
    np.testing.assert_allclose(np.sum(found.sum_y, axis=0), mass * (speed**2 / radius - G * 0.1 / BASE), rtol=1e-9)
    quotient = found.y_over_q[0, 0]
    assert 0.2 < quotient[0] < 0.45
    assert quotient[1] < 0.2
    assert quotient[2] < 0.05
    assert found.wheelset_y[0, 0] < -6.2e-3 < found.wheelset_y[0, 1]
    wear = np.asarray(found.wear_number)
    assert wear[0] > 3 * wear[1] > 6 * wear[2]


def test_critical_speed_in_a_curve(coach):
    """With linear creep the curve changes nothing; else it is where the growth of the motion about the equilibrium is zero, with gradients."""
    linear = railjax.curve_critical(railjax.replace(coach, contact__law="linear"), radius=3000.0, cant_deficiency=0.1)
    np.testing.assert_allclose(linear.speed, railjax.linear_critical_speed(coach), rtol=1e-8)

    def speed(stiffness, radius):
        vehicle = railjax.replace(coach, primary__stiffness_x=stiffness * 1e6)
        return railjax.curve_critical(vehicle, radius=radius * 1e3, cant_deficiency=0.1).speed

    slopes = jax.grad(speed, argnums=(0, 1))(3.2, 2.0)
    for k, at in enumerate(np.eye(2) * 1e-4):
        above, below = (speed(3.2 + sign * at[0], 2.0 + sign * at[1]) for sign in (1, -1))
        assert float(slopes[k]) == pytest.approx(float(above - below) / 2e-4, rel=2e-5)
    # a run from the equilibrium, pushed a little, dies out below it and grows above
    found = railjax.curve_critical(coach, radius=3000.0, cant_deficiency=0.1)
    left = []
    for share in (0.97, 1.03):
        v = share * float(found.speed)
        cant = BASE * v**2 / (G * 3000.0) - 0.1
        steady = railjax.curving(coach, v, radius=3000.0, cant=cant)
        layout = railjax.Layout([railjax.Segment.arc(1000.0, 3000.0, cant)])
        start = np.asarray(steady.state).copy()
        start[9] += 1e-5
        run = railjax.simulate(coach, v, track=layout, initial=start, duration=4.0, record=("wheelset_y",))
        away = np.max(np.abs(np.asarray(run["wheelset_y"]) - np.asarray(steady.wheelset_y)), axis=1)
        left.append(np.max(away[-100:]) / np.max(away[50:150]))
    assert left[0] < 0.5
    assert left[1] > 2.0
