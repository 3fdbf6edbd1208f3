"""Semi-active control of the secondary lateral dampers: what balance logic, skyhook, acceleration-driven, mixed and clipped LQR share.

All laws are of one of two kinds, per bogie's pair of dampers (hence the factors 2), with v = Δy_c' and a measured signal s:

    force-controlled   F = g |D(s)| sgn v + (1 - g) 2 c_min v     the damper is set to the force D where that resists: g = [D v > 0]
    valve-controlled   F = 2 (c_min + (c_max - c_min) g) v        its valve is shut by g, 0 to 1

so that F v >= 0 for every g in [0, 1]: whatever the controller does, energy is only taken out. Two versions of each (`law`):

* "sharp": the controller decides every `sample_time` (1 ms; None: at every step) and holds g until the next, as sampled hardware does
  (`railjax.dampers.sampling`), so that the result does not depend on a dt that divides the sample time: ADD and mixed SH-ADD would chatter
  at the step instead. sgn v, the damper's own, is held over a step: late by less than one where v turns. Observed order 1 in dt.
* "smooth": no memory; sgn x is x/√(x² + w²) with the widths `velocity_width` and `signal_width` (in units of the signal, see each law's
  `signal_scale`), g = (1 + sgn D sgn v)/2. Order 4. For gradients and limit cycles; over a 5 mm sinusoid within 1 % of the sharp law
  (skyhook), 5 % (balance logic, LQR), but see `ADD`.

Sensor and actuator are first-order lags (`sensor_lag`, `actuator_lag` in s; None: ideal), internal states of their own. Not delays
of whole steps, because those change with dt and neither the state matrix nor a limit cycle would see them.
"""

from dataclasses import dataclass
from typing import ClassVar, Literal

import jax.numpy as jnp
import numpy as np

from ..base import smooth
from ..base.fields import optional, parameter, twin
from ..base.typing import Number
from ..model.damper import HARD, SOFT, Bogies, Law, PassiveDamper, Seen
from ..model.vehicle import Vehicle
from .sampling import sampled

#: m; how far a secondary suspension goes (bump stops come at 25 to 65 mm), for bounds on rates
LARGEST_TRAVEL = 0.05


@dataclass(frozen=True, kw_only=True)
class Controlled(Law):
    """What the laws share: options, internal states, lags, and the hold of the sharp version.

    A law adds what it measures (`measured`), the number that it compares with the velocity (`signal`) and what it makes
    of both (`decision`, `delivered`).
    """

    damping_min: Number = parameter("N s/m", "c_min", "least damping per damper", 0.0)
    sensor_lag: Number = optional("s", "τ", "time constant of the sensor; left out: ideal", positive=True)
    actuator_lag: Number = optional("s", "", "time constant of the actuator; left out: ideal", positive=True)
    sample_time: Number = optional("s", "", "time from decision to decision; None: at every step", positive=True, default=1e-3)
    velocity_width: Number = parameter("m/s", "", "smooth twin: rounding of the velocity's sign", 5e-3, positive=True)
    signal_width: Number = parameter("1", "", "smooth twin: rounding of the signal's sign, of its scale", 0.02, positive=True)
    law: Literal["sharp", "smooth"] = twin()  # type: ignore[misc]

    observes: ClassVar[bool] = True
    #: what counts as one of the signal
    signal_scale: ClassVar[float] = 1.0

    @property
    def mean_over(self) -> Number | None:
        """Time constant (s) of the mean that is taken off the measurement; None: none is."""
        return None

    @property
    def states(self) -> tuple[str, ...]:
        """Internal states by name: held decision and direction of the sharp law and its clock, lagged opening, mean and lag of the measurement."""
        names: tuple[str, ...] = ("decision", "direction") if self.law == "sharp" else ()
        names += ("clock",) if self.law == "sharp" and self.sample_time is not None else ()
        names += () if self.actuator_lag is None else ("opening",)
        names += () if self.mean_over is None else ("mean",)
        return names if self.sensor_lag is None else (*names, "sensed")

    @property
    def internal_states(self) -> int:
        """How many states of its own the law has per bogie."""
        return len(self.states)

    @property
    def even_states(self) -> tuple[int, ...]:
        """Indices of the states without a side."""
        return tuple(k for k, name in enumerate(self.states) if name in ("decision", "clock", "opening"))

    def signal(self, measured: Bogies, sensed: Bogies | None) -> Bogies:
        """What is compared with the velocity, from the measurement and its lagged value."""
        return measured if sensed is None else sensed

    def decision(self, signal: Bogies, velocity: Bogies) -> Bogies:
        """g = [s v > 0]."""
        return smooth.agreement(self.law, self._sign(signal), self._direction(velocity))

    def _sign(self, signal: Bogies) -> Bogies:
        width = self.signal_width * self.signal_scale
        return smooth.smooth_sign(signal, width) if self.law == "smooth" else jnp.sign(signal)

    def _direction(self, velocity: Bogies) -> Bogies:
        return smooth.smooth_sign(velocity, self.velocity_width) if self.law == "smooth" else jnp.sign(velocity)

    def _seen(self, vehicle: Vehicle, travel: Bogies, internal: Bogies, seen: Seen) -> tuple[dict, Bogies, Bogies]:
        """Internal states by name, the measurement and the signal."""
        state = dict(zip(self.states, internal, strict=True))
        measured = self.measured(vehicle, travel, seen)
        measured = measured - state["mean"] if "mean" in state else measured
        return state, measured, self.signal(measured, state.get("sensed"))

    def force(self, vehicle: Vehicle, travel: Bogies, velocity: Bogies, internal: Bogies, seen: Seen) -> tuple[Bogies, Bogies]:
        """Force of a bogie's two dampers, N, and the rate of the internal states."""
        state, measured, signal = self._seen(vehicle, travel, internal, seen)
        decision = state["decision"] if "decision" in state else self.decision(signal, velocity)
        direction = state["direction"] if "direction" in state else self._direction(velocity)
        rates = {"clock": jnp.ones_like(velocity)}
        if "opening" in state:
            rates["opening"] = (decision - state["opening"]) / self.actuator_lag
        if "sensed" in state:
            rates["sensed"] = (measured - state["sensed"]) / self.sensor_lag
        if self.mean_over is not None:
            rates["mean"] = measured / self.mean_over
        zero = jnp.zeros_like(velocity)
        rate = jnp.stack([rates.get(name, zero) for name in self.states]) if self.states else internal
        return self.delivered(vehicle, signal, velocity, state.get("opening", decision), direction), rate

    def held(self, vehicle: Vehicle, travel: Bogies, velocity: Bogies, internal: Bogies, seen: Seen) -> Bogies:
        """The decision of this instant where a sample is due, and the direction, for the step that follows."""
        if self.law == "smooth":
            return internal
        state, _, signal = self._seen(vehicle, travel, internal, seen)
        state["direction"], fresh = self._direction(velocity), self.decision(signal, velocity)
        if "clock" in state:
            state["clock"], fresh = sampled(state["clock"], self.sample_time, fresh, state["decision"])
        state["decision"] = fresh
        return jnp.stack([state[name] for name in self.states]).astype(internal.dtype)


