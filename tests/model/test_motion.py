"""The equations of motion against an independent NumPy copy, closed forms and conservation laws."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference
import scipy.linalg

import railjax
from railjax.model.motion import PASSIVE, motion, state_rate
from railjax.simulation.simulate import initial_state


def rate(vehicle, x, eta, speed):
    instant = motion(vehicle, PASSIVE, 1.0 / speed, jnp.asarray(eta).reshape(2, 2), jnp.asarray(x))
    return np.asarray(state_rate(vehicle, instant))


@pytest.mark.parametrize("law", ["sharp", "smooth", "linear"])
@pytest.mark.parametrize("size", [1e-5, 1e-3, 2e-2])
def test_right_hand_side_is_the_independent_one(coach, law, size):
    rng = np.random.default_rng(7)
    vehicle = railjax.replace(coach, contact__law=law)
    for _ in range(10):
        x = rng.normal(size=34) * size * np.concatenate([np.ones(17), 20 * np.ones(17)])
        eta = rng.normal(size=4) * size
        expected = reference.rate(x, eta, 61.0, law)
        np.testing.assert_allclose(rate(vehicle, x, eta, 61.0), expected, rtol=1e-11, atol=1e-11 * np.abs(expected).max())


def test_carbody_acceleration_is_eq_5_corrected(coach):
    x = np.random.default_rng(1).normal(size=34)
    expected = reference.acceleration(x)
    assert rate(coach, x, np.zeros(4), 50.0)[17] == pytest.approx(expected, rel=1e-13)
    # as printed, with k_cy sum(y_b) inside the bracket with h_cb, it is another number
    as_printed = expected + 2 / reference.M_C * -reference.H_CB * reference.K_CY * (x[3:5].sum() - x[7:9].sum())
    assert as_printed != pytest.approx(expected, rel=1e-3)


def test_matrices_of_eq_2_and_4(coach):
    mass, damping, stiffness = (np.asarray(m) for m in railjax.matrices(coach, 50.0))
    matrix = np.asarray(railjax.state_matrix(coach, 50.0))
    assert matrix.shape == (34, 34)
    np.testing.assert_array_equal(matrix[:17, :17], 0)
    np.testing.assert_array_equal(matrix[:17, 17:], np.eye(17))
    np.testing.assert_allclose(matrix[17:, :17], -np.linalg.solve(mass, stiffness), rtol=1e-12)
    np.testing.assert_allclose(matrix[17:, 17:], -np.linalg.solve(mass, damping), rtol=1e-12)
    # springs alone are symmetric; creep makes K unsymmetric (that is what hunts)
    frictionless = railjax.replace(
        coach,
        contact__creep_longitudinal=0.0,
        contact__creep_lateral=0.0,
        contact__creep_lateral_spin=0.0,
        contact__creep_spin=0.0,
        contact__law="linear",
    )
    elastic = np.asarray(railjax.matrices(frictionless, 50.0).stiffness)
    np.testing.assert_allclose(elastic, elastic.T, rtol=1e-10, atol=1e-4)
    assert not np.allclose(stiffness, stiffness.T, rtol=1e-3)
    assert scipy.linalg.eigvalsh(elastic).min() > -1e-3
    columns = [reference.rate(np.eye(34)[i], np.zeros(4), 50.0, "linear") for i in range(34)]
    np.testing.assert_allclose(matrix, np.array(columns).T, rtol=1e-12, atol=1e-9)


def test_track_matrix_is_the_track_s_share(coach):
    share = np.asarray(railjax.track_matrix(coach, 50.0))
    columns = [reference.rate(np.zeros(34), np.eye(4)[i], 50.0, "linear") for i in range(4)]
    np.testing.assert_allclose(share, np.array(columns).T, rtol=1e-12, atol=1e-12)


def test_state_matrix_is_the_jacobian_of_the_nonlinear_law_at_rest(coach):
    for law in ("sharp", "linear"):
        vehicle = railjax.replace(coach, contact__law=law)

        def at(x, vehicle=vehicle):
            return state_rate(vehicle, motion(vehicle, PASSIVE, 1 / 50.0, jnp.zeros((2, 2)), x))

        for result in jax.jit(lambda x, at=at: (jax.jacfwd(at)(x), jax.jacrev(at)(x)))(jnp.zeros(34)):
            np.testing.assert_allclose(result, railjax.state_matrix(coach, 50.0), rtol=1e-12, atol=1e-9)


def test_gyroscopic_coupling_does_no_work_and_shows_in_e(coach):
    spinning = railjax.replace(coach, gyroscopic=True)
    rng = np.random.default_rng(3)
    x = rng.normal(size=34) * 1e-3
    difference = rate(spinning, x, np.zeros(4), 60.0) - rate(coach, x, np.zeros(4), 60.0)
    mass = np.diag(np.asarray(railjax.matrices(coach, 60.0).mass))
    assert np.abs(difference).max() > 1e-6
    assert abs(np.sum(x[17:] * mass * difference[17:])) < 1e-12
    # I_ox (v/r_0)(lambda/e) by hand, on the first wheelset
    coupling = 100.0 * (60.0 / 0.46) * 0.14 / 0.7175
    change = np.asarray(railjax.state_matrix(spinning, 60.0) - railjax.state_matrix(coach, 60.0))
    assert change[17 + 9, 17 + 13] == pytest.approx(coupling / 1410.0)
    assert change[17 + 13, 17 + 9] == pytest.approx(-coupling / 980.0)


def test_gravitational_stiffness_by_hand(coach):
    heavy = railjax.replace(coach, gravitational=True)
    change = np.asarray(railjax.matrices(heavy, 60.0).stiffness - railjax.matrices(coach, 60.0).stiffness)
    load = 2 * 51250.0
    assert change[9, 9] == pytest.approx(load * 0.14 / 0.7175)
    assert change[13, 13] == pytest.approx(-load * 0.14 * 0.7175)


def test_optional_elements_act_as_stated(coach):
    change = {}
    for path, value in (
        ("secondary.damping_x", 1e5),
        ("secondary.anti_roll_stiffness", 1e6),
        ("primary.damping_x", 1e4),
        ("primary.damping_y", 1e4),
    ):
        other = railjax.set_parameter(coach, path, value)
        change[path] = [
            np.asarray(b - a) for a, b in zip(railjax.matrices(coach, 60.0), railjax.matrices(other, 60.0), strict=True)
        ]
    # yaw dampers: 2 rho d_c^2 between car body and each bogie
    assert change["secondary.damping_x"][1][1, 1] == pytest.approx(4e5)
    assert change["secondary.damping_x"][1][1, 5] == pytest.approx(-2e5)
    # anti-roll bar: its stiffness once per bogie
    assert change["secondary.anti_roll_stiffness"][2][2, 2] == pytest.approx(2e6)
    assert change["secondary.anti_roll_stiffness"][2][2, 7] == pytest.approx(-1e6)
    # wherever the springs stand
    wide = railjax.replace(coach, geometry__half_secondary=1.2)
    barred = railjax.replace(wide, secondary__anti_roll_stiffness=1e6)
    stiffer = np.asarray(railjax.matrices(barred, 60.0).stiffness - railjax.matrices(wide, 60.0).stiffness)
    assert stiffer[2, 2] == pytest.approx(2e6)
    assert change["primary.damping_x"][1][13, 13] == pytest.approx(2e4)
    assert change["primary.damping_y"][1][9, 9] == pytest.approx(2e4)
    assert change["primary.damping_y"][1][9, 5] == pytest.approx(-2e4 * 1.28)


@pytest.fixture(scope="module")
def wheelset(coach):
    """A wheelset alone, without suspension, on linear creep."""
    vehicle = railjax.replace(
        coach, carbody__held=True, bogie__held=True, geometry__bogie_pattern=(0.0,), geometry__axle_pattern=(0.0,),
        primary__stiffness_x=0.0, primary__stiffness_y=0.0, contact__law="linear",
        contact__creep_lateral_spin=0.0, contact__creep_spin=0.0,
    )  # fmt: skip
    return vehicle


def test_klingel_wavelength_of_a_free_wheelset(wheelset):
    klingel = 2 * np.pi * np.sqrt(0.7175 * 0.46 / 0.14)
    speed = 0.05
    values = np.linalg.eigvals(np.asarray(railjax.state_matrix(wheelset, speed)))
    assert values.shape == (4,)
    wavelength = 2 * np.pi * speed / values.imag.max()
    assert wavelength == pytest.approx(klingel, rel=1e-3)


def test_klingel_wavelength_in_the_time_domain(wheelset):
    klingel = 2 * np.pi * np.sqrt(0.7175 * 0.46 / 0.14)
    # creep is stiff at walking speed: 2 f/(m v) is 1.5e4 1/s at 1 m/s
    run = railjax.simulate(
        wheelset,
        1.0,
        duration=40.0,
        dt=1e-4,
        sample=0.01,
        initial={"wheelset_y": 1e-3},
        record=["wheelset_y"],
    )
    y, time = np.asarray(run["wheelset_y"])[:, 0], np.asarray(run.time)
    assert bool(run.ok)
    zero = np.flatnonzero(np.diff(np.sign(y)))
    crossing = time[zero] - y[zero] * (time[zero + 1] - time[zero]) / (y[zero + 1] - y[zero])
    assert 2 * np.mean(np.diff(crossing)) == pytest.approx(klingel, rel=2e-3)


def conservative(vehicle):
    return railjax.replace(
        vehicle, contact__creep_longitudinal=0.0, contact__creep_lateral=0.0, contact__creep_lateral_spin=0.0,
        contact__creep_spin=0.0, contact__law="linear", secondary__damping_y=0.0, secondary__damping_z=0.0,
        primary__damping_z=0.0,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("name", "initial"),
    [
        ("coach-table1", {"carbody_y": 0.02, "bogie_y": [0.01, -0.01], "wheelset_psi": 1e-3}),
        # the stiffer guidance has modes up to 35 Hz, which RK4 itself damps by (omega dt)^6/72 of their energy a step: 6e-8
        # in 1e5 steps if the bogies start displaced; started from the car body they hold nothing
        ("coach", {"carbody_y": 0.02, "carbody_psi": 1e-3, "carbody_phi": 5e-3}),
    ],
)
def test_energy_is_conserved_without_creep_and_dampers(name, initial):
    free = conservative(railjax.load_vehicle(name))
    mass, _, stiffness = (np.asarray(m) for m in railjax.matrices(free, 50.0))

    def energy(x):
        x = np.asarray(x)
        return 0.5 * x[17:] @ mass @ x[17:] + 0.5 * x[:17] @ stiffness @ x[:17]

    start = initial_state(free, PASSIVE, initial)
    run = railjax.simulate(free, 50.0, duration=10.0, dt=1e-4, initial=start, record=[], sample=0.01)
    assert energy(run.final) == pytest.approx(energy(start), rel=1e-8)
    # and it did move: the potential energy of the start has gone elsewhere
    assert not np.allclose(run.final, start, rtol=0.1)


def test_held_bodies_leave_their_coordinates_out(coach):
    bogie = railjax.replace(coach, carbody__held=True, geometry__bogie_pattern=(0.0,))
    assert railjax.state_matrix(bogie, 50.0).shape == (14, 14)
    # the same bogie under a car body of infinite inertia
    giant = railjax.replace(coach, carbody__mass=1e18, carbody__roll_inertia=1e18, carbody__yaw_inertia=1e18)
    values = np.sort_complex(np.linalg.eigvals(np.asarray(railjax.state_matrix(giant, 50.0))))
    for value in np.linalg.eigvals(np.asarray(railjax.state_matrix(bogie, 50.0))):
        assert np.abs(values - value).min() < 1e-6 * abs(value)


def test_six_axle_vehicle(coach):
    loco = railjax.replace(coach, geometry__axle_pattern=(1.0, 0.0, -1.0))
    assert railjax.state_matrix(loco, 50.0).shape == (2 * 21, 2 * 21)
    # the third axle's springs hold the bogie's roll as well: 2 k_oz d_o^2, and 2 k_oy h_ob^2 of their lateral ones
    more = float(railjax.matrices(loco, 50.0).stiffness[7, 7] - railjax.matrices(coach, 50.0).stiffness[7, 7])
    assert more == pytest.approx(2 * 904e3 + 2 * coach.primary.stiffness_y * 0.01**2)
    run = railjax.simulate(loco, 40.0, track=railjax.SinusoidTrack(2e-3, 20.0), duration=0.5)
    assert run["wheelset_y"].shape == (50, 6)
    assert bool(run.ok)


def test_a_closed_flange_is_its_whole_stiffness(coach):
    closed = np.asarray(railjax.state_matrix(coach, 50.0, flange=True) - railjax.state_matrix(coach, 50.0))
    added = closed[17 + 9 : 17 + 13, 9:13] * coach.wheelset.mass
    np.testing.assert_allclose(added, -coach.contact.flange_stiffness * np.eye(4), rtol=1e-12, atol=1e-6)
