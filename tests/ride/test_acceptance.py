"""Running safety and ride: closed forms, an independent evaluation, verdicts on the coach, refusals, the command line."""

import dataclasses
import json

import jax.numpy as jnp
import numpy as np
import pytest

import railjax
from railjax.cli.application import status
from railjax.ride.acceptance.criteria import CRITERIA, bogie_limit, prudhomme_limit, quasistatic_limit
from railjax.ride.acceptance.signals import by_section, filtered, hunting_frequency, sliding_mean, sliding_rms

RATE, SPEED, AXLE_LOAD, MASS = 200.0, 50.0, 102.5e3, 5120.0
ROUGH = railjax.RandomTrack("erri-high", seed=3, length=12e3)
SOFT = ROUGH.scaled(0.3)


def record(seconds=160.0, lanes=(), **signals):
    """A record at 180 km/h; signals as functions of time, the same in all parts."""
    time = np.arange(round(seconds * RATE)) / RATE
    parts = {"guiding_force": 4, "bogie_acceleration": 4, "carbody_acceleration": 2}
    histories = {
        name: np.broadcast_to(
            signal(time).reshape(-1, *(1 for _ in (0, *lanes))), (len(time), parts[name], *lanes)
        ).copy()
        for name, signal in signals.items()
    }  # fmt: skip
    return railjax.RunningRecord(SPEED, RATE, **histories)


def assess(of, **options):
    return railjax.acceptance_of_record(of, axle_load=AXLE_LOAD, bogie_mass=MASS, **options)


def response(frequency, low=None, high=None):
    """Magnitude of `filtered` from the spectrum of its impulse response."""
    impulse = np.zeros((2**15, 1))
    impulse[2**14] = 1.0
    magnitude = np.abs(np.fft.rfft(filtered(impulse, RATE, low, high)[:, 0]))
    return np.interp(frequency, np.fft.rfftfreq(2**15, 1 / RATE), magnitude)


# filters


@pytest.mark.parametrize("corner", [6.0, 10.0, 20.0])
def test_low_pass_meets_the_requirement(corner):
    def decibels(f):
        return 20 * np.log10(response(f, None, corner))

    assert decibels(corner) == pytest.approx(-3.0103, abs=0.01)
    # within 0.5 dB of the nominal fourth-order curve up to the corner, and of 0 dB in the pass band
    below = np.linspace(0.02 * corner, corner, 200)
    nominal = -10 * np.log10(1 + (np.tan(np.pi * below / RATE) / np.tan(np.pi * corner / RATE)) ** 8)
    assert np.abs(decibels(below) - nominal).max() < 0.5
    assert np.abs(decibels(below[below < 0.75 * corner])).max() < 0.5
    assert decibels(2 * corner) - decibels(corner) < -24.0
    assert decibels(min(4 * corner, 90.0)) < -72.0


def test_band_pass_meets_the_requirement():
    assert 20 * np.log10(response([0.4, 10.0], 0.4, 10.0)) == pytest.approx(-3.0103, abs=0.02)
    assert 20 * np.log10(response(np.linspace(0.55, 7.5, 50), 0.4, 10.0)) == pytest.approx(0.0, abs=0.5)
    assert np.all(20 * np.log10(response([0.2, 20.0], 0.4, 10.0)) < -27.0)


@pytest.mark.parametrize("f0", [2.5, 5.5, 12.0])
def test_the_band_about_f0_passes_f0(f0):
    low, high = max(f0 - 2.0, 0.4), f0 + 2.0
    assert 20 * np.log10(response([low, f0, high], low, high)) == pytest.approx([-3.01, 0.0, -3.01], abs=0.05)


def test_filters_do_not_shift_the_phase():
    time = np.arange(4000) / RATE
    pulse = np.exp(-(((time - 9.0) / 0.1) ** 2))[:, None]
    for low, high in ((None, 6.0), (0.4, 10.0)):
        assert time[np.argmax(filtered(pulse, RATE, low, high))] == pytest.approx(9.0, abs=0.5 / RATE)


# windows and percentiles


