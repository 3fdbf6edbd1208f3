"""The dampers that files and the command line know by name; a new law adds its line here."""

from typing import TYPE_CHECKING

from ..base.errors import InputError, nearest

# the command line lists the names before it needs a law
if TYPE_CHECKING:
    from ..model.damper import Damper
    from ..model.vehicle import Vehicle

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


def make_damper(name: str, vehicle: "Vehicle", speed: float, alpha: float | None = None) -> "Damper":
    """The damper of one of the names in `DAMPERS`.

    Args:
        name: the kind.
        vehicle: the vehicle that it is for; clipped LQR is designed for it.
        speed: m/s, of that design.
        alpha: gain α of those in `WITH_ALPHA`; None leaves theirs.

    Raises `InputError` for an unknown name, an `alpha` without use, and a vehicle without secondary suspension.
    """
    from ..model.damper import HARD, PassiveDamper
    from .bouc_wen_damper import BoucWenDamper, HybridDamper
    from .controlled import ADD, BalanceLogic, ClippedLQR, MixedSkyhookADD, Skyhook

    if name not in DAMPERS:
        raise InputError(f"damper {name!r} is not known{nearest(name, DAMPERS)}")
    if name != "passive" and vehicle.bogie.held:
        raise InputError(f"damper {name}: this vehicle has no secondary suspension")
    if alpha is not None and name not in WITH_ALPHA:
        raise InputError(f"alpha is for {' and '.join(WITH_ALPHA)}, not for {name}")
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
