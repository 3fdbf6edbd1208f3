"""What a bogie carries to measure with, and what a controller makes of it: bandwidth, noise, bias, quantisation, delay.

A sensor of bandwidth f follows its quantity as a first-order low-pass, τ = 1/(2π f). Of an accelerometer that is the difference of a velocity
and the same velocity through the low-pass, over τ, so that no acceleration is needed; fixed to a body that rolls by φ it feels g φ as well:

    z = (v - w)/τ,  w' = z - g φ    so that  τ z' + z = v' + g φ        (accelerometers)
    z = w,          w' = (u - w)/τ                                      (others)

At a sample the converter makes of z:  round((z + b + σ e)/Δ) Δ, with the bias b, noise of r.m.s. σ and the quantum Δ; d samples later the
controller has it. The noise e is a function of seed, sample, bogie and sensor alone: a run repeats to the bit, alone or in a batch.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt

from ...base.arguments import guarded
from ...base.checks import from_zero, positive, whole
from ...base.errors import InputError, closest
from ...base.fields import parameter, structure, table
from ...base.pytrees import registered
from ...base.typing import Number, Scalar
from ...model.damper import Bogies, Seen
from ...model.kinematics import Groups, of_carbody
from ...model.vehicle import Vehicle

Signals = Float[Array, "m n *lanes"]


class Kind(NamedTuple):
    """A kind of sensor, with what is usual (orders of magnitude of data sheets, recalled): r.m.s. noise within the band, bias, band in Hz, quantum."""

    unit: str
    meaning: str
    noise: float
    bias: float
    bandwidth: float
    quantum: float


ACCELEROMETERS = ("carbody_acceleration", "bogie_acceleration")
KINDS = {
    "carbody_acceleration": Kind("m/s^2", "lateral acceleration of the car body above the dampers", 0.01, 0.05, 100.0, 0.01),
    "bogie_acceleration": Kind("m/s^2", "lateral acceleration of the bogie at the dampers", 0.05, 0.05, 100.0, 0.05),
    "travel": Kind("m", "displacement across the dampers", 5e-5, 5e-4, 100.0, 4e-5),
    "carbody_roll_rate": Kind("rad/s", "gyro: roll rate of the car body", 1e-3, 3e-3, 80.0, 1e-4),
    "carbody_yaw_rate": Kind("rad/s", "gyro: yaw rate of the car body", 1e-3, 3e-3, 80.0, 1e-4),
    "bogie_yaw_rate": Kind("rad/s", "gyro: yaw rate of the bogie", 1e-3, 3e-3, 80.0, 1e-4),
}
#: the suite that most laws need
USUAL = ("carbody_acceleration", "bogie_acceleration", "travel")

GRAVITY = 9.81  # m/s^2


@registered
@dataclass(frozen=True, kw_only=True)
class Sensors:
    """Sensors at each bogie, one of each of `names`; made by `Sensors.typical` or `Sensors.ideal`.

    Tables hold one number a sensor, in SI; a lane of a batch may have its own. `delays` are numbers of samples until the controller has a reading.
    """

    names: tuple[str, ...] = structure(USUAL, "kinds of sensors")
    delays: tuple[int, ...] = structure((0, 0, 0), "samples until the controller has a reading, per sensor")
    noise: Number = table("1", "σ", "r.m.s. of each sensor's noise, in its unit")
    bias: Number = table("1", "b", "bias of each sensor, in its unit", signed=True)
    quantum: Number = table("1", "Δ", "step of each converter, in its sensor's unit; 0: none")
    bandwidth: Number = table("Hz", "f", "bandwidth of each sensor")
    gravity: Number = parameter("m/s^2", "g", "what accelerometers feel of a roll angle; 0 on a levelled platform", GRAVITY)

    @classmethod
    @guarded(names=None, delay=whole(0))
    def typical(cls, *names: str, delay: int = 1) -> "Sensors":
        """As data sheets have them.

        Args:
            *names: kinds of sensors; none: accelerometers on both bodies and the damper's travel.
            delay: number of samples until the controller has a reading.

        Raises `InputError` for kinds that there are not.
        """
        names = _known(names or USUAL)
        return cls(
            names=names,
            delays=(delay,) * len(names),
            **{
                field: np.array([getattr(KINDS[name], field) for name in names])
                for field in ("noise", "bias", "quantum", "bandwidth")
            },
        )

    @classmethod
    @guarded(names=None, bandwidth=positive("Hz"))
    def ideal(cls, *names: str, bandwidth: float = 400.0) -> "Sensors":
        """Without noise, bias, quantisation, delay and roll.

        Args:
            *names: kinds of sensors; none: as `typical`.
            bandwidth: of each, Hz; by default one that RK4 at 1 ms just holds.
        """
        names = _known(names or USUAL)
        none = np.zeros(len(names))
        return cls(
            names=names, delays=(0,) * len(names), noise=none, bias=none, quantum=none, bandwidth=none + bandwidth, gravity=0.0
        )

    @guarded(share=from_zero())
    def scaled(self, share: float) -> "Sensors":
        """The same with noise, bias, quantum and g times `share`, and 1/share of the bandwidth's time constant."""
        noise, bias, quantum = (share * np.asarray(part) for part in (self.noise, self.bias, self.quantum))
        bandwidth = np.asarray(self.bandwidth) / share if share else self.bandwidth
        return replace(self, noise=noise, bias=bias, quantum=quantum, bandwidth=bandwidth, gravity=share * self.gravity)

    @property
    def longest_delay(self) -> int:
        """Samples that have to be remembered."""
        return max(self.delays)

    def fault(self) -> str | None:
        """What is wrong with its numbers together."""
        lengths = {len(self.names), len(self.delays)} | {
            jnp.shape(part)[0] for part in (self.noise, self.bias, self.quantum, self.bandwidth)
        }
        if len(lengths) > 1:
            return f"sensors: {len(self.names)} names need as many delays, noises, biases, quanta and bandwidths"
        if not all(isinstance(delay, int) and delay >= 0 for delay in self.delays):
            return f"sensors: delays must be whole numbers of samples from 0 on, not {self.delays}"
        if not np.all(np.asarray(self.bandwidth) > 0.0):
            return "sensors: every bandwidth must be positive (Hz)"
        return None

    def reading(
        self, vehicle: Vehicle, travel: Bogies, velocity: Bogies, seen: Seen, filtered: Signals
    ) -> tuple[Signals, Signals]:
        """z of each sensor and the rate w' of its filter, both (m, n, *lanes).

        Args:
            vehicle: gives the places of the dampers.
            travel: Δy_c over each bogie, shape `(n, *lanes)`, m.
            velocity: Δy_c', shape `(n, *lanes)`, m/s.
            seen: all coordinates and rates.
            filtered: w, shape `(m, n, *lanes)`, m/s, m and rad/s.
        """
        quantities = _quantities(vehicle, travel, velocity, seen)
        value = jnp.stack([quantities[name] for name in self.names])
        tilt = jnp.stack([quantities[f"roll of {name}"] if name in ACCELEROMETERS else 0.0 * travel for name in self.names])
        inverse = 2.0 * jnp.pi * column(self.bandwidth, value)
        rate = (value - filtered) * inverse
        accelerometer = np.array([name in ACCELEROMETERS for name in self.names]).reshape((-1,) + (1,) * (value.ndim - 1))
        return jnp.where(accelerometer, rate, filtered), jnp.where(accelerometer, rate - self.gravity * tilt, rate)

    def converted(self, reading: Signals, seed: Scalar, count: Bogies) -> Signals:
        """What the converters give of z; the derivative passes them by.

        Args:
            reading: z, shape `(m, n, *lanes)`, SI.
            seed: of the noise, a whole number.
            count: number of the sample, shape `(n, *lanes)`, dimensionless.
        """
        noisy = reading + column(self.bias, reading) + column(self.noise, reading) * noise_of(seed, count, reading)
        quantum = column(self.quantum, reading)
        step = jnp.where(quantum > 0.0, quantum, 1.0)
        rounded = jnp.where(quantum > 0.0, jnp.round(noisy / step) * step, noisy)
        return noisy + jax.lax.stop_gradient(rounded - noisy)


