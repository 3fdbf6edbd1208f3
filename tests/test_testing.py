"""The public testers pass all of the package's own dampers, tracks and objectives, and find each way in which one can be wrong."""

from dataclasses import dataclass, field, fields
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from laws import CONTROLLED, with_law

import railjax
from railjax import objectives as aim
from railjax.dampers.named import DAMPERS, make_damper
from railjax.testing import check_damper, check_objective, check_track
from railjax.tuning.quantity import Quantity

SPEED = 200 / 3.6
OTHERS = {name: CONTROLLED[name] for name in ("balance, limited, soft", "balance, lags", "skyhook, lags")}
OTHERS["balance, centred"] = railjax.BalanceLogic(0.7, centring=1.5)
OTHERS["maxwell"] = railjax.MaxwellDamper(25e3, 5e6, 0.1, 5e3)
#: those with springs of their own; all others only take energy out, at every instant
SPRINGS = ("bouc-wen", "maxwell")


#: whose smooth twins are looked at as well: one of force, one of a valve, one with a lag, one with springs
TWINS = ("balance-logic", "skyhook-continuous", "skyhook, lags", "bouc-wen")


@pytest.mark.parametrize(
    ("name", "law"), [*((name, "sharp") for name in [*DAMPERS, *OTHERS]), *((name, "smooth") for name in TWINS)]
)
def test_every_damper(coach, name, law):
    damper = OTHERS[name] if name in OTHERS else make_damper(name, coach, 55.0)
    if "law" not in {entry.name for entry in fields(damper)}:
        return check_damper(damper, coach, smooth=True)
    check_damper(with_law(damper, law), coach, energy="balance" if name in SPRINGS else "instant")


RECORD = 0.25 * np.arange(401)


@pytest.mark.parametrize(
    "track",
    [
        railjax.TangentTrack(),
        railjax.SinusoidTrack(5e-3, 20.0),
        railjax.BumpTrack(5e-3, 30.0),
        railjax.RandomTrack(length=1000.0),
        railjax.MeasuredTrack(RECORD, 4e-3 * np.sin(RECORD / 3.0)),
    ],
    ids=lambda track: type(track).__name__,
)
def test_every_track(track):
    check_track(track)


@pytest.mark.parametrize(
    ("quantity", "vehicle", "damper"),
    [
        (aim.comfort(SPEED), "coach", None),
        (aim.linear_critical_speed(), "single-wheelset", None),
        (aim.least_damping(30.0), "single-wheelset", None),
        (aim.limit_cycle_amplitude(34.0), "single-wheelset", None),
    ],
    ids=lambda value: value.name if isinstance(value, Quantity) else str(value or ""),
)
def test_every_objective(quantity, vehicle, damper):
    # through time only in the mode that tuning uses: the other one compiles for a minute
    modes = ("forward",) if quantity.mode == "forward" else ("forward", "reverse")
    check_objective(quantity, railjax.load_vehicle(vehicle), damper, modes=modes)


class Law:
    """A linear damper, right in everything; those below are wrong in one thing each."""

    internal_states: ClassVar[int] = 0

    def force(self, vehicle, travel, velocity, internal):
        return 2.0 * self.damping * velocity, internal


def law(**body: Any) -> Any:
    """A damper of 10 kN s/m with some of it replaced."""
    kind = type("Mine", (Law,), {"__annotations__": {"damping": Any}, "damping": 1e4, **body})
    return jax.tree_util.register_dataclass(dataclass(frozen=True)(kind))()


def forced(function, **body):
    return law(force=lambda self, vehicle, travel, velocity, internal: (function(self, travel, velocity), internal), **body)


@jax.custom_jvp
def half(x):
    return x


half.defjvp(lambda x, rates: (x[0], 0.5 * rates[0]))


@jax.custom_vjp
def only_reverse(x):
    return x


only_reverse.defvjp(lambda x: (x, None), lambda _, slope: (slope,))


@jax.custom_jvp
def only_forward(x):
    return x


only_forward.defjvp(lambda x, rates: (x[0], jax.lax.while_loop(lambda t: jnp.any(t > 1e9), lambda t: 0.5 * t, rates[0])))


