"""How good can a semi-active secondary damper be? Every law, ideal and as hardware runs it, on tracks that no law was tuned or trained on.

    python benchmarks/semiactive_limits.py --law law.npz --out results      # a law of `railjax train`; without one it trains one

Weighted (Wd) acceleration of the floor, mean of its three points, on ERRI's low and high spectra and on a line whose quality changes from
kilometre to kilometre, at 120 to 240 km/h, several realisations each; largest and r.m.s. secondary travel; onset of hunting; all faults at all
speeds. The bound knows the whole track ahead: the valve's opening over time, by gradients through the ride, within the same device.
"""

import argparse
import dataclasses
import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import optax

import railjax
from railjax.base.fields import matrix
from railjax.dampers.control.device import Device, every_fault, together
from railjax.model.damper import HARD, SOFT, Law, PassiveDamper
from railjax.plots import figure
from railjax.simulation.integrate import Plan, integrated

SPEEDS = np.array([120.0, 160.0, 200.0, 240.0])  # km/h
LINES = ("erri-low", "erri-high", "changing")
RATE, SETTLE, DURATION = 100.0, 4.0, 24.0
#: Hz, of the points between which the bound's openings are straight; s; steps of Adam
POINTS, BOUND_DURATION, BOUND_STEPS = 25.0, 14.0, 120


def tracks(line: str, seeds: range) -> railjax.RandomTrack | railjax.MeasuredTrack:
    """Realisations that training never sees (its own have seeds below 2000), as lanes."""
    if line != "changing":
        return railjax.RandomTrack(line, seed=seeds, length=2000.0)
    # ERRI's high spectrum with a slowly changing factor of 0.4 to 1.6 and welded joints every 20 m: as lines are measured
    distance = np.arange(0.0, 2000.0, 0.25)
    columns = []
    for seed in seeds:
        rough = np.asarray(railjax.alignment(railjax.RandomTrack("erri-high", seed=seed + 500, length=2000.0), distance))
        factor = 1.0 + 0.6 * np.sin(2 * np.pi * distance / 700.0 + seed)
        joints = 0.8e-3 * np.exp(-((((distance + 10.0) % 20.0 - 10.0) / 1.0) ** 2))
        columns.append(factor * rough + joints - joints.mean())
    made = [railjax.MeasuredTrack(distance, column) for column in columns]
    return jax.tree.map(lambda *leaves: np.stack([np.asarray(leaf) for leaf in leaves], axis=-1), *made)


def lanes_of(track: Any, count: int, speeds: np.ndarray) -> tuple[Any, np.ndarray]:
    """Every track at every speed (km/h), as lanes, and the speeds in m/s."""
    which = np.repeat(np.arange(count), len(speeds))

    def picked(leaf: Any) -> Any:
        leaf = np.asarray(leaf)
        return leaf[..., which] if leaf.ndim and leaf.shape[-1] == count else leaf

    return jax.tree.map(picked, track), np.tile(speeds, count) / 3.6


def classical(coach: Any, device: Device) -> dict[str, Any]:
    """The laws, ideal and as they are sensed and run on the device."""
    sky, add, mixed = railjax.Skyhook(damping=2 * HARD), railjax.ADD(), railjax.MixedSkyhookADD()
    balance = railjax.BalanceLogic(1.0, damping_min=SOFT, force_limit=5e3)
    lqr = railjax.ClippedLQR.design(coach, 200 / 3.6, damping_min=SOFT)
    filtered = railjax.KalmanFilter.design(coach, 200 / 3.6, railjax.Sensors.typical())
    ideal = {
        "skyhook, on/off": railjax.Skyhook(),
        "skyhook": sky,
        "ADD": add,
        "mixed SH-ADD": mixed,
        "balance logic": balance,
        "clipped LQR": lqr,
    }
    found: dict[str, Any] = {
        "passive": PassiveDamper(),
        "passive, soft": PassiveDamper.soft(),
        "balance logic, unlimited": railjax.BalanceLogic(1.0),
    }
    for name, law in ideal.items():
        found[f"{name}, ideal"] = law
        estimator = {"estimator": filtered} if name == "clipped LQR" else {}
        found[f"{name}, sensed"] = railjax.Controller(law, device=device, **estimator)
    for factor in (0.5, 2.0, 4.0):
        found[f"skyhook {factor:g} times, sensed"] = railjax.Controller(
            wraps=railjax.Skyhook(damping=2 * HARD * factor), device=device
        )
    found["skyhook, Kalman"] = railjax.Controller(sky, estimator=filtered, device=device)
    return found


