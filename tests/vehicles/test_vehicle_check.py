"""A vehicle file of one's own: written with every key, checked, completed by the shell; Ctrl-C says what is kept."""

import dataclasses
import json
import math
import os
import re
import signal
import subprocess
import sys
import time
import tomllib
import typing

import jax
import numpy as np
import pytest

import railjax
from railjax.cli.application import app, status
from railjax.model.vehicle import PARTS
from railjax.vehicles.ranges import RANGES, Remark


def written(tmp_path, text, name="mine"):
    path = tmp_path / f"{name}.toml"
    path.write_text(text, encoding="utf-8")
    return path


# a file with every key


@pytest.mark.parametrize("name", railjax.packaged_vehicles())
def test_a_written_vehicle_loads_to_the_same(tmp_path, name):
    vehicle = railjax.load_vehicle(name)
    again = railjax.load_vehicle(written(tmp_path, railjax.vehicle_toml(vehicle, name=name)))
    again = dataclasses.replace(again, note=vehicle.note)
    assert jax.tree.structure(again) == jax.tree.structure(vehicle)  # with names, provenance, optional parts
    for one, other in zip(jax.tree.leaves(again), jax.tree.leaves(vehicle), strict=True):
        np.testing.assert_array_equal(one, other)


def test_every_key_is_there_with_its_symbol_and_meaning(coach):
    lines = railjax.vehicle_toml(coach, name="coach").splitlines()
    for part, kind in PARTS.items():
        start = next(k for k, line in enumerate(lines) if line.lstrip("# ") == f"[{part}]")
        end = next((k for k in range(start + 1, len(lines)) if lines[k].lstrip("# ").startswith("[")), len(lines))
        for field in dataclasses.fields(kind):
            spelled = re.compile(rf"(# )?{field.name}(_[A-Za-z0-9_]+)? = ?.*# .*{re.escape(field.metadata['meaning'])}")
            (found,) = [line for line in lines[start + 1 : end] if spelled.match(line)]
            symbol = field.metadata.get("symbol")
            assert not symbol or f"# {symbol}: " in found
    assert "(calibrated)" in next(line for line in lines if line.startswith("friction"))


def test_what_a_file_switches_off_is_toml_when_it_is_filled_in(tmp_path, coach):
    text = railjax.vehicle_toml(coach, name="mine")
    text = re.sub(r"^# (\[yaw_damper\])", r"\1", text, flags=re.MULTILINE)
    for key, value in {"damping_kNs_per_m": 300, "half_distance_m": 1.35}.items():
        before, after = text.split("[yaw_damper]")
        text = before + "[yaw_damper]" + after.replace(f"# {key} =", f"{key} = {value}", 1)
    assert railjax.load_vehicle(written(tmp_path, text)).yaw_damper == railjax.YawDamper(3e5, 1.35)


def test_a_mark_ends_with_the_value_that_it_is_about(tmp_path, coach):
    text = railjax.vehicle_toml(coach, name="mine")
    assert "friction = 0.412426" in text
    changed = railjax.load_vehicle(written(tmp_path, text.replace("friction = 0.412426", "friction = 0.3")))
    marks = {entry.parameter: entry.status for entry in changed.provenance}
    assert "contact.friction" not in marks
    assert marks["contact.flange_clearance"] == "calibrated"
    with pytest.raises(railjax.InputError, match=r'provenance."carbody.mass".value must be a number'):
        railjax.load_vehicle(
            written(tmp_path, 'base = "coach"\n[provenance]\n"carbody.mass" = { status = "assumed", value = "3" }')
        )


