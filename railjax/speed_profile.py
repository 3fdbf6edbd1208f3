"""Speed over time: a number, or straight lines between points."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .typing import Number, Scalar


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SpeedProfile:
    """A speed that varies in time: straight lines between (time, speed) points, s and m/s; constant beyond the ends.

    `SpeedProfile([0, 60], [70, 62])` is a slow ramp down.
    """

    time: Number
    speed: Number

    def at(self, time: Float[Array, "..."]) -> Float[Array, "..."]:
        """v(t), m/s, at `time` t, s."""
        return jnp.interp(time, jnp.asarray(self.time, float), jnp.asarray(self.speed, float))

    def distance(self, time: Float[Array, "..."]) -> Float[Array, "..."]:
        """Integral of v from 0 (or the first point, if later) to `time` t (s), exact, m."""
        knots, speeds = jnp.asarray(self.time, float), jnp.asarray(self.speed, float)
        steps = jnp.diff(knots)
        at_knots = jnp.concatenate([jnp.zeros(1), jnp.cumsum(0.5 * (speeds[1:] + speeds[:-1]) * steps)])
        last = jnp.clip(jnp.searchsorted(knots, time, side="right") - 1, 0, knots.shape[0] - 1)
        return at_knots[last] + 0.5 * (speeds[last] + self.at(time)) * (time - knots[last])


Speed = Scalar | SpeedProfile