@pytest.mark.parametrize("spacing", [0.1, 0.25, 0.37])
def test_sliding_mean_of_a_sine_is_a_sinc(spacing):
    distance = spacing * np.arange(2000)
    for wavelength in (4.0, 9.0):
        values = 3.0 + np.sin(2 * np.pi * distance / wavelength)[:, None]
        starts, means = sliding_mean(values, spacing, 2.0, 0.5)
        np.testing.assert_allclose(np.diff(starts), 0.5)
        assert distance[-1] - 0.5 < starts[-1] + 2.0 <= distance[-1] + 1e-9
        expected = 3.0 + np.sinc(2.0 / wavelength) * np.sin(2 * np.pi * (starts + 1.0) / wavelength)
        np.testing.assert_allclose(means[:, 0], expected, atol=4e-3 if wavelength < 5 else 3e-4)


def test_sliding_rms_of_a_sine():
    distance = 0.25 * np.arange(4000)
    values = 2.0 * np.sin(2 * np.pi * distance / 8.0)[:, None]
    starts, means = sliding_rms(values, 0.25, 100.0, 10.0)
    assert len(starts) == 90
    np.testing.assert_allclose(means, 2.0 / np.sqrt(2.0), rtol=1e-6)
    # a window of 1.75 half waves: mean square 1/2 - [sin 2u]/(4 w), u the phase at its ends
    starts, means = sliding_rms(values, 0.25, 7.0, 1.0)
    phases = np.pi * starts / 4.0
    exact = 4.0 * (0.5 - (np.sin(2 * phases + 3.5 * np.pi) - np.sin(2 * phases)) / (4.0 * 1.75 * np.pi))
    np.testing.assert_allclose(means[:, 0] ** 2, exact, atol=2e-3)


QUARTERS = 250.0 * np.arange(4), 250.0 * np.arange(1, 5)


def test_percentiles_of_known_distributions():
    rng = np.random.default_rng(5)
    uniform = rng.permuted(np.tile(np.linspace(-1.0, 1.0, 2001), (4, 1)), axis=1).reshape(-1, 1)
    position = 250.0 / 2001 * (np.arange(len(uniform)) + 0.5)
    np.testing.assert_allclose(by_section(uniform, position, *QUARTERS, "percentiles"), 0.997, rtol=1e-12)
    np.testing.assert_allclose(by_section(uniform - 0.1, position, *QUARTERS, "median"), 0.1, rtol=1e-9)
    np.testing.assert_allclose(by_section(uniform - 0.1, position, *QUARTERS, "percentiles"), 1.097, rtol=1e-12)
    np.testing.assert_allclose(by_section(uniform, position, *QUARTERS, "rms") ** 2, 1 / 3, rtol=1e-2)
    gauss = rng.standard_normal((400000, 1))
    assert by_section(gauss, np.linspace(0.0, 1.0, 400000), np.zeros(1), np.ones(1), "percentiles")[0, 0] == pytest.approx(
        2.968, rel=0.02
    )


def test_hunting_frequency_is_that_of_the_highest_peak():
    time = np.arange(20000) / RATE
    for frequency in (1.37, 5.52, 9.96):
        values = np.sin(2 * np.pi * frequency * time) + 0.4 * np.sin(6 * np.pi * frequency * time + 1.0)
        assert hunting_frequency(values[:, None], RATE) == pytest.approx(frequency, abs=5e-3)


# limits and whole evaluations in closed form


def test_limits():
    assert prudhomme_limit(102.5e3) == pytest.approx(44166.7, abs=0.1)
    assert prudhomme_limit(102.5e3, 0.85) == pytest.approx(37541.7, abs=0.1)
    assert bogie_limit(5000.0) == 11.0
    for criterion in CRITERIA.values():
        assert "published" in criterion.sources or "recalled" in criterion.sources


def test_constant_force_is_its_own_estimate():
    found = assess(record(guiding_force=lambda t: np.full_like(t, -20e3)))
    assert found.findings["guiding_force_sum"].value == pytest.approx(20e3, rel=1e-9)
    assert found.findings["instability_force"].value == pytest.approx(0.0, abs=1.0)
    assert found.verdict == "met"
    assert set(found.findings) == {"guiding_force_sum", "instability_force"}
    assert "Not in the record" in str(found)
    beyond = assess(record(guiding_force=lambda t: np.full_like(t, 45e3)))
    assert beyond.verdict == "exceeded"
    assert beyond.findings["guiding_force_sum"].verdict == "exceeded"
    assert assess(record(guiding_force=lambda t: np.full_like(t, 40e3)), prudhomme_factor=0.85).verdict == "exceeded"


