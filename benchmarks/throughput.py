"""Simulation throughput over the batch size, against C, Numba, Diffrax and SciPy: one table, one figure.

    python benchmarks/throughput.py --out throughput          # minutes; --quick: seconds, small sizes

All contenders take turns within each round, in random order; ratios are medians over the rounds. A step is 1 ms of one
simulation, for adaptive solvers as well. Accuracy: largest relative difference of the r.m.s. acceleration from railjax's in float64.
"""

import argparse
import json
import os
import platform
import random
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import closed_loop
import jax
import jax.numpy as jnp
import numpy as np

import railjax
from railjax.base.style import COLOURS, figure
from railjax.model.kinematics import wheelset_positions
from railjax.model.motion import motion, state_rate

DT = 1e-3  # s
TRACK = railjax.SinusoidTrack(closed_loop.AMPLITUDE, closed_loop.WAVELENGTH)
RMS = "rms:carbody_acceleration"
BATCHES = [4**k for k in range(8)]  # 1 to 16384

#: which the others are compared with, by law
BESIDE = {"sharp": "railjax", "smooth": "railjax, continuous"}

#: (speeds m/s, alphas, steps) -> r.m.s. acceleration, m/s^2
Batch = Callable[[np.ndarray, np.ndarray, int], np.ndarray]


class Contender(NamedTuple):
    name: str
    run: Batch
    law: str = "sharp"  # of the controller: "sharp" is sampled, "smooth" continuous
    largest: int = 16384  # batch
    tolerance: float = 1e-6  # of the r.m.s. acceleration; single precision and other schemes have their own


class Measured(NamedTuple):
    """Seconds of each round, wall and CPU; those of the first call beyond the second; difference from railjax in float64."""

    wall: list[float]
    cpu: list[float]
    compile: float
    difference: float


def railjax_batch(law: str = "sharp", precision: str = "float64") -> Batch:
    """The public batched call."""
    coach = railjax.load_vehicle("coach")

    def run(speeds: np.ndarray, alphas: np.ndarray, steps: int) -> np.ndarray:
        with jax.enable_x64(precision == "float64"):
            return np.asarray(_simulate(coach, jnp.asarray(speeds, precision), jnp.asarray(alphas, precision), law, steps))

    return run


def railjax_vmap(compiled: bool = False) -> Batch:
    """What a user may write instead: `jax.vmap` of a single run, or `jax.jit` of that."""
    coach, known = railjax.load_vehicle("coach"), {}

    def run(speeds: np.ndarray, alphas: np.ndarray, steps: int) -> np.ndarray:
        if steps not in known:
            mapped = jax.vmap(lambda speed, alpha: _simulate(coach, speed, alpha, "sharp", steps))
            known[steps] = jax.jit(mapped) if compiled else mapped
        return np.asarray(known[steps](jnp.asarray(speeds), jnp.asarray(alphas)))

    return run


def _simulate(coach: railjax.Vehicle, speed: jax.Array, alpha: jax.Array, law: str, steps: int) -> jax.Array:
    damper, start = railjax.BalanceLogic(alpha, law=law), {"wheelset_y": closed_loop.OFFSET}
    options = {"track": TRACK, "duration": steps * DT, "dt": DT, "initial": start, "record": (), "reduce": (RMS,)}
    return railjax.simulate(coach, speed, damper=damper, **options)[RMS]


def diffrax_batch(adaptive: bool) -> Batch | None:
    """Diffrax over railjax's own equations of motion: classical RK4 in fixed steps, or Tsit5 with rtol 1e-6; None without it."""
    try:
        import diffrax
    except ImportError:
        return None

    class RungeKutta4(diffrax.AbstractERK):
        tableau = diffrax.ButcherTableau(
            c=np.array([0.5, 0.5, 1.0]),
            b_sol=np.array([1, 2, 2, 1]) / 6,
            b_error=np.zeros(4),
            a_lower=(np.array([0.5]), np.array([0.0, 0.5]), np.array([0.0, 0.0, 1.0])),
        )
        interpolation_cls = diffrax.ThirdOrderHermitePolynomialInterpolation.from_k

        def order(self, terms: object) -> int:
            return 4

    coach = railjax.load_vehicle("coach")

    def rate(t: jax.Array, y: jax.Array, given: tuple) -> jax.Array:
        speed, alpha = given
        eta = TRACK.seen_from(wheelset_positions(coach, jnp.zeros((2, 2))))(speed * t)
        dx = state_rate(coach, motion(coach, railjax.BalanceLogic(alpha, law="smooth"), 1.0 / speed, eta, y[:-1]))
        return jnp.append(dx, dx[17] ** 2)

    def one(speed: jax.Array, alpha: jax.Array, steps: int) -> jax.Array:
        start = jnp.zeros(35).at[9:13].set(closed_loop.OFFSET)
        solver, control = RungeKutta4(), diffrax.ConstantStepSize()
        if adaptive:
            solver, control = diffrax.Tsit5(), diffrax.PIDController(rtol=1e-6, atol=1e-9)
        duration, most = steps * DT, 20 * steps
        found = diffrax.diffeqsolve(
            diffrax.ODETerm(rate), solver, 0.0, duration, DT, start, (speed, alpha), stepsize_controller=control, max_steps=most
        )
        return jnp.sqrt(found.ys[0, -1] / duration)

    batch = jax.jit(jax.vmap(one, (0, 0, None)), static_argnums=2)
    return lambda speeds, alphas, steps: np.asarray(batch(jnp.asarray(speeds), jnp.asarray(alphas), steps))


