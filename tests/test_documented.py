"""Every public name is documented: arguments listed from three on, else named, numbers with a unit, fields with theirs; and stands in the reference."""

import dataclasses
import inspect
import re
import sys
import typing
from pathlib import Path

import pytest

import railjax
from railjax import objectives, testing

griffe = pytest.importorskip("griffe", reason="needs the extra docs")

NOTEBOOKS = Path(__file__).parents[1] / "notebooks"
sys.path.insert(0, str(NOTEBOOKS))
site_pages = pytest.importorskip("site_pages", reason="needs the extra docs")

#: what makes a number a quantity: a unit, or the word that it has none
UNIT = re.compile(
    r"(?<![\w/])(?:k?m/h|m/s(?:\^2|²)?|[mk]?N(?: ?s/m| ?m|/m)?|MN(?:/m)?|k?Hz|1/s|rad(?:/s|/m)?|1/m|s/m|kg|[mk]?m|ms|s|A|V(?:/m+)?|T|k?Pa|kg m\^2"
    r"|dimensionless|SI|numbers?|share|ratio|relative|factors?|counts?|steps|seed|power)"
    r"(?![\w/])"
)
#: what `railjax.Damper` and its controllers explain once for all laws
OF_LAWS = {"vehicle", "damper", "track", "travel", "velocity", "internal", "seen", "measured", "sensed", "signal", "decision"}
#: an annotation that leaves open what is meant; others, like a path or Matplotlib's axes, say it themselves
OPEN = re.compile(r"\b(float|int|str|bool|Scalar|ArrayLike|Number|Speed|Any|Mapping|dict|object|Callable)\b|Float\[")
NUMERIC = re.compile(r"\b(float|int|Scalar|ArrayLike|Number|Float\[|Speed)\b|Float\[")

NAMES = [name for name in railjax.__all__ if name not in ("CHANNELS", "objectives")]
FUNCTIONS = {name: value for name in NAMES if inspect.isroutine(value := getattr(railjax, name))}
FUNCTIONS |= {
    f"objectives.{name}": value
    for name, value in vars(objectives).items()
    if inspect.isfunction(value) and value.__module__ == objectives.__name__ and not name.startswith("_")
}
FUNCTIONS |= {f"testing.{name}": getattr(testing, name) for name in ("check_damper", "check_track", "check_objective")}
CLASSES = {name: value for name in NAMES if inspect.isclass(value := getattr(railjax, name))}
#: whose constructor is written by hand and not made of the fields
CONSTRUCTORS = {
    name: kind for name, kind in CLASSES.items() if dataclasses.is_dataclass(kind) and not kind.__dataclass_params__.init
}
METHODS = {
    f"{name}.{key}": inspect.unwrap(getattr(kind, key))
    for name, kind in CLASSES.items()
    for key, value in vars(kind).items()
    if not key.startswith("_") and (inspect.isfunction(value) or isinstance(value, classmethod))
}


def words(text: str | None, name: str) -> list[str]:
    """The parts of a text that speak of a name, from some words before to the end of its paragraph."""
    paragraphs = re.split(r"\n\s*\n", text or "")
    return [part[max(at.start() - 30, 0) :] for part in paragraphs for at in re.finditer(rf"\b{re.escape(name)}\b", part)]


def annotation(parameter: inspect.Parameter) -> str:
    found = parameter.annotation
    return found if isinstance(found, str) else typing._type_repr(found) if hasattr(typing, "_type_repr") else str(found)


#: arguments from which on a function lists them
LISTED = 3
#: what a line of a list says of a number, before its first semicolon: its unit, or that it has none
NUMBER = re.compile(
    r"(?<![\w/])(?:k?m/h|m/s(?:\^2|²)?|[mk]?N|Hz|1/s²?|[mk]?m|s|V|A|kg|Pa|SI|dimensionless|numbers? (?:of|from)|whole number|counted from)(?![\w/])"
)


def arguments_of(function) -> dict[str, inspect.Parameter]:
    """By name, with the stars of those that gather others."""
    stars = {inspect.Parameter.VAR_POSITIONAL: "*", inspect.Parameter.VAR_KEYWORD: "**"}
    given = inspect.signature(function).parameters
    return {stars.get(one.kind, "") + name: one for name, one in given.items() if name not in ("self", "cls")}


def list_of(text: str) -> dict[str, str] | None:
    """The lines of `Args:` by name, as the reference shows them; None where there is no list."""
    sections = griffe.Docstring(text, lineno=1).parse("google", warnings=False)
    found = [section.value for section in sections if section.kind is griffe.DocstringSectionKind.parameters]
    return {line.name: line.description for line in found[0]} if found else None


#: numbers whose annotation takes anything, because JAX puts other things in their place or several are taken
NUMBERS = {"axle_load", "bogie_mass", "speeds", "starts", "value"}


def numeric(parameter: inspect.Parameter) -> bool:
    if parameter.name in NUMBERS:
        return True
    return bool(NUMERIC.search(annotation(parameter))) and "Callable" not in annotation(parameter)


