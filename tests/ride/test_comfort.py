"""Ride comfort: closed forms of sines, Parseval, gradients, floor positions, reports, the command line."""

import csv
import json
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal
from derivatives import check

import railjax
from railjax.cli.application import status
from railjax.model.kinematics import deflections, lateral_of_floor, layout
from railjax.ride.comfort import FLOOR_POINTS
from railjax.ride.vibration import THIRD_OCTAVES, running_maximum, sperling_bands, vibration_dose

RATE = 200.0


def sine(amplitude, frequency, seconds, rate=RATE):
    return amplitude * np.sin(2 * np.pi * frequency * np.arange(round(seconds * rate)) / rate)


def factor(name, frequency):
    return abs(complex(railjax.weighting(name, frequency)))


@pytest.fixture(scope="module")
def noise():
    return np.random.default_rng(1).normal(size=(round(310 * RATE), 2)) * [0.2, 0.5]


@pytest.mark.parametrize("frequency", [0.6, 2.0, 5.0, 31.0])
def test_closed_forms_of_a_sine(frequency):
    a, settle, duration = 0.7, 10.0, 300.0
    found = railjax.comfort(sine(a, frequency, settle + duration), RATE, settle=settle)
    weighted = a * factor("Wd", frequency)
    for values in (found.rms, found.percentile):
        np.testing.assert_allclose(values["lateral"], weighted / np.sqrt(2), rtol=1e-3)
    # the most that 1 s of sin^2 can hold
    most = weighted * np.sqrt(0.5 * (1 + abs(np.sinc(2 * frequency))))
    np.testing.assert_allclose(found.running["lateral"], most, rtol=1e-3)
    np.testing.assert_allclose(found.blocks["lateral"], np.full(60, weighted / np.sqrt(2)), rtol=1e-3)
    np.testing.assert_allclose(found.mean, 6 * weighted / np.sqrt(2), rtol=1e-3)
    # the mean of sin^4 is 3/8
    np.testing.assert_allclose(found.dose["lateral"], weighted * (0.375 * duration) ** 0.25, rtol=1e-3)
    np.testing.assert_allclose(found.crest["lateral"], np.sqrt(2), rtol=2e-2)
    wz = (100 * a * factor("sperling-lateral", frequency)) ** (2 / 6.67)
    np.testing.assert_allclose(found.sperling["lateral"], wz, rtol=1e-9)
    band = THIRD_OCTAVES.index(round(10 * np.log10(frequency)))
    np.testing.assert_allclose(found.sperling_bands["lateral"][band], wz, rtol=1e-9)
    assert not found.notes


def test_sperlings_choices():
    a, b = sine(0.3, 1.0, 60.0), sine(0.2, 8.0, 60.0)
    first, second = (100 * x * factor("sperling-vertical", f) for x, f in ((0.3, 1.0), (0.2, 8.0)))
    np.testing.assert_allclose(railjax.sperling(a, RATE, "vertical", exponent=0.15), first**0.3, rtol=1e-9)
    np.testing.assert_allclose(railjax.sperling(a + b, RATE, "vertical"), (first**2 + second**2) ** (1 / 6.67), rtol=1e-9)
    tenth = (first ** (20 / 6.67) + second ** (20 / 6.67)) ** 0.1
    np.testing.assert_allclose(railjax.sperling(a + b, RATE, "vertical", power=10), tenth, rtol=1e-9)


def test_the_frequency_domain_is_the_filter_in_time(noise):
    """Parseval: r.m.s. of the weighted history against second-order sections, and against the spectrum's sum."""
    below_40 = scipy.signal.sosfiltfilt(scipy.signal.butter(8, 35.0, fs=1000.0, output="sos"), noise[:50000], axis=0)
    in_time = scipy.signal.sosfilt(railjax.weighting_filter("Wd", 1000.0), below_40, axis=0)
    found = railjax.weighted_acceleration(below_40, 1000.0, "Wd")
    np.testing.assert_allclose(railjax.weighted_rms(below_40, 1000.0), np.sqrt(np.mean(in_time**2, axis=0)), rtol=2e-4)
    # the filter is about a sample ahead
    assert np.max(np.abs(np.asarray(found)[1:] - in_time[:-1])) < 0.02 * np.max(np.abs(in_time))
    spectrum = np.abs(np.fft.rfft(below_40, axis=0)) ** 2 / len(below_40) ** 2
    weights = np.abs(np.asarray(railjax.weighting("Wd", np.fft.rfftfreq(len(below_40), 1e-3)))) ** 2
    summed = np.sqrt(2 * weights @ spectrum)
    np.testing.assert_allclose(railjax.weighted_rms(below_40, 1000.0), summed, rtol=1e-2)


