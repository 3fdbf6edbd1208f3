"""The dampers that files and the command line know by name: the one table. A new law adds its line here."""

from typing import TYPE_CHECKING

from ..base.by_name import Maker
from ..base.errors import InputError, nearest

# the command line lists the names before it needs a law
if TYPE_CHECKING:
    from ..model.damper import Damper
    from ..model.vehicle import Vehicle


#: name -> what makes it of the `vehicle`, the `speed` that it is designed for and the gain `alpha`
MAKERS = {
    "passive": Maker("model.damper", "PassiveDamper"),
    "passive-soft": Maker("model.damper", "PassiveDamper.soft"),
    "passive-hard": Maker("model.damper", "PassiveDamper.hard"),
    "balance-logic": Maker("dampers.balance_logic", "BalanceLogic", ("alpha",)),
    "bouc-wen": Maker("dampers.bouc_wen_damper", "BoucWenDamper"),
    "hybrid": Maker("dampers.bouc_wen_damper", "HybridDamper", ("alpha",)),
    "skyhook": Maker("dampers.skyhook", "Skyhook"),
    "skyhook-continuous": Maker("dampers.skyhook", "Skyhook.continuous"),
    "add": Maker("dampers.skyhook", "ADD"),
    "mixed-sh-add": Maker("dampers.skyhook", "MixedSkyhookADD"),
    "clipped-lqr": Maker("dampers.clipped_lqr", "ClippedLQR.design", ("vehicle", "speed")),
}
DAMPERS = tuple(MAKERS)
#: those with a gain α, and those that are designed at one speed
WITH_ALPHA = tuple(name for name, maker in MAKERS.items() if "alpha" in maker.takes)
DESIGNED = tuple(name for name, maker in MAKERS.items() if "speed" in maker.takes)
#: what the file of a law ends in
FILE = ".npz"


def make_damper(name: str, vehicle: "Vehicle", speed: float | None, alpha: float | None = None) -> "Damper":
    """The damper of one of the names in `DAMPERS`, or of a file that `law.save` wrote.

    Args:
        name: the kind, or a path that ends in .npz.
        vehicle: the vehicle that it is for; clipped LQR is designed for it.
        speed: m/s, of that design; None where none is given.
        alpha: gain α of those in `WITH_ALPHA`; None leaves theirs.

    Raises `InputError` for an unknown name, an `alpha` without use, a design without a speed, and a vehicle without secondary suspension.
    """
    if name not in MAKERS and not name.endswith(FILE):
        raise InputError(f"damper {name!r} is not known{nearest(name, DAMPERS)}")
    if name != "passive" and vehicle.bogie.held:
        raise InputError(f"damper {name}: this vehicle has no secondary suspension")
    if alpha is not None and name not in WITH_ALPHA:
        raise InputError(f"alpha is for {' and '.join(WITH_ALPHA)}, not for {name}")
    if name.endswith(FILE):
        from .control.law_files import load_law

        return load_law(name)
    if speed is None and name in DESIGNED:
        raise InputError(f"damper {name} is designed at a speed: give one")
    return MAKERS[name].make(vehicle=vehicle, speed=speed, alpha=alpha)
