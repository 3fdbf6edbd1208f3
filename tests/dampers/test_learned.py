"""Learned laws: what they begin as, their symmetry, files, and the same law in C."""

import ctypes
import dataclasses
import shutil
import subprocess

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import railjax
from railjax.dampers.control.device import Device
from railjax.dampers.control.export_c import source_of
from railjax.dampers.control.kalman import KalmanFilter

SKYHOOK = railjax.Skyhook(damping=1e5)
SAMPLES = 4000


@pytest.fixture(scope="module")
def controller():
    return railjax.Controller(SKYHOOK, device=Device(slew=50.0))


@pytest.fixture(scope="module")
def begun(coach, controller):
    return railjax.LearnedDamper.of(controller, coach)


@pytest.fixture(scope="module")
def other(begun):
    """As if it had been trained: all numbers moved."""
    rng = np.random.default_rng(1)
    changed = {
        name: getattr(begun, name) + 0.05 * rng.normal(size=np.shape(getattr(begun, name)))
        for name in ("linear_gain", "hidden_demand")
    }
    return dataclasses.replace(begun, **changed, time_constants=begun.time_constants * 1.3)


@pytest.fixture(scope="module")
def readings():
    """A ride's, (samples, sensors, bogies)."""
    rng = np.random.default_rng(0)
    t = 1e-3 * np.arange(SAMPLES)[:, None]
    tones = rng.uniform(0.3, 12.0, (3, 2, 1, 12))
    waves = np.sum(np.sin(2 * np.pi * tones * t[:, 0][None, None, :, None] + rng.uniform(0, 6, tones.shape)), axis=-1) / 3.0
    return np.moveaxis(waves, -1, 0) * np.array([0.3, 3.0, 6e-3])[:, None]


def commands(law, vehicle, readings):
    """What the law commands of readings, one sample after the other, (samples, bogies)."""

    @jax.jit
    def all_of(law, vehicle, readings):
        def one(carry, signals):
            memory, command = carry
            elapsed = jnp.full(2, law.sample_time)
            wanted, memory = law.decide(vehicle, signals, memory, elapsed)
            command = law.on.slewed(wanted, command, elapsed)
            return (memory, command), command

        return jax.lax.scan(one, (jnp.zeros((law.memory_rows, 2)), jnp.zeros(2)), readings)[1]

    return np.asarray(all_of(law, vehicle, jnp.asarray(readings)))


@pytest.fixture(scope="module")
def full(coach):
    """Clipped LQR on a filter that is none, but stable and of a filter's shapes."""
    rng = np.random.default_rng(3)
    lqr = railjax.ClippedLQR(feedback=rng.normal(size=(2, 34)))
    parts = {
        "transition": 0.12 * rng.normal(size=(50, 50)),
        "drive": 1e-6 * rng.normal(size=(50, 2)),
        "gain": 0.05 * rng.normal(size=(50, 6)),
    }
    assert np.abs(np.linalg.eigvals(parts["transition"])).max() < 0.98
    return railjax.Controller(lqr, estimator=KalmanFilter(**parts))


def test_it_begins_as_the_law_it_is_made_of(coach, controller, begun, full, readings):
    """But for the rounding of the velocity that a demand is divided by."""
    off = commands(begun, coach, readings) - commands(controller, coach, readings)
    assert np.sqrt(np.mean(off**2)) < 0.04
    assert begun.origin == "Skyhook"
    # of clipped LQR all states are fed back as they are estimated
    gain = railjax.LearnedDamper.of(full, coach, hidden=0, time_constants=())
    rows = (gain.linear_gain * gain.demand[:, None] / gain.scale)[:, :34]
    np.testing.assert_allclose(rows, full.wraps.feedback, rtol=1e-9)
    for law, about in ((railjax.Skyhook(), "linear"), (railjax.ADD(), "linear")):
        with pytest.raises(railjax.InputError, match=about):
            railjax.LearnedDamper.of(railjax.Controller(law), coach)


def test_files_keep_every_bit(coach, other, controller, tmp_path, readings):
    path = tmp_path / "law.npz"
    other.save(path)
    again = railjax.load_law(path)
    assert jax.tree.structure(again) == jax.tree.structure(other)
    for one, two in zip(jax.tree.leaves(again), jax.tree.leaves(other), strict=True):
        np.testing.assert_array_equal(one, two)
    controller.save(path)
    assert railjax.load_law(path).wraps == SKYHOOK
    path.write_bytes(path.read_bytes()[:300])
    for wrong, about in ((path, "damaged"), (tmp_path / "none.npz", "no law")):
        with pytest.raises(railjax.InputError, match=about):
            railjax.load_law(wrong)


def run_in_c(law, given, folder, vehicle=None):
    """What the law's C function commands of readings of single precision, compiled as for a controller."""
    law.export_c(folder / "law.c", name="ride_law", vehicle=vehicle)
    library = folder / "law.so"
    warnings = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic"]
    subprocess.run(["gcc", "-O2", *warnings, "-shared", "-fPIC", str(folder / "law.c"), "-o", str(library), "-lm"], check=True)
    code = ctypes.CDLL(str(library))
    state, found = ctypes.create_string_buffer(1 << 16), np.empty((SAMPLES, 2), np.float32)
    code.ride_law_reset(state)
    for k in range(SAMPLES):
        code.ride_law(state, given[k].ctypes.data_as(ctypes.c_void_p), found[k].ctypes.data_as(ctypes.c_void_p))
    return found


@pytest.mark.skipif(shutil.which("gcc") is None, reason="needs gcc")
def test_the_law_in_c_is_the_law(coach, other, readings, tmp_path):
    """Over 4 s, to 1e-6 of the valve's range."""
    given = np.ascontiguousarray(readings, np.float32)
    wanted = commands(other, coach, given.astype(float))
    assert 0.1 < np.std(wanted) < 0.6
    np.testing.assert_allclose(run_in_c(other, given, tmp_path), wanted, atol=1e-6, rtol=0.0)
    for wrong in ("2law", "a-b", ""):
        with pytest.raises(railjax.InputError, match="name"):
            source_of(other, wrong)


@pytest.mark.skipif(shutil.which("gcc") is None, reason="needs gcc")
@pytest.mark.parametrize(
    "device",
    [Device(), Device(kind="force", slew=60.0, damping_max=None), Device(kind="force", force_limit=None)],
    ids=["valve", "force", "limitless"],
)
def test_the_law_on_a_kalman_filter_in_c_is_the_law(coach, full, device, readings, tmp_path):
    """Likewise, the filter's states and the force that it is told included; a force to 1e-6 of the pair's largest."""
    law = railjax.LearnedDamper.of(dataclasses.replace(full, device=device), coach, hidden=2, time_constants=(0.1,))
    rng = np.random.default_rng(4)
    law = dataclasses.replace(
        law, linear_gain=law.linear_gain * (3e5 if device.kind == "valve" else 3e3), hidden_demand=0.05 * rng.normal(size=(2, 2))
    )
    given = np.ascontiguousarray(readings, np.float32)
    wanted = commands(law, coach, given.astype(float))
    largest = 1.0 if device.kind == "valve" else 1e4
    assert 0.1 < np.std(wanted) / largest < 1.0, np.std(wanted)
    # numbers of single precision have 1e-7 of themselves
    np.testing.assert_allclose(run_in_c(law, given, tmp_path, coach), wanted, atol=1e-6 * largest, rtol=1e-7)
    with pytest.raises(railjax.InputError, match="vehicle"):
        source_of(law, "law")
