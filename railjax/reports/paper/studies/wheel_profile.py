"""Beyond the paper: a wheel profile changed by gradients for the highest nonlinear critical speed at a given steering ability."""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ....base.errors import NumericalError
from ....base.style import COLOURS, figure
from ....base.units import KMH
from ....model.contact.conicity import equivalent_conicity
from ....model.contact.geometry import contact_geometry
from ....model.contact.profile_contact import contact_at
from ....model.contact.profile_table import with_profiles
from ....model.contact.profiles import WheelProfile
from ....model.vehicle import Vehicle
from ....simulation.simulate import simulate
from ....stability.hunting.nonlinear_critical import nonlinear_critical_speed
from ..study import Compared, Context, Outcome, Picture, study

#: m from the tread datum, of the control heights of the spline that is added to the wheel
AT = np.linspace(-30e-3, 20e-3, 6)
#: mm: bound of a height; reach of the first step and of the last that is tried; what may be lost of Delta r at 5 mm
MOST, REACH, LEAST, LOST = 0.5, 0.04, 3e-3, 2e-3
STEPS = 14
#: by what the reach grows after a step that counts and shrinks after one that does not
GROWS, SHRINKS = 1.3, 0.4
#: m, of each wheelset; s
DISTURBANCES, DURATION = ([3e-3] * 4, [6e-3] * 4, [8e-3, 8e-3, -8e-3, -8e-3], [2e-3, 4e-3, 6e-3, 8e-3]), 60.0
#: share of a critical speed at which disturbances must die out; m, below which a motion has
BELOW, DIED_OUT = 0.97, 1e-5


class Wheel(NamedTuple):
    """A changed wheel: heights (mm), the vehicle on it, its nonlinear critical speed (m/s) and Delta r at 5 mm (mm), with their slopes by
    the heights, per mm."""

    heights: Float[np.ndarray, "heights"]
    vehicle: Vehicle
    speed: float
    speed_slope: Float[np.ndarray, "heights"]
    steering: float
    steering_slope: Float[np.ndarray, "heights"]


def changed(coach: Vehicle, wheel: WheelProfile, heights: Float[Array, "heights"]) -> Vehicle:
    """The coach on a wheel changed by `heights` (m) at `AT`, and 60E1 1:40."""
    return with_profiles(coach, wheel.changed(AT, heights))


def steering(vehicle: Vehicle) -> Float[Array, ""]:
    """Delta r at 5 mm, m: how tight a curve a free wheelset can follow."""
    return 2.0 * contact_at(vehicle.profiles, jnp.full((1, 1), 5e-3)).radius[0, 0]


def with_rates(coach: Vehicle, wheel: WheelProfile) -> Any:
    """Compiled: heights (m) to the vehicle and its derivatives by each of them, through the contact geometry."""

    def both(heights: Float[Array, "heights"]) -> Any:
        along = partial(jax.jvp, partial(changed, coach, wheel), (heights,))
        return jax.vmap(lambda tangent: along((tangent,)), out_axes=(None, 0))(jnp.eye(len(AT)))

    return jax.jit(both)


def judged(made: Any, heights: Float[np.ndarray, "heights"]) -> Wheel:
    """A wheel changed by `heights` (mm).

    Args:
        made: from `with_rates`
        heights: mm at `AT`

    Raises:
        NumericalError: where there is no nonlinear critical speed.
    """
    vehicle, rates = made(jnp.asarray(1e-3 * heights, float))
    speed, slopes = jax.value_and_grad(nonlinear_critical_speed)(vehicle)
    able, along = jax.value_and_grad(steering)(vehicle)
    return Wheel(heights, vehicle, float(speed), 1e-3 * _chained(slopes, rates), 1e3 * float(able), _chained(along, rates))


def _chained(slopes: Any, rates: Any) -> Float[np.ndarray, "heights"]:
    """Slopes by a vehicle's numbers and these by the heights, together."""
    pairs = zip(jax.tree.leaves(rates), jax.tree.leaves(slopes), strict=True)
    return np.asarray(sum(np.tensordot(rate, slope, np.ndim(slope)) for rate, slope in pairs))


def holds(vehicle: Vehicle, speed: float) -> bool:
    """Whether large disturbances die out a little below a critical speed (m/s): a search for folds can miss one.

    A wheel without conicity in the middle wanders there for a minute, with waves of seconds, before it rests: what must shrink is the motion,
    however small it has become.
    """
    run = partial(simulate, vehicle, BELOW * speed, duration=DURATION, dt=5e-4, sample=1e-2, record=("wheelset_y",))
    for disturbance in DISTURBANCES:
        found = run(initial={"wheelset_y": np.array(disturbance)})
        _, middle, late = (np.ptp(third, axis=0).max() for third in np.array_split(np.asarray(found["wheelset_y"]), 3))
        if not found.ok or late > max(0.5 * middle, DIED_OUT):
            return False
    return True