def test_a_record_at_rest_before_it_begins():
    """Causal, as a filter switched on: nothing happens before an impulse, and no end wraps round to the beginning."""
    impulse = np.zeros(4000)
    impulse[2000] = 1.0
    found = np.asarray(railjax.weighted_acceleration(impulse, RATE, "Wd"))
    assert np.max(np.abs(found[:1990])) < 1e-3 * np.max(np.abs(found))
    late = np.zeros(4000)
    late[-1] = 1.0
    assert np.max(np.abs(railjax.weighted_acceleration(late, RATE, "Wd")[:3900])) < 1e-3 * np.max(np.abs(found))


def test_measures_against_plain_numpy(noise):
    found = railjax.comfort({"vertical": noise}, RATE)
    weighted = np.asarray(railjax.weighted_acceleration(noise - noise.mean(axis=0), RATE, "Wb"))
    blocks = [np.sqrt(np.mean(weighted[k * 1000 : (k + 1) * 1000] ** 2, axis=0)) for k in range(62)]
    np.testing.assert_allclose(found.blocks["vertical"], blocks, rtol=1e-9)
    np.testing.assert_allclose(found.mean, 6 * np.percentile(blocks, 95, axis=0), rtol=1e-9)
    slow = [np.sqrt(np.mean(weighted[k : k + 200] ** 2, axis=0)) for k in range(len(weighted) - 199)]
    np.testing.assert_allclose(found.running["vertical"], np.max(slow, axis=0), rtol=1e-9)
    np.testing.assert_allclose(found.dose["vertical"], (np.sum(weighted**4, axis=0) / RATE) ** 0.25, rtol=1e-9)
    np.testing.assert_allclose(found.crest["vertical"], np.abs(weighted).max(axis=0) / found.rms["vertical"], rtol=1e-9)


def test_three_directions_make_the_whole_of_n_mv(noise):
    three = {"lateral": noise, "vertical": 2 * noise, "longitudinal": 0.3 * noise}
    whole = railjax.comfort(three, RATE)
    parts = [railjax.comfort(values, RATE, direction=direction).mean for direction, values in three.items()]
    np.testing.assert_allclose(whole.mean, np.sqrt(np.sum(np.square(parts), axis=0)), rtol=1e-9)
    assert whole.weightings == {"lateral": "Wd", "vertical": "Wb", "longitudinal": "Wd"}
    assert "part alone" not in str(whole)
    assert "the lateral part alone" in str(railjax.comfort(noise, RATE))
    assert "longitudinal" not in whole.sperling
    other = railjax.comfort({"vertical": noise}, RATE, weightings={"vertical": "Wk"})
    np.testing.assert_allclose(other.rms["vertical"], railjax.weighted_rms(noise - noise.mean(axis=0), RATE, "Wk"), rtol=1e-9)


def test_scales_are_said_in_words():
    # C_Cy 0.25 m/s^2, N_MV 1.5; C_Cy 0.8, N_MV 4.8
    for rms, mean, continuous in ((0.26, "comfortable", "comfortable"), (0.8, "very uncomfortable", "less comfortable")):
        text = str(railjax.comfort(sine(rms * np.sqrt(2) / factor("Wd", 2.0), 2.0, 310.0), RATE, settle=10.0))
        assert f", {mean}\n" in text
        assert f"100% {continuous};" in text