def contenders() -> list[Contender]:
    """All that can run here; what is missing is said."""
    found = [
        Contender("railjax", railjax_batch()),
        Contender("railjax, continuous", railjax_batch("smooth"), "smooth"),
        Contender("railjax, float32", railjax_batch(precision="float32"), tolerance=1e-2),
        Contender("railjax, jax.vmap", railjax_vmap()),
        Contender("railjax, jax.jit(jax.vmap)", railjax_vmap(compiled=True)),
    ]
    for precision, name in (("float64", "C"), ("float32", "C, float32")):
        if kernel := closed_loop.c_kernel(precision):
            run = lambda v, a, n, kernel=kernel: kernel(v, a, n, DT)  # noqa: E731
            found.append(Contender(name, run, tolerance=1e-6 if precision == "float64" else 1e-2))
    if coach := closed_loop.numba_coach():
        found.append(Contender("Numba", lambda v, a, n: coach[0](v, a, n, DT)))
    if fixed := diffrax_batch(adaptive=False):
        # they integrate the squared acceleration where railjax sums it over the steps: within a share of a step per switching
        found.append(Contender("Diffrax, RK4", fixed, "smooth", largest=1024, tolerance=2e-2))
        found.append(Contender("Diffrax, Tsit5 adaptive", diffrax_batch(adaptive=True), "smooth", largest=1024, tolerance=2e-2))
    missing = {"C", "Numba", "Diffrax, RK4"} - {one.name for one in found}
    if missing:
        print("left out, as gcc, numba or diffrax is missing:", ", ".join(sorted(missing)))
    return found


def lanes(batch: int) -> tuple[np.ndarray, np.ndarray]:
    """Speeds 40 to 80 m/s and gains 0 to 1."""
    return np.linspace(40.0, 80.0, batch), np.linspace(0.0, 1.0, batch)


def measure(rivals: list[Contender], batch: int, steps: int, rounds: int) -> dict[str, Measured]:
    """All contenders in turn on the same lanes, `rounds` times."""
    speeds, alphas = lanes(batch)
    results, rms = {}, {}
    for one in rivals:
        first, second = (_timed(one.run, speeds, alphas, steps) for _ in range(2))
        rms[one.name] = second[2]
        difference = float(np.max(np.abs(rms[one.name] / rms[BESIDE[one.law]] - 1.0)))
        results[one.name] = Measured([], [], max(0.0, first[0] - second[0]), difference)
        assert difference < one.tolerance, f"{one.name}: r.m.s. acceleration is off by {difference:.2g} at batch {batch}"
    order = list(rivals)
    for _ in range(rounds):
        random.shuffle(order)
        for one in order:
            wall, cpu, _ = _timed(one.run, speeds, alphas, steps)
            results[one.name].wall.append(wall)
            results[one.name].cpu.append(cpu)
    return results


def _timed(run: Batch, *arguments: object) -> tuple[float, float, np.ndarray]:
    wall, cpu = time.perf_counter(), time.process_time()
    rms = run(*arguments)
    return time.perf_counter() - wall, time.process_time() - cpu, rms


def ratio(ours: Measured, theirs: Measured, clock: str = "wall") -> float:
    """How many times faster than them we are: the median over the rounds."""
    return statistics.median(b / a for a, b in zip(getattr(ours, clock), getattr(theirs, clock), strict=True))


def against_scipy(batch: int, duration: float, runs: int, numpy_runs: int) -> dict[str, float]:
    """railjax's batch beside SciPy's LSODA in a loop, over Numba and over NumPy; the loop's time is that of a few runs spread over
    the batch, taken in turn with the batch, times its length. Both solve the continuous controller."""
    speeds, alphas = lanes(batch)
    steps, ours = round(duration / DT), railjax_batch("smooth")
    rms = ours(speeds, alphas, steps)
    rates = {"numpy": (closed_loop.numpy_rate, numpy_runs)}
    if coach := closed_loop.numba_coach():
        coach[1](np.zeros(34), 0.0, 50.0, 0.5)
        rates["numba"] = (coach[1], runs)
    figures: dict[str, float] = {}
    for name, (rate, count) in rates.items():
        ratios, differences = [], []
        for chosen in np.linspace(0, batch - 1, count).round().astype(int):
            batch_s = _timed(ours, speeds, alphas, steps)[0]
            start = time.perf_counter()
            found = closed_loop.lsoda(rate, speeds[chosen], alphas[chosen], duration)
            one_s = time.perf_counter() - start
            ratios.append(batch * one_s / batch_s)
            differences.append(abs(closed_loop.rms_of(rate, found, speeds[chosen], alphas[chosen], duration) / rms[chosen] - 1.0))
        figures |= {f"scipy_{name}_run_s": one_s, f"ratio_to_scipy_{name}": statistics.median(ratios)}
        figures[f"scipy_{name}_difference"] = float(max(differences))
    return figures | {"railjax_batch_s": batch_s}