def test_sines_give_their_amplitudes():
    frequency = 5.0
    found = assess(
        record(
            guiding_force=lambda t: 30e3 * np.sin(2 * np.pi * frequency * t),
            bogie_acceleration=lambda t: 4.0 * np.sin(2 * np.pi * frequency * t),
            carbody_acceleration=lambda t: 0.6 * np.sin(2 * np.pi * 2.0 * t),
        )
    )
    value = {key: float(finding.value) for key, finding in found.findings.items()}
    mean = np.sinc(2.0 * frequency / SPEED)
    assert value["guiding_force_sum"] == pytest.approx(30e3 * mean, rel=2e-3)
    assert value["instability_force"] == pytest.approx(30e3 / np.sqrt(2), rel=1e-3)
    assert value["bogie_safety"] == pytest.approx(4.0, rel=5e-3)
    assert value["instability_bogie"] == pytest.approx(4.0 / np.sqrt(2), rel=1e-3)
    assert value["carbody_safety"] == pytest.approx(0.6, rel=1e-3)
    assert value["carbody_ride"] == pytest.approx(0.6, rel=1e-3)
    assert value["carbody_ride_rms"] == pytest.approx(0.6 / np.sqrt(2), rel=1e-3)
    assert float(found.hunting_frequency) == pytest.approx(frequency, abs=1e-2)
    # a band elsewhere hears nothing of it
    aside = assess(record(guiding_force=lambda t: 30e3 * np.sin(2 * np.pi * frequency * t)), hunting_frequency=10.0)
    assert aside.findings["instability_force"].value < 0.01 * 30e3


def test_the_estimate_is_mean_plus_k_standard_deviations_and_the_place_is_named():
    of = record(carbody_acceleration=lambda t: 0.3 * np.sin(2 * np.pi * 2.0 * t))
    growth = 1.0 + np.arange(len(of.carbody_acceleration)) / len(of.carbody_acceleration)
    of.carbody_acceleration[:, 1] *= growth
    of.carbody_acceleration[(growth > 1.5) & (growth < 1.52), 1] *= 2.0
    found = assess(of).findings["carbody_safety"]
    # sections of 250 m take 1000 samples after the margin of 5 s; the bump is in the sample 16000 to 16640
    assert found.part == 2
    assert found.position == 250.0 + 15 * 250.0
    filt = filtered(of.carbody_acceleration, RATE, None, 6.0)[1000:]
    each = [np.abs(np.percentile(filt[1000 * k : 1000 * (k + 1), 1], [0.15, 99.85])).max() for k in range(30)]
    assert found.value == pytest.approx(np.mean(each) + 3.0 * np.std(each, ddof=1), rel=1e-6)
    assert found.largest == pytest.approx(max(each), rel=1e-9)


def test_too_few_sections_determine_only_what_a_section_exceeds():
    quiet = assess(record(60.0, guiding_force=lambda t: 1e3 * np.sin(30 * t)))
    assert quiet.sections == 10
    assert quiet.findings["guiding_force_sum"].verdict == "not determined"
    assert quiet.findings["instability_force"].verdict == "met"
    assert quiet.verdict == "not determined"
    assert "Fewer than 25 sections" in str(quiet)
    assert assess(record(60.0, guiding_force=lambda t: 1e3 * np.sin(30 * t)), minimum_sections=10).verdict == "met"
    single = assess(record(16.0, guiding_force=lambda t: 60e3 * np.sin(20 * t)))
    assert single.sections == 1
    assert np.isnan(single.findings["guiding_force_sum"].value)
    assert single.findings["guiding_force_sum"].verdict == "exceeded"
    json.dumps(single.as_dict())


def test_sections_follow_the_speed_and_the_option():
    of = record(guiding_force=np.sin)
    fast = assess(dataclasses.replace(of, speed=250 / 3.6))
    assert (fast.section_length, fast.sections) == (500.0, 20)
    assert assess(of, section_length=100.0, margin=10.0).sections == 70


# the coach


#: the car body's own coordinates, for kinematics by hand
BODY = ("carbody_y_acceleration", "carbody_psi_acceleration", "carbody_phi_acceleration")


