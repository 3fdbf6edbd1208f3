"""Robust tuning, gain over speed, Pareto fronts and `railjax tune`."""

import dataclasses
import json

import jax.numpy as jnp
import numpy as np
import pytest

import railjax
from railjax import objectives as aim
from railjax.reports.paper.studies import tuning as paper_tuning
from railjax.reports.paper.study import Context
from railjax.tuning.derivatives import differentiated
from railjax.tuning.design_space import DesignSpace
from railjax.tuning.gain_schedule import bernstein
from railjax.tuning.pareto import Front, dominated

BOUNDS = {"primary.stiffness_x": (1e6, 20e6), "secondary.damping_y": (5e3, 100e3)}
PASSIVE = railjax.PassiveDamper()


@pytest.fixture(scope="module")
def scatter():
    return railjax.Scatter({"contact.conicity": (0.05, 0.4)}, {"carbody.mass": (0.9, 1.2)}, samples=6)


def test_expected_and_worst_are_those_of_the_samples(coach, scatter):
    paths, factors, samples = scatter.drawn()
    assert paths == ("contact.conicity", "carbody.mass")
    assert factors == (False, True)
    assert samples.shape == (2, 6)
    assert np.all((samples[0] > 0.05) & (samples[0] < 0.4) & (samples[1] > 0.9) & (samples[1] < 1.2))
    each = [
        float(
            railjax.linear_critical_speed(
                railjax.replace(coach, contact__conicity=conicity, carbody__mass=mass * coach.carbody.mass)
            )
        )
        for conicity, mass in samples.T
    ]
    mean, least = (how(aim.linear_critical_speed(), scatter) for how in (railjax.expected, railjax.worst))
    assert float(mean.value(coach, PASSIVE)) == pytest.approx(np.mean(each), rel=1e-9)
    assert least.sharp(coach, PASSIVE) == pytest.approx(min(each), rel=1e-9)
    assert 0.98 * min(each) < float(least.value(coach, PASSIVE)) <= min(each)
    assert least.greatest
    space = DesignSpace.of(coach, PASSIVE, BOUNDS)
    x = space.position(space.own)
    (value, high, low), slopes = differentiated(least, space, x + 1e-5 * np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0]]))
    slope = slopes[0]
    assert slope[0] == pytest.approx((high - low) / 2e-5, rel=1e-4)
    # the least critical speed of all wheels' wear rises
    found = railjax.tune(coach, BOUNDS, least, optimiser="slsqp")
    assert found.objective > 1.2 * value


def test_runs_are_scattered_as_lanes_of_one_batch(coach, scatter):
    comfort = aim.comfort([40.0, 45.0], railjax.SinusoidTrack(2e-3, 20.0), weighting=None, duration=3.0, settle=2.0)
    few = railjax.Scatter({"contact.conicity": (0.05, 0.15)}, samples=2)
    value = float(railjax.expected(comfort, few).value(coach, railjax.BalanceLogic(0.5)))
    each = [
        float(comfort.value(railjax.replace(coach, contact__conicity=float(c)), railjax.BalanceLogic(0.5)))
        for c in few.drawn()[2][0]
    ]
    assert value == pytest.approx(np.mean(each), rel=1e-9)


def test_bad_scatter_is_refused():
    for bad in (railjax.Scatter(), railjax.Scatter({"a.b": (2.0, 1.0)}), railjax.Scatter({"a.b": (1.0, 2.0)}, samples=1)):
        with pytest.raises(railjax.InputError, match="scatter"):
            railjax.expected(aim.linear_critical_speed(), bad)


def test_bernstein_is_a_partition_of_unity():
    basis = bernstein(np.linspace(30.0, 60.0, 7), np.array([30.0, 60.0]), 4)
    np.testing.assert_allclose(basis.sum(axis=1), 1.0)
    np.testing.assert_allclose(basis[[0, -1]], [[1, 0, 0, 0], [0, 0, 0, 1]], atol=1e-15)


