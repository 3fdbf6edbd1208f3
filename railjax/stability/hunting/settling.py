"""The motions to which a vehicle is drawn from large disturbances: simulated until they settle, then a guess for Newton.

A vehicle has more than one limit cycle at a speed, because each bogie may hunt or stand still. `drawn` simulates many
starts of many vehicles, and `patterns` makes the starts that between them reach the limit cycles of bogies that barely feel each other.
"""

import functools
import itertools
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float, Int

from ...base.batches import CHUNK, cores, in_threads
from ...base.compilation import QUICK, one_kernel, options
from ...base.packing import Form
from ...base.programs import kept
from ...model.kinematics import labels, size
from ...model.motion import held, wheelset_shape
from ...simulation.runge_kutta import rk4_in_loop
from .orbits import Model, Orbit, Shooting, advanced, pack, state_rates
from .shooting import OrbitProblem, at_speed

#: most periods of simulation; the slowest multiplier of the coach's stable limit cycles is about 0.97
SETTLING = 60
#: relative change of the amplitude in a period below which a motion has settled
STEADY = 1e-4
#: periods of history in which one of the motion is looked for: the motion may be slower than the mode it began with
HISTORY = 4
#: of how many turns of the wheelset the mean is taken; steps of false position for the instant of each
TURNS, TURNING = 4, 3
#: states kept of a period, and fewest steps of RK4 between two of them
SAMPLES, FEWEST_STEPS = 40, 2


class Start(NamedTuple):
    """A motion that begins in `state` at a `speed` (m/s), with about the `period` (s), of which RK4 needs so many `steps`.

    It has died out where its wheelsets all move by less than `rest` (m).
    """

    model: Model
    state: Float[np.ndarray, "states"]
    period: float
    speed: float
    steps: int
    rest: float = 0.0


class End(NamedTuple):
    """Where a motion ended: the packed orbit as a guess for Newton, the largest displacement of any wheelset (m), and whether that still
    swings to both sides."""

    guess: Float[np.ndarray, "unknowns"]
    displacement: float
    swings: bool


def drawn(shooting: Shooting, starts: Sequence[Start]) -> list[End]:
    """The motions from the starts, simulated until each has settled or died out, at most `SETTLING` periods.

    All models have the same structure. As many run together as a chunk has lanes; where one has ended the next begins.
    """
    queues = [queue for same in _by_table(starts) for queue in _shared_out(same)]
    every = _every(starts)
    found = in_threads(lambda queue: list(_settled(shooting, queue, every)), queues)
    return [end for _, end in sorted((pair for part in found for pair in part), key=lambda pair: pair[0])]


