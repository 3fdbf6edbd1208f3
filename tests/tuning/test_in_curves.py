"""Objectives in curves are the numbers of steady curving, with its derivatives."""

import numpy as np
import pytest

import railjax
from railjax import objectives as aim
from railjax.reports.paper.studies import steering
from railjax.reports.paper.study import Context
from railjax.testing import check_objective


def test_values_are_those_of_curving(coach):
    speed = np.sqrt(9.81 * 500.0 * 0.2 / 1.5)
    smooth = railjax.replace(coach, contact__law="smooth")
    found, passive = railjax.curving(smooth, speed, radius=500.0, cant=0.1), railjax.PassiveDamper()
    for quantity, value in (
        (aim.wear(500.0), found.wear_number),
        (aim.guiding_force(radius=500.0), np.max(np.abs(found.guiding_force))),
        (aim.angle_of_attack(500.0), np.max(found.angle_of_attack)),
        (aim.derailment_quotient(500.0), np.max(found.y_over_q)),
    ):
        assert float(quantity.value(smooth, passive)) == pytest.approx(float(value), rel=1e-9)
        assert "R 500 m at 92.06 km/h" in quantity.name
    assert np.isnan(aim.wear(150.0, 80.0).value(smooth, passive))
    for call, says in (
        (lambda: aim.wear(0.0), "radius in m"),
        (lambda: aim.wear(500.0, 20.0, cant_deficiency=0.1), "exclude each other"),
        (lambda: aim.guiding_force(), "needs speeds"),
    ):
        with pytest.raises(railjax.InputError, match=says):
            call()


def test_the_tester_of_objectives():
    check_objective(aim.wear(400.0, 20.0), railjax.load_vehicle("single-wheelset"))


def test_softer_guidance_wears_less(coach):
    """The trade-off of every bogie: within bounds, less wear in the curve costs critical speed."""
    bounds = {"primary.stiffness_x": (1e6, 20e6)}
    found = railjax.tune(coach, bounds, aim.wear(500.0), [aim.linear_critical_speed() >= 230 / 3.6])
    assert found.met
    assert found.parameters["primary.stiffness_x"] < coach.primary.stiffness_x
    tuned = railjax.replace(coach, primary__stiffness_x=float(found.parameters["primary.stiffness_x"]))
    assert float(railjax.linear_critical_speed(tuned)) * 3.6 == pytest.approx(230.0, abs=0.5)


def test_the_steering_study_of_the_report(coach, literal, monkeypatch):
    """The ends of each front, with the linear critical speed in place of the nonlinear one (benchmarks/steering_front.py)."""
    fronts, real, calls = [], steering.pareto, []
    monkeypatch.setattr(steering, "FEW", 2)
    monkeypatch.setattr(steering.aim, "nonlinear_critical_speed", aim.linear_critical_speed)

    def searched(*given, points, **more):
        # the front of many points, which is the nonlinear one, is that of few here
        calls.append(points)
        if len(calls) == 2:
            return fronts[0]
        fronts.append(real(*given, points=2, **more))
        return fronts[-1]

    monkeypatch.setattr(steering, "pareto", searched)
    outcome = steering.stability_and_wear(Context(coach, literal))
    plain, braced = fronts
    assert np.all(plain.met)
    assert np.min(plain.against) == pytest.approx(steering.SLOWEST, rel=1e-3)
    # faster is more wear, and a bracing takes some of it
    assert np.all(np.diff(plain.objective[np.argsort(plain.against)]) > 0.0)
    assert np.max(braced.against) > (1.0 - 1e-6) * np.max(plain.against)
    _, without, tied = steering.moved(plain, braced)
    assert np.all(tied <= without)
    assert np.min(tied / without) < 0.8
    # the wear of a design of the front
    values = {name.replace(".", "__"): float(found[0]) for name, found in plain.parameters.items()}
    speed = np.sqrt(9.81 * 500.0 * 0.2 / 1.5)
    one = railjax.curving(railjax.replace(coach, **values), speed, radius=500.0, cant=0.1)
    assert float(one.wear_number) == pytest.approx(plain.objective[0], rel=1e-4)
    assert "off the wear number" in outcome.pictures[0].caption
    assert len(outcome.quantities) == 6
