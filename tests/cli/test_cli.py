"""The command line: what it prints and writes, exit status 0, 1 or 2, and one line for whatever is wrong."""

import csv
import json
import subprocess
import sys

import numpy as np
import pytest

import railjax

SHORT = ["simulate", "coach", "--duration-s", "0.1"]


@pytest.fixture
def stable(tmp_path):
    """A vehicle that no speed makes hunt."""
    path = tmp_path / "stable.toml"
    path.write_text('base = "coach"\n[contact]\nconicity = 0.001\n')
    return path


def refused(result, *pieces, code=2):
    """One line on standard error that holds all pieces, nothing on standard output."""
    found, out, error = result
    assert found == code
    assert out == ""
    assert len(error.splitlines()) == 1
    for piece in ("railjax: ", *pieces):
        assert piece in error


def one_json_object(out):
    assert len(out.splitlines()) == 1
    return json.loads(out, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))


def test_vehicles(run):
    code, out, error = run("vehicles")
    assert (code, error) == (0, "")
    assert [line.split()[0] for line in out.splitlines()] == railjax.packaged_vehicles()
    listed = one_json_object(run("vehicles", "--json")[1])["vehicles"]
    assert {entry["name"]: entry["note"] for entry in listed}["coach"] == railjax.load_vehicle("coach").note


def test_modes(run, coach):
    code, out, error = run("modes", "coach", "--speed-kmh", 245.6, "--json")
    assert (code, error) == (0, "")
    content = one_json_object(out)
    assert content["speed_kmh"] == 245.6
    assert len(content["modes"]) == len(railjax.modes(coach, 245.6 / 3.6).names)
    critical = content["modes"][0]
    assert critical["name"] == "bogie hunting, bogies in phase"
    assert critical["damping_ratio"] == pytest.approx(0.0, abs=1e-6)
    assert critical["frequency_hz"] == pytest.approx(6.03, abs=0.05)
    assert "bogie hunting" in run("modes", "coach")[1]


def test_critical_speed(run):
    code, out, error = run("critical-speed", "coach", "--json")
    assert (code, error) == (0, "")
    content = one_json_object(out)
    assert content["linear_kmh"] == pytest.approx(245.6, abs=0.1)
    assert "bogie hunting" in content["mode"]
    assert len(content["calibrated"]) == 4
    text = run("critical-speed", "coach")[1]
    assert "245.60 km/h" in text
    assert text.count("calibrated, not predicted") == 4


def test_nonlinear_critical_speed(run, tmp_path):
    code, out, error = run("critical-speed", "single-wheelset", "--nonlinear", "--json")
    assert (code, error) == (0, "")
    content = one_json_object(out)
    assert content["nonlinear_kmh"] == pytest.approx(117.906, abs=1e-3)
    assert content["nonlinear_kmh"] < content["linear_kmh"]
    assert content["fold_amplitude_mm"] == pytest.approx(8.282, abs=2e-3)
    assert content["fold_frequency_hz"] == pytest.approx(content["frequency_hz"], rel=1e-2)
    assert (
        "fold of the limit cycles at 8.282 mm (wheelset 1 from the front)"
        in run("critical-speed", "single-wheelset", "--nonlinear")[1]
    )
    tight = tmp_path / "tight.toml"
    tight.write_text('base = "single-wheelset"\n[contact]\nflange_clearance_mm = 1\n')
    content = one_json_object(run("critical-speed", tight, "--nonlinear", "--json")[1])
    assert content["criticality"] == "supercritical"
    assert content["nonlinear_kmh"] == pytest.approx(content["linear_kmh"], rel=1e-9)
    assert content["fold_amplitude_mm"] is None
    assert "supercritical" in run("critical-speed", tight, "--nonlinear")[1]


