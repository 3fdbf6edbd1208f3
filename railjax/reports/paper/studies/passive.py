"""Section 2 of the paper with the passive suspension: the linear critical speed, figs. 2-4, the assumed wavelength."""

import jax.numpy as jnp
import numpy as np

from ....base.style import COLOURS, figure, legend_above, mark_paper
from ....base.units import KMH
from ....model.track.shapes import SinusoidTrack
from ....model.vehicle import Vehicle
from ....plots.charts import histories
from ....simulation.simulate import Simulation, simulate
from ....stability.linear_critical import linear_critical, linear_critical_speed
from ....stability.modes import modes, root_locus
from ..study import Compared, Context, Outcome, Picture, Statement, study

#: m; not in the paper. 20 m lies in the band of 3 to 25 m by which alignment is judged (EN 13848, D1)
WAVELENGTH = 20.0
#: m; the smaller of the amplitudes of figs. 16-18, used for figs. 2-4 and 10, which name none
AMPLITUDE = 5e-3
TEST_SPEED = 180 / KMH  # m/s, "the maximal testing speed"
PAPER_LINEAR = 245.6  # km/h

ASSUMED_TRACK = (
    f"Wavelength of the periodic irregularity: {WAVELENGTH:g} m (assumed; the paper gives none; within the 3-25 m band of "
    f"EN 13848). Amplitude for figs. 2-4 and 10: {1e3 * AMPLITUDE:g} mm (assumed; the value of fig. 16)."
)


@study("linear-critical-speed", "Linear critical speed")
def critical_speed(context: Context) -> Outcome:
    """The paper's 245.6 km/h, calibrated and to the letter of Table 1; the modes behind it."""
    ours = linear_critical(context.coach)
    literal = float(linear_critical_speed(context.literal)) * KMH
    coach = context.coach
    weight = float(coach.carbody.mass + 2 * coach.bogie.mass + 4 * coach.wheelset.mass) * 10.0 / 8.0
    quantities = [
        Compared("linear critical speed", "section 2", PAPER_LINEAR, float(ours.speed) * KMH, "km/h", True, 0.1),
        Compared(
            "linear critical speed, Table 1 to the letter",
            "section 2",
            PAPER_LINEAR,
            literal,
            "km/h",
            False,
            0.1,
        ),
        Compared("wheel load from the masses, g = 10 m/s^2", "Table 1", 51250.0, weight, "N", False, 1.0),
        Compared(
            "frequency of the critical mode",
            "(not in the paper)",
            None,
            float(ours.frequency),
            "Hz",
            False,
            None,
        ),
    ]
    at_critical = modes(context.coach, float(ours.speed))
    tracked = root_locus(context.coach, np.linspace(10.0, 300.0, 59) / KMH)
    with figure(height=5.4) as (page, axes):
        mark_paper(axes[0, 0], PAPER_LINEAR, f"paper: linear critical speed {PAPER_LINEAR} km/h", horizontal=False)
        tracked.plot(axes[0, 0], limit=0.55)
        axes[0, 0].set_ylim(-5, 60)
    name = at_critical.names[0]
    picture = Picture(
        "root-locus",
        "Damping of the modes over speed",
        f"Modes of the calibrated coach, tracked by eigenvector overlap. The mode that loses its damping at "
        f"{float(ours.speed) * KMH:.1f} km/h is '{name}', {float(ours.frequency):.2f} Hz. The crossing is fitted, the rest predicted.",
        "Damping ratio in per cent over speed in km/h for the least damped modes; bogie hunting crosses zero at 245.6 km/h.",
        page,
    )
    assumptions = [
        "Calibrated: one guidance factor 12.608 on k_ox and k_oy of Table 1, from the linear critical speed 245.6 km/h; friction "
        "and flange clearance from the fold of the limit cycles. To the letter, Table 1 gives "
        f"{literal:.1f} km/h: its horizontal primary stiffnesses look like those of the coil springs without axle guidance.",
        "Gyroscopic and gravitational-stiffness terms are off: the paper does not state them.",
    ]
    return Outcome(quantities, pictures=[picture], assumptions=assumptions)


def periodic_run(vehicle: Vehicle, **options) -> Simulation:
    """180 km/h over the assumed sinusoidal track: 20 s, of which the first 10 are left out of reductions."""
    track = SinusoidTrack(AMPLITUDE, WAVELENGTH)
    return simulate(vehicle, TEST_SPEED, track=track, duration=20.0, settle=10.0, **options)


