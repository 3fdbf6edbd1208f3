"""Tuning by gradient against what users do without: grid, differential evolution, Nelder-Mead, SLSQP with finite differences.

`python benchmarks/tuning_rivals.py [evaluations]` prints one table: evaluations and time until a feasible design is within 1 % (the
suspension) or 0.01 % (the gain) of the objective that `railjax.tune` ends at; rivals give up after 20 000 evaluations or the number given. All
evaluate the same compiled functions; compilation is outside of the times. Those of `tune` include its checks and the sharp laws.
"""

import contextlib
import sys
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import differential_evolution, minimize

import railjax
from railjax import objectives as aim
from railjax.base.compilation import jit as one_kernel
from railjax.reports.paper.studies.tuning import EIGHT
from railjax.tuning.design_space import DesignSpace

MOST_EVALUATIONS = 20_000
#: m/s; of the gain, and of the suspension
SPEED_OF_GAIN, SPEED = 220 / 3.6, 200 / 3.6
#: shares of the objective of `tune`, at which a rival has arrived
NEAR_GAIN, NEAR = 1.0001, 1.01
TRACK, GAIN = railjax.SinusoidTrack(5e-3, 20.0), {"damper.alpha": (0.0, 1.5)}
GAINS = np.linspace(0.0, 1.5, 401)


def tuned_gain(coach: railjax.Vehicle) -> railjax.Tuning:
    """α of balance logic for the least r.m.s. acceleration at 220 km/h."""
    return railjax.tune(coach, GAIN, aim.comfort(SPEED_OF_GAIN, TRACK, weighting=None), damper=railjax.BalanceLogic(0.5))


def grid_of_gains(coach: railjax.Vehicle) -> np.ndarray:
    """r.m.s. of 401 gains as one batch on all cores."""
    smooth, damper = railjax.replace(coach, contact__law="smooth"), railjax.BalanceLogic(jnp.asarray(GAINS), law="smooth")
    run = railjax.simulate(
        smooth, SPEED_OF_GAIN, track=TRACK, damper=damper, duration=12.0, settle=6.0, sample=0.1,
        record=(), reduce=["rms:carbody_acceleration"],
    )  # fmt: skip
    return np.asarray(run["rms:carbody_acceleration"])


def suspension_limits() -> list:
    """Of the eight parameters."""
    return [aim.linear_critical_speed() >= 260 / 3.6, aim.travel(SPEED) <= 0.060]


def tuned_suspension(coach: railjax.Vehicle) -> railjax.Tuning:
    """Eight parameters for comfort at 200 km/h on ERRI high."""
    return railjax.tune(coach, EIGHT, aim.comfort(SPEED), suspension_limits())


class Arrived(Exception):
    """A rival is where we are, or gives up."""


class Rival:
    """Values without derivatives, counted and timed until a feasible one is near the target."""

    def __init__(self, space: DesignSpace, objective: Any, limits: list, target: float, most: int, compiled: Callable) -> None:
        quantities = [objective, *(entry.quantity for entry in limits)]
        self.function = compiled(lambda x: jnp.stack([quantity.value(*space.apply(x)) for quantity in quantities]))
        self.limits, self.target, self.most, self.start = limits, target, most, space.position(space.own)
        self.scale = float(self.function(jnp.asarray(self.start))[0])

    def all(self, x: np.ndarray) -> np.ndarray:
        """Objective and violations, about 1."""
        if self.last is None or not np.array_equal(self.last[0], x):
            values = np.asarray(self.function(jnp.asarray(np.clip(x, 0.0, 1.0))))
            found = np.array(
                [values[0] / self.scale, *(entry.violation(v) for entry, v in zip(self.limits, values[1:], strict=True))]
            )
            found = np.where(np.isfinite(found), found, 10.0)
            self.last, self.count = (x.copy(), found), self.count + 1
            if np.max(found[1:], initial=0.0) <= 1e-4:
                self.best = min(self.best, float(found[0]) * self.scale)
            if self.best <= self.target or self.count >= self.most:
                raise Arrived
        return self.last[1]

    def penalised(self, x: np.ndarray) -> float:
        found = self.all(x)
        return float(found[0] + 10.0 * np.sum(np.maximum(found[1:], 0.0)) + 10.0 * np.sum(np.abs(x - np.clip(x, 0.0, 1.0))))

    def run(self, search: Callable[[], Any]) -> dict[str, Any]:
        self.count, self.best, self.last = 0, np.inf, None
        began = time.perf_counter()
        with contextlib.suppress(Arrived):
            search()
        seconds = time.perf_counter() - began
        return {"evaluations": self.count, "seconds": seconds, "arrived": self.best <= self.target, "best": self.best}

    def all_searches(self) -> dict[str, dict[str, Any]]:
        """What SciPy offers, from the same start."""
        bounds, start = [(0.0, 1.0)] * len(self.start), self.start
        limits = [{"type": "ineq", "fun": lambda x: -self.all(x)[1:]}] if self.limits else []
        searches = {
            "differential evolution": lambda: differential_evolution(
                self.penalised, bounds, rng=1, maxiter=1000, tol=1e-8, polish=False
            ),
            "Nelder-Mead": lambda: minimize(
                self.penalised, start, method="Nelder-Mead", options={"maxfev": self.most, "adaptive": True, "xatol": 1e-6, "fatol": 1e-9}
            ),
            "SLSQP with differences": lambda: minimize(
                lambda x: self.all(x)[0], start, method="SLSQP", bounds=bounds, constraints=limits, options={"maxiter": 200, "ftol": 1e-6}
            ),
        }  # fmt: skip
        return {name: self.run(search) for name, search in searches.items()}


