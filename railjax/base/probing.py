"""A function of lanes and what must hold of it: finite, the same in a batch, mapped, compiled and in plain Python, its derivatives those
of differences. What `railjax.testing` checks of laws rests on these; each raises an `AssertionError` of one line.
"""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .batches import own_axes
from .compilation import HASTY, options

#: share of an argument's size by which it is changed for a difference; by how much of the derivative, and of the value, that may be off
STEP, OFF, NOISE = 1e-6, 1e-5, 1e-8
#: share of the largest number beside it by which two ways to the same number may differ
ROUNDING = 1e-9


@contextmanager
def said(name: str, what: str) -> Iterator[None]:
    """Whatever is raised here as an `AssertionError` of one line."""
    try:
        yield
    except Exception as error:
        first = next(iter(str(error).strip().splitlines()), "")
        raise AssertionError(f"{name}: {what}: {type(error).__name__}: {first}") from error


def round_trip(name: str, value: Any) -> None:
    """It survives being taken apart and put together again, as all of JAX does with it."""
    leaves, structure = jax.tree.flatten(value)
    with said(name, "cannot be put together again from its leaves"):
        again = structure.unflatten(leaves)
    fields = dataclasses.fields(value) if dataclasses.is_dataclass(value) else ()
    for field in fields:
        if field.metadata.get("static"):
            with said(name, f"{field.name} is static and cannot be hashed, which jax.jit needs"):
                hash(getattr(again, field.name))
    # `label`s of tracks are for printing, and said to be lost
    for key in [field.name for field in fields if not (field.metadata.get("static") and field.name == "label")]:
        kept, own = getattr(again, key), getattr(value, key)
        assert jax.tree.structure(kept) == jax.tree.structure(own), f"{name}: {key} is {kept!r} after flattening, not {own!r}"  # type: ignore[operator]
    assert jax.tree.structure(again) == structure, f"{name}: flattened again it is {jax.tree.structure(again)}, not {structure}"  # type: ignore[operator]
    for kept, own in zip(jax.tree.leaves(again), leaves, strict=True):
        assert np.array_equal(kept, own, equal_nan=True), f"{name}: a number is {kept} after flattening, not {own}"


class Found(NamedTuple):
    """What one compilation says of a function of lanes."""

    batch: dict[str, Any]
    mapped: dict[str, Any]  # by jax.vmap
    size: Any  # of the weighted sum that is differentiated, per lane
    forward: Any  # derivative along each leaf, (leaves, lanes)
    reverse: Any
    difference: Any
    more: dict[str, Any]
    leaves: list[str]


def probed(name: str, function: Callable[[dict], dict], at: dict, along: dict, more: Callable[[dict], dict[str, Any]]) -> Found:
    """`function` and its derivatives along each leaf of `at` by the direction `along`; both have lanes on every leaf's last axis."""
    paths, structure = jax.tree_util.tree_flatten_with_path(at)
    directions, rng = jax.tree.leaves(along), np.random.default_rng(1)
    weights = jax.tree.map(lambda part: rng.uniform(0.5, 1.5, (*part.shape[:-1], 1)), _shapes_of(function, at))

    def parts(given: dict, scale: dict) -> list[Any]:
        scaled = jax.tree.map(lambda value, weight, by: value * weight / by, function(given), weights, scale)
        return [part.reshape(-1, part.shape[-1]) for part in jax.tree.leaves(scaled)]

    def masked(mask: Any) -> dict:
        return structure.unflatten([part * direction for part, direction in zip(mask, directions, strict=True)])

    def forward(of: Callable) -> Any:
        return jax.vmap(lambda mask: jax.jvp(of, (at,), (masked(mask),))[1])(jnp.eye(len(directions)))

    def reverse(of: Callable) -> Any:
        slopes = jax.tree.leaves(jax.grad(lambda given: jnp.sum(of(given)))(at))
        return jnp.stack([jnp.sum(s * d, axis=tuple(range(jnp.ndim(s) - 1))) for s, d in zip(slopes, directions, strict=True)])

    def all_of(at: dict) -> Found:
        batch = function(at)
        scale = jax.tree.map(lambda part: _or_one(jnp.max(jnp.abs(part), axis=-1, keepdims=True)), batch)

        def total(given: dict) -> Any:
            return sum(jnp.sum(part, axis=0) for part in parts(given, scale))

        def near(mask: Any) -> Any:
            return total(jax.tree.map(lambda x, d: x + STEP * d, at, masked(mask)))

        units = jnp.eye(len(directions))
        above, below = jnp.split(jax.lax.map(near, jnp.concatenate([units, -units])), 2)
        shares = jax.tree.map(lambda value, weight, by: jnp.abs(value * weight / by), batch, weights, scale)
        measure = sum(jnp.sum(part, axis=tuple(range(part.ndim - 1))) for part in jax.tree.leaves(shares))
        mapped = jax.vmap(function, in_axes=-1, out_axes=-1)(at)
        return Found(batch, mapped, measure, forward(total), reverse(total), (above - below) / (2.0 * STEP), more(at), [])

    one = jax.tree.map(lambda part: 1.0, weights)
    for mode in (forward, reverse):
        with said(name, f"has no derivative in {mode.__name__} mode"):
            jax.eval_shape(lambda mode=mode: mode(lambda given: sum(jnp.sum(part, axis=0) for part in parts(given, one))))
    with said(name, "cannot be mapped by jax.vmap"):
        jax.eval_shape(jax.vmap(function, in_axes=-1, out_axes=-1), at)
    # it runs once
    found = jax.device_get(jax.jit(all_of, compiler_options=options(HASTY))(at))
    return found._replace(leaves=[jax.tree_util.keystr(path, simple=True, separator=".") for path, _ in paths])


