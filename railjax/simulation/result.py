"""`Simulation`: what `simulate` returns, how it is read, printed and labelled."""

from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
from jaxtyping import Array, Float, Int

from ..base.arguments import ARGUMENTS
from ..base.checks import Kind
from ..base.errors import InputError
from ..base.failed_lanes import ends
from ..base.fields import structure
from ..base.typing import Number
from ..base.units import KMH
from .blocks import Sampled
from .channels import CHANNELS, absent, check_channel, has_channel, places_of
from .speed import SpeedProfile

if TYPE_CHECKING:
    import xarray


class Result(IntEnum):
    """What became of a lane."""

    OK = 0
    DIVERGED = 1  # a displacement beyond 1 m or 1 rad, or not a number
    STEP_TOO_LARGE = 2  # dt beyond what RK4 holds at this speed: numbers are not to be used


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Simulation:
    """Result of `simulate`. Arrays have time first, then floor point, bogie or wheelset (n·m), then lanes.

    `channels` holds the recorded time histories, `reductions` the sums over the run ("rms:carbody_acceleration"), `final` the
    state at the end, `code` a `Result` per lane. Indexing by name reads either, and any other channel as well where the states
    were kept: of a run alone, and of batches whose states take up to 1 MiB; not of what was made inside `jax.jit`, `vmap` or `grad`.
    """

    time: Float[Array, "samples"]  # s
    channels: dict[str, Float[Array, "samples ..."]]  # SI, units as in `railjax.CHANNELS`
    reductions: dict[str, Float[Array, "..."]]  # SI
    final: Float[Array, "states ..."]  # SI: m, rad, m/s, rad/s
    code: Int[Array, "..."]
    speed: Number  # m/s
    dt: Number  # s
    sampled: Sampled | None = None  # what further channels are read off
    vehicle_name: str = structure("")

    def __getitem__(self, name: str) -> Float[Array, "..."]:
        if name in self.channels:
            return self.channels[name]
        if name in self.reductions:
            return self.reductions[name]
        return self._later(name)

    def _later(self, name: str) -> Float[Array, "..."]:
        """A channel that `record` did not name, read now and kept."""
        if ":" in name:
            raise InputError(f"{name!r} was not summed up: name it in simulate(..., reduce=[{name!r}])")
        check_channel(name)
        if self.sampled is None:
            raise InputError(
                f"{name!r} was not recorded, and the states of a large batch, or of a run inside jax.jit, vmap or grad, are not "
                f"kept: name it in simulate(..., record=[{name!r}])"
            )
        vehicle = self.sampled.parameters[0]
        if not has_channel(vehicle, name):
            raise InputError(f"channel {name!r}: {absent(vehicle, name)}")
        read = self.__dict__.setdefault("_read", {})  # no field: not a part of the pytree
        if name not in read:
            read |= {one: jax.device_put(values) for one, values in self.sampled.channels((name,)).items()}
        return read[name]

    @property
    def ok(self) -> Array:
        """True where the lane's numbers can be used."""
        return self.code == Result.OK

    def __str__(self) -> str:
        shape = self.code.shape
        time, code = np.asarray(self.time), np.asarray(self.code)  # NumPy's functions need no compilation
        duration = float(time[-1] + (time[1] - time[0] if len(time) > 1 else 0.0))
        lanes = f"{shape[0]} lanes, " if shape else ""
        lines = [f"Simulation of {self.vehicle_name or 'a vehicle'}: {lanes}{duration:g} s in steps of {float(self.dt):g} s"]
        if not isinstance(self.speed, SpeedProfile):
            low, high = float(np.min(self.speed)) * KMH, float(np.max(self.speed)) * KMH
            lines[0] += f", {low:.1f} km/h" if low == high else f", {low:.1f} to {high:.1f} km/h"
        for name, values in self.channels.items():
            _, peak = ends(np.abs(values))
            lines.append(f"  {name} {tuple(values.shape)}: peak {peak:.4g} {CHANNELS[name].unit}")
        for name, values in self.reductions.items():
            low, high = ends(values)
            span = f"{low:.4g}" if low == high else f"{low:.4g} to {high:.4g}"
            lines.append(f"  {name}: {span} {CHANNELS[name.split(':')[1]].unit}")
        for result in Result:
            count = int(np.sum(code == result))
            if result is not Result.OK and count:
                lines.append(f"  {result.name.lower().replace('_', ' ')}: {count} of {self.code.size} lane(s)")
        return "\n".join(lines)

    def to_xarray(self) -> "xarray.Dataset":
        """A labelled dataset: dimensions time (s), floor, bogie, wheelset, wheel, lane; units in the attributes."""
        import xarray

        lane = ("lane",) if self.code.ndim else ()
        variables: dict[str, Any] = {}
        for name, values in (self.channels | self.reductions).items():
            how, _, channel = name.rpartition(":")
            unit, part, _ = CHANNELS[channel]
            time = () if how else ("time",)
            inner = (part,) if values.ndim > len(time) + len(lane) else ()
            variables[name.replace(":", "_")] = ((*time, *inner, *lane), np.asarray(values), {"units": unit})
        variables["code"] = (
            lane,
            np.asarray(self.code),
            {"meaning": ", ".join(f"{r.value} {r.name.lower()}" for r in Result)},
        )
        coordinates: dict[str, Any] = {"time": ("time", np.asarray(self.time), {"units": "s"})}
        sizes = {name: size for names, values, *_ in variables.values() for name, size in zip(names, values.shape, strict=True)}
        coordinates |= {part: names for part, size in sizes.items() if (names := places_of(part, size)) is not None}
        if not isinstance(self.speed, SpeedProfile):
            speed = np.asarray(self.speed)
            coordinates["speed"] = (lane if speed.ndim else (), speed, {"units": "m/s"})
        attributes = {"vehicle": self.vehicle_name, "dt": float(self.dt)}
        return xarray.Dataset(variables, coordinates, attributes)


ARGUMENTS["run"] = Kind(Simulation, "what railjax.simulate returns")
