"""Sample and hold: a clock among a controller's internal states, so that it decides at times of its own and not at the integrator's."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..base.typing import Scalar

Clock = Float[Array, "..."]

#: share of the sample time by which a clock may be early: it is summed up of steps, each rounded
SLACK = 1e-3


def sampled(
    clock: Clock, sample_time: Scalar, fresh: Float[Array, "..."], kept: Float[Array, "..."]
) -> tuple[Clock, Float[Array, "..."]]:
    """The clock and what is held from now on: `fresh` where a sample is due, else `kept`; for `Law.held`.

    `clock` in s, (*lanes); its rate is 1 and it begins at 0, when the first sample is taken. Samples are taken at the first step that
    reaches a multiple of `sample_time` (s): exactly then if the step divides it, at every step if it is longer. Doing it twice at an instant
    changes nothing. `fresh` and `kept` broadcast against the clock.
    """
    over = clock >= (1.0 - SLACK) * sample_time
    rest = clock - sample_time * jnp.floor(clock / sample_time + SLACK)
    rest = jnp.where(rest < SLACK * sample_time, 0.0, rest)
    due = over | (clock == 0.0)
    return jnp.where(over, rest, clock), jnp.where(due, fresh, kept)
