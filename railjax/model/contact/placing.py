"""What a wheel, a rail and how they lie may be, and which of them make no wheelset on its rails."""

from typing import Any

import numpy as np

from ...base.checks import Range, shown
from ...base.errors import InputError
from .gap import GAUGE_DEPTH
from .profiles import RailProfile, WheelProfile

#: rad; a contact angle at rest beyond which the flanges stand on the rails
STANDING = 0.6


def _one_or_two(kind: type) -> Any:
    """A rule: a profile, the name of one, or two of them."""
    what = "wheel" if kind is WheelProfile else "rail"

    def rule(key: str, value: Any) -> None:
        pair = value if isinstance(value, (tuple, list)) else (value,)
        if len(pair) not in (1, 2) or not all(isinstance(one, (kind, str)) and one != "" for one in pair):
            raise InputError(
                f"{key} must be a {what} profile, as railjax.{kind.__name__}.load gives it, or (right, left), not {shown(value)}"
            )

    return rule


#: what the numbers of a pair may be
NUMBERS = {
    "gauge": Range("m", 0.5, 2.0, axes=1, why="; is it in millimetres?"),
    "flange_back": Range("m", 0.4, 2.0, axes=1, why="; is it in millimetres?"),
    "tread_datum": Range("m", 0.0, 0.2, axes=1, why="; is it in millimetres?"),
    "radius": Range("m", 0.05, 1.5, axes=1, why="; is it in millimetres?"),
    "inclination": Range("rad", -0.2, 0.2, axes=1, why="; 1:40 is 1/40"),
}


#: what a wheel, a rail and how they lie may be
PLACED: dict[str, Any] = {
    "wheel": _one_or_two(WheelProfile),
    "rail": _one_or_two(RailProfile),
    **NUMBERS,
}


def over_flanges(wheels: tuple[WheelProfile, WheelProfile], base: Any) -> Any:
    """How far the faces of both flanges are apart where gauge is measured, m; `base` (m) are both tread datums from the wheelset's middle."""
    return sum(one - wheel.flange_face(GAUGE_DEPTH) for one, wheel in zip(base, wheels, strict=True))


def refuse_unfit(found: Any, gauge: float) -> None:
    """What is known to be no geometry of a wheelset on its rails.

    Args:
        found: a `ContactGeometry`
        gauge: m
    """
    apart = float(over_flanges(found.profiles[0], found.sides.base))
    if not apart < gauge:
        raise InputError(
            f"the wheelset does not fit between the rails: {1e3 * GAUGE_DEPTH:g} mm below the tread its flanges are {1e3 * apart:.1f} mm "
            f"apart and gauge is {1e3 * gauge:.1f} mm; enlarge gauge or take a smaller flange_back"
        )
    for side, (wheel, named) in enumerate(zip(found.profiles[0], ("right", "left"), strict=True)):
        place = np.asarray(found.wheel_position[:, side])
        for end in (wheel.lateral[0], wheel.lateral[-1]):
            beyond = np.abs(place - end) < 1e-6
            if np.any(beyond):
                at = float(found.y[int(np.argmax(beyond))])
                raise InputError(
                    f"{wheel.name}: at y = {1e3 * at:.2f} mm the {named} wheel would touch beyond its end at {1e3 * end:.1f} mm; the profile is too short for the gauge"
                )
    if not np.all(np.isfinite(found.roll)) or not np.all(np.isfinite(found.smooth.roll)):
        raise InputError("the profiles, or gauge and flange_back, are not those of a wheelset on rails: no contact was found")
    rest = np.asarray(found.contact_angle)[int(np.argmin(np.abs(np.asarray(found.y))))]
    if np.all(rest > STANDING):
        raise InputError(
            "the wheelset does not fit between the rails: at rest both flanges stand on them; gauge is too small for flange_back, or not in metres"
        )
