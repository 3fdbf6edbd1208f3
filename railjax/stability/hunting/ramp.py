"""A slow ramp of the speed down and up, simulated: the independent check of the bifurcation diagram, with its hysteresis."""

from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...base.arguments import guarded
from ...base.errors import InputError
from ...base.precision import require_double_precision
from ...base.units import KMH
from ...model.damper import Damper
from ...model.motion import PASSIVE
from ...model.track.shapes import SinusoidTrack
from ...model.vehicle import Vehicle
from ...simulation.simulate import Result, simulate
from ...simulation.speed import SpeedProfile
from ..linear_critical import Stability, linear_critical
from .nonlinear_critical import default_wheelset

#: m/s²; slow enough for the coach's jumps to lie within 1 km/h of the fold and a few km/h of the Hopf point
RATE = 0.02
#: s; the amplitude is the largest displacement within such windows, which hold several periods
WINDOW = 1.0
#: m; amplitude of the sinusoidal alignment on the way up, without which nothing would leave straight running
DISTURBANCE = 1e-6


@dataclass(frozen=True)
class Ramp:
    """Amplitude (m) of a wheelset over the speed (m/s), on the way down and on the way up."""

    down_speed: Float[np.ndarray, "windows"]  # m/s
    down_amplitude: Float[np.ndarray, "windows"]  # m
    up_speed: Float[np.ndarray, "windows"]  # m/s
    up_amplitude: Float[np.ndarray, "windows"]  # m
    rate: float  # m/s^2

    @property
    def stops(self) -> float:
        """Speed (m/s) at which hunting stops on the way down: below a tenth of its first amplitude. NaN if it goes on."""
        quiet = self.down_amplitude < 0.1 * self.down_amplitude[0]
        return float(self.down_speed[np.argmax(quiet)]) if quiet.any() else np.nan

    @property
    def starts(self) -> float:
        """Speed (m/s) at which it starts on the way up: beyond half of its last amplitude. NaN if it does not."""
        loud = self.up_amplitude > 0.5 * self.down_amplitude[0]
        return float(self.up_speed[np.argmax(loud)]) if loud.any() else np.nan

    def __str__(self) -> str:
        return (
            f"Speed ramp of {self.rate:g} m/s²: hunting stops at {self.stops * KMH:.1f} km/h on the way down and starts at "
            f"{self.starts * KMH:.1f} km/h on the way up"
        )

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers and lists, for JSON."""
        return {"stops_kmh": self.stops * KMH, "starts_kmh": self.starts * KMH, "rate_m_per_s2": self.rate}


@guarded(("low", "high"))
def speed_ramp(
    vehicle: Vehicle,
    low: float,
    high: float,
    *,
    damper: Damper = PASSIVE,
    rate: float = RATE,
    dt: float = 1e-3,
    wheelset: int | None = None,
    amplitude: float | None = None,
) -> Ramp:
    """Simulate the vehicle on even track while its speed falls slowly and rises again: where hunting stops, and where it starts.

    The way down begins with all wheelsets displaced and 10 s at `high`; on the way up the track has a sinusoidal alignment of 1
    µm with the wavelength of hunting. A jump comes late by what the vehicle moves on in the meantime: less the slower the ramp.

    Args:
        vehicle: a single vehicle.
        low: lowest speed, m/s.
        high: highest speed, m/s; it should lie above the linear critical speed for hunting to start on the way up.
        damper: what takes the place of rho_cy; by default the vehicle's own.
        rate: how fast the speed changes, m/s²; by default 0.02, with which the coach's jumps lie within 1 km/h of the fold and a
            few km/h of the Hopf point.
        dt: step of RK4, s.
        wheelset: the one whose lateral displacement is the amplitude, counted from the front, 0 the first; by default the leading
            one of the trailing bogie.
        amplitude: displacement of the wheelsets at the start, m; by default the flange clearance.

    Raises:
        InputError: for speeds or a rate that make no ramp, a dt that RK4 does not hold, a run that diverges, and in single
            precision.
    """
    require_double_precision("a speed ramp")
    if not 0 < low < high:
        raise InputError(f"low and high must be positive speeds in rising order (m/s), not {low:g} and {high:g}")
    if not rate > 0:
        raise InputError(f"rate must be positive (m/s²), not {rate:g}")
    index = default_wheelset(vehicle, wheelset)
    amplitude = float(vehicle.contact.flange_clearance) if amplitude is None else amplitude
    settle = 10.0
    duration = settle + np.ceil((high - low) / rate / WINDOW) * WINDOW
    times = jnp.array([0.0, settle, duration])
    hopf = linear_critical(vehicle, damper=damper)
    found = bool(hopf.code == Stability.OK)
    wavelength = float(hopf.speed / hopf.frequency) if found else 20.0
    ways = []
    for speeds, start, wave in (((high, high, low), amplitude, 0.0), ((low, low, high), 0.0, DISTURBANCE)):
        profile = SpeedProfile(times, jnp.array(speeds))
        run = simulate(
            vehicle,
            profile,
            damper=damper,
            track=SinusoidTrack(wave, wavelength),
            duration=float(duration),
            dt=dt,
            initial={"wheelset_y": start},
            record=["wheelset_y"],
            sample=5 * dt,
        )
        if int(run.code) != Result.OK:
            raise InputError(f"the ramp cannot be simulated with dt = {dt:g} s: {Result(int(run.code)).name.lower()}")
        y, time = np.asarray(run["wheelset_y"])[:, index], np.asarray(run.time)
        windows = (time // WINDOW).astype(int)
        heights = np.array([np.max(np.abs(y[windows == k])) for k in range(windows[-1] + 1)])
        middles = (np.arange(windows[-1] + 1) + 0.5) * WINDOW
        kept = middles > settle
        ways.append((np.asarray(profile.at(jnp.asarray(middles)))[kept], heights[kept]))
    (down_speed, down), (up_speed, up) = ways
    return Ramp(down_speed, down, up_speed, up, rate)
