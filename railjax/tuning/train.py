"""`train`: the numbers of a learned law, by gradients through vehicle, track, sensors and device, piece by piece of long rides."""

import copy
import dataclasses
import hashlib
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..base.arguments import guarded
from ..base.batches import Batch, in_threads
from ..base.checks import a_function, a_path, positive, whole
from ..base.compilation import jit
from ..base.errors import InputError, NumericalError
from ..base.packing import as_numbers
from ..base.precision import require_double_precision
from ..base.progress import Clock, Progress
from ..base.units import KMH
from ..dampers.control.learned import LearnedDamper
from ..model.motion import state_size
from ..model.parameters import without_labels
from ..model.track.random import RandomTrack
from ..model.track.sampled import MARGIN, SampledTrack
from ..model.vehicle import Vehicle
from ..ride.vibration import weighted_acceleration
from ..ride.weightings import weighting_filter
from ..simulation.channels import check_channel
from ..simulation.integrate import Plan, integrated
from ..simulation.simulate import simulate
from .forced import hunting
from .robust import Scatter, scattered

#: Hz; at which accelerations are looked at
RATE = 200.0
#: s at the start of a validation ride that do not count
SETTLING = 4.0
#: parts of a batch, each in a thread of its own: the same numbers on any machine
SHARES = 2
#: trained as their logarithm
POSITIVE = ("time_constants",)
#: how a limit's price grows with each window that is beyond it by its own size (mean square), and the price's curvature
PRICING, STIFFNESS = 0.2, 4.0
#: what a trial costs that is beyond its limit: ten times what it gains in comfort
DEAR = 10.0

Weights = dict[str, Float[Array, "..."]]


class Rides(NamedTuple):
    """What the lanes of a batch ride."""

    vehicle: Vehicle
    speed: Float[np.ndarray, "lanes"]
    track: SampledTrack
    seed: Float[np.ndarray, "lanes"]

    def part(self, which: slice | Int[np.ndarray, "some"]) -> "Rides":
        """Some of the lanes."""
        return Batch.of(self).take(which)[0]

    def on(self, seconds: float) -> "Rides":
        """The same, so much further along the line."""
        track = copy.copy(self.track)
        object.__setattr__(track, "start", np.asarray(track.start) - self.speed * seconds)
        return self._replace(track=track)


class Course(NamedTuple):
    """Where training stands between two episodes."""

    weights: Weights
    memory: Any  # of the optimiser
    prices: dict[str, Any]  # of what has a limit: Lagrange's multipliers
    best: Weights
    best_score: float
    stale: int  # validations since then
    episode: int
    history: list[tuple[float, ...]]


@dataclasses.dataclass(frozen=True)
class Training:
    """Result of `train`. Ratios, dimensionless, are of the trained law to the one that it was, over all validation rides: `comfort` of the weighted r.m.s.
    acceleration, `limited` of the r.m.s. of what has one of the `limits`, ratios too. `history` has a row a trial: the number of the episode, score,
    comfort and what is limited, as ratios; `episodes` is the number done."""

    law: LearnedDamper
    comfort: float
    limited: dict[str, float]
    limits: dict[str, float]
    history: Float[np.ndarray, "validations columns"]  # episode, score, comfort, what is limited
    episodes: int
    seconds: float  # s
    finished: str

    def __str__(self) -> str:
        gained = f"trained {self.law.origin}: {self.comfort:.3f} times the weighted acceleration on validation rides"
        held = [f"  {name} {value:.3f} times (limit {self.limits[name]:g})" for name, value in self.limited.items()]
        return "\n".join([gained, *held, f"  {self.episodes} episodes, {self.seconds:.0f} s, {self.finished}"])


def _tracks(key: str, value: Any) -> None:
    """Names, or tracks given by samples, of one length."""
    given = [value] if isinstance(value, (str, SampledTrack)) else value
    if not isinstance(given, (list, tuple)) or not given:
        raise InputError(f"{key}: give names of spectra, or tracks such as railjax.RandomTrack, not {value!r}")
    for one in given:
        if not isinstance(one, (str, SampledTrack)):
            raise InputError(f"{key}: {one!r} is neither the name of a spectrum nor a track given by samples")


