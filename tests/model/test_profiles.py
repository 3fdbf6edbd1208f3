"""Profiles: the standards' shapes, points in every form, smoothing, and refusals that name the line."""

import jax
import numpy as np
import pytest

import railjax
from railjax import RailProfile, WheelProfile
from railjax.model.contact.profile_shapes import rail_head, s1002

PLACES = np.linspace(-50e-3, 55e-3, 700)


def height_at(profile, places=PLACES):
    return np.interp(places, profile.lateral, profile.height)


@pytest.fixture(scope="module")
def nominal():
    return WheelProfile.load("S1002")


def table(path, lateral, height, head="y (mm);z (mm)", separator=";", decimal=","):
    rows = [f"{1e3 * a:.5f}{separator}{1e3 * b:.5f}".replace(".", decimal) for a, b in zip(lateral, height, strict=True)]
    path.write_text("\n".join([*([head] if head else []), *rows]) + "\n")
    return path


def simpack(path, y, z, kind, **keys):
    """A file of SIMPACK's form; the processing keys are those that its writer sets."""
    given = {"units.len.f": 1000.0, "mirror.y": 0, "inversion": 0} | keys
    lines = [
        "! SIMPACK",
        "header.begin",
        "  version = 1 ! Version",
        f"  type = {kind} ! 0=rail, 1=wheel",
        "header.end",
        "spline.begin",
    ]
    lines += ["  file = 'own.txt' ! Original"] + [f"  {key} = {value:+.6e} ! what" for key, value in given.items()]
    lines += ["  point.begin", "  ! y  z", *[f"{1e3 * a:.7E}\t{1e3 * b:.7E}" for a, b in zip(y, z, strict=True)], "  point.end"]
    path.write_text("\n".join([*lines, "spline.end"]) + "\n")
    return path


def test_s1002_is_the_standards(nominal):
    """Values of UIC 510-2's table (height 28 mm of the flange, 70 degrees of its face, 1:15 beyond 32.158 mm, thickness 32.5 mm 10 mm below)."""
    assert 1e3 * np.max(nominal.height) == pytest.approx(28.0, abs=1e-4)
    assert np.degrees(np.arctan(-np.interp(-39e-3, nominal.lateral, nominal.slope))) == pytest.approx(70.0, abs=1e-3)
    assert np.interp(45e-3, nominal.lateral, nominal.slope) == pytest.approx(-1 / 15, rel=1e-5)
    assert height_at(nominal, 0.0) == pytest.approx(0.0, abs=1e-8)
    face = (nominal.lateral < -30e-3) & (nominal.lateral > -50e-3)
    thickness = 70.0 + 1e3 * np.interp(-10e-3, -nominal.height[face], nominal.lateral[face])
    assert thickness == pytest.approx(32.5, abs=0.05)


@pytest.mark.parametrize(("name", "top"), [("60E1", 0.3), ("60E2", 0.2), ("UIC60-MANCHESTER", 0.3)])
def test_rail_heads_are_the_standards(name, top):
    """EN 13674-1: 72 mm wide where the arcs end in the sides of 1:20; the arcs are tangent, so their end tells all of them."""
    lateral, height = rail_head(name)
    side = np.flatnonzero(np.isclose(np.gradient(height, lateral), 20.0, rtol=1e-3))[0]
    assert 1e3 * lateral[side] == pytest.approx(36.0, abs=0.01)
    head = RailProfile.load(name)
    middle = np.abs(head.lateral) < 8e-3
    bend = np.gradient(head.slope, head.lateral) / (1.0 + head.slope**2) ** 1.5
    np.testing.assert_allclose(1.0 / bend[middle][2:-2], top, rtol=1e-3)
    np.testing.assert_allclose(head.height, head.height[::-1], atol=1e-9)


@pytest.mark.parametrize("form", ["plain", "mirrored", "reversed", "upwards", "mirrored upwards", "no header", "commas"])
def test_points_in_every_form(tmp_path, nominal, form):
    lateral, height = s1002()
    lateral = -lateral if "mirrored" in form else lateral
    height = -height if "upwards" in form else height
    if form == "reversed":
        lateral, height = lateral[::-1], height[::-1]
    how = {"commas": {"head": "y (mm),z (mm)", "separator": ",", "decimal": "."}, "no header": {"head": ""}}.get(form, {})
    found = WheelProfile.load(table(tmp_path / "wheel.csv", lateral, height, **how), smoothing=0.0)
    np.testing.assert_allclose(height_at(found), height_at(nominal), atol=1e-7)
    assert any("mirrored" in note for note in found.notes) == ("mirrored" in form)
    assert any("upwards" in note for note in found.notes) == ("upwards" in form)
    assert "wheel.csv" in str(found)


def test_simpack_files(tmp_path, nominal):
    """A wheel as their writers mirror it, and a rail shifted and in metres."""
    lateral, height = s1002()
    wheel = simpack(tmp_path / "own.prw", -lateral, height, 1, **{"mirror.y": 1, "inversion": 1})
    np.testing.assert_allclose(height_at(WheelProfile.load(wheel)), height_at(nominal), atol=1e-7)
    across, down = rail_head("60E1")
    rail = simpack(
        tmp_path / "own.prr",
        1e-3 * across,
        1e-3 * down,
        0,
        **{"units.len.f": 1.0, "shift.y": 5e-3, "bound.z.min": -1.0, "bound.z.max": 0.016},
    )
    moved, head = RailProfile.load(rail), RailProfile.load("60E1")
    places = np.linspace(-34e-3, 34e-3, 100)
    np.testing.assert_allclose(height_at(moved, places + 5e-3), height_at(head, places), atol=1e-6)
    with pytest.raises(railjax.InputError, match="profile of a rail"):
        WheelProfile.load(rail)
    broken = tmp_path / "broken.prr"
    broken.write_text(rail.read_text().replace("point.begin\n", "point.begin\n1.0\tx\n"))
    with pytest.raises(railjax.InputError, match=r"broken.prr, line \d+: .* is no point"):
        RailProfile.load(broken)


