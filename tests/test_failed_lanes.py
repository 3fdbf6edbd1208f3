"""A lane that fails is marked, NaN, and without effect on the derivatives of what it shares with the others."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import railjax
from railjax.ride.vibration import vibration_dose
from railjax.simulation.simulate import initial_state

LANES = 3  # the last one fails
RUN = {"duration": 0.2, "sample": 0.02, "track": railjax.SinusoidTrack(2e-3, 20.0), "record": ("wheelset_y",)}
#: what a lane has of its own, and one at a time what makes it fail
OWN = {"wheelset.mass": 1250.0, "contact.friction": 0.3, "start": 1e-3}
FAULTS = [
    ("wheelset.mass", np.nan),
    ("contact.friction", np.nan),
    ("wheelset.mass", 1e-9),
    ("start", 1e200),
    ("start", np.nan),
]


def lanes_with(path, bad):
    return {name: jnp.full(LANES, value).at[-1].set(bad if name == path else value) for name, value in OWN.items()}


def total(values, ok):
    """Of the lanes that can be used; the derivative of their root is NaN where they are."""
    return jnp.sum(jnp.where(ok, jnp.sqrt(values), 0.0)), ok


@pytest.fixture(scope="module")
def wheelset():
    """The smallest vehicle: how lanes fail is the same for all, and a derivative of the coach takes ten times as long to compile."""
    return railjax.load_vehicle("single-wheelset")


@pytest.fixture(scope="module")
def slopes(wheelset):
    """By what all lanes share, a stiffness: backwards in one batch and by `vmap`, and forwards."""

    def run(shared, own, initial):
        vehicle = railjax.replace(wheelset, primary__stiffness_x=shared * wheelset.primary.stiffness_x)
        for path in own:
            vehicle = railjax.set_parameter(vehicle, path, own[path])
        found = railjax.simulate(vehicle, 40.0, initial=initial, **RUN)
        return jnp.mean(found["wheelset_y"][:, 0] ** 2, axis=0), found.ok

    def batch(shared, own):
        own = dict(own)
        start = jax.vmap(lambda y: initial_state(wheelset, railjax.PassiveDamper(), {"wheelset_y": y}), out_axes=1)(
            own.pop("start")
        )
        return total(*run(shared, own, start))

    def one(shared, own):
        own = dict(own)
        return run(shared, own, {"wheelset_y": own.pop("start")})

    def mapped(shared, own):
        return total(*jax.vmap(one, (None, 0))(shared, own))

    def forward(shared, own):
        return jax.jvp(lambda shared: mapped(shared, own)[0], (shared,), (1.0,))[1]

    return [jax.jit(jax.grad(batch, has_aux=True)), jax.jit(jax.grad(mapped, has_aux=True))], jax.jit(forward)


@pytest.mark.parametrize(("path", "bad"), FAULTS)
def test_simulate(slopes, path, bad):
    backwards, forwards = slopes
    # a sum over two of three lanes that are alike
    wanted = 2.0 / 3.0 * backwards[0](1.0, lanes_with(None, None))[0]
    for function in backwards:
        slope, ok = function(1.0, lanes_with(path, bad))
        assert list(ok) == [True] * (LANES - 1) + [False]
        np.testing.assert_allclose(slope, wanted, rtol=1e-9)
    np.testing.assert_allclose(forwards(1.0, lanes_with(path, bad)), wanted, rtol=1e-7)


def test_a_lane_that_diverges_on_its_way(wheelset):
    """Without a flange and far above its critical speed."""
    vehicle = railjax.replace(wheelset, contact__law="linear")

    def lanes(shared):
        stiffer = railjax.replace(vehicle, primary__stiffness_x=shared * jnp.full(2, wheelset.primary.stiffness_x))
        run = railjax.simulate(
            stiffer, jnp.array([20.0, 140.0]), initial={"wheelset_y": 1e-3}, duration=30.0, dt=2e-3, record=["wheelset_y"]
        )
        return jnp.sum(jnp.where(run.ok, run["wheelset_y"][:, 0] ** 2, 0.0)), run

    slope, run = jax.jit(jax.grad(lanes, has_aux=True))(1.0)
    assert list(run.code) == [railjax.Result.OK, railjax.Result.DIVERGED]
    assert 0.0 < abs(slope) < np.inf
    assert list(np.isnan(run.final).any(axis=0)) == [False, True]
    assert list(np.isnan(run["wheelset_y"][:, 0, 1])[[0, -1]]) == [False, True], "up to where it diverged"


ON_TRACK = ("wheelset_on_track",)


def responded(response):
    return total(response.rms(*ON_TRACK)[0] ** 2, response.growth < 0.0)


@pytest.mark.parametrize(
    ("function", "transformed"),
    [
        (lambda vehicle: responded(railjax.frequency_response(vehicle, 20.0, points=64, record=ON_TRACK)), jax.jit),
        (lambda vehicle: total((found := railjax.linear_critical(vehicle)).speed, found.code == railjax.Stability.OK), jax.jit),
        (lambda vehicle: total((found := railjax.nonlinear_critical(vehicle)).speed, found.code == railjax.Hunting.OK), None),
    ],
    ids=["frequency_response", "linear_critical", "nonlinear_critical"],
)
def test_other_results(wheelset, function, transformed):
    def of(shared, bad):
        mass = wheelset.wheelset.mass * jnp.array([1.0, bad])
        stiffness = shared * wheelset.primary.stiffness_x
        return function(railjax.replace(wheelset, wheelset__mass=mass, primary__stiffness_x=stiffness))

    slopes = jax.grad(of, has_aux=True)
    slopes = transformed(slopes) if transformed else slopes
    (slope, ok), (both, _) = (slopes(1.0, bad) for bad in (np.nan, 1.0))
    assert list(ok) == [True, False]
    np.testing.assert_allclose(slope, 0.5 * both, rtol=1e-6)


def test_statistical_linearisation():
    """Two lanes without a number, and one that is unstable."""
    bogie = railjax.load_vehicle("cooperrider-bogie")
    paths = ("contact.friction", "wheelset.mass", "secondary.stiffness_y")
    own = np.tile([railjax.get_parameter(bogie, path) for path in paths], (len(paths) + 1, 1))
    own[[1, 2, 3], [0, 1, 2]] = np.nan, np.nan, -1e7

    def one(shared, own):
        vehicle = railjax.replace(bogie, primary__stiffness_x=shared * bogie.primary.stiffness_x)
        for path, value in zip(paths, own, strict=True):
            vehicle = railjax.set_parameter(vehicle, path, value)
        found = railjax.statistical_linearisation(vehicle, 30.0, "erri-low", points=64, record=ON_TRACK)
        return found.response.rms(*ON_TRACK)[0], found.change

    def all_lanes(shared, own):
        values, change = jax.vmap(one, (None, 0))(shared, own)
        return total(values**2, change < 1e-4)

    slopes = jax.jit(jax.grad(all_lanes, has_aux=True))
    slope, ok = slopes(1.0, own)
    assert list(ok) == [True, False, False, False]
    np.testing.assert_allclose(slope, slopes(1.0, np.tile(own[0], (len(own), 1)))[0] / len(own), rtol=1e-6)


@pytest.mark.parametrize(
    "measure",
    [
        lambda a: railjax.weighted_rms(a, 200.0),
        lambda a: railjax.sperling(a, 200.0),
        lambda a: vibration_dose(a, 200.0),
    ],
    ids=["weighted_rms", "sperling", "dose"],
)
def test_measures_of_vibration(measure):
    """A lane that is no number has no ride, least of all the best there is, and the scale of all keeps its derivative."""
    rides = np.random.default_rng(0).standard_normal((3000, 2))
    rides[7, 1] = np.nan
    values = measure(rides)
    assert 0.0 < values[0] < np.inf
    assert np.isnan(values[1])

    def scaled(lane, scale):
        # the scale acts on numbers only
        return measure(jnp.where(np.isnan(rides), jnp.nan, scale * np.nan_to_num(rides))[:, lane])

    both_slopes = jax.grad(lambda scale: total(both := scaled(slice(None), scale), jnp.isfinite(both))[0])
    slope, wanted = jax.jit(lambda scale: (both_slopes(scale), jax.grad(lambda scale: jnp.sqrt(scaled(0, scale)))(scale)))(1.0)
    np.testing.assert_allclose(slope, wanted, rtol=1e-9)
