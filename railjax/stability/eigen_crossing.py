"""The lowest speed at which an eigenvalue of E(v) crosses the imaginary axis, with a proof that none does below it.

Creep damps with 1/v and rolling wheelsets turn with v, so E = A + s B + v G at the slowness s = 1/v: three matrices are all speeds.
Speed by speed the search proves an interval stable and steps to its end. At a centre s_0 with eigenvectors X and W = X^-1,

    W E X (I + dS) = (I + dS)(Lambda + dD) + dF + d^2 N,    d = s - s_0, W E_1 X = D + off-diagonals,

where S moves the eigenvectors to first order wherever two eigenvalues lie far enough apart (else the off-diagonal stays in F). All
eigenvalues are in the left half plane over the whole interval if Lambda + dD outweighs what is left, measured entry by entry:
if a certain matrix of absolute values is an M-matrix (Gershgorin's discs with the best weights). Intervals shrink where that
fails and grow where it holds; ahead of a crossing they end just before it, ever closer, and Newton's method then finds it.

The same array code runs in NumPy, for many lanes in step, and inside a function that JAX compiles.
"""

import contextlib
import functools
from types import ModuleType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Complex, Float

#: relative length of the first interval to either side of its centre, the longest, and the shortest
FIRST, LONGEST, SHORTEST = 0.12, 0.45, 1e-7
#: of the way to a crossing, what the first interval before it leaves out; less and less, by squares
SHARE = 0.3
#: relative distance from a crossing up to which stability is proved
NEAR = 1e-6
#: eigenvalues further apart than this many times their coupling may be told apart to first order
APART = 8.0
#: share of the proof's reserve that an interval should use, and how lengths shrink where they prove too long
AIM, SHRINKING = 0.5, 0.6
#: largest error of W X = 1
INVERTED = 1e-5
#: |lambda| (1/s) of an eigenvalue that is zero at all speeds (a defective pair is rounded to some 1e-6), and the real part of a mode
#: that is undamped at all speeds
ZERO, UNDAMPED = 1e-4, 1e-9
#: intervals tried at most, and what is stepped over without proof where not even the shortest can be proved, relative
MOST, LEAP = 600, 1e-3
#: Newton's steps to the crossing, and the largest last one, relative; its error is the square of that
POLISHING, RESOLVED = 3, 1e-6

Numbers = Float[Array | np.ndarray, "lanes"]
Flags = Bool[Array | np.ndarray, "lanes"]
Square = Float[Array | np.ndarray, "lanes n n"]


class Crossing(NamedTuple):
    """A pair of eigenvalues +-i omega at the speed v (m/s), its dlambda/dv and its vectors, w^T x = 1."""

    speed: Float[Array | np.ndarray, "*lanes"]
    omega: Float[Array | np.ndarray, "*lanes"]
    by_speed: Complex[Array | np.ndarray, "*lanes"]
    right: Complex[Array | np.ndarray, "*lanes states"]
    left: Complex[Array | np.ndarray, "*lanes states"]


class Outcome(NamedTuple):
    """What was found in each lane, beside the crossing."""

    crossed: Flags
    unstable: Flags  # at the lowest speed already
    proved: Flags  # that nothing crosses below, or at all
    failed: Flags


class Pencil(NamedTuple):
    """E(v) = A + B/v + G v; G is None where the wheelsets' spin is left out."""

    constant: Square
    by_slowness: Square
    by_speed: Square | None


class Search(NamedTuple):
    """How far the search of each lane has come; slownesses in s/m."""

    proved: Numbers  # stable from the lowest speed to here
    length: Numbers  # of the next interval, to either side of its centre
    ahead: Numbers  # where the nearest crossing seems to be; -inf for none
    share: Numbers  # of the way to that crossing, what the next interval leaves out
    gaps: Flags  # something on the way could not be proved
    crossed: Flags
    done: Flags


def speeds_of(lowest: Any, highest: Any) -> tuple:
    """Three speeds (m/s) at which E is wanted for `pencil`."""
    return lowest, 2.0 / (1.0 / lowest + 1.0 / highest), highest


