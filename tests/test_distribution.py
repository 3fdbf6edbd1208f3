"""What is published: the wheel, built from the source archive, works outside the repository with nothing of it on the path; versions
agree; the code is clean to linter and type checker."""

import os
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest
import yaml

import railjax

ROOT = Path(__file__).parents[1]
TEMPLATES = {f"railjax/reports/vehicle/templates/{name}" for name in ("page.html", "parts.html", "style.css")}


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """The source archive and the wheel that is built out of it, with the installed build backend."""
    pytest.importorskip("build")
    pytest.importorskip("hatchling")
    out = tmp_path_factory.mktemp("dist")
    call(sys.executable, "-m", "build", "--no-isolation", "--outdir", str(out), str(ROOT), cwd=out)
    (archive,), (wheel,) = out.glob("*.tar.gz"), out.glob("*.whl")
    return archive, wheel


def call(*command, cwd, **environment):
    found = subprocess.run(command, cwd=cwd, capture_output=True, text=True, env=os.environ | environment)
    assert found.returncode == 0, found.stdout + found.stderr
    return found.stdout


def test_source_archive_has_what_a_packager_needs(built):
    with tarfile.open(built[0]) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert {
        "pyproject.toml",
        "LICENSE",
        "README.md",
        "CHANGELOG.md",
        "tests/model/test_motion.py",
        "railjax/vehicles/coach.toml",
        *TEMPLATES,
    } <= names
    assert {"notebooks/mkdocs.yml", "notebooks/pages/theory.md", "benchmarks/validation.py"} <= names
    assert not [name for name in names if name.endswith((".png", ".pyc", ".zarr"))]


def test_wheel_has_the_package_alone(built):
    with zipfile.ZipFile(built[1]) as wheel:
        names = wheel.namelist()
        metadata = wheel.read(next(name for name in names if name.endswith("METADATA"))).decode()
    assert {"railjax/py.typed", "railjax/vehicles/coach.toml", *TEMPLATES} <= set(names)
    assert {name.partition("/")[0] for name in names} == {"railjax", f"railjax-{railjax.__version__}.dist-info"}
    assert "License-Expression: MIT" in metadata
    assert re.search(r"^Requires-Dist: jax!=0\.10\.2,!=0\.11\.0,!=0\.11\.1,>=0\.10\.1", metadata, flags=re.MULTILINE)


def test_wheel_works_from_elsewhere(built, tmp_path):
    """Installed into an empty folder, which comes first on the path; run from another."""
    target, elsewhere = tmp_path / "site", tmp_path / "elsewhere"
    elsewhere.mkdir()
    call(
        sys.executable,
        "-m",
        "pip",
        "install",
        "--quiet",
        "--no-deps",
        "--no-index",
        "--target",
        str(target),
        str(built[1]),
        cwd=elsewhere,
    )
    code = "import railjax; print(railjax.__file__); print(*railjax.packaged_vehicles())"
    where, vehicles = call(sys.executable, "-c", code, cwd=elsewhere, PYTHONPATH=str(target)).splitlines()
    assert Path(where).is_relative_to(target)
    assert "coach" in vehicles.split()
    listed = call(sys.executable, "-m", "railjax.cli", "vehicles", "--json", cwd=elsewhere, PYTHONPATH=str(target))
    assert "cooperrider-bogie" in listed
    code = "from railjax.reports.vehicle.page import page; print(page('t', 'h', '', []))"
    assert "<style>" in call(sys.executable, "-c", code, cwd=elsewhere, PYTHONPATH=str(target))
    assert (target / "bin" / "railjax").is_file()


def test_versions_agree():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert project["version"] == railjax.__version__
    assert re.fullmatch(r"\d+\.\d+\.\d+", railjax.__version__)
    newest = re.search(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), flags=re.MULTILINE)
    assert newest
    assert newest[1] == railjax.__version__


@pytest.mark.parametrize("command", [["ruff", "check"], ["ruff", "format", "--check"], ["mypy", "railjax"]], ids=" ".join)
def test_code_is_clean(command):
    pytest.importorskip(command[0])
    call(sys.executable, "-m", *command, cwd=ROOT)


def test_hooks_before_a_commit_are_local():
    text = (ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8")
    assert set(re.findall(r"repo: (\S+)", text)) == {"local"}
    assert "://" not in text


def test_the_workflow_of_the_public_forge_runs_what_the_readme_says():
    text = (ROOT / ".github" / "workflows" / "tests.yml").read_text(encoding="utf-8")
    assert "://" not in text
    jobs = yaml.safe_load(text)["jobs"]
    matrix = jobs["test"]["strategy"]["matrix"]
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert matrix["python"] == re.findall(r"Python :: (3\.\d+)", "\n".join(project["classifiers"]))
    assert matrix["python"][0] == project["requires-python"].removeprefix(">=")
    assert {name.partition("-")[0] for name in matrix["os"]} == {"ubuntu", "macos", "windows"}
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    command = re.search(r"<!-- test command -->\n```bash\n(.*?)\n```", readme, flags=re.DOTALL)[1]
    posix, windows = (step["run"] for step in jobs["test"]["steps"] if "run" in step)
    found = call("bash", "-c", posix.replace("bash -euc", "echo"), cwd=ROOT)
    assert found.strip() == command
    said = [re.sub(r"^\S*?(python3?|pip) ", r"\1 ", line) for line in command.split(" && ")]
    there = [re.sub(r"^\S*?(python|pip) ", r"\1 ", line) for line in windows.splitlines()]
    assert [line.replace("python3 ", "python ") for line in said] == there[2:]
    lint = [step["run"] for step in jobs["lint"]["steps"] if "run" in step]
    assert {"ruff check", "ruff format --check", "mypy railjax"} <= set(lint)
    steps = [step for job in jobs.values() for step in job["steps"] if "uses" in step]
    assert all(step["with"]["cache"] == "pip" for step in steps if "setup-python" in step["uses"])
