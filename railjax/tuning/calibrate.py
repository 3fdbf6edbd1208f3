"""Fitting uncertain parameters to reported results, with exact derivatives; what was fitted is marked so in the vehicle."""

import dataclasses
import functools
import math
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..base.arguments import guarded
from ..base.checks import a_table, shown
from ..base.errors import InputError, NumericalError, nearest
from ..base.fields import is_single
from ..base.precision import require_double_precision
from ..base.units import KMH
from ..model.damper import Damper
from ..model.motion import PASSIVE
from ..model.parameters import bare, get_parameter, set_parameter
from ..model.vehicle import Provenance, Vehicle
from ..stability.hunting.fold_search import FoldSearch, search_folds
from ..stability.hunting.nonlinear_critical import Hunting, default_wheelset, enough_steps, nonlinear_critical
from ..stability.hunting.orbits import DISPLACEMENT, SPEED, Model, Shooting, model_of, rounded, section, unpack
from ..stability.hunting.shooting import BY_AMPLITUDE, Point, row_of
from ..stability.linear_critical import LinearCritical, Stability, linear_critical

#: what a vehicle can be fitted to: linear critical speed; speed of the fold of the limit cycles and amplitude there
RESULTS = ("linear_kmh", "fold_kmh", "fold_amplitude_mm")

#: relative residual below which as many results as unknowns count as met; the search leaves about 1e-7 in the fold's amplitude
MET = 1e-6
MOST_TRIALS = 60

Unknowns = tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class Calibration:
    """A fitted vehicle and how well its results are met.

    `jacobian[i, j]` is the change of result i (its own unit) per logarithm of factor j; `condition` that of the Jacobian with
    the results taken relative to the wanted ones: the factors of a large one are hardly told apart.
    """

    vehicle: Vehicle
    factors: dict[str, float]  # unknown -> factor on its parameters, as the given vehicle has them
    values: dict[str, float]  # parameter -> fitted value, SI
    residuals: dict[str, float]  # result -> computed minus wanted, km/h or mm
    jacobian: np.ndarray
    condition: float
    iterations: int  # number of them

    def __str__(self) -> str:
        lines = [f"Calibration of {self.vehicle.name or '(unnamed)'}, {self.iterations} iterations (fitted, not predicted)"]
        lines += [f"  factor {name}: {factor:.7g}" for name, factor in self.factors.items()]
        lines += [f"  {path} = {value:.8g}" for path, value in self.values.items()]
        lines += [f"  residual of {name}: {value:+.2g}" for name, value in self.residuals.items()]
        return "\n".join([*lines, f"  condition {self.condition:.3g}"])


