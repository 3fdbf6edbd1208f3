"""Controllers as they are built: sensors by hand, sensed laws against ideal ones, the estimators, faults."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
import scipy.signal

import railjax
from railjax.dampers.control.device import Device, every_fault, together
from railjax.dampers.control.estimators import ComplementaryFilter
from railjax.dampers.control.kalman import KalmanFilter, linear_model
from railjax.dampers.control.sensors import KINDS, Sensors, noise_of
from railjax.model.kinematics import size, split
from railjax.testing import check_damper

SPEED = 55.0
TRACK = railjax.RandomTrack("erri-high", seed=3, length=1500.0)
#: coordinates, rates and accelerations among the channels
OF = ("", "_rate", "_acceleration")
SKYHOOK = railjax.Skyhook(damping=1e5)


def internal(run, controller):
    """The controller's own states over time, by name, (samples, rows, n)."""
    states = np.asarray(run.sampled.states)
    own = states[:, 34 : 34 + 2 * controller.internal_states].reshape((len(states), -1, 2))
    return {name: np.moveaxis(rows, 0, 1) for name, rows in controller.parts(np.moveaxis(own, 0, 1)).items()}


def test_noise_is_white_of_unit_variance_and_a_function_of_its_counters():
    like = jnp.zeros((3, 2, 4000))
    count = jnp.broadcast_to(jnp.arange(4000.0), (2, 4000))
    noise = jax.jit(noise_of)
    e = np.asarray(noise(7.0, count, like))
    assert abs(e.mean()) < 0.02
    assert abs(e.std() - 1.0) < 0.02
    assert np.abs(e).max() < np.sqrt(12.0)
    rows = e.reshape(6, -1)
    assert np.abs(np.corrcoef(rows) - np.eye(6)).max() < 0.06
    assert np.abs([np.corrcoef(row[lag:], row[: 4000 - lag])[0, 1] for row in rows for lag in (1, 2, 3)]).max() < 0.06
    # a lane alone, and in another batch
    alone = noise(7.0, count[:, 17], like[..., 0])
    np.testing.assert_array_equal(alone, e[..., 17])
    several = noise(jnp.array([3.0, 7.0]), count[:, 17:18], like[..., :2])
    np.testing.assert_array_equal(several[..., 1], e[..., 17])
    assert np.all(np.asarray(several[..., 0]) != e[..., 17])


def test_converters_quantise_and_let_derivatives_pass():
    sensors = dataclasses.replace(Sensors.typical(delay=0), noise=np.zeros(3))
    z = jnp.array([[[0.123]], [[-4.567]], [[1.23e-3]]])
    given = np.asarray(sensors.converted(z, 0.0, jnp.zeros((1, 1)))).ravel()
    bias, step = ([getattr(KINDS[name], of) for name in sensors.names] for of in ("bias", "quantum"))
    np.testing.assert_allclose(given, np.round((np.ravel(z) + bias) / step) * np.array(step), rtol=1e-12)
    slope = jax.grad(lambda z: jnp.sum(sensors.converted(z, 0.0, jnp.zeros((1, 1)))))(z)
    np.testing.assert_array_equal(slope, 1.0)


def test_a_controller_is_a_damper_that_never_pushes(coach):
    """The package's own tester: pytree, lanes, derivatives, symmetry, dissipation at every instant."""
    check_damper(railjax.Controller(SKYHOOK, sensors=Sensors.ideal(), device=Device(slew=40.0)), coach, energy="instant")


@pytest.mark.parametrize(
    "device", [Device(), Device(kind="force"), Device(kind="force", damping_max=None, force_limit=3e3)], ids=str
)
def test_a_device_gives_what_it_can_and_never_pushes(device):
    """By hand, in NumPy, whatever is commanded."""
    rng = np.random.default_rng(0)
    command, v = rng.uniform(0.0, 1.0, 500) if device.kind == "valve" else rng.normal(size=500) * 8e3, rng.normal(size=500) * 0.2
    force = np.asarray(device.delivered(*map(jnp.asarray, (command, v))))
    assert np.all(force * v >= 0.0)
    if device.kind == "valve":
        expected = np.clip(2.0 * (device.damping_min + (5e4 - device.damping_min) * command) * v, -1e4, 1e4)
    else:
        most = np.inf if device.damping_max is None else 2.0 * device.damping_max * np.abs(v)
        least = 2.0 * device.damping_min * np.abs(v)
        expected = np.maximum(np.minimum(command * np.sign(v), most), least) * np.sign(v)
    np.testing.assert_allclose(force, expected, rtol=1e-12)
    # a demand that the device can give is what it gives
    wanted = 2.0 * 2e4 * v
    given = np.asarray(device.delivered(device.command(jnp.asarray(wanted), jnp.asarray(v)), jnp.asarray(v)))
    within = np.abs(wanted) < (3e3 if device.damping_max is None else 5e3) * 2.0
    np.testing.assert_allclose(given[within], wanted[within], rtol=1e-9)


