"""Beyond the paper: its gain tuned over speed, and its trade-off "stiffer is faster but rides worse" as Pareto fronts, with and
without the semi-active damper."""

import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Float

from ....base.style import COLOURS, figure, legend_above
from ....base.units import KMH
from ....dampers.balance_logic import BalanceLogic
from ....model.damper import SOFT, Damper
from ....model.motion import PASSIVE
from ....model.parameters import get_parameter
from ....model.vehicle import Vehicle, YawDamper
from ....tuning import objectives as aim
from ....tuning.gain_schedule import schedule_gain
from ....tuning.pareto import Front, pareto
from ..study import Compared, Context, Outcome, Picture, Statement, study
from .passive import ASSUMED_TRACK

#: km/h; s of a run, and of these before the r.m.s. begins
SPEEDS, DURATION, SETTLE = np.linspace(100.0, 240.0, 15), 12.0, 6.0
#: at α = 2 the mean stiffness of the secondary suspension, 2 k_cy - α k_cy per bogie, is gone
GAINS = (0.0, 1.9)
#: of the front: speed (km/h), points (20 take twice as long), and the factors on the coach's values within which the suspension is free
SPEED, POINTS, FREE = 200.0, 10, (0.5, 2.0)
SUSPENSION = ("primary.stiffness_x", "primary.stiffness_y", "secondary.stiffness_y")
#: N s/m per side; the coach has no yaw dampers: the least is as good as none
YAW_DAMPING = (1e3, 50e3)
#: suspension values that an engineer may choose within these bounds, for tests and benchmarks of eight parameters
EIGHT = {
    "primary.stiffness_x": (1e6, 10e6),
    "primary.stiffness_y": (4e6, 20e6),
    "primary.damping_x": (0.0, 20e3),
    "primary.damping_y": (0.0, 20e3),
    "secondary.stiffness_x": (60e3, 300e3),
    "secondary.stiffness_y": (60e3, 300e3),
    "secondary.damping_y": (5e3, 80e3),
    "secondary.anti_roll_stiffness": (0.0, 2e6),
}
#: of RK4 in half a period of hunting: the fold moves by less than 0.01 km/h against twice as many
STEPS = 100


@study("gain-over-speed", "Balance logic: the best gain over speed", beyond=True)
def gain_over_speed(context: Context) -> Outcome:
    """The best gain at each speed, a schedule and a single gain, by forward-mode gradients of forced runs."""
    found = schedule_gain(
        context.coach, SPEEDS / KMH, bounds=GAINS, degree=min(3, len(SPEEDS) - 1), duration=DURATION, settle=SETTLE
    )
    with figure(rows=2, height=2.8, share_x=True) as (page, axes):
        found.plot(axes[0, 0])
        axes[0, 0].set_xlabel("")
        for label, values, style in (
            ("best gain at each speed", found.rms_best, "o"),
            ("schedule, sharp law", found.rms_sharp, "-"),
            ("best single gain", found.rms_constant, ":"),
            ("passive", found.rms_passive, "-"),
        ):
            axes[1, 0].plot(SPEEDS, values, style, ms=4, label=label)
        axes[1, 0].set(xlabel="speed, km/h", ylabel="r.m.s. of car body\nacceleration, m/s²", ylim=(0, None))
        legend_above(axes[1, 0], 4)
    loss = np.nanmax(found.rms_constant / found.rms_best) - 1.0
    quantities = [Compared("best single gain of balance logic", "(not in the paper)", None, found.constant, "1", False, None)]
    hunts = SPEEDS[~np.isfinite(found.rms_best)]
    left_out = f" From {hunts[0]:.0f} km/h on the coach hunts on this track; no gain is tuned there." if len(hunts) else ""
    picture = Picture(
        "gain-over-speed",
        "Balance logic: the best gain over speed",
        f"R.m.s. of the car body's acceleration on the periodic track (5 mm, 20 m assumed). A single gain costs at most {100 * loss:.1f} % "
        f"against the best at each speed, so a schedule buys little here.{left_out} Smooth law but where stated. Predicted.",
        "Above: best gains, schedule and single gain over speed. Below: r.m.s. acceleration of each over speed.",
        page,
    )
    return Outcome(quantities, pictures=[picture], assumptions=[ASSUMED_TRACK])