@guarded(
    law=None, tracks=_tracks, validation=_tracks, limits=None, episodes=whole(0), windows=whole(2), window=positive("s"),
    lanes=whole(2), learning_rate=positive(), patience=whole(1), every=whole(1), keep=a_path, progress=a_function,
)  # fmt: skip
def train(
    vehicle: Vehicle,
    law: Any,
    *,
    tracks: Any,
    speeds: Sequence[float],
    validation: Any = None,
    scatter: Scatter | None = None,
    limits: Mapping[str, float] | None = None,
    episodes: int = 60,
    windows: int = 6,
    window: float = 2.0,
    lanes: int = 32,
    dt: float = 1e-3,
    learning_rate: float = 3e-3,
    every: int = 5,
    patience: int = 6,
    seed: int = 0,
    keep: str | Path | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> Training:
    """Train a law for comfort, through the closed loop, by truncated back-propagation.

    An episode is a ride of some windows over a batch of lanes, each with a track, a place on it, a speed, noise and a vehicle out of the scatter of its own.
    The state goes on from window to window, its derivative does not; after the first window each has a step of Adam. What is made small is the
    mean square of the weighted (Wd) acceleration of the floor, relative to that of the law as it was over the same ride, so that all speeds and
    tracks count alike; what has a limit is felt beyond it. Every few episodes the law is tried on the validation rides; the best is kept, and
    training ends after some trials without a better one. The same seed gives the same weights to the bit on one machine, also if it was stopped and
    taken up again from `keep`. A vehicle that hunts with the law as it is is refused: a hunting run is never differentiated.

    Args:
        vehicle: a single vehicle.
        law: made by `LearnedDamper.of`, or trained before.
        tracks: names of spectra, each for 24 realisations of 2 km, or tracks of one length, single or with lanes (`RandomTrack(seed=range(20))`).
        speeds: lowest and highest, or a list from which each ride takes one, m/s.
        validation: likewise tracks for early stopping, which are never trained on; by default realisations of the same names with other seeds.
        scatter: of the vehicle's parameters; None: the vehicle as it is.
        limits: largest ratio, dimensionless, of the r.m.s. of channels to those of the law as it was; by default {"secondary_travel": 1.0}.
        episodes: largest number of them; 0 hands the law on as it is.
        windows: number of them in an episode.
        window: its length, s.
        lanes: number of rides at once; even.
        dt: step of RK4, s.
        learning_rate: of Adam at the start, dimensionless; it falls to a tenth along half a cosine.
        every: number of episodes between two trials on the validation rides.
        patience: number of trials without a better one after which training ends.
        seed: of everything that is drawn, a whole number.
        keep: a file (.npz) that is written after each trial, and from which a training that was stopped goes on.
        progress: called with a `Progress` after each episode.

    Raises:
        InputError: for a vehicle that hunts, tracks of unequal length, limits of channels that there are not, a file of another training.
        NumericalError: where a ride diverges.
    """
    import optax

    require_double_precision("train")
    began = time.monotonic()
    fault = law.fault() if isinstance(law, LearnedDamper) else "it must be a railjax.LearnedDamper"
    if fault:
        raise InputError(f"law: {fault}")
    if lanes % SHARES:
        raise InputError(f"lanes must be an even number, not {lanes}")
    limits = {"secondary_travel": 1.0} if limits is None else dict(limits)
    for name in limits:
        check_channel(name)
    vehicle, law, track, range_ = prepared(vehicle, law, tracks, tuple(speeds))
    teacher = Teacher(vehicle, law, track, range_, scatter, limits, windows, window, lanes, dt, seed)
    if not episodes:
        ratios = dict.fromkeys(limits, 1.0)
        return Training(law, 1.0, ratios, limits, np.array([[0.0, 1.0, 1.0, *ratios.values()]]), 0, 0.0, "nothing done")
    trial = _Trial(vehicle, law, _others(tracks) if validation is None else validation, tuple(speeds), limits, dt)
    told = f"{teacher.fingerprint} {episodes} {learning_rate} {every} {patience}"
    schedule = optax.cosine_decay_schedule(learning_rate, max(1, episodes * (windows - 1)), alpha=0.1)
    optimiser = optax.chain(optax.clip_by_global_norm(1.0), optax.adam(schedule))
    weights = weights_of(law)
    score, numbers = trial.score(law)
    prices = {name: jnp.zeros(()) for name in limits}
    course = Course(weights, optimiser.init(weights), prices, weights, score, 0, 0, [(0.0, score, *numbers)])
    course = course if keep is None else _taken_up(keep, course, told)
    clock = Clock(course.episode, episodes)
    while course.episode < episodes and course.stale < patience:
        course = teacher.episode(course, optimiser)
        if course.episode % every == 0 or course.episode == episodes:
            score, numbers = trial.score(with_weights(law, course.weights))
            better = score < course.best_score
            course = course._replace(
                weights=course.weights
                if np.isfinite(score)
                else course.best,  # from a law with which it hunts nothing is learned
                best=course.weights if better else course.best,
                best_score=min(score, course.best_score),
                stale=0 if better else course.stale + 1,
                history=[*course.history, (float(course.episode), score, *numbers)],
            )
            if keep is not None:
                _kept(keep, course, told)
        if progress is not None:
            progress(clock.advance(1))
    best = min(course.history, key=lambda row: row[1])
    finished = "no better for long" if course.stale >= patience else "all episodes done"
    return Training(
        with_weights(law, course.best),
        best[2],
        dict(zip(limits, best[3:], strict=True)),
        limits,
        np.array(course.history),
        course.episode,
        time.monotonic() - began,
        finished,
    )


def prepared(
    vehicle: Vehicle, law: LearnedDamper, tracks: Any, speeds: tuple[float, ...]
) -> tuple[Vehicle, LearnedDamper, SampledTrack, tuple]:
    """Vehicle and law as arrays, the tracks as lanes of one, and the speeds, m/s.

    Args:
        vehicle: a single vehicle.
        law: what is trained.
        tracks: names of spectra and tracks.
        speeds: m/s.
    """
    vehicle, law = as_numbers((without_labels(vehicle), law))
    return vehicle, law, together(tracks), tuple(float(speed) for speed in speeds)


def weights_of(law: LearnedDamper) -> Weights:
    """What training changes, times as their logarithms."""
    found = {name: getattr(law, name) for name in LearnedDamper.TRAINED if getattr(law, name) is not None}
    return {name: jnp.log(value) if name in POSITIVE else jnp.asarray(value) for name, value in found.items()}


def with_weights(law: LearnedDamper, weights: Weights) -> LearnedDamper:
    """The law with these."""
    return dataclasses.replace(law, **{name: jnp.exp(value) if name in POSITIVE else value for name, value in weights.items()})


def _others(tracks: Any) -> Any:
    names = [tracks] if isinstance(tracks, str) else tracks
    if not all(isinstance(name, str) for name in names):
        raise InputError("validation: give tracks that are not trained on")
    return [RandomTrack(name, seed=UNSEEN, length=LENGTH, fade=0.0) for name in names]


#: m and number of realisations, of tracks that are given by a spectrum's name
LENGTH, REALISATIONS = 2000.0, 24
#: seeds of those of the validation rides
UNSEEN = range(1000, 1004)


def together(tracks: Any) -> SampledTrack:
    """Names and tracks, single or with lanes, as lanes of one, without a fade-in."""
    given = [tracks] if isinstance(tracks, (str, SampledTrack)) else list(tracks)
    made = [RandomTrack(one, seed=range(REALISATIONS), length=LENGTH, fade=0.0) if isinstance(one, str) else one for one in given]
    columns = []
    for one in made:
        table = np.asarray(one.coefficients)
        for k in range(table.shape[1] if table.ndim > 1 else 1):
            numbers = [np.ravel(getattr(one, name)) for name in ("spacing", "start", "amplitude")]
            columns.append((table[:, k] if table.ndim > 1 else table, *(part[k if part.size > 1 else 0] for part in numbers)))
    if len({len(column[0]) for column in columns}) > 1 or len({one.periodic for one in made}) > 1:
        raise InputError("tracks: they must be of one length, spacing and kind; give RandomTracks of the same length")
    joined = copy.copy(made[0])
    coefficients, spacing, start, amplitude = (np.stack(part, axis=-1) for part in zip(*columns, strict=True))
    for name, value in dict(coefficients=coefficients, spacing=spacing, start=start, amplitude=amplitude, fade=None).items():
        object.__setattr__(joined, name, value)
    return joined


def _picked(track: SampledTrack, which: np.ndarray, ahead: np.ndarray) -> SampledTrack:
    """Lanes of a track, each begun so far (m) along it."""
    picked = copy.copy(track)
    for name in ("coefficients", "spacing", "amplitude"):
        object.__setattr__(picked, name, np.asarray(getattr(track, name))[..., which])
    object.__setattr__(picked, "start", np.asarray(track.start)[which] - ahead)
    return picked


def filtered(
    sections: Float[np.ndarray, "sections 6"], memory: Float[Array, "sections 2 *places"], record: Float[Array, "samples *places"]
) -> tuple[Float[Array, "samples *places"], Float[Array, "sections 2 *places"]]:
    """A record through second-order sections, and what they remember after it: as `scipy.signal.sosfilt`, differentiable and in one kernel with a run.

    Args:
        sections: as `weighting_filter` gives them, dimensionless.
        memory: of what came before, in the record's unit, SI.
        record: samples at the filter's rate, SI.
    """

    def one(memory: Any, value: Any) -> tuple[Any, Any]:
        after = []
        for (b0, b1, b2, _, a1, a2), (first, second) in zip(sections, memory, strict=True):
            passed = b0 * value + first
            after.append(jnp.stack([b1 * value - a1 * passed + second, b2 * value - a2 * passed]))
            value = passed
        return jnp.stack(after), value

    memory, weighted = jax.lax.scan(one, jnp.asarray(memory), record)
    return weighted, memory


def _mean_square(values: Float[Array | np.ndarray, "samples *places lanes"]) -> Float[Array | np.ndarray, "lanes"]:
    return (values**2).mean(axis=tuple(range(values.ndim - 1)))


def _speed_of(speeds: tuple[float, ...], rng: np.random.Generator, count: int) -> np.ndarray:
    return rng.uniform(*speeds, count) if len(speeds) == 2 else rng.choice(speeds, count)


class Teacher:
    """Episodes: what is drawn, the ride of the law as it was, windows and steps."""

    def __init__(
        self, vehicle: Vehicle, law: LearnedDamper, track: SampledTrack, speeds: tuple[float, ...], scatter: Scatter | None,
        limits: dict[str, float], windows: int, window: float, lanes: int, dt: float, seed: int,
    ) -> None:  # fmt: skip
        self.vehicle, self.law, self.track, self.speeds = vehicle, law, track, speeds
        self.limits, self.windows, self.window, self.lanes, self.dt, self.seed = limits, windows, window, lanes, dt, seed
        self.scatter = None if scatter is None else scatter.drawn()
        every = round(1.0 / RATE / dt)
        if every < 1 or abs(every * dt * RATE - 1.0) > 1e-6:
            raise InputError(f"dt {dt:g} s: 5 ms must be a whole number of steps")
        self.plan = Plan(round(window * RATE), every, ("floor_acceleration", *limits), ())
        # of all numbers that the weights depend on, but the schedule
        told = hashlib.sha256(repr((speeds, sorted(limits.items()), windows, window, lanes, dt, seed, law.origin)).encode())
        for leaf in jax.tree.leaves((vehicle, law, track, self.scatter)):
            told.update(str(leaf).encode() if isinstance(leaf, str) else np.asarray(leaf).tobytes())
        self.fingerprint = told.hexdigest()
        self.sections = weighting_filter("Wd", RATE)
        self._compiled = False
        self.gradient = jit(jax.value_and_grad(self.loss, has_aux=True))

    def rides(self, episode: int) -> Rides:
        """What the lanes of an episode ride."""
        rng = np.random.default_rng((self.seed, episode))
        count = self.lanes
        speed = _speed_of(self.speeds, rng, count)
        which = rng.integers(0, np.shape(self.track.coefficients)[1], count)
        length = ((np.shape(self.track.coefficients)[0] - MARGIN) * np.asarray(self.track.spacing))[which]
        room = length if self.track.periodic else np.maximum(length - speed * self.windows * self.window, 0.0)
        track = _picked(self.track, which, rng.uniform(0.0, 1.0, count) * room)
        noise = rng.integers(0, 2**31 - 1, count).astype(float)
        vehicle = self.vehicle
        if self.scatter is not None:
            paths, factors, samples = self.scatter
            vehicle = scattered(vehicle, paths, factors, samples[:, rng.integers(0, samples.shape[1], count)])
        return Rides(vehicle, speed, track, noise)

    def loss(
        self, weights: Weights, rides: Rides, x: Any, echo: Any, base: dict[str, Any], prices: dict[str, Any]
    ) -> tuple[Any, Any]:
        law = dataclasses.replace(with_weights(self.law, weights), seed=rides.seed)
        run = integrated(rides.vehicle, law, rides.speed, rides.track, x, self.dt, 0.0, self.plan)
        weighted, echo = filtered(self.sections, echo, run.records["floor_acceleration"])
        ratios = {"comfort": _mean_square(weighted) / base["comfort"]}
        ratios |= {name: _mean_square(run.records[name]) / base[name] for name in self.limits}
        over = {name: jnp.mean(ratios[name]) - limit**2 for name, limit in self.limits.items()}
        # the augmented Lagrangian of inequalities
        felt = sum(jnp.maximum(prices[name] + STIFFNESS * by, 0.0) ** 2 / (2.0 * STIFFNESS) for name, by in over.items())
        return jnp.mean(ratios["comfort"]) + felt, (run.final, echo, over)

    def start(self, lanes: int) -> Float[np.ndarray, "states lanes"]:
        """Rest, of so many rides."""
        return np.zeros((state_size(self.vehicle, self.law), lanes))

    def silence(self, lanes: int) -> Float[np.ndarray, "sections 2 3 lanes"]:
        """What the weighting remembers before a ride."""
        return np.zeros((len(self.sections), 2, 3, lanes))

    def episode(self, course: Course, optimiser: Any) -> Course:
        """Where training stands after one more."""
        weights, memory, prices = course.weights, course.memory, course.prices
        rides = self.rides(course.episode)
        duration = self.windows * self.window
        base = measured(rides, self.law, duration, self.window, self.limits, self.dt)
        parts = [slice(k * self.lanes // SHARES, (k + 1) * self.lanes // SHARES) for k in range(SHARES)]
        state = self.start(self.lanes // SHARES)
        held = [(state, self.silence(self.lanes // SHARES))] * SHARES
        for window in range(self.windows):
            here = rides.on(window * self.window)

            given = [
                (weights, here.part(part), *kept, {name: value[part] for name, value in base.items()}, prices)
                for part, kept in zip(parts, held, strict=True)
            ]
            # the first call compiles, which two threads would do twice
            each = in_threads if self._compiled else lambda function, shares: [function(share) for share in shares]
            found, self._compiled = each(self._of_share, given), True
            values = [value for (value, _), _ in found]
            if not np.all(np.isfinite(values)):
                raise NumericalError("a ride in training diverged: its speed or scatter is beyond what this vehicle runs at")
            held = [(final, kept) for (_, (final, kept, _)), _ in found]
            if window == 0:  # from rest
                continue
            slope = jax.tree.map(lambda *part: sum(part) / SHARES, *[gradient for _, gradient in found])
            change, memory = optimiser.update(slope, memory, weights)
            weights = {name: weight + change[name] for name, weight in weights.items()}
            over = {name: sum(aux[2][name] for (_, aux), _ in found) / SHARES for name in prices}
            prices = {name: jnp.maximum(price + PRICING * over[name], 0.0) for name, price in prices.items()}
        return course._replace(weights=weights, memory=memory, prices=prices, episode=course.episode + 1)

    def _of_share(self, given: tuple) -> Any:
        """Value and gradient of one part of the batch."""
        return jax.device_get(self.gradient(*jax.tree.map(np.asarray, given)))


def measured(
    rides: Rides, law: LearnedDamper, duration: float, settle: float, channels: Any, dt: float, hunts: bool = False
) -> dict[str, np.ndarray]:
    """Mean squares of each ride's weighted acceleration and channels, after `settle`; NaN where it fails.

    Args:
        rides: what is ridden.
        law: with which.
        duration: s.
        settle: left out at the start, s.
        channels: names of what is looked at besides.
        dt: step of RK4, s.
        hunts: whether the vehicle is let run on, on even track, and a ride whose motion does not die out there has failed.
    """
    run = simulate(
        rides.vehicle, rides.speed, track=rides.track, damper=dataclasses.replace(law, seed=rides.seed), duration=duration, dt=dt,
        sample=1.0 / RATE, record=("floor_acceleration", *channels),
    )  # fmt: skip
    first = round(settle * RATE)
    weighted = np.asarray(weighted_acceleration(run["floor_acceleration"], RATE, "Wd"))[first:]
    found = {"comfort": np.asarray(_mean_square(weighted))}
    found |= {name: np.asarray(_mean_square(np.asarray(run[name])[first:])) for name in channels}
    ok = np.asarray(run.ok)
    if hunts:
        ok = ok & ~hunting(rides.vehicle, dataclasses.replace(law, seed=rides.seed), rides.speed, run.final, dt)
    return {name: np.where(ok, value, np.nan) for name, value in found.items()}


class _Trial:
    """The validation rides: every track at four speeds."""

    def __init__(
        self, vehicle: Vehicle, law: LearnedDamper, tracks: Any, speeds: tuple[float, ...], limits: dict[str, float], dt: float
    ) -> None:
        track = together(tracks)
        count = np.shape(track.coefficients)[1]
        several = np.linspace(speeds[0], speeds[-1], 4) if len(speeds) == 2 else np.asarray(speeds, float)
        which, speed = (part.ravel() for part in np.meshgrid(np.arange(count), several))
        self.rides = Rides(vehicle, speed, _picked(track, which, np.zeros(len(which))), np.arange(len(which)) + 0.5e6)
        self.limits, self.dt = limits, dt
        self.base = self._measured(law)
        if not all(np.all(np.isfinite(value)) for value in self.base.values()):
            worst = float(np.min(speed[~np.isfinite(self.base["comfort"])])) * KMH
            raise InputError(
                f"speeds: at {worst:.0f} km/h the vehicle hunts with the law as it is (left alone, its motion does not die out); go slower"
            )

    def _measured(self, law: LearnedDamper) -> dict[str, np.ndarray]:
        return measured(self.rides, law, 14.0, SETTLING, self.limits, self.dt, hunts=True)

    def score(self, law: LearnedDamper) -> tuple[float, tuple[float, ...]]:
        """What is to be small, and the ratios of comfort and of what is limited, r.m.s. over all rides."""
        found = self._measured(law)
        ratios = {name: float(np.sqrt(np.mean(found[name] / self.base[name]))) for name in found}
        score = ratios["comfort"] + sum(DEAR * max(ratios[name] - limit, 0.0) for name, limit in self.limits.items())
        return (score if np.isfinite(score) else np.inf), tuple(ratios.values())


def _kept(path: str | Path, course: Course, fingerprint: str) -> None:
    """Write where training stands, under another name first."""
    leaves = jax.tree.leaves((course.weights, course.memory, course.prices, course.best))
    path = Path(path)
    beside = path.with_name(path.name + ".part.npz")
    numbers = {f"leaf_{k}": np.asarray(leaf) for k, leaf in enumerate(leaves)}
    np.savez(
        beside, fingerprint=fingerprint, history=np.array(course.history), counts=np.array([course.episode, course.stale]),
        best_score=course.best_score, **numbers,
    )  # fmt: skip
    beside.replace(path)


def _taken_up(path: str | Path, course: Course, fingerprint: str) -> Course:
    """Where a training that was stopped stood; the beginning where there is no file."""
    if not Path(path).exists():
        return course
    with np.load(path, allow_pickle=False) as kept:
        if str(kept["fingerprint"]) != fingerprint:
            raise InputError(f"{path} is of another training; give keep= another name")
        structure = jax.tree.structure((course.weights, course.memory, course.prices, course.best))
        weights, memory, prices, best = structure.unflatten([kept[f"leaf_{k}"] for k in range(structure.num_leaves)])
        episode, stale = (int(number) for number in kept["counts"])
        history = [tuple(float(number) for number in row) for row in kept["history"]]
        return Course(weights, memory, prices, best, float(kept["best_score"]), stale, episode, history)
