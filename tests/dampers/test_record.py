"""Test records: columns and units as told or as the header says; whatever is wrong is one line."""

import numpy as np
import pytest

import railjax
from railjax.dampers.identification.record import acceleration, derivative, read_record

COUNT, RATE = 800, 1000.0


def motion():
    t = np.arange(COUNT) / RATE
    return {
        "t": t,
        "x": 0.01 * np.sin(2 * np.pi * 3 * t),
        "v": 0.01 * 6 * np.pi * np.cos(2 * np.pi * 3 * t),
        "u": np.sin(9 * t),
        "F": 1e3 * np.cos(2 * np.pi * 3 * t),
    }


def written(tmp_path, columns, name="test.csv", extra=""):
    path = tmp_path / name
    rows = [",".join(columns)] + [",".join(f"{value:.9g}" for value in row) for row in zip(*columns.values(), strict=True)]
    path.write_text("\n".join(rows) + "\n" + extra)
    return path


def test_reads_what_the_header_says(tmp_path):
    m = motion()
    columns = {"time (s)": m["t"], "Displacement [mm]": 1e3 * m["x"], "velocity (cm/s)": 1e2 * m["v"], "current (A)": m["u"]}
    record = read_record(written(tmp_path, columns | {"force (kN)": 1e-3 * m["F"]}, extra="\n\n"))
    assert record.dt == pytest.approx(1 / RATE)
    np.testing.assert_allclose(record.displacement, m["x"], atol=1e-10)
    np.testing.assert_allclose(record.velocity, m["v"], atol=1e-9)
    np.testing.assert_allclose(record.force, m["F"], atol=1e-5)
    np.testing.assert_allclose(record.command, np.maximum(m["u"], 0.0), atol=1e-8)
    assert any("negative values count as 0" in note for note in record.notes)
    assert not any("assumed; neither" in note for note in record.notes)


def test_reads_what_it_is_told(tmp_path):
    m = motion()
    path = written(tmp_path, {"a": 1e2 * m["x"], "b": m["F"], "time": m["t"], "": m["u"] * 0})
    named = {"displacement": "a", "force": "b"}
    record = read_record(path, columns=named, units={"displacement": "cm", "force": "kN"})
    np.testing.assert_allclose(record.displacement, m["x"], atol=1e-10)
    np.testing.assert_allclose(record.force, 1e3 * m["F"], rtol=1e-7, atol=1e-3)
    # without a velocity: the derivative
    np.testing.assert_allclose(record.velocity, m["v"], atol=4e-3 * 0.19)
    assert np.all(record.command == 0)
    assert any("derivative" in note for note in record.notes)
    assert any("unit of time" in note for note in record.notes)


def test_velocity_alone_and_a_rate_instead_of_time(tmp_path):
    m = motion()
    record = read_record(written(tmp_path, {"v": m["v"], "F": m["F"]}), sample_rate=RATE)
    np.testing.assert_allclose(record.displacement, m["x"], atol=2e-6)
    expected = -((6 * np.pi) ** 2) * m["x"]
    np.testing.assert_allclose(acceleration(record)[20:-20], expected[20:-20], atol=1e-3 * 3.55)
    assert len(record.until(600).every(3)) == 200
    assert record.every(4).dt == pytest.approx(4e-3)


def test_a_time_that_begins_anew_begins_a_stretch(tmp_path):
    m = motion()
    again = {name: np.concatenate([values, values[:600]]) for name, values in m.items()}
    record = read_record(written(tmp_path, again))
    assert record.begins == (0, COUNT)
    assert [len(record.velocity[stretch]) for stretch in record.stretches] == [COUNT, 600]
    np.testing.assert_allclose(acceleration(record)[COUNT:], acceleration(record)[:600], rtol=1e-9, atol=2e-2)


def test_noisy_displacements_are_smoothed_over_more_samples():
    time = np.arange(2000) * 2e-3
    clean = 0.01 * np.sin(2 * np.pi * 5 * time)
    found, window = derivative(clean, 2e-3)
    assert window == 5
    np.testing.assert_allclose(found[5:-5], 0.1 * np.pi * np.cos(2 * np.pi * 5 * time)[5:-5], atol=1e-4)
    noisy, wider = derivative(clean + 2e-6 * np.random.default_rng(1).standard_normal(2000), 2e-3)
    assert 9 <= wider <= 27
    assert np.std(noisy - found) < 4e-3 * np.std(found)


def test_a_rounded_time_is_even(tmp_path):
    m = motion()
    fine = dict(m, t=np.round(m["t"] / 3.0, 4))
    assert read_record(written(tmp_path, fine | {"v": 3 * m["v"]})).dt == pytest.approx(1 / (3 * RATE), rel=1e-3)


def spoilt(key, sample, value):
    columns = motion()
    columns[key] = columns[key].copy()
    columns[key][sample] = value
    return columns


@pytest.mark.parametrize(
    ("columns", "options", "message"),
    [
        (spoilt("F", 10, np.nan), {}, r"line 12: column 'F' is nan; cut"),
        (spoilt("x", 0, np.inf), {}, r"line 2: column 'x' is inf"),
        (spoilt("t", 7, 6e-3), {}, r"time does not increase from sample 7 \(0\.006 s\)"),
        (dict(motion(), t=motion()["t"] ** 2), {}, "not evenly spaced"),
        (motion(), {"columns": {"force": "load"}}, r"no column 'load' for --force; there are t, x, v, u, F"),
        (motion(), {"units": {"force": "lb"}}, "--force-unit must be one of N, kN, lbf, not 'lb'"),
        (
            motion(),
            {"units": {"displacement": "mm"}},
            r"changes 0.001 times as fast as the velocity says; check --displacement-unit",
        ),
        ({k: v for k, v in motion().items() if k != "F"}, {}, "no column of the force; name it with --force"),
        ({k: v for k, v in motion().items() if k not in "xv"}, {}, "no column of displacement or velocity"),
        ({k: v for k, v in motion().items() if k != "t"}, {}, "no column of the time"),
        ({k: v[:100] for k, v in motion().items()}, {}, "100 samples are too few"),
        (dict(motion(), F=np.full(COUNT, 900.0)), {}, "the force never changes"),
        (
            {("F (stone)" if k == "F" else k): v for k, v in motion().items()},
            {},
            "unit 'stone' of column 'F .stone.' is not known",
        ),
    ],
)
def test_bad_records_are_refused_in_one_line(tmp_path, columns, options, message):
    with pytest.raises(railjax.InputError, match=message) as caught:
        read_record(written(tmp_path, columns), **options)
    assert len(str(caught.value).splitlines()) == 1


def test_files_that_are_no_record(tmp_path):
    with pytest.raises(railjax.InputError, match="No such file"):
        read_record(tmp_path / "missing.csv")
    (tmp_path / "binary.csv").write_bytes(bytes(range(128, 256)) * 20)
    with pytest.raises(railjax.InputError, match="cannot be read as CSV"):
        read_record(tmp_path / "binary.csv")
    with pytest.raises(railjax.InputError, match=r"line 802: column 't' holds 'end', not a number"):
        read_record(written(tmp_path, motion(), extra="end,of,test,is,here\n"))
    with pytest.raises(railjax.InputError, match=r"line 802: column 'x' holds '', not a number"):
        read_record(written(tmp_path, motion(), extra="0.8\n"))
