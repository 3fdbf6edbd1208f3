"""Lanes without a result, so that they do not spoil the derivatives of what the others share: reverse mode multiplies their zero
cotangents by derivatives that must be numbers all the same, so a failed lane computes with harmless ones and is NaN at the end."""

import functools
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool

T = TypeVar("T")


def without_nan(tree: T) -> T:
    """The tree with 1 in place of NaN."""
    return jax.tree.map(lambda leaf: jnp.where(jnp.isnan(leaf), 1.0, leaf).astype(jnp.result_type(leaf)), tree)


def no_number(tree: Any, axes: Any = None) -> Bool[Array, "..."]:
    """Whether a leaf is NaN: lane by lane with `axes` as `own_axes` gives them, else in the whole tree."""
    leaves = jax.tree.leaves(tree)
    own = [jnp.ndim(leaf) for leaf in leaves] if axes is None else jax.tree.leaves(axes)
    found = [jnp.any(jnp.isnan(leaf), axis=tuple(range(count))) for leaf, count in zip(leaves, own, strict=True)]
    return functools.reduce(jnp.logical_or, found)


def nan_unless(sound: Bool[Array, "..."], tree: T) -> T:
    """NaN in lanes that are not sound: on the last axes, as many as `sound` has."""
    return jax.tree.map(lambda leaf: jnp.where(sound, leaf, jnp.nan).astype(leaf.dtype), tree)


def ends(values: ArrayLike) -> tuple[float, float]:
    """The least and the greatest of what is a number, for summaries that say apart how many failed; NaN where nothing is."""
    found = np.ravel(values)
    found = found[~np.isnan(found)]
    return (float(np.min(found)), float(np.max(found))) if found.size else (float("nan"), float("nan"))
