"""Units as files write them: what a header's cell says of name and unit, and the factor to SI, by `pint` where a table does not know it."""

import functools
import re
from collections.abc import Iterator
from typing import Any

#: what people write and pint does not take, in its words
SPELLINGS = {
    "⁻²": "^-2", "⁻¹": "^-1", "²": "^2", "³": "^3", "−": "-", "·": "*", "⋅": "*", "×": "*", "µ": "u", "μ": "u", "\'\'": "inch", '"': "inch"
}  # fmt: skip
ALIASES = ("@alias force_ton = tonf", "kmh = kilometer / hour", "ips = inch / second", "kp = force_kilogram")

#: the acceleration of gravity, where accelerations are meant: for pint g is a gram and G a gauss
GRAVITY = re.compile(r"(m|milli|u|micro)?[ -]?(?:g|g0|gn|g_n|g-force|gee)s?(?: ?\(?rms\)?)?", re.IGNORECASE)
PREFIX = {None: 1.0, "": 1.0, "m": 1e-3, "milli": 1e-3, "u": 1e-6, "micro": 1e-6}

STANDARD_GRAVITY = 9.80665


def factor(written: str, table: dict[str, float]) -> float | None:
    """The factor to SI of a unit as it is written, for a quantity whose usual units are in `table`; None if it is none of the quantity's.

    As written, then in any case, then by pint in the dimension of the table's units of factor 1.
    """
    if written in table:
        return table[written]
    folded = {unit.lower(): value for unit, value in reversed(table.items())}
    text = _spelled(written)
    if text.lower() in folded:
        return folded[text.lower()]
    if "g" in table and (gravity := GRAVITY.fullmatch(text)):
        return PREFIX[(gravity.group(1) or "").lower()] * STANDARD_GRAVITY
    for own in dict.fromkeys((text, text.lower())):
        for si in (unit for unit, value in table.items() if value == 1.0):
            found = _ratio(own, _spelled(si))
            if found is not None:
                return found
    return None


def is_unit(written: str) -> bool:
    """Whether a text can be a unit of anything."""
    text = _spelled(written)
    return GRAVITY.fullmatch(text) is not None or any(_parsed(own) is not None for own in (text, text.lower()))


def splits(cell: str) -> Iterator[tuple[str, str, bool]]:
    """Ways in which a header's cell may be a name and a unit, likeliest first, and whether a bracket says that it is a unit."""
    # the last bracket may hold others, as in "density (m^2/(rad/m))", and the name may have its own
    for start in (match.start() for match in re.finditer(r"[(\[{<]", cell)):
        if cell[-1] in ")]}>" and start:
            yield cell[:start].strip(" _,"), cell[start + 1 : -1].strip(), True
    for mark in (" / ", "/", ", ", " in ", ":"):
        name, found, unit = cell.partition(mark)
        if found and name.strip() and unit.strip():
            yield name.strip(), unit.strip(), False
    if re.fullmatch(r"g-?f(orce)?[ _]?[xyz]", cell, re.IGNORECASE):  # as phones write an acceleration in g
        yield cell, "g", False
    for blank in re.finditer(r"[_ ]+", cell):
        unit = re.sub(r"[_ ]per[_ ]", "/", cell[blank.end() :])
        for joined in " /":
            yield cell[: blank.start()], unit.replace("_", joined), False


def plain(name: str) -> str:
    """A name as it is compared: in small letters, with single blanks for what joins words."""
    return re.sub(r"[\s_.\-()\[\]]+", " ", name.lower()).strip()


def _spelled(written: str) -> str:
    """As pint takes it: "m/s2", "ms-2" and "m s⁻²" are m/s^2."""
    text = written.strip().strip("[]").strip()
    for mark, own in SPELLINGS.items():
        text = text.replace(mark, own)
    text = text.replace("^^", "^").replace("**", "^")
    if re.fullmatch(r"m[ .*_]?s\^?-2|m s 2", text, re.IGNORECASE) or text.lower() in ("mps2", "ms2", "m/sec2", "m/s/s"):
        return "m/s^2"
    text = re.sub(r"(?<=[A-Za-z])\.(?=[A-Za-z])", "*", text)
    return re.sub(r"([A-Za-z])(-?\d)", r"\1^\2", text)


@functools.cache
def _registry() -> Any:
    import pint

    registry: Any = pint.UnitRegistry(on_redefinition="ignore")
    for alias in ALIASES:
        registry.define(alias)
    return registry


@functools.cache
def _parsed(text: str) -> Any:
    # letters and the marks of units only: the rest is no unit, and pint would compute with it
    if not re.fullmatch(r"[A-Za-zΩ°%][A-Za-zΩ°%0-9*/^()\s.-]*|1/.*", text):
        return None
    try:
        return _registry().Quantity(1.0, _registry().parse_units(text))
    except Exception:  # pint has many, of no common class, for what it cannot read
        return None


def _ratio(text: str, si: str) -> float | None:
    own, base = _parsed(text), _parsed(si)
    if own is None or base is None or own.dimensionality != base.dimensionality:
        return None
    value = float((own / base).to("").magnitude)
    # "1/m" is a wave per metre: pint has the radian as a pure number
    if "rad" in si and not re.search("rad|cycle|turn|rev", text):
        value *= 2.0 * 3.141592653589793 if si == "rad/m" else 1.0 / (2.0 * 3.141592653589793)
    return value
