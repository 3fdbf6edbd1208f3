"""Equivalent conicity against EN 15302's reference cases, cones, and the free wheelset's path integrated by SciPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from en15302 import CONICITY, DELTA_R
from scipy.integrate import solve_ivp

import railjax

Y = np.linspace(-8e-3, 8e-3, 161)


def reference_case(name):
    half = 1e-3 * np.array(DELTA_R[name])
    y = 1e-4 * np.arange(len(half))
    return np.concatenate([-y[:0:-1], y]), np.concatenate([-half[:0:-1], half])


@pytest.mark.parametrize("case", CONICITY)
def test_reference_cases_of_the_standard(case):
    """The standard's tolerance is the lesser of 0.05 and half the value; its cases are met to the rounding of what it prints. E4 has a range in
    which nothing pulls the wheelset back (tan gamma_e = 0)."""
    amplitudes, printed = map(np.array, zip(*CONICITY[case].items(), strict=True))
    found = railjax.equivalent_conicity(*reference_case(case), 1e-3 * amplitudes)
    np.testing.assert_allclose(found, printed, atol=1.5e-3)


@pytest.mark.parametrize("conicity", [0.025, 0.1, 0.4])
def test_a_cone_has_its_own_conicity_at_every_amplitude(conicity):
    amplitudes = np.array([[1e-4, 3e-3], [5e-3, 8e-3]])
    found = railjax.equivalent_conicity(Y, 2.0 * conicity * Y, amplitudes, half_distance=0.5, radius=0.3)
    assert found.shape == amplitudes.shape
    np.testing.assert_allclose(found, conicity, rtol=3e-8)
    np.testing.assert_allclose(railjax.nonlinearity_parameter(Y, 2.0 * conicity * Y), 0.0, atol=1e-6)


def path(y, delta_r, start, half_distance=0.75, radius=0.46):
    """Wavelength and half-width of the wave that starts at `start` with y' = 0."""

    def rate(x, state):
        return [state[1], -np.interp(state[0], y, delta_r) / (2.0 * half_distance * radius)]

    def turns(x, state):
        return state[1]

    turns.terminal, turns.direction = True, -1.0 if np.interp(start, y, delta_r) < 0.0 else 1.0
    found = solve_ivp(rate, (0.0, 200.0), [start, 0.0], events=turns, rtol=1e-9, atol=1e-13, max_step=0.05)
    return 2.0 * found.t_events[0][-1], found.y_events[0][-1][0]


@pytest.mark.parametrize("offset", [0.0, 1e-3])
def test_against_the_path_of_a_free_wheelset(offset):
    """Also of unequal wheels, whose wave is about another y and not symmetric: EN 15302 takes half its width as the amplitude."""
    delta_r = 0.4 * Y + 2.0e3 * Y**3 + 20.0 * Y**2 + offset
    start = -6e-3
    wavelength, other = path(Y, delta_r, start)
    amplitude = 0.5 * (other - start)
    expected = (2.0 * np.pi / wavelength) ** 2 * 0.75 * 0.46
    np.testing.assert_allclose(railjax.equivalent_conicity(Y, delta_r, amplitude), expected, rtol=2e-5)


def test_where_there_is_no_wave():
    away = railjax.equivalent_conicity(Y, -0.2 * Y, np.array([1e-3, 3e-3]))
    assert np.isnan(away).all()
    beyond = railjax.equivalent_conicity(Y, 0.2 * Y, np.array([3e-3, 9e-3]))
    np.testing.assert_allclose(beyond, [0.1, np.nan])
    unequal = railjax.equivalent_conicity(Y, 0.2 * Y + 1e-3, np.array([2e-3, 4e-3]))  # about y = -5 mm
    np.testing.assert_allclose(unequal, [0.1, np.nan])


def test_derivatives_inside_transformations():
    delta_r = 0.3 * Y + 3e3 * Y**3 + 4e-4
    direction = np.cos(900.0 * Y) * 1e-3
    amplitudes = jnp.array([2e-3, 3e-3, 4.5e-3])

    @jax.jit
    def both(by):
        def of(by):
            return railjax.equivalent_conicity(Y, delta_r + by * direction, amplitudes)

        return of(by), jax.jvp(of, (by,), (1.0,))[1], jax.jacrev(of)(by)

    value, forward, reverse = both(0.1)
    np.testing.assert_allclose(value, railjax.equivalent_conicity(Y, delta_r + 0.1 * direction, np.array(amplitudes)), rtol=1e-9)
    steps = [railjax.equivalent_conicity(Y, delta_r + by * direction, np.array(amplitudes)) for by in (0.1 + 1e-4, 0.1 - 1e-4)]
    np.testing.assert_allclose(forward, (steps[0] - steps[1]) / 2e-4, rtol=1e-5)
    np.testing.assert_allclose(forward, reverse, rtol=1e-10)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"amplitude": 3.0}, "millimetres"),
        ({"amplitude": 0.02}, "at most 0.008 m"),
        ({"amplitude": -1e-3}, "amplitude"),
        ({"y": 1e3 * Y}, "millimetres"),
        ({"y": -Y}, "rising"),
        ({"delta_r": np.full(161, np.nan)}, "finite"),
        ({"delta_r": np.zeros(7)}, "a value for each y"),
    ],
)
def test_refusals(change, message):
    with pytest.raises(railjax.InputError, match=message):
        railjax.equivalent_conicity(**({"y": Y, "delta_r": 0.2 * Y, "amplitude": 3e-3} | change))
