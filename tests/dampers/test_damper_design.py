"""Design of the MR device against a brute search, its round trip through the analysis; the study; `railjax damper design`."""

import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_cli import one_json_object, refused

import railjax
from railjax.dampers.hardware import design as damper_design
from railjax.dampers.hardware import magnetic_circuit as magnetic
from railjax.dampers.hardware.design import Requirements, design_device, design_hybrid, wind, with_layers
from railjax.dampers.hardware.magnetic_circuit import Steel
from railjax.dampers.hardware.mr_device import MrDevice, MrFluid, analyse
from railjax.reports.paper.studies import damper as paper_damper

DEVICE, FLUID, STEEL = MrDevice(), MrFluid(), Steel()


@pytest.fixture(scope="module")
def hybrid():
    return design_hybrid()


def test_the_device_s_winding_is_the_fewest_full_layers():
    found = wind(DEVICE, FLUID, STEEL)
    assert found.layers == 3
    assert found.device.turns == DEVICE.turns == 150
    assert found.device.core_diameter == pytest.approx(DEVICE.core_diameter)
    two = with_layers(DEVICE, 2)
    assert two.turns < float(magnetic.circuit(two, FLUID, STEEL, FLUID.field).ampere_turns) / 1.5
    assert two.turns < found.needed_turns < 150
    with pytest.raises(railjax.InputError, match=r"no winding of full layers reaches 250 kA/m in the gap at 0\.5 A"):
        wind(DEVICE, FLUID, STEEL, 0.5)


def test_design_against_a_brute_search():
    """Every gap and pole width of a fine grid, every number of layers: none is better and meets the requirements."""
    wanted = Requirements()
    found = design_device(wanted)
    gaps, poles = np.meshgrid(np.linspace(0.2e-3, 0.8e-3, 241), np.linspace(1e-3, 4e-3, 241))
    best = np.inf, None
    for layers in range(1, 13):
        device = dataclasses.replace(with_layers(DEVICE, layers), gap=jnp.asarray(gaps), pole_width=jnp.asarray(poles))
        forces, state = analyse(device, FLUID), magnetic.circuit(device, FLUID, STEEL, FLUID.field)
        meets = (forces.total_force >= 343.0) & (state.ampere_turns <= 1.5 * device.turns)
        for density in (state.core_density, state.root_density, state.case_density):
            meets &= density <= 1.5
        cost = np.where(meets, 0.5 * np.log(forces.active_volume) - np.log(forces.dynamic_range), np.inf)
        at = np.unravel_index(np.argmin(cost), cost.shape)
        best = min(best, (float(cost[at]), (layers, gaps[at], poles[at])), key=lambda entry: entry[0])
    cost, (layers, gap, pole) = best
    assert layers == found.layers
    ours = 0.5 * np.log(found.forces.active_volume) - np.log(found.forces.dynamic_range)
    assert float(ours) <= cost + 1e-6
    assert found.device.gap == pytest.approx(gap, abs=0.01e-3)
    assert found.device.pole_width == pytest.approx(pole, abs=0.05e-3)


def test_design_meets_what_is_asked_and_survives_the_analysis():
    found = design_device(Requirements(force=250.0, velocity=0.02))
    assert float(found.forces.total_force) == pytest.approx(250.0, rel=1e-5)
    again = wind(found.device, FLUID, STEEL, 1.5 * (1 + 1e-6), 0.02)
    assert again.layers == found.layers
    for one, other in zip(jax.tree.leaves(again.forces), jax.tree.leaves(found.forces), strict=True):
        assert float(one) == pytest.approx(float(other), rel=1e-12)
    # the force that an arbitrary device has is met by a design at least as good
    device = dataclasses.replace(DEVICE, gap=0.35e-3, pole_width=1.8e-3)
    forces = analyse(device, FLUID)
    better = design_device(Requirements(force=float(forces.total_force), weight=0.0), device)
    assert float(better.forces.dynamic_range) > float(forces.dynamic_range)
    assert "full layers of wire" in str(better)


def test_a_large_weight_on_the_volume_asks_for_the_narrowest_gap():
    small, large = (design_device(Requirements(weight=w)) for w in (0.0, 2.0))
    assert float(large.forces.active_volume) < float(small.forces.active_volume)
    assert large.device.gap == pytest.approx(0.2e-3, rel=1e-6)
    assert small.device.gap == pytest.approx(design_device().device.gap, rel=1e-6)


def test_what_the_stated_assumption_on_the_iron_decides():
    below, above = (design_device(Requirements(iron_limit=limit)) for limit in (1.575, 1.585))
    assert (below.layers, above.layers) == (3, 4)
    assert (round(below.device.gap * 1e3, 2), round(above.device.gap * 1e3, 2)) == (0.4, 0.49)


def test_gradients_of_objective_and_margins():
    problem = (with_layers(DEVICE, 3), FLUID, STEEL, Requirements())
    x = np.log([0.45e-3, 2.3e-3])
    for function, slope in (
        (damper_design._objective, damper_design._objective_slope),
        (damper_design._margins, damper_design._margins_slope),
    ):
        found = np.asarray(slope(x, *problem))
        for k in range(2):
            step = 1e-6 * np.eye(2)[k]
            numeric = (np.asarray(function(x + step, *problem)) - np.asarray(function(x - step, *problem))) / 2e-6
            np.testing.assert_allclose(found[..., k], numeric, rtol=1e-6, atol=1e-8)


