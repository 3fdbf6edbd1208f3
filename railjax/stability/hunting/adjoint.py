"""Derivatives of a section by the numbers of a model: by each of them forwards; of vehicles with profiles, whose tables have some ten
thousand, along one direction forwards and by all of them backwards."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ...base.compilation import QUICK, options
from ...base.packing import Form
from ...base.programs import kept
from ...model.contact.profile_table import evened
from ...simulation.runge_kutta import rk4_in_loop
from .orbits import Model, Orbit, Shooting, by_parameters, called, section_of, state_rates, unpack

#: steps of RK4 for which there is room when an orbit is followed backwards: a multiple of this
ROOM = 512


def weighted(
    model: Model, shooting: Shooting, unknowns: Float[np.ndarray, "unknowns"], weights: Float[np.ndarray, "states"]
) -> Float[np.ndarray, "numbers"]:
    """weights · d residual by every number of the model, in the order of its leaves."""
    if model.vehicle.profiles is None:
        return weights @ by_parameters(model, shooting, unknowns)
    orbit = unpack(model, shooting, unknowns)
    share, sign = (0.5, model.mirror) if shooting.symmetric else (1.0, 1.0)
    room = -(-shooting.steps // ROOM) * ROOM
    given = np.asarray(orbit.state), np.asarray(share * orbit.period / shooting.steps), np.asarray(1.0 / orbit.speed)
    found = np.asarray(
        _backwards(model.form, room)(model.numbers, *given, np.asarray(shooting.steps), sign * weights / model.scales)
    )
    if not shooting.symmetric:
        return found
    # an orbit that is its own mirror image feels on its other half what this half feels in the mirror
    tree = model.form.tree(found)
    profiles = evened(tree.vehicle.profiles)
    return np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(_with_profiles(tree, profiles))])


def along(
    model: Model, shooting: Shooting, unknowns: Float[np.ndarray, "unknowns"], change: Float[np.ndarray, "numbers"]
) -> Float[np.ndarray, "states"]:
    """d residual along a change of the model's numbers."""
    if model.vehicle.profiles is None:
        return by_parameters(model, shooting, unknowns) @ change
    return called(_along, model, shooting, unpack(model, shooting, unknowns), change)


def _with_profiles(model: Model, profiles: Any) -> Model:
    return dataclasses.replace(model, vehicle=dataclasses.replace(model.vehicle, profiles=profiles))


def _along(symmetric: bool, model: Model, orbit: Orbit, steps: Any, change: Float[Array, "numbers"]) -> Float[Array, "states"]:
    moved = model.form.tree(change)
    return jax.jvp(lambda model: section_of(symmetric, model, orbit, steps)[0], (model,), (moved,))[1]


@functools.cache
def _backwards(form: Form, room: int) -> Callable[..., Array]:
    """The derivative of weights · (state at the end), by the numbers: the discrete adjoint, step by step from the end."""

    def function(
        numbers: Float[Array, "numbers"],
        state: Float[Array, "states"],
        dt: Float[Array, ""],
        slowness: Float[Array, ""],
        steps: Int[Array, ""],
        weights: Float[Array, "states"],
    ) -> Float[Array, "numbers"]:
        def step(numbers: Array, x: Array) -> Array:
            return rk4_in_loop(state_rates(form.tree(numbers), slowness), x, dt)

        def onwards(k: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
            x, history = carry
            return step(numbers, x), jax.lax.dynamic_update_index_in_dim(history, x, k, 0)

        start = state, jnp.zeros((room, *state.shape))
        history = jax.lax.fori_loop(0, steps, onwards, start)[1]

        def back(k: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
            weight, total = carry
            x = jax.lax.dynamic_index_in_dim(history, steps - 1 - k, 0, keepdims=False)
            by_numbers, by_state = jax.vjp(step, numbers, x)[1](weight)
            return by_state, total + by_numbers

        return jax.lax.fori_loop(0, steps, back, (weights, jnp.zeros_like(numbers)))[1]

    # not one kernel: of several wheelsets the derivative by a table scatters, which XLA does not write within one
    return kept(function, form, room, compiler_options=options(QUICK))
