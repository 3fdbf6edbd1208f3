"""Limit cycles and their branch against simulations, closed forms, finite differences and published results."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import railjax
from railjax import plots
from railjax.base.units import KMH
from railjax.cli.application import status
from railjax.stability.hunting import orbits, shooting
from railjax.stability.hunting.floquet import multipliers_of
from railjax.stability.hunting.fold_search import FoldSearch
from railjax.stability.hunting.limit_cycles import Branch
from railjax.stability.hunting.orbits import Model, Orbit, Shooting
from railjax.stability.hunting.settling import End


@pytest.fixture(scope="module")
def branch(coach: railjax.Vehicle) -> Branch:
    return railjax.hunting_branch(coach, highest_speed=300 / KMH)


@pytest.fixture(scope="module")
def bogie() -> railjax.Vehicle:
    return railjax.load_vehicle("cooperrider-bogie")


@pytest.fixture(scope="module")
def bogie_branch(bogie: railjax.Vehicle) -> Branch:
    return railjax.hunting_branch(bogie)


def test_branch_of_the_coach_meets_the_reported_points(branch):
    assert abs(float(branch.hopf.speed) * KMH - 245.6) < 0.1
    assert branch.criticality == "subcritical"
    assert branch.slope_at_hopf < 0
    assert abs(branch.fold.speed * KMH - 234.2) < 0.1
    assert abs(branch.fold.amplitude * 1e3 - 9.0) < 0.05
    assert branch.speed.max() * KMH >= 300.0
    assert branch.lyapunov is None  # the published law is not smooth at zero creep


def test_branch_is_unstable_below_the_fold_and_stable_above(branch):
    below, above = branch.pieces
    assert not any(point.stable for point in below[1:])
    assert all(point.stable for point in above if point.speed > 1.002 * branch.fold.speed)
    # without a gap: no step is longer than 1 mm or 10 m/s times the largest step
    for piece in branch.pieces:
        steps = np.hypot(np.diff([p.amplitude for p in piece]) * 1e3, np.diff([p.speed for p in piece]) / 10)
        assert steps[1:].max() < 0.4
    # the pieces meet at the fold, as far as the two bogies are alike
    assert abs(below[-1].speed - branch.fold.speed) * KMH < 0.1


def test_multipliers_are_credible(branch):
    assert max(point.floquet.error for point in branch.points if point.amplitude < 8.7e-3) < 1e-7
    # flange corners within steps of fixed length: the error bar that is printed beside the multipliers
    assert max(point.floquet.error for point in branch.points) < 0.03
    assert max(point.residual for point in branch.points) < 1e-7


def turning_points(run, index: int) -> tuple[float, float]:
    """Amplitude (m) and frequency (Hz) of the last part of a run, by parabolas through the extremes and by zero crossings."""
    y, time = np.asarray(run["wheelset_y"])[:, index], np.asarray(run.time)
    k = np.flatnonzero((np.abs(y[1:-1]) >= np.abs(y[:-2])) & (np.abs(y[1:-1]) > np.abs(y[2:]))) + 1
    a, b, c = np.abs(y[k - 1]), np.abs(y[k]), np.abs(y[k + 1])
    peaks = b - (c - a) ** 2 / (8.0 * (a - 2.0 * b + c))
    up = np.flatnonzero((y[:-1] < 0) & (y[1:] >= 0))
    crossings = time[up] - y[up] * (time[up + 1] - time[up]) / (y[up + 1] - y[up])
    return float(peaks.max()), float((len(crossings) - 1) / (crossings[-1] - crossings[0]))


@pytest.mark.parametrize("kmh", [236.0, 245.0, 255.0, 270.0, 290.0])
def test_stable_limit_cycles_agree_with_long_simulations(coach, branch, kmh):
    cycle = branch.at(kmh / KMH)
    assert cycle.stable
    assert abs(cycle.speed - kmh / KMH) < 1e-9
    # from the orbit pushed off it by a twentieth, so that the simulation must find its own way back
    run = railjax.simulate(
        coach, kmh / KMH, duration=40.0, dt=5e-4, initial=1.05 * cycle.state, record=["wheelset_y"], sample=1e-3
    )
    amplitude, frequency = turning_points(_tail(run, 4.0), branch.wheelset)
    assert amplitude == pytest.approx(cycle.amplitude, rel=1e-3)
    assert frequency == pytest.approx(cycle.frequency, rel=1e-4)


def _tail(run: railjax.Simulation, seconds: float) -> dict:
    shown = np.asarray(run.time) >= float(run.time[-1]) - seconds

    class Tail(dict):
        time = np.asarray(run.time)[shown]

    return Tail(wheelset_y=np.asarray(run["wheelset_y"])[shown])


@pytest.mark.parametrize("kmh", [236.0, 240.0, 244.0])
def test_unstable_limit_cycles_divide_rest_from_hunting(coach, branch, kmh):
    """All wheelsets' motion scaled a little below the unstable orbit dies out, a little above it grows."""
    cycle = branch.at(kmh / KMH, stable=False)
    scales = jnp.array([0.995, 1.005])
    run = railjax.simulate(
        coach,
        kmh / KMH,
        duration=60.0,
        dt=5e-4,
        initial=jnp.asarray(cycle.state)[:, None] * scales,
        record=(),
        reduce=["peak:wheelset_y"],
        settle=55.0,
    )
    rest, hunts = np.asarray(run["peak:wheelset_y"]).max(axis=0)
    assert rest < 0.2 * cycle.amplitude
    assert hunts > 8e-3


