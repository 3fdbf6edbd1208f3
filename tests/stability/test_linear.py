"""Linear critical speed, modes, root locus: numbers, derivatives, batches, codes."""

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize

import railjax
import railjax.base.batches
import railjax.model.parameters
import railjax.stability.eigen_crossing
from railjax.stability.along_speed import along_speed
from railjax.stability.eigen_crossing import Pencil, lowest_crossing
from railjax.stability.linear_critical import HIGHEST, LOWEST

SUSPENSION = [path for path, _ in railjax.parameters() if path.startswith(("primary.", "secondary."))]


def test_critical_speed_of_the_coach_and_of_table_1(coach, literal):
    assert float(railjax.linear_critical_speed(coach)) * 3.6 == pytest.approx(245.6, abs=0.1)
    assert float(railjax.linear_critical_speed(literal)) * 3.6 == pytest.approx(65.2, abs=0.1)


def test_critical_speed_is_where_numpy_s_eigenvalues_cross(coach):
    import reference

    def growth(speed):
        columns = [reference.rate(np.eye(34)[i], np.zeros(4), speed, "linear") for i in range(34)]
        return np.linalg.eigvals(np.array(columns).T).real.max()

    crossing = scipy.optimize.brentq(growth, 60.0, 75.0, xtol=1e-11)
    assert float(railjax.linear_critical_speed(coach)) == pytest.approx(crossing, rel=1e-9)


@functools.cache
def gradients():
    coach = railjax.load_vehicle("coach")
    reverse = jax.grad(railjax.linear_critical_speed)(coach)
    paths = [path for path, _ in railjax.parameters()]

    def of_all(values):
        vehicle = coach
        for path, value in zip(paths, values, strict=True):
            vehicle = railjax.set_parameter(vehicle, path, value)
        return railjax.linear_critical_speed(vehicle)

    values = [float(railjax.get_parameter(coach, path)) for path in paths]
    forward = jax.jacfwd(of_all)(values)
    return {path: (float(railjax.get_parameter(reverse, path)), float(f)) for path, f in zip(paths, forward, strict=True)}


def scattered(name, span, lanes, seed=0):
    """Variants with every parameter of a vehicle multiplied by up to exp(span) either way."""
    base = vehicle = railjax.load_vehicle(name)
    rng = np.random.default_rng(seed)
    for path, _ in railjax.parameters(base):
        value = float(railjax.get_parameter(base, path))
        vehicle = railjax.set_parameter(vehicle, path, jnp.asarray(value * np.exp(rng.uniform(-span, span, lanes))))
    return vehicle


#: lanes of `coaches` that are scattered, and conicities of the last
SCATTERED, CONICITY = 100, np.array([0.14, 1e-4, 0.3, 0.05])


def steps():
    """Steps of the differences, (paths, 5). A step must be small against the curvature and large against the eigenvalues' noise; where
    the balance lies differs from parameter to parameter, so several are tried. Those of size zero in the coach get usual sizes."""
    coach = railjax.load_vehicle("coach")
    values = np.array([[float(railjax.get_parameter(coach, path))] for path in SUSPENSION])
    return np.where(values != 0.0, values * [1e-4, 1e-3, 1e-2, 5e-2, 0.1], [50.0, 500.0, 5e3, 2e4, 1e5])


@functools.cache
def coaches():
    """One batch for many tests, compiled once: scattered variants, those of the central differences, and of several conicities."""
    coach, vehicle = railjax.load_vehicle("coach"), scattered("coach", np.log(1.5), SCATTERED)
    for path, _ in railjax.parameters(coach):
        moved = np.zeros((len(SUSPENSION), 5, 4))
        if path in SUSPENSION:
            row = SUSPENSION.index(path)
            moved[row] = np.outer(steps()[row], [1.0, -1.0, 2.0, -2.0])
        value = float(railjax.get_parameter(coach, path))
        others = CONICITY if path == "contact.conicity" else np.full(len(CONICITY), value)
        lanes = np.concatenate([railjax.get_parameter(vehicle, path), value + moved.ravel(), others])
        vehicle = railjax.set_parameter(vehicle, path, jnp.asarray(lanes))
    return vehicle, jax.tree.map(np.asarray, railjax.linear_critical(vehicle))


