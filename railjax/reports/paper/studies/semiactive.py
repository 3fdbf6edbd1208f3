"""Sections 3 and 5 of the paper, the closed loop: figs. 16-19, and control strategies compared."""

import jax.numpy as jnp
import numpy as np

from ....base.style import figure, legend_above
from ....base.units import KMH
from ....dampers.balance_logic import BalanceLogic
from ....dampers.bouc_wen_damper import COACH_FORCE, BoucWenDamper, HybridDamper
from ....dampers.clipped_lqr import ClippedLQR
from ....dampers.skyhook import ADD, MixedSkyhookADD, Skyhook
from ....model.damper import HARD, SOFT, Damper, PassiveDamper
from ....model.track.shapes import SinusoidTrack
from ....model.vehicle import Vehicle
from ....simulation.simulate import Simulation, simulate
from ..study import Compared, Context, Outcome, Picture, Statement, study
from .passive import PAPER_LINEAR, WAVELENGTH

#: figure, speed in km/h, amplitude in m
CASES = (("fig. 16", 220, 5e-3), ("fig. 17", 220, 10e-3), ("fig. 18", 250, 10e-3))
#: α of eq. (11): the elastic force is balanced whole. The paper gives no value
ALPHA = 1.0
#: ε K of eq. (18), V/m; not in the paper. Full voltage at 22.5 mm
VOLTAGE_GAIN = 100.0
DURATION, SETTLE, SAMPLE = 30.0, 14.0, 5e-3  # s

ASSUMED = [
    f"Figs. 16-19: wavelength {WAVELENGTH:g} m, gain α = {ALPHA:g} of eq. (11) and ε K = {VOLTAGE_GAIN / 1e3:g} V/mm of eq. (18) (all assumed; the paper "
    "gives none of them).",
    "Figs. 16-19: semi-active dampers replace rho_cy (eq. 6, C' has none). Balance logic by its equations: the dampers act while "
    "Δy_c Δy_c' < 0, where the elastic and the damping force are opposed (the prose has it the other way round).",
    f"Bouc-Wen damper: Spencer's 3 kN prototype (recalled), its force times {COACH_FORCE:g} to be 5 kN at 0.1 m/s and full voltage as Table 2's damper; "
    "the coil does not feel the sign that eq. (18) gives its voltage.",
    "Hybrid damper: Table 2's damper behind the pilot of section 4 and the MR device of Table 5, current behind a lag of 5 ms (assumed), force "
    "proportional to it (assumed).",
]


def paper_dampers() -> dict[str, Damper]:
    """The suspensions of figs. 16-19."""
    return {
        "passive": PassiveDamper(),
        "balance logic, ideal": BalanceLogic(ALPHA),
        "Bouc-Wen, voltage law": BoucWenDamper(voltage_gain=VOLTAGE_GAIN),
        "hybrid damper": HybridDamper(ALPHA),
    }


def _runs(vehicle: Vehicle, damper: Damper) -> Simulation:
    """All cases of figs. 16-18 with one damper, in one batch."""
    speeds, amplitudes = (jnp.asarray([case[k] for case in CASES], float) for k in (1, 2))
    return simulate(
        vehicle,
        speeds / KMH,
        track=SinusoidTrack(amplitudes, WAVELENGTH),
        damper=damper,
        duration=DURATION,
        settle=SETTLE,
        sample=SAMPLE,
        record=["carbody_acceleration"],
        reduce=[
            "rms:carbody_acceleration",
            "peak:carbody_acceleration",
            "peak:secondary_travel",
            "peak:damper_force",
            "rms:damper_force",
        ],
    )


def _values(run: Simulation, name: str) -> np.ndarray:
    """A reduction per case; of bogies the larger."""
    values = np.asarray(run[name])
    return values if values.ndim == 1 else values.max(axis=0)


