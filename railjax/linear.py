"""Linear stability: the critical speed at which straight running loses stability, and its gradient."""

import functools
from enum import IntEnum
from types import ModuleType
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float, Int

from .along_speed import TOGETHER, Along, along_speed, concrete
from .checks import guarded
from .crossing import GROWN, Crossing, crossings, first_unproved, one_by_one
from .dampers import Damper
from .deflections import size
from .errors import NumericalError
from .failed_lanes import without_nan
from .kernels import eig_both
from .lanes import by_device, count_lanes, each_lane, own_axes
from .motion import PASSIVE, state_matrix, state_product, state_size
from .precision import require_double_precision
from .typing import Scalar
from .units import KMH
from .vehicle import Vehicle, bare

#: speeds (m/s) between which a crossing is looked for, and how many are tried; a window of instability narrower than the
#: spacing (about 2.5 m/s) can be missed: look at `root_locus` when in doubt
LOWEST, HIGHEST, POINTS = 3.0, 150.0, 60
#: how often the spacing is halved
HALVINGS = 24
#: largest last step of Newton's method, relative
RESOLVED = 1e-10


class Stability(IntEnum):
    """What the search for the critical speed found."""

    OK = 0
    STABLE = 1  # no crossing up to the highest speed: the critical speed is given as infinity
    UNSTABLE = 2  # unstable at the lowest speed already: the critical speed is given as NaN
    FAILED = 3  # eigenvalues not finite, or the crossing could not be resolved: the critical speed is given as NaN


class LinearCritical(NamedTuple):
    """Linear critical speed (m/s), frequency of the critical mode (Hz), how fast its growth rate rises with speed
    (1/s per m/s), and a `Stability` code."""

    speed: Float[Array, "..."]
    frequency: Float[Array, "..."]
    growth_per_speed: Float[Array, "..."]
    code: Int[Array, "..."]


@guarded(("lowest", "highest"))
def linear_critical_speed(
    vehicle: Vehicle, *, damper: Damper = PASSIVE, lowest: float = LOWEST, highest: float = HIGHEST
) -> Float[Array, "..."]:
    """Speed (m/s) at which straight running first becomes unstable: an eigenvalue of E (eq. 4) crosses the imaginary axis.

    Differentiable once with respect to every float of the vehicle, in both modes (a second derivative raises an error). With
    lanes in the vehicle the result has one value per lane: inf where stable up to `highest` (m/s), NaN where unstable at
    `lowest` (m/s) already or not computable. For a single vehicle these raise `NumericalError`. Needs double precision.
    """
    found = linear_critical(vehicle, damper=damper, lowest=lowest, highest=highest)
    if not isinstance(found.code, jax.core.Tracer) and found.code.ndim == 0:
        if int(found.code) == Stability.STABLE:
            raise NumericalError(f"no linear critical speed: straight running is stable up to {highest * KMH:.0f} km/h")
        if int(found.code) == Stability.UNSTABLE:
            raise NumericalError(f"no linear critical speed: straight running is unstable at {lowest * KMH:.1f} km/h already")
        if int(found.code) == Stability.FAILED:
            raise NumericalError(
                "no linear critical speed: the eigenvalues of the state matrix are not finite or cannot be resolved; "
                "look for a mass or stiffness that is far from any vehicle's"
            )
    return found.speed


@guarded(("lowest", "highest"))
def linear_critical(
    vehicle: Vehicle, *, damper: Damper = PASSIVE, lowest: float = LOWEST, highest: float = HIGHEST
) -> LinearCritical:
    """As `linear_critical_speed`, `lowest` and `highest` in m/s too, with frequency and result code instead of errors."""
    require_double_precision("the linear critical speed")
    trees = bare(vehicle, damper)
    return _found(count_lanes(trees, _axes(trees)), trees, lowest, highest)[0]


def _axes(trees: tuple) -> tuple:
    return tuple(own_axes(tree) for tree in trees)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _found(lanes: int | None, trees: tuple, lowest: Scalar, highest: Scalar) -> tuple[LinearCritical, Crossing]:
    """What is said, and the critical eigenpair; for one vehicle whose numbers are known on the host, where little is to be compiled."""
    if lanes is None and concrete(trees, lowest, highest):
        found, crossing = _told(*_on_host(*trees, float(lowest), float(highest)), np)
        return jax.device_put(found), crossing
    return _compiled(lanes, trees, jnp.asarray(lowest, float), jnp.asarray(highest, float))


