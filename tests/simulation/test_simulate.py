"""`simulate`: batches equal single runs, channels, reductions, tracks, profiles, result codes, output."""

import contextlib

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference

import railjax

TRACK = railjax.SinusoidTrack(4e-3, 20.0)


def run(vehicle, speed=50.0, **options):
    options = {"track": TRACK, "duration": 0.5, "record": ["wheelset_y", "carbody_y"], **options}
    return railjax.simulate(vehicle, speed, **options)


@pytest.mark.parametrize("lanes", [1, 2, 70])  # one device idle, both full, and chunks of which the last is filled up
def test_batch_equals_single_runs(coach, lanes):
    speeds = jnp.linspace(30.0, 70.0, lanes)
    stiffness = jnp.linspace(2e6, 5e6, lanes)
    together = run(railjax.replace(coach, primary__stiffness_x=stiffness), speeds, reduce=["rms:wheelset_y"])
    assert together["wheelset_y"].shape == (50, 4, lanes)
    assert together["carbody_y"].shape == (50, lanes)
    assert together["rms:wheelset_y"].shape == (4, lanes)
    assert together.code.shape == (lanes,)
    for k in {0, lanes // 2, lanes - 1}:
        alone = run(
            railjax.replace(coach, primary__stiffness_x=float(stiffness[k])),
            float(speeds[k]),
            reduce=["rms:wheelset_y"],
        )
        np.testing.assert_allclose(together["wheelset_y"][..., k], alone["wheelset_y"], rtol=1e-9, atol=1e-14)
        np.testing.assert_allclose(together["rms:wheelset_y"][..., k], alone["rms:wheelset_y"], rtol=1e-9)


def test_every_argument_may_carry_lanes(coach):
    """Track, damper and start; vehicle and speed do above."""
    amplitude, damping = np.array([1e-3, 2e-3, 5e-3]), np.array([1e4, 3e4, 9e4])
    start = np.zeros((34, 3))
    start[9:13] = [[1e-3, 2e-3, 3e-3]] * 4
    together = run(coach, track=railjax.SinusoidTrack(amplitude, 20.0), initial=start, damper=railjax.PassiveDamper(damping))
    for k in range(3):
        alone = run(
            railjax.replace(coach, secondary__damping_y=float(damping[k])),
            track=railjax.SinusoidTrack(float(amplitude[k]), 20.0),
            initial={"wheelset_y": (k + 1) * 1e-3},
        )
        np.testing.assert_allclose(together["wheelset_y"][..., k], alone["wheelset_y"], rtol=1e-9, atol=1e-14)
        np.testing.assert_allclose(together["carbody_y"][..., k], alone["carbody_y"], rtol=1e-9, atol=1e-14)


def test_a_users_vmap_runs_as_the_batch_does():
    """The same chunks, to the last bit; nested, compiled and differentiated as well."""
    wheelset = railjax.load_vehicle("single-wheelset")
    smooth = railjax.replace(wheelset, contact__law="smooth")
    speeds, stiffness = np.linspace(20.0, 40.0, 70), np.linspace(1e5, 3e5, 70)
    name = "rms:wheelset_y"

    def rms(vehicle, speed, k_ox):
        vehicle = railjax.replace(vehicle, primary__stiffness_x=k_ox)
        return run(vehicle, speed, duration=0.1, record=(), reduce=[name])[name][0]

    own = rms(wheelset, speeds, stiffness)
    assert np.array_equal(jax.vmap(rms, (None, 0, 0))(wheelset, speeds, stiffness), own)
    lowered = jax.jit(jax.vmap(rms, (None, 0, 0))).lower(wheelset, speeds, stiffness).as_text()
    assert "tensor<4x32xf64>" in lowered  # chunks, lanes last
    assert "tensor<4x70xf64>" not in lowered
    several, two = speeds[::35], stiffness[::35]
    nested = jax.jit(jax.vmap(jax.vmap(rms, (None, None, 0)), (None, 0, None)))(wheelset, several, two)
    np.testing.assert_allclose(jnp.diag(nested), own[::35], rtol=1e-9)

    def total(k_ox):
        return jnp.sum(rms(smooth, several, k_ox))

    def mapped(k_ox):
        return jnp.sum(jax.vmap(rms, (None, 0, 0))(smooth, several, k_ox))

    expected = jax.jit(jax.grad(total))(two)
    np.testing.assert_allclose(jax.jit(jax.grad(mapped))(two), expected, rtol=1e-9)
    along = jax.jit(lambda k_ox: jax.jvp(mapped, (k_ox,), (two,))[1])(two)
    np.testing.assert_allclose(along, jnp.sum(expected * two), rtol=1e-9)


def test_vmap_and_jit_by_the_user_give_the_same(coach):
    speeds = jnp.array([40.0, 55.0])
    own = run(coach, speeds)["carbody_y"]
    mapped = jax.vmap(lambda speed: run(coach, speed)["carbody_y"])(speeds)
    np.testing.assert_allclose(mapped.T, own, rtol=1e-9, atol=1e-14)
    compiled = jax.jit(lambda speed: run(coach, speed)["carbody_y"])(speeds[1])
    np.testing.assert_allclose(compiled, own[:, 1], rtol=1e-9, atol=1e-14)
    one_kernel = railjax.jit(lambda speed: run(coach, speed)["carbody_y"])(speeds[1])
    np.testing.assert_allclose(one_kernel, own[:, 1], rtol=1e-9, atol=1e-14)


def test_lanes_must_agree(coach):
    with pytest.raises(railjax.InputError, match="different numbers of lanes"):
        run(railjax.replace(coach, carbody__mass=jnp.ones(3) * 3e4), jnp.ones(2) * 50.0)
    with pytest.raises(railjax.InputError, match="more than one axis of lanes"):
        run(coach, jnp.ones((2, 2)) * 50.0)


def test_a_failing_lane_is_marked_and_the_others_are_kept(coach):
    speeds = jnp.array([50.0, 1.0, 60.0])
    result = run(coach, speeds, dt=2e-3, duration=0.5, sample=0.01)
    assert [railjax.Result(int(code)).name for code in result.code] == ["OK", "STEP_TOO_LARGE", "OK"]
    alone = run(coach, 60.0, dt=2e-3, duration=0.5, sample=0.01)
    np.testing.assert_allclose(result["wheelset_y"][..., 2], alone["wheelset_y"], rtol=1e-9, atol=1e-14)
    linear = railjax.replace(coach, contact__law="linear")
    unstable = run(linear, jnp.array([60.0, 120.0]), duration=10.0, initial={"wheelset_y": 5e-3})
    assert [railjax.Result(int(code)).name for code in unstable.code] == ["OK", "DIVERGED"]
    assert np.all(np.isfinite(np.asarray(unstable["wheelset_y"][..., 0])))
    assert "diverged: 1 of 2" in str(unstable)


def test_float32_runs_close_to_float64(coach):
    with jax.enable_x64(False):
        single = run(coach)
        assert single.final.dtype == jnp.float32
        history = np.asarray(single["wheelset_y"])
    np.testing.assert_allclose(history, run(coach)["wheelset_y"], atol=2e-6)


def test_channels_are_consistent(coach):
    # those of single wheels are of vehicles on profiles
    names = [name for name, channel in railjax.CHANNELS.items() if channel.part != "wheel"]
    start = {"wheelset_y": 9.5e-3, "bogie_phi": 1e-3}
    result = run(coach, 60.0, record=names, initial=start, duration=0.1, sample=1e-3)
    shapes = {"carbody": (), "floor": (3,), "bogie": (2,), "wheelset": (4,)}
    for name in names:
        values = np.asarray(result[name])
        assert values.shape == (100, *shapes[railjax.CHANNELS[name].part]), name
        assert np.all(np.isfinite(values)), name
    q = {name: np.asarray(result[name]) for name in names}
    j, l = np.array([1.0, -1.0]), 8.6
    travel = (
        (q["carbody_y"] + 1.24 * q["carbody_phi"])[:, None] + j * l * q["carbody_psi"][:, None]
        - q["bogie_y"] + 0.06 * q["bogie_phi"]
    )  # fmt: skip
    np.testing.assert_allclose(q["secondary_travel"], travel, atol=1e-15)
    np.testing.assert_allclose(q["damper_force"], 2 * 25e3 * q["secondary_velocity"])
    np.testing.assert_allclose(q["wheelset_on_track"], q["wheelset_y"] - q["alignment"], atol=1e-18)
    outside = np.sign(q["wheelset_on_track"]) * np.maximum(np.abs(q["wheelset_on_track"]) - reference.DELTA, 0)
    np.testing.assert_allclose(q["flange_force"], -14.6e6 * outside, rtol=1e-9, atol=1e-6)
    assert np.abs(q["flange_force"]).max() > 100
    # rates are the derivatives of the displacements
    rate = np.gradient(q["carbody_y"], np.asarray(result.time), edge_order=2)
    np.testing.assert_allclose(rate[1:-1], q["carbody_y_rate"][1:-1], atol=3e-3 * np.ptp(rate))
    assert np.ptp(rate) > 1e-2
    np.testing.assert_array_equal(q["carbody_acceleration"], q["carbody_y_acceleration"])


def test_reductions_are_sums_over_every_step(coach):
    kinds = ["rms:carbody_acceleration", "mean:carbody_acceleration", "peak:carbody_acceleration"]
    record = ["carbody_acceleration", "secondary_velocity"]
    result = run(coach, sample=1e-3, record=record, reduce=[*kinds, "peak:secondary_velocity"], settle=0.2)
    values = np.asarray(result["carbody_acceleration"])[200:]
    rms, mean, peak = (float(result[kind]) for kind in kinds)
    assert rms == pytest.approx(np.sqrt(np.mean(values**2)), rel=1e-12)
    assert mean == pytest.approx(values.mean(), rel=1e-9)
    assert peak == pytest.approx(np.abs(values).max(), rel=1e-12)
    # to either side: of the two bogies the largest value is negative once
    both = np.asarray(result["secondary_velocity"])[200:]
    assert np.any(-both.min(axis=0) > both.max(axis=0))
    np.testing.assert_allclose(result["peak:secondary_velocity"], np.abs(both).max(axis=0), rtol=1e-12)


def test_decimation_does_not_change_the_numbers(coach):
    fine, coarse = run(coach, sample=1e-3), run(coach, sample=2.5e-2)
    np.testing.assert_allclose(fine["wheelset_y"][::25], coarse["wheelset_y"], rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(coarse.time, np.arange(20) * 2.5e-2)
    np.testing.assert_allclose(fine.final, coarse.final, rtol=1e-9, atol=1e-15)


def test_a_run_can_be_continued(coach):
    whole = run(coach, track=None, initial={"wheelset_y": 5e-3}, duration=0.4)
    first = run(coach, track=None, initial={"wheelset_y": 5e-3}, duration=0.2)
    second = run(coach, track=None, initial=first.final, duration=0.2)
    np.testing.assert_allclose(second.final, whole.final, rtol=1e-9, atol=1e-16)


def test_each_wheelset_sees_the_track_delayed_by_its_position(coach):
    result = run(coach, record=["alignment"])
    time, eta = np.asarray(result.time), np.asarray(result["alignment"])
    for wheelset, position in enumerate((9.88, 7.32, -7.32, -9.88)):
        expected = 4e-3 * np.sin(2 * np.pi / 20.0 * (50.0 * time + position))
        np.testing.assert_allclose(eta[:, wheelset], expected, atol=1e-15)


def test_bump_is_fixed_in_space_and_tangent_to_the_track(coach):
    bump = railjax.BumpTrack(5e-3, 8.0, start=30.0)
    for speed in (40.0, 60.0):
        result = run(coach, speed, track=bump, record=["alignment"], duration=1.2, sample=1e-3)
        felt = np.asarray(result["alignment"])[:, 0]
        distance = speed * np.asarray(result.time) + 9.88
        assert felt.max() == pytest.approx(5e-3, rel=1e-3)
        assert distance[felt.argmax()] == pytest.approx(34.0, abs=0.06)
        assert np.count_nonzero(felt > 1e-9) * 1e-3 * speed == pytest.approx(8.0, abs=0.2)
    slope = jax.grad(lambda s: railjax.alignment(bump, s))
    assert float(slope(30.0)) == pytest.approx(0.0, abs=1e-15)
    assert float(slope(38.0)) == pytest.approx(0.0, abs=1e-15)
    assert float(slope(32.0)) == pytest.approx(5e-3 * np.pi / 8.0)


def test_sinusoid_and_tangent_alignment():
    distance = jnp.linspace(0.0, 100.0, 7)
    eta = railjax.alignment(railjax.SinusoidTrack(2e-3, 17.0), distance)
    np.testing.assert_allclose(eta, 2e-3 * np.sin(2 * np.pi * distance / 17.0), atol=1e-17)
    np.testing.assert_array_equal(railjax.alignment(railjax.TangentTrack(), distance), 0.0)


def test_speed_profile_distance_is_exact_and_reduces_to_constant_speed(coach):
    ramp = railjax.SpeedProfile([1.0, 3.0, 4.0], [40.0, 60.0, 60.0])
    time = np.linspace(1.0, 6.0, 51)
    speed = np.asarray(ramp.at(jnp.asarray(time)))
    expected = np.interp(time, [1, 3, 4], [40, 60, 60])
    np.testing.assert_allclose(speed, expected)
    travelled = np.asarray(ramp.distance(jnp.asarray(time)))
    np.testing.assert_allclose(travelled, np.concatenate([[0], np.cumsum(0.05 * (speed[1:] + speed[:-1]))]), atol=1e-9)
    constant = run(coach, railjax.SpeedProfile([0.0, 1.0], [50.0, 50.0]))
    np.testing.assert_allclose(constant["wheelset_y"], run(coach)["wheelset_y"], rtol=1e-8, atol=1e-13)
    varying = run(coach, railjax.SpeedProfile([0.0, 0.5], [50.0, 30.0]))
    assert not np.allclose(varying["wheelset_y"], run(coach)["wheelset_y"], atol=1e-4)


def test_speed_profile_matches_an_independent_integration(coach):
    import scipy.integrate

    smooth = railjax.replace(coach, contact__law="smooth")
    positions = np.array([9.88, 7.32, -7.32, -9.88])

    def rate(t, x):
        eta = 4e-3 * np.sin(2 * np.pi / 20.0 * (50.0 * t - 20.0 * t * t + positions))
        return reference.rate(x, eta, 50.0 - 40.0 * t, "smooth")

    exact = scipy.integrate.solve_ivp(rate, (0, 0.5), np.zeros(34), method="DOP853", rtol=1e-10, atol=1e-13).y[:, -1]
    result = run(smooth, railjax.SpeedProfile([0.0, 0.5], [50.0, 30.0]), dt=2.5e-4)
    np.testing.assert_allclose(result.final, exact, atol=1e-6 * np.abs(exact).max())


def test_prints_itself_and_converts_to_xarray_with_units(coach):
    result = run(coach, jnp.array([40.0, 50.0]), reduce=["rms:secondary_travel"])
    text = str(result)
    assert len(text.splitlines()) <= 6
    assert "coach" in text
    assert "144.0 to 180.0 km/h" in text
    data = result.to_xarray()
    assert data["wheelset_y"].dims == ("time", "wheelset", "lane")
    assert data["carbody_y"].dims == ("time", "lane")
    assert data["rms_secondary_travel"].dims == ("bogie", "lane")
    assert data["wheelset_y"].attrs["units"] == "m"
    assert data["time"].attrs["units"] == "s"
    np.testing.assert_array_equal(data["speed"], [40.0, 50.0])
    single = run(coach).to_xarray()
    assert single["wheelset_y"].dims == ("time", "wheelset")


def test_a_lone_wheelset_has_no_suspension_channels(coach):
    alone = railjax.replace(
        coach,
        carbody__held=True,
        bogie__held=True,
        geometry__bogie_pattern=(0.0,),
        geometry__axle_pattern=(0.0,),
    )
    assert bool(run(alone, record=["wheelset_y", "guiding_force"]).ok)
    for channel in ("carbody_acceleration", "damper_force", "bogie_y"):
        with pytest.raises(railjax.InputError, match=channel):
            run(alone, record=[channel])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"speed": 0.0}, "speed must be positive"),
        ({"speed": -3.0}, "speed must be positive"),
        ({"speed": float("nan")}, "speed must be positive"),
        ({"speed": railjax.SpeedProfile([0, 1], [10.0, 0.0])}, "speed must be positive"),
        ({"speed": 2.0, "dt": 1e-2}, r"dt = 0.01 s is too large .* use dt <= 0.0003"),
        ({"dt": -1e-3}, "dt must be positive"),
        ({"duration": 0.0}, "duration must be positive"),
        ({"duration": 0.5005, "dt": 1e-3}, "whole number of steps"),
        ({"sample": 1.5e-3}, "sample .* whole number of steps"),
        ({"sample": 0.3}, "whole number of samples"),
        ({"settle": 2.0}, "settle must lie"),
        ({"record": ["carbody_accelleration"]}, "did you mean 'carbody_acceleration'"),
        ({"reduce": ["max:carbody_y"]}, "unknown reduction"),
        ({"initial": np.zeros(33)}, "34 states"),
        ({"initial": {"wheel_y": 1.0}}, "unknown coordinate 'wheel_y'"),
        ({"initial": {"wheelset_y": [1.0, 2.0, 3.0]}}, "one value or 4"),
        ({"track": railjax.SinusoidTrack(1e-3, 0.0)}, "wavelength must be positive"),
        ({"track": railjax.BumpTrack(1e-3, -1.0)}, "length must be positive"),
    ],
)
def test_bad_input_is_refused_in_one_line(coach, options, message):
    with pytest.raises(railjax.InputError, match=message) as caught:
        run(coach, **options)
    assert len(str(caught.value).splitlines()) == 1


