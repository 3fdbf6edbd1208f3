"""The motions to which a vehicle is drawn from large disturbances: simulated until they settle, then a guess for Newton.

A vehicle has more than one limit cycle at a speed, because each bogie may hunt or stand still. `drawn` simulates a batch of
starts at once, and `patterns` makes the starts that between them reach the limit cycles of bogies that barely feel each other.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .deflections import labels
from .integrate import BURST, Plan, largest_divisor, run
from .motion import state_size, wheelset_shape
from .orbits import Model, Orbit, Problem, Shooting, amplitude_index, at_speed, displacements, pack
from .track import TangentTrack
from .typing import Scalar

#: most periods of simulation; the slowest multiplier of the coach's stable limit cycles is about 0.97
SETTLING = 60
#: relative change of the amplitude in a period below which a motion has settled
STEADY = 1e-4
#: periods of history in which one of the motion is looked for: the motion may be slower than the mode it began with
HISTORY = 4


class Drawn(NamedTuple):
    """Where the motions of a batch ended: packed orbits as guesses for Newton, the largest displacement of any wheelset (m), and
    whether the wheelset that measures the amplitude still swings to both sides."""

    guesses: Float[Array, "lanes unknowns"]
    displacements: Float[Array, "lanes"]
    swings: Bool[Array, "lanes"]


def drawn(
    model: Model,
    shooting: Shooting,
    starts: Float[Array, "lanes states"],
    period: Scalar,
    speeds: Float[Array, "lanes"],
    rest: Scalar = 0.0,
) -> Drawn:
    """The motions from `starts` at `speeds` (m/s), simulated with steps for about the `period` (s).

    A motion whose wheelsets all move by less than `rest` (m) has died out; the simulation ends when each has settled or died out,
    at the latest after `SETTLING` periods.
    """
    per_period = 2 * shooting.steps if shooting.symmetric else shooting.steps
    every = largest_divisor(per_period, BURST)
    plan = Plan(samples=1, every=every, record=(), reduce=("peak:wheelset_y",))

    def some_steps(x: Float[Array, "states lanes"], _: None) -> tuple[Array, tuple[Array, Array]]:
        """The batch kernel of `simulate`, lanes last."""
        ran = run(model.vehicle, model.damper, speeds, TangentTrack(), x, period / per_period, 0.0, plan)
        return ran.final, (x, ran.reductions[plan.reduce[0]])

    def unsettled(carry: _Settling) -> Bool[Array, ""]:
        settled = jnp.abs(carry.now - carry.before) < STEADY * carry.now
        done = settled | (carry.now < rest) | ~jnp.isfinite(carry.now)
        return (carry.count < HISTORY) | (~jnp.all(done) & (carry.count < SETTLING))

    def one_period(carry: _Settling) -> _Settling:
        x, (states, peaks) = jax.lax.scan(some_steps, carry.x, length=per_period // every)
        history = jnp.concatenate([carry.history[states.shape[0] :], states])
        return _Settling(x, history, carry.now, jnp.max(peaks, axis=(0, 1, 2)), carry.count + 1)

    x, nothing = starts.T, jnp.zeros(speeds.shape)
    empty = jnp.zeros((HISTORY * per_period // every, *x.shape))
    end = jax.lax.while_loop(unsettled, one_period, _Settling(x, empty, nothing, nothing, jnp.asarray(0)))

    def closed(history: Float[Array, "samples states"], speed: Array) -> tuple[Array, Bool[Array, ""]]:
        y = history[:, amplitude_index(model.vehicle, shooting.wheelset)]
        weights, length, swings = _one_swing(y)
        guess = Orbit(weights @ history, jnp.where(swings, length * every / per_period, 1.0) * period, speed)
        return pack(model, shooting, guess), swings

    guesses, swings = jax.vmap(closed, in_axes=(2, 0))(end.history, speeds)
    return Drawn(guesses, end.now, swings)


class _Settling(NamedTuple):
    """Motions on their way: states, those of the last periods, the peaks of the period before and of the last, periods."""

    x: Float[Array, "states lanes"]
    history: Float[Array, "samples states lanes"]
    before: Float[Array, "lanes"]
    now: Float[Array, "lanes"]
    count: Int[Array, ""]


def _one_swing(y: Float[Array, "samples"]) -> tuple[Float[Array, "samples"], Float[Array, ""], Bool[Array, ""]]:
    """Weights of the samples at the instant when y is farthest to the right in the first half, samples of the period after it, and
    whether there is one."""
    index = jnp.arange(y.shape[0])
    right = jnp.argmax(jnp.where((index > 0) & (index < y.shape[0] // 2), y, -jnp.inf))
    # the top of the parabola through three samples
    left, top, after = y[right - 1], y[right], y[right + 1]
    curved = 2.0 * top - left - after
    off = jnp.clip(jnp.where(curved > 0.0, 0.5 * (after - left) / jnp.where(curved > 0.0, curved, 1.0), 0.0), -0.5, 0.5)
    parabola = jnp.stack([0.5 * off * (off - 1.0), 1.0 - off**2, 0.5 * off * (off + 1.0)])
    weights = jnp.zeros(y.shape).at[right + jnp.arange(-1, 2)].set(parabola)
    # two passages through the middle from right to left
    ahead = jnp.append(y[1:], y[-1])
    passing = (y > 0.0) & (ahead <= 0.0)
    first = jnp.argmax(passing & (index >= right))
    second = jnp.argmax(passing & (index > first))
    instants = index + y / jnp.where(passing, y - ahead, 1.0)
    return weights, instants[second] - instants[first], (first >= right) & passing[first] & (second > first)


def settled(model: Model, shooting: Shooting, state: Float[Array, "states"], period: Scalar, speed: Scalar) -> Problem:
    """The limit cycle to which the vehicle is drawn at a speed (m/s) from a state on, about whose period (s) is known."""
    found = drawn(model, shooting, state[None], period, jnp.asarray(speed)[None])
    return at_speed(model, shooting, found.guesses[0], speed)


def patterns(model: Model, state: Float[Array, "states"], displacement: Scalar) -> Float[Array, "patterns states"]:
    """Starts made of the motion of the bogie that moves most: all bogies alike, neighbours opposite, and each by itself.

    The largest displacement of its wheelsets becomes `displacement` (m); the car body and the dampers' internal states stay.
    """
    own, shared = _parts(model)
    bogies = len(own)
    moved = jnp.max(jnp.abs(state[displacements(model)]).reshape(bogies, -1), axis=1)
    most = jnp.argmax(moved)
    motion = state[jnp.asarray(own)[most]] * displacement / moved[most]
    signs = [np.ones(bogies)] if bogies == 1 else [np.ones(bogies), (-1.0) ** np.arange(bogies), *np.eye(bogies)]
    each = jnp.asarray(np.array(signs))[:, :, None] * motion
    return jnp.zeros((len(signs), state.shape[0])).at[:, own].set(each) + state * shared


def _parts(model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Which states are each bogie's and its wheelsets' own (bogies, own), and 1 for those that are no bogie's."""
    bogies, axles = wheelset_shape(model.vehicle)
    names = labels(model.vehicle)

    def of(name: str) -> int:
        part, _, index = name.partition("[")
        if part.startswith("carbody"):
            return -1
        return int(index[:-1]) // (axles if part.startswith("wheelset") else 1)

    owner = np.array([of(name) for name in names])
    owner = np.concatenate([owner, owner, np.full(state_size(model.vehicle, model.damper) - 2 * len(names), -1)])
    return np.array([np.flatnonzero(owner == bogie) for bogie in range(bogies)]), (owner == -1).astype(float)
