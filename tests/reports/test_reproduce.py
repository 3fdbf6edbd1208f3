"""The frame of `railjax reproduce`: what it writes, what it keeps, what it makes anew."""

import json
import re
import shutil

import jax
import pytest

import railjax
from railjax.base.source import PACKAGE, digest_of_source
from railjax.base.style import figure
from railjax.reports.paper import reproduce as frame
from railjax.reports.paper.page import render
from railjax.reports.paper.study import Compared, Outcome, Picture, Statement, Study

PNG = b"\x89PNG"


@pytest.fixture(autouse=True)
def _remembers(monkeypatch):
    """Other tests use what is compiled."""
    for name in ("forget_compiled", "return_memory"):
        monkeypatch.setattr(frame, name, lambda: None)


class Fake:
    """A study that counts its runs and can be told to fail."""

    def __init__(self, name, fitted=False, computed=2.0, beyond=False):
        self.name, self.fitted, self.computed, self.runs, self.fails = name, fitted, computed, 0, False
        self.beyond = beyond

    def __call__(self, context):
        assert context.coach.name == "coach"
        assert context.literal.name == "coach-table1"
        self.runs += 1
        if self.fails:
            raise RuntimeError("stopped here")
        with figure(height=1.0) as (page, axes):
            axes[0, 0].plot([0, 1])
        return Outcome(
            [Compared(f"speed of {self.name}", "fig. 1", 2.1, self.computed, "km/h", self.fitted, 0.2)],
            [Statement(f"{self.name} < 3", "section 1", True, "2 & 3")],
            [Picture(self.name, f"Title of {self.name}", "a caption", f'what "{self.name}" shows', page)],
            ["the same assumption"],
        )


@pytest.fixture
def fakes(monkeypatch):
    return known(monkeypatch, Fake("first"), Fake("second", fitted=True))


def known(monkeypatch, *fakes):
    """Makes these the only studies there are."""
    monkeypatch.setattr(frame, "studies", lambda: [Study(fake.name, fake.name.title(), fake, fake.beyond) for fake in fakes])
    return list(fakes)


def runs(fakes):
    return [fake.runs for fake in fakes]


def test_writes_report_figures_and_results(fakes, tmp_path):
    seen = []
    returned = frame.reproduce(tmp_path / "out", progress=lambda *step: seen.append(step))
    results = json.loads((tmp_path / "out" / "results.json").read_text())
    assert results == returned
    assert results["quantities"] == [
        {
            "name": f"speed of {name}",
            "source": "fig. 1",
            "paper": 2.1,
            "computed": 2.0,
            "unit": "km/h",
            "fitted": fitted,
            "tolerance": 0.2,
            "within": True,
        }
        for name, fitted in (("first", False), ("second", True))
    ]
    assert results["assumptions"] == ["the same assumption"]
    assert results["summary"].startswith("1 of 1 predicted quantities lie within their tolerance, 1 more was fitted; 2 of 2")
    for name in ("first", "second"):
        assert (tmp_path / "out" / "figures" / f"{name}.png").read_bytes().startswith(PNG)
    assert seen == [("First", 0, 2), ("Second", 1, 2), ("report", 2, 2)]


def test_a_second_call_keeps_finished_parts(fakes, tmp_path):
    first = frame.reproduce(tmp_path)
    assert frame.reproduce(tmp_path) == first
    assert runs(fakes) == [1, 1]
    frame.reproduce(tmp_path, fresh=True)
    assert runs(fakes) == [2, 2]


def test_only_runs_what_is_named(fakes, tmp_path):
    results = frame.reproduce(tmp_path, only=["second"])
    assert runs(fakes) == [0, 1]
    assert results["figures"] == ["second"]
    frame.reproduce(tmp_path)
    assert runs(fakes) == [1, 1]


