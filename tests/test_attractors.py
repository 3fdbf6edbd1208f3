"""The motions to which a vehicle is drawn: their starts, their periods, and the lowest fold that the search finds with them."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

import railjax
from railjax import attractors, orbits
from railjax.continuation import hunting_mode
from railjax.critical import Hunting
from railjax.linear import linear_critical
from railjax.vehicle import without_labels

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
    return orbits.Model(without_labels(orbits.rounded(coach)), railjax.motion.PASSIVE)


def test_starts_of_two_bogies(model, coach):
    """In phase, opposite, and each by itself, with the motion of the one that moves most."""
    states = orbits.state_size(*model)
    rng = np.random.default_rng(1)
    state = jnp.asarray(rng.normal(size=states))
    starts = np.asarray(attractors.patterns(model, state, 9e-3))
    assert starts.shape == (4, states)
    at = orbits.displacements(model)
    moved = np.abs(np.asarray(state)[at]).reshape(2, 2).max(axis=1)
    scaled = np.asarray(state)[at].reshape(2, 2)[np.argmax(moved)] * 9e-3 / moved.max()
    for start, signs in zip(starts, ([1, 1], [1, -1], [1, 0], [0, 1]), strict=True):
        np.testing.assert_allclose(start[at].reshape(2, 2), np.outer(signs, scaled), rtol=1e-12)
        np.testing.assert_allclose(start[:3], state[:3])  # the car body's
    names = railjax.deflections.labels(coach)
    assert names[:3] == ["carbody_y", "carbody_psi", "carbody_phi"]


@pytest.mark.parametrize("period", [37.3, 80.0, 151.9])
def test_a_swing_of_unknown_period(period):
    """Between half and twice the samples expected of a period (80), off the grid of samples."""
    at = np.arange(320)
    weights, length, swings = attractors._one_swing(jnp.asarray(3e-3 * np.cos(2.0 * np.pi * (at - 11.4) / period)))
    assert bool(swings)
    assert float(length) == pytest.approx(period, abs=0.02)
    instant = float(weights @ at)
    assert np.cos(2.0 * np.pi * (instant - 11.4) / period) == pytest.approx(1.0, abs=1e-4)


def test_what_stands_still_does_not_swing():
    for y in (np.zeros(320), np.full(320, 1e-3), np.linspace(1.0, -1.0, 320)):
        assert not bool(attractors._one_swing(jnp.asarray(y))[2])


def test_bogies_drawn_to_limit_cycles_and_to_rest(model, coach):
    """Above the fold from four starts into limit cycles as Newton finds them; far below it to rest; on the same steps."""
    shooting = orbits.Shooting(200, 2)
    hopf = linear_critical(coach)
    shape, omega = hunting_mode(model, shooting, hopf.speed)
    starts = attractors.patterns(model, shape, 9e-3)
    speeds = jnp.repeat(jnp.asarray([200.0, 242.0]) / 3.6, 4)
    end = attractors.drawn(model, shooting, jnp.tile(starts, (2, 1)), 2.0 * jnp.pi / omega, speeds, 1e-3)
    assert np.all(np.asarray(end.displacements)[:4] < 1e-3)
    assert np.all(np.asarray(end.displacements)[4:] > 9e-3)
    row = orbits.row_of(model, shooting, orbits.BY_SPEED)
    for k in range(4, 8):
        assert bool(end.swings[k])
        point = orbits.solved(model, shooting, orbits.Problem(end.guesses[k], row, speeds[k] / orbits.SPEED))
        assert bool(point.usable)
        assert float(point.unknowns[-2]) == pytest.approx(float(end.guesses[k][-2]), rel=2e-3)
        # the phase between the bogies, which barely feel each other, is still on its way
        orbit = orbits.history(model, shooting, orbits.unpack(model, shooting, point.unknowns))
        peak = float(jnp.max(jnp.abs(orbit[:, orbits.displacements(model)])))
        assert peak == pytest.approx(float(end.displacements[k]), rel=0.02)


def test_the_lowest_fold_where_the_hopf_point_is_another_mode_s(stiff):
    """With half the usual steps, as tuning takes it; the two tests that follow, with all of them."""
    found = railjax.nonlinear_critical(stiff, steps=100)
    assert Hunting(int(found.code)) == Hunting.OK
    assert float(found.linear.speed) * 3.6 == pytest.approx(405.65, abs=0.1)
    assert float(found.linear.frequency) == pytest.approx(6.745, abs=0.01)
    assert float(found.speed) * 3.6 == pytest.approx(335.81, abs=0.02)
    assert float(found.frequency) == pytest.approx(4.915, abs=0.01)


def test_that_fold_by_simulation(stiff):
    """Large disturbances of many shapes: 1 % above the fold some go on, 1 % below none does."""
    fold = float(railjax.nonlinear_critical_speed(stiff))
    assert fold * 3.6 == pytest.approx(335.81, abs=0.02)
    rng = np.random.default_rng(3)
    starts = np.zeros((orbits.state_size(stiff, railjax.motion.PASSIVE), 8))
    model = orbits.Model(without_labels(stiff), railjax.motion.PASSIVE)
    starts[orbits.displacements(model)] = 11e-3 * np.sign(rng.normal(size=(4, 8))) * rng.uniform(0.7, 1.3, (4, 8))
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
    assert branch.fold.speed * 3.6 == pytest.approx(335.806, abs=0.01)
    above = [cycle for cycle in branch.pieces[-1] if cycle.speed > 1.02 * branch.fold.speed]
    assert above
    assert all(cycle.stable for cycle in above if cycle.speed < 1.1 * branch.fold.speed)
