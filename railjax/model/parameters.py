"""A vehicle's parameters by their dotted names, and vehicles as compiled functions are handed them."""

import dataclasses
from collections.abc import Iterator
from typing import Any

from ..base.arguments import guarded
from ..base.checks import a_name
from ..base.errors import InputError, closest
from ..base.packing import as_numbers
from .consistency import VEHICLE
from .vehicle import OPTIONAL, PARTS, Vehicle

#: what the table of a vehicle on profiles has in its place
OF_PROFILES = tuple(
    f"contact.{name}"
    for name in ("conicity", "creep_longitudinal", "creep_lateral", "creep_lateral_spin", "creep_spin", "flange_clearance")
)


@guarded(vehicle=VEHICLE)
def replace(vehicle: Vehicle, **changes: Any) -> Vehicle:
    """A copy with some parameters changed, named by their path with `__` for the dot.

    >>> stiffer = replace(coach, primary__stiffness_x=4e6, contact__law="smooth")  # doctest: +SKIP

    Raises `InputError` for a path that does not exist.
    """
    for path, value in changes.items():
        vehicle = set_parameter(vehicle, path.replace("__", "."), value)
    return vehicle


@guarded(vehicle=VEHICLE, path=a_name)
def get_parameter(vehicle: Vehicle, path: str) -> Any:
    """The value at a dotted path, `get_parameter(coach, "primary.stiffness_x")` (SI).

    Raises `InputError` for a path that does not exist, in any vehicle or in this one.
    """
    value: Any = vehicle
    for name in path.split("."):
        if value is None and path in _paths():
            part = path.split(".")[0]
            raise InputError(f"no parameter {path!r}: this vehicle has no {part.replace('_', ' ')}")
        if not dataclasses.is_dataclass(value) or name not in {f.name for f in dataclasses.fields(value)}:
            raise _no_such_parameter(path)
        value = getattr(value, name)
    return value


@guarded(vehicle=VEHICLE, path=a_name)
def set_parameter(vehicle: Vehicle, path: str, value: Any) -> Vehicle:
    """A copy of the vehicle with one parameter changed.

    Args:
        vehicle: the vehicle, which stays as it is.
        path: dotted name of the parameter, such as "primary.stiffness_x".
        value: its new value, in SI; an array of shape `(lanes,)` makes a batch of vehicles.

    Raises:
        InputError: for a path that does not exist, in any vehicle or in this one, and for what profiles have in its place.
    """
    get_parameter(vehicle, path)  # refuses a path that does not exist
    if vehicle.profiles is not None and path in OF_PROFILES:
        raise InputError(
            f"{path} of a vehicle on profiles is theirs and would change nothing; make it anew with railjax.with_profiles"
        )
    return _set(vehicle, path.split("."), value)


def _set(part: Any, names: list[str], value: Any) -> Any:
    head, *rest = names
    return dataclasses.replace(part, **{head: _set(getattr(part, head), rest, value) if rest else value})


def _no_such_parameter(path: str) -> InputError:

    near = closest(path, _paths())
    return InputError(f"no parameter {path!r} in a vehicle; the nearest is {near!r}")


def _paths() -> list[str]:
    """Dotted paths of all that a vehicle may have."""
    return [f"{part}.{f.name}" for part, kind in PARTS.items() for f in dataclasses.fields(kind) if "unit" in f.metadata]


@guarded(vehicle=VEHICLE)
def parameters(vehicle: Vehicle | None = None) -> Iterator[tuple[str, dataclasses.Field]]:
    """Dotted path and field (its metadata: unit, symbol, meaning) of every number that all vehicles have, or, given a
    vehicle, of every number (and table) of that one, with its optional parts."""
    for part, kind in PARTS.items():
        there = kind if vehicle is None else getattr(vehicle, part)
        if there is None or (vehicle is None and part in OPTIONAL):
            continue
        for entry in dataclasses.fields(kind):
            # what a class lacks has no default, so every vehicle gives it
            if "unit" in entry.metadata and getattr(there, entry.name, entry) is not None:
                yield f"{part}.{entry.name}", entry


def without_labels(vehicle: Vehicle) -> Vehicle:
    """The vehicle without name, note and provenance, so that two vehicles of one structure share compiled code."""
    profiles = None if vehicle.profiles is None else dataclasses.replace(vehicle.profiles, given=())
    return dataclasses.replace(vehicle, name="", note="", provenance=(), profiles=profiles)


def bare(vehicle: Vehicle, damper: Any) -> tuple[Vehicle, Any]:
    """The vehicle without labels, and the damper, all numbers as arrays: see `as_numbers`; each is quicker to hand over."""
    return as_numbers((without_labels(vehicle), damper))