def test_gradients():
    rate = 100.0
    record = np.random.default_rng(3).normal(size=round(12 * rate))
    other = np.random.default_rng(4).normal(size=len(record))

    def measures(x):
        a = record + x * other
        weighted = railjax.weighted_acceleration(a, rate, "Wd")
        found = railjax.weighted_rms(a, rate, settle=1.0), railjax.sperling(a, rate), vibration_dose(weighted, rate)
        return jnp.stack([*found, running_maximum(weighted, rate)])

    # one derivative for all, with shares of their own
    check(lambda x: jnp.array([1.0, 0.3, -0.7, 2.1]) @ measures(x), 0.3)
    assert np.all(np.isfinite(jax.grad(lambda a: railjax.weighted_rms(a, rate))(jnp.zeros(1000))))
    assert np.all(np.isfinite(jax.grad(lambda a: jnp.sum(sperling_bands(a, rate)))(jnp.zeros(round(12 * rate)))))


def test_gradient_of_comfort_through_a_simulation(coach):
    track = railjax.SinusoidTrack(2e-3, 25.0)

    def weighted(damping):
        vehicle = railjax.replace(coach, secondary__damping_y=damping)
        run = railjax.simulate(vehicle, 50.0, track=track, duration=2.0, dt=4e-3, record=["floor_acceleration"])
        return railjax.weighted_rms(run["floor_acceleration"][:, 0], 25.0)

    # one mode: both are checked of the simulation and of the measures, each by itself
    tangent = jax.jit(lambda c: jax.jvp(weighted, (c,), (1.0,)))
    (low, _), (high, _) = tangent(3e4 - 3.0), tangent(3e4 + 3.0)
    np.testing.assert_allclose(tangent(3e4)[1], (high - low) / 6.0, rtol=1e-5)


@pytest.fixture(scope="module")
def run(coach):
    coordinates = [f"carbody_{name}{order}" for name in ("y", "psi", "phi") for order in ("", "_acceleration")]
    record = ["floor_acceleration", *coordinates]
    track = railjax.BumpTrack(6e-3, 15.0, 5.0)
    return railjax.simulate(
        coach, 60.0, track=track, duration=2.0, dt=5e-4, sample=1e-3, record=record, reduce=["rms:floor_acceleration"]
    )


def test_floor_is_a_rigid_bodys(coach, run):
    """Positions of the points of a body turned by psi and phi, differentiated twice in time by differences."""
    y, psi, phi = (np.asarray(run[f"carbody_{name}"]) for name in ("y", "psi", "phi"))
    length = coach.geometry.half_pivot_distance
    for index, along in enumerate((length, 0.0, -length)):
        # Rz(psi) Rx(phi) (x, 0, z): its lateral part, z up and roll positive as the deflections count it
        lateral = y + along * np.sin(psi) + np.cos(psi) * np.sin(phi) * 0.6
        numeric = (lateral[2:] - 2 * lateral[1:-1] + lateral[:-2]) / 1e-6
        found = np.asarray(run["floor_acceleration"][1:-1, index])
        np.testing.assert_allclose(found, numeric, atol=4e-3 * np.max(np.abs(found)))
        np.testing.assert_allclose(railjax.floor_acceleration(run, along)[1:-1], found, rtol=1e-12, atol=1e-15)
    above = railjax.floor_acceleration(run, 3.0, 0.5) - railjax.floor_acceleration(run, 3.0, 0.0)
    np.testing.assert_allclose(above, -0.5 * run["carbody_phi_acceleration"], atol=1e-14)


def test_at_the_springs_the_floor_moves_as_they_do(coach):
    """Sign and height against the deflection of the secondary suspension with the bogies at rest."""
    same = railjax.replace(coach, geometry__carbody_to_floor=coach.geometry.carbody_height)
    random = np.random.default_rng(6)
    q = {name: jnp.asarray(random.normal(size=(*shape, 5)) * name.startswith("carbody")) for name, shape in layout(coach).items()}
    np.testing.assert_allclose(lateral_of_floor(same, q)[jnp.array([0, 2])], deflections(same, q)["secondary_y"], rtol=1e-12)


