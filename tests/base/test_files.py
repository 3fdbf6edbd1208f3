"""Files as people have them: the same signals in many forms are read alike, or refused in one line that names the fault."""

import numpy as np
import pytest

import railjax
from railjax.base.file_units import STANDARD_GRAVITY, factor
from railjax.base.stamps import sampling
from railjax.base.text_table import open_table
from railjax.ride.rides import ACCELERATIONS, read_ride

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
    "a unit that one column says": (text(G, "time (s),ay,az (g)", digits=8), "utf-8", {}),
    "quoted decimal commas between commas": (
        text([[f'"{v:.6f}"'.replace(".", ",") for v in own] for own in SI], '"time (s)","ay (m/s2)","az (m/s2)"'),
        "utf-8",
        {},
    ),
    "a clock in whole seconds": (text(([f"18:53:{int(t):02d}" for t in TIME], *SI[1:]), "time,ay (m/s2),az (m/s2)"), "utf-8", {}),
    "another code page": (
        text(SI, "čas (s);příčné zrychlení (m/s2);svislé (m/s2)", ";", ","),
        "cp1250",
        {"columns": {"time": "čas", "lateral": "příčné zrychlení", "vertical": "svislé"}},
    ),
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
        (text((TIME, LATERAL, VERTICAL + 1.0), UNITS), {}, "gravity in g; its unit is g"),
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
    def judged(path):
        ride = read_ride(path, **options)
        return railjax.comfort(ride.values, ride.rate, mean=False)

    path = written(tmp_path, content)
    with pytest.raises(railjax.InputError, match=message) as caught:
        judged(path)
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


# tracks

DISTANCE = 0.25 * np.arange(6001)


def line(s):
    return 4e-3 * (np.sin(2 * np.pi * s / 17.0) + 0.5 * np.cos(2 * np.pi * s / 43.0))


ALIGNMENT = line(DISTANCE)


def versines(chord):
    return ALIGNMENT - 0.5 * (line(DISTANCE - 0.5 * chord) + line(DISTANCE + 0.5 * chord))


#: name -> text, encoding, options of `from_csv`
TRACKS = {
    "commas": (text((DISTANCE, 1e3 * ALIGNMENT), "distance (m),alignment (mm)"), "utf-8", {}),
    "semicolons, decimal commas, told": (
        text((12.5 + 1e-3 * DISTANCE, 1e3 * ALIGNMENT, 0 * DISTANCE + 3), "stan [km];posun [mm];prevyseni [mm]", ";", ","),
        "cp1250",
        {"columns": {"distance": "stan", "alignment": "posun", "cross_level": "prevyseni"}},
    ),
    "descending kilometres": (
        text((12.5 + 1e-3 * DISTANCE[::-1], 1e3 * ALIGNMENT[::-1]), "station [km]\talignment [mm]", "\t"),
        "utf-16",
        {},
    ),
    "no header": (text((DISTANCE, 1e3 * ALIGNMENT), "", " "), "utf-8", {"columns": {"distance": "1", "alignment": "2"}, "units": {"alignment": "mm"}}),
    "feet and inches": (text((DISTANCE / 0.3048, ALIGNMENT / 0.0254), "Location (ft),Alignment (in)", digits=8), "utf-8", {}),
    "miles": (text((100.0 + DISTANCE / 1609.344, ALIGNMENT / 0.0254), "milepost (mi),alignment_in", digits=8), "utf-8", {}),
    "empty cells of the gauge": (
        text((DISTANCE, ["" if 800 < k < 900 else "1435.0" for k in range(6001)], 1e3 * ALIGNMENT, 1e3 * ALIGNMENT), "chainage (m),gauge (mm),alignment left (mm),alignment right (mm)"),
        "utf-8",
        {},
    ),
    "sentinels in the cant": (
        text((DISTANCE, 1e3 * ALIGNMENT, np.where(DISTANCE == 50.0, -9999.0, 3.0)), "Chainage (m);Alignment (mm);Cant (mm)", ";", ","),
        "utf-8",
        {},
    ),
}  # fmt: skip


@pytest.mark.parametrize("form", TRACKS)
def test_a_track_is_read_in_every_form(tmp_path, form):
    content, encoding, options = TRACKS[form]
    track = railjax.MeasuredTrack.from_csv(written(tmp_path, content, encoding, "line.csv"), **options)
    assert track.label.distance[0] == pytest.approx(track.label.distance[-1] - 1500.0, abs=1e-3)
    np.testing.assert_allclose(track.label.alignment, ALIGNMENT, atol=1e-8)
    if "cells" in form or "sentinels" in form:
        assert "left out (line" in str(track)
        assert track.gauge is None
        assert track.cross_level is None
    if "descending" in form:
        assert "turned round" in str(track)


