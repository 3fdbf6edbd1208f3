"""Numbers handed over in few arrays: what belongs to one kind of tree is never handed the program of another."""

import jax

import railjax
from railjax.base.packing import Packed


def test_laws_that_differ_in_nothing_but_their_class_are_told_apart():
    laws = railjax.Skyhook(damping=1e5), railjax.BalanceLogic(force_limit=5e3)
    one, other = (jax.tree.structure(Packed.of((law, 50.0))) for law in laws)
    # JAX's own comparison says that they are equal
    assert one != other
    assert one == jax.tree.structure(Packed.of((railjax.Skyhook(damping=2e5), 60.0)))
    assert type(Packed.of(laws).unpacked()[1]) is railjax.BalanceLogic
