"""The nonlinear critical speed in a curve: the fold of the limit cycles about the equilibrium, shot over whole periods."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float, Int

from ...base.arguments import guarded
from ...base.host import Answer, HostFunction
from ...base.packing import as_numbers
from ...base.precision import require_double_precision
from ...base.typing import Scalar
from ...model.damper import Damper
from ...model.motion import PASSIVE
from ...model.parameters import without_labels
from ...model.track.curve import CANT_BASE, GRAVITY, BalancedArc
from ...model.vehicle import Vehicle
from ..hunting.fold_search import FoldSearch, search_folds
from ..hunting.nonlinear_critical import Hunting, default_wheelset, judged, search_of
from ..hunting.orbits import Model, rounded
from ..hunting.shooting import speed_slopes
from ..linear_critical import Stability
from .critical import CurveCritical, balanced_cant, curve_critical
from .result import Equilibrium
from .steady import A_CANT, a_radius, equilibria


class CurveNonlinear(NamedTuple):
    """Nonlinear critical speed in a curve (m/s); amplitude (m) of the limit cycle at the fold, about the equilibrium, and its frequency
    (Hz); the linear critical speed beside it; a `Hunting` code."""

    speed: Float[Array, "..."]
    amplitude: Float[Array, "..."]
    frequency: Float[Array, "..."]
    linear: CurveCritical
    code: Int[Array, "..."]


@guarded(radius=a_radius, cant_deficiency=A_CANT)
def curve_nonlinear_critical(
    vehicle: Vehicle,
    *,
    radius: Scalar,
    cant_deficiency: Scalar,
    damper: Damper = PASSIVE,
    wheelset: int | None = None,
    steps: int | None = None,
) -> CurveNonlinear:
    """Lowest speed (m/s) at which a limit cycle exists in an arc whose cant follows the speed, as `nonlinear_critical` has it on straight track.

    At a constant cant deficiency the equilibrium is the same at all speeds. Limit cycles about it are not alike to both sides, so they are
    shot over whole periods. Differentiable by every float of the vehicle, by radius and deficiency, outside of `jit`.

    Args:
        vehicle: the vehicle, or a batch with lanes in any of its numbers.
        radius: R, m, positive to the right.
        cant_deficiency: m.
        damper: what takes the place of rho_cy; by default the vehicle's own.
        wheelset: the one whose amplitude is given, counted from the front, 0 the first; by default the leading one of the trailing
            bogie.
        steps: number of RK4's steps in half a period; by default enough for the fastest motion.

    Returns:
        Speed (m/s), amplitude (m), frequency (Hz), the linear critical speed and the code.

    Raises:
        InputError: inside `jax.jit`, for a wheelset that is not there, and in single precision.
    """
    require_double_precision("the nonlinear critical speed in a curve")
    vehicle = rounded(vehicle)
    linear = curve_critical(vehicle, radius=radius, cant_deficiency=cant_deficiency, damper=damper)
    trees = as_numbers((without_labels(vehicle), damper, radius, cant_deficiency))
    known = tuple(jax.lax.stop_gradient(part) for part in (linear.speed, linear.frequency, linear.code))
    found = _searched((trees, known), default_wheelset(vehicle, wheelset), steps)
    return CurveNonlinear(*found[:3], linear, found[3])  # type: ignore[call-arg]


def _model(trees: tuple, speed: float) -> Model | None:
    """The vehicle about its equilibrium; None where there is none."""
    vehicle, damper, radius, deficiency = (jax.tree.map(lambda leaf: np.asarray(leaf, float), tree) for tree in trees)
    cant = balanced_cant(speed, radius, deficiency)
    told = equilibria(vehicle, damper, np.full(1, speed), radius, np.full(1, cant))
    if int(told["code"][0]) != int(Equilibrium.OK):
        return None
    sideways = GRAVITY / CANT_BASE * deficiency * np.sign(radius)
    return Model(vehicle, damper, BalancedArc(np.asarray(1.0 / radius), np.asarray(sideways), told["state"][:, 0]))


def _many(lanes: Sequence[tuple], slopes: bool, wheelset: int, steps: int | None) -> Answer:
    searches: dict[int, FoldSearch] = {}
    for k, (trees, (speed, frequency, code)) in enumerate(lanes):
        # where the curve is stable at all speeds, at one that any vehicle runs at
        model = _model(trees, float(speed) if np.isfinite(speed) else 30.0)
        if model is not None and code in (Stability.OK, Stability.STABLE):
            searches[k] = search_of(model, float(speed), float(frequency), wheelset, steps)
    if searches:
        search_folds(list(searches.values()))
    rows = []
    for k, (_, linear) in enumerate(lanes):
        search = searches.get(k)
        speed, amplitude, frequency, code = judged(search, *(float(value) for value in linear))
        if search is not None and code == Hunting.OK:
            amplitude -= search.model.offset[wheelset]
        rows.append((speed, amplitude, frequency, code))
    values = tuple(np.array(column) for column in zip(*rows, strict=True))
    return Answer(values, [_slopes(searches.get(k), lane, values[3][k]) for k, lane in enumerate(lanes)] if slopes else None)


def _slopes(search: FoldSearch | None, lane: tuple, code: int | np.integer) -> list[np.ndarray]:
    """Derivative of the fold's speed by each number of the lane; zero where there is no fold."""
    (vehicle, damper, radius, deficiency), known = jax.tree.map(lambda leaf: np.zeros(np.shape(leaf)), lane)
    if search is not None and code == Hunting.OK:
        found, given = speed_slopes(search.model, search.shooting, search.fold), lane[0][2]
        vehicle, damper = found.vehicle, found.damper
        radius = -np.asarray(found.arc.curvature) / given**2
        deficiency = np.asarray(found.arc.sideways) * GRAVITY / CANT_BASE * np.sign(given)
    floats = known[:2]
    return [np.asarray(leaf) for leaf in jax.tree.leaves(((vehicle, damper, radius, deficiency), floats))]


_searched = HostFunction("curve_nonlinear_critical", _many, (float, float, float, int))
