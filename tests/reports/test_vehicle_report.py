"""The report on a vehicle: its numbers against other ways to them, what it does where a section fails, the page in Chromium."""

import json
import re

import numpy as np
import pytest
from chromium import looked_at, needs_chromium, well_made
from markupsafe import Markup

import railjax
from railjax.cli.application import status
from railjax.model.parameters import parameters
from railjax.reports.paper.page import render
from railjax.reports.vehicle.page import Section, bullets, figure, marked, page, paragraph, table
from railjax.reports.vehicle.sections import ride as report_ride
from railjax.reports.vehicle.sections.vehicle import shown
from railjax.reports.vehicle.vehicle_report import SECTIONS
from railjax.stability.hunting.sensitivity import changes, counted, fold_gradient

#: exponents of mass, length and time in the units of parameters
DIMENSIONS = {
    "kg": (1, 0, 0),
    "kg m^2": (1, 2, 0),
    "m": (0, 1, 0),
    "m/s": (0, 1, -1),
    "N": (1, 1, -2),
    "N m": (1, 2, -2),
    "N m^2": (1, 3, -2),
    "N/m": (1, 0, -2),
    "N s/m": (1, 0, -1),
    "N m/rad": (1, 2, -2),
    "1": (0, 0, 0),
}


@pytest.fixture(scope="module")
def wheelset():
    return railjax.load_vehicle("single-wheelset")


@pytest.fixture(scope="module")
def steps():
    return []


@pytest.fixture(scope="module")
def made(wheelset, steps):
    return railjax.vehicle_report(wheelset, progress=lambda *step: steps.append(step))


@pytest.fixture(scope="module")
def branch(wheelset):
    return railjax.hunting_branch(wheelset)


def test_every_section_is_there_or_says_why_not(made, steps):
    assert made.failed == {}
    assert set(made.absent) == {"comfort", "dampers"}
    assert set(made.content["sections"]) | set(made.absent) == set(SECTIONS)
    for slug in SECTIONS:
        assert f'<section id="{slug}">' in made.html
        assert f'href="#{slug}"' in made.html
    for reason in made.absent.values():
        assert f'<p class="absent">{reason}</p>' in made.html
        assert len(reason.splitlines()) == 1
    assert [step[1:] for step in steps] == [(k, len(SECTIONS)) for k in range(len(SECTIONS) + 1)]
    json.dumps(made.content, allow_nan=False)
    assert "117.9 km/h" in str(made)


def test_numbers_are_those_of_the_functions(made, wheelset, branch):
    sections = made.content["sections"]
    critical = sections["critical-speeds"]
    assert critical["linear_kmh"] == pytest.approx(float(railjax.linear_critical_speed(wheelset)) * 3.6, rel=1e-9)
    assert critical["nonlinear_kmh"] == pytest.approx(117.906, abs=1e-3)
    assert critical["fold_amplitude_mm"] == pytest.approx(8.282, abs=2e-3)
    assert made.content["speed_kmh"] == pytest.approx(round(0.75 * critical["linear_kmh"], -1))
    values = np.linalg.eigvals(np.asarray(railjax.state_matrix(wheelset, made.content["speed_kmh"] / 3.6)))
    found = [mode["growth_per_s"] for mode in sections["modes"]["modes"]]
    np.testing.assert_allclose(sorted(found), sorted(values[values.imag >= 0].real), rtol=1e-9)
    # the locus crosses zero at the critical speed
    hunting = np.max([mode["growth_per_s"] for mode in sections["root-locus"]["modes"]], axis=0)
    first = int(np.argmax(hunting > 0.0))
    around = slice(first - 1, first + 1)
    crossing = np.interp(0.0, hunting[around], sections["root-locus"]["speeds_kmh"][around])
    assert crossing == pytest.approx(critical["linear_kmh"], abs=0.3)
    diagram = sections["bifurcation"]["branch"]
    np.testing.assert_allclose([point["speed_kmh"] for point in diagram], branch.speed * 3.6, rtol=1e-9)
    assert [point["stable"] for point in diagram] == branch.stable.tolist()
    values = sections["parameters"]["si"]
    assert values["wheelset.mass"] == 1250.0
    assert "bogie.mass" not in values


