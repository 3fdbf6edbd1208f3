"""Forced response as objectives: r.m.s. and extreme values on tracks, in the frequency domain or through time."""

import dataclasses
from dataclasses import dataclass
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..base.batches import Batch
from ..base.errors import InputError
from ..base.fields import structure
from ..base.pytrees import registered
from ..base.typing import Number, Scalar
from ..model.damper import Damper, answers, with_law
from ..model.track.random import RandomTrack
from ..model.track.sampled import SampledTrack
from ..model.track.shapes import TangentTrack, Track
from ..model.track.spectra import LONGEST, SHORTEST, spectrum
from ..model.vehicle import Vehicle
from ..ride.frequency import POINTS, frequency_response, waves_of
from ..ride.statistical import CONVERGED, statistical_linearisation
from ..ride.vibration import weighted_rms
from ..simulation.channels import CHANNELS
from ..simulation.integrate import DIVERGED
from ..simulation.simulate import Simulation, simulate
from ..simulation.step_size import largest_step
from .quantity import Quantity, kmh, sharp_laws, smoothed_laws

#: the sharp check of a spectrum: one whole period (m) of a realisation, after some seconds; samples each second of what is weighted
PERIOD, SETTLING, RATE = 4e3, 10.0, 200.0
#: s of free running after a run by which it is told whether the vehicle hunts; share of the motion that may be left, and the
#: displacement (m) below which it is at rest
COASTING, LEFT, REST = 6.0, 0.9, 2e-4
#: 1/s; displacements of less than 1 m at the rates of a vehicle move slower than this, m/s
FASTEST = 100.0


def response_over(
    label: str,
    speeds: np.ndarray,
    track: Any,
    channel: str,
    weighting: str | None,
    factor: Scalar,
    method: str,
    run: dict[str, Any],
) -> Quantity:
    """A `Response` on random tracks or a `Run` on any."""
    tracks = tuple(track) if isinstance(track, (list, tuple)) else (track,)
    if not tracks:
        raise InputError("track: name at least one")
    random = not any(isinstance(one, Track) and not isinstance(one, SampledTrack) for one in tracks)
    if method == "time" or (method == "auto" and not random):
        known = {field.name for field in dataclasses.fields(Run)} & {"duration", "settle", "dt"}
        for key in run:
            if key not in known:
                raise InputError(f"unknown option {key!r}; through time there are {', '.join(sorted(known))}")
        lines = tuple(one if isinstance(one, Track) else RandomTrack(one) for one in tracks)
        return Run(jnp.asarray(speeds), lines, label, channel, weighting, **run)
    if run:
        raise InputError(f"{next(iter(run))!r} is an option of method='time'")
    if not random:
        raise InputError(f"method={method!r} is for random tracks; {type(tracks[0]).__name__} needs method='time'")
    sources = tuple(one if isinstance(one, SampledTrack) else spectrum(one) for one in tracks)
    waves = tuple(waves_of(one, SHORTEST, LONGEST, POINTS) for one in sources)
    return Response(jnp.asarray(speeds), waves, sources, float(factor), label, channel, weighting, method)


@dataclass(frozen=True, eq=False)
class Forced(Quantity):
    """What the two share: names, units, and how speeds and tracks are put together."""

    def _names(self) -> tuple[str, str | None, str]:
        return self.label, self.weighting, self.channel  # type: ignore[attr-defined]

    @property
    def name(self) -> str:
        label, weighting, _ = self._names()
        return f"{label}{f' ({weighting})' if weighting else ''} at {kmh(self.speeds)}"

    @property
    def unit(self) -> str:  # type: ignore[override]
        return {"m": "mm", "N": "kN"}.get(CHANNELS[self.channel].unit, CHANNELS[self.channel].unit)

    @property
    def factor(self) -> float:  # type: ignore[override]
        return {"m": 1e3, "N": 1e-3}.get(CHANNELS[self.channel].unit, 1.0)

    def _together(self, values: Float[Array, "cases"]) -> Float[Array, ""]:
        return jnp.sqrt(jnp.mean(values**2)) if self.label == "comfort" else jnp.max(values)


