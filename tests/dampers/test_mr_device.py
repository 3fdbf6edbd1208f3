"""The MR device: Bingham flow against its exact solution, the circuit against a root search, derivatives, properties."""

import dataclasses

import derivatives
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from fuzz import cheap
from hypothesis import given
from hypothesis import strategies as st

import railjax
from railjax.dampers.hardware import magnetic_circuit as magnetic
from railjax.dampers.hardware import mr_device
from railjax.dampers.hardware.magnetic_circuit import Steel
from railjax.dampers.hardware.mr_device import MrDevice, MrFluid

DEVICE, FLUID, STEEL = MrDevice(), MrFluid(), Steel()
V = 0.015


def test_forces_against_numpy():
    d, rod, h, pole, coil, length = 22e-3, 8e-3, 0.4e-3, 2e-3, 16e-3, 30e-3
    area, w = np.pi * (d**2 - rod**2) / 4, np.pi * (d - h)
    q = area * V
    c = 2.07 + 12 * q * 0.25 / (12 * q * 0.25 + 0.4 * w * h**2 * 44.1e3)
    controlled = c * 44.1e3 * 2 * pole * area / h
    poles = 12 * 0.25 * q * 2 * pole * area / (w * h**3)
    beside = (d - coil) / 2
    viscous = poles + 12 * 0.25 * q * length * area / (np.pi * (d - beside) * beside**3)
    found = mr_device.analyse(DEVICE, FLUID)
    assert float(found.yield_force) == pytest.approx(controlled, rel=1e-12)
    assert float(found.viscous_force) == pytest.approx(viscous, rel=1e-12)
    assert float(found.total_force) == pytest.approx(controlled + viscous, rel=1e-12)
    assert float(found.dynamic_range) == pytest.approx(1 + controlled / viscous, rel=1e-12)
    assert float(found.total_force) == pytest.approx(316.19, abs=0.01)
    assert "dynamic range" in str(found)


def test_friction_and_a_moving_solenoid():
    rubbing = mr_device.analyse(dataclasses.replace(DEVICE, friction=20.0), FLUID)
    still = mr_device.analyse(DEVICE, FLUID)
    assert float(rubbing.total_force - still.total_force) == pytest.approx(20.0)
    assert float(rubbing.dynamic_range) == pytest.approx(1 + float(still.yield_force) / (float(still.viscous_force) + 20.0))
    moving = dataclasses.replace(DEVICE, moving=True)
    area = np.pi * (21.2e-3**2 - 8e-3**2) / 4
    assert float(mr_device.piston_area(moving)) == pytest.approx(area, rel=1e-12)
    q, w, h = area * V, np.pi * 21.6e-3, 0.4e-3
    textbook = (1 + w * h * V / (2 * q)) * 12 * 0.25 * q * 4e-3 * area / (w * h**3)
    found = mr_device.viscous_force(0.25, q, 4e-3, area, w, h, V)
    assert found == pytest.approx(textbook, rel=1e-12)
    assert float(mr_device.analyse(moving, FLUID).viscous_force) > textbook


@pytest.mark.parametrize("stiffness", [0.5, 2.0, 10.0, 35.0, 300.0])
def test_plate_coefficient_against_the_exact_bingham_flow(stiffness):
    """Plane Bingham flow with T = w h² τ/(12 Q η), P = w h³ Δp/(12 Q η L): P³ - (1 + 3 T) P² + 4 T³ = 0, the root above 2 T
    (the plug, 2 T/P of the gap, is thinner than the gap)."""
    roots = np.roots([1.0, -(1 + 3 * stiffness), 0.0, 4 * stiffness**3])
    exact = max(roots.real[np.abs(roots.imag) < 1e-9])
    assert exact > 2 * stiffness
    w, h, q, eta = 0.07, 0.4e-3, 5e-6, 0.25
    tau = stiffness * 12 * q * eta / (w * h**2)
    area, length = 3e-4, 4e-3
    c = mr_device.plate_coefficient(tau, q, eta, w, h)
    force = mr_device.yield_force(tau, length, area, h, c) + mr_device.viscous_force(eta, q, length, area, w, h)
    newtonian = mr_device.viscous_force(eta, q, length, area, w, h)
    assert force / newtonian == pytest.approx(exact, rel=0.02)


