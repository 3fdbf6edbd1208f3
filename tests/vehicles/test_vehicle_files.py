"""Vehicle files: values, units, `base`, provenance; one line that names key and fix for whatever is wrong."""

import math
import tomllib
from pathlib import Path

import jax
import pytest
from fuzz import toml

import railjax

TABLE_1 = (Path(railjax.__file__).parent / "vehicles" / "coach-table1.toml").read_text(encoding="utf-8")


@pytest.fixture
def load(tmp_path):
    """Writes a file, by default on top of the coach, and loads it."""

    def write_and_load(text, base="coach", name="mine.toml"):
        path = tmp_path / name
        path.write_text((f'base = "{base}"\n' if base else "") + text, encoding="utf-8")
        return railjax.load_vehicle(path)

    return write_and_load


def refused(call, *pieces):
    """The call raises `InputError` of one line that holds all pieces."""
    with pytest.raises(railjax.InputError) as caught:
        call()
    message = str(caught.value)
    assert len(message.splitlines()) == 1
    for piece in pieces:
        assert piece in message, message


def leaves(vehicle):
    return [railjax.get_parameter(vehicle, path) for path, _ in railjax.parameters()]


def test_packaged_vehicles_load():
    assert railjax.packaged_vehicles() == [
        "coach", "coach-mpe2019", "coach-s1002", "coach-table1", "cooperrider-bogie", "crh380a", "manchester-1",
        "manchester-1-profiles", "single-wheelset"
    ]  # fmt: skip
    for name in railjax.packaged_vehicles():
        vehicle = railjax.load_vehicle(name)
        assert vehicle.name == name
        assert all(type(value) is float and math.isfinite(value) for value in leaves(vehicle))
        paths = {path for path, _ in railjax.parameters(vehicle)}
        assert {entry.parameter for entry in vehicle.provenance} <= paths
        assert all(entry.note for entry in vehicle.provenance)
        assert vehicle.note


@pytest.mark.parametrize(
    ("name", "speed", "low", "high"),
    [
        ("coach", 20.0, 68.2, 68.3),
        ("coach-table1", 10.0, 18.0, 18.2),
        ("cooperrider-bogie", 20.0, 68.61, 68.71),
        # no critical speed is published for these: plausible is all that can be asked
        ("coach-mpe2019", 20.0, 50.0, 100.0),
        ("crh380a", 20.0, 80.0, 145.0),
        ("manchester-1", 20.0, 40.0, 100.0),
        ("single-wheelset", 20.0, 20.0, 80.0),
    ],
)
def test_packaged_vehicles_run_and_hunt(name, speed, low, high):
    vehicle = railjax.load_vehicle(name)
    assert low < float(railjax.linear_critical_speed(vehicle)) < high
    track = railjax.SinusoidTrack(3e-3, 20.0)
    run = railjax.simulate(vehicle, speed, track=track, duration=1.0, record=["wheelset_y"])
    assert bool(run.ok)
    assert 1e-4 < float(abs(run["wheelset_y"]).max()) < 2e-2


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("carbody.mass", 30760.0),
        ("carbody.roll_inertia", 53596.0),
        ("carbody.yaw_inertia", 1661732.0),
        ("bogie.mass", 2300.0),
        ("bogie.roll_inertia", 2240.0),
        ("bogie.yaw_inertia", 2965.0),
        ("wheelset.mass", 1410.0),
        ("wheelset.yaw_inertia", 980.0),
        ("wheelset.spin_inertia", 100.0),
        ("wheelset.wheel_radius", 0.46),
        ("primary.stiffness_x", 256e3),
        ("primary.stiffness_y", 885e3),
        ("primary.stiffness_z", 904e3),
        ("primary.damping_x", 0.0),
        ("primary.damping_y", 0.0),
        ("primary.damping_z", 3.67e3),
        ("secondary.stiffness_x", 133e3),
        ("secondary.stiffness_y", 133e3),
        ("secondary.stiffness_z", 473e3),
        ("secondary.damping_x", 0.0),
        ("secondary.damping_y", 25e3),
        ("secondary.damping_z", 18e3),
        ("secondary.anti_roll_stiffness", 0.0),
        ("geometry.half_wheelbase", 1.28),
        ("geometry.half_pivot_distance", 8.6),
        ("geometry.half_gauge", 0.7175),
        ("geometry.half_primary", 1.0),
        ("geometry.half_secondary", 1.0),
        ("geometry.carbody_height", 1.24),
        ("geometry.bogie_to_primary", 0.01),
        ("geometry.bogie_to_secondary", 0.06),
        ("contact.creep_longitudinal", 9.43e6),
        ("contact.creep_lateral", 10.25e6),
        ("contact.creep_lateral_spin", 1200.0),
        ("contact.creep_spin", 1000.0),
        ("contact.conicity", 0.14),
        ("contact.wheel_load", 51250.0),
        ("contact.flange_stiffness", 14.6e6),
        ("contact.flange_clearance", 9e-3),
    ],
)
def test_table_1_in_si(literal, path, value):
    assert railjax.get_parameter(literal, path) == pytest.approx(value, rel=1e-12)


