"""Magnetorheological dampers in the secondary suspension: modified Bouc-Wen (eqs. 12-18) and hybrid (figs. 11, sections 3-4).

Both are told by the balance logic when to act, Δy_c Δy_c' < 0, and how hard: the voltage law (18), or the current whose pressure
makes the force of eq. (11). Two versions of each (`law`): "sharp" decides every `sample_time` (s; None: at every step) and holds it;
"smooth" has no memory but the device's own, with signs of stated width, for gradients and limit cycles.
"""

import dataclasses
from dataclasses import dataclass
from typing import ClassVar, Literal

import jax
import jax.numpy as jnp

from ..base import smooth
from ..base.fields import optional, parameter, twin
from ..base.pytrees import registered
from ..base.typing import Number, Scalar
from ..model.damper import Bogies, Law, PassiveDamper, Seen
from ..model.vehicle import Vehicle
from . import bouc_wen
from .bouc_wen import BoucWen
from .hardware.hydraulics import HydraulicDamper, Pilot, active_area, damping_force, mr_force_for
from .sampling import sampled

#: times Spencer's 3 kN prototype: 5 kN at a steady 0.1 m/s and 2.25 V, as Table 2's damper; (α z_max + c_0 x') c_1/(c_0 + c_1)
#: is 1.26 kN for the prototype. The accumulator's bias k_1 x_0 cancels in a pair that is mounted face to face.
COACH_FORCE = 3.97
COACH_BOUC_WEN = bouc_wen.scaled(BoucWen(x0=0.0), force=COACH_FORCE)

#: m/s across the secondary suspension, for bounds on rates; a hunting coach reaches 0.5
LARGEST_VELOCITY = 0.5


def opposed(law: str, travel: Bogies, velocity: Bogies, travel_width: Scalar, velocity_width: Scalar) -> Bogies:
    """Balance logic's condition: 1 where Δy_c Δy_c' < 0, else 0; the smooth twin goes over within the widths (m, m/s)."""
    if law == "smooth":
        travel, velocity = smooth.smooth_sign(travel, travel_width), smooth.smooth_sign(velocity, velocity_width)
    return smooth.agreement(law, -travel, velocity)


def _size(law: str, travel: Bogies, width: Scalar) -> Bogies:
    return smooth.smooth_abs(travel, width) if law == "smooth" else jnp.abs(travel)


def _held_states(damper: "BoucWenDamper | HybridDamper") -> int:
    """The sharp law's decision and, with a sample time, its clock."""
    return 1 if damper.sample_time is None else 2


def _decided(damper: "BoucWenDamper | HybridDamper", travel: Bogies, velocity: Bogies, held: Bogies) -> list[Bogies]:
    """Whether the sharp law acts from now on, and its clock."""
    fresh = opposed(damper.law, travel, velocity, 0.0, 0.0)
    if damper.sample_time is None:
        return [fresh]
    clock, decision = sampled(held[1], damper.sample_time, fresh, held[0])
    return [decision, clock]


