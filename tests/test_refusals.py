"""Every public function refuses in one `InputError` what is known to be wrong when it is called, and passes tracers.

The functions are found by themselves: a new one needs `guarded` with a rule for each argument, or an entry in OWN_WAY.
"""

import dataclasses
import inspect

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import railjax
from railjax import objectives
from railjax.base.checks import FLAG, Range, Rising, Samples
from railjax.model.damper import check_damper

NAN, INF = float("nan"), float("inf")
SHORT = {"duration": 0.1}

#: what no argument may be but one that has a rule of its own kind
NOTHING = object()
NUMBERS = [
    NAN,
    INF,
    -INF,
    0.0,
    -0.0,
    0,
    -1,
    -1.0,
    1e-300,
    1e300,
    10**400,
    True,
    "1",
    "",
    None,
    [],
    [2.0, 1.0],
    [NAN, 1.0],
    {},
    1j,
    NOTHING,
]

#: arguments that are laws of their own to check, and methods that the integrator calls, with arrays of its own
OF_LAWS = {
    "force",
    "held",
    "extremes",
    "measured",
    "signal",
    "decision",
    "command",
    "gain",
    "delivered",
    "demand",
    "pair_force",
    "fault",
    "describing",
}
OF_LAWS |= {
    "usually",
    "across",
    "decide",
    "reading",
    "converted",
    "slewed",
    "advanced",
    "told",
    "features",
    "estimate",
    "inputs",
    "demanded",
}
OF_LAWS |= {"seen_from", "plot", "codes", "value", "sharp"}

CLASSES = {name: value for name in railjax.__all__ if inspect.isclass(value := getattr(railjax, name))}


def found():
    """Public functions and methods that take an argument, by name."""
    functions = {name: value for name in railjax.__all__ if inspect.isfunction(value := getattr(railjax, name))}
    methods = {
        f"{name}.{key}": getattr(kind, key)
        for name, kind in CLASSES.items()
        for key, value in vars(kind).items()
        if not key.startswith("_") and key not in OF_LAWS and (inspect.isfunction(value) or isinstance(value, classmethod))
    }
    together = functions | methods
    return {
        name: value for name, value in together.items() if [key for key in inspect.signature(value).parameters if key != "self"]
    }


PUBLIC = found()

