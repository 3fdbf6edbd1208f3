"""Estimators: what a law needs to know of the motion, made of what is sensed.

An estimator remembers numbers per bogie (`states`), takes readings in (`advanced`), and lays open what it knows: `features`, a few numbers per
bogie, of which `estimate` makes travel, velocity and a `Seen` for any law, linearly.
"""

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...base.fields import parameter
from ...base.pytrees import registered
from ...base.typing import Number
from ...model.damper import Bogies, Seen
from ...model.kinematics import Groups, bogie_positions, layout
from ...model.vehicle import Vehicle
from .sensors import Signals

Rows = Float[Array, "..."]


class Estimate(NamedTuple):
    """What a law goes by in place of the truth."""

    travel: Bogies  # Δy_c, m
    velocity: Bogies  # Δy_c', m/s
    seen: Seen


#: what one of the features is usually, by its name, in its own unit
USUALLY = {
    "travel": 5e-3,
    "velocity": 0.1,
    "carbody velocity": 0.02,
    "carbody acceleration": 0.2,
    "bogie acceleration": 2.0,
}


@registered
@dataclass(frozen=True, kw_only=True)
class ComplementaryFilter:
    """Velocities from accelerometers where motion is fast and from the travel where it is slow, each bogie by itself.

    Across the damper, with e = d - d̂ of the travel d:   v̂' = a_c - a_b + ω² e,  d̂' = v̂ + √2 ω e,   ω = 2π `crossover`;
    of the car body:   v̂_c' = a_c - ā_c - ω_0 v̂_c,  ā_c' = ω_0 (a_c - ā_c),   ω_0 = 2π `drift`,
    by Euler's rule from sample to sample. The first is exact for exact sensors whatever ω; the second leaves out what is slower than ω_0 (and
    with it bias, and cant and roll as accelerometers feel them): the car body's own velocity has no other witness.
    """

    crossover: Number = parameter("Hz", "ω/2π", "frequency from which on the damper's velocity is the accelerometers'", 1.0)
    drift: Number = parameter("Hz", "ω_0/2π", "frequency below which nothing is said of the car body's velocity", 0.1)

    needs: ClassVar[tuple[str, ...]] = ("carbody_acceleration", "bogie_acceleration", "travel")
    states: ClassVar[int] = 4
    names: ClassVar[tuple[str, ...]] = ("travel", "velocity", "carbody velocity", "carbody acceleration", "bogie acceleration")
    whole: ClassVar[bool] = False

    def usually(self, bogies: int) -> Float[np.ndarray, "features"]:
        """Usual size of each feature of each bogie, in its SI unit; `bogies`: how many there are, a whole number (dimensionless)."""
        return np.repeat([USUALLY[name] for name in self.names], bogies)

    def advanced(self, names: tuple[str, ...], signals: Signals, memory: Rows, elapsed: Bogies) -> Rows:
        """d̂, v̂, v̂_c and ā_c, (4, n, *lanes), after a sample.

        Args:
            names: of the sensors, in the order of their signals.
            signals: readings, shape `(m, n, *lanes)`, SI.
            memory: what this gave at the last sample, shape `(4, n, *lanes)`, SI.
            elapsed: time since then, shape `(n, *lanes)`, s.
        """
        above, below, travel = (signals[names.index(name)] for name in self.needs)
        d, v, body, mean = memory
        fast, slow, error = 2.0 * jnp.pi * self.crossover, 2.0 * jnp.pi * self.drift, travel - memory[0]
        v = v + elapsed * (above - below + fast**2 * error)
        mean = mean + elapsed * slow * (above - mean)
        return jnp.stack(
            [
                d + elapsed * (v + jnp.sqrt(2.0) * fast * error),
                v,
                body + elapsed * (above - mean - slow * body),
                mean,
            ]
        )

    def told(self, memory: Rows, force: Bogies) -> Rows:
        """The `memory`, SI, as it is: the `force` that will act, N, is of no use to it."""
        return memory

    def features(self, names: tuple[str, ...], signals: Signals, memory: Rows) -> Rows:
        """d̂, v̂, v̂_c, a_c - ā_c and a_b, (5, n, *lanes), in m, m/s and m/s^2.

        Args:
            names: of the sensors, in the order of their signals.
            signals: readings, shape `(m, n, *lanes)`, SI.
            memory: after them, shape `(4, n, *lanes)`, SI.
        """
        d, v, body, mean = memory
        above, below = (signals[names.index(name)] for name in self.needs[:2])
        return jnp.stack([d, v, body, above - mean, below])

    def estimate(self, vehicle: Vehicle, features: Rows) -> Estimate:
        """The damper's motion by its `features`, SI, and a car body whose lateral and yaw rates give v̂_c above each bogie (best, of more than two)."""
        travel, velocity, body = features[:3]
        shapes, lanes = layout(vehicle), travel.shape[1:]
        still: Groups = {name: jnp.zeros(shape + lanes, travel.dtype) for name, shape in shapes.items()}
        at = bogie_positions(vehicle, travel[:, None])
        at = jnp.broadcast_to(at, travel.shape)
        mean, arm = jnp.mean(body, axis=0), at - jnp.mean(at, axis=0)
        turning = jnp.sum(arm * body, axis=0) / jnp.maximum(jnp.sum(arm**2, axis=0), 1e-12)
        rates = dict(still)
        if "carbody_y" in shapes:
            rates |= {"carbody_y": mean - turning * jnp.mean(at, axis=0), "carbody_psi": turning}
        return Estimate(travel, velocity, Seen(still, rates))
