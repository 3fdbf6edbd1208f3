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

#: m; of the curve, run through at 100 mm of cant and as much deficiency; points of the front, and of those with and without bracing
RADIUS, POINTS, FEW = 500.0, 20, 8
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
    """Nonlinear critical speed against wear number; what passive radial steering does to it by linear critical speeds, as a nonlinear front over
    five parameters takes too long."""
    nonlinear, linear = (of(highest=FASTEST) for of in (aim.nonlinear_critical_speed, aim.linear_critical_speed))
    front = plain_front(context.coach, nonlinear, POINTS)
    plain = plain_front(context.coach, linear, FEW)
    braced = braced_front(context.coach, plain, linear, FEW)
    speeds, without, tied = moved(plain, braced)
    with figure(height=3.8) as (page, axes):
        drawn = (
            ("nonlinear, without bracing", front, "-", 0),
            ("linear, without bracing", plain, "--", 0),
            ("linear, braced", braced, "--", 1),
        )
        for name, one, line, colour in drawn:
            order = np.argsort(one.against)
            wear, speed = one.objective[order], KMH * one.against[order]
            axes[0, 0].plot(wear, speed, line, marker="o", markersize=3, color=COLOURS[colour], label=name)
        axes[0, 0].plot(front.own[0], KMH * front.own[1], "kx", label="the coach")
        axes[0, 0].set(xlabel=f"wear number in R {RADIUS:g} m, N", ylabel="critical speed, km/h", xlim=(0, None))
        legend_above(axes[0, 0], 4)
    less = 1.0 - tied / without
    quantities = [
        Compared(
            f"wear in R {RADIUS:g} m at a linear {KMH * speed:.0f} km/h, {how}",
            "(not in the paper)",
            None,
            float(wear),
            "N",
            False,
            None,
        )
        for at in (0, SPEEDS // 2, SPEEDS - 1)
        for speed, how, wear in ((speeds[at], "unbraced", without[at]), (speeds[at], "braced", tied[at]))
    ]
    picture = Picture(
        "steering",
        "Stability against wear in a curve, with and without cross bracing",
        f"Least wear at each critical speed from {KMH * SLOWEST:.0f} km/h on, over k_ox, k_oy and yaw damping, then over shear and bending stiffness of a bracing "
        f"between the wheelsets of each bogie as well; {front.evaluations + plain.evaluations + braced.evaluations} evaluations with exact derivatives. Nonlinear: fold of the "
        f"limit cycles on straight track. Wear: Tγ of all wheels in R {RADIUS:g} m with 100 mm of cant and of deficiency. At equal linear critical speeds of "
        f"{KMH * speeds[0]:.0f} to {KMH * speeds[-1]:.0f} km/h the bracing takes {100 * np.min(less):.0f} to {100 * np.max(less):.0f} % off the wear number (interpolated between few "
        "points: indicative). Local optima are possible. Predicted, on calibrated values.",
        "Curves of critical speed over wear number, with and without cross bracing.",
        page,
    )
    assumptions = [
        "Steering: bounds 0.3 to 20 MN/m of k_ox, 1 to 20 MN/m of k_oy, 0 to 100 kN s/m of yaw damping per side; bracing up to 20 MN/m and 5 MN m/rad."
    ]
    return Outcome(quantities, pictures=[picture], assumptions=assumptions)