@cheap(20)
@given(gap=st.floats(0.2e-3, 0.8e-3), pole=st.floats(1e-3, 6e-3), velocity=st.floats(1e-3, 0.1), stress=st.floats(1e4, 6e4))
def test_least_volume_is_the_active_one_and_forces_are_monotonic(gap, pole, velocity, stress):
    device = dataclasses.replace(DEVICE, gap=gap, pole_width=pole)
    here = mr_device.analyse(device, FLUID, velocity, stress)
    # one gap under one field wastes no fluid: Lord's bound is met with equality
    assert float(here.minimum_volume) == pytest.approx(float(here.active_volume), rel=1e-9)
    wider = mr_device.analyse(dataclasses.replace(device, gap=1.02 * gap), FLUID, velocity, stress)
    assert float(wider.total_force) < float(here.total_force)
    assert float(wider.dynamic_range) > float(here.dynamic_range)
    for change in ({"pole_width": 1.02 * pole}, {"rod_diameter": 7.8e-3}):
        assert float(mr_device.total_force(dataclasses.replace(device, **change), FLUID, velocity, stress)) > here.total_force
    assert float(mr_device.total_force(device, FLUID, 1.02 * velocity, stress)) > here.total_force
    assert float(mr_device.total_force(device, FLUID, velocity, 1.02 * stress)) > here.total_force


def test_derivatives_of_the_forces():
    derivatives.check(
        lambda h, pole, v, tau: mr_device.total_force(
            dataclasses.replace(DEVICE, gap=1e-3 * h, pole_width=1e-3 * pole), FLUID, 0.01 * v, 1e4 * tau
        ),
        0.4,
        2.0,
        1.5,
        4.41,
        rtol=1e-6,
    )
    slopes = jax.jacrev(lambda v, tau: mr_device.total_force(DEVICE, FLUID, v, tau), argnums=(0, 1))(0.0, 0.0)
    assert np.all(np.isfinite(slopes))


def test_curves():
    assert float(magnetic.carlson_yield_stress(250e3, 0.32)) == pytest.approx(
        271700 * 0.32**1.5239 * np.tanh(6.33e-6 * 250e3), rel=1e-12
    )
    assert float(magnetic.yield_stress(FLUID, 250e3)) == pytest.approx(44.1e3, rel=1e-12)
    assert float(magnetic.yield_stress(FLUID, 0.0)) == 0.0
    mu_0 = 4e-7 * np.pi
    expected = 1.91 * 0.32**1.133 * (1 - np.exp(-10.97 * mu_0 * 1e5)) + mu_0 * 1e5
    assert float(magnetic.fluid_density(FLUID, 1e5)) == pytest.approx(expected, rel=1e-12)
    for density in (0.0, 1e-6, 0.5, 1.5, 1.95, 2.4):
        h = float(magnetic.steel_field(STEEL, density))
        assert mu_0 * h + 1.95 * h / (h + 350.0) == pytest.approx(density, rel=1e-10, abs=1e-15)


