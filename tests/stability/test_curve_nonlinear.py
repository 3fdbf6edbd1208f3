"""The nonlinear critical speed in a curve: that of straight track where there is none, the fold itself by simulation, gradients by differences."""

import jax
import numpy as np
import pytest

import railjax

RADIUS, DEFICIENCY = 3000.0, 0.05


@pytest.fixture(scope="module")
def bogie():
    return railjax.load_vehicle("cooperrider-bogie")


def fold(bogie, radius, deficiency=DEFICIENCY):
    return railjax.curve_nonlinear_critical(bogie, radius=radius, cant_deficiency=deficiency)


def test_without_curvature_it_is_that_of_straight_track(bogie):
    found, straight = fold(bogie, 1e9, 0.0), railjax.nonlinear_critical(bogie)
    np.testing.assert_allclose(found.speed, straight.speed, rtol=1e-7)
    np.testing.assert_allclose(found.amplitude, straight.amplitude, rtol=1e-5)


def test_hunting_in_the_curve_dies_out_below_it_and_goes_on_above(bogie):
    found = fold(bogie, RADIUS)
    assert found.code == railjax.Hunting.OK
    assert float(found.speed) < float(found.linear.speed)
    left = []
    for share in (0.985, 1.015):
        v = share * float(found.speed)
        cant = 1.5 * v**2 / (9.81 * RADIUS) - DEFICIENCY
        steady = railjax.curving(bogie, v, radius=RADIUS, cant=cant)
        start = np.asarray(steady.state).copy()
        start[3:5] += 8e-3
        line = railjax.Layout([railjax.Segment.arc(2000.0, RADIUS, cant)])
        run = railjax.simulate(bogie, v, track=line, initial=start, duration=20.0, record=("wheelset_y",))
        left.append(np.max(np.abs(run["wheelset_y"] - steady.wheelset_y)[-100:]))
    assert left[0] < 1e-4
    assert left[1] > 5e-3


def test_gradient(bogie):
    slope = jax.grad(lambda radius: fold(bogie, radius * 1e3).speed)(3.0)
    difference = float(fold(bogie, 3003.0).speed - fold(bogie, 2997.0).speed) / 6e-3
    assert float(slope) == pytest.approx(difference, rel=1e-4)