def trade_off(vehicle: Vehicle, points: int, against: Any = None) -> dict[str, Front]:
    """Comfort against the nonlinear critical speed with the passive dampers and with balance logic, each with its own free.

    The vehicle gets linear, rigidly held yaw dampers where it has none. The critical speed of the controlled vehicle is the fold of
    the limit cycles under the smooth law, whose widths (5 mm/s, 0.2 mm) are small beside a hunting motion.
    """
    if vehicle.yaw_damper is None:
        vehicle = dataclasses.replace(vehicle, yaw_damper=YawDamper(YAW_DAMPING[0], half_distance=1.35))
    own = {
        path: tuple(factor * float(get_parameter(vehicle, path)) for factor in FREE)
        for path in (*SUSPENSION, "secondary.damping_y")
    }
    shared = {path: own[path] for path in SUSPENSION} | {"yaw_damper.damping": (*YAW_DAMPING, "linear")}
    damping = own["secondary.damping_y"]
    cases: dict[str, tuple[Damper, dict]] = {
        "passive": (PASSIVE, shared | {"secondary.damping_y": damping}),
        "balance logic": (
            BalanceLogic(0.5, damping_min=2.0 * SOFT),
            shared | {"damper.alpha": (0.0, 1.5), "damper.damping_min": (SOFT, damping[1])},
        ),
    }
    comfort, against = aim.comfort(SPEED / KMH), against or aim.nonlinear_critical_speed(STEPS)
    return {
        name: pareto(vehicle, bounds, comfort, against, damper=damper, points=points) for name, (damper, bounds) in cases.items()
    }


@study("trade-off", "Comfort against nonlinear critical speed", beyond=True)
def stiffness_and_comfort(context: Context) -> Outcome:
    """Weighted comfort on a random track against the nonlinear critical speed, with and without control."""
    fronts = trade_off(context.coach, POINTS)
    with figure(height=3.8) as (page, axes):
        for k, (name, front) in enumerate(fronts.items()):
            front.plot(axes[0, 0], name, COLOURS[k])
        legend_above(axes[0, 0], 2)
    passive, controlled = fronts["passive"], fronts["balance logic"]
    ends = "; ".join(
        f"{name}: {front.objective[0]:.4f} m/s² at {front.against[0] * KMH:.1f} km/h to {front.objective[-1]:.4f} m/s² at {front.against[-1] * KMH:.1f} km/h"
        for name, front in fronts.items()
    )
    gains = gains_over(controlled, passive)
    statements = [
        Statement(
            "Stiffer suspensions are faster but ride worse.",
            "section 2 (implied)",
            bool(passive.objective[-1] > 1.05 * passive.objective[0]),
            f"along the front of the passive coach, all else free: {ends}",
        ),
        Statement(
            "The semi-active damper moves the front: at no speed does it ride worse than the passive one.",
            "section 5 (implied)",
            bool(len(gains) and np.all(gains > -1e-3)),
            f"{100 * np.min(gains, initial=1.0):.0f} to {100 * np.max(gains, initial=0.0):.0f} % less weighted acceleration at equal critical speed; {ends}",
        ),
    ]
    picture = Picture(
        "trade-off",
        "Comfort against nonlinear critical speed",
        f"Fronts over k_ox, k_oy, k_cy (each {FREE[0]:g} to {FREE[1]:g} times the coach's), yaw dampers ({YAW_DAMPING[0] / 1e3:g} to {YAW_DAMPING[1] / 1e3:g} kN s/m a side; the coach has "
        f"none) and rho_cy, or α and the least damping of balance logic in its place; {passive.evaluations + controlled.evaluations} evaluations with exact derivatives. "
        f"Comfort: Wd-weighted r.m.s. at {SPEED:g} km/h on ERRI high, linear or statistically linearised; critical speed: the fold of the limit cycles, of the controlled coach "
        "under the smooth twin of its law. Crosses: the coach as it is, and with α 0.5 in place of rho_cy. Primary stiffness and yaw dampers cost next to no comfort on straight "
        "track (curves are not modelled), so a front is level until these stand at their bounds. Local optima are possible. Predicted, on calibrated values.",
        "Two curves of weighted acceleration over nonlinear critical speed, passive and with balance logic.",
        page,
    )
    assumptions = [
        "Trade-off: track ERRI high; the least damping of the controlled damper is at least that of its open valve.",
        "Trade-off: yaw dampers linear, rigidly held, 1.35 m from the middle.",
    ]
    return Outcome(statements=statements, pictures=[picture], assumptions=assumptions)


def gains_over(one: Front, other: Front) -> Float[np.ndarray, "points"]:
    """By what share `one` is lower at those points of `other` that lie within its range; negative where it is higher."""
    order = np.argsort(one.against)
    within = (other.against >= one.against.min()) & (other.against <= one.against.max())
    at = np.interp(other.against[within], one.against[order], one.objective[order])
    return 1.0 - at / other.objective[within]