def test_the_coach_changes_only_what_was_calibrated(coach, literal):
    changed = {
        path for path, _ in railjax.parameters() if railjax.get_parameter(coach, path) != railjax.get_parameter(literal, path)
    }
    assert changed == {"primary.stiffness_x", "primary.stiffness_y", "contact.friction", "contact.flange_clearance"}
    assert changed == {p.parameter for p in coach.provenance if p.status == "calibrated"}
    factors = [coach.primary.stiffness_x / 256e3, coach.primary.stiffness_y / 885e3]
    assert factors == pytest.approx([12.607937] * 2, rel=1e-6)


@pytest.mark.parametrize(
    ("text", "path", "value"),
    [
        ("[carbody]\nmass_t = 31.5", "carbody.mass", 31500.0),
        ("[bogie]\nyaw_inertia_tm2 = 2.5", "bogie.yaw_inertia", 2500.0),
        ("[wheelset]\nwheel_radius_mm = 460", "wheelset.wheel_radius", 0.46),
        ("[contact]\nwheel_load_N = 50000", "contact.wheel_load", 5e4),
        ("[contact]\nwheel_load_kN = 50", "contact.wheel_load", 5e4),
        ("[contact]\ncreep_lateral_MN = 8", "contact.creep_lateral", 8e6),
        ("[contact]\ncreep_lateral_spin_kNm = 2", "contact.creep_lateral_spin", 2e3),
        ("[contact]\ncreep_spin_kNm2 = 2", "contact.creep_spin", 2e3),
        ("[primary]\nstiffness_x_N_per_m = 4e6", "primary.stiffness_x", 4e6),
        ("[primary]\nstiffness_x_MN_per_m = 4", "primary.stiffness_x", 4e6),
        ("[secondary]\ndamping_y_Ns_per_m = 3e4", "secondary.damping_y", 3e4),
        ("[secondary]\nanti_roll_stiffness_MNm_per_rad = 2", "secondary.anti_roll_stiffness", 2e6),
        ("[geometry]\nbogie_to_secondary_m = -0.1", "geometry.bogie_to_secondary", -0.1),
        ("[geometry]\nhalf_vertical_damper_mm = 1300", "geometry.half_vertical_damper", 1.3),
        ("[contact]\nlaw = 'linear'", "contact.law", "linear"),
        ("[geometry]\naxle_pattern = [1, 0, -1]", "geometry.axle_pattern", (1.0, 0.0, -1.0)),
    ],
)
def test_units_and_overrides(load, coach, text, path, value):
    vehicle = load(text)
    assert railjax.get_parameter(vehicle, path) == pytest.approx(value)
    others = [name for name, _ in railjax.parameters() if name != path]
    assert [railjax.get_parameter(vehicle, name) for name in others] == [railjax.get_parameter(coach, name) for name in others]