MEMORY = """
import pathlib, resource, sys
sys.path.insert(0, {folder!r})
import throughput
throughput.railjax.use_double_precision()
throughput.railjax.use_all_cores()
if {batch}:
    throughput.railjax_batch()(*throughput.lanes({batch}), {steps})
status = pathlib.Path("/proc/self/status")
if status.exists():  # Linux hands the parent's ru_maxrss on to its children
    print(status.read_text().split("VmHWM:")[1].split()[0])
else:
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


def peak_memory(batch: int, steps: int) -> float:
    """Largest resident set (MiB) of a fresh process that runs one batch, Python, JAX and compilation included; of the imports alone at
    batch 0."""
    code = MEMORY.format(folder=str(Path(__file__).parent), batch=batch, steps=steps)
    printed = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout
    return int(printed.split()[-1]) / (1024.0**2 if sys.platform == "darwin" else 1024.0)


def table(results: dict[int, dict[str, Measured]], steps: dict[int, int]) -> str:
    """A row per contender and batch: Mstep/s (best round), railjax's speed over it, wall and CPU (medians), accuracy, compilation."""
    lines = [
        "| batch | contender | M steps/s | railjax is faster by | by CPU time | difference | compilation, s |",
        "|---:|---|---:|---:|---:|---:|---:|",
    ]
    for batch, row in results.items():
        for name, one in row.items():
            ours = row[BESIDE["smooth" if name.startswith("Diffrax") else "sharp"]]
            rate = batch * steps[batch] / min(one.wall) / 1e6
            lines.append(
                f"| {batch} | {name} | {rate:.3g} | {ratio(ours, one):.2f} | {ratio(ours, one, 'cpu'):.2f} "
                f"| {one.difference:.1e} | {one.compile:.2f} |"
            )
    return "\n".join(lines)


def draw(results: dict[int, dict[str, Measured]], steps: dict[int, int], path: Path) -> None:
    with figure(height=4.6) as (page, axes):
        shown = list(dict.fromkeys(name for row in results.values() for name in row))
        for k, name in enumerate(shown):
            batches = [batch for batch, row in results.items() if name in row]
            rates = [batch * steps[batch] / min(results[batch][name].wall) for batch in batches]
            style = {"linestyle": "--" if "float32" in name else "-", "marker": "os^vDx"[k % 6], "markersize": 4}
            axes[0, 0].loglog(batches, rates, label=name, color=COLOURS[k % len(COLOURS)], **style)
        axes[0, 0].set(xlabel="simulations in the batch", ylabel="steps of 1 ms per second")
        page.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
        page.savefig(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder for table.md, results.json, throughput.png")
    parser.add_argument("--batches", type=int, nargs="*", default=BATCHES)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--work", type=float, default=4e6, help="steps per call, all simulations together")
    parser.add_argument("--only", nargs="*", help="contenders by the beginning of their names")
    parser.add_argument("--quick", action="store_true", help="small sizes: does everything work?")
    options = parser.parse_args()
    if options.quick:
        options.batches, options.rounds, options.work = [1, 64], 2, 2e4
    railjax.use_double_precision()
    railjax.use_all_cores()
    options.out.mkdir(parents=True, exist_ok=True)
    only = tuple(options.only or ("",))
    rivals = [one for one in contenders() if one.name in BESIDE.values() or one.name.startswith(only)]
    steps = {batch: int(min(10_000, max(200, options.work // batch // 10 * 10))) for batch in options.batches}
    results = {}
    for batch in options.batches:
        results[batch] = measure([one for one in rivals if batch <= one.largest], batch, steps[batch], options.rounds)
        print(table({batch: results[batch]}, steps), flush=True)
    small = options.quick
    scipy = against_scipy(*(64, 1.0, 3, 1) if small else (4096, 10.0, 7, 3))
    memory = {batch: peak_memory(batch, steps.get(batch, 0)) for batch in (0, options.batches[0], options.batches[-1])}
    more = [f"{name.replace('_', ' ')}: {value:.4g}" for name, value in scipy.items()]
    more += [f"peak memory of a process at batch {batch}: {value:.0f} MiB" for batch, value in sorted(memory.items())]
    print("\n".join(more))
    (options.out / "table.md").write_text(table(results, steps) + "\n\n" + "\n".join(f"- {line}" for line in more) + "\n")
    draw(results, steps, options.out / "throughput.png")
    context = {
        "jax": jax.__version__,
        "python": platform.python_version(),
        "devices": jax.device_count(),
        "load": os.getloadavg(),
    }
    rows = {batch: {name: one._asdict() for name, one in row.items()} for batch, row in results.items()}
    everything = {"context": context, "steps": steps, "results": rows, "scipy": scipy, "peak_memory_MiB": memory}
    (options.out / "results.json").write_text(json.dumps(everything, indent=1))


if __name__ == "__main__":
    main()