def with_state(rate, force, **body):
    return law(
        internal_states=1,
        force=lambda self, vehicle, travel, velocity, internal: (force(velocity, internal[0]), rate(internal)),
        **body,
    )


@jax.tree_util.register_pytree_node_class
@dataclass(frozen=True)
class Forgetful(Law):
    """Its number is another one after JAX has taken it apart."""

    damping: Any = 1e4

    def tree_flatten(self):
        return (self.damping,), None

    @classmethod
    def tree_unflatten(cls, _, leaves):
        return cls() if leaves[0] is None else cls(jax.tree.map(lambda leaf: 2.0 * leaf, leaves[0]))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Unhashable(Law):
    damping: Any = 1e4
    table: Any = field(default_factory=lambda: np.ones(1), metadata={"static": True})


def wrong_dampers():
    def decided(self, vehicle, travel, velocity, internal, seen):
        return 0.5 * internal + 1.0

    return {
        "is refused": 3.0,
        "not 10000.0": Forgetful(),
        "table is static and cannot be hashed": Unhashable(),
        r"force has the shape \(\d+,\), not \(1, \d+\)": forced(lambda self, x, v: jnp.sum(v, axis=0)),
        "force is int": forced(lambda self, x, v: jnp.sign(v).astype(int)),
        "cannot be traced by jax.jit: TracerBool": forced(lambda self, x, v: v if v[0, 0] > 0 else 2.0 * v),
        "the force is nan at": forced(lambda self, x, v: 1e4 * v**2 / v),
        "batch is not that by jax.vmap": forced(
            lambda self, x, v: 1e4 * v * (1.0 + jnp.mean(v**2, axis=1, keepdims=v.ndim > 1) if v.ndim > 1 else v)
        ),
        "in plain Python is not": forced(lambda self, x, v: (1.0 if isinstance(v, jax.core.Tracer) else 2.0) * 1e4 * v),
        "twice at an instant": with_state(jnp.zeros_like, lambda v, s: 1e4 * v, held=decided, even_states=(0,)),
        "the force, and what it is with the motion mirrored": forced(lambda self, x, v: 1e4 * v * (1.0 + 0.1 * (v > 0.0))),
        "rate of the internal states, and what it is": with_state(lambda s: 1.0 - s, lambda v, s: 1e4 * v),
        "pushes: force": forced(lambda self, x, v: 1e4 * v + 1e5 * x),
        "has given back": with_state(lambda s: -s, lambda v, s: -1e4 * v),
        "derivative by law.damping": forced(lambda self, x, v: 2.0 * half(self.damping) * v),
        "derivative by velocity is 0, ": forced(lambda self, x, v: 1e4 * jax.lax.stop_gradient(v)),
        "no derivative in forward mode: TypeError": forced(lambda self, x, v: 1e4 * only_reverse(v)),
        "no derivative in reverse mode: ValueError": forced(lambda self, x, v: 1e4 * only_forward(v)),
        "the reverse derivative by velocity is nan": forced(lambda self, x, v: 1e4 * v * jnp.sqrt(jnp.abs(v))),
    }


WRONG = wrong_dampers()


@pytest.fixture(scope="module")
def bogie():
    """What is wrong shows in the least vehicle with a secondary suspension."""
    return railjax.load_vehicle("cooperrider-bogie")


@pytest.mark.parametrize("message", WRONG)
def test_a_damper_that_is_wrong_in_one_thing(bogie, message):
    with pytest.raises(AssertionError, match=message) as caught:
        check_damper(WRONG[message], bogie)
    assert len(str(caught.value).splitlines()) == 1


def test_a_damper_may_say_what_it_is(bogie):
    check_damper(forced(lambda self, x, v: -self.damping * v, may_push=True), bogie)
    check_damper(forced(lambda self, x, v: self.damping * (v + x)), bogie, energy="balance")
    check_damper(forced(lambda self, x, v: self.damping * v * (1.0 + 0.1 * jnp.tanh(v))), bogie, symmetric=False, smooth=True)
    with pytest.raises(AssertionError, match="by central differences"):
        check_damper(forced(lambda self, x, v: self.damping * jnp.sign(v)), bogie, smooth=True)
    with pytest.raises(AssertionError, match="without lanes"):
        check_damper(railjax.PassiveDamper(jnp.ones(3)), bogie)
    with pytest.raises(railjax.InputError, match="no secondary suspension"):
        check_damper(railjax.PassiveDamper(), railjax.load_vehicle("single-wheelset"))


