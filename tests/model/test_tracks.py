"""Sampled tracks: random ones follow their formula, measured ones their record, and both are tracks to every way of running."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal

import railjax
from railjax.model.track.sampled import STRAIGHT, fade_in
from railjax.model.track.spectra import LONGEST, SHORTEST

alignment = jax.jit(railjax.alignment)

LOW, HIGH = 2 * np.pi / LONGEST, 2 * np.pi / SHORTEST


def summed(track, distance):
    """The waves of a random track added one by one."""
    waves = np.exp(1j * np.outer(distance, track.wavenumbers))
    return np.real(waves @ np.asarray(track.lines))


@pytest.fixture(scope="module")
def track():
    return railjax.RandomTrack("erri-high", seed=3, length=2000.0, fade=0.0)


@pytest.fixture(scope="module")
def linear(coach):
    return railjax.replace(coach, contact__law="linear")


def rms(vehicle, speed, track, **options):
    name = "rms:carbody_acceleration"
    options = {"duration": 1.0, "settle": 0.5, "record": (), **options}
    return railjax.simulate(vehicle, speed, track=track, reduce=[name], **options)[name]


@pytest.mark.parametrize("name", ["erri-high", "fra-5"])
def test_welch_estimate_follows_the_formula_between_the_points_too(name):
    """Sampled 0.4 m apart, which meets all fractions of the cells of 0.25 m: every third octave within 5 %."""
    long = railjax.RandomTrack(name, seed=11, length=200e3, fade=0.0)
    distance = 0.4 * np.arange(round(200e3 / 0.4)) + 0.013
    eta = np.concatenate([alignment(long, part) for part in np.array_split(distance, 50)])
    frequency, density = scipy.signal.welch(eta, 1 / 0.4, nperseg=10000, noverlap=5000)
    of = railjax.spectrum(name)
    for centre in 100.0 / 10.0 ** (np.arange(16) / 10.0):  # 100 to 3.16 m
        low, high = 10.0**-0.05 / centre, 10.0**0.05 / centre
        inside = (frequency >= low) & (frequency < high)
        found, expected = np.mean(density[inside]), np.mean(of.density(2 * np.pi * frequency[inside]) * 2 * np.pi)
        assert found == pytest.approx(float(expected), rel=0.05), f"{centre:.3g} m"


@pytest.mark.parametrize("seed", [0, 1])
def test_bands_have_the_variance_of_the_closed_form(seed):
    """In every realisation, from its lines and from its alignment."""
    long, of = railjax.RandomTrack(seed=seed, length=50e3, fade=0.0), railjax.spectrum("erri-high")
    power, w = 0.5 * np.abs(np.asarray(long.lines)) ** 2, long.wavenumbers
    assert power.sum() == pytest.approx(float(of.variance(LOW, HIGH)), rel=1e-3)
    for longest, shortest in ((100.0, 50.0), (25.0, 3.0), (5.0, 2.5)):
        low, high = 2 * np.pi / longest, 2 * np.pi / shortest
        assert power[(w >= low) & (w <= high)].sum() == pytest.approx(float(of.variance(low, high)), rel=5e-3)
    eta = np.asarray(alignment(long, 0.5 * np.arange(100_000) + 0.1))
    assert np.var(eta) == pytest.approx(float(of.variance(LOW, HIGH)), rel=5e-3)


def test_a_single_wave_keeps_its_amplitude_and_the_spline_adds_less_than_said():
    """Images of the shortest wave below 6.2e-4 of it, of one twice as long below 4e-5."""
    for wavelength, bound in ((2.0, 6.2e-4), (4.0, 4e-5), (20.0, 1e-7)):
        number = round(1000.0 / wavelength)
        near = lambda w, n=number: jnp.where(jnp.abs(w / (2 * jnp.pi / 1000.0) - n) < 0.1, 1.0, 0.0)  # noqa: E731
        one = railjax.RandomTrack(near, length=1000.0, fade=0.0)
        assert one.length == pytest.approx(1000.0)
        distance = np.linspace(0.0, 40.0, 4001)
        off = np.asarray(alignment(one, distance)) - summed(one, distance)
        assert np.abs(off).max() < bound * np.abs(np.asarray(one.lines)).max()


def test_the_alignment_is_the_sum_of_its_waves_anywhere(track):
    distance = np.random.default_rng(5).uniform(-track.length, 3 * track.length, 300)
    eta = np.asarray(alignment(track, distance))
    np.testing.assert_allclose(eta, summed(track, distance), atol=1e-4 * eta.std())
    np.testing.assert_allclose(alignment(track, distance + track.length), eta, atol=1e-9 * eta.std())


def test_the_same_seed_is_the_same_track():
    """Numbers from JAX 0.10.1 and 0.12.0, which agree."""
    one, again, other = (railjax.RandomTrack("erri-high", seed=seed, length=2000.0) for seed in (7, 7, 8))
    np.testing.assert_array_equal(one.coefficients, again.coefficients)
    assert not np.allclose(one.coefficients, other.coefficients, atol=1e-4)
    np.testing.assert_allclose(alignment(one, np.array([100.0, 1234.5])), RECORDED, rtol=1e-9)
    with jax.enable_x64(False):
        np.testing.assert_array_equal(railjax.RandomTrack("erri-high", seed=7, length=2000.0).coefficients, one.coefficients)


RECORDED = [-0.0066941250706701325, 0.0032366550372180235]


def test_the_fade_in_is_straight_at_first_and_smooth():
    full, faded = (railjax.RandomTrack(seed=1, length=2000.0, fade=fade) for fade in (0.0, 50.0))
    distance = np.linspace(-30.0, 120.0, 601)
    eta, through = (np.asarray(alignment(t, distance)) for t in (full, faded))
    np.testing.assert_array_equal(through[distance <= STRAIGHT * 50.0], 0.0)
    np.testing.assert_array_equal(through[distance >= 50.0], eta[distance >= 50.0])
    second = jax.vmap(jax.grad(jax.grad(lambda s: fade_in(s, 50.0))))
    np.testing.assert_allclose(second(jnp.array([20.0, 20.0 + 1e-6, 50.0 - 1e-6, 50.0])), 0.0, atol=1e-7)


def test_lanes_of_seeds_and_amplitudes_are_the_single_runs(coach):
    options = {"duration": 1.0, "record": ["wheelset_y", "alignment"], "sample": 0.05}
    seeds, speeds, amplitudes = [4, 9, 2], [50.0, 60.0, 75.0], [0.5, 1.0, 2.0]
    together = railjax.RandomTrack(seed=seeds, length=1000.0).scaled(jnp.array(amplitudes))
    batch = railjax.simulate(coach, jnp.array(speeds), track=together, **options)
    assert batch["alignment"].shape == (20, 4, 3)
    for k, (seed, speed, amplitude) in enumerate(zip(seeds, speeds, amplitudes, strict=True)):
        alone = railjax.RandomTrack(seed=seed, length=1000.0).scaled(amplitude)
        run = railjax.simulate(coach, speed, track=alone, **options)
        for name in ("alignment", "wheelset_y"):
            np.testing.assert_allclose(batch[name][..., k], run[name], rtol=1e-7, atol=1e-13)
    assert np.abs(np.asarray(batch["alignment"])[-1]).max() > 1e-4


def test_wheelsets_see_the_track_at_their_place_also_with_a_speed_profile(coach, track):
    options = {"duration": 1.0, "record": ["alignment"], "sample": 0.05}
    run = railjax.simulate(coach, 50.0, track=track, **options)
    places = 50.0 * np.asarray(run.time)[:, None] + np.array([9.88, 7.32, -7.32, -9.88])
    np.testing.assert_allclose(run["alignment"], summed(track, places.ravel()).reshape(20, 4), atol=1e-7)
    varying = railjax.simulate(coach, railjax.SpeedProfile([0.0, 1.0], [50.0, 50.0]), track=track, **options)
    np.testing.assert_allclose(varying["alignment"], run["alignment"], atol=1e-12)


def test_user_transformations_give_the_same_and_a_new_seed_compiles_nothing_anew(coach, track):
    plain = rms(coach, 50.0, track)
    compiled = jax.jit(lambda t: rms(coach, 50.0, t))
    np.testing.assert_allclose(compiled(track), plain, rtol=1e-9)
    other = railjax.RandomTrack("erri-high", seed=4, length=2000.0, fade=0.0)
    np.testing.assert_allclose(compiled(other), rms(coach, 50.0, other), rtol=1e-9)
    assert compiled._cache_size() == 1
    mapped = jax.vmap(lambda a: rms(coach, 50.0, railjax.RandomTrack("erri-high", seed=3, length=2000.0, fade=0.0, amplitude=a)))
    np.testing.assert_allclose(mapped(jnp.array([1.0])), [plain], rtol=1e-9)


def test_derivatives_of_the_ride_with_respect_to_amplitude_speed_and_the_track_itself(linear, track):
    def ride(line, speed):
        return rms(linear, speed, line, dt=2e-3, sample=0.1)

    value = float(ride(track, 50.0))
    of_track, of_speed = jax.jit(jax.grad(ride, argnums=(0, 1)))(track, 50.0)
    forward = jax.jit(lambda a, v: jax.jvp(lambda a, v: ride(track.scaled(a), v), (a, v), (1.0, 1.0))[1])(1.0, 50.0)
    assert float(forward) == pytest.approx(float(of_track.amplitude + of_speed), rel=1e-9)
    h = 1e-4
    assert float(of_speed) == pytest.approx(float(ride(track, 50.0 + h) - ride(track, 50.0 - h)) / (2 * h), rel=1e-5)
    assert float(of_track.amplitude) == pytest.approx(
        float(ride(track.scaled(1.0 + h), 50.0) - ride(track.scaled(1.0 - h), 50.0)) / (2 * h), rel=1e-7
    )
    # linear: the ride is in proportion to the amplitude, and (Euler) to all coefficients together
    assert float(of_track.amplitude) == pytest.approx(value, rel=1e-9)
    assert float(jnp.sum(of_track.coefficients * track.coefficients)) == pytest.approx(value, rel=1e-9)


def test_order_in_dt_on_a_random_track(linear):
    """The spline is twice differentiable and its third derivative jumps little: RK4 keeps its order."""
    track = railjax.RandomTrack("erri-high", seed=3, length=1000.0)

    def final(dt):
        return railjax.simulate(linear, 50.0, track=track, dt=dt, duration=2.0, sample=2.0, record=()).final

    exact = final(2.5e-4)
    errors = [float(jnp.linalg.norm((final(dt) - exact)[:17])) for dt in (4e-3, 2e-3)]
    assert np.log2(errors[0] / errors[1]) > 3.5, errors


def test_single_precision_keeps_the_track_far_from_its_start(coach):
    """Distances of the wheelsets from each other stay exact; the distance itself is rounded to 6e-8 of it."""
    track = railjax.RandomTrack("erri-high", seed=3, length=10e3)
    for start, bound in ((1e3, 2e-7), (20e3, 4e-6), (100e3, 3e-5)):
        offsets = np.array([9.875, 0.3, -9.875])
        exact = np.asarray(alignment(track, start + offsets))
        with jax.enable_x64(False):
            single = track.seen_from(jnp.asarray(offsets, jnp.float32))(jnp.float32(start))
            assert single.dtype == jnp.float32
        np.testing.assert_allclose(single, exact, atol=bound)
    with jax.enable_x64(False):
        run = railjax.simulate(coach, 50.0, track=track, duration=1.0, record=["alignment"])
        assert run.final.dtype == jnp.float32
        single, time = np.asarray(run["alignment"]), np.asarray(run.time, float)
    places = 50.0 * time[:, None] + np.array([9.88, 7.32, -7.32, -9.88])
    np.testing.assert_allclose(single, alignment(track, places), atol=1e-7)


def test_prints_itself(track):
    text = str(track)
    assert "erri-high" in text
    assert "seed 3" in text
    assert len(text.splitlines()) == 1
    assert "2 to 200 m" in text
    assert "seed" not in str(jax.tree.map(lambda leaf: leaf, track))  # what made it is lost, not wrong


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"spectrum": "fra5"}, "nearest is 'fra-5'"),
        ({"seed": -1}, "seed must be a whole number"),
        ({"seed": 1.5}, "seed must be a whole number"),
        ({"seed": []}, "seed must be a whole number"),
        ({"seed": [1, 2.5]}, "seed must be a whole number"),
        ({"seed": True}, "seed must be a whole number"),
        ({"length": 500.0}, "length 500 m is too short for waves of 200 m: give at least 1000 m"),
        ({"length": float("nan")}, "length must be a positive"),
        ({"shortest": 300.0}, "the band is empty"),
        ({"shortest": 0.0}, "shortest must be a positive"),
    ],
)
def test_bad_random_tracks_are_refused_in_one_line(options, message):
    with pytest.raises(railjax.InputError, match=message) as caught:
        railjax.RandomTrack(**options)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"amplitude": float("nan")}, "track.amplitude must be finite"),
        ({"fade": -1.0}, "track.fade must be positive"),
    ],
)
def test_a_run_refuses_bad_numbers_of_a_track(coach, change, message):
    with pytest.raises(railjax.InputError, match=message):
        railjax.simulate(coach, 50.0, track=railjax.RandomTrack(**change), duration=0.1)


def record(step=0.25, length=600.0, scale=4e-3):
    distance = step * np.arange(round(length / step) + 1)
    return distance, scale * (np.sin(2 * np.pi * distance / 17.0) + 0.5 * np.cos(2 * np.pi * distance / 43.0))


@pytest.mark.parametrize("step", [0.1, 0.25, 0.3, 1.0])
def test_a_measured_track_goes_through_its_samples(step):
    distance, eta = record(step)
    track = railjax.MeasuredTrack(distance + 1000.0, eta)
    inner = (distance > 50.0) & (distance < distance[-1] - 50.0)
    found = np.asarray(alignment(track, distance[inner] + 20.0))
    np.testing.assert_allclose(found, (eta - eta.mean())[inner], atol=1e-8)
    between = np.linspace(60.0, 540.0, 977)
    expected = 4e-3 * (np.sin(2 * np.pi * between / 17.0) + 0.5 * np.cos(2 * np.pi * between / 43.0)) - eta.mean()
    np.testing.assert_allclose(alignment(track, between + 20.0), expected, atol=3e-6)
    outside = np.array([-1e6, -5.0, 0.0, 10.0, 19.0, 630.0, 1e4, 1e7])
    np.testing.assert_allclose(alignment(track, outside), 0.0, atol=1e-15)


def test_uneven_samples_are_put_on_an_even_grid():
    random = np.random.default_rng(3)
    distance = np.cumsum(random.uniform(0.15, 0.35, 2400))
    eta = 4e-3 * np.sin(2 * np.pi * distance / 17.0)
    track = railjax.MeasuredTrack(distance, eta)
    between = np.linspace(60.0, 500.0, 1000)
    expected = 4e-3 * np.sin(2 * np.pi * between / 17.0) - eta.mean()
    np.testing.assert_allclose(alignment(track, between - distance[0] + 20.0), expected, atol=1e-6)


def test_the_filter_takes_out_long_and_short_waves_without_shifting_the_others():
    distance = 0.25 * np.arange(8001)
    kept = 3e-3 * np.sin(2 * np.pi * distance / 25.0)
    layout, noise = 5.0 * np.cos(2 * np.pi * distance / 1500.0), 1e-3 * np.sin(2 * np.pi * distance / 1.3)
    with pytest.raises(railjax.InputError, match="longest"):
        railjax.MeasuredTrack(distance, kept + layout)
    track = railjax.MeasuredTrack(distance, kept + layout + noise, longest=150.0, shortest=3.0)
    inner = (distance > 500.0) & (distance < 1500.0)
    found = np.asarray(alignment(track, distance[inner] + 20.0))
    np.testing.assert_allclose(found, kept[inner], atol=3e-5)


def test_a_measured_track_runs_and_carries_lanes(coach):
    track = railjax.MeasuredTrack(*record())
    lanes = railjax.simulate(coach, jnp.array([50.0, 60.0]), track=track.scaled(jnp.array([1.0, 2.0])), duration=1.0, sample=0.1)
    for k, (speed, amplitude) in enumerate([(50.0, 1.0), (60.0, 2.0)]):
        alone = railjax.simulate(coach, speed, track=track.scaled(amplitude), duration=1.0, sample=0.1)
        np.testing.assert_allclose(lanes["wheelset_y"][..., k], alone["wheelset_y"], rtol=1e-7, atol=1e-13)
    assert np.abs(np.asarray(lanes["wheelset_y"])).max() > 1e-4


def test_a_file_with_both_rails_cross_level_and_gauge(tmp_path):
    distance, eta = record()
    path = tmp_path / "line.csv"
    columns = np.column_stack([1e-3 * distance + 12.0, 1e3 * eta + 1.0, 1e3 * eta - 1.0, 3.0 + 0 * eta, 1435.0 + 1e3 * eta])
    header = "Chainage (km),Alignment left (mm),Alignment right (mm),Cant (mm),Gauge (mm)"
    np.savetxt(path, columns, delimiter=",", header=header, comments="", fmt="%.9f")
    track = railjax.MeasuredTrack.from_csv(path)
    np.testing.assert_allclose(track.coefficients, railjax.MeasuredTrack(distance, eta).coefficients, atol=1e-8)
    np.testing.assert_allclose(track.cross_level, 3e-3)
    np.testing.assert_allclose(track.gauge, 1.435 + eta, atol=1e-9)
    assert track.cross is None  # a constant is none
    assert "gauge: kept, but the model does not use it" in str(track)
    assert "rolls the track, positive where the left rail is higher (assumed)" in str(track)
    assert "mean of the left and the right rail" in str(track)
    told = railjax.MeasuredTrack.from_csv(path, columns={"alignment": "Gauge"}, units={"alignment": "cm"})
    np.testing.assert_allclose(told.coefficients, 10.0 * np.asarray(track.coefficients), atol=1e-7)


def test_a_written_track_is_read_again(tmp_path):
    random = railjax.RandomTrack("erri-low", seed=5, length=1000.0)
    path = tmp_path / "random.csv"
    random.to_csv(path)
    again = railjax.MeasuredTrack.from_csv(path)
    distance = np.linspace(60.0, 900.0, 333)
    shift = np.asarray(alignment(again, distance + 20.0)) - np.asarray(alignment(random, distance))
    np.testing.assert_allclose(shift, shift.mean(), atol=2e-6)  # the mean that was taken out
    with pytest.raises(railjax.InputError, match="cannot be written"):
        random.to_csv(tmp_path / "no" / "such.csv")
    with pytest.raises(railjax.InputError, match="lanes"):
        railjax.RandomTrack(seed=[1, 2]).to_csv(path)


def test_the_estimate_of_a_track_is_a_spectrum_to_make_others_from():
    of, long = railjax.spectrum("fra-4"), railjax.RandomTrack("fra-4", seed=2, length=50e3)
    estimate = railjax.spectrum_of(long)
    w = np.geomspace(0.1, 2.0, 40)
    assert np.mean(np.asarray(estimate.density(w)) / of.density(w)) == pytest.approx(1.0, abs=0.05)
    again = railjax.RandomTrack(estimate, seed=1)
    band = (again.wavenumbers > 0.1) & (again.wavenumbers < 2.0)
    power = 0.5 * np.sum(np.abs(np.asarray(again.lines)[band]) ** 2)
    assert power == pytest.approx(float(of.variance(0.1, 2.0)), rel=0.05)
    measured = railjax.spectrum_of(railjax.MeasuredTrack(*record(length=4000.0)))
    peak = float(measured.wavenumber[np.argmax(measured.values)])
    assert peak == pytest.approx(2 * np.pi / 17.0, rel=0.02)


DISTANCE, ETA = record()


@pytest.mark.parametrize(
    ("distance", "eta", "options", "message"),
    [
        (DISTANCE[:10], ETA[:10], {}, "10 samples are too few"),
        (DISTANCE, ETA[:-1], {}, "alignment must hold one number for each"),
        (DISTANCE, np.where(DISTANCE == 30.0, np.nan, ETA), {}, "alignment of sample 121 is nan"),
        (DISTANCE[::-1], ETA, {}, "distance does not increase from sample 1"),
        (np.where(DISTANCE > 300.0, DISTANCE + 50.0, DISTANCE), ETA, {}, "a gap of 50.25 m after 300 m"),
        (DISTANCE, 1e3 * ETA, {}, "check its unit"),
        (DISTANCE, 1e-6 * ETA, {}, "check its unit"),
        (DISTANCE, 0.0 * ETA, {}, "never changes"),
        (DISTANCE, ETA, {"fade": 400.0}, "fade must lie between"),
        (DISTANCE, ETA, {"fade": 0.0}, "fade must lie between"),
        (DISTANCE, ETA, {"longest": 700.0}, "longest must lie between"),
        (DISTANCE, ETA, {"shortest": 0.4}, "shortest must lie between"),
        (DISTANCE, ETA, {"shortest": 30.0, "longest": 20.0}, "the band is empty"),
        (DISTANCE, ETA, {"gauge": np.full(7, 1.435)}, "gauge must hold"),
    ],
)
def test_bad_records_are_refused_in_one_line(distance, eta, options, message):
    with pytest.raises(railjax.InputError, match=message) as caught:
        railjax.MeasuredTrack(distance, eta, **options)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("header", "options", "message"),
    [
        ("a,alignment (mm)", {}, "no column of the distance"),
        ("distance (m),a", {}, "no column of the lateral alignment"),
        ("distance (m),left (mm)", {}, "no column of the lateral alignment"),
        ("distance (m),alignment (kN)", {}, "unit 'kN' of column"),
        ("distance (m),alignment", {}, "check its unit"),
        ("distance (m),alignment (mm)", {"columns": {"cant": "x"}}, "no quantity 'cant'"),
        ("distance (m),alignment (mm)", {"columns": {"gauge": "x"}}, r"no column 'x' for columns\['gauge'\]"),
        ("distance (m),alignment (mm)", {"units": {"alignment": "N"}}, r"units\['alignment'\] must be one of m, mm"),
    ],
)
def test_bad_files_are_refused_in_one_line(tmp_path, header, options, message):
    path = tmp_path / "bad.csv"
    np.savetxt(path, np.column_stack([DISTANCE, 1e3 * ETA]), delimiter=",", header=header, comments="")
    with pytest.raises(railjax.InputError, match=message) as caught:
        railjax.MeasuredTrack.from_csv(path, **options)
    assert len(str(caught.value).splitlines()) == 1


def test_a_track_of_many_points_runs(coach):
    """JAX 0.10.1 would spread the gathers of more than 64 thousand points over threads, which one kernel cannot have."""
    track = railjax.RandomTrack("erri-low", length=24e3)
    for speed in (50.0, jnp.array([50.0, 60.0])):
        run = railjax.simulate(coach, speed, track=track, duration=1.5, record=(), reduce=("rms:carbody_acceleration",))
        assert np.all(np.asarray(run["rms:carbody_acceleration"]) > 1e-4)