@guarded(fit=a_table, to=a_table, start=a_table)
def calibrate(
    vehicle: Vehicle,
    fit: dict[str, tuple[str, ...] | str],
    to: dict[str, float],
    *,
    start: dict[str, float] | None = None,
    bounds: tuple[float, float] = (0.01, 100.0),
    damper: Damper = PASSIVE,
    wheelset: int | None = None,
) -> Calibration:
    """The vehicle with uncertain parameters chosen such that its results are the reported ones.

    With more results than unknowns the sum of their squared relative errors is made smallest.

    `scipy.optimize.least_squares` on a logarithmic scale with exact derivatives, of critical speeds by the implicit function and
    of the fold's amplitude by the curvature of the branch. A trial vehicle without a fold makes the step shorter.

    Args:
        vehicle: the vehicle with the values that the factors are of.
        fit: unknowns by name; each is one positive factor on the parameters of its tuple of dotted names.
        to: the wanted results: "linear_kmh" and "fold_kmh" in km/h, "fold_amplitude_mm" in mm.
        start: first value of unknowns by name, dimensionless; 1 where not given.
        bounds: least and greatest factor, dimensionless.
        damper: what takes the place of rho_cy; by default the vehicle's own.
        wheelset: the one whose amplitude at the fold is meant, counted from the front, 0 the first; by default the leading one of
            the trailing bogie.

    Raises:
        InputError: for names that do not exist, values that cannot be scaled, more unknowns than results, an unknown that moves
            no result, results that the vehicle does not have at the start, and in single precision.
        NumericalError: where the results are not met.

    Examples:
        >>> fitted = calibrate(
        ...     literal,
        ...     fit={"guidance": ("primary.stiffness_x", "primary.stiffness_y"), "friction": ("contact.friction",)},
        ...     to={"linear_kmh": 245.6, "fold_kmh": 234.2},
        ...     start={"guidance": 12.6},
        ... )  # doctest: +SKIP
    """
    from scipy.optimize import least_squares  # here, for a quick import of railjax

    require_double_precision("calibrate")
    _check(vehicle, fit, to, start or {}, bounds)
    trial = _Trials(vehicle, tuple(tuple(paths) for paths in fit.values()), tuple(to), damper, wheelset)
    wanted = np.array(list(to.values()))
    first = np.log([(start or {}).get(name, 1.0) for name in fit])
    trial.begin(first)
    unmoved = [name for name, column in zip(fit, trial.jacobian(first).T, strict=True) if not np.any(column)]
    if unmoved:
        raise InputError(f"fit: {unmoved[0]!r} moves none of the results {', '.join(to)}; leave it out")
    solution = least_squares(
        lambda logs: trial.results(logs) / wanted - 1.0,
        first,
        lambda logs: trial.jacobian(logs) / wanted[:, None],
        bounds=tuple(np.log(bounds)),
        xtol=1e-12,
        ftol=1e-14,
        gtol=1e-12,
        max_nfev=MOST_TRIALS,
    )
    residuals = solution.fun * wanted
    if solution.status == 0 or (len(fit) == len(to) and not np.max(np.abs(solution.fun)) <= MET):
        missed = ", ".join(f"{name} {value + error:.6g}" for (name, value), error in zip(to.items(), residuals, strict=True))
        raise NumericalError(f"calibrate did not reach its results; nearest: {missed}; try another start or wider bounds")
    factors = dict(zip(fit, np.exp(solution.x).tolist(), strict=True))
    fitted = trial.vehicle_of(solution.x)
    values = {path: float(get_parameter(fitted, path)) for paths in fit.values() for path in paths}
    return Calibration(
        _marked(fitted, fit, factors, to),
        factors,
        values,
        dict(zip(to, residuals.tolist(), strict=True)),
        trial.jacobian(solution.x),
        float(np.linalg.cond(solution.jac)),
        int(solution.njev),
    )


def _check(vehicle: Vehicle, fit: dict, to: dict, start: dict, bounds: tuple[float, float]) -> None:
    if not fit or not to:
        raise InputError("calibrate: fit and to must each name something")
    for name, value in to.items():
        if name not in RESULTS:
            raise InputError(f"to: no result {name!r}{nearest(name, list(RESULTS))}")
        if not (math.isfinite(value) and value > 0.0):
            raise InputError(f"to: {name} must be positive and finite, not {value:g}")
    if len(fit) > len(to):
        raise InputError(f"calibrate: {len(fit)} unknowns need as many results, but to has {len(to)}; fit fewer")
    if not 0.0 < bounds[0] < bounds[1] < math.inf:
        raise InputError(f"bounds must be two positive factors, the smaller first, not {bounds}")
    for name, factor in start.items():
        if name not in fit:
            raise InputError(f"start: no unknown {name!r}{nearest(name, list(fit))}")
        if not bounds[0] < factor < bounds[1]:
            raise InputError(f"start: {name} must lie between the bounds {bounds[0]:g} and {bounds[1]:g}, not {factor:g}")
    seen: set[str] = set()
    for name, paths in fit.items():
        if isinstance(paths, str) or not paths:
            raise InputError(f"fit: {name!r} must name its parameters in a tuple, like ('contact.friction',)")
        for path in paths:
            value = get_parameter(vehicle, path)
            if path in seen:
                raise InputError(f"fit: {path} is named twice")
            seen.add(path)
            if not is_single(value):
                raise InputError(f"fit: {path} must be a single number, not {shown(value)}")
            if value == 0.0:
                raise InputError(f"fit: {path} is 0, which a factor cannot change; give it a value first")