def ridden(
    coach: Any, law: Any, lines: dict[str, tuple[Any, np.ndarray]], duration: float = DURATION
) -> dict[str, dict[str, np.ndarray]]:
    """Of each line: weighted acceleration (m/s^2), r.m.s. and largest travel (m), per lane."""
    found = {}
    for line, (track, speed) in lines.items():
        run = railjax.simulate(
            coach, speed, track=track, damper=law, duration=duration, settle=SETTLE, sample=1.0 / RATE,
            record=("floor_acceleration",), reduce=("rms:secondary_travel", "peak:secondary_travel", "rms:guiding_force"),
        )  # fmt: skip
        ok = np.asarray(run.ok)
        weighted = np.asarray(railjax.weighted_rms(run["floor_acceleration"], RATE, "Wd", settle=SETTLE))
        values = {
            "comfort": np.sqrt(np.mean(weighted**2, axis=0)),
            "travel": np.sqrt(np.mean(np.asarray(run["rms:secondary_travel"]) ** 2, axis=0)),
            "largest travel": np.asarray(run["peak:secondary_travel"]).max(axis=0),
            "guiding force": np.sqrt(np.mean(np.asarray(run["rms:guiding_force"]) ** 2, axis=0)),
        }
        found[line] = {name: np.where(ok, value, np.nan) for name, value in values.items()}
    return found


def families(coach: Any, device: Device) -> dict[str, Any]:
    """Sensed classical laws with their gains and their estimators' drift varied: what is tuned of them by hand."""
    found = {}
    for drift in (0.08, 0.1, 0.13, 0.16, 0.2):
        by = railjax.ComplementaryFilter(drift=drift)
        for gain in (5e4, 7e4, 1e5, 1.5e5):
            found[f"skyhook {gain:g} N s/m, drift {drift:g} Hz"] = railjax.Controller(
                railjax.Skyhook(damping=gain), device=device, estimator=by
            )
        for crossover in (0.75, 1.0, 1.5, 2.0):
            found[f"mixed SH-ADD {crossover:g} Hz, drift {drift:g} Hz"] = railjax.Controller(
                railjax.MixedSkyhookADD(crossover=2.0 * np.pi * crossover), device=device, estimator=by
            )
    for speed in (200.0, 240.0):
        by = railjax.KalmanFilter.design(coach, speed / 3.6, railjax.Sensors.typical())
        for gain in (5e4, 7e4, 1e5, 1.5e5):
            found[f"skyhook {gain:g} N s/m, Kalman filter of {speed:g} km/h"] = railjax.Controller(
                railjax.Skyhook(damping=gain), device=device, estimator=by
            )
    return found


def at_equal_travel(coach: Any, device: Device, law: Any, lines: dict[str, tuple[Any, np.ndarray]]) -> dict[str, Any]:
    """The least acceleration of classical laws over their travel, and a law's beside that of the same travel on the line through them.

    Acceleration and travel are r.m.s. over all rides of ratios to those of skyhook with 100 kN s/m, so that all rides count alike.
    """

    def ratios(of: Any, base: Any) -> tuple[float, float]:
        both = [np.concatenate([(of[line][name] / base[line][name]) ** 2 for line in lines]) for name in ("travel", "comfort")]
        return float(np.sqrt(both[0].mean())), float(np.sqrt(both[1].mean()))

    base = ridden(coach, railjax.Controller(railjax.Skyhook(damping=1e5), device=device), lines)
    found = {name: ratios(ridden(coach, one, lines), base) for name, one in families(coach, device).items()}
    front: list[tuple[float, float, str]] = []
    for name, (travel, comfort) in sorted(found.items(), key=lambda entry: entry[1]):
        if not front or comfort < front[-1][1]:
            front.append((travel, comfort, name))
    travel, comfort = ratios(ridden(coach, law, lines), base)
    # beyond the front's ends nothing is gained by more travel
    equal = float(np.interp(travel, [row[0] for row in front], [row[1] for row in front], left=np.nan))
    return {
        "front": front,
        "all": found,
        "learned": (travel, comfort),
        "classical at its travel": equal,
        "ratio": comfort / equal,
    }


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Planned(Law):
    """A valve whose opening over time is planned: logits at points 1/POINTS s apart, (points, n)."""

    device: Device
    logits: Any = matrix("1", "", "logit of the opening")

    internal_states: ClassVar[int] = 1

    def force(self, vehicle: Any, travel: Any, velocity: Any, internal: Any) -> tuple[Any, Any]:
        """By the device, at the time that is its internal state."""
        along = jnp.clip(internal[0] * POINTS, 0.0, self.logits.shape[0] - 1.001)
        first = jnp.floor(along).astype(jnp.int32)
        low, high = (jnp.take_along_axis(self.logits, (first + k)[None], axis=0)[0] for k in (0, 1))
        opening = jax.nn.sigmoid(low + (along - first) * (high - low))
        return self.device.delivered(opening, velocity), jnp.ones_like(internal)


