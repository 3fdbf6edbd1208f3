"""The objectives that the command line knows by name: the one table. A new one adds its line here."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from ..base.by_name import Maker
from ..base.errors import InputError, closest

# the command line lists the names before it needs an objective
if TYPE_CHECKING:
    from .quantity import Quantity

#: m; of the curve of objectives in one
RADIUS = 500.0

#: name -> what makes it of the `speeds`, or of the fastest, of the `track`, and of the `radius`. Limits are given in the unit in which it is printed
OBJECTIVES = {
    "comfort": Maker("tuning.objectives", "comfort", ("speeds", "track")),
    "travel-mm": Maker("tuning.objectives", "travel", ("speeds", "track")),
    "guiding-force-kN": Maker("tuning.objectives", "guiding_force", ("speeds", "track")),
    "wear-N": Maker("tuning.objectives", "wear", ("radius",)),
    "angle-of-attack-mrad": Maker("tuning.objectives", "angle_of_attack", ("radius",)),
    "y-over-q": Maker("tuning.objectives", "derailment_quotient", ("radius",)),
    "critical-speed": Maker("tuning.objectives", "linear_critical_speed"),
    "nonlinear-critical-speed": Maker("tuning.objectives", "nonlinear_critical_speed"),
    "least-damping": Maker("tuning.objectives", "least_damping", ("speed",)),
    "limit-cycle-mm": Maker("tuning.objectives", "limit_cycle_amplitude", ("speed",)),
}


def make_objective(name: str, speeds: Sequence[float], track: str, radius: float = RADIUS) -> "Quantity":
    """The objective of a name in `OBJECTIVES` for `speeds` (m/s; what takes a single one is for the highest) on the `track` of a spectrum's name,
    or in a curve of this `radius` (m).

    Raises `InputError` for an unknown name.
    """

    if name not in OBJECTIVES:
        near = closest(name, OBJECTIVES)
        raise InputError(f"{name!r} is not known; did you mean {near}?")
    return OBJECTIVES[name].make(speeds=speeds, speed=max(speeds), track=track, radius=radius)