def test_gradients_of_both_critical_speeds_obey_dimensional_analysis(made, wheelset, branch):
    """v is a speed: with all masses (lengths, times) in other units it changes like one. Euler's theorem for each of the three."""
    sensitivity = made.content["sections"]["sensitivity"]["change_kmh_per_10_percent"]
    nonlinear = fold_gradient(branch)
    euler = np.zeros(3)
    for path, entry in parameters(wheelset):
        value = float(railjax.get_parameter(branch.model.vehicle, path))
        euler += np.array(DIMENSIONS[entry.metadata["unit"]]) * value * float(railjax.get_parameter(nonlinear, path))
    np.testing.assert_allclose(euler / branch.fold.speed, [0.0, 1.0, -1.0], atol=1e-4)
    assert sensitivity["nonlinear critical speed"] == pytest.approx(changes(wheelset, nonlinear), rel=1e-6, abs=1e-9)
    # the linear one, of the values that are not zero; nothing else has a part in it
    units = {path: entry.metadata["unit"] for path, entry in parameters(wheelset)}
    euler = np.zeros(3)
    for path, value in counted(wheelset).items():
        if value:
            euler += np.array(DIMENSIONS[units[path]]) * sensitivity["linear critical speed"][path] / 0.1
    linear = made.content["sections"]["critical-speeds"]["linear_kmh"]
    np.testing.assert_allclose(euler / linear, [0.0, 1.0, -1.0], atol=1e-6)


def test_the_gradient_at_the_fold_is_that_of_the_fold(wheelset, branch):
    path = "contact.friction"
    value = float(railjax.get_parameter(wheelset, path))
    low, high = (
        railjax.hunting_branch(railjax.set_parameter(wheelset, path, share * value)).fold.speed for share in (0.995, 1.005)
    )
    gradient = float(railjax.get_parameter(fold_gradient(branch), path))
    assert gradient == pytest.approx((high - low) / (0.01 * value), rel=5e-3)


def test_the_page_is_complete_without_anything_else(made):
    assert "http" not in made.html.replace("http://www.w3.org", "")
    assert "<script" not in made.html
    images = re.findall(r"<img [^>]*>", made.html)
    assert len(images) == 4
    for image in images:
        assert 'src="data:image/svg+xml;base64,' in image
        assert re.search('alt="[^"]{20,}"', image)
    assert '<span class="assumed">assumed</span>' in made.html


@needs_chromium
def test_the_page_in_chromium(made, tmp_path):
    well_made(looked_at(made.html, tmp_path), images=4)


@needs_chromium
def test_the_page_of_reproduce_in_chromium(tmp_path):
    quantity = {"name": "a speed", "source": "fig. 1", "unit": "km/h", "fitted": False, "computed": 1.0}
    results = {
        "railjax": "0",
        "jax": "0",
        "summary": "Some.",
        "quantities": [
            {**quantity, "paper": 1.0, "tolerance": 0.1, "within": True},
            {**quantity, "paper": None, "tolerance": None, "within": None},
        ],
        "statements": [{"claim": "long " * 40, "source": "s", "holds": True, "numbers": "1234567890" * 12}],
        "assumptions": ["a" * 300],
        "seconds": {"fig-1": 1.0},
        "peak_memory_mb": {"fig-1": 400.0},
    }
    png = "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwADhgGAWjR9awAAAABJRU5ErkJggg=="
    picture = {"slug": "fig-1", "title": "Fig. 1", "caption": "c", "alternative": "what it shows", "png": png}
    pictures = [{**picture, "section": "figures"}, {**picture, "slug": "further", "section": "beyond"}]
    found = looked_at(render(results, pictures), tmp_path)
    well_made(found, images=2)
    assert "#fig-1" in found["links"]


@needs_chromium
def test_chromium_sees_what_is_wrong_with_a_page(tmp_path):
    wrong = Markup('<div style="width: 800px">x</div><script>nothing()</script>')
    body = figure("f", "", "", "", "data:image/png;base64,broken") + wrong
    found = looked_at(page("t", "h", "", [Section("here", "Here", body, [("nowhere", "Nowhere")])]), tmp_path)
    assert found["images"] == [["", 0]]
    assert found["missing"] == 1
    assert found["scroll"] > found["client"]
    assert any("nothing is not defined" in line for line in found["console"])


def test_texts_are_not_read_as_html():
    made = page(
        "<t>", "<h>", "", [Section('"s', "a & b", paragraph("1 < 2") + bullets(["<b>"]) + table(("A", "B"), [("1", "2")], (1,)))]
    )
    assert "<t>" not in made
    assert "<h>" not in made
    assert "1 &lt; 2" in made
    assert "&lt;b&gt;" in made
    assert "a &amp; b" in made
    assert '<td>1</td><td class="number">2</td>' in made
    cells = table(("A", "B"), [("<i>", marked("no", "<b>"))])
    assert '<td>&lt;i&gt;</td><td><span class="no">&lt;b&gt;</span></td>' in cells
    assert "".join(cells.split()) in "".join(page("t", "h", cells, []).split())


