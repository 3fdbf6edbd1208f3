"""Batches: the same function over many lanes at once, in chunks that stay in cache, spread over all local devices.

A lane is one simulation of a batch; it lives on the trailing axis of every array that has it.
"""

import dataclasses
import functools
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero
from jax.sharding import Mesh, PartitionSpec

from .checks import traced
from .compilation import WIDE, one_kernel, options
from .errors import InputError

T = TypeVar("T")
R = TypeVar("R")

#: lanes integrated together on one device; beyond 40 (JAX 0.10.1) or 56 (0.12) lanes a step on CPU takes twice as long per lane
CHUNK = 32


def chunk_for(dtype: Any) -> int:
    """Lanes for one chunk: `CHUNK`; in single precision twice as many where that is quicker (by 7 %), from JAX 0.12 on."""
    return 2 * CHUNK if dtype == jnp.float32 and jax.__version_info__ >= (0, 12) else CHUNK


def cores() -> int:
    """How many this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def in_threads(function: Callable[[T], R], given: Sequence[T]) -> list[R]:
    """`function` of each, as many at once as there are cores: for host code that waits for compiled programs most of its time."""
    if len(given) < 2 or cores() < 2:
        return [function(one) for one in given]
    with ThreadPoolExecutor(cores()) as pool:
        return list(pool.map(function, given))


def use_all_cores() -> None:
    """One CPU device per core, so that a batch runs on all of them. Call it before anything is computed.

    Raises `InputError` where JAX has started its backend already: the number of devices is fixed from then on.
    """
    try:
        jax.config.update("jax_num_cpu_devices", cores())
    except RuntimeError:
        if jax.local_device_count("cpu") != cores():
            raise InputError("railjax.use_all_cores() comes too late: call it before the first computation") from None


def own_axes(tree: Any) -> Any:
    """For each leaf, how many axes it has of its own, before any lanes: a field's `axes` metadata, else 0; through tuples and dictionaries."""
    if dataclasses.is_dataclass(tree) and not isinstance(tree, type):
        axes: list[int] = []
        for field in dataclasses.fields(tree):
            if field.metadata.get("static"):
                continue
            value = getattr(tree, field.name)
            below = jax.tree.leaves(own_axes(value))
            axes += [field.metadata["axes"]] * len(below) if "axes" in field.metadata else below
        return jax.tree.structure(tree).unflatten(axes)
    if isinstance(tree, Mapping):
        return {key: own_axes(value) for key, value in tree.items()}
    if isinstance(tree, (tuple, list)):
        inner = [own_axes(value) for value in tree]
        return type(tree)(*inner) if hasattr(tree, "_fields") else type(tree)(inner)
    return jax.tree.map(lambda _: 0, tree)