def bound(coach: Any, device: Device, track: Any, speed: np.ndarray, start: Any) -> dict[str, np.ndarray]:
    """The least weighted acceleration that gradients find over the openings of a ride, lane by lane, from those of a law."""
    device = dataclasses.replace(device, lag=None)
    plan = Plan(round(BOUND_DURATION * RATE), 10, ("floor_acceleration", "secondary_travel"), ())
    begun = railjax.simulate(
        coach,
        speed,
        track=track,
        damper=start,
        duration=BOUND_DURATION,
        sample=1.0 / POINTS,
        record=("damper_force", "secondary_velocity"),
    )
    force, velocity = (np.asarray(begun[name]) for name in ("damper_force", "secondary_velocity"))
    damping = 0.5 * force * velocity / (velocity**2 + 1e-4)
    opening = np.clip((damping - device.damping_min) / (device.damping_max - device.damping_min), 0.02, 0.98)
    logits = jnp.asarray(np.log(opening / (1.0 - opening)))
    x = jnp.zeros((36, len(speed)))
    skip = round(SETTLE * RATE)

    def of(logits: Any) -> tuple[Any, Any]:
        run = integrated(coach, Planned(device, logits), jnp.asarray(speed), track, x, 1e-3, 0.0, plan)
        weighted = railjax.weighted_acceleration(run.records["floor_acceleration"], RATE, "Wd")[skip:]
        comfort = jnp.mean(weighted**2, axis=(0, 1))
        return jnp.sum(jnp.log(comfort)), (
            jnp.sqrt(comfort),
            jnp.sqrt(jnp.mean(run.records["secondary_travel"][skip:] ** 2, axis=(0, 1))),
        )

    optimiser = optax.adam(optax.cosine_decay_schedule(0.3, BOUND_STEPS, 0.05))
    memory = optimiser.init(logits)
    slope = railjax.jit(jax.value_and_grad(of, has_aux=True))
    best, travel = np.full(len(speed), np.inf), np.full(len(speed), np.nan)
    for _ in range(BOUND_STEPS):
        (_, (comfort, stroke)), gradient = slope(logits)
        better = np.asarray(comfort) < best
        best, travel = np.where(better, comfort, best), np.where(better, stroke, travel)
        # a lane's loss is its own: its gradient is scaled to a size that Adam likes whatever the ride
        change, memory = optimiser.update(gradient, memory)
        logits = optax.apply_updates(logits, change)
    return {"comfort": best, "travel": travel, "started": np.asarray(of(jnp.asarray(np.log(opening / (1.0 - opening))))[1][0])}


def onsets(coach: Any, law: Any) -> dict[str, float]:
    """Speeds (km/h) from which the coach hunts after a small and after a large disturbance."""
    from railjax.tuning.onset import amplitudes, disturbances, onset

    speeds = np.arange(222.0, 254.0, 1.0)
    starts = zip(("small", "large"), disturbances(coach), strict=True)
    return {name: onset(speeds, amplitudes(coach, law, start, speeds / 3.6)) for name, start in starts}


def fault_table(coach: Any, law: Any, count: int) -> dict[str, dict[str, float]]:
    """Worst ratio of the weighted acceleration to the sound law's over speeds and tracks, and the largest travel (m), per fault from 2 s on."""
    faults = every_fault(law.sensors.names, 2, 2.0)
    track, speed = lanes_of(tracks("erri-high", range(2000, 2000 + count)), count, SPEEDS)
    rides = len(speed)

    def repeated(leaf: Any) -> Any:
        leaf = np.asarray(leaf)
        return np.tile(leaf, (*(1,) * (leaf.ndim - 1), len(faults))) if leaf.ndim and leaf.shape[-1] == rides else leaf

    failing = jax.tree.map(lambda leaf: np.repeat(leaf, rides, axis=-1), together(faults))
    lines = {"all": (jax.tree.map(repeated, track), np.tile(speed, len(faults)))}
    found = ridden(coach, dataclasses.replace(law, faults=failing), lines, 14.0)["all"]
    comfort, travel = (found[name].reshape(len(faults), rides) for name in ("comfort", "largest travel"))
    return {
        name: {
            "worst": float(np.max(comfort[k] / comfort[0])),
            "mean": float(np.mean(comfort[k] / comfort[0])),
            "travel": float(travel[k].max()),
        }
        for k, name in enumerate(faults)
    }