@_found.defjvp
def _derivative(lanes: int | None, primals: tuple, tangents: tuple) -> tuple:
    found, crossing = _found(lanes, *primals)
    speed, omega, frequency = _rates(lanes, primals[0], tangents[0], _held(crossing), found.code)
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
        if lanes is None:
            return _rayleigh(*trees, at)
        return each_lane(_rayleigh, (*trees, at), (*_axes(trees), Crossing(0, 0, 0, 1, 1)))

    change = jax.jvp(eigenvalue, (without_nan(trees),), (moved,))[1]
    speed = -change.real / at.by_speed.real
    omega = change.imag + at.by_speed.imag * speed
    found = code == Stability.OK
    speed, omega = jnp.where(found, speed, 0.0), jnp.where(found, omega, 0.0)
    return speed, omega, omega / (2.0 * jnp.pi)


@jax.custom_jvp
def _held(crossing: Crossing) -> Crossing:
    return crossing


@_held.defjvp
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
    found = code == Stability.OK
    crossing = Crossing(*(xp.where(found, value, none) for value, none in zip(crossing, (1.0, 0.0, 1.0, 0.0, 0.0), strict=True)))
    speed = xp.where(found, crossing.speed, xp.where(code == Stability.STABLE, np.inf, np.nan))
    frequency = xp.where(found, crossing.omega / (2.0 * np.pi), np.nan)
    return LinearCritical(speed, frequency, xp.where(found, crossing.by_speed.real, np.nan), code), crossing


@functools.partial(jax.jit, static_argnames="lanes")
def _compiled(
    lanes: int | None, trees: tuple, lowest: Float[Array, ""], highest: Float[Array, ""]
) -> tuple[LinearCritical, Crossing]:
    if lanes is None:
        return _told(*_robust(*trees, lowest, highest))
    axes = _axes(trees)
    return _told(*by_device(functools.partial(_many, axes), (*trees, lowest, highest), (*axes, 0, 0)))


def _many(axes: tuple, trees: tuple) -> tuple[Crossing, Int[Array, "lanes"]]:
    """All lanes of a device: stability proved speed by speed, then the crossing; what is left over, by the robust way."""
    *parameters, lowest, highest = trees
    parameters, lanes = tuple(parameters), count_lanes(tuple(parameters), axes)

    def taken(index: Int[Array, "..."]) -> tuple:
        return jax.tree.map(lambda leaf, own: leaf[..., index] if jnp.ndim(leaf) > own else leaf, parameters, axes)

    def matrices(index: Int[Array, "k"], speeds: Float[Array, "k"]) -> Float[Array, "k states states"]:
        def one(vehicle: Vehicle, damper: Damper, speed: Scalar) -> Array:
            return state_matrix(vehicle, speed, damper)

        return jnp.moveaxis(each_lane(one, (*taken(index), speeds), (*axes, 0)), -1, 0)

    coordinates, speeds = size(parameters[0]), jnp.linspace(lowest, highest, POINTS)
    first, logarithm = first_unproved(matrices, lanes, coordinates, speeds)
    between = (first > 0) & (first < POINTS)
    low, high = speeds[jnp.maximum(first - 1, 0)], speeds[jnp.clip(first, 1, POINTS - 1)]
    crossing, proved = crossings(matrices, lanes, coordinates, between, low, high)
    unstable = (first == 0) & (logarithm > jnp.log(GROWN))
    code = jnp.where(first == POINTS, int(Stability.STABLE), jnp.where(unstable, int(Stability.UNSTABLE), int(Stability.OK)))
    left = (code == Stability.OK) & ~proved
    crossing, code = one_by_one(left, lambda index: _robust(*taken(index), lowest, highest), (crossing, code))
    return crossing._replace(right=crossing.right.T, left=crossing.left.T), code