@functools.cache
def differences():
    """Derivatives by central differences with Richardson's extrapolation, for several steps."""
    near = coaches()[1].speed[SCATTERED : -len(CONICITY)].reshape(len(SUSPENSION), 5, 4)
    once, twice = (near[:, :, 0] - near[:, :, 1]) / (2 * steps()), (near[:, :, 2] - near[:, :, 3]) / (4 * steps())
    return dict(zip(SUSPENSION, (4 * once - twice) / 3, strict=True))


@pytest.mark.parametrize("path", SUSPENSION)
def test_gradient_against_central_differences(path):
    """Every suspension parameter, those that are zero in the coach too; both modes."""
    reverse, forward = gradients()[path]
    # NaN where a large negative damper makes the coach unstable at any speed
    assert np.nanmin(np.abs(reverse - differences()[path])) < 1e-6 * abs(reverse)
    assert forward == pytest.approx(reverse, rel=1e-9)


def test_gradient_by_left_and_right_eigenvectors(coach):
    """dv/dp = -Re(w^H dE/dp r / w^H r) / Re(w^H dE/dv r / w^H r), written out with SciPy's vectors."""
    import scipy.linalg

    speed = float(railjax.linear_critical_speed(coach))
    values, left, right = scipy.linalg.eig(np.asarray(railjax.state_matrix(coach, speed)), left=True, right=True)
    k = values.real.argmax()
    w, r = left[:, k], right[:, k]

    def rate(tangent):
        return (w.conj() @ np.asarray(tangent) @ r / (w.conj() @ r)).real

    by_speed = rate(jax.jvp(lambda v: railjax.state_matrix(coach, v), (speed,), (1.0,))[1])
    for path in ("primary.stiffness_x", "contact.conicity", "bogie.yaw_inertia"):
        value = float(railjax.get_parameter(coach, path))
        by_value = rate(
            jax.jvp(
                lambda p, path=path: railjax.state_matrix(railjax.set_parameter(coach, path, p), speed),
                (value,),
                (1.0,),
            )[1]
        )
        assert gradients()[path][0] == pytest.approx(-by_value / by_speed, rel=1e-8)


def test_a_second_derivative_is_refused_not_wrong(coach):
    speed = lambda k: railjax.linear_critical_speed(railjax.replace(coach, primary__stiffness_x=k))  # noqa: E731
    with pytest.raises(NotImplementedError):
        jax.grad(jax.grad(speed))(3e6)


def test_batch_equals_single_and_marks_failures(coach):
    found = railjax.stability.linear_critical.LinearCritical(*(values[-len(CONICITY) :] for values in coaches()[1]))
    assert [railjax.Stability(int(code)).name for code in found.code] == ["OK", "STABLE", "OK", "OK"]
    assert float(found.speed[1]) == np.inf
    assert np.isnan(float(found.frequency[1]))
    for k in (0, 2, 3):
        alone = railjax.linear_critical_speed(railjax.replace(coach, contact__conicity=float(CONICITY[k])))
        assert float(found.speed[k]) == pytest.approx(float(alone), rel=1e-10)


def growths(vehicle, damper, speeds):
    """Largest real part by NumPy, of every lane at its own speeds: (k, lanes) -> (k, lanes)."""
    axes = railjax.base.batches.own_axes(vehicle)
    moved = jax.tree.map(lambda leaf, own: -1 if jnp.ndim(leaf) > own else None, vehicle, axes)
    matrices = jax.vmap(lambda one, speed: railjax.state_matrix(one, speed, damper), in_axes=(moved, 0))
    at = jax.jit(matrices, compiler_options={"xla_backend_optimization_level": 0})
    return np.array([np.linalg.eigvals(np.asarray(at(vehicle, jnp.asarray(row)))).real.max(axis=-1) for row in speeds])