def test_what_goes_beyond_the_paper_is_made_when_asked_for_and_kept(monkeypatch, tmp_path):
    fakes = known(monkeypatch, Fake("first"), Fake("further", beyond=True), Fake("last"))
    seen = []
    results = frame.reproduce(tmp_path, progress=lambda *step: seen.append(step))
    assert runs(fakes) == [1, 0, 1]
    assert results["figures"] == ["first", "last"]
    assert seen == [("First", 0, 2), ("Last", 1, 2), ("report", 2, 2)]
    assert 'id="beyond"' not in (tmp_path / "report.html").read_text(encoding="utf-8")
    results = frame.reproduce(tmp_path, beyond=True)
    assert runs(fakes) == [1, 1, 1]
    assert results["figures"] == list(results["seconds"]) == ["first", "further", "last"]
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert page.index('id="last"') < page.index('id="beyond"') < page.index('id="further"')
    # it stays in the report as long as it is of this code
    assert frame.reproduce(tmp_path) == results
    assert frame.reproduce(tmp_path, fresh=True)["figures"] == results["figures"]
    assert runs(fakes) == [2, 1, 2]
    (tmp_path / "figures" / "further.png").unlink()
    assert frame.reproduce(tmp_path)["figures"] == ["first", "last"]
    assert frame.reproduce(tmp_path, only=["further"])["figures"] == ["further"]
    assert runs(fakes) == [2, 2, 2]


def test_says_what_each_study_took(fakes, tmp_path):
    results = frame.reproduce(tmp_path)
    assert list(results["seconds"]) == list(results["peak_memory_mb"]) == ["first", "second"]
    assert all(0.0 < seconds < 60.0 for seconds in results["seconds"].values())
    assert all(100.0 < memory < 1e5 for memory in results["peak_memory_mb"].values())
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert f'<td>second</td><td class="number">{results["seconds"]["second"]:.1f}</td>' in page


def test_programs_of_one_group_are_forgotten_before_the_next(monkeypatch, tmp_path):
    fakes = known(monkeypatch, *(Fake(name) for name in ("a", "b", "c", "d")))
    done = []
    for fake, module in zip(fakes, ("one", "two", "three", "three"), strict=True):
        fake.__module__ = module
    monkeypatch.setattr(frame, "GROUPS", (("one", "two"), ("three",)))
    monkeypatch.setattr(frame, "forget_compiled", lambda: done.append([fake.name for fake in fakes if fake.runs]))
    frame.reproduce(tmp_path)
    assert done == [["a", "b"], ["a", "b", "c", "d"]]


