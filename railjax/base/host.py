"""Functions that are computed on the host, by Python that calls small compiled programs, and that JAX sees through all the same.

`jax.grad`, `jvp` and `vmap` reach such a function with numbers. Inside `jax.jit` (and `lax.scan`, `lax.map`) there are none, and it
refuses: a callback that itself calls JAX can wait for ever for a thread that runs its caller (JAX issue 24255).
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Primitive
from jax.interpreters import ad, batching

from .batches import own_axes
from .errors import InputError


class Answer(NamedTuple):
    """Values (lanes,), of which the first is differentiable; and where it was asked for, for each lane its derivative by every
    floating-point leaf, shaped like that."""

    values: tuple[np.ndarray, ...]
    slopes: list[list[np.ndarray]] | None


#: lanes (each a tree of NumPy's numbers), and whether the slopes are wanted
Many = Callable[[Sequence[Any], bool], Answer]


class HostFunction:
    """`many` as a function of a tree whose leaves may carry lanes on an axis after their own.

    `name` says in messages what cannot be traced; `options` of a call are handed on to `many`, after the lanes and the wish for slopes.
    """

    def __init__(self, name: str, many: Callable[..., Answer], outputs: Sequence[type]) -> None:
        self.name, self.many, self.outputs = name, many, tuple(outputs)
        self._differentiable = jax.custom_jvp(self._values, nondiff_argnums=(0,))
        self._differentiable.defjvp(self._derivative)

    def __call__(self, tree: Any, *options: Any) -> tuple[jax.Array, ...]:
        """The values; one per lane where any leaf has lanes."""
        return self._differentiable(options, tree)

    def _values(self, options: tuple, tree: Any) -> tuple[jax.Array, ...]:
        return tuple(self._bound(options, tree, False))

    def _derivative(self, options: tuple, primals: tuple, tangents: tuple) -> tuple[tuple, tuple]:
        (tree,), (change,) = primals, tangents
        found = self._bound(options, tree, True)
        values, slopes = found[: len(self.outputs)], found[len(self.outputs) :]
        leaves, changes = jax.tree.leaves(tree), jax.tree.leaves(change)
        own = jax.tree.leaves(own_axes(tree))
        floats = [k for k, leaf in enumerate(leaves) if jnp.issubdtype(jnp.result_type(leaf), jnp.floating)]
        moved = sum(jnp.sum(slope * changes[k], axis=tuple(range(own[k]))) for slope, k in zip(slopes, floats, strict=True))
        moved = jnp.where(jnp.isfinite(values[0]), moved, 0.0)  # a lane without a value spoils no derivative of what is shared
        still = (
            jnp.zeros_like(v) if jnp.issubdtype(v.dtype, jnp.floating) else np.zeros(v.shape, jax.dtypes.float0)
            for v in values[1:]
        )
        return tuple(values), (moved, *still)

    def _bound(self, options: tuple, tree: Any, slopes: bool) -> list[jax.Array]:
        leaves, structure = jax.tree.flatten(tree)
        axes = tuple(jax.tree.leaves(own_axes(tree)))
        lanes = tuple(jnp.ndim(leaf) > own for leaf, own in zip(leaves, axes, strict=True))
        call = _Call(self, options, structure, axes, lanes, slopes)
        return _host.bind(*leaves, call=call)


class _Call(NamedTuple):
    """What of a call is no array; hashable."""

    function: HostFunction
    options: tuple
    structure: Any
    axes: tuple[int, ...]  # of each leaf, before lanes
    lanes: tuple[bool, ...]  # which leaves have them
    slopes: bool


_host = Primitive("railjax_host")
_host.multiple_results = True


@_host.def_impl
def _computed(*leaves: Any, call: _Call) -> list[jax.Array]:
    given = [np.asarray(leaf) for leaf in leaves]
    count = next((leaf.shape[-1] for leaf, lane in zip(given, call.lanes, strict=True) if lane), None)
    lanes = [
        call.structure.unflatten([leaf[..., k] if lane else leaf for leaf, lane in zip(given, call.lanes, strict=True)])
        for k in range(1 if count is None else count)
    ]
    answer = call.function.many(lanes, call.slopes, *call.options)
    found: list[np.ndarray] = [np.asarray(v, kind) for v, kind in zip(answer.values, call.function.outputs, strict=True)]
    found += [np.stack(slopes, axis=-1) for slopes in zip(*(answer.slopes or ()), strict=True)]
    return [jnp.asarray(values[..., 0] if count is None else values) for values in found]


@_host.def_abstract_eval
def _traced(*leaves: Any, call: _Call) -> Any:
    raise InputError(
        f"{call.function.name} is a search that runs on the host: call it outside of jax.jit, lax.scan and lax.map "
        "(jax.grad, jax.jacfwd and jax.vmap work; for many vehicles give one vehicle with lanes)"
    )


def _mapped(leaves: Sequence[Any], axes: Sequence[Any], *, call: _Call) -> tuple[list, list]:
    """The mapped axis becomes the axis of lanes; where there is one already, each of its lanes is one of the new ones."""
    width = next(leaf.shape[axis] for leaf, axis in zip(leaves, axes, strict=True) if axis is not None)
    shapes = [leaf.shape if axis is None else np.delete(leaf.shape, axis) for leaf, axis in zip(leaves, axes, strict=True)]
    before = next((int(shape[-1]) for shape, lane in zip(shapes, call.lanes, strict=True) if lane), None)
    flat, lanes = [], []
    for leaf, axis, lane in zip(leaves, axes, call.lanes, strict=True):
        here = axis is not None
        leaf = jnp.moveaxis(leaf, axis, -1) if here else leaf
        if before is not None and (here or lane):  # own axes, lanes, mapped
            leaf = leaf if lane else leaf[..., None, :]
            leaf = leaf if here else leaf[..., None]
            leaf = jnp.broadcast_to(leaf, (*leaf.shape[:-2], before, width)).reshape((*leaf.shape[:-2], before * width))
        flat.append(leaf)
        lanes.append(here or lane)
    found = _host.bind(*flat, call=call._replace(lanes=tuple(lanes)))
    if before is not None:
        found = [value.reshape((*value.shape[:-1], before, width)) for value in found]
    return found, [value.ndim - 1 for value in found]


batching.primitive_batchers[_host] = _mapped


def _twice(primals: Any, tangents: Any, *, call: _Call) -> Any:
    raise NotImplementedError(f"second derivatives of {call.function.name}")


ad.primitive_jvps[_host] = _twice