def test_cooperrider_bogie_settles_on_the_computed_cycle_or_at_rest(bogie, bogie_branch):
    """Kaas-Petersen's bogie: hunts at 70 m/s from y1 = 0.1 m, comes to rest at 60 m/s (bifurcation.de, exd10)."""
    assert abs(float(bogie_branch.hopf.speed) - 68.66) < 0.05
    assert bogie_branch.criticality == "subcritical"
    start = {"wheelset_y": jnp.array([0.1, 0.0])}
    at_70 = railjax.simulate(bogie, 70.0, duration=60.0, dt=5e-4, initial=start, record=["wheelset_y"], sample=1e-3)
    amplitude, frequency = turning_points(_tail(at_70, 5.0), 0)
    cycle = bogie_branch.at(70.0)
    assert amplitude == pytest.approx(cycle.amplitude, rel=1e-3)
    assert frequency == pytest.approx(cycle.frequency, rel=1e-4)
    at_60 = railjax.simulate(bogie, 60.0, duration=60.0, initial=start, record=["wheelset_y"], sample=0.01)
    assert np.abs(np.asarray(at_60["wheelset_y"])[-100:]).max() < 1e-6


def test_a_single_bogie_has_one_connected_branch(bogie_branch):
    assert len(bogie_branch.folds) == 1
    assert not bogie_branch.note
    assert bogie_branch.amplitude[1] < 0.03 * 9.1e-3  # down to the Hopf point


def test_amplitude_grows_in_proportion_to_the_speed_difference_at_the_hopf_point(bogie_branch):
    """Vermeulen and Johnson's factor 1 - u/3 is not smooth at zero: v - v_H is linear in A, not quadratic."""
    small = [point for point in bogie_branch.pieces[0][1:] if point.amplitude < 0.8e-3]
    slopes = [(point.speed - float(bogie_branch.hopf.speed)) / point.amplitude for point in small]
    np.testing.assert_allclose(slopes, bogie_branch.slope_at_hopf, rtol=0.1)


def test_half_and_whole_period_agree(bogie, bogie_branch):
    cycle = bogie_branch.at(70.0)
    model = orbits.model_of(bogie, railjax.PassiveDamper())
    whole = Shooting(2 * bogie_branch.shooting.steps, 0, symmetric=False)
    guess = orbits.pack(model, whole, Orbit(cycle.state, 1.0 / cycle.frequency, 70.0))
    point = shooting.solved(model, whole, shooting.at_speed(model, whole, guess, 70.0))
    assert point.usable
    assert point.amplitude == pytest.approx(cycle.amplitude, rel=1e-7)
    squares = multipliers_of(whole, point.monodromy).multipliers
    np.testing.assert_allclose(np.abs(squares[1:6]), np.abs(cycle.floquet.multipliers[1:6]), atol=2e-3)