def track(seen_from, amplitude: Any = 5e-3):
    kind = type("Line", (), {"__annotations__": {"amplitude": Any}, "amplitude": amplitude, "seen_from": seen_from})
    return jax.tree_util.register_dataclass(dataclass(frozen=True)(kind))()


WRONG_TRACKS = {
    "is refused": 3.0,
    "the alignment has the shape": track(lambda self, offset: lambda start: self.amplitude * jnp.sin(start)),
    "the alignment is nan at start": track(lambda self, offset: lambda start: self.amplitude * jnp.sqrt(start + offset)),
    r"is not seen_from\(0\)": track(lambda self, offset: lambda start: self.amplitude * jnp.sin(start - offset)),
    "jumps by 0.00": track(lambda self, offset: lambda start: self.amplitude * jnp.where(start + offset > 77.0, 1.0, 0.0)),
    "derivative by track.amplitude": track(lambda self, offset: lambda start: half(self.amplitude) * jnp.sin(start + offset)),
    "by jax.vmap": track(
        lambda self, offset: lambda start: self.amplitude * jnp.sin(start + offset) * (1.0 if jnp.ndim(start) else 1.1)
    ),
}


@pytest.mark.parametrize("message", WRONG_TRACKS)
def test_a_track_that_is_wrong_in_one_thing(message):
    with pytest.raises(AssertionError, match=message) as caught:
        check_track(WRONG_TRACKS[message])
    assert len(str(caught.value).splitlines()) == 1


def quantity(value=lambda vehicle: vehicle.primary.stiffness_x * vehicle.secondary.damping_y, **body):
    body = {"value": lambda self, vehicle, damper: value(vehicle), "name": "mine", **body}
    return jax.tree_util.register_dataclass(dataclass(frozen=True, eq=False)(type("Mine", (Quantity,), body)))()


def stiffness(vehicle):
    return vehicle.primary.stiffness_x


WRONG_OBJECTIVES = {
    "is refused": 3.0,
    "has no name: NotImplementedError": quantity(name=Quantity.name),
    r"value has shape \(2,\)": quantity(lambda vehicle: jnp.ones(2) * vehicle.primary.stiffness_x),
    "value is nan": quantity(lambda vehicle: jnp.nan * vehicle.primary.stiffness_x),
    r"check\(\) refuses this vehicle: InputError": quantity(check=lambda *_: quantity() >= "x"),
    r"sharp\(\) is nan": quantity(sharp=lambda *_: float("nan")),
    "under jax.jit": quantity(lambda v: stiffness(v) * (2.0 if isinstance(stiffness(v), jax.core.Tracer) else 1.0)),
    "derivative in forward mode 0": quantity(lambda vehicle: jax.lax.stop_gradient(stiffness(vehicle))),
    "fails in reverse mode": quantity(lambda vehicle: only_forward(stiffness(vehicle))),
    "fails in forward mode": quantity(lambda vehicle: only_reverse(stiffness(vehicle))),
    "by each": quantity(each=lambda self, vehicle, damper: jnp.flip(stiffness(vehicle)) * vehicle.secondary.damping_y),
}


@pytest.mark.parametrize("message", WRONG_OBJECTIVES)
def test_an_objective_that_is_wrong_in_one_thing(coach, message):
    with pytest.raises(AssertionError, match=message) as caught:
        check_objective(WRONG_OBJECTIVES[message], coach)
    assert len(str(caught.value).splitlines()) == 1


def test_the_objective_that_the_wrong_ones_are_made_of_is_right(coach):
    check_objective(quantity(), coach)
    check_objective(quantity(lambda vehicle: only_forward(stiffness(vehicle))), coach, modes=("forward",))