def test_a_base_beside_the_file_and_a_chain_of_two(load):
    load("[carbody]\nmass_t = 40\n[bogie]\nmass_t = 3", name="below.toml")
    vehicle = load("[carbody]\nmass_t = 41", base="below.toml", name="above.toml")
    assert (vehicle.carbody.mass, vehicle.bogie.mass, vehicle.wheelset.mass) == (41e3, 3e3, 1410.0)


def test_a_file_does_not_inherit_what_is_said_of_its_base(load, coach):
    vehicle = load("[primary]\nstiffness_x_MN_per_m = 5")
    assert (vehicle.name, vehicle.note) == ("mine", "")
    entries = {entry.parameter for entry in vehicle.provenance}
    assert "primary.stiffness_x" not in entries
    assert "primary.stiffness_y" in entries


YAW_DAMPER = """
[yaw_damper]
damping_kNs_per_m = 300
half_distance_m = 1.35
"""
BLOW_OFF = "blow_off_velocity_mm_per_s = 10\ndamping_beyond_kNs_per_m = 20\n"
ELEMENTS = (
    YAW_DAMPER
    + BLOW_OFF
    + """series_stiffness_MN_per_m = 10
[lateral_damper]
blow_off_velocity_m_per_s = 0.1
damping_beyond_kNs_per_m = 5
carbody_height_mm = 970
bogie_to_damper_m = -0.044
[bump_stop]
travel_mm = [0, 25, 30]
force_kN = [0, 0, 0.6]
[geometry]
half_vertical_damper_m = 1.323
"""
)


def test_optional_parts(load, coach):
    vehicle = load(ELEMENTS)
    assert vehicle.yaw_damper == railjax.YawDamper(3e5, 1.35, 0.01, 2e4, 1e7)
    assert vehicle.lateral_damper == railjax.LateralDamper(0.1, 5e3, 0.97, -0.044)
    # the point (0, 0) goes without saying
    assert vehicle.bump_stop.travel == pytest.approx([0.025, 0.03])
    assert vehicle.bump_stop.force == pytest.approx([0.0, 600.0])
    assert vehicle.geometry.half_vertical_damper == 1.323
    assert (coach.yaw_damper, coach.lateral_damper, coach.bump_stop) == (None, None, None)
    assert load(YAW_DAMPER).yaw_damper == railjax.YawDamper(3e5, 1.35)


def test_optional_parts_of_the_base_are_changed_or_taken_out(load):
    load(ELEMENTS + "[provenance]\n'yaw_damper.damping' = {status = 'assumed'}", name="below.toml")
    inherited = load("", base="below.toml")
    assert inherited.yaw_damper.series_stiffness == 1e7
    softer = load("[yaw_damper]\nseries_stiffness_MN_per_m = 5\n[bump_stop]\nforce_N = [0, 0, 900]", base="below.toml")
    assert softer.yaw_damper == railjax.YawDamper(3e5, 1.35, 0.01, 2e4, 5e6)
    assert softer.bump_stop.force == pytest.approx([0.0, 900.0])
    without = load("yaw_damper = false", base="below.toml", name="without.toml")
    assert without.yaw_damper is None
    assert without.bump_stop is not None
    assert not any(entry.parameter.startswith("yaw_damper") for entry in without.provenance)
    assert load(YAW_DAMPER, base="without.toml", name="again.toml").yaw_damper == railjax.YawDamper(3e5, 1.35)


