"""Registration of laws and tracks as trees of numbers that compiled code tells apart by their class."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import jax

T = TypeVar("T")


def registered(kind: type[T]) -> type[T]:
    """Register a frozen dataclass as a pytree, as `jax.tree_util.register_dataclass` does: for those of which one may stand where another was.

    JAX (0.10 and 0.12) takes trees for equal whose nodes are of different dataclasses with the same fields, and now and then (where hashes
    fall into the same place) may hand one's numbers to the program compiled for the other.
    """
    fields = [f for f in dataclasses.fields(kind) if f.init]  # type: ignore[arg-type]
    leaves = [f.name for f in fields if not f.metadata.get("static")]
    fixed = [f.name for f in fields if f.metadata.get("static")]
    return registered_by_name(kind, leaves, fixed, lambda values: kind(**values))


def registered_by_name(
    kind: type[T], leaves: Sequence[str], fixed: Sequence[str], rebuild: Callable[[dict[str, Any]], T]
) -> type[T]:
    """Register a class as a pytree by names of its attributes.

    Args:
        kind: the class.
        leaves: of what JAX transforms.
        fixed: of what it compiles anew for.
        rebuild: makes one again of the values of both by their names, which may be tracers or placeholders.
    """
    keys = [jax.tree_util.GetAttrKey(name) for name in leaves]

    def flatten(one: T) -> tuple[list, tuple]:
        return [getattr(one, name) for name in leaves], tuple(getattr(one, name) for name in fixed)

    def flatten_with_keys(one: T) -> tuple[list, tuple]:
        values, rest = flatten(one)
        return list(zip(keys, values, strict=True)), rest

    def unflatten(rest: tuple, values: Any) -> T:
        return rebuild(dict(zip((*leaves, *fixed), (*values, *rest), strict=True)))

    jax.tree_util.register_pytree_with_keys(kind, flatten_with_keys, unflatten, flatten)
    return kind