def test_monodromy_against_finite_differences(bogie, bogie_branch):
    """Columns of the half period's derivative, by differences of the flow from the orbit of the unstable branch."""
    cycle = bogie_branch.at(66.9, stable=False)
    model = orbits.model_of(bogie, railjax.PassiveDamper())
    scale = model.scales

    @jax.jit
    def arrive(scaled):
        orbit = Orbit(scaled * scale, jnp.asarray(1.0 / cycle.frequency), jnp.asarray(cycle.speed))
        return orbits.section(model, bogie_branch.shooting, orbit)

    start, step = cycle.state / scale, 1e-6
    numeric = np.array([(arrive(start + step * e) - arrive(start - step * e)) / (2 * step) for e in np.eye(len(start))]).T
    half = multipliers_of(bogie_branch.shooting, numeric)
    np.testing.assert_allclose(half.multipliers[:4], cycle.floquet.multipliers[:4], atol=1e-5)


def test_lyapunov_coefficient_predicts_the_smooth_branch(bogie):
    """v - v_H = -l_1 |z|² / Re(dlambda/dv) with amplitude 2 |z| |q|, from the branch itself at small amplitude."""
    # a narrow corner of the flange, which else gives a little stiffness at rest already
    smooth = railjax.replace(bogie, contact__law="smooth", contact__creep_width=0.3, contact__flange_width=1e-6)
    branch = railjax.hunting_branch(smooth, highest_speed=72.0)
    assert branch.lyapunov > 0
    assert branch.criticality == "subcritical"
    modes = railjax.modes(smooth, float(branch.hopf.speed))
    shape = np.abs(modes.shapes[:, np.argmin(np.abs(modes.eigenvalues.real))])
    wheelset = shape[modes.coordinates.index("wheelset_y[0]")] / shape.max()
    point = branch.pieces[0][1]
    assert point.amplitude < 0.6e-3
    z = point.amplitude / (2.0 * wheelset)
    predicted = -branch.lyapunov * z**2 / float(branch.hopf.growth_per_speed)
    assert point.speed - float(branch.hopf.speed) == pytest.approx(predicted, rel=0.01)


def test_lyapunov_coefficient_where_the_law_has_a_side(bogie, monkeypatch):
    """Quadratic terms, which vanish in a vehicle alike to both sides but not with every damper: in the plane, where l_1 is known.

    x' = -w y + f, y' = w x + g has r' = a r^3 with 16 a as below (Guckenheimer and Holmes, eq. 3.4.11); r = 2 |z|, so l_1 = 4 a.
    """
    from railjax.stability.hunting import normal_form

    w, (fxx, fxy, fyy, gxx, gxy, gyy) = 3.0, (0.7, -1.1, 0.4, 0.9, 0.6, -1.3)
    fxxx, fxyy, gxxy, gyyy = 0.5, -0.2, 0.8, 0.3

    def rate(vehicle, damper, speed, state):
        x, y = state
        f = fxx * x**2 / 2 + fxy * x * y + fyy * y**2 / 2 + fxxx * x**3 / 6 + fxyy * x * y**2 / 2
        g = gxx * x**2 / 2 + gxy * x * y + gyy * y**2 / 2 + gxxy * x**2 * y / 2 + gyyy * y**3 / 6
        return jnp.stack([-w * y + f, w * x + g])

    monkeypatch.setattr(normal_form, "_rate", rate)
    monkeypatch.setattr(normal_form, "state_matrix", lambda *_: np.array([[0.0, -w], [w, 0.0]]))
    smooth = railjax.replace(bogie, contact__law="smooth")
    found = railjax.first_lyapunov_coefficient(
        smooth, hopf=railjax.stability.linear_critical.LinearCritical(1.0, w / (2 * np.pi), 1.0, 0)
    )
    quadratic = fxy * (fxx + fyy) - gxy * (gxx + gyy) - fxx * gxx + fyy * gyy
    assert found == pytest.approx((fxxx + fxyy + gxxy + gyyy + quadratic / w) / 4, rel=1e-12)


def test_lyapunov_coefficient_is_refused_for_the_published_law(bogie):
    with pytest.raises(railjax.InputError, match="smooth"):
        railjax.first_lyapunov_coefficient(bogie)


def test_ramp_shows_the_same_hysteresis(coach, branch):
    ramp = railjax.speed_ramp(coach, 230 / KMH, 252 / KMH, rate=0.04)
    assert branch.fold.speed * KMH - 1.5 < ramp.stops * KMH < branch.fold.speed * KMH
    assert 0.0 < ramp.starts * KMH - float(branch.hopf.speed) * KMH < 6.0
    on = ramp.down_speed > 1.005 * branch.fold.speed
    stable = sorted((p.speed, p.amplitude) for p in branch.points if p.stable and p.amplitude > 0)
    np.testing.assert_allclose(ramp.down_amplitude[on], np.interp(ramp.down_speed[on], *np.array(stable).T), rtol=5e-3)