def test_circuit_against_a_root_search():
    """Ampère's law with the flux as the unknown, each part by SciPy."""
    mu_0 = 4e-7 * np.pi
    d, h, pole, core, case, coil = 22e-3, 0.4e-3, 2e-3, 12.4e-3, 26e-3, 30e-3
    face = d - 2 * h

    def steel(b):
        return scipy.optimize.brentq(lambda x: mu_0 * x + 1.95 * x / (x + 350.0) - b, 0.0, 1e7, xtol=1e-9)

    def fluid(b):
        return scipy.optimize.brentq(
            lambda x: 1.91 * 0.32**1.133 * (1 - np.exp(-10.97 * mu_0 * x)) + mu_0 * x - b, 0.0, 1e7, xtol=1e-9
        )

    def ampere_turns(flux):
        return (
            2 * h * fluid(flux / (np.pi * (d - h) * pole))
            + (coil + pole) * steel(flux / (np.pi * core**2 / 4))
            + (coil + pole) * steel(flux / (np.pi * (case**2 - d**2) / 4))
            + 2 * (face - core) / 2 * steel(flux / (np.pi * (face + core) / 2 * pole))
        )

    for current in (0.3, 1.5, 3.0):
        flux = scipy.optimize.brentq(lambda x, i=current: ampere_turns(x) - 150.0 * i, 1e-9, 2.5e-4)
        expected = fluid(flux / (np.pi * (d - h) * pole))
        found = float(magnetic.gap_field(DEVICE, FLUID, STEEL, current))
        assert found == pytest.approx(expected, rel=1e-7)
        state = magnetic.circuit(DEVICE, FLUID, STEEL, found)
        assert float(state.flux) == pytest.approx(flux, rel=1e-7)
        assert float(state.ampere_turns) == pytest.approx(150.0 * current, rel=1e-9)
    assert "flux density in the core" in str(state)


def test_a_bored_core_carries_less():
    bored = dataclasses.replace(DEVICE, core_bore=8e-3)
    assert float(magnetic.gap_field(bored, FLUID, STEEL, 1.5)) < float(magnetic.gap_field(DEVICE, FLUID, STEEL, 1.5))


def test_field_grows_with_current_and_turns_and_starts_at_zero():
    field = jax.jit(jax.vmap(lambda i, n: magnetic.gap_field(dataclasses.replace(DEVICE, turns=n), FLUID, STEEL, i)))
    currents = jnp.linspace(0.0, 4.0, 21)
    few, many = field(currents, jnp.full(21, 140.0)), field(currents, jnp.full(21, 150.0))
    assert abs(float(few[0])) < 1.0
    assert np.all(np.diff(few) > 0)
    assert np.all(np.asarray(many[1:]) > np.asarray(few[1:]))
    forces = jax.vmap(lambda i: magnetic.force_of_current(DEVICE, FLUID, STEEL, i, V))(currents)
    assert np.all(np.diff(forces) > 0)
    np.testing.assert_allclose(forces[0], mr_device.analyse(DEVICE, FLUID, V, 0.0).viscous_force, rtol=1e-3)


def test_derivatives_through_the_circuit():
    derivatives.check(
        lambda i, h, j: magnetic.force_of_current(dataclasses.replace(DEVICE, gap=1e-3 * h), FLUID, Steel(saturation=j), i),
        1.5,
        0.4,
        1.95,
        step=1e-5,
        rtol=1e-5,
    )
    assert np.isfinite(jax.grad(lambda i: magnetic.force_of_current(DEVICE, FLUID, STEEL, i))(0.0))


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"rod_diameter": 23e-3}, "rod_diameter 23 mm"),
        ({"gap": 4e-3}, "coil_diameter 16 mm must be smaller than the poles' diameter"),
        ({"core_diameter": 17e-3}, "core_diameter 17 mm"),
        ({"core_bore": 12.4e-3}, "core_bore 12.4 mm"),
        ({"case_diameter": 21e-3}, "bore 22 mm must be smaller than case_diameter, 21 mm"),
    ],
)
def test_parts_that_do_not_fit_are_named(change, named):
    mr_device.check(DEVICE)
    with pytest.raises(railjax.InputError, match=named) as caught:
        mr_device.check(dataclasses.replace(DEVICE, **change))
    assert len(str(caught.value).splitlines()) == 1


def test_turns_of_a_layer():
    assert magnetic.turns_per_layer(DEVICE) == 50
    assert magnetic.turns_per_layer(dataclasses.replace(DEVICE, wire_diameter=0.7e-3)) == 42
    with pytest.raises(railjax.InputError, match="wire_diameter 31 mm"):
        magnetic.turns_per_layer(dataclasses.replace(DEVICE, wire_diameter=31e-3))