@study("figs-16-19", "Figs. 16-19: car body acceleration, passive and semi-active")
def closed_loop(context: Context) -> Outcome:
    """Time histories, spectra, r.m.s. and peak values of the four suspensions."""
    runs = {name: _runs(context.coach, damper) for name, damper in paper_dampers().items()}
    time = np.asarray(runs["passive"].time)
    last = time >= time[-1] - 3.0
    pictures, quantities, statements = [], [], []
    for case, (source, kmh, amplitude) in enumerate(CASES):
        where = f"{kmh} km/h, {1e3 * amplitude:g} mm"
        with figure(height=3.2) as (page, axes):
            for name, run in runs.items():
                axes[0, 0].plot(time[last], np.asarray(run["carbody_acceleration"])[last, case], label=name)
            axes[0, 0].set(xlabel="time, s", ylabel="car body acceleration, m/s²", xlim=(time[last][0], time[-1]))
            legend_above(axes[0, 0])
        found = {
            how: {name: float(_values(run, f"{how}:carbody_acceleration")[case]) for name, run in runs.items()}
            for how in ("rms", "peak")
        }
        for how, label in (("rms", "r.m.s."), ("peak", "peak")):
            quantities += [
                Compared(f"{label} acceleration at {where}: {name}", source, None, value, "m/s^2", False, None)
                for name, value in found[how].items()
            ]
        less = all(found[how][name] < found[how]["passive"] for how in found for name in list(runs)[1:])
        numbers = "; ".join(
            f"{name}: r.m.s. {found['rms'][name]:.3f}, peak {found['peak'][name]:.3f} m/s²" for name in found["rms"]
        )
        statements.append(
            Statement(
                f"Semi-active control significantly reduces the car body's lateral acceleration at {where}.",
                source,
                less,
                numbers,
            )
        )
        slug = source.replace(". ", "-")
        pictures.append(
            Picture(
                slug,
                f"{source.capitalize()}: car body acceleration at {where}",
                f"Last 3 s of {DURATION:g} s; wavelength {WAVELENGTH:g} m, α = {ALPHA:g} and ε K = {VOLTAGE_GAIN / 1e3:g} V/mm (assumed). "
                + (
                    "Above the linear critical speed the coach hunts with every suspension; the dampers only keep the car body from it. "
                    if kmh > PAPER_LINEAR
                    else ""
                )
                + "Predicted.",
                f"Acceleration over 3 s at {where} for {', '.join(runs)}.",
                page,
            )
        )
    pictures.append(_spectra(runs))
    statements.append(_least_damping(context.coach, runs["hybrid damper"]))
    return Outcome(quantities, statements, pictures, ASSUMED)


def _least_damping(vehicle: Vehicle, controlled: Simulation) -> Statement:
    """F_dmin of eq. (10): the hybrid damper without current against the same with its control."""
    without = _runs(vehicle, HybridDamper(0.0))
    forces = [_values(run, "rms:damper_force") / 1e3 for run in (without, controlled)]
    numbers = "; ".join(
        f"{kmh} km/h, {1e3 * amplitude:g} mm: {least:.2f} against {force:.2f} kN, acceleration {off:.3f} against {on:.3f} m/s²"
        for (_, kmh, amplitude), least, force, off, on in zip(
            CASES, *forces, *(_values(run, "rms:carbody_acceleration") for run in (without, controlled)), strict=True
        )
    )
    return Statement(
        "The hybrid damper's least damping F_dmin is negligible in comparison to the damping forces in semi-active mode.",
        "section 5, eq. (11)",
        bool(np.all(forces[0] < 0.1 * forces[1])),
        f"r.m.s. per bogie without current against controlled: {numbers}; read as: less than a tenth",
    )


def _spectra(runs: dict[str, Simulation]) -> Picture:
    from scipy.signal import welch

    time = np.asarray(runs["passive"].time)
    steady = time >= SETTLE
    with figure(rows=2, height=2.9, share_x=True) as (page, axes):
        for row, case in enumerate((1, 2)):
            _, kmh, amplitude = CASES[case]
            for name, run in runs.items():
                signal = np.asarray(run["carbody_acceleration"])[steady, case]
                frequency, density = welch(signal, fs=1.0 / SAMPLE, nperseg=1024)
                axes[row, 0].semilogy(frequency, density, label=name)
            axes[row, 0].axvline(kmh / KMH / WAVELENGTH, color="0.35", linestyle=":", linewidth=1.0)
            axes[row, 0].set(ylabel=f"{kmh} km/h, {1e3 * amplitude:g} mm:\np.s.d., (m/s²)²/Hz", xlim=(0, 25), ylim=(1e-7, 10))
        legend_above(axes[0, 0])
        axes[1, 0].set_xlabel("frequency, Hz")
    return Picture(
        "fig-19",
        "Fig. 19: spectral density of the car body's acceleration",
        "Welch's method (Hann windows of 5.1 s, steady part of the runs of figs. 17 and 18; the paper does not say which run it shows). Dotted: the track's frequency. "
        "At 250 km/h the second peak, near 6 Hz, is hunting. Switching raises the odd harmonics, and ideal balance logic, whose force jumps when the suspension turns, "
        "lies above the passive suspension between them. Predicted.",
        "Power spectral density over frequency up to 25 Hz at 220 and 250 km/h for the four suspensions.",
        page,
    )


