"""The hybrid damper's hydraulics: the paper's digits, eq. (9) recomputed, the valve as an independent relief valve, derivatives."""

import derivatives
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from fuzz import cheap
from hypothesis import given
from hypothesis import strategies as st

from railjax.dampers.hardware import hydraulics
from railjax.dampers.hardware.hydraulics import HydraulicDamper, Pilot

DAMPER, PILOT = HydraulicDamper(), Pilot()


def test_sizes_to_the_digits_printed():
    unrounded = hydraulics.size_pilot(DAMPER, PILOT)
    assert f"{unrounded.area * 1e4:.1f}" == "16.5"
    assert f"{unrounded.flow:.2e}" == "1.65e-04"
    assert f"{unrounded.drop / 1e5:.4f}" == "30.3152"  # cut off, not rounded, in the paper: 30.31
    assert f"{unrounded.largest_opening * 1e6:.2f}" == "10.35"  # the paper: 10.36, from the rounded flow
    printed = hydraulics.size_pilot(DAMPER, PILOT, flow=1.65e-4, drop=30.31e5)
    digits = {
        "smallest_opening": (1e6, "3.26"),
        "largest_opening": (1e6, "10.36"),
        "narrowest_stroke": (1e3, "0.54"),
        "widest_stroke": (1e3, "1.73"),
    }
    for name, (factor, text) in digits.items():
        assert f"{float(getattr(printed, name)) * factor:.2f}" == text
    assert [f"{float(f):.0f}" for f in (printed.smallest_force, printed.largest_force)] == ["34", "343"]


def test_sizes_against_numpy():
    damper, pilot = HydraulicDamper(0.06, 0.025, 7000.0, 0.12), Pilot(0.014, 7e-3, 4e5, discharge=0.65, density=860.0)
    area = np.pi * (0.06**2 - 0.025**2) / 4
    flow, drop, piston = area * 0.12, 7000.0 / area, np.pi * 0.014**2 / 4
    openings = [flow / 0.65 / np.sqrt(2 * p / 860.0) for p in (drop, 4e5)]
    expected = [area, flow, drop, *openings, 4e5 * piston, drop * piston, openings[0] / 7e-3, openings[1] / 7e-3]
    found = jax.tree.leaves(hydraulics.size_pilot(damper, pilot))
    np.testing.assert_allclose(np.array(found, float), expected, rtol=1e-9)


def test_sizes_print_themselves():
    text = str(hydraulics.size_pilot(DAMPER, PILOT))
    assert "1649.34 mm^2" in text
    assert "3031.52 kPa" in text
    lanes = hydraulics.size_pilot(HydraulicDamper(force=jnp.array([4000.0, 5000.0])), PILOT)
    assert "274.286 to 342.857 N" in str(lanes)


@cheap(20)
@given(area=st.floats(1e-6, 2e-5), flow=st.floats(1e-5, 1e-3))
def test_orifice_flow_and_drop_are_inverse_and_odd(area, flow):
    drop = hydraulics.orifice_drop(area, flow)
    assert float(hydraulics.orifice_flow(area, drop)) == pytest.approx(flow, rel=1e-4)
    assert float(hydraulics.orifice_flow(area, -drop)) == pytest.approx(-flow, rel=1e-4)
    assert float(hydraulics.orifice_area(flow, drop)) == pytest.approx(area, rel=1e-4)
    assert hydraulics.orifice_drop(area, -flow) == -drop
    assert hydraulics.opening_stroke(hydraulics.opening_area(1e-3, 6e-3), 6e-3) == pytest.approx(1e-3)


def test_eq_9_at_working_pressure_is_exact():
    expected = 0.61 * 5e-6 * np.sqrt(2 * 3e5 / 880.0)
    assert float(hydraulics.orifice_flow(5e-6, 3e5)) == pytest.approx(expected, rel=1e-11)


def test_derivatives_at_zero_flow():
    """F ~ Q|Q| has slope 0, the rounded root a finite one."""
    assert float(jax.grad(lambda q: hydraulics.orifice_drop(5e-6, q))(0.0)) == 0.0
    slope = float(jax.grad(lambda p: hydraulics.orifice_flow(5e-6, p))(0.0))
    assert slope == pytest.approx(0.61 * 5e-6 * np.sqrt(2 / 880.0), rel=1e-9)
    for law in ("sharp", "smooth"):
        for mode in (jax.jacfwd, jax.jacrev):
            found = mode(lambda v, f, law=law: hydraulics.damping_force(DAMPER, PILOT, v, f, law), argnums=(0, 1))(0.0, 0.0)
            assert np.all(np.isfinite(found))