def pencil(at: Any, speeds: tuple, gyroscopic: bool) -> Pencil:
    """A, B and G from E at the three speeds, (3, lanes, n, n)."""
    v = speeds
    if not gyroscopic:
        by_slowness = (at[0] - at[2]) / (1.0 / v[0] - 1.0 / v[2])
        return Pencil(at[2] - by_slowness / v[2], by_slowness, None)
    # divided differences of v E = B + A v + G v^2
    first, second = (v[1] * at[1] - v[0] * at[0]) / (v[1] - v[0]), (v[2] * at[2] - v[1] * at[1]) / (v[2] - v[1])
    by_speed = (second - first) / (v[2] - v[0])
    constant = first - (v[0] + v[1]) * by_speed
    return Pencil(constant, v[0] * (at[0] - constant - v[0] * by_speed), by_speed)


class _Modes(NamedTuple):
    values: Any  # (lanes, n)
    right: Any  # X
    left: Any  # W
    moved: Any  # W dE/ds X
    turning: Any  # |W G X|, or None
    neutral: Any  # zero or undamped at all speeds, but for rounding

    @property
    def drift(self) -> Any:
        """dlambda/ds of each eigenvalue."""
        return self.moved.diagonal(axis1=-2, axis2=-1)


def _modes(of: Pencil, s: Any, xp: ModuleType) -> _Modes:
    by_s, slowness = of.by_slowness, s[:, None, None]
    matrix, turning = of.constant + slowness * by_s, None
    if of.by_speed is not None:
        matrix, by_s = matrix + of.by_speed / slowness, by_s - of.by_speed / slowness**2
    values, x = xp.linalg.eig(matrix)
    w, left_over = _inverse(x, xp)
    w = xp.where((xp.abs(left_over).max(axis=(1, 2)) < INVERTED)[:, None, None], w, xp.nan)
    if of.by_speed is not None:
        turning = xp.abs(w @ of.by_speed @ x)
    modes = _Modes(values, x, w, w @ by_s @ x, turning, None)
    least = xp.where(xp.abs(values) < ZERO, ZERO, UNDAMPED)
    return modes._replace(neutral=(xp.abs(values.real) < least) & (s[:, None] * xp.abs(modes.drift.real) < least))


def _inverse(x: Any, xp: ModuleType) -> tuple[Any, Any]:
    """W = X^-1, and 1 - W X."""
    eye = xp.eye(x.shape[-1])
    if xp is np:
        w = _solved(x, np.broadcast_to(eye, x.shape), np)
        return w, eye - w @ x
    turn = _rotation(x.shape[-1])
    w = _solved(turn @ x, jnp.broadcast_to(turn, x.shape), jnp)
    w = w + (eye - w @ x) @ w  # Newton's step
    return w, eye - w @ x


@functools.cache
def _rotation(n: int) -> Float[np.ndarray, "n n"]:
    """Some rotation, after which the pivots of a matrix need not be searched for."""
    return np.linalg.qr(np.random.default_rng(0).normal(size=(n, n)))[0]


def _solved(matrix: Any, right: Any, xp: ModuleType) -> Any:
    """matrix^-1 right of stacked matrices, NaN where one is singular.

    Compiled, by elimination without LAPACK, whose threads get into each other's way where two CPU devices call it (15 ms for 3 ms), and
    without a search for pivots: what it finds is tested.
    """
    if xp is np:
        try:
            return np.linalg.solve(matrix, right)
        except np.linalg.LinAlgError:
            found = np.full(right.shape, np.nan, np.result_type(matrix, right))
            for lane in range(len(found)):
                with contextlib.suppress(np.linalg.LinAlgError):
                    found[lane] = np.linalg.solve(matrix[lane], right[lane])
            return found
    n = matrix.shape[-1]
    index = jnp.arange(n)[:, None]

    def eliminate(k: Array, both: Array) -> Array:
        row = both[:, k] / both[:, k, k, None]
        column = both[:, :, k, None]
        return jnp.where(index == k, row[:, None], both - column * row[:, None])

    both = jnp.concatenate([matrix, right.astype(matrix.dtype)], axis=2)
    return jax.lax.fori_loop(0, n, eliminate, both)[:, :, n:]


