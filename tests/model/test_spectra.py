"""Spectra of the alignment: values, closed variances against quadrature, tables, names, derivatives."""

import derivatives
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate

import railjax
from railjax.model.track.spectra import LONGEST, NAMED, SHORTEST, FormulaSpectrum, TableSpectrum, variance

LOW, HIGH = 2 * np.pi / LONGEST, 2 * np.pi / SHORTEST


def test_erri_at_a_tenth_of_a_radian_per_metre():
    assert float(railjax.spectrum("erri-low").density(0.1)) == pytest.approx(2.003277e-5, rel=1e-6)
    assert float(railjax.spectrum("erri-high").density(0.1)) == pytest.approx(5.790502e-5, rel=1e-6)


def test_fra_follows_its_formula_and_the_classes_get_smoother():
    w = np.array([0.05, 0.8245, 3.0])
    expected = 0.25 * 0.0762e-4 * 0.8245**2 / (w**2 * (w**2 + 0.8245**2))
    np.testing.assert_allclose(railjax.spectrum("fra-5").density(w), expected, rtol=1e-14)
    # A in cm^2 rad/m, classes 1 to 6
    classes = [3.3634, 1.2107, 0.4128, 0.3027, 0.0762, 0.0339]
    levels = [float(railjax.spectrum(f"fra-{k}").density(0.3)) for k in range(1, 7)]
    np.testing.assert_allclose(levels, np.array(classes) * 1e-4 * 0.25 * 0.8245**2 / (0.09 * (0.09 + 0.8245**2)), rtol=1e-14)
    assert levels == sorted(levels, reverse=True)


@pytest.mark.parametrize("name", NAMED)
@pytest.mark.parametrize(("low", "high"), [(LOW, HIGH), (1e-3, 0.01), (0.5, 0.500001)])
def test_variance_in_closed_form_is_the_integral(name, low, high):
    of = railjax.spectrum(name)
    exact = scipy.integrate.quad(lambda x: float(np.exp(x) * of.density(np.exp(x))), np.log(low), np.log(high), epsrel=1e-12)[0]
    assert float(of.variance(low, high)) == pytest.approx(exact, rel=1e-9)
    # and without a closed form, by quadrature
    assert float(variance(FormulaSpectrum(of.density), low, high)) == pytest.approx(exact, rel=1e-9)


def test_densities_and_variances_have_derivatives():
    derivatives.check(lambda a, c, r: railjax.ErriSpectrum(1e-7 * a, c, r).density(0.1) * 1e5, 6.0, 0.8, 0.02)
    derivatives.check(lambda a, c, r: railjax.ErriSpectrum(1e-7 * a, c, r).variance(LOW, HIGH) * 1e5, 6.0, 0.8, 0.02)
    derivatives.check(lambda a, c, k: railjax.FraSpectrum(1e-5 * a, c, k).variance(LOW, HIGH) * 1e4, 3.0, 0.8, 0.25)
    points = jnp.array([0.1, 0.5, 2.0])
    derivatives.check(lambda s: TableSpectrum(points, s).density(jnp.array([0.2, 0.7])), jnp.array([3.0, 2.0, 0.1]))


def test_a_table_is_straight_between_logarithms_and_zero_outside():
    w = np.geomspace(0.02, 4.0, 12)
    of = TableSpectrum.checked(w, 3e-6 * w**-2.5)
    within = np.geomspace(0.02, 4.0, 77)[1:-1]
    np.testing.assert_allclose(of.density(within), 3e-6 * within**-2.5, rtol=1e-12)
    np.testing.assert_array_equal(of.density(np.array([0.0, 0.0199, 4.01])), 0.0)
    # the derivative is finite everywhere, at zero as well
    assert np.all(np.isfinite(jax.vmap(jax.grad(of.density))(jnp.array([0.0, 0.0199, 0.3, 5.0]))))


def test_a_table_from_a_file_in_its_own_units(tmp_path):
    frequency, density = np.array([0.01, 0.1, 1.0]), np.array([400.0, 2.0, 3e-3])
    path = tmp_path / "line.csv"
    path.write_text("frequency (1/m),PSD (mm^2/(1/m))\n" + "".join(f"{f},{d}\n" for f, d in zip(frequency, density, strict=True)))
    of = railjax.spectrum(path)
    np.testing.assert_allclose(of.density(2 * np.pi * frequency), density * 1e-6 / (2 * np.pi), rtol=1e-12)
    # the same variance in either unit: ∫ S dΩ = ∫ S' df
    assert isinstance(railjax.spectrum(str(path)), TableSpectrum)


def test_a_source_is_a_name_a_spectrum_or_a_function():
    of = railjax.ErriSpectrum(1e-7)
    assert railjax.spectrum(of) is of
    assert railjax.spectrum("erri-low").roughness == 2.119e-7
    own = railjax.spectrum(lambda w: 1e-6 / (0.1 + w**2))
    assert float(own.density(0.5)) == pytest.approx(1e-6 / 0.35)
    assert all(isinstance(entry, railjax.Spectrum) for entry in (of, own, TableSpectrum(np.ones(2), np.ones(2))))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: railjax.spectrum("eri-high"), "nearest is 'erri-high'"),
        (lambda: railjax.spectrum("missing.csv"), "missing.csv: cannot be read"),
        (lambda: TableSpectrum.checked([1.0], [1.0]), "at least two wavenumbers"),
        (lambda: TableSpectrum.checked([1.0, 2.0], [1.0]), "as many densities"),
        (lambda: TableSpectrum.checked([1.0, 2.0, 2.0], [1.0, 1.0, 1.0]), "must rise; they do not from point 2"),
        (lambda: TableSpectrum.checked([1.0, 2.0], [1.0, 0.0]), "density must be positive and finite; point 2 is 0"),
        (lambda: TableSpectrum.checked([float("nan"), 2.0], [1.0, 1.0]), "wavenumber must be positive .* point 1 is nan"),
        (lambda: railjax.RandomTrack(TableSpectrum(np.array([2.0, 1.0]), np.ones(2))), "must rise"),
        (lambda: railjax.RandomTrack(railjax.ErriSpectrum(-1.0)), "spectrum.roughness must be positive"),
        (lambda: railjax.RandomTrack(lambda w: -w), "density must be finite and not negative"),
    ],
)
def test_bad_spectra_are_refused_in_one_line(make, message):
    with pytest.raises(railjax.InputError, match=message) as caught:
        make()
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a,b\n1,2\n2,3\n", "no column of the wavenumber"),
        ("wavenumber (rad/m),psd (kg)\n1,2\n2,3\n", "unit 'kg' of column"),
        ("wavenumber (rad/m),psd (mm^2/(rad/m))\n1,2\n2,x\n", "line 3: column .* holds 'x'"),
        ("wavenumber (rad/m),psd (mm^2/(rad/m))\n2,2\n1,3\n", "must rise"),
        ("wavenumber (rad/m),psd (mm^2/(rad/m))\n2,2\n", "too few to make a spectrum"),
    ],
)
def test_bad_files_of_spectra_are_refused_in_one_line(tmp_path, text, message):
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(railjax.InputError, match=message) as caught:
        railjax.spectrum(path)
    assert len(str(caught.value).splitlines()) == 1
