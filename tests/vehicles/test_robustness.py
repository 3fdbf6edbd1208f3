"""Whatever a user's file holds: it loads to finite numbers or is refused in one line, later steps end with a number or a code,
and nothing in it is evaluated."""

import copy
import dataclasses
import tempfile
import tomllib
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fuzz import CODE, cheap, mutate, mutations, toml
from hypothesis import event, given
from hypothesis import strategies as st

import railjax
from railjax.cli.application import status
from railjax.model.damper import PassiveDamper
from railjax.simulation.step_size import largest_step
from railjax.sweeps.files import EXAMPLE, read_study
from railjax.sweeps.points import make_design

PACKAGED = Path(railjax.__file__).parent / "vehicles"


def tables_of(name):
    return tomllib.loads((PACKAGED / f"{name}.toml").read_text(encoding="utf-8"))


FULL = {
    **tables_of("coach-table1"),
    "yaw_damper": {"damping_kNs_per_m": 300, "half_distance_m": 1.35, "blow_off_velocity_mm_per_s": 10, "damping_beyond_kNs_per_m": 20, "series_stiffness_MN_per_m": 10},
    "lateral_damper": {"blow_off_velocity_m_per_s": 0.1, "damping_beyond_kNs_per_m": 5, "carbody_height_mm": 970, "bogie_to_damper_m": -0.044},
    "bump_stop": {"travel_mm": [0, 25, 30], "force_kN": [0, 0, 0.6]},
}  # fmt: skip
STARTS = [FULL, tables_of("coach-table1"), tables_of("crh380a"), tables_of("single-wheelset"), tables_of("coach")]


def structure(vehicle):
    return jax.tree.structure(dataclasses.replace(vehicle, name="", note="", provenance=()))


#: compiled code serves this structure; any other runs op by op, as each would have to be compiled
COMPILED = structure(railjax.load_vehicle("coach"))


def one_line(error):
    assert len(str(error).splitlines()) == 1, str(error)
    assert all(len(message.splitlines()) == 1 for message in getattr(error, "messages", ()))


def exercise(path):
    """Load, write, check and use a vehicle file; says how far it came."""
    try:
        vehicle = railjax.load_vehicle(path)
    except railjax.InputError as error:
        one_line(error)
        return "refused"
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(vehicle))
    copied = path.with_name("copied.toml")
    copied.write_text(railjax.vehicle_toml(vehicle, name="copied"), encoding="utf-8")
    again = railjax.load_vehicle(copied)
    assert structure(again) == structure(vehicle)
    assert all(np.array_equal(a, b) for a, b in zip(jax.tree.leaves(again), jax.tree.leaves(vehicle), strict=True))
    compiled = structure(vehicle) == COMPILED
    found = railjax.check_vehicle(vehicle, dynamics=compiled)
    assert len(str(found).splitlines()) == 1 + len(found.warnings) + sum(not entry.doubtful for entry in found.derived)
    assert all(entry.doubtful for entry in found.derived if np.isnan(entry.value))
    try:
        with jax.disable_jit(not compiled):
            # arrays, as under jit, for Python's floats raise where they divide by zero
            modes = railjax.modes(jax.tree.map(jnp.asarray, vehicle) if not compiled else vehicle, 40.0)
    except (railjax.InputError, railjax.NumericalError) as error:
        one_line(error)
        return "without modes"
    assert all(np.all(np.isfinite(values)) for values in (modes.eigenvalues, modes.shapes, modes.energy))
    if compiled:
        critical = railjax.linear_critical(vehicle)
        code = railjax.Stability(int(critical.code))
        assert np.isfinite(critical.speed) == (code == railjax.Stability.OK)
        try:
            assert not np.isnan(largest_step(vehicle, 40.0, PassiveDamper()))
            run = railjax.simulate(vehicle, 40.0, duration=0.02, reduce=["rms:wheelset_y"], record=())
            assert np.all(np.isfinite(run["rms:wheelset_y"])) or not run.ok
        except (railjax.InputError, railjax.NumericalError) as error:
            one_line(error)
            return "without a run"
    return "used"


