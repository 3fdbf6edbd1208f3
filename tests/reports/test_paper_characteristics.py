"""Figs. 13-14: loops that close, dissipate, grow with the current, and the level that is fitted."""

import numpy as np
import pytest

from railjax.reports.paper.studies import characteristics as paper
from railjax.reports.paper.study import Context


@pytest.fixture(scope="module")
def device():
    return paper.scaled_device()


def test_the_device_is_the_prototype_in_another_size(device):
    parameters, factor = device
    assert parameters.c0a == pytest.approx(2100.0 * factor / 0.2)
    assert parameters.gamma == pytest.approx(3.63e6 / 0.2**2)
    assert parameters.k1 == 0.0
    *_, force = paper.device_loops(parameters, paper.COMPUTED)
    assert force[-1].max() == pytest.approx(406.7, rel=1e-6)


def test_loops_close_and_dissipate(device):
    x, v, force = paper.device_loops(device[0], paper.COMPUTED)
    force = force[: len(paper.CURRENTS)]
    assert np.max(np.abs(x)) == pytest.approx(5e-3, rel=1e-4)
    assert np.max(np.abs(v)) == pytest.approx(0.015, rel=1e-4)
    np.testing.assert_allclose(force[:, 0], force[:, -1], atol=1e-2 * force.max())
    # odd: half a period later the opposite force
    half = len(x) // 2
    np.testing.assert_allclose(force[:, half], -force[:, 0], atol=0.02 * force.max())
    energy = np.trapezoid(force, x, axis=1)
    assert np.all(np.diff(energy) > 0)
    assert energy[0] > 0
    assert np.all(energy < 4 * 5e-3 * force.max(axis=1))  # the rectangle of dry friction


def test_study(coach, literal, device):
    outcome = paper.characteristics(Context(coach, literal))
    found = {quantity.name: quantity for quantity in outcome.quantities}
    fitted = found["force of the MR device at 1.5 A, 15 mm/s (Bouc-Wen)"]
    assert fitted.fitted
    assert fitted.within
    assert all(statement.holds for statement in outcome.statements)
    hybrid = found["hybrid damper's force at 0.1 m/s, full current"]
    assert not hybrid.fitted
    assert hybrid.computed == pytest.approx(5000, abs=100)
    assert [picture.slug for picture in outcome.pictures] == ["figs-13-14", "hybrid-characteristic"]
    assert any("level is fitted, the shape is the prototype's" in entry for entry in outcome.assumptions)