@registered
@dataclass(frozen=True, eq=False)
class Response(Forced):
    """On random tracks, linear or statistically linearised: `peak_factor` times the r.m.s. of a channel, of its places the largest."""

    speeds: Number = None
    waves: tuple = ()
    sources: tuple = ()  # spectra or realisations, for the sharp check
    peak_factor: Number = 1.0
    label: str = structure("comfort")
    channel: str = structure("carbody_acceleration")
    weighting: str | None = structure("Wd")
    method: str = structure("frequency")

    def suited(self, damper: Damper) -> "Response":
        """Frequency domain for what is linear, statistical linearisation for what switches or is curved. Raises `InputError` for laws with memory."""
        law = answers(damper)
        if self.method == "frequency" and law.decides:
            raise InputError(
                f"{self.label}: {type(damper).__name__} has no linear law; method='statistical' takes balance logic, 'time' any law"
            )
        method = ("frequency" if law.linear else "statistical") if self.method == "auto" else self.method
        if method == "statistical" and not law.memoryless:
            raise InputError(f"{self.label}: {type(damper).__name__} has a memory; tune it with method='time'")
        return dataclasses.replace(self, method=method)

    def value(self, vehicle: Vehicle, damper: Damper) -> Float[Array, ""]:
        def of(waves: Any) -> Float[Array, "speeds"]:
            def at(speed: Float[Array, ""]) -> Float[Array, ""]:
                if self.method == "statistical":
                    found = statistical_linearisation(
                        vehicle, speed, waves, damper=with_law(damper, "smooth"), record=(self.channel,)
                    )
                    rms = jnp.where(found.change < CONVERGED, found.response.rms(self.channel, self.weighting), jnp.nan)
                else:
                    rms = frequency_response(vehicle, speed, waves, damper=damper, record=(self.channel,)).rms(
                        self.channel, self.weighting
                    )
                return jnp.max(rms)

            return jax.lax.map(at, self.speeds)

        return self.peak_factor * self._together(jnp.concatenate([of(waves) for waves in self.waves]))

    def sharp(self, vehicle: Vehicle, damper: Damper) -> float:
        """The same r.m.s. of a simulation with the sharp laws, over a whole period of a realisation, whose lines have the spectrum's
        variance exactly."""
        found = []
        for source in self.sources:
            track = source if isinstance(source, SampledTrack) else RandomTrack(source, length=PERIOD)
            found += [_period_rms(self, *sharp_laws(vehicle, damper), float(speed), track) for speed in np.asarray(self.speeds)]
        return float(self.peak_factor) * float(self._together(jnp.asarray(found)))


def _period_rms(of: Response, vehicle: Vehicle, damper: Damper, speed: float, track: SampledTrack) -> float:
    dt = step(vehicle, speed, damper)
    sample = 1.0 / RATE
    duration = round((SETTLING + float(track.length) / speed) * RATE) / RATE
    run = simulate(vehicle, speed, track=track, damper=damper, duration=duration, dt=dt, sample=sample, record=(of.channel,))
    record = jnp.asarray(run[of.channel])
    if not bool(run.ok):
        return np.nan
    if of.weighting:
        return float(jnp.max(weighted_rms(record, RATE, of.weighting, settle=SETTLING)))
    return float(jnp.max(jnp.sqrt(jnp.mean(record[round(SETTLING * RATE) :] ** 2, axis=0))))


def step(vehicle: Vehicle, speed: float, damper: Damper) -> float:
    """1 ms, or the whole part of it that RK4 holds."""
    largest = float(largest_step(vehicle, jnp.asarray(speed), damper))
    if not largest > 0.0:
        raise InputError("the state matrix is not finite; look for a mass or stiffness that is far from any vehicle's")
    return 1e-3 / max(1, int(np.ceil(1e-3 / (0.95 * largest))))


