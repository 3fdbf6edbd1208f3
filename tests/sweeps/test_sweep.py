"""Sweeps: designs, studies, results with units and codes; what raises is marked, nothing is kept in memory."""

import dataclasses
import os
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fuzz import cheap
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import qmc

import railjax
from railjax.base.fingerprint import described, lines
from railjax.sweeps.chunks import PointCode
from railjax.sweeps.names import placed, unit_of
from railjax.sweeps.points import Blocks, Design, make_design

SPEEDS = np.array([50.0, 60.0, 70.0])
CONICITIES = [0.1, 0.2]
HERE = Path(__file__).parent


def growth(vehicle, speed):
    """A study of lanes: four numbers a point, cheap to compile."""
    stiffness = vehicle.primary.stiffness_x
    return {"product": speed * stiffness, "powers": jnp.stack([speed, speed**2, speed**3, jnp.zeros_like(speed)])}


# designs


def test_a_grid_has_all_combinations_with_the_last_parameter_running_fastest():
    design = make_design({"a": [1.0, 2.0], "b": [3, 4, 5]})
    points = Blocks(design, 10).points(0)
    assert (design.dims, design.shape) == (("a", "b"), (2, 3))
    assert points["a"].tolist() == [1, 1, 1, 2, 2, 2]
    assert points["b"].tolist() == [3, 4, 5, 3, 4, 5]
    assert Blocks(design, 2).points(3)["b"].tolist() == [5]


def test_a_list_of_points_keeps_its_rows():
    design = make_design({"a": [1.0, 2.0, 3.0], "b": [6.0, 5.0, 4.0]}, "points")
    assert (design.dims, design.shape) == (("point",), (3,))
    assert {name: values.tolist() for name, values in Blocks(design, 2).points(1).items()} == {"a": [3], "b": [4]}


@pytest.mark.parametrize("samples", [1, 2, 5, 16, 100])
def test_samples_are_scipys(samples):
    ranges = {"a": (1.0, 3.0), "b": (0.01, 1.0, "log")}
    unit_cube = {
        "latin-hypercube": qmc.LatinHypercube(2, rng=5).random(samples),
        "sobol": qmc.Sobol(2, rng=5).random(128)[:samples],
    }
    for kind, unit in unit_cube.items():
        a, b = make_design(ranges, kind, samples, 5).columns
        np.testing.assert_allclose(a, 1.0 + 2.0 * unit[:, 0], rtol=1e-15)
        np.testing.assert_allclose(np.log10(b), -2.0 + 2.0 * unit[:, 1], atol=1e-13)
    strata = np.sort(np.floor((make_design(ranges, "latin-hypercube", samples, 5).columns[0] - 1.0) / 2.0 * samples))
    np.testing.assert_array_equal(strata, np.arange(samples))


@cheap(50)
@given(shape=st.lists(st.integers(1, 9), min_size=1, max_size=3), largest=st.integers(1, 200))
def test_blocks_cover_every_point_once_and_are_no_larger_than_asked(shape, largest):
    axes = tuple(np.arange(float(n)) for n in shape)
    blocks = Blocks(Design("grid", tuple("abc"[: len(shape)]), axes), largest)
    assert blocks.lanes <= largest
    seen = np.zeros(shape, int)
    for index in range(blocks.count):
        points = blocks.points(index)
        seen[tuple(points[name].astype(int) for name in points)] += 1
        assert blocks.size(index) == len(points["a"]) <= blocks.lanes
        assert np.all(seen[blocks.slices(index)] == 1)
    assert np.all(seen == 1)
    if largest >= np.prod(shape):
        assert blocks.shape == tuple(shape)


