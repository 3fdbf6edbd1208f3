"""What tracks given by samples share: a cubic B-spline over distance, its pytree, and its evaluation in the time loop.

    η(s) = g(s) a Σ_j c_j β³(s/h - j)

with the spacing h (m), the coefficients c_j (m), the scale factor a and the fade-in g. The spline is twice continuously
differentiable, so a run sees no kinks.
"""

import copy
import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ...base.arguments import guarded
from ...base.checks import Kind, Range, a_path, positive
from ...base.compilation import fence
from ...base.errors import InputError
from ...base.fields import optional, parameter, structure, table
from ...base.pytrees import registered_by_name
from ...base.typing import Number, Scalar
from .shapes import Alignment, Distances, alignment
from .spectra import TableSpectrum

T = TypeVar("T", bound="SampledTrack")

#: share of the fade-in that stays straight: 20 m of 50 m, so that the leading wheelset starts on straight track
STRAIGHT = 0.4

#: coefficients beyond the cells: a cell's value takes the coefficients at its ends and one further on either side
MARGIN = 3


@dataclass(frozen=True)
class SampledTrack:
    """Lateral alignment as a cubic spline over cells of `spacing` m from s = `start` on.

    Leaves: `coefficients` of shape (cells + 3, *lanes), of which the cell i takes i to i + 3; `spacing`; `start`; `amplitude`, a factor;
    `fade`, m, or None: the alignment is straight up to 0.4 fade and full from fade on. `periodic` tracks go on for ever, others
    are straight where their table ends in zeros. `label` is for printing and lost when JAX takes the pytree apart.
    """

    coefficients: Number = table("m", "c_j", "coefficients of the spline", signed=True)
    spacing: Number = parameter("m", "h", "length of the spline's cells", positive=True)
    start: Number = parameter("m", "", "distance at which the table begins", 0.0, signed=True)
    amplitude: Number = parameter("1", "a", "factor on the alignment", 1.0, signed=True)
    fade: Number = optional("m", "", "distance over which the alignment fades in", positive=True)
    periodic: bool = structure(True, "whether the table goes on for ever")
    label: Any = structure(None)

    def _set(self, **fields: Any) -> None:
        for name, value in fields.items():
            object.__setattr__(self, name, value)

    @property
    def length(self) -> float:
        """Length of the table, m; of a periodic track its period."""
        return (jnp.shape(self.coefficients)[0] - MARGIN) * self.spacing

    @guarded(amplitude=Range("1", axes=1))
    def scaled(self: T, amplitude: Scalar) -> T:
        """The same track with this scale factor instead of its own; one value, or one per lane."""
        scaled = copy.copy(self)
        scaled._set(amplitude=amplitude)
        return scaled

    @guarded(path=a_path, length=positive("m"), step=positive("m"))
    def to_csv(self, path: str | Path, length: float | None = None, step: float | None = None) -> None:
        """Write distance (m) and alignment (mm), fade-in and amplitude included, for other programs or `MeasuredTrack.from_csv`.

        From 0 to `length` (default the whole table) in steps of `step` (default the spacing), m. Raises `InputError` for lanes, and
        for a file that cannot be written.
        """
        length, step = length or self.start + self.length, step or self.spacing
        distance = step * np.arange(int(length / step + 1e-9) + 1)
        columns = np.column_stack([distance, 1e3 * np.asarray(alignment(_single(self), distance))])
        try:
            np.savetxt(path, columns, delimiter=",", header="distance (m),alignment (mm)", comments="", fmt="%.9g")
        except OSError as error:
            raise InputError(f"{path}: cannot be written ({error.strerror})") from None

    def seen_from(self, offset: Distances) -> Alignment:
        """η(start + offset). Both distances are split into cell and fraction before they are added, so that in single precision
        the wheelsets' distances from each other stay exact however far the run."""
        table = jnp.asarray(self.coefficients, offset.dtype)
        cells = table.shape[0] - MARGIN
        offset_cell, offset_part = self._split(offset - self.start, cells)

        def at(start: Distances) -> Distances:
            start_cell, start_part = self._split(jnp.asarray(start), cells)
            part = start_part + offset_part
            carry = part >= 1.0
            cell = start_cell + offset_cell + carry
            # both cells of a periodic track lie within the period, so their sum is at most one beyond it
            cell = jnp.where(cell >= cells, cell - cells, cell) if self.periodic else jnp.clip(cell, 0, cells - 1)
            eta = self.amplitude * cubic(table, cell, part - carry)
            return eta if self.fade is None else eta * fade_in(start + offset, self.fade)

        return at

    def _split(self, distance: Distances, cells: int) -> tuple[Int[Array, "..."], Distances]:
        """Cell and the fraction of it; of periodic tracks the cell within the period."""
        along = distance / self.spacing
        whole = jnp.floor(along)
        cell = whole.astype(jnp.int32)
        return (cell % cells if self.periodic else cell), along - whole


