"""Lateral dampers of the secondary suspension: what takes the place of rho_cy in eq. (6); the passive ones.

A damper is a pytree with two things, and needs no base class; a law of one's own is written the same way (`Damper`):

* `internal_states`: how many states of its own it carries per bogie (0 for a memoryless law);
* `force(vehicle, travel, velocity, internal)`: the law itself, a pure function. `travel` and `velocity` are Δy_c and Δy_c' of
  eqs. (7)-(8), at the damper's own heights where `vehicle.lateral_damper` gives them, shape (n, *lanes), `internal` is (states, n, *lanes). Returns the force of one bogie's dampers in N, positive
  along `velocity` when it resists, and the rate of the internal states.

It may have more, where the law needs it:

* `observes = True`: `force` takes a fifth argument, a `Seen`, for a controller that looks further than the damper's travel;
* `held(vehicle, travel, velocity, internal, seen)`: the internal states as they go into the next step of a run. A sampled controller
  decides here and keeps its decision, an internal state of rate zero, through the four stages of RK4: a decision made within
  a stage would destroy the order. It is called at the start and after every step, and must not change what it gave itself;
  `railjax.dampers.sampling` holds a decision over a sample time of the controller's own;
* `extremes(vehicle)`: laws, linear at rest, that bound the rates of its motion where its own linearisation at rest does not;
* `fault()`: what is wrong with its numbers together, as the end of a message, or None; single ones are checked without it;
* `even_states`: indices of the internal states that have no side (a valve's opening, not a force), for limit cycles.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Literal, NamedTuple, Protocol, runtime_checkable

import jax
import numpy as np
from jaxtyping import Array, Float

from ..base.arguments import ARGUMENTS
from ..base.checks import shown, traced
from ..base.errors import InputError
from ..base.fields import structure
from ..base.typing import Number
from .kinematics import Groups
from .suspension import blow_off_force, yaw_damper_force
from .vehicle import Vehicle, YawDamper

Bogies = Float[Array, "..."]

#: N s/m per damper. Table 2's damper (5 kN at 0.1 m/s) with its control valve shut, and open: 3 of 30.31 bar (section 4)
HARD, SOFT = 50e3, 50e3 * 3.0 / 30.31


class Seen(NamedTuple):
    """What a controller may look at: all coordinates q, their rates q', and the states that series yaw dampers have of their own."""

    coordinates: Groups  # m, rad
    rates: Groups  # m/s, rad/s
    yaw_dampers: Float[Array, "s n *lanes"] | None = None  # elongation of their dashpots, m


@runtime_checkable
class Damper(Protocol):
    """What `simulate`, `hunting_branch`, `sweep`, `tune` and the rest ask of a damper: a frozen dataclass that is registered as a
    pytree, with these two. What a law may have beyond them stands at the head of `railjax.model.damper`.

    >>> @jax.tree_util.register_dataclass
    ... @dataclass(frozen=True)
    ... class OrificeDamper:
    ...     leakage: float = 5e3  # N s/m
    ...     orifice: float = 300e3  # N s^2/m^2
    ...     internal_states: ClassVar[int] = 0
    ...
    ...     def force(self, vehicle, travel, velocity, internal):
    ...         return 2.0 * (self.leakage + self.orifice * abs(velocity)) * velocity, internal

    Its numbers are then "damper.leakage" and "damper.orifice" in sweeps and tuning; gradients are exact if the law is made of
    `jax.numpy` and differentiable.
    """

    @property
    def internal_states(self) -> int:
        """States of its own per bogie: k."""
        ...

    @property
    def force(self) -> Callable[..., tuple[Bogies, Bogies]]:
        """(vehicle, travel (n, *lanes) m, velocity (n, *lanes) m/s, internal (k, n, *lanes)) to the force of one bogie's dampers,
        (n, *lanes) N, and the rate of their internal states, (k, n, *lanes) per s."""
        ...


def law_of(damper: Damper, seen: Seen) -> Callable[[Vehicle, Bogies, Bogies, Bogies], tuple[Bogies, Bogies]]:
    """The damper's `force` at this instant, with what it observes."""
    if getattr(damper, "observes", False):
        return lambda *local: damper.force(*local, seen)
    return damper.force


def damper_extremes(vehicle: Vehicle, damper: Damper) -> list[Damper]:
    """The damper and the laws that bound its rates away from rest."""
    return [damper, *(damper.extremes(vehicle) if hasattr(damper, "extremes") else ())]


