"""Ready-made studies for `railjax.sweep`, and `each_point`, which makes one of a function written for a single point."""

import functools
import inspect
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..base.arguments import guarded
from ..base.batches import Batch
from ..base.fields import parameter
from ..base.precision import require_double_precision
from ..base.typing import Scalar
from ..model.damper import Damper
from ..model.motion import PASSIVE, state_matrix
from ..model.parameters import without_labels
from ..model.track.shapes import TangentTrack, Track
from ..model.vehicle import Vehicle
from ..ride.frequency import frequency_response
from ..ride.spectral_comfort import spectral_comfort
from ..simulation.simulate import Simulation, simulate
from ..simulation.speed import Speed
from ..stability.hunting.nonlinear_critical import Hunting, nonlinear_critical
from ..stability.linear_critical import LinearCritical, Stability, linear_critical
from ..stability.modes import LeastDamped, least_damped
from .conicity_map import EquivalentConicity

TANGENT = TangentTrack()


@dataclass(frozen=True)
class ForcedRun:
    """Reductions of a run over a track (`simulate`'s `reduce`), such as "rms:carbody_acceleration"; nothing else is kept.

    `duration`, `dt` and `settle` in s, `initial` as those of `simulate`. A lane that diverged or whose step is too large is NaN.
    """

    reduce: tuple[str, ...] = ("rms:carbody_acceleration",)
    duration: float = parameter("s", "", "duration of the run", 10.0, positive=True)
    dt: float = parameter("s", "", "step of RK4", 1e-3, positive=True)
    settle: float = parameter("s", "", "time before the reductions begin", 0.0)
    initial: Any = None

    chunk: ClassVar[int] = 4096

    def __call__(self, vehicle: Vehicle, speed: Speed, track: Track = TANGENT, damper: Damper = PASSIVE) -> Simulation:
        """All lanes together."""
        options = {"duration": self.duration, "dt": self.dt, "settle": self.settle, "initial": self.initial}
        return simulate(vehicle, speed, track=track, damper=damper, record=(), reduce=tuple(self.reduce), **options)


@dataclass(frozen=True)
class CriticalSpeed:
    """Linear critical speed and the frequency of its mode (`linear_critical`); inf where stable at all speeds."""

    units: ClassVar[dict[str, str]] = {"critical_speed": "m/s", "critical_frequency": "Hz"}
    codes: ClassVar[type[IntEnum]] = Stability
    chunk: ClassVar[int] = 512

    def __call__(self, vehicle: Vehicle, damper: Damper = PASSIVE) -> dict[str, Array]:
        """All lanes, one after another."""
        found: LinearCritical = linear_critical(vehicle, damper=damper)
        return {"critical_speed": found.speed, "critical_frequency": found.frequency, "code": found.code}


@dataclass(frozen=True)
class NonlinearCriticalSpeed:
    """Nonlinear critical speed: the fold of the limit cycles with its amplitude (of `wheelset`) and frequency, beside the linear
    one (`nonlinear_critical`, whose default of `steps` looks at all points of a chunk together: give it to compare chunks)."""

    wheelset: int | None = None
    steps: int | None = None

    units: ClassVar[dict[str, str]] = {
        "nonlinear_critical_speed": "m/s",
        "fold_amplitude": "m",
        "fold_frequency": "Hz",
        "critical_speed": "m/s",
    }
    codes: ClassVar[type[IntEnum]] = Hunting
    chunk: ClassVar[int] = 64

    def __call__(self, vehicle: Vehicle, damper: Damper = PASSIVE) -> dict[str, Array]:
        """All lanes, gathered."""
        found = nonlinear_critical(vehicle, damper=damper, wheelset=self.wheelset, steps=self.steps)
        return {
            "nonlinear_critical_speed": found.speed,
            "fold_amplitude": found.amplitude,
            "fold_frequency": found.frequency,
            "critical_speed": found.linear.speed,
            "code": found.code,
        }


@dataclass(frozen=True)
class LeastDamping:
    """The least damped mode of straight running at a speed (`stability.modes.least_damped`): damping ratio ζ = -Re λ/|λ|, -1 where the
    vehicle leans over without oscillating, and frequency; and the largest growth rate Re λ of all modes, which is negative where
    running is stable."""

    units: ClassVar[dict[str, str]] = {"least_damping_ratio": "1", "frequency": "Hz", "growth": "1/s"}
    chunk: ClassVar[int] = 4096

    def __call__(self, vehicle: Vehicle, speed: Scalar, damper: Damper = PASSIVE) -> dict[str, Array]:
        """All lanes, one after another."""
        require_double_precision("the damping of the modes")
        trees = (without_labels(vehicle), speed, damper)
        return dict(zip(self.units, _least_damped(trees), strict=True))


