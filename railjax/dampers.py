"""Lateral dampers of the secondary suspension: what takes the place of rho_cy in eq. (6).

A damper is a pytree with two things, and needs no base class:

* `internal_states`: how many states of its own it carries per bogie (0 for a memoryless law);
* `force(vehicle, travel, velocity, internal)`: the law itself, a pure function. `travel` and `velocity` are Δy_c and Δy_c' of
  eqs. (7)-(8), at the damper's own heights where `vehicle.lateral_damper` gives them, shape (n, *lanes), `internal` is (states, n, *lanes). Returns the force of one bogie's dampers in N, positive
  along `velocity` when it resists, and the rate of the internal states.
"""

from dataclasses import dataclass
from typing import ClassVar, Protocol, runtime_checkable

import jax
from jaxtyping import Array, Float

from .elements import blow_off_force
from .typing import Number
from .vehicle import Vehicle

Bogies = Float[Array, "..."]


@runtime_checkable
class Damper(Protocol):
    """What `simulate` asks of a damper."""

    internal_states: ClassVar[int]

    def force(self, vehicle: Vehicle, travel: Bogies, velocity: Bogies, internal: Bogies) -> tuple[Bogies, Bogies]:
        """Force of one bogie's dampers, N, and the rate of their internal states."""
        ...


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class PassiveDamper:
    """The vehicle's own dampers, rho_cy with its blow-off if it has one; or linear ones of `damping` (N s/m per side)."""

    damping: Number = None

    internal_states: ClassVar[int] = 0

    def force(self, vehicle: Vehicle, travel: Bogies, velocity: Bogies, internal: Bogies) -> tuple[Bogies, Bogies]:
        """F_d = 2 rho_cy Δy_c' (eq. 1's dissipation function), up to blow-off."""
        damping = vehicle.secondary.damping_y if self.damping is None else self.damping
        if self.damping is None and vehicle.lateral_damper is not None:
            return 2.0 * blow_off_force(vehicle.contact.law, vehicle.lateral_damper, damping, velocity), internal
        return 2.0 * damping * velocity, internal
