"""Lateral dampers of the secondary suspension: what takes the place of rho_cy in eq. (6); the passive ones.

A damper is a pytree with two things, and needs no base class; a law of one's own is written the same way (`Damper`):

* `internal_states`: how many states of its own it carries per bogie (0 for a memoryless law);
* `force(vehicle, travel, velocity, internal)`: the law itself, a pure function. `travel` and `velocity` are Δy_c and Δy_c' of
  eqs. (7)-(8), at the damper's own heights where `vehicle.lateral_damper` gives them, shape (n, *lanes), `internal` is (states, n, *lanes). Returns the force of one bogie's dampers in N, positive
  along `velocity` when it resists, and the rate of the internal states.

It may answer more for itself, where the law needs it: what else is asked of it, and what is taken where it says nothing, is `Law`. The package's
laws inherit it; of others `answers` completes what they leave out.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Protocol, runtime_checkable

import jax
from jaxtyping import Array, Float

from ..base.arguments import ARGUMENTS
from ..base.checks import traced
from ..base.errors import InputError
from ..base.fields import LAWS, check_numbers, optional, parameter
from ..base.pytrees import registered
from ..base.typing import Number, Scalar
from .kinematics import Groups
from .suspension import blow_off_force
from .vehicle import Vehicle

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
    pytree, with these two. What a law may have beyond them stands in `railjax.model.damper.Law`.

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


class Law:
    """What a law answers for itself besides `force` (see `Damper`), with what is taken where it says nothing."""

    #: `force` takes a fifth argument, a `Seen`, for a controller that looks further than the damper's travel
    observes: ClassVar[bool] = False
    #: "sharp", or "smooth" for its twin without corners and jumps; None: there is but one
    law: ClassVar[str | None] = None

    force: Callable[..., tuple[Bogies, Bogies]]

    @property
    def internal_states(self) -> int:
        """States of its own per bogie."""
        return 0

    @property
    def even_states(self) -> tuple[int, ...]:
        """Indices of the internal states that have no side (a valve's opening, not a force), for limit cycles."""
        return ()

    def held(self, vehicle: Vehicle, travel: Bogies, velocity: Bogies, internal: Bogies, seen: Seen) -> Bogies:
        """The internal states as they go into the next step of a run.

        A sampled controller decides here and keeps its decision, an internal state of rate zero, through the four stages of RK4: a decision
        made within a stage would destroy the order. It is called at the start and after every step, and must not change what it gave
        itself; `railjax.dampers.sampling` holds a decision over a sample time of the controller's own.
        """
        return internal

    @property
    def decides(self) -> bool:
        """Whether it is a controller: what has a `held` of its own."""
        return getattr(self.held, "__func__", None) is not Law.held

    def extremes(self, vehicle: Vehicle) -> tuple[Damper, ...]:
        """Laws, linear at rest, that bound the rates of its motion where its own linearisation at rest does not."""
        return ()

    def fault(self) -> str | None:
        """What is wrong with its numbers together, as the end of a message; single ones are checked without it."""
        return None

    @property
    def memoryless(self) -> bool:
        """Whether it is a law of travel and velocity alone, which statistical linearisation takes."""
        return self.internal_states == 0 and not self.observes

    @property
    def linear(self) -> bool:
        """Whether its linearisation at rest says what it does: of laws with a memory there is no better, of others it may be curved."""
        return not (self.decides or self.memoryless)

    def describing(self, vehicle: Vehicle, omega: Scalar) -> Damper | None:
        """A linear law that does the same to an oscillation of `omega` (rad/s), whatever its amplitude; None where there is none."""
        return None


class _Answers(Law):
    """Somebody's law, with the defaults for what it does not answer itself."""

    internal_states: int = 0
    even_states: tuple[int, ...] = ()

    def __init__(self, damper: Any):
        for name in ("internal_states", "force", "observes", "held", "extremes", "fault", "even_states", "law"):
            if hasattr(damper, name):
                setattr(self, name, getattr(damper, name))


def answers(damper: Damper) -> Law:
    """The damper, if it is a `Law`, or its answers completed by the defaults: the one place where these are looked for."""
    return damper if isinstance(damper, Law) else _Answers(damper)


def law_of(damper: Damper, seen: Seen) -> Callable[[Vehicle, Bogies, Bogies, Bogies], tuple[Bogies, Bogies]]:
    """The damper's `force` at this instant, with what it observes."""
    if answers(damper).observes:
        return lambda *local: damper.force(*local, seen)
    return damper.force


def damper_extremes(vehicle: Vehicle, damper: Damper) -> list[Damper]:
    """The damper and the laws that bound its rates away from rest."""
    return [damper, *answers(damper).extremes(vehicle)]


def with_law(damper: Damper, law: str) -> Damper:
    """The damper with its "sharp" law, or with the "smooth" twin of it, if it has both."""
    own = answers(damper).law
    return dataclasses.replace(damper, law=law) if isinstance(own, str) and own in LAWS and own != law else damper  # type: ignore[type-var]


def check_damper(damper: object) -> None:
    """Refuse what is no damper, numbers that are not finite or have the wrong sign, where they are known, and a law that is not there."""
    kind = damper.__name__ if isinstance(damper, type) else type(damper).__name__
    # the look at a protocol takes 30 µs
    if isinstance(damper, type) or not isinstance(damper, (Law, Damper)):
        wanted = f"an object, {kind}()" if isinstance(damper, type) else "an object with internal_states and force(...)"
        raise InputError(f"damper must be {wanted}, not {damper!r}; railjax.Damper says how to write one")
    if jax.tree_util.all_leaves([damper]):
        raise InputError(f"damper: {kind} is no pytree; decorate it with @jax.tree_util.register_dataclass")
    known = check_numbers(damper, "damper") if dataclasses.is_dataclass(damper) else not traced(damper)
    fault = answers(damper).fault() if known else None
    if fault:
        raise InputError(f"damper: {fault}")


ARGUMENTS["damper"] = lambda key, value: check_damper(value)


@registered
@dataclass(frozen=True)
class PassiveDamper(Law):
    """The vehicle's own dampers, rho_cy with its blow-off if it has one; or linear ones of `damping` (N s/m per side)."""

    damping: Number = optional("N s/m", "c", "damping per side; left out: the vehicle's own")

    linear: ClassVar[bool] = True

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


@registered
@dataclass(frozen=True)
class EquivalentDamper(Law):
    """A spring and a dashpot for each bogie's pair of dampers: what linearisation makes of a law. One number, or one for each bogie, (n, 1)."""

    stiffness: Number = parameter("N/m", "k", "stiffness of a bogie's pair of dampers", signed=True)
    damping: Number = parameter("N s/m", "c", "damping of a bogie's pair of dampers", signed=True)

    linear: ClassVar[bool] = True

    def force(self, vehicle: Vehicle, travel: Bogies, velocity: Bogies, internal: Bogies) -> tuple[Bogies, Bogies]:
        """k Δy_c + c Δy_c'."""
        return self.stiffness * travel + self.damping * velocity, internal
