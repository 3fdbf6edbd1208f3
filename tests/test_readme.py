"""The README's examples run, in order, and its two commands are where `.ci/run` and a reader look for them."""

import re
from pathlib import Path

import pytest

import railjax

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", README, flags=re.DOTALL)


def test_python_examples_run_and_draw_a_figure(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(railjax, "use_all_cores", lambda: None)  # the tests have set them up
    namespace: dict = {}
    found = blocks("python")
    assert len(found) >= 2
    for block in found:
        exec(compile(block, "README.md", "exec"), namespace)
    printed = capsys.readouterr().out
    assert "245.6" in printed
    assert "(1000,)" in printed
    assert (tmp_path / "run.png").stat().st_size > 10_000


def test_toml_example_is_a_vehicle(tmp_path):
    (example,) = blocks("toml")
    path = tmp_path / "own.toml"
    path.write_text(example)
    vehicle = railjax.load_vehicle(path)
    assert float(vehicle.primary.stiffness_x) == 5e6
    assert float(railjax.linear_critical_speed(vehicle)) > 70.0


@pytest.mark.parametrize(("marker", "words"), [("reproduce", "railjax reproduce --out results"), ("test", "-m pytest")])
def test_the_two_commands(marker, words):
    command = re.search(rf"<!-- {marker} command -->\n```bash\n(.*?)\n```", README, flags=re.DOTALL)
    assert command, marker
    assert words in command.group(1)
    assert "-m venv" in command.group(1)


def test_every_module_of_the_map_exists():
    for module in re.findall(r"`(\w+)\.py`", README):
        assert (ROOT / "railjax" / f"{module}.py").is_file(), module
