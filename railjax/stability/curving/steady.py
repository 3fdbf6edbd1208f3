"""`curving`: the steady motion of a vehicle, or of many, in arcs of constant curvature and cant."""

import dataclasses
import functools
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ...base.arguments import guarded
from ...base.batches import Batch, in_threads
from ...base.checks import Range, traced
from ...base.compilation import QUICK
from ...base.errors import InputError
from ...base.failed_lanes import nan_unless, no_number, without_nan
from ...base.packing import Form, as_numbers
from ...base.precision import require_double_precision
from ...base.typing import Scalar
from ...model.damper import Damper
from ...model.kinematics import size
from ...model.motion import PASSIVE, state_size
from ...model.parameters import without_labels
from ...model.track.curve import CANT_BASE, GRAVITY
from ...model.vehicle import Vehicle
from .equilibrium import SHARES, Case, moved, searched
from .result import Equilibrium, SteadyCurving
from .wheels import in_a_row, wheel_forces

#: times the friction, with which equilibria are looked for where there is none to be found otherwise: what begins there finds it
MORE_FRICTION = (1.1, 1.5, 2.5)
#: lanes that go from step to step together
TOGETHER = 64

A_CANT = Range("m", -0.4, 0.4, axes=1, why="; is it in millimetres?")


def a_radius(key: str, value: Any) -> None:
    """Numbers that are not 0; infinite is straight track."""
    Range("m", axes=1, infinite=True, why="; infinite for straight track, negative for a left-hand curve")(key, value)
    if not traced(value) and np.any(np.abs(np.asarray(value, float)) < 1.0):
        raise InputError(f"{key} must be a radius in m, of 1 m at least; infinite is straight track")


@guarded(radius=a_radius, cant=A_CANT)
def curving(vehicle: Vehicle, speed: Scalar, *, radius: Scalar, cant: Scalar = 0.0, damper: Damper = PASSIVE) -> SteadyCurving:
    """Steady motion in an arc: the equilibrium f(x; kappa, theta) = 0 of the equations of motion in the frames of the line.

    kappa = 1/R enters psi'/v of the creepages, the line's differences between the bodies' places enter the deflections, and each mass
    feels v² kappa - g theta to the outside, theta = cant/1.5 m, g = 9.81 m/s². Creep saturates and flanges guide as `contact.law` says.
    Differentiable by every float in both modes (implicit function); any number may be an array of one axis of lanes, and `jax.vmap` works. A lane
    without equilibrium is NaN and marked in `code`. Where creep slides there may be several equilibria: it is the one nearest to linear
    creep that is looked for.

    Args:
        vehicle: what runs, as `load_vehicle` gives it.
        speed: v, m/s.
        radius: R, m, positive for a right-hand curve, negative for a left-hand one, infinite for straight track.
        cant: height of the outer rail above the inner one over a base of 1.5 m, m.
        damper: what takes the place of rho_cy; at rest it matters only where it has a stiffness.

    Returns:
        The steady motion, SI: displacements, guiding forces, loads, creep forces, wear, with wheelsets first and lanes last.

    Raises:
        InputError: for a radius of 0, a cant beyond 400 mm, in single precision.
    """
    require_double_precision("steady curving")
    trees = as_numbers((without_labels(vehicle), damper, speed, radius, cant))
    found, _ = _found(Batch.of(*trees).lanes, trees)
    geometry, clearance = vehicle.geometry, vehicle.contact.flange_clearance
    drawn: dict[str, Any] = {}
    if not traced((geometry, clearance)):
        bogies, axles = (
            np.mean(half) * np.asarray(pattern)
            for half, pattern in (
                (geometry.half_pivot_distance, geometry.bogie_pattern),
                (geometry.half_wheelbase, geometry.axle_pattern),
            )
        )
        places = np.add.outer(bogies, axles).ravel().tolist()
        drawn = {"positions": tuple(places), "clearance": float(np.mean(clearance))}
    return SteadyCurving(**found, speed=speed, radius=radius, cant=cant, vehicle_name=vehicle.name, **drawn)


def case_of(vehicle: Vehicle, damper: Damper, speed: Scalar, radius: Scalar, cant: Scalar) -> Case:
    """The arc as the equations have it: kappa (1/m) to the right and theta (rad), positive where the right rail is lower.

    Args:
        vehicle: what runs.
        damper: what takes the place of rho_cy.
        speed: v, m/s.
        radius: R, m, to the right.
        cant: of the outer rail, m.
    """
    return Case(vehicle, damper, speed, 1.0 / radius, jnp.where(radius < 0.0, -cant, cant) / CANT_BASE)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _found(lanes: int | None, trees: tuple) -> tuple[dict[str, Array], Array]:
    """What is said of each lane, and the unknowns in equilibrium."""
    return _compiled(trees) if traced(trees) else _on_host(lanes, trees)