@dataclass(frozen=True, kw_only=True)
class ForceControlled(Controlled):
    """Laws that set a force up to `force_limit` (N per damper, None: unlimited); their signal is what the force is set to."""

    force_limit: Number = optional("N", "", "largest force per damper; left out: unlimited")

    def demand(self, vehicle: Vehicle, signal: Bogies) -> Bogies:
        """|D| of a bogie's pair, N, from the signal."""
        size = smooth.smooth_abs(signal, self.signal_width * self.signal_scale) if self.law == "smooth" else jnp.abs(signal)
        force = self.gain(vehicle) * size
        if self.force_limit is None:
            return force
        limit = 2.0 * self.force_limit
        return force - smooth.beyond(self.law, force, limit, 0.05 * limit)

    def delivered(self, vehicle: Vehicle, signal: Bogies, velocity: Bogies, opening: Bogies, direction: Bogies) -> Bogies:
        """F = g |D| sgn v + (1 - g) 2 c_min v."""
        return opening * self.demand(vehicle, signal) * direction + (1.0 - opening) * (2.0 * self.damping_min * velocity)

    def extremes(self, vehicle: Vehicle) -> tuple[PassiveDamper, ...]:
        """The smooth law is steepest at v = 0, where it is a damper of |D|/w_v."""
        if self.law == "sharp":
            return (PassiveDamper(self.damping_min),)
        largest = self.gain(vehicle) * self.largest_signal
        largest = largest if self.force_limit is None else jnp.minimum(largest, 2.0 * self.force_limit)
        return (PassiveDamper(0.5 * largest / self.velocity_width),)


@dataclass(frozen=True, kw_only=True)
class ValveControlled(Controlled):
    """Laws that set a damping between c_min and `damping_max` c_max (N s/m per damper)."""

    damping_min: Number = parameter("N s/m", "c_min", "damping per damper with the valve open", SOFT)
    damping_max: Number = parameter("N s/m", "c_max", "damping per damper with the valve shut", HARD)

    def delivered(self, vehicle: Vehicle, signal: Bogies, velocity: Bogies, opening: Bogies, direction: Bogies) -> Bogies:
        """F = 2 (c_min + (c_max - c_min) g) v."""
        return 2.0 * (self.damping_min + (self.damping_max - self.damping_min) * opening) * velocity

    def fault(self) -> str | None:
        """What is wrong with a valve that damps less shut than open."""
        if np.any(np.asarray(self.damping_min) >= self.damping_max):
            return f"damping_min ({self.damping_min}) must be below damping_max ({self.damping_max})"
        return None

    def extremes(self, vehicle: Vehicle) -> tuple[PassiveDamper, ...]:
        """The damper with its valve shut bounds the rates."""
        return (PassiveDamper(self.damping_max),)
