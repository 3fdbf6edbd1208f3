"""Objectives and constraints for `railjax.tune`, each with the derivative that suits it.

    comfort, travel, guiding_force    random track: frequency domain (reverse mode); any track in time: forward mode
    linear_critical_speed, least_damping    eigenvalues, by left and right eigenvectors
    nonlinear_critical_speed, limit_cycle_amplitude    periodic orbits, by the implicit function
    wear, guiding_force, angle_of_attack, derailment_quotient    steady curving, by the implicit function

Each is a function that returns a `Quantity`; `quantity >= limit` and `quantity <= limit` (SI) are constraints. A run that hunts is
never differentiated through time: that is refused, and the message names what to use instead.

>>> from railjax import objectives as aim
>>> aim.comfort(55.0), aim.linear_critical_speed() >= 72.0, aim.travel(55.0) <= 0.06  # doctest: +SKIP
"""

import dataclasses
from dataclasses import dataclass
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..base.arguments import SPEED
from ..base.errors import InputError
from ..base.fields import structure
from ..base.pytrees import registered
from ..base.typing import Number, Scalar
from ..base.units import KMH
from ..model.damper import Damper, answers, with_law
from ..model.motion import state_matrix
from ..model.vehicle import Vehicle
from ..ride.weightings import check_weighting
from ..simulation.channels import CHANNELS, check_channel
from ..stability import linear_critical as linear
from ..stability.hunting import limit_cycles
from ..stability.hunting import nonlinear_critical as critical
from ..stability.hunting.fold_search import KnownFolds
from ..stability.modes import least_damped
from .forced import response_over
from .in_curves import CANT, CANT_DEFICIENCY, critical_in_curve, in_curve
from .quantity import Quantity, kmh

METHODS = ("auto", "frequency", "statistical", "time")
#: of a Gaussian signal 99.73 % lie within three standard deviations; EN 14363 judges forces by the 99.85 and 0.15 % percentiles
PEAK_FACTOR = 3.0


def comfort(
    speeds: Any,
    track: Any = "erri-high",
    *,
    weighting: str | None = "Wd",
    channel: str = "carbody_acceleration",
    method: str = "auto",
    **run: Any,
) -> Quantity:
    """Weighted r.m.s. of an acceleration, m/s^2: the root mean square over all speeds and tracks, of several places the worst.

    Args:
        speeds: one or several, shape `(speeds,)`, m/s.
        track: a spectrum (a name, a table, a formula), a `RandomTrack`, by method "time" any track, or several of these in a
            list.
        weighting: name of a frequency weighting, as `weighting` has them; None for the plain r.m.s.
        channel: of the vehicle, from `railjax.CHANNELS`.
        method: "frequency" (linear; exact and in milliseconds), "statistical" (equivalent creep, flange and balance logic) or
            "time" (forward mode through a forced run; refused where the vehicle hunts). "auto" is "time" for tracks that are no
            random ones, "statistical" for balance logic and laws of your own without memory, else "frequency".
        **run: `duration`, `settle` and `dt` of the runs of method "time", s.

    Raises:
        InputError: for speeds, names or options that cannot be; where the damper has no law for the method it is `tune` that
            raises.
    """
    if weighting is not None:
        check_weighting(weighting)
    return _response("comfort", speeds, track, channel, weighting, 1.0, method, run)


def travel(
    speeds: Any,
    track: Any = "erri-high",
    *,
    peak_factor: Scalar = PEAK_FACTOR,
    method: str = "auto",
    **run: Any,
) -> Quantity:
    """Largest lateral travel of the secondary suspension, m: of all speeds, tracks and bogies the greatest.

    Args:
        speeds: one or several, shape `(speeds,)`, m/s.
        track: a spectrum, a `RandomTrack`, by method "time" any track, or several of these in a list, as in `comfort`.
        peak_factor: on a random track the times of the r.m.s. that count as the peak, dimensionless, by default 3; by method
            "time" the peak is the run's own.
        method: as in `comfort`.
        **run: `duration`, `settle` and `dt` of the runs of method "time", s.

    Raises:
        InputError: as in `comfort`.
    """
    return _response("secondary travel", speeds, track, "secondary_travel", None, peak_factor, method, run)


