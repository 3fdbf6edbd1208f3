"""The house: rooms in one order, said in pyproject.toml; nobody reaches for another's private names; every room says what it is."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import grimp
import pytest

import railjax

PACKAGE = Path(railjax.__file__).parent
MODULES = sorted(PACKAGE.rglob("*.py"))
ROOMS = sorted(path.parent for path in PACKAGE.rglob("__init__.py") if path.parent != PACKAGE)


def test_rooms_import_downwards_only_and_in_no_circle():
    command = [str(Path(sys.executable).with_name("lint-imports")), "--no-cache"]
    found = subprocess.run(command, cwd=PACKAGE.parent, capture_output=True, text=True)
    assert found.returncode == 0, found.stdout[-3000:]
    assert "0 broken" in found.stdout


def test_a_newcomer_sees_the_house_at_a_glance():
    there = [path.name for path in PACKAGE.iterdir() if path.name != "__pycache__"]
    assert len(there) <= 16, sorted(there)
    for room in ROOMS:
        said = ast.get_docstring(ast.parse((room / "__init__.py").read_text(encoding="utf-8"))) or ""
        first, _, rest = said.partition("\n\n")
        assert first.endswith("."), room
        assert rest.startswith("Imports "), room


def test_no_public_function_has_a_room_of_its_name():
    assert not {room.name for room in ROOMS if room.parent == PACKAGE} & set(railjax.__all__)


@pytest.mark.parametrize("module", MODULES, ids=lambda path: path.relative_to(PACKAGE).with_suffix("").as_posix())
def test_private_names_stay_at_home(module):
    for node in ast.walk(ast.parse(module.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.level:
            private = [alias.name for alias in node.names if re.match(r"_[a-z]", alias.name)]
            assert not private, f"line {node.lineno}: {private}"


def test_the_rules_of_arguments_are_there_when_a_function_needs_them():
    """Rules are added where a thing is defined; whoever guards an argument by such a name has that module among its imports."""
    graph = grimp.build_graph("railjax")
    homes: dict[str, str] = {}
    guarded: list[tuple[str, str, str]] = []
    for path in MODULES:
        module = ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts)
        text = path.read_text(encoding="utf-8")
        homes |= {name: module for name in re.findall(r'^ARGUMENTS\["(\w+)"\] =', text, flags=re.MULTILINE)}
        for node in ast.walk(ast.parse(text)):
            for call in node.decorator_list if isinstance(node, ast.FunctionDef) else ():
                if isinstance(call, ast.Call) and getattr(call.func, "id", "") == "guarded":
                    own = {keyword.arg for keyword in call.keywords}
                    given = {argument.arg for argument in (*node.args.args, *node.args.kwonlyargs)}
                    guarded += [(module, node.name, name) for name in sorted(given - own)]
    assert {"vehicle", "damper", "track", "run"} <= homes.keys()
    for module, function, name in guarded:
        home = homes.get(name)
        assert home in (None, module) or graph.find_shortest_chain(module, home), f"{module}.{function}({name}) without {home}"


def test_the_tests_mirror_the_rooms():
    """What is about one room lies in the folder of its name; at the top is what looks at the whole package."""
    folders = {path.parent.name for path in Path(__file__).parent.glob("*/test_*.py")}
    assert folders == {room.name for room in ROOMS if room.parent == PACKAGE}