class Batch(NamedTuple):
    """Arguments of a function of one lane. A leaf carries the lanes, if it has them, on an axis after its own."""

    trees: tuple
    axes: tuple  # of each leaf, its own, before lanes
    lanes: int | None  # None: a single lane, without an axis for it

    @classmethod
    def of(cls, *trees: Any, own: Mapping[int, Any] | None = None) -> "Batch":
        """Of the arguments; `own` gives the axes of those that do not tell them (`own_axes`), by their place. Raises `InputError`
        where they have different numbers of lanes."""
        axes = tuple(own[k] if own and k in own else own_axes(tree) for k, tree in enumerate(trees))
        counts = set()
        for leaf, ours in zip(jax.tree.leaves(trees), jax.tree.leaves(axes), strict=True):
            shape = jnp.shape(leaf)
            if len(shape) > ours + 1:
                raise InputError(f"an array of shape {shape} has more than one axis of lanes; flatten the grid first")
            if len(shape) == ours + 1:
                counts.add(shape[-1])
        if len(counts) > 1:
            raise InputError(f"arrays with different numbers of lanes in one batch: {sorted(counts)}")
        return cls(trees, axes, counts.pop() if counts else None)

    @property
    def carrying(self) -> tuple[bool, ...]:
        """Which leaves have lanes."""
        return tuple(jnp.ndim(leaf) > own for leaf, own in zip(*map(jax.tree.leaves, (self.trees, self.axes)), strict=True))

    def take(self, index: Any) -> tuple:
        """The arguments of one lane (an integer), or of several (an array of integers)."""
        return jax.tree.map(lambda leaf, own: leaf[..., index] if jnp.ndim(leaf) > own else leaf, self.trees, self.axes)

    def each(self, function: Callable[..., Any]) -> Any:
        """`function(*trees)`, which is written for one lane, of each (`vmap`); outputs carry lanes on the last axis."""
        if self.lanes is None:
            return function(*self.trees)
        mapped = jax.tree.map(lambda leaf, own: -1 if jnp.ndim(leaf) > own else None, self.trees, self.axes)
        return jax.vmap(function, in_axes=mapped, out_axes=-1)(*self.trees)

    def in_chunks(self, function: Callable[..., Any], chunk: int = CHUNK, spread: bool = False) -> Any:
        """`function(*trees)` of the lanes, chunk by chunk; outputs carry lanes on the last axis.

        The last chunk is filled up with copies of the last lane, which are dropped. With `spread`, and outside of transformations,
        the chunks are spread over all devices and each device's share becomes one kernel; `function` must be the same object in
        every call then, as it is compiled only once, and may not call LAPACK (whose own threads deadlock with those of two CPU
        devices at work; seen with JAX 0.10.1).
        """
        assert self.lanes is not None
        leaves, structure = jax.tree.flatten(self.trees)
        if not spread or traced(leaves):
            prepare, work, finish = _stages(function, structure, self.carrying, self.lanes, chunk, 1)
        else:
            devices = len(jax.local_devices())
            prepare, work, finish = _compiled_stages(function, structure, self.carrying, self.lanes, chunk, devices)
        return finish(work(*prepare(leaves)))

    def by_device(self, function: Callable[..., Any], chunk: int | None = None) -> Any:
        """`function(*trees)` of each device's share of the lanes, all of them at once or in chunks; outputs carry lanes on the last axis."""
        assert self.lanes is not None
        leaves, structure = jax.tree.flatten(jax.tree.map(jnp.asarray, self.trees))
        stages = _stages(function, structure, self.carrying, self.lanes, chunk or self.lanes, len(jax.local_devices()))
        prepare, work, finish = stages
        return finish(_on_devices(work)(*prepare(leaves)))

    def one_by_one(self, function: Callable[..., Any]) -> Any:
        """`function(*trees)` of one lane after another, for what branches or calls LAPACK; outputs carry lanes on the last axis.

        The lanes are shared out among the devices, each of which takes its own one by one.
        """
        if self.lanes is None:
            return function(*self.trees)

        def single(*chunk: Any) -> Any:
            lone = Batch(chunk, self.axes, 1).take(0)
            return jax.tree.map(lambda leaf: leaf[..., None], function(*lone))

        return self.by_device(single, chunk=1)


@functools.cache
def alone(
    function: Callable[..., Any], derived: Callable[..., Any], batch_of: Callable[..., Batch], chunk: int, spread: bool
) -> Callable[..., Any]:
    """`function(*trees)` of one lane, of which a user's `jax.vmap` makes `batch_of(*trees)` in chunks instead of one array wider than
    the cache.

    All leaves are floating-point arrays. Derivatives are those of `derived`, around `custom_vmap`, which has no reverse mode.
    """
    single = jax.custom_batching.custom_vmap(function)

    @single.def_vmap
    def _many(lanes: int, batched: list, *trees: Any) -> tuple[Any, Any]:
        last = jax.tree.map(lambda leaf, lane: jnp.moveaxis(leaf, 0, -1) if lane else leaf, trees, tuple(batched))
        result = batch_of(*last).in_chunks(function, chunk, spread)
        return jax.tree.map(lambda leaf: jnp.moveaxis(leaf, -1, 0), result), jax.tree.map(lambda _: True, result)

    return with_derivative_of(derived, single)


