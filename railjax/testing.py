"""Testers of what users write: one for all dampers, one for all tracks, one for all objectives; to be called in one's own tests.

    railjax.use_double_precision()

    def test_my_damper():
        railjax.testing.check_damper(MyDamper())

Each raises an `AssertionError` for the first thing that is wrong, in one line that names it with its numbers.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .base.compilation import HASTY, options
from .base.errors import InputError
from .base.packing import as_numbers
from .base.precision import require_double_precision
from .base.probing import ROUNDING, Found, differentiated, equal, finite, lanes_of, probed, round_trip, said, same, shapes
from .base.typing import Scalar
from .model import damper as dampers
from .model.kinematics import damper_point, deflections, size, split
from .model.parameters import without_labels
from .model.suspension import yaw_damper_states
from .model.track.shapes import a_track, alignment
from .model.vehicle import Vehicle
from .simulation.runge_kutta import rk4
from .tuning.quantity import Quantity

#: m and m/s: motion over a secondary suspension; random motions tried; and those at rest, at zero velocity and at zero travel
TRAVEL, VELOCITY, MOVING, NASTY = 1e-2, 0.2, 24, 6


def check_damper(
    law: Any,
    vehicle: Vehicle | None = None,
    *,
    energy: Literal["instant", "balance", "free"] | None = None,
    symmetric: bool = True,
    smooth: bool | None = None,
    internal_size: float = 1e-2,
    seed: int = 0,
) -> None:
    """Check a damper as `simulate`, `hunting_branch`, `sweep` and `tune` use it; `railjax.Damper` says how one is written.

    Over random motions of the whole vehicle, and at rest, at zero velocity and at zero travel: the pytree's round trip; shapes; that
    nothing is NaN; that a batch, `jax.vmap`, `jax.jit` and plain Python give the same, with lanes in the law's own numbers as well; that
    deciding twice (`held`) changes nothing; that the mirrored motion has the mirrored force (`even_states` have no side); that energy
    is taken out; and the derivatives by motion, internal states, vehicle and every number of the law, forward and reverse, against
    central differences (where velocity or travel vanish only that they are finite, unless the law is smooth).

    Args:
        law: the damper, without lanes.
        vehicle: what it is for, with a secondary suspension; None: the packaged coach.
        energy: "instant": F v >= 0 at every instant, whatever the internal states, as of passive and semi-active dampers without springs
            of their own. "balance": from empty internal states on, never more is given back than was taken in, which allows springs.
            "free": it may push, as an actuator. None: "free" where the law has `may_push = True`, else "instant" where its internal
            states are `even_states` or none, else "balance".
        symmetric: False for a law that has a side.
        smooth: whether derivatives are compared with differences at rest, at zero velocity and at zero travel too; None: where the
            law has `law = "smooth"`.
        internal_size: size of the random internal states in their own units, dimensionless; `even_states` lie between 0 and 1.
        seed: of the random motions, a whole number.

    Raises `AssertionError` for what is wrong, and `InputError` in single precision.
    """
    name = _begun("check_damper", law, dampers.check_damper)
    vehicle = as_numbers(without_labels(_packaged("coach") if vehicle is None else vehicle))
    at, along = _motions(vehicle, law, internal_size, np.random.default_rng(seed))
    states, shape = law.internal_states, np.shape(at["travel"])
    shapes(name, _damped, at, {"force": shape, "rate of the internal states": (states, *shape)})
    wanted = energy or _claimed(law)
    found = probed(name, _damped, at, along, lambda at: _more_of(at, law, wanted == "balance"))
    force, (_, velocity) = np.asarray(found.batch["force"]), (at["travel"], at["velocity"])
    where = [f"travel {x:.3g} m, velocity {v:.3g} m/s" for x, v in zip(at["travel"][0], velocity[0], strict=True)]
    finite(name, found, where)
    same(name, _damped, found, at, MOVING // 2)
    equal(name, "held() twice at an instant is not held() once", found.more["twice"], found.more["once"], where)
    if symmetric:
        _mirrored(name, found, where)
    if wanted == "instant":
        power = force * velocity
        worst = np.unravel_index(np.argmin(power), power.shape)
        assert power[worst] >= 0.0, (
            f"{name}: pushes: force {force[worst]:.6g} N at velocity {velocity[worst]:.6g} m/s ({where[worst[1]]} of the leading bogie); "
            'energy="balance" allows springs, energy="free" any force'
        )
    smooth = getattr(law, "law", None) == "smooth" if smooth is None else smooth
    differentiated(name, found, where, MOVING, MOVING + NASTY if smooth else MOVING)
    if wanted == "balance":
        _balanced(name, at, np.asarray(found.more["slowing"]))


def check_track(track: Any, *, length: float = 300.0, seed: int = 0) -> None:
    """Check a track as `simulate` uses it: an object with `seen_from(offset)`, which returns eta(start + offset), m, as a function of start.

    The pytree's round trip; shapes; that nothing is NaN, before the start and 100 km away neither; that eta depends on start + offset
    alone; that a batch, `jax.vmap`, `jax.jit` and plain Python give the same, with lanes in the track's own numbers as well; that the
    alignment does not jump; and its derivatives by distance and every number of the track, forward and reverse, against differences.

    Args:
        track: the track, without lanes.
        length: m; the stretch from 0 on that is tried.
        seed: of the places tried, a whole number.

    Raises `AssertionError` for what is wrong, and `InputError` in single precision.
    """
    name = _begun("check_track", track, lambda value: a_track("track", value))
    rng = np.random.default_rng(seed)
    start = np.concatenate([rng.uniform(0.0, length, MOVING), [-50.0, 0.0, 0.5 * length, length, 1e4, 1e5]])
    own, own_along = lanes_of(as_numbers(track), start.size, rng)
    at = {"track": own, "offset": rng.uniform(-10.0, 10.0, (2, 2, start.size)), "start": start}
    along = {"track": own_along, "offset": np.ones_like(at["offset"]), "start": np.ones_like(start)}
    shapes(name, _aligned, at, {"alignment": at["offset"].shape})
    found = probed(name, _aligned, at, along, lambda at: {"moved": _aligned(_without_offset(at))})
    where = [f"start {place:.6g} m" for place in start]
    finite(name, found, where)
    equal(name, "seen_from(offset)(start) is not seen_from(0)(start + offset)", found.batch, found.more["moved"], where)
    same(name, _aligned, found, at, MOVING // 2)
    differentiated(name, found, where, MOVING, MOVING)
    _continuous(name, track, length)


def check_objective(
    quantity: Any,
    vehicle: Vehicle | None = None,
    damper: Any = None,
    *,
    modes: Sequence[str] = ("forward", "reverse"),
    rtol: float = 1e-4,
    step: float = 1e-4,
    seed: int = 0,
) -> None:
    """Check an objective or constraint as `tune`, `pareto` and `schedule_gain` use it: a `Quantity` of `railjax.objectives`.

    The pytree's round trip; its name, unit and sharp twin; that its value is one finite number; that `check` lets this vehicle pass; that
    `jax.jit`, `jax.vmap` and `each` give what single calls give; and its derivative as all numbers of vehicle and damper change by random
    shares at once, in both modes against central differences.

    Args:
        quantity: the objective.
        vehicle: one for which it has a value; None: the packaged coach.
        damper: the damper beside it; None: the vehicle's own.
        modes: "forward", "reverse" or both: `quantity.mode` is the one that tuning uses.
        rtol: share (dimensionless) of the derivative by which the difference may be off.
        step: share (dimensionless) by which the numbers are changed for the difference.
        seed: of the random shares, a whole number.

    Raises `AssertionError` for what is wrong, and `InputError` in single precision.
    """
    name = _begun("check_objective", quantity, _a_quantity)
    damper = dampers.PassiveDamper() if damper is None else damper
    with said(name, "does not suit this damper"):
        quantity = quantity.suited(damper)
    trees = as_numbers((without_labels(_packaged("coach") if vehicle is None else vehicle), damper))
    rng = np.random.default_rng(seed)
    along = jax.tree.map(lambda leaf: leaf * rng.uniform(-1.0, 1.0, np.shape(leaf)), trees)

    def changed(share: Scalar) -> tuple[Vehicle, Any]:
        return jax.tree.map(lambda leaf, by: leaf + share * by, trees, along)

    def value(share: Scalar) -> Float[Array, "..."]:
        return quantity.value(*changed(share))

    def lanes(shares: Scalar) -> tuple[Vehicle, Any]:
        return jax.tree.map(lambda leaf, by: leaf[..., None] + shares * by[..., None], trees, along)

    # what is computed on the host is not compiled as a whole; the rest runs a few times
    compiled = functools.partial(jax.jit, compiler_options=options(HASTY)) if quantity.traced else lambda function: function
    pair = jnp.array([0.0, 10.0 * step])
    ways: dict[str, Callable[[], Any]] = {
        "jax.vmap": lambda: compiled(jax.vmap(value))(pair),
        "forward": lambda: compiled(lambda share: jax.jvp(value, (share,), (1.0,))[1])(0.0),
        "reverse": lambda: compiled(jax.grad(value))(0.0),
    }
    if type(quantity).each is not Quantity.each:
        ways["each"] = lambda: compiled(lambda shares: quantity.each(*lanes(shares)))(pair)
    with said(name, "value() cannot be computed"):
        plain = value(jnp.asarray(0.0))
    assert np.shape(plain) == (), f"{name}: value has shape {np.shape(plain)}, not ()"
    assert np.isfinite(plain), f"{name}: value is {plain} for this vehicle"
    for word in ("name", "unit"):
        with said(name, f"has no {word}"):
            assert isinstance(getattr(quantity, word), str)
    with said(name, "check() refuses this vehicle"):
        quantity.check(*changed(0.0))
    with said(name, "sharp() cannot be computed"):
        sharp = quantity.sharp(*trees)
    assert np.isfinite(sharp), f"{name}: sharp() is {sharp}, value() {float(plain):.6g}"
    single = compiled(value)
    near = {share: float(single(jnp.asarray(share))) for share in (0.0, 10.0 * step, step, -step)}
    assert abs(near[0.0] - plain) <= ROUNDING * abs(plain), (
        f"{name}: under jax.jit {near[0.0]:.9g}, in plain Python {float(plain):.9g}"
    )
    difference = (near[step] - near[-step]) / (2.0 * step)
    for way, call in ways.items():
        if way in ("forward", "reverse") and way not in modes:
            continue
        with said(name, f"fails {'in ' + way + ' mode' if way in modes else 'by ' + way}"):
            got = np.asarray(call())
        if way in modes:
            assert abs(got - difference) <= rtol * abs(difference) + 1e-8 * abs(plain), (
                f"{name}: derivative in {way} mode {float(got):.6g}, by central differences {difference:.6g}"
            )
        else:
            wanted = np.array([near[0.0], near[10.0 * step]])
            assert got.shape == (2,), f"{name}: {way} of two lanes has shape {got.shape}"
            assert np.allclose(got, wanted, rtol=1e-7, atol=0.0), f"{name}: by {way} {got}, one by one {wanted}"


def _begun(what: str, value: Any, refuse: Callable[[Any], None]) -> str:
    """The kind's name, after what can be said without computing: it is one of those, and a pytree that survives its round trip."""
    require_double_precision(what)
    name = type(value).__name__
    with said(name, "is refused"):
        refuse(value)
    round_trip(name, value)
    return name