@_found.defjvp
def _derivative(lanes: int | None, primals: tuple, tangents: tuple) -> tuple:
    told, unknowns = _found(lanes, *primals)
    along = _rates(*primals, *tangents, unknowns, told["code"] != int(Equilibrium.FAILED))
    return (told, unknowns), (along[0] | {"code": np.zeros(told["code"].shape, jax.dtypes.float0)}, along[1])


@jax.jit
def _rates(trees: tuple, change: tuple, unknowns: Array, converged: Array) -> tuple[dict[str, Array], Array]:
    """Derivatives of all but the code along a change of what was given; zero where there is no equilibrium."""

    def of(*given: Any) -> tuple[dict[str, Array], Array]:
        here, along, (unknowns, converged) = without_nan(given[: len(trees)]), given[len(trees) : -2], given[-2:]
        case, rate = jax.jvp(case_of, here, along)
        unknowns_rate = moved(case, rate, unknowns, converged)

        def told(case: Case, unknowns: Array) -> dict[str, Array]:
            found = _told(case, unknowns)
            return {name: value for name, value in found.items() if name != "code"}

        found = jax.jvp(told, (case, unknowns), (rate, unknowns_rate))[1]
        return {name: jnp.where(converged, value, 0.0) for name, value in found.items()}, unknowns_rate

    batch = Batch.of(*trees, *change, unknowns, converged, own={2 * len(trees): 1})
    return of(*batch.trees) if batch.lanes is None else batch.in_chunks(of, TOGETHER)


def _searched(first: Any, last: Any, beside: Array | None, *trees: Any) -> tuple[dict[str, Array], Array]:
    """Of all lanes together; those that have no equilibrium are NaN."""
    batch = Batch.of(*trees)
    lanes = () if batch.lanes is None else (batch.lanes,)
    sound = jnp.broadcast_to(~no_number(trees, batch.axes), lanes)
    case = case_of(*without_nan(trees))
    unknowns, converged = searched(case, lanes, first, last, beside)
    converged = converged & sound
    told = _told(case, unknowns)
    code = jnp.where(converged, told.pop("code"), int(Equilibrium.FAILED))
    deficiency = told.pop("cant_deficiency")
    return nan_unless(converged, told) | {"code": code, "cant_deficiency": deficiency}, unknowns


@jax.jit
def _compiled(trees: tuple) -> tuple[dict[str, Array], Array]:
    """Where numbers are not known yet, or mapped over by the user."""
    batch = Batch.of(*trees)
    function = functools.partial(_searched, 0, SHARES, None)
    return function(*trees) if batch.lanes is None else batch.in_chunks(function, TOGETHER)


# at the full level it takes as long to compile and twice as long to run
@functools.partial(jax.jit, static_argnames="form", compiler_options=QUICK)
def _chunk(
    form: Form, numbers: Array, tables: list, first: Array, last: Array, neighbours: Array
) -> tuple[dict[str, Array], Array]:
    """`form` is that of the numbers, with an entry without shape for each table."""
    count, beside = [math.prod(shape) for shape in form.shapes if shape is not None], iter(tables)
    pieces = iter(jnp.split(numbers, np.cumsum(count)[:-1]))
    leaves = [next(beside) if shape is None else next(pieces).reshape((*shape, -1)) for shape in form.shapes]
    return _searched(first, last, neighbours, *form.structure.unflatten(leaves))


def _on_host(lanes: int | None, trees: tuple) -> tuple[dict[str, Array], Array]:
    """Of known numbers, in chunks of a fixed number of lanes, compiled once for all of a kind of vehicle whatever has lanes: first all by
    Newton's method alone, then the few that need more; at last from where they would be with more friction."""
    batch = Batch.of(*trees)
    count = lanes or 1
    found = _of_lanes(batch, np.arange(count), 0, 0)
    for friction in (1.0, *MORE_FRICTION):
        again = np.flatnonzero(found[0]["code"] == int(Equilibrium.FAILED))
        if not again.size:
            break
        if friction == 1.0:
            other = _of_lanes(batch, again, 1, SHARES)
        else:
            vehicle, *rest = trees
            contact = dataclasses.replace(vehicle.contact, friction=friction * vehicle.contact.friction)
            near = _of_lanes(Batch.of(dataclasses.replace(vehicle, contact=contact), *rest), again, 0, SHARES)
            beside = np.where(near[0]["code"] == int(Equilibrium.FAILED), np.nan, near[1])
            other = _of_lanes(batch, again, 0, SHARES - 1, beside)
        for all_of, more in zip(*map(jax.tree.leaves, (found, other)), strict=True):
            all_of[..., again] = more
    return jax.device_put(found if lanes is not None else jax.tree.map(lambda leaf: leaf[..., 0], found))


