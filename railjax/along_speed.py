"""E and dE/dv of one vehicle at many speeds, as NumPy arrays: for eigenvalues on the host, without compiling a search."""

import functools
import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .dampers import Damper
from .motion import state_matrix
from .vehicle import Vehicle, bare

#: speeds computed in one call: few calls, little in vain
TOGETHER = 15

#: speeds (k,) -> E and dE/dv, each (k, states, states)
Along = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


def concrete(*trees: object) -> bool:
    """Whether all leaves are numbers, and not what JAX traces a function with."""
    return not any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(trees))


def along_speed(vehicle: Vehicle, damper: Damper, flange: bool = False) -> Along:
    """The function that gives E (`state_matrix`, also as to the `flange`) and its derivative with respect to the speed at each of some
    speeds (m/s), for a vehicle without lanes."""
    leaves, structure = jax.tree.flatten(bare(vehicle, damper))
    shapes = tuple(np.shape(leaf) for leaf in leaves)
    # as one array, because each is slow to hand over
    numbers = np.concatenate([np.ravel(leaf) for leaf in leaves])

    def at(speeds: Float[np.ndarray, "speeds"]) -> tuple[Float[np.ndarray, "speeds s s"], Float[np.ndarray, "speeds s s"]]:
        pieces = np.pad(speeds, (0, -len(speeds) % TOGETHER), mode="edge").reshape(-1, TOGETHER)
        found = [_matrices(structure, shapes, numbers, np.asarray(flange), piece) for piece in pieces]
        return tuple(np.concatenate(part)[: len(speeds)] for part in zip(*found, strict=True))

    return at


def both_at(vehicle: Vehicle, speed: float, damper: Damper) -> Float[np.ndarray, "2 s s"]:
    """As `motion.state_matrices`, by the program that the linear critical speed has compiled already."""
    return np.concatenate([along_speed(vehicle, damper, flange)(np.array([speed]))[0] for flange in (False, True)])


# compiled in half the time, and run some ten times
@functools.partial(jax.jit, static_argnames=("structure", "shapes"), compiler_options={"xla_backend_optimization_level": 0})
def _matrices(
    structure: Any,
    shapes: tuple[tuple[int, ...], ...],
    numbers: Float[Array | np.ndarray, "numbers"],
    flange: Bool[Array | np.ndarray, ""],
    speeds: Float[Array | np.ndarray, "speeds"],
) -> tuple[Float[Array, "speeds s s"], Float[Array, "speeds s s"]]:
    parts = jax.lax.split(numbers, [math.prod(shape) for shape in shapes])
    vehicle, damper = structure.unflatten([part.reshape(shape) for part, shape in zip(parts, shapes, strict=True)])

    def at(speed: Float[Array, ""]) -> tuple[Float[Array, "s s"], Float[Array, "s s"]]:
        return jax.jvp(
            lambda speed: state_matrix(vehicle, speed, damper, flange=jnp.asarray(flange)), (speed,), (jnp.ones_like(speed),)
        )

    return jax.vmap(at)(speeds)
