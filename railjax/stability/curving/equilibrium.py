"""The equilibrium of a vehicle in an arc: Newton's method, helped where creep saturates and flanges strike, and its implicit derivative.

At rest in the arc's frames the state is x = [q, 0, internal states]. The unknowns u = (q, internal states) make accelerations and the
rates of the internal states zero, f(u; kappa, theta) = 0. Newton's method begins where linear creep would lead, within the flanges. Where
it fails, u' = f(u) is followed by implicit steps that lengthen as f falls (Kelley and Keyes, SIAM J. Numer. Anal. 35, 1998), at last the
load (kappa, theta) grows from zero in shares. All of them may begin at a neighbour's equilibrium, that of more friction. All arrays have lanes last, as `motion` has them.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ...base.elimination import eliminated, inverse
from ...base.typing import Scalar
from ...model.damper import Damper
from ...model.kinematics import labels, size
from ...model.motion import Motion, held, motion, state_rate, state_size, wheelset_shape
from ...model.track.curve import arc
from ...model.vehicle import Vehicle

#: last step of Newton's method, m and rad, and of the value; its error is the square of that
ABSOLUTE, RELATIVE = 1e-12, 1e-9
#: m and rad by which a step goes at most, and beyond which the small displacements of the model have lost their meaning
LONGEST, FARTHEST = 0.03, 1.0
#: share of the curve that is small enough for linear creep
LITTLE = 1e-6
#: the attempts: Newton's method, implicit steps from 1/s of so much (1/s²) on, twice, and shares of the load; steps for each
STIFFNESS = np.array([0.0, 1e4, 1e3, 0.0])
STEPS = np.array([12, 80, 80, 14])
SHARES = len(STIFFNESS) - 1
#: 1/s² that is nothing beside the softest suspension; the first share of the load and the smallest; steps of a lane in all
SOFT, FIRST, SMALLEST, MOST = 1e-3, 0.25, 1e-4, 500

Unknowns = Float[Array, "unknowns *lanes"]
Whole = int | Int[Array, ""]


class Case(NamedTuple):
    """A vehicle in an arc; every number may have lanes."""

    vehicle: Vehicle
    damper: Damper
    speed: Scalar  # v, m/s
    curvature: Scalar  # kappa, 1/m, to the right
    cant_angle: Scalar  # theta, rad

    def instant(self, x: Float[Array, "states *lanes"], load: Scalar = 1.0) -> Motion:
        """All that is known of the vehicle in a state, in a share of the curve."""
        even = jnp.zeros((*wheelset_shape(self.vehicle), *x.shape[1:]), x.dtype)
        curve = arc(self.vehicle, self.speed, load * self.curvature, load * self.cant_angle, even)
        return motion(self.vehicle, self.damper, 1.0 / self.speed, even, x, curve)

    def state(self, u: Unknowns) -> Float[Array, "states *lanes"]:
        """x with rates of zero."""
        n = size(self.vehicle)
        return jnp.concatenate([u[:n], jnp.zeros_like(u[:n]), u[n:]])

    def residual(self, u: Unknowns, load: Scalar = 1.0) -> Unknowns:
        """q'' and the rates of internal states, SI: zero in equilibrium."""
        return state_rate(self.vehicle, self.instant(self.state(u), load))[size(self.vehicle) :]

    def jacobian(self, u: Unknowns, load: Scalar = 1.0) -> tuple[Unknowns, Float[Array, "unknowns unknowns *lanes"]]:
        """The residual and its derivative. An internal state that nothing changes at rest, as a valve's decision or the hysteresis of a
        magnetorheological damper, stays as it is: its row is that of u' = 0."""

        def along(direction: Float[Array, "unknowns"]) -> tuple[Unknowns, Unknowns]:
            moved = jnp.broadcast_to(direction.reshape((-1,) + (1,) * (u.ndim - 1)), u.shape)
            return jax.jvp(lambda u: self.residual(u, load), (u,), (moved,))

        found, matrix = jax.vmap(along, out_axes=(None, 1))(jnp.eye(u.shape[0], dtype=u.dtype))
        rows = jnp.arange(u.shape[0]).reshape((-1,) + (1,) * (u.ndim - 1))
        idle = jnp.all(matrix == 0.0, axis=1) & (rows >= size(self.vehicle))
        unit = jnp.eye(u.shape[0], dtype=u.dtype).reshape(matrix.shape[:2] + (1,) * (u.ndim - 1))
        return jnp.where(idle, 0.0, found), matrix + jnp.where(idle[:, None], unit, 0.0)


class Search(NamedTuple):
    """How far each lane has come."""

    unknowns: Unknowns
    begun: Unknowns  # where linear creep would lead, within the flanges
    at: Unknowns  # the equilibrium at the load `reached`
    reached: Float[Array, "*lanes"]
    load: Float[Array, "*lanes"]  # that is tried now
    attempt: Int[Array, "*lanes"]
    tried: Int[Array, "*lanes"]  # steps in this attempt, or at this load
    stiffness: Float[Array, "*lanes"]  # of an implicit step, 1/s²
    norm: Float[Array, "*lanes"]  # of f at its start
    steps: Int[Array, "*lanes"]


