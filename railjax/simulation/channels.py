"""What can be recorded of a simulation: names, units, and how each is read off the vehicle's `Motion`."""

import math
from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..base.errors import InputError, closest
from ..model.contact.profile_contact import guiding_forces
from ..model.kinematics import FLOOR_POINTS, UNITS, is_one_stage, lateral_of_floor, layout
from ..model.motion import Motion
from ..model.vehicle import Vehicle

Values = Float[Array, "..."]


class Channel(NamedTuple):
    """A recordable quantity: `read` gives (*lanes), (points, *lanes), (n, *lanes), (n, m, *lanes) or (n, m, 2, *lanes) as `part` is
    carbody, floor, bogie, wheelset or wheel (right, left)."""

    unit: str
    part: str
    read: Callable[[Motion], Values]


def _coordinate(group: str, order: int) -> Callable[[Motion], Values]:
    # the first three of a `Motion` are coordinates, rates and accelerations
    return lambda instant: instant[:3][order][group]


def _coordinates() -> dict[str, Channel]:
    channels = {}
    for group, unit in UNITS.items():
        part = group.split("_")[0]
        for order, (suffix, per) in enumerate((("", ""), ("_rate", "/s"), ("_acceleration", "/s^2"))):
            channels[group + suffix] = Channel(unit + per, part, _coordinate(group, order))
    return channels


CHANNELS: dict[str, Channel] = _coordinates() | {
    # eq. (5), corrected (reading 1): by the equations of motion it is y_c'', and in a curve what an accelerometer measures in the
    # plane of the track, y_c'' + v² kappa - g theta
    "carbody_acceleration": Channel("m/s^2", "carbody", lambda instant: instant.specific["carbody_y"]),
    # lateral, over the leading bogie, in the centre, over the trailing bogie
    "floor_acceleration": Channel("m/s^2", "floor", lambda instant: lateral_of_floor(instant.vehicle, instant.specific)),
    "secondary_travel": Channel("m", "bogie", lambda instant: instant.deflection["secondary_y"]),
    "secondary_velocity": Channel("m/s", "bogie", lambda instant: instant.deflection_rate["secondary_y"]),
    "damper_force": Channel("N", "bogie", lambda instant: instant.damper_force),
    "primary_travel": Channel("m", "wheelset", lambda instant: instant.deflection["primary_y"]),
    "alignment": Channel("m", "wheelset", lambda instant: instant.alignment),
    "wheelset_on_track": Channel("m", "wheelset", lambda instant: instant.deflection["contact_y"] - instant.alignment),
    # force of the track on the wheelset: creep and flange
    "guiding_force": Channel("N", "wheelset", lambda instant: -instant.contact.lateral),
    "flange_force": Channel("N", "wheelset", lambda instant: -instant.contact.flange),
    # of the wheel that is nearer to sliding, on profiles
    "creep_saturation": Channel("1", "wheelset", lambda instant: instant.contact.saturation),
    # on profiles: Q, Y of a wheel on its rail, positive outwards, and Y/Q; the sum of Y, to the right, is the guiding force of the opposite sign
    "wheel_load": Channel("N", "wheel", lambda instant: _of_wheels(instant)[0]),
    "wheel_lateral_force": Channel("N", "wheel", lambda instant: _of_wheels(instant)[1]),
    "derailment_quotient": Channel("1", "wheel", lambda instant: _quotient(*_of_wheels(instant))),
}


def _of_wheels(instant: Motion) -> tuple[Values, Values]:
    load, lateral = guiding_forces(instant.vehicle, instant.contact, instant.wheels)
    return jnp.moveaxis(load, 0, 2), jnp.moveaxis(lateral, 0, 2)


def _quotient(load: Values, lateral: Values) -> Values:
    """Y/Q; 0 where the wheel has lifted off."""
    on = load > 0.0
    return jnp.where(on, lateral / jnp.where(on, load, 1.0), 0.0)


