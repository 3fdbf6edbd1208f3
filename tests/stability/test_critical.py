"""Nonlinear critical speed: numbers, derivatives, batches, codes. Orbits themselves: tests/stability/test_hunting.py."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import TypeCheckError

import railjax
from railjax import Hunting
from railjax.model.motion import PASSIVE
from railjax.stability.hunting import fold_search, settling
from railjax.stability.hunting.fold_search import KnownFolds
from railjax.stability.hunting.nonlinear_critical import found_beside

CHECKED = [path for path, _ in railjax.parameters() if path.startswith(("primary.", "secondary."))] + [
    "contact.friction",
    "contact.conicity",
    "contact.flange_stiffness",
    "contact.flange_clearance",
    "contact.wheel_load",
    "bogie.yaw_inertia",
    "wheelset.mass",
    "geometry.half_wheelbase",
]


@functools.cache
def load(name):
    return railjax.load_vehicle(name)


def kmh(speed):
    return float(speed) * 3.6


@pytest.mark.parametrize(
    ("name", "linear", "fold", "amplitude", "frequency"),
    [
        ("coach", 245.600, 234.200, 9.000, 5.155),
        ("cooperrider-bogie", 247.120, 239.989, 9.354, 3.800),
        ("single-wheelset", 117.9212, 117.9060, 8.282, 2.837),
    ],
)
def test_folds_of_packaged_vehicles(name, linear, fold, amplitude, frequency):
    """The coach's are the calibration's targets; the others are regressions, narrow against linear minus fold."""
    found = railjax.nonlinear_critical(load(name))
    assert Hunting(int(found.code)) == Hunting.OK
    assert kmh(found.linear.speed) == pytest.approx(linear, abs=1e-3)
    assert kmh(found.speed) == pytest.approx(fold, abs=1e-3)
    assert float(found.amplitude) * 1e3 == pytest.approx(amplitude, abs=2e-3)
    assert float(found.frequency) == pytest.approx(frequency, abs=2e-3)
    assert kmh(found.speed) < kmh(found.linear.speed) - 0.01
    # the fold of a hunting branch lies where the flange begins to act
    assert abs(float(found.amplitude) / float(load(name).contact.flange_clearance) - 1.0) < 0.1


def test_above_the_fold_a_large_disturbance_hunts_and_below_it_dies():
    """By simulation, which knows nothing of folds; Cooperrider's bogie, whose branch is wide."""
    bogie = load("cooperrider-bogie")
    fold = float(railjax.nonlinear_critical_speed(bogie))
    bump = railjax.BumpTrack(9.5e-3, 8.0)
    speeds = jnp.array([0.985, 1.015]) * fold
    run = railjax.simulate(bogie, speeds, track=bump, duration=60.0, record=["wheelset_y"], sample=0.01)
    late = np.abs(np.asarray(run["wheelset_y"])[-500:]).max(axis=(0, 1))
    assert late[0] < 1e-4
    assert late[1] > 8e-3


#: derivatives are those of the flow in as many steps as it is computed with, be they few
FEW = 100
#: checked in forward mode too
FORWARD = ["primary.stiffness_x", "secondary.damping_y", "contact.friction", "contact.flange_clearance"]
#: steps of the differences for parameters that are zero in the coach
STEPS_FROM_ZERO = {"secondary.anti_roll_stiffness": 1e4, "primary.damping_y": 20.0}


@functools.cache
def reverse():
    return jax.grad(lambda vehicle: railjax.nonlinear_critical_speed(vehicle, steps=FEW))(load("coach"))


def test_gradient_against_central_differences():
    """One batch for all: a test per parameter would have each worker compute it."""
    coach = load("coach")
    vehicle, steps = coach, {}
    for row, path in enumerate(CHECKED):
        value = float(railjax.get_parameter(coach, path))
        steps[path] = 1e-3 * value or STEPS_FROM_ZERO.get(path, 500.0)
        moved = np.zeros((len(CHECKED), 2))
        moved[row] = steps[path], -steps[path]
        vehicle = railjax.set_parameter(vehicle, path, jnp.asarray(value + moved.ravel()))
    speeds = np.asarray(railjax.nonlinear_critical(vehicle, steps=FEW).speed).reshape(len(CHECKED), 2)
    differences = {path: (up - down) / (2 * steps[path]) for path, (up, down) in zip(CHECKED, speeds, strict=True)}
    exact = {path: float(railjax.get_parameter(reverse(), path)) for path in CHECKED}
    assert exact == pytest.approx(differences, rel=1e-4)


