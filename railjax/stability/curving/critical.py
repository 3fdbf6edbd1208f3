"""The linear critical speed in a curve: of the motion linearised about the equilibrium in the arc, at each speed anew."""

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ...base.arguments import guarded
from ...base.compilation import QUICK
from ...base.errors import InputError
from ...base.host import Answer, HostFunction
from ...base.packing import Form, as_numbers, numbers_of
from ...base.precision import require_double_precision
from ...base.typing import Scalar
from ...model.damper import Damper
from ...model.kinematics import size
from ...model.motion import PASSIVE, state_rate
from ...model.parameters import without_labels
from ...model.track.curve import cant_in_balance
from ...model.vehicle import Vehicle
from ..linear_critical import HIGHEST, LOWEST, Stability
from .equilibrium import Case, moved
from .result import Equilibrium
from .steady import A_CANT, TOGETHER, a_radius, case_of, equilibria

#: speeds of a round of the search, and rounds: from each to the next the interval falls to a 63rd, at last to 1e-10 of the speed
ROUNDS = 6
#: 1/s; growth below which a mode is one that is neutral at all speeds, as a clock or a hysteresis at rest
NEUTRAL = 1e-7
#: 1/s; growth that is left where a mode crosses; more is a jump, as at a flange's sharp corner
CROSSED = 1e-3


class CurveCritical(NamedTuple):
    """Linear critical speed in a curve (m/s), frequency of the critical mode (Hz), and a `Stability` code: STABLE is stable up to the highest
    speed at which the vehicle can run there, UNPROVED a speed at which stability ends with a jump, as where a flange strikes, without
    derivatives."""

    speed: Float[Array, "..."]
    frequency: Float[Array, "..."]
    code: Int[Array, "..."]


@guarded(("lowest", "highest"), radius=a_radius, cant=A_CANT, cant_deficiency=A_CANT)
def curve_critical(
    vehicle: Vehicle,
    *,
    radius: Scalar,
    cant: Scalar | None = None,
    cant_deficiency: Scalar | None = None,
    damper: Damper = PASSIVE,
    lowest: float = LOWEST,
    highest: float = HIGHEST,
) -> CurveCritical:
    """The speed at which steady running in an arc loses its stability: an eigenvalue of the motion about the equilibrium crosses the imaginary axis.

    Creep that the curve saturates, and a flange at the rail, are in the linearisation as they are in the equilibrium. With a `cant` the
    deficiency grows with the speed, and the search ends where a wheel lifts; with a `cant_deficiency` the cant follows the speed. Speeds are
    tried on a grid of 64 and refined: a pair of crossings between two of them is not seen. Differentiable by every float of the vehicle, by
    radius and cant in both modes (implicit function), outside of `jit`.

    Args:
        vehicle: the vehicle, or a batch with lanes in any of its numbers.
        radius: R, m, positive to the right.
        cant: of the outer rail, m; 0 if neither it nor the deficiency is given.
        cant_deficiency: instead of the cant, m.
        damper: what takes the place of rho_cy, linearised in the equilibrium.
        lowest: speed from which on a crossing is looked for, m/s.
        highest: speed up to which it is looked for, m/s.

    Returns:
        Speed (m/s), infinite where stable and NaN where there is none; frequency (Hz) and code.

    Raises:
        InputError: for both cant and deficiency, `lowest` not below `highest`, inside `jax.jit`, and in single precision.
    """
    require_double_precision("the critical speed in a curve")
    if cant is not None and cant_deficiency is not None:
        raise InputError("cant and cant_deficiency exclude each other: give one of them")
    tilt = cant_deficiency if cant_deficiency is not None else 0.0 if cant is None else cant
    trees = as_numbers((without_labels(vehicle), damper, radius, tilt))
    return CurveCritical(*_searched(trees, cant_deficiency is not None, float(lowest), float(highest)))


def balanced_cant(speed: Any, radius: Any, deficiency: Any) -> Any:
    """The cant that leaves the deficiency (m) at a speed (m/s), m."""
    return cant_in_balance(speed, radius) - deficiency


def _cant(balanced: bool, speed: Any, radius: Any, tilt: Any) -> Any:
    """The cant at a speed, m."""
    return balanced_cant(speed, radius, tilt) if balanced else tilt


def _at(balanced: bool, trees: tuple, speed: Any) -> Case:
    vehicle, damper, radius, tilt = trees
    return case_of(vehicle, damper, speed, radius, _cant(balanced, speed, radius, tilt))