#: part -> names of its places, of parts whose places have names
PLACES = {"floor": FLOOR_POINTS}

#: channels of the bogie's suspension that a lone wheelset lacks
UNAVAILABLE = ("secondary_travel", "secondary_velocity", "damper_force")


def has_channel(vehicle: Vehicle, name: str) -> bool:
    """Whether this vehicle has it: held bodies have no channels."""
    shapes = layout(vehicle)
    parts = {group.split("_")[0] for group in shapes} | ({"bogie", "floor"} if "carbody_y" in shapes else set())
    parts |= {"floor"} if is_one_stage(vehicle) else set()
    if CHANNELS[name].part == "wheel":
        return has_wheels(vehicle)
    return CHANNELS[name].part in parts and not (name in UNAVAILABLE and len(parts) == 1)


def has_wheels(vehicle: Vehicle) -> bool:
    """Whether its wheels have channels: on profiles, and where forces are not those of the tangent at rest."""
    return vehicle.profiles is not None and vehicle.contact.law != "linear"


def absent(vehicle: Vehicle, name: str) -> str:
    """Why a vehicle lacks a channel, as the end of a message."""
    part = CHANNELS[name].part
    if part != "wheel":
        return f"this vehicle's {part} is held"
    return "the forces of single wheels are known on profiles only (railjax.with_profiles), and not with the linear contact law"


def places_of(part: str, count: int) -> list[str] | None:
    """Names of a part's places, where they have any."""
    if part == "wheel":
        return [f"{k // 2 + 1} {('right', 'left')[k % 2]}" for k in range(count)]
    return list(PLACES[part]) if part in PLACES else None


def shape_of(name: str, vehicle: Vehicle) -> tuple[int, ...]:
    """Shape of a channel before its lanes, as `Channel.read` gives it: (), (3,), (n,), (n, m) or (n, m, 2)."""
    n, m = len(vehicle.geometry.bogie_pattern), len(vehicle.geometry.axle_pattern)
    return {"carbody": (), "floor": (len(FLOOR_POINTS),), "bogie": (n,), "wheelset": (n, m), "wheel": (n, m, 2)}[
        CHANNELS[name].part
    ]


def rows_of_state(vehicle: Vehicle) -> dict[str, slice]:
    """Coordinates and rates, the channels that stand in the state: which of its rows they are."""
    rows, start = {}, 0
    for suffix in ("", "_rate"):
        for group, shape in layout(vehicle).items():
            rows[group + suffix] = slice(start, start := start + math.prod(shape))
    return rows


def rows_of_motion(vehicle: Vehicle) -> dict[str, slice]:
    """The other channels that this vehicle has, one below the other."""
    in_state, rows, start = rows_of_state(vehicle), {}, 0
    for name in CHANNELS:
        if name not in in_state and has_channel(vehicle, name):
            rows[name] = slice(start, start := start + math.prod(shape_of(name, vehicle)))
    return rows


#: how a channel can be summed up over a run without storing it
REDUCTIONS = ("rms", "mean", "peak")


def check_channel(name: str) -> str:
    """The name itself, or an `InputError` with the nearest one."""
    if name not in CHANNELS:
        near = closest(name, CHANNELS)
        raise InputError(f"unknown channel {name!r}; did you mean {near!r}?")
    return name


def check_linear_channel(name: str) -> str:
    """As `check_channel`, of what is read near straight running: forces of single wheels, which are not small there, are not."""
    if CHANNELS[check_channel(name)].part == "wheel":
        raise InputError(f"channel {name!r} is known in simulations only, not in frequency responses; simulate instead")
    return name


def parse_reduction(name: str) -> tuple[str, str]:
    """ "rms:carbody_acceleration" as its two halves."""
    how, _, channel = name.partition(":")
    if how not in REDUCTIONS or not channel:
        raise InputError(f"unknown reduction {name!r}: write one of {', '.join(r + ':channel' for r in REDUCTIONS)}")
    return how, check_channel(channel)
