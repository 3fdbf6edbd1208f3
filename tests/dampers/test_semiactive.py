"""Semi-active laws: closed forms, the hold over a step, lanes, the regulator. Dissipation, symmetry, derivatives: tests/test_testing.py."""

import dataclasses

import jax
import jax.numpy as jnp
import laws
import numpy as np
import pytest
import scipy.linalg
from laws import ALL, CONTROLLED, K

import railjax
from railjax.dampers.sampling import sampled
from railjax.model.damper import HARD, SOFT
from railjax.model.kinematics import deflections, size, split
from railjax.model.track.curve import arc as curve_arc
from railjax.simulation.step_size import fastest_rate

H, L = 1.24, 8.6  # h_cc, l


def above(groups):
    """The car body's lateral motion above each bogie, by hand."""
    y, psi, phi = (np.asarray(groups[f"carbody_{name}"]) for name in ("y", "psi", "phi"))
    return np.stack([y + H * phi + L * psi, y + H * phi - L * psi])


def test_sharp_laws_by_hand(coach):
    """Eqs. (10)-(11) and the published rules, in NumPy, at 16 random motions."""
    for name, damper in CONTROLLED.items():
        if "lags" in name:
            continue
        travel, velocity, internal, seen = laws.instant(coach, damper, 0, lanes=(8,))
        found, _ = laws.force(coach, damper, travel, velocity, internal, seen)
        d, v, body = np.asarray(travel), np.asarray(velocity), above(seen.rates)
        if name == "balance":
            expected = np.where(d * v < 0, 2 * 0.7 * K * np.abs(d) * np.sign(v), 0.0)
        elif name == "balance, limited, soft":
            expected = np.where(d * v < 0, np.minimum(2 * 1.2 * K * np.abs(d), 2e3) * np.sign(v), 2 * 4e3 * v)
        elif name == "skyhook":
            expected = 2 * np.where(body * v > 0, HARD, SOFT) * v
        elif name == "skyhook, continuous":
            expected = 2 * np.clip(40e3 * body / v, SOFT, HARD) * v
        else:
            acceleration = (body - np.asarray(internal)[-1]) / 5e-3
            fast = np.abs(acceleration) > 3 * np.pi * np.abs(body)
            signal = acceleration if name == "ADD" else np.where(fast, acceleration, body)
            expected = 2 * np.where(signal * v > 0, HARD, SOFT) * v
        np.testing.assert_allclose(np.asarray(found), expected, rtol=1e-12, atol=1e-9, err_msg=name)


@pytest.mark.parametrize("name", ["balance", "skyhook", "skyhook, continuous", "ADD"])
def test_smooth_twin_tends_to_the_sharp_law(coach, name):
    errors = []
    travel, velocity, internal, seen = laws.instant(coach, CONTROLLED[name], 3, lanes=(500,))
    sharp, _ = laws.force(coach, CONTROLLED[name], travel, velocity, internal, seen)
    for width in (1e-2, 1e-3):
        twin = dataclasses.replace(CONTROLLED[name], law="smooth", signal_width=4 * width, velocity_width=width)
        smooth, _ = laws.force(coach, twin, travel, velocity, internal[len(internal) - twin.internal_states :], seen)
        errors.append(np.mean(np.abs(np.asarray(smooth - sharp))) / np.mean(np.abs(np.asarray(sharp))))
    assert errors[0] < 0.15
    assert errors[1] < 0.2 * errors[0]


@pytest.mark.parametrize("name", ALL)
def test_decision_is_held_and_deciding_twice_changes_nothing(coach, name):
    damper = ALL[name]
    travel, velocity, internal, seen = laws.instant(coach, damper, 5)
    once = damper.held(coach, travel, velocity, internal, seen)
    np.testing.assert_allclose(damper.held(coach, travel, velocity, once, seen), once, rtol=1e-12)
    # later in the step, the suspension having turned: the decision is the same, and nothing moves it
    arguments = (coach, -travel, -velocity, once) + ((seen,) if getattr(damper, "observes", False) else ())
    _, rate = damper.force(*arguments)
    decided = 4 if name == "bouc-wen" else 1 if name == "hybrid" else 0
    assert np.all(np.asarray(rate)[decided] == 0.0)
    clock = laws.clock(damper)
    assert np.all(np.asarray(rate)[clock] == 1.0)
    half, whole = (once.at[clock].set(share * damper.sample_time) for share in (0.5, 1.0))
    between, again = (damper.held(coach, -travel, velocity, state, seen) for state in (half, whole))
    np.testing.assert_array_equal(np.asarray(between)[decided], np.asarray(once)[decided])
    if name in ("balance", "bouc-wen", "hybrid"):
        np.testing.assert_allclose(np.asarray(again)[decided], 1.0 - np.asarray(once)[decided])