#: arguments that a function checks itself, with a call for each that it must refuse
OWN_WAY = {
    "ClippedLQR.design.options": None,
    "MeasuredTrack.from_csv": lambda coach: railjax.MeasuredTrack.from_csv("nowhere.csv"),
    "TableSpectrum.from_csv": lambda coach: railjax.TableSpectrum.from_csv("nowhere.csv"),
    "Spectrum.density": None,  # of the protocol
    "acceptance.options": lambda coach: railjax.acceptance_of_record(a_record(), axle_load=1e5, margin=-1.0),
    "alignment.distance": None,
    "calibrate.bounds": lambda coach: railjax.calibrate(
        coach, {"a": ("contact.friction",)}, {"linear_kmh": 200.0}, bounds=(2.0, 1.0)
    ),
    "comfort.place": lambda coach: railjax.comfort(np.zeros(9000), 200.0, place="roof"),
    "Faults.none.sensors": lambda coach: railjax.Faults.none(0, 2),
    "LearnedDamper.of.controller": lambda coach: railjax.LearnedDamper.of(railjax.Skyhook(), coach),
    "LearnedDamper.of.time_constants": None,
    "Sensors.typical.names": lambda coach: railjax.Sensors.typical("nose"),
    "Sensors.ideal.names": lambda coach: railjax.Sensors.ideal("nose"),
    "train.law": lambda coach: railjax.train(coach, railjax.Skyhook(), tracks="erri-low", speeds=[30.0, 40.0]),
    "train.limits": lambda coach: railjax.train(
        coach,
        railjax.LearnedDamper.of(railjax.Controller(railjax.Skyhook(damping=1e5)), coach),
        tracks="erri-low",
        speeds=[30.0, 40.0],
        limits={"travel": 1.0},
    ),
    "pareto.objective": lambda coach: railjax.pareto(coach, BOUNDS, "comfort", AIM),
    "pareto.against": lambda coach: railjax.pareto(coach, BOUNDS, AIM, 3),
    "pareto.constraints": lambda coach: railjax.pareto(coach, BOUNDS, AIM, AIM, [3.0]),
    "tune.objective": lambda coach: railjax.tune(coach, BOUNDS, "comfort"),
    "tune.constraints": lambda coach: railjax.tune(coach, BOUNDS, AIM, [3.0]),
    "tune.optimiser": lambda coach: railjax.tune(coach, BOUNDS, AIM, optimiser="best"),
    "replace.changes": lambda coach: railjax.replace(coach, primary__stiffness=1.0),
    "set_parameter.value": None,  # of any pytree
    "spectrum.source": lambda coach: railjax.spectrum("rough"),
    "state_matrix.flange": None,
    "identify_damper.voltage_law": None,
    "identify_damper.method": None,
    "vehicle_report.track": lambda coach: railjax.vehicle_report(coach, track="rough"),
    "sweep.design": lambda coach: railjax.sweep(railjax.CriticalSpeed(), {"speed": [40.0]}, vehicle=coach, design="fine"),
    "sweep.executor": lambda coach: railjax.sweep(railjax.LeastDamping(), {"speed": [40.0]}, vehicle=coach, executor=3),
    "sweep.in_flight": lambda coach: railjax.sweep(railjax.LeastDamping(), {"speed": [40.0]}, vehicle=coach, in_flight=0),
    "sweep.worker_devices": None,
    "sweep.part": lambda coach: railjax.sweep(railjax.LeastDamping(), {"speed": [40.0]}, vehicle=coach, part=(3, 2)),
    "sweep.progress": None,
    "sweep.samples": lambda coach: railjax.sweep(
        railjax.LeastDamping(), {"speed": (30.0, 40.0)}, vehicle=coach, design="sobol", samples=0
    ),
    "Layout.from_samples": lambda coach: railjax.Layout.from_samples([0.0, 1.0], [0.0, NAN]),
    "Layout.load": lambda coach: railjax.Layout.load("nowhere.csv"),
    "Layout.curve_at": None,  # by the integrator
    "TableSpectrum.checked.wavenumber": lambda coach: railjax.TableSpectrum.checked([2.0, 1.0], [1.0, 1.0]),
    "WheelProfile.load.columns": lambda coach: railjax.WheelProfile.load("nowhere.csv", columns={"lateral": "a"}),
    "WheelProfile.load.unit": None,
    "RailProfile.load.columns": lambda coach: railjax.RailProfile.load("nowhere.csv", columns={"lateral": "a"}),
    "RailProfile.load.unit": None,
    "ContactGeometry.plot.axes": None,
    "ContactTable.at.y": None,  # by the integrator
    "ContactTable.rates.y": None,
    "TableSpectrum.checked.density": lambda coach: railjax.TableSpectrum.checked([1.0, 2.0], [1.0, NAN]),
}
AIM = objectives.linear_critical_speed()
BOUNDS = {"primary.stiffness_x": (1e6, 20e6)}


def a_record():
    return railjax.RunningRecord(40.0, 200.0, guiding_force=np.ones((9000, 4)))


@pytest.fixture(scope="module")
def good(coach):
    """Values that required arguments may have, by their names."""
    damped = railjax.PassiveDamper()
    run = railjax.simulate(coach, 40.0, duration=0.1)
    return {
        "vehicle": coach,
        "damper": damped,
        "run": run,
        "motion": run,
        "out": "film.gif",
        "distance": 1.0,
        "speed": 40.0,
        "speeds": np.array([30.0, 40.0]),
        "low": 30.0,
        "high": 40.0,
        "fit": {"a": ("contact.friction",)},
        "to": {"linear_kmh": 200.0},
        "acceleration": np.ones(4000),
        "sampling_rate": 200.0,
        "load": 5e4,
        "wheel_radius": 0.46,
        "rail_head_radius": 0.3,
        "ratio": 1.0,
        "quantity": AIM,
        "scatter": railjax.Scatter({"contact.conicity": (0.1, 0.2)}),
        "path": "primary.stiffness_x",
        "value": 1e6,
        "record": railjax.Record(*np.ones((4, 1000)), 1e-3),
        "function": len,
        "name_or_path": "coach",
        "parameters": BOUNDS,
        "objective": AIM,
        "against": AIM,
        "source": "erri-high",
        "track": railjax.RandomTrack("erri-low", length=1000.0),
        "study": railjax.CriticalSpeed(),
        "over": {"speed": [40.0]},
        "name": "Wd",
        "frequency": 1.0,
        "axle_load": 1e5,
        "response": None,
        "channel": "carbody_acceleration",
        "time": jnp.array(1.0),
        "wavenumber": 1.0,
        "amplitude": 1.0,
        "index": 0,
        "wheel": "S1002",
        "rail": "60E1",
        "y": np.linspace(-8e-3, 8e-3, 17),
        "delta_r": np.linspace(-2e-3, 2e-3, 17),
        "conicity": 0.1,
        "lateral": np.linspace(-0.05, 0.06, 17),
        "height": np.zeros(17),
        "at": np.array([0.0, 0.01]),
        "by": np.zeros(2),
        "geometry": None,
        "last": 10,
        "stride": 2,
        "tracks": "erri-low",
        "law": None,
        "sensors": railjax.Sensors.typical(),
        "bogies": 2,
        "controller": None,
        "share": 0.5,
    }


