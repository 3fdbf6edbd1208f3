"""Files as people have them: the same signals in many forms are read alike, or refused in one line that names the fault."""

import numpy as np
import pytest

import railjax
from railjax.file_units import STANDARD_GRAVITY, factor
from railjax.rides import ACCELERATIONS, read_ride
from railjax.stamps import sampling
from railjax.text_table import open_table

RATE, COUNT = 200.0, 2400
TIME = np.arange(COUNT) / RATE
LATERAL = 0.3 * np.sin(2 * np.pi * 1.3 * TIME) + 0.1 * np.sin(2 * np.pi * 7.1 * TIME + 1.0)
VERTICAL = 0.4 * np.sin(2 * np.pi * 1.9 * TIME + 0.5)
STAMPS = np.datetime64("2026-11-25T23:59:57.000", "ms") + np.round(1e3 * TIME).astype("timedelta64[ms]")


def text(columns, header, separator=",", decimal=".", digits=6, before="", end="\n"):
    """Lines of a file of numbers (arrays) and texts (lists)."""
    cells = [[v if isinstance(v, str) else f"{v:.{digits}f}".replace(".", decimal) for v in values] for values in columns]
    lines = [separator.join(row) for row in zip(*cells, strict=True)]
    return before + end.join(([header] if header else []) + lines) + end


def written(tmp_path, content, encoding="utf-8", name="ride.csv"):
    path = tmp_path / name
    path.write_bytes(content.encode(encoding))
    return path


SI = (TIME, LATERAL, VERTICAL)
G = (TIME, LATERAL / STANDARD_GRAVITY, VERTICAL / STANDARD_GRAVITY)
NOTE = [f"km 12+{k} ok" for k in range(COUNT)]

