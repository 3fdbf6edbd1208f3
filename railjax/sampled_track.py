"""What tracks given by samples share: a cubic B-spline over distance, its pytree, and its evaluation in the time loop.

    η(s) = g(s) a Σ_j c_j β³(s/h - j)

with the spacing h (m), the coefficients c_j (m), the scale factor a and the fade-in g. The spline is twice continuously
differentiable, so a run sees no kinks.
"""

import copy
import dataclasses
from dataclasses import dataclass, field
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from .track import Alignment, Distances
from .typing import Number, Scalar

T = TypeVar("T", bound="SampledTrack")

#: share of the fade-in that stays straight: 20 m of 50 m, so that the leading wheelset starts on straight track
STRAIGHT = 0.4

#: coefficients beyond the cells: a cell's value takes the coefficients at its ends and one further on either side
MARGIN = 3


@dataclass(frozen=True)
class SampledTrack:
    """Lateral alignment as a cubic spline over cells of `spacing` m from s = 0 on.

    Leaves: `coefficients` of shape (cells + 3, *lanes), of which the cell i takes i to i + 3; `spacing`; `amplitude`, a factor;
    `fade`, m, or None: the alignment is straight up to 0.4 fade and full from fade on. `periodic` tracks go on for ever, others
    are straight where their table ends in zeros. `label` is for printing and lost when JAX takes the pytree apart.
    """

    coefficients: Number = field(metadata={"axes": 1})
    spacing: Number
    amplitude: Number = 1.0
    fade: Number = None
    periodic: bool = field(default=True, metadata={"static": True})
    label: Any = field(default=None, metadata={"static": True})

    def _set(self, **fields: Any) -> None:
        for name, value in fields.items():
            object.__setattr__(self, name, value)

    @property
    def length(self) -> float:
        """Length of the table, m; of a periodic track its period."""
        return (jnp.shape(self.coefficients)[0] - MARGIN) * self.spacing

    def scaled(self: T, amplitude: Scalar) -> T:
        """The same track with this scale factor instead of its own; one value, or one per lane."""
        scaled = copy.copy(self)
        scaled._set(amplitude=amplitude)
        return scaled

    def seen_from(self, offset: Distances) -> Alignment:
        """η(start + offset). Both distances are split into cell and fraction before they are added, so that in single precision
        the wheelsets' distances from each other stay exact however far the run."""
        table = jnp.asarray(self.coefficients, offset.dtype)
        cells = table.shape[0] - MARGIN
        offset_cell, offset_part = self._split(offset, cells)

        def at(start: Distances) -> Distances:
            start_cell, start_part = self._split(jnp.asarray(start), cells)
            part = start_part + offset_part
            carry = part >= 1.0
            cell = start_cell + offset_cell + carry
            if self.periodic:
                cell = jnp.where(cell >= cells, cell - cells, cell)
            else:
                cell = jnp.clip(cell, 0, cells - 1)
            eta = self.amplitude * cubic(table, cell, part - carry)
            return eta if self.fade is None else eta * fade_in(start + offset, self.fade)

        return at

    def _split(self, distance: Distances, cells: int) -> tuple[Int[Array, "..."], Distances]:
        """Cell and the fraction of it; of periodic tracks the cell within the period."""
        along = distance / self.spacing
        whole = jnp.floor(along)
        cell = whole.astype(jnp.int32)
        return (cell % cells if self.periodic else cell), along - whole


def cubic(table: Float[Array, "k *lanes"], cell: Int[Array, "..."], part: Distances) -> Distances:
    """Σ_m T[cell + m] β_m(part): the spline's value at a fraction (0 to 1) of a cell."""
    f, g = part, 1.0 - part
    weights = (g**3, 4.0 - 3.0 * f**2 * (1.0 + g), 4.0 - 3.0 * g**2 * (1.0 + f), f**3)
    if table.ndim > 1:
        lanes = table.shape[1]
        cell, table = cell * lanes + jnp.arange(lanes, dtype=cell.dtype), table.reshape(-1)
    else:
        lanes = 1
    values = [table.at[cell + m * lanes].get(mode="promise_in_bounds") for m in range(4)]
    return sum(w * value for w, value in zip(weights, values, strict=True)) / 6.0


def fade_in(distance: Distances, fade: Scalar) -> Distances:
    """0 up to 0.4 fade, 1 from fade on, twice continuously differentiable between."""
    t = jnp.clip((distance / fade - STRAIGHT) / (1.0 - STRAIGHT), 0.0, 1.0)
    return t**3 * (10.0 - 15.0 * t + 6.0 * t**2)


def register(kind: type[T]) -> type[T]:
    """Register a kind of sampled track as a pytree whose constructor, which makes the table, is not called on rebuilding."""
    leaves = [f.name for f in dataclasses.fields(kind) if not f.metadata.get("static")]
    keys = [jax.tree_util.GetAttrKey(name) for name in leaves]

    def flatten(track: T) -> tuple[list, tuple]:
        return [getattr(track, name) for name in leaves], (track.periodic,)

    def flatten_with_keys(track: T) -> tuple[list, tuple]:
        values, rest = flatten(track)
        return list(zip(keys, values, strict=True)), rest

    def unflatten(rest: tuple, values: list) -> T:
        track = object.__new__(kind)
        track._set(**dict(zip(leaves, values, strict=True)), periodic=rest[0], label=None)
        return track

    jax.tree_util.register_pytree_with_keys(kind, flatten_with_keys, unflatten, flatten)
    return kind