def guiding_force(
    speeds: Any = None,
    track: Any = "erri-high",
    *,
    radius: Scalar | None = None,
    cant: Scalar = CANT,
    cant_deficiency: Scalar | None = None,
    peak_factor: Scalar = PEAK_FACTOR,
    method: str = "auto",
    **run: Any,
) -> Quantity:
    """Largest lateral force of the track on a wheelset (ΣY), N: of all speeds, tracks and wheelsets the greatest. With a `radius` instead the
    largest force of a rail on a wheel (Y) in steady curving.

    Args:
        speeds: one or several, shape `(speeds,)`, m/s; in a curve one, or none, as in `wear`.
        track: a spectrum, a `RandomTrack`, by method "time" any track, or several of these in a list, as in `comfort`.
        radius: R of a curve, m; by default it is random tracks that are run on.
        cant: of the curve's outer rail, m.
        cant_deficiency: of the curve, m, as in `wear`.
        peak_factor: on a random track the times of the r.m.s. that count as the peak, dimensionless, by default 3; by method
            "time" the peak is the run's own.
        method: as in `comfort`.
        **run: `duration`, `settle` and `dt` of the runs of method "time", s.

    Raises:
        InputError: as in `comfort`.
    """
    if radius is not None:
        return in_curve("guiding force", radius, None if speeds is None else _one(speeds), cant, cant_deficiency)
    if speeds is None:
        raise InputError("guiding_force needs speeds (m/s), or the radius of a curve")
    return _response("guiding force", speeds, track, "guiding_force", None, peak_factor, method, run)


def wear(radius: Scalar, speed: Scalar | None = None, *, cant: Scalar = CANT, cant_deficiency: Scalar | None = None) -> Quantity:
    """Wear number T gamma of all wheels in steady curving, N.

    Args:
        radius: R, m, positive to the right.
        speed: v, m/s; None: that of cant and cant deficiency together.
        cant: of the outer rail, m.
        cant_deficiency: instead of a speed, m; 0.1 if neither is given.

    Raises:
        InputError: for numbers that cannot be, and for both a speed and a deficiency.
    """
    return in_curve("wear", radius, speed, cant, cant_deficiency)


def angle_of_attack(
    radius: Scalar, speed: Scalar | None = None, *, cant: Scalar = CANT, cant_deficiency: Scalar | None = None
) -> Quantity:
    """Largest angle of attack of a wheelset against the outer rail in steady curving, rad.

    Args:
        radius: R, m, positive to the right.
        speed: v, m/s, as in `wear`.
        cant: of the outer rail, m.
        cant_deficiency: m, as in `wear`.

    Raises:
        InputError: as in `wear`.
    """
    return in_curve("angle of attack", radius, speed, cant, cant_deficiency)


def derailment_quotient(
    radius: Scalar, speed: Scalar | None = None, *, cant: Scalar = CANT, cant_deficiency: Scalar | None = None
) -> Quantity:
    """Largest Y/Q of a wheel that presses its rail outwards in steady curving, dimensionless.

    Args:
        radius: R, m, positive to the right.
        speed: v, m/s, as in `wear`.
        cant: of the outer rail, m.
        cant_deficiency: m, as in `wear`.

    Raises:
        InputError: as in `wear`.
    """
    return in_curve("Y/Q", radius, speed, cant, cant_deficiency)


def curve_critical_speed(radius: Scalar, *, cant_deficiency: Scalar = CANT_DEFICIENCY) -> Quantity:
    """Linear critical speed (m/s) in a curve of `radius` (m), at a cant that follows the speed so that the `cant_deficiency` (m) stays."""
    return critical_in_curve(radius, cant_deficiency)