@pytest.mark.parametrize(
    ("over", "options", "message"),
    [
        ({}, {}, "at least one parameter"),
        ({"speed": []}, {}, "over 'speed': give a list of numbers"),
        ({"speed": 50.0}, {}, "over 'speed': give a list of numbers"),
        ({"speed": [[50.0], [1.0, 2.0]]}, {}, "over 'speed': give a list of numbers"),
        ({"speed": [True, False]}, {}, "over 'speed': give a list of numbers"),
        ({"speed": [50.0, np.nan]}, {}, "over 'speed': every value must be finite"),
        ({"speed": [50.0, 0.0]}, {}, "speed must be positive"),
        ({"speed": [50.0]}, {"design": "cube"}, "design must be one of grid, points, latin-hypercube, sobol"),
        ({"speed": [50.0]}, {"samples": 4}, "samples is for latin-hypercube and sobol"),
        ({"speed": (50.0, 60.0)}, {"design": "sobol"}, "needs samples="),
        ({"speed": (50.0, 60.0)}, {"design": "sobol", "samples": 0}, "needs samples="),
        ({"speed": (50.0, 60.0)}, {"design": "sobol", "samples": 4, "seed": -1}, "seed must be a whole number"),
        ({"speed": (60.0, 50.0)}, {"design": "sobol", "samples": 4}, "the range must rise"),
        ({"speed": [50.0, 60.0, 70.0]}, {"design": "sobol", "samples": 4}, "give a range (low, high)"),
        ({"contact.conicity": (0.0, 0.1, "log")}, {"design": "sobol", "samples": 4}, "must be positive"),
        ({"speed": [50.0, 60.0], "contact.conicity": [0.1]}, {"design": "points"}, "columns of one length"),
        ({"primary.stifness_x": [1e6]}, {}, "the nearest is 'primary.stiffness_x'"),
        ({"primary.stiffness_x": [-1e6]}, {}, "primary.stiffness_x must not be negative"),
        ({"carbody.mass": [0.0]}, {}, "carbody.mass must be positive"),
        ({"contact.law": [1.0]}, {}, "not a single number"),
        ({"geometry.axle_pattern": [1.0]}, {}, "not a single number"),
        ({"yaw_damper.damping": [1.0]}, {}, "has no yaw damper"),
        ({"sped": [50.0]}, {}, "the nearest is 'speed'"),
        ({"track.amplitude": [1e-3]}, {}, "takes no track"),
        ({"speed": [50.0]}, {"speed": 40.0}, "speed is given by speed= and varies"),
        ({"speed": [50.0]}, {"track": railjax.TangentTrack()}, "takes no track"),
        ({"contact.conicity": [0.1]}, {}, "needs speed: give speed= or put it in over"),
        ({"contact.conicity": [0.1]}, {"speed": -3.0}, "speed must be positive"),
        ({"speed": [50.0]}, {"vehicle": None}, "needs vehicle: give vehicle="),
        ({"speed": [50.0]}, {"chunk": 0}, "chunk must be"),
        ({"speed": [50.0]}, {"executor": 3}, "executor must have a submit method"),
        ({"speed": [50.0]}, {"in_flight": 0}, "in_flight must be"),
        ({"speed": (50.0, 60.0)}, {"design": "sobol", "samples": 10**12}, "from 1 to 100000000"),
        ({"speed": [50.0]}, {"part": (2, 2)}, "part must be"),
        ({"speed": [50.0]}, {"part": (0, 2)}, "give out="),
        ({"speed": [50.0]}, {"part": (0, 2), "out": "s.zarr"}, "2 processes share 1 chunk(s)"),
    ],
)
def test_what_cannot_be_swept_is_refused_in_one_line(coach, over, options, message):
    with pytest.raises(railjax.InputError) as error:
        railjax.sweep(growth, over, **{"vehicle": coach, **options})
    assert message in str(error.value)
    assert len(str(error.value).splitlines()) == 1


def test_dampers_and_tracks_are_checked_as_well(coach):
    run = railjax.ForcedRun()
    given = {"vehicle": coach, "speed": 50.0, "track": railjax.SinusoidTrack(1e-3, 20.0), "damper": railjax.BalanceLogic()}
    for name, values, message in (
        ("damper.alpha", [-1.0], "damper.alpha must not be negative"),
        ("damper.alfa", [1.0], "did you mean 'alpha'"),
        ("damper.law", [1.0], "not a single number"),
        ("track.wavelength", [0.0], "track.wavelength must be positive"),
    ):
        with pytest.raises(railjax.InputError, match=message):
            railjax.sweep(run, {name: values}, **given)
    with pytest.raises(railjax.InputError, match="give damper="):
        railjax.sweep(run, {"damper.alpha": [1.0]}, vehicle=coach, speed=50.0)
    with pytest.raises(railjax.InputError, match=r"CriticalSpeed\(\)"):
        railjax.sweep(railjax.CriticalSpeed, {"contact.conicity": [0.1]}, vehicle=coach)


