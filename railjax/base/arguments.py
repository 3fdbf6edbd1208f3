"""The arguments of public functions by their names: what they may be (`checks`)."""

from typing import Any

from .checks import (
    FLAG,
    Kind,
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
    whole,
)
from .errors import InputError

SPEED = positive("m/s", axes=1, why=": creepage is a ratio to the speed")


def a_vehicle(key: str, value: Any) -> None:
    """A vehicle whose numbers have the sign that they must have; lanes of NaN pass, and are marked in results."""
    from ..model.vehicle import Vehicle
    from ..vehicles.values import check_values

    if not isinstance(value, Vehicle):
        raise InputError(f"{key} must be a vehicle, as railjax.load_vehicle gives it, not {shown(value)}")
    check_values(value)


def a_damper(key: str, value: Any) -> None:
    """A law in place of rho_cy."""
    from ..model.damper import check_damper

    check_damper(value)


def a_track(key: str, value: Any) -> None:
    """A track with an alignment, no spectrum."""
    from ..model.track.shapes import Track, check_track

    if isinstance(value, type) or not isinstance(value, Track):
        hint = f"; write railjax.RandomTrack({value!r}) for a spectrum" if isinstance(value, str) else ""
        raise InputError(f"{key} must be a track, like railjax.SinusoidTrack(5e-3, 20.0), not {shown(value)}{hint}")
    check_track(value)


def an_excitation(key: str, value: Any) -> None:
    """A spectrum, a realisation of one, or waves."""
    from ..model.track.sampled import SampledTrack
    from ..model.track.shapes import check_track
    from ..model.track.spectra import spectrum
    from ..ride.frequency import Excitation

    if isinstance(value, SampledTrack):
        check_track(value)
    elif not isinstance(value, Excitation):
        spectrum(value)


def a_speed(key: str, value: Any) -> None:
    """A number, one per lane, or a profile over time."""
    from ..simulation.speed import SpeedProfile, in_order

    if isinstance(value, SpeedProfile):
        in_order(key, value)
    else:
        SPEED(key, value)


def an_acceleration(key: str, value: Any) -> None:
    """A simulation, records by direction, or one record."""
    from ..simulation.result import Simulation

    if not isinstance(value, Simulation):
        for direction, record in value.items() if hasattr(value, "items") else [(key, value)]:
            Samples("m/s²")(direction, record)


def a_state(key: str, value: Any) -> None:
    """The state at the start: coordinates by name, or the whole."""
    for one, number in value.items() if hasattr(value, "items") else [("", value)]:
        Range(axes=2)(f"{key}: {one}" if one else key, number)


ONE_SPEED = SPEED._replace(axes=0)

#: name -> rule; functions say where they mean something else by a name
ARGUMENTS: dict[str, Rule] = {
    # things
    "vehicle": a_vehicle,
    "damper": a_damper,
    "track": a_track,
    "run": Kind("simulation.result.Simulation", "what railjax.simulate returns"),
    "response": Kind("ride.frequency.FrequencyResponse", "what railjax.frequency_response returns"),
    "motion": Kind(
        "simulation.result.Simulation stability.hunting.limit_cycles.LimitCycle stability.modes.Modes",
        "a Simulation, a LimitCycle of hunting_branch or Modes",
    ),
    "hopf": Kind("stability.linear_critical.LinearCritical", "what railjax.linear_critical returns"),
    "quantity": Kind("tuning.quantity.Quantity", "one of railjax.objectives"),
    "scatter": Kind("tuning.robust.Scatter", "a railjax.Scatter"),
    # speeds, times, numbers
    "speed": a_speed,
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
