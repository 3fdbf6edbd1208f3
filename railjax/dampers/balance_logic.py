"""Balance logic, the paper's own law: the dampers balance the elastic force while it and the damping force oppose each other."""

from dataclasses import dataclass
from typing import ClassVar

import jax.numpy as jnp

from ..base.fields import optional, parameter
from ..base.pytrees import registered
from ..base.typing import Number, Scalar
from ..model.damper import Bogies, EquivalentDamper, Seen
from ..model.vehicle import Vehicle
from .controlled import LARGEST_TRAVEL, ForceControlled


@registered
@dataclass(frozen=True)
class BalanceLogic(ForceControlled):
    """Eqs. (10)-(11): the dampers balance the elastic force 2 k_cy Δy_c, times α, while it and the damping force oppose each other,
    Δy_c Δy_c' < 0; otherwise they give the least damping, F_dmin = 2 c_min Δy_c' (0 in eq. 11).

    Reading 2: the paper's prose says the opposite of its equations (the damper would act while the car body moves away); the
    equations are the ones that make sense and are implemented. In semi-active runs this replaces rho_cy (C' has none).
    Signal: -Δy_c, m. Sensible: α 0.2 to 1.

    In a curve the suspension stands deflected, and the law as it is, which takes that for vibration, pushes the car body further out with
    every motion back. With `centring` it balances Δy_c less its mean over that time, a first-order high-pass with a state of its own: on
    straight track next to the same, in an arc the same again once it has been there for three times as long. Sensible: 2 to 4 s
    (benchmarks/semiactive_curve.py).
    """

    alpha: Number = parameter("1", "α", "share of the elastic force that is balanced", 1.0)
    centring: Number = optional("s", "τ_c", "time constant of the mean travel, which is taken off; left out: none", positive=True)
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

    @property
    def mean_over(self) -> Number | None:
        """`centring`, s."""
        return self.centring

    def gain(self, vehicle: Vehicle) -> Scalar:
        """2 α k_cy, N/m."""
        return 2.0 * self.alpha * vehicle.secondary.stiffness_y

    @property
    def memoryless(self) -> bool:
        """Without lags and mean: the sharp law's held decision is that of the instant."""
        return self.sensor_lag is None and self.actuator_lag is None and self.centring is None

    def describing(self, vehicle: Vehicle, omega: Scalar) -> EquivalentDamper | None:
        """Its describing function at ω = `omega` (rad/s), which holds for every amplitude, as the law is homogeneous without lags and limit: for
        Δy_c = X sin ωt per bogie k = 2 c_min ω/π - α k_cy and c = c_min + 2 α k_cy/(π ω)."""
        if not self.memoryless or self.force_limit is not None:
            return None
        elastic, least = self.alpha * vehicle.secondary.stiffness_y, self.damping_min
        # the least damping acts in the other two quarters of the cycle, where Δy_c and Δy_c' have the same sign
        return EquivalentDamper(2.0 * least * omega / jnp.pi - elastic, least + 2.0 * elastic / (jnp.pi * omega))
