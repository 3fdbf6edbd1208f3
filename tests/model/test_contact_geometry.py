"""Contact geometry: known pairs, CONTACT's answer to the Manchester benchmark, an independent search, derivatives, the table."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import brentq

import railjax
from railjax import ContactTable, RailProfile, WheelProfile, contact_geometry, equivalent_conicity
from railjax.base.compilation import hasty
from railjax.model.contact.profile_shapes import rail_head

#: Manchester contact benchmark, case A-2.2, as CONTACT answers it (published output): y (mm); roll (mrad, right side up positive); right
#: wheel: rail and wheel position (mm, field side positive) and contact angle against the track (rad); left wheel: the same
BENCHMARK = np.array(
    [
        [1, 0.05049, -18.5418, -9.0305, 0.0696, -5.2886, 6.2694, 0.0176],
        [2, 0.1128, -19.6178, -11.1296, 0.0806, -4.0270, 8.5660, 0.0134],
        [3, 0.1803, -20.5627, -13.0963, 0.0923, -3.2967, 10.3382, 0.0110],
        [4, 0.2557, -21.7944, -15.3505, 0.1078, -2.8681, 11.8167, 0.0096],
        [6, 0.6272, -35.3954, -31.1222, 0.4176, -2.5116, 14.3878, 0.0084],
        [7, 6.393, -41.4881, -41.1389, 1.0634, -1.9234, 18.6704, 0.0064],
        [9, 10.10, -40.0422, -43.4346, 0.8676, -2.8403, 21.5501, 0.0095],
    ]
)


@pytest.fixture(scope="module")
def standard():
    return contact_geometry("S1002", "60E1")


def test_s1002_on_60e1(standard):
    """Conicity as an independent code and the literature have it (0.177 at 3 mm), and the jumps."""
    found = equivalent_conicity(standard.y, standard.delta_r, np.array([2e-3, 3e-3, 4e-3]))
    np.testing.assert_allclose(found, [0.221, 0.177, 0.159], rtol=0.02)
    np.testing.assert_allclose(1e3 * standard.jumps, [-6.26, -4.99, -0.23, 0.23, 4.99, 6.26], atol=0.02)
    np.testing.assert_allclose(standard.jump_sizes, standard.jump_sizes[::-1], atol=1e-7)
    np.testing.assert_allclose(standard.delta_r, -standard.delta_r[::-1], atol=1e-9)
    np.testing.assert_allclose(standard.contact_angle, standard.contact_angle[::-1, ::-1], atol=1e-6)
    np.testing.assert_allclose(standard.roll, -standard.roll[::-1], atol=1e-9)
    text = str(standard)
    assert "0.177" in text
    assert "4.99 mm (+2.17 mm)" in text
    assert standard.half_distance == pytest.approx(0.75)


def test_manchester_benchmark():
    """Contact positions within 0.7 mm and angles within 0.01 rad of CONTACT's elastic contacts, outside of the jumps (4.99, 6.26 mm)."""
    y, roll = 1e-3 * BENCHMARK[:, 0], 1e-3 * BENCHMARK[:, 1]
    found = contact_geometry("S1002", "60E1", y=y, load=10e3)
    assert np.abs(found.roll - roll).max() < 6e-5
    for form, angle in ((found, 0.01), (found.smooth, 0.011)):
        for side, sign in ((0, 1.0), (1, -1.0)):
            rail, wheel, tilt = BENCHMARK[:, 2 + 3 * side : 5 + 3 * side].T
            assert np.abs(1e3 * form.rail_position[:, side] - rail).max() < 0.5
            assert np.abs(1e3 * form.wheel_position[:, side] - wheel).max() < 0.5
            assert np.abs(form.contact_angle[:, side] + sign * form.roll - tilt).max() < angle


def test_at_rest_the_smooth_form_is_the_elastic_contact():
    """In the middle the patch spans two radii of the rail: CONTACT's middle of it is at -8.66 mm on the rail and 1.8726 mm on the wheel."""
    found = contact_geometry("S1002", "60E1", y=np.array([-1e-3, 0.0, 1e-3]), load=10e3)
    np.testing.assert_allclose(1e3 * found.smooth.rail_position[1], -8.66, atol=0.05)
    np.testing.assert_allclose(1e3 * found.smooth.wheel_position[1], 1.8726, atol=0.05)


