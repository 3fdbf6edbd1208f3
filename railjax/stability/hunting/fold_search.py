"""The search for the lowest fold of each of many vehicles' limit cycles; plain Python over a few small compiled programs.

From all motions to which a vehicle is drawn at some speeds about the linear critical speed (up to the highest, where straight running is
stable at all of them), the one at the lowest speed is followed down to its fold. Then the motions below that fold and just above it are tried, and so on until none leads further down. What is simulated is simulated
for all vehicles together. A vehicle that is little different from one that has been searched takes its fold from that one's, by Newton's
method, and only the motions below it are tried.
"""

from collections import deque
from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from ...base.batches import in_threads
from ...simulation.step_size import STABLE_RADIUS
from .continuation import fold_beside, fold_between, fold_near, follow, hunting_mode, near_hopf, wheelset_mode
from .orbits import DISPLACEMENT, SPEED, Model, Shooting, fastest, unpack
from .settling import End, Start, displaced_wheelsets, drawn, one_period, patterns
from .shooting import OrbitProblem, Point, at_speed, largest_displacement, solved

#: shares of the linear critical speed, or of the highest one, at which motions are tried first, and of a fold's speed at which they are
#: tried then: below it, and just above, where those of another family may live whose fold is a little lower
ABOUT_HOPF = (0.45, 0.6, 0.75, 0.85, 0.9, 0.95, 0.99, 1.02)
UP_TO_HIGHEST = (0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.85, 1.0)
ABOUT_FOLD = (0.8, 0.87, 0.93, 0.97, 0.99, 0.998, 0.9995, 1.002)
#: multiplier of half a period beyond which a motion is taken to leave its branch
LEAVES = 1.015
#: residual of an orbit that all but exists
NEARLY = 1e-2
#: m; motions of one family differ by less between a fold and just above it
ALIKE = 1.5e-3
#: relative difference of speeds below which two folds are one
SAME = 1e-9
#: displacement, in clearances, with which motions begin; also with which where straight running is stable; and below which they are taken
#: to have died out
LARGE, LARGER, SMALL = 1.1, 2.0, 0.1
#: from this share of a fold's speed on motions begin as large as the fold's: a larger one falls past the limit cycles near it
NEAR_FOLD = 0.998
#: and from this share on wheelsets displaced at rest are tried as well: they hit limit cycles of small basins, in which one bogie hunts alone
FROM_REST = 0.97
#: speeds tried between one at which nothing goes on and one at which something does that is no limit cycle; how often
BETWEEN, NARROWINGS = 6, 3
#: share of the flange clearance at which the branch is entered at the Hopf point
AT_HOPF = 0.1
#: the same where it must not meet the limit cycles of other bogies
SMALLER = 0.03
#: longest step down the branch (1 mm or 10 m/s), and how many are tried
LARGEST_STEP, MOST_STEPS = 0.1, 400
#: folds one below the other
MOST_FOLDS = 8
#: of RK4: a motion that needs more is not simulated well, and no fold is found
MOST_STEPS_OF_PERIOD = 20_000
#: searches that are remembered
MOST_KNOWN = 100