def test_parameters_are_placed_and_carry_their_units(coach):
    given = {"vehicle": coach, "damper": railjax.BoucWenDamper(), "track": railjax.SinusoidTrack(1e-3, 20.0)}
    units = {
        "speed": "m/s",
        "primary.stiffness_x": "N/m",
        "track.wavelength": "m",
        "damper.voltage_gain": "V/m",
        "damper.parameters.k0": "N/m",
    }
    assert {name: unit_of(given, name) for name in units} == units
    found = placed(given, {"damper.parameters.k0": 3.0, "speed": 40.0, "primary.stiffness_x": 2e6, "track.amplitude": 0.0})
    assert found["damper"].parameters == dataclasses.replace(given["damper"].parameters, k0=3.0)
    assert (found["speed"], found["vehicle"].primary.stiffness_x, found["track"].amplitude) == (40.0, 2e6, 0.0)
    assert given["vehicle"] is coach


# studies and their results


def test_a_forced_run_is_simulate_at_every_point():
    wheelset = railjax.load_vehicle("single-wheelset")
    track = railjax.SinusoidTrack(1e-3, 8.0)
    options = {"duration": 0.5, "settle": 0.1}
    study = railjax.ForcedRun(("rms:wheelset_y", "peak:guiding_force"), **options)
    over = {"track.amplitude": [1e-3, 2e-3], "speed": SPEEDS}
    found = railjax.sweep(study, over, vehicle=wheelset, track=track, chunk=4)
    assert found["rms_wheelset_y"].dims == ("track.amplitude", "speed", "wheelset")
    assert {n: found[n].attrs["units"] for n in ("rms_wheelset_y", "peak_guiding_force", "speed", "track.amplitude")} == {
        "rms_wheelset_y": "m",
        "peak_guiding_force": "N",
        "speed": "m/s",
        "track.amplitude": "m",
    }
    assert np.all(found["code"] == 0)
    one = railjax.simulate(
        wheelset,
        60.0,
        track=railjax.SinusoidTrack(2e-3, 8.0),
        record=(),
        reduce=["rms:wheelset_y", "peak:guiding_force"],
        **options,
    )
    at = found.sel({"speed": 60.0, "track.amplitude": 2e-3})
    np.testing.assert_allclose(at["rms_wheelset_y"], one["rms:wheelset_y"], rtol=1e-9)
    np.testing.assert_allclose(at["peak_guiding_force"], one["peak:guiding_force"], rtol=1e-9)


def test_a_lane_that_cannot_be_run_is_nan_with_its_code_and_the_others_are_kept():
    wheelset = railjax.load_vehicle("single-wheelset")
    found = railjax.sweep(
        railjax.ForcedRun(("rms:wheelset_y",), duration=0.5),
        {"speed": [0.05, 50.0, 60.0, 70.0]},
        vehicle=wheelset,
        track=railjax.SinusoidTrack(1e-3, 8.0),
    )
    assert found["code"].values.tolist() == [railjax.Result.STEP_TOO_LARGE, 0, 0, 0]
    assert np.isnan(found["rms_wheelset_y"].values[:, 0]).tolist() == [True, False, False, False]
    assert "2 step_too_large" in found["code"].attrs["meaning"]
    assert "-3 not_computed" in found["code"].attrs["meaning"]


def test_critical_speeds_are_those_of_linear_and_nonlinear_critical():
    wheelset = railjax.load_vehicle("single-wheelset")
    conicities = [0.0001, 0.1, 0.15]
    lanes = railjax.replace(wheelset, contact__conicity=jnp.array(conicities))
    found = railjax.sweep(railjax.CriticalSpeed(), {"contact.conicity": conicities}, vehicle=wheelset)
    alone = railjax.linear_critical(lanes)
    np.testing.assert_allclose(found["critical_speed"], alone.speed, rtol=1e-12)
    np.testing.assert_allclose(found["critical_frequency"], alone.frequency, rtol=1e-9)
    assert found["code"].values.tolist() == [railjax.Stability.STABLE, 0, 0]
    assert "1 stable" in found["code"].attrs["meaning"]
    assert np.isinf(found["critical_speed"].values[0])
    assert found["critical_speed"].attrs["units"] == "m/s"

    found = railjax.sweep(railjax.NonlinearCriticalSpeed(), {"contact.conicity": conicities}, vehicle=wheelset)
    alone = railjax.nonlinear_critical(lanes)
    np.testing.assert_allclose(found["nonlinear_critical_speed"], alone.speed, rtol=1e-9)
    np.testing.assert_allclose(found["fold_amplitude"], alone.amplitude, rtol=1e-6)
    np.testing.assert_array_equal(found["critical_speed"], alone.linear.speed)
    assert found["code"].values.tolist() == [2, 0, 0]
    assert "2 stable" in found["code"].attrs["meaning"]


