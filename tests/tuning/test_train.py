"""Training: gradients through the closed loop, the same weights to the bit, taken up again, and refused where it must be."""

import dataclasses

import jax
import numpy as np
import pytest

import railjax
from railjax.tuning import course, teacher
from railjax.tuning import train as training
from railjax.tuning.train import train

SPEEDS = (40.0, 60.0)
#: short windows and few rides: what is compiled is as for long ones
SMALL = {
    "tracks": [railjax.RandomTrack("erri-high", seed=range(4), length=1100.0, fade=0.0)],
    "validation": [railjax.RandomTrack("erri-high", seed=[7], length=1100.0, fade=0.0)],
    "speeds": SPEEDS, "windows": 3, "window": 0.2, "lanes": 4, "every": 1,
}  # fmt: skip


@pytest.fixture(scope="module")
def law(coach):
    # what is quantised has no differences: derivatives pass it by
    sensors = dataclasses.replace(railjax.Sensors.typical(), quantum=np.zeros(3))
    controller = railjax.Controller(railjax.Skyhook(damping=1e5), device=railjax.Device(), sensors=sensors)
    return railjax.LearnedDamper.of(controller, coach, hidden=2, time_constants=(0.1,))


@pytest.fixture(scope="module", autouse=True)
def one_teacher():
    """What all trainings here share is compiled once."""
    made, one_kernel, kept = training.Teacher, teacher.jit, {}
    teacher.jit = jax.jit  # compiled in a third of the time, and as right

    def shared(*arguments):
        new = made(*arguments)
        if "gradient" in kept:
            new.gradient = kept["gradient"]
        kept.setdefault("gradient", new.gradient)
        return new

    training.Teacher = shared
    yield
    training.Teacher, teacher.jit = made, one_kernel


def same(one, other):
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        np.testing.assert_array_equal(a, b)


def test_the_same_seed_gives_the_same_law_to_the_bit_also_after_a_stop(coach, law, tmp_path):
    whole = train(coach, law, **SMALL, episodes=2)
    assert whole.episodes == 2
    assert whole.history.shape == (3, 4)
    assert whole.history[0, 1] == 1.0
    assert all(60.0 < speed < 70.0 for speed in whole.quiet)  # m/s; below 227 and 241 km/h
    assert "hunts no earlier" in str(whole)
    # killed in its second episode
    kept = tmp_path / "kept.npz"

    def kill(at):
        if at.done == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(coach, law, **SMALL, episodes=2, keep=kept, progress=kill)
    again = train(coach, law, **SMALL, episodes=2, keep=kept)
    np.testing.assert_array_equal(again.history, whole.history)
    same(again.law, whole.law)
    assert "2 episodes" in str(again)
    with pytest.raises(railjax.InputError, match="another training: lanes is 4 there and 6 here"):
        train(coach, law, **(SMALL | {"lanes": 6}), episodes=2, keep=kept)
    with pytest.raises(railjax.InputError, match=r"another training: vehicle\.carbody\.mass is"):
        train(railjax.replace(coach, carbody__mass=1.01 * coach.carbody.mass), law, **SMALL, episodes=2, keep=kept)
    with pytest.raises(railjax.InputError, match="hunts"):
        train(coach, law, **(SMALL | {"speeds": (60.0, 110.0)}), episodes=1)