def _a_quantity(value: Any) -> None:
    if not isinstance(value, Quantity):
        raise InputError(f"{value!r} is not one of railjax.objectives, nor of a class made from Quantity")


def _packaged(name: str) -> Vehicle:
    from .vehicles.files import load_vehicle

    return load_vehicle(name)


def _motions(vehicle: Vehicle, law: Any, internal_size: float, rng: np.random.Generator) -> tuple[dict, dict]:
    """Motions, internal states, and the law's and the vehicle's numbers, in lanes; and directions in which each changes."""
    count, lanes, slow = size(vehicle), MOVING + NASTY, np.ones(MOVING + NASTY)
    slow[:MOVING] = np.geomspace(1e-4, 1.0, MOVING)  # down to what noise makes
    sizes = [amount * slow * rng.normal(size=(count, lanes)) for amount in (TRAVEL, VELOCITY)]
    seen = dampers.Seen(  # type: ignore[call-arg]
        *(split(vehicle, jnp.asarray(part)) for part in sizes),
        internal_size * jnp.asarray(rng.normal(size=(yaw_damper_states(vehicle), len(vehicle.geometry.bogie_pattern), lanes))),
    )
    deflected = [deflections(vehicle, part) for part in seen[:2]]
    if "secondary_y" not in deflected[0]:
        raise InputError("check_damper: this vehicle has no secondary suspension")
    travel, velocity = (np.array(part[damper_point(part)]) for part in deflected)
    internal = internal_size * slow * rng.normal(size=(law.internal_states, *travel.shape))
    for index in getattr(law, "even_states", ()):
        internal[index] = rng.uniform(size=internal[index].shape)
    rest, still, level = (slice(MOVING + k, MOVING + k + 2) for k in (0, 2, 4))
    velocity[:, rest] = velocity[:, still] = travel[:, rest] = travel[:, level] = internal[..., rest] = 0.0
    owns, alongs = zip(*(lanes_of(as_numbers(tree), lanes, rng) for tree in (law, vehicle)), strict=True)
    at = dict(law=owns[0], vehicle=owns[1], travel=travel, velocity=velocity, internal=internal, seen=seen)
    moved = dict(travel=TRAVEL * slow, velocity=VELOCITY * slow, internal=internal_size * slow, seen=VELOCITY * slow)
    directions = {key: jax.tree.map(lambda leaf, by=by: by * np.ones_like(leaf), at[key]) for key, by in moved.items()}
    return jax.device_get(at), dict(law=alongs[0], vehicle=alongs[1], **jax.device_get(directions))