def test_ride_comfort_marks_what_is_unstable(coach):
    over = {"speed": np.array([50.0, 60.0, 75.0]), "secondary.stiffness_y": np.array([1e5, 1.5e5])}
    found = railjax.sweep(railjax.RideComfort("erri-low"), over, vehicle=coach)
    assert found["code"].values.tolist() == [[0, 0], [0, 0], [1, 1]]
    assert np.isnan(found["mean_comfort"].values[2]).all()
    softer = railjax.replace(coach, secondary__stiffness_y=1e5)
    response = railjax.frequency_response(softer, 60.0, "erri-low", record=["floor_acceleration"])
    expected = railjax.spectral_comfort(response)
    for name, values in zip(("weighted_rms", "mean_comfort", "sperling"), expected, strict=True):
        np.testing.assert_allclose(found[name].values[1, 0], values.max(), rtol=1e-9)


def test_the_least_damping_is_that_of_modes(coach):
    over = {"speed": SPEEDS, "contact.conicity": CONICITIES}
    found = railjax.sweep(railjax.LeastDamping(), over, vehicle=coach)
    for speed in SPEEDS:
        alone = railjax.modes(railjax.replace(coach, contact__conicity=0.2), speed)
        oscillating = alone.frequency > 0
        at = found.sel({"speed": speed, "contact.conicity": 0.2})
        least = np.argmin(alone.damping_ratio[oscillating])
        assert float(at["least_damping_ratio"]) == pytest.approx(alone.damping_ratio[oscillating][least], abs=1e-9)
        assert float(at["frequency"]) == pytest.approx(alone.frequency[oscillating][least], rel=1e-9)
        assert float(at["growth"]) == pytest.approx(alone.eigenvalues.real.max(), abs=1e-7)


def test_results_say_what_they_rest_on(coach):
    over = {"speed": (50.0, 60.0), "primary.stiffness_x": (2e6, 5e6)}
    found = railjax.sweep(growth, over, vehicle=coach, design="sobol", samples=8, seed=3, units={"product": "N/s"})
    assert found["product"].dims == ("point",)
    assert found["powers"].dims == ("point", "powers_0")
    assert set(found.coords) == {"speed", "primary.stiffness_x"}
    np.testing.assert_array_equal(found["speed"], make_design(over, "sobol", 8, 3).columns[0])
    np.testing.assert_array_equal(found["product"], found["speed"] * found["primary.stiffness_x"])
    np.testing.assert_allclose(found["powers"][:, 2], found["speed"] ** 3, rtol=1e-15)
    assert found["product"].attrs["units"] == "N/s"
    attributes = found.attrs
    assert (attributes["samples"], attributes["seed"], attributes["vehicle"]) == (8, 3, "coach")
    assert (attributes["railjax"], attributes["jax"]) == (railjax.__version__, jax.__version__)
    # what varies is not fitted any more
    assert "primary.stiffness_y: guidance factor" in attributes["calibrated"]
    assert "primary.stiffness_x" not in attributes["calibrated"]


def test_a_study_may_have_arguments_of_its_own(coach):
    def guidance(vehicle, factor):
        p = vehicle.primary
        stiffer = railjax.replace(
            vehicle, primary__stiffness_x=factor * p.stiffness_x, primary__stiffness_y=factor * p.stiffness_y
        )
        return {"ratio": stiffer.primary.stiffness_x / stiffer.primary.stiffness_y, "stiffness": stiffer.primary.stiffness_x}

    found = railjax.sweep(guidance, {"factor": [0.5, 1.0]}, vehicle=coach, units={"stiffness": "N/m", "factor": "1"})
    np.testing.assert_allclose(found["stiffness"], np.array([0.5, 1.0]) * coach.primary.stiffness_x)
    np.testing.assert_allclose(found["ratio"], coach.primary.stiffness_x / coach.primary.stiffness_y)
    assert (found["factor"].attrs["units"], found["stiffness"].attrs["units"]) == ("1", "N/m")


