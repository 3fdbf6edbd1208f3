"""Parameters declare unit, sign and choices once: every reader of them decides alike, and what is known by name is in one table a room."""

import dataclasses
import functools
import math
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import railjax
from railjax.base.fields import LAWS, check_numbers, given_fields, given_value, is_number, keys_by_unit
from railjax.cli.inputs import make_track as track_of_option
from railjax.dampers.named import DAMPERS, DESIGNED, MAKERS, make_damper
from railjax.model.damper import EquivalentDamper, Law, answers, check_damper, with_law
from railjax.model.parameters import parameters
from railjax.model.track.named import TRACKS, make_track
from railjax.model.vehicle import PARTS
from railjax.sweeps.names import check_range, unit_of
from railjax.tuning.design_space import DesignSpace
from railjax.tuning.named import OBJECTIVES, make_objective

COACH = railjax.load_vehicle("coach")
NUMBERS = {path: entry for path, entry in parameters(COACH) if not entry.metadata.get("axes")}


@functools.cache
def law_by_name(name):
    """Made when it is asked for: every worker reads this file, and the regulator's design takes seconds."""
    return make_damper(name, COACH, 60.0)


def refuses(call) -> bool:
    try:
        call()
    except railjax.InputError:
        return True
    return False


@pytest.mark.parametrize("path", NUMBERS)
def test_files_sweeps_and_tuning_agree_on_the_sign(path):
    entry, passive = NUMBERS[path], railjax.PassiveDamper()
    space = railjax.set_parameter(COACH, path, 1.0)
    for value in (-1.0, 0.0, 1.0):
        found = {
            refuses(lambda value=value: given_value(value, 1.0, entry, path)),
            refuses(lambda value=value: check_range({"vehicle": COACH}, path, value, value)),
            refuses(lambda value=value: DesignSpace.of(space, passive, {path: (value, 2.0)})),
        }
        assert found == {(value < 0.0 and not entry.metadata["signed"]) or (value == 0.0 and entry.metadata["positive"])}
    # a call lets differences step beyond zero, but not where zero itself is none
    changed = railjax.set_parameter(COACH, path, -1.0)
    assert (
        refuses(lambda: check_numbers(getattr(changed, path.split(".")[0]), "part", scattered=True)) == entry.metadata["positive"]
    )


def test_a_negative_conicity_loads_and_is_tuned(tmp_path):
    file = tmp_path / "hollow.toml"
    file.write_text('base = "coach"\n[contact]\nconicity = -0.05\n')
    hollow = railjax.load_vehicle(file)
    space = DesignSpace.of(hollow, railjax.PassiveDamper(), {"contact.conicity": (-0.1, 0.1)})
    np.testing.assert_allclose(space.own, [-0.05])
    np.testing.assert_allclose(space.position([-0.05]), [0.25])


@pytest.mark.parametrize("name", DAMPERS)
def test_every_number_of_a_law_is_declared_and_checked(name):
    damper = law_by_name(name)
    assert isinstance(damper, Law)
    check_damper(damper)
    for entry in dataclasses.fields(damper):
        value, static = getattr(damper, entry.name), entry.metadata.get("static")
        assert static or is_number(entry) or dataclasses.is_dataclass(value), entry.name
        if not is_number(entry):
            continue
        assert (
            unit_of({"damper": damper}, f"damper.{entry.name}") == entry.metadata["unit"]
            if not entry.metadata.get("axes")
            else True
        )
        assert entry.metadata["meaning"]
        for wrong in (math.nan, -1.0, 0.0):
            expected = (
                math.isnan(wrong)
                or (wrong == -1.0 and not entry.metadata["signed"])
                or (wrong == 0.0 and entry.metadata["positive"])
            )
            if not entry.metadata.get("axes") and expected:
                with pytest.raises(
                    railjax.InputError, match=rf"damper.{entry.name} must .*{entry.metadata['meaning'].split(';')[0]}"
                ):
                    check_damper(dataclasses.replace(damper, **{entry.name: wrong}))


