"""What the tests of robustness share: a writer of TOML, values that no file should hold, and mutations of a file's tables.

`RAILJAX_FUZZ=2000` in the environment makes as many examples, other ones in every run, instead of the few that a test can afford.
"""

import datetime
import os

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

EXAMPLES = int(os.environ.get("RAILJAX_FUZZ", "0"))


def cheap(examples):
    """Settings of a test of few examples (the same in every run: conftest.py), or of as many as the environment asks for."""
    return settings(max_examples=EXAMPLES or examples, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])


def toml(tables):
    """Tables as TOML, each on one line."""
    return "\n".join(f"{_key(key)} = {_value(value)}" for key, value in tables.items()) + "\n"


def _key(key):
    return '"' + "".join(_escaped(c) if not c.isascii() or not c.isalnum() else c for c in key) + '"'


def _escaped(c):
    return f"\\u{ord(c):04x}" if ord(c) < 0x10000 else f"\\U{ord(c):08x}"


def _value(value):
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_key(key)} = {_value(entry)}" for key, entry in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(_value(entry) for entry in value) + "]"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return _key(value)
    if isinstance(value, datetime.date | datetime.time | datetime.datetime):
        return value.isoformat()
    # in hexadecimals an integer may be longer than Python prints
    return hex(value**2) if value == 10**4000 else repr(value)


#: strings that would do something if anything evaluated, formatted, expanded or imported them
CODE = [
    "__import__('os').system('touch evaluated')",
    "open('evaluated', 'w')",
    "$(touch evaluated)",
    "`touch evaluated`",
    "!!python/object/apply:os.system ['touch evaluated']",
    "{0.__class__.__init__.__globals__}",
    "%(evaluated)s%n%x",
    "1e3 if True else 0",
    "lambda: 0",
    "jax.numpy",
]
KNOWN = [
    "base", "held", "law", "hertz", "mass_t", "mass_kg", "mass", "creep_width", "bogie_pattern", "axle_pattern", "provenance", "name",
    "note", "gyroscopic", "yaw_damper", "bump_stop", "travel_mm", "force_kN", "stiffness_x_kN_per_m", "carbody_to_floor_m", "conicity",
    "rail_head_radius_m", "wheel_profile_radius_m", "status", "value", "carbody.mass", "bump_stop.travel",
]  # fmt: skip
names = st.text(st.characters(max_codepoint=0x10FFFF, exclude_categories=("Cs",)), max_size=8) | st.sampled_from(KNOWN)
numbers = st.one_of(
    st.floats(),
    st.integers(),
    st.sampled_from([0, -0.0, 5e-324, 1e-300, 1e-9, 1e9, 1e150, 1e308, -1e308, 10**400, 10**4000]),
)
scalars = st.one_of(
    numbers,
    st.booleans(),
    st.sampled_from(["", "coach", "linear", "smooth", "calibrated", "a\nb", *CODE]),
    st.dates(),
    st.times(),
    st.datetimes(),
    names,
)
values = st.recursive(
    scalars, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(names, inner, max_size=2), max_leaves=5
)

#: what is done, at which place, with which name, value and factor
mutations = st.tuples(
    st.sampled_from(["drop", "rename", "change", "change", "add", *["scale"] * 6, "respell", "swap"]),
    st.integers(0, 10_000),
    names,
    values,
    st.sampled_from([1e-3, 1e3, -1.0, 0.0, 1e-9, 1e9, 1e-150, 1e150, 1e300, 0.5, 2.0, 10.0]),
)


def mutate(tables, changes):
    """Apply `mutations` to nested tables, in place; returns the tables, never empty."""
    for kind, which, name, value, factor in changes:
        places = list(_places(tables))
        table, key = places[which % len(places)]
        other_table, other = places[(which // len(places)) % len(places)]
        if kind == "drop":
            del table[key]
        elif kind == "rename":
            table[name] = table.pop(key)
        elif kind == "respell":  # another unit, or none
            table[key.replace("_kN", "_MN").replace("_m", "_mm").replace("_kg", "_t")] = table.pop(key)
        elif kind == "swap":
            if not isinstance(table[key], dict) and not isinstance(other_table[other], dict):  # a table might end up in itself
                table[key], other_table[other] = other_table[other], table[key]
        elif kind == "scale":
            numbers = [(t, k) for t, k in places if isinstance(t[k], int | float) and not isinstance(t[k], bool)]
            if numbers:
                table, key = numbers[which % len(numbers)]
                table[key] = table[key] * factor if abs(table[key]) < 1e300 else factor
        else:
            table[key if kind == "change" else name] = value
        if not any(True for _ in _places(tables)):
            tables["name"] = "empty"
    return tables


def _places(tables):
    for key, value in tables.items():
        yield tables, key
        if isinstance(value, dict):
            yield from _places(value)