@pytest.mark.parametrize(
    ("name", "span", "lanes", "damper"),
    [
        ("coach", np.log(1.5), SCATTERED, railjax.PassiveDamper()),
        ("coach", np.log(10.0), 100, railjax.MaxwellDamper()),
        ("crh380a", np.log(10.0), 64, railjax.PassiveDamper()),
        ("single-wheelset", np.log(10.0), 64, railjax.PassiveDamper()),
    ],
    ids=["coach", "wild coach with Maxwell dampers", "wild crh380a", "wild wheelset"],
)
def test_first_crossing_of_scattered_variants_against_all_eigenvalues(name, span, lanes, damper):
    """Stable at every speed of the grid below, on the axis there, unstable just above: by NumPy's eigenvalues."""
    vehicle = railjax.model.parameters.without_labels(scattered(name, span, lanes))
    if lanes == SCATTERED and damper == railjax.PassiveDamper():
        found = railjax.stability.linear_critical.LinearCritical(*(values[:SCATTERED] for values in coaches()[1]))
    else:
        found = jax.tree.map(np.asarray, railjax.linear_critical(vehicle, damper=damper))
    grid = np.linspace(LOWEST, HIGHEST, 60)
    growth = growths(vehicle, damper, np.broadcast_to(grid[:, None], (60, lanes)))
    # what double precision leaves open: the round-off of eigenvalues
    zero = 1e-5
    for k, code in enumerate(found.code):
        if code == railjax.Stability.OK:
            assert np.all(growth[grid < found.speed[k], k] < zero)
        elif code == railjax.Stability.STABLE:
            assert np.all(growth[:, k] < zero)
        else:
            assert code == railjax.Stability.UNSTABLE
            assert growth[0, k] > -zero
    ok = found.code == railjax.Stability.OK
    assert ok.sum() > lanes / 3
    speed = np.where(ok, found.speed, 50.0)
    near = growths(vehicle, damper, speed * np.array([[1.0 - 1e-3], [1.0], [1.0 + 1e-3]]))[:, ok]
    assert np.all(np.abs(near[1]) < zero)
    moves = 1e-3 * (speed * found.growth_per_speed)[ok]
    clear = moves > 1e-4  # others rise so slowly that round-off or curvature hides it
    assert np.all((near[0] < 0.0)[clear])
    assert np.all((near[2] > 0.0)[clear])
    assert clear.mean() > 0.6


def test_the_host_s_way_is_the_compiled_one_s(coach):
    """One vehicle, of numbers known or traced: the same codes, the same numbers."""
    many = railjax.model.parameters.without_labels(scattered("coach", np.log(5.0), 40, seed=1))
    traced = jax.jit(railjax.linear_critical)
    broken = railjax.replace(railjax.model.parameters.without_labels(coach), carbody__mass=1e-320)
    codes = set()
    for vehicle in (
        *(jax.tree.map(lambda leaf, k=k: np.asarray(leaf)[k], many) for k in range(40)),
        jax.tree.map(np.float64, broken),
    ):
        host, compiled = (jax.tree.map(float, find(vehicle)) for find in (railjax.linear_critical, traced))
        assert host.code == compiled.code
        codes.add(int(host.code))
        # what rises slowly is known no better than the eigenvalues' round-off lets it
        slow = 1e-11 / host.growth_per_speed if host.code == railjax.Stability.OK else 0.0
        np.testing.assert_allclose(host[:2], compiled[:2], rtol=1e-9, atol=slow)
        np.testing.assert_allclose(host.growth_per_speed, compiled.growth_per_speed, rtol=1e-5)
    assert codes == set(railjax.Stability) - {railjax.Stability.UNPROVED}


def with_maxwell(stiffness, conicity):
    """Speed and frequency, with a damper that has internal states."""
    vehicle = railjax.replace(railjax.load_vehicle("coach"), primary__stiffness_x=stiffness, contact__conicity=conicity)
    found = railjax.linear_critical(vehicle, damper=railjax.MaxwellDamper())
    return found.speed, found.frequency


