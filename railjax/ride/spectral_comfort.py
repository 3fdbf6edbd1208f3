"""Ride comfort out of a response spectrum, without a time history: what `comfort` finds on average in long records of it."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..base.arguments import guarded
from ..base.errors import InputError
from ..base.smooth import sqrt_of_square
from .frequency import FrequencyResponse
from .vibration import BLOCK, SPERLING_BAND, mean_comfort

#: the 95th percentile of a standard normal number
NORMAL_95 = 1.6448536269514722


class SpectralComfort(NamedTuple):
    """Per place and lane: weighted r.m.s. a_w (Wd, m/s^2), the lateral part of EN 12299's N_MV, Sperling's Wz."""

    rms: Float[Array, "..."]  # a_w, m/s^2
    mean: Float[Array, "..."]  # lateral part of N_MV, dimensionless
    sperling: Float[Array, "..."]  # Wz, dimensionless


@guarded()
def spectral_comfort(response: FrequencyResponse, channel: str = "floor_acceleration") -> SpectralComfort:
    """Lateral ride comfort of a Gaussian, stationary response (`frequency_response`, or that of `statistical_linearisation`).

    N_MV takes the 95th percentile of the r.m.s. of 5 s. The mean square of T = 5 s of a process of one-sided spectrum G has the
    mean m = ∫ G df and, for T well above the correlation time, the variance ∫ G² df/T (Bendat and Piersol); it is taken as
    gamma-distributed, with the percentile of Wilson and Hilferty (1931). Wz: that of `sperling` with its defaults. Differentiable.
    Raises `InputError` if the response lacks the channel: record=("floor_acceleration",).
    """
    if channel not in response.transfer:
        raise InputError(f"the response lacks {channel!r}: frequency_response(..., record=[{channel!r}])")
    return _judged(
        response.rms(channel, "Wd"),
        response.shares(channel, "Wd"),
        response.spectrum(channel, "Wd"),
        response.shares(channel, "sperling-lateral"),
        response.frequency,
    )


@jax.jit
def _judged(
    rms: Float[Array, "..."],
    shares: Float[Array, "waves ..."],
    spectrum: Float[Array, "waves ..."],
    of_sperling: Float[Array, "waves ..."],
    frequency: Float[Array, "waves ..."],
) -> SpectralComfort:
    spread = jnp.sum(shares * spectrum, axis=0) / BLOCK
    square = rms**2
    # 2/(9 nu), nu = 2 m^2/variance degrees of freedom
    narrow = spread / (9.0 * square**2)
    percentile = square * (1.0 - narrow + NORMAL_95 * jnp.sqrt(narrow)) ** 3
    low, high = SPERLING_BAND
    within = (frequency >= low) & (frequency < high)
    within = within.reshape((len(within),) + (1,) * (of_sperling.ndim - within.ndim) + within.shape[1:])
    # amplitudes in cm/s^2: their squares add up to twice the mean square
    total = 2e4 * jnp.sum(of_sperling * within, axis=0)
    return SpectralComfort(rms, mean_comfort([sqrt_of_square(percentile)]), total ** (1.0 / 6.67))
