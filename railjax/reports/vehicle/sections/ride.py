"""The sections of a vehicle's report on its ride: comfort over speed, and passive against semi-active dampers."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ....base.style import COLOURS, figure, legend_above
from ....base.units import KMH
from ....dampers.balance_logic import BalanceLogic
from ....dampers.skyhook import Skyhook
from ....model.damper import HARD, SOFT, Damper
from ....model.kinematics import CARBODY_TO_FLOOR, FLOOR_POINTS, is_one_stage
from ....model.motion import PASSIVE
from ....model.parameters import without_labels
from ....model.track.random import RandomTrack
from ....model.track.spectra import spectrum
from ....model.vehicle import Vehicle
from ....ride.comfort_result import MEAN_SCALE
from ....ride.frequency import Excitation, excitation, frequency_response
from ....ride.spectral_comfort import SpectralComfort, spectral_comfort
from ....ride.vibration import weighted_rms
from ....simulation.simulate import simulate
from ....tuning.forced import step
from ..page import paragraph, table
from ..subject import Absent, Part, Subject, drawn

#: of the linear critical speed (or the usual top speed): the range of the ride's speeds; how many by theory and simulated
RANGE, FINE, COARSE = (0.25, 0.95), 40, 8
#: s; of each simulated ride, and what is left out of it; samples each second
DURATION, SETTLE, RATE = 50.0, 10.0, 200.0
SEED = 1
#: gains of balance logic that are compared
ALPHAS = (0.5, 1.0)
#: least and most damping of skyhook's valve, of the vehicle's own rho_cy: as the paper's controlled damper to its passive one
SKYHOOK = (SOFT / 25e3, HARD / 25e3)


_felt = jax.jit(functools.partial(weighted_rms, sampling_rate=RATE, name="Wd", settle=SETTLE))


def _needs_carbody(subject: Subject, or_one_stage: bool = False) -> None:
    vehicle = subject.vehicle
    # one body on wheelsets is a vehicle, a bogie sprung to a held car body is none
    whole = or_one_stage and is_one_stage(vehicle) and not np.any(vehicle.secondary.stiffness_y)
    if vehicle.carbody.held and not whole:
        raise Absent("The car body is held in this model, so there is no ride to judge.")


@jax.jit
def _theory(vehicle: Vehicle, speeds: Float[Array, "speeds"], waves: Excitation) -> SpectralComfort:
    return spectral_comfort(frequency_response(vehicle, speeds, waves, record=("floor_acceleration",)))


def _speeds(subject: Subject, count: int) -> Float[np.ndarray, "count"]:
    """Evenly spaced, m/s, the report's own among them."""
    speeds = np.linspace(*RANGE, count) * subject.top
    speeds[np.argmin(np.abs(speeds - subject.speed))] = subject.speed
    return np.sort(speeds)


def comfort_over_speed(subject: Subject) -> Part:
    """N_MV, Wz and weighted acceleration of the floor by linear theory."""
    _needs_carbody(subject, or_one_stage=True)
    speeds = _speeds(subject, FINE)
    found = _theory(without_labels(subject.vehicle), jnp.asarray(speeds), excitation(spectrum(subject.spectrum)))
    rms, mean, sperling = (np.asarray(values) for values in found)
    here = int(np.argmin(np.abs(speeds - subject.speed)))
    with figure(rows=2, height=2.7, share_x=True) as (page, axes):
        for place, values in zip(FLOOR_POINTS, mean, strict=True):
            axes[0, 0].plot(speeds * KMH, values, label=place)
        axes[0, 0].set(ylabel="$N_{MV}$, lateral part", ylim=(0.0, None))
        legend_above(axes[0, 0])
        for place, values in zip(FLOOR_POINTS, sperling, strict=True):
            axes[1, 0].plot(speeds * KMH, values, label=place)
        axes[1, 0].set(ylabel="Sperling $W_z$", xlabel="speed, km/h", xlim=(speeds[0] * KMH, speeds[-1] * KMH))
    worst = float(mean[:, here].max())
    if not np.isfinite(worst):
        raise Absent(f"Straight running is unstable at {subject.speed * KMH:.0f} km/h, so there is no stationary ride.")
    word = next(word for bound, word in MEAN_SCALE if worst < bound)
    assumed = subject.vehicle.geometry.carbody_to_floor is None
    floor = f" The floor is taken {CARBODY_TO_FLOOR:g} m below the car body's centre of gravity (assumed)." if assumed else ""
    rows = [
        (place, f"{rms[k, here]:.3f}", f"{mean[k, here]:.2f}", f"{sperling[k, here]:.2f}") for k, place in enumerate(FLOOR_POINTS)
    ]
    said = f"Lateral ride on {subject.spectrum} at {subject.speed * KMH:.0f} km/h, by linear theory (frequency domain, no simulation)."
    body = table(("Place on the floor", "a_w (Wd), m/s²", "N_MV, lateral part", "Sperling Wz"), rows, numbers=(1, 2, 3))
    caption = (
        "Mean comfort of EN 12299 (its lateral part, below the whole) and Sperling's index over speed. Creep is linear and the flange is not touched, so what hunting adds "
        f"near the critical speed is not in it.{floor}"
    )
    alternative = f"Two panels over speed from {speeds[0] * KMH:.0f} to {speeds[-1] * KMH:.0f} km/h: N_MV and Sperling's index at three places of the floor."
    numbers = {
        "track": subject.spectrum,
        "speeds_kmh": (speeds * KMH).tolist(),
        "places": list(FLOOR_POINTS),
        "weighted_rms": rms.tolist(),
        "mean_comfort": mean.tolist(),
        "sperling": sperling.tolist(),
    }
    headline = [(f"ride at {subject.speed * KMH:.0f} km/h", f"N_MV {worst:.2f}", f"{word}, worst place, {subject.spectrum}")]
    return Part(paragraph(said) + body + drawn("comfort", alternative, caption, page), numbers, headline)


