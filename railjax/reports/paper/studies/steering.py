"""Beyond the paper: stability on straight track against wear in a curve, with and without cross bracing between the wheelsets of a bogie."""

import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Float

from ....base.style import COLOURS, figure, legend_above
from ....base.units import KMH
from ....model.parameters import replace
from ....model.vehicle import CrossBracing, Vehicle
from ....tuning import objectives as aim
from ....tuning.pareto import Front, pareto
from ..study import Compared, Context, Outcome, Picture, study

#: m; of the curve, run through at 100 mm of cant and as much deficiency; and the points of a front
RADIUS, POINTS = 500.0, 20
#: m/s; what hunts below is no bogie, and beyond nobody runs (braced, some are stable at all speeds)
SLOWEST, FASTEST = 40.0, 100.0
#: N/m and N s/m per side, within which the bogie is free: primary stiffnesses and yaw damping; N/m and N m/rad of the bracing
BOUNDS = {"primary.stiffness_x": (0.3e6, 20e6), "primary.stiffness_y": (1e6, 20e6), "secondary.damping_x": (0.0, 100e3)}
BRACING = {"cross_bracing.shear_stiffness": (0.0, 20e6), "cross_bracing.bending_stiffness": (0.0, 5e6)}
#: with which the search for the braced front begins
SLIGHT = CrossBracing(shear_stiffness=1e5, bending_stiffness=1e4)
#: percentiles of the plain front's speeds between which the two are compared, and at how many
COMPARED, SPEEDS = (10, 90), 6


def plain_front(vehicle: Vehicle, stability: Any, points: int) -> Front:
    """The least wear at each critical speed over primary stiffnesses and yaw damping.

    Args:
        vehicle: that begins.
        stability: a critical speed.
        points: of the front, their number.
    """
    return pareto(vehicle, BOUNDS, aim.wear(RADIUS), stability, stability >= SLOWEST, points=points)


def braced_front(vehicle: Vehicle, plain: Front, stability: Any, points: int) -> Front:
    """The same with a bracing, from the middle of the front without it, so that the search does not end in worse bogies than those.

    Args:
        vehicle: as there.
        plain: the front without a bracing.
        stability: as there.
        points: of the front, their number.
    """
    middle = {name.replace(".", "__"): float(values[len(values) // 2]) for name, values in plain.parameters.items()}
    start = dataclasses.replace(replace(vehicle, **middle), cross_bracing=SLIGHT)
    return pareto(start, BOUNDS | BRACING, aim.wear(RADIUS), stability, stability >= SLOWEST, points=points)


def moved(plain: Front, braced: Front) -> tuple[Float[np.ndarray, "speeds"], ...]:
    """Speeds (m/s), and the least wear numbers (N) without and with a bracing there; one of no stiffness is none, so that the better counts."""
    low, high = np.percentile(plain.against, COMPARED)
    speeds = np.linspace(low, high, SPEEDS)
    without, tied = (
        np.interp(speeds, front.against[order], front.objective[order])
        for front, order in ((front, np.argsort(front.against)) for front in (plain, braced))
    )
    return speeds, without, np.minimum(without, tied)


@study("steering", "Stability against wear in a curve, with and without cross bracing", beyond=True)
def stability_and_wear(context: Context) -> Outcome:
    """Nonlinear critical speed against wear number, with and without passive radial steering."""
    stability = aim.nonlinear_critical_speed(highest=FASTEST)
    plain = plain_front(context.coach, stability, POINTS)
    braced = braced_front(context.coach, plain, stability, POINTS)
    speeds, without, tied = moved(plain, braced)
    with figure(height=3.8) as (page, axes):
        for k, (name, front) in enumerate((("without bracing", plain), ("with cross bracing", braced))):
            order = np.argsort(front.against)
            axes[0, 0].plot(KMH * front.against[order], front.objective[order], "o-", markersize=3, color=COLOURS[k], label=name)
        axes[0, 0].plot(plain.own[1], KMH * plain.own[0], "kx", label="the coach")
        axes[0, 0].set(xlabel=f"wear number in R {RADIUS:g} m, N", ylabel="nonlinear critical speed, km/h")
        legend_above(axes[0, 0], 3)
    less = 1.0 - tied / without
    quantities = [
        Compared(
            f"wear in R {RADIUS:g} m at {KMH * speed:.0f} km/h, {how}", "(not in the paper)", None, float(wear), "N", False, None
        )
        for at in (0, SPEEDS // 2, SPEEDS - 1)
        for speed, how, wear in ((speeds[at], "unbraced", without[at]), (speeds[at], "braced", tied[at]))
    ]
    picture = Picture(
        "steering",
        "Stability against wear in a curve, with and without cross bracing",
        f"Fronts from {KMH * SLOWEST:.0f} km/h on over k_ox, k_oy and yaw damping, then over shear and bending stiffness of a bracing between the wheelsets of each bogie as well; "
        f"{plain.evaluations + braced.evaluations} evaluations with exact derivatives. Stability: fold of the limit cycles on straight track; wear: Tγ of all "
        f"wheels in R {RADIUS:g} m with 100 mm of cant and of deficiency. At equal critical speeds of {KMH * speeds[0]:.0f} to {KMH * speeds[-1]:.0f} km/h the bracing takes "
        f"{100 * np.min(less):.0f} to {100 * np.max(less):.0f} % off the wear number. Local optima are possible. Predicted, on calibrated values.",
        "Two curves of wear number over nonlinear critical speed, with and without cross bracing.",
        page,
    )
    assumptions = [
        "Steering: bounds 0.3 to 20 MN/m of k_ox, 1 to 20 MN/m of k_oy, 0 to 100 kN s/m of yaw damping per side; bracing up to 20 MN/m and 5 MN m/rad."
    ]
    return Outcome(quantities, pictures=[picture], assumptions=assumptions)
