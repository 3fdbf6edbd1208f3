"""Time simulation: one run, a batch, a gradient, and the first call of a fresh process."""

import dataclasses
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import rivals

import railjax

SPEED = 50.0  # m/s, 180 km/h
AMPLITUDE, WAVELENGTH = 5e-3, 20.0  # m
DURATION, DT = 10.0, 1e-3  # s
TRACK = railjax.SinusoidTrack(AMPLITUDE, WAVELENGTH)

BATCH, BATCH_DURATION = 1024, 2.0

#: largest difference of railjax and LSODA over the run, as a share of the peak
AGREEMENT = 1e-3
GRADIENT_LIMIT = 6.0
FIRST_CALL_LIMIT = 3.0  # s


def pairs(first: Callable[[], Any], second: Callable[[], Any], repeats: int = 25) -> tuple[float, float, float]:
    """Median times of two compiled functions that take turns, and the median of second/first."""
    taken = []
    for _ in range(repeats):
        start = time.perf_counter()
        jax.block_until_ready(first())
        between = time.perf_counter()
        jax.block_until_ready(second())
        taken.append((between - start, time.perf_counter() - between))
    return (
        statistics.median(one for one, _ in taken),
        statistics.median(two for _, two in taken),
        statistics.median(two / one for one, two in taken),
    )


def test_one_run(benchmark: Any, note: Callable, coach: railjax.Vehicle) -> None:
    def run() -> railjax.Simulation:
        return jax.block_until_ready(railjax.simulate(coach, SPEED, track=TRACK, duration=DURATION, dt=DT))

    ours = run()  # compiles
    start = time.perf_counter()
    theirs = rivals.lsoda_run(SPEED, AMPLITUDE, WAVELENGTH, np.asarray(ours.time))
    rival = time.perf_counter() - start
    benchmark(run)
    median = benchmark.stats.stats.median

    difference = {
        name: float(np.max(np.abs(np.asarray(ours[name]) - values)) / np.max(np.abs(values)))
        for name, values in (("wheelset_y", theirs.wheelset_y), ("carbody_acceleration", theirs.carbody_acceleration))
    }
    note(
        steps_per_s=DURATION / DT / median,
        lsoda_s=rival,
        lsoda_evaluations=theirs.evaluations,
        ratio_to_lsoda=rival / median,
        **{f"difference_of_{name}": value for name, value in difference.items()},
    )
    assert max(difference.values()) < AGREEMENT