def test_spikes_and_holes_are_named_and_bridged_on_request(tmp_path):
    spoilt = ALIGNMENT.copy()
    spoilt[777] += 0.02
    spoilt[2000] -= 0.005
    track = railjax.MeasuredTrack(DISTANCE, spoilt)
    assert "2 spike(s) of a single sample kept (bridge takes them out), at 194.25, 500 m" in str(track)
    mended = railjax.MeasuredTrack(DISTANCE, spoilt, bridge=2.0)
    np.testing.assert_allclose(mended.label.alignment, ALIGNMENT, atol=2e-5)
    assert "spike" not in str(railjax.MeasuredTrack(DISTANCE, ALIGNMENT))
    cells = [f"{1e3 * v:.5f}" for v in ALIGNMENT]
    cells[1000:1003], cells[3000] = [""] * 3, "-999"
    path = written(tmp_path, text((DISTANCE, cells), "distance (m),alignment (mm)"), name="line.csv")
    with pytest.raises(railjax.InputError, match=r"line 1002: column 'alignment .*' holds ''"):
        railjax.MeasuredTrack.from_csv(path)
    with pytest.raises(railjax.InputError, match=r"hole of 1 m after 249.75 m, longer than the 0.6 m"):
        railjax.MeasuredTrack.from_csv(path, bridge=0.6)
    mended = railjax.MeasuredTrack.from_csv(path, bridge=2.0)
    np.testing.assert_allclose(mended.label.alignment, ALIGNMENT, atol=2e-4)
    assert "2 hole(s) bridged, the first at 250 m" in str(mended)
    kept = (DISTANCE < 300.0) | (DISTANCE > 306.0)
    with pytest.raises(railjax.InputError, match=r"a gap of 6.5 m after 299.75 m"):
        railjax.MeasuredTrack(DISTANCE[kept], ALIGNMENT[kept])
    assert "the widest of 6.5 m after 299.75 m" in str(railjax.MeasuredTrack(DISTANCE[kept], ALIGNMENT[kept], bridge=7.0))


@pytest.mark.parametrize("chord", [10.0, 31 * 0.3048, 62 * 0.3048, 124 * 0.3048])
def test_versines_are_restored_to_the_space_curve(chord):
    track = railjax.MeasuredTrack(DISTANCE, versines(chord), chord=chord, longest=90.0)
    inner = (DISTANCE > 500.0) & (DISTANCE < 1000.0)
    found = np.asarray(railjax.alignment(track, DISTANCE[inner] + 20.0))
    lost = "17.4 to 20.7 m" in str(track)  # 17 m is near enough to half of 124 ft to come back with less
    np.testing.assert_allclose(found, ALIGNMENT[inner], atol=5e-4 if lost else 4e-5)
    assert f"restored from versines over a chord of {chord:g} m" in str(track)
    assert "waves longer than 90 m are filtered away" in str(track)


@pytest.mark.parametrize(
    ("columns", "header", "message"),
    [
        (
            (DISTANCE, ALIGNMENT / 0.0254),
            "distance (m),alignment",
            r"alignment 0.236 m from its middle.*says no unit.*alignment=mm",
        ),
        ((12.5 + 1e-3 * DISTANCE, 1e3 * ALIGNMENT), "km post,alignment (mm)", "no column of the distance"),
        (
            (12.5 + 1e-3 * DISTANCE, 1e3 * ALIGNMENT),
            "station,alignment (mm)",
            r"a sample every 0.00025 m.*give its unit, as distance=km",
        ),
    ],
)
def test_a_track_without_units_is_doubted(tmp_path, columns, header, message):
    with pytest.raises(railjax.InputError, match=message) as caught:
        railjax.MeasuredTrack.from_csv(written(tmp_path, text(columns, header, digits=7), name="line.csv"))
    assert len(str(caught.value).splitlines()) == 1


def test_versines_are_not_taken_for_alignment(tmp_path):
    path = written(tmp_path, text((DISTANCE, 1e3 * versines(10.0)), "distance (m);versine 10 m (mm)", ";", ","), name="line.csv")
    with pytest.raises(railjax.InputError, match="no column of the lateral alignment"):
        railjax.MeasuredTrack.from_csv(path)
    told = {"alignment": "versine 10 m"}
    with pytest.raises(railjax.InputError, match="holds versines over a chord; give the chord's length"):
        railjax.MeasuredTrack.from_csv(path, columns=told)
    assert railjax.MeasuredTrack.from_csv(path, columns=told, chord=10.0).label.alignment.shape == (6001,)
    for options, message in (
        ({"chord": 0.5}, "chord must lie"),
        ({"chord": 10.0, "longest": 300.0}, "shows 0.5%"),
        ({"bridge": -1.0}, "bridge must be"),
    ):
        with pytest.raises(railjax.InputError, match=message):
            railjax.MeasuredTrack(DISTANCE, versines(10.0), **options)