def rules_of(name):
    return getattr(PUBLIC[name], "rules", getattr(getattr(PUBLIC[name], "__func__", None), "rules", {}))


@pytest.mark.parametrize("name", PUBLIC)
def test_each_argument_has_a_rule(name):
    for key in inspect.signature(PUBLIC[name]).parameters:
        if key not in ("self", "cls") and rules_of(name).get(key) is None and name not in OWN_WAY:
            assert f"{name}.{key}" in OWN_WAY, (
                f"{name}({key}) needs a rule in railjax.arguments, or a call that it refuses in OWN_WAY"
            )


@pytest.mark.parametrize("case", [name for name, call in OWN_WAY.items() if call is not None])
def test_what_functions_check_themselves(coach, case):
    with pytest.raises(railjax.InputError):
        OWN_WAY[case](coach)


def refused(rule, key, value):
    try:
        rule(key, value)
    except railjax.InputError:
        return True
    return False


CASES = [(name, key) for name in PUBLIC for key, rule in rules_of(name).items() if rule is not None and key != "self"]


@pytest.mark.parametrize(("name", "key"), CASES)
def test_bad_arguments_are_refused(good, name, key):
    """What a rule refuses reaches nobody: the call raises one `InputError` that names the argument. Nothing is compiled, as what the
    rule accepts is not called."""
    function, rule = PUBLIC[name], rules_of(name)[key]
    parameters = inspect.signature(function).parameters
    required = [p for p in parameters.values() if p.default is p.empty and p.kind not in (p.VAR_KEYWORD, p.VAR_POSITIONAL)]
    arguments = {p.name: good.get(p.name) for p in required if p.name not in (key, "self")}
    if "record" in arguments and name.startswith("acceptance"):
        arguments["record"] = a_record()
    owner = [None] if "self" in parameters else []  # refused before it is looked at

    @settings(max_examples=25, deadline=None, database=None)
    @given(st.sampled_from(NUMBERS) | st.floats() | st.integers() | st.text(max_size=3) | st.lists(st.floats(), max_size=3))
    def bad(value):
        if value is parameters[key].default or not refused(rule, key, value):
            return
        with pytest.raises(railjax.InputError) as error:
            function(*owner, **arguments, **{key: value})
        assert "\n" not in str(error.value)

    if not owner:
        bad()
    if isinstance(rule, Range):
        for value in (NAN, "1", NOTHING, [], 1j, [NAN]):
            assert refused(rule, key, value), f"{name}({key}={value}) passes"
    elif isinstance(rule, (Rising, Samples)) or rule is FLAG:
        for value in ("1", NOTHING, []):
            assert refused(rule, key, value), f"{name}({key}={value}) passes"


def test_unknown_and_missing_arguments_are_type_errors(coach):
    for call in (lambda: railjax.simulate(coach, 40.0, durations=1.0), lambda: railjax.simulate(coach)):
        with pytest.raises(TypeError, match=r"durations|speed"):
            call()


def of_kind(method):
    return {name: kind for name, kind in CLASSES.items() if hasattr(kind, method) and dataclasses.is_dataclass(kind)}


def spoiled(part):
    """Copies of a dataclass with one number that is none, or of the wrong sign."""
    for field in dataclasses.fields(part):
        if isinstance(getattr(part, field.name), float):
            for value in (NAN, INF, -1e3, "stiff", [], NOTHING):
                yield field.name, value, dataclasses.replace(part, **{field.name: value})


@pytest.mark.parametrize("vehicle", railjax.packaged_vehicles())
def test_vehicles(vehicle):
    """Every number of every vehicle."""
    vehicle = railjax.load_vehicle(vehicle)
    for part in ("carbody", "bogie", "wheelset", "primary", "secondary", "geometry", "contact", "yaw_damper", "lateral_damper"):
        there = getattr(vehicle, part)
        if there is None or getattr(there, "held", False):
            continue
        signed = {f.name for f in dataclasses.fields(there) if not f.metadata.get("positive")}  # differences step beyond zero
        for key, value, changed in spoiled(there):
            if value == -1e3 and key in signed:
                continue
            with pytest.raises(railjax.InputError, match=f"{part}.{key} must be"):
                railjax.simulate(dataclasses.replace(vehicle, **{part: changed}), 40.0, **SHORT)