@functools.partial(jax.jit, static_argnames=("form", "balanced"), compiler_options=QUICK)
def _matrices(form: Form, balanced: bool, numbers: Array, speeds: Array, states: Array) -> Float[Array, "speeds s s"]:
    """E about the equilibria at several speeds."""
    trees = form.tree(numbers)

    def at(speed: Array, x: Array) -> Array:
        case = _at(balanced, trees, speed)
        return jax.jacfwd(lambda x: state_rate(case.vehicle, case.instant(x)))(x)

    return jax.vmap(at, in_axes=(0, -1))(speeds, states)


class _Found(NamedTuple):
    speed: float
    frequency: float
    code: int
    state: Any = None
    matrix: Any = None


def _lane(trees: tuple, balanced: bool, lowest: float, highest: float) -> _Found:
    form, numbers = Form.of(trees), numbers_of(trees)
    vehicle, damper, radius, tilt = trees
    low, high = lowest, highest
    for k in range(ROUNDS):
        speeds = np.geomspace(low, high, TOGETHER)
        told = equilibria(vehicle, damper, speeds, radius, _cant(balanced, speeds, radius, tilt))
        there = (told["code"] == int(Equilibrium.OK)) & np.isfinite(told["state"]).all(axis=0)
        last = TOGETHER if there.all() else int(np.argmin(there))
        if k == 0 and last == 0:
            return _Found(np.nan, np.nan, int(Stability.FAILED))
        matrices = np.asarray(_matrices(form, balanced, numbers, speeds, np.where(there, told["state"], 0.0)))
        roots = np.linalg.eigvals(matrices[:last])
        growth = np.max(np.where(np.abs(roots) > NEUTRAL, roots.real, -np.inf), axis=1)
        first = int(np.argmax(growth > 0.0)) if np.any(growth > 0.0) else last
        if first == last:
            if k == 0:
                return _Found(np.inf, np.nan, int(Stability.STABLE))
            first = last - 1  # rounding, at the end of a round
        if first == 0:
            if k == 0:
                return _Found(np.nan, np.nan, int(Stability.UNSTABLE))
            first = 1
        low, high = speeds[first - 1], speeds[first]
    mode = roots[first][np.argmax(np.where(np.abs(roots[first]) > NEUTRAL, roots[first].real, -np.inf))]
    code = Stability.OK if abs(growth[first]) < CROSSED else Stability.UNPROVED
    return _Found(high, abs(mode.imag) / (2.0 * np.pi), int(code), told["state"][:, first], matrices[first])


@jax.custom_jvp
def _in_equilibrium(case: Case, unknowns: Array) -> Array:
    """The unknowns, which are in equilibrium, with the derivative that this gives them."""
    return unknowns


@_in_equilibrium.defjvp
def _moves(primals: tuple, tangents: tuple) -> tuple:
    return primals[1], moved(primals[0], tangents[0], primals[1], jnp.asarray(True))


@functools.partial(jax.jit, static_argnames=("form", "balanced"))
def _slope(form: Form, balanced: bool, numbers: Array, speed: Array, state: Array, right: Array, left: Array) -> Array:
    """Derivative of the crossing's speed by each number: Re(w^T E x) stays zero for the right and left vectors of the mode."""

    def growth(numbers: Array, speed: Array) -> Array:
        case = _at(balanced, form.tree(numbers), speed)
        n = size(case.vehicle)
        x = case.state(_in_equilibrium(case, jnp.concatenate([state[:n], state[2 * n :]])))

        def along(part: Array) -> Array:
            return jax.jvp(lambda x: state_rate(case.vehicle, case.instant(x)), (x,), (part,))[1]

        return jnp.real(left @ (along(jnp.real(right)) + 1j * along(jnp.imag(right))))

    by_numbers, by_speed = jax.grad(growth, argnums=(0, 1))(numbers, speed)
    return -by_numbers / by_speed


def _slopes(found: _Found, trees: tuple, balanced: bool) -> list[np.ndarray]:
    form, numbers = Form.of(trees), numbers_of(trees)
    slope = np.zeros_like(numbers)
    if found.code == Stability.OK:
        roots, vectors = np.linalg.eig(found.matrix)
        k = int(np.argmax(np.where(np.abs(roots) > NEUTRAL, roots.real, -np.inf)))
        right, left = vectors[:, k], np.linalg.inv(vectors)[k]
        slope = np.asarray(_slope(form, balanced, numbers, np.asarray(found.speed), found.state, right, left))
    return [np.asarray(leaf) for leaf in jax.tree.leaves(form.tree(slope))]


def _many(lanes: Sequence[tuple], slopes: bool, balanced: bool, lowest: float, highest: float) -> Answer:
    found = [_lane(trees, balanced, lowest, highest) for trees in lanes]
    values = tuple(np.array([one[k] for one in found]) for k in range(3))
    return Answer(values, [_slopes(one, trees, balanced) for one, trees in zip(found, lanes, strict=True)] if slopes else None)


_searched = HostFunction("curve_critical", _many, (float, float, int))
