"""Layouts of lines against integrals and differences; bad ones are refused in one line or warned of."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

import railjax
from railjax import Layout, Segment
from railjax.model.kinematics import heights
from railjax.model.track.curve import GRAVITY, arc

TURN = Segment.transition(60.0)
COMPOUND = [Segment.straight(40.0), TURN, Segment.arc(50.0, 400.0, 0.12), TURN, Segment.arc(50.0, -900.0, 0.03), TURN]


@pytest.mark.parametrize("ramp", ["linear", "smooth"])
def test_curvature_and_cant_lead_from_segment_to_segment(ramp):
    layout = Layout(COMPOUND, ramp=ramp)
    ends = np.array([-50.0, 0.0, 30.0, 110.0, 140.0, 215.0, 255.0, 330.0, 1000.0])
    kappa, theta = layout.at(ends)
    np.testing.assert_allclose(kappa, [0, 0, 0, 1 / 400, 1 / 400, -1 / 900, -1 / 900, 0, 0], atol=1e-15)
    np.testing.assert_allclose(theta, np.array([0, 0, 0, 0.12, 0.12, -0.03, -0.03, 0, 0]) / 1.5, atol=1e-15)
    # ramps: half way in the middle; the corners are rounded, the quarter is that of each kind
    kappa, _ = layout.at(np.array([55.0, 70.0, 180.0]))
    np.testing.assert_allclose(
        kappa, [(0.25 if ramp == "linear" else 0.15625) / 400, 0.5 / 400, 0.5 * (1 / 400 - 1 / 900)], rtol=1e-12
    )


@pytest.mark.parametrize("ramp", ["linear", "smooth"])
def test_what_a_vehicle_sees_of_the_line(coach, ramp):
    """Places by integrals of the curvature, rates and accelerations by differences in time, of a vehicle that gains speed."""
    layout, like, x = Layout(COMPOUND, ramp=ramp), jnp.zeros((2, 2)), coach.geometry.half_pivot_distance
    v, gain, h = 20.0, 0.7, heights(coach)["bogie"]

    def kappa(s):
        return float(layout.at(s)[0])

    for centre in (39.0, 70.0, 97.5, 183.0):
        found = layout.curve_at(coach, centre, v, gain, like)
        theta = [float(layout.at(s)[1]) for s in (centre + x, centre)]
        breaks = {"points": [38, 40, 42, 98, 100, 102, 148, 150, 152, 208, 210, 212], "limit": 200}
        turn = quad(kappa, centre, centre + x, **breaks)[0]
        aside = quad(lambda s, centre=centre: (centre + x - s) * kappa(s), centre, centre + x, **breaks)[0]
        assert float(found.place["bogie_psi"][0]) == pytest.approx(turn, abs=1e-10)
        assert float(found.place["bogie_y"][0]) == pytest.approx(aside + h * (theta[0] - theta[1]), abs=1e-10)
        assert float(found.place["bogie_phi"][0]) == pytest.approx(theta[1] - theta[0], abs=1e-12)
        step = 1e-4
        before, after = (
            layout.curve_at(coach, centre + v * t + 0.5 * gain * t**2, v + gain * t, gain, like) for t in (-step, step)
        )
        for name, rate in found.rate.items():
            difference = (after.place[name] - before.place[name]) / (2 * step)
            np.testing.assert_allclose(rate, difference, atol=1e-8, err_msg=f"{name} at {centre}")
        turning = [(v + gain * t) * c.curvature for t, c in ((-step, before), (step, after))]
        np.testing.assert_allclose(found.acceleration["wheelset_psi"], (turning[1] - turning[0]) / (2 * step), atol=1e-6)
        tilt = [float(layout.at(centre + v * t + 0.5 * gain * t**2)[1]) for t in (-1e-3, 0.0, 1e-3)]
        rolling = (tilt[2] - 2 * tilt[1] + tilt[0]) / 1e-6
        np.testing.assert_allclose(-found.acceleration["carbody_phi"], rolling, atol=2e-5)
        sideways = v**2 * kappa(centre) - GRAVITY * tilt[1] + heights(coach)["carbody"] * rolling
        np.testing.assert_allclose(found.acceleration["carbody_y"], sideways, atol=5e-5)


def test_a_cross_level_rolls_each_body_with_the_rails_under_its_wheelsets(coach):
    """By NumPy from the record's values under the wheelsets; the line itself is as it was."""
    s, like = np.arange(0.0, 200.0, 0.5), jnp.zeros((2, 2))
    record = s, 1e-3 * np.sin(s / 4.0)
    level = 4e-3 * np.cos(2.0 * np.pi * s / 9.0)
    rough = railjax.MeasuredTrack(*record, cross_level=level)
    plain, rolled = (Layout(COMPOUND, irregularity=one).curve_at(coach, 107.3, 30.0, 0.4, like) for one in (None, rough))
    geometry, step = coach.geometry, 1e-2
    along = np.add.outer(geometry.half_pivot_distance * np.array([1, -1]), geometry.half_wheelbase * np.array([1, -1]))
    # the record begins 20 m in front of the run's start; faded in over 50 m, it is full at 70 m
    under = lambda ahead: 4e-3 * np.cos(2.0 * np.pi * (107.3 + ahead + along - 20.0) / 9.0) / 1.5  # noqa: E731
    mean = np.mean(level)
    theta = under(0.0) - mean / 1.5
    twist = (under(step) - 2.0 * under(0.0) + under(-step)) / step**2
    slope = (under(step) - under(-step)) / (2.0 * step)
    body = np.mean(theta)
    for name, values in (("wheelset", theta), ("bogie", np.mean(theta, axis=1))):
        moved = rolled.place[f"{name}_phi"] - plain.place[f"{name}_phi"]
        np.testing.assert_allclose(moved, body - values, atol=2e-6)
        np.testing.assert_allclose(
            rolled.place[f"{name}_y"] - plain.place[f"{name}_y"], heights(coach)[name] * (values - body), atol=2e-6
        )
    height = heights(coach)["carbody"]
    felt = rolled.acceleration["carbody_y"] - plain.acceleration["carbody_y"]
    expected = -GRAVITY * body + height * (30.0**2 * np.mean(twist) + 0.4 * np.mean(slope))
    np.testing.assert_allclose(felt, expected, rtol=0.01)
    np.testing.assert_array_equal(rolled.curvature, plain.curvature)
    still = railjax.MeasuredTrack(*record, cross_level=level, rolls=False)
    np.testing.assert_array_equal(Layout(COMPOUND, irregularity=still).curve_at(coach, 107.3, 30.0, 0.4, like).place["bogie_phi"], plain.place["bogie_phi"])  # fmt: skip
    with pytest.raises(railjax.InputError, match=r"cross level reaches .* take it out by longest"):
        railjax.MeasuredTrack(*record, cross_level=30.0 * level)