def test_numbers_within_a_law_are_checked_by_their_own_fields():
    thin = dataclasses.replace(railjax.HybridDamper().hydraulic, piston_diameter=-0.05)
    with pytest.raises(railjax.InputError, match=r"damper.hydraulic.piston_diameter must be positive \(m\)"):
        check_damper(railjax.HybridDamper(hydraulic=thin))
    # what an identification may find is no fault
    check_damper(railjax.BoucWenDamper(parameters=railjax.BoucWen(x0=-0.01, c0b=-3.0)))


@pytest.mark.parametrize("name", TRACKS)
def test_every_number_of_a_track_is_declared(name):
    kind = TRACKS[name].found()
    declared = [entry for entry in dataclasses.fields(kind) if is_number(entry)]
    assert len(declared) == sum(not entry.metadata.get("static") for entry in dataclasses.fields(kind))
    made = make_track(
        name, {key: 2000.0 for key, (entry, factor) in keys_by_unit(kind).items() if is_number(entry) and factor == 1.0}
    )
    assert made.seen_from(jnp.zeros(2))(jnp.asarray(3.0)).shape == (2,)


def test_tracks_by_name_are_those_by_class():
    assert make_track("bump", {"amplitude_mm": 5, "length_m": 10}) == railjax.BumpTrack(5e-3, 10.0)
    assert track_of_option("sinusoid:amplitude_mm=5,wavelength_m=20", None)[0] == railjax.SinusoidTrack(5e-3, 20.0)
    random, _ = track_of_option("random:spectrum=fra-5,seed=3,length_m=1000", None)
    np.testing.assert_array_equal(random.coefficients, railjax.RandomTrack("fra-5", seed=3, length=1000.0).coefficients)


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("bump:amplitude_mm=5", "missing key track.length_m"),
        ("bump:amplitude_mm=5,length=10", "unknown key track.length; did you mean track.length_m"),
        ("bump:5", "key=value"),
        ("bump:amplitude_mm=5,amplitude_m=5,length_m=1", "given twice"),
        ("bump:amplitude_mm=high,length_m=1", "must be a number"),
        ("random:seed=x", "track.seed must be a whole number"),
        ("bumb:amplitude_mm=5", "no spectrum"),
    ],
)
def test_bad_tracks_of_an_option_are_refused_in_one_line(option, message):
    with pytest.raises(railjax.InputError, match=message) as error:
        track_of_option(option, None)
    assert len(str(error.value).splitlines()) == 1


def test_tables_of_names_lead_to_what_they_say():
    assert {name for name, maker in MAKERS.items() if "speed" in maker.takes} == set(DESIGNED) == {"clipped-lqr"}
    with pytest.raises(railjax.InputError, match="designed at a speed"):
        make_damper("clipped-lqr", COACH, None)
    for name in OBJECTIVES:
        found = make_objective(name, [40.0, 50.0], "erri-low")
        unit = name.rpartition("-")[2]
        assert found.unit == unit if unit in ("mm", "kN") else found.unit not in ("mm", "kN")
        if "speed" in OBJECTIVES[name].takes:
            assert float(found.speed) == 50.0
    with pytest.raises(railjax.InputError, match="did you mean comfort"):
        make_objective("comfrt", [40.0], "erri-low")


def test_units_in_the_keys_of_a_law():
    law = railjax.BoucWenDamper()
    assert given_fields(law, {"voltage_gain_V_per_m": 50, "sample_time_ms": 2, "law": "smooth"}, "damper") == {
        "voltage_gain": 50.0,
        "sample_time": 2e-3,
        "law": "smooth",
    }
    for table, message in (
        ({"parameters": 3.0}, "unknown key"),
        ({"law": "soft"}, "one of sharp, smooth"),
        ({"voltage": 1.0}, "voltage_V"),
    ):
        with pytest.raises(railjax.InputError, match=message):
            given_fields(law, table, "damper")


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Foreign:
    """A law of somebody's whose fields are called like answers of `Law`, which it does not inherit."""

    linear: Any = 5e3  # N s/m
    memoryless: Any = 0.0
    weights: Any = dataclasses.field(default_factory=lambda: -np.ones((3, 3)))
    law: Any = 1.0

    internal_states = 1

    def force(self, vehicle, travel, velocity, internal):
        return self.linear * velocity, -internal


