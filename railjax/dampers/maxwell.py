"""A damper whose ends give way: dashpots in series with a stiffness."""

from dataclasses import dataclass
from typing import ClassVar, Literal

from ..base.fields import optional, parameter, twin
from ..base.pytrees import registered
from ..base.typing import Number
from ..model.damper import Bogies, Law
from ..model.suspension import yaw_damper_force
from ..model.vehicle import Vehicle, YawDamper


@registered
@dataclass(frozen=True)
class MaxwellDamper(Law):
    """Dashpots of `damping` c in series with a stiffness k (rubber ends, oil), both per side; blow-off as the yaw dampers'.

    One internal state, the dashpot's elongation s: F = 2 k (Δy_c - s), s' = v(k (Δy_c - s)). Typical: k 3 to 10 MN/m. The corners
    of the blow-off are sharp or rounded within `blow_off_width` as `law` says.
    """

    damping: Number = parameter("N s/m", "c", "damping per side, up to blow-off", 25e3)
    series_stiffness: Number = parameter("N/m", "k", "stiffness in series, per side", 5e6, positive=True)
    blow_off_velocity: Number = optional("m/s", "v_0", "velocity at which it blows off")
    damping_beyond: Number = optional("N s/m", "c_b", "damping per side beyond blow-off", positive=True)
    blow_off_width: Number = parameter("m/s", "", "smooth twin: rounding of the blow-off's corners", 1e-3, positive=True)
    law: Literal["sharp", "smooth"] = twin()  # type: ignore[misc]

    internal_states: ClassVar[int] = 1

    def force(self, vehicle: Vehicle, travel: Bogies, velocity: Bogies, internal: Bogies) -> tuple[Bogies, Bogies]:
        """The yaw dampers' Maxwell element, across the secondary suspension: F = 2 k (Δy_c - s).

        Args:
            vehicle: plays no part; all numbers are the damper's own.
            travel: Δy_c over each bogie, shape `(n, *lanes)`, m.
            velocity: Δy_c', shape `(n, *lanes)`, m/s; plays no part beside the stiffness.
            internal: elongation s of the dashpots, shape `(1, n, *lanes)`, m.

        Returns:
            The force of each bogie's two dampers, `(n, *lanes)`, N, positive along Δy_c' when it resists; and s',
            `(1, n, *lanes)`, m/s.
        """
        element = YawDamper(
            self.damping, 1.0, self.blow_off_velocity, self.damping_beyond, self.series_stiffness, self.blow_off_width
        )
        return yaw_damper_force(self.law, element, travel, velocity, internal)

    def fault(self) -> str | None:
        """A valve that is half described."""
        if (self.blow_off_velocity is None) != (self.damping_beyond is None):
            return "blow_off_velocity and damping_beyond belong together; give both or none"
        return None

    def extremes(self, vehicle: Vehicle) -> tuple["MaxwellDamper", ...]:
        """Beyond blow-off the dashpot yields at the rate k/c_b."""
        if self.blow_off_velocity is None:
            return ()
        return (MaxwellDamper(self.damping_beyond, self.series_stiffness),)
