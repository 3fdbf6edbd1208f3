"""What a semi-active damper can do with a command: between least and greatest damping, up to a force, with the lag of its actuator, never pushing.

    valve   command g from 0 (open) to 1 (shut):  F = 2 min((c_min + (c_max - c_min) g) |v|, F_max) sgn v
    force   command D in N per pair of dampers:   F = clip(D sgn v, 2 c_min |v|, 2 min(c_max |v|, F_max)) sgn v

so that F v >= 0 whatever is commanded. Faults of the loop: the current lost (the valve opens, the force goes), a sensor frozen at its last
reading, some of a bogie's dampers dead.
"""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...base import smooth
from ...base.arguments import guarded
from ...base.checks import from_zero, whole
from ...base.fields import matrix, optional, parameter, structure, table
from ...base.pytrees import registered
from ...base.typing import Number
from ...model.damper import HARD, SOFT, Bogies


@registered
@dataclass(frozen=True, kw_only=True)
class Device:
    """A semi-active damper and its driver, numbers per damper. Default: the paper's damper, its valve open and shut, and 5 kN (Table 2)."""

    kind: str = structure("valve", "what is commanded: the opening of a valve, or a force", ("valve", "force"))
    damping_min: Number = parameter("N s/m", "c_min", "damping with the valve open", SOFT)
    damping_max: Number = optional("N s/m", "c_max", "damping with the valve shut; left out: unlimited", default=HARD)
    force_limit: Number = optional("N", "F_max", "largest force; left out: unlimited", default=5e3, positive=True)
    lag: Number = optional("s", "τ_a", "time constant of driver and coil; left out: none", positive=True, default=5e-3)
    slew: Number = optional("1/s", "", "fastest change of the command, in shares of its range; left out: any", positive=True)
    width: Number = parameter("m/s", "w", "rounding of the velocity by which a demand is divided", 0.0)
    damping_rest: Number = parameter("N s/m", "c_0", "damping that is commanded where the velocity is well within that", 0.0)

    def fault(self) -> str | None:
        """What is wrong with its numbers together."""
        if self.kind == "valve" and self.damping_max is None:
            return "device: a valve needs a damping_max"
        if self.damping_max is not None and np.any(np.asarray(self.damping_min) >= self.damping_max):
            return f"device: damping_min ({self.damping_min}) must be below damping_max ({self.damping_max})"
        if self.kind == "force" and self.slew is not None and self.force_limit is None:
            return "device: slew is in shares of the force_limit: give one"
        return None

    @property
    def held(self) -> bool:
        """Whether its direction has to be held over a step, as the force jumps where the velocity turns."""
        return self.kind == "force" and self.damping_max is None

    def command(self, demand: Bogies, velocity: Bogies) -> Bogies:
        """What is commanded for a force `demand` (N per pair) at a velocity that is known (m/s), both (n, *lanes)."""
        if self.kind == "force":
            return demand if self.force_limit is None else jnp.clip(demand, -2.0 * self.force_limit, 2.0 * self.force_limit)
        rounding = self.width**2
        damping = (0.5 * demand * velocity + self.damping_rest * rounding) / (velocity**2 + rounding + smooth.TINY)
        return jnp.clip((damping - self.damping_min) / (self.damping_max - self.damping_min), 0.0, 1.0)

    def slewed(self, wanted: Bogies, before: Bogies, elapsed: Bogies) -> Bogies:
        """The command, as fast as it may change.

        Args:
            wanted: the command that is wanted, shape `(n, *lanes)`, dimensionless or N.
            before: what it was, likewise, dimensionless or N.
            elapsed: time since then, s.
        """
        if self.slew is None:
            return wanted
        most = self.slew * elapsed * (1.0 if self.kind == "valve" else 2.0 * self.force_limit)
        return before + jnp.clip(wanted - before, -most, most)

    def delivered(self, command: Bogies, velocity: Bogies, direction: Bogies | None = None) -> Bogies:
        """Force of a bogie's pair, (n, *lanes), N.

        Args:
            command: g, dimensionless, or D, N, shape `(n, *lanes)`.
            velocity: Δy_c', shape `(n, *lanes)`, m/s.
            direction: the velocity's sign where it is held over a step, dimensionless; None: that of the velocity.
        """
        if self.kind == "valve":
            force = 2.0 * (self.damping_min + (self.damping_max - self.damping_min) * command) * velocity
            return force if self.force_limit is None else jnp.clip(force, -2.0 * self.force_limit, 2.0 * self.force_limit)
        sign = jnp.sign(velocity) if direction is None else direction
        size, along = 2.0 * jnp.abs(velocity), command * sign
        if self.damping_max is not None:
            along = jnp.minimum(along, self.damping_max * size)
        # the limit is the command's; the least damping is a leak beside it
        return jnp.where(along > self.damping_min * size, along, 2.0 * self.damping_min * velocity * sign) * sign


@registered
@dataclass(frozen=True, kw_only=True)
class Faults:
    """What fails from `time` on: 0 is sound, 1 is failed; `every_fault` has one of each kind. Lanes may fail differently."""

    time: Number = parameter("s", "", "time from which on it has failed", 0.0)
    current: Number = table("1", "", "current lost, per bogie")
    dead: Number = table("1", "", "share of a bogie's dampers that are dead, per bogie")
    frozen: Number = matrix("1", "", "sensors frozen at their last reading, per sensor and bogie")

    @classmethod
    @guarded(sensors=whole(1), bogies=whole(1), time=from_zero("s"))
    def none(cls, sensors: int, bogies: int, time: float = 0.0) -> "Faults":
        """Nothing has failed: what to begin from.

        Args:
            sensors: number of kinds of sensors.
            bogies: number of bogies.
            time: from which on what is changed in it has failed, s.
        """
        return cls(time=time, current=np.zeros(bogies), dead=np.zeros(bogies), frozen=np.zeros((sensors, bogies)))


def every_fault(names: tuple[str, ...], bogies: int, time: float) -> dict[str, Faults]:
    """Each single fault by its name: none, current lost at all bogies and at each, each sensor frozen, one of a bogie's two dampers dead.

    Args:
        names: kinds of sensors, as `Sensors.names`.
        bogies: how many there are.
        time: from which on it has failed, s.
    """
    places = ["leading", *(f"bogie {j + 1}" for j in range(1, bogies - 1)), "trailing"][:bogies]

    def with_(**changed: Any) -> Faults:
        sound = Faults.none(len(names), bogies, time)
        return Faults(**{name: changed.get(name, getattr(sound, name)) for name in ("time", "current", "dead", "frozen")})

    one = np.eye(bogies)
    found = {"none": with_(), "current lost": with_(current=np.ones(bogies))}
    for j, place in enumerate(places):
        found[f"current lost, {place}"] = with_(current=one[j])
        found[f"one damper dead, {place}"] = with_(dead=0.5 * one[j])
        for k, name in enumerate(names):
            found[f"{name.replace('_', ' ')} frozen, {place}"] = with_(frozen=np.outer(np.eye(len(names))[k], one[j]))
    return found


def together(faults: dict[str, Faults]) -> Faults:
    """The faults as lanes of a batch, in their order."""
    return jax.tree.map(lambda *parts: np.stack(parts, axis=-1), *faults.values())


def failed(faults: Faults, now: Float[Array, "..."]) -> Float[Array, "..."]:
    """1 from the time of the faults on, else 0, as `now` (s)."""
    return jnp.where(now >= faults.time, 1.0, 0.0).astype(now.dtype)