def equilibria(vehicle: Vehicle, damper: Damper, speed: Any, radius: Any, cant: Any) -> dict[str, Any]:
    """What is said of known lanes, of which the speed has an axis, as NumPy's arrays.

    Args:
        vehicle: what runs.
        damper: what takes the place of rho_cy.
        speed: v, m/s, one per lane.
        radius: R, m, to the right.
        cant: of the outer rail, m.
    """
    trees = as_numbers((vehicle, damper, speed, radius, cant))
    return jax.tree.map(np.asarray, _on_host(len(speed), trees)[0])


def _of_lanes(
    batch: Batch,
    index: Int[np.ndarray, "lanes"],
    first: int,
    last: int,
    beside: Float[np.ndarray, "unknowns lanes"] | None = None,
) -> tuple[dict[str, Any], Any]:
    leaves = [(np.asarray(leaf), own) for leaf, own in zip(*map(jax.tree.leaves, (batch.trees, batch.axes)), strict=True)]
    # a table that lanes share stays one
    shapes = tuple(leaf.shape[:own] if leaf.ndim > own or own < 2 else None for leaf, own in leaves)
    form = Form(jax.tree.structure(batch.trees), shapes)  # type: ignore[arg-type]
    tables = [leaf for (leaf, _), shape in zip(leaves, shapes, strict=True) if shape is None]

    if beside is None:
        vehicle, damper = batch.trees[:2]
        beside = np.full((state_size(vehicle, damper) - size(vehicle), len(index)), np.nan)

    def piece(start: int) -> tuple[dict[str, Any], Any]:
        those = np.minimum(np.arange(start, start + TOGETHER), len(index) - 1)
        here = index[those]
        numbers = [
            np.broadcast_to(leaf[..., here] if leaf.ndim > own else leaf[..., None], (*shape, TOGETHER)).reshape((-1, TOGETHER))
            for (leaf, own), shape in zip(leaves, shapes, strict=True)
            if shape is not None
        ]
        given = np.asarray(first), np.asarray(last), beside[:, those]
        return jax.tree.map(np.asarray, _chunk(form, np.concatenate(numbers), tables, *given))

    found = in_threads(piece, range(0, len(index), TOGETHER))
    return jax.tree.map(lambda *parts: np.concatenate(parts, axis=-1)[..., : len(index)], *found)


def _told(case: Case, unknowns: Array) -> dict[str, Array]:
    """What is read off the equilibrium."""
    x = case.state(unknowns)
    instant = case.instant(x)
    wheels = wheel_forces(instant)
    q = instant.coordinates
    still, lanes = jnp.zeros_like(q["wheelset_y"][:, 0]), unknowns.shape[1:]
    psi, kappa = in_a_row(q["wheelset_psi"]), jnp.broadcast_to(case.curvature, lanes)
    sideways = jnp.broadcast_to(case.speed**2 * case.curvature - GRAVITY * case.cant_angle, lanes)
    roll = q.get("carbody_phi", jnp.zeros(lanes, x.dtype))
    outside = jnp.where(kappa < 0.0, -1.0, 1.0)
    lifted = jnp.any(wheels.load < 0.0, axis=(0, 1))
    return {
        "wheelset_y": in_a_row(q["wheelset_y"]),
        "wheelset_psi": psi,
        "angle_of_attack": jnp.where(kappa < 0.0, psi, -psi),
        "guiding_force": wheels.guiding,
        "sum_y": jnp.sum(wheels.guiding, axis=1),
        "wheel_load": wheels.load,
        "load_transfer": 0.5 * (wheels.load[:, 0] - wheels.load[:, 1]),
        "y_over_q": wheels.y_over_q,
        "longitudinal_creep_force": wheels.longitudinal_creep,
        "lateral_creep_force": wheels.lateral_creep,
        "saturation": in_a_row(instant.contact.saturation),
        "wheel_wear": wheels.wear,
        "wear_number": jnp.sum(wheels.wear, axis=(0, 1)),
        "bogie_yaw": q.get("bogie_psi", still),
        "carbody_acceleration": sideways + GRAVITY * roll,
        "carbody_roll": roll,
        "state": x,
        "code": jnp.where(lifted, int(Equilibrium.LIFTED), int(Equilibrium.OK)),
        "cant_deficiency": CANT_BASE / GRAVITY * outside * sideways,
    }
