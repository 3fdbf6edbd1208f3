"""Every controlled damper, and one run of RK4 with the hold whose number of steps is not part of the compiled code."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

import railjax
from railjax.model.damper import Seen, answers, law_of
from railjax.model.kinematics import deflections, size, split
from railjax.model.motion import held, motion, state_rate
from railjax.simulation.runge_kutta import rk4

SPEED = 55.0
CONTROLLED = {
    "balance": railjax.BalanceLogic(0.7),
    "balance, limited, soft": railjax.BalanceLogic(1.2, damping_min=4e3, force_limit=1e3),
    "balance, lags": railjax.BalanceLogic(0.7, sensor_lag=4e-3, actuator_lag=6e-3),
    "skyhook": railjax.Skyhook(),
    "skyhook, lags": railjax.Skyhook(sensor_lag=4e-3, actuator_lag=6e-3),
    "skyhook, continuous": railjax.Skyhook(damping=40e3),
    "ADD": railjax.ADD(),
    "mixed": railjax.MixedSkyhookADD(),
}
MR = {"bouc-wen": railjax.BoucWenDamper(), "hybrid": railjax.HybridDamper()}
ALL = CONTROLLED | MR
K = 133e3  # k_cy of Table 1


def with_law(damper, law):
    return dataclasses.replace(damper, law=law)


def clock(damper):
    """Where the clock of a sharp law stands among its internal states; none of them without one."""
    if getattr(damper, "law", None) != "sharp" or getattr(damper, "sample_time", None) is None:
        return slice(0)
    return damper.states.index("clock") if hasattr(damper, "states") else damper.internal_states - 1


def instant(coach, damper, seed, size_of=1e-2, lanes=()):
    """A random motion: travel, velocity, internal states, what the controller sees."""
    rng = np.random.default_rng(seed)
    x = (
        size_of
        * rng.normal(size=(2 * size(coach), *lanes))
        * np.repeat([1.0, 20.0], size(coach)).reshape((-1,) + (1,) * len(lanes))
    )
    seen = Seen(*(split(coach, jnp.asarray(part)) for part in np.split(x, 2)))
    travel, velocity = (deflections(coach, part)["secondary_y"] for part in seen[:2])
    internal = size_of * rng.normal(size=(damper.internal_states, 2, *lanes))
    for index in damper.even_states:
        internal[index] = rng.uniform(size=internal[index].shape)
    internal[clock(damper)] = 0.0  # a sample is due
    return travel, velocity, jnp.asarray(internal), seen


def force(vehicle, damper, travel, velocity, internal, seen):
    """Force and rates just after the controller has decided."""
    internal = answers(damper).held(vehicle, travel, velocity, internal, seen)
    return law_of(damper, seen)(vehicle, travel, velocity, internal)


@jax.jit
def final(vehicle, damper, x, duration, steps):
    """State after `duration` s of straight running in that many steps."""
    dt, even = duration / steps, jnp.zeros((2, 2))

    def stage(_, x, sums):
        return state_rate(vehicle, motion(vehicle, damper, 1.0 / SPEED, even, x)), sums

    def step(_, x):
        return held(vehicle, damper, rk4(stage, x, None, dt)[0])

    return jax.lax.fori_loop(0, steps, step, held(vehicle, damper, x))