def test_critical_speed_of_the_literal_table_says_why_it_is_low(run):
    content = one_json_object(run("critical-speed", "coach-table1", "--json")[1])
    assert content["linear_kmh"] == pytest.approx(65.2, abs=0.1)
    assert "without axle guidance" in content["note"]
    assert content["calibrated"] == []
    assert content["note"] in run("critical-speed", "coach-table1")[1]


def test_a_file_does_not_claim_the_calibration_of_its_base(run, tmp_path):
    path = tmp_path / "softer.toml"
    path.write_text('base = "coach"\n[primary]\nstiffness_x_MN_per_m = 2\nstiffness_y_MN_per_m = 8\n')
    content = one_json_object(run("critical-speed", path, "--json")[1])
    assert content["vehicle"] == "softer"
    assert content["linear_kmh"] < 240
    assert not [entry for entry in content["calibrated"] if "stiffness" in entry]


def test_simulate_prints_and_reduces(run, coach):
    code, out, error = run(*SHORT)
    assert (code, error) == (0, "")
    assert "0.1 s in steps of 0.001 s, 180.0 km/h" in out
    assert "rms:carbody_acceleration" in out
    options = [
        "--record",
        "wheelset_y, carbody_y",
        "--speed-kmh",
        144,
        "--amplitude-mm",
        3,
        "--wavelength-m",
        15,
    ]
    content = one_json_object(run(*SHORT, *options, "--json")[1])
    expected = railjax.simulate(
        coach,
        40.0,
        track=railjax.SinusoidTrack(3e-3, 15.0),
        duration=0.1,
        reduce=["rms:wheelset_y", "peak:carbody_y"],
    )
    assert set(content["reductions"]) == {f"{how}:{name}" for how in ("rms", "peak") for name in ("wheelset_y", "carbody_y")}
    for name, values in expected.reductions.items():
        np.testing.assert_allclose(content["reductions"][name], values, rtol=1e-9)
    assert any("wavelength" in entry for entry in content["assumed"])


def test_simulate_over_a_bump(run, coach):
    options = ["--bump-m", 8, "--speed-kmh", 180, "--duration-s", 0.5, "--record", "wheelset_y", "--json"]
    content = one_json_object(run("simulate", "coach", *options)[1])
    expected = railjax.simulate(coach, 50.0, track=railjax.BumpTrack(5e-3, 8.0), duration=0.5, reduce=["peak:wheelset_y"])
    np.testing.assert_allclose(content["reductions"]["peak:wheelset_y"], expected["peak:wheelset_y"], rtol=1e-9)


def test_simulate_over_real_track(run, coach, tmp_path):
    options = ["--speed-kmh", 180, "--duration-s", 2, "--record", "wheelset_y", "--json"]
    content = one_json_object(run("simulate", "coach", "--track", "fra-5", "--track-seed", 3, *options)[1])
    track = railjax.RandomTrack("fra-5", seed=3)
    expected = railjax.simulate(coach, 50.0, track=track, duration=2.0, reduce=["peak:wheelset_y"])
    np.testing.assert_allclose(content["reductions"]["peak:wheelset_y"], expected["peak:wheelset_y"], rtol=1e-9)
    assert any("seed 3" in entry for entry in content["assumed"])
    path = tmp_path / "line.csv"
    track.to_csv(path, length=400.0)
    content = one_json_object(run("simulate", "coach", "--track", path, *options)[1])
    expected = railjax.simulate(coach, 50.0, track=railjax.MeasuredTrack.from_csv(path), duration=2.0, reduce=["peak:wheelset_y"])
    np.testing.assert_allclose(content["reductions"]["peak:wheelset_y"], expected["peak:wheelset_y"], rtol=1e-9)


