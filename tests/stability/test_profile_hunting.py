"""Limit cycles on profiles: against long runs, with unequal wheels too; their folds' derivatives by the table, and a critical speed's by gauge."""

import dataclasses

import jax
import numpy as np
import pytest

import railjax
from railjax import with_profiles
from railjax.model.parameters import bare
from railjax.stability.hunting.adjoint import along, weighted
from railjax.stability.hunting.orbits import Model, Orbit, Shooting, pack, rounded

#: unequal wheels of a lone wheelset, m
UNEQUAL = (0.4501, 0.4499)


@pytest.fixture(scope="module")
def wheelset():
    return railjax.load_vehicle("single-wheelset")


@pytest.fixture(scope="module")
def narrow(wheelset):
    """On a narrow gauge the conicity falls with amplitude before it rises: limit cycles below the linear critical speed."""
    return with_profiles(wheelset, gauge=1.43)


@pytest.fixture(scope="module")
def unequal(wheelset):
    return with_profiles(wheelset, gauge=1.43, radius=UNEQUAL)


def test_limit_cycles_are_what_long_runs_end_on(unequal):
    """Of wheels that are not alike: by the whole period, about another middle."""
    branch = railjax.hunting_branch(unequal)
    assert not branch.shooting.symmetric
    assert 0.85 < branch.fold.speed / branch.hopf.speed < 0.95
    stable = [cycle for piece in branch.pieces for cycle in piece if cycle.stable and cycle.amplitude > 3e-3]
    for cycle in (stable[0], stable[-1]):
        run = railjax.simulate(
            unequal, cycle.speed, duration=10.0, dt=5e-4, sample=1e-3, initial=np.asarray(cycle.state), record=("wheelset_y",)
        )
        y = np.asarray(run["wheelset_y"])[-2000:, 0]
        assert np.max(np.abs(y)) == pytest.approx(cycle.amplitude, rel=1e-3)
        assert abs(0.5 * (np.max(y) + np.min(y))) > 0.1e-3


def test_derivative_of_the_fold_by_the_table(wheelset, narrow, unequal):
    """Of a symmetric orbit from half a period, of another from the whole one, towards the table of another gauge."""
    for vehicle, radius in ((narrow, None), (unequal, UNEQUAL)):
        plain, other = (
            dataclasses.replace(one, profiles=dataclasses.replace(one.profiles, given=()))
            for one in (vehicle, with_profiles(wheelset, gauge=1.4302, radius=radius))
        )

        def speed(share, plain=plain, other=other):
            return railjax.nonlinear_critical_speed(jax.tree.map(lambda a, b: a + share * (b - a), plain, other))

        difference = (float(speed(1e-3)) - float(speed(-1e-3))) / 2e-3
        assert float(jax.grad(speed)(0.0)) == pytest.approx(difference, rel=1e-4)


def test_derivatives_of_a_section_of_four_wheelsets_forwards_and_backwards(coach):
    """The discrete adjoint against the derivative along one direction, towards another gauge and softer springs."""
    vehicle, other = (with_profiles(coach, gauge=gauge) for gauge in (1.435, 1.434))
    other = dataclasses.replace(
        railjax.replace(other, primary__stiffness_x=0.9 * coach.primary.stiffness_x),
        profiles=dataclasses.replace(other.profiles, given=vehicle.profiles.given),
    )
    model, changed = (Model(*bare(rounded(one), railjax.PassiveDamper())) for one in (vehicle, other))
    shooting, rng = Shooting(16, 0, False), np.random.default_rng(3)
    state = np.concatenate([1e-3 * rng.normal(size=17), 1e-2 * rng.normal(size=17)])
    unknowns, weights = pack(model, shooting, Orbit(state, 0.05, 50.0)), rng.normal(size=34)
    change = changed.numbers - model.numbers
    expected = weights @ along(model, shooting, unknowns, change)
    np.testing.assert_allclose(weighted(model, shooting, unknowns, weights) @ change, expected, rtol=1e-9)


def test_derivatives_by_gauge_inclination_and_radii(wheelset):
    """Through the contact geometry and the table, along one direction of all of them."""

    def speed(step):
        vehicle = with_profiles(
            wheelset,
            gauge=1.43 + 1e-3 * step,
            inclination=1 / 40 + 1e-3 * step,
            radius=(0.4501 + 1e-5 * step, 0.4499 - 1e-5 * step),
        )
        return railjax.linear_critical_speed(vehicle)

    difference = (float(speed(1e-3)) - float(speed(-1e-3))) / 2e-3
    assert float(jax.jvp(speed, (0.0,), (1.0,))[1]) == pytest.approx(difference, rel=1e-4)
