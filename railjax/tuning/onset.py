"""From which speed on a vehicle hunts with a law in its dampers: run for a minute on even track, after a small and after a large disturbance."""

import numpy as np
from jaxtyping import Bool, Float

from ..model.damper import Damper
from ..model.kinematics import layout
from ..model.motion import PASSIVE, state_size
from ..model.vehicle import Vehicle
from ..simulation.simulate import initial_state, simulate

#: m; displacement of all wheelsets that only linear instability keeps alive
SMALL = 0.2e-3
#: flange clearances; of wheelsets displaced to alternate sides, which end in hunting from the same speed on as those of a limit cycle do
LARGE = 1.1
DURATION, LAST = 60.0, 5.0  # s
#: m; a wheelset that still moves more than this in the last seconds hunts
HUNTS = 3e-3
#: of the lowest speed, up to which an onset is looked for; and how many speeds are tried at once, first all the way and then between two
HIGHEST, COARSE, FINE = 1.3, 12, 6
#: of the quiet speed, at which another law must keep quiet too: half a percent is between one speed that is tried and the next
BELOW = (0.99, 0.975, 0.96)


def amplitudes(
    vehicle: Vehicle,
    damper: Damper,
    start: Float[np.ndarray, "states *lanes"],
    speeds: Float[np.ndarray, "lanes"],
    dt: float = 1e-3,
) -> Float[np.ndarray, "lanes"]:
    """Largest wheelset displacement (m) over the last seconds on even track, for each speed.

    Args:
        vehicle: a single vehicle.
        damper: the law, a single one.
        start: state of the vehicle without the damper's own, which begin at rest; the same for all speeds or one for each, SI.
        speeds: m/s.
        dt: step of RK4, s.
    """
    at_rest = np.zeros((state_size(vehicle, damper) - len(start), *start.shape[1:]))
    run = simulate(
        vehicle,
        speeds,
        damper=damper,
        duration=DURATION,
        settle=DURATION - LAST,
        sample=0.1,
        dt=dt,
        initial=np.concatenate([start, at_rest]),
        record=(),
        reduce=["peak:wheelset_y"],
    )
    return np.asarray(run["peak:wheelset_y"]).max(axis=0)


def first_onset(quiet: Bool[np.ndarray, "speeds"]) -> int:
    """Index of the lowest speed from which on up the vehicle hunts; their number where it does not at the highest.

    Args:
        quiet: at which of the rising speeds it does not hunt, dimensionless.
    """
    found = np.flatnonzero(quiet)
    return 0 if len(found) == 0 else int(found[-1]) + 1


def onset(speeds: Float[np.ndarray, "speeds"], heights: Float[np.ndarray, "speeds"]) -> float:
    """The lowest of rising speeds (in any unit) from which on up the vehicle hunts; NaN where it does not at the highest.

    Args:
        speeds: which were tried, m/s or km/h.
        heights: `amplitudes` there, m.
    """
    return float(np.append(speeds, np.nan)[first_onset(heights <= HUNTS)])


def disturbances(vehicle: Vehicle) -> tuple[Float[np.ndarray, "states"], Float[np.ndarray, "states"]]:
    """A small one and a large one: states of the vehicle with all wheelsets displaced to one side, or to alternate sides."""
    shape = layout(vehicle)["wheelset_y"]
    sides = (-1.0) ** np.arange(np.prod(shape)).reshape(shape)
    clearance = float(np.asarray(vehicle.contact.flange_clearance))
    each = SMALL * np.ones(shape), LARGE * clearance * sides
    small, large = (np.asarray(initial_state(vehicle, PASSIVE, {"wheelset_y": y})) for y in each)
    return small, large


class QuietSpeeds:
    """The highest speeds up to which a vehicle with a law does not hunt, at `lowest` (m/s) or above: NaN where it does there already."""

    def __init__(self, vehicle: Vehicle, law: Damper, lowest: float, dt: float) -> None:
        self.vehicle, self.dt, self.starts = vehicle, dt, np.stack(disturbances(vehicle), axis=-1)
        self.small, self.large = self.speeds = self._searched(law, lowest)

    def _quiet(self, law: Damper, speeds: Float[np.ndarray, "speeds 2"]) -> Bool[np.ndarray, "speeds 2"]:
        """Whether it keeps quiet at some speeds after each disturbance."""
        starts = np.tile(self.starts, (1, len(speeds)))
        return (amplitudes(self.vehicle, law, starts, speeds.ravel(), self.dt) <= HUNTS).reshape(speeds.shape)

    def _searched(self, law: Damper, lowest: float) -> tuple[float, float]:
        low, high, found = np.full(2, lowest), np.full(2, HIGHEST * lowest), np.full(2, np.nan)
        for count in (COARSE, FINE):
            speeds = np.linspace(low, high, count)
            quiet = self._quiet(law, speeds)
            for k in range(2):
                first = first_onset(quiet[:, k])
                if first > 0:
                    found[k] = low[k] = speeds[first - 1, k]
                if first < count:
                    high[k] = speeds[first, k]
        return float(found[0]), float(found[1])

    def kept(self, law: Damper) -> bool:
        """Whether another law keeps quiet there as well, to one percent, and at two lower speeds."""
        speeds = np.outer(BELOW, np.nan_to_num(self.speeds, nan=1.0))
        quiet = self._quiet(law, speeds)
        return bool(np.all(quiet | np.isnan(self.speeds)))