def with_derivative_of(derived: Callable[..., Any], function: Callable[..., Any]) -> Callable[..., Any]:
    """`function(*trees)`; where it is differentiated, `derived(*trees)`, which is the same written so that it has good derivatives."""
    whole = jax.custom_jvp(function)

    @functools.partial(whole.defjvp, symbolic_zeros=True)
    def _derivative(primals: tuple, tangents: tuple) -> tuple[Any, Any]:
        leaves, structure = jax.tree.flatten(primals)
        rates = jax.tree.leaves(tangents)
        moving = [k for k, rate in enumerate(rates) if not isinstance(rate, SymbolicZero)]

        def of(moved: list) -> Any:
            replaced = dict(zip(moving, moved, strict=True))
            return derived(*structure.unflatten([replaced.get(k, leaf) for k, leaf in enumerate(leaves)]))

        return jax.jvp(of, ([leaves[k] for k in moving],), ([rates[k] for k in moving],))

    return whole


def _stages(
    function: Callable[..., Any],
    structure: Any,
    batched: tuple[bool, ...],
    lanes: int,
    chunk: int,
    devices: int,
) -> tuple[Callable, Callable, Callable]:
    """Cut into chunks; run each device's; put the lanes together again."""
    chunk = max(1, min(chunk, -(-lanes // devices)))
    chunks = -(-lanes // (chunk * devices)) * devices
    missing = chunk * chunks - lanes

    def prepare(leaves: list) -> tuple[list, list]:
        shared = [leaf for leaf, lane in zip(leaves, batched, strict=True) if not lane]
        own = [jnp.asarray(leaf) for leaf, lane in zip(leaves, batched, strict=True) if lane]
        filled = [jnp.pad(leaf, [(0, 0)] * (leaf.ndim - 1) + [(0, missing)], mode="edge") for leaf in own]
        return shared, [_chunked(leaf, chunks, chunk) for leaf in filled]

    def work(shared: list, moved: list) -> Any:
        def one_chunk(pieces: list) -> Any:
            here, alike = iter(pieces), iter(shared)
            return function(*structure.unflatten([next(here) if lane else next(alike) for lane in batched]))

        return jax.lax.map(one_chunk, moved)

    def finish(result: Any) -> Any:
        return jax.tree.map(lambda leaf: _joined(leaf)[..., :lanes], result)

    return prepare, work, finish


@functools.cache
def _compiled_stages(*arguments: Any) -> tuple[Callable, Callable, Callable]:
    """Three compilations, because only a function without exchange between devices can be one kernel."""
    prepare, work, finish = _stages(*arguments)
    return jax.jit(prepare), jax.jit(_on_devices(one_kernel(work)), compiler_options=options(WIDE)), jax.jit(finish)


def _on_devices(work: Callable) -> Callable:
    """Spread the chunks, the first axis of the second argument, over the devices."""
    if len(jax.local_devices()) == 1:
        return work
    mesh = Mesh(np.array(jax.local_devices()), ("lane",))
    spread = PartitionSpec("lane")
    return jax.shard_map(work, mesh=mesh, in_specs=(PartitionSpec(), spread), out_specs=spread, check_vma=False)


def _chunked(leaf: jax.Array, chunks: int, chunk: int) -> jax.Array:
    """(..., chunks * chunk) -> (chunks, ..., chunk)."""
    return jnp.moveaxis(leaf.reshape((*leaf.shape[:-1], chunks, chunk)), -2, 0)


def _joined(leaf: jax.Array) -> jax.Array:
    """(chunks, ..., chunk) -> (..., chunks * chunk)."""
    leaf = jnp.moveaxis(leaf, 0, -2)
    return leaf.reshape((*leaf.shape[:-2], -1))