def rivals_of_gain(coach: railjax.Vehicle, target: float, most: int = MOST_EVALUATIONS) -> dict[str, dict[str, Any]]:
    """Each evaluation one run of 12 s, compiled into one kernel."""
    damper = railjax.BalanceLogic(0.5)
    objective = aim.comfort(SPEED_OF_GAIN, TRACK, weighting=None)
    return Rival(DesignSpace.of(coach, damper, GAIN), objective, [], NEAR_GAIN * target, most, one_kernel).all_searches()


def rivals_of_suspension(coach: railjax.Vehicle, target: float, most: int = MOST_EVALUATIONS) -> dict[str, dict[str, Any]]:
    """Objective and constraints in one compiled call."""
    passive = railjax.PassiveDamper()
    limits = [type(entry)(entry.quantity.suited(passive), entry.limit, entry.above) for entry in suspension_limits()]
    space, objective = DesignSpace.of(coach, passive, EIGHT), aim.comfort(SPEED).suited(passive)
    return Rival(space, objective, limits, NEAR * target, most, jax.jit).all_searches()


def timed(function: Callable[[], Any], rounds: int = 3) -> tuple[float, Any]:
    """The median of some rounds after one for compilation, and the result."""
    seconds, result = [], function()
    for _ in range(rounds):
        began = time.perf_counter()
        result = function()
        seconds.append(time.perf_counter() - began)
    return float(np.median(seconds)), result


def main(most: int) -> None:
    railjax.use_double_precision()
    railjax.use_all_cores()
    coach = railjax.load_vehicle("coach")
    rows: list[tuple[str, str, Any, float, float, bool]] = []
    seconds, gain = timed(lambda: tuned_gain(coach))
    rows.append(("gain", "`railjax.tune`", gain.evaluations, seconds, gain.objective, True))
    seconds, rms = timed(lambda: grid_of_gains(coach))
    rows.append(("gain", "grid", len(GAINS), seconds, float(rms.min()), bool(rms.min() <= NEAR_GAIN * gain.objective)))
    found = {"gain": rivals_of_gain(coach, gain.objective, most)}
    at = len(rows)
    seconds, suspension = timed(lambda: tuned_suspension(coach))
    found["suspension"] = rivals_of_suspension(coach, suspension.objective, most)
    for case, results in found.items():
        for name, r in results.items():
            rows.append((case, name, r["evaluations"], r["seconds"], r["best"], r["arrived"]))
    rows.insert(
        at + len(found["gain"]), ("suspension", "`railjax.tune`", suspension.evaluations, seconds, suspension.objective, True)
    )
    print("| tuned | by | evaluations | s | objective, m/s² | arrived |\n| --- | --- | --- | --- | --- | --- |")
    for case, name, count, seconds, best, arrived in rows:
        print(f"| {case} | {name} | {count} | {seconds:.3g} | {best:.5f} | {'yes' if arrived else 'no'} |")
    print(f"\nOf `tune` each evaluation has its derivatives.\n\n{suspension}")
    print(f"  nonlinear critical speed: {float(railjax.nonlinear_critical_speed(suspension.vehicle)) * 3.6:.1f} km/h")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else MOST_EVALUATIONS)