def _known(names: tuple[str, ...]) -> tuple[str, ...]:
    for name in names:
        if name not in KINDS:
            raise InputError(f"unknown sensor {name!r}; did you mean {closest(str(name), KINDS)!r}? there are {', '.join(KINDS)}")
    if len(set(names)) < len(names):
        raise InputError("sensors: name each kind once; every bogie has one of each")
    return tuple(names)


def _quantities(vehicle: Vehicle, travel: Bogies, velocity: Bogies, seen: Seen) -> Groups:
    """What the sensors of all kinds measure, with v for v', and by how much accelerometers are tilted, each (n, *lanes)."""

    def of(group: str, groups: Groups) -> Bogies:
        return jnp.broadcast_to(groups.get(group, jnp.zeros_like(travel)), travel.shape)

    above = jnp.broadcast_to(of_carbody(vehicle, seen.rates), travel.shape)
    return {
        "carbody_acceleration": above,
        # Δy_c' is the difference of what the damper's ends do
        "bogie_acceleration": above - velocity,
        "roll of carbody_acceleration": of("carbody_phi", seen.coordinates),
        "roll of bogie_acceleration": of("bogie_phi", seen.coordinates),
        "travel": travel,
        "carbody_roll_rate": of("carbody_phi", seen.rates),
        "carbody_yaw_rate": of("carbody_psi", seen.rates),
        "bogie_yaw_rate": of("bogie_psi", seen.rates),
    }