def test_floor_in_xarray(coach, run):
    data = run.to_xarray()
    assert data["floor_acceleration"].dims == ("time", "floor")
    assert data["rms_floor_acceleration"].dims == ("floor",)
    assert tuple(data["floor"].values) == FLOOR_POINTS
    assert "floor" not in replace(run, channels={}, reductions={}).to_xarray().dims
    wheelset = railjax.load_vehicle("single-wheelset")
    with pytest.raises(railjax.InputError, match="floor_acceleration"):
        railjax.simulate(wheelset, 20.0, duration=0.1, record=["floor_acceleration"])


def test_comfort_of_a_batch(coach):
    speeds = jnp.array([50.0, 50.0, 1.0])  # the last one too slow for its step
    heights = railjax.replace(coach, geometry__carbody_to_floor=jnp.array([0.6, 0.9, 0.6]))
    record = ["floor_acceleration", "carbody_phi_acceleration"]
    options = {"track": railjax.SinusoidTrack(3e-3, 25.0), "duration": 15.0, "dt": 5e-3, "sample": 5e-3}
    run = railjax.simulate(heights, speeds, record=record, **options)
    floor, roll = run["floor_acceleration"], run["carbody_phi_acceleration"]
    assert run.to_xarray()["floor_acceleration"].dims == ("time", "floor", "lane")
    np.testing.assert_allclose(floor[:, 1, 1] - floor[:, 1, 0], 0.3 * roll[:, 0], atol=1e-12)
    assert not bool(run.ok[2])
    found = railjax.comfort(run, settle=3.0, mean=False)
    assert found.mean is None
    assert found.places == FLOOR_POINTS
    assert "at leading bogie, centre, trailing bogie" in str(found)
    assert found.rms["lateral"].shape == (3, 3)
    assert np.all(np.isnan(found.rms["lateral"][:, 2]))
    one = railjax.comfort(run, settle=3.0, mean=False, place="centre")
    np.testing.assert_allclose(one.rms["lateral"], found.rms["lateral"][1], rtol=1e-12)
    alone = railjax.weighted_rms(floor[:, 1, 0] - jnp.mean(floor[:, 1, 0]), RATE, settle=3.0)
    np.testing.assert_allclose(one.rms["lateral"][0], alone, rtol=1e-9)
    with pytest.raises(railjax.InputError, match="rate 40 Hz is too low"):
        railjax.comfort(replace(run, time=5 * run.time), mean=False)
    with pytest.raises(railjax.InputError, match="place 'roof' is not one of floor_acceleration's: leading bogie, centre"):
        railjax.comfort(run, place="roof")
    with pytest.raises(railjax.InputError, match="has not recorded bogie_y"):
        railjax.comfort(run, channel="bogie_y")
    with pytest.raises(railjax.InputError, match="not recorded carbody_y_acceleration, carbody_psi_acceleration"):
        railjax.floor_acceleration(run)


GOOD = np.random.default_rng(5).normal(size=round(110 * RATE))


@pytest.mark.parametrize(
    ("values", "options", "message"),
    [
        (np.where(np.arange(len(GOOD)) == 6, np.nan, GOOD), {}, "lateral: sample 7 is nan; cut such samples out"),
        (GOOD[: round(99 * RATE)], {}, "99 s hold 19 blocks of 5 s, too few for the 95th percentile of N_MV, which needs 20"),
        (GOOD, {"settle": 20.0}, "90 s hold 18 blocks"),
        (GOOD[:1000], {"mean": False}, "5 s after settle = 0 s are too few"),
        (GOOD, {"settle": -1.0}, "settle must be 0 or positive"),
        (GOOD, {"sampling_rate": 50.0}, "sampling_rate 50 Hz is too low"),
        (GOOD, {"sampling_rate": -200.0}, "sampling_rate must be positive"),
        (GOOD, {"sampling_rate": None}, "sampling_rate in Hz is missing"),
        (GOOD, {"direction": "sideways"}, "direction 'sideways' is not one of longitudinal, lateral, vertical"),
        (GOOD, {"weightings": {"lateral": "Wq"}}, "unknown weighting 'Wq'"),
        (GOOD, {"weightings": {"lateral": "sperling-lateral"}}, "is no weighting of ISO 2631-1"),
        (np.full(len(GOOD), 9.81), {}, "the acceleration never changes"),
        (np.array(3.0), {}, "array of numbers"),
        (GOOD, {"place": 0}, "are for a Simulation"),
    ],
)
def test_bad_records_are_one_line(values, options, message):
    with pytest.raises(railjax.InputError) as error:
        railjax.comfort(values, **{"sampling_rate": RATE, **options})
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_fewer_blocks_than_a_full_test_are_noted():
    assert railjax.comfort(GOOD, RATE).notes == ("N_MV is of 22 blocks of 5 s; a full test has 60 (5 min)",)
    with pytest.raises(railjax.InputError, match="no derivative"):
        jax.jit(lambda a: railjax.comfort(a, RATE).rms)(GOOD)


