"""The climb of the wheel profile's study: within its bounds, not below the steering it began with, and no step that a simulation refutes."""

import numpy as np
import pytest

from railjax.reports.paper.studies import wheel_profile as study

#: of a made-up wheel: steering falls along what makes it faster, least where the speed is highest
FASTER, STEERS = np.array([3.0, 1.0, -2.0, 0.0, 1.0, 2.0]), np.array([-1.0, 1.0, 0.5, 0.3, 0.0, 0.1])


@pytest.fixture
def made_up(monkeypatch):
    def judged(_, heights):
        slope = FASTER - 2.0 * heights
        return study.Wheel(heights, heights, 40.0 + FASTER @ heights - heights @ heights, slope, 1.7 + STEERS @ heights, STEERS)

    monkeypatch.setattr(study, "judged", judged)
    monkeypatch.setattr(study, "holds", lambda vehicle, speed: vehicle[0] < 0.3)
    return judged(None, np.zeros(6))


def test_climbs_within_bounds_at_the_same_steering(made_up):
    last, taken = study.climbed(None, made_up, 40)
    speeds = [one.speed for one in taken]
    assert len(taken) > 3
    assert np.all(np.diff(speeds) > 0.0)
    assert np.all(np.abs(last.heights) <= study.MOST + 1e-9)
    assert last.steering >= made_up.steering - study.LOST
    # up to what a simulation refutes, although the tangents lead on
    assert 0.2 < last.heights[0] < 0.3
    assert np.all(last.heights[[1, 2, 4, 5]] * [1, -1, 1, 1] > 0.2)


def test_slopes_are_chained_over_all_numbers():
    rates = {"a": np.arange(12.0).reshape(2, 3, 2), "b": np.array([1.0, -1.0])}
    slopes = {"a": np.ones((3, 2)), "b": 2.0}
    np.testing.assert_allclose(study._chained(slopes, rates), [15.0 + 2.0, 51.0 - 2.0])