@pytest.mark.parametrize(
    ("text", "pieces"),
    [
        ("[yaw_dampers]\ndamping_kNs_per_m = 1", ["unknown key 'yaw_dampers'", "did you mean yaw_damper?"]),
        ("yaw_damper = 3e5", ["yaw_damper must be a table, written [yaw_damper]"]),
        ("carbody = false", ["carbody must be a table"]),
        ("[yaw_damper]\ndamping_kNs_per_m = 300", ["missing key yaw_damper.half_distance_m"]),
        ("[yaw_damper]\nhalf_distance_m = 1", ["missing key yaw_damper.damping_Ns_per_m"]),
        (YAW_DAMPER + "blow_off_velocity = 0.1", ["must name its unit: blow_off_velocity_m_per_s or"]),
        (YAW_DAMPER + "blow_off_m_per_s = 0.1", ["unknown key yaw_damper.blow_off_m_per_s", "blow_off_width_m_per_s?"]),
        (YAW_DAMPER + "blow_off_velocity_m_per_s = 0.01", ["blow_off_velocity also needs yaw_damper.damping_beyond"]),
        (YAW_DAMPER + "damping_beyond_kNs_per_m = 20", ["damping_beyond also needs yaw_damper.blow_off_velocity"]),
        (YAW_DAMPER + BLOW_OFF.replace("= 20", "= 400"), ["damping_beyond must not exceed yaw_damper.damping"]),
        (YAW_DAMPER + BLOW_OFF.replace("= 10", "= 0"), ["blow_off_velocity_mm_per_s must be positive, not 0"]),
        (YAW_DAMPER + BLOW_OFF.replace("= 20", "= -1"), ["damping_beyond_kNs_per_m must not be negative (-1)"]),
        (
            YAW_DAMPER + BLOW_OFF.replace("= 20", "= 0") + "series_stiffness_MN_per_m = 5",
            ["damping_beyond must be positive beside series_stiffness"],
        ),
        (YAW_DAMPER + "series_stiffness_MN_per_m = nan", ["series_stiffness_MN_per_m must be finite"]),
        (YAW_DAMPER.replace("= 300", "= '300'"), ["yaw_damper.damping_kNs_per_m must be a number, not '300'"]),
        ("[lateral_damper]\nblow_off_velocity_m_per_s = 0.1", ["also needs lateral_damper.damping_beyond"]),
        (
            "[lateral_damper]\nblow_off_velocity_m_per_s = 0.1\ndamping_beyond_kNs_per_m = 26",
            ["lateral_damper.damping_beyond must not exceed secondary.damping_y"],
        ),
        ("[bump_stop]\ntravel_mm = [20, 30]", ["missing key bump_stop.force_N"]),
        ("[bump_stop]\ntravel_mm = 20\nforce_N = [1]", ["bump_stop.travel_mm must be a list of numbers", "not 20"]),
        ("[bump_stop]\ntravel_mm = []\nforce_N = []", ["bump_stop.travel_mm must be a list of numbers"]),
        ("[bump_stop]\ntravel = [20]\nforce_N = [1]", ["must name its unit: travel_m or travel_mm"]),
        ("[bump_stop]\ntravel_mm = [20, 'x']\nforce_N = [1, 2]", ["bump_stop.travel_mm must be a number, not 'x'"]),
        ("[bump_stop]\ntravel_mm = [20, nan]\nforce_N = [1, 2]", ["bump_stop.travel_mm must be finite"]),
        ("[bump_stop]\ntravel_mm = [-20, 30]\nforce_N = [1, 2]", ["bump_stop.travel_mm must not be negative (-20)"]),
        ("[bump_stop]\ntravel_mm = [20, 30]\nforce_N = [1]", ["travel has 2 entries and force 1", "pairs"]),
        ("[bump_stop]\ntravel_mm = [30, 20]\nforce_N = [1, 2]", ["bump_stop.travel must rise"]),
        ("[bump_stop]\ntravel_mm = [0, 20]\nforce_N = [5, 10]", ["bump_stop.travel must rise", "or from 0 at 0 N"]),
        ("[bump_stop]\ntravel_mm = [20, 30]\nforce_N = [2, 1]", ["bump_stop.force must not fall"]),
        ("[bump_stop]\ntravel_m = [1e-300, 1]\nforce_N = [1e10, 1e11]", ["rises too steeply", "units"]),
        ("[carbody]\nheld = true\n[bogie]\nheld = true\n" + YAW_DAMPER, ["[yaw_damper]", "the bogie is held"]),
    ],
)
def test_bad_optional_parts_are_refused_in_one_line(load, text, pieces):
    refused(lambda: load(text), "mine.toml", *pieces)