def missing_of_list(arguments: dict[str, inspect.Parameter], text: str) -> list[str]:
    """What the list of the arguments lacks."""
    listed = list_of(text)
    if listed is None:
        return ["no list of arguments"]
    if list(listed) != list(arguments):
        return [f"lists {', '.join(listed)}, but takes {', '.join(arguments)}"]
    lacking = [f"{name}: no annotation" for name, one in arguments.items() if one.annotation is one.empty]
    lacking += [f"{name}: says nothing" for name, line in listed.items() if not line.strip()]
    return lacking + [
        f"{name}: no unit"
        for name, line in listed.items()
        if numeric(arguments[name]) and not NUMBER.search(line.partition(";")[0])
    ]


def missing_in_prose(arguments: dict[str, inspect.Parameter], text: str) -> list[str]:
    """What prose lacks on arguments so few that they need no list."""
    lacking = []
    for name, parameter in arguments.items():
        if parameter.kind is parameter.VAR_KEYWORD:
            continue
        if parameter.annotation is parameter.empty:
            lacking.append(f"{name}: no annotation")
        elif name in OF_LAWS or not OPEN.search(annotation(parameter)) or "Path" in annotation(parameter):
            continue
        elif not words(text, name):
            lacking.append(f"{name}: not named")
        elif numeric(parameter) and not any(map(UNIT.search, words(text, name))):
            lacking.append(f"{name}: no unit")
    return lacking


def missing_of(function) -> list[str]:
    """What its documentation lacks."""
    text = inspect.getdoc(function) or ""
    if not text:
        return ["no docstring"]
    arguments = arguments_of(function)
    listed = len(arguments) >= LISTED or list_of(text) is not None
    lacking = missing_of_list(arguments, text) if listed else missing_in_prose(arguments, text)
    returned = inspect.signature(function).return_annotation
    if returned is inspect.Signature.empty:
        lacking.append("returns: no annotation")
    elif (
        re.search(r"Float\[|\bfloat\b|ndarray", str(returned))
        and not OF_LAWS & set(arguments) - {"vehicle", "damper", "track"}
        and not UNIT.search(text)
    ):
        lacking.append("returns: no unit")
    return lacking


@pytest.mark.parametrize("name", [*FUNCTIONS, *METHODS])
def test_functions_name_their_arguments_with_units(name):
    assert missing_of({**FUNCTIONS, **METHODS}[name]) == []


@pytest.mark.parametrize("name", CONSTRUCTORS)
def test_constructors_list_their_arguments(name):
    kind = CONSTRUCTORS[name]
    assert missing_of_list(arguments_of(kind), inspect.getdoc(kind) or "") == []


@pytest.mark.parametrize("name", CLASSES)
def test_fields_have_units(name):
    kind = CLASSES[name]
    assert kind.__doc__
    lacking = []
    for field, unit, meaning in site_pages.fields_of(kind):
        hint = inspect.get_annotations(kind).get(field, "")
        numeric = "unit" in str(meaning) or bool(NUMERIC.search(str(hint)) or "Any" in str(hint))
        if numeric and not unit and not UNIT.search(meaning) and not any(map(UNIT.search, words(inspect.getdoc(kind), field))):
            lacking.append(field)
    assert lacking == []


def test_the_check_itself_finds_what_is_missing():
    def undocumented(speed: float, mass: float) -> float:
        """The `speed` in m/s."""

    def wrong(speed: float, x) -> float:
        """Of `speed` and `x`."""

    assert missing_of(undocumented) == ["mass: not named"]
    assert missing_of(wrong) == ["speed: no unit", "x: no annotation", "returns: no unit"]


def test_the_check_itself_reads_lists():
    def of(args: str):
        def function(mass: float, speed: float, name: str, **more: float) -> None: ...

        function.__doc__ = f"A sum in J.\n\nArgs:\n{args}\nRaises:\n    InputError: never.\n"
        return missing_of(function)

    whole = "    mass: of all,\n        kg.\n    speed: v, m/s.\n    name: what it is called.\n    **more: dimensionless.\n"
    assert of(whole) == []
    assert of(whole.replace("    name: what it is called.\n", "")) == [
        "lists mass, speed, **more, but takes mass, speed, name, **more"
    ]
    assert of(whole.replace("mass:", "m:")) == ["lists m, speed, name, **more, but takes mass, speed, name, **more"]
    assert of(whole.replace("speed: v, m/s", "speed: fast")) == ["speed: no unit"]
    assert of(whole.replace("kg", "large")) == ["mass: no unit"]
    swapped = whole.replace("speed: v, m/s.\n    name: what it is called.", "name: what it is called.\n    speed: v, m/s.")
    assert of(swapped) == ["lists mass, name, speed, **more, but takes mass, speed, name, **more"]
    assert of("") == ["no list of arguments"]


def test_every_public_name_stands_in_the_reference():
    page = (NOTEBOOKS / "pages" / "api.md").read_text(encoding="utf-8")
    listed = re.findall(r"^::: (\S+)$", page, flags=re.MULTILINE)
    assert len(listed) == len(set(listed))
    public = [f"railjax.{name}" for name in (*FUNCTIONS, *CLASSES)]
    assert sorted(listed) == sorted(public)
    assert "<!-- channels -->" in page