def column(numbers: Number, like: Float[Array, "..."]) -> Float[Array, "..."]:
    """One number a row, (m,) or with lanes (m, lanes), for arrays of shape (m, n, *lanes)."""
    numbers = jnp.asarray(numbers, like.dtype)
    return numbers.reshape((numbers.shape[0], 1, *numbers.shape[1:], *(1,) * (like.ndim - 1 - numbers.ndim)))


def noise_of(seed: Scalar, count: Bogies, like: Signals) -> Signals:
    """Numbers of mean 0 and variance 1 for each sensor of each bogie: the sum of four even ones, at most 3.46 (excess -0.3)."""
    index = jnp.arange(like.shape[0] * like.shape[1], dtype=jnp.uint32).reshape(like.shape[:2] + (1,) * (like.ndim - 2))
    first = _mixed(index + _mixed(_whole(count)[None] + _mixed(_whole(seed) + jnp.uint32(0x9E3779B9))))
    pair = first, _mixed(first ^ jnp.uint32(0x68E31DA4))
    quarters = [part for word in pair for part in (word & jnp.uint32(0xFFFF), word >> jnp.uint32(16))]
    total = sum(part.astype(like.dtype) for part in quarters)
    return jnp.broadcast_to((total / 65536.0 - 2.0 * (1.0 - 1.0 / 65536.0)) * np.sqrt(3.0), like.shape)


def _whole(number: Scalar) -> UInt[Array, "..."]:
    return jnp.round(jax.lax.stop_gradient(jnp.asarray(number))).astype(jnp.int32).astype(jnp.uint32)


def _mixed(bits: UInt[Array, "..."]) -> UInt[Array, "..."]:
    """A permutation of 32 bits that looks like chance (the multipliers of Wellons' "lowbias32")."""
    bits = (bits ^ (bits >> jnp.uint32(16))) * jnp.uint32(0x7FEB352D)
    bits = (bits ^ (bits >> jnp.uint32(15))) * jnp.uint32(0x846CA68B)
    return bits ^ (bits >> jnp.uint32(16))