class Pair(NamedTuple):
    matrix: jax.Array
    sine: jax.Array


@railjax.each_point
def at_one_point(vehicle, speed):
    assert jnp.ndim(speed) == 0
    return Pair(railjax.state_matrix(vehicle, speed)[17:20, :2], jnp.sin(speed))


def test_a_function_of_one_point_is_mapped(coach):
    found = railjax.sweep(at_one_point, {"speed": SPEEDS, "contact.conicity": CONICITIES}, vehicle=coach, chunk=4)
    assert found["matrix"].dims == ("speed", "contact.conicity", "matrix_0", "matrix_1")
    alone = railjax.state_matrix(railjax.replace(coach, contact__conicity=0.2), 60.0)[17:20, :2]
    np.testing.assert_allclose(found["matrix"][1, 1], alone, rtol=1e-12)
    np.testing.assert_allclose(found["sine"], np.sin(SPEEDS)[:, None] * np.ones(2), rtol=1e-12)


def test_a_function_of_one_point_need_not_be_jax(coach):
    calls = []

    @railjax.each_point(traced=False)
    def study(vehicle, speed):
        calls.append(speed)
        assert isinstance(speed, float)
        return {"name": len(railjax.modes(vehicle, speed).names), "frequency": railjax.modes(vehicle, speed).frequency[:2]}

    found = railjax.sweep(study, {"speed": SPEEDS}, vehicle=coach, chunk=2)
    assert sorted(calls) == SPEEDS.tolist()
    np.testing.assert_array_equal(found["frequency"][2], railjax.modes(coach, 70.0).frequency[:2])
    assert found["name"].dtype.kind == "i"


@pytest.mark.parametrize(
    ("study", "message"),
    [
        (lambda speed: {"x": jnp.ones((len(speed), 4))}, "last axis must have one value per point"),
        (lambda speed: {"x": "text"}, "'x' is str, not an array of numbers"),
        (lambda speed: {"x": None}, "'x' is NoneType, not an array of numbers"),
        (lambda speed: {"code": speed}, "nothing but a code"),
        (lambda speed: {"speed": speed}, "'speed' cannot have that name"),
        (lambda speed: {"a/b": speed}, "'a/b' cannot have that name"),
    ],
)
def test_results_that_are_none_are_refused(study, message):
    with pytest.raises(railjax.InputError, match=message):
        railjax.sweep(study, {"speed": SPEEDS})


def test_a_run_without_reductions_is_refused():
    def study(speed):
        nothing = jnp.zeros_like(speed)
        return railjax.Simulation(jnp.zeros(1), {"wheelset_y": nothing[None]}, {}, nothing, nothing.astype(int), speed, 1e-3)

    with pytest.raises(railjax.InputError, match="run without reductions"):
        railjax.sweep(study, {"speed": SPEEDS})


def test_a_constant_is_the_same_at_every_point():
    found = railjax.sweep(lambda speed: {"one": 1.0, "speed_kmh": 3.6 * speed}, {"speed": SPEEDS})
    assert found["one"].values.tolist() == [1.0, 1.0, 1.0]


def test_points_that_raise_are_marked_and_the_others_kept(caplog):
    def study(speed):
        if np.any(speed == 53.0) or np.any(speed == 58.0):
            raise ValueError("not this\none")
        return {"twice": 2.0 * speed, "count": np.ones(len(speed), int)}

    speeds = np.arange(50.0, 63.0)
    found = railjax.sweep(study, {"speed": speeds}, chunk=4)
    bad = np.isin(speeds, [53.0, 58.0])
    np.testing.assert_array_equal(found["code"], np.where(bad, PointCode.RAISED, 0))
    np.testing.assert_array_equal(found["twice"], np.where(bad, np.nan, 2.0 * speeds))
    assert found["count"].dtype.kind == "i"
    assert [record.getMessage() for record in caplog.records] == [
        "1 point(s) of chunk 0 raised an error; the first, at speed = 53: ValueError: not this one",
        "1 point(s) of chunk 2 raised an error; the first, at speed = 58: ValueError: not this one",
    ]