@registered
@dataclass(frozen=True, eq=False)
class Run(Forced):
    """Through time, with smooth laws and in forward mode: r.m.s. of the run after `settle`, or its peak (travel and forces)."""

    speeds: Number
    tracks: tuple
    label: str = structure("comfort")
    channel: str = structure("carbody_acceleration")
    weighting: str | None = structure(None)
    duration: float = structure(12.0)
    settle: float = structure(6.0)
    dt: float = structure(1e-3)

    mode: ClassVar[str] = "forward"

    def _runs(self, vehicle: Vehicle, damper: Damper, speeds: Any, **options: Any) -> list[Simulation]:
        return [
            simulate(
                vehicle, speeds, track=track, damper=damper, duration=self.duration, settle=self.settle, dt=self.dt, **options
            )
            for track in self.tracks
        ]

    @property
    def _speed(self) -> Float[Array, "..."]:
        """Lanes where there are several; a run alone is quicker without."""
        speeds = jnp.asarray(self.speeds)
        return speeds if speeds.shape[0] > 1 else speeds[0]

    def _values(self, vehicle: Vehicle, damper: Damper, speeds: Any) -> tuple[Float[Array, "tracks *lanes"], list[Array]]:
        """Of each track, of places the worst; and the states at the end."""
        lanes = 1 if Batch.of(vehicle, damper, speeds).lanes else 0
        if self.weighting:
            runs = self._runs(vehicle, damper, speeds, record=(self.channel,), sample=1.0 / RATE)
            found = [weighted_rms(run[self.channel], RATE, self.weighting, settle=self.settle) for run in runs]
        else:
            how = f"{'rms' if self.label == 'comfort' else 'peak'}:{self.channel}"
            runs = self._runs(vehicle, damper, speeds, record=(), sample=self.dt * max(1, round(0.1 / self.dt)), reduce=(how,))
            found = [run[how] for run in runs]
        worst = [jnp.max(values, axis=0) if values.ndim > lanes else values for values in found]
        # not run.ok, whose look at dt XLA does not put into one kernel with the run; `check` looks
        ends = [run.final for run in runs]
        within = [jnp.max(jnp.abs(end), axis=0) < DIVERGED * FASTEST for end in ends]
        return jnp.stack([jnp.where(fine, values, jnp.nan) for fine, values in zip(within, worst, strict=True)]), ends

    def _ended(self, vehicle: Vehicle, damper: Damper) -> tuple[Float[Array, ""], list[Array]]:
        values, ends = self._values(vehicle, damper, self._speed)
        return self._together(values.reshape(-1)), ends

    def each(self, vehicle: Vehicle, damper: Damper) -> Float[Array, "lanes"]:
        """All lanes and speeds in one batch."""
        batch, speeds = Batch.of(*smoothed_laws(vehicle, damper)), jnp.asarray(self.speeds)
        repeated = batch.take(np.repeat(np.arange(batch.lanes), len(speeds)))
        values, _ = self._values(*repeated, jnp.tile(speeds, batch.lanes))  # type: ignore[call-arg]
        found = values.reshape(len(self.tracks), batch.lanes, len(speeds))
        return jax.vmap(lambda values: self._together(values.reshape(-1)), in_axes=1)(found)

    def value(self, vehicle: Vehicle, damper: Damper) -> Float[Array, ""]:
        return self.ended(vehicle, damper)[0]

    def ended(self, vehicle: Vehicle, damper: Damper) -> tuple[Float[Array, ""], list[Array]]:
        """With the states at the end of the runs."""
        return self._ended(*smoothed_laws(vehicle, damper))

    def sharp(self, vehicle: Vehicle, damper: Damper) -> float:
        """The same run with the sharp laws."""
        return float(self._ended(*sharp_laws(vehicle, damper))[0])

    def check(self, vehicle: Vehicle, damper: Damper, end: Any = None) -> None:
        """Let the vehicle run on, on even track: what does not die out is hunting."""
        vehicle, damper = smoothed_laws(vehicle, damper)
        for state in self._ended(vehicle, damper)[1] if end is None else end:
            hunts = hunting(vehicle, damper, self._speed, state, self.dt)
            if np.any(hunts):
                at = kmh(np.asarray(self.speeds)[np.atleast_1d(hunts)])
                raise InputError(
                    f"{self.label} through time at {at}: the vehicle hunts there (left alone, its motion does not die out), and a hunting run "
                    "is never differentiated through time; tune limit_cycle_amplitude(speed) or nonlinear_critical_speed(), or go slower"
                )


def hunting(
    vehicle: Vehicle, damper: Damper, speed: Any, state: Float[Array, "states *lanes"], dt: float
) -> Bool[np.ndarray, "*lanes"]:
    """Where the motion from a state on does not die out on even track, or the state cannot be used."""
    free = simulate(
        vehicle,
        speed,
        track=TangentTrack(),
        damper=damper,
        duration=COASTING,
        dt=dt,
        initial=state,
        record=("wheelset_y",),
        sample=10 * dt,
    )
    y = np.asarray(free["wheelset_y"])
    second = len(y) // int(COASTING)
    first, last = (np.sqrt(np.mean(part**2, axis=0)).max(axis=0) for part in (y[:second], y[-second:]))
    return np.asarray(((last > LEFT * first) & (last > REST)) | ~np.isfinite(last) | ~np.asarray(free.ok))
