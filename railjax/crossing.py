"""Where eigenvalues of E(v) first cross the imaginary axis, for many vehicles at once and without LAPACK: all is matrix products.

The Cayley transform C = (sI + E)(sI - E)^-1 takes the left half plane into the unit circle, so that |C^N| < 1, for any norm and any N,
proves E stable; N = 2^k costs k products. Along a grid of speeds each lane is followed up to the first speed where that proof
fails. There C^N is all but of rank 2, its columns and rows being the right and left eigenvectors of the fastest growing pair:
two-sided Rayleigh quotient iteration with Newton's method for the speed, v <- v - Re(lambda)/Re(dlambda/dv), takes that pair to the axis.
At last the pair is taken out of C (C - sum c x w^T, with c its eigenvalue and w^T x = 1) and what remains is proved stable likewise; where it
is not, its fastest growing pair is the next to be taken to the axis. Lanes that end without proof are marked, for a
slower method.
"""

import functools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Complex, Float, Int

#: lanes worked on together: their matrices stay in the second cache
TOGETHER = 16

#: s of the Cayley transform, rad/s: a mode decays quickest in it where |lambda| = s; lightly damped ones lie at 1 to 50
CAYLEY = 25.0

#: squarings that may be spent on the proof at a grid speed, and for the eigenvectors and the proof at the crossing
SCAN, FULL = 20, 22

#: largest last step in speed, relative, and residual of the eigenpair
TOLERANCE = 1e-6

#: steps of Rayleigh quotient and Newton; modes taken to the axis one after another
STEPS, ROUNDS = 7, 6

#: |C^N| beyond this is growth, not a transient
GROWN = 1e6

#: log |C^N| at which the fastest growing pair has left the others behind
SEPARATED = 1e3

#: E of the lanes with these indices at these speeds
Matrices = Callable[[Int[Array, "k"], Float[Array, "k"]], Float[Array, "k states states"]]


class Crossing(NamedTuple):
    """A pair of eigenvalues +-i omega at the speed v (m/s), its dlambda/dv and its vectors, w^T x = 1."""

    speed: Float[Array, "*lanes"]
    omega: Float[Array, "*lanes"]
    by_speed: Complex[Array, "*lanes"]
    right: Complex[Array, "*lanes states"]
    left: Complex[Array, "*lanes states"]


def inverse(a: Array) -> Array:
    """Inverses of matrices (k, m, m) by Gauss-Jordan elimination without a search for pivots; the caller checks what it does."""
    a = jnp.moveaxis(a, 0, -1)  # lanes last, so that they fill the vector registers
    index = jnp.arange(a.shape[0])

    def eliminate(k: Array, a: Array) -> Array:
        here = (index == k)[:, None]
        row, column = a[k], a[:, k]
        reciprocal = 1.0 / row[k]
        row = jnp.where(here, reciprocal, row * reciprocal)
        others = jnp.where(here[None], 0.0, a) - column[:, None] * row[None]
        return jnp.where(here[:, None], row[None], others)

    return jnp.moveaxis(jax.lax.fori_loop(0, a.shape[0], eliminate, a), -1, 0)


def resolvent(matrix: Float[Array, "k states states"], shift: Array, coordinates: int) -> Array:
    """(E - sI)^-1, with the velocities p = sq + a eliminated first: only a matrix of the size of q and the internal states is left."""
    n, states = coordinates, matrix.shape[-1]
    s = shift[:, None, None]
    q, p, z = slice(n), slice(n, 2 * n), slice(2 * n, None)
    below, unit = slice(n, None), jnp.eye(states - n)
    by_p = matrix[:, below, p] - s * unit[:, :n]
    dynamic = jnp.concatenate([matrix[:, below, q] + s * by_p, matrix[:, below, z] - s * unit[:, n:]], axis=2)
    solved = inverse(dynamic)
    rows = jnp.concatenate([-solved @ by_p, solved], axis=2)  # of q, then of the internal states
    return jnp.concatenate([rows[:, :n], s * rows[:, :n] + jnp.eye(n, states), rows[:, n:]], axis=1)