@pytest.mark.parametrize(
    ("dt", "times"),
    [
        (5e-5, [0.0, 1e-3, 2e-3, 3e-3]),
        (4e-4, [0.0, 1.2e-3, 2e-3, 3.2e-3]),
        (1e-3, [0.0, 1e-3, 2e-3, 3e-3]),
        (1.5e-3, [0.0, 1.5e-3, 3e-3]),
    ],
)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_samples_are_taken_at_the_first_step_that_reaches_one(dt, times, dtype):
    clock, kept, found = jnp.zeros(2, dtype), jnp.zeros(2, dtype), []
    for index in range(int(3.4e-3 / dt) + 1):
        clock, kept = sampled(clock, 1e-3, jnp.full(2, index, dtype), kept)
        np.testing.assert_array_equal(sampled(clock, 1e-3, kept, kept)[0], clock)
        found.append(float(kept[0]))
        clock = clock + dtype(dt)
    np.testing.assert_allclose(np.unique(found) * dt, times, rtol=1e-6)


@pytest.mark.parametrize("name", ["skyhook", "ADD", "mixed"])
def test_a_controller_with_a_sample_time_does_not_feel_the_step(coach, name):
    """1 ms against 0.05 ms, read at the same instants; deciding at every step they are 1 to 10 % apart."""

    def forces(dt):
        options = {"track": railjax.SinusoidTrack(5e-3, 20.0), "duration": 1.5, "record": ["damper_force"], "sample": 1e-3}
        return np.asarray(railjax.simulate(coach, 55.0, damper=CONTROLLED[name], dt=dt, **options)["damper_force"])

    coarse, fine = forces(1e-3), forces(5e-5)
    assert np.sqrt(np.mean(coarse**2)) == pytest.approx(np.sqrt(np.mean(fine**2)), rel=2e-3)
    assert np.mean(np.abs(coarse - fine)) < 0.01 * np.mean(np.abs(fine))


@pytest.mark.parametrize("alpha", [0.3, 1.0])
def test_loss_per_cycle_is_that_of_a_damping_ratio_alpha_over_2_pi(coach, alpha):
    """Two quarters of a cycle at 2 α k |x|: α (2 k) X², at any frequency."""
    phase = np.linspace(0.0, 2 * np.pi, 20001)[:-1]
    amplitude = 0.02
    for omega in (3.0, 30.0):
        travel = jnp.asarray(np.stack([amplitude * np.sin(phase)] * 2))
        velocity = jnp.asarray(np.stack([amplitude * omega * np.cos(phase)] * 2))
        seen = laws.instant(coach, CONTROLLED["balance"], 0, lanes=(len(phase),))[3]
        damper = railjax.BalanceLogic(alpha)
        force, _ = laws.force(coach, damper, travel, velocity, jnp.zeros((damper.internal_states, 2, len(phase))), seen)
        loss = np.sum(np.asarray(force * velocity)[0]) * (2 * np.pi / omega / len(phase))
        assert loss == pytest.approx(alpha * 2 * K * amplitude**2, rel=1e-3)


def test_lanes_are_single_runs(coach):
    """A batch over speeds and gains, by lanes and by `vmap`; every instant dissipates with its fresh decision."""
    options = {"track": railjax.SinusoidTrack(4e-3, 20.0), "duration": 0.3, "record": ["damper_force", "secondary_velocity"]}

    def run(speed, gain):
        return railjax.simulate(coach, speed, damper=railjax.BalanceLogic(gain), **options).channels

    gains, speeds = jnp.array([0.2, 0.9]), jnp.array([45.0, 60.0])
    batch, mapped = run(speeds, gains), jax.vmap(run)(speeds, gains)
    alone = jnp.moveaxis(mapped["damper_force"], 0, -1)
    np.testing.assert_allclose(batch["damper_force"], alone, rtol=1e-8, atol=1e-6)
    assert float(jnp.min(batch["damper_force"] * batch["secondary_velocity"])) >= 0.0