def controlled(vehicle: Vehicle) -> dict[str, Damper]:
    """The controlled dampers that are compared, skyhook's valve in proportion to the vehicle's own damping."""
    own = float(vehicle.secondary.damping_y)
    balance = {f"balance logic, α = {alpha:g}": BalanceLogic(alpha) for alpha in ALPHAS}
    return {**balance, "skyhook, on/off": Skyhook(damping_min=SKYHOOK[0] * own, damping_max=SKYHOOK[1] * own)}


def passive_and_semiactive(subject: Subject) -> Part:
    """The same track ridden with the vehicle's own lateral dampers and with controlled ones in their place."""
    _needs_carbody(subject)
    vehicle = subject.vehicle
    own = float(vehicle.secondary.damping_y)
    if vehicle.bogie.held or not own > 0.0:
        raise Absent("The vehicle has no secondary lateral dampers that a controlled one could replace.")
    speeds = _speeds(subject, COARSE)
    track = RandomTrack(subject.spectrum, seed=SEED)
    dampers = {"passive": PASSIVE, **controlled(vehicle)}
    found = {name: _ride(vehicle, speeds, track, damper) for name, damper in dampers.items()}
    here = int(np.argmin(np.abs(speeds - subject.speed)))
    with figure(rows=2, height=2.7, share_x=True) as (page, axes):
        for k, (name, (felt, travel)) in enumerate(found.items()):
            look = {"color": COLOURS[k], "marker": ".", "label": name}
            axes[0, 0].plot(speeds * KMH, felt, **look)
            axes[1, 0].plot(speeds * KMH, 1e3 * travel, **look)
        axes[0, 0].set(ylabel="$a_w$ (Wd), m/s²", ylim=(0.0, None))
        axes[1, 0].set(ylabel="largest travel, mm", xlabel="speed, km/h", ylim=(0.0, None))
        legend_above(axes[0, 0])
    rms = {name: float(felt[here]) for name, (felt, _) in found.items()}
    against = {name: 100.0 * (value / rms["passive"] - 1.0) for name, value in rms.items() if name != "passive"}
    rows = [
        (name, _text(rms[name], ".3f"), _text(against.get(name, np.nan), "+.0f"), _text(1e3 * float(travel[here]), ".1f"))
        for name, (_, travel) in found.items()
    ]
    head = ("Secondary lateral damper", "a_w (Wd), m/s²", "against passive, %", "largest travel, mm")
    said = f"At {subject.speed * KMH:.0f} km/h on {subject.spectrum}, simulated with the nonlinear contact and the sharp, sampled control laws."
    caption = (
        f"Weighted acceleration of the floor (worst place) and largest travel of the secondary suspension, {DURATION - SETTLE:g} s on one realisation of {subject.spectrum} (seed {SEED}) "
        f"at each speed. Balance logic is ideal (no lags, no limit of force); skyhook's valve goes from {1e-3 * SKYHOOK[0] * own:.3g} to {1e-3 * SKYHOOK[1] * own:.3g} kN s/m per damper, "
        "in proportion to the passive one as the paper's. Neither is tuned to this vehicle. Gaps are runs that cannot be used."
    )
    alternative = f"Two panels over speed: weighted acceleration and largest travel for {', '.join(found)}."
    numbers = {
        "track": subject.spectrum,
        "seed": SEED,
        "speeds_kmh": (speeds * KMH).tolist(),
        "weighted_rms": {name: felt.tolist() for name, (felt, _) in found.items()},
        "largest_travel_mm": {name: (1e3 * travel).tolist() for name, (_, travel) in found.items()},
    }
    gains = {name: value for name, value in against.items() if np.isfinite(value)}
    best = min(gains, key=lambda name: gains[name], default="")
    remark = f"weighted acceleration, {best} against passive"
    headline = [(f"semi-active at {subject.speed * KMH:.0f} km/h", f"{gains[best]:+.0f} %", remark)] if best else []
    return Part(paragraph(said) + table(head, rows, (1, 2, 3)) + drawn("dampers", alternative, caption, page), numbers, headline)


def _text(value: float, form: str) -> str:
    """A dash for what is not a number."""
    return format(value, form) if np.isfinite(value) else "-"


def _ride(
    vehicle: Vehicle, speeds: Float[np.ndarray, "speeds"], track: RandomTrack, damper: Damper
) -> tuple[Float[np.ndarray, "speeds"], Float[np.ndarray, "speeds"]]:
    """Weighted acceleration (m/s^2) of the worst place and largest travel (m) at each speed; NaN where the run cannot be used."""
    run = simulate(
        vehicle,
        jnp.asarray(speeds),
        track=track,
        damper=damper,
        duration=DURATION,
        settle=SETTLE,
        dt=step(vehicle, float(speeds[0]), damper),
        sample=1.0 / RATE,
        record=("floor_acceleration",),
        reduce=("peak:secondary_travel",),
    )
    felt = np.asarray(_felt(run["floor_acceleration"])).max(axis=0)
    travel = np.asarray(run["peak:secondary_travel"]).max(axis=0)
    usable = np.asarray(run.ok)
    return np.where(usable, felt, np.nan), np.where(usable, travel, np.nan)
