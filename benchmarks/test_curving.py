"""Ten thousand curves (radius, speed, cant) in steady running with gradients, and beside it SciPy's root on an independent right-hand side."""

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import railjax

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from curve_reference import independent

CURVES = 10_000
LONGEST = 5.0  # s, on two cores
RIVAL_CURVES = 10
AGREEMENT = 1e-9  # m and rad


def test_ten_thousand_curves_with_gradients(benchmark: Any, note: Callable, coach: railjax.Vehicle) -> None:
    rng = np.random.default_rng(0)
    radius, cant, deficiency = rng.uniform(300, 3000, CURVES), rng.uniform(0, 0.16, CURVES), rng.uniform(-0.05, 0.13, CURVES)
    speed = np.sqrt(np.maximum(9.81 * radius * (cant + deficiency) / 1.5, 25.0))

    def total(vehicle: railjax.Vehicle, speed: Any, radius: Any, cant: Any) -> tuple[jax.Array, railjax.SteadyCurving]:
        found = railjax.curving(vehicle, speed, radius=radius, cant=cant)
        return jnp.sum(found.wear_number) + jnp.sum(found.guiding_force[0, 0]), found

    both = jax.value_and_grad(total, argnums=(0, 1, 2, 3), has_aux=True)
    (_, found), slopes = jax.block_until_ready(both(coach, speed, radius, cant))  # compiles
    benchmark.pedantic(lambda: jax.block_until_ready(both(coach, speed, radius, cant)), rounds=3)
    ours = benchmark.stats.stats.median

    start = time.perf_counter()
    theirs = np.array([independent(coach, speed[k], radius[k], cant[k]) for k in range(RIVAL_CURVES)])
    rival = (time.perf_counter() - start) / RIVAL_CURVES
    difference = float(np.max(np.abs(np.asarray(found.state)[:17, :RIVAL_CURVES].T - theirs)))
    note(
        curves=CURVES,
        with_gradients_s=ours,
        without_equilibrium=int(np.sum(np.asarray(found.code) == railjax.Equilibrium.FAILED)),
        scipy_per_curve_s=rival,
        ratio_to_scipy_value_only=rival * CURVES / ours,
        largest_difference=difference,
    )
    assert difference < AGREEMENT
    assert np.all(np.isfinite(slopes[1]))
    assert ours <= LONGEST
