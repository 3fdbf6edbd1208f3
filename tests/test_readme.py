"""The code blocks of the README and of the documentation's pages run, in order; the README's commands are where `.ci/run` and a
reader look for them.

Blocks marked `python` run always; those marked `py`, which take long or need a cluster, are compiled, and all but the latter run with
RAILJAX_ALL_BLOCKS=1.
"""

import os
import re
from pathlib import Path

import pytest

import railjax

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"
PAGES = sorted((ROOT / "notebooks" / "pages").glob("*.md"))
ELSEWHERE = ("dask.distributed", "jax.distributed")


def blocks(page: Path, language: str) -> list[str]:
    return re.findall(rf"```(?:{language})\n(.*?)```", page.read_text(encoding="utf-8"), flags=re.DOTALL)


def run(page: Path) -> None:
    language = "python|py" if "RAILJAX_ALL_BLOCKS" in os.environ else "python"
    namespace: dict = {}
    for block in blocks(page, language):
        if not any(word in block for word in ELSEWHERE):
            exec(compile(block, page.name, "exec"), namespace)


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(railjax, "use_all_cores", lambda: None)  # the tests have set them up


def test_examples_of_the_readme_run_and_draw_a_figure(tmp_path, capsys):
    assert len(blocks(README, "python")) >= 3
    run(README)
    printed = capsys.readouterr().out
    assert "245.6" in printed
    assert "(1000,)" in printed
    assert "constraints" in printed or "met" in printed
    assert (tmp_path / "run.png").stat().st_size > 10_000


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_examples_of_the_pages(page):
    for block in blocks(page, "py"):
        compile(block, page.name, "exec")
    run(page)


def test_toml_example_is_a_vehicle(tmp_path):
    (example,) = blocks(README, "toml")
    path = tmp_path / "own.toml"
    path.write_text(example)
    vehicle = railjax.load_vehicle(path)
    assert float(vehicle.primary.stiffness_x) == 5e6
    assert float(railjax.linear_critical_speed(vehicle)) > 70.0


@pytest.mark.parametrize(("marker", "words"), [("reproduce", "railjax reproduce --out results"), ("test", "-m pytest")])
def test_the_two_commands(marker, words):
    text = README.read_text(encoding="utf-8")
    command = re.search(rf"<!-- {marker} command -->\n```bash\n(.*?)\n```", text, flags=re.DOTALL)
    assert command, marker
    assert words in command.group(1)
    assert "-m venv" in command.group(1)


def test_the_map_of_the_modules_is_complete():
    """Every module stands in the contributor's page, and every one that stands there exists."""
    text = (ROOT / "notebooks" / "pages" / "contributing.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"^    units,.*?\n\n", text, flags=re.DOTALL | re.MULTILINE)
    listed = set(re.findall(r"\w+", block)) | set(re.findall(r"`(\w+)\.py`", text))
    there = {path.stem for path in (ROOT / "railjax").glob("*.py")} - {"__init__"}
    small = {"typing", "precision", "progress"}  # leaves used anywhere
    assert listed - there == set()
    assert there - listed <= small