def strategies(vehicle: Vehicle) -> dict[str, Damper]:
    """All suspensions compared; the valve-controlled ones between the controlled damper's shut and open valve."""
    return {
        "passive, Table 1": PassiveDamper(),
        "passive, soft": PassiveDamper.soft(),
        "passive, hard": PassiveDamper.hard(),
        "balance logic, ideal": BalanceLogic(ALPHA),
        "balance logic, lags of 5 ms": BalanceLogic(ALPHA, damping_min=SOFT, force_limit=5e3, sensor_lag=5e-3, actuator_lag=5e-3),
        "Bouc-Wen, voltage law": BoucWenDamper(voltage_gain=VOLTAGE_GAIN),
        "hybrid damper": HybridDamper(ALPHA),
        "hybrid damper, no current": HybridDamper(0.0),
        "skyhook, on/off": Skyhook(),
        "skyhook, continuous": Skyhook(damping=HARD),
        "acceleration-driven": ADD(),
        "mixed skyhook/ADD": MixedSkyhookADD(),
        "clipped LQR": ClippedLQR.design(vehicle, 220.0 / KMH),
    }


@study("strategies", "Control strategies compared", beyond=True)
def compared(context: Context) -> Outcome:
    """R.m.s. and peak acceleration, travel and force of every strategy in the cases of figs. 16-18."""
    runs = {name: _runs(context.coach, damper) for name, damper in strategies(context.coach).items()}
    table = {how: {name: _values(run, how) for name, run in runs.items()} for how in runs["passive, Table 1"].reductions}
    rms, travel = table["rms:carbody_acceleration"], table["peak:secondary_travel"]
    quantities = [
        Compared(f"{label} at {kmh} km/h, {1e3 * amplitude:g} mm: {name}", "(not in the paper)", None, factor * float(values[case]), unit, False, None)
        for how, label, factor, unit in (
            ("rms:carbody_acceleration", "r.m.s. acceleration", 1.0, "m/s^2"),
            ("peak:carbody_acceleration", "peak acceleration", 1.0, "m/s^2"),
            ("peak:secondary_travel", "peak secondary travel", 1e3, "mm"),
            ("peak:damper_force", "peak damper force of a bogie", 1e-3, "kN"),
        )
        for case, (_, kmh, amplitude) in enumerate(CASES)
        if case != 1
        for name, values in table[how].items()
    ]  # fmt: skip
    rows = np.arange(len(runs))
    with figure(columns=2, height=4.6) as (page, axes):
        for k, case in enumerate((0, 2)):
            _, kmh, amplitude = CASES[case]
            label = f"{kmh} km/h, {1e3 * amplitude:g} mm"
            axes[0, 0].barh(rows + 0.2 - 0.4 * k, [rms[name][case] for name in runs], 0.38, label=label)
            axes[0, 1].barh(rows + 0.2 - 0.4 * k, [1e3 * travel[name][case] for name in runs], 0.38, label=label)
        axes[0, 0].set_yticks(rows, list(runs))
        axes[0, 1].set_yticks(rows, [])
        axes[0, 0].set_xlabel("r.m.s. acceleration of the car body, m/s²")
        axes[0, 1].set_xlabel("largest secondary travel, mm")
        for side in axes[0]:
            side.invert_yaxis()
        legend_above(axes[0, 0])
    return Outcome(
        quantities,
        pictures=[
            Picture(
                "strategies",
                "Control strategies compared",
                f"Wavelength {WAVELENGTH:g} m (assumed). Valves between {SOFT / 1e3:.1f} and {HARD / 1e3:g} kN s/m per damper. The clipped LQR knows all states and is designed at 220 km/h. "
                "The least damping decides: laws that can switch off altogether (ideal balance logic, LQR) are nearly twice as good as those that cannot, and these "
                "little better than a soft passive damper on this single wavelength, which misses the car body's own frequency. Predicted.",
                "Bars of r.m.s. acceleration and of largest secondary travel for thirteen suspensions at 220 and 250 km/h.",
                page,
            )
        ],
        assumptions=[
            *ASSUMED,
            "Strategies: parameters as the classes' defaults, not tuned; valve between Table 2's damper and 3/30.31 of it.",
        ],
    )