def searched(wheels, rails, y, gauge, radii, slopes, flange_back, tread_datum):
    """Roll and rolling radii by polygons on the track and Brent's method: the wheelset lies where both vertical gaps are least."""

    def polygon(profile):
        at = np.arange(profile.lateral[0], profile.lateral[-1], 4e-6)
        return at, CubicHermiteSpline(profile.lateral, profile.height, profile.slope)(at)

    placed = []
    for rail, slope in zip(rails, slopes, strict=True):
        angle = np.arctan(slope)
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        x, z = turn @ np.array(polygon(rail))
        outline, down = turn @ rail.drawn
        inner = outline < x[np.argmin(z)]
        order = np.argsort(down[inner])
        x = x + 0.5 * gauge - np.interp(np.min(z) + 14e-3, down[inner][order], outline[inner][order])
        placed.append((x, z - np.min(z)))

    def depth(roll, side):
        sign = 1.0 - 2.0 * side
        s, rise = polygon(wheels[side])
        out, below = 0.5 * flange_back + tread_datum + s, radii[side] + rise
        x = sign * y + out * np.cos(sign * roll) + below * np.sin(sign * roll)
        z = below * np.cos(sign * roll) - out * np.sin(sign * roll)
        gap = np.interp(x, *placed[side], left=1.0, right=1.0) - z
        return np.min(gap), radii[side] + rise[np.argmin(gap)]

    roll = brentq(lambda roll: depth(roll, 0)[0] - depth(roll, 1)[0], -5e-3, 5e-3, xtol=1e-10)
    return roll, depth(roll, 0)[1], depth(roll, 1)[1]


@pytest.mark.parametrize("y", [-4e-3, 2.5e-3, 5.5e-3])
def test_unlike_sides_against_an_independent_search(y):
    """Unequal wheels (920 and 918 mm), a cone under a rail of another kind and inclination."""
    wheels = WheelProfile.load("S1002"), WheelProfile.cone(0.05)
    rails = RailProfile.load("60E1"), RailProfile.load("60E2")
    given = {"gauge": 1.437, "flange_back": 1.361, "tread_datum": 0.0695}
    radii, slopes = (0.460, 0.459), (1 / 40, 1 / 20)
    found = contact_geometry(wheels, rails, y=y + np.array([-1e-4, 0.0, 1e-4]), radius=radii, inclination=slopes, **given)
    roll, right, left = searched(wheels, rails, y, radii=radii, slopes=slopes, **given)
    assert found.roll[1] == pytest.approx(roll, abs=2e-7)
    np.testing.assert_allclose(found.rolling_radius[1], [right, left], atol=3e-6)


def test_unequal_wheels():
    """920 and 918 mm: r_R - r_L is 1 mm more than with equal ones, the roll's effect aside; EN 15302's wave is about another middle."""
    lateral = np.linspace(-8e-3, 8e-3, 161)
    found = contact_geometry("S1002", "60E1", radius=(0.460, 0.459), y=lateral)
    unlike = contact_geometry("S1002", "60E1", radius=(0.459, 0.460), y=lateral)
    np.testing.assert_allclose(unlike.delta_r, -found.delta_r[::-1], atol=1e-8)
    both = [float(equivalent_conicity(one.y, one.delta_r, 3e-3)) for one in (found, unlike)]
    assert both[0] == pytest.approx(both[1], rel=1e-6)
    assert both[0] == pytest.approx(0.273, abs=0.004)


@pytest.mark.parametrize("conicity", [0.05, 0.1])
def test_a_cone_on_arcs(conicity):
    """Rolling out by phi moves the wheel by r phi and the contact on the rail's arc by R phi: Delta r = 2 gamma y/(1 - gamma (r + R)/e)."""
    y = np.linspace(-4e-3, 4e-3, 41)
    found = contact_geometry(WheelProfile.cone(conicity), "60E1", inclination=conicity, y=y)
    np.testing.assert_allclose(found.contact_angle, np.arctan(conicity), atol=1e-7)
    half_distance = 0.75 + found.wheel_position[20, 0]
    gain = 2.0 * conicity / (1.0 - conicity * (0.46 + 0.3) / half_distance)
    np.testing.assert_allclose(found.delta_r, gain * y, rtol=6e-3, atol=1e-9)
    np.testing.assert_allclose(found.smooth.delta_r, found.delta_r, atol=2e-6)
    assert found.jumps.size == 0


