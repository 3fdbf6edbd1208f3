"""The gain of a controlled damper over speed: the best at each speed, one for all, and a smooth schedule α(v)."""

import dataclasses
import functools
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..base.arguments import SPEED, guarded
from ..base.checks import Rising
from ..base.compilation import jit as one_kernel
from ..base.errors import InputError, NumericalError
from ..base.fields import number_names
from ..base.precision import require_double_precision
from ..base.units import KMH
from ..dampers.balance_logic import BalanceLogic
from ..model.damper import Damper, check_damper
from ..model.motion import PASSIVE
from ..model.track.shapes import SinusoidTrack, Track
from ..model.vehicle import Vehicle
from ..simulation.channels import check_channel
from ..simulation.simulate import simulate
from . import minimise
from .forced import hunting
from .objectives import comfort
from .quantity import sharp_laws, smoothed_laws
from .robust import Scatter, expected

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: gains tried at every speed before the search between them, and steps of that
COARSE, STEPS = 9, 6


@dataclass(frozen=True)
class GainSchedule:
    """Result of `schedule_gain`; arrays over `speeds` (m/s), r.m.s. in m/s^2, NaN where the vehicle hunts.

    `best` is the best gain of each speed alone, `scheduled` = α(v) from `coefficients` (of Bernstein's polynomials between
    the lowest and the highest speed, so α stays within its bounds), `constant` the best single gain; `rms_...` what each gives,
    `rms_passive` what the vehicle's own dampers give, `rms_sharp` the schedule by the sharp laws.
    """

    speeds: Float[np.ndarray, "speeds"]
    best: Float[np.ndarray, "speeds"]
    scheduled: Float[np.ndarray, "speeds"]
    constant: float
    rms_best: Float[np.ndarray, "speeds"]  # m/s^2
    rms_scheduled: Float[np.ndarray, "speeds"]  # m/s^2
    rms_constant: Float[np.ndarray, "speeds"]  # m/s^2
    rms_passive: Float[np.ndarray, "speeds"]  # m/s^2
    rms_sharp: Float[np.ndarray, "speeds"]  # m/s^2
    coefficients: Float[np.ndarray, "coefficients"]
    runs: int  # number of runs
    seconds: float  # s

    @guarded(speed=SPEED)
    def at(self, speed: Any) -> Any:
        """α at a speed or speeds (m/s), beyond the ends that of the end."""
        return bernstein(np.asarray(speed, float), self.speeds, len(self.coefficients)) @ self.coefficients

    def __str__(self) -> str:
        lines = [
            f"Gain over speed: {self.speeds[0] * KMH:.0f} to {self.speeds[-1] * KMH:.0f} km/h, {self.runs} runs, {self.seconds:.1f} s"
        ]
        lines.append("    km/h   best gain  scheduled   r.m.s. best  scheduled  one gain   passive, m/s²")
        rows = zip(
            self.speeds * KMH, self.best, self.scheduled, self.rms_best, self.rms_scheduled, self.rms_constant, self.rms_passive,
            strict=True,
        )  # fmt: skip
        lines += ["  {:6.1f} {:11.3f} {:10.3f} {:13.4f} {:10.4f} {:9.4f} {:9.4f}".format(*row) for row in rows]
        hunt = ~np.isfinite(self.rms_best)
        lines.append(f"  the best single gain: {self.constant:.3f}")
        if np.any(hunt):
            lines.append(f"  hunts, left out: {', '.join(f'{speed:.0f}' for speed in self.speeds[hunt] * KMH)} km/h")
        return "\n".join(lines)

    def plot(self, axes: "Axes") -> None:
        """Gains over the speeds at which the vehicle does not hunt."""
        axes.plot(self.speeds * KMH, self.best, "o", ms=4, label="best at each speed")
        moving = self.speeds[np.isfinite(self.best)]
        fine = np.linspace(moving[0], moving[-1], 101)
        axes.plot(fine * KMH, self.at(fine), label="schedule")
        axes.axhline(self.constant, color="0.4", linestyle=":", label="best single gain")
        axes.set(xlabel="speed, km/h", ylabel=r"gain $\alpha$", ylim=(0, 1.1 * max(np.nanmax(self.best), self.constant)))
        axes.legend(loc="lower left")


def bernstein(
    speed: Float[np.ndarray, "*speeds"], over: Float[np.ndarray, "knots"], count: int
) -> Float[np.ndarray, "*speeds count"]:
    """B_k(t) = C(n, k) t^k (1 - t)^(n - k), t from 0 to 1 between the first and the last of `over`."""
    from scipy.special import comb

    span = float(over[-1] - over[0]) or 1.0
    t = np.clip((speed - over[0]) / span, 0.0, 1.0)[..., None]
    k, n = np.arange(count), count - 1
    return comb(n, k) * t**k * (1.0 - t) ** (n - k)