@pytest.fixture(scope="module")
def sensed(coach):
    """Shares of what is usual of noise, bias, quanta, bandwidth, drift and sample time, one a lane; 1 s of a sinusoid in steps of 1/8 ms."""
    shares = np.array([1.0, 0.5, 0.25, 0.125])
    parts = [Sensors.typical(delay=0).scaled(share) for share in shares]
    sensors = jax.tree.map(lambda *leaves: np.stack(leaves, axis=-1), *parts)
    options = {
        "track": railjax.SinusoidTrack(5e-3, 20.0), "duration": 1.0, "dt": 1.25e-4, "sample": 1e-3, 
        "record": ("damper_force", "carbody_acceleration"),
    }  # fmt: skip
    controller = railjax.Controller(
        wraps=dataclasses.replace(SKYHOOK, law="smooth"),
        sensors=sensors,
        estimator=ComplementaryFilter(drift=0.1 * shares),
        sample_time=1e-3 * shares,
    )
    return shares, controller, railjax.simulate(coach, SPEED, damper=controller, **options), options


def test_sensed_skyhook_converges_to_the_ideal_law(coach, sensed):
    """Of first order in the share of everything that stands between the law and the motion."""
    _, controller, run, options = sensed
    ideal = np.asarray(railjax.simulate(coach, SPEED, damper=controller.wraps, **options)["damper_force"])
    off = np.asarray(run["damper_force"]) - ideal[..., None]
    errors = np.sqrt(np.mean(off**2, axis=(0, 1))) / ideal.std()
    orders = np.log2(errors[:-1] / errors[1:])
    assert np.all(np.diff(errors) < 0.0)
    assert 0.85 < orders[-1] < 1.3, (errors, orders)
    assert errors[-1] < 0.15


def test_accelerometer_is_the_acceleration_behind_a_low_pass(coach):
    """Against SciPy's filter of the acceleration and roll of the run."""
    controller = railjax.Controller(SKYHOOK)
    run = railjax.simulate(
        coach, SPEED, track=TRACK, damper=controller, duration=1.5, sample=1e-3, record=("carbody_acceleration",)
    )
    body = {(name, of): np.asarray(run[f"carbody_{name}{of}"])[:, None] for name in ("y", "psi", "phi") for of in OF}
    above = {of: body["y", of] + 1.24 * body["phi", of] + np.array([8.6, -8.6]) * body["psi", of] for of in OF}
    tau = 1.0 / (2.0 * np.pi * KINDS["carbody_acceleration"].bandwidth)
    felt = above["_acceleration"] + 9.81 * body["phi", ""]
    expected = scipy.signal.lfilter(*scipy.signal.bilinear([1.0], [tau, 1.0], 1e3), felt, axis=0)
    read = (above["_rate"] - internal(run, controller)["filtered"][:, 0]) / tau
    # the force's steps from sample to sample fall between the filter's samples
    assert np.std(read - expected) < 0.03 * expected.std()
    assert np.std(read - felt) > 0.06 * expected.std()


def test_delays_are_whole_samples_and_a_sample_is_taken_once(coach, monkeypatch):
    # commands what it hears of the last sensor
    monkeypatch.setattr(railjax.Controller, "decide", lambda self, vehicle, signals, memory, elapsed: (signals[-1], memory))
    controller = railjax.Controller(SKYHOOK, sensors=dataclasses.replace(Sensors.typical(), delays=(0, 1, 3)), faults=None)
    rng, n = np.random.default_rng(0), 17
    own, seen_readings = jnp.zeros((controller.internal_states, 2)), []
    held = jax.jit(controller.held)
    for _ in range(5):
        x = jnp.asarray(1e-2 * rng.normal(size=2 * n))
        seen = railjax.Seen(*(split(coach, part) for part in (x[:n], x[n:])))
        travel, velocity = jnp.asarray(rng.normal(size=(2, 2)))
        once = held(coach, travel, velocity, own, seen)
        np.testing.assert_array_equal(held(coach, travel, velocity, once, seen), once)
        seen_readings.append(np.asarray(controller.parts(once)["readings"])[:3])
        half = once.at[0].add(-0.5e-3)
        np.testing.assert_array_equal(held(coach, -travel, velocity, half, seen), half)
        own = once.at[0].add(-1e-3)
    line = np.asarray(controller.parts(own)["readings"]).reshape(3, 3, 2)
    for age in range(3):
        np.testing.assert_array_equal(line[age], seen_readings[-1 - age])
    np.testing.assert_array_equal(controller.parts(own)["command"][0], seen_readings[-1 - 3][2])
    assert float(own[1, 0]) == 5.0


