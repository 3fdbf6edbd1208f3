"""Kalker's table and Hertz's contact: entries, closed forms, an independent solver, derivatives."""

import derivatives
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
import scipy.special

import railjax
from railjax.model.contact import kalker

YOUNG, POISSON = 2.1e11, 0.27


@pytest.mark.parametrize(
    ("ratio", "poisson", "c11", "c22", "c23"),
    [
        (0.1, 0.0, 2.51, 2.51, 0.334),
        (0.3, 0.25, 3.44, 2.75, 0.715),
        (1.0, 0.25, 4.12, 3.67, 1.47),
        (1.0, 0.5, 5.20, 3.98, 1.63),
        (1 / 0.7, 0.25, 4.54, 4.21, 1.95),
        (10.0, 0.0, 10.7, 10.7, 12.2),
        (10.0, 0.5, 12.9, 16.0, 18.0),
    ],
)
def test_entries_of_the_table(ratio, poisson, c11, c22, c23):
    c = railjax.kalker_coefficients(ratio, poisson)
    np.testing.assert_allclose([c.c11, c.c22, c.c23], [c11, c22, c23], rtol=1e-12)


def test_no_entry_stands_out_from_its_neighbours():
    """A slip of the pen: each row but the ends against the cubic through its neighbours, in logarithms; all are within 1 %."""
    at = np.log(kalker._RATIOS)
    for table in (kalker._C11, kalker._C22, kalker._C23, kalker._C33):
        logs = np.log(table)
        for row in range(1, len(at) - 1):
            others = [k for k in range(max(0, row - 2), min(len(at), row + 3)) if k != row]
            cubic = np.polyfit(at[others], logs[others], len(others) - 1)
            smooth = [np.polyval(column, at[row]) for column in cubic.T]
            np.testing.assert_allclose(logs[row], smooth, rtol=0.0, atol=0.01)


def test_between_the_rows_it_is_linear_in_logarithms():
    for low, high, nu in ((0.3, 0.4, 0.25), (1.0, 1 / 0.9, 0.0), (5.0, 10.0, 0.5)):
        middle, *ends = (np.array(railjax.kalker_coefficients(ratio, nu)) for ratio in (np.sqrt(low * high), low, high))
        np.testing.assert_allclose(middle, np.sqrt(ends[0] * ends[1]), rtol=1e-12)


def test_table_is_monotonic_and_flat_outside():
    ratios = jnp.geomspace(0.1, 10.0, 300)
    c = jax.vmap(railjax.kalker_coefficients)(ratios)
    for column in (c.c11, c.c22, c.c23):
        assert np.all(np.diff(np.asarray(column)) > -1e-12)
    assert np.all(np.diff(np.asarray(c.c33)) < 1e-12)
    ends = jax.jit(railjax.kalker_coefficients)(jnp.array([10.0, 20.0])).c11  # refused where it is known
    assert ends[0] == ends[1]


def test_circular_contact_has_the_closed_form():
    """Crossed equal cylinders are a sphere on a plane: a^3 = 3 P R/(4 E*)."""
    load, radius = 51250.0, 0.3
    ellipse = railjax.contact_ellipse(load, radius, radius)
    expected = (3 * load * radius * 2 * (1 - POISSON**2) / (4 * YOUNG)) ** (1 / 3)
    np.testing.assert_allclose([ellipse.a, ellipse.b], expected, rtol=1e-9)


@pytest.mark.parametrize(
    ("wheel", "rail", "profile"),
    [(0.46, 0.3, np.inf), (0.3, 0.46, np.inf), (0.46, 0.3, -0.33), (0.1, 1.0, np.inf)],
)
def test_ellipse_against_an_independent_solution(wheel, rail, profile):
    """Hertz by SciPy: find the pressure ellipse whose own displacement field has the two curvatures."""
    load, modulus = 80e3, YOUNG / (1 - POISSON**2) / 2
    ellipse = railjax.contact_ellipse(load, wheel, rail, profile)
    curvature = {"a": 0.5 / wheel, "b": 0.5 * (1 / rail + 1 / profile)}

    def curvatures(logs):
        a, b = np.exp(logs)
        major, minor = max(a, b), min(a, b)
        m = 1 - (minor / major) ** 2
        first, second = scipy.special.ellipk(m), scipy.special.ellipe(m)
        peak = 3 * load / (2 * np.pi * a * b)
        # displacement under an ellipsoidal pressure, Johnson (1985) eqs. 3.62: pi p0/E* b/a-terms
        along_major = peak / modulus * minor / (m * major**2) * (first - second)
        along_minor = peak / modulus * minor / (m * major**2) * ((major / minor) ** 2 * second - first)
        return (along_major, along_minor) if a > b else (along_minor, along_major)

    def residual(logs):
        found = curvatures(logs)
        return [np.log(found[0] / curvature["a"]), np.log(found[1] / curvature["b"])]

    guess = np.log([float(ellipse.a) * 1.1, float(ellipse.b) * 0.95])
    solved = np.exp(scipy.optimize.fsolve(residual, guess, xtol=1e-13))
    np.testing.assert_allclose([ellipse.a, ellipse.b], solved, rtol=1e-8)


def test_load_scaling():
    """Linear theory: a, b ~ P^(1/3), so f_11, f_33 ~ P^(2/3), f_12 ~ P, f_22 ~ P^(4/3)."""
    one, eight = (railjax.creep_coefficients(load, 0.46, 0.3) for load in (5e4, 4e5))
    np.testing.assert_allclose(np.array(eight) / np.array(one), [4, 4, 8, 16], rtol=1e-12)


def test_coach_wheel_gives_the_order_of_table_1():
    f = railjax.creep_coefficients(51250.0, 0.46, 0.3)
    assert float(f.creep_longitudinal) == pytest.approx(9.43e6, rel=0.05)
    assert float(f.creep_lateral) == pytest.approx(10.25e6, rel=0.25)


def test_derivatives():
    """Of all four, in shares of their own; the weights keep an error in one from making up for one in another."""
    at = 51250.0, 0.46, 0.3
    weight = np.array([1.0, 1.3, 1.7, 2.3]) / np.array(railjax.creep_coefficients(*at))
    derivatives.check(lambda *p: weight * jnp.stack(railjax.creep_coefficients(*p)), *at, step=1e-6, rtol=1e-5)


def test_a_file_can_ask_for_hertz(tmp_path):
    path = tmp_path / "light.toml"
    path.write_text('base = "coach"\n[contact]\nwheel_load_kN = 30\n[contact.hertz]\nrail_head_radius_m = 0.3\n')
    vehicle = railjax.load_vehicle(path)
    expected = railjax.creep_coefficients(30e3, 0.46, 0.3)
    assert float(vehicle.contact.creep_longitudinal) == pytest.approx(float(expected.creep_longitudinal))
    assert float(vehicle.contact.creep_spin) == pytest.approx(float(expected.creep_spin))
    # a file on top of it may give coefficients again
    above = tmp_path / "above.toml"
    above.write_text('base = "light.toml"\n[contact]\ncreep_longitudinal_MN = 7\ncreep_lateral_MN = 8\n')
    assert float(railjax.load_vehicle(above).contact.creep_longitudinal) == 7e6