class FoldSearch:
    """What is known of one vehicle's limit cycles: the lowest `fold`, if one was found; whether a branch fell into the Hopf point.

    `hopf` is the linear critical speed, m/s; or, where straight running is `stable` at all speeds, the highest of them.
    """

    def __init__(self, model: Model, shooting: Shooting, hopf: float, stable: bool = False) -> None:
        self.model, self.shooting, self.hopf, self.stable = model, shooting, hopf, stable
        self.fold: Point | None = None
        self.folds, self.vanished = 0, False
        # speeds at which nothing goes on and at which something does, where that was no limit cycle; how often these were brought nearer
        self.doubtful: tuple[float, float] | None = None
        self.narrowings = 0
        self.rest = SMALL * float(model.vehicle.contact.flange_clearance)

    def starts(self) -> Iterator[Start]:
        """Motions about the Hopf point, or up to the highest speed, made of a mode; or about the lowest fold, made of its orbit."""
        clearance = float(self.model.vehicle.contact.flange_clearance)
        if self.fold is None:
            largest = [LARGE * clearance] + ([LARGER * clearance] if self.stable else [])
            speeds = self._speeds()
            if not self.stable:
                state, omega = hunting_mode(self.model, self.shooting, self.hopf)
                steps = steps_of_period(self.model, speeds[0], 2.0 * np.pi / omega)
            for speed in speeds:
                if self.stable:
                    state, omega = wheelset_mode(self.model, self.shooting, speed)
                    steps = steps_of_period(self.model, speed, 2.0 * np.pi / omega)
                for displacement in largest:
                    yield from self._starts(state + self.model.rest, 2.0 * np.pi / omega, speed, displacement, steps)
            return
        orbit = unpack(self.model, self.shooting, self.fold.unknowns)
        period, speed = float(orbit.period), float(orbit.speed)
        states = one_period(self.model, orbit, steps_of_period(self.model, speed, period))
        displaced = np.max(np.abs(states[:, self.model.displacements] - self.model.offset), axis=1)
        state, most = states[np.argmax(displaced)], float(np.max(displaced))
        steps = steps_of_period(self.model, ABOUT_FOLD[0] * speed, period)  # the slower, the more
        for share in ABOUT_FOLD:
            displacement = LARGE * max(clearance, most) if share < NEAR_FOLD else most
            yield from self._starts(state, period, share * speed, displacement, steps)
            if share >= FROM_REST:
                yield from self._starts(
                    displaced_wheelsets(self.model) + self.model.rest, period, share * speed, clearance, steps
                )

    def _speeds(self) -> Float[np.ndarray, "speeds"]:
        """Those at which motions are tried as long as no fold is known, m/s."""
        if self.doubtful is None:
            return self.hopf * np.array(UP_TO_HIGHEST if self.stable else ABOUT_HOPF)
        return np.linspace(*self.doubtful, BETWEEN + 2)[1:-1]

    def _starts(
        self, state: Float[np.ndarray, "states"], period: float, speed: float, displacement: float, steps: int
    ) -> Iterator[Start]:
        for start in patterns(self.model, state, displacement):
            yield Start(self.model, start, period, speed, steps, self.rest)

    def descend(self, ends: Sequence[End]) -> bool:
        """Follow the motions, those of low speed first, until one leads to a fold below the known one at which motions end; where none
        does, the lowest of the other folds is taken. Whether there is one, and others are to be looked for below it."""
        tried: list[End] = []
        other: Point | None = None
        if self.fold is None and not self.stable:
            # above the Hopf point motions do not die out: what is left is a small limit cycle that grows with speed
            self.vanished = self.doubtful is None and all(end.displacement < self.rest for end in ends)
        for end in ends:
            if not (end.swings and end.displacement > self.rest) or any(self._alike(end.guess, one.guess) for one in tried):
                continue
            tried.append(end)
            fold = self._fold_from(end)
            if not _lower(fold, self.fold):
                continue
            if motions_end(fold):
                return self._keep(fold)
            other = fold if _lower(fold, other) else other
        if other is not None:
            return self._keep(other)
        return self.fold is None and not self.vanished and self._look_between(ends)

    def _look_between(self, ends: Sequence[End]) -> bool:
        """Where motions go on that are no limit cycles that could be followed, between the lowest speed of these and the highest below it
        at which nothing does; whether that is worth while. At last the branch that leaves the Hopf point is followed."""
        speeds = np.array([end.guess[-1] for end in ends]) * SPEED
        goes_on = np.array([not end.displacement < self.rest for end in ends])
        if self.model.vehicle.profiles is not None and not self.stable and np.all(speeds[goes_on] > self.hopf):
            # only above the Hopf point, out of which a small limit cycle may grow that bogies which barely feel each other are slow to settle on
            point = self._out_of_hopf(SMALLER)
            self.vanished = point.usable and bool(point.unknowns[-1] * SPEED > self.hopf)
            if self.vanished:
                return False
        if goes_on.any() and self.narrowings < NARROWINGS:
            low = np.min(speeds[goes_on])
            quiet = speeds[speeds < low]
            floor = 0.0 if self.doubtful is None else self.doubtful[0]
            self.doubtful, self.narrowings = (
                (float(max(np.max(quiet, initial=floor), 0.5 * low)), float(low)),
                self.narrowings + 1,
            )
            return True
        if not self.stable:
            point = self._out_of_hopf(AT_HOPF)
            if point.usable and point.unknowns[-1] * SPEED > self.hopf:
                self.vanished = True
            elif point.usable:
                fold = self._first_fold(point)
                return fold is not None and self._keep(fold)
        return False

    def _out_of_hopf(self, share: float) -> Point:
        """The limit cycle that grows out of the Hopf point, with an amplitude of this share of the clearance."""
        state, omega = hunting_mode(self.model, self.shooting, self.hopf)
        amplitude = share * 10.0 * self.rest
        return solved(self.model, self.shooting, near_hopf(self.model, self.shooting, state, omega, self.hopf, amplitude))

    def _first_fold(self, start: Point) -> Point | None:
        """Of the branch that leaves the Hopf point towards lower speeds."""
        for point, before in follow(self.model, self.shooting, start, LARGEST_STEP, MOST_STEPS):
            if before.slope < 0.0 <= point.slope:
                return fold_between(self.model, self.shooting, before, point)
        return None

    def _keep(self, fold: Point) -> bool:
        self.fold, self.folds = fold, self.folds + 1
        return self.folds < MOST_FOLDS

    def _fold_from(self, end: End) -> Point | None:
        """The fold of the limit cycle on which a motion ended; None where there is none, or none below the known one."""
        speed = end.guess[-1]
        above = self.fold is not None and speed > self.fold.unknowns[-1]
        if above:
            if self._alike(end.guess, self.fold.unknowns):
                return None
            speed = self.fold.unknowns[-1]
        entry = solved(self.model, self.shooting, at_speed(self.model, self.shooting, end.guess, speed * SPEED))
        if above and not entry.usable and entry.residual < NEARLY:
            # it ends at nearly the same speed
            across = OrbitProblem(entry.unknowns, entry.direction, float(entry.direction @ entry.unknowns))
            beside = solved(self.model, self.shooting, across, entry)
            fold = fold_beside(self.model, self.shooting, beside) if beside.usable else None
            return fold if fold is not None and motions_end(fold) else None
        if not entry.usable or largest_displacement(self.model, entry) < self.rest:
            return None
        return self._down_from(entry)

    def _above_hopf(self, fold: Point) -> bool:
        return bool(fold.unknowns[-1] * SPEED >= self.hopf)

    @property
    def ends(self) -> bool:
        """Whether a fold was found, and motions end there."""
        return self.fold is not None and motions_end(self.fold)

    def _alike(self, one: Float[np.ndarray, "unknowns"], other: Float[np.ndarray, "unknowns"]) -> bool:
        """Whether two packed orbits at nearly the same speed are of one family."""
        at = self.model.displacements
        near = np.max(np.abs(one[at] - other[at])) * DISPLACEMENT < ALIKE
        return bool(near and abs(one[-1] / other[-1] - 1.0) < 2.0 * (ABOUT_FOLD[-1] - 1.0))

    def take_from(self, other: "FoldSearch") -> bool:
        """The fold near that of a vehicle that is little different, on the same side of the linear critical speed; False where there is none
        at which motions end."""
        if not other.ends:
            return False
        fold = fold_near(self.model, self.shooting, other.model, other.fold)
        if fold is None or self._above_hopf(fold) != other._above_hopf(other.fold) or not motions_end(fold):
            return False
        self.fold, self.folds = fold, 1
        return True

    def _down_from(self, entry: Point) -> Point | None:
        downwards = entry._replace(direction=-entry.direction * np.sign(entry.slope))
        for point, before in follow(self.model, self.shooting, downwards, LARGEST_STEP, MOST_STEPS):
            if before.slope < 0.0 <= point.slope:
                return fold_between(self.model, self.shooting, before, point)
            if largest_displacement(self.model, point) < self.rest:
                self.vanished = True
                return None
        return None


