"""Speed over time: a number, or straight lines between points."""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..base.arguments import SPEED, guarded
from ..base.checks import Range, Rising, positive, traced
from ..base.errors import InputError
from ..base.fields import table
from ..base.typing import Number, Scalar

#: of a profile, one axis for its points
TIME = Range("s", axes=9)
SPEEDS = positive("m/s", axes=2, why=": creepage is a ratio to the speed")


def in_order(key: str, profile: "SpeedProfile") -> None:
    """Times that rise, speeds that are positive and as many, where they are known."""
    if traced(profile):
        return
    Rising(Range("s"))(f"{key}.time", profile.time)
    SPEEDS(f"{key}.speed", profile.speed)
    counts = [np.shape(values)[:1] for values in (profile.time, profile.speed)]
    if counts[0] != counts[1]:
        raise InputError(
            f"{key}: time and speed must be pairs, but their shapes are {np.shape(profile.time)} and {np.shape(profile.speed)}"
        )


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SpeedProfile:
    """A speed that varies in time: straight lines between (time, speed) points, s and m/s; constant beyond the ends.

    `SpeedProfile([0, 60], [70, 62])` is a slow ramp down.
    """

    time: Number = table("s", "t", "times of the profile's points")
    speed: Number = table("m/s", "v", "speeds of the profile's points")

    @guarded(self=in_order, time=TIME)
    def at(self, time: Float[Array, "..."]) -> Float[Array, "..."]:
        """v(t), m/s, at `time` t, s."""
        return jnp.interp(time, jnp.asarray(self.time, float), jnp.asarray(self.speed, float))

    @guarded(self=in_order, time=TIME)
    def distance(self, time: Float[Array, "..."]) -> Float[Array, "..."]:
        """Integral of v from 0 (or the first point, if later) to `time` t (s), exact, m."""
        knots, speeds = jnp.asarray(self.time, float), jnp.asarray(self.speed, float)
        steps = jnp.diff(knots)
        at_knots = jnp.concatenate([jnp.zeros(1), jnp.cumsum(0.5 * (speeds[1:] + speeds[:-1]) * steps)])
        last = jnp.clip(jnp.searchsorted(knots, time, side="right") - 1, 0, knots.shape[0] - 1)
        return at_knots[last] + 0.5 * (speeds[last] + self.at(time)) * (time - knots[last])


Speed = Scalar | SpeedProfile


def a_speed(key: str, value: Any) -> None:
    """A number, one per lane, or a profile over time."""
    if isinstance(value, SpeedProfile):
        in_order(key, value)
    else:
        SPEED(key, value)