def _shared_out(starts: list[tuple[int, Start]]) -> list[list[tuple[int, Start]]]:
    """As many queues as there is work for, and cores."""
    pieces = min(-(-len(starts) // CHUNK), cores())
    return [starts[first::pieces] for first in range(pieces)]


def _by_table(starts: Sequence[Start]) -> list[list[tuple[int, Start]]]:
    """Motions of vehicles whose profiles have the same table, which the lanes of a batch share; with their numbers."""
    groups: dict[bytes | None, list[tuple[int, Start]]] = {}
    known: dict[int, bytes | None] = {}
    for number, start in enumerate(starts):
        rows = start.model.apart[1]
        key = known.setdefault(id(rows), None if rows is None else rows.tobytes())
        groups.setdefault(key, []).append((number, start))
    return list(groups.values())


def _every(starts: Sequence[Start]) -> int:
    """Steps of RK4 between two samples."""
    return max(FEWEST_STEPS, *(-(-start.steps // SAMPLES) for start in starts))


def _settled(shooting: Shooting, queue: list[tuple[int, Start]], every: int) -> Iterator[tuple[int, End]]:
    """The motions of a queue with their numbers, as they end."""
    batch = _Batch(queue[0][1], every)
    waiting = iter(queue)
    lanes: list[_Lane | None] = [batch.begin(k, next(waiting, None)) for k in range(CHUNK)]
    while any(lane is not None for lane in lanes):
        peaks = batch.one_period()
        for k, lane in enumerate(lanes):
            if lane is not None and lane.ended(float(peaks[k])):
                yield lane.number, _end(shooting, lane.start, batch.history(k), lane.now)
                lanes[k] = batch.begin(k, next(waiting, None))


class _Lane:
    """A motion on its way: its largest displacement in the period before and in the last, periods."""

    def __init__(self, number: int, start: Start) -> None:
        self.number, self.start = number, start
        self.before = self.now = 0.0
        self.periods = 0

    def ended(self, peak: float) -> bool:
        """After one more period."""
        self.before, self.now, self.periods = self.now, peak, self.periods + 1
        if self.periods < HISTORY:
            return False
        settled = abs(self.now - self.before) < STEADY * self.now
        return settled or self.now < self.start.rest or not np.isfinite(self.now) or self.periods >= SETTLING


class _Batch:
    """Motions that are integrated together, a lane each."""

    def __init__(self, first: Start, every: int) -> None:
        model, lanes = first.model, np.ones(CHUNK)
        apart, self.table = model.apart
        self.form, self.numbers = apart.form, apart.numbers[:, None] * lanes
        self.x = np.zeros((len(first.state), CHUNK))
        self.slowness, self.dt = lanes / first.speed, lanes * first.period / SAMPLES
        self.every = every
        self.at, self.offset = model.displacements, model.offset
        self.periods: deque[np.ndarray] = deque(maxlen=HISTORY)

    def begin(self, k: int, entry: tuple[int, Start] | None) -> _Lane | None:
        """The next motion in lane k, if there is one; else the lane goes on with rest."""
        if entry is None:
            self.x[:, k] = 0.0
            return None
        number, start = entry
        self.numbers[:, k] = start.model.apart[0].numbers
        self.x[:, k], self.slowness[k], self.dt[k] = start.state, 1.0 / start.speed, start.period / SAMPLES
        return _Lane(number, start)

    def one_period(self) -> Float[np.ndarray, "lanes"]:
        """Integrate; the largest displacement of any wheelset in each lane, m."""
        x, states = _one_period(self.form)(self.numbers, self.table, self.x, self.slowness, self.dt, np.asarray(self.every))
        states, self.x = np.asarray(states), np.array(x)  # type: ignore[assignment]
        first = self.periods[-1][-1:] if self.periods else states[:1]
        self.periods.append(states)
        y = np.abs(np.concatenate([first, states, self.x[None]])[:, self.at] - self.offset[:, None])
        left, top, right = y[:-2], y[1:-1], y[2:]
        # the tops of the parabolas through three samples
        curved = 2.0 * top - left - right
        turns = (top >= left) & (top >= right) & (curved > 0.0)
        y = np.where(turns, top + (right - left) ** 2 / (8.0 * np.where(turns, curved, 1.0)), top)
        return np.max(y, axis=(0, 1))

    def history(self, k: int) -> Float[np.ndarray, "samples states"]:
        """States of the last periods of lane k."""
        return np.concatenate([states[:, :, k] for states in self.periods])


def _steps(
    model: Model,
    x: Float[Array, "states lanes"],
    slowness: Float[Array, "lanes"],
    dt: Float[Array, "lanes"],
    every: Int[Array, ""],
) -> tuple[Float[Array, "states lanes"], Float[Array, "samples states lanes"]]:
    rate = state_rates(model, slowness, slowness.shape)

    def step(_: Array, x: Array) -> Array:
        return held(model.vehicle, model.damper, rk4_in_loop(rate, x, dt / every))

    def sample(x: Array, _: None) -> tuple[Array, Array]:
        return jax.lax.fori_loop(0, every, step, x), x

    return jax.lax.scan(sample, held(model.vehicle, model.damper, x), length=SAMPLES)


@functools.cache
def _one_period(form: Form) -> Callable[..., tuple[Array, Array]]:
    kernel = one_kernel(lambda numbers, table, *rest: _steps(form.tree(numbers).with_table(table), *rest))
    return kept(kernel, form, compiler_options=options(QUICK))


def one_period(model: Model, orbit: Orbit, steps: int) -> Float[np.ndarray, "samples states"]:
    """States of a limit cycle over a period, of which RK4 needs so many `steps`."""
    start = Start(model, np.asarray(orbit.state), float(orbit.period), float(orbit.speed), steps)
    batch = _Batch(start, _every([start]))
    batch.begin(0, (0, start))
    batch.one_period()
    return batch.history(0)


def _end(shooting: Shooting, start: Start, history: Float[np.ndarray, "samples states"], displacement: float) -> End:
    """The orbit from the mean of the last turns of the wheelset that moves most, those to the left seen in the mirror, so that the car
    body's slow sway, which dies out long after the wheelsets have settled, cancels; it begins where the wheelset that measures turns."""
    model, dt = start.model, start.period / SAMPLES
    moved = history[:, model.displacements] - model.offset
    wheelset = int(np.argmax(np.max(np.abs(moved), axis=0)))
    most, middle = model.displacements.start + wheelset, model.offset[wheelset]
    turns, length = _turns(moved[:, wheelset])
    if len(turns) < 2 or displacement < start.rest:
        return End(pack(model, shooting, Orbit(history[0], start.period, start.speed)), displacement, False)
    if not shooting.symmetric:
        turns = [turn for turn in turns if history[turn, most] > middle]
    states = [_at_turn(model, history, turn, most, dt, start.speed) for turn in turns[-TURNS:]]
    state = np.mean([state if state[most] > middle else model.mirror * state for state in states], axis=0)
    orbit, index = Orbit(state, length * dt, start.speed), model.amplitude_index(shooting.wheelset)
    if most != index:
        history = one_period(model, orbit, start.steps)
        turn = 1 + int(np.argmax(history[1:-1, index]))
        orbit = orbit._replace(state=_at_turn(model, history, turn, index, orbit.period / SAMPLES, start.speed))
    return End(pack(model, shooting, orbit), displacement, True)


def _at_turn(
    model: Model, history: Float[np.ndarray, "samples states"], turn: int, index: int, dt: float, speed: float
) -> Float[np.ndarray, "states"]:
    """The state at the instant, next to a sample, where the displacement `index` turns: found by the flow itself, for between samples a
    flange may strike."""
    rate, side = index + size(model.vehicle), np.sign(history[turn, index] - model.rest[index])
    before = turn if side * history[turn, rate] > 0.0 else turn - 1
    (early, rising), (late, falling) = ((k * dt, side * history[before + k, rate]) for k in (0, 1))
    state = history[turn]
    for _ in range(TURNING if falling < 0.0 < rising else 0):
        middle = early + (late - early) * rising / (rising - falling)
        state = advanced(model, Orbit(history[before], middle, speed))
        if side * state[rate] > 0.0:
            early, rising, falling = middle, side * state[rate], 0.5 * falling
        else:
            late, falling, rising = middle, side * state[rate], 0.5 * rising
    return state


def _turns(y: Float[np.ndarray, "samples"]) -> tuple[list[int], float]:
    """The samples at which y is farthest out between two passages through the middle, and those of a period, from one passage to the next
    but one; none where it does not swing."""
    if not np.all(np.isfinite(y)):
        return [], 0.0
    passing = np.flatnonzero((y[:-1] > 0.0) != (y[1:] > 0.0))
    if len(passing) < 3:
        return [], 0.0
    turns = [int(a + 1 + np.argmax(np.abs(y[a + 1 : b + 1]))) for a, b in itertools.pairwise(passing)]
    instants = passing + y[passing] / (y[passing] - y[passing + 1])
    count = (len(instants) - 1) // 2 * 2
    return turns, float(2.0 * (instants[count] - instants[0]) / count)


def settled(
    model: Model, shooting: Shooting, state: Float[np.ndarray, "states"], period: float, speed: float, steps: int
) -> OrbitProblem:
    """The limit cycle to which the vehicle is drawn at a speed (m/s) from a state on, about whose period (s) and the `steps` that RK4
    needs for it are known."""
    (end,) = drawn(shooting, [Start(model, state, period, speed, steps)])
    return at_speed(model, shooting, end.guess, speed)


def patterns(model: Model, state: Float[np.ndarray, "states"], displacement: float) -> Float[np.ndarray, "patterns states"]:
    """Starts made of the motion about rest of the bogie that moves most: all bogies alike, neighbours opposite, and each by itself.

    The largest displacement of its wheelsets becomes `displacement` (m); the car body and the dampers' internal states stay.
    """
    own, shared = _parts(model)
    bogies = len(own)
    state = state - model.rest
    moved = np.max(np.abs(state[model.displacements]).reshape(bogies, -1), axis=1)
    most = np.argmax(moved)
    motion = state[own[most]] * displacement / moved[most]
    signs = [np.ones(bogies)] if bogies == 1 else [np.ones(bogies), (-1.0) ** np.arange(bogies), *np.eye(bogies)]
    starts = np.tile(state * shared, (len(signs), 1))
    starts[:, own] = np.array(signs)[:, :, None] * motion
    return starts + model.rest


def displaced_wheelsets(model: Model) -> Float[np.ndarray, "states"]:
    """All wheelsets displaced by 1 m, at rest."""
    state = np.zeros(model.states)
    state[model.displacements] = 1.0
    return state


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
    owner = np.concatenate([owner, owner, np.full(model.states - 2 * len(names), -1)])
    return np.array([np.flatnonzero(owner == bogie) for bogie in range(bogies)]), (owner == -1).astype(float)