@pytest.fixture(scope="module")
def runs(coach):
    """160 km/h on a smooth track, 200 on a rough one, 250 on a smooth one: 152 s."""
    track = ROUGH.scaled(jnp.array([0.3, 1.0, 0.3]))
    return railjax.simulate(
        coach,
        jnp.array([160.0, 200.0, 250.0]) / 3.6,
        track=track,
        duration=152.0,
        sample=5e-3,
        record=(*railjax.acceptance_channels(coach), "wheelset_y", *BODY),
    )


@pytest.fixture(scope="module")
def batch(coach, runs):
    return railjax.acceptance(coach, runs, minimum_sections=18)


def test_the_coach_at_160_passes_and_hunting_at_250_fails(batch):
    assert list(batch.verdict) == ["met", "exceeded", "exceeded"]
    slow, hunting = batch.lane(0), batch.lane(2)
    assert slow.sections >= 25
    assert {str(f.verdict) for f in slow.findings.values()} == {"met"}
    for key in ("instability_force", "instability_bogie"):
        assert hunting.findings[key].verdict == "exceeded"
        assert slow.findings[key].value < 0.3 * slow.findings[key].limit
    for text in ("f0 =", "no certificate", "Y/Q", "axle ", "wheelset ", "met"):
        assert text in str(slow)
    assert "lanes" in batch.as_dict()
    assert " *" in str(batch)
    content = json.loads(json.dumps(hunting.as_dict()))
    assert content["quantities"]["instability_bogie"]["verdict"] == "exceeded"
    assert content["speed_kmh"] == pytest.approx(250.0)


def test_f0_of_hunting_is_the_frequency_of_the_limit_cycle(coach):
    run = railjax.simulate(
        coach,
        250 / 3.6,
        initial={"wheelset_y": 5e-3},
        duration=30.0,
        sample=5e-3,
        record=(*railjax.acceptance_channels(coach), "wheelset_y", *BODY),
    )
    found = railjax.acceptance(coach, run, section_length=250.0)
    y = np.asarray(run["wheelset_y"])[2000:, 2]
    up = np.flatnonzero((y[:-1] < 0) & (y[1:] >= 0))
    instants = (up - y[up] / (y[up + 1] - y[up])) * 5e-3
    cycles = (len(instants) - 1) / (instants[-1] - instants[0])
    assert 5.0 < cycles < 6.5
    assert float(found.hunting_frequency) == pytest.approx(cycles, abs=0.02)
    assert found.findings["instability_force"].verdict == "exceeded"