# indices of several directions and of the quasi-static part


def test_a_vector_sum_and_standing_and_seated_comfort():
    t = np.arange(0, 110, 1 / RATE)
    records = {
        name: amplitude * np.sin(2 * np.pi * 5.0 * t)
        for name, amplitude in (("longitudinal", 0.2), ("lateral", 0.5), ("vertical", 0.7), ("seat lateral", 0.6), ("seat vertical", 0.4), ("backrest longitudinal", 0.3))
    }  # fmt: skip
    found = railjax.comfort(records, RATE)
    assert found.weightings["backrest longitudinal"] == "Wc"
    x, y, z, seat_y, seat_z, back = (found.percentile[name] for name in records)
    # of a stationary sine all percentiles are one
    np.testing.assert_allclose(found.indices["a_v"], np.sqrt(x**2 + y**2 + z**2), rtol=2e-3)
    np.testing.assert_allclose(found.indices["N_VD"], 3 * np.sqrt(16 * x**2 + 4 * y**2 + z**2) + 5 * y, rtol=2e-3)
    np.testing.assert_allclose(found.indices["N_VA"], 4 * z + 2 * np.sqrt(seat_y**2 + seat_z**2) + 4 * back, rtol=1e-9)
    np.testing.assert_allclose(found.mean, 6 * np.sqrt(x**2 + y**2 + z**2), rtol=1e-9)
    assert "N_VA (EN 12299)" in str(found)
    del records["seat vertical"]
    fewer = railjax.comfort(records, RATE, weightings={"vertical": "Wk"})
    assert "N_VA" not in fewer.indices
    assert "N_VA: not formed, as seat vertical is not in the record" in fewer.notes
    assert "(Wd, Wd, Wk)" in str(fewer)


def test_discrete_events_and_transition_curves():
    t = np.arange(0, 60, 1 / RATE)
    # a transition of 4 s to 0.9 m/s^2 with the body rolling at 0.03 rad/s, and noise to be judged
    ramp = 0.9 * np.clip((t - 20.0) / 4.0, 0.0, 1.0)
    roll = np.where((t > 20.0) & (t < 24.0), 0.03, 0.0)
    noise = 1e-3 * np.random.default_rng(0).normal(size=t.size)
    found = railjax.comfort({"lateral": ramp + noise, "roll rate": roll}, RATE, mean=False, transitions=[(20.0, 24.0)])
    for who, (a, b, c, d, e) in (("standing", (28.54, 20.69, 11.1, 3.64, 2.283)), ("seated", (8.97, 9.68, 5.9, 0.916, 1.626))):
        expected = max(a * 0.9 + b * 0.9 / 4.0 - c, 0.0) + 100.0 * (d * 0.03) ** e
        np.testing.assert_allclose(found.curves[who], [expected], rtol=0.01)
    # in 2 s the acceleration changes by 0.45 with the mean near its end
    np.testing.assert_allclose(found.events["standing"], 0.0, atol=1e-9)
    step = railjax.comfort(np.where(t > 30.0, 1.5, -1.5) + noise, RATE, mean=False).events
    # nearly all of the jump is in the window before it is half over, and the low-pass takes 0.2 s
    assert 0.85 < step["standing"] / (16.62 * 3.0 + 27.01 * 1.5 - 37.0) < 1.0
    bare = railjax.comfort(ramp + noise, RATE, mean=False, transitions=[(20.0, 24.0)])
    assert "P_CT: without its part of the roll rate, which is not in the record" in bare.notes
    with pytest.raises(railjax.InputError, match="transitions are for a record of the lateral"):
        railjax.comfort({"vertical": ramp + noise}, RATE, mean=False, transitions=[(20.0, 24.0)])