def test_orbits_with_a_damper_in_the_loop(bogie):
    """Any damper law takes part: twice rho_cy through the damper is twice rho_cy in the vehicle."""
    own = float(bogie.secondary.damping_y)
    twice = railjax.replace(bogie, secondary__damping_y=2.0 * own)
    damper = railjax.PassiveDamper(2.0 * own)
    at = [railjax.nonlinear_critical(twice).speed, railjax.nonlinear_critical(bogie, damper=damper).speed]
    assert float(at[0]) == pytest.approx(float(at[1]), rel=1e-9)


def test_limit_cycles_under_balance_logic(bogie):
    """Its smooth twin in the loop: a branch that leaves the Hopf point upwards and turns twice, and the simulation on it."""
    damper = railjax.BalanceLogic(0.5, damping_min=25e3, law="smooth")
    branch = railjax.hunting_branch(bogie, damper=damper)
    assert branch.criticality == "supercritical"
    assert len(branch.folds) == 2
    assert len(branch.pieces) == 1
    assert branch.folds[0].speed > float(branch.hopf.speed) > branch.fold.speed
    cycle = branch.at(1.03 * float(branch.hopf.speed))
    start = {"wheelset_y": 9e-3}
    run = railjax.simulate(
        bogie, cycle.speed, damper=damper, duration=40.0, dt=5e-4, initial=start, record=["wheelset_y"], sample=1e-3
    )
    assert turning_points(_tail(run, 4.0), 0)[0] == pytest.approx(cycle.amplitude, rel=1e-3)


def test_states_without_a_side_are_not_mirrored(bogie):
    class WithCommand(railjax.PassiveDamper):
        internal_states = 2
        even_states = (1,)

    signs = Model(bogie, WithCommand()).mirror
    assert list(signs[14:]) == [-1.0, 1.0]


def test_bad_requests_are_one_line(coach, branch):
    with pytest.raises(railjax.InputError, match="no stable limit cycle at 100"):
        branch.at(100 / KMH)
    with pytest.raises(railjax.InputError, match="highest_speed"):
        railjax.hunting_branch(coach, highest_speed=10.0)
    with pytest.raises(railjax.InputError, match="wheelset"):
        railjax.hunting_branch(coach, wheelset=4)
    with pytest.raises(railjax.InputError, match="low must be below high"):
        railjax.speed_ramp(coach, 70.0, 60.0)
    linear = railjax.replace(coach, primary__stiffness_x=0.0, primary__stiffness_y=0.0)
    with pytest.raises(railjax.NumericalError, match=r"no linear critical speed|no limit cycle"):
        railjax.hunting_branch(linear)


def test_diagram_and_dataset(branch, tmp_path):
    from railjax.base.style import figure

    data = branch.to_xarray()
    assert data.sizes["point"] == len(branch.points)
    assert data["amplitude"].attrs["units"] == "m"
    with figure() as (page, axes):
        branch.plot(axes[0, 0])
        page.savefig(tmp_path / "diagram.png")
    dashed = [line for line in axes[0, 0].lines if line.get_linestyle() == "--"]
    assert dashed
    assert axes[0, 0].get_xlabel() == "speed, km/h"
    assert "subcritical" in str(branch)
    assert "234." in str(branch)


def test_command_line(capsys, tmp_path):
    import json

    assert status(["hunting", "cooperrider-bogie", "--json", "--out", str(tmp_path / "points.csv")]) == 0
    content = json.loads(capsys.readouterr().out)
    assert content["hopf_kmh"] == pytest.approx(68.66 * KMH, abs=0.2)
    assert content["criticality"] == "subcritical"
    assert content["fold_kmh"] < content["hopf_kmh"]
    assert set(content["branch"][0]) >= {"speed_kmh", "amplitude_mm", "frequency_hz", "stable", "largest_multiplier"}
    assert len((tmp_path / "points.csv").read_text().splitlines()) == len(content["branch"]) + 1
    assert status(["hunting", "coach", "--wheelset", "9"]) == 2
    assert status(["hunting", "coach", "--out", "diagram.doc"]) == 2
    assert "railjax: --out" in capsys.readouterr().err


