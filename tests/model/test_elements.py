"""Yaw dampers, blow-off, bump stops, points of their own: closed forms, virtual work, power, derivatives, lanes."""

import dataclasses
from typing import ClassVar

import cooperrider
import jax
import jax.numpy as jnp
import laws
import numpy as np
import pytest
import scipy.integrate
import scipy.linalg

import railjax
from railjax.model import suspension as elements
from railjax.model.motion import PASSIVE, motion, state_rate, state_size
from railjax.simulation.simulate import initial_state
from railjax.simulation.step_size import fastest_rate, largest_step

LAWS = ["sharp", "smooth", "linear"]
C, C_B, V_0, K, ARM = 3e5, 2e4, 0.01, 1e7, 1.35
YAW = railjax.YawDamper(C, ARM, V_0, C_B, K)
RIGID = dataclasses.replace(YAW, series_stiffness=None)
TRAVEL, FORCE = np.array([0.025, 0.03, 0.035, 0.04]), np.array([0.0, 600.0, 1760.0, 3730.0])
STOP = railjax.BumpStop(TRAVEL, FORCE)


def full(coach, law="sharp"):
    """The coach with every optional element."""
    lateral = railjax.LateralDamper(0.1, 5e3, 0.97, 0.044)
    return railjax.replace(
        coach,
        yaw_damper=YAW,
        lateral_damper=lateral,
        bump_stop=STOP,
        cross_bracing=railjax.CrossBracing(5e6, 1e5),
        geometry__half_vertical_damper=1.323,
        contact__law=law,
    )


def instant(vehicle, x, speed=50.0):
    return motion(vehicle, PASSIVE, 1.0 / speed, jnp.zeros((2, 2)), jnp.asarray(x))


def blow_off(velocity):
    """One damper, by hand."""
    return np.sign(velocity) * np.where(np.abs(velocity) < V_0, C * np.abs(velocity), C * V_0 + C_B * (np.abs(velocity) - V_0))


def test_blow_off_and_its_inverse():
    velocity = np.linspace(-0.05, 0.05, 1001)
    force = np.asarray(elements.blow_off_force("sharp", YAW, C, jnp.asarray(velocity)))
    np.testing.assert_allclose(force, blow_off(velocity), rtol=1e-12, atol=1e-9)
    back = np.asarray(elements.blow_off_velocity("sharp", YAW, C, jnp.asarray(force)))
    np.testing.assert_allclose(back, velocity, rtol=1e-12, atol=1e-15)
    linear = np.asarray(elements.blow_off_force("linear", YAW, C, jnp.asarray(velocity)))
    np.testing.assert_array_equal(linear, C * velocity)
    # the twins are off by half their width at most, at the corner: w in velocity, c w in force for the inverse
    smooth = np.asarray(elements.blow_off_force("smooth", YAW, C, jnp.asarray(velocity)))
    bound = (C - C_B) * 0.5 * YAW.blow_off_width
    assert 0.9 * bound < np.abs(smooth - force).max() <= bound * (1 + 1e-9)
    inverse = np.asarray(elements.blow_off_velocity("smooth", YAW, C, jnp.asarray(force)))
    bound = (1 / C_B - 1 / C) * 0.5 * C * YAW.blow_off_width
    assert 0.9 * bound < np.abs(inverse - velocity).max() <= bound * (1 + 1e-9)


@pytest.mark.parametrize("travel", [TRAVEL, np.array([0.02, 0.05, 0.06, 0.08]), TRAVEL[1:]])
def test_bump_stop_is_the_interpolated_table(travel):
    force = FORCE[-len(travel) :]
    stop = railjax.BumpStop(travel, force)
    d = np.linspace(-0.1, 0.1, 4001)
    last = (force[-1] - force[-2]) / (travel[-1] - travel[-2])
    inside = np.interp(np.abs(d), np.append(0.0, travel), np.append(0.0, force))
    expected = np.sign(d) * (inside + last * np.maximum(np.abs(d) - travel[-1], 0.0))
    found = np.asarray(elements.bump_stop_force("sharp", stop, jnp.asarray(d)))
    np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-8)
    smooth = np.asarray(elements.bump_stop_force("smooth", stop, jnp.asarray(d)))
    changes = np.abs(np.diff(np.diff(np.append(0.0, force)) / np.diff(np.append(0.0, travel))))
    assert 0.0 < np.abs(smooth - expected).max() <= 0.51 * changes.sum() * stop.width
    linear = np.asarray(elements.bump_stop_force("linear", stop, jnp.asarray(d)))
    np.testing.assert_allclose(linear, force[0] / travel[0] * d, rtol=1e-12)