@pytest.fixture
def command(capsys):
    def call(*arguments):
        code = status(["comfort", *map(str, arguments)])
        return code, *capsys.readouterr()

    return call


@pytest.fixture(scope="module")
def ride(tmp_path_factory):
    """110 s at 200 Hz: time, lateral and vertical in g."""
    path = tmp_path_factory.mktemp("ride") / "ride.csv"
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["time (s)", "Ay (g)", "up"])
        writer.writerows((f"{k / RATE:.3f}", f"{0.01 * a:.7f}", f"{0.02 * a:.7f}") for k, a in enumerate(GOOD))
    return path


def test_command_line_on_a_record(command, ride):
    code, out, error = command(ride, "--json")
    assert (code, error) == (0, "")
    found = json.loads(out)
    expected = railjax.comfort(0.01 * 9.80665 * GOOD, RATE)
    np.testing.assert_allclose(found["mean_comfort"], expected.mean, rtol=1e-5)
    assert list(found["directions"]) == ["lateral"]
    np.testing.assert_allclose(found["directions"]["lateral"]["sperling"], expected.sperling["lateral"], rtol=1e-5)
    both = json.loads(command(ride, "--fs", 200, "--columns", "lateral=Ay,vertical=up", "--unit", "g", "--json")[1])
    assert list(both["directions"]) == ["lateral", "vertical"]
    assert both["mean_comfort"] > found["mean_comfort"]
    code, out, error = command(ride, "--columns", "vertical=up")
    assert (code, error) == (0, "")
    assert "unit of vertical ('up'): m/s2 (assumed; neither the header nor --unit says it)" in out
    assert "C_Cz" in out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--weighting", "vertical=Wq"], "--weighting vertical=Wq: Wq is none of Wk, Wd"),
        (["--weighting", "Wk"], "--weighting 'Wk': write direction=name"),
        (["--transition", "3"], "--transition '3': write its start and end"),
        (["--transition", "30,500"], "must rise and lie within the record's 110 s"),
        (["--track", "erri-high"], "--track is for a vehicle on a track, not for the record"),
        (["--columns", "lateral=Aq"], "no column 'Aq' for --columns lateral="),
        (["--columns", "Ay"], "--columns 'Ay': write direction=name"),
        (["--unit", "ft"], "--unit must be one of m/s2"),
        (["--fs", "nan"], "--fs must be a positive, finite number"),
    ],
)
def test_command_line_refuses_in_one_line(command, ride, options, message):
    code, out, error = command(ride, *options)
    assert (code, out) == (2, "")
    assert message in error
    assert len(error.splitlines()) == 1


@pytest.mark.parametrize(
    ("content", "options", "message"),
    [
        ("y\n1\nnan\n2\n", ["--fs", "200"], "column 'y' is nan"),
        ("y\n1\nx\n2\n", ["--fs", "200"], "holds 'x', not a number"),
        ("y\n1\n2\n3\n", ["--fs", "200"], "are too few"),
        ("y\n1\n2\n3\n", [], "give --fs in Hz"),
        ("q\n1\n2\n3\n", ["--fs", "200"], "no column of an acceleration; name it, as in --columns lateral=NAME"),
        ("y (stone)\n1\n2\n3\n", ["--fs", "200"], "or --unit"),
    ],
)
def test_command_line_refuses_bad_files(command, tmp_path, content, options, message):
    path = tmp_path / "bad.csv"
    path.write_text(content)
    code, out, error = command(path, *options)
    assert (code, out) == (2, "")
    assert message in error
    assert len(error.splitlines()) == 1


