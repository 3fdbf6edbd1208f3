"""The motions to which a vehicle is drawn: their starts, their periods, and the lowest fold that the search finds with them."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

import railjax
from railjax.stability.hunting import fold_search, orbits, shooting
from railjax.stability.hunting import settling as attractors
from railjax.stability.hunting.continuation import hunting_mode
from railjax.stability.hunting.nonlinear_critical import Hunting
from railjax.stability.linear_critical import linear_critical

#: a stiff, softly sprung coach with yaw dampers that the first search took for supercritical: its Hopf point is another mode's
STIFF = {
    "primary.stiffness_x": 6259524.7,
    "primary.stiffness_y": 22305952.4,
    "secondary.stiffness_y": 66500.0,
    "yaw_damper.damping": 49936.2,
    "secondary.damping_y": 13320.2,
}


@pytest.fixture(scope="module")
def stiff(coach):
    vehicle = dataclasses.replace(coach, yaw_damper=railjax.YawDamper(1e3, half_distance=1.35))
    for path, value in STIFF.items():
        vehicle = railjax.set_parameter(vehicle, path, value)
    return vehicle


@pytest.fixture(scope="module")
def model(coach):
    return orbits.model_of(coach, railjax.model.motion.PASSIVE)


def test_starts_of_two_bogies(model, coach):
    """In phase, opposite, and each by itself, with the motion of the one that moves most."""
    rng = np.random.default_rng(1)
    state = rng.normal(size=model.states)
    starts = attractors.patterns(model, state, 9e-3)
    assert starts.shape == (4, model.states)
    at = model.displacements
    moved = np.abs(state[at]).reshape(2, 2).max(axis=1)
    scaled = state[at].reshape(2, 2)[np.argmax(moved)] * 9e-3 / moved.max()
    for start, signs in zip(starts, ([1, 1], [1, -1], [1, 0], [0, 1]), strict=True):
        np.testing.assert_allclose(start[at].reshape(2, 2), np.outer(signs, scaled), rtol=1e-12)
        np.testing.assert_allclose(start[:3], state[:3])  # the car body's
    names = railjax.model.kinematics.labels(coach)
    assert names[:3] == ["carbody_y", "carbody_psi", "carbody_phi"]


@pytest.mark.parametrize("period", [18.7, 40.0, 75.9])
def test_a_swing_of_unknown_period(period):
    """Between half and twice the samples expected of a period (40), off the grid of samples."""
    at = np.arange(160)
    turns, length = attractors._turns(3e-3 * np.cos(2.0 * np.pi * (at - 11.4) / period))
    assert length == pytest.approx(period, abs=0.02)
    away = (np.array(turns) - 11.4) / (0.5 * period)
    # the first and the last may be an end of the record
    assert np.all(np.abs(away - np.round(away))[1:-1] * 0.5 * period < 0.51)
    assert np.all(np.diff(np.round(away)) == 1)


def test_what_stands_still_does_not_swing():
    for y in (np.zeros(160), np.full(160, 1e-3), np.linspace(1.0, -1.0, 160), np.full(160, np.nan)):
        assert not attractors._turns(y)[0]


def test_bogies_drawn_to_limit_cycles_and_to_rest(model, coach):
    """Above the fold from four starts into limit cycles as Newton finds them; far below it to rest; more starts than a chunk has lanes."""
    shot = orbits.Shooting(200, 2)
    shape, omega = hunting_mode(model, shot, float(linear_critical(coach).speed))
    patterns, period = attractors.patterns(model, shape, 9e-3), 2.0 * np.pi / omega
    speeds = np.repeat([200.0, 242.0], 20) / 3.6
    starts = [
        attractors.Start(model, state, period, speed, 30, 1e-3)
        for state, speed in zip(np.tile(patterns, (10, 1)), speeds, strict=True)
    ]
    ends = attractors.drawn(shot, starts)
    assert all(end.displacement < 1e-3 for end in ends[:20])
    assert all(end.displacement > 9e-3 for end in ends[20:])
    for k in range(20, 24):
        assert ends[k].swings
        assert ends[k].displacement == ends[k + 4].displacement  # whatever runs beside it
        point = shooting.solved(model, shot, shooting.at_speed(model, shot, ends[k].guess, speeds[k]))
        assert point.usable
        assert point.unknowns[-2] == pytest.approx(ends[k].guess[-2], rel=2e-3)
        # the phase between the bogies, which barely feel each other, is still on its way
        assert np.max(point.peaks) == pytest.approx(ends[k].displacement, rel=0.02)


def test_batches_of_neighbours_take_their_folds_from_one_another(coach, monkeypatch):
    """By Newton's method from a neighbour's fold and searched from nothing: the same answers."""
    scale = jnp.array([0.9, 1.0, 1.05, 1.2])
    variants = railjax.replace(coach, primary__stiffness_x=coach.primary.stiffness_x * scale)
    taken = []
    take_from = fold_search.FoldSearch.take_from
    monkeypatch.setattr(fold_search.FoldSearch, "take_from", lambda *pair: taken.append(take_from(*pair)) or taken[-1])
    together = railjax.nonlinear_critical(variants, steps=200)
    assert taken == [True, True, True]
    monkeypatch.setattr(fold_search.FoldSearch, "take_from", lambda *_: False)
    apart = railjax.nonlinear_critical(variants, steps=200)
    assert np.all(np.asarray(together.code) == Hunting.OK)
    np.testing.assert_allclose(together.speed, apart.speed, rtol=1e-9)
    np.testing.assert_allclose(together.amplitude, apart.amplitude, rtol=1e-5)


def test_the_lowest_fold_where_the_hopf_point_is_another_mode_s(stiff):
    """With half the usual steps, as tuning takes it; the two tests that follow, with all of them."""
    found = railjax.nonlinear_critical(stiff, steps=100)
    assert Hunting(int(found.code)) == Hunting.OK
    assert float(found.linear.speed) * 3.6 == pytest.approx(405.65, abs=0.1)
    assert float(found.linear.frequency) == pytest.approx(6.745, abs=0.01)
    assert float(found.speed) * 3.6 == pytest.approx(335.70, abs=0.02)
    assert float(found.frequency) == pytest.approx(4.915, abs=0.01)


def test_that_fold_by_simulation(stiff):
    """Large disturbances of many shapes: 1 % above the fold some go on, 1 % below none does."""
    fold = float(railjax.nonlinear_critical_speed(stiff))
    assert fold * 3.6 == pytest.approx(335.70, abs=0.02)
    rng = np.random.default_rng(3)
    model = orbits.model_of(stiff, railjax.model.motion.PASSIVE)
    starts = np.zeros((model.states, 8))
    starts[model.displacements] = 11e-3 * np.sign(rng.normal(size=(4, 8))) * rng.uniform(0.7, 1.3, (4, 8))
    ends = []
    for factor in (0.99, 1.01):
        run = railjax.simulate(
            stiff,
            factor * fold,
            duration=60.0,
            dt=5e-4,
            initial=starts,
            record=["wheelset_y"],
            sample=5e-3,
        )
        late = np.asarray(run["wheelset_y"])[-400:]
        ends.append(np.abs(late).max(axis=(0, 1)))
    assert np.all(ends[0] < 2e-3)
    assert np.any(ends[1] > 8e-3)


def test_the_diagram_ends_in_the_same_fold(stiff):
    branch = railjax.hunting_branch(stiff)
    assert branch.fold.speed * 3.6 == pytest.approx(335.703, abs=0.01)
    above = [cycle for cycle in branch.pieces[-1] if cycle.speed > 1.02 * branch.fold.speed]
    assert above
    assert all(cycle.stable for cycle in above if cycle.speed < 1.1 * branch.fold.speed)