# spectra


@pytest.mark.parametrize(
    ("header", "separator", "decimal", "scale"),
    [
        ("frequency (1/m);PSD (mm²/(1/m))", ";", ",", (2 * np.pi, 1e-6 / (2 * np.pi))),
        ("wavenumber [rad/m]\tdensity [cm^2/(rad/m)]", "\t", ".", (1.0, 1e-4)),
        ("frequency (cycle/ft),PSD (in^2/(cycle/ft))", ",", ".", (2 * np.pi / 0.3048, 0.0254**2 * 0.3048 / (2 * np.pi))),
    ],
)
def test_a_spectrum_in_every_form(tmp_path, header, separator, decimal, scale):
    frequency, density = np.geomspace(0.01, 1.0, 20), np.geomspace(400.0, 3e-3, 20)
    path = written(tmp_path, text((frequency, density), header, separator, decimal, digits=9), "utf-16", "psd.txt")
    of = railjax.spectrum(path)
    np.testing.assert_allclose(of.wavenumber, frequency * scale[0], rtol=1e-6)
    np.testing.assert_allclose(of.values, density * scale[1], rtol=1e-5)
    with pytest.raises(railjax.InputError, match="does not say its unit"):
        railjax.spectrum(written(tmp_path, text((frequency, density), "frequency,psd"), name="bare.csv"))


# damper records

T = np.arange(1500) / 500.0
X, U = 0.011 * np.sin(2 * np.pi * 2.5 * T), np.where(T > 1.5, 1.5, 0.5)
V, F = 0.011 * 5 * np.pi * np.cos(2 * np.pi * 2.5 * T), 900.0 * np.cos(2 * np.pi * 2.5 * T)


@pytest.mark.parametrize(
    ("content", "options"),
    [
        (text((T, 1e2 * X, 1e2 * V, U, F), "time (s);displacement (cm);velocity (cm/s);Voltage (V);Force (N)", ";", ",", 7), {}),
        (text((1e6 * T, X / 0.0254, V / 0.0254, U, F / 4448.2216152605), "t_us,stroke_in,velocity_in/s,volts_V,load_kip", digits=9), {}),
        (text((T, X, U, F / 9.80665), "time,disp,cmd,force\ns,m,V,kgf", digits=8), {}),
        (text((F / 9806.65, 1e3 * X, U), "", "\t", ",", 8), {"columns": {"force": "1", "displacement": "2", "command": "3"}, "units": {"force": "tf", "displacement": "mm", "command": "V"}, "sample_rate": 500.0}),
    ],
)  # fmt: skip
def test_a_damper_record_in_every_form(tmp_path, content, options):
    record = railjax.read_record(written(tmp_path, content), **options)
    assert record.dt == pytest.approx(2e-3)
    np.testing.assert_allclose(record.displacement, X, atol=1e-8)
    np.testing.assert_allclose(record.force, F, atol=1e-3)
    np.testing.assert_allclose(record.command, U, atol=1e-6)


@pytest.mark.parametrize(
    ("columns", "header", "options", "message"),
    [
        ((T, 1e2 * X, 1e2 * V, U, F), "time,displacement,velocity,voltage,force", {}, r"a displacement of 1.1 m .* is none of a damper; give its unit, --displacement-unit cm"),
        ((T, 1e2 * V, U, F), "time,velocity,voltage,force", {}, r"a velocity of 17.3 m/s .* --velocity-unit cm/s"),
        ((T, X, U, 1e-3 * F), "time,displacement,voltage,force", {}, r"a force of 0.9 N .* --force-unit kN"),
        ((T, X, U, F), "time (s),displacement (m),signal,force (N)", {}, r"no column of the command is known, and it may be 'signal'; name it with --command"),
        ((T, X, U, F), "time (s);stroke (m);weg;force (N)", {"columns": {"displacement": "wg"}}, "no column 'wg' for --displacement"),
    ],
)  # fmt: skip
def test_a_damper_record_is_refused_in_one_true_line(tmp_path, columns, header, options, message):
    path = written(tmp_path, text(columns, header, ";" if ";" in header else ","))
    with pytest.raises(railjax.InputError, match=message) as caught:
        railjax.read_record(path, **options)
    assert len(str(caught.value).splitlines()) == 1


def test_a_record_without_a_command_says_so(tmp_path):
    path = written(tmp_path, text((T, X, U, F), "time (s),displacement (m),signal,force (N)"))
    assert not railjax.read_record(path, columns={"command": "none"}).command.any()
    np.testing.assert_allclose(railjax.read_record(path, columns={"command": "signal"}).command, U)
    warm = written(tmp_path, text((T, X, U, F), "time (s),displacement (m),oil (degC),force (N)"), name="warm.csv")
    assert not railjax.read_record(warm).command.any()
