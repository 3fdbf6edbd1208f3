"""Force laws written outside the package work wherever its own do: simulate, hunting, sweep, tune; under jit, vmap and grad.

Two laws: one without memory, a valve with an orifice, and one with an internal state, a frequency-selective damper.
"""

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import railjax
from railjax import objectives as aim
from railjax.model.damper import check_damper

SPEED = 180 / 3.6
TRACK = railjax.SinusoidTrack(amplitude=5e-3, wavelength=20.0)
RMS = "rms:carbody_acceleration"


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class OrificeDamper:
    """Leakage c and a turbulent orifice k in parallel, per side: F = 2 (c + k |v|) v."""

    leakage: Any = 5e3  # N s/m
    orifice: Any = 300e3  # N s^2/m^2

    internal_states: ClassVar[int] = 0

    def force(self, vehicle, travel, velocity, internal):
        return 2.0 * (self.leakage + self.orifice * jnp.abs(velocity)) * velocity, internal


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SelectiveDamper:
    """Hard to slow motion and soft to fast: F = 2 (c_fast v + (c_slow - c_fast) s), lag s' = v - s."""

    slow: Any = 40e3  # N s/m
    fast: Any = 10e3  # N s/m
    lag: Any = 0.05  # s

    internal_states: ClassVar[int] = 1

    def force(self, vehicle, travel, velocity, internal):
        force = 2.0 * (self.fast * velocity + (self.slow - self.fast) * internal[0])
        return force, (velocity - internal) / self.lag


LAWS = [OrificeDamper(), SelectiveDamper()]
by_law = pytest.mark.parametrize("damper", LAWS, ids=["orifice", "selective"])


def run(vehicle, damper, **options):
    options = {"track": TRACK, "duration": 3.0, "settle": 1.0, "record": (), "reduce": (RMS,)} | options
    return railjax.simulate(vehicle, SPEED, damper=damper, **options)[RMS]


@by_law
def test_simulation_is_that_of_scipy(coach, damper):
    """The linear vehicle without lateral dampers from its state matrix, eq. (7) by hand, the law in NumPy, SciPy's integrator."""
    linear = railjax.replace(coach, contact__law="linear")
    bare = np.asarray(railjax.state_matrix(linear, SPEED, railjax.PassiveDamper(0.0)))
    mass = np.diag(np.asarray(railjax.matrices(linear, SPEED).mass))
    g = coach.geometry
    travel = np.zeros((2, 17))  # q: carbody y, psi, phi; bogies y (2), psi (2), phi (2); wheelsets
    for j, ahead in enumerate((1.0, -1.0)):
        travel[j, [0, 1, 2]] = 1.0, ahead * g.half_pivot_distance, g.carbody_height
        travel[j, [3 + j, 7 + j]] = -1.0, g.bogie_to_secondary

    def rate(_, x):
        q, s = x[:34], x[34:]
        v = travel @ q[17:]
        if isinstance(damper, OrificeDamper):
            force, s_rate = 2 * (5e3 * v + 300e3 * v * np.abs(v)), s
        else:
            force, s_rate = 2 * (10e3 * v + 30e3 * s), (v - s) / 0.05
        return np.concatenate([bare @ q + np.concatenate([np.zeros(17), -(travel.T @ force) / mass]), s_rate])

    start = np.zeros(34 + 2 * damper.internal_states)
    start[[17, 20, 22]] = 0.3, 0.5, 0.5  # m/s
    expected = solve_ivp(rate, (0.0, 1.5), start, rtol=1e-9, atol=1e-11).y[:, -1]
    found = railjax.simulate(linear, SPEED, damper=damper, duration=1.5, dt=5e-4, initial=jnp.asarray(start), record=())
    np.testing.assert_allclose(found.final, expected, rtol=1e-5, atol=1e-8)


def test_jit_vmap_lanes_and_gradient_of_a_run():
    bogie, name = railjax.load_vehicle("cooperrider-bogie"), "rms:bogie_y_acceleration"
    values = 300e3 * jnp.array([0.5, 1.0 - 1e-3, 1.0, 1.0 + 1e-3])

    def of(value):
        options = {"track": TRACK, "duration": 2.0, "settle": 1.0, "record": (), "reduce": (name,)}
        return railjax.simulate(bogie, SPEED, damper=OrificeDamper(orifice=value), **options)[name][0]

    lanes = of(values)
    np.testing.assert_allclose(jax.jit(jax.vmap(of))(values), lanes, rtol=1e-9)
    value, slope = jax.value_and_grad(of)(300e3)
    assert float(value) == pytest.approx(float(lanes[2]), rel=1e-9)
    assert float(slope) == pytest.approx(float(lanes[3] - lanes[1]) / 600.0, rel=1e-4)
    assert abs(float(lanes[0] / lanes[2]) - 1.0) > 0.01


