"""Skyhook, acceleration-driven damping, and what mixes the two: valves told by the motion of the car body."""

from dataclasses import dataclass
from typing import ClassVar

import jax.numpy as jnp
import numpy as np

from ..base import smooth
from ..base.errors import InputError
from ..base.fields import optional, parameter
from ..base.pytrees import registered
from ..base.typing import Number
from ..model.damper import HARD, Bogies, Seen
from ..model.kinematics import of_carbody
from ..model.vehicle import Vehicle
from .controlled import ValveControlled


@registered
@dataclass(frozen=True)
class Skyhook(ValveControlled):
    """Skyhook (Karnopp, Crosby, Harwood 1974): as if a damper tied the car body to the sky, where that takes out energy.

    With `damping` None on/off: c_max while the car body's lateral velocity v_c (above the dampers) and Δy_c' have the same sign,
    else c_min. With `damping` c_sky (N s/m per damper) continuous: F = 2 c_sky v_c within what the valve can do,
    c = c_sky v_c/Δy_c' between c_min and c_max. Signal: v_c, m/s.
    """

    damping: Number = optional("N s/m", "c_sky", "damping per damper of the continuous law; left out: on/off")
    signal_width: Number = parameter("1", "", "smooth twin: rounding of the signal's sign, of its scale", 0.002, positive=True)
    signal_scale: ClassVar[float] = 0.1

    @classmethod
    def continuous(cls) -> "Skyhook":
        """With c_sky that of the valve shut."""
        return cls(damping=HARD)

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


@registered
@dataclass(frozen=True)
class ADD(ValveControlled):
    """Acceleration-driven damping (Savaresi, Silani, Bittanti 2005): c_max while the car body's lateral acceleration a_c and Δy_c'
    have the same sign, else c_min. Good above the car body's own frequencies, where skyhook is good below.

    Against a motion faster than its sample time the sharp law goes to and fro from sample to sample; its smooth twin slides between valve
    open and shut instead and gives 10 to 30 % less force (mixed SH-ADD likewise), however narrow its widths. Report with the sharp law.

    The accelerometer's lag is part of the law: a_c is measured as (v_c - its lagged value)/τ, the acceleration through a
    first-order low-pass. Signal: a_c, m/s^2.
    """

    sensor_lag: Number = optional("s", "τ", "time constant of the accelerometer", positive=True, default=5e-3)
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


@registered
@dataclass(frozen=True)
class MixedSkyhookADD(ADD):
    """Mixed SH-ADD (Savaresi, Spelta 2007): skyhook where |a_c| <= ω |v_c|, acceleration-driven where it is larger.

    `crossover` ω in rad/s parts slow from fast motion: near the car body's own lateral frequency, 1 Hz. Signal: ω v_c or a_c,
    m/s^2; the smooth version goes from one to the other within `signal_width` of a_c² - ω² v_c².
    """

    crossover: Number = parameter("rad/s", "ω", "frequency that parts slow from fast motion", 2.0 * np.pi * 1.5)

    def signal(self, measured: Bogies, sensed: Bogies | None) -> Bogies:
        """ω v_c where motion is slow, a_c where it is fast."""
        acceleration, velocity = super().signal(measured, sensed), self.crossover * measured
        excess = acceleration**2 - velocity**2
        if self.law == "sharp":
            return jnp.where(excess <= 0.0, velocity, acceleration)
        fast = 0.5 * (1.0 + smooth.smooth_sign(excess, self.signal_width))
        return (1.0 - fast) * velocity + fast * acceleration
