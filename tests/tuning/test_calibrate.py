"""Calibration: known parameters are found again, derivatives, and what is refused."""

import numpy as np
import pytest

import railjax

PATHS = {
    "guidance": ("primary.stiffness_x", "primary.stiffness_y"),
    "friction": ("contact.friction",),
    "clearance": ("contact.flange_clearance",),
}
COACH = {"linear_kmh": 245.6, "fold_kmh": 234.2, "fold_amplitude_mm": 9.0}


def results(vehicle):
    found = railjax.nonlinear_critical(vehicle)
    values = np.array([float(found.linear.speed) * 3.6, float(found.speed) * 3.6, float(found.amplitude) * 1e3])
    return dict(zip(COACH, values, strict=True))


@pytest.fixture(scope="module")
def bogie():
    return railjax.load_vehicle("cooperrider-bogie")


def scaled(vehicle, factors):
    for name, factor in factors.items():
        for path in PATHS[name]:
            vehicle = railjax.set_parameter(vehicle, path, float(railjax.get_parameter(vehicle, path)) * factor)
    return vehicle


@pytest.fixture(scope="module")
def recovered(bogie):
    true = {"guidance": 1.08, "friction": 0.9, "clearance": 1.06}
    return true, railjax.calibrate(bogie, PATHS, results(scaled(bogie, true)))


def test_known_parameters_are_found_again(bogie, recovered):
    true, found = recovered
    for name, factor in true.items():
        assert found.factors[name] == pytest.approx(factor, rel=1e-5)
        for path in PATHS[name]:
            expected = factor * railjax.get_parameter(bogie, path)
            assert found.values[path] == pytest.approx(expected, rel=1e-5)
            assert railjax.get_parameter(found.vehicle, path) == found.values[path]
    assert max(map(abs, found.residuals.values())) < 1e-5
    assert found.iterations < 15
    assert 1.0 < found.condition < 1e4
    text = str(found)
    assert "fitted, not predicted" in text
    assert all(name in text for name in (*true, *COACH))
    # Cooperrider's own values are "recalled"; those fitted are so no more
    status = {entry.parameter: entry.status for entry in found.vehicle.provenance}
    assert all(status[path] == "calibrated" for paths in PATHS.values() for path in paths)
    assert status["contact.conicity"] == "recalled"
    assert len(status) == len(found.vehicle.provenance)


def test_jacobian_against_central_differences(recovered):
    _, found = recovered
    for k, name in enumerate(PATHS):
        # the fold's amplitude, where the speed is stationary, is not found better than to some 1e-6 mm
        step = 3e-3
        up, down = (list(results(scaled(found.vehicle, {name: float(np.exp(h))})).values()) for h in (step, -step))
        numeric = (np.array(up) - np.array(down)) / (2 * step)
        np.testing.assert_allclose(found.jacobian[:2, k], numeric[:2], rtol=1e-3, atol=1e-3)
        np.testing.assert_allclose(found.jacobian[2, k], numeric[2], rtol=1e-3, atol=1e-2)


def test_the_coach_from_table_1(coach, literal):
    """The packaged values are what `calibrate` finds, to the digits kept in the file."""
    start = {"guidance": 12.0, "friction": 1.3, "clearance": 1.0}
    found = railjax.calibrate(literal, PATHS, COACH, start=start)
    for path, value in found.values.items():
        assert railjax.get_parameter(coach, path) == pytest.approx(value, rel=2e-6)
        assert "calibrated" in {entry.status for entry in found.vehicle.provenance if entry.parameter == path}
    assert found.factors["guidance"] == pytest.approx(12.607937, rel=1e-6)
    # dead band and friction, not guidance, set the fold's amplitude
    assert abs(found.jacobian[2, 2]) > 10 * abs(found.jacobian[2, 0])
    assert np.all(found.jacobian[0, 1:] == 0.0)


def test_more_results_than_unknowns_are_met_in_the_least_squares_sense(bogie):
    # inconsistent on purpose: one factor cannot serve both
    found = railjax.calibrate(bogie, {"guidance": PATHS["guidance"]}, {"linear_kmh": 255.0, "fold_kmh": 240.0})
    assert found.jacobian.shape == (2, 1)
    relative = found.jacobian[:, 0] / [255.0, 240.0]
    residual = np.array(list(found.residuals.values())) / [255.0, 240.0]
    assert abs(relative @ residual) < 1e-8
    assert np.abs(residual).max() > 1e-3


@pytest.mark.parametrize(
    ("fit", "to", "options", "message"),
    [
        ({"g": ("primary.stifness_x",)}, {"linear_kmh": 200.0}, {}, "nearest is 'primary.stiffness_x'"),
        ({"g": ("yaw_damper.damping",)}, {"linear_kmh": 200.0}, {}, "has no yaw damper"),
        ({"g": ("primary.damping_x",)}, {"linear_kmh": 200.0}, {}, "is 0, which a factor cannot change"),
        ({"g": "primary.stiffness_x"}, {"linear_kmh": 200.0}, {}, "in a tuple"),
        ({"g": ("contact.law",)}, {"linear_kmh": 200.0}, {}, "single number"),
        ({"g": ("contact.friction",), "h": ("contact.friction",)}, COACH, {}, "named twice"),
        (PATHS, {"linear_kmh": 200.0, "fold_kmh": 190.0}, {}, "3 unknowns need as many results"),
        ({"g": ("contact.conicity",)}, {"linear": 200.0}, {}, "did you mean linear_kmh"),
        ({"g": ("contact.conicity",)}, {"linear_kmh": float("nan")}, {}, "positive and finite"),
        ({"g": ("contact.conicity",)}, {"linear_kmh": 200.0}, {"start": {"f": 1.0}}, "no unknown 'f'"),
        ({"g": ("contact.conicity",)}, {"linear_kmh": 200.0}, {"start": {"g": 0.0}}, "between the bounds"),
        ({"g": ("contact.friction",)}, {"linear_kmh": 200.0}, {}, "moves none of the results"),
        ({}, {"linear_kmh": 200.0}, {}, "must each name something"),
        ({"g": ("contact.conicity",)}, {"linear_kmh": 200.0}, {"bounds": (2.0, 1.0)}, "rising order"),
        ({"g": ("contact.conicity",)}, {"linear_kmh": 200.0}, {"start": {"g": 0.011}}, "no linear critical speed"),
    ],
)
def test_bad_input_is_one_line(coach, fit, to, options, message):
    with pytest.raises(railjax.InputError, match=message) as caught:
        railjax.calibrate(coach, fit, to, **options)
    assert len(str(caught.value).splitlines()) == 1


def test_a_fold_that_the_vehicle_does_not_have_is_refused():
    tight = railjax.replace(railjax.load_vehicle("single-wheelset"), contact__flange_clearance=1e-3)
    with pytest.raises(railjax.InputError, match="no fold"):
        railjax.calibrate(tight, {"friction": ("contact.friction",)}, {"fold_kmh": 117.0})


def test_results_out_of_reach_are_said(coach):
    with pytest.raises(railjax.NumericalError, match="did not reach its results; nearest: linear_kmh"):
        railjax.calibrate(coach, {"k": ("secondary.stiffness_y",)}, {"linear_kmh": 400.0}, bounds=(0.5, 2.0))