def test_batch(benchmark: Any, note: Callable, coach: railjax.Vehicle, tmp_path: Path) -> None:
    speeds = jnp.linspace(40.0, 80.0, BATCH)
    options = {"track": TRACK, "duration": BATCH_DURATION, "dt": DT, "record": (), "reduce": ("rms:carbody_acceleration",)}

    def run() -> railjax.Simulation:
        return jax.block_until_ready(railjax.simulate(coach, speeds, **options))

    result = run()  # compiles
    assert bool(jnp.all(result.ok))
    benchmark.pedantic(run, rounds=7)
    steps = round(BATCH_DURATION / DT)
    rate = BATCH * steps / benchmark.stats.stats.median
    note(runs=BATCH, steps_per_s=rate)
    source = os.environ.get("RAILJAX_C_RIVAL")
    if source and (rival := rivals.c_rate(source, BATCH, steps, tmp_path)):
        note(c_steps_per_s=rival, ratio_to_c=rate / rival)

    # a lane of the batch is the run alone
    alone = railjax.simulate(coach, float(speeds[BATCH // 4]), **options)["rms:carbody_acceleration"]
    assert abs(float(result["rms:carbody_acceleration"][BATCH // 4] / alone) - 1.0) < 1e-9


def test_gradient(benchmark: Any, note: Callable, coach: railjax.Vehicle) -> None:
    # the smooth twins of the contact laws: the same cost, and a derivative everywhere
    smooth = railjax.replace(coach, contact__law="smooth")

    def comfort(parts: tuple) -> jax.Array:
        primary, secondary = parts
        vehicle = dataclasses.replace(smooth, primary=primary, secondary=secondary)
        name = "rms:carbody_acceleration"
        return railjax.simulate(vehicle, SPEED, track=TRACK, duration=DURATION, dt=DT, record=(), reduce=(name,))[name]

    parts = jax.tree.map(jnp.asarray, (smooth.primary, smooth.secondary))
    forward, gradient = railjax.jit(comfort), railjax.jit(jax.value_and_grad(comfort))
    value, slope = jax.block_until_ready(gradient(parts))  # compiles
    jax.block_until_ready(forward(parts))
    benchmark.pedantic(lambda: jax.block_until_ready(gradient(parts)), rounds=15)
    once, _, ratio = pairs(lambda: forward(parts), lambda: gradient(parts))
    recorded = lambda: railjax.simulate(smooth, SPEED, track=TRACK, duration=DURATION, dt=DT)  # noqa: E731
    jax.block_until_ready(recorded())
    plain, _, ratio_to_plain = pairs(recorded, lambda: gradient(parts))

    # against central differences, along a change of all parameters at once
    def moved(share: float) -> float:
        return float(forward(jax.tree.map(lambda leaf: leaf * (1.0 + share), parts)))

    step = 1e-5
    differences = (moved(step) - moved(-step)) / (2 * step)
    along = float(sum(jax.tree.leaves(jax.tree.map(lambda leaf, d: leaf * d, parts, slope))))
    note(
        parameters=len(jax.tree.leaves(parts)),
        forward_s=once,
        ratio_to_forward=ratio,
        simulate_with_records_s=plain,
        ratio_to_simulate_with_records=ratio_to_plain,
        ratio_to_finite_differences_of_all=(len(jax.tree.leaves(parts)) + 1) / ratio,
        difference_from_central_differences=abs(along / differences - 1.0),
    )
    assert abs(float(value) / float(forward(parts)) - 1.0) < 1e-9
    assert abs(along / differences - 1.0) < 1e-4
    assert ratio <= GRADIENT_LIMIT


MAP_LIMIT = 12.0  # s, on two cores


def test_speed_gain_map(benchmark: Any, coach: railjax.Vehicle, note: Callable) -> None:
    """64 speeds and 64 gains of balance logic, 10 s each in steps of 1 ms."""
    from railjax.reports.paper.studies.gain import speed_gain_map

    speed_gain_map(coach)
    rms = benchmark.pedantic(speed_gain_map, args=(coach,), rounds=2)
    assert rms.shape == (64, 64)
    seconds = benchmark.stats.stats.min
    note(seconds=seconds, steps_per_s=4096 * 10_000 / seconds)
    assert seconds <= MAP_LIMIT


FIRST_CALL = """
import time
start = time.perf_counter()
import jax, railjax
imported = time.perf_counter()
railjax.use_double_precision()
coach = railjax.load_vehicle("coach")
jax.block_until_ready(railjax.simulate(coach, 50.0, track=railjax.SinusoidTrack(5e-3, 20.0), duration=10.0))
print(imported - start, time.perf_counter() - imported)
"""


def test_first_call(benchmark: Any, note: Callable) -> None:
    environment = os.environ | {"JAX_ENABLE_COMPILATION_CACHE": "false"}
    imports, calls = [], []

    def fresh() -> None:
        printed = subprocess.run([sys.executable, "-c", FIRST_CALL], env=environment, check=True, stdout=subprocess.PIPE)
        imported, called = map(float, printed.stdout.split())
        imports.append(imported)
        calls.append(called)

    # the benchmark's own time is that of the whole process
    benchmark.pedantic(fresh, rounds=3)
    note(import_s=min(imports), first_call_s=min(calls), slowest_first_call_s=max(calls))
    assert min(calls) < FIRST_CALL_LIMIT