def _held(at: dict) -> Any:
    """The internal states as they go into a step: just after the controller has decided."""
    held = getattr(at["law"], "held", None)
    return at["internal"] if held is None else held(at["vehicle"], at["travel"], at["velocity"], at["internal"], at["seen"])


def _free(at: dict) -> tuple[Any, Any]:
    """Force and rates with the internal states as they are."""
    return dampers.law_of(at["law"], at["seen"])(at["vehicle"], at["travel"], at["velocity"], at["internal"])


def _damped(at: dict) -> dict:
    force, rate = _free({**at, "internal": _held(at)})
    return {"force": force, "rate of the internal states": rate}


def _more_of(at: dict, law: Any, stores: bool) -> dict[str, Any]:
    """The mirrored motion's force, decisions once and twice, and how each internal state slows the others."""
    sides = np.full(law.internal_states, -1.0)
    sides[list(getattr(law, "even_states", ()))] = 1.0
    odd = jax.tree.map(lambda part: -part, {key: at[key] for key in ("travel", "velocity", "seen")})
    mirrored = _damped({**at, **odd, "internal": at["internal"] * sides[:, None, None]})
    mirrored = {
        "force": -mirrored["force"],
        **{key: part * sides[:, None, None] for key, part in mirrored.items() if key != "force"},
    }

    def slowed(state: Any) -> Any:
        tangent = state[:, None, None] * jnp.ones_like(at["internal"])
        return jax.jvp(lambda internal: _free({**at, "internal": internal})[1], (at["internal"],), (tangent,))[1]

    once = _held(at)
    twice = _held({**at, "internal": once})
    return {
        "mirrored": mirrored,
        "once": once,
        "twice": twice,
        "slowing": jax.vmap(slowed)(jnp.eye(law.internal_states)) if stores else None,
    }


