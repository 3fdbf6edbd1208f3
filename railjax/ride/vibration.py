"""Measures of vibration on man out of an acceleration history; pure JAX, differentiable, time along the first axis."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Complex, Float

from ..base.arguments import guarded
from ..base.errors import InputError
from ..base.failed_lanes import nan_unless
from ..base.smooth import sqrt_of_square
from .weightings import SPERLING, WEIGHTINGS, check_rate, check_weighting, weighting

History = Float[Array, "samples *lanes"]

#: averaging times of the standards, s
BLOCK = 5.0  # EN 12299
RUNNING = 1.0  # ISO 2631-1, for MTVV

#: the third octaves of Sperling's index: n of 10^(n/10) Hz, 0.5 to 31.5 Hz
THIRD_OCTAVES = tuple(range(-3, 16))
#: the edges of the lowest and the highest, Hz
SPERLING_BAND = tuple(10.0 ** ((n + half) / 10.0) for n, half in ((THIRD_OCTAVES[0], -0.5), (THIRD_OCTAVES[-1], 0.5)))


@guarded()
def weighted_acceleration(acceleration: ArrayLike, sampling_rate: float | int, name: str) -> History:
    """A frequency-weighted acceleration, at rest before it begins.

    In the frequency domain: the record, followed by zeros for five times 1/f1 (12.5 s; the filter then has forgotten 9 of 10
    digits), times the analogue response of `weighting` below the Nyquist frequency. So it is exact for a record without content
    above half of its sampling rate, which a recursive filter is not; its derivative costs one more transform, and a gradient
    needs no tape over the samples. It begins with the transient of a filter switched on, like `scipy.signal.sosfilt`: 2 s after
    it the high-pass has forgotten a constant.

    Args:
        acceleration: samples of shape `(samples, *lanes)`, m/s^2 or any other unit, which the result has too.
        sampling_rate: Hz.
        name: of the weighting, "Wd" for example; `weighting` lists them.

    Returns:
        Samples of the same shape and unit; lanes that are not finite throughout are NaN.

    Raises:
        InputError: for an unknown name or a rate that is not positive.
    """
    from scipy.fft import next_fast_len

    check_weighting(name)
    check_rate(sampling_rate)
    a = jnp.asarray(acceleration, float)
    lowest = 0.4 if name in SPERLING else WEIGHTINGS[name].f1
    length = next_fast_len(len(a) + math.ceil(5.0 / lowest * sampling_rate), real=True)
    return _filtered(a, weighting(name, np.fft.rfftfreq(length, 1.0 / sampling_rate)), length)


# compiled as a whole, here and below: one operation after the other takes twenty times as long the first time
@functools.partial(jax.jit, static_argnums=2)
def _filtered(a: History, response: Complex[Array, "lines"], length: int) -> History:
    a, sound = _sound(a)
    spectrum = jnp.fft.rfft(a, length, axis=0) * response.reshape((-1,) + (1,) * (a.ndim - 1))
    return nan_unless(sound, jnp.fft.irfft(spectrum, length, axis=0)[: len(a)])


def _sound(values: History) -> tuple[History, Bool[Array, "*lanes"]]:
    """The record with 1 in lanes that are not numbers throughout, and which are: so that such a lane spoils no derivative."""
    sound = jnp.all(jnp.isfinite(values), axis=0)
    return jnp.where(sound, values, 1.0), sound


@guarded()
def weighted_rms(
    acceleration: ArrayLike, sampling_rate: float | int, name: str = "Wd", settle: float | int = 0.0
) -> Float[Array, "*lanes"]:
    """a_w = sqrt(mean(a_w(t)^2)) (ISO 2631-1, eq. 1) of `weighted_acceleration`.

    Differentiable where the acceleration is not 0 throughout.

    Args:
        acceleration: samples of shape `(samples, *lanes)`, m/s^2.
        sampling_rate: Hz.
        name: of the weighting; "Wd" is that of lateral and longitudinal accelerations, "Wb" or "Wk" of vertical ones.
        settle: time left out at the start, after the weighting, s.

    Returns:
        a_w, shape `(*lanes)`, m/s^2.

    Raises:
        InputError: for an unknown name and a `settle` that leaves nothing.
    """
    weighted = weighted_acceleration(acceleration, sampling_rate, name)[round(settle * sampling_rate) :]
    if not len(weighted):
        raise InputError(f"settle {settle:g} s leaves nothing of a record of {len(acceleration) / sampling_rate:g} s")
    return rms(weighted)


@jax.jit
def rms(values: History) -> Float[Array, "*lanes"]:
    """Root of the mean square over time; its derivative at 0 is 0."""
    values, sound = _sound(values)
    return nan_unless(sound, sqrt_of_square(jnp.mean(values**2, axis=0)))


@functools.partial(jax.jit, static_argnums=1)
def block_rms(weighted: History, sampling_rate: float | int) -> Float[Array, "blocks *lanes"]:
    """R.m.s. of successive blocks of 5 s (EN 12299: the continuous comfort C_C); what is left at the end does not count."""
    samples = round(BLOCK * sampling_rate)
    blocks = len(weighted) // samples
    weighted, sound = _sound(weighted)
    squares = weighted[: blocks * samples].reshape(blocks, samples, *weighted.shape[1:]) ** 2
    return nan_unless(sound, sqrt_of_square(jnp.mean(squares, axis=1)))


@jax.jit
def mean_comfort(percentiles: list[Float[Array, "*lanes"]]) -> Float[Array, "*lanes"]:
    """N_MV = 6 sqrt(sum of squares) of the 95th percentiles (m/s^2) of the directions' 5 s values (EN 12299, floor)."""
    return 6.0 * sqrt_of_square(sum(value**2 for value in percentiles))