def test_smoothing_halves_waves_of_its_width(nominal):
    """Waves of 2 mm on a straight tread, smoothed over 2 mm; those of 8 mm stay to (1 + 4^-4)."""
    lateral = np.arange(-54e-3, 59e-3, 1e-4)
    inner = np.linspace(-20e-3, 20e-3, 1001)
    for wave, kept in ((2e-3, 0.5), (8e-3, 256.0 / 257.0), (0.5e-3, 1.0 / 257.0)):
        ripple = 1e-5 * np.sin(2.0 * np.pi * lateral / wave)
        found = WheelProfile.from_points(lateral, ripple, smoothing=2e-3, mirrored=False)
        assert np.max(np.abs(height_at(found, inner))) == pytest.approx(1e-5 * kept, rel=0.03, abs=2e-8)


def test_noise_is_smoothed_by_default(tmp_path, nominal):
    lateral, height = s1002()
    noise = np.random.default_rng(1).normal(0.0, 1e-5, (2, len(lateral)))
    found = WheelProfile.load(table(tmp_path / "wheel.csv", lateral + noise[0], height + noise[1]))
    assert np.max(np.abs(height_at(found) - height_at(nominal))) < 3e-5
    assert any("smoothed over 2 mm" in note for note in found.notes)


def without(lateral, height):
    keep = (lateral < -20e-3) | (lateral > -5e-3)
    return lateral[keep], height[keep]


def crossing(lateral, height):
    lateral = lateral.copy()
    lateral[800] -= 3e-3
    return lateral, height


def missing(lateral, height):
    height = height.copy()
    height[700] = np.nan
    return lateral, height


def spike(lateral, height):
    height = height.copy()
    height[900] += 4e-4
    return lateral, height


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (without, "line 735: a hole of 15.2 mm"),
        (crossing, "line 802: goes back by 2.9 mm"),
        (missing, "line 702: .*nan"),
        (spike, "line 902: lies 0.21 mm off"),
        (lambda y, z: (1e-3 * y, 1e-3 * z), "0.13 mm wide.*unit"),
        (lambda y, z: (y[::300], z[::300]), "too few"),
        (lambda y, z: (y + 80e-3, z), "tread datum"),
        (lambda y, z: rail_head("60E1"), "is it a wheel"),
    ],
)
def test_bad_points_are_refused_in_one_line(tmp_path, fault, message):
    path = table(tmp_path / "wheel.csv", *fault(*s1002()), decimal=".")
    with pytest.raises(railjax.InputError, match=message) as error:
        WheelProfile.load(path)
    assert "\n" not in str(error.value)
    assert "wheel.csv" in str(error.value)


def test_more_refusals(tmp_path):
    lateral, height = s1002()
    across, down = rail_head("60E1")
    calls = {
        "is it a rail": lambda: RailProfile.from_points(lateral, height),
        "only the field side goes down": lambda: RailProfile.from_points(across[across > -15e-3], down[across > -15e-3]),
        "flange is on the field side": lambda: WheelProfile.from_points(lateral, height, mirrored=True),
        "point 900: a kink of 78": lambda: WheelProfile.from_points(*spike(lateral, height)),
        "mm wide": lambda: WheelProfile.from_points(1e3 * lateral, 1e3 * height),
        "known numbers": lambda: jax.grad(lambda z: WheelProfile.from_points(lateral, z).height[0])(height),
        "cannot be read": lambda: WheelProfile.load(tmp_path / "nowhere.csv"),
        "3 columns": lambda: WheelProfile.load(_three(tmp_path / "three.csv")),
        "smoothing": lambda: WheelProfile.from_points(lateral, height, smoothing=2.0),
        "rising": lambda: WheelProfile.load("S1002").changed([0.0, -0.01], [0.0, 0.0]),
        "a height for each": lambda: WheelProfile.load("S1002").changed([0.0, 0.01], [0.0]),
    }
    for message, call in calls.items():
        with pytest.raises(railjax.InputError, match=message):
            call()


def _three(path):
    path.write_text("a;b;c\n" + "\n".join(f"{k};{k};{k}" for k in range(20)) + "\n")
    return path


def test_control_heights(nominal):
    """A spline through the heights at their positions, and nothing beyond one more step."""
    at, by = np.array([-20e-3, -10e-3, 0.0, 10e-3]), np.array([1e-4, -2e-4, 3e-4, 1e-4])
    changed = nominal.changed(at, by)
    np.testing.assert_allclose(height_at(changed, at) - height_at(nominal, at), by, atol=2e-7)
    beyond = np.array([-45e-3, -30e-3, 20e-3, 50e-3])
    np.testing.assert_allclose(height_at(changed, beyond), height_at(nominal, beyond), atol=2e-7)
    tread = nominal.lateral > -30e-3
    np.testing.assert_allclose(np.gradient(changed.height, nominal.lateral)[tread], changed.slope[tread], atol=2e-3)