def scales(states: int, coordinates: int) -> Float[Array, "states"]:
    """Displacements against velocities, so that a norm is not that of the units."""
    return jnp.where(jnp.arange(states) < coordinates, CAYLEY, 1.0)


def _squared(
    matrix: Float[Array, "k states states"],
    coordinates: int,
    most: int,
    decided: Callable[[Array], Array],
    removed: Float[Array, "k states states"] | float = 0.0,
) -> tuple[Float[Array, "k states states"], Float[Array, "k"]]:
    """C^N, scaled to norm 1, and log |C^N|, squared until every lane's logarithm is decided, `most` times at most; C without
    what is to be removed from it."""
    states = matrix.shape[-1]
    scale = scales(states, coordinates)
    shift = jnp.full(matrix.shape[0], CAYLEY)
    cayley = -jnp.eye(states) - 2.0 * CAYLEY * resolvent(matrix, shift, coordinates) - removed
    cayley = cayley * (scale[:, None] / scale)

    def scaled(power: Array, logarithm: Array) -> tuple[Array, Array]:
        norm = jnp.sqrt(jnp.sum(power**2, axis=(1, 2)))
        return power / norm[:, None, None], logarithm + jnp.log(norm)

    def more(carry: tuple[Array, Array, Array]) -> Array:
        count, _, logarithm = carry
        return (count < most) & ~jnp.all(decided(logarithm) | ~jnp.isfinite(logarithm))

    def square(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        count, power, logarithm = carry
        return count + 1, *scaled(power @ power, 2.0 * logarithm)

    start = scaled(cayley, jnp.zeros_like(shift))
    _, power, logarithm = jax.lax.while_loop(more, square, (jnp.array(0), *start))
    return power * (scale / scale[:, None]), logarithm


def growth(matrix: Float[Array, "k states states"], coordinates: int) -> Float[Array, "k"]:
    """log |C^N|: below 0 the matrix is proved stable, above log(GROWN) unstable, between them it is not known."""
    return _squared(matrix, coordinates, SCAN, lambda log: (log < 0.0) | (log > jnp.log(GROWN)))[1]


def _dominant(
    matrix: Float[Array, "k states states"], power: Float[Array, "k states states"]
) -> tuple[Complex[Array, "k"], Complex[Array, "k states"], Complex[Array, "k states"]]:
    """Eigenvalue, right and left vectors of the pair that C^N has left over."""
    states = matrix.shape[-1]
    # two columns, and two rows, as a power without structure of its own mixes them
    mixed = jnp.cos(jnp.arange(2 * states) ** 2 * 1.0).reshape(states, 2)
    right, left = power @ mixed, jnp.swapaxes(power, 1, 2) @ mixed
    gram = jnp.swapaxes(left, 1, 2) @ right
    image = jnp.swapaxes(left, 1, 2) @ (matrix @ right)
    # the quadratic det(image - lambda gram) = 0
    two, one, zero = _determinant(gram, gram), -_mixed(image, gram), _determinant(image, image)
    root = jnp.sqrt((one**2 - 4.0 * two * zero).astype(complex))
    root = jnp.where(two > 0, root, -root)  # the larger real part, or the positive imaginary one
    value = (-one + root) / (2.0 * two)
    pencil = image - value[:, None, None] * gram
    column = jnp.stack([-pencil[:, 0, 1], pencil[:, 0, 0]], axis=1)
    row = jnp.stack([-pencil[:, 1, 0], pencil[:, 0, 0]], axis=1)
    x, w = jnp.einsum("kij,kj->ki", right, column), jnp.einsum("kij,kj->ki", left, row)
    return value, x, w


def _determinant(a: Array, b: Array) -> Array:
    return a[:, 0, 0] * b[:, 1, 1] - a[:, 0, 1] * b[:, 1, 0]


def _mixed(a: Array, b: Array) -> Array:
    return a[:, 0, 0] * b[:, 1, 1] + b[:, 0, 0] * a[:, 1, 1] - a[:, 0, 1] * b[:, 1, 0] - b[:, 0, 1] * a[:, 1, 0]


def _to_axis(
    at: Callable[[Float[Array, "k"]], tuple[Array, Array]],
    coordinates: int,
    speed: Float[Array, "k"],
    start: tuple[Array, Array, Array],
    bounds: tuple[Float[Array, "k"], Float[Array, "k"]],
) -> tuple[Crossing, Bool[Array, "k"]]:
    """Follow an eigenpair to the axis; also whether it got there, rising."""

    def step(carry: tuple, _: None) -> tuple[tuple, tuple]:
        speed, shift, x, w = carry
        matrix, by_speed = at(speed)
        solve = resolvent(matrix, shift, coordinates)
        x, w = jnp.einsum("kij,kj->ki", solve, x), jnp.einsum("kji,kj->ki", solve, w)
        x = x / jnp.sqrt(jnp.sum(jnp.abs(x) ** 2, axis=1, keepdims=True))
        w = w / jnp.sum(w * x, axis=1, keepdims=True)
        value = jnp.einsum("ki,kij,kj->k", w, matrix, x)
        slope = jnp.einsum("ki,kij,kj->k", w, by_speed, x)
        newton = -value.real / slope.real
        moved = jnp.clip(speed + newton, *bounds)
        # where the eigenvalue will be there; a little beside it, so that the matrix is not singular
        shift = value + slope * (moved - speed)
        shift = shift + 1e-9 * CAYLEY
        defect = scale * (jnp.einsum("kij,kj->ki", matrix, x) - value[:, None] * x)
        residual = jnp.sqrt(jnp.sum(jnp.abs(defect) ** 2, axis=1) / jnp.sum(jnp.abs(scale * x) ** 2, axis=1))
        sound = (jnp.abs(newton) < TOLERANCE * speed) & (residual < TOLERANCE * CAYLEY) & (slope.real > 0.0)
        return (moved, shift, x, w), (slope, sound)

    scale = scales(start[1].shape[1], coordinates)
    (moved, shift, x, w), (slope, sound) = jax.lax.scan(step, (speed, *start), length=STEPS)
    return Crossing(moved, jnp.abs(shift.imag), slope[-1], x, w), sound[-1]


def _in_pieces(
    selected: Bool[Array, "lanes"], work: Callable[[Int[Array, "k"], tuple], tuple], carry: tuple, piece: int
) -> tuple:
    """`carry` after `work(indices, carry)` for all selected lanes, `piece` at a time (some twice, to fill the last)."""
    order = jnp.argsort(~selected, stable=True)
    pieces = (jnp.sum(selected) + piece - 1) // piece
    return jax.lax.fori_loop(0, pieces, lambda i, c: work(jax.lax.dynamic_slice(order, (i * piece,), (piece,)), c), carry)


def first_unproved(matrices: Matrices, lanes: int, coordinates: int, speeds: Float[Array, "points"]) -> tuple[Array, Array]:
    """Index of the first speed at which stability is not proved (the number of speeds where there is none), and log |C^N| there."""
    points, piece = speeds.shape[0], min(TOGETHER, lanes)

    def at_speed(carry: tuple) -> tuple:
        point, first, last = carry

        def check(index: Array, carry: tuple) -> tuple:
            first, last = carry
            log = growth(matrices(index, jnp.full(piece, speeds[point])), coordinates)
            fresh = first[index] == points
            proved = log < 0.0  # False for NaN
            return (
                first.at[index].set(jnp.where(fresh & ~proved, point, first[index])),
                last.at[index].set(jnp.where(fresh, log, last[index])),
            )

        return point + 1, *_in_pieces(first == points, check, (first, last), piece)

    start = jnp.array(0), jnp.full(lanes, points), jnp.zeros(lanes)
    _, first, last = jax.lax.while_loop(lambda carry: (carry[0] < points) & jnp.any(carry[1] == points), at_speed, start)
    return first, last


def crossings(
    matrices: Matrices,
    lanes: int,
    coordinates: int,
    wanted: Bool[Array, "lanes"],
    low: Float[Array, "lanes"],
    high: Float[Array, "lanes"],
) -> tuple[Crossing, Bool[Array, "lanes"]]:
    """The crossing between `low` and `high` m/s at which all other eigenvalues are in the left half plane, and whether it was found."""
    piece = min(TOGETHER, lanes)

    def work(index: Array, carry: tuple) -> tuple:
        found, proved = _proved_crossing(functools.partial(matrices, index), coordinates, low[index], high[index])
        crossing, all_proved = carry
        return jax.tree.map(lambda all, new: all.at[index].set(new), crossing, found), all_proved.at[index].set(proved)

    states = jax.eval_shape(matrices, jnp.zeros(1, int), jnp.zeros(1)).shape[-1]
    vectors = jnp.zeros((lanes, states), complex)
    nothing = Crossing(jnp.zeros(lanes), jnp.zeros(lanes), jnp.zeros(lanes, complex), vectors, vectors)
    return _in_pieces(wanted, work, (nothing, jnp.zeros(lanes, bool)), piece)


def _proved_crossing(
    matrix_at: Callable[[Float[Array, "k"]], Float[Array, "k states states"]],
    coordinates: int,
    low: Float[Array, "k"],
    high: Float[Array, "k"],
) -> tuple[Crossing, Bool[Array, "k"]]:
    def at(speed: Float[Array, "k"]) -> tuple[Float[Array, "k states states"], Float[Array, "k states states"]]:
        return jax.jvp(matrix_at, (speed,), (jnp.ones_like(speed),))

    margin = 1e-3 * (high - low)
    bounds = low - margin, high + margin

    def unproved(carry: tuple) -> Array:
        count, _, _, proved = carry
        return (count <= ROUNDS) & ~jnp.all(proved)

    def one_round(carry: tuple) -> tuple:
        count, found, sound, proved = carry
        matrix, _ = at(found.speed)
        power, log = _squared(matrix, coordinates, FULL, lambda log: (log < 0.0) | (log > SEPARATED), _share(found))
        proved = proved | (sound & (log < 0.0))

        def next_mode() -> tuple[Crossing, Array]:
            new, sound = _to_axis(at, coordinates, found.speed, _dominant(matrix, power), bounds)
            choose = lambda old, new: jnp.where(proved.reshape((-1,) + (1,) * (old.ndim - 1)), old, new)  # noqa: E731
            return jax.tree.map(choose, found, new), proved | sound

        found, sound = jax.lax.cond(jnp.all(proved), lambda: (found, sound), next_mode)
        return count + 1, found, sound, proved

    zero, no = jnp.zeros((*high.shape, matrix_at(high).shape[-1]), complex), jnp.zeros_like(high, bool)
    start = Crossing(high, jnp.zeros_like(high), jnp.zeros_like(high, complex), zero, zero)
    _, found, _, proved = jax.lax.while_loop(unproved, one_round, (jnp.array(0), start, no, no))
    return found, proved


def _share(found: Crossing) -> Float[Array, "k states states"]:
    """What the pair contributes to the Cayley transform: c x w^T and its conjugate, or, of a real eigenvalue, c x w^T alone."""
    value = 1j * found.omega
    cayley = (CAYLEY + value) / (CAYLEY - value)
    times = jnp.where(found.omega > TOLERANCE * CAYLEY, 2.0, 1.0)
    return jnp.real((times * cayley)[:, None, None] * found.right[:, :, None] * found.left[:, None, :])


def one_by_one(selected: Bool[Array, "lanes"], function: Callable[[Array], tuple], carry: tuple) -> tuple:
    """`carry` (lanes first) with `function(index)` in place of what stood there, for all selected lanes."""

    def work(index: Int[Array, "1"], carry: tuple) -> tuple:
        return jax.tree.map(lambda all, new: all.at[index[0]].set(new), carry, function(index[0]))

    return _in_pieces(selected, work, carry, 1)