def test_simulate_over_files_as_people_have_them(run, tmp_path, coach):
    options = ["--speed-kmh", 180, "--duration-s", 1, "--record", "wheelset_y", "--json"]
    s = 0.25 * np.arange(1601)
    y = 3.0 * np.sin(2 * np.pi * s / 17.0)
    path = tmp_path / "line.txt"
    path.write_text(
        "stan [km];posun [mm]\n" + "\n".join(f"{a:.5f};{b:.4f}".replace(".", ",") for a, b in zip(s / 1e3, y, strict=True))
    )
    refused(
        run("simulate", "coach", "--track", path, *options), "no column of the distance", "separated by ';' with decimal commas"
    )
    named = ["--columns", "distance=stan,alignment=posun", "--longest-m", 60]
    content = one_json_object(run("simulate", "coach", "--track", path, *named, *options)[1])
    track = railjax.MeasuredTrack(s, 1e-3 * np.round(y, 4), longest=60.0)
    expected = railjax.simulate(coach, 50.0, track=track, duration=1.0, reduce=["peak:wheelset_y"])
    np.testing.assert_allclose(content["reductions"]["peak:wheelset_y"], expected["peak:wheelset_y"], rtol=1e-6)
    restored = one_json_object(run("simulate", "coach", "--track", path, *named, "--chord-m", 10, *options)[1])
    assert any("restored from versines over a chord of 10 m" in line for line in restored["assumed"])
    psd = tmp_path / "psd.csv"
    psd.write_text("frequency (1/m);PSD (mm^2/(1/m))\n0,005;400\n0,1;2\n1;0,003\n")
    content = one_json_object(run("simulate", "coach", "--track", psd, "--track-seed", 3, *options)[1])
    track = railjax.RandomTrack(railjax.spectrum(psd), seed=3)
    expected = railjax.simulate(coach, 50.0, track=track, duration=1.0, reduce=["peak:wheelset_y"])
    np.testing.assert_allclose(content["reductions"]["peak:wheelset_y"], expected["peak:wheelset_y"], rtol=1e-9)
    refused(run("simulate", "coach", "--track", psd, "--chord-m", 10), "holds a spectrum, --chord-m is for a measured track")
    refused(run("simulate", "coach", "--track", "erri-high", "--chord-m", 10), "--chord-m is for a track's file")
    refused(run("simulate", "coach", "--track", path, *named, "--track-seed", 1), "--track-seed is for a random track")


def test_the_package_runs_as_a_module(monkeypatch, capsys):
    import runpy

    monkeypatch.setattr("sys.argv", ["railjax", "vehicles", "--help"])
    with pytest.raises(SystemExit) as end:
        runpy.run_module("railjax", run_name="__main__")
    assert not end.value.code
    assert "railjax vehicles" in capsys.readouterr().out


def test_simulate_writes_csv(run, tmp_path, coach):
    out = tmp_path / "run.csv"
    assert run(*SHORT, "--record", "carbody_y,wheelset_y", "--out", out)[0] == 0
    with out.open() as file:
        header, *rows = csv.reader(file)
    assert header == ["time (s)", "carbody_y (m)", *[f"wheelset_y[{i}] (m)" for i in range(4)]]
    numbers = np.array(rows, float)
    expected = railjax.simulate(
        coach, 50.0, track=railjax.SinusoidTrack(5e-3, 20.0), duration=0.1, record=["carbody_y", "wheelset_y"]
    )
    np.testing.assert_allclose(numbers[:, 0], expected.time, atol=1e-12)
    np.testing.assert_allclose(numbers[:, 1], expected["carbody_y"], rtol=1e-9, atol=1e-14)
    np.testing.assert_allclose(numbers[:, 2:], expected["wheelset_y"], rtol=1e-9, atol=1e-14)


def test_simulate_writes_netcdf(run, tmp_path):
    import xarray

    out = tmp_path / "run.nc"
    assert run(*SHORT, "--out", out)[0] == 0
    with xarray.open_dataset(out, engine="scipy") as data:
        assert data["wheelset_y"].dims == ("time", "wheelset")
        assert data["carbody_acceleration"].attrs["units"] == "m/s^2"
        assert data.attrs["vehicle"] == "coach"
        assert float(data["peak_wheelset_y"].max()) > 1e-4


