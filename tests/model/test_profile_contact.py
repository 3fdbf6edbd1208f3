"""Dynamics on profiles: against CONTACT, against the constant conicity, virtual work against normal forces, derivatives, vehicle files."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import railjax
from railjax import WheelProfile, contact_geometry, linear_critical_speed, with_profiles
from railjax.model.contact.profile_contact import contact_at, profile_contact, seated
from railjax.model.kinematics import join, layout
from railjax.model.motion import motion

#: Manchester contact benchmark, case A-2.2, as CONTACT answers it (published output), right wheel and left wheel: y (mm); creepages x and y
#: (1e-3); spin (1e-3/mm); creep force and its part across (N)
RIGHT = np.array(
    [
        [1, 0.6943, 2.407, 0.1510, 2947, -2832],
        [2, 0.8752, 4.818, 0.1746, 2939, -2893],
        [3, 1.052, 7.235, 0.1998, 2932, -2902],
        [4, 1.276, 9.662, 0.2330, 2923, -2898],
        [6, 5.077, 15.80, 0.8744, 2911, -2775],
        [7, 19.49, 34.57, 1.838, 4195, -3644],
        [9, 22.66, 33.41, 1.588, 3583, -2963],
    ]
)
LEFT = np.array(
    [
        [1, -0.6297, 2.400, -0.03848, 3009, -2893],
        [2, -0.8651, 4.798, -0.02947, 3011, -2961],
        [3, -1.103, 7.197, -0.02432, 3009, -2974],
        [4, -1.399, 9.594, -0.02138, 3009, -2977],
        [6, -4.901, 14.37, -0.01957, 3007, -2845],
        [7, -20.35, 16.63, -0.02761, 3004, -1900],
        [9, -24.25, 21.35, -0.04210, 3005, -1985],
    ]
)


@pytest.fixture(scope="module")
def wheelset():
    """The benchmark's, on rails that do not give way."""
    found = railjax.load_vehicle("single-wheelset")
    return railjax.replace(
        found, contact__wheel_load=10e3, contact__friction=0.3, contact__flange_stiffness=1e12, wheelset__wheel_radius=0.46,
        geometry__half_gauge=0.75, contact__law="sharp",
    )  # fmt: skip


@pytest.fixture(scope="module")
def rigid(wheelset):
    return with_profiles(wheelset)


def at(vehicle, y, psi, guided=0.0):
    y, psi = (jnp.asarray(one, float)[None, None] for one in (y, psi))
    still = jnp.zeros_like(y)
    return profile_contact(vehicle, 0.5, seated(vehicle, y, still)[0], y, psi, still, still, {"primary_y": still + guided})


def test_manchester_benchmark(wheelset):
    """On its own rail: up to the flange creepages within 3 %; creep forces within 1.5 %, and their difference as vectors within 6 % of
    CONTACT's, whose signs are those of the forces on the wheel."""
    y = 1e-3 * RIGHT[:, 0]
    creepage, _, wheels = at(with_profiles(wheelset, "S1002", "UIC60-Manchester"), y, 2.4 * y)
    along = 0.5e-3 * (RIGHT[:, 1] - LEFT[:, 1])  # the mean is the wheelset's own speed
    off = np.where(RIGHT[:, 0] <= 6.0, 0.03, 0.04)
    assert np.all(np.abs(creepage.longitudinal[0, 0] / along - 1.0) < off)
    for side, published in enumerate((RIGHT, LEFT)):
        force, across = (np.asarray(part[side, 0, 0]) for part in (wheels.longitudinal_force, wheels.lateral_force))
        parallel = np.sqrt(published[:, 4] ** 2 - published[:, 5] ** 2)
        apart = np.hypot(np.abs(force) - parallel, across - published[:, 5])
        np.testing.assert_allclose(-wheels.lateral[side, 0, 0], 1e-3 * published[:, 2], rtol=0.013)
        assert np.all(np.abs(wheels.spin[side, 0, 0] / published[:, 3] + 1.0) < off)
        np.testing.assert_allclose(np.hypot(force, across), published[:, 4], rtol=0.015)
        assert np.all(apart < np.where(RIGHT[:, 0] <= 6.0, 0.06, 0.08) * published[:, 4])


