"""The arguments of public functions by their names: what they may be (`checks`), and `guarded`, which refuses the rest.

What a vehicle, a damper or a track may be is said where it is defined, which adds its name here.
"""

import functools
import inspect
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from .checks import (
    FLAG,
    Range,
    Rising,
    Rule,
    Samples,
    a_function,
    a_name,
    a_path,
    a_table,
    from_zero,
    positive,
    shown,
    some_names,
    traced,
    whole,
)
from .errors import InputError

F = TypeVar("F", bound=Callable[..., Any])

SPEED = positive("m/s", axes=1, why=": creepage is a ratio to the speed")


def a_state(key: str, value: Any) -> None:
    """The state at the start: coordinates by name, or the whole."""
    for one, number in value.items() if hasattr(value, "items") else [("", value)]:
        Range(axes=2)(f"{key}: {one}" if one else key, number)


ONE_SPEED = SPEED._replace(axes=0)

#: name -> rule; functions say where they mean something else by a name
ARGUMENTS: dict[str, Any] = {
    # speeds, times, numbers
    "speed": SPEED,
    "speeds": Rising(SPEED, 1),
    "lowest": ONE_SPEED,
    "highest": ONE_SPEED,
    "highest_speed": ONE_SPEED,
    "low": ONE_SPEED,
    "high": ONE_SPEED,
    "duration": positive("s"),
    "dt": positive("s"),
    "sample": positive("s"),
    "settle": from_zero("s"),
    "rate": positive("m/s²"),
    "sampling_rate": positive("Hz"),
    "sample_rate": positive("Hz"),
    "frequency": Range("Hz", axes=9),
    "amplitude": positive("m"),
    "initial": a_state,
    "chunk": whole(1),
    "wheelset": whole(0),
    "steps": whole(1),
    "largest_step": positive(),
    "symmetric": FLAG,
    # tracks and spectra
    "distance": Range("m", axes=9),
    "shortest": positive("m"),
    "longest": positive("m"),
    "points": whole(16),
    "segment": positive("m"),
    # ride
    "acceleration": Samples("m/s²"),
    "exponent": positive(),
    "power": positive(),
    "along": Range("m", axes=1),
    "height": Range("m", axes=1),
    "prudhomme_factor": positive(),
    "axle_load": positive("N", axes=1),
    "bogie_mass": positive("kg", axes=1),
    "section_length": positive("m"),
    "margin": from_zero("s"),
    "hunting_frequency": positive("Hz"),
    "minimum_sections": whole(1),
    # contact
    "load": positive("N", axes=1),
    "wheel_radius": positive("m", axes=1),
    "rail_head_radius": positive("m", axes=1),
    "wheel_profile_radius": Range("m", axes=1, infinite=True),
    "youngs_modulus": positive("Pa", axes=1),
    "poisson": Range("1", 0.0, 0.5, axes=1),
    "ratio": Range("1", 0.1, 10.0, axes=1, why=": Kalker's table ends there"),
    # names, files, choices
    "name": a_name,
    "direction": a_name,
    "channel": a_name,
    "parameter": a_name,
    "source": a_name,
    "title": a_name,
    "record": some_names,
    "reduce": some_names,
    "folder": a_path,
    "out": a_path,
    "name_or_path": a_path,
    "function": a_function,
    "progress": a_function,
    "traced": FLAG,
    "dynamics": FLAG,
    "mean": FLAG,
    "columns": a_table,
    "units": a_table,
    "weightings": a_table,
    # studies
    "seed": whole(0),
    "samples": whole(1),
    "tolerance": Range("1", 0.0, 1.0, open=True),
    "most_steps": whole(1),
    "tighten": FLAG,
    "bounds": Rising(from_zero(), 2, 2),
    "degree": whole(0),
    "mode": whole(0),
    "start": from_zero("s"),
    "stop": positive("s"),
    "slow": positive(),
    "magnified": positive(),
}


def _in_order(low: str, high: str, first: Any, second: Any) -> None:
    if not traced((first, second)) and not np.all(np.asarray(first, float) < np.asarray(second, float)):
        raise InputError(f"{low} must be below {high}, not {shown(first)} and {shown(second)}")


def guarded(*between: tuple[str, str], **own: Rule | None) -> Callable[[F], F]:
    """A function whose arguments are checked by the rules of their names (`ARGUMENTS`), or by its `own`; each pair of
    names `between` must be in that order. A default passes, and what has the rule None, which the function checks itself."""

    def decorate(function: F) -> F:
        given = inspect.signature(function).parameters
        rules = {name: own.get(name, ARGUMENTS.get(name)) for name in given}
        defaults = {name: parameter.default for name, parameter in given.items()}
        by_place = [name for name, parameter in given.items() if parameter.kind is parameter.POSITIONAL_OR_KEYWORD]

        @functools.wraps(function)
        def refusing(*arguments: Any, **named: Any) -> Any:
            placed = dict(zip(by_place, arguments, strict=False)) if arguments else {}
            for key, value in (placed | named).items():
                rule = rules.get(key)
                if rule is not None and value is not defaults[key]:
                    rule(key, value)
            for low, high in between:
                ends = [placed.get(end, named.get(end, defaults[end])) for end in (low, high)]
                if not any(end is None or end is inspect.Parameter.empty for end in ends):
                    _in_order(low, high, *ends)
            return function(*arguments, **named)

        refusing.rules = rules  # type: ignore[attr-defined]
        return refusing  # type: ignore[return-value]

    return decorate
