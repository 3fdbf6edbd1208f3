"""The studies of comfort and safety on real tracks, in a small size."""

import numpy as np
import pytest

from railjax.dampers.balance_logic import BalanceLogic
from railjax.model.damper import PassiveDamper
from railjax.reports.paper.studies import acceptance as paper_acceptance
from railjax.reports.paper.studies import comfort as paper_comfort
from railjax.reports.paper.study import Context


@pytest.fixture
def small(coach, literal, monkeypatch):
    """Three speeds, two suspensions, just long enough for N_MV."""
    dampers = {"passive, Table 1": PassiveDamper(), "balance logic, ideal": BalanceLogic(1.0)}
    for module in (paper_comfort, paper_acceptance):
        monkeypatch.setattr(module, "SPEEDS", np.array([160.0, 220.0, 280.0]))
        monkeypatch.setattr(module, "SPECTRA", {"erri-high": "ERRI high"})
        monkeypatch.setattr(module, "DURATION", 112.0)
    monkeypatch.setattr(paper_comfort, "strategies", lambda vehicle: dampers)
    monkeypatch.setattr(paper_comfort, "DRAWN", tuple(dampers))
    monkeypatch.setattr(paper_acceptance, "paper_dampers", lambda: {"passive": PassiveDamper()})
    return Context(coach, literal)


def test_comfort_over_speed(small, monkeypatch):
    monkeypatch.setattr(paper_comfort, "SPECTRA", {"erri-low": "ERRI low", "erri-high": "ERRI high"})
    found = paper_comfort.on_real_tracks(small)
    values = {quantity.name: quantity.computed for quantity in found.quantities}
    passive, controlled = (
        values[f"N_MV (lateral) on ERRI high at 220 km/h: {name}"] for name in ("passive, Table 1", "balance logic, ideal")
    )
    assert 1.2 < passive < 3.0
    assert 0.3 < controlled / passive < 0.6
    assert values["N_MV (lateral) on ERRI low at 220 km/h: passive, Table 1"] < passive
    assert [statement.holds for statement in found.statements] == [True, True]
    assert {picture.slug for picture in found.pictures} == {"comfort-over-speed", "comfort-strategies"}
    assert all(not quantity.fitted for quantity in found.quantities)


def test_safety_over_speed(small):
    found = paper_acceptance.safety(small)
    first = {quantity.name: quantity.computed for quantity in found.quantities}
    assert len(first) == 7
    force = next(value for name, value in first.items() if name.startswith("sum of guiding forces"))
    assert force == 220.0
    assert "Not a certificate" in found.pictures[0].caption
