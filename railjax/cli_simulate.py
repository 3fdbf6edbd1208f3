"""The dampers that `railjax simulate --damper` knows by name."""

import difflib
from typing import TYPE_CHECKING

from .errors import InputError

if TYPE_CHECKING:
    from .dampers import Damper
    from .vehicle import Vehicle

DAMPERS = (
    "passive",
    "passive-soft",
    "passive-hard",
    "balance-logic",
    "bouc-wen",
    "hybrid",
    "skyhook",
    "skyhook-continuous",
    "add",
    "mixed-sh-add",
    "clipped-lqr",
)
WITH_ALPHA = ("balance-logic", "hybrid")


def make_damper(name: str, vehicle: "Vehicle", speed: float, alpha: float | None) -> "Damper":
    """The damper of that name, for a vehicle at a speed (m/s); `alpha` of those that have it. Raises `InputError`."""
    from . import ADD, BalanceLogic, BoucWenDamper, ClippedLQR, HybridDamper, MixedSkyhookADD, PassiveDamper, Skyhook
    from .dampers import HARD

    if name not in DAMPERS:
        near = difflib.get_close_matches(name, DAMPERS, n=1, cutoff=0.0)[0]
        raise InputError(f"--damper {name!r} is not known; did you mean {near}?")
    if name != "passive" and vehicle.bogie.held:
        raise InputError(f"--damper {name}: this vehicle has no secondary suspension")
    if alpha is not None and name not in WITH_ALPHA:
        raise InputError(f"--alpha is for {' and '.join(WITH_ALPHA)}, not for {name}")
    gain = {} if alpha is None else {"alpha": alpha}
    return {
        "passive": PassiveDamper,
        "passive-soft": PassiveDamper.soft,
        "passive-hard": PassiveDamper.hard,
        "balance-logic": lambda: BalanceLogic(**gain),
        "bouc-wen": BoucWenDamper,
        "hybrid": lambda: HybridDamper(**gain),
        "skyhook": Skyhook,
        "skyhook-continuous": lambda: Skyhook(damping=HARD),
        "add": ADD,
        "mixed-sh-add": MixedSkyhookADD,
        "clipped-lqr": lambda: ClippedLQR.design(vehicle, speed),
    }[name]()
