"""The bifurcation diagram of hunting: limit cycles over speed, from the Hopf point to the highest speed, with stability.

branch = railjax.hunting_branch(railjax.load_vehicle("coach"))
print(branch)
branch.plot(axes)
"""

import itertools
from collections.abc import Iterator

import numpy as np

from ...base.arguments import guarded
from ...base.errors import InputError, NumericalError
from ...base.precision import require_double_precision
from ...base.units import KMH
from ...model.damper import Damper
from ...model.motion import PASSIVE
from ...model.vehicle import Vehicle
from .. import linear_critical as linear
from ..along_speed import both_at
from ..linear_critical import LinearCritical, Stability, linear_critical
from . import continuation
from . import settling as attractors
from .floquet import floquet, multipliers_of
from .fold_search import FoldSearch, search_folds, steps_of_period
from .limit_cycles import Branch, Event, LimitCycle, limit_cycle_at
from .nonlinear_critical import default_wheelset, search_of
from .normal_form import first_lyapunov_coefficient
from .orbits import DISPLACEMENT, PERIOD, SPEED, Model, Shooting, model_of
from .shooting import Point, at_speed, plane, solved

#: share of the flange clearance at which the branch is entered from the Hopf point, to which it is followed down, and at which
#: its first direction is taken
NEAR_HOPF, DOWN_TO, AT_HOPF = 0.1, 0.02, 1e-3
#: and the share where the motion is one that settles too slowly to be followed from above
NEARER_HOPF = 0.03
#: longest step between two points of the diagram (1 mm or 10 m/s), and the most points that one piece may have
LARGEST_STEP, MOST_POINTS = 0.25, 600
#: where the branch has no fold it is entered this much above the linear critical speed
ENTRY = 1.02
#: largest difference of unknowns (1 mm, 50 mm/s, ...) between two computations of one fold
SAME = 1e-2
#: how far the diagram goes, in linear critical speeds
HIGHEST = 1.25


def follow(
    model: Model, shooting: Shooting, start: Point, largest_step: float = LARGEST_STEP
) -> Iterator[tuple[Point, Point | None]]:
    """Limit cycles along a branch from `start` in its direction, for as long as the caller asks; ends where it is stuck.

    Yields each point, and the fold between it and the one before (solved for) where there is one.
    """
    for point, before in continuation.follow(model, shooting, start, largest_step):
        folded = before.slope * point.slope < 0.0
        yield point, continuation.fold_between(model, shooting, before, point) if folded else None