@registered
@dataclass(frozen=True)
class BoucWenDamper(Law):
    """MR dampers after the modified Bouc-Wen model, eqs. (12)-(17), under the voltage law (18) behind the driver's lag.

    `parameters` of one damper (default: Spencer's prototype, its force times 3.97 to be the coach's size); `voltage_gain` ε K
    in V/m, up to `voltage_limit`; `voltage` is what is applied in between (0: passive-off). Eq. (18) prints ε K |x| sgn x'; the
    coil does not feel the sign of its voltage, so the command is ε K |x|. Typical: 0.05 to 1 V/mm.

    Internal states of the sharp law: y; z and s = x - y at the start of the step; u; the decision; its clock. The loop's own rate, 2 √(A(β + γ))|x'|
    (9e3 1/s at 0.1 m/s), is no bound on dt: within a step z follows from z and s at its start in closed form (`bouc_wen.along_path`),
    so that the vehicle feels a spring. Observed order through turns about 2 at constant voltage. Any n >= 1; but 2 takes three times the time of n = 2.
    The smooth law integrates eq. (14) itself, with |x' - y'| rounded: states y, z, u; dt 0.1 ms and less.
    """

    parameters: BoucWen = COACH_BOUC_WEN
    voltage_gain: Number = parameter("V/m", "ε K", "voltage per travel", 100.0)
    voltage_limit: Number = parameter("V", "", "largest voltage", 2.25)
    voltage: Number = parameter("V", "", "voltage where balance logic does not act", 0.0)
    travel_width: Number = parameter("m", "", "smooth twin: rounding of the travel's sign", 2e-4, positive=True)
    velocity_width: Number = parameter("m/s", "", "smooth twin: rounding of the velocity's sign", 5e-3, positive=True)
    law: Literal["sharp", "smooth"] = twin()  # type: ignore[misc]
    sample_time: Number = optional("s", "", "time from decision to decision; None: at every step", positive=True, default=1e-3)

    @property
    def internal_states(self) -> int:
        """y, z, s, u, decision and its clock; or y, z, u."""
        return 4 + _held_states(self) if self.law == "sharp" else 3

    @property
    def even_states(self) -> tuple[int, ...]:
        """Indices of voltage, decision and clock, which have no side."""
        return tuple(range(3, self.internal_states)) if self.law == "sharp" else (2,)

    def command(self, travel: Bogies, decision: Bogies) -> Bogies:
        """v of eq. (18), V."""
        wanted = self.voltage + decision * self.voltage_gain * _size(self.law, travel, self.travel_width)
        return wanted - smooth.beyond(self.law, wanted, self.voltage_limit, 0.05 * self.voltage_limit)

    def force(self, vehicle: Vehicle, travel: Bogies, velocity: Bogies, internal: Bogies) -> tuple[Bogies, Bogies]:
        """Twice eq. (12), and the rates of eqs. (13)-(14) and of the driver.

        Args:
            vehicle: plays no part; all numbers are the damper's own.
            travel: Δy_c over each bogie, shape `(n, *lanes)`, m.
            velocity: Δy_c', shape `(n, *lanes)`, m/s.
            internal: shape `(states, n, *lanes)`: y, z and s in m, u in V, the decision, dimensionless, and its clock in s; by
                the smooth law y, z and u.

        Returns:
            The force of each bogie's two dampers, `(n, *lanes)`, N, positive along `velocity` when it resists; and the rates of
            `internal`.
        """
        p = self.parameters
        if self.law == "sharp":
            y, start, s, u, decision, *clock = internal
            z, _ = bouc_wen.along_path(p, start, travel - y - s)
        else:
            y, z, u = internal
            decision = opposed(self.law, travel, velocity, self.travel_width, self.velocity_width)
        y_rate = bouc_wen.y_rate(p, travel, velocity, y, z, u)
        u_rate = bouc_wen.u_rate(p, u, self.command(travel, decision))
        force = 2.0 * bouc_wen.force(p, travel, velocity, y, z, u)
        if self.law == "sharp":
            held = jnp.zeros_like(y)
            return force, jnp.stack([y_rate, held, held, u_rate, held, *[jnp.ones_like(y) for _ in clock]])
        return force, jnp.stack([y_rate, self._smooth_z_rate(velocity - y_rate, z), u_rate])

    def _smooth_z_rate(self, relative: Bogies, z: Bogies) -> Bogies:
        """Eq. (14) with √(r² + w²) for |r|: its rate is linear in r to either side, and r = r₊ - r₋, |r| = r₊ + r₋."""
        forth, back = (smooth.smooth_ramp(r, self.velocity_width) for r in (relative, -relative))
        return bouc_wen.z_rate(self.parameters, forth, z) + bouc_wen.z_rate(self.parameters, -back, z)

    def held(self, vehicle: Vehicle, travel: Bogies, velocity: Bogies, internal: Bogies, seen: Seen) -> Bogies:
        """z and s brought to this instant, and, where a sample is due, whether the damper is to act until the next.

        Args:
            vehicle: plays no part.
            travel: Δy_c over each bogie, shape `(n, *lanes)`, m.
            velocity: Δy_c', shape `(n, *lanes)`, m/s.
            internal: as `force` takes them, shape `(states, n, *lanes)`, m, V, dimensionless and s.
            seen: plays no part.

        Returns:
            The internal states as the next step begins with them, of the same shape; by the smooth law as they came.
        """
        if self.law == "smooth":
            return internal
        y, start, s, u = internal[:4]
        z, _ = bouc_wen.along_path(self.parameters, start, travel - y - s)
        return jnp.stack([y, z, travel - y, u, *_decided(self, travel, velocity, internal[4:])])

    def extremes(self, vehicle: Vehicle) -> tuple:
        """At full voltage, with the loop's steepest side; of the smooth law also the loop's own rate."""
        p, u = self.parameters, jnp.asarray(self.voltage_limit, float)
        alpha, c0, c1 = bouc_wen.by_voltage(p, u)
        steepest = p.A * (1.0 + jnp.maximum(p.gamma - p.beta, 0.0) / (p.gamma + p.beta))
        full = dataclasses.replace(p, alpha_a=alpha, c0a=c0, c1a=c1, alpha_b=0.0, c0b=0.0, c1b=0.0, A=steepest)
        found = [dataclasses.replace(self, parameters=full)]
        if self.law == "smooth":
            found.append(_Relaxation(p.n * p.A / bouc_wen.largest(p) * LARGEST_VELOCITY))
        return tuple(found)


