"""Transition curves of a simulated run: when it passes them, and what its floor feels there."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..base.errors import InputError
from ..model.track.curve import GRAVITY
from ..model.track.layout import Layout
from ..simulation.simulate import Simulation
from ..simulation.speed import SpeedProfile
from .indices import AFTER

Values = Float[np.ndarray, "samples ..."]


class Passage(NamedTuple):
    """What P_CT is formed of: lateral acceleration of the floor (m/s²) and its roll rate (rad/s) as instruments on it feel them, from and
    to which times (s) the car body's centre is in each transition, and notes."""

    lateral: Values
    roll_rate: Values
    times: tuple[tuple[float, float], ...]
    notes: tuple[str, ...]


def passage(run: Simulation, layout: Layout, lateral: Values) -> Passage:
    """The transitions of a layout in a run over it.

    An accelerometer on the floor feels g phi more than one in the plane of the track, and a gyroscope the roll against the track less the
    ramp of the cant, phi' - v theta'.

    Args:
        run: all lanes at one speed, with the car body's roll and roll rate.
        layout: the line that it ran on.
        lateral: acceleration in the plane of the track, of shape `(samples, *places, *lanes)`, m/s².

    Raises:
        InputError: for lanes of different speeds, a run without the car body's roll, and one that passes no transition.
    """
    time, speed = np.asarray(run.time), run.speed
    if isinstance(speed, SpeedProfile):
        if np.ndim(speed.speed) > 1 or np.ndim(speed.time) > 1:
            raise InputError("layout: lanes must run at one speed, for their transitions to be passed together")
        distance, at = np.asarray(speed.distance(jnp.asarray(time))), np.asarray(speed.at(jnp.asarray(time)))
    else:
        if np.ptp(np.asarray(speed)) > 0.0:
            raise InputError("layout: lanes must run at one speed, for their transitions to be passed together")
        at = np.broadcast_to(float(np.ravel(speed)[0]), time.shape)
        distance = at * time
    places = layout.transitions()
    passed = [(low, high) for low, high in places if distance[0] <= low and high + at[-1] * AFTER <= distance[-1]]
    if not passed:
        raise InputError(
            f"layout: the run of {distance[-1]:.0f} m holds none of the line's {len(places)} transitions and {AFTER:g} s beyond; run longer"
        )
    ramp = jax.jvp(lambda s: layout.at(s)[1], (jnp.asarray(distance),), (jnp.asarray(at),))[1]
    roll, rate = (np.asarray(run[name]) for name in ("carbody_phi", "carbody_phi_rate"))
    lanes = (1,) * (roll.ndim - 1)
    rate = rate - np.asarray(ramp).reshape((-1, *lanes))
    if lateral.ndim > roll.ndim:
        roll, rate = roll[:, None], rate[:, None]
    lacking = len(places) - len(passed)
    return Passage(
        lateral + GRAVITY * roll,
        rate,
        tuple(tuple(float(np.interp(end, distance, time)) for end in place) for place in passed),  # type: ignore[misc]
        (f"P_CT: {lacking} of {len(places)} transitions are not within the run",) if lacking else (),
    )
