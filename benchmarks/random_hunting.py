"""No limit cycle below the reported nonlinear critical speed, and none missed: random vehicles against plain simulation.

python benchmarks/random_hunting.py [vehicles] [seed]

Coaches with yaw dampers that blow off, many of which hunt without a Hopf point. Each is simulated for 60 s from large disturbances at
speeds below the reported nonlinear critical speed, up to the highest where none was found; a motion that is still there counts as hunting.
Prints each vehicle that contradicts what was reported, and exits with 1 if any does.
"""

import dataclasses
import sys

import numpy as np

import railjax
import railjax.stability.linear_critical
from railjax.base.units import KMH

#: shares of the nonlinear critical speed; those of the highest speed where there is none
BELOW, UP_TO = (0.5, 0.7, 0.85, 0.93, 0.97, 0.99, 0.997), (0.25, 0.35, 0.45, 0.55, 0.65, 0.75, 0.85, 0.95)
#: displacement of the wheelsets of each bogie at the start, in clearances
STARTS = ((1.0, 1.0), (1.0, -1.0), (1.3, 0.0), (0.0, 1.3), (0.6, 0.6))
#: s simulated, and of these the last that are looked at; share of the clearance, and of the amplitude before, that is hunting
DURATION, LAST, LARGE, LASTS = 60.0, 10.0, 0.1, 0.98


def drawn_by_lot(rng: np.random.Generator) -> railjax.Vehicle:
    """A coach with some of its parameters, and its yaw dampers, drawn by lot."""
    coach = railjax.load_vehicle("coach")
    between = lambda low, high: float(np.exp(rng.uniform(np.log(low), np.log(high))))  # noqa: E731
    damper = railjax.YawDamper(between(3e5, 2e6), 1.3, between(2e-3, 2e-2), between(3e3, 3e4), between(4e6, 3e7))
    changes = {
        "contact__conicity": between(0.05, 0.35),
        "contact__friction": rng.uniform(0.2, 0.5),
        "contact__flange_clearance": rng.uniform(4e-3, 10e-3),
        "contact__flange_stiffness": between(3e6, 2e7),
        "primary__stiffness_x": between(3e6, 2e7),
        "primary__stiffness_y": between(3e6, 2e7),
        "secondary__damping_y": between(1e4, 6e4),
    }
    return railjax.replace(dataclasses.replace(coach, yaw_damper=damper), **changes)


def hunts(vehicle: railjax.Vehicle, speeds: np.ndarray) -> np.ndarray:
    """Whether it hunts at each speed (m/s), from any of the starts."""
    clearance = float(vehicle.contact.flange_clearance)
    pairs = [(speed, start) for speed in speeds for start in STARTS]
    coordinates = railjax.model.kinematics.labels(vehicle)
    wheelsets = [coordinates.index(f"wheelset_y[{k}]") for k in range(4)]
    initial = np.zeros((railjax.state_matrix(vehicle, 50.0).shape[0], len(pairs)))
    initial[wheelsets] = clearance * np.array([np.repeat(start, 2) for _, start in pairs]).T
    run = railjax.simulate(
        vehicle,
        np.array([speed for speed, _ in pairs]),
        duration=DURATION,
        dt=5e-4,
        initial=initial,
        record=["wheelset_y"],
        sample=5e-3,
    )
    y, time = np.abs(np.asarray(run["wheelset_y"])).max(axis=1), np.asarray(run.time)
    last, before = (y[(time > low) & (time <= low + LAST)].max(axis=0) for low in (DURATION - LAST, DURATION - 2.0 * LAST))
    return ((last > LARGE * clearance) & (last > LASTS * before)).reshape(len(speeds), len(STARTS)).any(axis=1)


def main(vehicles: int = 60, seed: int = 0) -> int:
    railjax.use_double_precision()
    rng = np.random.default_rng(seed)
    wrong, codes, without = 0, dict.fromkeys(railjax.Hunting, 0), 0
    for number in range(vehicles):
        vehicle = drawn_by_lot(rng)
        found = railjax.nonlinear_critical(vehicle)
        code = railjax.Hunting(int(found.code))
        codes[code] += 1
        without += code == railjax.Hunting.OK and not np.isfinite(float(found.linear.speed))
        if code in (railjax.Hunting.OK, railjax.Hunting.SUPERCRITICAL, railjax.Hunting.STABLE):
            stable = code == railjax.Hunting.STABLE
            speeds = (
                railjax.stability.linear_critical.HIGHEST * np.array(UP_TO) if stable else float(found.speed) * np.array(BELOW)
            )
            contradiction = hunts(vehicle, speeds)
        if code in (railjax.Hunting.FAILED, railjax.Hunting.STEP_TOO_LARGE) or contradiction.any():
            wrong += 1
            at = (
                ""
                if code in (railjax.Hunting.FAILED, railjax.Hunting.STEP_TOO_LARGE)
                else f", but hunts at {np.round(speeds[contradiction] * KMH, 1)} km/h"
            )
            print(f"vehicle {number}: {code.name}, {float(found.speed) * KMH:.2f} km/h{at}", flush=True)
    counted = ", ".join(f"{count} {code.name}" for code, count in codes.items() if count)
    print(
        f"{vehicles} vehicles: {counted}; {without} of them hunt without a Hopf point; {wrong} contradicted by simulation or failed"
    )
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main(*(int(argument) for argument in sys.argv[1:])))
