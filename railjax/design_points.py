"""Which points a sweep visits: a grid, a list, a Latin hypercube or Sobol's sequence over named parameters, cut into blocks."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from .errors import InputError

DESIGNS = ("grid", "points", "latin-hypercube", "sobol")
SAMPLED = ("latin-hypercube", "sobol")
SCALES = ("linear", "log")

Block = tuple[slice, ...]


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

    def points(self, block: Block) -> dict[str, Float[np.ndarray, "lanes"]]:
        """The points of a block, one array per parameter, the last dimension running fastest."""
        if self.kind != "grid":
            return {name: column[block[0]] for name, column in zip(self.names, self.columns, strict=True)}
        axes = [column[cut] for column, cut in zip(self.columns, block, strict=True)]
        return {name: values.ravel() for name, values in zip(self.names, np.meshgrid(*axes, indexing="ij"), strict=True)}


def block_shape(shape: tuple[int, ...], largest: int) -> tuple[int, ...]:
    """The block that the dimensions are cut into: at most `largest` points, the last dimensions whole, cuts of even size."""
    block = []
    left = largest
    for count in reversed(shape):
        pieces = -(-count // min(count, max(left, 1)))
        block.append(-(-count // pieces))
        left //= block[-1]
    return tuple(reversed(block))


def block_at(shape: tuple[int, ...], block: tuple[int, ...], index: int) -> tuple[tuple[int, ...], Block]:
    """Position in the grid of blocks, and slices, of block number `index`."""
    where = tuple(int(k) for k in np.unravel_index(index, blocks_along(shape, block)))
    return where, tuple(slice(k * b, min((k + 1) * b, n)) for k, b, n in zip(where, block, shape, strict=True))


def blocks_along(shape: tuple[int, ...], block: tuple[int, ...]) -> tuple[int, ...]:
    """Number of blocks along each dimension."""
    return tuple(-(-n // b) for n, b in zip(shape, block, strict=True))


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

    if not isinstance(samples, int) or isinstance(samples, bool) or samples < 1:
        raise InputError(f"a {kind} design needs samples=, the number of points, at least 1")
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