def test_limit_cycles_are_those_of_the_simulation():
    """An orbit of the branch, set free in `simulate`, is after one period where it was; the fold moves with the law as its implicit
    derivative says."""
    bogie, damper = railjax.load_vehicle("cooperrider-bogie"), OrificeDamper(25e3, 20e3)
    branch, *beside = (railjax.hunting_branch(bogie, damper=replace(damper, orifice=k)) for k in (20e3, 19e3, 21e3))
    plain = railjax.linear_critical_speed(bogie, damper=railjax.PassiveDamper(25e3))
    assert float(branch.hopf.speed) == pytest.approx(float(plain), rel=1e-9)  # at rest the orifice does nothing
    cycle = branch.at(1.02 * float(branch.hopf.speed), stable=True)
    period, steps = 1.0 / cycle.frequency, 2 * branch.shooting.steps
    free = railjax.simulate(
        bogie, cycle.speed, damper=damper, duration=period, dt=period / steps, initial=jnp.asarray(cycle.state), record=()
    )
    np.testing.assert_allclose(free.final, cycle.state, atol=1e-3 * float(np.max(np.abs(cycle.state))))
    value, slope = jax.value_and_grad(
        lambda k: railjax.nonlinear_critical_speed(bogie, damper=OrificeDamper(25e3, k), steps=branch.shooting.steps)
    )(20e3)
    low, high = (one.fold.speed for one in beside)
    assert float(value) == pytest.approx(branch.fold.speed, abs=1e-3)
    assert float(slope) == pytest.approx((high - low) / 2e3, rel=1e-2)
    assert abs(float(slope)) * 20e3 > 0.01  # m/s


def test_linear_law_with_a_state_has_the_critical_speed_of_its_limits(coach):
    """lag to zero: c_slow at all frequencies; lag to infinity: c_fast."""
    lags = jnp.array([1e-5, 0.05 - 1e-6, 0.05 + 1e-6, 1e4])
    found = railjax.linear_critical(coach, damper=SelectiveDamper(lag=lags)).speed
    ends = [railjax.linear_critical_speed(coach, damper=railjax.PassiveDamper(c)) for c in (40e3, 10e3)]
    np.testing.assert_allclose(found[jnp.array([0, 3])], ends, rtol=1e-4)
    slope = jax.grad(lambda lag: railjax.linear_critical_speed(coach, damper=SelectiveDamper(lag=lag)))(0.05)
    assert float(slope) == pytest.approx(float(found[2] - found[1]) / 2e-6, rel=1e-4)


def test_sweeps_over_its_parameters(coach):
    over = {"damper.fast": [5e3, 10e3, 20e3]}
    data = railjax.sweep(railjax.CriticalSpeed(), over, vehicle=coach, damper=SelectiveDamper())
    lanes = railjax.linear_critical(coach, damper=SelectiveDamper(fast=jnp.array(over["damper.fast"])))
    np.testing.assert_allclose(data["critical_speed"], lanes.speed, rtol=1e-9)
    assert (data["code"] == 0).all()
    over = {"damper.orifice": [150e3, 300e3, 600e3]}
    study = railjax.ForcedRun((RMS,), duration=3.0, settle=1.0)
    common = {"vehicle": coach, "speed": SPEED, "track": TRACK, "damper": OrificeDamper()}
    forced = railjax.sweep(study, over, **common, units={"damper.orifice": "N s^2/m^2"})
    direct = run(coach, OrificeDamper(orifice=jnp.array(over["damper.orifice"])))
    np.testing.assert_allclose(forced["rms_carbody_acceleration"], direct, rtol=1e-9)
    assert forced["damper.orifice"].attrs["units"] == "N s^2/m^2"


def test_tuning_finds_the_best(coach):
    """A curved law by statistical linearisation, without being told: linearised at rest the orifice would do nothing."""
    found = railjax.tune(coach, {"damper.orifice": (2e4, 2e6)}, aim.comfort(SPEED), damper=OrificeDamper(), optimiser="slsqp")
    best = found.parameters["damper.orifice"]

    def comfort(orifice):
        response = railjax.statistical_linearisation(coach, SPEED, damper=OrificeDamper(orifice=orifice)).response
        return float(response.rms("carbody_acceleration", "Wd"))

    low, at, high = (comfort(factor * best) for factor in (0.9, 1.0, 1.1))
    assert at == pytest.approx(found.objective, rel=1e-9)
    assert at < low
    assert at < high
    assert at < 0.98 * found.objective_before
    assert found.objective_sharp == pytest.approx(found.objective, rel=0.1)
    assert found.damper.orifice == best
    assert found.quantity.method == "statistical"


class NotRegistered:
    internal_states = 0

    def force(self, vehicle, travel, velocity, internal):
        return velocity, internal


@pytest.mark.parametrize(
    ("damper", "message"),
    [
        (3.0, "internal_states"),
        (OrificeDamper, "OrificeDamper()"),
        (NotRegistered(), "register_dataclass"),
        (OrificeDamper(-1.0), "leakage"),
    ],
)
def test_what_is_no_damper_is_refused(damper, message):
    with pytest.raises(railjax.InputError) as error:
        check_damper(damper)
    assert message in str(error.value)