def _scaled(vehicle: Vehicle, unknowns: Unknowns, logs: Float[Array, "unknowns"]) -> Vehicle:
    for paths, factor in zip(unknowns, jnp.exp(logs), strict=True):
        for path in paths:
            vehicle = set_parameter(vehicle, path, get_parameter(vehicle, path) * factor)
    return vehicle


def _marked(vehicle: Vehicle, fit: dict, factors: dict[str, float], to: dict[str, float]) -> Vehicle:
    """Provenance "calibrated" for all that was fitted."""
    source = ", ".join(f"{name} = {value:g}" for name, value in to.items())
    notes = [
        Provenance(path, "calibrated", f"{name} factor {factors[name]:.8g}, from {source}")
        for name, paths in fit.items()
        for path in paths
    ]
    fitted = {note.parameter for note in notes}
    kept = [entry for entry in vehicle.provenance if entry.parameter not in fitted]
    return dataclasses.replace(vehicle, provenance=(*kept, *notes))


class _Trials:
    """Results and their derivatives at trial factors; the last trial is kept, for SciPy asks for both one after the other."""

    def __init__(
        self, vehicle: Vehicle, unknowns: Unknowns, results: tuple[str, ...], damper: Damper, wheelset: int | None
    ) -> None:
        self.vehicle, self.unknowns, self.names, self.damper = vehicle, unknowns, results, damper
        self.folding = any(name.startswith("fold") for name in results)
        self.wheelset = default_wheelset(vehicle, wheelset)
        self.shooting: Shooting | None = None
        self.at: np.ndarray | None = None

    def vehicle_of(self, logs: np.ndarray) -> Vehicle:
        """With plain floats, so that all trials share compiled code with other calls."""
        vehicle = self.vehicle
        for paths, factor in zip(self.unknowns, np.exp(logs), strict=True):
            for path in paths:
                vehicle = set_parameter(vehicle, path, float(get_parameter(vehicle, path)) * float(factor))
        return vehicle

    def begin(self, logs: np.ndarray) -> None:
        """Choose the steps once, for results must not jump; refuse results that the vehicle does not have."""
        vehicle = self.vehicle_of(logs)
        linear = linear_critical(vehicle, damper=self.damper)
        stability = Stability(int(linear.code))
        if stability != Stability.OK:
            raise InputError(f"to: at the start the vehicle has no linear critical speed ({stability.name}); start elsewhere")
        if not self.folding:
            return
        steps = enough_steps(model_of(vehicle, self.damper), float(linear.speed), float(linear.frequency))
        self.shooting = Shooting(steps, self.wheelset)
        found = nonlinear_critical(vehicle, damper=self.damper, wheelset=self.wheelset, steps=self.shooting.steps)
        hunting = Hunting(int(found.code))
        if hunting == Hunting.SUPERCRITICAL:
            raise InputError("to: at the start the vehicle's limit cycles have no fold (SUPERCRITICAL); start elsewhere")
        if hunting != Hunting.OK:
            raise NumericalError(f"calibrate: at the start no fold was found ({hunting.name}); start elsewhere")

    def _try(self, logs: np.ndarray) -> tuple[LinearCritical, Point | None]:
        """The linear critical speed, and the fold if it is wanted and there is one."""
        if self.at is None or not np.array_equal(self.at, logs):
            vehicle = self.vehicle_of(logs)
            linear = linear_critical(vehicle, damper=self.damper)
            fold = None
            if self.shooting is not None and int(linear.code) == Stability.OK:
                search = FoldSearch(model_of(vehicle, self.damper), self.shooting, float(linear.speed))
                search_folds([search])
                fold = search.fold
            self.at, self.found = logs.copy(), (linear, fold)
        return self.found

    def results(self, logs: np.ndarray) -> np.ndarray:
        """Each in its unit; NaN where there is none."""
        linear, fold = self._try(logs)
        values = {"linear_kmh": float(linear.speed) * KMH}
        if fold is not None:
            values |= {"fold_kmh": fold.unknowns[-1] * SPEED * KMH, "fold_amplitude_mm": fold.amplitude * 1e3}
        found = np.array([values.get(name, np.nan) for name in self.names])
        return np.where(np.isfinite(found), found, np.nan)

    def jacobian(self, logs: np.ndarray) -> np.ndarray:
        """d result / d log factor, (results, unknowns)."""
        _, fold = self._try(logs)
        columns = [self._slopes(logs, direction, fold) for direction in np.eye(len(logs))]
        return np.array([[column.get(name, np.nan) for column in columns] for name in self.names])

    def _slopes(self, logs: np.ndarray, direction: np.ndarray, fold: Point | None) -> dict[str, float]:
        """One unknown at a time, so that what is compiled serves any choice of them."""

        def trees_at(logs: Float[Array, "unknowns"]) -> tuple[Vehicle, Damper]:
            return bare(_scaled(self.vehicle, self.unknowns, logs), self.damper)

        found = {}
        trees, moved = jax.jvp(trees_at, (jnp.asarray(logs),), (jnp.asarray(direction),))
        if "linear_kmh" in self.names:
            speed = jax.jvp(lambda trees: linear_critical(trees[0], damper=trees[1]).speed, (trees,), (moved,))[1]
            found["linear_kmh"] = float(speed) * KMH
        if fold is not None:
            speed, amplitude = _fold_slopes(self.shooting, trees, moved, fold)
            found |= {"fold_kmh": float(speed) * KMH, "fold_amplitude_mm": float(amplitude) * 1e3}
        return found


