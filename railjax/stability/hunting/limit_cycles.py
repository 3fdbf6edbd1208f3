"""Limit cycles over speed, and the branch that they form: what `hunting_branch` finds; it prints and plots itself."""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float

from ...base.arguments import ONE_SPEED, guarded
from ...base.batches import in_threads
from ...base.checks import FLAG
from ...base.errors import InputError
from ...base.host import Answer, HostFunction
from ...base.style import COLOURS, legend_above
from ...base.typing import Number
from ...base.units import KMH
from ...model.damper import Damper
from ...model.parameters import bare
from ...model.vehicle import Vehicle
from ..linear_critical import LinearCritical
from .continuation import hunting_mode
from .floquet import Floquet, multipliers_of
from .fold_search import steps_of_period
from .nonlinear_critical import default_wheelset
from .orbits import DISPLACEMENT, Model, Orbit, Shooting, pack, rounded, unpack
from .settling import settled
from .shooting import Point, amplitude_slopes, at_speed, largest_displacement, solved

if TYPE_CHECKING:
    import xarray
    from matplotlib.axes import Axes

    from .ramp import Ramp


@dataclass(frozen=True)
class LimitCycle:
    """A periodic motion at one speed (m/s): amplitude of the wheelset (m), frequency (Hz), Floquet multipliers, state.

    `state` is x where the wheelset turns, to start a simulation with; `residual` how far the orbit is from closing (1 mm,
    50 mm/s); `floquet.error` is |mu_1 - 1|, the error bar of the multipliers.
    """

    speed: float
    amplitude: float
    frequency: float
    floquet: Floquet
    state: Float[np.ndarray, "states"]
    residual: float
    unknowns: Float[np.ndarray, "unknowns"]  # the orbit as one vector of numbers about one

    @property
    def stable(self) -> bool:
        """Whether nearby motions come back to it."""
        return self.floquet.stable

    def __str__(self) -> str:
        kind = "stable" if self.stable else "unstable"
        return (
            f"limit cycle at {self.speed * KMH:.3f} km/h: {self.amplitude * 1e3:.3f} mm, {self.frequency:.4f} Hz, {kind}, "
            f"largest multiplier {self.floquet.largest:.4f} (error {self.floquet.error:.1e})"
        )

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers and lists, for JSON."""
        return {
            "speed_kmh": self.speed * KMH,
            "amplitude_mm": self.amplitude * 1e3,
            "frequency_hz": self.frequency,
            "stable": self.stable,
            "largest_multiplier": self.floquet.largest,
            "trivial_multiplier_error": self.floquet.error,
        }


class Event(NamedTuple):
    """Where the stability of the limit cycles changes along the branch: kind, speed (m/s) and amplitude (m)."""

    kind: str
    speed: float
    amplitude: float


@dataclass(frozen=True)
class Branch:
    """Limit cycles of a vehicle, in pieces that are each followed without a gap, from the Hopf point to the highest speed.

    `folds` are solved for as such; the lowest is the nonlinear critical speed. `criticality` tells on which side of the Hopf
    point limit cycles are: "subcritical" (below: a large disturbance makes the vehicle hunt before it is unstable) or
    "supercritical"; "isolated" where there is no Hopf point, because straight running is stable at all speeds. `slope_at_hopf` is dv/dA there, m/s per m: with the Vermeulen-Johnson law, whose force is not smooth at
    zero creep, amplitude grows in proportion to the speed difference. For a smooth law `lyapunov` is the first Lyapunov
    coefficient (see `normal_form`), else None. `note` says what is peculiar.
    """

    vehicle_name: str
    hopf: LinearCritical
    criticality: str
    slope_at_hopf: float
    lyapunov: float | None  # 1/s, of amplitudes scaled as `normal_form` says; None: the law is not smooth
    pieces: tuple[tuple[LimitCycle, ...], ...]
    folds: tuple[LimitCycle, ...]
    events: tuple[Event, ...]
    note: str
    wheelset: int  # number from the front, whose displacement is the amplitude
    model: Model
    shooting: Shooting

    @property
    def points(self) -> list[LimitCycle]:
        """All limit cycles, from the Hopf point on."""
        return [point for piece in self.pieces for point in piece]

    @property
    def speed(self) -> Float[np.ndarray, "points"]:
        """Speed of each limit cycle, m/s."""
        return np.array([point.speed for point in self.points])

    @property
    def amplitude(self) -> Float[np.ndarray, "points"]:
        """Amplitude of the wheelset's lateral displacement, m."""
        return np.array([point.amplitude for point in self.points])

    @property
    def frequency(self) -> Float[np.ndarray, "points"]:
        """Frequency of each limit cycle, Hz."""
        return np.array([point.frequency for point in self.points])

    @property
    def multipliers(self) -> Complex[np.ndarray, "points states"]:
        """Floquet multipliers of the whole period, the trivial one first."""
        return np.array([point.floquet.multipliers for point in self.points])

    @property
    def stable(self) -> Bool[np.ndarray, "points"]:
        """Whether nearby motions come back."""
        return np.array([point.stable for point in self.points])

    @property
    def fold(self) -> LimitCycle | None:
        """The lowest fold, the nonlinear critical speed; None where the branch has none (supercritical)."""
        return min(self.folds, key=lambda point: point.speed, default=None)

    @guarded(speed=ONE_SPEED, stable=FLAG)
    def at(self, speed: float, stable: bool = True) -> LimitCycle:
        """The limit cycle at a speed (m/s), solved for; `InputError` where the branch has none that is (un)stable there."""
        for piece in self.pieces:
            for one, other in itertools.pairwise(piece):
                within = min(one.speed, other.speed) <= speed <= max(one.speed, other.speed)
                if within and one.stable == stable and other.stable == stable:
                    share = (speed - one.speed) / (other.speed - one.speed) if other.speed != one.speed else 0.0
                    guess = one.unknowns + share * (other.unknowns - one.unknowns)
                    found = solved(self.model, self.shooting, at_speed(self.model, self.shooting, guess, speed))
                    if found.usable:
                        return limit_cycle_at(self.model, self.shooting, found)
        kind = "stable" if stable else "unstable"
        raise InputError(f"the branch has no {kind} limit cycle at {speed * KMH:.2f} km/h")

    def plot(self, axes: "Axes", ramp: "Ramp | None" = None) -> None:
        """The diagram as engineers draw it: amplitude over km/h, stable solid, unstable dashed, jumps marked."""
        hopf = float(self.hopf.speed) * KMH
        named: set[bool] = set()
        for piece in self.pieces:
            for stable, points in _stretches(piece):
                speeds, heights = (np.array([getattr(p, name) for p in points]) for name in ("speed", "amplitude"))
                label = ("stable limit cycle" if stable else "unstable limit cycle") if stable not in named else None
                named.add(stable)
                style = "-" if stable else (0, (4, 2.5))
                axes.plot(speeds * KMH, heights * 1e3, color=COLOURS[0], linestyle=style, label=label)
        left, right = self.speed.min() * KMH - 8.0, self.speed.max() * KMH
        axes.plot([left, min(hopf, right)], [0, 0], color=COLOURS[0], clip_on=False, zorder=3)
        if np.isfinite(hopf):
            axes.plot([hopf, right], [0, 0], color=COLOURS[0], linestyle=(0, (4, 2.5)), clip_on=False, zorder=3)
            axes.plot(hopf, 0, "o", color=COLOURS[1], clip_on=False, zorder=4, label=f"Hopf point, {hopf:.1f} km/h")
        fold = self.fold
        arrow = {"arrowstyle": "-|>", "color": "0.45", "linewidth": 1.0, "shrinkA": 0, "shrinkB": 3}
        if fold is not None:
            speed, height = fold.speed * KMH, fold.amplitude * 1e3
            axes.plot(speed, height, "s", color=COLOURS[1], zorder=4, label=f"fold, {speed:.1f} km/h and {height:.2f} mm")
            axes.annotate("", (speed, 0.0), (speed, height), arrowprops=arrow)
            above = [p for p in self.points if p.stable and p.amplitude > 0]
            if above and np.isfinite(hopf):
                landing = np.interp(hopf, *np.array(sorted((p.speed * KMH, p.amplitude * 1e3) for p in above)).T)
                axes.annotate("", (hopf, landing), (hopf, 0.0), arrowprops=arrow)
        if ramp is not None:
            axes.plot(
                ramp.down_speed * KMH, ramp.down_amplitude * 1e3, ".", ms=2.5, color=COLOURS[2], label="simulated ramp down"
            )
            axes.plot(ramp.up_speed * KMH, ramp.up_amplitude * 1e3, ".", ms=2.5, color=COLOURS[4], label="simulated ramp up")
        axes.set(
            xlabel="speed, km/h",
            ylabel=f"amplitude of wheelset {self.wheelset + 1}, mm",
            xlim=(left, right),
            ylim=(0.0, None),
        )
        legend_above(axes, 3)

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers and lists, for JSON."""
        isolated, fold = self.criticality == "isolated", self.fold
        return {
            "vehicle": self.vehicle_name,
            "hopf_kmh": None if isolated else float(self.hopf.speed) * KMH,
            "hopf_frequency_hz": None if isolated else float(self.hopf.frequency),
            "criticality": self.criticality,
            "slope_at_hopf_kmh_per_mm": None if isolated else self.slope_at_hopf * KMH * 1e-3,
            "lyapunov_per_s": self.lyapunov,
            "fold_kmh": None if fold is None else fold.speed * KMH,
            "fold_amplitude_mm": None if fold is None else fold.amplitude * 1e3,
            "fold_frequency_hz": None if fold is None else fold.frequency,
            "folds": [point.as_dict() for point in self.folds],
            "events": [
                {"kind": kind, "speed_kmh": speed * KMH, "amplitude_mm": amplitude * 1e3}
                for kind, speed, amplitude in self.events
            ],
            "wheelset": self.wheelset + 1,
            "branch": [{**point.as_dict(), "piece": k} for k, piece in enumerate(self.pieces) for point in piece],
            "largest_trivial_multiplier_error": max(point.floquet.error for point in self.points),
            "note": self.note,
        }

    def to_xarray(self) -> "xarray.Dataset":
        """A labelled dataset over the points."""
        import xarray

        largest = np.array([point.floquet.largest for point in self.points])
        error = np.array([point.floquet.error for point in self.points])
        piece = np.concatenate([np.full(len(part), k) for k, part in enumerate(self.pieces)])
        columns = {
            "speed": (self.speed, "m/s"),
            "amplitude": (self.amplitude, "m"),
            "frequency": (self.frequency, "Hz"),
            "stable": (self.stable, "1"),
            "largest_multiplier": (largest, "1"),
            "trivial_multiplier_error": (error, "1"),
            "piece": (piece, "1"),
        }
        variables = {name: ("point", values, {"units": unit}) for name, (values, unit) in columns.items()}
        attributes = {"vehicle": self.vehicle_name, "criticality": self.criticality, "note": self.note}
        return xarray.Dataset(variables, attrs=attributes)

    def __str__(self) -> str:
        low, high = self.speed.min() * KMH, self.speed.max() * KMH
        lines = [
            f"Hunting of {self.vehicle_name or 'a vehicle'}: {len(self.points)} limit cycles, {low:.1f} to {high:.1f} km/h",
            "  no Hopf point: straight running is stable at all speeds tried, the limit cycles are isolated"
            if self.criticality == "isolated"
            else f"  Hopf point: {float(self.hopf.speed) * KMH:.3f} km/h, {float(self.hopf.frequency):.3f} Hz, {self.criticality}",
        ]
        lines += [f"  fold: {fold}" for fold in self.folds]
        lines += [f"  {kind}: {speed * KMH:.2f} km/h, {amplitude * 1e3:.2f} mm" for kind, speed, amplitude in self.events]
        lines += [f"  {self.note}"] if self.note else []
        return "\n".join(lines)


def limit_cycle_at(model: Model, shooting: Shooting, point: Point) -> LimitCycle:
    """The limit cycle of a point on its branch, with multipliers and its largest displacement: more than at the turning point where
    the wheelset turns more than twice."""
    orbit = unpack(model, shooting, point.unknowns)
    return LimitCycle(
        float(orbit.speed),
        float(point.peaks[shooting.wheelset]),
        1.0 / float(orbit.period),
        multipliers_of(shooting, point.monodromy),
        orbit.state,
        point.residual,
        point.unknowns,
    )


#: displacement, in clearances, below which a vehicle has come to rest
AT_REST = 1e-3


def limit_cycle_amplitude(vehicle: Vehicle, damper: Damper, speed: Number, steps: int) -> Float[Array, "..."]:
    """Amplitude (m) of the limit cycle to which the vehicle is drawn from a large disturbance at a speed (m/s), 0 where it comes to rest,
    NaN where its motion is no limit cycle.

    Of the leading wheelset of the trailing bogie; differentiable by the vehicle and the damper; lanes as in `nonlinear_critical`.
    `steps` of RK4 in half a period. Not inside of `jax.jit`.
    """
    given = bare(rounded(vehicle), damper), jnp.asarray(speed, float)
    return _amplitude(given, default_wheelset(vehicle, None), steps)[0]


def _amplitudes(lanes: Sequence[tuple], slopes: bool, wheelset: int, steps: int) -> Answer:
    def one(lane: Any) -> tuple[float, list[np.ndarray]]:
        model = Model(*lane[0])
        shooting = Shooting(steps if model.alike else 2 * steps, wheelset, model.alike)
        return _amplitude_of(model, float(lane[1]), shooting, slopes)

    found = in_threads(one, lanes)
    values, by_numbers = zip(*found, strict=True)
    return Answer((np.array(values),), list(by_numbers) if slopes else None)


def _amplitude_of(model: Model, speed: float, shooting: Shooting, slopes: bool) -> tuple[float, list[np.ndarray]]:
    """The amplitude and, if wanted, its derivative by each number of the model and by the speed (taken as given: zero)."""
    none = [*(np.zeros(np.shape(leaf)) for leaf in jax.tree.leaves(model)), np.zeros(())]
    shape, omega = hunting_mode(model, shooting, speed)
    clearance = float(model.vehicle.contact.flange_clearance)
    period = 2.0 * np.pi / omega
    problem = settled(model, shooting, shape * clearance + model.rest, period, speed, steps_of_period(model, speed, period))
    point = solved(model, shooting, problem)
    if point.usable and largest_displacement(model, point) > AT_REST * clearance:
        sign = np.sign(point.amplitude)
        by_numbers = jax.tree.leaves(amplitude_slopes(model, shooting, point)) if slopes else []
        return abs(point.amplitude), [*(np.asarray(sign * slope) for slope in by_numbers), np.zeros(())]
    resting = pack(model, shooting, Orbit(model.rest, 0.0, 0.0))
    at_rest = point.usable or np.max(np.abs((problem.guess - resting)[:-2])) * DISPLACEMENT < AT_REST * clearance
    return 0.0 if at_rest else np.nan, none


_amplitude = HostFunction(
    "the amplitude of a limit cycle",
    _amplitudes,
    (float,),
)


def _stretches(piece: tuple) -> Iterator[tuple[bool, list]]:
    """Stretches of like stability, each with the first point of the next so that no gap shows."""
    start = 0
    for k in range(1, len(piece) + 1):
        if k == len(piece) or piece[k].stable != piece[start].stable:
            yield piece[start].stable, list(piece[start : k + 1])
            start = k