@guarded()
def hunting_branch(
    vehicle: Vehicle,
    *,
    damper: Damper = PASSIVE,
    highest_speed: float | None = None,
    wheelset: int | None = None,
    steps: int | None = None,
    symmetric: bool = True,
    largest_step: float = LARGEST_STEP,
) -> Branch:
    """The limit cycles of a vehicle over speed: unstable ones from the Hopf point to the fold, stable ones from there on.

    Where straight running is stable at all speeds but limit cycles were found, as where yaw dampers blow off, both ways from
    their fold. Sharp flange corners are rounded within 0.01 mm (`rounded` in `railjax.stability.hunting.orbits` says why).

    Args:
        vehicle: a single vehicle; for many use `nonlinear_critical`.
        damper: what takes the place of rho_cy; by default the vehicle's own.
        highest_speed: where the diagram ends, m/s; by default 1.25 times the linear critical speed, 150 m/s where there is none.
        wheelset: the one whose lateral displacement is the amplitude, counted from the front, 0 the first; by default the leading
            one of the trailing bogie, as in the paper's fig. 6.
        steps: number of RK4's steps in half a period; by default enough for the fastest motion, at least 200.
        symmetric: False looks for orbits by the whole period, of twice as many steps, for dampers that are not alike to both
            sides.
        largest_step: longest step between two points, dimensionless: 1 for 1 mm or 10 m/s; by default 0.25.

    Raises:
        NumericalError: where straight running is unstable at the lowest speed or no limit cycle is found.
        InputError: for a batch, a `highest_speed` below 1.02 times the linear critical speed, and in single precision.
    """
    require_double_precision("hunting")
    hopf = linear_critical(vehicle, damper=damper)
    if hopf.code.ndim:
        raise InputError("hunting_branch draws one vehicle; for many use nonlinear_critical, which takes lanes")
    code, speed = int(hopf.code), float(hopf.speed)
    if code not in (Stability.OK, Stability.STABLE):
        reason = Stability(code).name.lower()
        raise NumericalError(f"no branch of limit cycles: straight running has no linear critical speed ({reason})")
    isolated = code == Stability.STABLE
    lowest, default = (0.0, linear.HIGHEST) if isolated else (ENTRY * speed, HIGHEST * speed)
    highest = default if highest_speed is None else highest_speed
    if not highest > lowest:
        raise InputError(
            "highest_speed must be positive"
            if isolated
            else f"highest_speed must lie above {lowest:.2f} m/s, {ENTRY:g} times the linear critical speed"
        )
    model = model_of(vehicle, damper)
    search = search_of(model, speed, float(hopf.frequency), default_wheelset(vehicle, wheelset), steps, symmetric)
    shooting = search.shooting
    search_folds([search])
    tracer = _Tracer(model, shooting, hopf, largest_step)
    if isolated:
        below, above, folds, note = tracer.isolated(search, highest)
        first: tuple = ()
        slope, criticality = np.nan, "isolated"
    else:
        below, above, folds, note = tracer.pieces(search, highest)
        first, slope = (tracer.hopf_point(),), tracer.slope_at_hopf()
        criticality = "subcritical" if slope < 0.0 else "supercritical"
    cycles = {id(point): limit_cycle_at(model, shooting, point) for point in (*below, *above, *folds)}
    pieces = tuple(tuple(cycles[id(point)] for point in piece) for piece in (below, above) if piece)
    if below:  # else no limit cycle near the Hopf point could be computed, and nothing is drawn to it
        pieces = ((*first, *pieces[0]), *pieces[1:])
    turning = tuple(cycles[id(fold)] for fold in folds)
    smooth = vehicle.contact.law == "smooth" and vehicle.profiles is None
    return Branch(
        vehicle_name=vehicle.name,
        hopf=hopf,
        criticality=criticality,
        slope_at_hopf=slope,
        lyapunov=first_lyapunov_coefficient(vehicle, damper, hopf) if smooth and not isolated else None,
        pieces=pieces,
        folds=turning,
        events=tuple(event for piece in pieces for event in _events(piece, turning, shooting.symmetric)),
        note=note,
        wheelset=shooting.wheelset,
        model=model,
        shooting=shooting,
    )


