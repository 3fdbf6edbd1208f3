"""Beyond the paper: what the controlled damper does to hunting, to both critical speeds and to the limit cycles."""

import numpy as np

from ....base.style import COLOURS, figure, legend_above
from ....base.units import KMH
from ....model.damper import Damper, PassiveDamper
from ....model.motion import PASSIVE
from ....simulation.simulate import initial_state
from ....stability.hunting.branch import hunting_branch
from ....tuning.onset import DURATION, LAST, SMALL, amplitudes, onset
from ..study import Compared, Context, Outcome, Picture, Statement, study
from .semiactive import paper_dampers

#: km/h; speeds tried, and how far apart they lie
SPEEDS = np.arange(180.0, 300.1, 2.0)
#: km/h; the large disturbance is the passive coach's limit cycle at this speed
LARGE = 250.0


@study("controlled-hunting", "Hunting with the controlled damper", beyond=True)
def controlled_hunting(context: Context) -> Outcome:
    """Amplitude after a minute from a small and a large disturbance, over speed, for the suspensions of figs. 16-19."""
    coach = context.coach
    dampers: dict[str, Damper] = {"no lateral damper": PassiveDamper(0.0), **paper_dampers()}
    # starts, and an independent computation of the passive coach's onsets
    branch = hunting_branch(coach)
    starts = np.asarray(initial_state(coach, PASSIVE, {"wheelset_y": SMALL})), branch.at(LARGE / KMH).state
    found = {name: [amplitudes(coach, damper, start, SPEEDS / KMH) for start in starts] for name, damper in dampers.items()}
    onsets = {name: [onset(SPEEDS, heights) for heights in both] for name, both in found.items()}
    with figure(rows=2, height=2.9, share_x=True) as (page, axes):
        for row, title in zip(range(2), ("from 0.2 mm", "from hunting"), strict=True):
            for k, (name, both) in enumerate(found.items()):
                axes[row, 0].plot(SPEEDS, both[row] * 1e3, color=COLOURS[k], label=name, marker=".", ms=3)
            axes[row, 0].set(ylabel=f"amplitude after 60 s\n{title}, mm", ylim=(0, None))
        axes[1, 0].set_xlabel("speed, km/h")
        legend_above(axes[0, 0], 3)
    quantities = [
        Compared(f"hunts {kind} disturbance from: {name}", "(not in the paper)", None, speeds[k], "km/h", False, None)
        for name, speeds in onsets.items()
        for k, kind in enumerate(("after a small", "after a large"))
    ]
    passive = onsets["passive"]
    assert branch.fold is not None  # the coach's own
    computed = float(branch.hopf.speed) * KMH, branch.fold.speed * KMH
    step = float(SPEEDS[1] - SPEEDS[0])
    controlled = [speeds for name, speeds in onsets.items() if name not in ("passive", "no lateral damper")]
    statements = [
        Statement(
            "The simulated onsets of the passive coach are its computed critical speeds.",
            "(a check of this study)",
            all(abs(one - other) <= 2.0 * step for one, other in zip(passive, computed, strict=True)),
            f"small disturbance {passive[0]:.0f} against {computed[0]:.1f} km/h, large {passive[1]:.0f} against {computed[1]:.1f} km/h",
        ),
        Statement(
            "The paper's suspension raises comfort without lowering the critical speed.",
            "section 5 (implied: the aim is a higher speed)",
            all(speeds[1] >= passive[1] - step for speeds in controlled),
            "after a large disturbance hunting sets in at "
            + ", ".join(f"{speeds[1]:.0f} km/h ({name})" for name, speeds in onsets.items()),
        ),
    ]
    picture = Picture(
        "controlled-hunting",
        "Hunting with the controlled damper (beyond the paper)",
        f"Largest wheelset displacement in the last {LAST:g} s of {DURATION:g} s on even track, started with all wheelsets at 0.2 mm (only linear "
        f"instability keeps that alive) and from the passive coach's limit cycle at {LARGE:g} km/h. Simulated with the sharp, sampled control laws, for which straight running has "
        "no linearisation: their force is of the order of the motion itself. Predicted, on the calibrated coach.",
        "Two panels of amplitude in mm over speed in km/h for five suspensions.",
        page,
    )
    assumptions = ["Hunting with the controlled damper: gains as for figs. 16-19; 'hunts' means more than 3 mm after a minute."]
    return Outcome(quantities, statements, [picture], assumptions)