def test_independent_evaluation_of_a_whole_run(runs, batch):
    """Filters as multipliers of the discrete Fourier transform, means by summing a tenfold interpolation, kinematics by hand."""
    speed, cut, a, l = 200 / 3.6, 1000, 1.28, 8.6
    channel = {name: np.asarray(values)[..., 1] for name, values in runs.channels.items()}
    n = len(channel["guiding_force"])
    frequency = np.fft.rfftfreq(n, 5e-3)
    warped = np.tan(np.pi * frequency / RATE)

    def multiplier(low, high):
        first, second = (np.tan(np.pi * corner / RATE) for corner in (low or 0.0, high))
        with np.errstate(divide="ignore", invalid="ignore"):
            x = (warped**2 - first * second) / (warped * (second - first)) if low else warped / second
        return (1 / (1 + (np.sqrt(2) - 1) * x**8))[:, None]

    def through(values, low, high):
        return np.fft.irfft(np.fft.rfft(values, axis=0) * multiplier(low, high), n, axis=0)

    def fine(values):
        return np.fft.irfft(np.fft.rfft(values, axis=0), 10 * n, axis=0) * 10

    def windows(values, length, step):
        values = fine(values)[10 * cut : 10 * (n - cut - 1) + 1]
        h = speed * 5e-4
        total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(0.5 * (values[1:] + values[:-1]) * h, axis=0)])
        along = h * np.arange(len(total))
        starts = np.arange(0.0, along[-1] - length, step)
        ends = [np.array([np.interp(s, along, column) for column in total.T]).T for s in (starts, starts + length)]
        return starts, (ends[1] - ends[0]) / length

    force = channel["guiding_force"]
    bogie = [
        channel["bogie_y_acceleration"][:, j] + sign * a * channel["bogie_psi_acceleration"][:, j]
        + 0.14 * channel["bogie_phi_acceleration"][:, j]
        for j in (0, 1) for sign in (1, -1)
    ]  # fmt: skip
    height = 0.6  # of the floor below the centre of gravity, assumed
    body = [
        channel["carbody_y_acceleration"] + height * channel["carbody_phi_acceleration"]
        + sign * l * channel["carbody_psi_acceleration"]
        for sign in (1, -1)
    ]  # fmt: skip
    bogie, body = np.array(bogie).T, np.array(body).T
    count = int(speed * (n / RATE - 10.0) / 250.0)

    def estimate(values, position, k, statistic):
        each = np.array([
            statistic(values[(position >= 250 * i) & (position < 250 * (i + 1))]) for i in range(count)
        ])  # fmt: skip
        return (each.mean(axis=0) + k * each.std(axis=0, ddof=1)).max()

    def percentile(values):
        return np.maximum(-np.quantile(values, 0.0015, axis=0), np.quantile(values, 0.9985, axis=0))

    along = speed / RATE * np.arange(n - 2 * cut)
    starts, means = windows(through(force, None, 20.0), 2.0, 0.5)
    f0 = float(batch.hunting_frequency[1])
    expected = {
        "guiding_force_sum": estimate(means, starts + 1.0, 3.0, percentile),
        "bogie_safety": estimate(through(bogie, None, 10.0)[cut:-cut], along, 3.0, percentile),
        "carbody_safety": estimate(through(body, None, 6.0)[cut:-cut], along, 3.0, percentile),
        "carbody_ride": estimate(through(body, 0.4, 10.0)[cut:-cut], along, 2.2, percentile),
        "carbody_ride_rms": estimate(through(body, 0.4, 10.0)[cut:-cut], along, 2.2, lambda v: np.sqrt((v**2).mean(axis=0))),
        "instability_force": np.sqrt(windows(through(force, f0 - 2, f0 + 2) ** 2, 100.0, 10.0)[1].max()),
        "instability_bogie": np.sqrt(windows(through(bogie, f0 - 2, f0 + 2) ** 2, 100.0, 10.0)[1].max()),
    }
    found = {key: float(finding.value[1]) for key, finding in batch.findings.items()}
    assert found == pytest.approx(expected, rel=2e-3)
    # the dominant line of the raw spectrum is where f0 is
    lines = (np.abs(np.fft.rfft(force[cut:-cut], axis=0)) ** 2).sum(axis=1)
    raw = np.fft.rfftfreq(n - 2 * cut, 5e-3)
    smooth = np.convolve(lines, np.hanning(61), "same")[(raw > 1) & (raw < 12)]
    assert raw[(raw > 1) & (raw < 12)][smooth.argmax()] == pytest.approx(f0, abs=0.2)


def test_lanes_equal_single_runs_and_unsound_lanes_spoil_nothing(coach, runs, batch):
    alone = railjax.acceptance(
        coach,
        dataclasses.replace(runs, channels={k: v[..., 2] for k, v in runs.channels.items()}, code=runs.code[2], speed=250 / 3.6),
        minimum_sections=18,
    )
    for key, finding in alone.findings.items():
        np.testing.assert_allclose(finding.value, batch.findings[key].value[2], rtol=1e-9)
    spoiled = {k: v.at[..., 1].set(jnp.nan) for k, v in runs.channels.items()}
    code = runs.code.at[1].set(int(railjax.Result.DIVERGED))
    marked = railjax.acceptance(coach, dataclasses.replace(runs, channels=spoiled, code=code), minimum_sections=18)
    assert list(marked.verdict) == ["met", "not determined", "exceeded"]
    for key, finding in marked.findings.items():
        assert np.isnan(finding.value[1])
        np.testing.assert_array_equal(finding.value[[0, 2]], batch.findings[key].value[[0, 2]])
    assert "no sound run" in str(marked)
    assert not marked.lane(1).as_dict()["ok"]
    str(marked.lane(1))


def test_limits_may_differ_between_lanes(coach, runs, batch):
    loads = coach.contact.wheel_load * jnp.array([1.0, 1.0, 2.0])
    found = railjax.acceptance(railjax.replace(coach, contact__wheel_load=loads), runs, minimum_sections=18)
    limit = found.findings["guiding_force_sum"].limit
    np.testing.assert_allclose(limit, [44166.67, 44166.67, 10e3 + 205e3 / 3], rtol=1e-6)
    np.testing.assert_allclose(found.findings["bogie_safety"].limit, batch.findings["bogie_safety"].limit)
    assert batch.findings["bogie_safety"].limit[0] == pytest.approx(12.0 - 5.12 / 5)


