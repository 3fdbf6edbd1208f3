"""Where a contact jumps, however small the step of y."""

from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from ...base.namespace import known
from .gap import Pose
from .points import Touching, touching

#: m by which a contact moves on the wheel where it jumps; how often a step is halved to see it
JUMP, HALVINGS = 0.3e-3, 14


def jumps_of(found: Any) -> tuple[Float[np.ndarray, "jumps"], Float[np.ndarray, "jumps"]]:
    """Where a contact jumps, and by how much Delta r does: steps in which a contact moves far are halved, and what does not become
    small is a jump. Of two within a step the larger counts. `found`: a `ContactGeometry`."""
    y, place = np.asarray(found.y), np.asarray(found.wheel_position)
    suspect = np.flatnonzero(np.max(np.abs(np.diff(place, axis=0)), axis=1) > JUMP)
    ends = [(y[suspect + k], Pose(np.asarray(found.height)[suspect + k], np.asarray(found.roll)[suspect + k])) for k in (0, 1)]
    if not suspect.size:
        return np.zeros(0), np.zeros(0)
    side = known(found.sides)
    low, high = (touching(side, at, pose) for at, pose in ends)
    for _ in range(HALVINGS):
        middle = touching(side, 0.5 * (low.y + high.y), Pose(*(0.5 * (a + b) for a, b in zip(low.pose, high.pose, strict=True))))
        first = np.max(np.abs(middle.place - low.place), axis=0) > np.max(np.abs(high.place - middle.place), axis=0)
        low, high = _chosen(first, low, middle), _chosen(first, middle, high)
    jumped = np.max(np.abs(high.place - low.place), axis=0) > JUMP
    size = (high.rise - low.rise)[0] - (high.rise - low.rise)[1]
    return (0.5 * (low.y + high.y))[jumped], size[jumped]


def _chosen(first: Any, one: Touching, other: Touching) -> Touching:
    return jax.tree.map(lambda a, b: np.where(first, a, b), one, other)