def test_bound_on_the_step_sees_what_rest_does_not_show(coach):
    """The smooth law is a damper of 2 k 50 mm/w between bogie (2300 kg; roll makes it lighter) and car body."""
    narrow = railjax.BalanceLogic(1.0, law="smooth", velocity_width=1e-4)
    rate = float(fastest_rate(coach, 50.0, narrow))
    assert 1.0 < rate / (2 * K * 0.05 / 1e-4 / 2300) < 1.4
    with pytest.raises(railjax.InputError, match="too large for RK4"):
        railjax.simulate(coach, 50.0, damper=narrow, duration=0.1)


def independent_plant(coach, speed):
    """A, B (per kN of each bogie's dampers), outputs: accelerations above the bogies, travels; by hand."""
    a = np.asarray(railjax.state_matrix(coach, speed, railjax.PassiveDamper(0.0)))
    travel = np.zeros((2, 17))
    for j, side in enumerate((1.0, -1.0)):
        travel[j, [0, 1, 2, 3 + j, 7 + j]] = 1.0, side * L, H, -1.0, 0.06
    mass = np.diag(np.asarray(railjax.matrices(coach, speed).mass))
    b = np.vstack([np.zeros((17, 2)), -1e3 * travel.T / mass[:, None]])
    body = np.array([[1.0, L, H], [1.0, -L, H]])
    return a, b, np.hstack([np.zeros((2, 0)), body @ a[17:20]]), body @ b[17:20], travel


def test_regulator_is_optimal(coach):
    """J(K) by Lyapunov's equation for an independent plant: stationary at the gain, and the unstable coach is stabilised."""
    speed, w_t, w_f = 250.0 / 3.6, 10.0, 0.05
    a, b, c, d, travel = independent_plant(coach, speed)
    assert np.linalg.eigvals(a).real.max() > 0.0
    gain = np.asarray(railjax.ClippedLQR.design(coach, speed, travel_weight=w_t, force_weight=w_f).feedback) / 1e3

    def cost(gain):
        # u = D in kN = gain x
        closed = a + b @ gain
        assert np.linalg.eigvals(closed).real.max() < 0.0
        output = np.vstack([c + d @ gain, np.hstack([w_t * travel, np.zeros((2, 17))]), w_f * gain])
        return np.trace(scipy.linalg.solve_continuous_lyapunov(closed.T, -output.T @ output) @ noise)

    rng = np.random.default_rng(2)
    root = rng.normal(size=(34, 34)) * np.repeat([1e-3, 2e-2], 17)[:, None]
    noise = root @ root.T
    best = cost(gain)
    for _ in range(4):
        change = 1e-3 * rng.normal(size=gain.shape) * np.abs(gain)
        up, down = cost(gain + change), cost(gain - change)
        assert min(up, down) >= best * (1 - 1e-9)
        assert abs(up - down) < 0.05 * (up + down - 2 * best) + 1e-7 * best


@pytest.mark.parametrize("stiffness", [None, 8e6])
def test_regulator_of_a_vehicle_with_yaw_dampers(coach, stiffness):
    """Its linear closed loop, the yaw dampers' own states fed back, is stable where the vehicle is not; a run takes it."""
    yaw = railjax.YawDamper(3e4, 1.3, series_stiffness=stiffness)
    vehicle, speed = railjax.replace(coach, yaw_damper=yaw, contact__conicity=0.4), 110.0
    damper = railjax.ClippedLQR.design(vehicle, speed)
    open_loop = np.asarray(railjax.state_matrix(vehicle, speed, railjax.PassiveDamper(0.0)))
    assert np.linalg.eigvals(open_loop).real.max() > 0.0
    travel = independent_plant(coach, speed)[-1]
    b = np.zeros((len(open_loop), 2))
    b[17:34] = -travel.T / np.diag(np.asarray(railjax.matrices(coach, speed).mass))[:, None]
    assert damper.feedback.shape == (2, len(open_loop))
    assert np.linalg.eigvals(open_loop + b @ damper.feedback).real.max() < -1e-3
    run = railjax.simulate(vehicle, speed, damper=damper, duration=0.2, initial={"carbody_y": 2e-3}, record=["damper_force"])
    assert np.abs(run["damper_force"]).max() > 10.0
    if stiffness is not None:
        travel, *_, seen = laws.instant(coach, damper, 4)
        seen = seen._replace(yaw_dampers=jnp.array([[1e-3, -2e-3]]))
        x = np.concatenate([np.ravel(g) for groups in seen[:2] for g in groups.values()] + [np.array([1e-3, -2e-3])])
        np.testing.assert_allclose(damper.measured(vehicle, travel, seen), damper.feedback @ x, rtol=1e-9)