def test_hertz_and_kalker(standard):
    """At y = 0 and on the flange, of the curvatures and angles there by the functions of one contact."""
    ellipse, creep = standard.ellipses(60e3), standard.creep_coefficients(60e3)
    assert ellipse.a.shape == (201, 2)
    for k, side in ((100, 0), (130, 1), (190, 0)):
        across = 1.0 / standard.curvature[k, side]
        along = standard.rolling_radius[k, side] / np.cos(standard.contact_angle[k, side])
        one = jax.jit(railjax.creep_coefficients)(60e3, along, min(across, 2.0))
        for found, expected in zip(creep, one, strict=True):
            np.testing.assert_allclose(found[k, side], expected, rtol=1e-6)
    assert standard.rail_curvature[100, 0] == pytest.approx(1 / 0.3, rel=1e-3)


AT = np.array([-20e-3, -12e-3, -4e-3, 4e-3, 12e-3])
Y = np.linspace(-4.5e-3, 4.5e-3, 31)


def conicities(x):
    """At 3 mm, sharp and smooth, over changes of gauge, inclination, difference of the radii and control heights of the profile."""
    found = contact_geometry(
        WheelProfile.load("S1002").changed(AT, x[3:]),
        "60E1",
        gauge=1.435 + x[0],
        inclination=1 / 40 + x[1],
        radius=(0.46 + 0.5 * x[2], 0.46 - 0.5 * x[2]),
        y=Y,
    )
    xp = jnp if isinstance(x, jax.Array) else np
    return xp.stack([equivalent_conicity(Y, one.delta_r, 3e-3) for one in (found, found.smooth)])


def test_derivatives():
    """By the envelope theorem, against central differences of what NumPy computes, at a wheelset of unequal wheels."""
    x = np.array([5e-4, 1e-3, 1.3e-4, 3e-6, -5e-6, 2e-6, -2e-6, 1e-6])
    # the geometry's three one by one, the profile's five along two directions: each takes NumPy a second
    along = np.zeros((5, 8))
    along[:3, :3] = np.diag([2e-6, 1e-6, 1e-7])
    along[3:, 3:] = 1e-7 * np.random.default_rng(0).uniform(-1.0, 1.0, (2, 5))
    # reverse mode goes through the forward derivative, which is written by hand
    value, reverse = hasty()(jax.value_and_grad(lambda x: jnp.sum(conicities(x))))(jnp.asarray(x))
    assert value == pytest.approx(conicities(x).sum(), rel=1e-9)
    differences = np.array([conicities(x + one).sum() - conicities(x - one).sum() for one in along]) / 2.0
    found = along @ np.asarray(reverse)
    np.testing.assert_allclose(found[:3], differences[:3], rtol=1e-4)
    np.testing.assert_allclose(found[3:], differences[3:], rtol=1e-4, atol=1e-4 * np.abs(along[3:] * reverse).max())


def test_the_table_is_the_smooth_geometry():
    """Between its y as well as at them, in `jit`, `vmap` and with derivatives, straight beyond its ends."""
    coarse = contact_geometry("S1002", "60E1", y=np.linspace(-9e-3, 9e-3, 361))
    between = np.array([-6.2e-3, -3.33e-3, -0.71e-3, 0.013e-3, 4.96e-3, 5.31e-3, 7.77e-3])
    exact = contact_geometry("S1002", "60E1", y=between).smooth
    table = ContactTable.of(coarse)
    found = jax.jit(lambda table, y: (table.at(y), table.rates(y)))(table, between)
    np.testing.assert_allclose(found[0].delta_r, exact.delta_r, atol=4e-6)
    np.testing.assert_allclose(found[0].angle_right, exact.contact_angle[:, 0], atol=2e-3)
    np.testing.assert_allclose(found[0].angle_left, exact.contact_angle[:, 1], atol=2e-3)
    np.testing.assert_allclose(found[0].roll, exact.roll, atol=1e-6)
    slopes = jax.vmap(jax.grad(lambda y: table.at(y).delta_r))(jnp.append(between, jnp.array([0.0, 1e-3])))
    np.testing.assert_allclose(table.rates(jnp.append(between, jnp.array([0.0, 1e-3]))).delta_r, slopes, rtol=1e-9)
    ends = table.at(jnp.array([9e-3, 10e-3, 11e-3])).delta_r
    np.testing.assert_allclose(ends[2] - ends[1], ends[1] - ends[0], rtol=1e-9)
    with pytest.raises(railjax.InputError, match="equal steps"):
        ContactTable.of(contact_geometry("S1002", "60E1", y=np.array([0.0, 1e-3, 3e-3])))