def test_gain_over_speed(coach, literal, monkeypatch):
    """The study of the report, in a small size, whose schedule is judged by a grid."""
    speeds, track = np.array([150.0, 220.0, 270.0]) / 3.6, railjax.SinusoidTrack(5e-3, 20.0)
    real, schedules = paper_tuning.schedule_gain, []

    def kept(*arguments, **named):
        schedules.append(real(*arguments, **named | {"degree": 1}))
        return schedules[-1]

    monkeypatch.setattr(paper_tuning, "schedule_gain", kept)
    monkeypatch.setattr(paper_tuning, "SPEEDS", speeds * 3.6)
    monkeypatch.setattr(paper_tuning, "DURATION", 6.0)
    monkeypatch.setattr(paper_tuning, "SETTLE", 4.0)
    outcome = paper_tuning.gain_over_speed(Context(coach, literal))
    (found,) = schedules
    grid = np.linspace(0.0, 1.5, 101)
    gains, lanes = (jnp.asarray(values.ravel()) for values in np.meshgrid(grid, speeds[:2], indexing="ij"))
    run = railjax.simulate(
        railjax.replace(coach, contact__law="smooth"), lanes, track=track, damper=railjax.BalanceLogic(gains, law="smooth"),
        duration=6.0, settle=4.0, sample=0.1, record=(), reduce=["rms:carbody_acceleration"],
    )  # fmt: skip
    rms = np.asarray(run["rms:carbody_acceleration"]).reshape(101, 2)
    np.testing.assert_allclose(found.best[:2], grid[rms.argmin(axis=0)], atol=0.015 + 1e-9)
    assert np.all(found.rms_best[:2] <= rms.min(axis=0) * (1 + 1e-5))
    # it hunts at 270 km/h, which is left out
    assert np.isnan(found.rms_best[2])
    assert "left out: 270" in str(found)
    # two coefficients for two speeds meet both; one gain lies between
    np.testing.assert_allclose(found.rms_scheduled[:2], found.rms_best[:2], rtol=1e-4)
    assert found.best[:2].min() - 1e-3 <= found.constant <= found.best[:2].max() + 1e-3
    assert np.all(found.rms_scheduled[:2] < 0.5 * found.rms_passive[:2])
    assert found.at(speeds[0]) == pytest.approx(found.scheduled[0])
    assert outcome.quantities[0].computed == found.constant
    assert "270 km/h" in outcome.pictures[0].caption


def front(objective, against):
    """One by its points."""
    nothing = {"parameters": {}, "met": np.ones(len(objective), bool), "own": (1.0, 50.0), "evaluations": 1, "seconds": 0.0}
    return Front(
        aim.comfort(50.0),
        aim.linear_critical_speed(),
        np.array(objective),
        np.array(against),
        vehicle_name="",
        notes=(),
        **nothing,
    )


def test_fronts_are_compared_where_both_are():
    passive = front([1.0, 1.1, 1.5], [60.0, 70.0, 80.0])
    assert paper_tuning.gains_over(front([0.5, 1.0], [50.0, 75.0]), passive) == pytest.approx([0.3, 0.2 / 1.1])
    assert paper_tuning.gains_over(front([0.5, 1.5], [50.0, 70.0]), passive) == pytest.approx([0.0, -0.4 / 1.1])


def test_dominated_points():
    objective, against = np.array([1.0, 2.0, 3.0, 3.0]), np.array([5.0, 4.0, 6.0, 6.0])
    assert list(dominated(objective, against, most=False, most_against=True)) == [False, True, False, False]
    assert list(dominated(-objective, -against, most=True, most_against=False)) == [False, True, False, False]


def test_the_trade_off_of_the_report(coach, literal, monkeypatch):
    """The study with the linear critical speed in place of the nonlinear one, whose fronts take a minute (benchmarks)."""
    real, fronts = paper_tuning.trade_off, {}

    def small(vehicle, points):
        fronts.update(real(vehicle, 2, aim.linear_critical_speed(harmonic_hz=5.0)))
        return fronts

    monkeypatch.setattr(paper_tuning, "trade_off", small)
    outcome = paper_tuning.stiffness_and_comfort(Context(coach, literal))
    assert len(outcome.statements) == 2
    assert "m/s²" in outcome.pictures[0].figure.axes[0].get_ylabel()
    passive, controlled = fronts["passive"], fronts["balance logic"]
    for front in fronts.values():
        assert np.all(front.met)
        assert np.all(np.diff(front.against) > 0.0)
        assert np.all(np.diff(front.objective) > 0.0)
    assert passive.own[1] == pytest.approx(float(railjax.linear_critical_speed(coach)), rel=0.02)  # 1 kN s/m of yaw damping
    assert controlled.objective[0] < 0.7 * passive.objective[0]
    assert str(round(float(passive.against[-1]) * 3.6)) in outcome.statements[0].numbers
    # what a front says of its fastest design is so
    fastest = coach
    for path, values in passive.parameters.items():
        if path != "yaw_damper.damping":
            fastest = railjax.set_parameter(fastest, path, float(values[-1]))
    yaw = railjax.YawDamper(float(passive.parameters["yaw_damper.damping"][-1]), half_distance=1.35)
    speed = railjax.linear_critical_speed(dataclasses.replace(fastest, yaw_damper=yaw))
    assert float(speed) == pytest.approx(passive.against[-1], rel=1e-4)