def test_vehicles_new(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, error = run("vehicles", "new", "my.toml", "--from", "coach")
    assert (code, error) == (0, "")
    assert "railjax check my.toml" in out
    tables = tomllib.loads((tmp_path / "my.toml").read_text(encoding="utf-8"))
    assert tables["name"] == "my"
    assert "coach" in tables["source"]
    assert "Table 1" in tables["source"]  # of the base of coach
    before = (tmp_path / "my.toml").read_bytes()
    code, out, error = run("vehicles", "new", "my.toml", "--from", "crh380a")
    assert (code, out) == (2, "")
    assert "--force" in error
    assert (tmp_path / "my.toml").read_bytes() == before
    code, out, _ = run("vehicles", "new", "my.toml", "--from", "crh380a", "--force", "--json")
    assert (code, json.loads(out)) == (0, {"file": "my.toml", "from": "crh380a"})
    assert railjax.load_vehicle("my.toml").yaw_damper is not None
    # from a file of one's own, and what cannot be
    assert run("vehicles", "new", "second.toml", "--from", "my.toml")[0] == 0
    for arguments, piece in (
        (["third.txt"], "must end in .toml"),
        (["nowhere/third.toml"], "cannot be written (No such file or directory)"),
        (["third.toml", "--from", "koach"], "did you mean 'coach'?"),
    ):
        code, out, error = run("vehicles", "new", *arguments)
        assert (code, out, len(error.splitlines())) == (2, "", 1)
        assert piece in error
    assert {path.name for path in tmp_path.iterdir()} == {"my.toml", "second.toml"}


# what is wrong


def test_all_faults_of_a_file_are_told_at_once(run, tmp_path):
    path = written(
        tmp_path,
        'base = "coach"\ngyroscopic = 1\n[primary]\nstifness_z_kN_per_m = 904\nstiffness_x_kN = 3\n[carbody]\nmass_kg = -5\n'
        '[contact]\nfriction = nan\n[provenance]\n"a.b" = 3\n',
    )
    code, out, error = run("check", path)
    assert (code, out) == (2, "")
    expected = (
        "gyroscopic must be",
        "did you mean primary.stiffness_z",
        "must name its unit",
        "must be positive",
        "finite",
        "no parameter",
    )
    for line, piece in zip(error.splitlines(), expected, strict=True):
        assert line.startswith("railjax: ")
        assert piece in line
    code, out, error = run("check", path, "--json")
    assert code == 2
    assert [f"railjax: {message}" for message in json.loads(out)["errors"]] == error.splitlines()
    missing = run("check", written(tmp_path, "[carbody]\nmass_t = 30"))[2]
    assert "missing key carbody.roll_inertia_kgm2" in missing
    assert "missing key contact.conicity" in missing
    assert "carbody.mass" not in missing


# what is doubtful


@pytest.mark.parametrize("name", railjax.packaged_vehicles())
def test_packaged_vehicles_are_plausible(name):
    found = railjax.check_vehicle(railjax.load_vehicle(name), dynamics=False)
    expected = {"contact.creep_lateral_spin", "contact.creep_spin"} if name in ("coach", "coach-table1") else set()
    assert {entry.key for entry in found.warnings} == expected, str(found)
    assert all(math.isfinite(entry.value) for entry in (*found.parameters, *found.derived))


def test_ranges_are_of_parameters():
    known = {f"{part}.{field.name}" for part, kind in PARTS.items() for field in dataclasses.fields(kind)}
    assert set(RANGES) <= known
    assert all(0 <= low < high or (low < 0 and "bogie_to" in path) for path, (low, high, _) in RANGES.items())


def test_what_follows_from_the_values(coach):
    """By hand: c-g-s of the paper's coach."""
    derived = {entry.meaning: entry.value for entry in railjax.check_vehicle(coach, dynamics=False).derived}
    load, mass = 51250.0, 30760.0 + 2 * 2300.0 + 4 * 1410.0
    assert derived["axle load"] == pytest.approx(2 * load / 9.81)
    assert derived["weight of the masses over the wheels' load"] == pytest.approx(mass * 9.81 / (8 * load))
    assert derived["static deflection of the primary springs"] == pytest.approx((load - 705.0 * 9.81) / 904e3)
    above = 4 * load - (2 * 1410.0 + 2300.0) * 9.81
    assert derived["static deflection of the secondary springs"] == pytest.approx(above / (2 * 473e3))
    assert derived["radius of gyration of carbody, yaw"] == pytest.approx(math.sqrt(1661732.0 / 30760.0))
    # yaw of the car body alone: 4 corners at l = 8.6 m (sideways) and d_c = 1 m (along)
    stiffness, damping = 4 * 133e3 * (8.6**2 + 1.0), 4 * 25e3 * 8.6**2
    frequency = math.sqrt(stiffness / 1661732.0)
    assert derived["natural frequency of the car body's yaw"] == pytest.approx(frequency / (2 * math.pi), rel=1e-9)
    assert derived["damping ratio of the car body's yaw"] == pytest.approx(damping / (2 * 1661732.0 * frequency), rel=1e-9)


@pytest.mark.parametrize(
    ("text", "key", "pieces"),
    [
        ("[primary]\nstiffness_z_N_per_m = 904", "primary.stiffness_z", ["904 N/m", "a thousand times too small? look at the unit"]),
        ("[bogie]\nmass_t = 2300", "bogie.mass", ["2300 t", "a thousand times too large? look at the unit"]),
        ("[secondary]\nstiffness_z_kN_per_m = 60", "secondary.stiffness_z", ["static deflection of the secondary springs 1.29 m", "10 mm to 700 mm"]),
        ("[contact]\nflange_clearance_mm = 90", "contact.flange_clearance", ["90 mm", "2 mm to 20 mm", "1435 mm gauge"]),
        ("[contact]\nconicity = 1.4", "contact.conicity", ["1.4", "0.01 to 0.6"]),
        ("[carbody]\nmass_t = 45", "contact.wheel_load", ["weight of the masses over the wheels' load"]),
        ("[carbody]\nyaw_inertia_kgm2 = 1661", "carbody.yaw_inertia", ["radius of gyration", "1.5 m to 12 m"]),
        ("[secondary]\ndamping_y_kNs_per_m = 0", "secondary", ["damping ratio of the car body's yaw"]),
        ("[contact]\ncreep_lateral_kN = 10.25", "contact.creep_lateral", ["over Kalker's 0.0012"]),
        ("[bump_stop]\ntravel_m = [20, 30]\nforce_kN = [0, 5]", "bump_stop.travel", ["last travel 30 m", "a thousand times too large"]),
        (
            "[lateral_damper]\nblow_off_velocity_mm_per_s = 10\ndamping_beyond_kNs_per_m = 0.1",
            "lateral_damper.blow_off_width",
            ["rounding of the blow-off"],
        ),
    ],
)  # fmt: skip
def test_doubtful_values_are_told_with_range_and_reason(tmp_path, text, key, pieces):
    found = railjax.check_vehicle(railjax.load_vehicle(written(tmp_path, f'base = "coach"\n{text}\n')), dynamics=False)
    told = " | ".join(str(entry) for entry in found.warnings if entry.key == key)
    for piece in pieces:
        assert piece in told


def test_a_yaw_damper_that_opens_for_good_passes(tmp_path):
    text = 'base = "coach"\n[yaw_damper]\nhalf_distance_m = 1.3\ndamping_kNs_per_m = 300\nblow_off_velocity_mm_per_s = 10\ndamping_beyond_kNs_per_m = 0\n'
    found = railjax.check_vehicle(railjax.load_vehicle(written(tmp_path, text)), dynamics=False)
    assert not [entry for entry in found.warnings if entry.key.startswith("yaw_damper")]


def test_a_finding_tells_its_range():
    high = Remark("a.b", "what", 1200.0, -math.inf, 0.0, "1/s", "why")
    assert high.doubtful
    assert str(high) == "a.b: what 1200 1/s, plausible at most 0 1/s: why"
    assert Remark("a.b", "what", math.nan, 0.0, 1.0, "m", "why").doubtful
    assert not Remark("a.b", "what", 0.02, 0.01, math.inf, "m", "why").doubtful


def test_check_on_the_command_line(run, tmp_path):
    code, out, error = run("check", "coach-table1", "--json")
    assert (code, error) == (0, "")
    content = json.loads(out, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    assert content["errors"] == []
    (slow,) = [entry for entry in content["warnings"] if entry["key"] == "vehicle"]
    assert slow["value"] == pytest.approx(65.24, abs=0.1)
    assert (slow["low"], slow["high"]) == (90.0, None)
    step = next(entry["value"] for entry in content["derived"] if "RK4" in entry["meaning"])
    # what it says is what simulate does
    literal = railjax.load_vehicle("coach-table1")
    railjax.simulate(literal, 1.01 * step / 3.6, duration=2e-3, dt=1e-3)
    with pytest.raises(railjax.InputError, match="too large for RK4"):
        railjax.simulate(literal, 0.99 * step / 3.6, duration=2e-3, dt=1e-3)
    # nothing guides the wheelsets of this one; the structure is the same, so nothing is compiled again
    path = written(tmp_path, 'base = "coach"\n[primary]\nstiffness_x_N_per_m = 0\nstiffness_y_N_per_m = 0\n')
    code, out, _ = run("check", path)
    assert code == 0
    assert "growth of the least damped mode at" in out
    assert "linear critical speed" not in out


def test_a_vehicle_with_lanes_is_not_checked(coach):
    with pytest.raises(railjax.InputError, match="has lanes"):
        railjax.check_vehicle(railjax.replace(coach, carbody__mass=np.array([3e4, 4e4])))


# completion and Ctrl-C, as processes


def process(*arguments, **environment):
    command = [sys.executable, "-m", "railjax.cli", *arguments]
    return subprocess.run(command, capture_output=True, text=True, env={**os.environ, **environment}, check=False)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("railjax critical-speed coach-", ["coach-mpe2019", "coach-s1002", "coach-table1"]),
        ("railjax simulate coach --damper skyhook", ["skyhook", "skyhook-continuous"]),
        ("railjax acceptance coach --track err", ["erri-low", "erri-high"]),
        ("railjax ve", ["vehicles"]),
        ("railjax vehicles ne", ["new"]),
        ("railjax hunting mine", []),  # the shell offers files
    ],
)
def test_the_shell_completes(capsys, monkeypatch, words, expected):
    monkeypatch.setenv("_RAILJAX_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", words)
    monkeypatch.setenv("COMP_CWORD", str(len(words.split()) - 1))
    with pytest.raises(SystemExit) as end:
        status([])
    assert end.value.code == 0
    assert capsys.readouterr().out.split() == expected


