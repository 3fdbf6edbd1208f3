"""The frequency domain: comfort with its gradient in milliseconds, and against the long simulation that it replaces."""

import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

import railjax

SPEED = 200 / 3.6
#: s; the bar for one evaluation with gradient
GRADIENT_LIMIT = 5e-3
#: s of simulation, and the largest difference of the r.m.s.
DURATION, SETTLE, AGREEMENT = 2000.0, 40.0, 0.01


def test_comfort_and_its_gradient(benchmark: Any, note: Callable, coach: railjax.Vehicle) -> None:
    def felt(values: jax.Array) -> jax.Array:
        softer = railjax.replace(coach, secondary__stiffness_y=values[0], secondary__damping_y=values[1])
        return railjax.frequency_response(softer, SPEED, "erri-high").rms("carbody_acceleration", "Wd")

    evaluate, value = jax.jit(jax.value_and_grad(felt)), jax.jit(felt)
    at = jnp.array([coach.secondary.stiffness_y, coach.secondary.damping_y])
    _, slope = jax.block_until_ready(evaluate(at))
    errors = []
    for index in range(2):
        step = 1e-4 * at[index]
        numeric = (value(at.at[index].add(step)) - value(at.at[index].add(-step))) / (2 * step)
        errors.append(abs(float(slope[index] / numeric) - 1.0))
    benchmark.pedantic(lambda: jax.block_until_ready(evaluate(at)), rounds=50, warmup_rounds=5)
    median = benchmark.stats.stats.median
    note(ms=1e3 * median, difference_from_central_differences=max(errors))
    assert max(errors) < 1e-6
    assert median < GRADIENT_LIMIT


def test_rms_against_a_long_simulation(benchmark: Any, note: Callable, coach: railjax.Vehicle) -> None:
    track = railjax.RandomTrack("erri-high", seed=1, length=SPEED * DURATION)
    names = ("carbody_acceleration", "secondary_travel")
    respond = lambda: railjax.frequency_response(coach, SPEED, track, record=names)  # noqa: E731
    response = respond()
    benchmark.pedantic(lambda: jax.block_until_ready(respond()), rounds=3)
    linear = railjax.replace(coach, contact__law="linear")
    start = time.perf_counter()
    run = railjax.simulate(
        linear,
        SPEED,
        track=track,
        duration=DURATION + SETTLE,
        settle=SETTLE,
        sample=1.0,
        record=(),
        reduce=[f"rms:{name}" for name in names],
    )
    jax.block_until_ready(run)
    seconds = time.perf_counter() - start
    differences = [float(jnp.max(jnp.abs(response.rms(name) / run[f"rms:{name}"] - 1.0))) for name in names]
    note(largest_difference=max(differences), simulation_s=seconds, ratio=seconds / benchmark.stats.stats.median)
    assert max(differences) < AGREEMENT