def _proved(modes: _Modes, curved: Any, lower: Any, upper: Any, xp: ModuleType) -> Any:
    """Whether all eigenvalues of Lambda + d M + d^2 R, |R| <= `curved`, are in the left half plane for d in [-lower, upper]; and what
    share of that proof's reserve (0 to 1) it uses up."""
    values, drift = modes.values, modes.drift
    eye = xp.eye(values.shape[-1], dtype=bool)
    off = xp.where(eye, 0.0, modes.moved)
    size = xp.abs(off)
    d = xp.maximum(lower, upper)[:, None, None]
    gap = values[:, None, :] - values[:, :, None]
    # the geometric mean does not depend on the vectors' lengths
    apart = ~eye & (xp.abs(gap) > APART * d * xp.sqrt(size * xp.swapaxes(size, 1, 2)))
    s = xp.where(apart, off / xp.where(apart, gap, 1.0), 0.0)
    second = xp.abs(off @ s - s * (drift[:, None, :] - drift[:, :, None]))
    turned = d * xp.abs(s)
    rest = d * xp.where(apart, 0.0, size) + d**2 * second
    if curved is not None:
        rest = rest + d**2 * (curved + curved @ turned)
    # the slowest decay within the interval; what is neutral at all speeds is set aside
    real = xp.maximum((values - lower[:, None] * drift).real, (values + upper[:, None] * drift).real)
    decay = xp.where(modes.neutral, 1.0, -real)
    comparison = (eye - turned) - rest / decay[:, None, :]
    weights = _solved(comparison, xp.ones((*values.shape, 1)), xp)
    again = _solved(comparison, weights, xp)
    fits = (comparison @ weights > 0.0).all(axis=(1, 2))  # with weights > 0 that is what makes it an M-matrix
    used = 1.0 - 1.0 / xp.max(again / weights, axis=(1, 2))  # its spectral radius, by Collatz and Wielandt
    return fits & (decay > 0.0).all(axis=1) & (weights > 0.0).all(axis=(1, 2)), used  # False for NaN


def _advance(of: Pencil, end: Any, search: Search, xp: ModuleType) -> Search:
    """One more interval tried, in every lane; `end` is the slowness (s/m) of the highest speed."""
    proved = search.proved
    length = xp.minimum(search.length, 0.5 * (proved - xp.maximum(search.ahead, end)))
    length = xp.maximum(length, SHORTEST * proved)
    centre = xp.maximum(proved - length, end)
    modes = _modes(of, centre, xp)
    # how far each eigenvalue is from the axis, going up in speed
    real = xp.where(modes.neutral, -xp.inf, modes.values.real)
    rising = (modes.drift.real < 0.0) & ~modes.neutral
    way = xp.min(xp.where(rising, real / xp.where(rising, modes.drift.real, 1.0), xp.inf), axis=1)
    stable = xp.max(real, axis=1) < 0.0  # False for NaN
    lower = xp.clip((1.0 - search.share) * way, 0.0, xp.minimum(length, centre - end))
    curved = None
    if modes.turning is not None:  # v - v_0 = -v_0^2 d + v v_0^2 d^2
        curved = modes.turning / (centre**2 * (centre - lower))[:, None, None]
    holds, used = _proved(modes, curved, lower, proved - centre, xp)
    holds = stable & holds
    short = ~holds & (length <= 2.0 * SHORTEST * proved)
    leap = short & stable
    foreseen = xp.where(stable, centre - way, search.ahead)
    before = xp.where(holds, centre - lower, proved)  # up to here all is stable
    near = (holds & (foreseen > end) & (before - foreseen <= NEAR * before)) | (short & ~stable)
    limited = holds & (lower < length) & (before > end)
    reached = xp.where(leap, xp.maximum(proved * (1.0 - LEAP), end), before)
    growing = xp.clip(xp.sqrt(AIM / xp.maximum(used, 0.01)), 0.7, 2.0)  # what is left over grows with the square of the length
    return Search(
        proved=reached,
        length=xp.where(holds, xp.where(limited, length, xp.minimum(growing * length, LONGEST * reached)), SHRINKING * length),
        ahead=xp.where(short, xp.where(leap, -xp.inf, centre), foreseen),
        share=xp.where(limited, search.share**2, xp.where(holds, SHARE, xp.sqrt(search.share))),
        gaps=search.gaps | leap,
        crossed=search.crossed | near,
        done=search.done | near | (reached <= end),
    )