def test_gradient_of_the_closed_loop_is_that_of_differences(coach, law):
    """Along a random direction of all weights at once, over noise, delay, estimator and device; 0.2 s, 2 rides."""
    taught = training.Teacher(
        *training.prepared(coach, law, SMALL["tracks"], SPEEDS), None, {"secondary_travel": 1.0}, 3, 0.2, 4, 1e-3, 0
    )
    rides = taught.rides(0).part(np.arange(2))
    weights, rng = course.weights_of(law), np.random.default_rng(0)
    weights = weights | {"hidden_demand": weights["hidden_demand"] + 0.1}
    along = {name: rng.normal(size=np.shape(value)) * 0.1 for name, value in weights.items()}
    x, echo = taught.start(2), 0.05 + taught.silence(2)
    x[:34] = 1e-3 * rng.normal(size=(34, 2))
    base, prices = {name: np.ones(2) for name in ("comfort", "secondary_travel")}, {"secondary_travel": np.asarray(0.5)}

    def value(share):
        moved = {name: np.asarray(weights[name] + share * along[name]) for name in weights}
        return taught.gradient(moved, rides, x, echo, base, prices)

    (_, _), slope = value(0.0)
    step = 1e-5
    difference = (value(step)[0][0] - value(-step)[0][0]) / (2 * step)
    found = sum(float(np.sum(np.asarray(slope[name]) * along[name])) for name in weights)
    assert abs(found) > 1e-8
    np.testing.assert_allclose(found, difference, rtol=1e-5)


def test_what_cannot_be_trained_is_refused(coach, law):
    for changed, about in (
        ({"lanes": 3}, "even"),
        ({"tracks": [railjax.RandomTrack(length=1100.0), railjax.RandomTrack(length=1500.0)]}, "one length"),
        ({"tracks": []}, "tracks"),
        ({"dt": 3e-3}, "5 ms"),
        ({"limits": {"secondary_travl": 1.0}}, "secondary_travel"),
    ):
        with pytest.raises(railjax.InputError, match=about):
            train(coach, law, **(SMALL | changed), episodes=1)
    with pytest.raises(railjax.InputError, match="LearnedDamper"):
        train(coach, railjax.Skyhook(), **SMALL)
    with pytest.raises(railjax.InputError, match="validation"):
        train(coach, law, tracks=SMALL["tracks"], speeds=SPEEDS)


def test_training_aims_lower_where_validation_was_beyond_a_limit_and_higher_where_it_was_not():
    limits = {"secondary_travel": 1.05, "guiding_force": 1.0}
    aims = {name: np.ones(()) for name in limits}
    aims = training.aimed(aims, limits, (1.071, 0.95))
    np.testing.assert_allclose(list(aims.values()), [0.99, 1.025])
    aims = training.aimed(aims, limits, (1.05, 3.0))
    np.testing.assert_allclose(list(aims.values()), [0.99, training.AIMS[0]])
    aims = training.aimed(aims, limits, (np.nan, np.nan))  # where a ride failed
    np.testing.assert_allclose(list(aims.values()), [0.99, training.AIMS[0]])


def test_a_better_law_with_which_the_vehicle_hunts_earlier_is_not_taken(law):
    """Part of the way there is, where it keeps quiet; the course goes on from where it stood."""
    best, now = course.weights_of(law), jax.tree.map(lambda one: one + 1.0, course.weights_of(law))
    began = course.Course(now, (), {}, {}, best, 1.0, 2, 5, [(0.0, 1.0, 1.0)])

    class Rides:
        scores = iter((0.93, 0.95))

        def score(self, _):
            return (found := next(self.scores)), (found,)

    def after(quiet, score=0.9):
        Rides.scores = iter((0.93, 0.95))
        answers = iter(quiet)
        judge = type("Quiet", (), {"kept": lambda self, _: next(answers)})()
        return training.tried.__wrapped__(began, law, Rides(), judge, score, (score,))

    whole, half, none, worse = after([True]), after([False, True]), after([False] * 3), after([], 1.1)
    same(whole.best, now)
    assert (whole.best_score, whole.stale, whole.history[-1]) == (0.9, 0, (5.0, 0.9, 0.9))
    same(half.best, jax.tree.map(lambda a, b: a + 0.5 * (b - a), best, now))
    assert (half.best_score, half.history[-1]) == (0.93, (5.0, 0.93, 0.93))
    for course_after in (none, worse):
        same(course_after.best, best)
        assert (course_after.best_score, course_after.stale) == (1.0, 3)
    assert none.history[-1] == (5.0, np.inf, 0.95)
    same(half.weights, now)