def test_refusals():
    with pytest.raises(railjax.NumericalError, match="gives 5000 N within its space; the nearest misses its force by"):
        design_device(Requirements(force=5000.0))
    with pytest.raises(railjax.NumericalError, match="no device with full layers of wire gives 343 N"):
        design_device(Requirements(iron_limit=1.2))
    with pytest.raises(railjax.InputError, match="narrowest_gap must be smaller than widest_gap"):
        design_device(Requirements(narrowest_gap=3e-3))
    with pytest.raises(railjax.InputError, match="coil_diameter 16 mm"):
        design_device(Requirements(narrowest_gap=3e-3, widest_gap=4e-3))
    with jax.enable_x64(False), pytest.raises(railjax.InputError, match="double precision"):
        design_device()


def test_the_paper_s_numbers(hybrid):
    """Which of them follow, and which do not, by name."""
    found = {q.name: q for q in paper_damper.quantities(hybrid)}
    differing = {name for name, q in found.items() if q.within is False}
    assert differing == {
        "pressure drop",
        "largest opening",
        "yield stress at the design field, Carlson's formula",
        "force of the MR device",
        "force of the MR device, nearest reading",
    }
    assert [name for name, q in found.items() if q.fitted] == ["force of the MR device, nearest reading"]
    assert sum(q.within is True for q in found.values()) == 12


def test_readings_of_the_force(hybrid):
    """The nearest one, written out."""
    name, force = paper_damper.readings(hybrid)[0]
    assert name == "A_p of the bore with the rod, w of the poles, over the coil, walls at rest"
    area, w, h = np.pi * 22e-3**2 / 4, np.pi * 21.2e-3, 0.4e-3
    q = area * 0.015
    c = 2.07 + 3 * q / (3 * q + 0.4 * w * h**2 * 44.1e3)
    assert force == pytest.approx(c * 44.1e3 * 4e-3 * area / h + 3 * q * 30e-3 * area / (w * h**3), rel=1e-12)
    assert len(paper_damper.readings(hybrid)) == 120


def test_study(coach, literal, tmp_path):
    from railjax.reports.paper.study import Context

    outcome = paper_damper.damper_design(Context(coach, literal))
    assert [s.holds for s in outcome.statements] == [True, True, False]
    assert [p.slug for p in outcome.pictures] == ["mr-device-gap", "mr-device-current", "hybrid-damper-valve"]
    for picture in outcome.pictures:
        picture.figure.savefig(tmp_path / "figure.png")
    assert "30.3152" in outcome.assumptions[-1]


def test_command(run):
    code, out, error = run("damper", "design")
    assert (code, error) == (0, "")
    for piece in ("wire diameter", "10.359 mm^2", "406.7", "316.191 N", "chosen to fit, not predicted", "assumed: "):
        assert piece in out
    content = one_json_object(run("damper", "design", "--json")[1])
    assert set(content) == {"inputs", "quantities", "design", "assumed"}
    assert {q["source"] for q in content["inputs"]} >= {"Table 2", "Table 3", "Table 4", "Table 5"}
    assert all(q["paper"] == q["computed"] for q in content["inputs"])
    assert content["design"]["gap_mm"] == pytest.approx(0.4026, abs=1e-3)
    assert content["design"]["layers"] == 3


def test_command_with_other_inputs_leaves_the_paper_s_results_out(run):
    arguments = ["damper", "design", "--force-n", 6000, "--velocity-mm-per-s", 120, "--viscosity-pa-s", 0.1]
    out = run(*arguments)[1]
    assert "The inputs are not the paper's" in out
    content = json.loads(run(*arguments, "--json")[1])
    assert all(q["paper"] is None and q["within"] is None for q in content["quantities"])
    computed = {q["name"]: q["computed"] for q in content["quantities"]}
    assert computed["largest force on the pilot's piston"] == pytest.approx(342.857 * 1.2, abs=0.01)
    assert computed["designed: force of the MR device"] == pytest.approx(342.857 * 1.2, abs=0.01)
    assert not [name for name in computed if "as printed" in name]


@pytest.mark.parametrize(
    ("arguments", "pieces", "code"),
    [
        (["--gap-mm", "nan"], ["--gap-mm must be a positive, finite number"], 2),
        (["--current-a", "0"], ["--current-a must be a positive"], 2),
        (["--gap", "1"], ["--gap"], 2),
        (["--rod-diameter-mm", "60"], ["rod_diameter 60 mm must be smaller than piston_diameter"], 2),
        (["--device-rod-mm", "30"], ["rod_diameter 30 mm must be smaller than the bore"], 2),
        (["--bore-mm", "16"], ["coil_diameter 16 mm"], 2),
        (["--minimum-drop-bar", "40"], ["minimum_drop 40 bar must be below the 30.32 bar"], 2),
        (["--current-a", "0.1"], ["no winding of full layers", "raise current"], 2),
        (["--force-n", "90000", "--json"], ["no device with full layers"], 1),
    ],
)
def test_command_refuses_in_one_line(run, arguments, pieces, code):
    refused(run("damper", "design", *arguments), *pieces, code=code)
