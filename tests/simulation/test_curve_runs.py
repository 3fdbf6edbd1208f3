"""Runs through curves: they settle on the equilibrium of `curving`, on straight layouts nothing changes, forces carry the masses."""

import json

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


def test_comfort_in_the_transitions_of_a_layout(run, coach, tmp_path):
    # a transition of 100 m at 25 m/s takes 4 s; in the arc of R 500 m with 100 mm of cant v² kappa - g theta is 0.596 m/s²
    line = railjax.Layout.curve(500.0, cant=0.1, transition=100.0, arc=200.0, lead=50.0)
    assert line.transitions() == ((48.0, 152.0), (348.0, 452.0))
    ran = railjax.simulate(coach, 25.0, layout=line, duration=18.0, record=["floor_acceleration"])
    found = railjax.comfort(ran, mean=False, layout=line)
    phi, rate = np.asarray(ran["carbody_phi"]), np.asarray(ran["carbody_phi_rate"])
    assert any("1 of 2 transitions" in note for note in found.notes)
    assert found.curves["standing"].shape == (1, 3)
    # by hand from the run: means over 1 s of what the floor feels, of its change and of its roll, in space, into the curve
    time = np.asarray(ran.time)
    window = np.ones(100) / 100.0
    floor = np.asarray(ran["floor_acceleration"])[:, 1] + 9.81 * phi
    level = np.convolve(floor, window, "same")
    change = np.convolve(np.gradient(level, 0.01), window, "same")
    turning = np.convolve(rate - np.where((time > 2.0) & (time < 6.0), 25.0 * 0.1 / 1.5 / 100.0, 0.0), window, "same")
    there = (time >= 48.0 / 25.0) & (time < 152.0 / 25.0)
    beyond = (time >= 48.0 / 25.0) & (time < 152.0 / 25.0 + 1.6)
    a, b, c, d, e = 28.54, 20.69, 11.1, 3.64, 2.283
    across = a * np.abs(level[beyond]).max() + b * np.abs(change[there]).max() - c
    by_hand = max(across, 0.0) + 100.0 * (d * np.abs(turning[there]).max()) ** e
    np.testing.assert_allclose(found.curves["standing"][0, 1], by_hand, rtol=0.03)
    with pytest.raises(railjax.InputError, match="holds none of the line's 2 transitions"):
        railjax.comfort(ran, mean=False, layout=railjax.Layout.curve(500.0, lead=2000.0))
    with pytest.raises(railjax.InputError, match="a simulation has those of its layout"):
        railjax.comfort(ran, mean=False, transitions=[(2.0, 6.0)])
    with pytest.raises(railjax.InputError, match="layout is for a Simulation"):
        railjax.comfort(floor, 100.0, mean=False, layout=line)
    path = tmp_path / "curve.toml"
    path.write_text(
        '[[segment]]\nkind = "straight"\nlength_m = 50\n[[segment]]\nkind = "transition"\nlength_m = 100\n'
        '[[segment]]\nkind = "arc"\nlength_m = 200\nradius_m = 500\ncant_mm = 100\n'
    )
    asked = ("--speed-kmh", 90, "--duration-s", 13, "--no-mean-comfort")
    code, out, _ = run("comfort", "coach", "--layout", path, *asked, "--json")
    assert code == 0
    said = json.loads(out)["curve_transitions_percent"]["standing"]
    np.testing.assert_allclose(said, found.curves["standing"], rtol=0.03)


def test_a_long_wave_of_the_cross_level_is_a_cant(coach):
    """On straight track over a record with a cross level as on a layout with that cant; twice of it does twice as much."""
    s = np.arange(0.0, 600.0, 0.5)
    level = 5e-3 * np.exp(-(((s - 300.0) / 100.0) ** 2))
    rough = railjax.MeasuredTrack(s, 1e-5 * np.sin(s / 3.0), cross_level=level, fade=200.0)
    still = railjax.MeasuredTrack(s, 1e-5 * np.sin(s / 3.0), cross_level=level, fade=200.0, rolls=False)
    at = np.arange(0.0, 620.0, 0.5)
    line = Layout.from_samples(at, 0.0 * at, railjax.alignment(rough.cross, at))
    options = {"duration": 12.0, "record": ["carbody_acceleration", "wheelset_y"]}
    over = railjax.simulate(coach, 50.0, track=rough, **options)
    canted = railjax.simulate(coach, 50.0, track=still, layout=line, **options)
    twice = railjax.simulate(coach, 50.0, track=rough.scaled(2.0), **options)
    for name in options["record"]:
        peak = np.max(np.abs(canted[name]))
        np.testing.assert_allclose(over[name], canted[name], atol=0.02 * peak)
        np.testing.assert_allclose(twice[name], 2.0 * over[name], atol=0.03 * peak)
    assert np.max(np.abs(over["carbody_acceleration"])) > 0.02