def climbed(made: Any, first: Wheel, steps: int) -> tuple[Wheel, list[Wheel]]:
    """The wheel after so many steps, and all that counted: each is a linear programme of both tangents within a reach that follows success.

    Args:
        made: from `with_rates`
        first: the wheel to begin with
        steps: most tried, their number
    """
    from scipy.optimize import linprog

    now, reach, taken = first, REACH, [first]
    for _ in range(steps):
        low, high = np.maximum(-reach, -MOST - now.heights), np.minimum(reach, MOST - now.heights)
        spare = [now.steering - first.steering]
        step = linprog(-now.speed_slope, A_ub=-now.steering_slope[None], b_ub=spare, bounds=np.column_stack([low, high]))
        found = None
        if step.status == 0:
            try:
                found = judged(made, now.heights + step.x)
            except NumericalError:
                found = None
        better = found is not None and found.speed > now.speed and found.steering > first.steering - LOST
        if found is not None and better and holds(found.vehicle, found.speed):
            now, reach = found, GROWS * reach
            taken.append(now)
        else:
            reach *= SHRINKS
        if reach < LEAST:
            break
    return now, taken


@study("wheel-profile", "A wheel profile changed by gradients", beyond=True)
def wheel_profile(context: Context) -> Outcome:
    """S1002 changed by six heights: nonlinear critical speed at the same Delta r at 5 mm."""
    wheel = WheelProfile.load("S1002")
    made = with_rates(context.coach, wheel)
    first = judged(made, np.zeros(len(AT)))
    last, taken = climbed(made, first, STEPS)
    at = np.linspace(0.5e-3, 7e-3, 40)
    with figure(1, 3, height=2.9) as (page, axes):
        for k, (name, one) in enumerate((("S1002", first), ("changed", last))):
            other = wheel.changed(AT, 1e-3 * one.heights)
            geometry = contact_geometry(other, "60E1")
            draw = {"label": name, "color": COLOURS[k]}
            axes[0, 0].plot(1e3 * np.asarray(wheel.lateral), 1e3 * np.asarray(other.height - wheel.height), **draw)
            axes[0, 1].plot(1e3 * np.asarray(geometry.y), 1e3 * np.asarray(geometry.delta_r), **draw)
            axes[0, 2].plot(1e3 * at, equivalent_conicity(geometry.y, geometry.delta_r, at), **draw)
        axes[0, 0].set(xlabel="from the tread datum, mm", ylabel="change of the wheel's radius, mm", xlim=(-45, 45))
        axes[0, 1].set(xlabel="lateral displacement, mm", ylabel="r_R - r_L, mm", xlim=(-7, 7), ylim=(-8, 8))
        axes[0, 2].set(xlabel="amplitude, mm", ylabel="equivalent conicity", ylim=(0, 0.6))
        axes[0, 1].legend(loc="lower right")
    quantities = [
        Compared(f"nonlinear critical speed on {name}", "(not in the paper)", None, KMH * one.speed, "km/h", False, None)
        for name, one in (("S1002 and 60E1 1:40", first), ("the changed wheel", last))
    ]
    quantities.append(
        Compared(
            "Delta r at 5 mm, changed less S1002", "(not in the paper)", None, last.steering - first.steering, "mm", False, None
        )
    )
    heights = ", ".join(f"{height:+.2f}" for height in last.heights)
    picture = Picture(
        "wheel-profile",
        "A wheel profile changed by gradients",
        f"The calibrated coach on S1002 and 60E1 1:40 (a prediction: nothing is fitted to profiles): six control heights of the wheel, {heights} mm at {1e3 * AT[0]:.0f} to "
        f"{1e3 * AT[-1]:.0f} mm from the tread datum, by {len(taken) - 1} linear programmes of the tangents of the nonlinear critical speed and of Delta r at 5 mm (steering), both by "
        f"the envelope theorem at the contact points: {KMH * first.speed:.1f} to {KMH * last.speed:.1f} km/h at the same Delta r. Each step counts only if large disturbances die "
        f"out at {BELOW:g} of the speed that it claims. What it finds is a middle of little conicity and a jump of the contact beyond it: it shows what hunting asks of a "
        "wheel, and is none to turn, as wear, contact stress and other rails have no say.",
        "Change of the wheel's radius, rolling radii difference and equivalent conicity, before and after.",
        page,
    )
    assumptions = [f"Wheel profile: heights within {MOST:g} mm, gauge 1435 mm, one new rail; nothing but these two aims."]
    return Outcome(quantities, pictures=[picture], assumptions=assumptions)