def relief_valve(velocity, mr_force):
    """The same valve, found as a balance: the piston rests where pressure, spring and MR device are in equilibrium."""
    area = np.pi * (0.05**2 - 0.02**2) / 4
    flow = area * abs(velocity)

    def drop(stroke):
        return 440.0 * (flow / (0.61 * 6e-3 * stroke)) ** 2

    def imbalance(stroke):
        return drop(stroke) * np.pi * 0.012**2 / 4 - 34.0 - mr_force

    low, high = 0.54e-3, 2e-3
    if imbalance(low) <= 0:
        stroke = low
    elif imbalance(high) >= 0:
        stroke = high
    else:
        stroke = scipy.optimize.brentq(imbalance, low, high, xtol=1e-15)
    return np.sign(velocity) * area * drop(stroke), stroke


@pytest.mark.parametrize("mr_force", [0.0, 100.0, 308.8])
@pytest.mark.parametrize("velocity", [-0.3, -0.06, -0.01, 0.02, 0.05, 0.1, 0.25])
def test_damping_force_against_a_balance_of_forces(velocity, mr_force):
    force, stroke = relief_valve(velocity, mr_force)
    assert float(hydraulics.damping_force(DAMPER, PILOT, velocity, mr_force)) == pytest.approx(force, rel=1e-8)
    flow = float(hydraulics.active_area(DAMPER)) * velocity
    assert float(hydraulics.pilot_stroke(PILOT, flow, mr_force)) == pytest.approx(stroke, rel=1e-8)
    # the twin differs by its width in the stroke at most, so by twice its share in the force
    twin = float(hydraulics.damping_force(DAMPER, PILOT, velocity, mr_force, "smooth"))
    assert twin == pytest.approx(force, rel=2 * PILOT.stroke_width / 0.54e-3)


def test_the_pilot_reaches_the_passive_damper_s_force():
    drop = DAMPER.force / float(hydraulics.active_area(DAMPER))
    mr_force = hydraulics.mr_force_for(PILOT, drop)
    assert float(hydraulics.held_drop(PILOT, mr_force)) == pytest.approx(drop)
    assert float(hydraulics.damping_force(DAMPER, PILOT, 0.12, mr_force)) == pytest.approx(5000.0, rel=1e-6)


@cheap(20)
@given(velocity=st.floats(0.001, 0.5), mr_force=st.floats(0.0, 400.0), law=st.sampled_from(["sharp", "smooth"]))
def test_force_grows_with_velocity_and_with_the_mr_force(velocity, mr_force, law):
    def force(v, f):
        return float(hydraulics.damping_force(DAMPER, PILOT, v, f, law))

    here = force(velocity, mr_force)
    assert force(-velocity, mr_force) == pytest.approx(-here)
    assert force(1.05 * velocity, mr_force) >= here * (1 - 1e-9)
    assert force(velocity, mr_force + 20.0) >= here * (1 - 1e-9)


@pytest.mark.parametrize(("velocity", "law"), [(0.02, "sharp"), (0.08, "sharp"), (0.3, "sharp"), (0.0646, "smooth")])
def test_derivatives_of_the_damping_force(velocity, law):
    derivatives.check(
        lambda v, f, d, width, drop: (
            1e-3 * hydraulics.damping_force(HydraulicDamper(piston_diameter=d), Pilot(0.012, width, drop), v, 100.0 * f, law)
        ),
        velocity,
        1.0,
        0.05,
        6e-3,
        3e5,
        step=1e-7,
        rtol=1e-5,
        atol=1e-5,
    )


def test_lanes():
    velocities = jnp.linspace(-0.2, 0.2, 5)[:, None]
    mr_forces = jnp.array([0.0, 200.0])
    batch = hydraulics.damping_force(DAMPER, PILOT, velocities, mr_forces)
    assert batch.shape == (5, 2)
    for i, v in enumerate(velocities[:, 0]):
        for j, f in enumerate(mr_forces):
            alone = hydraulics.damping_force(DAMPER, PILOT, float(v), float(f))
            np.testing.assert_allclose(batch[i, j], alone, rtol=1e-12, atol=1e-12)