def test_command_line_takes_files_by_any_name_and_other_weightings(command, ride, tmp_path):
    text = ride.read_text().replace(",", ";").replace(".", ",")
    (tmp_path / "ride.txt").write_text(text, encoding="utf-16")
    options = ["--columns", "lateral=Ay,vertical=up", "--unit", "vertical=g", "--no-mean-comfort", "--json"]
    expected = json.loads(command(ride, *options)[1])
    found = json.loads(command(tmp_path / "ride.txt", *options)[1])
    assert found["directions"]["vertical"]["rms_m_per_s2"] == expected["directions"]["vertical"]["rms_m_per_s2"]
    other = json.loads(command(ride, *options, "--weighting", "vertical=Wk")[1])
    assert other["directions"]["vertical"]["weighting"] == "Wk"
    assert other["directions"]["vertical"]["rms_m_per_s2"] != expected["directions"]["vertical"]["rms_m_per_s2"]
    np.testing.assert_allclose(
        other["indices"]["a_v"], np.hypot(*(part["rms_m_per_s2"] for part in other["directions"].values())), rtol=1e-9
    )
    slow = json.loads(command(ride, *options, "--fs", 100)[1])
    assert slow["sampling_rate_hz"] == 100
    assert any("--fs 100 Hz as told, though the time column says 200 Hz" in note for note in slow["notes"])


def test_command_line_on_a_wagon_of_one_stage(command, tmp_path):
    """Its only "bogie" is its body."""
    text = """base = "cooperrider-bogie"
name = "wagon"
[bogie]
mass_t = 12
yaw_inertia_tm2 = 90
[secondary]
stiffness_x_N_per_m = 0
stiffness_y_N_per_m = 0
stiffness_z_N_per_m = 0
damping_y_Ns_per_m = 0
damping_z_Ns_per_m = 0
[geometry]
half_wheelbase_m = 4.5
"""
    (tmp_path / "wagon.toml").write_text(text)
    options = ["--speed-kmh", 60, "--duration-s", 12, "--no-mean-comfort", "--json"]
    code, out, error = command(tmp_path / "wagon.toml", *options)
    assert (code, error) == (0, "")
    found = json.loads(out)
    assert len(found["directions"]["lateral"]["rms_m_per_s2"]) == 3
    assert any("of the only body, over its outer axles" in note for note in found["notes"])
    wagon = railjax.load_vehicle(tmp_path / "wagon.toml")
    names = ["floor_acceleration", "bogie_y_acceleration", "bogie_psi_acceleration", "bogie_phi_acceleration"]
    run = railjax.simulate(wagon, 16.0, track=railjax.SinusoidTrack(2e-3, 20.0), duration=1.0, sample=0.01, record=names)
    y, psi, phi = (np.asarray(run[name])[:, 0] for name in names[1:])
    for k, along in enumerate((4.5, 0.0, -4.5)):
        np.testing.assert_allclose(run["floor_acceleration"][:, k], y + 0.6 * phi + along * psi, rtol=1e-9, atol=1e-12)


def test_command_line_on_a_vehicle(command):
    options = ["--speed-kmh", 160, "--duration-s", 12, "--dt-s", 0.005, "--no-mean-comfort", "--json"]
    code, out, error = command("coach", *options, "--track-seed", 3)
    assert (code, error) == (0, "")
    found = json.loads(out)
    assert found["mean_comfort"] is None
    assert found["places"] == list(FLOOR_POINTS)
    assert all(0.01 < value < 1.0 for value in found["directions"]["lateral"]["rms_m_per_s2"])
    assert any("seed 3" in note for note in found["notes"])
    assert any("assumed" in note for note in found["notes"])
    sinusoid = json.loads(command("coach", *options, "--amplitude-mm", 2)[1])
    assert sinusoid["directions"]["lateral"]["crest_factor"][1] == pytest.approx(np.sqrt(2), rel=0.02)


def test_command_line_refuses_records_options_on_vehicles(command):
    assert "are for a record" in command("coach", "--fs", 200)[2]
    assert command("nosuch")[0] == 2
    assert command("coach", "--track", "nosuch", "--duration-s", 12)[0] == 2
