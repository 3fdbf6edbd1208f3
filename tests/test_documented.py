"""Every public name is documented: arguments named, numbers with a unit, fields with theirs; and stands in the reference."""

import inspect
import re
import sys
import typing
from pathlib import Path

import pytest

import railjax
from railjax import objectives, testing

NOTEBOOKS = Path(__file__).parents[1] / "notebooks"
sys.path.insert(0, str(NOTEBOOKS))
site_pages = pytest.importorskip("site_pages", reason="needs the extra docs")

#: what makes a number a quantity: a unit, or the word that it has none
UNIT = re.compile(
    r"(?<![\w/])(?:k?m/h|m/s(?:\^2|²)?|[mk]?N(?: ?s/m| ?m|/m)?|MN(?:/m)?|k?Hz|1/s|rad(?:/s|/m)?|1/m|s/m|kg|[mk]?m|ms|s|A|V(?:/m+)?|T|k?Pa|kg m\^2"
    r"|dimensionless|SI|seconds?|per cent|number|numbers|share|shares|ratio|relative|factors?|counts?|counted|times|steps|seed|samples|percentile|exponent|power|mean squares)"
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


def missing_of(function) -> list[str]:
    """What its documentation lacks."""
    text, lacking = inspect.getdoc(function) or "", []
    if not text:
        return ["no docstring"]
    names = inspect.signature(function).parameters
    for name, parameter in names.items():
        if name in ("self", "cls") or parameter.kind is parameter.VAR_KEYWORD:
            continue
        if parameter.annotation is parameter.empty:
            lacking.append(f"{name}: no annotation")
        elif name in OF_LAWS or not OPEN.search(annotation(parameter)) or "Path" in annotation(parameter):
            continue
        elif not words(text, name):
            lacking.append(f"{name}: not named")
        elif (
            NUMERIC.search(annotation(parameter))
            and "bool" not in annotation(parameter)
            and not any(map(UNIT.search, words(text, name)))
        ):
            lacking.append(f"{name}: no unit")
    returned = inspect.signature(function).return_annotation
    if returned is inspect.Signature.empty:
        lacking.append("returns: no annotation")
    elif (
        re.search(r"Float\[|\bfloat\b|ndarray", str(returned))
        and not OF_LAWS & set(names) - {"vehicle", "damper", "track"}
        and not UNIT.search(text)
    ):
        lacking.append("returns: no unit")
    return lacking


@pytest.mark.parametrize("name", [*FUNCTIONS, *METHODS])
def test_functions_name_their_arguments_with_units(name):
    assert missing_of({**FUNCTIONS, **METHODS}[name]) == []


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


def test_every_public_name_stands_in_the_reference():
    page = (NOTEBOOKS / "pages" / "api.md").read_text(encoding="utf-8")
    listed = re.findall(r"^::: (\S+)$", page, flags=re.MULTILINE)
    assert len(listed) == len(set(listed))
    public = [f"railjax.{name}" for name in (*FUNCTIONS, *CLASSES)]
    assert sorted(listed) == sorted(public)
    assert "<!-- channels -->" in page
