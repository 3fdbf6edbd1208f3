"""Vehicles on wheel and rail profiles: against the constant conicity, long runs and differences; their cost; bifurcations over gauge.

    python benchmarks/profiles.py --out profiles [--only cones cycles cost derivatives gauge]       # minutes

cones        cones on the arcs of a rail's head beside the constant conicity that they have: critical speeds and limit cycles
cycles       limit cycles of a coach and of the Manchester benchmark's vehicle on S1002 and 60E1 beside what long runs end on
cost         throughput of a batch and time of the nonlinear critical speed, beside those of constant conicity, in turns in one process
derivatives  of both critical speeds by gauge, inclination, difference of the wheels' diameters and control heights of the wheel
gauge        bifurcation diagrams of a bogie over the gauge, with the conicity over amplitude: PATH/gauge.png
"""

import argparse
import dataclasses
import json
import statistics
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import railjax
from railjax.base.style import COLOURS, figure
from railjax.base.units import KMH

LANES, STEPS, ROUNDS = 1024, 2000, 5
GAUGES = (1.430, 1.432, 1.435, 1.437, 1.440)
#: positions of the control heights on the wheel, m
AT = np.array([-20e-3, -12e-3, -4e-3, 4e-3, 12e-3])


def cones() -> dict[str, Any]:
    """Linear critical speeds (m/s) of the coach, and the nonlinear ones; `whole` has what a constant conicity leaves out."""
    coach, found = railjax.load_vehicle("coach"), {}
    for slope in (0.05, 0.1, 0.15):
        cone = railjax.WheelProfile.cone(slope)
        plain, whole = (
            railjax.with_profiles(coach, cone, "60E1", inclination=slope, simplified=simplified) for simplified in (True, False)
        )
        constant = dataclasses.replace(plain, profiles=None)
        linear = [float(railjax.linear_critical_speed(one)) for one in (constant, plain, whole)]
        nonlinear = [float(railjax.nonlinear_critical_speed(one)) for one in (constant, plain)]
        found[f"{slope:g}"] = {
            "linear": linear[1] / linear[0] - 1.0,
            "nonlinear": nonlinear[1] / nonlinear[0] - 1.0,
            "linear, whole": linear[2] / linear[0] - 1.0,
        }
    return found