def elongation_after(stretch, duration):
    """s of the Maxwell element that many seconds after a step of its deflection, by SciPy."""

    def rate(_, s):
        d = jnp.array([stretch])
        return np.asarray(elements.yaw_damper_force("sharp", YAW, d, d, jnp.asarray(s)[None])[1])[0]

    run = scipy.integrate.solve_ivp(rate, (0.0, duration), [0.0], rtol=1e-9, atol=1e-14, max_step=duration / 20)
    return run.y[0, -1]


def test_maxwell_step_relaxes_exponentially():
    stretch = 1e-4  # k d = 1000 N, below the 3000 N of blow-off
    time = 0.05
    found = elongation_after(stretch, time)
    assert found == pytest.approx(stretch * (1 - np.exp(-K / C * time)), rel=1e-8)


def test_maxwell_step_beyond_blow_off():
    """From F = k d > F_0 the force falls towards F_0 - c_b v_0 with k/c_b, and then to zero with k/c."""
    force_0, start = C * V_0, 5e-4 * K
    rest = force_0 - C_B * V_0
    reach = C_B / K * np.log((start - rest) / (force_0 - rest))
    after = 0.02
    expected = force_0 * np.exp(-K / C * after)
    found = elongation_after(5e-4, reach + after)
    assert K * (5e-4 - found) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("frequency", [0.5, 3.0, 20.0])
def test_maxwell_element_has_the_complex_stiffness_of_its_parts(frequency):
    """K* = k i w c/(k + i w c) of one damper, from the linearisation of the law."""
    omega = 2 * np.pi * frequency

    def law(d, s):
        force, rate = elements.yaw_damper_force("linear", YAW, d, jnp.zeros(1), s[None])
        return force[0], rate[0, 0]

    d, s = jnp.zeros(1), jnp.zeros(1)
    (f_d, r_d), (f_s, r_s) = (jax.jacfwd(law, argnums=i)(d, s) for i in (0, 1))
    stiffness = f_d[0] + f_s[0] * r_d[0] / (1j * omega - r_s[0])
    assert complex(stiffness) == pytest.approx(2 * K * 1j * omega * C / (K + 1j * omega * C), rel=1e-12)


def test_maxwell_harmonic_response_in_the_vehicle(coach):
    """Forced through the track, the vehicle answers as E says with the element's complex stiffness put in by hand."""
    omega = 2 * np.pi * 1.7
    damped = railjax.replace(coach, yaw_damper=dataclasses.replace(YAW, blow_off_velocity=None, damping_beyond=None))
    matrix = np.asarray(railjax.state_matrix(damped, 50.0))
    share = np.asarray(railjax.track_matrix(damped, 50.0)).sum(axis=1)
    found = np.linalg.solve(1j * omega * np.eye(36) - matrix, share)[:17]
    mass, damping, stiffness = (np.asarray(m) for m in railjax.matrices(coach, 50.0))
    force = np.diag(mass) * np.asarray(railjax.track_matrix(coach, 50.0)).sum(axis=1)[17:]
    arms = np.zeros((2, 17))
    arms[:, 1], arms[[0, 1], [5, 6]] = ARM, -ARM
    complex_stiffness = 2 * K * 1j * omega * C / (K + 1j * omega * C)
    dynamic = -(omega**2) * mass + 1j * omega * damping + stiffness + complex_stiffness * arms.T @ arms
    np.testing.assert_allclose(found, np.linalg.solve(dynamic, force), rtol=1e-9, atol=1e-12)


@pytest.fixture(scope="module")
def cooperrider_bogie():
    return railjax.load_vehicle("cooperrider-bogie")