def with_yaw_dampers(*values):
    return dataclasses.replace(railjax.load_vehicle("coach"), yaw_damper=railjax.YawDamper(*values))


@functools.cache
def blown_off():
    """A coach that no speed makes unstable, whose yaw dampers blow off in large motions (the audit's case of hunting without a Hopf point)."""
    coach = with_yaw_dampers(1.04e6, 1.3, 3.8e-3, 7.7e3, 1.9e7)
    changes = {
        "contact__conicity": 0.23,
        "contact__friction": 0.35,
        "contact__flange_clearance": 6.1e-3,
        "contact__flange_stiffness": 10.7e6,
        "primary__stiffness_x": 15.3e6,
        "secondary__damping_y": 29.4e3,
    }
    return railjax.replace(coach, **changes)


@functools.cache
def isola():
    return railjax.hunting_branch(blown_off(), wheelset=0, highest_speed=100.0)


def test_hunting_without_a_hopf_point():
    """By simulation from 6 mm: at 290 km/h it dies out, at 300 km/h the leading bogie hunts alone with 7.53 mm, at 350 km/h both do with
    9.01 mm."""
    vehicle = blown_off()
    found = railjax.nonlinear_critical(vehicle)
    assert (found.code, found.linear.code) == (railjax.Hunting.OK, railjax.Stability.STABLE)
    assert float(found.speed) * KMH == pytest.approx(278.392, abs=0.01)  # a slow ramp down from 350 km/h stops hunting at 277
    branch = isola()
    assert branch.criticality == "isolated"
    assert branch.fold.speed == pytest.approx(float(found.speed), rel=1e-6)
    assert branch.speed.max() > 100.0
    assert branch.at(300.0 / KMH).amplitude * 1e3 == pytest.approx(7.53, abs=0.1)
    assert branch.at(350.0 / KMH).amplitude * 1e3 == pytest.approx(9.01, abs=0.03)
    # the unstable cycles lie below the stable ones, on the same piece
    assert branch.at(300.0 / KMH, stable=False).amplitude < 7e-3
    assert "no Hopf point" in str(branch)


def test_isolated_limit_cycles_on_the_command_line_and_drawn():
    content = railjax.nonlinear_critical(blown_off()).as_dict()
    assert content["criticality"] == "isolated"
    assert content["nonlinear_kmh"] == pytest.approx(278.392, abs=0.01)
    with plots.figure() as (_page, axes):
        isola().plot(axes[0, 0])
        labels = axes[0, 0].get_legend_handles_labels()[1]
    assert any("fold" in label for label in labels)
    assert not any("Hopf" in label for label in labels)


def test_what_is_no_limit_cycle_above_the_hopf_point_leaves_the_linear_critical_speed():
    """2 % above it this coach's motion of 7 mm is not periodic, and nothing hunts at 99 % (60 s from five large disturbances by
    benchmarks/random_hunting.py); the branch leaves the Hopf point towards higher speeds."""
    changes = {
        "contact__conicity": 0.28227630882259,
        "contact__friction": 0.4802130547868749,
        "contact__flange_clearance": 6.146771180254421e-3,
        "contact__flange_stiffness": 8871757.819494389,
        "primary__stiffness_x": 5524745.279048182,
        "primary__stiffness_y": 9263396.304686327,
        "secondary__damping_y": 18320.867872095667,
    }
    coach = with_yaw_dampers(1179130.3140105978, 1.3, 6.704776695697665e-3, 6128.626154960816, 10646226.318967136)
    found = railjax.nonlinear_critical(railjax.replace(coach, **changes))
    assert found.code == railjax.Hunting.SUPERCRITICAL
    assert float(found.speed) == float(found.linear.speed)


def test_motions_that_shrink_to_small_limit_cycles_are_supercritical(coach):
    """All ends below a tenth of the clearance, also above the Hopf point, where straight running is unstable."""
    model = orbits.model_of(coach, railjax.PassiveDamper())
    search = FoldSearch(model, Shooting(200, 2), 68.2)
    guess = np.append(np.zeros(model.states - 1), [1.0, 6.8])
    assert not search.descend([End(guess, 5e-4, True)] * 3)
    assert search.vanished
