"""The nonlinear critical speed: the lowest at which a limit cycle exists, the fold of its branch; and its gradient."""

import dataclasses
from collections.abc import Sequence
from enum import IntEnum
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float, Int

from ...base.arguments import guarded
from ...base.errors import InputError, NumericalError
from ...base.host import Answer, HostFunction
from ...base.precision import require_double_precision
from ...base.units import KMH
from ...model.damper import Damper
from ...model.motion import PASSIVE, wheelset_shape
from ...model.parameters import bare
from ...model.vehicle import Vehicle
from ...simulation.step_size import STABLE_RADIUS
from ..linear_critical import HIGHEST, LinearCritical, Stability, linear_critical
from .continuation import wheelset_mode
from .fold_search import FoldSearch, KnownFolds, search_folds
from .orbits import Model, Shooting, fastest, rounded, unpack
from .shooting import speed_slopes

#: fewest steps of RK4 in half a period; the fold of the coach moves by less than 1e-4 km/h when they are doubled
FEWEST_STEPS = 200


class Hunting(IntEnum):
    """What the search for the nonlinear critical speed found."""

    OK = 0
    SUPERCRITICAL = 1  # no fold below the linear critical speed, which is then the nonlinear one as well
    STABLE = 2  # straight running is stable, and no limit cycle was found, up to the highest speed: infinity
    UNSTABLE = 3  # unstable at the lowest speed already: NaN
    FAILED = 4  # no limit cycle was found, or its branch could not be followed to a fold: NaN
    STEP_TOO_LARGE = 5  # RK4 does not hold the step that the period is cut into: give more `steps`; NaN


class NonlinearCritical(NamedTuple):
    """Nonlinear critical speed (m/s); amplitude (m) and frequency (Hz) of the limit cycle at the fold; the linear critical
    speed beside it; a `Hunting` code."""

    speed: Float[Array, "..."]
    amplitude: Float[Array, "..."]
    frequency: Float[Array, "..."]
    linear: LinearCritical
    code: Int[Array, "..."]

    def as_dict(self) -> dict[str, Any]:
        """Of a single vehicle that has one, plain numbers for JSON; without a fold it is the linear one, and amplitude and frequency null."""
        folded = int(self.code) == Hunting.OK
        return {
            "nonlinear_kmh": float(self.speed) * KMH,
            "fold_amplitude_mm": float(self.amplitude) * 1e3 if folded else None,
            "fold_frequency_hz": float(self.frequency) if folded else None,
            "criticality": ("subcritical" if np.isfinite(self.linear.speed) else "isolated") if folded else "supercritical",
        }


def told(found: NonlinearCritical, vehicle: Vehicle) -> str:
    """One line on the nonlinear critical speed of a single vehicle that has one."""
    if int(found.code) != Hunting.OK:
        return "no fold: limit cycles leave the linear critical speed upwards (supercritical), so it is the nonlinear one"
    place = f"wheelset {default_wheelset(vehicle, None) + 1} from the front"
    return (
        f"nonlinear critical speed {float(found.speed) * KMH:.2f} km/h: fold of the limit cycles at "
        f"{float(found.amplitude) * 1e3:.3f} mm ({place}), {float(found.frequency):.3f} Hz"
    )


@guarded()
def nonlinear_critical_speed(
    vehicle: Vehicle, *, damper: Damper = PASSIVE, wheelset: int | None = None, steps: int | None = None
) -> Float[Array, "..."]:
    """Lowest speed (m/s) at which a limit cycle exists: the fold (saddle-node) of the branch of hunting motions.

    Above it a disturbance that is large enough makes the vehicle hunt; below it none does. Where there is no fold (the branch
    leaves the Hopf point towards higher speeds, supercritical) it is the linear critical speed itself. A vehicle that is linearly
    stable at all speeds may hunt all the same, as where yaw dampers blow off: its limit cycles are isolated, and end in a fold
    too.

    Differentiable with respect to every float of the vehicle, in both modes, by implicit differentiation of the periodic orbit at
    the fold (no simulation is differentiated). How it is found: `nonlinear_critical`.

    Args:
        vehicle: the vehicle, or a batch with lanes in any of its numbers.
        damper: what takes the place of rho_cy; by default the vehicle's own. It may have lanes too.
        wheelset: the one whose amplitude is followed, counted from the front, 0 the first; by default the leading one of the
            trailing bogie.
        steps: number of RK4's steps in half a period; by default enough for the fastest motion, at least 200.

    Returns:
        The speed, m/s, one per lane: infinity where no limit cycle was found up to 150 m/s, NaN where no fold could be computed;
        `nonlinear_critical` tells which.

    Raises:
        NumericalError: for a single vehicle that has no such speed.
        InputError: inside `jax.jit`, for a wheelset that is not there, and in single precision.
    """
    found = nonlinear_critical(vehicle, damper=damper, wheelset=wheelset, steps=steps)
    if not isinstance(found.code, jax.core.Tracer) and found.code.ndim == 0:
        refuse(found.code)
    return found.speed


