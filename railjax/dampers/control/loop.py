"""The loop as hardware closes it: sensors are read every `sample_time`, a law makes a command of the readings, and a device holds it.

All memory is the damper's own internal states, as many for each bogie: the time until the next sample, its number, the sensors' filters,
past readings, what the law remembers, the command, and the actuator's answer to it. Between samples only filters and actuator move.
"""

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from ...base.fields import parameter
from ...base.typing import Number
from ...model.damper import Bogies, Law, PassiveDamper, Seen
from ...model.vehicle import Vehicle
from ..sampling import SLACK
from .device import Device, Faults, failed
from .sensors import Sensors, Signals

Rows = Float[Array, "..."]


@dataclass(frozen=True, kw_only=True)
class SampledLoop(Law):
    """What controllers and learned laws share. A law adds what it remembers (`memory_rows`, `memory_even`) and how it decides (`decide`)."""

    sensors: Sensors
    device: Device | None = None
    faults: Faults | None = None
    sample_time: Number = parameter("s", "T", "time from sample to sample; a step must not be longer", 1e-3, positive=True)
    seed: Number = parameter("1", "", "seed of the sensors' noise, a whole number", 0.0)

    observes: ClassVar[bool] = True

    @property
    @abstractmethod
    def on(self) -> Device:
        """The device that it commands."""

    @property
    def memory_rows(self) -> int:
        """What the law remembers from sample to sample, numbers per bogie."""
        return 0

    @property
    def memory_even(self) -> tuple[int, ...]:
        """Which of these have no side."""
        return ()

    @abstractmethod
    def decide(self, vehicle: Vehicle, signals: Signals, memory: Rows, elapsed: Bogies) -> tuple[Bogies, Rows]:
        """The command and what is remembered, of the readings that have arrived `elapsed` s after the last ones."""

    @property
    def rows(self) -> dict[str, int]:
        """The internal states in their order: name -> how many per bogie."""
        sensors = len(self.sensors.names)
        # the newest reading is remembered where it may freeze
        line = sensors * (max(self.sensors.longest_delay, 0 if self.faults is None else 1))
        return {
            "clock": 1,
            "count": 1,
            "filtered": sensors,
            "readings": line,
            "memory": self.memory_rows,
            "command": 1,
            "actuator": 0 if self.on.lag is None else 1,
            "direction": 1 if self.on.held else 0,
        }

    @property
    def internal_states(self) -> int:
        """How many states of its own the loop has per bogie."""
        return sum(self.rows.values())

    @property
    def even_states(self) -> tuple[int, ...]:
        """Indices of the states without a side: times, and a valve's opening."""
        starts, start = {}, 0
        for name, count in self.rows.items():
            starts[name], start = start, start + count
        memory = tuple(starts["memory"] + index for index in self.memory_even)
        valve = ("command", "actuator")[: 2 if self.on.lag is not None else 1] if self.on.kind == "valve" else ()
        return (starts["clock"], starts["count"], *memory, *(starts[name] for name in valve))

    def parts(self, internal: Any) -> dict[str, Any]:
        """The internal states by name, each (rows, n, *lanes)."""
        found, start = {}, 0
        for name, count in self.rows.items():
            found[name], start = internal[start : start + count], start + count
        return found

    def force(self, vehicle: Vehicle, travel: Bogies, velocity: Bogies, internal: Bogies, seen: Seen) -> tuple[Bogies, Bogies]:
        """Force of a bogie's dampers, N, and the rates of clock, filters and actuator."""
        own = self.parts(internal)
        _, filtering = self.sensors.reading(vehicle, travel, velocity, seen, own["filtered"])
        rates = {name: jnp.zeros_like(rows) for name, rows in own.items()}
        rates |= {"clock": -jnp.ones_like(own["clock"]), "filtered": filtering}
        acting = own["command"]
        if self.on.lag is not None:
            acting = own["actuator"]
            rates["actuator"] = (own["command"] - acting) / self.on.lag
        direction = own["direction"][0] if self.on.held else None
        force = self.on.delivered(acting[0], velocity, direction)
        if self.faults is not None:
            force = force * (1.0 - padded(self.faults.dead, force) * failed(self.faults, self._now(own)))
        return force, jnp.concatenate([rates[name] for name in own])

    def held(self, vehicle: Vehicle, travel: Bogies, velocity: Bogies, internal: Bogies, seen: Seen) -> Bogies:
        """Where a sample is due: readings, decision, and the time until the next. Done twice at an instant it changes nothing."""
        own = self.parts(internal)
        left = own["clock"][0]
        due = left <= SLACK * self.sample_time
        # more than one where a step is longer than the sample time
        passed = jnp.where(due, jnp.floor(SLACK - left / self.sample_time) + 1.0, 0.0)
        elapsed = passed * self.sample_time
        fresh = dict(own)
        fresh["clock"] = (left + elapsed)[None]
        fresh["count"] = own["count"] + passed[None]
        reading, _ = self.sensors.reading(vehicle, travel, velocity, seen, own["filtered"])
        reading = self.sensors.converted(reading, self.seed, own["count"][0])
        line = own["readings"].reshape((-1, *reading.shape))
        if self.faults is not None:
            frozen = padded(self.faults.frozen, reading) * failed(self.faults, self._now(own))
            reading = jnp.where(frozen > 0.5, line[0], reading)
        line = jnp.concatenate([reading[None], line])
        signals = jnp.stack([line[delay, k] for k, delay in enumerate(self.sensors.delays)])
        fresh["readings"] = line[:-1].reshape(own["readings"].shape)
        command, fresh["memory"] = self.decide(vehicle, signals, own["memory"], elapsed)
        command = self.on.slewed(command, own["command"][0], elapsed)
        if self.faults is not None:
            command = command * (1.0 - padded(self.faults.current, command) * failed(self.faults, self._now(own)))
        fresh["command"] = command[None]
        chosen = jnp.where(due, jnp.concatenate(list(fresh.values())), internal)
        if self.on.held:
            chosen = jnp.concatenate([chosen[:-1], jnp.sign(velocity)[None]])
        return chosen.astype(internal.dtype)

    def _now(self, own: dict[str, Rows]) -> Bogies:
        """Time since the start, s, (n, *lanes)."""
        return own["count"][0] * self.sample_time - own["clock"][0]

    def fault(self) -> str | None:
        """What is wrong with the parts together."""
        return self.sensors.fault() or self.on.fault()

    def extremes(self, vehicle: Vehicle) -> tuple[PassiveDamper, ...]:
        """The device's greatest damping bounds the rates, its least where a force has no such bound."""
        return (PassiveDamper(self.on.damping_min if self.on.damping_max is None else self.on.damping_max),)


def padded(numbers: Number, like: Rows) -> Rows:
    """Numbers with axes of their own, without lanes or with them, for an array that has lanes."""
    numbers = jnp.asarray(numbers, like.dtype)
    return numbers.reshape(numbers.shape + (1,) * (like.ndim - numbers.ndim))