#: two coaches, and one that nothing makes hunt
STIFFNESS, OF_CONE = np.array([2.5e6, 4e6, 3e6]), np.array([0.14, 0.14, 1e-4])


#: of a coach with weak damping: unstable from 6.095 m/s on for 0.4 m/s only, and again from 17.7 m/s on
NARROW = {
    "secondary__damping_z": 1261.5609,
    "contact__conicity": 0.136,
    "secondary__stiffness_x": 385195.8269,
    "secondary__stiffness_y": 1267141.8925,
    "primary__stiffness_x": 621792.1528,
    "primary__stiffness_y": 25455695.2358,
    "secondary__damping_y": 286.3324,
}


def test_a_narrow_window_of_instability_is_not_stepped_over(coach):
    """By NumPy's eigenvalues every 0.01 m/s; alone, in a batch and compiled alike."""
    weak = railjax.replace(coach, **NARROW)
    speeds = np.arange(5.8, 7.0, 0.01)
    growth = growths(railjax.model.parameters.without_labels(weak), railjax.PassiveDamper(), speeds[:, None])[:, 0]
    first = speeds[np.argmax(growth > 0.0)]
    assert growth[0] < 0.0
    assert growth[-1] < 0.0
    batch = jax.tree.map(lambda x: jnp.full(3, x), railjax.model.parameters.without_labels(weak))
    batch = railjax.replace(batch, contact__conicity=jnp.array([0.13, 0.136, 0.14]))
    for found in (railjax.linear_critical(weak), jax.tree.map(lambda x: x[1], railjax.linear_critical(batch))):
        assert found.code == railjax.Stability.OK
        assert first - 0.01 <= float(found.speed) <= first
        assert float(found.speed) == pytest.approx(6.0952081, rel=1e-6)


@pytest.mark.parametrize("name", ["coach", "crh380a", "single-wheelset"])
def test_lowest_means_lowest_for_random_vehicles(name):
    """Against the eigenvalues every 0.1 m/s, of vehicles that are weakly damped as well."""
    rng, variants = np.random.default_rng(3), []
    vehicle = railjax.load_vehicle(name)
    paths = [
        path
        for path, _ in railjax.parameters(vehicle)
        if path.split(".")[1].startswith(("stiffness", "damping", "conicity", "mass", "inertia"))
        and isinstance(railjax.get_parameter(vehicle, path), float)
    ]
    for _ in range(12):
        one = vehicle
        for path in paths:
            factor = np.exp(0.6 * rng.normal()) * (rng.choice([1.0, 0.3, 0.1]) if "damping" in path else 1.0)
            one = railjax.set_parameter(one, path, factor * railjax.get_parameter(vehicle, path))
        variants.append(one)
    trees = [railjax.model.parameters.without_labels(one) for one in variants]
    batch = jax.tree.map(lambda *leaves: np.stack(leaves, axis=-1), *trees)
    together = railjax.linear_critical(batch)
    grid = np.arange(LOWEST, HIGHEST, 0.1)
    for k, one in enumerate(trees):
        growth = np.linalg.eigvals(along_speed(one, railjax.PassiveDamper())(grid)[0]).real.max(axis=-1)
        found = railjax.linear_critical(one)
        assert found.code == together.code[k]
        assert found.code in (railjax.Stability.OK, railjax.Stability.STABLE, railjax.Stability.UNSTABLE)
        lowest = LOWEST if found.code == railjax.Stability.UNSTABLE else float(found.speed)
        first = grid[np.argmax(growth > 1e-9)] if (growth > 1e-9).any() else np.inf
        assert first == lowest or first - 0.1 <= lowest <= first
        np.testing.assert_allclose(found.speed, together.speed[k], rtol=1e-9)


