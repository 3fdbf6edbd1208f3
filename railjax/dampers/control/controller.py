"""`Controller`: a classical law behind sensors, an estimator, a sampled computer and a device."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from ...base.arguments import guarded
from ...base.checks import a_path
from ...base.pytrees import registered
from ...model.damper import Bogies, answers, law_of
from ...model.vehicle import Vehicle
from ..clipped_lqr import ClippedLQR
from ..controlled import ForceControlled, ValveControlled
from .device import Device
from .estimators import ComplementaryFilter
from .kalman import KalmanFilter
from .law_files import save_law
from .loop import SampledLoop
from .sensors import Sensors, Signals

Rows = Float[Array, "..."]
Estimator = ComplementaryFilter | KalmanFilter


@registered
@dataclass(frozen=True, kw_only=True)
class Controller(SampledLoop):
    """A law as hardware runs it: `Controller(Skyhook())`.

    Every `sample_time` the `sensors` are read, the `estimator` makes travel, velocities and a `Seen` of the readings, the law `wraps` decides on
    these as it stands, and the `device` holds its command until the next sample. What the law asks for is clipped to what the device can do at
    the velocity there is. Lags of the law's own are steps of Euler's rule in the computer; its `sample_time` is the controller's.

    Args:
        wraps: balance logic, skyhook, ADD, mixed SH-ADD, clipped LQR or a law of one's own whose force is a demand. Laws that are devices
            themselves (Bouc-Wen, hybrid, Maxwell) take no orders and are refused.
        sensors: what is measured; by default `Sensors.typical()`, one sample late.
        estimator: a `ComplementaryFilter`, or a `KalmanFilter` made by `KalmanFilter.design(vehicle, speed, sensors)`, which clipped LQR needs.
        device: the damper; by default what the law itself assumes, without lag.
        faults: what fails, and when; None: nothing, and no code for it.
        sample_time: T, s.
        seed: of the sensors' noise, a whole number; an array gives each lane its own.
    """

    wraps: Any = dataclasses.field(default=None, kw_only=False)
    sensors: Sensors = dataclasses.field(default_factory=Sensors.typical)
    estimator: Any = dataclasses.field(default_factory=ComplementaryFilter)

    @property
    def on(self) -> Device:
        """The device: its own, or what the law has."""
        if self.device is not None:
            return self.device
        law = self.wraps
        if isinstance(law, ValveControlled):
            return Device(damping_min=law.damping_min, damping_max=law.damping_max, force_limit=None, lag=None)
        if isinstance(law, ForceControlled):
            return Device(kind="force", damping_min=law.damping_min, damping_max=None, force_limit=law.force_limit, lag=None)
        return Device()

    @property
    def _inner(self) -> Any:
        """The law, which decides at every sample."""
        names = {entry.name for entry in dataclasses.fields(self.wraps)} if dataclasses.is_dataclass(self.wraps) else set()
        return dataclasses.replace(self.wraps, sample_time=None) if "sample_time" in names else self.wraps

    @property
    def memory_rows(self) -> int:
        """Those of estimator and law."""
        return self.estimator.states + getattr(self._inner, "internal_states", 0)

    @property
    def memory_even(self) -> tuple[int, ...]:
        """Those of the law."""
        return tuple(self.estimator.states + index for index in answers(self._inner).even_states)

    def decide(self, vehicle: Vehicle, signals: Signals, memory: Rows, elapsed: Bogies) -> tuple[Bogies, Rows]:
        """The law's command on what is estimated.

        Args:
            vehicle: what the law takes for its own.
            signals: readings, shape `(m, n, *lanes)`, each in its unit.
            memory: of estimator and law, shape `(rows, n, *lanes)`, SI.
            elapsed: time since the last sample, shape `(n, *lanes)`, s.
        """
        names, known = self.sensors.names, self.estimator.states
        estimated = self.estimator.advanced(names, signals, memory[:known], elapsed)
        guess = self.estimator.estimate(vehicle, self.estimator.features(names, signals, estimated))
        local = vehicle, guess.travel, guess.velocity
        law = self._inner
        inner = answers(law).held(*local, memory[known:], guess.seen)
        demand, rate = law_of(law, guess.seen)(*local, inner)
        command = self.on.command(demand, guess.velocity)
        estimated = self.estimator.told(estimated, self.on.delivered(command, guess.velocity))
        return command, jnp.concatenate([estimated, inner + elapsed * rate])

    @guarded(path=a_path)
    def save(self, path: str | Path) -> None:
        """Write all numbers and what the controller is made of to a file (.npz) for `railjax.load_law`. Raises `InputError`."""
        save_law(self, path)

    def fault(self) -> str | None:
        """What is wrong with the parts together."""
        law = self.wraps
        if law is None or (not isinstance(law, (ForceControlled, ValveControlled)) and self.device is None):
            return (
                "a Controller wraps a law that commands a damper, as Controller(Skyhook()); of others give the device, whose "
                f"commands their force is then taken for; not {type(law).__name__}"
            )
        lacking = [name for name in self.estimator.needs if name not in self.sensors.names]
        if lacking:
            return f"the {type(self.estimator).__name__} needs the sensors {', '.join(lacking)}"
        if isinstance(law, ClippedLQR) and not self.estimator.whole:
            return "ClippedLQR feeds back all states: give the Controller a KalmanFilter.design(vehicle, speed, sensors)"
        return super().fault() or answers(law).fault()
