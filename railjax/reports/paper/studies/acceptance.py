"""Running safety of the coach in the manner of UIC 518 / EN 14363 on real tracks over speed, passive and semi-active."""

import jax.numpy as jnp
import numpy as np

from ....base.style import COLOURS, figure
from ....base.units import KMH
from ....model.damper import Damper
from ....model.vehicle import Vehicle
from ....ride.acceptance.assess import acceptance
from ....ride.acceptance.criteria import CRITERIA
from ....ride.acceptance.record import acceptance_channels
from ....simulation.simulate import Simulation, simulate
from ..study import Compared, Context, Outcome, Picture, study
from .comfort import SAMPLE, SPECTRA, SPEEDS, real_track
from .semiactive import paper_dampers

DURATION = 300.0  # s
SHOWN = ("guiding_force_sum", "bogie_safety", "instability_force", "carbody_ride_rms")


def _run(vehicle: Vehicle, spectrum: str, damper: Damper) -> Simulation:
    """At all speeds in one batch; some 500 MB, so none is kept while the next is made."""
    return simulate(
        vehicle,
        jnp.asarray(SPEEDS / KMH),
        track=real_track(spectrum),
        damper=damper,
        duration=DURATION,
        sample=SAMPLE,
        record=acceptance_channels(vehicle),
    )


@study("acceptance", "Running safety on real tracks over speed", beyond=True)
def safety(context: Context) -> Outcome:
    """Quantities of EN 14363 as shares of their limits, and the first speed at which each is exceeded."""
    coach, quantities = context.coach, []
    dampers = {name: damper for name, damper in paper_dampers().items() if name in ("passive", "hybrid damper")}
    with figure(rows=2, columns=len(SHOWN) // 2, height=3.0, share_x=True) as (page, axes):
        for colour, (spectrum, label) in zip(COLOURS, SPECTRA.items(), strict=False):
            for style, (name, damper) in zip(("-", (0, (4, 2))), dampers.items(), strict=False):
                found = acceptance(coach, _run(coach, spectrum, damper)).findings
                for here, key in zip(axes.ravel(), SHOWN, strict=True):
                    share = 100 * found[key].value / found[key].limit
                    here.plot(SPEEDS, share, color=colour, linestyle=style, label=f"{label}, {name}")
                for key, finding in found.items():
                    beyond = SPEEDS[finding.verdict == "exceeded"]
                    first = float(beyond[0]) if len(beyond) else np.nan
                    quantity = f"{CRITERIA[key].name}: first of the speeds at which the limit is exceeded, {label}, {name}"
                    quantities.append(Compared(quantity, "(not in the paper)", None, first, "km/h", False, None))
        for here, key in zip(axes.ravel(), SHOWN, strict=True):
            here.axhline(100.0, color="0.2", linewidth=0.8)
            here.set_title(CRITERIA[key].name, fontsize="medium")
            here.set(xlim=(SPEEDS[0], SPEEDS[-1]), ylim=(0.0, 300.0))
        for here in axes[:, 0]:
            here.set_ylabel("share of the limit, %")
        for here in axes[1]:
            here.set_xlabel("speed, km/h")
        handles, names = axes[0, 0].get_legend_handles_labels()
        page.legend(handles, names, loc="outside upper center", ncols=2)
    caption = (
        f"{DURATION:g} s of straight track at each speed. The instability criterion does not tell hunting from the forced response of a weakly damped hunting mode, which is why "
        "it trips below the fold of the limit cycles (234.2 km/h, fitted). Not a certificate: limits are recalled values of the standards, and Y/Q, vertical quantities and curves "
        "are beyond a lateral model. Predicted."
    )
    return Outcome(
        quantities,
        pictures=[
            Picture(
                "acceptance",
                "Running safety on real tracks over speed",
                caption,
                "Four quantities of EN 14363 as shares of their limits over speed on ERRI low and high, passive and with the hybrid damper.",
                page,
            )
        ],
        assumptions=["Running safety: one realisation of each ERRI spectrum; limits of UIC 518 / EN 14363 as recalled."],
    )
