"""Section 2 of the paper, nonlinear stability: figs. 5 and 6, the nonlinear critical speed."""

import time

import numpy as np

from ....base.style import figure, legend_above, mark_paper
from ....base.units import KMH
from ....simulation.simulate import simulate
from ....stability.hunting.branch import hunting_branch
from ....stability.hunting.ramp import speed_ramp
from ..study import Compared, Context, Outcome, Picture, Statement, study
from .passive import PAPER_LINEAR

PAPER_NONLINEAR, PAPER_AMPLITUDE = 234.2, 9.0  # km/h, mm
#: km/h; the diagram's end
HIGHEST = 300.0


@study("figs-5-6", "Figs. 5-6: limit cycles and the bifurcation diagram")
def bifurcation_diagram(context: Context) -> Outcome:
    """The coach's branch of limit cycles, a speed ramp beside it, and the leading axle of the trailing bogie at the limit."""
    coach = context.coach
    started = time.perf_counter()
    branch = hunting_branch(coach, highest_speed=HIGHEST / KMH)
    found = time.perf_counter()
    ramp = speed_ramp(coach, 0.98 * branch.speed.min(), 1.05 * float(branch.hopf.speed))
    ended = time.perf_counter()
    fold = branch.fold
    assert fold is not None  # the coach's own
    with figure(height=4.6) as (page, axes):
        branch.plot(axes[0, 0], ramp)
        points = [PAPER_NONLINEAR, PAPER_LINEAR], [PAPER_AMPLITUDE, 0.0]
        axes[0, 0].plot(*points, "x", color="0.1", ms=8, mew=1.5, zorder=6, clip_on=False, label="paper: (234.2; 9), (245.6; 0)")
        legend_above(axes[0, 0], 3)
    diagram = Picture(
        "fig-6",
        "Fig. 6: bifurcation diagram",
        "Amplitude of the leading wheelset of the trailing bogie. Limit cycles are computed directly (shooting, Newton), their "
        "stability by Floquet multipliers; dots are simulated speed ramps of "
        f"{ramp.rate:g} m/s², independent of them. The two points that the paper gives are fitted; the branch, its stability and "
        f"the limit cycles up to {HIGHEST:g} km/h are predicted. {branch.note}",
        f"Amplitude in mm over speed in km/h: an unstable branch from the Hopf point at {float(branch.hopf.speed) * KMH:.1f} km/h "
        f"back to the fold at {fold.speed * KMH:.1f} km/h and {fold.amplitude * 1e3:.1f} mm, a stable one from there on.",
        page,
    )
    above, below = 1.004 * fold.speed, 0.990 * fold.speed
    cycle = branch.at(above)
    with figure(rows=2, height=2.6, share_x=True) as (page, axes):
        held = []
        for row, speed in zip(axes[:, 0], (above, below), strict=True):
            run = simulate(coach, speed, duration=20.0, initial=cycle.state, record=["wheelset_y"], sample=5e-3)
            y = np.asarray(run["wheelset_y"])[:, branch.wheelset] * 1e3
            row.plot(np.asarray(run.time), y, label=f"{speed * KMH:.1f} km/h", linewidth=0.6)
            mark_paper(row, PAPER_AMPLITUDE, "paper: 9 mm")
            row.set(ylabel="displacement, mm", xlim=(0, 20), ylim=(-11, 11))
            legend_above(row)
            held.append(float(np.max(np.abs(y[-400:]))))
        axes[1, 0].set_xlabel("time, s")
    history = Picture(
        "fig-5",
        "Fig. 5: axle displacement at the stability limit",
        "Leading wheelset of the trailing bogie on even track, started from the same large motion 0.4 % above and 1 % below the "
        "nonlinear critical speed: above, it hunts on; below, it comes to rest. The paper gives no starting values.",
        "Two time histories over 20 s: a steady oscillation of 9 mm above the fold, a decaying one below.",
        page,
    )
    stable = [point for point in branch.points if point.stable and point.amplitude > 0]
    quantities = [
        Compared("nonlinear critical speed (fold)", "section 2", PAPER_NONLINEAR, fold.speed * KMH, "km/h", True, 0.1),
        Compared("amplitude at the fold", "section 2", PAPER_AMPLITUDE, fold.amplitude * 1e3, "mm", True, 0.05),
        Compared("frequency at the fold", "(not in the paper)", None, fold.frequency, "Hz", False, None),
        Compared("ramp down: hunting stops", "(not in the paper)", None, ramp.stops * KMH, "km/h", False, None),
        Compared("ramp up: hunting starts", "(not in the paper)", None, ramp.starts * KMH, "km/h", False, None),
        Compared("time for the diagram, with compilation", "(not in the paper)", None, found - started, "s", False, None),
        Compared("time for the ramp, with compilation", "(not in the paper)", None, ended - found, "s", False, None),
    ]
    statements = [
        Statement(
            "At 245.6 km/h an unstable periodic solution bifurcates subcritically.",
            "section 2, fig. 6",
            branch.criticality == "subcritical" and not any(point.stable for point in branch.pieces[0][1:-1]),
            f"{branch.criticality}; near the Hopf point the speed falls by {-branch.slope_at_hopf * KMH * 1e-3:.3f} km/h per mm (in "
            "proportion to the amplitude, for Vermeulen and Johnson's law has a kink at zero creep)",
        ),
        Statement(
            "At the saddle-node the amplitude equals the rail-wheel clearance.",
            "section 2, fig. 6",
            bool(0.0 <= fold.amplitude - float(coach.contact.flange_clearance) < 0.5e-3),
            f"amplitude {fold.amplitude * 1e3:.2f} mm, clearance {float(coach.contact.flange_clearance) * 1e3:.2f} mm: the flange must be "
            "pressed a little to turn the branch (both fitted)",
        ),
        Statement(
            "Above the fold the stable solution is a limit cycle.",
            "section 2, fig. 6",
            len(stable) > 5 and held[0] > 0.9 * cycle.amplitude * 1e3 and held[1] < 1.0,
            f"stable limit cycles from {min(p.speed for p in stable) * KMH:.1f} to {max(p.speed for p in stable) * KMH:.1f} km/h; a run 0.4 % above "
            f"keeps {held[0]:.2f} mm, one 1 % below decays to {held[1]:.3f} mm in 20 s",
        ),
    ]
    assumptions = [
        f"Orbits see the flange's sharp corner rounded within 0.01 mm; largest error of a trivial Floquet multiplier "
        f"{max(point.floquet.error for point in branch.points):.1e}.",
    ]
    return Outcome(quantities, statements, [history, diagram], assumptions)