def test_forward_mode_equals_reverse_mode():
    coach = load("coach")

    def of_some(values):
        vehicle = coach
        for path, value in zip(FORWARD, values, strict=True):
            vehicle = railjax.set_parameter(vehicle, path, value)
        return railjax.nonlinear_critical_speed(vehicle, steps=FEW)

    forward = jax.jacfwd(of_some)([float(railjax.get_parameter(coach, path)) for path in FORWARD])
    for path, one in zip(FORWARD, forward, strict=True):
        assert float(one) == pytest.approx(float(railjax.get_parameter(reverse(), path)), rel=1e-8)


def test_twice_the_steps_give_the_same_fold():
    once, twice = (kmh(railjax.nonlinear_critical_speed(load("coach"), steps=steps)) for steps in (200, 400))
    assert abs(once - twice) < 1e-4


def test_a_batch_equals_single_calls_and_marks_the_lane_that_fails():
    bogie = load("cooperrider-bogie")
    scale_x, scale_y = np.array([0.8, 0.9, 1.0, 1.1] * 2), np.repeat([0.9, 1.2], 4)
    mass = np.full(8, float(bogie.wheelset.mass))
    mass[5] = np.nan
    variants = railjax.replace(
        bogie,
        primary__stiffness_x=bogie.primary.stiffness_x * jnp.asarray(scale_x),
        primary__stiffness_y=bogie.primary.stiffness_y * jnp.asarray(scale_y),
        wheelset__mass=jnp.asarray(mass),
    )
    found = railjax.nonlinear_critical(variants, steps=FEW)
    codes = [Hunting(int(code)) for code in found.code]
    assert codes == [Hunting.FAILED if k == 5 else Hunting.OK for k in range(8)]
    assert np.isnan(float(found.speed[5]))
    assert np.isnan(float(found.amplitude[5]))
    for k in (0, 3, 6):
        alone = railjax.replace(
            bogie,
            primary__stiffness_x=float(bogie.primary.stiffness_x * scale_x[k]),
            primary__stiffness_y=float(bogie.primary.stiffness_y * scale_y[k]),
        )
        single = railjax.nonlinear_critical(alone, steps=FEW)
        assert float(found.speed[k]) == pytest.approx(float(single.speed), rel=1e-8)
        assert float(found.amplitude[k]) == pytest.approx(float(single.amplitude), rel=1e-4)


def test_supercritical_gives_the_linear_critical_speed():
    """A small clearance, whose flange stops the motion before creep saturates: just above the Hopf point the motion is small."""
    tight = railjax.replace(load("single-wheelset"), contact__flange_clearance=1e-3)
    found = railjax.nonlinear_critical(tight)
    assert Hunting(int(found.code)) == Hunting.SUPERCRITICAL
    assert float(found.speed) == float(found.linear.speed)
    assert float(found.amplitude) == 0.0
    assert float(railjax.nonlinear_critical_speed(tight)) == float(found.linear.speed)


def test_bogies_that_hunt_at_two_frequencies():
    """A soft secondary damper hardly couples the bogies: no limit cycle 2 % above the Hopf point, one of a single bogie below. Simulated
    from a large disturbance in steps of 1 km/h, the coach hunts from 228 km/h on."""
    found = railjax.nonlinear_critical(railjax.replace(load("coach"), secondary__damping_y=6e3))
    assert Hunting(int(found.code)) == Hunting.OK
    assert kmh(found.linear.speed) == pytest.approx(236.459, abs=1e-3)
    # the leading bogie alone ends at 227.678, the trailing one at 227.681: folds so near each other count as one
    assert kmh(found.speed) == pytest.approx(227.6795, abs=3e-3)


def test_no_nonlinear_critical_speed_is_said():
    wheelset = load("single-wheelset")
    stable = railjax.replace(wheelset, contact__conicity=1e-4)
    found = railjax.nonlinear_critical(stable)
    assert Hunting(int(found.code)) == Hunting.STABLE
    assert float(found.speed) == np.inf
    with pytest.raises(railjax.NumericalError, match="stable and no limit cycle was found up to 540 km/h"):
        railjax.nonlinear_critical_speed(stable)
    # the fastest motion is that on the closed flange
    hard = railjax.replace(wheelset, contact__flange_stiffness=1.46e9)
    assert Hunting(int(railjax.nonlinear_critical(hard, steps=30).code)) == Hunting.STEP_TOO_LARGE
    with pytest.raises(railjax.NumericalError, match="more steps"):
        railjax.nonlinear_critical_speed(hard, steps=30)
    with pytest.raises(railjax.InputError, match="wheelset must lie between 0 and 0"):
        railjax.nonlinear_critical(wheelset, wheelset=1)