@pytest.mark.parametrize("name", ["cooperrider-bogie", "single-wheelset"])
def test_vehicles_without_a_car_body_have_what_they_have(name):
    vehicle = railjax.load_vehicle(name)
    channels = railjax.acceptance_channels(vehicle)
    run = railjax.simulate(vehicle, 40.0, track=SOFT, duration=30.0, sample=5e-3, record=channels)
    found = railjax.acceptance(vehicle, run, minimum_sections=3)
    assert "carbody_ride" not in found.findings
    assert ("bogie_safety" in found.findings) == (name == "cooperrider-bogie")
    assert found.verdict == "met"


# refusals


def spoiled(value):
    of = record(20.0, guiding_force=np.sin)
    of.guiding_force[777, 2] = value
    return of


@pytest.mark.parametrize(
    ("of", "options", "message"),
    [
        (lambda: spoiled(np.nan), {}, "guiding_force is not finite at sample 777 of wheelset 3"),
        (lambda: spoiled(np.inf), {}, "guiding_force is not finite"),
        (lambda: dataclasses.replace(record(20.0, guiding_force=np.sin), sampling_rate=100.0), {}, "200 Hz or more, not 100"),
        (lambda: dataclasses.replace(record(20.0, guiding_force=np.sin), sampling_rate=np.nan), {}, "sampling_rate must be"),
        (lambda: record(14.0, guiding_force=np.sin), {}, "shorter than a section of 250 m and the margins; it takes 15 s"),
        (lambda: dataclasses.replace(record(20.0, guiding_force=np.sin), speed=0.0), {}, "speed must be positive"),
        (
            lambda: dataclasses.replace(record(20.0, guiding_force=np.sin), speed=[50.0, 60.0]),
            {},
            "speed must be one number or one for each of 1 lane",
        ),
        (lambda: railjax.RunningRecord(SPEED, RATE), {}, "the record is empty"),
        (lambda: railjax.RunningRecord(SPEED, RATE, np.zeros(4000)), {}, "guiding_force must have shape"),
        (
            lambda: railjax.RunningRecord(SPEED, RATE, np.zeros((4000, 4)), np.zeros((3999, 4))),
            {},
            "samples and lanes must agree",
        ),
        (lambda: record(20.0, bogie_acceleration=np.sin), {"bogie_mass": None}, "bogie_mass is needed"),
        (lambda: record(20.0, guiding_force=np.sin), {"axle_load": -1.0}, "axle_load must be positive"),
        (lambda: record(20.0, guiding_force=np.sin), {"section_length": 50.0}, "section_length must be 70 m or more"),
        (lambda: record(20.0, guiding_force=np.sin), {"margin": -1.0}, "margin must be 0 or positive"),
        (lambda: record(20.0, guiding_force=np.sin), {"hunting_frequency": 99.0}, "hunting_frequency 99 Hz is too high"),
        (lambda: record(20.0, guiding_force=np.sin), {"prudhomme_factor": 0.0}, "prudhomme_factor must be positive"),
    ],
)
def test_bad_records_are_refused_in_one_line(of, options, message):
    with pytest.raises(railjax.InputError, match=message) as caught:
        railjax.acceptance_of_record(of(), **{"axle_load": AXLE_LOAD, "bogie_mass": MASS, **options})
    assert len(str(caught.value).splitlines()) == 1


def test_bad_runs_are_refused(coach, runs):
    less = {name: values for name, values in runs.channels.items() if name != "guiding_force"}
    with pytest.raises(railjax.InputError, match=r"lacks guiding_force.* record=railjax.acceptance_channels"):
        railjax.acceptance(coach, dataclasses.replace(runs, channels=less))
    with pytest.raises(railjax.InputError, match="constant speed"):
        railjax.acceptance(coach, dataclasses.replace(runs, speed=railjax.SpeedProfile([0.0, 1.0], [50.0, 40.0])))


# command line


def test_command_line(capsys):
    arguments = ["acceptance", "coach", "--speed-kmh", "250", "--length-m", "1500", "--track", "erri-low", "--json"]
    assert status(arguments) == 0
    out, error = capsys.readouterr()
    assert error == ""
    content = json.loads(out)
    assert content["verdict"] == "exceeded"
    assert content["quantities"]["instability_force"]["verdict"] == "exceeded"
    assert content["quantities"]["carbody_ride_rms"]["verdict"] in ("exceeded", "not determined")
    assert (content["damper"], content["sections"]) == ("passive", 1)
    assert "erri-low" in content["track"]
    assert any("Y/Q" in note for note in content["notes"])
    assert content["calibrated"]


