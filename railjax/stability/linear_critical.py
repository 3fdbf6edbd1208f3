"""Linear stability: the critical speed at which straight running loses stability, and its gradient."""

import functools
import warnings
from enum import IntEnum
from types import ModuleType
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float, Int

from ..base.arguments import ARGUMENTS, guarded
from ..base.batches import Batch, in_threads
from ..base.checks import Kind, traced
from ..base.errors import NumericalError
from ..base.failed_lanes import without_nan
from ..base.precision import require_double_precision
from ..base.typing import Scalar
from ..base.units import KMH
from ..model.damper import Damper
from ..model.motion import PASSIVE, state_matrix, state_product
from ..model.parameters import bare
from ..model.vehicle import Vehicle
from .along_speed import along_speed, lanes_along_speed
from .eigen_crossing import Crossing, Outcome, lowest_crossing, lowest_crossing_compiled, pencil, speeds_of

#: speeds (m/s) between which the lowest crossing is looked for
LOWEST, HIGHEST = 3.0, 150.0
#: lanes that go from speed to speed in step
TOGETHER = 32


class Stability(IntEnum):
    """What the search for the critical speed found."""

    OK = 0
    STABLE = 1  # no crossing up to the highest speed: the critical speed is given as infinity
    UNSTABLE = 2  # unstable at the lowest speed already: the critical speed is given as NaN
    FAILED = 3  # eigenvalues not finite, or the crossing could not be resolved: the critical speed is given as NaN
    UNPROVED = 4  # as OK or STABLE, but at some speed below stability could not be proved: a lower crossing is not excluded


class LinearCritical(NamedTuple):
    """Linear critical speed (m/s), frequency of the critical mode (Hz), how fast its growth rate rises with speed
    (1/s per m/s), and a `Stability` code."""

    speed: Float[Array, "..."]
    frequency: Float[Array, "..."]
    growth_per_speed: Float[Array, "..."]
    code: Int[Array, "..."]


ARGUMENTS["hopf"] = Kind(LinearCritical, "what railjax.linear_critical returns")


@guarded(("lowest", "highest"))
def linear_critical_speed(
    vehicle: Vehicle, *, damper: Damper = PASSIVE, lowest: float = LOWEST, highest: float = HIGHEST
) -> Float[Array, "..."]:
    """Speed (m/s) at which straight running first becomes unstable: an eigenvalue of E (eq. 4) crosses the imaginary axis.

    Differentiable once with respect to every float of the vehicle, in both modes (a second derivative raises an error). Where
    stability could not be proved at all speeds below, a RuntimeWarning says so.

    Args:
        vehicle: the vehicle, or a batch with lanes in any of its numbers.
        damper: what takes the place of rho_cy, linearised at rest; by default the vehicle's own. It may have lanes too.
        lowest: speed from which on a crossing is looked for, m/s; by default 3.
        highest: speed up to which it is looked for, m/s; by default 150.

    Returns:
        The speed, m/s, one per lane: inf where stable up to `highest`, NaN where unstable at `lowest` already or not computable.

    Raises:
        NumericalError: for a single vehicle that has no such speed.
        InputError: for `lowest` not below `highest`, and in single precision.
    """
    found = linear_critical(vehicle, damper=damper, lowest=lowest, highest=highest)
    if isinstance(found.code, jax.core.Tracer):
        return found.speed
    if found.code.ndim == 0:
        if int(found.code) == Stability.STABLE:
            raise NumericalError(f"no linear critical speed: straight running is stable up to {highest * KMH:.0f} km/h")
        if int(found.code) == Stability.UNSTABLE:
            raise NumericalError(f"no linear critical speed: straight running is unstable at {lowest * KMH:.1f} km/h already")
        if int(found.code) == Stability.FAILED:
            raise NumericalError(
                "no linear critical speed: the eigenvalues of the state matrix are not finite or cannot be resolved; "
                "look for a mass or stiffness that is far from any vehicle's"
            )
    if np.any(np.asarray(found.code) == Stability.UNPROVED):
        warnings.warn(
            "stability could not be proved at all speeds below a linear critical speed: a lower one is not excluded; look at root_locus",
            RuntimeWarning,
            stacklevel=2,
        )
    return found.speed