def _response(
    label: str, speeds: Any, track: Any, channel: str, weighting: str | None, factor: Scalar, method: str, run: dict[str, Any]
) -> Quantity:
    check_channel(channel)
    if CHANNELS[channel].part not in ("carbody", "floor", "bogie", "wheelset", "wheel"):
        raise InputError(f"channel {channel!r} is not one of a vehicle's")
    if not (np.isfinite(factor) and factor > 0):
        raise InputError(f"peak_factor must be positive, not {factor}")
    if method not in METHODS:
        raise InputError(f"method must be one of {', '.join(METHODS)}, not {method!r}")
    return response_over(label, _speeds(speeds), track, channel, weighting, factor, method, run)


def _speeds(speeds: Any) -> Float[np.ndarray, "speeds"]:
    try:
        found = np.atleast_1d(np.asarray(speeds, float))
    except (TypeError, ValueError):
        raise InputError(f"speeds must be numbers in m/s, not {speeds!r}") from None
    if found.ndim != 1 or found.size == 0:
        raise InputError(f"speeds must be a number or a list of numbers in m/s, not of shape {found.shape}")
    SPEED("speeds", found)
    return found


def linear_critical_speed(highest: Scalar = linear.HIGHEST, harmonic_hz: float | None = None) -> Quantity:
    """Speed (m/s) at which straight running loses its stability; `highest` (m/s) where it is stable up to there.

    Balance logic has no linear law at rest, and its smooth twin's there is an artefact of the rounding. With `harmonic_hz` (the frequency of
    hunting, Hz) its describing function takes its place (`BalanceLogic.describing`).
    """
    return HighestLinearCritical(_above_lowest(highest), _frequency(harmonic_hz))


def _above_lowest(highest: Scalar) -> float:
    if not (np.isfinite(highest) and highest > linear.LOWEST):
        raise InputError(f"highest must be above {linear.LOWEST:g} m/s, not {highest}")
    return float(highest)


def nonlinear_critical_speed(steps: int | None = None, highest: Scalar = linear.HIGHEST) -> Quantity:
    """Lowest speed (m/s) with a limit cycle, the fold; takes about a second where the linear one takes milliseconds, a tenth of that for
    a trial that is little different from an earlier one of the same `tune` or `pareto`, from which it takes its fold.

    `steps` of RK4 in half a period as in `railjax.nonlinear_critical`, the same for all trials; None: 200. What lies above `highest` (m/s)
    counts as that.

    Controlled dampers have the smooth twin of their law here, which is sharp beside a hunting motion (balance logic's fold lies within
    1 km/h of where simulations with the sharp law begin to hunt; that of its describing function up to 2.4 km/h too high). They
    need a least damping: undamped to small motions, the twin is unstable where the controlled vehicle is not.
    """
    return HighestNonlinearCritical(critical.FEWEST_STEPS if steps is None else int(steps), _above_lowest(highest))


def _frequency(harmonic_hz: Any) -> float | None:
    if harmonic_hz is None:
        return None
    if not (np.ndim(harmonic_hz) == 0 and np.isfinite(harmonic_hz) and harmonic_hz > 0):
        raise InputError(f"harmonic_hz must be a positive number, not {harmonic_hz}")
    return float(harmonic_hz)


def describing(damper: Damper, vehicle: Vehicle, harmonic_hz: float | None) -> Damper:
    """The damper's smooth twin, or the describing function of balance logic.

    Args:
        damper: any; with a frequency, of the controlled ones only balance logic without lags and limit.
        vehicle: gives k_cy.
        harmonic_hz: frequency of the harmonic motion, Hz; None for the smooth twin.

    Raises:
        InputError: with a frequency, for other controlled dampers.
    """
    law = answers(damper)
    if harmonic_hz is None or not law.decides:
        return with_law(damper, "smooth")
    found = law.describing(vehicle, 2.0 * np.pi * harmonic_hz)
    if found is None:
        raise InputError("harmonic_hz is for balance logic without lags and limit")
    return found


def least_damping(speed: Scalar) -> Quantity:
    """Damping ratio of the least damped mode at a speed (m/s), negative where it is unstable."""
    return GreatestDamping(float(_one(speed)))