def test_command_line_on_a_measured_track(capsys, tmp_path):
    path = tmp_path / "line.csv"
    distance = np.arange(0.0, 1300.0, 0.5)
    alignment = 1e3 * np.asarray(railjax.alignment(ROUGH, jnp.asarray(distance + 100.0)))
    np.savetxt(path, np.column_stack([distance, alignment]), delimiter=",", header="distance (m),alignment (mm)", comments="")
    assert status(["acceptance", "coach", "--speed-kmh", "160", "--track", str(path), "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert content["sections"] == 3  # of 1299.5 m
    assert content["verdict"] == "not determined"
    assert 0.1 < content["quantities"]["carbody_ride"]["value"] < 2.5
    for more in (["--length-m", "1400"], ["--speed-kmh", "100"]):
        assert status(["acceptance", "coach", "--speed-kmh", "160", "--track", str(path), *more]) == 2
        assert "is 1299.5 m long" in capsys.readouterr().err


def test_command_line_on_a_record(capsys, tmp_path):
    t = np.arange(0, 70, 1 / 200.0)
    body = 0.8 * np.sin(2 * np.pi * 1.5 * t) + 0.3 * np.sin(2 * np.pi * 4.1 * t)
    force = 9.0 * np.sin(2 * np.pi * 2.0 * t)
    path = tmp_path / "test.dat"
    rows = "\n".join(
        f"{a:.3f};{b:.5f};{c:.5f};{d:.4f}".replace(".", ",") for a, b, c, d in zip(t, body / 9.80665, body, force, strict=True)
    )
    path.write_text("time (s);carbody 1 (g);carbody 2 (m/s2);SumY 1 (kN)\n" + rows)
    assert status(["acceptance", str(path), "--speed-kmh", "160", "--axle-load-n", "120000", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    record = railjax.RunningRecord(160 / 3.6, 200.0, 1e3 * force[:, None], None, np.stack([body, body], axis=1))
    expected = railjax.acceptance_of_record(record, axle_load=120e3)
    assert found["quantities"]["carbody_ride"]["value"] == pytest.approx(float(expected.findings["carbody_ride"].value), rel=1e-4)
    assert found["quantities"]["guiding_force_sum"]["value"] == pytest.approx(
        float(expected.findings["guiding_force_sum"].value), rel=1e-4
    )
    assert status(["acceptance", str(path), "--speed-kmh", "160"]) == 2
    assert "axle_load is needed for the limits of guiding forces" in capsys.readouterr().err
    assert status(["acceptance", str(path), "--speed-kmh", "160", "--track", "erri-low"]) == 2
    assert "is the record of one run" in capsys.readouterr().err
    assert status(["acceptance", "coach", "--fs", "200"]) == 2
    assert "--fs is for the record of a test" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--speed-kmh", "nan"], "--speed-kmh must be a positive"),
        (["--track", "erri-hi"], "erri-high"),
        (["--length-m", "300"], "--length-m 300 does not hold a section and the margins; give 806 or more"),
        (["--section-m", "20"], "--section-m must be 70 or more"),
        (["--dt-s", "0.01"], "--dt-s must be 0.005 or less"),
        (["--prudhomme-factor", "-1"], "--prudhomme-factor must be a positive"),
        (["--track-seed", "-1"], "seed must be a whole number"),
        (["--damper", "clipped-lqr", "--speed-kmh", "100", "--speed-kmh", "120"], "one speed"),
    ],
)
def test_bad_options_are_one_line_and_status_2(capsys, options, message):
    assert status(["acceptance", "coach", *options]) == 2
    out, error = capsys.readouterr()
    assert out == ""
    assert len(error.splitlines()) == 1
    assert message in error


def test_zones_of_a_layout(capsys, coach, tmp_path):
    """Straight track, R 700 to the right, 500 to the left and 300: sections within full arcs, quasi-static values as steady curving has them,
    limits of each zone, SumY of an arc by NumPy from the run."""
    turn = railjax.Segment.transition(80.0)
    arcs = [railjax.Segment.arc(260.0, radius, 0.1) for radius in (700.0, -500.0, 300.0)]
    line = railjax.Layout([railjax.Segment.straight(650.0), turn, arcs[0], turn, railjax.Segment.straight(50.0), turn, arcs[1], turn, railjax.Segment.straight(50.0), turn, arcs[2], turn])  # fmt: skip
    channels = railjax.acceptance_channels(coach, curves=True)
    run = railjax.simulate(coach, 22.0, track=railjax.RandomTrack("erri-low"), layout=line, duration=98.0, dt=2.5e-3, sample=5e-3, record=channels)  # fmt: skip
    found = railjax.zone_acceptance(coach, run, line, minimum_sections=2)
    assert {number: int(zone.sections) for number, zone in found.zones.items()} == {1: 2, 2: 2, 3: 2, 4: 3}
    assert found.verdict == "met"
    for number, radius in ((2, 700.0), (3, -500.0), (4, 300.0)):
        steady = railjax.curving(coach, 22.0, radius=radius, cant=0.1)
        value = float(found.zones[number].findings["carbody_quasistatic"].value)
        assert value == pytest.approx(abs(float(steady.carbody_acceleration)), abs=0.02)
    bogie = 12.0 - (coach.bogie.mass + 2 * coach.wheelset.mass) / 5e3
    limits = [(zone.findings["bogie_safety"].limit, zone.findings["carbody_safety"].limit) for zone in found.zones.values()]
    np.testing.assert_allclose(limits, [(bogie, 3.0), (bogie, 3.0), (bogie - 3.0, 2.8), (bogie - 3.0, 2.6)])
    assert "instability_force" in found.zones[2].findings
    assert "instability_force" not in found.zones[3].findings
    # the arc to the left: full from 1202 m on, its last wheelset 12 m behind
    arc = next(stretch for stretch in found.stretches if stretch.zone == 3)
    half = coach.geometry.half_pivot_distance + coach.geometry.half_wheelbase
    assert (arc.start, arc.end) == pytest.approx((1202.0 + half, 1458.0 - half))
    # two sections of 100 m at the beginning of the arc; the bogies feel the curve
    along = 22.0 * np.asarray(run.time)
    raw = np.asarray(run["guiding_force"]).reshape(len(along), -1)
    smooth = filtered(raw, 200.0, None, 20.0)
    starts, means = sliding_mean(smooth, 0.11, 2.0, 0.5)
    each = [
        np.abs(np.percentile(means[(starts + 1.0 >= low) & (starts + 1.0 < low + 100.0)], (0.15, 99.85), axis=0)).max(axis=0)
        for low in (arc.start, arc.start + 100.0)
    ]
    by_hand = np.max(np.mean(each, axis=0) + 3.0 * np.std(each, axis=0, ddof=1))
    assert float(found.zones[3].findings["guiding_force_sum"].value) == pytest.approx(by_hand, rel=0.02)
    assert float(found.zones[4].findings["bogie_safety"].value) > 0.9 * (22.0**2 / 300.0 - 9.81 * 0.1 / 1.5)
    text = str(found)
    assert "Zone 3, small radius, R 500 to 500 m" in text
    assert text.count("no vertical dynamics") == 1
    assert "the record has the sum of both wheels only" in text
    with pytest.raises(railjax.InputError, match="no section of any zone"):
        railjax.zone_acceptance(coach, run, railjax.Layout.curve(200.0, lead=20.0, arc=9e3))
    # a full assessment takes more sections
    assert railjax.zone_acceptance(coach, run, line).verdict == "not determined"
    path = tmp_path / "line.toml"
    path.write_text('[[segment]]\nkind = "straight"\nlength_m = 20\n[[segment]]\nkind = "transition"\nlength_m = 80\n[[segment]]\nkind = "arc"\nlength_m = 400\nradius_m = 350\ncant_mm = 100\n')  # fmt: skip
    options = ["acceptance", "coach", "--layout", str(path), "--speed-kmh", "80", "--track", "erri-low", "--json"]
    assert status(options) == 0
    assert list(json.loads(capsys.readouterr().out)["zones"]) == ["4"]
    assert status([*options, "--section-m", "100"]) == 2
    assert "zones have sections of their own" in capsys.readouterr().err


def test_quasistatic_limit_of_a_wheel():
    assert quasistatic_limit(300.0) == pytest.approx(65e3)