def _aligned(at: dict) -> dict:
    return {"alignment": at["track"].seen_from(at["offset"])(at["start"])}


def _without_offset(at: dict) -> dict:
    return {"track": at["track"], "offset": jnp.zeros_like(at["offset"]), "start": at["start"] + at["offset"]}


def _mirrored(name: str, found: Found, where: list[str]) -> None:
    for key, part in found.batch.items():
        what = f"the {key}, and what it is with the motion mirrored, turned back (even_states have no side, symmetric=False allows one)"
        equal(name, what, part, found.more["mirrored"][key], where)


def _claimed(law: Any) -> str:
    if getattr(law, "may_push", False):
        return "free"
    return "instant" if len(set(getattr(law, "even_states", ()))) == law.internal_states else "balance"


def _continuous(name: str, track: Any, length: float) -> None:
    """Go into the steepest interval, again and again: what is left at 1e-8 m is a jump."""
    low, width, largest, at = -10.0, length + 10.0, 0.0, jax.jit(lambda track, places: alignment(track, places))
    while width > 1e-8:
        places = np.linspace(low, low + width, 2049)
        eta = np.asarray(at(track, places))
        steepest, largest = int(np.argmax(np.abs(np.diff(eta)))), max(largest, np.max(np.abs(eta)))
        low, width = places[steepest], width / 2048
        change = abs(eta[steepest + 1] - eta[steepest])
    assert change <= 1e-6 * largest, f"{name}: the alignment jumps by {change:.4g} m at {low:.6g} m"