@contextlib.contextmanager
def compilations():
    """What XLA compiles meanwhile, by name."""
    found = []

    def listen(event, _, **about):
        if event == "/jax/core/compile/backend_compile_duration":
            found.append(about.get("fun_name", "?"))

    jax.monitoring.register_event_duration_secs_listener(listen)
    yield found
    jax.monitoring.unregister_event_duration_listener(listen)


@pytest.mark.parametrize("lanes", [None, 3])
def test_what_is_compiled_serves_every_vehicle_length_and_channel(coach, literal, lanes):
    speed = 50.0 if lanes is None else np.linspace(40.0, 60.0, lanes)
    options = {"reduce": ["rms:carbody_y"]}
    with compilations() as first:
        run(coach, speed, **options, record=["damper_force"])
    assert first, "else this counts nothing"
    with compilations() as later:
        run(literal, speed, **options, duration=0.7)
        run(coach, speed, **options, record=["guiding_force", "bogie_psi_acceleration"], settle=0.1)
        result = run(railjax.replace(coach, carbody__mass=np.float64(3e4)), speed, **options, sample=0.025)
        run(railjax.replace(coach, carbody__mass=np.float32(3e4)), speed, **options)
        assert np.all(np.isfinite(result["flange_force"])), str(result)
    assert not later


