"""Runs through curves: they settle on the equilibrium of `curving`, on straight layouts nothing changes, forces carry the masses."""

import jax
import numpy as np
import pytest

import railjax
from railjax import Layout, Segment

TURN = Segment.transition(80.0)
ENTRY = [Segment.straight(40.0), TURN, Segment.arc(2000.0, 500.0, 0.1)]


def test_a_run_settles_on_the_equilibrium(coach):
    """From straight track over a transition into the arc, past the flange's corner."""
    speed = 90 / 3.6
    record = ("carbody_acceleration", "guiding_force", "wheelset_y")
    run = railjax.simulate(coach, speed, layout=Layout(ENTRY), duration=60.0, dt=2e-3, record=record, sample=0.1)
    steady = railjax.curving(coach, speed, radius=500.0, cant=0.1)
    np.testing.assert_allclose(run.final, steady.state, atol=1e-8)
    np.testing.assert_allclose(run["guiding_force"][-1], steady.sum_y, rtol=1e-6)
    sideways = speed**2 / 500.0 - 9.81 * 0.1 / 1.5
    assert float(run["carbody_acceleration"][-1]) == pytest.approx(sideways, rel=1e-6)
    # momentum: the rails' force over all time is what turned the masses, as the vehicle ends as it began, at rest beside the line
    assert np.max(np.abs(run["wheelset_y"])) < 0.012


def test_lanes_profiles_and_transformations_are_one(coach):
    """A batch of speeds, the same speed as a profile, and the run inside of `jit`, over an irregularity upon the curve."""
    layout, rough = Layout(ENTRY, ramp="smooth"), railjax.SinusoidTrack(2e-3, 20.0)
    options = {"duration": 6.0, "dt": 2e-3, "record": ("wheelset_y",), "sample": 0.2}
    alone = railjax.simulate(coach, 25.0, layout=layout, track=rough, **options)
    batch = railjax.simulate(coach, np.array([20.0, 25.0]), layout=layout, track=rough, **options)
    np.testing.assert_allclose(batch["wheelset_y"][..., 1], alone["wheelset_y"], rtol=1e-9, atol=1e-12)
    varying = railjax.simulate(
        coach, railjax.SpeedProfile([0.0, 10.0], [25.0, 25.0]), track=layout.with_irregularity(rough), **options
    )
    np.testing.assert_allclose(varying["wheelset_y"], alone["wheelset_y"], rtol=1e-7, atol=1e-10)
    traced = jax.jit(lambda speed: railjax.simulate(coach, speed, layout=layout, track=rough, **options).final)(25.0)
    np.testing.assert_allclose(traced, alone.final, rtol=1e-8, atol=1e-11)
    plain = railjax.simulate(coach, 25.0, track=rough, **options)
    assert np.max(np.abs(alone["wheelset_y"] - plain["wheelset_y"])) > 4e-3


def test_verb(run, tmp_path):
    path = tmp_path / "curve.toml"
    path.write_text(
        '[[segment]]\nkind = "transition"\nlength_m = 60\n[[segment]]\nkind = "arc"\nlength_m = 500\nradius_m = 400\ncant_mm = 100\n'
    )
    code, out, _ = run("simulate", "coach", "--layout", path, "--speed-kmh", 80, "--duration-s", 2, "--json")
    assert code == 0
    assert "least radius 400 m" in out
    code, _, error = run("simulate", "coach", "--layout", tmp_path / "no.toml")
    assert code == 2
    assert "cannot be read" in error
