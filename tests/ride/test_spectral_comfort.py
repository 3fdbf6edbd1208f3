"""Comfort out of a spectrum against the comfort of long records of it, and against differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import railjax

SPEED = 180 / 3.6
FLOOR = ("floor_acceleration",)


def test_it_is_the_comfort_of_a_long_record(coach):
    """Ten minutes of the linear vehicle on a realisation: the record is made of the response's own lines, without integration."""
    track = railjax.RandomTrack("erri-high", seed=5, length=600 * SPEED)
    response = railjax.frequency_response(coach, SPEED, track, record=FLOOR)
    rate, seconds = 200.0, track.length / SPEED
    samples = round(seconds * rate)
    lines = np.asarray(track.lines)
    numbers = np.round(np.asarray(response.excitation.wavenumber) / track.wavenumbers[1]).astype(int)
    spectrum = np.zeros((samples // 2 + 1, 3), complex)
    spectrum[numbers] = 0.5 * samples * np.asarray(response.transfer["floor_acceleration"]) * lines[numbers, None]
    record = np.fft.irfft(spectrum, samples, axis=0)
    measured = railjax.comfort(record, samples / seconds, settle=10.0)
    expected = railjax.spectral_comfort(railjax.frequency_response(coach, SPEED, "erri-high", record=FLOOR))
    np.testing.assert_allclose(expected.rms, measured.rms["lateral"], rtol=5e-3)
    np.testing.assert_allclose(expected.mean, measured.mean, rtol=4e-2)
    np.testing.assert_allclose(expected.sperling, measured.sperling["lateral"], rtol=3e-3)


def test_lanes_and_derivatives(coach):
    def mean(stiffness, speed=SPEED):
        vehicle = railjax.replace(coach, secondary__stiffness_y=stiffness * coach.secondary.stiffness_y)
        return railjax.spectral_comfort(railjax.frequency_response(vehicle, speed, record=FLOOR))

    many = mean(1.0, jnp.array([40.0, SPEED]))
    for one, batch in zip(mean(1.0), many, strict=True):
        np.testing.assert_allclose(batch[:, 1], one, rtol=1e-10)
    h = 1e-4
    for index in range(3):
        numeric = (mean(1 + h)[index] - mean(1 - h)[index]) / (2 * h)
        np.testing.assert_allclose(jax.jacfwd(lambda k, i=index: mean(k)[i])(1.0), numeric, rtol=1e-6)


def test_the_channel_must_be_there(coach):
    with pytest.raises(railjax.InputError, match="floor_acceleration"):
        railjax.spectral_comfort(railjax.frequency_response(coach, SPEED))