def test_virtual_work_is_the_normal_forces(rigid):
    """Without friction: the wheel loads that hold the roll, times the tangents of the contact angles, at arms of the contacts' places."""
    y = np.array([-7e-3, -3e-3, 1e-3, 4e-3, 5.6e-3, 7.5e-3])
    smooth = contact_geometry("S1002", "60E1", y=np.concatenate([y[:1] - 1e-5, y]), load=10e3).smooth
    angle, roll, place = smooth.contact_angle[1:], smooth.roll[1:], smooth.wheel_position[1:]
    slope = np.tan(angle + np.stack([roll, -roll], axis=1))
    arm = 0.75 + place - smooth.rolling_radius[1:] * slope
    right = 2 * 10e3 * arm[:, 1] / arm.sum(axis=1)
    lateral = right * slope[:, 0] - (2 * 10e3 - right) * slope[:, 1]
    found = at(railjax.replace(rigid, contact__friction=1e-9), y, 0.0 * y)[1]
    # on the flange of a rigid rail the table's steps of 0.05 mm are seen
    np.testing.assert_allclose(found.lateral[0, 0], lateral, rtol=0.02)
    np.testing.assert_allclose(found.lateral[0, 0, 1:5], lateral[1:5], rtol=1e-3)


def test_springs_and_the_roll_of_wheelsets_are_reciprocal(coach):
    """Maxwell: what a wheelset's displacement does to the bogie's roll moment, by rolling on its rails, a roll of the bogie does to it."""
    vehicle = with_profiles(railjax.replace(coach, contact__flange_stiffness=1e12, contact__friction=1e-9))
    still = jnp.zeros((2, 2))

    def pulled(y, phi, law):
        by_law = dataclasses.replace(vehicle, contact=dataclasses.replace(vehicle.contact, law=law))
        groups = {name: jnp.zeros(shape) for name, shape in layout(vehicle).items()} | {"wheelset_y": y, "bogie_phi": phi}
        x = jnp.concatenate([*join(vehicle, groups), jnp.zeros(17)])
        found = motion(by_law, railjax.PassiveDamper(), 0.02, still, x).accelerations
        return vehicle.bogie.roll_inertia * found["bogie_phi"], vehicle.wheelset.mass * found["wheelset_y"]

    for y, law in ((1e-3 * jnp.array([[-6.0, -2.5], [1.5, 4.0]]), "sharp"), (still, "linear")):
        slopes = jax.jacfwd(pulled, argnums=(0, 1))(y, jnp.array([2e-3, -1e-3]), law)
        of_y, of_phi = np.asarray(slopes[0][0]), np.moveaxis(np.asarray(slopes[1][1]), 2, 0)
        assert np.abs(of_y).max() > 1e4  # N, 3 kN of each mm at rest
        np.testing.assert_allclose(of_y, of_phi, rtol=2e-3, atol=1e-3 * np.abs(of_y).max())


def test_wheel_loads_carry_the_suspension(rigid):
    """A lateral force at the height of the axle loads the wheel towards which it points; the creep that can be follows."""
    y = np.array([2e-3])
    free, guided = (at(rigid, y, 0.02 + 0.0 * y, force)[2] for force in (0.0, 4e3))
    change = 0.46 * 4e3 / (2 * 0.75) / 10e3
    ratio = np.asarray(guided.lateral_force / free.lateral_force)[:, 0, 0, 0]
    np.testing.assert_allclose(ratio, [1 + change, 1 - change], rtol=0.02)


@pytest.mark.parametrize("slope", [0.05, 0.1])
def test_cones_are_a_constant_conicity(coach, slope):
    """Straight rail heads: what the constant conicity leaves out aside, its critical speed; and with that, what the terms say in closed form."""
    cone = WheelProfile.cone(slope)
    plain = with_profiles(coach, cone, "60E1", inclination=slope, simplified=True)
    constant = dataclasses.replace(plain, profiles=None)
    expected = linear_critical_speed(constant)
    np.testing.assert_allclose(linear_critical_speed(plain), expected, rtol=1e-4)
    whole = with_profiles(coach, cone, "60E1", inclination=slope)
    at_rest = contact_at(whole.profiles, jnp.zeros((1, 1)))
    gain = 1.0 / (1.0 - slope * (0.46 + 0.3) / 0.75)
    np.testing.assert_allclose(constant.contact.conicity, slope * gain, rtol=6e-3)
    np.testing.assert_allclose(at_rest.moved, 1.0 + 0.46 * slope / 0.75 * gain, rtol=3e-3)
    np.testing.assert_allclose(at_rest.sine, np.sin(np.arctan(slope)), rtol=1e-5)


@pytest.fixture(scope="module")
def profiled():
    return railjax.load_vehicle("manchester-1-profiles")