@functools.partial(jax.jit, static_argnums=1)
def running_maximum(weighted: History, sampling_rate: float | int) -> Float[Array, "*lanes"]:
    """MTVV = max of the running r.m.s. over 1 s (ISO 2631-1, eqs. 2 and 4; linear averaging, whole windows)."""
    samples = round(RUNNING * sampling_rate)
    weighted, sound = _sound(weighted)
    # the mean taken out, which the differences do not see, so that the sum stays small in single precision
    squares = weighted**2
    mean = jnp.mean(squares, axis=0)
    total = jnp.concatenate([jnp.zeros_like(squares[:1]), jnp.cumsum(squares - mean, axis=0)])
    largest = jnp.max(total[samples:] - total[:-samples], axis=0) / samples + mean
    return nan_unless(sound, sqrt_of_square(jnp.maximum(largest, 0.0)))


@functools.partial(jax.jit, static_argnums=1)
def vibration_dose(weighted: History, sampling_rate: float | int) -> Float[Array, "*lanes"]:
    """VDV = (integral of a_w(t)^4)^(1/4) in m/s^1.75 (ISO 2631-1, eq. 5)."""
    weighted, sound = _sound(weighted)
    # fourth powers of numbers near 1, for single precision
    scale = jax.lax.stop_gradient(jnp.max(jnp.abs(weighted), axis=0))
    scale = jnp.where(scale == 0.0, 1.0, scale)
    return nan_unless(sound, scale * (jnp.sum((weighted / scale) ** 4, axis=0) / sampling_rate) ** 0.25)


@guarded()
def sperling_bands(
    acceleration: ArrayLike, sampling_rate: float | int, direction: str = "lateral", exponent: float | int = 1.0 / 6.67
) -> Float[Array, "bands *lanes"]:
    """Sperling's index per third octave, 0.5 to 31.5 Hz: Wz_i = (sum of (a B)^2)^exponent over the band's spectral lines.

    a is the amplitude in cm/s^2 of each line of the record's spectrum, without window (`acceleration` in m/s^2); B(f) is
    `weighting`'s. By Parseval the sum is twice the mean square of what the band holds, so that it is meant for random records
    as well. A sine gives (a B)^(2/6.67). `exponent`: 1/6.67; some codes have 0.15.
    """
    check_rate(sampling_rate)
    check_weighting(name := f"sperling-{direction}")
    a = jnp.asarray(acceleration, float)
    frequency = np.fft.rfftfreq(len(a), 1.0 / sampling_rate)
    edges = 10.0 ** ((np.arange(THIRD_OCTAVES[0], THIRD_OCTAVES[-1] + 2) - 0.5) / 10.0)
    bands = (frequency >= edges[:-1, None]) & (frequency < edges[1:, None])
    if not bands.any(axis=1).all() or edges[-1] > 0.5 * sampling_rate:
        raise InputError(
            f"{len(a) / sampling_rate:.3g} s at {sampling_rate:g} Hz leave a third octave from 0.5 to 31.5 Hz without spectral "
            f"lines; Sperling's index needs about 10 s and 75 Hz"
        )
    return _indices(a, bands, weighting(name, frequency), exponent)


@functools.partial(jax.jit, static_argnums=3)
def _indices(
    a: History, bands: Bool[ArrayLike, "bands lines"], response: Complex[Array, "lines"], exponent: float | int
) -> Float[Array, "bands *lanes"]:
    a, sound = _sound(a)
    amplitude = 100.0 * (2.0 / len(a)) * jnp.fft.rfft(a, axis=0)
    squares = (amplitude.real**2 + amplitude.imag**2).reshape(len(response), -1)
    sums = (bands * jnp.abs(response) ** 2).astype(squares.dtype) @ squares
    positive = sums > 0.0
    found = jnp.where(positive, jnp.where(positive, sums, 1.0) ** exponent, 0.0)
    return nan_unless(sound, found.reshape((len(bands), *a.shape[1:])))


@guarded()
def sperling(
    acceleration: ArrayLike,
    sampling_rate: float | int,
    direction: str = "lateral",
    exponent: float | int = 1.0 / 6.67,
    power: float | int = 6.67,
) -> Float[Array, "*lanes"]:
    """Sperling's index Wz = (sum of Wz_i^power)^(1/power) over the third octaves of `sperling_bands`, dimensionless.

    Below 2 very good, 2.5 good, 3 satisfactory for passengers (recalled).

    Args:
        acceleration: samples of shape `(samples, *lanes)`, m/s^2, of about 10 s or more.
        sampling_rate: Hz, about 75 or more.
        direction: "lateral" or "vertical".
        exponent: of `sperling_bands`, dimensionless; some codes have 0.15.
        power: dimensionless; 6.67 adds mean squares, so that Wz does not depend on where the bands' edges lie. Many codes take
            the tenth root of tenth powers (10), which is lower.

    Raises:
        InputError: for another direction, and a record so short or so slowly sampled that a band holds no spectral line.
    """
    bands = sperling_bands(acceleration, sampling_rate, direction, exponent)
    return combined(bands, power)


@functools.partial(jax.jit, static_argnums=1)
def combined(bands: Float[Array, "bands *lanes"], power: float | int) -> Float[Array, "*lanes"]:
    """(sum of Wz_i^power)^(1/power)."""
    bands, sound = _sound(bands)
    total = jnp.sum(bands**power, axis=0)
    positive = total > 0.0
    return nan_unless(sound, jnp.where(positive, jnp.where(positive, total, 1.0) ** (1.0 / power), 0.0))
