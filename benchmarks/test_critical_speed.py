"""Linear critical speed: a grid of suspensions as one batch, with its gradient."""

import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import rivals

import railjax

SIDE = 16  # 16 x 16 variants
RIVAL_VARIANTS = 16
AGREEMENT = 1e-6  # relative


def test_grid_with_gradient(benchmark: Any, note: Callable, coach: railjax.Vehicle) -> None:
    scale = np.geomspace(0.5, 2.0, SIDE)
    k_ox, k_oy = (grid.ravel() for grid in np.meshgrid(coach.primary.stiffness_x * scale, coach.primary.stiffness_y * scale))

    def total(k_ox: jax.Array, k_oy: jax.Array) -> tuple[jax.Array, jax.Array]:
        vehicle = railjax.replace(coach, primary__stiffness_x=k_ox, primary__stiffness_y=k_oy)
        speed = railjax.linear_critical(vehicle).speed
        # a variant's speed depends on its own stiffnesses only, so the gradient of the sum holds every variant's
        return jnp.sum(speed), speed

    both = jax.jit(jax.value_and_grad(total, argnums=(0, 1), has_aux=True))
    arguments = jnp.asarray(k_ox), jnp.asarray(k_oy)
    (_, speeds), (by_x, by_y) = jax.block_until_ready(both(*arguments))  # compiles
    benchmark.pedantic(lambda: jax.block_until_ready(both(*arguments)), rounds=3)
    ours = benchmark.stats.stats.median / len(k_ox)

    search = rivals.critical_speed_search()
    chosen = np.linspace(0, len(k_ox) - 1, RIVAL_VARIANTS).round().astype(int)
    search(k_ox[0], k_oy[0])  # LAPACK is loaded
    start = time.perf_counter()
    theirs = np.array([search(k_ox[k], k_oy[k]) for k in chosen])
    rival = (time.perf_counter() - start) / len(chosen)
    difference = float(np.max(np.abs(np.asarray(speeds)[chosen] / theirs - 1.0)))

    # the rival's derivative by central differences: four more searches
    middle, step = chosen[len(chosen) // 2], 1e-3
    x, y = k_ox[middle], k_oy[middle]
    by_hand = (search(x * (1 + step), y) - search(x * (1 - step), y)) / (2 * step * x)
    by_hand_y = (search(x, y * (1 + step)) - search(x, y * (1 - step))) / (2 * step * y)
    gradient = np.array([by_x[middle], by_y[middle]])
    error = float(np.linalg.norm(gradient - [by_hand, by_hand_y]) / np.linalg.norm(gradient))

    note(
        variants=len(k_ox),
        per_variant_with_gradient_s=ours,
        numpy_per_variant_s=rival,
        ratio_to_numpy_value_only=rival / ours,
        ratio_to_numpy_with_central_differences=5 * rival / ours,
        largest_relative_difference=difference,
        gradient_difference=error,
    )
    assert np.all(np.isfinite(speeds))
    assert difference < AGREEMENT
    assert error < 1e-4


NONLINEAR_LIMIT = 60.0  # s for all variants, on two cores


def test_grid_of_nonlinear_critical_speeds(benchmark: Any, note: Callable, coach: railjax.Vehicle) -> None:
    scale = np.geomspace(0.5, 2.0, SIDE)
    k_ox, k_oy = (grid.ravel() for grid in np.meshgrid(coach.primary.stiffness_x * scale, coach.primary.stiffness_y * scale))
    variants = railjax.replace(coach, primary__stiffness_x=jnp.asarray(k_ox), primary__stiffness_y=jnp.asarray(k_oy))

    start = time.perf_counter()
    first = jax.block_until_ready(railjax.nonlinear_critical(variants))
    with_compilation = time.perf_counter() - start
    found = benchmark.pedantic(lambda: jax.block_until_ready(railjax.nonlinear_critical(variants)), rounds=1)
    taken = benchmark.stats.stats.median

    # a lane of the batch is the vehicle alone
    middle = SIDE * SIDE // 2 + SIDE // 2
    alone = railjax.replace(coach, primary__stiffness_x=float(k_ox[middle]), primary__stiffness_y=float(k_oy[middle]))
    difference = abs(float(found.speed[middle] / railjax.nonlinear_critical(alone).speed) - 1.0)
    folds = int(np.sum(np.asarray(found.code) == railjax.Hunting.OK))
    note(
        variants=len(k_ox),
        with_compilation_s=with_compilation,
        per_variant_s=taken / len(k_ox),
        total_s=taken,
        folds=folds,
        difference_to_single=difference,
    )
    assert np.array_equal(np.asarray(first.speed), np.asarray(found.speed), equal_nan=True)
    assert difference < AGREEMENT
    assert folds >= 0.95 * len(k_ox)
    assert taken < NONLINEAR_LIMIT