def test_channels_of_wheels(profiled, coach):
    """Loads add up to the axle load, Y to the guiding force, but for the mean over contacts that are passing from place to place."""
    names = ("wheel_load", "wheel_lateral_force", "derailment_quotient", "guiding_force")
    run = railjax.simulate(profiled, 75.0, duration=1.0, initial={"wheelset_y": 7e-3}, record=names, reduce=("peak:wheel_load",))
    load, lateral, quotient, guiding = (np.asarray(run[name]) for name in names)
    assert load.shape == (100, 8)
    assert run["peak:wheel_load"].shape == (8,)
    np.testing.assert_allclose(load[:, 0::2] + load[:, 1::2], 2.0 * profiled.contact.wheel_load, rtol=1e-12)
    np.testing.assert_allclose(lateral[:, 1::2] - lateral[:, 0::2], guiding, atol=0.05 * np.abs(guiding).max())
    np.testing.assert_allclose(quotient, lateral / load, rtol=1e-12)
    assert list(run.to_xarray().wheel.values[:3]) == ["1 right", "1 left", "2 right"]
    with pytest.raises(railjax.InputError, match="on profiles only"):
        railjax.simulate(coach, 60.0, duration=0.1, record=("wheel_load",))
    with pytest.raises(railjax.InputError, match="simulate instead"):
        railjax.frequency_response(profiled, 50.0, "erri-low", record=("wheel_load",))


def test_what_profiles_have_in_its_place_cannot_be_changed(profiled):
    with pytest.raises(railjax.InputError, match="conicity of a vehicle on profiles is theirs"):
        railjax.replace(profiled, contact__conicity=0.1)
    assert railjax.replace(profiled, contact__friction=0.2).contact.friction == 0.2


def test_assessment_by_nadal(profiled):
    record = railjax.acceptance_channels(profiled)
    run = railjax.simulate(profiled, 75.0, duration=10.0, sample=5e-3, initial={"wheelset_y": 7e-3}, record=record)
    found = railjax.acceptance(profiled, run, section_length=100.0, margin=1.0, minimum_sections=3)
    slope = np.tan(np.radians(70.0))  # of S1002's flange
    assert found.findings["derailment"].limit == pytest.approx((slope - 0.3) / (1.0 + 0.3 * slope), rel=1e-5)
    assert 0.05 < found.findings["derailment"].value < 1.0
    assert "derailment quotient Y/Q" in str(found)
    assert "sum of both wheels only" not in str(found)


FILE = """
name = "own"
base = "manchester-1"
[contact.profiles]
wheel = "wheel.csv"
rail = "60E1"
gauge_mm = 1434
"""


def test_vehicle_files(tmp_path, profiled, wheelset):
    """Profiles beside the vehicle's file; what the file gives once; and the text of a vehicle file makes the same vehicle."""
    wheel = WheelProfile.load("S1002")
    np.savetxt(tmp_path / "wheel.csv", 1e3 * np.stack([wheel.lateral, -wheel.height], axis=1)[::10], delimiter=",")
    path = tmp_path / "own.toml"
    path.write_text(FILE)
    own = railjax.load_vehicle(path)
    assert "wheel.csv on 60E1 1:40, gauge 1434 mm" in str(own) or "gauge 1434 mm" in str(own)
    assert not [entry for entry in own.provenance if entry.parameter == "contact.conicity"]
    again = tmp_path / "again.toml"
    again.write_text(railjax.vehicle_toml(profiled, name="again"))
    for one, other in zip(jax.tree.leaves(profiled), jax.tree.leaves(railjax.load_vehicle(again)), strict=True):
        np.testing.assert_array_equal(one, other)
    for wrong, message in (
        ("gauge_mm = 1434\ninclination = 0.025", "write 40 for 1:40"),
        ("gauge = 1.434", "unknown key 'gauge'.*gauge_mm"),
        ("gauge_mm = 1.434", "millimetres"),
        ("gauge_mm = 1434\n[contact]\nconicity = 0.1", "beside"),
        ("gauge_mm = 1434\nflange_back_mm = 1415", "own.toml: contact.profiles"),
    ):
        text = FILE.replace("gauge_mm = 1434", wrong)
        if "[contact]" in wrong:
            text = FILE.replace("[contact.profiles]", "[contact]\nconicity = 0.1\n[contact.profiles]")
        path.write_text(text)
        with pytest.raises(railjax.InputError, match=message) as error:
            railjax.load_vehicle(path)
        assert "\n" not in str(error.value)
