"""Registered dataclasses: told apart by their class on every release, rebuilt whole, their leaves named."""

from dataclasses import dataclass

import jax

from railjax.base.fields import structure
from railjax.base.pytrees import registered


@registered
@dataclass(frozen=True)
class One:
    gain: float = 1.0
    law: str = structure("sharp")


@registered
@dataclass(frozen=True)
class Other:
    gain: float = 1.0
    law: str = structure("sharp")


def test_same_fields_of_another_class_are_another_tree():
    one, other = jax.tree.structure(One()), jax.tree.structure(Other())
    assert one != other
    assert one == jax.tree.structure(One(3.0))
    assert one != jax.tree.structure(One(law="smooth"))


def test_rebuilt_and_named():
    assert jax.tree.map(lambda leaf: 2.0 * leaf, One(3.0, "smooth")) == One(6.0, "smooth")
    ((path, leaf),) = jax.tree_util.tree_leaves_with_path(One(3.0))
    assert (jax.tree_util.keystr(path), leaf) == (".gain", 3.0)