@guarded(("lowest", "highest"))
def linear_critical(
    vehicle: Vehicle, *, damper: Damper = PASSIVE, lowest: float = LOWEST, highest: float = HIGHEST
) -> LinearCritical:
    """As `linear_critical_speed`, with frequency and result code instead of errors.

    Args:
        vehicle: the vehicle, or a batch with lanes in any of its numbers.
        damper: what takes the place of rho_cy, linearised at rest; by default the vehicle's own. It may have lanes too.
        lowest: speed from which on a crossing is looked for, m/s; by default 3.
        highest: speed up to which it is looked for, m/s; by default 150.

    Raises:
        InputError: for `lowest` not below `highest`, and in single precision.
    """
    require_double_precision("the linear critical speed")
    trees = bare(vehicle, damper)
    return _found(Batch.of(*trees).lanes, trees, lowest, highest)[0]


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _found(lanes: int | None, trees: tuple, lowest: Scalar, highest: Scalar) -> tuple[LinearCritical, Crossing]:
    """What is said, and the critical eigenpair."""
    if not traced((trees, lowest, highest)):
        found, crossing = _told(*_on_host(lanes, trees, float(lowest), float(highest)), np)
        return jax.device_put(found), crossing
    return _compiled(lanes, trees, jnp.asarray(lowest, float), jnp.asarray(highest, float))


@_found.defjvp
def _derivative(lanes: int | None, primals: tuple, tangents: tuple) -> tuple:
    found, crossing = _found(lanes, *primals)
    speed, omega, frequency = _rates(lanes, primals[0], tangents[0], _constant(crossing), found.code)
    of_found, of_crossing = jax.tree.map(jnp.zeros_like, (found, crossing))
    of_found = of_found._replace(speed=speed, frequency=frequency, code=np.zeros(found.code.shape, jax.dtypes.float0))
    return (found, crossing), (of_found, of_crossing._replace(speed=speed, omega=omega))


@functools.partial(jax.jit, static_argnames="lanes")
def _rates(
    lanes: int | None, trees: tuple, moved: tuple, at: Crossing, code: Int[Array, "..."]
) -> tuple[Float[Array, "..."], Float[Array, "..."], Float[Array, "..."]]:
    """Of speed, omega and frequency. Implicit function: Re(dlambda + lambda_v dv) = 0 with dlambda = w^T dE x for right and left
    vectors with w^T x = 1."""

    def eigenvalue(trees: tuple) -> Complex[Array, "..."]:
        return Batch.of(*trees, at, own={len(trees): Crossing(0, 0, 0, 1, 1)}).each(_rayleigh)

    change = jax.jvp(eigenvalue, (without_nan(trees),), (moved,))[1]
    speed = -change.real / at.by_speed.real
    omega = change.imag + at.by_speed.imag * speed
    found = (code == Stability.OK) | (code == Stability.UNPROVED)
    speed, omega = jnp.where(found, speed, 0.0), jnp.where(found, omega, 0.0)
    return speed, omega, omega / (2.0 * jnp.pi)


@jax.custom_jvp
def _constant(crossing: Crossing) -> Crossing:
    return crossing


@_constant.defjvp
def _refused(primals: tuple, tangents: tuple) -> tuple:
    # eigenvectors are taken as constants in the first derivative, so its own derivative would be wrong
    raise NotImplementedError("second derivatives of the linear critical speed")


def _rayleigh(vehicle: Vehicle, damper: Damper, crossing: Crossing) -> Complex[Array, ""]:
    """w^T E x at the crossing's speed."""
    x = crossing.right
    image = state_product(vehicle, crossing.speed, damper, jnp.stack([x.real, x.imag], axis=1))
    return crossing.left @ (image[:, 0] + 1j * image[:, 1])