@registered
@dataclass(frozen=True)
class _Relaxation(Law):
    """Nothing but a state that decays at a rate (1/s)."""

    rate: Number = parameter("1/s", "", "rate at which it decays")

    internal_states: ClassVar[int] = 1

    def force(self, vehicle: Vehicle, travel: Bogies, velocity: Bogies, internal: Bogies) -> tuple[Bogies, Bogies]:
        return jnp.zeros_like(velocity), -self.rate * internal


@registered
@dataclass(frozen=True)
class HybridDamper(Law):
    """The paper's MR hybrid damper (fig. 11): a hydraulic damper whose orifice is opened by a pilot piston against an MR device.

        balance logic -> current -> MR force -> pressure at which the pilot opens -> opening, eq. (9) -> force A_p Δp

    The current is the one that makes the force of eq. (11), α k_cy |Δy_c| per damper, as far as the device goes; it follows its command
    with `current_lag` (driver and coil), the pilot without. Without current (`alpha` 0, or a failed supply) spring and orifices are a passive damper:
    that is F_dmin of eq. (10). Between narrowest and widest opening the force is held by the pilot; beyond them it is the orifice's.

    `mr_force` and `mr_current`: Table 5's 406.7 N at 1.5 A; taken as proportional, without remanence. Internal states: current (A)
    and, of the sharp law, the decision and its clock.
    """

    alpha: Number = parameter("1", "α", "share of the elastic force that is balanced", 1.0)
    hydraulic: HydraulicDamper = HydraulicDamper()
    pilot: Pilot = Pilot()
    mr_force: Number = parameter("N", "", "largest force of the MR device", 406.7, positive=True)
    mr_current: Number = parameter("A", "", "current of the largest force", 1.5, positive=True)
    current_lag: Number = parameter("s", "", "time constant of driver and coil", 5e-3, positive=True)
    travel_width: Number = parameter("m", "", "smooth twin: rounding of the travel's sign", 2e-4, positive=True)
    velocity_width: Number = parameter("m/s", "", "smooth twin: rounding of the velocity's sign", 5e-3, positive=True)
    law: Literal["sharp", "smooth"] = twin()  # type: ignore[misc]
    sample_time: Number = optional("s", "", "time from decision to decision; None: at every step", positive=True, default=1e-3)

    @property
    def internal_states(self) -> int:
        """Current; decision and its clock."""
        return 1 + _held_states(self) if self.law == "sharp" else 1

    @property
    def even_states(self) -> tuple[int, ...]:
        """Indices of all states: none of them has a side."""
        return tuple(range(self.internal_states))

    def command(self, vehicle: Vehicle, travel: Bogies, decision: Bogies) -> Bogies:
        """Current that makes the wanted force α k_cy |Δy_c| of each damper, as far as the device goes, A.

        Args:
            vehicle: gives k_cy.
            travel: Δy_c over each bogie, shape `(n, *lanes)`, m.
            decision: 1 where the damper is to act, else 0, shape `(n, *lanes)`, dimensionless.
        """
        wanted = self.alpha * vehicle.secondary.stiffness_y * _size(self.law, travel, self.travel_width)
        share = mr_force_for(self.pilot, wanted / active_area(self.hydraulic)) / self.mr_force
        # between nothing and the device's largest force
        share = 0.5 + (share - 0.5) - smooth.beyond(self.law, share - 0.5, 0.5, 0.02)
        return decision * share * self.mr_current

    def pair_force(self, velocity: Bogies, current: Bogies) -> Bogies:
        """Force of a bogie's two dampers, N, at a velocity (m/s) and a current (A)."""
        mr_force = self.mr_force * current / self.mr_current
        return 2.0 * damping_force(self.hydraulic, self.pilot, velocity, mr_force, self.law)

    def force(self, vehicle: Vehicle, travel: Bogies, velocity: Bogies, internal: Bogies) -> tuple[Bogies, Bogies]:
        """Force of a bogie's two dampers, and the rate of the current.

        Args:
            vehicle: gives k_cy.
            travel: Δy_c over each bogie, shape `(n, *lanes)`, m.
            velocity: Δy_c', shape `(n, *lanes)`, m/s.
            internal: shape `(states, n, *lanes)`: the current in A; of the sharp law the decision, dimensionless, and its clock
                in s.

        Returns:
            The force, `(n, *lanes)`, N, positive along `velocity` when it resists; and the rates of `internal`.
        """
        current = internal[0]
        if self.law == "sharp":
            decision = internal[1]
        else:
            decision = opposed(self.law, travel, velocity, self.travel_width, self.velocity_width)
        rate = (self.command(vehicle, travel, decision) - current) / self.current_lag
        rates = [rate, jnp.zeros_like(rate), jnp.ones_like(rate)][: len(internal)]
        return self.pair_force(velocity, current), jnp.stack(rates)

    def held(self, vehicle: Vehicle, travel: Bogies, velocity: Bogies, internal: Bogies, seen: Seen) -> Bogies:
        """Where a sample is due, whether the damper is to act until the next.

        Args:
            vehicle: plays no part.
            travel: Δy_c over each bogie, shape `(n, *lanes)`, m.
            velocity: Δy_c', shape `(n, *lanes)`, m/s.
            internal: as `force` takes them, shape `(states, n, *lanes)`, A, dimensionless and s.
            seen: plays no part.

        Returns:
            The internal states as the next step begins with them, of the same shape; by the smooth law as they came.
        """
        if self.law == "smooth":
            return internal
        return jnp.stack([internal[0], *_decided(self, travel, velocity, internal[1:])])

    def extremes(self, vehicle: Vehicle) -> tuple[PassiveDamper, ...]:
        """The steepest part of its characteristic at full current."""
        slope = jax.vmap(jax.grad(lambda velocity: self.pair_force(velocity, self.mr_current)))
        return (PassiveDamper(0.5 * jnp.max(slope(jnp.linspace(0.0, LARGEST_VELOCITY, 501)))),)