def test_simulate_draws(run, tmp_path):
    out = tmp_path / "run.png"
    assert run(*SHORT, "--out", out)[0] == 0
    assert out.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("arguments", "pieces"),
    [
        (["critical-speed", "koach"], ["no vehicle 'koach'", "did you mean 'coach'?"]),
        (["critical-speed"], ["VEHICLE"]),
        (["critical"], ["critical"]),
        ([*SHORT, "--speed", "200"], ["--speed"]),
        ([*SHORT, "--track", "eri-high"], ["--track", "nearest is 'erri-high'"]),
        ([*SHORT, "--track", "none.csv"], ["--track: none.csv", "cannot be read"]),
        ([*SHORT, "--track", "erri-high", "--track-seed", "-1"], ["seed must be a whole number"]),
        ([*SHORT, "--track", "erri-high", "--amplitude-mm", "3"], ["--amplitude-mm", "exclude each other"]),
        ([*SHORT, "--track-seed", "1"], ["--track-seed is for a random track"]),
        ([*SHORT, "--speed-kmh", "fast"], ["--speed-kmh", "number"]),
        ([*SHORT, "--speed-kmh", "0"], ["--speed-kmh must be a positive"]),
        ([*SHORT, "--speed-kmh", "-5", "--json"], ["--speed-kmh must be a positive, finite number, not -5"]),
        (["modes", "coach", "--speed-kmh", "inf"], ["--speed-kmh must be a positive"]),
        ([*SHORT, "--amplitude-mm", "nan"], ["--amplitude-mm must be a finite number"]),
        ([*SHORT, "--wavelength-m", "0"], ["--wavelength-m must be a positive"]),
        ([*SHORT, "--bump-m", "-1"], ["--bump-m must be a positive"]),
        ([*SHORT, "--dt-s", "nan"], ["--dt-s must be a positive"]),
        ([*SHORT, "--dt-s", "0.03"], ["duration 0.1 s must be a whole number of steps"]),
        ([*SHORT, "--dt-s", "0.01", "--speed-kmh", "10"], ["dt = 0.01 s is too large", "use dt <= 0.000"]),
        ([*SHORT, "--record", "weelset_y"], ["unknown channel 'weelset_y'", "did you mean 'wheelset_y'?"]),
        ([*SHORT, "--record", ","], ["--record names no channel"]),
        ([*SHORT, "--out", "run.pdf"], ["--out run.pdf", ".csv, .nc, .png, .svg or .json"]),
        (["reproduce", "--only", "fig-99"], ["no study 'fig-99'", "linear-critical-speed"]),
    ],
)
def test_bad_input_is_one_line_and_status_2(run, tmp_path, monkeypatch, arguments, pieces):
    monkeypatch.chdir(tmp_path)
    refused(run(*arguments), *pieces)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("suffix", ["csv", "nc", "png"])
def test_unwritable_out(run, tmp_path, suffix):
    out = tmp_path / "nowhere" / f"run.{suffix}"
    refused(run(*SHORT, "--out", out), f"--out {out}: cannot be written", "No such file or directory")


def test_reproduce_into_a_file(run, tmp_path):
    out = tmp_path / "taken"
    out.write_text("")
    refused(run("reproduce", "--out", out), f"--out {out}", "folder")


def test_numerical_failures_have_status_1(run, stable, tmp_path):
    refused(run("critical-speed", stable), "no linear critical speed", "stable up to 540 km/h", code=1)
    linear = tmp_path / "linear.toml"
    linear.write_text('base = "coach"\n[contact]\nlaw = "linear"\n')
    refused(run("simulate", linear, "--speed-kmh", 500), "diverged at 500 km/h", code=1)


def test_help(run):
    code, out, error = run("--help")
    assert (code, error) == (0, "")
    for command in ("vehicles", "modes", "critical-speed", "simulate", "reproduce"):
        assert command in out
        assert run(command, "--help")[0] == 0