@cheap(60)
@given(st.sampled_from(STARTS), st.lists(mutations, min_size=1, max_size=4))
def test_any_vehicle_file_is_used_or_refused(start, changes):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "mutant.toml"
        path.write_text(toml(mutate(copy.deepcopy(start), changes)), encoding="utf-8")
        event(exercise(path))  # pytest --hypothesis-show-statistics tells how many came how far


# studies


STUDIES = [
    tomllib.loads(EXAMPLE),
    {
        "study": "critical-speed",
        "vehicle": "coach",
        "design": "sobol",
        "samples": 8,
        "seed": 1,
        "over": {"primary.stiffness_x_MN_per_m": {"from": 2, "to": 5, "scale": "log"}, "contact": {"conicity": {"from": 0.1, "to": 0.2}}},
    },
    {
        "study": "ride-comfort",
        "vehicle": "coach",
        "design": "points",
        "speed_kmh": 200,
        "track": {"kind": "random", "spectrum": "fra-5", "seed": 3, "length_m": 2000},
        "damper": {"kind": "hybrid", "alpha": 0.3},
        "over": {"damper.alpha": [0.2, 0.5], "primary.damping_y_kNs_per_m": [3, 4]},
    },
]  # fmt: skip


@cheap(120)
@given(st.sampled_from(STUDIES), st.lists(mutations, min_size=1, max_size=3))
def test_any_study_file_is_read_or_refused(start, changes):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "study.toml"
        path.write_text(toml(mutate(copy.deepcopy(start), changes)), encoding="utf-8")
        try:
            found = read_study(path)
            design = make_design(found["over"], found["design"], found.get("samples"), found.get("seed", 0))
        except railjax.InputError as error:
            one_line(error)
            event("refused")
            return
        assert design.size >= 1
        assert all(np.all(np.isfinite(column)) for column in design.columns)
        event("read")


# CSV files


def record(columns, rows=600):
    """A sound CSV file of a header and rows."""
    t = np.arange(rows) * 5e-3
    values = np.column_stack([t if k == 0 else np.sin(7.0 * t + k) * 1e-2 for k in range(len(columns))])
    return ",".join(columns) + "\n" + "\n".join(",".join(f"{value:.6g}" for value in row) for row in values) + "\n"


def comfort_reader(path):
    from railjax.ride.rides import read_ride

    ride = read_ride(path)
    return [*ride.values.values(), ride.rate]


def damper_reader(path):
    found = railjax.read_record(path)
    return [found.displacement, found.velocity, found.command, found.force, found.dt]


def track_reader(path):
    return [railjax.MeasuredTrack.from_csv(path).coefficients]


def spectrum_reader(path):
    found = railjax.TableSpectrum.from_csv(path)
    return [found.wavenumber, found.values, railjax.RandomTrack(path, length=2000.0).coefficients]


READERS = {
    "comfort": (comfort_reader, record(["time (s)", "lateral (m/s2)", "vertical (m/s2)"])),
    "damper": (damper_reader, record(["time (s)", "displacement (m)", "command (V)", "force (kN)"])),
    "track": (track_reader, record(["distance (km)", "alignment (m)", "cross level (mm)"])),
    "spectrum": (
        spectrum_reader,
        "wavenumber (rad/m),density (m^2/(rad/m))\n" + "".join(f"{0.02 * 1.2**k:.5g},{1e-6 / 1.3**k:.5g}\n" for k in range(30)),
    ),
}
JUNK = st.one_of(
    st.binary(max_size=40),
    st.sampled_from(
        [b"", b"\x00", b"\xff\xfe", b'"', b'""', b"'", b",", b";", b"\t", b"\r", b"\n", b"\r\n\r\n", b"nan", b"inf", b"-inf", b"1e999", b"-", b"--"]
        + [b"1,5", b"1.5.5", b"1e400", b"0x10", b"1_000", b"\xc2\xb5", "٣".encode(), b"9" * 5000, b"x" * 200_000, b'"' + b"\n" * 50, b"=1+1", b"\xef\xbb\xbf"]
        + [code.encode() for code in CODE]
    ),
)  # fmt: skip
EDITS = st.lists(
    st.tuples(
        st.sampled_from(["insert", "replace", "cut", "cell", "line", "points", "swap"]), st.floats(0, 1), st.floats(0, 0.05), JUNK
    ),
    min_size=1,
    max_size=4,
)