@pytest.fixture(scope="module")
def kalman(coach):
    sensors = Sensors.typical()
    return sensors, KalmanFilter.design(coach, SPEED, sensors)


def test_kalman_filter_knows_the_car_body_in_a_nonlinear_run(coach, kalman):
    """All states of it from six sensors with noise, bias and delay, on a track whose course the filter does not know."""
    sensors, estimator = kalman
    lqr = railjax.ClippedLQR.design(coach, SPEED)
    controller = railjax.Controller(lqr, sensors=sensors, estimator=estimator)
    run = railjax.simulate(coach, SPEED, track=TRACK, damper=controller, duration=6.0, record=("carbody_y_rate",))
    memory = internal(run, controller)["memory"][:, : estimator.states - 1]
    known = memory.reshape(len(memory), -1)[200:, :34]
    truth = np.asarray(run.sampled.states)[200:, :34]
    off = np.sqrt(np.mean((known - truth) ** 2, axis=0)) / truth.std(axis=0)
    body = dict(zip(("y", "psi", "phi"), off[size(coach) : size(coach) + 3], strict=True))
    assert body["phi"] < 0.1, body
    assert max(body["y"], body["psi"]) < 0.4, body
    assert off[20:22].max() < 0.1  # the bogies' lateral rates
    # sizes that a learned law divides by are of the motion's order
    size_of = truth.std(axis=0) / np.asarray(estimator.usual)[:34, 0]
    assert 0.1 < size_of.min() < size_of.max() < 3.0, size_of


@pytest.fixture(scope="module")
def sampled_model(coach, kalman):
    """F, H, C, Q and R of the filter's model from sample to sample, by 64 small steps, and P of the error before a sample, in NumPy alone."""
    model = linear_model(coach, SPEED, kalman[0], 6e-7, 1e-3)
    one, h = np.eye(len(model.a)), 1e-3 / 64
    half, small = (one + m @ (one + m / 2 @ (one + m / 3 @ (one + m / 4))) for m in (model.a * h / 2, model.a * h))
    transition, driven, spread = one, np.zeros_like(model.b), np.zeros_like(one)
    for _ in range(64):  # midpoint rule
        transition, driven = small @ transition, small @ driven + h * half @ model.b
        spread = small @ spread @ small.T + h * (half * model.noise) @ half.T
    read, measured = model.read, np.diag(model.measured)
    # 2^30 steps of the filter's Riccati recursion from nothing, by doubling
    a, g, p = transition.T, read.T @ np.linalg.solve(measured, read), spread
    for _ in range(30):
        apart = np.linalg.inv(one + g @ p)
        a, g, p = a @ apart @ a, g + a @ apart @ g @ a.T, p + a.T @ p @ apart @ a
    return transition, driven, read, spread, measured, p


def test_kalman_gain_is_that_of_a_riccati_recursion(kalman, sampled_model):
    """Whose last step, as it stands in every textbook, changes nothing more; SciPy plays no part."""
    transition, driven, read, spread, measured, p = sampled_model
    gain = p @ read.T @ np.linalg.inv(read @ p @ read.T + measured)
    after = transition @ (p - gain @ read @ p) @ transition.T + spread
    size_of = np.sqrt(np.diag(p))
    assert np.abs((after - p) / np.outer(size_of, size_of)).max() < 1e-6
    scale = size_of[:, None] / np.sqrt(np.diag(measured))
    assert np.abs((kalman[1].gain - gain) / scale).max() < 1e-5 * np.abs(gain / scale).max()
    keep = np.eye(len(p)) - gain @ read
    for found, expected in ((kalman[1].transition, keep @ transition), (kalman[1].drive, keep @ driven)):
        weighed = np.abs(expected / size_of[:, None] * (size_of if expected.shape[1] == len(p) else 1.0))
        off = np.abs((found - expected) / size_of[:, None] * (size_of if expected.shape[1] == len(p) else 1.0))
        assert off.max() < 1e-5 * weighed.max()


