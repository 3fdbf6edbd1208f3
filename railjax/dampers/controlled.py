"""Semi-active control of the secondary lateral dampers: balance logic, skyhook, acceleration-driven, mixed, clipped LQR.

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

from dataclasses import dataclass, field, replace
from typing import ClassVar, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..base import smooth
from ..base.arguments import guarded
from ..base.checks import from_zero, positive
from ..base.errors import InputError
from ..base.fields import structure
from ..base.precision import require_double_precision
from ..base.typing import Number, Scalar
from ..model.damper import HARD, SOFT, Bogies, PassiveDamper, Seen
from ..model.kinematics import join, of_carbody, size
from ..model.motion import state_matrix
from ..model.vehicle import Vehicle
from .sampling import sampled

#: m; how far a secondary suspension goes (bump stops come at 25 to 65 mm), for bounds on rates
LARGEST_TRAVEL = 0.05


@dataclass(frozen=True, kw_only=True)
class Controlled:
    """What the laws share: options, internal states, lags, and the hold of the sharp version.

    A law adds what it measures (`measured`), the number that it compares with the velocity (`signal`) and what it makes
    of both (`decision`, `delivered`).
    """

    damping_min: Number = 0.0  # c_min, N s/m per damper
    sensor_lag: Number = None  # s
    actuator_lag: Number = None  # s
    sample_time: Number = 1e-3  # s; None: a decision at every step
    velocity_width: Number = 5e-3  # m/s
    signal_width: Number = 0.02  # of the signal's scale
    law: Literal["sharp", "smooth"] = structure("sharp")

    observes: ClassVar[bool] = True
    #: what counts as one of the signal
    signal_scale: ClassVar[float] = 1.0

    @property
    def states(self) -> tuple[str, ...]:
        """Internal states by name: held decision and direction of the sharp law and its clock, lagged opening, lagged measurement."""
        names = ("decision", "direction") if self.law == "sharp" else ()
        names += ("clock",) if self.law == "sharp" and self.sample_time is not None else ()
        names += () if self.actuator_lag is None else ("opening",)
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

    force_limit: Number = None

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

    damping_min: Number = SOFT
    damping_max: Number = HARD

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


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class BalanceLogic(ForceControlled):
    """Eqs. (10)-(11): the dampers balance the elastic force 2 k_cy Δy_c, times α, while it and the damping force oppose each other,
    Δy_c Δy_c' < 0; otherwise they give the least damping, F_dmin = 2 c_min Δy_c' (0 in eq. 11).

    Reading 2: the paper's prose says the opposite of its equations (the damper would act while the car body moves away); the
    equations are the ones that make sense and are implemented. In semi-active runs this replaces rho_cy (C' has none).
    Signal: -Δy_c, m. Sensible: α 0.2 to 1.
    """

    alpha: Number = 1.0  # α, dimensionless
    signal_scale: ClassVar[float] = 0.01
    largest_signal: ClassVar[float] = LARGEST_TRAVEL

    def measured(self, vehicle: Vehicle, travel: Bogies, seen: Seen) -> Bogies:
        """-Δy_c, along which the balancing force acts.

        Args:
            vehicle: plays no part.
            travel: Δy_c over each bogie, shape `(n, *lanes)`, m.
            seen: plays no part.

        Returns:
            -Δy_c, `(n, *lanes)`, m.
        """
        return -travel

    def gain(self, vehicle: Vehicle) -> Scalar:
        """2 α k_cy, N/m."""
        return 2.0 * self.alpha * vehicle.secondary.stiffness_y


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Skyhook(ValveControlled):
    """Skyhook (Karnopp, Crosby, Harwood 1974): as if a damper tied the car body to the sky, where that takes out energy.

    With `damping` None on/off: c_max while the car body's lateral velocity v_c (above the dampers) and Δy_c' have the same sign,
    else c_min. With `damping` c_sky (N s/m per damper) continuous: F = 2 c_sky v_c within what the valve can do,
    c = c_sky v_c/Δy_c' between c_min and c_max. Signal: v_c, m/s.
    """

    damping: Number = None
    signal_width: Number = 0.002  # of the signal's scale
    signal_scale: ClassVar[float] = 0.1

    def measured(self, vehicle: Vehicle, travel: Bogies, seen: Seen) -> Bogies:
        """v_c = y_c' + h φ_c' ± l ψ_c', at the dampers' upper ends.

        Args:
            vehicle: gives the places of the dampers.
            travel: Δy_c over each bogie, shape `(n, *lanes)`, m; plays no part.
            seen: all coordinates and rates, of which the car body's rates are read.

        Returns:
            v_c, `(n, *lanes)`, m/s.
        """
        return of_carbody(vehicle, seen.rates)

    def decision(self, signal: Bogies, velocity: Bogies) -> Bogies:
        """How far the valve is shut."""
        if self.damping is None:
            return super().decision(signal, velocity)
        span = self.damping_max - self.damping_min
        least = self.velocity_width**2 if self.law == "smooth" else smooth.TINY
        wanted = (self.damping * signal * velocity / (velocity**2 + least) - self.damping_min) / span
        if self.law == "sharp":
            return jnp.clip(wanted, 0.0, 1.0)
        width = self.signal_width
        return smooth.smooth_ramp(wanted, width) - smooth.smooth_ramp(wanted - 1.0, width)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ADD(ValveControlled):
    """Acceleration-driven damping (Savaresi, Silani, Bittanti 2005): c_max while the car body's lateral acceleration a_c and Δy_c'
    have the same sign, else c_min. Good above the car body's own frequencies, where skyhook is good below.

    Against a motion faster than its sample time the sharp law goes to and fro from sample to sample; its smooth twin slides between valve
    open and shut instead and gives 10 to 30 % less force (mixed SH-ADD likewise), however narrow its widths. Report with the sharp law.

    The accelerometer's lag is part of the law: a_c is measured as (v_c - its lagged value)/τ, the acceleration through a
    first-order low-pass. Signal: a_c, m/s^2.
    """

    sensor_lag: Number = 5e-3
    signal_scale: ClassVar[float] = 1.0

    def measured(self, vehicle: Vehicle, travel: Bogies, seen: Seen) -> Bogies:
        """v_c at the dampers' upper ends, of which the accelerometer makes a_c.

        Args:
            vehicle: gives the places of the dampers.
            travel: Δy_c over each bogie, shape `(n, *lanes)`, m; plays no part.
            seen: all coordinates and rates, of which the car body's rates are read.

        Returns:
            v_c, `(n, *lanes)`, m/s.
        """
        return of_carbody(vehicle, seen.rates)

    def fault(self) -> str | None:
        """What is wrong where the accelerometer has no lag."""
        if self.sensor_lag is None:
            return f"{type(self).__name__} needs a sensor_lag: the low-pass of its accelerometer, 5e-3 s for example"
        return super().fault()

    def signal(self, measured: Bogies, sensed: Bogies | None) -> Bogies:
        """a_c as the accelerometer gives it, m/s^2."""
        if sensed is None:
            raise InputError(self.fault())
        return (measured - sensed) / self.sensor_lag


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class MixedSkyhookADD(ADD):
    """Mixed SH-ADD (Savaresi, Spelta 2007): skyhook where |a_c| <= ω |v_c|, acceleration-driven where it is larger.

    `crossover` ω in rad/s parts slow from fast motion: near the car body's own lateral frequency, 1 Hz. Signal: ω v_c or a_c,
    m/s^2; the smooth version goes from one to the other within `signal_width` of a_c² - ω² v_c².
    """

    crossover: Number = 2.0 * np.pi * 1.5

    def signal(self, measured: Bogies, sensed: Bogies | None) -> Bogies:
        """ω v_c where motion is slow, a_c where it is fast."""
        acceleration, velocity = super().signal(measured, sensed), self.crossover * measured
        excess = acceleration**2 - velocity**2
        if self.law == "sharp":
            return jnp.where(excess <= 0.0, velocity, acceleration)
        fast = 0.5 * (1.0 + smooth.smooth_sign(excess, self.signal_width))
        return (1.0 - fast) * velocity + fast * acceleration


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ClippedLQR(ForceControlled):
    """Clipped optimal control: the force of a linear quadratic regulator with all states known, where dampers can give it.

    Made with `ClippedLQR.design(vehicle, speed)`; `feedback` (n, 2N) is its gain, D = K [q, q'] per bogie's pair, N; with yaw dampers in
    series (n, 2N + n), as their elongations count. It belongs to that vehicle; at other speeds it is no longer optimal. What full knowledge could buy, not something to be built:
    a train does not measure its wheelsets' lateral positions. Signal: D, N.
    """

    feedback: Number = field(default=None, metadata={"axes": 2})
    force_limit: Number = 5e3  # N per damper
    signal_scale: ClassVar[float] = 1e3

    @classmethod
    @guarded(speed=positive("m/s"), travel_weight=from_zero("1/s²"), force_weight=positive("m/s² per kN"))
    def design(
        cls, vehicle: Vehicle, speed: float, travel_weight: float = 10.0, force_weight: float = 0.05, **options: Number
    ) -> "ClippedLQR":
        """The regulator of least ∫ a_1² + a_2² + (w_t Δy_1)² + (w_t Δy_2)² + (w_f F_1)² + (w_f F_2)² dt.

        a_j is the car body's lateral acceleration above bogie j (m/s^2), Δy_j its secondary travel, F_j in kN. Straight running
        with linear creep, the dampers taken out; by SciPy's `solve_continuous_are`.

        Args:
            vehicle: a single vehicle, to which the regulator then belongs.
            speed: v, m/s.
            travel_weight: w_t, 1/s².
            force_weight: w_f, m/s² per kN.
            **options: the other fields of `ClippedLQR`, such as `force_limit` in N per damper.

        Raises:
            InputError: where there is no regulator, for weights out of range, and in single precision.
        """
        import scipy.linalg

        require_double_precision("ClippedLQR.design")
        n, bogies = size(vehicle), len(vehicle.geometry.bogie_pattern)
        whole = np.asarray(state_matrix(vehicle, speed, _Actuator()))
        # the actuators' states stand before those of the yaw dampers
        inputs, rates = np.arange(2 * n, 2 * n + bogies), slice(n, 2 * n)
        plant = np.delete(whole, inputs, axis=0)
        a, b = np.delete(plant, inputs, axis=1), plant[:, inputs]
        travel, above = (np.asarray(rows) for rows in _outputs(vehicle, n))
        acceleration, direct = above @ a[rates], above @ b[rates]
        state = np.vstack([acceleration, np.hstack([travel_weight * travel, np.zeros((bogies, len(a) - n))])])
        through = np.vstack([direct, np.zeros((bogies, bogies))])
        try:
            cost = scipy.linalg.solve_continuous_are(
                a, b, state.T @ state, through.T @ through + force_weight**2 * np.eye(bogies), s=state.T @ through
            )
        except np.linalg.LinAlgError as error:
            raise InputError(f"no regulator at {speed * 3.6:g} km/h with force_weight {force_weight:g}: {error}") from None
        gain = np.linalg.solve(through.T @ through + force_weight**2 * np.eye(bogies), b.T @ cost + through.T @ state)
        # u = -K x in kN; the damper's force is D
        return cls(feedback=-1e3 * gain, **options)

    def fault(self) -> str | None:
        """What is wrong where there is no gain."""
        return "ClippedLQR has no feedback; make it with ClippedLQR.design(vehicle, speed)" if self.feedback is None else None

    def measured(self, vehicle: Vehicle, travel: Bogies, seen: Seen) -> Bogies:
        """D = K x, the force that the regulator wants.

        Args:
            vehicle: tells the order of the coordinates.
            travel: Δy_c over each bogie, shape `(n, *lanes)`, m; plays no part, as it is in x.
            seen: all coordinates, rates and states of yaw dampers, which together are x.

        Returns:
            D of each bogie's pair of dampers, `(n, *lanes)`, N.
        """
        own = [] if seen.yaw_dampers is None else [*seen.yaw_dampers]
        x = jnp.concatenate(join(vehicle, seen.coordinates) + join(vehicle, seen.rates) + own)
        feedback = jnp.asarray(self.feedback)
        # lanes of its own on the last axis, or none
        return jnp.sum(feedback.reshape(feedback.shape + (1,) * (x.ndim + 1 - feedback.ndim)) * x, axis=1)

    def gain(self, vehicle: Vehicle) -> Scalar:
        """1: the signal is the force, N."""
        return 1.0

    @property
    def largest_signal(self) -> Scalar:
        """Unlimited forces are bounded as if they were 20 kN."""
        return 20e3


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class _Actuator:
    """Forces from outside, kN per bogie: their columns of the state matrix are B of x' = A x + B u."""

    internal_states: ClassVar[int] = 1

    def force(self, vehicle: Vehicle, travel: Bogies, velocity: Bogies, internal: Bogies) -> tuple[Bogies, Bogies]:
        return 1e3 * internal[0], jnp.zeros_like(internal)


def _outputs(vehicle: Vehicle, n: int) -> tuple[Float[Array, "bogies n"], Float[Array, "bogies n"]]:
    """Rows that make of q the damper's travel and the car body's displacement above it, per bogie."""
    from ..model.kinematics import damper_point, deflections, split

    unit = split(vehicle, jnp.eye(n))
    travel = deflections(vehicle, unit)
    return travel[damper_point(travel)], of_carbody(vehicle, unit)


def smoothed(damper: Controlled) -> Controlled:
    """The damper's smooth version, for gradients and limit cycles."""
    return replace(damper, law="smooth")