def _balanced(name: str, at: dict, slowing: np.ndarray) -> None:
    """From empty internal states through 1 s of a motion of two tones: no more is ever given back than was taken in."""
    law, vehicle = (jax.tree.map(lambda leaf: leaf[..., 0], at[key]) for key in ("law", "vehicle"))
    # as many steps as RK4 needs, with a margin, for the fastest of the internal states
    rates = np.abs(np.linalg.eigvals(np.moveaxis(slowing, (0, 1), (-1, -2))))
    steps = int(np.clip(np.max(rates, initial=0.0), 2000, 200_000))
    tones = 2.0 * np.pi * np.array([2.0, 5.3])
    shapes = VELOCITY / tones[:, None] * np.random.default_rng(2).normal(size=(2, size(vehicle)))
    least, when = (np.asarray(part) for part in _least_work(type(law), law, vehicle, shapes, tones, steps))
    bogie = int(np.argmin(least))
    assert np.all(np.isfinite(least)), f"{name}: does not stay finite over 1 s in {steps} steps"
    assert least[bogie] >= 0.0, (
        f"{name}: has given back {-least[bogie]:.4g} J more than it has taken in after {when[bogie]:.3g} s, moved at 2 and 5.3 Hz from rest; "
        'energy="free" allows it'
    )


@functools.partial(jax.jit, static_argnums=0)
def _least_work(kind: type, law: Any, vehicle: Vehicle, shapes: Any, tones: Any, steps: Any) -> tuple[Any, Any]:
    """Least work taken in so far and when, per bogie, in J and s; 1e-3 of what went to and fro is left to the quadrature.
    `kind` is the law's class, which JAX 0.10 may take for another with the same fields."""
    dt = 1.0 / steps

    def given(t: Any, internal: Any) -> dict:
        parts = jnp.sum(jnp.sin(tones * t)[:, None] * shapes, 0), jnp.sum((tones * jnp.cos(tones * t))[:, None] * shapes, 0)
        seen = dampers.Seen(  # type: ignore[call-arg]
            *(split(vehicle, part) for part in parts),
            jnp.zeros((yaw_damper_states(vehicle), len(vehicle.geometry.bogie_pattern))),
        )
        travel, velocity = ((found := deflections(vehicle, part))[damper_point(found)] for part in seen[:2])
        return dict(law=law, vehicle=vehicle, travel=travel, velocity=velocity, internal=internal, seen=seen)

    def step(k: Any, carry: tuple) -> tuple:
        internal, work, moved, least, when = carry
        start = given(k * dt, internal)
        internal = _held(start)
        power = _free(start | {"internal": internal})[0] * start["velocity"]
        work, moved = work + dt * power, moved + dt * jnp.abs(power)
        left = work + 1e-3 * moved
        when, least = jnp.where(left < least, (k + 1) * dt, when), jnp.minimum(left, least)

        def stage(index: Any, internal: Any, nothing: None) -> tuple[Any, None]:
            return _free(given((k + jnp.array([0.0, 0.5, 0.5, 1.0])[index]) * dt, internal))[1], nothing

        return rk4(stage, internal, None, dt)[0], work, moved, least, when

    bogies = jnp.zeros(len(vehicle.geometry.bogie_pattern))
    begin = jnp.zeros((law.internal_states, bogies.size)), bogies, bogies, bogies + jnp.inf, bogies
    return jax.lax.fori_loop(0, steps, step, begin)[3:]
