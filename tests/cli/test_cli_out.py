"""`--out`: every verb has it and writes what `--json` prints; tables and pictures beside."""

import csv
import json
import xml.etree.ElementTree as xml

import numpy as np
import pytest
import typer

import railjax
from railjax.cli.application import app

LONE = "single-wheelset"


def verbs(group, before=()):
    for name, verb in group.commands.items():
        yield from verbs(verb, (*before, name)) if hasattr(verb, "commands") else [((*before, name), verb)]


@pytest.mark.parametrize(
    ("words", "verb"), [pytest.param(*found, id=" ".join(found[0])) for found in verbs(typer.main.get_command(app))]
)
def test_every_verb_has_it(words, verb):
    options = {option for parameter in verb.params for option in parameter.opts}
    assert "--json" in options
    assert "--out" in options or words == ("vehicles", "new")  # whose argument is the file that it writes


@pytest.mark.parametrize(
    "words",
    [
        ["vehicles"],
        ["check", LONE],
        ["modes", LONE, "--speed-kmh", "100"],
        ["critical-speed", LONE],
        ["simulate", LONE, "--speed-kmh", "100", "--duration-s", "0.2", "--record", "wheelset_y"],
        ["damper", "design"],
    ],
    ids=" ".join,
)
def test_the_object_in_a_file(run, tmp_path, words):
    out = tmp_path / "found.json"
    code, text, error = run(*words, "--json", "--out", out)
    assert (code, error) == (0, "")
    assert json.loads(out.read_text()) == json.loads(text)


def test_errors_of_a_vehicle_in_a_file(run, tmp_path):
    out = tmp_path / "found.json"
    code, text, error = run("check", tmp_path / "none.toml", "--out", out)
    assert (code, text) == (2, "")
    assert json.loads(out.read_text())["errors"][0] in error


def test_table_of_modes(run, tmp_path):
    out = tmp_path / "modes.csv"
    assert run("modes", "coach", "--speed-kmh", "200", "--out", out)[0] == 0
    with out.open() as file:
        rows = list(csv.DictReader(file))
    found = railjax.modes(railjax.load_vehicle("coach"), 200 / 3.6)
    assert [row["name"] for row in rows] == list(found.names)
    np.testing.assert_allclose([float(row["frequency_hz"]) for row in rows], found.frequency, rtol=1e-12)
    np.testing.assert_allclose([float(row["growth_per_s"]) for row in rows], found.eigenvalues.real, rtol=1e-12)


def words_of(picture):
    """matplotlib draws letters as outlines and leaves the text in comments."""
    parser = xml.XMLParser(target=xml.TreeBuilder(insert_comments=True))
    return [node.text.strip() for node in xml.parse(picture, parser).iter() if node.tag is xml.Comment]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["modes", LONE, "--speed-kmh", "100"], ["damping ratio, %", "speed, km/h"]),
        (["critical-speed", LONE], ["damping ratio, %", "linear critical speed, {critical:.1f} km/h"]),
        (
            ["comfort", "ride.csv", "--fs", "100", "--unit", "m/s2", "--no-mean-comfort"],
            ["weighted r.m.s. of 5 s, m/s²", "third octave, Hz", "lateral (Wd)"],
        ),
    ],
    ids=["modes", "critical-speed", "comfort"],
)
def test_pictures(run, tmp_path, monkeypatch, words, expected):
    monkeypatch.chdir(tmp_path)
    np.savetxt("ride.csv", np.random.default_rng(2).normal(size=2000), header="lateral", comments="")
    code, _, error = run(*words, "--out", "found.svg")
    assert (code, error) == (0, "")
    found, critical = words_of("found.svg"), float(railjax.linear_critical_speed(railjax.load_vehicle(LONE))) * 3.6
    assert [text for text in expected if text.format(critical=critical) not in found] == []


@pytest.mark.parametrize(
    ("out", "words"),
    [("found.pdf", ".csv, .png, .svg or .json"), ("found", "must end in"), ("nowhere/found.csv", "cannot be written")],
)
def test_refused_before_the_work(run, out, words):
    code, text, error = run("modes", "no such vehicle", "--out", out)
    assert (code, text) == (2, "")
    assert error.startswith(f"railjax: --out {out}: ")
    assert words in error
