"""What the numbers of a vehicle may be: sign and range of each, and what no single one can tell. Files and functions ask here."""

import dataclasses
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from ..base.arguments import ARGUMENTS
from ..base.checks import Kind
from ..base.errors import InputError
from ..base.fields import check_numbers
from .vehicle import OPTIONAL, PARTS, BumpStop, LateralDamper, Vehicle, YawDamper


def check_values(vehicle: Vehicle) -> None:
    """Refuse numbers of a vehicle that have the wrong sign or are none, and what no single number can tell, where they are known.

    What may be zero may be negative here, as differences step to both sides of zero; files refuse it. A lane that is NaN passes, as results mark it. Raises `InputError`.
    """
    known = True
    for part in PARTS:
        there = getattr(vehicle, part)
        if there is not None and not getattr(there, "held", False):
            known &= check_numbers(there, part, scattered=True)
    if known:
        consistent({part: _on_host(getattr(vehicle, part)) for part in PARTS}, "vehicle")
        if vehicle.bump_stop is not None:
            _bump_stop(np.asarray(vehicle.bump_stop.travel, float), np.asarray(vehicle.bump_stop.force, float), "vehicle")


def _on_host(part: Any) -> Any:
    """With NumPy's arrays in place of JAX's, each of whose comparisons would be compiled."""
    if not any(value.__class__ is not float and isinstance(value, jax.Array) for value in getattr(part, "__dict__", {}).values()):
        return part
    return jax.tree.map(np.asarray, part)


def _any(condition: Any) -> bool:
    """Of a comparison of numbers, or of lanes."""
    return condition if condition.__class__ is bool else bool(np.any(condition))


def consistent(parts: dict[str, Any], where: str) -> None:
    """What no single key can tell; the bump stop's table is `bump_stop_table`'s."""
    geometry, contact, bogie = parts["geometry"], parts["contact"], parts["bogie"]
    for key, pattern, spread in (
        ("bogie_pattern", geometry.bogie_pattern, geometry.half_pivot_distance),
        ("axle_pattern", geometry.axle_pattern, geometry.half_wheelbase),
    ):
        if len(pattern) > 1 and _any(spread <= 0.0):
            raise InputError(f"{where}: geometry.{key} has {len(pattern)} entries, so their half distance must be positive")
    if not bogie.held and _any(geometry.half_secondary == 0.0):
        raise InputError(f"{where}: geometry.half_secondary must be positive, as roll and yaw act on the secondary springs by it")
    if bogie.held and not parts["carbody"].held:
        raise InputError(f"{where}: bogie.held without carbody.held leaves the car body on fixed springs; hold both or none")
    creeps = contact.creep_longitudinal, contact.creep_lateral
    if contact.law != "linear" and _any(creeps[0] == 0.0) and _any(np.maximum(*creeps) == 0.0):
        raise InputError(f"{where}: contact.creep_longitudinal and creep_lateral are both zero; use law = 'linear' for that")
    if parts["cross_bracing"] is not None and len(geometry.axle_pattern) != 2:
        raise InputError(
            f"{where}: [cross_bracing] ties the two wheelsets of a bogie, but geometry.axle_pattern has {len(geometry.axle_pattern)}; leave it out"
        )
    for part in OPTIONAL:
        if part != "cross_bracing" and parts[part] is not None and bogie.held:
            raise InputError(f"{where}: [{part}] acts between car body and bogie, but the bogie is held; leave it out")
    if parts["yaw_damper"] is not None:
        _blow_off(parts["yaw_damper"], "yaw_damper", parts["yaw_damper"].damping, where)
    if parts["lateral_damper"] is not None:
        _blow_off(parts["lateral_damper"], "lateral_damper", parts["secondary"].damping_y, where)


def _blow_off(valve: YawDamper | LateralDamper, part: str, damping: Any, where: str) -> None:
    initial = "yaw_damper.damping" if part == "yaw_damper" else "secondary.damping_y"
    velocity, beyond = valve.blow_off_velocity, valve.damping_beyond
    if (velocity is None) != (beyond is None):
        given, missing = ("blow_off_velocity", "damping_beyond") if beyond is None else ("damping_beyond", "blow_off_velocity")
        raise InputError(f"{where}: {part}.{given} also needs {part}.{missing}")
    # Python's vehicles may be scattered beyond it
    if beyond is not None and where != "vehicle" and _any(beyond > damping):
        raise InputError(f"{where}: {part}.damping_beyond must not exceed {initial}, as a valve that opens softens the damper")
    if isinstance(valve, YawDamper) and valve.series_stiffness is not None and beyond is not None and _any(beyond == 0.0):
        raise InputError(f"{where}: yaw_damper.damping_beyond must be positive beside series_stiffness, which would run away")


def bump_stop_table(stop: BumpStop, where: str) -> BumpStop:
    """The bump stop with its table checked, and without the point (0, 0), which goes without saying."""
    travel, force = stop.travel, stop.force
    if len(travel) != len(force):
        raise InputError(f"{where}: bump_stop.travel has {len(travel)} entries and force {len(force)}; they must be pairs")
    if travel[0] == 0.0 and force[0] == 0.0 and len(travel) > 1:
        travel, force = travel[1:], force[1:]
    _bump_stop(travel, force, where)
    return dataclasses.replace(stop, travel=travel, force=force)


def _bump_stop(travel: Float[np.ndarray, "points ..."], force: Float[np.ndarray, "points ..."], where: str) -> None:
    if len(travel) != len(force):
        raise InputError(f"{where}: bump_stop.travel has {len(travel)} entries and force {len(force)}; they must be pairs")
    further, more = np.diff(travel, axis=0, prepend=0.0), np.diff(force, axis=0, prepend=0.0)
    if not np.all(further > 0.0):
        raise InputError(f"{where}: bump_stop.travel must rise from entry to entry, from above zero (or from 0 at 0 N)")
    if not np.all(more >= 0.0):
        raise InputError(f"{where}: bump_stop.force must not fall from entry to entry")
    with np.errstate(over="ignore"):
        if not np.all(np.isfinite(more.T / further.T)):  # lanes first, then points
            raise InputError(f"{where}: bump_stop.force rises too steeply; check the units of travel and force")


VEHICLE = Kind(Vehicle, "a vehicle, as railjax.load_vehicle gives it")


def a_vehicle(key: str, value: Any) -> None:
    """A vehicle whose numbers have the sign that they must have; lanes of NaN pass, and are marked in results."""
    VEHICLE(key, value)
    check_values(value)


ARGUMENTS["vehicle"] = a_vehicle