def check_damper(damper: object) -> None:
    """Refuse what is no damper, numbers that are not finite or have the wrong sign, where they are known, and a law that is not there."""
    kind = damper.__name__ if isinstance(damper, type) else type(damper).__name__
    if isinstance(damper, type) or not isinstance(damper, Damper):
        wanted = f"an object, {kind}()" if isinstance(damper, type) else "an object with internal_states and force(...)"
        raise InputError(f"damper must be {wanted}, not {damper!r}; railjax.Damper says how to write one")
    if jax.tree_util.all_leaves([damper]):
        raise InputError(f"damper: {kind} is no pytree; decorate it with @jax.tree_util.register_dataclass")
    if not dataclasses.is_dataclass(damper):
        return
    for field in dataclasses.fields(damper):
        key, value = f"damper.{field.name}", getattr(damper, field.name)
        if field.name == "law" and value not in ("sharp", "smooth"):
            raise InputError(f"{key} must be 'sharp' or 'smooth', not {value!r}")
        leaves = [] if field.metadata.get("static") else jax.tree.leaves(value)
        if isinstance(value, (list, dict)) and not leaves:
            raise InputError(f"{key} must be a number, not {shown(value)}")
        # NumPy, because under `jit` even constants become tracers of jax.numpy
        for leaf in (leaf for leaf in leaves if not isinstance(leaf, jax.core.Tracer)):
            if leaf.__class__ is float and 0.0 < leaf < np.inf:
                continue
            try:
                array = np.asarray(leaf, float)
            except (TypeError, ValueError):
                raise InputError(f"{key} must be a number, not {shown(value)}") from None
            if not np.all(np.isfinite(array)):
                raise InputError(f"{key} must be finite, not {value}")
            if np.any(array < 0.0) and np.ndim(value) < 2 and not dataclasses.is_dataclass(value):
                raise InputError(f"{key} must not be negative, not {value}")
            if np.any(array == 0.0) and field.name.endswith(
                ("_lag", "_width", "sample_time", "series_stiffness", "damping_beyond")
            ):
                raise InputError(f"{key} must be positive, not {value}")
    fault = damper.fault() if hasattr(damper, "fault") and not traced(damper) else None
    if fault:
        raise InputError(f"damper: {fault}")


ARGUMENTS["damper"] = lambda key, value: check_damper(value)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class PassiveDamper:
    """The vehicle's own dampers, rho_cy with its blow-off if it has one; or linear ones of `damping` (N s/m per side)."""

    damping: Number = None  # N s/m per side; None: the vehicle's own

    internal_states: ClassVar[int] = 0

    @classmethod
    def soft(cls) -> "PassiveDamper":
        """The controlled damper with its valve open, at 4.9 kN s/m per side."""
        return cls(SOFT)

    @classmethod
    def hard(cls) -> "PassiveDamper":
        """The controlled damper with its valve shut: Table 2's 5 kN at 0.1 m/s, taken as linear."""
        return cls(HARD)

    def force(self, vehicle: Vehicle, travel: Bogies, velocity: Bogies, internal: Bogies) -> tuple[Bogies, Bogies]:
        """F_d = 2 rho_cy Δy_c' (eq. 1's dissipation function), up to blow-off.

        Args:
            vehicle: gives rho_cy and the blow-off valve where the damper has no `damping` of its own.
            travel: Δy_c over each bogie, shape `(n, *lanes)`, m; plays no part in this law.
            velocity: Δy_c', shape `(n, *lanes)`, m/s.
            internal: no states, shape `(0, n, *lanes)`, dimensionless.

        Returns:
            The force of each bogie's two dampers, `(n, *lanes)`, N, positive along `velocity` when it resists; and `internal` as
            it came.
        """
        damping = vehicle.secondary.damping_y if self.damping is None else self.damping
        if self.damping is None and vehicle.lateral_damper is not None:
            return 2.0 * blow_off_force(vehicle.contact.law, vehicle.lateral_damper, damping, velocity), internal
        return 2.0 * damping * velocity, internal


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class MaxwellDamper:
    """Dashpots of `damping` c in series with a stiffness k (rubber ends, oil), both per side; blow-off as the yaw dampers'.

    One internal state, the dashpot's elongation s: F = 2 k (Δy_c - s), s' = v(k (Δy_c - s)). Typical: k 3 to 10 MN/m. The corners
    of the blow-off are sharp or rounded within `blow_off_width` as `law` says.
    """

    damping: Number = 25e3  # N s/m per side
    series_stiffness: Number = 5e6  # N/m per side
    blow_off_velocity: Number = None  # m/s; None: no blow-off
    damping_beyond: Number = None  # N s/m per side, beyond blow-off
    blow_off_width: Number = 1e-3  # m/s
    law: Literal["sharp", "smooth"] = structure("sharp")

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