def main() -> None:
    """Everything, into semiactive_limits.json and .png."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--law", type=Path, help="file of a learned law")
    parser.add_argument("--out", type=Path, default=Path("results"))
    parser.add_argument("--seeds", type=int, default=5, help="realisations of each line")
    parser.add_argument("--only", nargs="*", default=["laws", "front", "bound", "faults", "hunting"])
    parser.add_argument("--names", nargs="*", help="ride with these laws only; what the file has of others stays")
    options = parser.parse_args()
    railjax.use_double_precision()
    railjax.use_all_cores()
    coach = railjax.load_vehicle("coach")
    device, count = Device(), options.seeds
    laws = classical(coach, device)
    if options.law is not None:
        laws["learned"] = railjax.load_law(options.law)
    lines = {line: lanes_of(tracks(line, range(2000, 2000 + count)), count, SPEEDS) for line in LINES}
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / "semiactive_limits.json"
    content = json.loads(path.read_text()) if path.exists() else {}
    if "laws" in options.only:
        content.setdefault("laws", {})
        for name, law in laws.items():
            if options.names and name not in options.names:
                continue
            began = time.perf_counter()
            found = ridden(coach, law, lines)
            content["laws"][name] = {line: {key: value.tolist() for key, value in of.items()} for line, of in found.items()}
            mean = {line: np.asarray(of["comfort"]).reshape(count, -1).mean(axis=0) * 1e3 for line, of in found.items()}
            print(
                f"{name:28s}",
                *(np.round(value, 1) for value in mean.values()),
                f"{time.perf_counter() - began:.0f} s",
                flush=True,
            )
    if "front" in options.only and "learned" in laws:
        of = at_equal_travel(coach, device, laws["learned"], {line: lines[line] for line in LINES[:2]})
        content["front"] = of
        for travel, comfort, name in of["front"]:
            print(f"travel {travel:.3f} acceleration {comfort:.3f} {name}", flush=True)
        travel, comfort = of["learned"]
        print(f"travel {travel:.3f} acceleration {comfort:.3f} learned: {of['ratio']:.3f} of the front's there", flush=True)
    if "bound" in options.only:
        few = min(count, 3)
        content["bound"] = {}
        for line in ("erri-low", "erri-high"):
            track, speed = lanes_of(tracks(line, range(2000, 2000 + few)), few, SPEEDS)
            found = bound(coach, device, jax.tree.map(jnp.asarray, track), speed, railjax.Skyhook(damping=2 * HARD))
            content["bound"][line] = {key: np.asarray(value).tolist() for key, value in found.items()}
            print(
                "bound",
                line,
                {key: np.round(1e3 * value.reshape(few, -1).mean(axis=0), 2) for key, value in found.items()},
                flush=True,
            )
    best = "learned" if "learned" in laws else "skyhook, sensed"
    if "faults" in options.only:
        content["faults"] = {name: fault_table(coach, laws[name], 2) for name in dict.fromkeys(("skyhook, sensed", best))}
        for name, table in content["faults"].items():
            for fault, row in table.items():
                print(
                    f"{name:18s} {fault:44s} worst {row['worst']:.2f} mean {row['mean']:.2f} travel {1e3 * row['travel']:.0f} mm",
                    flush=True,
                )
    if "hunting" in options.only:
        content["hunting"] = {name: onsets(coach, laws[name]) for name in dict.fromkeys(("passive", "skyhook, sensed", best))}
        print(content["hunting"], flush=True)
    path.write_text(json.dumps(content, indent=1) + "\n")
    if "laws" in content:
        drawn(content, count, options.out / "semiactive_limits.png")


def drawn(content: dict[str, Any], count: int, path: Path) -> None:
    """Weighted acceleration over speed, band over realisations, for the laws that matter, and the bound."""
    shown = ("passive", "passive, soft", "skyhook, ideal", "skyhook, sensed", "clipped LQR, sensed", "learned")
    with figure(columns=2, height=3.6) as (page, axes):
        for axis, line in zip(axes[0], ("erri-low", "erri-high"), strict=True):
            for name in shown:
                if name in content["laws"]:
                    values = 1e3 * np.asarray(content["laws"][name][line]["comfort"]).reshape(count, -1)
                    axis.plot(SPEEDS, values.mean(axis=0), "o-", ms=3, label=name)
                    axis.fill_between(SPEEDS, values.min(axis=0), values.max(axis=0), alpha=0.15, lw=0)
            if "bound" in content:
                values = 1e3 * np.asarray(content["bound"][line]["comfort"]).reshape(-1, len(SPEEDS))
                axis.plot(SPEEDS, values.mean(axis=0), "k--", label="bound, whole track known")
            axis.set(xlabel="speed, km/h", ylabel="weighted acceleration Wd of the floor, mm/s²", title=line, ylim=(0, None))
        axes[0, 0].legend(fontsize=7)
        page.savefig(path, dpi=130)


if __name__ == "__main__":
    main()