def test_wheels_that_turn_freely_are_neutral_not_unstable(coach):
    """Without longitudinal creep nothing centres the vehicle: a defective pair of zeros, rounded to 3e-6 1/s, at all speeds."""
    free = railjax.replace(coach, contact__creep_longitudinal=0.0)
    values = np.linalg.eigvals(np.asarray(railjax.state_matrix(free, 50.0)))
    assert np.sum(np.abs(values) < 1e-4) == 2
    found = railjax.linear_critical(free)
    assert found.code == railjax.Stability.OK
    assert float(found.speed) == pytest.approx(
        135.977, rel=1e-5
    )  # of a wheelset's yaw at 12.9 Hz; by bisection on NumPy's eigenvalues


def test_divergence_without_frequency_is_a_crossing_too():
    """Two uncoupled real eigenvalues, 0.1 - 2/v and -1: the first is zero at 20 m/s."""
    given = Pencil(np.diag([0.1, -1.0])[None], np.diag([-2.0, 0.0])[None], None)
    crossing, outcome = lowest_crossing(given, 3.0, 150.0)
    assert outcome.crossed[0]
    assert outcome.proved[0]
    assert crossing.speed[0] == pytest.approx(20.0, rel=1e-12)
    assert crossing.omega[0] == 0.0
    assert crossing.by_speed[0] == pytest.approx(2.0 / 20.0**2)


def test_what_cannot_be_proved_is_said(coach, monkeypatch):
    """Where the proof fails for a while, however short the interval, the search goes on and says so."""
    proof, calls = railjax.stability.eigen_crossing._proved, itertools.count()

    def fails_for_a_while(*arguments):
        holds, used = proof(*arguments)
        return holds & (not 5 < next(calls) < 45), used

    monkeypatch.setattr(railjax.stability.eigen_crossing, "_proved", fails_for_a_while)
    with pytest.warns(RuntimeWarning, match="could not be proved"):
        speed = railjax.linear_critical_speed(coach)
    assert float(speed) == pytest.approx(68.222224, rel=1e-7)
    monkeypatch.undo()
    assert railjax.linear_critical(coach).code == railjax.Stability.OK


def test_batch_vmap_and_single_give_the_same_derivatives():
    """Speed and frequency, both modes; the lane without a critical speed spoils nothing."""
    values = jnp.asarray(STIFFNESS)

    def of(value):
        return with_maxwell(value, OF_CONE)

    _, linear = jax.linearize(of, values)
    forward = linear(jnp.ones(3))
    transposed = jax.linear_transpose(linear, values)
    alone = [jax.jacfwd(with_maxwell)(*one) for one in zip(STIFFNESS, OF_CONE, strict=True)]
    mapped = jax.vmap(jax.jacfwd(with_maxwell))(values, OF_CONE)  # one vehicle's function, mapped by the user
    step = 1e-4 * values
    more, less = of(values + step), of(values - step)
    for k, name in enumerate(("speed", "frequency")):
        (reverse,) = transposed(tuple(jnp.full(3, float(k == other)) for other in range(2)))
        expected = np.array([one[k] for one in alone])
        assert expected[2] == 0.0
        for found in (forward[k], reverse, mapped[k]):
            np.testing.assert_allclose(found, expected, rtol=1e-7, err_msg=name)
        slope = (more[k] - less[k])[:2] / (2 * step[:2])
        np.testing.assert_allclose(slope, expected[:2], rtol=1e-5, err_msg=name)
    with pytest.raises(NotImplementedError):
        jax.hessian(lambda value: jnp.sum(of(value)[0]))(values)


def test_no_critical_speed_is_said(coach):
    with pytest.raises(railjax.NumericalError, match="stable up to 540 km/h"):
        railjax.linear_critical_speed(railjax.replace(coach, contact__conicity=1e-4))
    soft = railjax.replace(coach, primary__stiffness_x=1e3, primary__stiffness_y=1e4, contact__conicity=0.4)
    with pytest.raises(railjax.NumericalError, match="unstable at"):
        railjax.linear_critical_speed(soft, lowest=20.0)