def test_exit_status_of_the_process(tmp_path):
    def process(*arguments):
        return subprocess.run([sys.executable, "-m", "railjax.cli", *arguments], capture_output=True, text=True)

    good = process("critical-speed", "coach", "--json")
    assert (good.returncode, good.stderr) == (0, "")
    assert one_json_object(good.stdout)["linear_kmh"] == pytest.approx(245.6, abs=0.1)
    bad = process("critical-speed", "koach")
    refused((bad.returncode, bad.stdout, bad.stderr), "did you mean 'coach'?")


def test_simulate_with_a_controlled_damper(run):
    reductions = {}
    for damper in ("passive", "balance-logic", "passive-soft"):
        content = one_json_object(run(*SHORT, "--duration-s", 3, "--speed-kmh", 220, "--damper", damper, "--json")[1])
        assert content["damper"] == damper
        assert any("damper" in entry for entry in content["assumed"]) == (damper != "passive")
        reductions[damper] = content["reductions"]["rms:carbody_acceleration"]
    assert reductions["balance-logic"] < reductions["passive-soft"] < reductions["passive"]


@pytest.mark.parametrize(
    ("options", "pieces"),
    [
        (["--damper", "skyhok"], ["--damper 'skyhok'", "did you mean skyhook?"]),
        (["--damper", "skyhook", "--alpha", "1"], ["--alpha is for balance-logic and hybrid"]),
        (["--damper", "hybrid", "--alpha", "nan"], ["--alpha must be a finite number"]),
        (["--damper", "hybrid", "--alpha", "-1"], ["alpha must not be negative"]),
    ],
)
def test_bad_dampers_are_refused(run, options, pieces):
    refused(run(*SHORT, *options), *pieces)


def test_a_damper_needs_a_secondary_suspension(run):
    refused(run("simulate", "single-wheelset", "--damper", "skyhook", "--record", "wheelset_y"), "no secondary suspension")


def test_every_damper_of_the_command_line_can_be_made(coach):
    from railjax.dampers.named import DAMPERS, make_damper
    from railjax.model.damper import Damper

    for name in DAMPERS:
        made = make_damper(name, coach, 60.0, 0.5 if name in ("balance-logic", "hybrid") else None)
        assert isinstance(made, Damper)


def test_train_writes_a_law_that_every_damper_option_takes(run, tmp_path):
    """No episodes: the law as it begins."""
    law, code = tmp_path / "law.npz", tmp_path / "law.c"
    options = [
        "--law",
        "linear",
        "--track",
        "erri-low",
        "--speed-kmh",
        150,
        "--speed-kmh",
        200,
        "--episodes",
        0,
        "--out",
        law,
        "--c",
        code,
        "--json",
    ]
    status, out, error = run("train", "coach", *options)
    assert status == 0, error
    found = json.loads(out)
    assert found["comfort_ratio"] == 1.0
    assert found["begun_as"] == "Skyhook"
    assert "damper_law_reset" in code.read_text()
    status, out, error = run("simulate", "coach", "--speed-kmh", 180, "--duration-s", 0.5, "--damper", law, "--json")
    assert status == 0, error
    for wrong, about in (
        (["train", "coach", "--out", tmp_path / "law.txt"], ".npz"),
        (["train", "coach", "--out", law, "--law", "lerned"], "--law"),
        (["train", "coach", "--out", law, "--speed-kmh", 100], "--speed-kmh"),
        (["train", "coach", "--out", law, "--estimator", "observer"], "--estimator"),
        (["simulate", "coach", "--speed-kmh", 180, "--damper", tmp_path / "none.npz"], "no law"),
        (["simulate", "coach", "--speed-kmh", 180, "--damper", code.with_suffix(".npzz")], "--damper"),
    ):
        status, out, error = run(*wrong)
        assert status == 2
        assert about in error
        assert error.count("\n") == 1