@guarded(speeds=Rising(SPEED, 2))
def schedule_gain(
    vehicle: Vehicle,
    speeds: Any,
    track: Track | None = None,
    *,
    damper: Damper | None = None,
    parameter: str = "alpha",
    bounds: tuple[float, float] = (0.0, 1.5),
    degree: int = 3,
    channel: str = "carbody_acceleration",
    duration: float = 12.0,
    settle: float = 6.0,
    dt: float = 1e-3,
    scatter: Scatter | None = None,
) -> GainSchedule:
    """The gain of a damper for the least r.m.s. of a channel over the speed on a track: the best at each speed, one for all, and
    α(v).

    All speeds are lanes of one batch of forced runs with the smooth laws, differentiated in forward mode: at each speed the best
    of 9 gains within the bounds, then 6 steps of a safeguarded secant on the derivative between its neighbours; then a polynomial
    α(v) and a single gain, each for the least mean square over the speeds. Speeds at which the vehicle hunts are left out (NaN):
    no gain is tuned there.

    Args:
        vehicle: a single vehicle.
        speeds: two or more in rising order, shape `(speeds,)`, m/s.
        track: what excites the vehicle; by default the paper's periodic one (5 mm, 20 m assumed).
        damper: the controlled damper; by default `BalanceLogic`.
        parameter: the damper's field that is the gain.
        bounds: least and greatest gain, in its SI unit; α of the balance logic is dimensionless.
        degree: of the polynomial α(v), a whole number from 0 to the number of speeds less 1.
        channel: whose r.m.s. is made least, of several places together; from `railjax.CHANNELS`.
        duration: of each run, s.
        settle: time at the start that does not count, s.
        dt: step of RK4, s.
        scatter: parameters that vary; the mean square is then that over its samples.

    Raises:
        InputError: for speeds, bounds, a degree or a parameter that cannot be, and in single precision.
        NumericalError: where the vehicle hunts at every speed.
    """
    require_double_precision("schedule_gain")
    began = time.perf_counter()
    check_channel(channel)
    speeds = np.asarray(speeds, float)
    if not isinstance(degree, int) or not 0 <= degree < len(speeds):
        raise InputError(f"degree must be a whole number from 0 to {len(speeds) - 1}, not {degree!r}")
    low, high = map(float, bounds)
    damper = BalanceLogic() if damper is None else damper
    check_damper(damper)
    if parameter not in number_names(damper):
        raise InputError(f"parameter: {type(damper).__name__} has no {parameter!r}")
    track = SinusoidTrack(5e-3, 20.0) if track is None else track
    runs = _Runs(vehicle, damper, parameter, speeds, track, channel, duration, settle, dt, scatter)
    best = runs.best_each(low, high)
    moving = ~runs.hunts(np.full(len(speeds), 0.5 * (low + high))) & np.isfinite(runs.squares(best)[0])
    if not np.any(moving):
        raise NumericalError("schedule_gain: the vehicle hunts at every speed, and there no gain is tuned")
    scale, width = float(np.mean(runs.squares(best)[0][moving])), high - low

    def fitted(count: int) -> np.ndarray:
        """Coefficients of the polynomial that gives the least mean square over the speeds."""
        basis = bernstein(speeds, speeds, count)

        def evaluate(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            value, slope = runs.squares(basis @ (low + width * x[0]))
            mean = np.mean(value[moving]) / scale
            return mean[None, None], (width / (scale * moving.sum()) * (basis[moving].T @ slope[moving]))[None, None]

        first = np.linalg.lstsq(basis[moving], best[moving], rcond=None)[0]
        return low + width * minimise.slsqp(evaluate, np.clip((first - low) / width, 0.0, 1.0), 1e-8, 40).x

    coefficients, constant = fitted(degree + 1), float(fitted(1)[0])

    def rms(gains: np.ndarray, **options: Any) -> np.ndarray:
        return np.where(moving, np.sqrt(runs.squares(gains, **options)[0]), np.nan)

    scheduled = bernstein(speeds, speeds, degree + 1) @ coefficients
    return GainSchedule(
        speeds,
        np.where(moving, best, np.nan),
        scheduled,
        constant,
        rms(best),
        rms(scheduled),
        rms(np.full(len(speeds), constant)),
        rms(best, passive=True),
        rms(scheduled, sharp=True),
        coefficients,
        runs.count,
        time.perf_counter() - began,
    )


class _Runs:
    """Mean squares of the channel over the speeds for given gains, and their derivatives; lanes are speeds times samples."""

    def __init__(
        self,
        vehicle: Vehicle,
        damper: Damper,
        parameter: str,
        speeds: np.ndarray,
        track: Track,
        channel: str,
        duration: float,
        settle: float,
        dt: float,
        scatter: Scatter | None,
    ) -> None:
        self.samples, self.count = 1, 0
        if scatter is not None:
            robust = expected(comfort(float(speeds[0])), scatter)
            self.samples = scatter.samples
            repeated = dataclasses.replace(robust, samples=jnp.tile(robust.samples, len(speeds)))  # type: ignore[type-var]
            vehicle = repeated.scattered(vehicle)
        self.vehicle, self.damper, self.parameter, self.track = vehicle, damper, parameter, track
        self.lanes = jnp.repeat(jnp.asarray(speeds), self.samples)
        self.options = (channel, duration, settle, dt)

    def _spread(self, gains: np.ndarray) -> Float[Array, "lanes"]:
        return jnp.repeat(jnp.asarray(gains), self.samples)

    def _over_samples(self, values: Any) -> np.ndarray:
        return np.asarray(values).reshape(-1, self.samples).mean(axis=1)

    def squares(self, gains: np.ndarray, sharp: bool = False, passive: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """(speeds,) each, (m/s^2)^2; without derivatives for the sharp laws and for the vehicle's own dampers."""
        self.count += len(self.lanes)
        lanes = self._spread(gains)
        if sharp or passive:
            vehicle, damper = sharp_laws(self.vehicle, self.damper)
            damper = PASSIVE if passive else dataclasses.replace(damper, **{self.parameter: lanes})  # type: ignore[type-var]
            values = _square(vehicle, damper, self.lanes, self.track, self.options)
            return self._over_samples(values), np.full(len(gains), np.nan)
        vehicle, damper = smoothed_laws(self.vehicle, self.damper)
        values, slopes = _derivative(self.parameter, self.options)((vehicle, damper, self.lanes, self.track), lanes)
        return self._over_samples(values), self._over_samples(slopes)

    def hunts(self, gains: np.ndarray) -> Bool[np.ndarray, "speeds"]:
        """Where any sample hunts."""
        vehicle, damper = smoothed_laws(self.vehicle, self.damper)
        damper = dataclasses.replace(damper, **{self.parameter: self._spread(gains)})  # type: ignore[type-var]
        _, duration, _, dt = self.options
        run = simulate(vehicle, self.lanes, track=self.track, damper=damper, duration=duration, dt=dt, record=(), sample=dt)
        self.count += 2 * len(self.lanes)
        return hunting(vehicle, damper, self.lanes, run.final, dt).reshape(-1, self.samples).any(axis=1)

    def best_each(self, low: float, high: float) -> Float[np.ndarray, "speeds"]:
        """The best gain of each speed."""
        speeds = len(self.lanes) // self.samples
        grid = np.linspace(low, high, COARSE)
        tried = np.array([self.squares(np.full(speeds, gain))[0] for gain in grid])
        middle = np.nanargmin(np.where(np.isfinite(tried), tried, np.inf), axis=0)
        a, b = grid[np.maximum(middle - 1, 0)], grid[np.minimum(middle + 1, COARSE - 1)]
        at_a, at_b = np.full(speeds, np.nan), np.full(speeds, np.nan)
        x, least, best = grid[middle], np.full(speeds, np.inf), grid[middle]
        for _ in range(STEPS):
            value, slope = self.squares(x)
            best, least = np.where(value < least, x, best), np.fmin(value, least)
            a, at_a = np.where(slope < 0, x, a), np.where(slope < 0, slope, at_a)
            b, at_b = np.where(slope >= 0, x, b), np.where(slope >= 0, slope, at_b)
            with np.errstate(invalid="ignore", divide="ignore"):
                secant = a - at_a * (b - a) / (at_b - at_a)
            inside = np.clip(secant, a + 0.05 * (b - a), b - 0.05 * (b - a))
            x = np.where(np.isfinite(secant), inside, 0.5 * (a + b))
        return best


def _square(vehicle: Vehicle, damper: Damper, speeds: Any, track: Track, options: tuple) -> Float[Array, "lanes"]:
    """Mean square over the places of the channel, per lane."""
    channel, duration, settle, dt = options
    how = f"rms:{channel}"
    run = simulate(
        vehicle, speeds, track=track, damper=damper, duration=duration, settle=settle, dt=dt, record=(), reduce=(how,),
        sample=dt * max(1, round(0.1 / dt)),
    )  # fmt: skip
    return jnp.mean(jnp.atleast_2d(run[how]) ** 2, axis=0)


@functools.cache
def _derivative(parameter: str, options: tuple) -> Any:
    @one_kernel
    def both(trees: tuple, gains: Float[Array, "lanes"]) -> tuple[Float[Array, "lanes"], Float[Array, "lanes"]]:
        vehicle, damper, speeds, track = trees
        of = lambda gains: _square(vehicle, dataclasses.replace(damper, **{parameter: gains}), speeds, track, options)  # noqa: E731
        # a lane depends on its own gain only
        return jax.jvp(of, (gains,), (jnp.ones_like(gains),))

    return both