def test_describing_function_of_balance_logic(coach):
    """A harmonic motion of the secondary suspension, the force of the sharp law, and its first harmonic by quadrature."""
    damper, omega, X = railjax.BalanceLogic(0.7, damping_min=3e3), 2 * np.pi * 6.0, 4e-3
    law = aim.describing(damper, coach, 6.0)
    theta = (np.arange(4000) + 0.5) * 2 * np.pi / 4000
    y, v = X * np.sin(theta), X * omega * np.cos(theta)
    elastic = 2 * coach.secondary.stiffness_y * y
    force = np.where(elastic * v < 0, 0.7 * np.abs(elastic) * np.sign(v), 2 * 3e3 * v)  # eqs. (10)-(11)
    assert law.stiffness == pytest.approx(2 * np.mean(force * np.sin(theta)) / X, rel=1e-5)
    assert law.damping == pytest.approx(2 * np.mean(force * np.cos(theta)) / (X * omega), rel=1e-5)
    with pytest.raises(railjax.InputError, match="harmonic_hz"):
        aim.describing(railjax.Skyhook(), coach, 6.0)


def test_pareto_front(coach):
    front = railjax.pareto(coach, BOUNDS, aim.comfort(50.0), aim.linear_critical_speed(), points=3)
    assert np.all(front.met)
    assert np.all(np.diff(front.against) > 0.0)
    assert np.all(np.diff(front.objective) > -1e-6)
    # no point of a grid dominates it
    space = DesignSpace.of(coach, PASSIVE, BOUNDS)
    grid = np.stack(np.meshgrid(*[np.linspace(0, 1, 5)] * 2), axis=-1).reshape(-1, 2)
    comfort = differentiated(aim.comfort(50.0).suited(PASSIVE), space, grid)[0]
    speed = differentiated(aim.linear_critical_speed(), space, grid)[0]
    for objective, against in zip(front.objective, front.against, strict=True):
        assert not np.any((comfort < objective * (1 - 1e-3)) & (speed > against * (1 + 1e-3)))
    assert "Pareto front" in str(front)
    assert front.to_xarray().sizes["point"] == 3


COMMAND = ("tune", "coach", "--parameter", "secondary.damping_y_kNs_per_m=5:100")


def test_command_line(run, tmp_path, coach):
    code, out, error = run(
        *COMMAND, "--parameter", "primary.stiffness_x_MN_per_m=1:20", "--objective", "comfort", "--speed-kmh", 180,
        "--track", "erri-high", "--constraint", "critical-speed>=260", "--out", tmp_path / "h.png", "--json",
    )  # fmt: skip
    assert (code, error) == (0, "")
    content = json.loads(out)
    assert {"parameters", "objective", "evaluations", "seconds", "constraints"} <= set(content)
    tuned = railjax.replace(coach, **{name.replace(".", "__"): value for name, value in content["parameters"].items()})
    assert float(railjax.linear_critical_speed(tuned)) * 3.6 >= 260 * (1 - 1e-4)
    assert content["constraints"][0]["met"]
    assert content["objective"] < content["objective_before"]
    assert 5e3 <= content["parameters"]["secondary.damping_y"] <= 100e3
    assert (tmp_path / "h.png").stat().st_size > 5000


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("tune", "coach", "--parameter", "secondary.damping_y=5:100"), "did you mean secondary.damping_y_"),
        (("tune", "coach", "--parameter", "secondary.damping_y_kNs_per_m"), "low:high"),
        (("tune", "coach", "--parameter", "secondary.damping_y_kNs_per_m=5:x"), "low:high"),
        (("tune", "coach", "--parameter", "damper.alpha=0:1"), "has no 'alpha'"),
        ((*COMMAND, "--constraint", "critical-speed=260"), "critical-speed>=260"),
        ((*COMMAND, "--constraint", "critical-sped>=260"), "critical-speed"),
        ((*COMMAND, "--constraint", "critical-speed>=fast"), "not a number"),
        ((*COMMAND, "--objective", "comfrt"), "comfort"),
        ((*COMMAND, "--speed-kmh", "-3"), "--speed-kmh"),
        ((*COMMAND, "--track", "erri-hi"), "erri-high"),
        ((*COMMAND, "--optimiser", "newton"), "optimiser"),
        ((*COMMAND, "--out", "history.txt"), ".png"),
    ],
)
def test_command_line_refuses(run, arguments, message):
    code, out, error = run(*arguments)
    assert (code, out) == (2, "")
    assert len(error.splitlines()) == 1
    assert message in error