def test_answers_of_a_law_that_inherits_nothing():
    damper = Foreign()
    check_damper(damper)
    found = answers(damper)
    answered = (found.internal_states, found.observes, found.decides, found.memoryless, found.linear)
    assert answered == (1, False, False, False, True)
    assert (found.even_states, found.extremes(COACH), found.fault(), found.describing(COACH, 1.0)) == ((), (), None, None)
    assert with_law(damper, "smooth") is damper
    with pytest.raises(railjax.InputError, match=r"damper.linear must not be negative"):
        check_damper(Foreign(linear=-1.0))
    with pytest.raises(railjax.InputError, match=r"damper.weights must be finite"):
        check_damper(Foreign(weights=np.full((3, 3), np.nan)))


@pytest.mark.parametrize("name", DAMPERS)
def test_what_the_package_s_laws_answer(name):
    """Against what they are: controllers decide, and change what they hold; laws with two versions change between them and back."""
    damper = law_by_name(name)
    assert damper.decides == (name.partition("-")[0] != "passive")
    assert damper.linear == (not damper.decides)
    assert damper.memoryless == (name in ("passive", "passive-soft", "passive-hard", "balance-logic"))
    if damper.law is not None:
        assert damper.law in LAWS
        assert name == "clipped-lqr" or with_law(with_law(damper, "smooth"), "sharp") == damper
        assert with_law(damper, "smooth").law == "smooth"


def test_describing_function_of_balance_logic_is_its_first_harmonic():
    """Against the projection of the law's own force on a sine, per bogie."""
    damper, omega, size = railjax.BalanceLogic(0.7, damping_min=4e3), 9.0, 8e-3
    found = damper.describing(COACH, omega)
    phase = np.linspace(0.0, 2.0 * np.pi, 200_001)[:-1] + 1e-6
    travel, velocity = size * np.sin(phase), size * omega * np.cos(phase)
    stiff = 133e3  # k_cy of Table 1
    force = np.where(travel * velocity < 0.0, -2.0 * 0.7 * stiff * np.abs(travel) * -np.sign(velocity), 2.0 * 4e3 * velocity)
    np.testing.assert_allclose(found.stiffness, 2.0 * np.mean(force * np.sin(phase)) / size, rtol=1e-4)
    np.testing.assert_allclose(found.damping, 2.0 * np.mean(force * np.cos(phase)) / (size * omega), rtol=1e-4)
    check_damper(EquivalentDamper(float(found.stiffness), float(found.damping)))
    assert railjax.BalanceLogic(sensor_lag=1e-3).describing(COACH, omega) is None
    assert railjax.BalanceLogic(force_limit=1e3).describing(COACH, omega) is None
    assert railjax.Skyhook().describing(COACH, omega) is None


def test_parts_of_a_vehicle_say_what_they_may_lack():
    for part, kind in PARTS.items():
        for entry in dataclasses.fields(kind):
            assert (entry.default is None) == bool(entry.metadata.get("optional")), f"{part}.{entry.name}"
    for changed in ({"carbody__mass": None}, {"contact__conicity": True}, {"contact__conicity": "steep"}):
        with pytest.raises(railjax.InputError, match="must be a number"):
            railjax.state_matrix(railjax.replace(COACH, **changed), 40.0)
    soft = dataclasses.replace(COACH.contact)
    object.__setattr__(soft, "law", "soft")  # as without the run-time checks of these tests
    with pytest.raises(railjax.InputError, match=r"contact.law must be one of sharp, smooth, linear"):
        railjax.state_matrix(dataclasses.replace(COACH, contact=soft), 40.0)