def test_innovation_of_the_kalman_filter_is_white_and_of_its_covariance(kalman, sampled_model):
    """Over 200 rides of 0.5 s of the linear model with its own noise; a steady filter that lost anything would have both wrong."""
    transition, driven, read, spread, measured, p = sampled_model
    estimator, rng, rides = kalman[1], np.random.default_rng(0), 200
    foreseen = read @ p @ read.T + measured
    after = p - p @ read.T @ np.linalg.solve(foreseen, read @ p)

    def root(covariance):
        values, vectors = np.linalg.eigh(covariance)
        return vectors * np.sqrt(np.maximum(values, 0.0))

    moved, read_off = root(spread), root(measured)
    x, known, surprises = root(after) @ rng.normal(size=(len(p), rides)), np.zeros((len(p), rides)), []
    for _ in range(500):
        force = 2e3 * rng.normal(size=(2, rides))
        x = transition @ x + driven @ force + moved @ rng.normal(size=x.shape)
        y = read @ x + read_off @ rng.normal(size=(len(read), rides))
        surprises.append(np.linalg.solve(np.linalg.cholesky(foreseen), y - read @ (transition @ known + driven @ force)))
        known = estimator.transition @ known + estimator.drive @ force + estimator.gain @ y
    surprises = np.array(surprises)
    for lag in (0, 1, 2, 10):
        shared = np.einsum("tar,tbr->ab", surprises[lag:], surprises[: len(surprises) - lag]) / surprises[lag:, 0].size
        # 1e5 samples: 0.003, and 0.0045 of variances
        assert np.abs(shared - (np.eye(len(read)) if lag == 0 else 0.0)).max() < 0.02, lag


def test_every_fault_ends_in_a_stable_ride(coach):
    """All single faults as lanes, at 1 s of 6; the damper takes energy out throughout, and the ride stays a ride."""
    controller = railjax.Controller(SKYHOOK, device=Device())
    faults = every_fault(controller.sensors.names, 2, 1.0)
    assert len(faults) == 1 + 1 + 2 * (1 + 1 + 3)
    run = railjax.simulate(
        coach, SPEED, track=TRACK, damper=dataclasses.replace(controller, faults=together(faults)), duration=6.0,
        record=("damper_force", "secondary_velocity", "carbody_acceleration"), reduce=("peak:secondary_travel",),
    )  # fmt: skip
    assert np.all(np.asarray(run.ok))
    assert np.min(np.asarray(run["damper_force"]) * np.asarray(run["secondary_velocity"])) >= 0.0
    rms = dict(zip(faults, np.std(np.asarray(run["carbody_acceleration"])[200:], axis=0), strict=True))
    assert max(rms.values()) < 3.0 * rms["none"], rms
    assert np.max(np.asarray(run["peak:secondary_travel"])) < 0.05
    force = np.asarray(run["damper_force"])
    lost, dead, sound = (list(faults).index(name) for name in ("current lost", "one damper dead, leading", "none"))
    # before the fault nothing differs; without current the valve is open
    np.testing.assert_array_equal(force[:95, :, lost], force[:95, :, sound])
    velocity = np.asarray(run["secondary_velocity"])
    open_valve = 2.0 * controller.device.damping_min * velocity[150:, :, lost]
    np.testing.assert_allclose(force[150:, :, lost], open_valve, rtol=1e-9, atol=1e-6)
    assert np.std(force[150:, 0, dead]) < 0.7 * np.std(force[150:, 1, dead])


def test_what_does_not_belong_sharedis_refused(coach):
    for controller, about in (
        (railjax.Controller(), "wraps"),
        (railjax.Controller(railjax.BoucWenDamper()), "BoucWenDamper"),
        (railjax.Controller(railjax.Skyhook(), sensors=Sensors.typical("travel")), "carbody_acceleration"),
        (railjax.Controller(railjax.ClippedLQR(feedback=np.zeros((2, 34)))), "KalmanFilter"),
        (railjax.Controller(SKYHOOK, device=Device(damping_min=6e4)), "damping_max"),
        (railjax.Controller(SKYHOOK, sample_time=-1.0), "sample_time"),
        (railjax.Controller(SKYHOOK, sensors=dataclasses.replace(Sensors.ideal(), bandwidth=np.zeros(3))), "bandwidth"),
    ):
        with pytest.raises(railjax.InputError, match=about):
            railjax.simulate(coach, SPEED, damper=controller, duration=0.1)
    with pytest.raises(railjax.InputError, match="carbody_acceleration"):
        Sensors.typical("carbody_aceleration")