def test_export_and_figure(standard, tmp_path):
    data = standard.to_xarray()
    assert data.delta_r.dims == ("y",)
    assert data.contact_angle.sel(side="right").attrs["units"] == "rad"
    np.testing.assert_allclose(data.smooth_delta_r, standard.smooth.delta_r)
    standard.plot().savefig(tmp_path / "pair.png")
    assert (tmp_path / "pair.png").stat().st_size > 20_000


def test_refusals():
    across, down = rail_head("60E1")
    shallow = down < 10e-3
    calls = {
        "14 mm below": lambda: contact_geometry("S1002", RailProfile.from_points(across[shallow], down[shallow])),
        "do not fit|does not fit": lambda: contact_geometry("S1002", "60E1", gauge=1.41),
        "1421.7 mm apart and gauge is 1300.0 mm": lambda: contact_geometry("S1002", "60E1", gauge=1.3),
        "too short for the gauge": lambda: contact_geometry("S1002", "60E1", gauge=1.668),
        "gauge .*millimetres": lambda: contact_geometry("S1002", "60E1", gauge=1435.0),
        "inclination": lambda: contact_geometry("S1002", "60E1", inclination=40.0),
        "wheel must be a wheel profile": lambda: contact_geometry(RailProfile.load("60E1"), "60E1"),
        "or two, .right, left.": lambda: contact_geometry("S1002", "60E1", radius=(0.46, 0.46, 0.46)),
        "y must be .*rising|rising": lambda: contact_geometry("S1002", "60E1", y=np.array([1e-3, 0.0, 2e-3])),
        "packaged are S1002": lambda: contact_geometry("S1003", "60E1"),
        "packaged are 60E1, UIC60-MANCHESTER, 60E2": lambda: contact_geometry("S1002", "60E3"),
        "cannot be read": lambda: contact_geometry("nowhere.prw", "60E1"),
    }
    for message, call in calls.items():
        with pytest.raises(railjax.InputError, match=message) as error:
            call()
        assert "\n" not in str(error.value)


def test_command_line(run, tmp_path):
    code, out, err = run(
        "conicity", "S1002", "60E1", "--gauge-mm", 1435, "--inclination", 40, "--json", "--out", tmp_path / "c.png"
    )
    assert (code, err) == (0, "")
    found = json.loads(out)
    at = found["amplitude_mm"].index(3.0)
    assert found["tan_gamma_e"][at] == pytest.approx(0.177, abs=0.004)
    assert found["tan_gamma_e_3mm"] == pytest.approx(found["tan_gamma_e"][at])
    assert len(found["y_mm"]) == len(found["delta_r_mm"]) == 201
    assert found["jumps_mm"][-2:] == pytest.approx([4.99, 6.26], abs=0.02)
    assert (tmp_path / "c.png").stat().st_size > 20_000
    code, out, err = run("conicity", "S1002", "60E2", "--inclination", 20, "--left-radius-mm", 459)
    assert code == 0
    assert "nonlinearity parameter" in out
    for wrong, message in (
        (["--inclination", "0.025"], "40 for 1:40"),
        (["--gauge-mm", "1410"], "fit"),
        (["--out", "c.pdf"], "must end in"),
    ):
        code, _, err = run("conicity", "S1002", "60E1", *wrong)
        assert code == 2
        assert message in err
        assert err.count("\n") == 1