def _single(track: T) -> T:
    """The track, if it is one and not lanes of them."""
    if jnp.ndim(track.coefficients) > 1 or jnp.ndim(track.amplitude) > 0:
        raise InputError("this is for one track, and the seeds or amplitudes make lanes of several")
    return track


@guarded(track=Kind(SampledTrack, "a track given by samples, like railjax.RandomTrack"))
def spectrum_of(track: SampledTrack, segment: float = 1000.0) -> TableSpectrum:
    """Estimate of a track's spectrum by Welch's method (Hann window, overlapping by half), as points of m²/(rad/m) over rad/m.

    `segment` in m sets the resolution, 2π/segment; it is cut to a quarter of the track. The fade-in of random tracks is left
    out, so a random track of the spectrum of a measured one is `RandomTrack(spectrum_of(measured))`. Raises `InputError` for
    lanes.
    """
    from scipy.signal import welch

    table = float(_single(track).amplitude) * np.asarray(track.coefficients, float)
    # between the ends of a measured track's straight parts
    there = slice(None) if track.periodic else slice(*(np.flatnonzero(np.abs(table) > 1e-6 * np.abs(table).max())[[0, -1]]))
    samples = ((table[:-2] + 4.0 * table[1:-1] + table[2:]) / 6.0)[there]
    frequency, density = welch(
        samples, 1.0 / track.spacing, nperseg=max(16, min(round(segment / track.spacing), samples.size // 4)), detrend=False
    )
    kept = density[1:] > 0.0
    return TableSpectrum.checked(2.0 * np.pi * frequency[1:][kept], density[1:][kept] / (2.0 * np.pi))


def cubic(table: Float[Array, "k *lanes"], cell: Int[Array, "..."], part: Distances) -> Distances:
    """The spline at a fraction f (0 to 1) of a cell with the coefficients a, b, c, d: Σ_m T[cell + m] β_m(f), by Horner's rule.

    Four gathers of single numbers: XLA on CPU has them in one loop with the rest, which a gather of windows is not.
    """
    lanes = 1
    if table.ndim > 1:
        lanes = table.shape[1]
        cell, table = cell * lanes + jnp.arange(lanes, dtype=cell.dtype), table.reshape(-1)
    a, b, c, d = _taken(table, cell, cell + lanes, cell + 2 * lanes, cell + 3 * lanes)
    inner = 3.0 * (a - 2.0 * b + c) + part * (d - a + 3.0 * (b - c))
    return (a + 4.0 * b + c + part * (3.0 * (c - a) + part * inner)) / 6.0


@fence
def _taken(table: Float[Array, "k"], *cells: Int[Array, "..."]) -> tuple[Distances, ...]:
    """T at the cells, alone: together with arithmetic XLA would hold the gathers of a long table for work worth two threads."""
    return tuple(table.at[cell].get(mode="promise_in_bounds") for cell in cells)


def fade_in(distance: Distances, fade: Scalar) -> Distances:
    """0 up to 0.4 fade, 1 from fade on, twice continuously differentiable between."""
    t = jnp.clip((distance / fade - STRAIGHT) / (1.0 - STRAIGHT), 0.0, 1.0)
    return t**3 * (10.0 - 15.0 * t + 6.0 * t**2)


def register(kind: type[T]) -> type[T]:
    """Register a kind of sampled track as a pytree whose constructor, which makes the table, is not called on rebuilding."""
    leaves = [f.name for f in dataclasses.fields(kind) if not f.metadata.get("static")]

    def rebuilt(values: dict[str, Any]) -> T:
        track = object.__new__(kind)
        track._set(**values, label=None)
        return track

    return registered_by_name(kind, leaves, ("periodic",), rebuilt)