def _told(crossing: Crossing, code: Int[Array | np.ndarray, "..."], xp: ModuleType = jnp) -> tuple[LinearCritical, Crossing]:
    """The crossing as it is told, in NumPy or JAX; and with numbers without effect where nothing was found, so that such a lane does
    not spoil a sum's derivative."""
    unproved = code == Stability.UNPROVED
    found = (code == Stability.OK) | (unproved & xp.isfinite(crossing.speed))
    crossing = Crossing(*(xp.where(found, value, none) for value, none in zip(crossing, (1.0, 0.0, 1.0, 0.0, 0.0), strict=True)))
    speed = xp.where(found, crossing.speed, xp.where((code == Stability.STABLE) | unproved, np.inf, np.nan))
    frequency = xp.where(found, crossing.omega / (2.0 * np.pi), np.nan)
    return LinearCritical(speed, frequency, xp.where(found, crossing.by_speed.real, np.nan), code), crossing


@functools.partial(jax.jit, static_argnames="lanes")
def _compiled(
    lanes: int | None, trees: tuple, lowest: Float[Array, ""], highest: Float[Array, ""]
) -> tuple[LinearCritical, Crossing]:
    """Where numbers are not known yet, or mapped over by the user: lane after lane, as LAPACK takes them."""

    def one(
        vehicle: Vehicle, damper: Damper, lowest: Float[Array, ""], highest: Float[Array, ""]
    ) -> tuple[Crossing, Int[Array, ""]]:
        speeds = speeds_of(lowest, highest)
        at = jnp.stack([state_matrix(vehicle, speed, damper)[None] for speed in speeds])
        crossing, outcome = lowest_crossing_compiled(pencil(at, speeds, vehicle.gyroscopic), lowest, highest)
        return jax.tree.map(lambda leaf: leaf[0], (crossing, _code(outcome, jnp)))

    return _told(*Batch.of(*trees, lowest, highest).one_by_one(one))


def _on_host(lanes: int | None, trees: tuple, lowest: float, highest: float) -> tuple[Crossing, Int[np.ndarray, "..."]]:
    """Of known numbers, by LAPACK on the host, so that only E is compiled."""
    with np.errstate(invalid="ignore"):  # NaN is a lane that fails
        return _searched(lanes, trees, lowest, highest)


def _searched(lanes: int | None, trees: tuple, lowest: float, highest: float) -> tuple[Crossing, Int[np.ndarray, "..."]]:
    speeds = speeds_of(lowest, highest)
    gyroscopic = trees[0].gyroscopic
    if lanes is None:
        at, _ = along_speed(*trees)(np.array(speeds))
        crossing, outcome = lowest_crossing(pencil(at[:, None], speeds, gyroscopic), lowest, highest)
        return Crossing(*(part[0, ...] for part in crossing)), _code(outcome, np)[0, ...]
    at = lanes_along_speed(trees, TOGETHER)  # type: ignore[assignment]

    def piece(start: int) -> tuple[Crossing, Outcome]:
        matrices = at(np.array(speeds), start, min(start + TOGETHER, lanes))  # type: ignore[operator]
        return lowest_crossing(pencil(matrices, speeds, gyroscopic), lowest, highest)

    found = in_threads(piece, range(0, lanes, TOGETHER))
    crossing, outcome = (
        type(parts[0])(*(np.concatenate(part) for part in zip(*parts, strict=True))) for parts in zip(*found, strict=True)
    )
    return crossing._replace(right=crossing.right.T, left=crossing.left.T), _code(outcome, np)


def _code(outcome: Outcome, xp: ModuleType) -> Int[Array | np.ndarray, "lanes"]:
    code = xp.where(outcome.crossed, int(Stability.OK), int(Stability.STABLE))
    code = xp.where(outcome.proved, code, int(Stability.UNPROVED))
    code = xp.where(outcome.unstable, int(Stability.UNSTABLE), code)
    return xp.where(outcome.failed, int(Stability.FAILED), code)