def test_a_whole_chunk_that_raises_is_marked_once_the_study_has_worked():
    def study(speed):
        if np.any(speed > 52.0):
            raise ValueError("too fast")
        return {"twice": 2.0 * speed}

    found = railjax.sweep(study, {"speed": np.arange(50.0, 58.0)}, chunk=2)
    assert found["code"].values.tolist() == [0, 0, 0, -1, -1, -1, -1, -1]


def test_a_study_that_works_nowhere_raises_its_own_error():
    def study(speed):
        raise KeyError("a slip of the programmer")

    with pytest.raises(KeyError, match="a slip of the programmer"):
        railjax.sweep(study, {"speed": SPEEDS})


def test_nan_without_a_code_is_marked():
    found = railjax.sweep(lambda speed: jnp.stack([speed, jnp.where(speed > 55.0, jnp.nan, 1.0)]), {"speed": SPEEDS})
    assert found["code"].values.tolist() == [0, -2, -2]
    assert found["result"].dims == ("speed", "result_0")


def test_nothing_stays_in_memory(coach):
    def live():
        return len(jax.live_arrays())

    counts = []
    over = {"speed": np.linspace(50.0, 60.0, 40)}
    railjax.sweep(at_one_point, over, vehicle=coach, chunk=4, progress=lambda at: counts.append(live()))
    assert len(counts) == 10
    assert len(set(counts[1:])) == 1


def test_progress_tells_rate_and_time_left(capsys):
    seen = []
    railjax.sweep(growth_of_speed, {"speed": np.linspace(50.0, 60.0, 10)}, chunk=4, progress=seen.append)
    # ten points in even chunks
    assert [at.done for at in seen] == [4, 8, 10]
    assert {at.total for at in seen} == {10}
    assert all(at.rate > 0 for at in seen)
    assert seen[-1].left == 0.0
    # no bar into a pipe
    railjax.sweep(growth_of_speed, {"speed": SPEEDS}, progress=True)
    assert capsys.readouterr() == ("", "")


def growth_of_speed(speed):
    return {"cube": speed**3}


# fingerprints

FACTOR = 2.0


def with_global(speed):
    return FACTOR * speed


def test_functions_are_told_apart_by_what_they_compute(monkeypatch):
    def make(power, default=1.0):
        return lambda speed, default=default: speed**power

    assert described(make(2)) == described(make(2))
    assert described(make(2)) != described(make(3))
    assert described(make(2)) != described(make(2, default=2.0))
    assert described(lambda speed: speed + 1) != described(lambda speed: speed + 2)
    before = described(with_global)
    monkeypatch.setitem(globals(), "FACTOR", 3.0)
    assert described(with_global) != before
    assert described(railjax.each_point(with_global)) == described(with_global)


def test_functions_are_told_the_same_in_another_process():
    code = (
        "import test_sweep, railjax\n"
        "from railjax.base.fingerprint import described\n"
        "print(*[described(value) for value in (test_sweep.with_global, test_sweep.with_set, railjax.ForcedRun())], sep='|')"
    )
    # strings hash differently in every process, so sets come in another order
    environment = {**os.environ, "PYTHONHASHSEED": "1", "PYTHONPATH": os.pathsep.join([str(HERE.parents[1]), str(HERE.parent)])}
    there = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, cwd=HERE)
    here = "|".join(described(value) for value in (with_global, with_set, railjax.ForcedRun()))
    assert there.stdout.strip() == here, there.stderr


def with_set(speed, kind="a"):
    return speed if kind in {"a", "b", "c", "d"} else -speed


def test_every_parameter_has_a_line_of_its_own(coach):
    found = lines("vehicle", coach)
    assert found["vehicle.primary.stiffness_x"] == repr(coach.primary.stiffness_x)
    changed = lines("vehicle", railjax.replace(coach, contact__law="smooth"))
    assert [key for key in found if found[key] != changed[key]] == ["vehicle.contact.law"]
    assert described(np.arange(3.0)) != described(np.arange(3))
    assert described(np.arange(100.0)) != described(np.arange(100.0) + 1e-12)
    assert described(jnp.arange(100.0)) == described(np.arange(100.0))
