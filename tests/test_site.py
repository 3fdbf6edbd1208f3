"""The documentation's site builds with warnings as errors, from the pages, the notebooks and the docstrings; the validation page is
as its command makes it now; nothing in the repository names a package index or a path of one machine."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import railjax

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "benchmarks"))
import validation  # noqa: E402

PAGE = ROOT / "notebooks" / "pages" / "validation.md"


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    pytest.importorskip("mkdocs", reason="needs the extra docs")
    out = tmp_path_factory.mktemp("site")
    command = [
        sys.executable,
        "-m",
        "mkdocs",
        "build",
        "--strict",
        "--quiet",
        "-f",
        str(ROOT / "notebooks" / "mkdocs.yml"),
        "-d",
        str(out),
    ]
    environment = os.environ | {"PYTHONPATH": str(ROOT), "NO_MKDOCS_2_WARNING": "1"}
    found = subprocess.run(command, capture_output=True, text=True, cwd=out, env=environment)
    assert found.returncode == 0, found.stdout + found.stderr
    return out


def test_site_builds_without_a_warning(site):
    pages = {path.parent.name for path in site.glob("*/index.html")}
    assert {
        "theory",
        "howto",
        "api",
        "validation",
        "limits",
        "sharp-bits",
        "contributing",
        "changelog",
        "08-own-force-law",
    } <= pages
    assert (site / "run.png").stat().st_size > 10_000
    reference = (site / "api" / "index.html").read_text(encoding="utf-8")
    for name in ("linear_critical_speed", "hunting_branch", "BalanceLogic", "identify_damper"):
        assert 'id="railjax.' in reference
        assert re.search(rf'id="railjax\.{name}"', reference), name
    assert "carbody_acceleration" in reference
    assert "N s/m per side" in reference  # fields with their units


def test_site_needs_nothing_from_elsewhere(site):
    """No font, script or style sheet is loaded from another host."""
    for path in site.rglob("*.html"):
        text = path.read_text(encoding="utf-8")
        loaded = re.findall(
            r"<(?:script|img)[^>]+src=\"?(\S+?)[\"\s>]|<link[^>]+rel=\"?(?:stylesheet|preload)[^>]+href=\"?(\S+?)[\"\s>]", text
        )
        assert not [one for pair in loaded for one in pair if one.startswith(("http:", "https:", "//"))], path


def rows_of(text: str) -> dict[str, list[str]]:
    lines = re.findall(r"^\| (.+) \|$", text, flags=re.MULTILINE)
    return {cells[0]: cells[1:] for cells in (line.split(" | ") for line in lines)}


def test_validation_page_holds_what_its_command_prints():
    """The cheap rows made again; the critical speeds are tested where they belong."""
    written = rows_of(PAGE.read_text(encoding="utf-8"))
    fresh = [row for name, group in validation.GROUPS.items() if name != "hunting" for row in group()]
    assert len(fresh) > 30
    for row in fresh:
        assert rows_of(str(row))[row.quantity][:3] == written[row.quantity][:3], row.quantity
    hopf = written["Hopf point of Cooperrider's bogie, m/s"]
    assert float(hopf[2]) == pytest.approx(float(hopf[1]), abs=0.05)
    assert written["nonlinear critical speed, km/h"][1:3] == ["234.2", "234.2"]
    assert f"railjax {railjax.__version__}" in PAGE.read_text(encoding="utf-8")
    for row in fresh:  # what the source prints, to its digits, but where the note says why
        assert f"{row.published:{row.digits}}" == f"{row.ours:{row.digits}}" or row.note, row.quantity


def test_repository_names_no_index_and_no_path_of_a_machine():
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True)
    if listed.returncode:
        pytest.skip("no git checkout")
    forbidden = re.compile(
        "|".join(
            [
                "pypi\\." + "org",
                "files\\.python" + "hosted",
                "/simp" + "le/",
                "index" + "-url",
                "/ro" + "ot/",
                "/ho" + "me/\\w",
                "/wo" + "rk/",
            ]
        )
    )
    for name in filter(None, listed.stdout.split("\0")):
        path = ROOT / name
        if path.suffix in (".png", ".pyc") or not path.is_file():
            continue
        found = forbidden.search(path.read_text(encoding="utf-8", errors="replace"))
        assert not found, f"{name}: {found[0] if found else ''}"