MADE = {
    "BumpTrack": (5e-3, 20.0),
    "SinusoidTrack": (5e-3, 20.0),
    "MaxwellDamper": (25e3, 5e6, 0.1, 5e3),
    "ErriSpectrum": (1e-7,),
    "FraSpectrum": (1e-5,),
    "Controller": (railjax.Skyhook(),),
}


@pytest.mark.parametrize("name", [name for name in of_kind("force") if name not in ("Damper", "LearnedDamper")])
def test_dampers(coach, name):
    damper = CLASSES[name](*MADE.get(name, ()))
    for key, _, changed in spoiled(damper):
        with pytest.raises(railjax.InputError, match=f"damper.{key} must"):
            railjax.simulate(coach, 40.0, damper=changed, **SHORT)


@pytest.mark.parametrize("name", [name for name in of_kind("seen_from") if name in MADE])
def test_tracks(coach, name):
    for key, value, changed in spoiled(CLASSES[name](*MADE[name])):
        if value == -1e3 and key in ("amplitude", "start"):
            continue
        with pytest.raises(railjax.InputError, match=f"track.{key} must"):
            railjax.simulate(coach, 40.0, track=changed, **SHORT)


@pytest.mark.parametrize("name", [name for name in of_kind("density") if name in MADE])
def test_spectra(coach, name):
    for key, _, changed in spoiled(CLASSES[name](*MADE[name])):
        with pytest.raises(railjax.InputError, match=f"spectrum.{key} must"):
            railjax.frequency_response(coach, 40.0, changed)


def with_parts(coach, **parts):
    return dataclasses.replace(coach, **parts)


RIDE = np.sin(np.arange(4000) / 7.0)
#: what used to pass with a number, or to end in a traceback
NAMED = {
    "falling times": (
        lambda c: railjax.simulate(c, railjax.SpeedProfile([10.0, 0.0], [70.0, 62.0]), **SHORT),
        "speed.time must be",
    ),
    "a profile that stands": (
        lambda c: railjax.simulate(c, railjax.SpeedProfile([0.0, 9.0], [7.0, 0.0]), **SHORT),
        "speed.speed must be",
    ),
    "half a profile": (lambda c: railjax.simulate(c, railjax.SpeedProfile([0.0, 9.0], [7.0]), **SHORT), "pairs"),
    "band turned round": (
        lambda c: railjax.frequency_response(c, 40.0, shortest=200, longest=2),
        "shortest must be below longest",
    ),
    "negative spectrum": (lambda c: railjax.frequency_response(c, 40.0, lambda w: -1e-7 / (1 + w**2)), "not negative"),
    "amplitude nan": (
        lambda c: railjax.frequency_response(c, 40.0, railjax.RandomTrack().scaled(NAN)),
        "amplitude must be a finite number",
    ),
    "settle -5": (lambda c: railjax.weighted_rms(RIDE, 200.0, settle=-5), "settle must be 0 or positive"),
    "settle beyond": (lambda c: railjax.weighted_rms(RIDE, 200.0, settle=500), "leaves nothing"),
    "exponent -1": (lambda c: railjax.sperling(RIDE, 200.0, exponent=-1.0), "exponent must be positive"),
    "power 0": (lambda c: railjax.sperling(RIDE, 200.0, power=0), "power must be positive"),
    "comfort's exponent": (
        lambda c: railjax.comfort(RIDE, 200.0, mean=False, sperling_exponent=NAN),
        "sperling_exponent must be positive",
    ),
    "falling bump stop": (
        lambda c: railjax.simulate(with_parts(c, bump_stop=railjax.BumpStop(np.array([0.03, 0.02]), np.array([0.0, 1e5]))), 40.0),
        "travel must rise",
    ),
    "negative mass": (lambda c: railjax.linear_critical(railjax.replace(c, carbody__mass=-3e4)), "carbody.mass must be positive"),
    "negative lane": (
        lambda c: railjax.simulate(railjax.replace(c, carbody__mass=np.array([3e4, -3e4])), 40.0, **SHORT),
        "carbody.mass must be positive",
    ),
    "beyond Kalker's table": (lambda c: railjax.kalker_coefficients(20.0), "ratio must be .* 0.1 and 10"),
    "Poisson's ratio 2": (lambda c: railjax.creep_coefficients(5e4, 0.46, 0.3, poisson=2.0), "poisson must be .* 0 and 0.5"),
    "hollow wheel": (lambda c: railjax.creep_coefficients(5e4, 0.46, 0.3, -0.2), "hollow"),
    "skyhook": (
        lambda c: railjax.simulate(c, 40.0, damper=railjax.Skyhook(damping_min=6e4, damping_max=1e4), **SHORT),
        "damping_min .* below damping_max",
    ),
    "no accelerometer": (lambda c: railjax.simulate(c, 40.0, damper=railjax.ADD(None), **SHORT), "needs a sensor_lag"),
    "weight 0": (lambda c: railjax.ClippedLQR.design(c, 40.0, force_weight=0.0), "force_weight must be positive"),
    "design at rest": (lambda c: railjax.ClippedLQR.design(c, 0.0), "speed must be positive"),
    "no feedback": (lambda c: railjax.simulate(c, 40.0, damper=railjax.ClippedLQR(), **SHORT), "has no feedback"),
    "half a valve": (
        lambda c: railjax.linear_critical(with_parts(c, yaw_damper=railjax.YawDamper(1e6, 1.3, 0.01))),
        "also needs yaw_damper.damping_beyond",
    ),
    "half a Maxwell valve": (lambda c: check_damper(railjax.MaxwellDamper(blow_off_velocity=0.1)), "belong together"),
    "steps 0": (lambda c: railjax.nonlinear_critical_speed(c, steps=0), "steps must be a whole number from 1 on"),
    "wavelength -3": (lambda c: railjax.alignment(railjax.SinusoidTrack(5e-3, -3.0), 1.0), "wavelength must be positive"),
    "wavelength 0": (lambda c: railjax.alignment(railjax.SinusoidTrack(5e-3, 0.0), 1.0), "wavelength must be positive"),
    "tolerance -1": (lambda c: railjax.tune(c, BOUNDS, AIM, tolerance=-1), "tolerance must be a number between 0 and 1"),
    "spectrum for a track": (lambda c: railjax.simulate(c, 40.0, track="erri-high", **SHORT), "RandomTrack"),
    "a name for a vehicle": (lambda c: railjax.simulate("coach", 40.0, **SHORT), "load_vehicle"),
    "unknown channel": (lambda c: railjax.frequency_response(c, 40.0, points=16).rms("carbody_psi"), "the response lacks"),
}