@functools.partial(jax.jit, static_argnums=0)
def _fold_slopes(shooting: Shooting, trees: tuple, moved: tuple, point: Point) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Derivatives of the fold's speed (m/s) and amplitude (m) where vehicle and damper move along `moved`.

    The speed's is that of `implicit_speed`. At the fold the slope s = dv/dA along the branch vanishes, so dA/dp =
    -(ds/dp)/(ds/dA). As s is the adjoint's share in dr/dx · (tangent), its derivatives are second derivatives of the residual r,
    each along two directions: nested `jvp` of the flow, without any derivative of a Jacobian.
    """

    def model_of_trees(trees: tuple) -> Model:
        vehicle, damper = trees
        return Model(rounded(vehicle), damper)

    def residual(orbit: Float[Array, "orbit"], trees: tuple) -> Float[Array, "states"]:
        model = model_of_trees(trees)
        start = unpack(model, shooting, orbit)
        return section(model, shooting, start) - start.state / model.scales

    model, orbit = model_of_trees(trees), point.unknowns
    row = row_of(model, shooting, BY_AMPLITUDE)
    bordered = jnp.vstack([point.jacobian, row])
    along = point.direction / (row @ point.direction)

    def slope(orbit: Float[Array, "orbit"], trees: tuple) -> Float[Array, ""]:
        """s, as far as its first derivatives at the fold go."""
        return -point.adjoint @ jax.jvp(lambda x: residual(x, trees), (orbit,), (along,))[1]

    curvature = jax.jvp(lambda x: slope(x, trees), (orbit,), (along,))[1]
    pushed = jax.jvp(lambda trees: residual(orbit, trees), (trees,), (moved,))[1]
    # the orbit of the same amplitude
    same = -jnp.linalg.solve(bordered, jnp.append(pushed, 0.0))
    bent = jax.jvp(slope, (orbit, trees), (same, moved))[1]
    return -point.adjoint @ pushed * SPEED, -bent / curvature * DISPLACEMENT
