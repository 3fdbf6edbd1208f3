"""`train`: the numbers of a learned law, by gradients through vehicle, track, sensors and device, piece by piece of long rides."""

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..base.arguments import guarded
from ..base.checks import a_function, a_path, positive, whole
from ..base.errors import InputError
from ..base.fingerprint import described
from ..base.packing import as_numbers
from ..base.precision import require_double_precision
from ..base.programs import return_memory
from ..base.progress import Clock, Progress
from ..base.units import KMH
from ..dampers.control.learned import LearnedDamper
from ..model.parameters import without_labels
from ..model.track.sampled import SampledTrack
from ..model.vehicle import Vehicle
from ..simulation.channels import check_channel
from .course import Course, kept, taken_up, weights_of, with_weights
from .onset import QuietSpeeds
from .rides import Trial, as_tracks, others, together
from .robust import Scatter
from .teacher import SHARES, Teacher

#: between which shares of its limit training holds something, so that validation rides, which differ from its own, keep the limit and use it
AIMS = 0.9, 1.1
#: shares of the way from the best weights to those of a trial that are tried where the vehicle hunts earlier with these
WAY = 1.0, 0.5, 0.25


@dataclasses.dataclass(frozen=True)
class Training:
    """Result of `train`. Ratios, dimensionless, are of the trained law to the one that it was, over all validation rides: `comfort` of the weighted r.m.s.
    acceleration, `limited` of the r.m.s. of what has one of the `limits`, ratios too. `history` has a row a trial: the number of the episode, score,
    comfort and what is limited, as ratios, a score without bound where the vehicle hunts earlier than it did; `quiet` are the highest speeds (m/s) at which
    the vehicle did not hunt with the law that it was, after a small and after a large disturbance, nor does now, to one percent: NaN where it did at the highest speed of
    the rides already; `episodes` is the number done."""

    law: LearnedDamper
    comfort: float
    limited: dict[str, float]
    limits: dict[str, float]
    history: Float[np.ndarray, "validations columns"]  # episode, score, comfort, what is limited
    quiet: tuple[float, float]  # m/s
    episodes: int
    seconds: float  # s
    finished: str

    def __str__(self) -> str:
        gained = f"trained {self.law.origin}: {self.comfort:.3f} times the weighted acceleration on validation rides"
        held = [f"  {name} {value:.3f} times (limit {self.limits[name]:g})" for name, value in self.limited.items()]
        kinds = zip(("small", "large"), self.quiet, strict=True)
        speeds = [f"after a {kind} disturbance at {KMH * speed:.0f} km/h" for kind, speed in kinds if np.isfinite(speed)]
        if speeds:
            held.append(f"  hunts no earlier than it did, to one percent: not {', not '.join(speeds)}")
        return "\n".join([gained, *held, f"  {self.episodes} episodes, {self.seconds:.0f} s, {self.finished}"])


@guarded(
    law=None, tracks=as_tracks, validation=as_tracks, limits=None, episodes=whole(0), windows=whole(2), window=positive("s"),
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
    learning_rate: float = 2e-3,
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
    taken up again from `keep`. A vehicle that hunts with the law as it is is refused: a hunting run is never differentiated. Nor is a law taken for
    better with which the vehicle hunts more than one percent below the speed up to which it did not with the law as it was, after a small or a
    large disturbance.

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
        return Training(
            law, 1.0, ratios, limits, np.array([[0.0, 1.0, 1.0, *ratios.values()]]), (np.nan, np.nan), 0, 0.0, "nothing done"
        )
    trial = Trial(vehicle, law, others(tracks) if validation is None else validation, tuple(speeds), limits, dt)
    schedule_of = {"episodes": episodes, "learning_rate": learning_rate, "every": every, "patience": patience}
    told = teacher.fingerprint | {name: described(value) for name, value in schedule_of.items()}
    schedule = optax.cosine_decay_schedule(learning_rate, max(1, episodes * (windows - 1)), alpha=0.1)
    optimiser = optax.chain(optax.clip_by_global_norm(1.0), optax.adam(schedule))
    quiet = QuietSpeeds(vehicle, law, max(speeds), dt)
    weights = weights_of(law)
    score, numbers = trial.score(law)
    return_memory()  # what the compiler needed for the rides, before it needs as much for the gradient
    prices = {name: jnp.zeros(()) for name in limits}
    aims = {name: jnp.ones(()) for name in limits}
    course = Course(weights, optimiser.init(weights), prices, aims, weights, score, 0, 0, [(0.0, score, *numbers)])
    course = course if keep is None else taken_up(keep, course, told)
    clock = Clock(course.episode, episodes)
    while course.episode < episodes and course.stale < patience:
        course = teacher.episode(course, optimiser)
        if course.episode % every == 0 or course.episode == episodes:
            score, numbers = trial.score(with_weights(law, course.weights))
            # from a law with which it hunts, or worse than it was, nothing is learned
            weights = course.weights if numbers[0] < 1.0 else course.best
            course = course._replace(weights=weights, aims=aimed(course.aims, limits, numbers[1:]))
            course = tried(course, law, trial, quiet, score, numbers)
            if keep is not None:
                kept(keep, course, told)
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
        quiet.speeds,
        course.episode,
        time.monotonic() - began,
        finished,
    )


def tried(
    course: Course, law: LearnedDamper, trial: Trial, quiet: QuietSpeeds, score: float, numbers: tuple[float, ...]
) -> Course:
    """The course with its weights as the best, if they are better and the vehicle hunts no earlier with them; else, where that is all, with
    those part of the way there from the best so far.

    Args:
        course: after an episode.
        law: what is trained.
        trial: validation rides.
        quiet: speeds at which it must not hunt.
        score: of the weights on the validation rides, dimensionless.
        numbers: ratios there, dimensionless.
    """
    weights = course.weights
    for share in WAY:
        if share < 1.0:
            weights = jax.tree.map(lambda best, now, share=share: best + share * (now - best), course.best, course.weights)
            score, numbers = trial.score(with_weights(law, weights))
        if not score < course.best_score:
            break
        if quiet.kept(with_weights(law, weights)):
            history = [*course.history, (float(course.episode), score, *numbers)]
            return course._replace(best=weights, best_score=score, stale=0, history=history)
        score = np.inf
    return course._replace(stale=course.stale + 1, history=[*course.history, (float(course.episode), score, *numbers)])


def aimed(aims: dict[str, Any], limits: Mapping[str, float], found: Sequence[float]) -> dict[str, Any]:
    """What training is to hold from now on, times the limits: less by half of what the last trial was beyond, more by half of what it left.

    Args:
        aims: what it held until now.
        limits: the limits.
        found: ratios of the trial, in their order.
    """
    ratios = dict(zip(limits, found, strict=True))
    return {
        name: jnp.clip(aim + 0.5 * (1.0 - ratios[name] / limits[name]), *AIMS) if np.isfinite(ratios[name]) else aim
        for name, aim in aims.items()
    }


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