def refuse(code: Int[Array, ""]) -> None:
    """Raise `NumericalError` where there is no nonlinear critical speed."""
    reason = {
        Hunting.STABLE: f"straight running is stable and no limit cycle was found up to {HIGHEST * KMH:.0f} km/h",
        Hunting.UNSTABLE: "straight running is unstable at all speeds tried",
        Hunting.FAILED: "the branch of limit cycles could not be followed to a fold; draw it with hunting_branch",
        Hunting.STEP_TOO_LARGE: "RK4 does not hold that few steps in half a period; give more steps",
    }.get(Hunting(int(code)))
    if reason:
        raise NumericalError(f"no nonlinear critical speed: {reason}")


@guarded()
def nonlinear_critical(
    vehicle: Vehicle, *, damper: Damper = PASSIVE, wheelset: int | None = None, steps: int | None = None
) -> NonlinearCritical:
    """As `nonlinear_critical_speed`, with amplitude, frequency and result code instead of errors.

    The vehicle is simulated from large disturbances (both bogies hunting in phase, opposite, or one of them) at shares of 0.45 to
    1.02 of the linear critical speed, or of 0.2 to 1 of the highest speed where straight running is stable at all, all at once.
    The limit cycle at the lowest speed is followed down to its fold; then the same is done at shares of 0.8 to 0.9995 of the
    fold's speed, until no motion goes on below a fold. So what is found is the end of the motions that a vehicle settles on, as a
    slow ramp down would show. Of many vehicles, those that are little different from one that has been searched take their fold
    from that one's, and only the motions below it are tried.

    The search runs on the host: `jax.grad` and `jax.vmap` work, but not `jax.jit`.

    Args:
        vehicle: the vehicle, or a batch with lanes in any of its numbers.
        damper: what takes the place of rho_cy; by default the vehicle's own. It may have lanes too.
        wheelset: the one whose amplitude is given, counted from the front, 0 the first; by default the leading one of the
            trailing bogie, as in the paper's fig. 6.
        steps: number of RK4's steps in half a period; by default enough for the fastest motion of the vehicle, at least 200.

    Raises:
        InputError: inside `jax.jit`, for a wheelset that is not there, and in single precision.
    """
    return found_beside(None, vehicle, damper, wheelset, steps)


def found_beside(
    known: KnownFolds | None, vehicle: Vehicle, damper: Damper, wheelset: int | None = None, steps: int | None = None
) -> NonlinearCritical:
    """`nonlinear_critical` for one trial of many: the vehicle takes its fold from the nearest of those that are `known`, as one lane of a
    batch does from another, and is added to them.

    Args:
        known: what earlier trials found; None to search from nothing.
        vehicle: as there.
        damper: as there.
        wheelset: as there.
        steps: as there, their number.
    """
    require_double_precision("the nonlinear critical speed")
    linear = linear_critical(vehicle, damper=damper)
    given = bare(rounded(vehicle), damper), (linear.speed, linear.frequency, linear.code)
    found = _searched(given, default_wheelset(vehicle, wheelset), steps, known)
    return NonlinearCritical(*found[:3], linear, found[3])  # type: ignore[call-arg]


def default_wheelset(vehicle: Vehicle, wheelset: int | None) -> int:
    """The leading wheelset of the trailing bogie, or the one given, checked."""
    bogies, axles = wheelset_shape(vehicle)
    if wheelset is None:
        return (bogies - 1) * axles
    if not 0 <= wheelset < bogies * axles:
        raise InputError(f"wheelset must lie between 0 and {bogies * axles - 1}, counted from the front, not {wheelset}")
    return wheelset


def enough_steps(model: Model, speed: float, frequency: float) -> int:
    """Steps in half a period of hunting for the fastest motion of the vehicle, at half the `speed` (m/s), for the branch may lead far down."""
    needed = fastest(model, 0.5 * speed) * 0.5 / frequency / STABLE_RADIUS
    return max(FEWEST_STEPS, 100 * int(np.ceil(needed / 100.0))) if np.isfinite(needed) else FEWEST_STEPS


