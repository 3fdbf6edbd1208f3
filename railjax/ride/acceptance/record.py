"""The record of a running test: measured histories, or what a test would have measured in a simulated run."""

from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ...base.arguments import guarded
from ...base.checks import FLAG
from ...base.errors import InputError
from ...base.typing import Number
from ...model.kinematics import deflections, layout
from ...model.vehicle import Vehicle
from ...simulation.channels import has_wheels
from ...simulation.simulate import Simulation
from ...simulation.speed import SpeedProfile
from .criteria import PLACES, SAMPLING

Values = Float[np.ndarray, "..."]


@dataclass(frozen=True)
class RunningRecord:
    """Time histories of a run at constant speed, simulated or measured, in SI units.

    `speed` in m/s (a number, or one per lane), `sampling_rate` in Hz, arrays (samples, parts, *lanes): `guiding_force` SumY of
    each wheelset in N, lateral accelerations in m/s^2 of the bogie frames over each axle and of the car body over each bogie,
    `derailment_quotient` Y/Q and `wheel_lateral_force` Y of each wheel (right and left of the first wheelset, of the second, ...), Y positive outwards; None where
    it was not measured. `ok` is False for lanes to be left out (a diverged simulation).
    """

    speed: Number
    sampling_rate: float
    guiding_force: Any = None  # N
    bogie_acceleration: Any = None  # m/s^2
    carbody_acceleration: Any = None  # m/s^2
    derailment_quotient: Any = None  # Y/Q, dimensionless
    wheel_lateral_force: Any = None  # Y, N
    ok: Any = True  # per lane: a number or bool, False leaves it out
    name: str = ""

    @property
    def lanes(self) -> bool:
        """Whether it is a batch."""
        return any(np.ndim(getattr(self, name)) > 2 for name in PLACES)


@guarded(curves=FLAG)
def acceptance_channels(vehicle: Vehicle, *, curves: bool = False) -> tuple[str, ...]:
    """The channels that `acceptance` (with `curves` `zone_acceptance`) reads of a run of this vehicle: `simulate(..., record=acceptance_channels(vehicle))`."""
    groups = layout(vehicle)
    floor = ("floor_acceleration",) if "carbody_y" in groups else ()
    wheels = ("derailment_quotient", *(("wheel_lateral_force",) if curves else ())) if has_wheels(vehicle) else ()
    rolls = tuple(name for name in ("carbody_phi", "bogie_phi") if curves and name in groups)
    return ("guiding_force", *wheels, *floor, *(name + "_acceleration" for name in groups if name.startswith("bogie")), *rolls)


def record_of_run(vehicle: Vehicle, run: Simulation) -> RunningRecord:
    """What a test would have measured in a simulated run; raises `InputError` where a channel is missing."""
    if isinstance(run.speed, SpeedProfile):
        raise InputError("acceptance needs a run at constant speed, not a SpeedProfile")
    missing = [name for name in acceptance_channels(vehicle) if name not in run.channels]
    if missing:
        raise InputError(f"the run lacks {', '.join(missing)}: simulate with record=railjax.acceptance_channels(vehicle)")
    if len(run.time) < 2:
        raise InputError("the run has fewer than two samples")
    force = jnp.asarray(run["guiding_force"])
    pattern = vehicle.geometry
    # time as the first of the trailing axes, as if its instants were lanes
    still = jnp.zeros((len(pattern.bogie_pattern), len(pattern.axle_pattern), len(force), *force.shape[2:]), force.dtype)
    groups = {"wheelset_y": still, "wheelset_psi": still}
    for name in (name for name in acceptance_channels(vehicle) if name.startswith("bogie")):
        groups[name.removesuffix("_acceleration")] = jnp.moveaxis(jnp.asarray(run[name]), 1, 0)
    return RunningRecord(
        speed=run.speed,
        sampling_rate=(len(run.time) - 1) / float(run.time[-1] - run.time[0]),
        guiding_force=force,
        bogie_acceleration=None if vehicle.bogie.held else _over_axles(vehicle, groups),
        carbody_acceleration=None if vehicle.carbody.held else jnp.asarray(run["floor_acceleration"])[:, [0, -1]],
        derailment_quotient=jnp.asarray(run["derailment_quotient"]) if has_wheels(vehicle) else None,
        ok=run.ok,
        name=vehicle.name,
    )


def _over_axles(vehicle: Vehicle, groups: dict[str, Any]) -> Float[Array, "samples axles *lanes"]:
    """Bogie frame at the axle boxes, y_b'' ± a psi_b'' + h_ob phi_b'': what the primary springs see with wheelsets at rest."""
    values = deflections(vehicle, groups)["primary_y"]
    return jnp.moveaxis(values.reshape((-1, *values.shape[2:])), 0, 1)


def check_record(record: RunningRecord) -> tuple[dict[str, Float[np.ndarray, "..."]], int, Bool[np.ndarray, "lanes"]]:
    """The signals as (samples, parts, lanes), how many lanes and which of them count; a single run is one lane.

    Raises `InputError` for what cannot be assessed.
    """
    given = {name: getattr(record, name) for name in PLACES if getattr(record, name) is not None}
    signals = {name: np.asarray(values, float) for name, values in given.items()}
    if not signals:
        raise InputError(f"the record is empty: give at least one of {', '.join(PLACES)}")
    if not (np.isfinite(record.sampling_rate) and record.sampling_rate >= SAMPLING * (1.0 - 1e-9)):
        raise InputError(
            f"sampling_rate must be {SAMPLING:g} Hz or more, not {record.sampling_rate:g}: simulate with sample={1.0 / SAMPLING:g}"
        )
    for name, values in signals.items():
        if values.ndim not in (2, 3) or not values.size:
            raise InputError(
                f"{name} must have shape (samples, {PLACES[name]}s) or (samples, {PLACES[name]}s, lanes), not {values.shape}"
            )
    shapes = {name: (len(values), *values.shape[2:]) for name, values in signals.items()}
    if len(set(shapes.values())) > 1:
        raise InputError(f"samples and lanes must agree: {', '.join(f'{n} has {s}' for n, s in shapes.items())}")
    signals = {name: values.reshape((*values.shape[:2], -1)) for name, values in signals.items()}
    lanes = next(iter(signals.values())).shape[2]
    ok = np.broadcast_to(np.asarray(record.ok, bool), (lanes,))
    for name, values in signals.items():
        bad = np.argwhere(~np.isfinite(values) & ok)
        if len(bad):
            raise InputError(
                f"{name} is not finite at sample {bad[0][0]} of {PLACES[name]} {bad[0][1] + 1}; cut such samples out"
            )
    return signals, lanes, ok
