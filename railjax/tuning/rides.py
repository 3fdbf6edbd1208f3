"""What a law is trained and tried on: rides of a vehicle, each on a place of a track, at a speed, with noise of its own; and what is measured on them."""

import copy
import dataclasses
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Float, Int

from ..base.batches import Batch
from ..base.errors import InputError
from ..base.units import KMH
from ..dampers.control.learned import LearnedDamper
from ..model.track.random import RandomTrack
from ..model.track.sampled import SampledTrack
from ..model.vehicle import Vehicle
from ..ride.vibration import weighted_acceleration
from ..simulation.simulate import simulate
from .forced import hunting

#: Hz; at which accelerations are looked at
RATE = 200.0
#: s at the start of a validation ride that do not count
SETTLING = 4.0
#: what a trial costs that is beyond its limit: ten times what it gains in comfort
DEAR = 10.0
#: m and number of realisations, of tracks that are given by a spectrum's name
LENGTH, REALISATIONS = 2000.0, 24
#: seeds of those of the validation rides
UNSEEN = range(1000, 1004)


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


def as_tracks(key: str, value: Any) -> None:
    """Names, or tracks given by samples, of one length."""
    given = [value] if isinstance(value, (str, SampledTrack)) else value
    if not isinstance(given, (list, tuple)) or not given:
        raise InputError(f"{key}: give names of spectra, or tracks such as railjax.RandomTrack, not {value!r}")
    for one in given:
        if not isinstance(one, (str, SampledTrack)):
            raise InputError(f"{key}: {one!r} is neither the name of a spectrum nor a track given by samples")


def others(tracks: Any) -> Any:
    names = [tracks] if isinstance(tracks, str) else tracks
    if not all(isinstance(name, str) for name in names):
        raise InputError("validation: give tracks that are not trained on")
    return [RandomTrack(name, seed=UNSEEN, length=LENGTH, fade=0.0) for name in names]


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


def picked(track: SampledTrack, which: np.ndarray, ahead: np.ndarray) -> SampledTrack:
    """Lanes of a track, each begun so far (m) along it."""
    picked = copy.copy(track)
    for name in ("coefficients", "spacing", "amplitude"):
        object.__setattr__(picked, name, np.asarray(getattr(track, name))[..., which])
    object.__setattr__(picked, "start", np.asarray(track.start)[which] - ahead)
    return picked


def mean_square(values: Float[Array | np.ndarray, "samples *places lanes"]) -> Float[Array | np.ndarray, "lanes"]:
    return (values**2).mean(axis=tuple(range(values.ndim - 1)))


def speed_of(speeds: tuple[float, ...], rng: np.random.Generator, count: int) -> np.ndarray:
    return rng.uniform(*speeds, count) if len(speeds) == 2 else rng.choice(speeds, count)


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
    found = {"comfort": np.asarray(mean_square(weighted))}
    found |= {name: np.asarray(mean_square(np.asarray(run[name])[first:])) for name in channels}
    ok = np.asarray(run.ok)
    if hunts:
        ok = ok & ~hunting(rides.vehicle, dataclasses.replace(law, seed=rides.seed), rides.speed, run.final, dt)
    return {name: np.where(ok, value, np.nan) for name, value in found.items()}


class Trial:
    """The validation rides: every track at four speeds."""

    def __init__(
        self, vehicle: Vehicle, law: LearnedDamper, tracks: Any, speeds: tuple[float, ...], limits: dict[str, float], dt: float
    ) -> None:
        track = together(tracks)
        count = np.shape(track.coefficients)[1]
        several = np.linspace(speeds[0], speeds[-1], 4) if len(speeds) == 2 else np.asarray(speeds, float)
        which, speed = (part.ravel() for part in np.meshgrid(np.arange(count), several))
        self.rides = Rides(vehicle, speed, picked(track, which, np.zeros(len(which))), np.arange(len(which)) + 0.5e6)
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