#: name -> text, encoding, options of `read_ride`
RIDES = {
    "commas": (text(SI, "time (s),lateral (m/s^2),vertical (m/s^2)"), "utf-8", {}),
    "semicolons, decimal commas": (text(SI, "Time [s];ay [m/s²];az [m/s²]", ";", ","), "utf-8", {}),
    "code page": (text(SI, "time (s),ay (m/s²),az (m/s²)", end="\r\n"), "cp1252", {}),
    "code page and umlauts": (text((*SI, NOTE), "Zeit (s);ay (m/s²);az (m/s²);Höhe über Gleis", ";", ","), "cp1252", {}),
    "UTF-16, tabs, decimal commas": (text(SI, "time (s)\tay (m/s²)\taz (m/s²)", "\t", ","), "utf-16", {}),
    "UTF-16 without a mark": (text(SI, "time (s)\tay (m/s^2)\taz (m/s^2)", "\t"), "utf-16-be", {}),
    "blanks": (text(SI, "time   ay   az", "   "), "utf-8", {"units": {"lateral": "m/s2", "vertical": "m/s2", "time": "s"}}),
    "blanks and units with blanks": (text(SI, "time (s)  ay (m s^-2)  az (m s^-2)", "  "), "utf-8", {}),
    "comments, a row of units, a mark": (
        text(SI, "time,ay,az\ns,m/s^2,m/s^2", before="# Coach 12, floor, bogie 1\n# fs = 200 Hz\n"),
        "utf-8-sig",
        {},
    ),
    "a row of units in brackets": (text(SI, "Time;Ay;Az\n(s);(m/s2);(m/s2)", ";", ","), "utf-8", {}),
    "header in a comment": (text(SI, "# time (s), ay (m/s2), az (m/s2)"), "utf-8", {}),
    "header and units in comments": (text(G, "# time, ay, az\n# s, g, g", digits=8), "utf-8", {}),
    "lines before the header": (text(SI, "time (s),ay (m/s2),az (m/s2)", before="Logger 7\nDate,2026-11-25\n\n"), "utf-8", {}),
    "sep= of spreadsheets": (text(SI, "time (s);ay (m/s2);az (m/s2)", ";", before="sep=;\n"), "utf-8", {}),
    "quoted": (text(SI, '"Time (s)","Ay (m/s2)","Az (m/s2)"'), "utf-8", {}),
    "quoted numbers": (
        text([[f'"{v:.6f}"'.replace(".", ",") for v in own] for own in SI], '"time (s)";"ay (m/s2)";"az (m/s2)"', ";"),
        "utf-8",
        {},
    ),
    "a header over two lines": (text(SI, '"time\n(s)","ay\n(m/s2)","az\n(m/s2)"'), "utf-8", {}),
    "no header": (
        text(SI, ""),
        "utf-8",
        {"columns": {"time": "1", "lateral": "2", "vertical": "3"}, "units": {"lateral": "m/s2"}},
    ),
    "no header, semicolons": (text(SI, "", ";", ","), "utf-8", {"columns": {"time": "1", "lateral": "2", "vertical": "3"}}),
    "capitals": (text(SI, "TIME (S),LATERAL ACCELERATION (M/S2),VERTICAL ACCELERATION (M/S2)"), "utf-8", {}),
    "sec and G": (text(G, "Time (sec),Lateral (G),Vertical (G)", digits=8), "utf-8", {}),
    "milliseconds": (text((1e3 * TIME, *G[1:]), "time (msec),ay (g),az (g)", digits=8), "utf-8", {}),
    "microseconds and mg": (text((1e6 * TIME, 1e3 * G[1], 1e3 * G[2]), "t [µs];ay [mg];az [mg]", ";", ","), "cp1252", {}),
    "nanoseconds of an epoch": (
        text(([f"{1764111597_000000000 + k * 5_000_000}" for k in range(COUNT)], *SI[1:]), "time,ay (m/s/s),az (ms-2)"),
        "utf-8",
        {},
    ),
    "seconds of an epoch": (
        text(([f"{1764111597 + t:.3f}" for t in TIME], *SI[1:]), "timestamp,ay (m/s2),az (m/s2)"),
        "utf-8",
        {},
    ),
    "ISO 8601": (text(([f"{s}Z" for s in STAMPS.astype(str)], *SI[1:]), "time,ay (m/s2),az (m/s2)"), "utf-8", {}),
    "date and time": (
        text(
            ([s.replace("T", " ").replace(".", ",") for s in STAMPS.astype(str)], *SI[1:]), "time;ay (m/s2);az (m/s2)", ";", ","
        ),
        "utf-8",
        {},
    ),
    "clock over midnight": (text(([s[11:] for s in STAMPS.astype(str)], *SI[1:]), "time,ay (m/s2),az (m/s2)"), "utf-8", {}),
    "slash": (text(SI, "t / s;ay / m/s²;az / m/s²", ";"), "utf-8", {}),
    "suffix": (text(SI, "time_s,ay_m_s2,az_m_per_s2"), "utf-8", {}),
    "suffix g": (text((1e3 * TIME, *G[1:]), "time_ms,ay_g,az_g", digits=8), "utf-8", {}),
    "after a comma": (text(SI, "t, s;ay, m/s2;az, m/s2", ";"), "utf-8", {}),
    "feet": (text((TIME, LATERAL / 0.3048, VERTICAL / 0.0254), "time (s),ay (ft/s^2),az (in/s^2)"), "utf-8", {}),
    "text beside": (text((NOTE, *SI), "place,time (s),ay (m/s2),az (m/s2)"), "utf-8", {}),
    "empty cells beside": (text((["", "x"] * (COUNT // 2), *SI), "mark,time (s),ay (m/s2),az (m/s2)"), "utf-8", {}),
    "separator at the end": (text((*SI, [""] * COUNT), "time (s);ay (m/s2);az (m/s2);", ";"), "utf-8", {}),
    "exponents": (
        text([[f"{v:.7E}".replace(".", ",") for v in own] for own in SI], "time (s);ay (m/s2);az (m/s2)", ";"),
        "utf-8",
        {},
    ),
    "told in other units": (text(SI, "a;b;c", ";", ","), "utf-8", {"columns": {"time": "A", "lateral": "b", "vertical": "c"}}),
    "without units, gravity in it": (text((G[0], G[1], G[2] + 1.0), "time,ay,az", digits=8), "utf-8", {}),
    "without units, gravity in m/s2": (text((TIME, LATERAL, VERTICAL - STANDARD_GRAVITY), "time,ay,az"), "utf-8", {}),
    "phone": (
        text((G[0], G[1], 0 * TIME, G[2] + 1.0, 0 * TIME + 1), "time;gFx;gFy;gFz;TgF", ";", ",", digits=8),
        "utf-8",
        {"columns": {"lateral": "gFx", "vertical": "gFz"}},
    ),
}


@pytest.mark.parametrize("form", RIDES)
def test_a_ride_is_read_in_every_form(tmp_path, form):
    content, encoding, options = RIDES[form]
    ride = read_ride(written(tmp_path, content, encoding), **options)
    assert ride.rate == pytest.approx(RATE, rel=1e-6)
    np.testing.assert_allclose(ride.values["lateral"], LATERAL, atol=2e-6)
    vertical = ride.values["vertical"]
    np.testing.assert_allclose(vertical - vertical.mean(), VERTICAL - VERTICAL.mean(), atol=2e-6)


def test_a_single_column_with_decimal_commas(tmp_path):
    ride = read_ride(written(tmp_path, text([LATERAL], "ay (m/s2)", decimal=",")), sample_rate=RATE)
    np.testing.assert_allclose(ride.values["lateral"], LATERAL, atol=2e-6)


UNITS = "time (s),ay (m/s2),az (m/s2)"


@pytest.mark.parametrize(
    ("content", "options", "message"),
    [
        (
            text(SI, "time (s),ay (m/s2),az (m/s2)", decimal=","),
            {},
            r"the header names 3 columns, the rows have 6 cells .*decimal commas",
        ),
        (text(SI[:2], "", decimal=","), {}, "has no header, only 4 column|separators or decimal marks"),
        (text([np.arange(COUNT), np.arange(COUNT)], "", digits=0), {}, "two cells or a decimal comma"),
        (
            text(SI, "a;b;c", ";", ","),
            {},
            r"no column of an acceleration.*there are a, b, c \(cells separated by ';' with decimal commas\)",
        ),
        (text(SI, "", ";", ","), {}, r"has no header, only 3 column.*';' with decimal commas; name them by number"),
        (text(SI, UNITS, ";", ","), {}, "the header names|no column"),
        (text(SI, UNITS).replace("0.500000,", "0.500000,-999,", 1), {}, "line 102: 4 cells, where the header has 3"),
        (
            text(SI, UNITS).replace("\n0.500000,", "\n0.500000,,", 1).replace(f",{VERTICAL[100]:.6f}", "", 1),
            {},
            "line 102: .* holds ''",
        ),
        (
            text((TIME, np.where(TIME == 1.0, -999.0, LATERAL), VERTICAL), UNITS),
            {},
            "line 202: column 'ay .*' holds -999.*no value",
        ),
        (text((TIME, LATERAL, VERTICAL + 1.0), UNITS), {}, ""),
        (
            text((1e3 * TIME, *SI[1:]), "time,ay (m/s2),az (m/s2)"),
            {},
            "a sample every 5 s, if the time is in s; give its unit by --time-unit",
        ),
        (text(SI, "time (s),ay (m/s2),Ay (g)"), {}, r"columns 'ay \(m/s2\)' and 'Ay \(g\)' may all be the lateral"),
        (text((TIME, LATERAL, 1e3 * (G[2] + 1.0)), "time,ay,az"), {}, "the vertical acceleration has the mean 1000 and no unit"),
        (
            text(SI, "time (s);ay (m/s2);az (m/s2)", ";", ",").replace("0,500000;", "0.500000;", 1),
            {},
            "line 102: .* holds '0.500000'",
        ),
        (text(SI, "time (s),ay (m/s2),az (m/s2)") + "9,8\n", {}, "line 2402: column 'az .*' holds ''"),
        (text(SI, "time (s),ay (m/s2),az (m/s2)").replace("\n0.25", '\n"0.25', 1), {}, "not closed|holds"),
        ("\n\n# nothing\n", {}, "holds no numbers"),
        ("time,ay\n", {}, "no rows of numbers"),
    ],
)
def test_a_ride_is_refused_in_one_true_line(tmp_path, content, options, message):
    with pytest.raises(railjax.InputError, match=message) as caught:
        ride = read_ride(written(tmp_path, content), **options)
        railjax.comfort(ride.values, ride.rate, mean=False)
    assert len(str(caught.value).splitlines()) == 1


def test_a_bad_cell_of_a_column_that_is_not_used_is_no_matter(tmp_path):
    beside = [["", "-999", "bad", "1"][k % 4] for k in range(COUNT)]
    path = written(tmp_path, text((*SI, beside), UNITS + ",vy (m/s)"))
    np.testing.assert_allclose(read_ride(path).values["lateral"], LATERAL, atol=2e-6)


def test_gravity_along_another_direction_or_in_another_unit_is_said():
    with pytest.raises(railjax.InputError, match="gravity in g; its unit is g"):
        railjax.comfort({"lateral": LATERAL, "vertical": G[2] + 1.0}, RATE, mean=False)
    with pytest.raises(railjax.InputError, match="gravity lies along it"):
        railjax.comfort(LATERAL + 9.8, RATE, mean=False)
    with pytest.raises(railjax.InputError, match="more than gravity; check its unit"):
        railjax.comfort({"vertical": VERTICAL + 9.8 * STANDARD_GRAVITY}, RATE, mean=False)
    found = railjax.comfort({"vertical": VERTICAL - 9.8}, RATE, mean=False)
    assert "gravity is in the record" in str(found)
    np.testing.assert_allclose(found.rms["vertical"], railjax.comfort({"vertical": VERTICAL}, RATE, mean=False).rms["vertical"])


# units


@pytest.mark.parametrize(
    ("written", "table", "value"),
    [
        *((unit, ACCELERATIONS, 1.0) for unit in ("m/s²", "m/s/s", "ms-2", "m s^-2", "m·s⁻²", "M/S2", "m/s**2", "m.s-2", "m s-2")),
        *((unit, ACCELERATIONS, STANDARD_GRAVITY) for unit in ("g", "G", "gn", "[g]")),
        ("mG", ACCELERATIONS, 1e-3 * STANDARD_GRAVITY),
        ("cm/s²", ACCELERATIONS, 1e-2),
        ("ft/s^2", ACCELERATIONS, 0.3048),
        ("lateral", ACCELERATIONS, None),
        ("kg", ACCELERATIONS, None),
        *((unit, {"s": 1.0, "ms": 1e-3}, value) for unit, value in (("sec", 1.0), ("S", 1.0), ("MS", 1e-3), ("µs", 1e-6), ("us", 1e-6), ("ns", 1e-9), ("min", 60.0), ("h", 3600.0))),
        *((unit, {"N": 1.0, "kN": 1e3}, value) for unit, value in (("kip", 4448.2216), ("lbf", 4.4482216), ("kgf", 9.80665), ("tonf", 8896.4432), ("tf", 9806.65), ("MN", 1e6), ("KN", 1e3), ("lb", None))),
        *((unit, {"m": 1.0, "mm": 1e-3}, value) for unit, value in (("in", 0.0254), ("ft", 0.3048), ("mi", 1609.344), ("MM", 1e-3), ("yd", 0.9144), ("km", 1e3), ("s", None))),
        *((unit, {"m/s": 1.0}, value) for unit, value in (("km/h", 1 / 3.6), ("kmh", 1 / 3.6), ("mph", 0.44704), ("in/s", 0.0254), ("cm/s", 0.01))),
        *((unit, {"rad/m": 1.0}, value) for unit, value in (("1/m", 2 * np.pi), ("cycle/ft", 2 * np.pi / 0.3048), ("rad/ft", 1 / 0.3048))),
        *((unit, {"m^2/(rad/m)": 1.0}, value) for unit, value in (("mm²/(1/m)", 1e-6 / (2 * np.pi)), ("in^2/(cycle/ft)", 0.0254**2 * 0.3048 / (2 * np.pi)), ("cm^2 m/rad", 1e-4))),
    ],
)  # fmt: skip
def test_units_as_they_are_written(written, table, value):
    found = factor(written, table)
    assert found is None if value is None else found == pytest.approx(value, rel=1e-7)


# stamps


def smooth(t):
    return np.sin(2 * np.pi * 1.3 * t) + 0.3 * np.sin(2 * np.pi * 7.0 * t)


def test_jittered_stamps_are_resampled():
    random = np.random.default_rng(1)
    stamps = TIME + random.uniform(-1.5e-3, 1.5e-3, COUNT)
    grid = sampling(stamps, None, "ride")
    assert 1.0 / grid.dt == pytest.approx(RATE, rel=1e-9)
    found = grid.even(smooth(stamps))
    np.testing.assert_allclose(found, smooth(stamps[0] + grid.dt * np.arange(len(found))), atol=2e-3)
    assert "resampled at 200 Hz" in grid.notes[0]


@pytest.mark.parametrize("digits", [2, 1])
@pytest.mark.parametrize("cut", [np.round, lambda x: np.floor(x + 1e-9)])
def test_coarsely_rounded_stamps_are_even(digits, cut):
    grid = sampling(cut(TIME * 10**digits) / 10**digits, None, "ride")
    assert grid.stamps is None
    assert 1.0 / grid.dt == pytest.approx(RATE, rel=1e-9)
    assert "rounded to" in grid.notes[0]


def test_holes_are_bridged_and_named_up_to_a_length():
    kept = np.ones(COUNT, bool)
    kept[500:510] = kept[900:903] = False
    grid = sampling(TIME[kept], None, "ride")
    found = grid.even(smooth(TIME[kept]))
    assert len(found) == COUNT
    np.testing.assert_allclose(found[kept], smooth(TIME[kept]), atol=1e-9)
    assert "2 hole(s) up to 0.055 s bridged, the first after 2.495 s" in " ".join(grid.notes)
    kept[500:600] = False
    with pytest.raises(railjax.InputError, match=r"a hole of 0.505 s after 2.495 s"):
        sampling(TIME[kept], None, "ride")
    assert len(sampling(TIME[kept], None, "ride", bridge=1.0).even(TIME[kept])) == COUNT


def test_a_told_rate_has_the_last_word(tmp_path):
    ride = read_ride(written(tmp_path, text(SI, UNITS)), sample_rate=100.0)
    assert ride.rate == 100.0
    assert any("--fs 100 Hz as told, though the time column says 200 Hz" in note for note in ride.notes)
    falling = written(tmp_path, text((np.where(TIME > 3.0, 0.0, TIME), *SI[1:]), UNITS), name="falling.csv")
    assert read_ride(falling, sample_rate=RATE).rate == RATE
    lacking = written(tmp_path, text((["?"] * COUNT, *SI[1:]), UNITS), name="lacking.csv")
    assert read_ride(lacking, sample_rate=RATE).rate == RATE
    with pytest.raises(railjax.InputError, match="time does not increase"):
        read_ride(falling)


def test_a_long_record_is_read_fast(tmp_path):
    import time

    rows = 200_000
    values = np.random.default_rng(0).normal(size=(rows, 2))
    path = tmp_path / "long.csv"
    lines = "\n".join(f"{k / RATE:.3f};{a:.5f};{b:.5f}".replace(".", ",") for k, (a, b) in enumerate(values))
    path.write_text("time (s);ay (g);az (g)\n" + lines)
    since = time.process_time()
    assert len(open_table(path, lambda cell: "ay" in cell)) == rows
    assert len(read_ride(path).values["lateral"]) == rows
    assert time.process_time() - since < 2.0