def test_clipped_regulator_by_hand(coach):
    damper = railjax.ClippedLQR.design(coach, 55.0)
    travel, velocity, internal, seen = laws.instant(coach, damper, 4)
    force, _ = laws.force(coach, damper, travel, velocity, internal, seen)
    x = np.concatenate([np.ravel(group) for groups in seen[:2] for group in groups.values()])
    wanted = np.clip(damper.feedback @ x, -1e4, 1e4)
    np.testing.assert_allclose(force, np.where(wanted * np.asarray(velocity) > 0, wanted, 0.0), rtol=1e-9)


@pytest.mark.parametrize(
    ("damper", "message"),
    [
        (railjax.BalanceLogic(float("nan")), "damper.alpha must be finite"),
        (railjax.BalanceLogic(-0.1), "damper.alpha must not be negative"),
        (railjax.BalanceLogic(sensor_lag=0.0), "damper.sensor_lag must be positive"),
        (railjax.ADD(sensor_lag=None), "ADD needs a sensor_lag"),
        (railjax.HybridDamper(mr_force=jnp.array([1.0, jnp.inf])), "damper.mr_force must be finite"),
    ],
)
def test_bad_numbers_are_refused_in_one_line(coach, damper, message):
    with pytest.raises(railjax.InputError, match=message) as caught:
        railjax.simulate(coach, 50.0, damper=damper, duration=0.1)
    assert len(str(caught.value).splitlines()) == 1


def test_centred_balance_logic_by_hand(coach):
    """The law of Δy_c less its mean, which follows with the rate of a first-order lag; over a very long time it is the law itself."""
    plain, centred = railjax.BalanceLogic(0.7), railjax.BalanceLogic(0.7, centring=1.5)
    travel, velocity, internal, seen = laws.instant(coach, plain, 0, lanes=(8,))
    standing = 0.03
    mean = jnp.concatenate([internal, jnp.full_like(internal[:1], -standing)])  # of what is measured, -Δy_c
    alike, _ = laws.force(coach, plain, travel, velocity, internal, seen)
    found, rates = laws.force(coach, centred, travel + standing, velocity, mean, seen)
    np.testing.assert_allclose(found, alike, rtol=1e-12)
    np.testing.assert_allclose(rates[-1], -np.asarray(travel) / 1.5, rtol=1e-12)
    long = railjax.BalanceLogic(0.7, centring=1e9)
    same, _ = laws.force(coach, long, travel, velocity, mean.at[-1].set(0.0), seen)
    np.testing.assert_allclose(same, alike, rtol=1e-12)
    assert plain.memoryless
    assert not centred.memoryless
    assert centred.describing(coach, 30.0) is None


def test_balance_logic_in_a_curve(coach):
    """It takes the standing deflection for vibration and pushes the car body out; centred it leaves the deflection as it is."""
    steady = railjax.curving(coach, 40.0, radius=1000.0, cant=0.1)
    standing = float(np.mean(travel_in_equilibrium(coach, steady)))
    arc = railjax.Layout(
        [railjax.Segment.straight(20.0), railjax.Segment.transition(80.0), railjax.Segment.arc(600.0, 1000.0, 0.1)]
    )
    options = {"layout": arc, "track": railjax.SinusoidTrack(3e-3, 20.0), "duration": 14.0, "record": ["secondary_travel"]}
    means = {}
    for centring in (None, 1.0):
        run = railjax.simulate(coach, 40.0, damper=railjax.BalanceLogic(0.7, centring=centring), **options)
        means[centring] = float(np.mean(np.asarray(run["secondary_travel"])[-400:]))
    assert means[None] / standing > 1.2
    assert means[1.0] == pytest.approx(standing, rel=0.05)


def travel_in_equilibrium(coach, steady):
    """Δy_c of each bogie in steady curving: what a passive run settles on."""
    groups = split(coach, jnp.asarray(steady.state[: size(coach)]))
    curve = curve_arc(coach, 40.0, 1e-3, 0.1 / 1.5, jnp.zeros((2, 2)))
    still = {name: jnp.zeros_like(value) for name, value in groups.items()}
    return curve.added(coach, deflections(coach, groups), deflections(coach, still))[0]["secondary_y"]