def search_of(
    model: Model, speed: float, frequency: float, wheelset: int, steps: int | None, symmetric: bool = True
) -> FoldSearch:
    """The search for a vehicle of this linear critical speed (m/s; infinite where there is none) and frequency (Hz)."""
    stable = not np.isfinite(speed)
    if stable:
        speed = HIGHEST
        frequency = wheelset_mode(model, Shooting(FEWEST_STEPS, wheelset), 0.5 * speed)[1] / (2.0 * np.pi)
    half = enough_steps(model, speed, frequency) if steps is None else steps
    symmetric = symmetric and model.alike
    return FoldSearch(model, Shooting(half if symmetric else 2 * half, wheelset, symmetric), speed, stable)


def _many(lanes: Sequence[tuple], slopes: bool, wheelset: int, steps: int | None, known: KnownFolds | None) -> Answer:
    """Speed, amplitude, frequency and code of each lane: (vehicle, damper), (linear critical speed, frequency, code)."""
    searches: dict[int, FoldSearch] = {}
    for k, (trees, (speed, frequency, code)) in enumerate(lanes):
        if code in (Stability.OK, Stability.STABLE):
            searches[k] = search_of(Model(*trees), float(speed), float(frequency), wheelset, steps)
    _search(searches, known)
    if steps is None:
        finer = {k: again for k, search in searches.items() if (again := _finer(search)) is not None}
        _search(finer, known)
        searches |= finer
    rows = [judged(searches.get(k), *(float(value) for value in linear)) for k, (_, linear) in enumerate(lanes)]
    values = tuple(np.array(column) for column in zip(*rows, strict=True))
    return Answer(values, [_slopes(searches.get(k), lane, values[3][k]) for k, lane in enumerate(lanes)] if slopes else None)


def _search(searches: dict[int, FoldSearch], known: KnownFolds | None) -> None:
    """Those together whose orbits are looked for in the same way."""
    for symmetric in (True, False):
        some = [search for search in searches.values() if search.shooting.symmetric == symmetric]
        if some:
            search_folds(some, known)


def _finer(search: FoldSearch) -> FoldSearch | None:
    """The search with more steps, where the fold has a longer period than those were chosen for."""
    if search.fold is None:
        return None
    orbit = unpack(search.model, search.shooting, search.fold.unknowns)
    enough = enough_steps(search.model, 2.0 * float(orbit.speed), 1.0 / float(orbit.period)) * search.shooting.halves
    if enough <= search.shooting.steps:
        return None
    return FoldSearch(search.model, dataclasses.replace(search.shooting, steps=enough), search.hopf, search.stable)


def judged(search: FoldSearch | None, speed: float, frequency: float, code: float) -> tuple[float, float, float, Hunting]:
    """Speed, amplitude and frequency, values only where there are any, and the code.

    Args:
        search: that was made; None where none was.
        speed: linear critical speed, m/s.
        frequency: of its mode, Hz.
        code: `Stability`.
    """
    if search is None:
        return np.nan, np.nan, np.nan, Hunting.UNSTABLE if code == Stability.UNSTABLE else Hunting.FAILED
    fold = search.fold
    if fold is None and search.stable:  # where something goes on that is no limit cycle nothing is proved
        return (np.inf, np.nan, np.nan, Hunting.STABLE) if search.doubtful is None else (np.nan, np.nan, np.nan, Hunting.FAILED)
    orbit = None if fold is None else unpack(search.model, search.shooting, fold.unknowns)
    # where no fold was found it is at the Hopf point that the step is judged
    at = (speed, frequency) if orbit is None else (float(orbit.speed), 1.0 / float(orbit.period))
    if 0.5 * search.shooting.halves / at[1] / search.shooting.steps * fastest(search.model, at[0]) > STABLE_RADIUS:
        return np.nan, np.nan, np.nan, Hunting.STEP_TOO_LARGE
    if fold is not None and at[0] < speed:
        return at[0], fold.amplitude, at[1], Hunting.OK
    if fold is not None or search.vanished:
        return speed, 0.0, frequency, Hunting.SUPERCRITICAL
    return np.nan, np.nan, np.nan, Hunting.FAILED


def _slopes(search: FoldSearch | None, lane: tuple, code: int | np.integer) -> list[np.ndarray]:
    """Derivative of the speed by each number of the lane but the code; zero where there is none, so that such a lane does not spoil a sum's."""
    trees, (speed, frequency, _) = jax.tree.map(np.zeros_like, lane)
    if search is not None and code == Hunting.OK:
        trees = speed_slopes(search.model, search.shooting, search.fold)
    return [*jax.tree.leaves(trees), np.ones_like(speed) if code == Hunting.SUPERCRITICAL else speed, frequency]


_searched = HostFunction(
    "the nonlinear critical speed",
    _many,
    (float, float, float, int),
)