@pytest.mark.parametrize("size", [1e-6, 1e-3, 2e-2])
def test_cooperrider_s_equations(cooperrider_bogie, size):
    """The right-hand side of the published benchmark, from linear creep to full slip and flange contact."""
    rng = np.random.default_rng(11)
    order = [4, 5, 6, 0, 2, 1, 3]  # frame y, psi, roll; wheelsets y; psi
    for _ in range(5):
        q, w = size * rng.normal(size=7), 10 * size * rng.normal(size=7)
        x = jnp.asarray(np.concatenate([q[order], w[order]]))
        found = motion(cooperrider_bogie, PASSIVE, 1 / 66.0, jnp.zeros((1, 2)), x)
        expected = cooperrider.rate(q, w, 66.0)[order]
        rates = np.asarray(state_rate(cooperrider_bogie, found))
        np.testing.assert_array_equal(rates[:7], w[order])
        np.testing.assert_allclose(rates[7:], expected, rtol=1e-10, atol=1e-12 * np.abs(expected).max())


def test_cooperrider_s_hopf_point_and_what_lies_around_it(cooperrider_bogie):
    """Published: 68.66 m/s; from y_1 = 0.1 m, 70 m/s settles on a periodic orbit and 60 m/s decays to rest."""
    assert float(railjax.linear_critical_speed(cooperrider_bogie)) == pytest.approx(68.66, abs=0.05)
    late = {}
    for speed in (60.0, 70.0):
        result = railjax.simulate(
            cooperrider_bogie, speed, duration=12.0, initial={"wheelset_y": [0.1, 0.0]}, record=["wheelset_y"]
        )
        assert bool(result.ok)
        y = np.asarray(result["wheelset_y"])[:, 0]
        late[speed] = np.abs(y[len(y) * 3 // 4 :]).max()
    assert late[60.0] < 1e-5
    assert 5e-3 < late[70.0] < 2e-2


def test_a_stiff_maxwell_element_is_the_rigid_one(coach):
    linear = {"blow_off_velocity": None, "damping_beyond": None}
    rigid = railjax.replace(coach, yaw_damper=dataclasses.replace(RIGID, **linear))
    held = railjax.replace(coach, yaw_damper=dataclasses.replace(YAW, **linear, series_stiffness=1e13))
    as_before = railjax.replace(coach, secondary__damping_x=C * ARM**2)  # half_secondary is 1 m
    speed = float(railjax.linear_critical_speed(rigid))
    assert float(railjax.linear_critical_speed(held)) == pytest.approx(speed, rel=1e-5)
    assert float(railjax.linear_critical_speed(as_before)) == pytest.approx(speed, rel=1e-10)
    assert state_size(rigid, PASSIVE) == 34
    assert state_size(held, PASSIVE) == 36


def by_hand(vehicle, x):
    """Generalised forces of the added elements, and x' of the dashpots, in NumPy."""
    q, w, s = x[:17], x[17:34], x[34:]
    expected, rates = np.zeros(17), np.zeros(2)
    for j, side in enumerate((1.0, -1.0)):
        b_y, b_psi, b_phi = 3 + j, 5 + j, 7 + j
        yaw = np.zeros(17)
        yaw[[1, b_psi]] = ARM, -ARM
        spring = K * (yaw @ q - s[j])
        excess = abs(spring) - C * V_0
        rates[j] = spring / C if excess < 0 else np.sign(spring) * (V_0 + excess / C_B)
        lateral = np.zeros(17)
        lateral[[0, 1, 2, b_y, b_phi]] = 1.0, side * 8.6, 0.97, -1.0, 0.044
        velocity = lateral @ w
        force = np.sign(velocity) * (min(abs(velocity), 0.1) * 25e3 + max(abs(velocity) - 0.1, 0.0) * 5e3)
        springs = np.zeros(17)
        springs[[0, 1, 2, b_y, b_phi]] = 1.0, side * 8.6, 1.24, -1.0, 0.06
        travel = springs @ q
        slope = (FORCE[-1] - FORCE[-2]) / (TRAVEL[-1] - TRAVEL[-2])
        stop = np.interp(abs(travel), np.append(0.0, TRAVEL), np.append(0.0, FORCE))
        stop = np.sign(travel) * (stop + slope * max(abs(travel) - TRAVEL[-1], 0.0))
        roll = np.zeros(17)
        roll[[2, b_phi]] = 1.0, -1.0
        # in place of the coach's own lateral damper at the springs and vertical damper at 1 m
        expected -= yaw * 2 * spring + lateral * 2 * force + springs * (stop - 2 * 25e3 * (springs @ w))
        expected -= roll * 2 * 18e3 * (1.323**2 - 1.0) * (roll @ w)
        wheelset_y, wheelset_psi, half = 9 + 2 * j, 13 + 2 * j, vehicle.geometry.half_wheelbase
        shear, bending = np.zeros(17), np.zeros(17)
        shear[[wheelset_y, wheelset_y + 1, wheelset_psi, wheelset_psi + 1]] = 1.0, -1.0, -half, -half
        bending[[wheelset_psi, wheelset_psi + 1]] = 1.0, -1.0
        expected -= shear * 5e6 * (shear @ q) + bending * 1e5 * (bending @ q)
    return expected, rates


@pytest.mark.parametrize("size", [1e-4, 3e-3, 2e-2])
def test_generalised_forces_and_rates_are_the_independent_ones(coach, size):
    vehicle = full(coach)
    mass = np.diag(np.asarray(railjax.matrices(coach, 50.0).mass))
    rng = np.random.default_rng(5)
    for _ in range(4):
        x = size * np.concatenate([rng.normal(size=17), 20 * rng.normal(size=17), rng.normal(size=2)])
        change = np.asarray(state_rate(vehicle, instant(vehicle, x)))
        before = np.asarray(state_rate(coach, instant(coach, x[:34])))
        expected, rates = by_hand(vehicle, x)
        scale = np.abs(mass * before[17:]).max()
        np.testing.assert_allclose(mass * (change[17:34] - before[17:]), expected, rtol=1e-9, atol=1e-11 * scale)
        np.testing.assert_allclose(change[34:], rates, rtol=1e-9)


@pytest.mark.parametrize("law", LAWS)
def test_dampers_take_power_out(coach, law):
    """Without creep all that changes kinetic and spring energy is the dampers: power is never put in."""
    vehicle = railjax.replace(
        full(coach, law),
        contact__creep_longitudinal=0.0,
        contact__creep_lateral=0.0,
        contact__creep_lateral_spin=0.0,
        contact__creep_spin=0.0,
    )
    mass = np.diag(np.asarray(railjax.matrices(coach, 50.0).mass))
    still = railjax.replace(
        vehicle,
        yaw_damper=None,
        lateral_damper=None,
        secondary__damping_y=0.0,
        secondary__damping_z=0.0,
        primary__damping_z=0.0,
    )
    rng = np.random.default_rng(6)
    for size in (1e-4, 1e-2):
        x = size * np.concatenate([rng.normal(size=17), 20 * rng.normal(size=17), rng.normal(size=2)])
        rate = np.asarray(state_rate(vehicle, instant(vehicle, x)))
        # forces that are not conservative, times velocities; the series springs' energy is k (d - s)^2 of two dampers
        conservative = np.asarray(state_rate(still, instant(still, x[:34])))
        power = np.sum(x[17:34] * mass * (rate[17:34] - conservative[17:]))
        stretch = ARM * np.array([x[1] - x[5], x[1] - x[6]]) - x[34:]
        velocity = ARM * np.array([x[18] - x[22], x[18] - x[23]])
        stored = np.sum(2 * K * stretch * (velocity - rate[34:]))
        assert power + stored < 0.0
        dashpots = np.sum(2 * K * stretch * rate[34:])
        assert dashpots > 0.0
        dissipated = -(power + stored) - dashpots
        now = instant(vehicle, x)
        travel_rate = np.asarray(now.deflection_rate["lateral_damper"])
        others = np.sum(np.asarray(now.damper_force) * travel_rate)
        for name, damping in (("vertical_damper", 2 * 18e3), ("primary_z", 4 * 3.67e3)):
            others += np.sum(damping * np.asarray(now.deflection_rate[name]) ** 2)
        assert dissipated == pytest.approx(others, rel=1e-9)


def test_a_controlled_damper_sees_its_own_point(coach):
    class Spy:
        internal_states = 1

        def force(self, vehicle, travel, velocity, internal):
            seen.append((travel, velocity))
            return 1e3 * velocity, internal + travel[None]

    seen = []
    vehicle = railjax.replace(coach, lateral_damper=railjax.LateralDamper(carbody_height=0.97))
    x = np.random.default_rng(2).normal(size=36) * 1e-3
    found = motion(vehicle, Spy(), 1 / 50.0, jnp.zeros((2, 2)), jnp.asarray(x))
    q, side = x[:17], np.array([1.0, -1.0])
    # the bogie's height, not given, is that of the springs
    travel = q[0] + 0.97 * q[2] + side * 8.6 * q[1] - q[3:5] + 0.06 * q[7:9]
    np.testing.assert_allclose(seen[0][0], travel, rtol=1e-12)
    np.testing.assert_array_equal(found.internal_rate, (x[34:] + np.asarray(seen[0][0]))[None])


def test_states_of_lateral_dampers_come_before_those_of_yaw_dampers(coach):
    @jax.tree_util.register_dataclass
    @dataclasses.dataclass(frozen=True)
    class Lag:
        internal_states: ClassVar[int] = 2

        def force(self, vehicle, travel, velocity, internal):
            return internal[0], jnp.stack([-5.0 * internal[0], -7.0 * internal[1]])

    vehicle = railjax.replace(coach, yaw_damper=YAW)
    matrix = np.asarray(railjax.state_matrix(vehicle, 50.0, Lag()))
    assert matrix.shape == (40, 40)
    np.testing.assert_allclose(np.diag(matrix)[34:], [-5, -5, -7, -7, -K / C, -K / C])
    assert matrix[38, 1] == pytest.approx(K / C * ARM)
    assert [np.asarray(m).shape for m in railjax.matrices(vehicle, 50.0)] == [(17, 17)] * 3


def test_an_explicit_passive_damper_is_linear(coach):
    valve = railjax.replace(coach, lateral_damper=railjax.LateralDamper(0.1, 5e3))
    velocity = jnp.array([0.05, 0.3])
    own, _ = PASSIVE.force(valve, velocity, velocity, jnp.zeros((0, 2)))
    np.testing.assert_allclose(own, [2 * 25e3 * 0.05, 2 * (25e3 * 0.1 + 5e3 * 0.2)])
    given, _ = railjax.PassiveDamper(25e3).force(valve, velocity, velocity, jnp.zeros((0, 2)))
    np.testing.assert_allclose(given, 2 * 25e3 * velocity)


@pytest.mark.parametrize("law", LAWS)
def test_derivatives_at_and_near_the_corners(law):
    """Against finite differences beside the corners, finite and between the sides at them."""

    def all_laws(damping, beyond, velocity_0, stiffness, x):
        yaw = railjax.YawDamper(damping, ARM, velocity_0, beyond, stiffness)
        rigid = dataclasses.replace(yaw, series_stiffness=None)
        one = jnp.reshape(x, (1,))
        stretch = one * C / K  # the force of blow-off at velocity_0
        force, rate = elements.yaw_damper_force(law, yaw, stretch, one, jnp.zeros((1, 1)))
        stop = elements.bump_stop_force(law, railjax.BumpStop(TRAVEL, FORCE), 2.5 * one)
        valve = elements.yaw_damper_force(law, rigid, stretch, one, jnp.zeros((0, 1)))[0]
        return jnp.concatenate([1e-3 * force, 1e-3 * valve, 1e-3 * stop, 10.0 * rate[0]])

    # value and both modes' derivatives at all points, by one compilation
    @jax.jit
    @jax.vmap
    def at(x):
        given = C, C_B, V_0, K, x
        return all_laws(*given), *(jnp.stack(mode(all_laws, argnums=range(5))(*given)) for mode in (jax.jacfwd, jax.jacrev))

    step, beside = 1e-9, V_0 * (1 + np.array([3e-5, -3e-5, 0.7] if law == "sharp" else [0.0, 3e-5, -3e-5, 0.7]))
    corners = V_0 * np.array([0.0, 1.0, -1.0, 0.9, 1.1, -0.7, -1.7])
    values, forward, reverse = (np.asarray(part) for part in at(np.concatenate([beside, beside + step, beside - step, corners])))
    assert np.all(np.isfinite(forward))
    np.testing.assert_allclose(forward, reverse, rtol=1e-10, atol=1e-6)
    _, above, below, _ = np.split(values, len(beside) * np.arange(1, 4))
    np.testing.assert_allclose(forward[: len(beside), 4], (above - below) / (2 * step), rtol=1e-4, atol=1e-3)
    if law == "sharp":
        middle, below, above = forward[len(beside) * 3 + np.array([1, 3, 4]), 4]
        assert np.all((np.minimum(below, above) <= middle) & (middle <= np.maximum(below, above)))


def test_derivatives_of_a_run_and_of_the_critical_speed(coach):
    """The run is a bogie's, whose elements are those of two and whose derivative takes half as long to compile."""
    paths = (
        "yaw_damper.series_stiffness",
        "yaw_damper.damping",
        "lateral_damper.damping_beyond",
        "geometry.half_vertical_damper",
    )

    def with_factors(vehicle, factors):
        for path, factor in zip(paths, factors, strict=True):
            vehicle = railjax.set_parameter(vehicle, path, factor * railjax.get_parameter(vehicle, path))
        return vehicle

    def rms(factors):
        run = railjax.simulate(
            with_factors(full(railjax.load_vehicle("cooperrider-bogie"), "smooth"), factors),
            50.0,
            track=railjax.SinusoidTrack(8e-3, 20.0),
            duration=0.5,
            record=(),
            reduce=["rms:bogie_y"],
        )
        return 1e3 * run["rms:bogie_y"][0]

    for both in (
        jax.jit(jax.value_and_grad(rms)),
        jax.value_and_grad(lambda factors: railjax.linear_critical_speed(with_factors(full(coach), factors))),
    ):
        h = 1e-4
        differences = [(both(jnp.ones(4) + step)[0] - both(jnp.ones(4) - step)[0]) / (2 * h) for step in h * np.eye(4)]
        np.testing.assert_allclose(both(jnp.ones(4))[1], differences, rtol=1e-4, atol=1e-8)
    table = jax.grad(
        lambda force: jnp.sum(elements.bump_stop_force("sharp", railjax.BumpStop(TRAVEL, force), jnp.array([0.0325])))
    )
    np.testing.assert_allclose(table(jnp.asarray(FORCE)), [0.0, 0.5, 0.5, 0.0], atol=1e-12)


def run(vehicle, **options):
    options = {"track": railjax.SinusoidTrack(6e-3, 20.0), "duration": 0.5} | options
    return railjax.simulate(vehicle, 40.0, record=["carbody_y", "damper_force"], **options)


def test_lanes_over_the_series_stiffness_and_over_tables(coach):
    """Both in one batch, in which the car body meets the stops of two lanes."""
    stiffness, tables = np.array([2e6, 5e6, 1e7]), TRAVEL[:, None] * np.array([0.1, 1.0, 2.0])
    start = {"initial": {"carbody_y": 0.03}}

    def of(stiffness, travel):
        return railjax.replace(full(coach), yaw_damper__series_stiffness=stiffness, bump_stop__travel=travel)

    batch = run(of(jnp.asarray(stiffness), jnp.asarray(tables)), **start)
    for lane in range(3):
        single = run(of(float(stiffness[lane]), tables[:, lane]), **start)
        np.testing.assert_allclose(batch["carbody_y"][..., lane], single["carbody_y"], rtol=1e-9, atol=1e-15)
        np.testing.assert_allclose(batch.final[:, lane], single.final, rtol=1e-6, atol=1e-12)
    # each matters by itself
    stiff, wide = run(of(1e7, tables[:, 0]), **start), run(of(2e6, tables[:, 2]), **start)
    assert np.abs(stiff["carbody_y"] - batch["carbody_y"][..., 0]).max() > 1e-7
    assert np.abs(wide["carbody_y"] - batch["carbody_y"][..., 0]).max() > 1e-5


def test_the_step_s_bound_covers_the_opened_valve_and_the_bump_stop(coach):
    valve = railjax.replace(coach, yaw_damper=dataclasses.replace(YAW, damping_beyond=2e3))
    assert float(fastest_rate(valve, 50.0, PASSIVE)) > 0.9 * K / 2e3
    with pytest.raises(railjax.InputError, match="too large"):
        run(valve)
    assert float(largest_step(valve, 50.0, PASSIVE)) > 2.5e-4
    stop = railjax.BumpStop(np.array([0.02, 0.03]), np.array([0.0, 1e8]))
    stiff = float(fastest_rate(railjax.replace(coach, bump_stop=stop), 50.0, PASSIVE))
    assert stiff > np.sqrt(1e10 / 2300.0)
    # within the corners nothing is faster than without the elements
    mild = railjax.replace(coach, bump_stop=STOP)
    assert float(fastest_rate(mild, 50.0, PASSIVE)) == pytest.approx(float(fastest_rate(coach, 50.0, PASSIVE)), rel=1e-3)


def test_rk4_keeps_its_order_with_the_maxwell_element(coach):
    vehicle = full(coach, "linear")
    start = initial_state(vehicle, PASSIVE, {"bogie_psi": 1e-3})
    exact = scipy.linalg.expm(0.2 * np.asarray(railjax.state_matrix(vehicle, laws.SPEED))) @ np.asarray(start)
    errors = [np.abs(np.asarray(laws.final(vehicle, PASSIVE, start, 0.2, steps)) - exact).max() for steps in (200, 400)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.3)


def test_a_vehicle_says_what_it_has(coach):
    assert "yaw dampers (blow-off and series stiffness), lateral dampers with blow-off, bump stops, cross bracing" in str(
        full(coach)
    )
    assert "with" not in str(coach).splitlines()[1]
    bare = railjax.replace(coach, yaw_damper=RIGID, lateral_damper=railjax.LateralDamper(bogie_to_damper=0.1))
    assert "yaw dampers (blow-off), lateral dampers at heights of their own" in str(bare)


def test_cross_bracing_ties_the_wheelsets_of_a_bogie(coach):
    """Its stiffness is k_s b b' + k_b c c' with the shear b and the bending c of two wheelsets; and it steadies a soft bogie."""
    shear, bending, a = 5e6, 2e5, coach.geometry.half_wheelbase
    braced = railjax.replace(coach, cross_bracing=railjax.CrossBracing(shear, bending))
    added = np.asarray(railjax.matrices(braced, 50.0).stiffness - railjax.matrices(coach, 50.0).stiffness)
    expected = np.zeros((17, 17))
    for first in (9, 11):
        b, c = np.zeros(17), np.zeros(17)
        b[[first, first + 1, first + 4, first + 5]] = 1.0, -1.0, -a, -a
        c[[first + 4, first + 5]] = 1.0, -1.0
        expected += shear * np.outer(b, b) + bending * np.outer(c, c)
    np.testing.assert_allclose(added, expected, atol=1e-3)  # of differences of 1e9
    soft = railjax.replace(coach, primary__stiffness_x=0.15 * coach.primary.stiffness_x)
    both = [railjax.linear_critical(one).speed for one in (soft, railjax.replace(soft, cross_bracing=braced.cross_bracing))]
    assert both[1] > 1.2 * both[0]
    single = railjax.replace(coach, cross_bracing=braced.cross_bracing, geometry__axle_pattern=(0.0,))
    with pytest.raises(railjax.InputError, match=r"\[cross_bracing\] ties the two wheelsets .* has 1"):
        railjax.linear_critical(single)


def test_parameters_of_a_vehicle_are_its_leaves(coach):
    vehicle = full(coach)
    paths = [path for path, _ in railjax.parameters(vehicle)]
    assert len(paths) == len(set(paths)) == len(jax.tree.leaves(vehicle))
    assert {"yaw_damper.damping", "bump_stop.travel", "geometry.half_vertical_damper"} <= set(paths)
    assert [path for path, _ in railjax.parameters(coach)] == [path for path, _ in railjax.parameters()]


@pytest.mark.parametrize("part", ["yaw_damper.damping", "lateral_damper.blow_off_velocity", "bump_stop.force"])
def test_a_part_that_is_not_there_is_named(coach, part):
    for call in (railjax.get_parameter, lambda vehicle, path: railjax.set_parameter(vehicle, path, 1.0)):
        with pytest.raises(railjax.InputError, match=f"this vehicle has no {part.split('.')[0].replace('_', ' ')}") as caught:
            call(coach, part)
        assert len(str(caught.value).splitlines()) == 1
    with pytest.raises(railjax.InputError, match=r"nearest is 'yaw_damper\.damping'"):
        railjax.get_parameter(coach, "yaw_damper.dampin")
    assert railjax.get_parameter(full(coach), part) is not None
