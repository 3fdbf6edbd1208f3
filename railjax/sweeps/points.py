"""Which points a sweep visits: a grid, a list, a Latin hypercube or Sobol's sequence over named parameters, cut into blocks."""

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from ..base.errors import InputError

DESIGNS = ("grid", "points", "latin-hypercube", "sobol")
SAMPLED = ("latin-hypercube", "sobol")
SCALES = ("linear", "log")
#: of a column, which is kept in memory; more is a slip of the keyboard
MOST_POINTS = 10**8


@dataclass(frozen=True)
class Design:
    """Named columns of points. A grid keeps its axes only; the others keep every point, 8 bytes a number.

    `shape` and `dims` are those of the results: one axis per parameter for a grid, else the single axis "point".
    """

    kind: str
    names: tuple[str, ...]
    columns: tuple[Float[np.ndarray, "_"], ...]

    @property
    def shape(self) -> tuple[int, ...]:
        """Points along each dimension."""
        return tuple(len(c) for c in self.columns) if self.kind == "grid" else (len(self.columns[0]),)

    @property
    def dims(self) -> tuple[str, ...]:
        """Names of the dimensions."""
        return self.names if self.kind == "grid" else ("point",)

    @property
    def size(self) -> int:
        """Number of points."""
        return math.prod(self.shape)


@dataclass(frozen=True)
class Blocks:
    """A design cut into blocks of at most `largest` points, numbered from 0: what is computed, and written, together."""

    design: Design
    largest: int

    @functools.cached_property
    def shape(self) -> tuple[int, ...]:
        """Of a full block: the last dimensions whole, cuts of even size."""
        block = []
        left = self.largest
        for count in reversed(self.design.shape):
            pieces = -(-count // min(count, max(left, 1)))
            block.append(-(-count // pieces))
            left //= block[-1]
        return tuple(reversed(block))

    @functools.cached_property
    def _along(self) -> tuple[int, ...]:
        return tuple(-(-n // b) for n, b in zip(self.design.shape, self.shape, strict=True))

    @property
    def count(self) -> int:
        """Number of blocks."""
        return math.prod(self._along)

    @property
    def lanes(self) -> int:
        """Number of points in a full block."""
        return math.prod(self.shape)

    def position(self, index: int) -> tuple[int, ...]:
        """Where the block is among the blocks, along each dimension."""
        return tuple(int(k) for k in np.unravel_index(index, self._along))

    def slices(self, index: int) -> tuple[slice, ...]:
        """The part of the results that is the block's."""
        ends = zip(self.position(index), self.shape, self.design.shape, strict=True)
        return tuple(slice(k * b, min((k + 1) * b, n)) for k, b, n in ends)

    def size(self, index: int) -> int:
        """Number of points in the block, fewer than `lanes` at the edges."""
        return math.prod(cut.stop - cut.start for cut in self.slices(index))

    def points(self, index: int) -> dict[str, Float[np.ndarray, "lanes"]]:
        """The points of the block, one array per parameter, the last dimension running fastest."""
        design, cut = self.design, self.slices(index)
        if design.kind != "grid":
            return {name: column[cut[0]] for name, column in zip(design.names, design.columns, strict=True)}
        axes = [column[along] for column, along in zip(design.columns, cut, strict=True)]
        return {name: values.ravel() for name, values in zip(design.names, np.meshgrid(*axes, indexing="ij"), strict=True)}


def make_design(over: Mapping[str, Any], kind: str = "grid", samples: int | None = None, seed: int = 0) -> Design:
    """The design over named parameters; values in SI.

    "grid": {name: values}, all combinations. "points": {name: values}, columns of one length, a point per row.
    "latin-hypercube", "sobol": {name: (low, high)} or (low, high, "log"), `samples` points (of Sobol's scrambled sequence best a
    power of two), the same for the same `seed`; by SciPy's `qmc`.

    Raises `InputError` for anything that is no such thing.
    """
    if kind not in DESIGNS:
        raise InputError(f"design must be one of {', '.join(DESIGNS)}, not {kind!r}")
    if not isinstance(over, Mapping) or not over or not all(isinstance(name, str) for name in over):
        raise InputError('over must name at least one parameter, like {"speed": [50.0, 60.0]}')
    if kind in SAMPLED:
        return Design(kind, tuple(over), tuple(_sampled(over, kind, samples, seed)))
    if samples is not None:
        raise InputError(f"samples is for {' and '.join(SAMPLED)}; a {kind} has the points that `over` gives")
    columns = tuple(_column(name, values) for name, values in over.items())
    lengths = {name: len(column) for name, column in zip(over, columns, strict=True)}
    if kind == "points" and len(set(lengths.values())) > 1:
        raise InputError(f"a list of points needs columns of one length, not {lengths}")
    return Design(kind, tuple(over), columns)


def _column(name: str, values: Any) -> Float[np.ndarray, "values"]:
    try:
        column = np.asarray(values)
    except ValueError:
        column = np.empty((0, 0))
    if column.ndim != 1 or column.size == 0 or column.dtype.kind not in "iuf":
        raise InputError(f"over {name!r}: give a list of numbers")
    column = column.astype(float)
    if not np.all(np.isfinite(column)):
        raise InputError(f"over {name!r}: every value must be finite")
    return column


def _sampled(over: Mapping[str, Any], kind: str, samples: int | None, seed: int) -> list[Float[np.ndarray, "values"]]:
    from scipy.stats import qmc  # here, for a quick import of railjax

    if not isinstance(samples, int) or isinstance(samples, bool) or not 1 <= samples <= MOST_POINTS:
        raise InputError(f"a {kind} design needs samples=, the number of points, from 1 to {MOST_POINTS}")
    if not isinstance(seed, int) or isinstance(seed, bool) or seed < 0:
        raise InputError(f"seed must be an integer from 0, not {seed!r}")
    ranges = [_range(name, given) for name, given in over.items()]
    dimensions = len(ranges)
    if kind == "sobol":
        # the whole power of two, for less of it draws SciPy's warning
        unit = qmc.Sobol(dimensions, rng=seed).random_base2(max(samples - 1, 0).bit_length())[:samples]
    else:
        unit = qmc.LatinHypercube(dimensions, rng=seed).random(samples)
    return [
        low * (high / low) ** u if scale == "log" else low + (high - low) * u
        for (low, high, scale), u in zip(ranges, np.ascontiguousarray(unit.T), strict=True)
    ]


def _range(name: str, given: Any) -> tuple[float, float, str]:
    scale = "linear"
    if isinstance(given, (tuple, list)) and len(given) == 3 and given[2] in SCALES:
        given, scale = given[:2], given[2]
    try:
        low, high = (float(value) for value in given)
    except (TypeError, ValueError):
        raise InputError(f'over {name!r}: give a range (low, high) or (low, high, "log")') from None
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise InputError(f"over {name!r}: the range must rise between finite numbers, not from {low:g} to {high:g}")
    if scale == "log" and not low > 0:
        raise InputError(f"over {name!r}: a logarithmic range must be positive, not from {low:g}")
    return low, high, scale
