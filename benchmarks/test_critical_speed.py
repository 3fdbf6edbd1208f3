"""Critical speeds of a grid of suspensions as one batch: linear with its gradient, and nonlinear."""

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


VARIANTS, SPREAD = 10_000, 1.5  # each suspension parameter within this factor either way
RATIO = 10.0  # at least, to NumPy without gradients


def test_variants_of_the_suspension_with_gradient(benchmark: Any, note: Callable, coach: railjax.Vehicle) -> None:
    paths = [path for path, _ in railjax.parameters() if path.startswith(("primary.", "secondary."))]
    rng = np.random.default_rng(0)
    factors = SPREAD ** rng.uniform(-1.0, 1.0, (len(paths), VARIANTS))
    values = jnp.asarray([float(railjax.get_parameter(coach, path)) for path in paths])[:, None] * factors

    def varied(values: jax.Array) -> railjax.Vehicle:
        vehicle = coach
        for path, value in zip(paths, values, strict=True):
            vehicle = railjax.set_parameter(vehicle, path, value)
        return vehicle

    def total(values: jax.Array) -> tuple[jax.Array, jax.Array]:
        speed = railjax.linear_critical(varied(values)).speed
        return jnp.sum(jnp.where(jnp.isfinite(speed), speed, 0.0)), speed

    both = jax.jit(jax.value_and_grad(total, has_aux=True))
    (_, speeds), slopes = jax.block_until_ready(both(values))  # compiles
    search = rivals.critical_speed_search()
    stiffness = coach.primary.stiffness_x, coach.primary.stiffness_y
    search(*stiffness)  # LAPACK is loaded

    # in turns, so that both see the same machine; what a search takes hardly depends on the variant
    ratios, searches = [], []

    def rival() -> None:
        start = time.perf_counter()
        for _ in range(2 * RIVAL_VARIANTS):
            search(*stiffness)
        searches.append((time.perf_counter() - start) / (2 * RIVAL_VARIANTS))

    for _ in range(3):
        rival()
        start = time.perf_counter()
        jax.block_until_ready(both(values))
        ratios.append(searches[-1] / ((time.perf_counter() - start) / VARIANTS))
    benchmark.pedantic(lambda: jax.block_until_ready(both(values)), rounds=1)

    # the critical eigenvalue by NumPy, and one derivative by differences
    chosen = np.linspace(0, VARIANTS - 1, RIVAL_VARIANTS).round().astype(int)
    few = values[:, chosen]
    largest = np.array(
        [
            np.linalg.eigvals(np.asarray(railjax.state_matrix(varied(one), float(speed)))).real.max()
            for one, speed in zip(np.asarray(few).T, np.asarray(speeds)[chosen], strict=True)
        ]
    )
    row, step = paths.index("primary.stiffness_x"), 1e-4
    up, down = (railjax.linear_critical(varied(few.at[row].multiply(1.0 + s * step))).speed for s in (1, -1))
    numeric = (up - down) / (2 * step * few[row])
    error = float(jnp.max(jnp.abs(numeric - slopes[row, chosen])) / jnp.max(jnp.abs(numeric)))
    note(
        variants=VARIANTS,
        parameters=len(paths),
        per_variant_with_gradient_s=benchmark.stats.stats.median / VARIANTS,
        numpy_per_variant_s=min(searches),
        ratio_to_numpy_value_only=float(np.median(ratios)),
        largest_growth_at_the_crossing=float(np.max(np.abs(largest))),
        gradient_difference=error,
        found=int(np.sum(np.isfinite(speeds))),
    )
    assert np.max(np.abs(largest)) < 1e-6
    assert error < 1e-4
    assert np.median(ratios) >= RATIO


NONLINEAR_LIMIT = 60.0  # s for all variants, on two cores
DWELLS, DWELL = 80, 4.0  # speeds, s at each
LOWEST = 0.8  # of the linear critical speed


def by_simulation(variants: railjax.Vehicle, linear: jax.Array) -> np.ndarray:
    """Speeds (m/s) at which hunting stops when a batch of simulations goes down from 1.02 times the linear critical speed, dwelling
    `DWELL` s at each speed: what one does without continuation. NaN where it goes on."""
    state, first = {"wheelset_y": 9e-3}, None
    stops = np.full(len(linear), np.nan)
    for share in np.linspace(1.02, LOWEST, DWELLS):
        settle = 0.5 * DWELL
        duration = DWELL if first is not None else 5 * DWELL
        options = {"initial": state, "duration": duration, "settle": settle, "record": (), "reduce": ["peak:wheelset_y"]}
        run = railjax.simulate(variants, share * linear, **options)
        amplitude = np.max(np.asarray(run["peak:wheelset_y"]), axis=0)
        first = amplitude if first is None else first
        stops = np.where(np.isnan(stops) & (amplitude < 0.1 * first), share * np.asarray(linear), stops)
        state = run.final
    return stops


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
    folded = np.asarray(found.code) == railjax.Hunting.OK
    folds = int(np.sum(folded))

    linear = railjax.linear_critical(variants).speed
    by_simulation(variants, linear)  # compiles
    start = time.perf_counter()
    stops = by_simulation(variants, linear)
    simulated = time.perf_counter() - start
    late = (np.asarray(found.speed) - stops)[folded & np.isfinite(stops)] * 3.6
    note(
        variants=len(k_ox),
        with_compilation_s=with_compilation,
        simulated_s=simulated,
        ratio_to_simulated=simulated / taken,
        simulated_late_kmh=float(np.median(late)),
        simulated_latest_kmh=float(np.max(late)),
        simulated_to_the_end=int(np.sum(np.isfinite(stops))),
        per_variant_s=taken / len(k_ox),
        total_s=taken,
        folds=folds,
        difference_to_single=difference,
    )
    assert np.array_equal(np.asarray(first.speed), np.asarray(found.speed), equal_nan=True)
    assert difference < AGREEMENT
    assert folds >= 0.95 * len(k_ox)
    # simulation never stops hunting above the fold by more than its own step in speed
    assert np.min(late) > -1.5 * (1.02 - LOWEST) / DWELLS * float(jnp.max(linear)) * 3.6
    assert taken < NONLINEAR_LIMIT