def _lower(one: Point | None, other: Point | None) -> bool:
    """Whether one fold lies below another and is not the same found again, or is the only one."""
    return one is not None and (other is None or bool(one.unknowns[-1] < (1.0 - SAME) * other.unknowns[-1]))


def motions_end(fold: Point) -> bool:
    """Whether the motions that end in the fold are there down to it: all multipliers but the trivial one and the fold's own lie within the
    unit circle, or so little outside as where bogies barely feel each other. Else the motion has left this branch before."""
    multipliers = np.linalg.eigvals(fold.monodromy)
    others = np.delete(multipliers, np.argsort(np.abs(multipliers - 1.0))[:2])
    return bool(np.all(np.abs(others) < LEAVES))


def steps_of_period(model: Model, speed: float, period: float) -> int:
    """The fewest steps of RK4 in a period (s) that hold the vehicle's fastest motion at a speed (m/s)."""
    return int(np.ceil(min(fastest(model, speed) * period / STABLE_RADIUS, MOST_STEPS_OF_PERIOD)))


class KnownFolds:
    """The last searches made, of vehicles that came one after another, as an optimiser asks for them."""

    def __init__(self) -> None:
        self.searches: deque[tuple[FoldSearch, bool]] = deque(maxlen=MOST_KNOWN)  # and whether motions end at the fold

    def add(self, searches: Sequence[FoldSearch]) -> None:
        """Remember them."""
        self.searches.extend((search, search.ends) for search in searches)

    def near(self, search: FoldSearch) -> list[FoldSearch]:
        """Those whose orbits are measured and looked for in the same way, if motions end at their folds."""
        asked = search.model.form, search.shooting.wheelset, search.shooting.symmetric
        return [
            one
            for one, ends in self.searches
            if ends and asked == (one.model.form, one.shooting.wheelset, one.shooting.symmetric)
        ]

    def again(self, search: FoldSearch) -> bool:
        """Whether the very same has been searched, with the same steps; it then has all that was found."""
        for one, _ in self.searches:
            same = one.shooting == search.shooting and one.model.form == search.model.form
            if same and np.array_equal(one.model.numbers, search.model.numbers):
                search.__dict__ |= one.__dict__
                return True
        return False