def cycles() -> dict[str, Any]:
    """Relative differences of the amplitude after 60 s from that of the limit cycle on which the run began."""
    found = {}
    for name in ("coach-s1002", "manchester-1-profiles"):
        vehicle = railjax.load_vehicle(name)
        branch = railjax.hunting_branch(vehicle)
        stable = [cycle for piece in branch.pieces for cycle in piece if cycle.stable and cycle.amplitude > 0.2e-3]
        for cycle in stable[:: max(1, len(stable) // 4)]:
            run = railjax.simulate(
                vehicle, cycle.speed, duration=60.0, sample=2e-3, initial=np.asarray(cycle.state), record=("wheelset_y",)
            )
            last = np.abs(np.asarray(run["wheelset_y"])[-5000:, branch.wheelset]).max()
            key = f"{name} at {cycle.speed * KMH:.1f} km/h, {cycle.amplitude * 1e3:.2f} mm"
            found[key] = float(last / cycle.amplitude - 1.0)
    return found


def cost() -> dict[str, Any]:
    """Ratios to constant conicity: throughput of a batch, with balance logic on a sinusoid and without, and time of a fold."""
    constant, profiled = railjax.load_vehicle("manchester-1"), railjax.load_vehicle("manchester-1-profiles")
    speeds = jnp.linspace(40.0, 70.0, LANES)
    logic = {"damper": railjax.BalanceLogic(jnp.linspace(0.2, 1.0, LANES)), "track": railjax.SinusoidTrack(5e-3, 20.0)}
    found: dict[str, Any] = {}
    for name, more in (("straight track", {}), ("balance logic on a sinusoid", logic)):
        seconds: dict[str, list[float]] = {"constant": [], "profiles": []}
        for turn in range(ROUNDS + 1):
            for key, vehicle in (("constant", constant), ("profiles", profiled)):
                begun = time.process_time()
                run = railjax.simulate(
                    vehicle, speeds, duration=STEPS * 1e-3, initial={"wheelset_y": 5e-3}, record=(),
                    reduce=("rms:carbody_acceleration",), **more,
                )  # fmt: skip
                jax.block_until_ready(run.reductions)
                if turn:
                    seconds[key].append(time.process_time() - begun)
        one, other = (statistics.median(seconds[key]) for key in ("constant", "profiles"))
        found[name] = {"throughput": one / other, "ns a step": 1e9 * other / LANES / STEPS}
    narrow = railjax.with_profiles(constant, gauge=1.43)
    times: dict[str, list[float]] = {"constant": [], "profiles": []}
    for turn in range(ROUNDS + 1):
        for key, vehicle in (("constant", constant), ("profiles", narrow)):
            changed = railjax.replace(vehicle, contact__friction=float(vehicle.contact.friction) * (1.0 + 1e-4 * turn))
            begun = time.process_time()
            railjax.nonlinear_critical(changed)
            if turn:
                times[key].append(time.process_time() - begun)
    one, other = (statistics.median(times[key]) for key in ("constant", "profiles"))
    return found | {"nonlinear critical speed": {"times": other / one, "seconds": other}}


def derivatives() -> dict[str, Any]:
    """Relative differences of automatic derivatives from central differences, by parameter."""
    wheelset, wheel = railjax.load_vehicle("single-wheelset"), railjax.WheelProfile.load("S1002")
    names = ("gauge", "inclination", "difference of radii", *(f"height at {1e3 * at:g} mm" for at in AT))
    steps = np.array([1e-6, 1e-6, 2e-8] + [2e-8] * len(AT))

    def vehicle(x: Any) -> railjax.Vehicle:
        return railjax.with_profiles(
            wheelset, wheel.changed(AT, x[3:]), "60E1", gauge=1.43 + x[0], inclination=1 / 40 + x[1],
            radius=(0.4501 + 0.5 * x[2], 0.4499 - 0.5 * x[2]),
        )  # fmt: skip

    found: dict[str, Any] = {}
    for label, speed in (("linear", railjax.linear_critical_speed), ("nonlinear", railjax.nonlinear_critical_speed)):
        slopes = np.asarray(jax.grad(lambda x, speed=speed: speed(vehicle(x)))(jnp.zeros(len(names))))
        for k, name in enumerate(names):
            ends = [float(speed(vehicle(sign * steps[k] * np.eye(len(names))[k]))) for sign in (1.0, -1.0)]
            found[f"{label}, {name}"] = float(slopes[k] / ((ends[0] - ends[1]) / (2.0 * steps[k])) - 1.0)
    return found


def gauge(out: Path) -> dict[str, Any]:
    """Bifurcation diagrams of Cooperrider's bogie on S1002 and 60E1 1:40, and what the conicity says of them."""
    bogie, found = railjax.load_vehicle("cooperrider-bogie"), {}
    amplitudes = np.linspace(0.25e-3, 6e-3, 47)
    with figure(1, 2, height=3.9) as (page, ((left, right),)):
        for colour, width in zip(COLOURS, GAUGES, strict=False):
            geometry = railjax.contact_geometry("S1002", "60E1", gauge=width)
            label = f"{1e3 * width:.0f} mm"
            conicity = railjax.equivalent_conicity(geometry.y, geometry.delta_r, amplitudes)
            left.plot(1e3 * amplitudes, conicity, color=colour, label=label)
            vehicle = railjax.with_profiles(bogie, gauge=width)
            branch = railjax.hunting_branch(vehicle)
            for piece in branch.pieces:
                speed, amplitude = (np.array(values) for values in zip(*((c.speed, c.amplitude) for c in piece), strict=True))
                stable = np.array([cycle.stable for cycle in piece])
                right.plot(KMH * speed, 1e3 * amplitude, color=colour, linewidth=0.8, linestyle=(0, (2, 2)))
                right.plot(KMH * speed, np.where(stable, 1e3 * amplitude, np.nan), color=colour, label=label)
                label = "_"
            found[f"{1e3 * width:.0f} mm"] = {
                "hopf_kmh": float(branch.hopf.speed) * KMH,
                "criticality": branch.criticality,
                "lowest_fold_kmh": None if branch.fold is None else branch.fold.speed * KMH,
                "conicity_3mm": float(railjax.equivalent_conicity(geometry.y, geometry.delta_r, 3e-3)),
                "nonlinearity_per_mm": float(railjax.nonlinearity_parameter(geometry.y, geometry.delta_r)) / 1e3,
            }
        left.set(xlabel="amplitude (mm)", ylabel="equivalent conicity", ylim=(0, None))
        left.legend(title="gauge")
        right.set(xlabel="speed (km/h)", ylabel="amplitude of the trailing bogie's first wheelset (mm)", ylim=(0, None))
        right.legend(title="gauge; dashed: unstable")
        page.savefig(out / "gauge.png", dpi=150)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("profiles"))
    studies = {"cones": cones, "cycles": cycles, "cost": cost, "derivatives": derivatives, "gauge": gauge}
    parser.add_argument("--only", nargs="+", choices=list(studies), default=list(studies))
    options = parser.parse_args()
    railjax.use_all_cores()
    railjax.use_double_precision()
    options.out.mkdir(parents=True, exist_ok=True)
    results = {}
    for name in options.only:
        study: Any = studies[name]
        results[name] = study(options.out) if name == "gauge" else study()
        print(name, json.dumps(results[name], indent=1), flush=True)
    (options.out / "profiles.json").write_text(json.dumps(results, indent=1))


if __name__ == "__main__":
    main()