def limit_cycle_amplitude(speed: Scalar, steps: int = critical.FEWEST_STEPS) -> Quantity:
    """Amplitude (m) of the limit cycle to which the vehicle is drawn from a large disturbance at a speed (m/s), 0 where it comes to rest.

    Of the leading wheelset of the trailing bogie; by implicit differentiation of the orbit at this speed. `steps`: their number in half a period.
    """
    return LimitCycleAmplitude(float(_one(speed)), int(steps))


def _one(speed: Any) -> float:
    found = _speeds(speed)
    if found.size != 1:
        raise InputError("speed must be a single number in m/s")
    return float(found[0])


@registered
@dataclass(frozen=True, eq=False)
class HighestLinearCritical(Quantity):
    """See `linear_critical_speed`."""

    highest: float = structure(linear.HIGHEST)
    harmonic_hz: float | None = structure(None)

    unit: ClassVar[str] = "km/h"
    factor: ClassVar[float] = KMH
    greatest: ClassVar[bool] = True

    @property
    def name(self) -> str:
        return "linear critical speed"

    def value(self, vehicle: Vehicle, damper: Damper) -> Float[Array, ""]:
        found = linear.linear_critical(vehicle, damper=describing(damper, vehicle, self.harmonic_hz), highest=self.highest)
        return jnp.where(found.code == linear.Stability.STABLE, self.highest, found.speed)


@registered
@dataclass(frozen=True, eq=False)
class HighestNonlinearCritical(Quantity):
    """See `nonlinear_critical_speed`."""

    steps: int = structure(critical.FEWEST_STEPS)
    highest: float = structure(linear.HIGHEST)
    known: KnownFolds | None = structure(None)

    traced: ClassVar[bool] = False
    unit: ClassVar[str] = "km/h"
    factor: ClassVar[float] = KMH
    greatest: ClassVar[bool] = True

    @property
    def name(self) -> str:
        return "nonlinear critical speed"

    def value(self, vehicle: Vehicle, damper: Damper) -> Float[Array, "..."]:
        found = critical.found_beside(self.known, vehicle, with_law(damper, "smooth"), steps=self.steps)
        return jnp.minimum(found.speed, self.highest)  # infinite where it is stable

    def remembering(self) -> "HighestNonlinearCritical":
        """Each trial takes its fold from its neighbour's."""
        return dataclasses.replace(self, known=KnownFolds())

    def sharp(self, vehicle: Vehicle, damper: Damper) -> float:
        """Searched from nothing, whatever the trials remember."""
        return float(dataclasses.replace(self, known=None).value(vehicle, damper))

    each = value


@registered
@dataclass(frozen=True, eq=False)
class GreatestDamping(Quantity):
    """See `least_damping`."""

    speed: Number

    unit: ClassVar[str] = "%"
    factor: ClassVar[float] = 100.0
    greatest: ClassVar[bool] = True

    @property
    def name(self) -> str:
        return f"least damping at {kmh(self.speed)}"

    def value(self, vehicle: Vehicle, damper: Damper) -> Float[Array, ""]:
        return least_damped(jnp.linalg.eigvals(state_matrix(vehicle, self.speed, with_law(damper, "smooth")))).ratio


@registered
@dataclass(frozen=True, eq=False)
class LimitCycleAmplitude(Quantity):
    """See `limit_cycle_amplitude`."""

    speed: Number
    steps: int = structure(critical.FEWEST_STEPS)

    traced: ClassVar[bool] = False
    unit: ClassVar[str] = "mm"
    factor: ClassVar[float] = 1e3

    @property
    def name(self) -> str:
        return f"limit-cycle amplitude at {kmh(self.speed)}"

    def value(self, vehicle: Vehicle, damper: Damper) -> Float[Array, "..."]:
        return limit_cycles.limit_cycle_amplitude(vehicle, with_law(damper, "smooth"), self.speed, self.steps)

    each = value