def edited(data, edits):
    for kind, where, width, junk in edits:
        at = int(where * len(data))
        end = at + int(width * len(data))
        if kind == "insert":
            data = data[:at] + junk + data[at:]
        elif kind == "replace":
            data = data[:at] + junk + data[end:]
        elif kind == "cut":
            data = data[:at]
        elif kind == "points":
            data = data[:at] + data[at:].replace(b".", b",") if where > 0.5 else data.replace(b",", b";").replace(b".", b",")
        elif kind == "line":
            lines = data.split(b"\n")
            lines.insert(int(where * len(lines)), junk)
            data = b"\n".join(lines)
        elif kind == "swap":
            lines = data.split(b"\n")
            lines.insert(int(where * len(lines)), lines[int((1 - where) * (len(lines) - 1))])
            data = b"\n".join(lines)
        else:
            cells = data.split(b",")
            cells[int(where * (len(cells) - 1))] = junk
            data = b",".join(cells)
    return data


@pytest.mark.parametrize("kind", READERS)
def test_the_sound_files_are_read(tmp_path, kind):
    reader, text = READERS[kind]
    (tmp_path / "sound.csv").write_text(text)
    assert all(np.all(np.isfinite(values)) for values in reader(tmp_path / "sound.csv"))


@pytest.mark.parametrize("kind", READERS)
@cheap(60)
@given(edits=EDITS)
def test_any_csv_file_is_read_or_refused(kind, edits):
    reader, text = READERS[kind]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "junk.csv"
        path.write_bytes(edited(text.encode(), edits))
        try:
            found = reader(path)
        except railjax.InputError as error:
            one_line(error)
            event("refused")
            return
        assert all(np.all(np.isfinite(values)) for values in found)
        event("read")


# nothing is evaluated


@pytest.mark.parametrize("code", CODE)
def test_code_in_a_file_stays_text(tmp_path, monkeypatch, capsys, code):
    monkeypatch.chdir(tmp_path)
    quoted = toml({"x": code}).split(" = ", 1)[1]
    files = {
        "number.toml": f'base = "coach"\n[carbody]\nmass_kg = {quoted}',
        "base.toml": f"base = {quoted}",
        "pattern.toml": f'base = "coach"\n[geometry]\naxle_pattern = [{quoted.strip()}]',
        "study.toml": f'study = {quoted}vehicle = "coach"\n[over]\nconicity = [1]',
        "vehicle.toml": f'study = "critical-speed"\nvehicle = {quoted}[over]\n"contact.conicity" = [1]',
        "over.toml": f'study = "critical-speed"\nvehicle = "coach"\n[over]\n"contact.conicity" = [{quoted.strip()}]',
        "track.csv": "distance (m),alignment (m)\n" + "".join(f'{k},"{code}"\n' for k in range(20)),
    }
    for name, text in files.items():
        Path(name).write_text(text, encoding="utf-8")
    calls = [
        *(["check", name] for name in ("number.toml", "base.toml", "pattern.toml")),
        *(["sweep", name, "--out", "out.zarr"] for name in ("study.toml", "vehicle.toml", "over.toml")),
        ["simulate", "coach", "--track", "track.csv"],
        ["modes", code],
        ["tune", "coach", "--parameter", f"contact.conicity={code}"],
    ]
    for call in calls:
        assert status(call) == 2, call
        out, error = capsys.readouterr()
        assert (out, len(error.splitlines())) == ("", 1), call
    Path("label.toml").write_text(f'base = "coach"\nname = {quoted}note = {quoted}')
    vehicle = railjax.load_vehicle("label.toml")
    assert (vehicle.name, vehicle.note) == (code, code)
    assert {path.name for path in tmp_path.iterdir()} == {*files, "label.toml"}