def searched(
    case: Case, lanes: tuple[int, ...], first: Whole = 0, last: Whole = SHARES, beside: Unknowns | None = None
) -> tuple[Unknowns, Bool[Array, "*lanes"]]:
    """Unknowns in equilibrium and whether they are, of each of the lanes, by the attempts from `first` to `last` (counted from 0), which
    begin at the equilibrium of a neighbour `beside`, where there is one (else NaN)."""
    n, dtype = size(case.vehicle), jnp.result_type(float)
    rest = held(case.vehicle, case.damper, jnp.zeros((state_size(case.vehicle, case.damper), *lanes), dtype))
    rest = jnp.concatenate([rest[:n], rest[2 * n :]])
    none, whole, counted = jnp.zeros(lanes, dtype), jnp.ones(lanes, dtype), jnp.zeros(lanes, int)
    start = Search(rest, rest, rest, none, whole, counted - 1, counted, none, none, counted)
    if beside is not None:
        known = jnp.all(jnp.isfinite(beside), axis=0)
        begun, attempt = jnp.where(known, beside, rest), jnp.where(known, first, start.attempt)
        stiffness = jnp.where(known, jnp.asarray(STIFFNESS)[first], none)
        start = start._replace(unknowns=begun, begun=begun, attempt=attempt, stiffness=stiffness)
    last = jnp.asarray(last)

    def underway(now: Search) -> Bool[Array, "*lanes"]:
        small = (now.attempt == SHARES) & (now.load - now.reached < SMALLEST)
        return (now.reached < 1.0) & ~small & (now.attempt <= last) & (now.steps < MOST)

    def step(now: Search) -> Search:
        after, active = _step(case, rest, jnp.asarray(first), now), underway(now)
        return jax.tree.map(lambda new, old: jnp.where(active, new, old), after, now)

    end = jax.lax.while_loop(lambda now: jnp.any(underway(now)), step, start)
    return end.at, end.reached >= 1.0


def _step(case: Case, rest: Unknowns, first: Int[Array, ""], now: Search) -> Search:
    """One step of each lane. The one before the first attempt is that of linear creep in a little of the curve."""
    n, before = size(case.vehicle), now.attempt < 0
    found, matrix = case.jacobian(now.unknowns, jnp.where(before, LITTLE, now.load))
    norm = jnp.sqrt(jnp.sum(found**2, axis=0))
    shrinks = now.tried > 0
    ratio = jnp.clip(norm / jnp.where(shrinks & (now.norm > 0.0), now.norm, 1.0), 0.1, 2.0)
    stiffness = jnp.where(shrinks, now.stiffness * ratio, now.stiffness)
    unit = jnp.eye(len(found), dtype=found.dtype).reshape(matrix.shape[:2] + (1,) * (found.ndim - 1))
    change = eliminated(stiffness * unit - matrix, found[:, None])[:, 0]
    farthest = jnp.max(jnp.abs(change[:n]), axis=0)
    change = change * jnp.where(before, 1.0 / LITTLE, jnp.minimum(1.0, LONGEST / jnp.where(farthest > 0.0, farthest, 1.0)))
    u = _within_flanges(case.vehicle, now.unknowns + change, before)
    small = jnp.all(jnp.abs(change) <= ABSOLUTE + RELATIVE * jnp.abs(u), axis=0) & (stiffness < SOFT)
    sound = jnp.all(jnp.isfinite(u), axis=0) & (jnp.max(jnp.abs(u[:n]), axis=0) < FARTHEST)
    arrived = small & sound & ~before
    failed = ~arrived & ~before & (~sound | (now.tried + 1 >= jnp.asarray(STEPS)[now.attempt]))
    shares = now.attempt == SHARES
    # the next attempt begins anew; of shares the next is up to twice this one, or a quarter of it
    attempt = jnp.where(before, first, jnp.where(failed & ~shares, now.attempt + 1, now.attempt))
    to_shares = (attempt == SHARES) & (now.attempt != SHARES)
    begun = jnp.where(before, jnp.where(sound, u, rest), now.begun)
    reached = jnp.where(arrived, now.load, now.reached)
    at = jnp.where(arrived, u, now.at)
    share = jnp.where(failed, 0.25, 2.0) * (now.load - now.reached)
    load = jnp.where(shares & (arrived | failed), jnp.minimum(1.0, reached + share), now.load)
    u = jnp.where(failed | before, jnp.where(shares | to_shares, at, begun), u)
    return Search(
        u,
        begun,
        at,
        reached,
        jnp.where(to_shares, FIRST, load),
        attempt,
        jnp.where(arrived | failed | before, 0, now.tried + 1),
        jnp.where(failed | before, jnp.asarray(STIFFNESS)[attempt], stiffness),
        norm,
        now.steps + 1,
    )


def _within_flanges(vehicle: Vehicle, u: Unknowns, clip: Bool[Array, "*lanes"]) -> Unknowns:
    """Wheelsets no farther out than the flanges allow, where that is asked for; with linear creep there are none."""
    if vehicle.contact.law == "linear":
        return u
    rows = np.array([name.startswith("wheelset_y") for name in labels(vehicle)] + [False] * (len(u) - size(vehicle)))
    clearance = vehicle.contact.flange_clearance
    return jnp.where(clip & rows.reshape((-1,) + (1,) * (u.ndim - 1)), jnp.clip(u, -clearance, clearance), u)


def moved(case: Case, change: Case, u: Unknowns, converged: Bool[Array, "*lanes"]) -> Unknowns:
    """Implicit function: du = -(df/du)^-1 df along a change of the case; none in lanes without an equilibrium."""
    rate = jax.jvp(lambda case: case.residual(u), (case,), (change,))[1]
    matrix = case.jacobian(u)[1]
    unit = jnp.eye(len(u), dtype=u.dtype).reshape(matrix.shape[:2] + (1,) * (u.ndim - 1))
    # the inverse, because reverse mode transposes what is done to the rate
    found = jnp.sum(inverse(jnp.where(converged, matrix, unit)) * rate, axis=1)
    return jnp.where(converged, -found, 0.0)