@jax.jit
def _least_damped(trees: tuple) -> LeastDamped:
    def single(vehicle: Vehicle, speed: Scalar, damper: Damper) -> LeastDamped:
        return least_damped(jnp.linalg.eigvals(state_matrix(vehicle, speed, damper)))

    batch = Batch.of(*trees)
    if batch.lanes is None:
        return single(*trees)
    # LAPACK lane by lane, on one device
    return batch.in_chunks(lambda *chunk: Batch.of(*chunk).each(single), chunk=1)


class Stationary(IntEnum):
    """Whether the linearised vehicle has a stationary response."""

    OK = 0
    UNSTABLE = 1


@dataclass(frozen=True)
class RideComfort:
    """Lateral ride comfort of the linearised vehicle on a random track of that `spectrum`, at the worst of three places on the floor
    (`frequency_response`, `spectral_comfort`): weighted r.m.s., N_MV and Sperling's Wz, without time integration."""

    spectrum: str = "erri-high"

    units: ClassVar[dict[str, str]] = {"weighted_rms": "m/s^2", "mean_comfort": "1", "sperling": "1"}
    codes: ClassVar[type[IntEnum]] = Stationary
    chunk: ClassVar[int] = 256

    def __call__(self, vehicle: Vehicle, speed: Scalar, damper: Damper = PASSIVE) -> dict[str, Array]:
        """All lanes together."""
        response = frequency_response(vehicle, speed, self.spectrum, damper=damper, record=("floor_acceleration",))
        found = [jnp.max(values, axis=0) for values in spectral_comfort(response)]
        stable = response.growth < 0.0
        return dict(zip(self.units, found, strict=True)) | {
            "code": jnp.where(stable, int(Stationary.OK), int(Stationary.UNSTABLE))
        }


#: ready-made studies by the names that study files use
READY_MADE: dict[str, type] = {
    "forced-run": ForcedRun,
    "critical-speed": CriticalSpeed,
    "nonlinear-critical-speed": NonlinearCriticalSpeed,
    "least-damping": LeastDamping,
    "ride-comfort": RideComfort,
    "equivalent-conicity": EquivalentConicity,
}


class EachPoint:
    """A study of a function for one point; see `each_point`."""

    def __init__(self, function: Callable[..., Any], traced: bool):
        functools.update_wrapper(self, function)
        self.traced = traced

    def __reduce__(self) -> Any:
        # a decorated function is found by its name, under which pickle would not find the bare one
        found = getattr(sys.modules.get(self.__module__), self.__qualname__, None)
        by_name = found is self and self.__module__ != "__main__"
        return self.__qualname__ if by_name else (EachPoint, (self.__wrapped__, self.traced))

    def __call__(self, **given: Any) -> Any:
        """All lanes, one after another."""
        given = {name: without_labels(value) if isinstance(value, Vehicle) else value for name, value in given.items()}
        if self.traced:
            return self._mapped(given)
        return self._in_python(given)

    @functools.cached_property
    def _mapped(self) -> Callable[[dict], Any]:
        return jax.jit(lambda given: Batch.of(given).one_by_one(lambda one: self.__wrapped__(**one)))

    def _in_python(self, given: dict[str, Any]) -> dict[str, Any]:
        batch = Batch.of(given)
        found = []
        for lane in range(batch.lanes or 0):
            (one,) = batch.take(lane)
            found.append(as_dictionary(self.__wrapped__(**jax.tree.map(_plain, one))))
        return {name: np.stack([np.asarray(entry[name]) for entry in found], axis=-1) for name in found[0]}


@guarded()
def each_point(function: Callable[..., Any] | None = None, *, traced: bool = True) -> EachPoint | Callable[..., EachPoint]:
    """A study (see `sweep`) of a function that is written for one point, whose arguments are then plain numbers.

    >>> @each_point
    ... def study(vehicle, speed): ...

    The points are taken one after another, shared out among the devices, by a compiled loop. For what JAX cannot trace (NumPy,
    `nonlinear_critical`, `hunting_branch`, a program of one's own) `each_point(traced=False)`: called in Python, on floats, one core; an `executor`
    spreads it.
    """
    if function is None:
        return functools.partial(each_point, traced=traced)
    return EachPoint(function, traced)


def _plain(leaf: Any) -> Any:
    """A number as Python's."""
    return leaf.item() if np.ndim(leaf) == 0 and hasattr(leaf, "item") else leaf


def as_dictionary(result: Any) -> dict[str, Any]:
    """What a study returns by name: a dictionary, a named tuple, or a single array, which is called "result"."""
    if isinstance(result, Mapping):
        return dict(result)
    return result._asdict() if hasattr(result, "_asdict") else {"result": result}


def arguments_of(study: Callable[..., Any]) -> dict[str, bool]:
    """The arguments that a study takes by name, and whether they may be left out."""
    found = inspect.signature(study).parameters.values()
    by_name = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    return {p.name: p.default is not inspect.Parameter.empty for p in found if p.kind in by_name}