@pytest.mark.parametrize("case", NAMED)
def test_named_faults(coach, case):
    call, message = NAMED[case]
    with pytest.raises(railjax.InputError, match=message):
        call(coach)


def test_tracers_pass(coach):
    """Shapes alone, nothing is compiled; a number that would be refused is not known here."""

    def final(vehicle, speed, wavelength, damping):
        track, damper = railjax.SinusoidTrack(1e-3, wavelength), railjax.Skyhook(damping_min=damping)
        return railjax.simulate(vehicle, speed, track=track, damper=damper, duration=0.01).final

    assert jax.eval_shape(final, coach, -1.0, 0.0, 1e9).ndim == 1
    assert jax.eval_shape(lambda ratio: railjax.kalker_coefficients(ratio), 100.0).c11.shape == ()
    assert jax.eval_shape(lambda a: railjax.sperling(a, 200.0), jnp.ones(4000)).shape == ()
    # trees hold gradients, axes and placeholders as well
    axes = jax.tree.map(lambda _: -1, coach)
    assert railjax.replace(axes, carbody__mass=None).carbody.mass is None


def test_lanes_of_nan_are_marked(coach):
    """NaN among lanes is how results say that there is none; alone it is refused."""
    lanes = railjax.simulate(railjax.replace(coach, carbody__mass=np.array([3e4, NAN])), 40.0, **SHORT)
    assert [bool(ok) for ok in lanes.ok] == [True, False]
    assert np.isnan(railjax.linear_critical(railjax.replace(coach, carbody__mass=np.array([3e4, NAN]))).speed[1])


def test_a_single_run_that_diverges_is_returned_and_marked(coach):
    """Its history tells how; only what is wrong with the input raises."""
    run = railjax.simulate(railjax.replace(coach, contact__law="linear"), 140.0, initial={"wheelset_y": 1e-3}, duration=30.0)
    assert run.code == railjax.Result.DIVERGED
    assert not run.ok
    assert "diverged: 1 of 1" in str(run)
    with pytest.raises(railjax.InputError, match="too large for RK4"):
        railjax.simulate(coach, 1.0, dt=1e-2, duration=1.0)