class _Tracer:
    """Traces the pieces of one vehicle's branch."""

    def __init__(self, model: Model, shooting: Shooting, hopf: LinearCritical, largest_step: float) -> None:
        self.model, self.shooting, self.largest_step = model, shooting, largest_step
        self.hopf, self.speed = hopf, float(hopf.speed)
        if np.isfinite(self.speed):
            self.mode = continuation.hunting_mode(model, shooting, self.speed)
        self.clearance = float(model.vehicle.contact.flange_clearance)

    def isolated(self, search: FoldSearch, highest: float) -> tuple[list[Point], list[Point], list[Point], str]:
        """The limit cycles of a vehicle that is stable at all speeds: both ways from the lowest fold, up to the highest speed or, where
        they close upon themselves, once around."""
        if search.fold is None:
            raise NumericalError(
                f"no branch of limit cycles: straight running is stable, and no limit cycle was found, up to {linear.HIGHEST * KMH:.0f} km/h"
            )
        lowest, folds, ways = search.fold, [search.fold], []
        onward = self._growing(lowest)
        for start in (onward, onward._replace(direction=-onward.direction)):
            points: list[Point] = []
            for point, fold in self._follow(start):
                if fold is not None and not points:
                    fold = None  # the one that it begins at
                if fold is not None and self._same(fold, lowest):
                    note = "The limit cycles close upon themselves: an isola."
                    return [lowest, *points, lowest], [], folds, note
                if fold is not None:
                    folds.append(fold)
                    points.append(fold)
                points.append(point)
                if point.unknowns[-1] * SPEED > highest:
                    break
            ways.append(points)
        note = "Straight running is stable at all speeds: only a large disturbance makes the vehicle hunt, on limit cycles that no Hopf point leads to."
        return [*ways[1][::-1], lowest, *ways[0]], [], folds, note

    def pieces(self, search: FoldSearch, highest: float) -> tuple[list[Point], list[Point], list[Point], str]:
        """Limit cycles from the Hopf point on, those that are not connected with it, the folds, and a note.

        From above: the stable limit cycles from the lowest fold, the nonlinear critical speed, up to the highest speed; where there
        is none, those to which the vehicle is drawn above the Hopf point. From below: the branch that leaves the Hopf point, up to
        its fold. Where the two are one and the same, so is the branch.
        """
        if search.fold is not None:
            folds = [search.fold]
            above = [search.fold, *self._up_to(highest, self._growing(search.fold))]
        else:
            folds = []
            above = self._without_fold(highest)
            if self._small(above[0]):
                return above, [], [], ""
        below, turns = self._from_hopf(highest)
        if turns and folds and self._same(turns[-1], folds[0]):
            return [*below[:-1], *above], [], [*turns[:-1], *folds], ""
        note = (
            "The branch from the Hopf point and that of the stable limit cycles are not connected directly: bogies that barely "
            "feel each other have neighbouring limit cycles in between, in which one hunts less than the other."
        )
        return below, above, [*turns, *folds], note

    def _without_fold(self, highest: float) -> list[Point]:
        """The limit cycle to which the vehicle is drawn above the Hopf point, down to that point if it leads there, and up to the
        highest speed."""
        shape, omega = self.mode
        period, speed = 2.0 * np.pi / omega, ENTRY * self.speed
        steps = steps_of_period(self.model, speed, period)
        problem = attractors.settled(self.model, self.shooting, shape * self.clearance + self.model.rest, period, speed, steps)
        entry = solved(self.model, self.shooting, problem)
        if not entry.usable:
            entry = self._of_slow_bogies(attractors.Start(self.model, shape + self.model.rest, period, speed, steps))
        if not (entry.usable and entry.unknowns[-1] * SPEED > self.speed):
            raise NumericalError(
                f"no limit cycle found at {ENTRY:g} times the linear critical speed: the motion there is not periodic within "
                f"{attractors.SETTLING} periods"
            )
        upwards = entry._replace(direction=entry.direction * np.sign(entry.slope))
        up = self._up_to(highest, upwards)
        return [*self._to_hopf(upwards._replace(direction=-upwards.direction), highest)[::-1], entry, *up]

    def _of_slow_bogies(self, start: attractors.Start) -> Point:
        """The limit cycle of bogies that barely feel each other, which settle slowly: that to which one of their patterns leads, a stable
        one if there is one; else the one that leaves the Hopf point."""
        states = attractors.patterns(self.model, start.state, self.clearance)
        ends = attractors.drawn(self.shooting, [start._replace(state=state) for state in states])
        problems = [at_speed(self.model, self.shooting, end.guess, start.speed) for end in ends if end.swings]
        found = [solved(self.model, self.shooting, problem) for problem in problems]
        usable = [point for point in found if point.usable and not self._small(point)]
        for point in usable:
            if multipliers_of(self.shooting, point.monodromy).stable:
                return point
        return usable[0] if usable else self._small_orbit(NEARER_HOPF)

    def _growing(self, fold: Point) -> Point:
        """The fold in the direction in which the wheelset that moves most moves more: that of the stable limit cycles."""
        moved = fold.unknowns[self.model.displacements] - self.model.offset / DISPLACEMENT
        most = np.argmax(np.abs(moved))
        along = fold.direction[self.model.displacements][most] * moved[most]
        return fold._replace(direction=fold.direction * np.sign(along))

    def _up_to(self, highest: float, start: Point) -> list[Point]:
        """Onwards to the highest speed (m/s)."""
        points = []
        for point, _ in self._follow(start):
            points.append(point)
            if point.unknowns[-1] * SPEED > highest:
                break
        return points

    @staticmethod
    def _same(one: Point, other: Point) -> bool:
        """Whether two folds are the same orbit, or its mirror image half a period later."""
        return bool(np.allclose(one.unknowns, other.unknowns, atol=SAME))

    def _follow(self, start: Point) -> Iterator[tuple[Point, Point | None]]:
        for count, found in enumerate(follow(self.model, self.shooting, start, self.largest_step)):
            if count == MOST_POINTS:
                return
            yield found

    def _to_hopf(self, start: Point, highest: float) -> list[Point]:
        """Onwards to small amplitudes, or away from them up to the highest speed (m/s)."""
        points: list[Point] = []
        for point, _ in self._follow(start):
            points.append(point)
            if self._small(point) or point.unknowns[-1] * SPEED > highest:
                break
        return points

    def _small(self, point: Point) -> bool:
        return bool(point.amplitude - self.model.offset[self.shooting.wheelset] < DOWN_TO * self.clearance)

    def _from_hopf(self, highest: float) -> tuple[list[Point], list[Point]]:
        """From near the Hopf point down to it as far as it goes, and up to the fold at its lowest speed, or to the highest speed (m/s); with
        all folds."""
        start = self._small_orbit(NEAR_HOPF)
        if not start.usable:  # where the contact changes within a fraction of a millimetre
            start = self._small_orbit(NEARER_HOPF)
        if not start.usable:
            return [], []
        below = []
        for point, _ in self._follow(start._replace(direction=-start.direction)):
            # the branch turns before it meets the Hopf point where another mode is near
            if self._small(point) or self._rises(point):
                break
            below.append(point)
        points, turns, before = [*below[::-1], start], [], start
        for point, fold in self._follow(start):
            if fold is not None:
                turns.append(fold)
                points.append(fold)
                # a branch that first leaves towards higher speeds turns back before it comes to its lowest
                if before.slope < 0.0:
                    break
            points.append(point)
            before = point
            if point.unknowns[-1] * SPEED > highest:
                break
        return points, turns

    def _rises(self, point: Point) -> bool:
        return bool(plane(self.model, self.shooting, point.direction)[0] > 0.0)

    def _small_orbit(self, share: float) -> Point:
        """The limit cycle near the Hopf point whose amplitude is a share of the clearance."""
        problem = continuation.near_hopf(self.model, self.shooting, *self.mode, self.speed, share * self.clearance)
        return solved(self.model, self.shooting, problem)

    def slope_at_hopf(self) -> float:
        """dv/dA of the branch where it leaves the Hopf point, m/s per m."""
        first = self._small_orbit(AT_HOPF)
        amplitude, speed = plane(self.model, self.shooting, first.direction)
        if not first.usable:
            raise NumericalError("no limit cycle found near the Hopf point")
        return float(speed / amplitude) * SPEED / DISPLACEMENT

    def hopf_point(self) -> LimitCycle:
        """The Hopf point as a limit cycle of no amplitude."""
        states = self.model.scales.shape[0]
        period = 1.0 / float(self.hopf.frequency)
        matrix = both_at(self.model.vehicle, self.speed, self.model.damper)[0]
        growth = np.linalg.eigvals(matrix) * period
        half = np.exp(0.5 * growth) * -1.0 if self.shooting.symmetric else np.exp(growth)
        nothing = np.zeros(states)
        unknowns = np.append(np.zeros(states - 1), [period / PERIOD, self.speed / SPEED])
        found = floquet(self.shooting, half)
        return LimitCycle(self.speed, 0.0, 1.0 / period, found, nothing, 0.0, unknowns)


def _events(piece: tuple[LimitCycle, ...], folds: tuple[LimitCycle, ...], symmetric: bool) -> Iterator[Event]:
    """Where multipliers cross the unit circle between two points, but at folds."""
    special = {id(fold) for fold in folds} | {id(point) for point in piece if point.amplitude == 0.0}
    for one, other in itertools.pairwise(piece):
        outside = [int(np.sum(np.abs(point.floquet.half[1:]) > 1.0)) for point in (one, other)]
        if outside[0] == outside[1] or id(one) in special or id(other) in special:
            continue
        # the one that crosses is, on the side where it is outside, the one nearest to the circle
        more = one if outside[0] > outside[1] else other
        beyond = more.floquet.half[1:][np.abs(more.floquet.half[1:]) > 1.0]
        crossing = beyond[np.argmin(np.abs(beyond))]
        if abs(crossing.imag) > 1e-6:
            kind = "Neimark-Sacker"
        elif crossing.real < 0.0:
            kind = "loss of symmetry" if symmetric else "period doubling"
        else:
            kind = "branch point"
        yield Event(kind, 0.5 * (one.speed + other.speed), 0.5 * (one.amplitude + other.amplitude))
