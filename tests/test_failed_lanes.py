"""A lane that fails is marked, NaN, and without effect on the derivatives of what it shares with the others."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import railjax
from railjax.simulate import initial_state

LANES = 3  # the last one fails
RUN = {"duration": 0.2, "sample": 0.02, "track": railjax.SinusoidTrack(2e-3, 20.0), "record": ("carbody_acceleration",)}
START = {"wheelset_y": 1e-3}


def with_last(value, bad):
    return jnp.full(LANES, value).at[-1].set(bad)


#: what makes a lane fail: the vehicle's parameter, its good value times 1 and the bad one; None: the initial state
FAULTS = {
    "mass nan": ("carbody.mass", np.nan),
    "friction nan": ("contact.friction", np.nan),
    "mass 1e-9": ("wheelset.mass", 1e-9),
    "initial 1e200": (None, 1e200),
    "initial nan": (None, np.nan),
}


def simulated(coach, path, shared, own):
    """Acceleration and whether it can be used, with a stiffness that all lanes share."""
    vehicle = railjax.replace(coach, primary__stiffness_x=shared * coach.primary.stiffness_x)
    if path is None:
        run = railjax.simulate(vehicle, 40.0, initial={"wheelset_y": own}, **RUN)
    else:
        run = railjax.simulate(railjax.set_parameter(vehicle, path, own), 40.0, initial=START, **RUN)
    # the root's derivative is NaN where the acceleration is
    return jnp.sqrt(jnp.mean(run["carbody_acceleration"] ** 2, axis=0)), run.ok


def totals(coach, path, bad):
    """The sum over the lanes that can be used, as a function of what is shared, in one batch and by `vmap`; and of good lanes alone."""
    good = 1e-3 if path is None else railjax.get_parameter(coach, path)
    own = with_last(good, bad)

    def batch(shared, own=own):
        if path is None:
            states = jax.vmap(lambda y: initial_state(coach, railjax.PassiveDamper(), {"wheelset_y": y}))
            vehicle = railjax.replace(coach, primary__stiffness_x=shared * coach.primary.stiffness_x)
            run = railjax.simulate(vehicle, 40.0, initial=states(own).T, **RUN)
            value, ok = jnp.sqrt(jnp.mean(run["carbody_acceleration"] ** 2, axis=0)), run.ok
        else:
            value, ok = simulated(coach, path, shared, own)
        return jnp.sum(jnp.where(ok, value, 0.0)), ok

    def mapped(shared, own=own):
        value, ok = jax.vmap(lambda one: simulated(coach, path, shared, one))(own)
        return jnp.sum(jnp.where(ok, value, 0.0)), ok

    return batch, mapped, own[:-1]


@pytest.mark.parametrize("fault", FAULTS)
def test_simulate(coach, fault):
    path, bad = FAULTS[fault]
    batch, mapped, good = totals(coach, path, bad)
    wanted, _ = jax.jit(jax.grad(batch, has_aux=True))(1.0, good)
    for function in (batch, mapped):
        slope, ok = jax.jit(jax.grad(function, has_aux=True))(1.0)
        assert list(ok) == [True] * (LANES - 1) + [False]
        np.testing.assert_allclose(slope, wanted, rtol=1e-9)
    forward = jax.jit(lambda one: jax.jvp(lambda one: mapped(one)[0], (one,), (1.0,))[1])(1.0)
    np.testing.assert_allclose(forward, wanted, rtol=1e-7)