def test_within_an_arc_it_is_that_of_steady_curving(coach):
    layout, like = Layout([Segment.straight(10.0), TURN, Segment.arc(100.0, 300.0, 0.1)]), jnp.zeros((2, 2))
    found, expected = layout.curve_at(coach, 120.0, 25.0, 0.0, like), arc(coach, 25.0, 1 / 300.0, 0.1 / 1.5, like)
    for part in ("place", "acceleration"):
        for name, value in getattr(expected, part).items():
            np.testing.assert_allclose(getattr(found, part)[name], value, atol=1e-12, err_msg=name)
    for value in found.rate.values():
        np.testing.assert_allclose(value, 0.0, atol=1e-12)


def test_bad_layouts_are_refused_or_warned_of(tmp_path):
    for call, says in (
        (lambda: Layout([TURN, TURN]), "both transitions"),
        (lambda: Layout([]), "must be a list"),
        (lambda: Segment.arc(100.0, 0.0), "radius must be"),
        (lambda: Segment.arc(100.0, 500.0, 100.0), "in millimetres"),
        (lambda: Segment.straight(-1.0), "length must be positive"),
        (lambda: Layout([TURN], ramp="sine"), "ramp must be one of linear, smooth"),
        (lambda: Layout.from_samples([0, 1, 2, 100, 101], np.zeros(5)), "a gap of 98 m after 2 m"),
        (lambda: Layout.from_samples([0, 1, 1, 2], np.zeros(4)), "must rise"),
        (lambda: Layout.load(tmp_path / "none.toml"), "cannot be read"),
    ):
        with pytest.raises(railjax.InputError, match=says) as error:
            call()
        assert "\n" not in str(error.value)
    with pytest.warns(RuntimeWarning, match="jumps at 50 m without a transition"):
        jump = Layout([Segment.straight(50.0), Segment.arc(100.0, 500.0)])
    np.testing.assert_allclose(jump.at(np.array([47.9, 50.0, 52.1]))[0], [0.0, 0.001, 0.002], rtol=1e-12)
    np.testing.assert_allclose(
        Layout([Segment.arc(100.0, 500.0, 0.1)]).at(np.array([-20.0, 0.0, 200.0])), [[1 / 500] * 3, [1 / 15] * 3]
    )
    with pytest.warns(RuntimeWarning, match="cant of 250 mm"):
        Layout([TURN, Segment.arc(100.0, 500.0, 0.25), TURN])


def test_files(tmp_path):
    path = tmp_path / "curve.toml"
    path.write_text(
        'ramp = "smooth"\n[[segment]]\nkind = "straight"\nlength_m = 40\n[[segment]]\nkind = "transition"\nlength_m = 60\n'
        '[[segment]]\nkind = "arc"\nlength_m = 50\nradius_m = 400\ncant_deficiency_mm = 30\nspeed_kmh = 72\n'
    )
    cant = 1.5 * 20.0**2 / (9.81 * 400) - 0.03
    np.testing.assert_allclose(Layout.load(path).at(120.0), [1 / 400, cant / 1.5], rtol=1e-12)
    path.write_text(path.read_text().replace("length_m = 50", "length = 50"))
    with pytest.raises(railjax.InputError, match=r"curve.toml: unknown key segment 3.length; did you mean"):
        Layout.load(path)
    samples, layout = tmp_path / "line.csv", Layout(COMPOUND)
    s = np.arange(0.0, 340.0, 2.0)
    kappa, theta = (np.asarray(part) for part in layout.at(s))
    radius = np.where(np.abs(kappa) > 1e-6, 1.0 / np.where(kappa == 0.0, 1.0, kappa), 0.0)
    rows = np.column_stack([s, radius, 1.5e3 * theta])
    np.savetxt(samples, rows, delimiter=",", header="distance (m),radius (m),cant (mm)", comments="")
    found = Layout.load(samples)
    np.testing.assert_allclose(found.at(s + 0.7)[0], layout.at(s + 0.7)[0], atol=2e-5)
    np.testing.assert_allclose(found.at(s + 0.7)[1], layout.at(s + 0.7)[1], atol=1e-3)
    assert "least radius 400 m" in str(found)