def test_the_shell_gets_its_script():
    found = process(_RAILJAX_COMPLETE="source_bash")
    assert found.returncode == 0
    assert "complete -o default" in found.stdout
    assert "_RAILJAX_COMPLETE=complete_bash" in found.stdout


def test_ctrl_c_says_what_is_kept(tmp_path):
    out = tmp_path / "results"
    started = subprocess.Popen(
        [sys.executable, "-m", "railjax.cli", "reproduce", "--out", str(out)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    for _ in range(600):
        if (out / "parts").is_dir() or started.poll() is not None:
            break
        time.sleep(0.1)
    time.sleep(0.3)
    started.send_signal(signal.SIGINT)
    text, error = started.communicate(timeout=120)  # the compiler is not interrupted
    assert started.returncode == 130
    assert text == ""
    assert error == f"railjax: stopped; finished parts are kept in {out}, and the same command goes on there\n"


@pytest.mark.parametrize("verb", ["modes", "check"])
def test_ctrl_c_elsewhere_is_one_line(verb, capsys, monkeypatch):
    from railjax.cli import common as cli_common

    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(cli_common, "load", stop)
    monkeypatch.setattr("railjax.cli.verbs.stability.load", stop)
    assert status([verb, "coach"]) == 130
    assert capsys.readouterr() == ("", "railjax: stopped\n")


# every verb


def commands(group=app, path="railjax"):
    """Each verb with its function."""
    found = []
    for entry in group.registered_commands:
        found.append((f"{path} {entry.name or entry.callback.__name__.replace('_', '-')}", entry.callback))
    for entry in group.registered_groups:
        found += commands(entry.typer_instance, f"{path} {entry.name}")
    return found


UNITS = (
    "_kmh", "_m", "_mm", "_s", "_hz", "_n", "_mm_per_s", "_bar", "_a", "_ka_per_m", "_kpa", "_pa_s", "_t",
)  # fmt: skip
DIMENSIONLESS = {
    "alpha",
    "friction",
    "inclination",
    "prudhomme_factor",
    "sperling_exponent",
    "sperling_power",
    "fit_share",
    "slow",
    "travel_ratio",
    "magnified",
}


def test_every_verb_of_the_design_is_there():
    found = {name.split()[1] for name, _ in commands()}
    assert found >= {
        "vehicles", "modes", "critical-speed", "hunting", "simulate", "sweep", "comfort", "tune", "damper", "acceptance", "reproduce", "check",
    }  # fmt: skip


@pytest.mark.parametrize(("name", "function"), commands(), ids=[name for name, _ in commands()])
def test_every_verb_has_an_example_json_and_units(name, function):
    assert f"Example: {name.removesuffix(' list')}" in " ".join(function.__doc__.split())
    options = typing.get_type_hints(function, include_extras=True)
    options.pop("return")
    told = {option: hint.__metadata__[0] for option, hint in options.items()}
    # of Annotated options typer takes the first spelling for the default
    spellings = {
        option: [text for text in (info.default, *(info.param_decls or ())) if isinstance(text, str)]
        for option, info in told.items()
    }
    assert "--json" in spellings["as_json"]
    for option, hint in options.items():
        kind = hint.__origin__
        assert told[option].help, option
        spelled = [option, *(text.replace("-", "_") for text in spellings[option])]
        if float in (kind, *typing.get_args(kind)):
            assert option in DIMENSIONLESS or any(text.endswith(UNITS) for text in spelled), option