def test_circle_is_refused(load):
    refused(lambda: load("", base="mine.toml"), "mine.toml", "base", "circle")


def test_kalker_coefficients_from_the_ellipse(load, coach):
    vehicle = load("[contact.hertz]\nrail_head_radius_m = 0.3", name="hertz.toml")
    expected = railjax.creep_coefficients(51250.0, 0.46, 0.3)
    for name, value in expected._asdict().items():
        found = getattr(vehicle.contact, name)
        assert type(found) is float
        assert found == pytest.approx(float(value))
    # the load of the file above counts, and an unrelated key of the same table does not undo the ellipse
    lighter = load("[contact]\ncreep_width = 0.02\nwheel_load_kN = 40", base="hertz.toml")
    assert lighter.contact.creep_lateral == pytest.approx(float(railjax.creep_coefficients(40e3, 0.46, 0.3).creep_lateral))
    own = load("[contact]\ncreep_longitudinal_MN = 9\ncreep_lateral_MN = 8", base="hertz.toml")
    assert (own.contact.creep_longitudinal, own.contact.creep_lateral) == (9e6, 8e6)


def test_the_ellipse_does_not_depend_on_the_precision_in_use(load):
    double = load("[contact.hertz]\nrail_head_radius_m = 0.3")
    with jax.enable_x64(False):
        single = load("[contact.hertz]\nrail_head_radius_m = 0.3")
    assert single == double