def test_unknown_study_is_refused_in_one_line(fakes, tmp_path):
    with pytest.raises(railjax.InputError, match="no study 'third'; there are first, second") as caught:
        frame.reproduce(tmp_path / "out", only=["first", "third"])
    assert len(str(caught.value).splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_needs_double_precision(fakes, tmp_path):
    with jax.enable_x64(False), pytest.raises(railjax.InputError, match=r"railjax\.use_double_precision\(\)"):
        frame.reproduce(tmp_path)
    assert runs(fakes) == [0, 0]


@pytest.mark.parametrize("spoil", ["fingerprint", "half", "list", "figure"])
def test_a_part_that_does_not_fit_is_made_anew(fakes, tmp_path, spoil):
    frame.reproduce(tmp_path)
    part = tmp_path / "parts" / "first.json"
    if spoil == "fingerprint":
        part.write_text(json.dumps(json.loads(part.read_text()) | {"fingerprint": "of other code"}))
    elif spoil == "half":
        part.write_text(part.read_text()[:50])
    elif spoil == "list":
        part.write_text("[]")
    else:
        (tmp_path / "figures" / "first.png").unlink()
    frame.reproduce(tmp_path)
    assert runs(fakes) == [2, 1]
    assert (tmp_path / "figures" / "first.png").read_bytes().startswith(PNG)


def test_parts_are_bound_to_the_code_and_to_jax(fakes, tmp_path, monkeypatch):
    frame.reproduce(tmp_path)
    monkeypatch.setattr(frame.jax, "__version__", "99.0")
    frame.reproduce(tmp_path)
    assert runs(fakes) == [2, 2]
    changed = shutil.copytree(PACKAGE, tmp_path / "railjax")
    monkeypatch.setattr(frame, "digest_of_source", lambda *without: digest_of_source.__wrapped__(*without, package=changed))
    frame.reproduce(tmp_path)
    assert runs(fakes) == [2, 2]
    (changed / "cli" / "files.py").write_text("other code")  # changes no number
    frame.reproduce(tmp_path)
    assert runs(fakes) == [2, 2]
    (changed / "model" / "motion.py").write_text("other code")
    frame.reproduce(tmp_path)
    assert runs(fakes) == [3, 3]
    (changed / "model" / "motion.py").rename(changed / "base" / "motion.py")
    frame.reproduce(tmp_path)
    assert runs(fakes) == [4, 4]


def test_goes_on_after_a_failure(fakes, tmp_path):
    fakes[1].fails = True
    with pytest.raises(RuntimeError, match="stopped here"):
        frame.reproduce(tmp_path)
    assert not (tmp_path / "results.json").exists()
    fakes[1].fails = False
    results = frame.reproduce(tmp_path)
    assert runs(fakes) == [1, 2]
    assert len(results["quantities"]) == 2


def test_a_fresh_run_that_is_stopped_leaves_no_old_part_beside_a_new_figure(fakes, tmp_path):
    frame.reproduce(tmp_path)
    fakes[0].fails = True
    with pytest.raises(RuntimeError, match="stopped here"):
        frame.reproduce(tmp_path, fresh=True)
    fakes[0].fails = False
    frame.reproduce(tmp_path)
    assert runs(fakes) == [3, 1]


def test_report_is_self_contained_and_calls_fitted_fitted(fakes, tmp_path):
    frame.reproduce(tmp_path)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "http" not in page
    assert "<script" not in page
    assert "<link" not in page
    images = re.findall(r"<img [^>]*>", page)
    assert len(images) == 2
    for image, name in zip(images, ("first", "second"), strict=True):
        assert 'src="data:image/png;base64,iVBORw0KGgo' in image
        assert f'alt="what &#34;{name}&#34; shows"' in image
    first, second = (next(row for row in page.split("<tr>") if f"speed of {name}" in row) for name in ("first", "second"))
    assert "predicted" in first
    assert '<span class="fitted">' not in first
    assert '<span class="fitted">fitted</span>' in second
    assert "-0.1" in first
    assert "first &lt; 3" in page
    assert "2 &amp; 3" in page
    for name in re.findall(r'href="#([^"]+)"', page):
        assert f'id="{name}"' in page


def test_a_quantity_that_is_not_a_number_is_null_and_shown(fakes, tmp_path):
    fakes[0].computed = float("nan")
    frame.reproduce(tmp_path)
    text = (tmp_path / "results.json").read_text()
    results = json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    assert results["quantities"][0]["computed"] is None
    assert results["quantities"][0]["within"] is False
    assert '<td class="number">-</td>' in render(results, [])


def test_the_linear_critical_speed_of_the_paper(tmp_path):
    results = frame.reproduce(tmp_path, only=["linear-critical-speed"])
    found = {quantity["name"]: quantity for quantity in results["quantities"]}
    calibrated = found["linear critical speed"]
    assert calibrated["paper"] == 245.6
    assert calibrated["computed"] == pytest.approx(245.6, abs=0.1)
    assert calibrated["fitted"]
    assert calibrated["within"]
    literal = found["linear critical speed, Table 1 to the letter"]
    assert literal["computed"] == pytest.approx(65.2, abs=0.1)
    assert not literal["fitted"]
    assert not literal["within"]
    assert (tmp_path / "figures" / "root-locus.png").read_bytes().startswith(PNG)


def test_studies_have_names_of_their_own():
    names = [study.name for study in frame.studies()]
    assert len(names) == len(set(names))
    assert [study.name for study in frame.studies() if not study.beyond] == [
        "linear-critical-speed",
        "figs-2-4",
        "figs-5-6",
        "figs-7-9",
        "fig-10",
        "damper-design",
        "figs-13-14",
        "figs-16-19",
        "fig-19-comfort",
    ]
