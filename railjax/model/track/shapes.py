"""Tracks: lateral alignment eta (m) over distance (m). Wheelset i sees eta(v t + s_i), delayed by its position.

A track is a pytree with one method, `seen_from(offset)`, that returns eta(start + offset) as a function of `start`: the
offsets are fixed over a run, so what depends on them alone is computed once.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from ...base.arguments import ARGUMENTS, guarded
from ...base.checks import shown
from ...base.errors import InputError
from ...base.fields import check_numbers, parameter
from ...base.pytrees import registered
from ...base.typing import Number

Distances = Float[Array, "..."]
Alignment = Callable[[Distances], Distances]


@runtime_checkable
class Track(Protocol):
    """What `simulate` asks of a track."""

    def seen_from(self, offset: Distances) -> Alignment:
        """eta(start + offset) as a function of start; both in m, broadcast against each other."""
        ...


def check_track(track: Track) -> None:
    """Refuse numbers that are not finite or have the wrong sign, where they are known; fields of a track of one's own that declare
    nothing may have either."""
    if dataclasses.is_dataclass(track):
        check_numbers(track, "track", undeclared="signed")


def a_track(key: str, value: Any) -> None:
    """A track with an alignment, no spectrum."""
    if isinstance(value, type) or not isinstance(value, Track):
        hint = f"; write railjax.RandomTrack({value!r}) for a spectrum" if isinstance(value, str) else ""
        raise InputError(f"{key} must be a track, like railjax.SinusoidTrack(5e-3, 20.0), not {shown(value)}{hint}")
    check_track(value)


ARGUMENTS["track"] = a_track


@guarded()
def alignment(track: Track, distance: ArrayLike) -> Distances:
    """Lateral alignment eta in m at any `distance` (m, of any shape) along the track."""
    distance = jnp.asarray(distance, float)
    return track.seen_from(jnp.zeros_like(distance))(distance)


@registered
@dataclass(frozen=True)
class TangentTrack:
    """Straight, without irregularity."""

    def seen_from(self, offset: Distances) -> Alignment:
        """eta = 0, m, whatever `offset` (m) and distance."""
        return lambda start: jnp.zeros(jnp.broadcast_shapes(offset.shape, jnp.shape(start)), offset.dtype)


@registered
@dataclass(frozen=True)
class SinusoidTrack:
    """Periodic irregularity eta = A sin(2 pi s/L): amplitude A and wavelength L in m.

    The paper gives A (5 and 10 mm in figs. 16-18) but not L. Wavelengths of 6 to 60 m are felt by a coach at 50 m/s.
    """

    amplitude: Number = parameter("m", "A", "amplitude of the alignment", signed=True)
    wavelength: Number = parameter("m", "L", "wavelength of the alignment", positive=True)

    def seen_from(self, offset: Distances) -> Alignment:
        """A sin(kappa (start + offset)), by the addition theorem: two sines a start, whatever the number of offsets."""
        wavenumber = 2.0 * jnp.pi / self.wavelength
        sine, cosine = (
            self.amplitude * jnp.sin(wavenumber * offset),
            self.amplitude * jnp.cos(wavenumber * offset),
        )

        return lambda start: jnp.cos(wavenumber * start) * sine + jnp.sin(wavenumber * start) * cosine


@registered
@dataclass(frozen=True)
class BumpTrack:
    """A single period fixed in space, tangent to the track at both ends, so that its duration follows the speed.

    eta = A/2 (1 - cos(2 pi (s - start)/L)) for start <= s <= start + L, 0 elsewhere; A is the peak, m. The paper's "single
    period sinusoid function which considers the irregularity tangent to the track" is read as this.
    """

    amplitude: Number = parameter("m", "A", "peak of the bump", signed=True)
    length: Number = parameter("m", "L", "length of the bump", positive=True)
    start: Number = parameter("m", "", "distance at which the bump begins", 20.0, signed=True)

    def seen_from(self, offset: Distances) -> Alignment:
        """The bump at start + `offset`, m: a function of the distance (m)."""

        def at(start: Distances) -> Distances:
            along = jnp.clip((start + offset - self.start) / self.length, 0.0, 1.0)
            return 0.5 * self.amplitude * (1.0 - jnp.cos(2.0 * jnp.pi * along))

        return at