def test_channels_are_read_later_as_if_recorded(coach):
    names = ["bogie_y", "wheelset_psi_rate", "floor_acceleration", "alignment", "damper_force"]
    start = {"initial": {"wheelset_y": 9.5e-3}, "duration": 12.0}  # more samples than a block has
    for speed in (60.0, railjax.SpeedProfile([0.0, 12.0], [60.0, 50.0])):
        later, recorded = run(coach, speed, record=(), **start), run(coach, speed, record=names, **start)
        together = run(coach, jnp.array([60.0] * 40), record=names, **start) if speed == 60.0 else None  # read in the kernel
        for name in names:
            np.testing.assert_array_equal(later[name], recorded[name])
            if together is not None:
                np.testing.assert_allclose(together[name][..., 7], later[name], rtol=1e-7, atol=1e-9)
    assert list(later.channels) == []
    batch = run(coach, jnp.array([60.0] * 40), **start, record=names)
    with pytest.raises(railjax.InputError, match=r"record=\['bogie_psi'\]"):
        batch["bogie_psi"]
    with pytest.raises(railjax.InputError, match=r"record=\['bogie_psi'\]"):
        jax.jit(lambda speed: run(coach, speed)["bogie_psi"])(50.0)
    with pytest.raises(railjax.InputError, match=r"reduce=\['rms:bogie_y'\]"):
        later["rms:bogie_y"]
    with pytest.raises(railjax.InputError, match="did you mean 'bogie_psi'"):
        later["bogie_psy"]
