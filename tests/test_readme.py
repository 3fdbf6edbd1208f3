"""The code blocks of the README and of the documentation's pages run, in order; the README's commands are where `.ci/run` and a
reader look for them.

Blocks marked `python` run always; those marked `py`, which take long or need a cluster, are compiled, and all but the latter run with
RAILJAX_ALL_BLOCKS=1.
"""

import ast
import os
import re
import sys
from pathlib import Path

import pytest
from PIL import Image

import railjax

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "notebooks"))
import pictures  # noqa: E402

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


def test_the_map_of_the_house_is_the_listing():
    """A line a room, with what its own docstring says; and whatever the page points to is there."""
    page = (ROOT / "notebooks" / "pages" / "contributing.md").read_text(encoding="utf-8")
    for room in sorted(path.parent for path in (ROOT / "railjax").glob("*/__init__.py")):
        said = (ast.get_docstring(ast.parse((room / "__init__.py").read_text(encoding="utf-8"))) or "").partition("\n\n")[0]
        assert f"| `{room.name}/` | {' '.join(said.split())} |" in page
    for file, name in re.findall(r"`([\w/]+\.py)(?:: (\w+))?`", page):
        source = ROOT / file if file.startswith(("railjax/", "tests/")) else ROOT / "railjax" / file
        assert source.is_file(), file
        assert not name or re.search(rf"^(def |class )?{name}\b", source.read_text(encoding="utf-8"), flags=re.MULTILINE), name


def test_every_equation_of_the_paper_has_its_place():
    page = (ROOT / "notebooks" / "pages" / "contributing.md").read_text(encoding="utf-8")
    table = re.findall(r"^\| (\(\d.*?) \|", page, flags=re.MULTILINE)
    numbers = [tuple(map(int, re.findall(r"\d+", cell))) for cell in table]
    covered = [k for pair in numbers for k in range(pair[0], pair[-1] + 1)]
    assert covered == list(range(1, 19))


def test_the_pictures_at_its_head_are_there_and_small_and_made_by_one_command(tmp_path, monkeypatch):
    head = README.read_text(encoding="utf-8").partition("```")[0]
    shown = re.findall(r"\]\((notebooks/pages/[\w-]+\.(?:svg|gif))\)", head)
    assert sorted(Path(path).name for path in shown) == sorted([pictures.DIAGRAM, pictures.FILM])
    assert "python notebooks/pictures.py" in (ROOT / "notebooks" / "pages" / "contributing.md").read_text(encoding="utf-8")
    for path in shown:
        assert 5e3 < (ROOT / path).stat().st_size < 150e3, path
    for number in ("245.6", "234.2"):  # of the coach, as the page's description says
        assert number in head
    monkeypatch.setattr(sys, "argv", ["pictures.py", "--out", str(tmp_path), "--vehicle", "single-wheelset", "--frames", "3"])
    pictures.main()
    with Image.open(tmp_path / pictures.FILM) as film, Image.open(ROOT / "notebooks" / "pages" / pictures.FILM) as committed:
        assert film.n_frames == 3
        assert committed.n_frames == 16
        assert film.width == committed.width
    assert "<svg" in (tmp_path / pictures.DIAGRAM).read_text(encoding="utf-8")[:600]