def _shapes_of(function: Callable[[dict], dict], at: dict) -> dict:
    """Shapes of what the function gives: traced anew, as JAX 0.10 may take what it has traced of another class with the same fields."""
    return jax.eval_shape(lambda at: function(at), at)


def _or_one(size: Any) -> Any:
    return jnp.where(size > 0.0, size, 1.0)


def lanes_of(tree: Any, lanes: int, rng: np.random.Generator) -> tuple[Any, Any]:
    """A tree of numbers with lanes, each within 5 % of its own, and a direction in which all of them change."""
    own = own_axes(tree)

    def spread(leaf: Any, axes: int) -> Any:
        if np.ndim(leaf) != axes:
            raise AssertionError(f"give one without lanes: a number has the shape {np.shape(leaf)}")
        return np.asarray(leaf)[..., None] * rng.uniform(0.95, 1.05, lanes)

    spreads = jax.tree.map(spread, tree, own)
    return spreads, jax.tree.map(lambda leaf: leaf * rng.uniform(0.5, 1.5, np.shape(leaf)), spreads)


def shapes(name: str, function: Callable[[dict], dict], at: dict, expected: dict[str, tuple[int, ...]]) -> None:
    with said(name, "cannot be traced by jax.jit"):
        given = _shapes_of(function, at)
    for key, shape in expected.items():
        assert given[key].shape == shape, f"{name}: the {key} has the shape {given[key].shape}, not {shape}"
        assert jnp.issubdtype(given[key].dtype, jnp.floating), f"{name}: the {key} is {given[key].dtype}, not a float"


def finite(name: str, found: Found, where: list[str]) -> None:
    for key, part in found.batch.items():
        wrong = np.argwhere(~np.isfinite(part))
        assert not wrong.size, f"{name}: the {key} is {part[tuple(wrong[0])]} at {where[wrong[0][-1]]}"


def equal(name: str, what: str, one: Any, other: Any, where: Sequence[str] | None = None) -> None:
    """Two ways to the same numbers, lanes last."""
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        a, b = np.broadcast_arrays(a, b)
        off = np.abs(a - b) - ROUNDING * np.max(np.maximum(np.abs(a), np.abs(b)), axis=-1, keepdims=True, initial=0.0)
        if np.any(off > 0.0):
            worst = np.unravel_index(np.argmax(off), off.shape)
            at = f" at {where[int(worst[-1])]}" if where else ""
            raise AssertionError(f"{name}: {what}: {a[worst]:.9g} and {b[worst]:.9g}{at}")


def same(name: str, function: Callable[[dict], dict], found: Found, at: dict, lane: int) -> None:
    """A batch, `jax.vmap`, and that lane in plain Python."""
    with said(name, "cannot be computed without jax.jit"):
        alone = jax.device_get(function(jax.tree.map(lambda leaf: jnp.asarray(leaf[..., lane]), at)))
    for key, part in found.batch.items():
        equal(name, f"the {key} of a batch is not that by jax.vmap", part, found.mapped[key])
        equal(name, f"the {key} in plain Python is not that under jax.jit", alone[key][..., None], part[..., lane : lane + 1])


def differentiated(name: str, found: Found, where: list[str], usual: int, compared: int) -> None:
    """Both modes against each other everywhere, against differences in the first `compared` lanes, of which those after the first `usual`
    may have corners in their slopes."""
    # the reverse mode names the leaf that is to blame; in the forward one 0 times infinity spoils them all
    modes = {"reverse": found.reverse, "forward": found.forward}
    for mode, slopes in modes.items():
        for leaf, lane in np.argwhere(~np.isfinite(slopes)):
            raise AssertionError(
                f"{name}: the {mode} derivative by {found.leaves[leaf]} is {slopes[leaf, lane]} at {where[lane]}"
            )
    # a corner in the slope, as v |v| has at rest, is seen by differences in proportion to their step
    noise = np.where(np.arange(found.size.size) < usual, NOISE, STEP) * np.max(found.size)
    for leaf, *slopes, difference in zip(found.leaves, *modes.values(), found.difference, strict=True):
        for mode, slope in zip(modes, slopes, strict=True):
            share = OFF * np.maximum(np.abs(slope), np.abs(difference)) + noise
            off = (np.abs(slope - difference) - share)[:compared]
            worst = int(np.argmax(off))
            assert off[worst] <= 0.0, (
                f"{name}: the {mode} derivative by {leaf} is {slope[worst]:.6g}, by central differences {difference[worst]:.6g} "
                f"(of the weighted sum of force and rates; {where[worst]})"
            )
    apart = np.abs(found.forward - found.reverse) - ROUNDING * (np.abs(found.forward) + np.max(found.size))
    leaf, lane = (int(k) for k in np.unravel_index(np.argmax(apart), apart.shape))
    assert apart[leaf, lane] <= 0.0, (
        f"{name}: by {found.leaves[leaf]} the forward derivative is {found.forward[leaf, lane]:.6g}, the reverse one "
        f"{found.reverse[leaf, lane]:.6g} at {where[lane]}"
    )