@pytest.mark.parametrize(
    ("text", "pieces"),
    [
        ("[carbdy]\nmass_t = 1", ["unknown key 'carbdy'", "did you mean carbody?"]),
        ("[carbody]\nmas_kg = 1", ["unknown key carbody.mas_kg", "did you mean carbody.mass_kg?"]),
        ("[carbody]\nmass = 1", ["carbody.mass", "name its unit", "mass_kg or mass_t"]),
        ("[carbody]\nmass_lb = 1", ["carbody.mass_lb", "name its unit", "mass_kg or mass_t"]),
        ("[contact]\ncreep_lateral_spin = 1", ["must name its unit: creep_lateral_spin_Nm or"]),
        ("[carbody]\nmass_kg = -1", ["carbody.mass_kg", "must be positive"]),
        ("[wheelset]\nwheel_radius_mm = 0", ["wheelset.wheel_radius_mm", "must be positive"]),
        (
            "[primary]\nstiffness_x_kN_per_m = -5",
            ["primary.stiffness_x_kN_per_m", "must not be negative (-5)"],
        ),
        ("[contact]\nfriction = nan", ["contact.friction", "must be finite"]),
        ("[contact]\nfriction = inf", ["contact.friction", "must be finite"]),
        ("[contact]\nflange_stiffness_MN_per_m = 1e305", ["contact.flange_stiffness_MN_per_m", "too large"]),
        (f"[carbody]\nmass_kg = {'9' * 400}", ["carbody.mass_kg", "must be finite"]),
        ("[carbody]\nmass_kg = '30 t'", ["carbody.mass_kg", "must be a number, not '30 t'"]),
        ("[carbody]\nmass_kg = true", ["carbody.mass_kg", "must be a number, not True"]),
        ("[carbody]\nmass_kg = 1\nmass_t = 1", ["carbody.mass_t", "given twice", "keep one"]),
        ("[geometry]\naxle_pattern = [-1, 1]", ["geometry.axle_pattern", "must fall from front to rear"]),
        ("[geometry]\naxle_pattern = [1, 1]", ["geometry.axle_pattern", "must fall from front to rear"]),
        ("[geometry]\naxle_pattern = []", ["geometry.axle_pattern", "must be a list", "like [1, -1]"]),
        ("[geometry]\naxle_pattern = ['front']", ["geometry.axle_pattern", "must be a number"]),
        ("[geometry]\nhalf_wheelbase_m = 0", ["geometry.axle_pattern", "must be positive"]),
        ("[geometry]\nhalf_secondary_m = 0", ["geometry.half_secondary must be positive"]),
        ("[contact]\nlaw = 'sharpe'", ["contact.law", "sharp, smooth, linear", "not 'sharpe'"]),
        ("[contact]\nlaw = ['sharp']", ["contact.law", "sharp, smooth, linear"]),
        (
            "[contact]\ncreep_longitudinal_N = 0\ncreep_lateral_N = 0",
            ["contact.creep_longitudinal", "law = 'linear'"],
        ),
        ("[provenance]\n'carbody.mass' = {status = 'guessed'}", ['"carbody.mass"', "published, recalled"]),
        ("[provenance]\n'carbody.mass' = 'assumed'", ['"carbody.mass"', "table with status"]),
        ("[provenance]\n'carbody.mas' = {status = 'assumed'}", ['did you mean "carbody.mass"?']),
        (
            "[provenance]\n'carbody.mass' = {status = 'assumed', nota = ''}",
            ["unknown key 'nota'", "did you mean note?"],
        ),
        ("carbody = 30", ["carbody must be a table", "[carbody]"]),
        ("name = 5", ["name must be a string, not 5"]),
        ("gyroscopic = 1", ["gyroscopic must be true or false, not 1"]),
        ("provenance = 1", ["provenance must be a table, not 1"]),
        ("[carbody]\nheld = 'yes'", ["carbody.held", "must be true or false"]),
        ("[bogie]\nheld = true", ["bogie.held", "carbody.held"]),
        ('[carbody]\n"a\\nb" = 1', ["unknown key carbody.a b"]),
        (
            "[contact.hertz]\nrail_radius_m = 0.3",
            ["unknown key 'rail_radius_m'", "did you mean rail_head_radius_m?"],
        ),
        ("[contact.hertz]\npoisson_ratio = 0.3", ["contact.hertz needs rail_head_radius_m"]),
        ("[contact.hertz]\nrail_head_radius_m = -0.3", ["rail_head_radius_m must be positive"]),
        (
            "[contact.hertz]\nrail_head_radius_m = 0.3\npoisson_ratio = 0.6",
            ["poisson_ratio must lie between 0 and 0.5"],
        ),
        (
            "[contact.hertz]\nrail_head_radius_m = 0.3\nwheel_profile_radius_m = -0.2",
            ["wheel_profile_radius_m", "wider"],
        ),
        (
            "[contact.hertz]\nrail_head_radius_m = 1e-200",
            ["[contact.hertz] gives no contact ellipse", "check"],
        ),
        (
            "[contact]\ncreep_lateral_N = 1\n[contact.hertz]\nrail_head_radius_m = 0.3",
            ["creep_lateral", "keep one"],
        ),
        ("[contact]\nhertz = 0.3", ["contact.hertz must be a table"]),
        ("carbody mass = 30", ["not TOML", "line 2"]),
        (f"name = {'[' * 3000}{']' * 3000}", ["not TOML"]),
        (f"name = {'9' * 5000}", ["not TOML"]),
    ],
)
def test_bad_input_is_refused_in_one_line(load, text, pieces):
    refused(lambda: load(text), "mine.toml", *pieces)


def test_missing_keys_are_named(load, tmp_path):
    without = TABLE_1.replace("mass_kg = 30760", "# mass_kg = 30760")
    refused(lambda: load(without, base=None), "missing key carbody.mass_kg", "car body mass")
    refused(lambda: load("", base=None), "missing key carbody.mass_kg")
    refused(lambda: load("[contact.hertz]\nrail_head_radius_m = 0.3", base=None), "also needs contact.wheel_load")