def search_folds(searches: Sequence[FoldSearch], known: KnownFolds | None = None) -> None:
    """The lowest fold of each vehicle; all have the same structure, and their amplitude is measured at the same wheelset.

    Those that are `known` already are neighbours too, if motions end at their folds, and what is found is added to them.
    """
    if known:
        searches = [search for search in searches if not known.again(search)]
        if not searches:
            return
    near = known.near(searches[0]) if known else []
    taken: list[FoldSearch] = []
    for wave in _waves(searches, near):
        took = in_threads(lambda pair: pair[1] is not None and pair[0].take_from(pair[1]), wave)
        taken += [search for (search, _), done in zip(wave, took, strict=True) if done]
        _search_to_the_end([search for (search, _), done in zip(wave, took, strict=True) if not done])
    _search_to_the_end(taken)
    if known:
        known.add(searches)


def _search_to_the_end(searches: list[FoldSearch]) -> None:
    """Round by round, the motions of all vehicles that are left simulated together."""
    while searches:
        starts = [list(search.starts()) for search in searches]
        ends = drawn(searches[0].shooting, [start for own in starts for start in own])
        last = np.cumsum([len(own) for own in starts])
        parts = [ends[end - len(own) : end] for own, end in zip(starts, last, strict=True)]
        onward = in_threads(lambda pair: pair[0].descend(pair[1]), list(zip(searches, parts, strict=True)))
        searches = [search for search, more in zip(searches, onward, strict=True) if more]


def _waves(searches: Sequence[FoldSearch], known: Sequence[FoldSearch]) -> Iterator[list[tuple[FoldSearch, FoldSearch | None]]]:
    """The vehicles, each with the nearest of those known or in earlier waves; each wave doubles the number of these."""
    every = [*known, *searches]
    numbers = np.array([search.model.numbers for search in every])
    spread = np.std(numbers, axis=0)
    numbers = numbers[:, spread > 0.0] / spread[spread > 0.0]
    order = _farthest_first(numbers, len(known))
    count = len(known)
    if not count:
        yield [(every[order[0]], None)]
        count = 1
    while count < len(order):
        wave, before = order[count : 2 * count], numbers[order[:count]]
        nearest = [order[np.argmin(np.sum((before - numbers[k]) ** 2, axis=1))] for k in wave]
        yield [(every[k], every[near]) for k, near in zip(wave, nearest, strict=True)]
        count += len(wave)


def _farthest_first(points: Float[np.ndarray, "points numbers"], known: int) -> list[int]:
    """The first, which are known, or else the point in the middle; then always the one that is farthest from all before it, so that soon
    none is far."""
    order = list(range(known)) or [int(np.argmin(np.sum((points - np.mean(points, axis=0)) ** 2, axis=1)))]
    distance = np.full(len(points), np.inf)
    for one in order[:-1]:
        distance = np.minimum(distance, np.sum((points - points[one]) ** 2, axis=1))
    while len(order) < len(points):
        distance = np.minimum(distance, np.sum((points - points[order[-1]]) ** 2, axis=1))
        distance[order] = -1.0  # where points are the same
        order.append(int(np.argmax(distance)))
    return order