@study("figs-2-4", "Figs. 2-4: response to periodic irregularities at 180 km/h")
def periodic_response(context: Context) -> Outcome:
    """Lateral, yaw and roll of car body, leading bogie and leading wheelset."""
    motions = {
        "lateral displacement": (
            {"carbody_y": "car body", "bogie_y": "bogie", "wheelset_y": "wheelset"},
            1e3,
            "mm",
            "fig-2",
        ),
        "yaw": (
            {"carbody_psi": "car body", "bogie_psi": "bogie", "wheelset_psi": "wheelset"},
            1e3,
            "mrad",
            "fig-3",
        ),
        "roll": ({"carbody_phi": "car body", "bogie_phi": "bogie"}, 1e3, "mrad", "fig-4"),
    }
    channels = [channel for names, *_ in motions.values() for channel in names]
    run = periodic_run(context.coach, record=channels, reduce=[f"rms:{channel}" for channel in channels], sample=0.01)
    pictures = []
    for title, (names, scale, unit, slug) in motions.items():
        with figure() as (page, axes):
            histories(axes[0, 0], run, names, scale, f"{title}, {unit}", last=4.0)
        number = slug.replace("fig-", "Fig. ")
        pictures.append(
            Picture(
                slug,
                f"{number}: {title} at 180 km/h",
                f"Leading bogie and wheelset; sinusoidal alignment of {1e3 * AMPLITUDE:g} mm and {WAVELENGTH:g} m (both assumed), "
                "last 4 s of 20 s. Predicted.",
                f"Time histories of the {title} of {', '.join(names.values())} over 4 s.",
                page,
            )
        )

    def rms(channel: str) -> float:
        return float(np.max(np.asarray(run[f"rms:{channel}"])))

    ratio = rms("carbody_y") / rms("wheelset_y")
    numbers = f"r.m.s. of car body, bogie, wheelset: {1e3 * rms('carbody_y'):.2f}, {1e3 * rms('bogie_y'):.2f}, {1e3 * rms('wheelset_y'):.2f} mm"
    claim = "The track's perturbations are slightly felt at the car body, as opposed to bogie and axles where they persist."
    return Outcome(
        statements=[Statement(claim, "section 2, figs. 2-4", ratio < 0.5, numbers)],
        pictures=pictures,
        assumptions=[ASSUMED_TRACK],
    )


@study("wavelength", "Sensitivity to the assumed wavelength", beyond=True)
def wavelength_sensitivity(context: Context) -> Outcome:
    """R.m.s. of the car body's acceleration over the wavelength, 6 to 60 m, which the paper does not give."""
    wavelengths = np.geomspace(6.0, 60.0, 96)
    speeds = {180: COLOURS[0], 220: COLOURS[1], 250: COLOURS[2]}
    # two sizes, because saturation and flange make the response nonlinear in the amplitude
    with figure(rows=2, height=2.9, share_x=True) as (page, axes):
        span = {}
        for row, (channel, label) in enumerate(
            (
                ("carbody_acceleration", "car body acceleration,\nr.m.s., m/s²"),
                ("wheelset_y", "leading wheelset,\nr.m.s., mm"),
            )
        ):
            for kmh, colour in speeds.items():
                for amplitude, style in ((1e-3, "--"), (AMPLITUDE, "-")):
                    run = _sensitivity_run(context.coach, kmh / KMH, amplitude, wavelengths)
                    values = np.asarray(run[f"rms:{channel}"])
                    values = values if values.ndim == 1 else 1e3 * values[0]
                    text = f"{kmh} km/h, {1e3 * amplitude:g} mm"
                    axes[row, 0].semilogx(wavelengths, values, style, color=colour, label=text)
                    span[channel, kmh, amplitude] = values
            axes[row, 0].axvline(WAVELENGTH, color="0.35", linestyle=":", label=f"chosen: {WAVELENGTH:g} m")
            axes[row, 0].set(ylabel=label, ylim=(0, None), xlim=(6, 60))
        legend_above(axes[0, 0], 4)
        ticks = [6, 8, 10, 15, 20, 30, 40, 60]
        axes[1, 0].set_xticks(ticks, [str(tick) for tick in ticks])
        axes[1, 0].minorticks_off()
        axes[1, 0].set_xlabel("wavelength of the alignment, m")
    reference = span["carbody_acceleration", 180, AMPLITUDE]
    low, high = reference.min(), reference.max()
    return Outcome(
        pictures=[
            Picture(
                "wavelength",
                "What the assumed wavelength decides",
                f"The paper gives amplitudes but no wavelength. At 180 km/h and 5 mm the car body's acceleration lies between {low:.2f} and "
                f"{high:.2f} m/s² over 6 to 60 m, so absolute accelerations of figs. 10 and 16-19 rest on this choice. It vanishes where the "
                "bogies, 17.2 m apart, are half a wave apart (34.4, 11.5 and 6.9 m): they then push the car body's centre in opposition. "
                "At 250 km/h straight running is unstable and the coach hunts whatever the track.",
                "Two panels of r.m.s. values over wavelength from 6 to 60 m at 180, 220 and 250 km/h for 1 mm and 5 mm amplitude.",
                page,
            )
        ],
        assumptions=[ASSUMED_TRACK],
    )


def _sensitivity_run(vehicle: Vehicle, speed: float, amplitude: float, wavelengths: np.ndarray) -> Simulation:
    track = SinusoidTrack(amplitude, jnp.asarray(wavelengths))
    reduce = ("rms:carbody_acceleration", "rms:wheelset_y")
    return simulate(vehicle, speed, track=track, duration=30.0, settle=15.0, record=(), sample=0.1, reduce=reduce)