@pytest.mark.parametrize("base", ["nowhere.toml", "a\\u0000.toml", "x" * 300, "", "."])
def test_a_base_that_is_no_file_is_refused(load, base):
    refused(lambda: load("", base=base))


def test_what_is_no_readable_file_is_refused(tmp_path):
    refused(lambda: railjax.load_vehicle(tmp_path / "nowhere.toml"), "nowhere.toml", "no such file")
    refused(lambda: railjax.load_vehicle("coach-tabel1"), "'coach-tabel1'", "did you mean 'coach-table1'?")
    refused(lambda: railjax.load_vehicle("wagon"), "'wagon'", ", ".join(railjax.packaged_vehicles()))
    refused(lambda: railjax.load_vehicle(tmp_path), str(tmp_path), "neither a file nor")
    folder, binary = tmp_path / "folder.toml", tmp_path / "binary.toml"
    folder.mkdir()
    binary.write_bytes(b"name = '\xff\xfe'")
    refused(lambda: railjax.load_vehicle(folder), "folder.toml", "cannot be read as text")
    refused(lambda: railjax.load_vehicle(binary), "binary.toml", "cannot be read as text")


def test_held_bodies_need_no_inertia(load):
    tables = tomllib.loads(TABLE_1)
    tables["carbody"], tables["bogie"] = {"held": True}, {"held": True}
    vehicle = load(toml(tables), base=None)
    assert vehicle.carbody.held
    assert vehicle.bogie.held
    assert "held: carbody, bogie" in str(vehicle)
    assert railjax.modes(vehicle, 50.0).coordinates[0].startswith("wheelset")


def test_provenance_and_note_reach_the_vehicle(coach, literal):
    assert "65 km/h" in coach.note
    assert "letter" in literal.note
    status = {entry.parameter: entry.status for entry in coach.provenance}
    calibrated = (
        "primary.stiffness_x",
        "primary.stiffness_y",
        "contact.friction",
        "contact.flange_clearance",
    )
    assert [status[parameter] for parameter in calibrated] == ["calibrated"] * 4
    assert status["contact.flange_stiffness"] == "assumed"
    for parameter in calibrated:
        assert f"{parameter} (calibrated)" in str(coach)
    assert "calibrated" not in str(literal)
    assert all(entry.note for entry in coach.provenance)


def test_parameters_by_path(coach):
    paths = dict(railjax.parameters())
    assert paths["primary.stiffness_x"].metadata["unit"] == "N/m"
    assert paths["primary.stiffness_x"].metadata["symbol"] == "k_ox"
    assert len(paths) == len(jax.tree.leaves(coach))
    stiffer = railjax.set_parameter(coach, "primary.stiffness_x", 4e6)
    assert railjax.get_parameter(stiffer, "primary.stiffness_x") == 4e6
    assert stiffer == railjax.replace(coach, primary__stiffness_x=4e6)
    assert railjax.set_parameter(stiffer, "primary.stiffness_x", coach.primary.stiffness_x) == coach
    smooth = railjax.replace(coach, contact__law="smooth", gyroscopic=True)
    assert (smooth.contact.law, smooth.gyroscopic) == ("smooth", True)


@pytest.mark.parametrize(
    "call",
    [
        lambda coach: railjax.get_parameter(coach, "primary.stifness_x"),
        lambda coach: railjax.set_parameter(coach, "primary.stifness_x", 1.0),
        lambda coach: railjax.replace(coach, primary__stifness_x=1.0),
        lambda coach: railjax.get_parameter(coach, "primary.stiffness_x.real"),
    ],
)
def test_unknown_path_names_the_nearest(coach, call):
    refused(lambda: call(coach), "no parameter 'primary.stif", "'primary.stiffness_x'")


def test_the_writer_of_mutants_writes_what_it_is_given(load, literal):
    tables = tomllib.loads(TABLE_1)
    assert tomllib.loads(toml(tables)) == tables
    assert load(toml(tables), base=None) == literal