def test_vmap_and_lanes_within_it():
    """`vmap` gathers its lanes into one batch, also around a vehicle that has lanes already; and derivatives by lanes."""
    wheelset = load("single-wheelset")

    def speed(friction, mass=wheelset.wheelset.mass):
        return railjax.nonlinear_critical_speed(
            railjax.replace(wheelset, contact__friction=friction, wheelset__mass=mass), steps=FEW
        )

    frictions, masses = jnp.array([0.3, 0.1]), wheelset.wheelset.mass * jnp.array([1.0, 1.1])
    alone = float(railjax.nonlinear_critical_speed(wheelset, steps=FEW))
    many = jax.vmap(speed)(frictions)
    assert many.shape == (2,)
    assert float(many[0]) == pytest.approx(alone, rel=1e-9)
    assert float(many[1]) < alone
    both = jax.vmap(lambda friction: speed(friction, masses))(frictions)
    assert both.shape == (2, 2)
    np.testing.assert_allclose(both[:, 0], many, rtol=1e-9)
    assert float(both[1, 1]) == pytest.approx(float(speed(0.1, float(masses[1]))), rel=1e-9)
    slopes = jax.vmap(jax.grad(speed))(frictions)
    numeric = (speed(frictions + 1e-5) - speed(frictions - 1e-5)) / 2e-5
    np.testing.assert_allclose(slopes, numeric, rtol=1e-4)
    summed = jax.grad(lambda frictions: jnp.sum(speed(frictions)))(frictions)
    np.testing.assert_allclose(summed, slopes, rtol=1e-8)


def test_inside_of_jit_it_says_what_to_call_instead():
    wheelset = load("single-wheelset")
    with pytest.raises(railjax.InputError, match=r"call it outside of jax\.jit.*jax\.grad"):
        jax.jit(lambda mass: railjax.nonlinear_critical_speed(railjax.replace(wheelset, wheelset__mass=mass)))(1000.0)
    with pytest.raises(NotImplementedError, match="second derivatives"):
        jax.grad(jax.grad(lambda mass: railjax.nonlinear_critical_speed(railjax.replace(wheelset, wheelset__mass=mass))))(1000.0)


def test_smooth_twin_lies_near_the_sharp_law():
    """Creep rounded at zero and the flange's corner within 0.1 mm: both soften the contact a little."""
    smooth = railjax.replace(load("coach"), contact__law="smooth")
    found = railjax.nonlinear_critical(smooth)
    assert Hunting(int(found.code)) == Hunting.OK
    assert kmh(found.speed) == pytest.approx(234.2, abs=1.0)
    assert float(found.amplitude) * 1e3 == pytest.approx(9.0, abs=0.1)


def test_single_precision_is_refused():
    with jax.enable_x64(False), pytest.raises(railjax.InputError, match="double precision"):
        railjax.nonlinear_critical(load("single-wheelset"))


def test_annotations_are_checked():
    with pytest.raises(TypeCheckError):
        railjax.stability.hunting.orbits.rounded("coach")


def test_trials_of_an_optimiser_take_their_folds_from_their_neighbours(monkeypatch):
    """Each is what a search from nothing finds; the same vehicle again is no search at all."""
    wheelset, known, rounds = load("single-wheelset"), KnownFolds(), []
    monkeypatch.setattr(fold_search, "drawn", lambda *given: rounds.append(len(given[1])) or settling.drawn(*given))
    counts = []
    for friction in (0.3, 0.27, 0.3):
        trial = railjax.replace(wheelset, contact__friction=friction)
        rounds.clear()
        beside = found_beside(known, trial, PASSIVE, steps=FEW)
        counts.append(len(rounds))
        alone = railjax.nonlinear_critical(trial, steps=FEW)
        assert float(beside.speed) == pytest.approx(float(alone.speed), rel=1e-9)
        assert float(beside.amplitude) == pytest.approx(float(alone.amplitude), rel=1e-5)
    # from nothing: motions about the Hopf point, then about the fold; from the neighbour: only the latter
    assert counts == [2, 1, 0]