def _robust(vehicle: Vehicle, damper: Damper, lowest: Scalar, highest: Scalar) -> tuple[Crossing, Int[Array, ""]]:
    """One vehicle: all eigenvalues along the grid up to the first speed where one grows, then bisection."""
    speeds = jnp.linspace(lowest, highest, POINTS)

    class Search(NamedTuple):
        low: Float[Array, ""]  # nothing grows there
        high: Float[Array, ""]  # infinite as long as nothing grows
        tried: Int[Array, ""]
        halvings: Int[Array, ""]
        finite: Bool[Array, ""]

    def unfinished(search: Search) -> Bool[Array, ""]:
        found = jnp.isfinite(search.high)
        return search.finite & jnp.where(found, search.halvings < HALVINGS, search.tried < POINTS)

    # Bisection on the largest real part stays with the first crossing even where modes cross each other below it. One loop for grid and
    # bisection, because the eigenvalues take long to compile
    def onward(search: Search) -> Search:
        low, high, tried, halvings, _ = search
        found = jnp.isfinite(high)
        speed = jnp.where(found, 0.5 * (low + high), speeds[tried])
        growth = jnp.max(jnp.linalg.eigvals(state_matrix(vehicle, speed, damper)).real)
        low, high = jnp.where(growth > 0, low, speed), jnp.where(growth > 0, speed, high)
        return Search(low, high, tried + ~found, halvings + found, jnp.isfinite(growth))

    none = jnp.array(0)
    search = Search(speeds[0], jnp.full_like(speeds[0], jnp.inf), none, none, jnp.array(True))
    low, high, tried, _, finite = jax.lax.while_loop(unfinished, onward, search)
    found = jnp.isfinite(high)
    at_once = jnp.where(tried == 1, int(Stability.UNSTABLE), int(Stability.OK))
    code = jnp.where(found, at_once, int(Stability.STABLE))
    code = jnp.where(finite, code, int(Stability.FAILED))
    near = jnp.where(found, 0.5 * (low + high), highest)
    matrix, by_speed = jax.jvp(lambda v: state_matrix(vehicle, v, damper), (near,), (jnp.ones_like(near),))
    values, left, right = eig_both(matrix)
    critical = jnp.argmax(values.real)
    x, w = right[:, critical], jnp.conj(left[:, critical])
    w = w / (w @ x)
    slope = w @ (by_speed @ x)
    # one Newton step on the real part of that mode polishes the value
    step = -values[critical].real / slope.real
    # it must stay within the grid's bracket, else the crossing is lost in round-off
    resolved = jnp.abs(step) <= (highest - lowest) / POINTS
    code = jnp.where((code == Stability.OK) & ~resolved, int(Stability.FAILED), code)
    return Crossing(near + step, jnp.abs(values[critical].imag + slope.imag * step), slope, x, w), code


def _on_host(vehicle: Vehicle, damper: Damper, lowest: float, highest: float) -> tuple[Crossing, Int[np.ndarray, ""]]:
    """The same as `_robust` by LAPACK on the host, with Newton's method inside the bracket in place of most of the bisection."""
    from scipy.linalg import eig  # here, for a quick import of railjax

    along, speeds = along_speed(vehicle, damper), np.linspace(lowest, highest, POINTS)
    nothing = Crossing(*np.zeros(2), np.zeros((), complex), *np.zeros((2, state_size(vehicle, damper)), complex))
    with np.errstate(all="ignore"):
        try:
            growth = _growth_up_to_instability(along, speeds)
            if not growth[-1] > 0.0:
                return nothing, np.array(int(Stability.STABLE))
            if len(growth) == 1:
                return nothing, np.array(int(Stability.UNSTABLE))
            low, high = speeds[len(growth) - 2 : len(growth)]
            near = low + (high - low) * growth[-2] / (growth[-2] - growth[-1])
            for _ in range(2 * HALVINGS):
                (matrix,), (by_speed,) = along(np.array([near]))
                values, left, right = eig(matrix, left=True, right=True)
                critical = np.argmax(values.real)
                value, x, w = values[critical], right[:, critical], left[:, critical].conj()
                w = w / (w @ x)
                slope = w @ by_speed @ x
                step = -value.real / slope.real
                low, high = (low, near) if value.real > 0 else (near, high)
                if abs(step) <= RESOLVED * near:
                    break
                near = near + step if low < near + step < high else 0.5 * (low + high)
        except (np.linalg.LinAlgError, ValueError):  # not finite, or no convergence
            return nothing, np.array(int(Stability.FAILED))
        code = Stability.OK if abs(step) <= (highest - lowest) / POINTS else Stability.FAILED
        return Crossing(near + step, np.abs(value.imag + slope.imag * step), slope, x, w), np.array(int(code))


def _growth_up_to_instability(along: Along, speeds: Float[np.ndarray, "points"]) -> list[float]:
    """Largest real part of E's eigenvalues at the speeds up to the first where it is positive. Raises `LinAlgError`."""
    growth: list[float] = []
    for start in range(0, len(speeds), TOGETHER):
        matrices, _ = along(speeds[start : start + TOGETHER])
        for matrix in matrices:
            growth.append(float(np.linalg.eigvals(matrix).real.max()))
            if growth[-1] > 0.0:
                return growth
    return growth
