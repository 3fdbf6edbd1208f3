"""Values in vehicle files: their kinds, and [contact.hertz]. Every error is one line that
names file, key and fix.
"""

import dataclasses
import math
from typing import Any

from ..base.checks import shown
from ..base.errors import InputError, nearest
from ..base.fields import a_choice, given_number

Table = dict[str, Any]


def structure(entry: dataclasses.Field, value: Any, name: str) -> Any:
    """A value that is no number: a pattern of positions, whether a body is held, the contact law."""
    if isinstance(entry.default, tuple):
        if not isinstance(value, list) or not value:
            raise InputError(f"{name} must be a list of positions from front to rear, like [1, -1]")
        pattern = tuple(given_number(position, name) for position in value)
        if list(pattern) != sorted(pattern, reverse=True) or len(set(pattern)) != len(pattern):
            raise InputError(f"{name} must fall from front to rear, like [1, -1], not {shown(value)}")
        return pattern
    if isinstance(entry.default, bool):
        if not isinstance(value, bool):
            raise InputError(f"{name} must be true or false, not {shown(value)}")
        return value
    a_choice(name, value, entry.metadata["one_of"])
    return value


HERTZ_KEYS = {
    "rail_head_radius_m": "rail_head_radius",
    "wheel_profile_radius_m": "wheel_profile_radius",
    "youngs_modulus_GPa": "youngs_modulus",
    "poisson_ratio": "poisson",
}


def hertz(table: Any, name: str) -> Table:
    """Arguments of `kalker.creep_coefficients` from [contact.hertz]."""
    if not isinstance(table, dict):
        raise InputError(f"{name} must be a table, written [contact.hertz]")
    values = {}
    for key, value in table.items():
        if key not in HERTZ_KEYS:
            raise InputError(f"{name}: unknown key {key!r}{nearest(key, HERTZ_KEYS)}")
        given = given_number(value, f"{name}.{key}") * (1e9 if key.endswith("GPa") else 1.0)
        if HERTZ_KEYS[key] == "poisson":
            if not 0.0 <= given <= 0.5:
                raise InputError(f"{name}.{key} must lie between 0 and 0.5, not {given:g}")
        elif given == 0.0 or (given < 0.0 and HERTZ_KEYS[key] != "wheel_profile_radius"):
            raise InputError(f"{name}.{key} must be positive, not {given:g}")
        values[HERTZ_KEYS[key]] = given
    if "rail_head_radius" not in values:
        raise InputError(f"{name} needs rail_head_radius_m (0.3 for a UIC 60 rail)")
    if 1.0 / values["rail_head_radius"] + 1.0 / values.get("wheel_profile_radius", math.inf) <= 0.0:
        raise InputError(f"{name}.wheel_profile_radius_m: a hollow wheel must be wider than the rail head")
    return values