def test_gyroscopic_and_gravitational_terms_move_it_a_little(coach):
    base = float(railjax.linear_critical_speed(coach))
    for option in ("gyroscopic", "gravitational"):
        moved = float(railjax.linear_critical_speed(railjax.replace(coach, **{option: True})))
        assert 1e-4 < abs(moved - base) / base < 0.1


def test_modes_of_the_coach(coach):
    found = railjax.modes(coach, 245.6 / 3.6)
    names = dict(zip(found.names, found.frequency, strict=True))
    assert found.names[0] == "bogie hunting, bogies in phase"
    assert names["bogie hunting, bogies in phase"] == pytest.approx(6.03, abs=0.01)
    assert names["car body lower sway"] == pytest.approx(0.50, abs=0.01)
    assert names["car body upper sway"] == pytest.approx(1.00, abs=0.01)
    assert names["car body yaw"] == pytest.approx(0.70, abs=0.01)
    assert len(set(found.names)) == len(found.names)
    assert found.damping_ratio[0] == pytest.approx(0.0, abs=1e-4)
    np.testing.assert_allclose(found.energy.sum(axis=0), 1.0)
    assert found.condition.min() >= 1.0
    # each is an eigenpair
    matrix = np.asarray(railjax.state_matrix(coach, 245.6 / 3.6))
    np.testing.assert_allclose(matrix @ found.right, found.right * found.eigenvalues, atol=1e-8)
    # all eigenvalues are there: pairs twice, real ones once
    assert 2 * np.sum(found.eigenvalues.imag > 0) + np.sum(found.eigenvalues.imag == 0) == 34
    assert "245.6 km/h" in str(found)


def test_condition_tells_how_an_eigenvalue_moves(coach):
    found = railjax.modes(coach, 60.0)
    matrix = np.asarray(railjax.state_matrix(coach, 60.0))
    rng = np.random.default_rng(0)
    direction = rng.normal(size=(34, 34))
    direction *= 1e-6 / np.linalg.norm(direction, 2)
    moved = np.linalg.eigvals(matrix + direction)
    for value, condition in zip(found.eigenvalues, found.condition, strict=True):
        assert np.abs(moved - value).min() <= 1.01 * condition * 1e-6 + 1e-9


def test_root_locus_is_continuous_and_keeps_its_names(coach):
    speeds = np.linspace(100.0, 300.0, 41) / 3.6
    locus = railjax.root_locus(coach, speeds)
    assert locus.eigenvalues.shape == (41, len(locus.names))
    # oscillating modes move smoothly; overdamped ones may meet on the real axis and part again
    oscillating = locus.damping_ratio.max(axis=0) < 0.8
    assert oscillating.sum() >= 11
    bends = np.abs(np.diff(locus.eigenvalues[:, oscillating], n=2, axis=0))
    assert bends.max() < 0.1
    hunting = locus.names.index("bogie hunting, bogies in phase")
    growth = locus.eigenvalues[:, hunting].real
    assert np.all(np.diff(growth[(speeds > 150 / 3.6) & (speeds < 280 / 3.6)]) > 0)
    assert np.interp(0.0, growth, speeds * 3.6) == pytest.approx(245.6, abs=0.2)
    sway = locus.names.index("car body lower sway")
    assert np.ptp(locus.eigenvalues[:, sway].imag) < 0.05
    for k in range(41):
        full = np.linalg.eigvals(np.asarray(railjax.state_matrix(coach, speeds[k])))
        assert np.abs(full[:, None] - locus.eigenvalues[k]).min(axis=0).max() < 1e-6


@pytest.mark.parametrize("speed", [0.0, -1.0])
def test_modes_at_no_speed_are_refused(coach, speed):
    with pytest.raises(railjax.InputError, match="speed must be positive"):
        railjax.modes(coach, speed)
    with pytest.raises(railjax.InputError, match=r"positive|rising order"):
        railjax.root_locus(coach, np.array([speed, 10.0]))


def test_search_range_is_as_documented():
    assert pytest.approx(540.0) == HIGHEST * 3.6
