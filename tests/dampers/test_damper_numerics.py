"""Numerics of the dampers: observed order in dt, a gradient through a run."""

import dataclasses

import jax
import jax.numpy as jnp
import laws
import numpy as np
import pytest
from laws import ALL, K

import railjax
from railjax.model.parameters import without_labels
from railjax.simulation.simulate import initial_state

START = {"wheelset_y": [6e-3, 5e-3, -4e-3, 3e-3], "bogie_psi": [1e-3, -1e-3], "carbody_y": 5e-3}


def errors_of(vehicle, damper, counts, fine):
    """Of the coordinates and their rates after 0.3 s, by number of steps."""
    x = initial_state(vehicle, damper, START)
    exact = laws.final(vehicle, damper, x, 0.3, fine)
    weight = jnp.concatenate([jnp.full(17, 50.0), jnp.ones(17)])
    return [float(jnp.linalg.norm((laws.final(vehicle, damper, x, 0.3, int(n)) - exact)[:34] * weight)) for n in counts]


def observed_order(counts, errors):
    return -np.polyfit(np.log(counts), np.log(errors), 1)[0]


@pytest.fixture(scope="module")
def linear(coach):
    return without_labels(railjax.replace(coach, contact__law="linear"))


@pytest.mark.parametrize("name", [name for name in ALL if name != "bouc-wen"])
def test_held_decisions_are_of_first_order(linear, name):
    """Of decisions at every step: up to one late, by chance, so that the order shows over a decade of steps."""
    damper = dataclasses.replace(ALL[name], sample_time=None)
    counts = np.round(np.geomspace(200, 2000, 9)).astype(int)
    assert 0.6 < observed_order(counts, errors_of(linear, damper, counts, 40_000)) < 1.7


@pytest.mark.parametrize(("name", "order"), [(name, 3.0 if name == "hybrid" else 4.0) for name in ALL if name != "bouc-wen"])
def test_smooth_twins_are_of_fourth_order(linear, name, order):
    """With widths that the steps resolve; the orifice's v |v| leaves the hybrid damper a jump in the second derivative."""
    wide = {"velocity_width": 0.1} | ({"travel_width": 5e-3} if name == "hybrid" else {"signal_width": 1.0})
    damper = dataclasses.replace(ALL[name], law="smooth", **wide)
    if name == "hybrid":  # the stroke's own corners
        damper = dataclasses.replace(damper, pilot=dataclasses.replace(damper.pilot, stroke_width=2e-4))
    counts = np.array([150, 212, 300, 424])
    assert observed_order(counts, errors_of(linear, damper, counts, 4000)) == pytest.approx(order, abs=0.4)


def test_the_maxwell_damper_is_of_fourth_order(linear):
    counts = np.array([150, 212, 300, 424])
    damper = railjax.MaxwellDamper(25e3, 5e6)
    assert observed_order(counts, errors_of(linear, damper, counts, 4000)) == pytest.approx(4.0, abs=0.3)


def test_gradient_through_a_run(smooth):
    """With respect to gain, stiffness and lag: reverse mode against differences."""
    track = railjax.SinusoidTrack(3e-3, 20.0)

    @jax.jit
    def both(values):
        def objective(values):
            alpha, stiffness, lag = values
            vehicle = railjax.replace(smooth, secondary__stiffness_y=stiffness)
            damper = railjax.BalanceLogic(alpha, sensor_lag=lag, law="smooth")
            reduce = ["rms:carbody_acceleration"]
            run = railjax.simulate(vehicle, 50.0, track=track, damper=damper, duration=0.3, record=[], sample=0.1, reduce=reduce)
            return run["rms:carbody_acceleration"]

        return jax.value_and_grad(objective)(values)

    values = jnp.array([0.6, K, 5e-3])
    reverse = both(values)[1]
    for k, value in enumerate(values):
        h = 1e-5 * float(value)
        numeric = (float(both(values.at[k].add(h))[0]) - float(both(values.at[k].add(-h))[0])) / (2 * h)
        assert float(reverse[k]) == pytest.approx(numeric, rel=1e-4)
