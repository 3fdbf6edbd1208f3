"""Results on the disk: resumed after any stop to the same bits, refused for another study, opened by xarray; study files."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import xarray
from fuzz import cheap
from hypothesis import given
from hypothesis import strategies as st

import railjax
from railjax.cli.application import status
from railjax.cli.verbs.sweep import summary
from railjax.sweeps.files import EXAMPLE, read_study

SPEEDS, CONICITIES = np.linspace(50.0, 60.0, 5), np.array([0.1, 0.15, 0.2])
OVER = {"speed": SPEEDS, "contact.conicity": CONICITIES}
PROCESS = Path(__file__).with_name("sweep_study.py")


def study(vehicle, speed):
    """Two results, one with an axis of its own."""
    product = speed * vehicle.contact.conicity
    return {"product": product, "pair": np.stack([product, 1.0 / product])}


def run(coach, out=None, **options):
    """Fifteen points in chunks of six; the points done after each chunk beside the results."""
    done = []
    data = railjax.sweep(study, OVER, vehicle=coach, out=out, chunk=6, progress=lambda at: done.append(at.done), **options)
    return data, done


def bits(data):
    return {name: (data[name].dims, data[name].dtype, data[name].values.tobytes()) for name in data.variables}


# stores


def test_a_store_opens_as_what_was_returned(coach, tmp_path):
    expected, _ = run(coach)
    found, done = run(coach, tmp_path / "s.zarr")
    assert done == [6, 12, 15]
    assert not found["product"].variable._in_memory
    opened = xarray.open_zarr(tmp_path / "s.zarr")
    assert bits(opened) == bits(found) == bits(expected)
    assert opened.attrs == found.attrs
    assert opened["product"].sel({"speed": 55.0, "contact.conicity": 0.2}) == 55.0 * 0.2
    # one chunk of Zarr for one of the sweep
    assert opened["pair"].encoding["chunks"] == (2, 3, 2)


def test_samples_carry_their_coordinates_through_the_store(coach, tmp_path):
    over = {"speed": (50.0, 60.0), "contact.conicity": (0.1, 0.2)}
    options = {"vehicle": coach, "design": "latin-hypercube", "samples": 10, "chunk": 4}
    found = railjax.sweep(study, over, out=tmp_path / "s.zarr", **options)
    assert set(xarray.open_zarr(tmp_path / "s.zarr").coords) == {"speed", "contact.conicity"}
    assert bits(found) == bits(railjax.sweep(study, over, **options))


def test_what_is_missing_or_in_pieces_is_computed_again(coach, tmp_path):
    store = tmp_path / "s.zarr"
    whole = bits(run(coach, store)[0])
    assert run(coach, store)[1] == []
    codes = sorted((store / "code" / "c").glob("*/0"))
    assert len(codes) == 3
    codes[1].unlink()
    (store / "product" / "c" / "1" / "0").write_bytes(b"")  # left behind by a loss of power
    assert run(coach, store)[1] == [15]
    codes[0].write_bytes(codes[0].read_bytes()[:3])
    codes[2].write_bytes(b"")
    (store / "pair" / "c" / "2" / "0" / "0").unlink()
    data, done = run(coach, store)
    assert done == [12, 15]
    assert bits(data) == whole


def test_an_unfinished_store_says_so(coach, tmp_path):
    store = tmp_path / "s.zarr"

    def stop(at):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt, match=r"stopped: 6 of 15 points are in .*s\.zarr; the same again goes on from there"):
        railjax.sweep(study, OVER, vehicle=coach, out=store, chunk=6, progress=stop)
    opened = xarray.open_zarr(store)
    assert opened["code"].values[:2].tolist() == [[0] * 3] * 2
    assert np.all(opened["code"].values[2:] == -3)
    assert np.all(np.isnan(opened["product"].values[2:]))
    assert summary(opened)[0] == {"ok": 6, "not_computed": 9}
    data, done = run(coach, store)
    assert done == [12, 15]
    assert bits(data) == bits(run(coach)[0])


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"study": lambda vehicle, speed: {"product": speed}}, "study is"),
        ({"over": {**OVER, "speed": SPEEDS + 1.0}}, "over speed is float64 [50.0, 52.5"),
        ({"over": {"speed": SPEEDS}}, "over contact.conicity is float64 [0.1"),
        ({"vehicle": "stiffer"}, "vehicle.primary.stiffness_x is 3227632.0 there and 4000000.0 here"),
        ({"chunk": 3}, "chunk is tuple(2, 3) there and tuple(1, 3) here"),
        ({"units": {"product": "m/s"}}, "units is"),
        ({"damper": railjax.PassiveDamper()}, "takes no damper"),
    ],
)
def test_a_store_of_another_study_is_refused(coach, tmp_path, changed, message):
    store = tmp_path / "s.zarr"
    run(coach, store)
    if "vehicle" in changed:
        changed = {"vehicle": railjax.replace(coach, primary__stiffness_x=4e6)}
    arguments = {"study": study, "over": OVER, "vehicle": coach, "chunk": 6, **changed}
    with pytest.raises(railjax.InputError) as error:
        railjax.sweep(arguments.pop("study"), arguments.pop("over"), out=store, **arguments)
    assert message in str(error.value)
    assert len(str(error.value).splitlines()) == 1


def test_a_release_that_may_compute_other_numbers_is_refused(coach, tmp_path, monkeypatch):
    run(coach, tmp_path / "s.zarr")
    monkeypatch.setattr(sys.modules["railjax.sweeps.sweep"], "digest_of_source", lambda *_: "0123456789abcdef")
    with pytest.raises(
        railjax.InputError, match=rf"railjax is .* there and {re.escape(railjax.__version__)} \(0123456789abcdef\) here"
    ):
        run(coach, tmp_path / "s.zarr")


def test_names_and_labels_of_a_vehicle_do_not_matter(coach, tmp_path):
    import dataclasses

    run(coach, tmp_path / "s.zarr")
    assert run(dataclasses.replace(coach, name="other", note="", provenance=()), tmp_path / "s.zarr")[1] == []


def test_nothing_is_left_of_a_store_that_could_not_be_made(coach, tmp_path, monkeypatch):
    with pytest.raises(railjax.InputError, match="cannot have that name"):
        railjax.sweep(lambda speed: {"speed": speed}, {"speed": SPEEDS}, out=tmp_path / "s.zarr")

    def full(number):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(railjax.InputError, match=r"cannot be written \(No space left"):
            run(coach, tmp_path / "s.zarr")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("what", ["file", "folder", "zarr"])
def test_what_is_no_sweep_is_left_alone(coach, tmp_path, what):
    path = tmp_path / "s.zarr"
    if what == "file":
        path.write_text("mine")
    elif what == "folder":
        path.mkdir()
        (path / "mine").write_text("mine")
    else:
        xarray.Dataset({"a": ("x", [1.0])}).to_zarr(path)
    before = sorted((p, p.read_bytes() if p.is_file() else b"") for p in [path, *path.rglob("*")])
    with pytest.raises(railjax.InputError, match="is there already and holds no sweep"):
        run(coach, path)
    assert sorted((p, p.read_bytes() if p.is_file() else b"") for p in [path, *path.rglob("*")]) == before
    with pytest.raises(railjax.InputError, match="does not exist"):
        run(coach, tmp_path / "nowhere" / "s.zarr")


def test_shares_of_several_processes_fill_one_store(coach, tmp_path):
    store = tmp_path / "s.zarr"
    _, first = run(coach, store, part=(0, 2))
    data, second = run(coach, store, part=(1, 2))
    assert (first, second) == ([6, 9], [6])
    assert bits(data) == bits(run(coach)[0])


class Meanwhile:
    """What happens while the next chunk is computed; a class is told by its name, so it is no part of the study."""

    happens = None


def interrupted(vehicle, speed):
    """`study`, during whose first chunk something else happens."""
    happens, Meanwhile.happens = Meanwhile.happens, None
    if happens:
        happens()
    return study(vehicle, speed)


@pytest.mark.parametrize("other", [study, interrupted])
def test_two_that_begin_at_once_agree_on_one_store(coach, tmp_path, other):
    store = tmp_path / "s.zarr"
    # neither finds a store; the second to finish its first chunk finds that of the first
    Meanwhile.happens = lambda: railjax.sweep(other, OVER, vehicle=coach, out=store, chunk=6, part=(1, 2))
    if other is study:
        with pytest.raises(railjax.InputError, match="holds another study: study is study"):
            railjax.sweep(interrupted, OVER, vehicle=coach, out=store, chunk=6)
    else:
        found = railjax.sweep(interrupted, OVER, vehicle=coach, out=store, chunk=6)
        assert bits(found) == bits(run(coach)[0])
    assert [path.name for path in tmp_path.iterdir()] == ["s.zarr"]


# processes that are stopped


def start(store, pause):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(PROCESS.parents[2]), os.environ.get("PYTHONPATH", "")])}
    return subprocess.Popen(
        [sys.executable, str(PROCESS), str(store), str(pause)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
    )


def stopped_after(process, points, how):
    """Wait for some points, let the next chunk begin, and send the signal; lines on standard error."""
    for line in process.stdout:
        if int(line) >= points:
            break
    time.sleep(0.1)
    process.send_signal(how)
    _, error = process.communicate(timeout=300)
    return error


def test_killed_and_resumed_to_the_same_bits(coach, tmp_path):
    import sweep_study

    store = tmp_path / "s.zarr"
    # a pause of a second: the kill is within the second or third chunk
    process = start(store, 1.0)
    stopped_after(process, 12, signal.SIGKILL)
    assert process.returncode == -signal.SIGKILL
    there = int(np.sum(xarray.open_zarr(store)["code"].values == 0))
    assert 12 <= there <= 36
    done = []
    found = sweep_study.run(coach, out=store, progress=lambda at: done.append(at.done))
    assert done == list(range(there + 12, 121, 12))
    assert bits(found) == bits(sweep_study.run(coach))


def test_control_c_ends_with_a_line_how_to_go_on(tmp_path):
    store = tmp_path / "s.zarr"
    process = start(store, 0.5)
    error = stopped_after(process, 12, signal.SIGINT)
    assert process.returncode != 0
    last = error.splitlines()[-1]
    assert last.startswith("KeyboardInterrupt: stopped: ")
    assert last.endswith("the same again goes on from there")


# study files and the command line

SMALL = """
study = "least-damping"
vehicle = "coach"
speed_kmh = 180
chunk = 4
[over]
contact.conicity = [0.1, 0.15, 0.2]
"primary.stiffness_x_MN_per_m" = { from = 2, to = 4, points = 3, scale = "log" }
"""


@pytest.fixture
def command(capsys, tmp_path):
    """Writes a study file and runs it: exit status, standard output, standard error."""

    def run_and_capture(text, *options):
        path = tmp_path / "study.toml"
        path.write_text(text)
        code = status(["sweep", str(path), "--out", str(tmp_path / "s.zarr"), *options])
        return code, *capsys.readouterr()

    return run_and_capture


def test_the_example_is_a_study(capsys, tmp_path):
    assert status(["sweep", "--example"]) == 0
    assert capsys.readouterr().out == EXAMPLE
    (tmp_path / "study.toml").write_text(EXAMPLE)
    found = read_study(tmp_path / "study.toml")
    assert found["study"] == railjax.ForcedRun(
        ("rms:carbody_acceleration", "peak:guiding_force"), duration=10.0, dt=1e-3, settle=2.0
    )
    assert (found["track"], found["damper"]) == (railjax.SinusoidTrack(5e-3, 20.0), railjax.BalanceLogic(alpha=0.5))
    np.testing.assert_allclose(found["over"]["speed"], np.linspace(150.0, 250.0, 21) / 3.6)
    np.testing.assert_allclose(found["over"]["primary.stiffness_x"], np.linspace(2e6, 5e6, 7))
    assert found["over"]["damper.alpha"].tolist() == [0.2, 0.5, 1.0]


def test_the_command_line_computes_and_tells(command, tmp_path, coach):
    code, out, error = command(SMALL, "--json")
    assert (code, error) == (0, "")
    content = json.loads(out)
    assert (content["points"], content["codes"], content["vehicle"]) == (9, {"ok": 9}, "coach")
    assert not any(entry.startswith("primary.stiffness_x") for entry in content["calibrated"])
    assert any(entry.startswith("primary.stiffness_y") for entry in content["calibrated"])
    data = xarray.open_zarr(tmp_path / "s.zarr")
    np.testing.assert_allclose(data["primary.stiffness_x"], [2e6, 2e6 * 2**0.5, 4e6])
    ends = content["results"]["least_damping_ratio"]
    assert (ends["min"], ends["max"]) == (float(data["least_damping_ratio"].min()), float(data["least_damping_ratio"].max()))
    # again: nothing is left to do
    code, out, error = command(SMALL)
    assert (code, error) == (0, "")
    assert "9 points: 9 ok" in out
    code, out, error = command(SMALL.replace("180", "181"))
    assert (code, out) == (2, "")
    assert "holds another study: speed is 50.0 there and 50.2" in error
    assert len(error.splitlines()) == 1


def test_a_run_may_start_from_a_disturbance(tmp_path):
    initial = "[options.initial]\nwheelset_y_mm = 5\nbogie_psi_rate_mrad_per_s = 2"
    (tmp_path / "study.toml").write_text(OTHER + initial)
    assert read_study(tmp_path / "study.toml")["study"].initial == {"wheelset_y": 5e-3, "bogie_psi_rate": 2e-3}


def test_vehicles_are_found_beside_the_study(command, tmp_path):
    (tmp_path / "mine.toml").write_text('base = "coach"\nname = "mine"\n')
    (tmp_path / "study.toml").write_text(SMALL.replace('"coach"', '"mine.toml"'))
    assert read_study(tmp_path / "study.toml")["vehicle"].name == "mine"


def test_stopped_on_the_command_line(command, monkeypatch):
    def stop(**arguments):
        raise KeyboardInterrupt("stopped: 4 of 9 points are in s.zarr; the same again goes on from there")

    monkeypatch.setattr(railjax, "sweep", lambda **arguments: stop(**arguments))
    code, out, error = command(SMALL)
    assert (code, out) == (130, "")
    assert error.strip().splitlines()[-1] == "railjax: stopped: 4 of 9 points are in s.zarr; the same again goes on from there"


def test_a_study_file_may_ride_on_a_random_track(tmp_path):
    path = tmp_path / "study.toml"
    track = '[track]\nkind = "random"\nspectrum = "erri-low"\nseed = 3\nlength_m = 1500\n'
    text = 'study = "forced-run"\nvehicle = "coach"\n[options]\nduration_s = 1\n' + track + "[over]\nspeed_kmh = [150, 200]\n"
    path.write_text(text)
    found = read_study(path)["track"]
    assert isinstance(found, railjax.RandomTrack)
    assert found.length == pytest.approx(1500.0)
    for wrong, message in (
        ("erri-lo", "nearest is 'erri-low'"),
        ("seed = 3", "seed"),
        ("length_m = 1500", "length"),
    ):
        right = {"erri-lo": "erri-low"}.get(wrong, wrong)
        path.write_text(text.replace(right, {"seed = 3": 'seed = "x"', "length_m = 1500": "length_m = 1"}.get(wrong, wrong)))
        with pytest.raises(railjax.InputError, match=message):
            read_study(path)


MAP = """study = "equivalent-conicity"
[options]
wheel = "S1002"
[over]
gauge_mm = [1420, 1430, 1435]
inclination = [0.025, 0.05]
"""


def test_a_conicity_map(command, tmp_path):
    """Without a vehicle; the numbers are those of the pair by themselves, and a pair that does not fit is told by its code."""
    code, out, _ = command(MAP, "--json")
    assert code == 0
    assert json.loads(out)["codes"] == {"ok": 4, "does_not_fit": 2}
    data = xarray.open_zarr(tmp_path / "s.zarr")
    assert data.equivalent_conicity.dims == ("gauge", "inclination")
    assert data.gauge.attrs["units"] == "m"
    found = data.equivalent_conicity.values
    assert np.isnan(found[0]).all()
    assert found[2, 0] == pytest.approx(0.177, abs=0.004)
    alone = railjax.contact_geometry("S1002", "60E1", gauge=1.43)
    assert found[1, 0] == pytest.approx(float(railjax.equivalent_conicity(alone.y, alone.delta_r, 3e-3)), rel=1e-6)


OTHER = SMALL.replace('"least-damping"', '"forced-run"')


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("study = ", "not a TOML file"),
        ('vehicle = "coach"', "study must be one of forced-run, critical-speed"),
        (SMALL.replace("least-damping", "least-dampin"), "did you mean least-damping?"),
        (SMALL.replace('vehicle = "coach"', ""), "missing key vehicle"),
        (SMALL.replace("coach", "couch"), "no vehicle 'couch'"),
        (SMALL.replace("speed_kmh", "speed_mph"), "unknown key 'speed_mph'; did you mean speed_kmh?"),
        (SMALL.replace("speed_kmh = 180", 'speed_kmh = "fast"'), "speed_kmh must be a number"),
        (SMALL.replace("speed_kmh = 180", "speed_kmh = 180\nspeed_m_per_s = 50"), "speed is given twice"),
        (SMALL.replace("speed_kmh = 180", "speed_kmh = -180"), "speed must be positive"),
        (SMALL.replace("speed_kmh = 180", ""), "needs speed"),
        (SMALL.replace("chunk = 4", "chunk = 4.5"), "chunk must be a whole number"),
        (SMALL.replace("chunk = 4", 'design = "cube"'), "design must be one of"),
        (SMALL.replace("chunk = 4", 'design = "sobol"\nsamples = 8'), "over.contact.conicity: a sobol design needs { from"),
        (SMALL.replace("[0.1, 0.15, 0.2]", "[]"), "must be a list of numbers or"),
        (SMALL.replace("[0.1, 0.15, 0.2]", "[0.1, true]"), "over.contact.conicity must be a number"),
        (SMALL.replace("[0.1, 0.15, 0.2]", "[0.1, nan]"), "over.contact.conicity must be finite"),
        (SMALL.replace("contact.conicity", "contact.conicty"), "did you mean contact.conicity?"),
        (SMALL.replace("contact.conicity", "contract.conicity"), "did you mean contact.conicity?"),
        (SMALL.replace("stiffness_x_MN_per_m", "stiffness_x"), "did you mean primary.stiffness_x_"),
        (SMALL.replace("points = 3", "points = 0"), "points must be a whole number"),
        (SMALL.replace("points = 3", "pionts = 3"), "must be a list of numbers or"),
        (SMALL.replace("points = 3", "points = 3, step = 1"), "unknown key over.primary.stiffness_x_MN_per_m.step"),
        (SMALL.replace('"log"', '"cubic"'), "scale must be one of linear, log"),
        (SMALL.replace("from = 2", "from = -2"), 'scale = "log" must be positive'),
        (SMALL.replace("[over]", "[under]"), "unknown key 'under'"),
        (SMALL.split("[over]")[0], "missing table [over]"),
        (SMALL.split("[over]")[0] + "over = 3", "over must be a table"),
        (SMALL + "[options]\nsteps = 3", "has no options"),
        (SMALL + '[track]\nkind = "tangent"', "takes no track"),
        (MAP + '[damper]\nkind = "skyhook"', "takes no damper"),
        ('vehicle = "coach"\n' + MAP, "takes no vehicle"),
        (MAP.replace("gauge_mm", "gauge_cm"), "unknown parameter over.gauge_cm; did you mean gauge_m?"),
        (MAP.replace("gauge_mm", "gauge_m"), "gauge must be a number between 0.5 and 2 (m), not 1420; is it in millimetres?"),
        (MAP.replace("S1002", "S1003"), "no profile 'S1003': packaged are S1002"),
        (OTHER + "[options]\nduration = 3", "did you mean options.duration_s?"),
        (OTHER + "[options]\nduration_s = 1\nduration_ms = 1000", "duration is given twice"),
        (OTHER + "[options]\nduration_s = 0", "duration must be positive"),
        (OTHER + "[options]\nreduce = [3]", "options.reduce must be a list of names"),
        (OTHER + '[options]\nreduce = ["rms:speed"]', "unknown channel 'speed'"),
        (OTHER + "[options]\ninitial = 3", "must be a table of coordinates"),
        (OTHER + "[options.initial]\nwheelset_y = 3", "did you mean options.initial.wheelset_y_m"),
        (OTHER + "[options.initial]\nwheelset_y_mm = 3\nwheelset_y_m = 3", "wheelset_y is given twice"),
        (OTHER + '[track]\nkind = "wavy"', "track.kind must be one of tangent, sinusoid, bump"),
        (OTHER + '[track]\nkind = "sinusoid"\namplitude_mm = 5', "missing key track.wavelength_m"),
        (OTHER + '[track]\nkind = "sinusoid"\namplitude = 5', "did you mean track.amplitude_m"),
        (OTHER + '[track]\nkind = "sinusoid"\namplitude_mm = 5\nwavelength_m = 0', "track.wavelength must be positive"),
        (OTHER + '[damper]\nkind = "sky"', "damper.kind must be one of passive"),
        (OTHER + '[damper]\nkind = "skyhook"\nalpha = 1', "unknown key damper.alpha"),
        (OTHER + '[damper]\nkind = "skyhook"\nlaw = "soft"', "damper.law must be one of sharp, smooth"),
        (OTHER + '"damper.alpha" = [1, 2]', "the file has no [damper]"),
        (OTHER + '"damper.alpha" = [1, 2]\n[damper]\nkind = "skyhook"', "unknown parameter over.damper.alpha"),
    ],
)
def test_what_is_wrong_in_a_study_file_is_one_line(command, text, message):
    code, out, error = command(text)
    assert (code, out) == (2, "")
    assert message in error
    assert len(error.splitlines()) == 1


@cheap(60)
@given(
    lines=st.lists(st.sampled_from(EXAMPLE.splitlines()), max_size=40),
    value=st.sampled_from(
        ["-1", '"x"', "[]", "{}", "nan", "true", "1e400", "[[1]]", "{ from = 1 }", '{ from = "a", to = 2, points = 2 }']
    ),
    at=st.integers(0, 40),
)
def test_a_study_file_is_read_or_refused_whatever_is_in_it(tmp_path_factory, lines, value, at):
    if at < len(lines) and "=" in lines[at]:
        lines[at] = lines[at].split("=")[0] + "= " + value
    path = tmp_path_factory.mktemp("files") / "study.toml"
    path.write_text("\n".join(lines))
    try:
        found = read_study(path)
    except railjax.InputError as error:
        assert len(str(error).splitlines()) == 1  # noqa: PT017
        return
    assert {"study", "over", "design"} <= set(found)


@pytest.mark.parametrize("part", ["0/2", "3/2", "x", "1", "1/0"])
def test_a_part_is_the_kth_of_n(command, part):
    code, _, error = command(SMALL, "--part", part)
    assert code == 2
    assert "write it like 2/8" in error
