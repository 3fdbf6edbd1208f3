"""Trees of numbers as compiled functions are handed them: few arrays of one kind."""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .fields import structure

#: numbers of an array above which it stays on its device
FEW = 4096


def as_numbers(tree: Any) -> Any:
    """Every number of the tree as an array of JAX's default float: code is compiled anew where a Python float takes the place of an
    array or of a NumPy number. Where nothing is traced NumPy makes them, because each first `jnp.asarray` of a kind compiles as well."""
    dtype = jnp.result_type(float)

    def number(leaf: Any) -> Any:
        if isinstance(leaf, jax.core.Tracer):
            return jnp.asarray(leaf, dtype)
        large = isinstance(leaf, jax.Array) and leaf.size > FEW and leaf.dtype == dtype
        return leaf if large else np.asarray(leaf, dtype)

    return jax.tree.map(number, tree)


class Unlike(int):
    """A number that tells things apart within one process only, such as a hash."""


class Form(NamedTuple):
    """What a tree of arrays is made of but its numbers, which a compiled function takes as one array: many are slow to hand over, and XLA
    aborts the process on an argument of one kernel for which it finds no use."""

    structure: Any
    shapes: tuple[tuple[int, ...], ...]

    @classmethod
    def of(cls, tree: Any) -> "Form":
        leaves, structure = jax.tree.flatten(tree)
        return cls(structure, tuple(np.shape(leaf) for leaf in leaves))

    def tree(self, numbers: Any) -> Any:
        """The tree of `numbers` (numbers, *lanes), NumPy's or JAX's."""
        sizes, lanes = [math.prod(shape) for shape in self.shapes], numbers.shape[1:]
        parts = [numbers[end - size : end] for size, end in zip(sizes, np.cumsum(sizes), strict=True)]
        return self.structure.unflatten([part.reshape((*shape, *lanes)) for part, shape in zip(parts, self.shapes, strict=True)])


def numbers_of(tree: Any) -> np.ndarray:
    """All numbers of a tree as one array, in the order of its leaves."""
    return np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(tree)])


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Packed:
    """A tree of arrays as a compiled function is handed it: what has no axes in one vector, since 50 numbers each by itself take 100 µs."""

    numbers: Any
    tables: Any
    tree: Any = structure(None)
    single: Any = structure(())
    #: JAX 0.10 takes trees for equal whose nodes are of different dataclasses but for that alike (skyhook and balance logic, say), and
    #: its programs were handed to the wrong one; the hashes differ
    kinds: Any = structure(0)

    @classmethod
    def of(cls, tree: Any) -> "Packed":
        leaves, treedef = jax.tree.flatten(tree)
        single = tuple(np.ndim(leaf) == 0 for leaf in leaves)
        numbers = np.array([leaf for leaf, alone in zip(leaves, single, strict=True) if alone], jnp.result_type(float))
        tables = [leaf for leaf, alone in zip(leaves, single, strict=True) if not alone]
        return cls(numbers, as_numbers(tables), treedef, single, Unlike(hash(treedef)))

    def unpacked(self) -> Any:
        numbers, tables = iter(self.numbers), iter(self.tables)
        return self.tree.unflatten([next(numbers) if alone else next(tables) for alone in self.single])