def test_command_line(tmp_path, capsys):
    out = tmp_path / "ride.html"
    code = status(
        ["report", "single-wheelset", "--only", "modes", "--only", "comfort", "--speed-kmh", "100", "--out", str(out), "--json"]
    )
    text, error = capsys.readouterr()
    assert (code, error) == (0, "")
    content = json.loads(text)
    assert content["speed_kmh"] == pytest.approx(100.0)
    assert list(content["sections"]) == ["modes"]
    assert "held" in content["absent"]["comfort"]
    assert "single-wheelset" in out.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--only", "moods"], "no section 'moods'; there are vehicle, modes"),
        (["--track", "erri-middle"], "erri-middle"),
        (["--out", "report.pdf"], "must end in .html"),
        (["--out", "nowhere/report.html"], "there is no folder nowhere"),
        (["--speed-kmh", "-3"], "--speed-kmh must be a positive"),
    ],
)
def test_bad_input_is_refused_in_one_line(arguments, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert status(["report", "single-wheelset", *arguments]) == 2
    out, error = capsys.readouterr()
    assert out == ""
    assert len(error.splitlines()) == 1
    assert message in error
    assert not list(tmp_path.iterdir())


def test_a_failing_section_is_marked_and_the_others_are_kept(tmp_path, capsys):
    """A wheelset on springs so soft that it hunts at walking speed already."""
    path, out = tmp_path / "soft.toml", tmp_path / "soft.html"
    path.write_text('base = "single-wheelset"\n[primary]\nstiffness_x_N_per_m = 1\nstiffness_y_N_per_m = 1\n')
    code = status(["report", str(path), "--only", "modes", "--only", "bifurcation", "--out", str(out), "--json"])
    text, error = capsys.readouterr()
    assert code == 1
    content = json.loads(text)
    assert list(content["sections"]) == ["modes"]
    assert "unstable at 10.8 km/h already" in content["failed"]["bifurcation"]
    assert len(error.splitlines()) == 1
    assert "lacks bifurcation (no linear critical speed" in error
    shown = out.read_text(encoding="utf-8")
    assert '<p class="failed">This section failed: no linear critical speed' in shown
    assert shown.count("<img") == 1


def test_a_vehicle_that_no_speed_makes_hunt(wheelset):
    cylindrical = railjax.replace(wheelset, contact__conicity=1e-6)
    made = railjax.vehicle_report(cylindrical, sections=("modes", "critical-speeds", "bifurcation", "sensitivity"))
    assert made.failed == {}
    assert set(made.absent) == {"bifurcation", "sensitivity"}
    assert "stable up to 540 km/h" in made.absent["bifurcation"]
    assert made.content["sections"]["critical-speeds"]["linear_kmh"] is None


@pytest.mark.parametrize(
    ("value", "unit", "expected"),
    [
        (3.2276e6, "N/m", ("3.2276", "MN/m")),
        (25e3, "N s/m", ("25", "kN s/m")),
        (0.0, "N s/m", ("0", "N s/m")),
        (8.74e-3, "m", ("8.74", "mm")),
        (1.28, "m", ("1.28", "m")),
        (750.0, "kg m^2", ("750", "kg m²")),
        (0.4, "1", ("0.4", "")),
        ([0.025, 0.065], "m", ("25, 65", "mm")),
        ([0.0, 17170.0, 230e3], "N", ("0, 17.17, 230", "kN")),
    ],
)
def test_values_are_shown_as_engineers_write_them(value, unit, expected):
    assert shown(np.array(value), unit) == expected


def test_lanes_are_refused(wheelset):
    many = railjax.replace(wheelset, contact__conicity=np.array([0.1, 0.2]))
    with pytest.raises(railjax.InputError, match="one vehicle"):
        railjax.vehicle_report(many)


def test_simulated_ride_is_near_linear_theory(coach, monkeypatch):
    """Two ways to the passive coach's ride, of one page: frequency domain, and simulation with the nonlinear contact."""
    monkeypatch.setattr(report_ride, "controlled", lambda vehicle: {"balance logic, α = 1": railjax.BalanceLogic(1.0)})
    made = railjax.vehicle_report(coach, sections=("comfort", "dampers"), speed=160.0 / 3.6)
    theory, simulated = (made.content["sections"][slug] for slug in ("comfort", "dampers"))
    at = [int(np.argmin(np.abs(np.array(section["speeds_kmh"]) - 160.0))) for section in (theory, simulated)]
    worst = np.max(theory["weighted_rms"], axis=0)[at[0]]
    assert theory["speeds_kmh"][at[0]] == simulated["speeds_kmh"][at[1]] == pytest.approx(160.0)
    assert simulated["weighted_rms"]["passive"][at[1]] == pytest.approx(worst, rel=0.15)
    assert simulated["weighted_rms"]["balance logic, α = 1"][at[1]] < 0.7 * worst
    assert made.html.count("<img") == 2
