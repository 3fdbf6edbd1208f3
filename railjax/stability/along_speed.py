"""E and dE/dv of one vehicle at many speeds, as NumPy arrays: for eigenvalues on the host, without compiling a search."""

import functools
from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..base.batches import Batch
from ..base.packing import Form, numbers_of
from ..base.programs import kept
from ..model.damper import Damper
from ..model.motion import state_matrix
from ..model.parameters import bare
from ..model.vehicle import Vehicle

#: speeds computed in one call: few calls, little in vain
TOGETHER = 15

#: speeds (k,) -> E and dE/dv, each (k, states, states)
Along = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


def along_speed(vehicle: Vehicle, damper: Damper, flange: bool = False) -> Along:
    """The function that gives E (`state_matrix`, also as to the `flange`) and its derivative with respect to the speed at each of some
    speeds (m/s), for a vehicle without lanes."""
    # the law of contact has no part in E, and would be compiled anew for
    law_free = replace(vehicle, contact=replace(vehicle.contact, law="linear"))
    trees = bare(law_free, damper)
    form, numbers = Form.of(trees), numbers_of(trees)

    def at(speeds: Float[np.ndarray, "speeds"]) -> tuple[Float[np.ndarray, "speeds s s"], Float[np.ndarray, "speeds s s"]]:
        pieces = np.pad(speeds, (0, -len(speeds) % TOGETHER), mode="edge").reshape(-1, TOGETHER)
        found = [_matrices(form)(numbers, np.asarray(flange), piece) for piece in pieces]
        return tuple(np.concatenate(part)[: len(speeds)] for part in zip(*found, strict=True))

    return at


def lanes_along_speed(trees: tuple, together: int) -> Callable[..., Float[np.ndarray, "speeds lanes s s"]]:
    """The function (speeds (m/s), first, last) -> E of the lanes [first, last) of a vehicle and its damper, at most `together`."""
    batch = Batch.of(*jax.tree.map(np.asarray, trees))

    def at(speeds: Float[np.ndarray, "speeds"], first: int, last: int) -> Float[np.ndarray, "speeds lanes s s"]:
        index = np.minimum(np.arange(first, first + together), last - 1)
        return np.moveaxis(np.asarray(_matrices_of_lanes(batch.take(index), speeds)), -1, 1)[:, : last - first]

    return at


@functools.partial(jax.jit, compiler_options={"xla_backend_optimization_level": 0})
def _matrices_of_lanes(trees: tuple, speeds: Float[Array | np.ndarray, "speeds"]) -> Float[Array, "speeds s s lanes"]:
    def of(vehicle: Vehicle, damper: Damper) -> Float[Array, "speeds s s"]:
        return jax.vmap(lambda speed: state_matrix(vehicle, speed, damper))(speeds)

    return Batch.of(*trees).each(of)


def both_at(vehicle: Vehicle, speed: float, damper: Damper) -> Float[np.ndarray, "2 s s"]:
    """As `motion.state_matrices`, by the program that the linear critical speed has compiled already."""
    return np.concatenate([along_speed(vehicle, damper, flange)(np.array([speed]))[0] for flange in (False, True)])


@functools.cache
def _matrices(form: Form) -> Callable[..., tuple[Float[Array, "speeds s s"], Float[Array, "speeds s s"]]]:
    def function(
        numbers: Float[Array | np.ndarray, "numbers"],
        flange: Bool[Array | np.ndarray, ""],
        speeds: Float[Array | np.ndarray, "speeds"],
    ) -> tuple[Float[Array, "speeds s s"], Float[Array, "speeds s s"]]:
        vehicle, damper = form.tree(numbers)

        def at(speed: Float[Array, ""]) -> tuple[Float[Array, "s s"], Float[Array, "s s"]]:
            return jax.jvp(
                lambda speed: state_matrix(vehicle, speed, damper, flange=jnp.asarray(flange)), (speed,), (jnp.ones_like(speed),)
            )

        return jax.vmap(at)(speeds)

    # compiled in half the time, and run some ten times
    return kept(function, form, compiler_options={"xla_backend_optimization_level": 0})