def _start(of: Pencil, begin: Any, xp: ModuleType) -> tuple[Search, Outcome]:
    """Before the first interval; lanes that end at once, because they are unstable at the lowest speed or not finite, are done."""
    modes = _modes(of, begin, xp)
    growth = xp.max(xp.where(modes.neutral, -xp.inf, modes.values.real), axis=1)
    failed, unstable = ~xp.isfinite(modes.values).all(axis=1), growth > 0.0
    none, gaps, crossed = (xp.zeros(begin.shape, bool) for _ in range(3))  # each its own: NumPy writes into those of the search
    search = Search(
        begin, FIRST * begin, xp.full(begin.shape, -xp.inf), xp.full(begin.shape, SHARE), gaps, crossed, failed | unstable
    )
    return search, Outcome(none, unstable, none, failed)


def _end(of: Pencil, end: Any, search: Search, outcome: Outcome, xp: ModuleType) -> tuple[Crossing, Outcome]:
    """Newton's method from where the crossing was foreseen, on the eigenvalue nearest to the axis there."""
    s = start = xp.where(search.crossed, search.ahead, end)
    follow = None
    for _ in range(POLISHING):
        modes = _modes(of, s, xp)
        real = xp.where(modes.neutral, -xp.inf, modes.values.real)
        distance = -real if follow is None else xp.abs(modes.values - follow[:, None])
        which = xp.argmin(distance, axis=1)[:, None]
        value, drift = (xp.take_along_axis(of_all, which, axis=1)[:, 0] for of_all in (modes.values, modes.drift))
        step = -value.real / drift.real
        taken = xp.where(search.crossed & (xp.abs(step) < LEAP * s), step, 0.0)  # not NaN, and not far away
        follow = 1j * (value + drift * taken).imag
        s = s + taken
    right = xp.take_along_axis(modes.right, which[:, None, :], axis=2)[:, :, 0]
    left = xp.take_along_axis(modes.left, which[:, :, None], axis=1)[:, 0, :]
    sound = (xp.abs(step) <= RESOLVED * s) & (xp.abs(s - start) <= 10.0 * LEAP * start) & (drift.real < 0.0)
    lost = ~search.done | (search.crossed & ~sound)
    speed = xp.where(search.crossed, 1.0 / s, xp.inf)
    crossing = Crossing(speed, xp.abs(follow.imag), -(s**2) * drift, right, left)
    failed = outcome.failed | lost
    return crossing, Outcome(search.crossed & ~failed, outcome.unstable, ~search.gaps & ~failed, failed)


def lowest_crossing(of: Pencil, lowest: Any, highest: Any) -> tuple[Crossing, Outcome]:
    """For lanes on the first axis, between two speeds (m/s), in NumPy: lanes that are done are dropped from the work."""
    good = np.isfinite(sum(part.sum(axis=(1, 2)) for part in of if part is not None))
    of = Pencil(*(None if part is None else np.where(good[:, None, None], part, -np.eye(part.shape[-1])) for part in of))
    begin, end = np.full(len(good), 1.0 / lowest), 1.0 / highest
    with np.errstate(all="ignore"):
        search, outcome = _start(of, begin, np)
        outcome = outcome._replace(failed=outcome.failed | ~good)
        search = search._replace(done=search.done | ~good)
        for _ in range(MOST):
            left = np.flatnonzero(~search.done)
            if not len(left):
                break
            here, those = (type(tree)(*(part if part is None else part[left] for part in tree)) for tree in (of, search))
            for whole, new in zip(search, _advance(here, end, those, np), strict=True):
                whole[left] = new
        return _end(of, end, search, outcome, np)


def lowest_crossing_compiled(of: Pencil, lowest: Any, highest: Any) -> tuple[Crossing, Outcome]:
    """The same inside a function that JAX compiles, for one lane or few: all go on until the last is done."""
    search, outcome = _start(of, jnp.full(of.constant.shape[0], 1.0 / lowest), jnp)
    end = 1.0 / highest

    def unfinished(carry: tuple) -> Array:
        count, search = carry
        return (count < MOST) & ~jnp.all(search.done)

    def onward(carry: tuple) -> tuple:
        count, search = carry
        new = _advance(of, end, search, jnp)
        return count + 1, jax.tree.map(lambda old, new: jnp.where(search.done, old, new), search, new)

    _, search = jax.lax.while_loop(unfinished, onward, (jnp.array(0), search))
    return _end(of, end, search, outcome, jnp)
