"""Forced response in the frequency domain: transfer functions, spectra and r.m.s. of the linearised vehicle, exact and without
time integration.

Straight running with linear creep on the alignment eta, wheelset i at s_i ahead of the car body's centre:

    x' = E x + sum_i B_i eta(v t + s_i),  y = C x + sum_i D_i eta(v t + s_i)
    H(W) = C (i W v - E)^-1 b(W) + d(W),  b = sum_i B_i exp(i W s_i),  d = sum_i D_i exp(i W s_i),  W in rad/m

from the same `motion` as the simulation. A random track of spectrum S(W) gives y the spectrum |H|^2 S; a track made of lines
(`RandomTrack`) the sum of |H|^2 times their mean squares.
"""

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from ..base.arguments import ARGUMENTS, guarded
from ..base.batches import Batch
from ..base.checks import Kind, a_name, traced
from ..base.compilation import eig
from ..base.errors import InputError, NumericalError
from ..base.failed_lanes import ends, nan_unless, no_number, without_nan
from ..base.fields import structure
from ..base.packing import as_numbers
from ..base.precision import require_double_precision
from ..base.smooth import sqrt_of_square
from ..base.typing import Number, Scalar
from ..base.units import KMH
from ..model.damper import Damper
from ..model.kinematics import wheelset_positions
from ..model.motion import PASSIVE, Motion, linearised, state_rate, state_size, wheelset_shape
from ..model.parameters import bare
from ..model.track.sampled import SampledTrack
from ..model.track.shapes import check_track
from ..model.track.spectra import LONGEST, SHORTEST, Spectrum, spectrum
from ..model.vehicle import Vehicle
from ..simulation.channels import CHANNELS, check_channel, check_linear_channel
from .weightings import weighting

if TYPE_CHECKING:
    import xarray

#: wavenumbers between longest and shortest wavelength, evenly spaced in their logarithm. The trapezoidal sum of a peak of damping
#: ratio zeta converges as exp(-2 pi zeta/h), h the spacing: 400 over two decades resolve 1 % of critical damping to 0.4 %
POINTS = 400


class Excitation(NamedTuple):
    """Alignment as waves: wavenumber W in rad/m, and of each its share of the variance, m^2."""

    wavenumber: Float[Array, "waves"]
    variance: Float[Array, "waves"]
    density: Float[Array, "waves"]  # one-sided, m^2/(rad/m)


def excitation(of: Spectrum, shortest: Scalar = SHORTEST, longest: Scalar = LONGEST, points: int = POINTS) -> Excitation:
    """The spectrum between two wavelengths (m) as waves, so that sums over them are integrals: trapezoids in log W with Gregory's
    corrections of fourth order at the ends."""
    # in NumPy where nothing is traced: a dozen small programs less to compile
    xp = jnp if traced((shortest, longest)) else np
    logarithm = xp.linspace(xp.log(2.0 * np.pi / longest), xp.log(2.0 * np.pi / shortest), points)
    weights = np.ones(points)
    weights[:3] = weights[:-4:-1] = (3.0 / 8.0, 7.0 / 6.0, 23.0 / 24.0)
    wavenumber = xp.exp(logarithm)
    density = of.density(wavenumber)
    if not traced(density):
        known = np.asarray(density)
        bad = np.flatnonzero(~(np.isfinite(known) & (known >= 0.0)))
        if known.shape != (points,) or bad.size:
            what = f"at {wavenumber[bad[0]]:.4g} rad/m it is {known[bad[0]]:g}" if bad.size else f"not of shape {known.shape}"
            raise InputError(f"the spectrum's density must be finite and not negative, one value per wavenumber; {what}")
    waves = wavenumber, density * wavenumber * weights * (logarithm[1] - logarithm[0]), density
    return Excitation(*(jax.device_put(as_numbers(wave)) for wave in waves))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class FrequencyResponse:
    """Result of `frequency_response`. Arrays have the wave first, then bogie, wheelset (n m) or floor position, then lanes.

    `transfer` is H of each channel, unit of the channel per m of alignment, with the phase of the wave at the car body's centre;
    `growth` the largest real part of E's eigenvalues, 1/s: where it is not negative there is no stationary response and H is NaN.
    """

    frequency: Float[Array, "waves ..."]  # W v/(2 pi), Hz
    transfer: dict[str, Complex[Array, "waves ..."]]
    excitation: Excitation
    growth: Float[Array, "..."]
    speed: Number  # m/s
    vehicle_name: str = structure("")

    @guarded(weight=a_name)
    def spectrum(self, channel: str, weight: str | None = None) -> Float[Array, "waves ..."]:
        """One-sided power spectral density of a channel, (unit)^2/Hz, weighted by the `weighting` that `weight` names, if one is given."""
        return _shares(self._of(channel), self.frequency, self.alignment_spectrum, weight)

    @property
    def alignment_spectrum(self) -> Float[Array, "waves ..."]:
        """One-sided power spectral density of the alignment as the vehicle meets it, m^2/Hz."""
        return _of_frequency(self.excitation.density, self.frequency, as_numbers(self.speed))

    @guarded(weight=a_name)
    def shares(self, channel: str, weight: str | None = None) -> Float[Array, "waves ..."]:
        """What each wave adds to the mean square of a channel, (unit)^2 in SI; `weight` as in `spectrum`."""
        return _shares(self._of(channel), self.frequency, self.excitation.variance, weight)

    @guarded(weight=a_name)
    def rms(self, channel: str, weight: str | None = None) -> Float[Array, "..."]:
        """Root mean square of a channel in its SI unit; with a `weight` ("Wd", ...) weighted."""
        return _rms(self._of(channel), self.frequency, self.excitation.variance, weight)

    def _of(self, channel: str) -> Complex[Array, "waves ..."]:
        if channel not in self.transfer:
            raise InputError(f"the response lacks {check_channel(channel)!r}: frequency_response(..., record=[{channel!r}])")
        return self.transfer[channel]

    def __str__(self) -> str:
        speed = np.ravel(np.asarray(self.speed)) * KMH
        span = f"{speed[0]:.1f}" if speed.min() == speed.max() else f"{speed.min():.1f} to {speed.max():.1f}"
        lines = [f"Linear forced response of {self.vehicle_name or 'a vehicle'} at {span} km/h, {len(self.frequency)} waves"]
        for name in self.transfer:
            values = self.rms(name)
            low, high = ends(values)
            lines.append(f"  rms {name}: {low:.4g}" + ("" if low == high else f" to {high:.4g}") + f" {CHANNELS[name].unit}")
        unstable = int(np.sum(~(np.asarray(self.growth) < 0.0)))
        if unstable:
            lines.append(f"  unstable, without a stationary response: {unstable} of {self.growth.size} lane(s)")
        return "\n".join(lines)

    def to_xarray(self) -> "xarray.Dataset":
        """Transfer functions and spectra with dimensions wave, bogie, wheelset or position, lane; units in the attributes."""
        import xarray

        lane = ("lane",) if self.growth.ndim else ()
        variables = {}
        for name, values in self.transfer.items():
            unit, part, _ = CHANNELS[name]
            inner = (part,) if values.ndim > 1 + len(lane) else ()
            dims = ("wave", *inner, *lane)
            variables[f"{name}_transfer"] = (dims, np.asarray(values), {"units": f"({unit})/m"})
            variables[f"{name}_spectrum"] = (dims, np.asarray(self.spectrum(name)), {"units": f"({unit})^2/Hz"})
        coordinates = {
            "frequency": (("wave", *lane), np.asarray(self.frequency), {"units": "Hz"}),
            "wavelength": (("wave",), 2.0 * np.pi / np.asarray(self.excitation.wavenumber), {"units": "m"}),
            "speed": (lane if np.ndim(self.speed) else (), np.asarray(self.speed), {"units": "m/s"}),
        }
        return xarray.Dataset(variables, coordinates, {"vehicle": self.vehicle_name})


ARGUMENTS["response"] = Kind(FrequencyResponse, "what railjax.frequency_response returns")


def an_excitation(key: str, value: Any) -> None:
    """A spectrum, a realisation of one, or waves."""
    if isinstance(value, SampledTrack):
        check_track(value)
    elif not isinstance(value, Excitation):
        spectrum(value)


@guarded(("shortest", "longest"), track=an_excitation)
def frequency_response(
    vehicle: Vehicle,
    speed: Scalar,
    track: object = "erri-high",
    *,
    damper: Damper = PASSIVE,
    record: tuple[str, ...] | list[str] = ("carbody_acceleration",),
    shortest: Scalar = SHORTEST,
    longest: Scalar = LONGEST,
    points: int = POINTS,
) -> FrequencyResponse:
    """Stationary response of the linearised vehicle to a random track.

    The creep is linear and the flange not touched; a damper is linearised at rest (see `statistical_linearisation` for creep
    saturation, the flange and balance logic). Differentiable in both modes with respect to every float of vehicle, speed, damper
    and spectrum. Where straight running is unstable there is no stationary response: in a batch or transformation such a lane is
    NaN.

    Args:
        vehicle: the vehicle, or a batch with lanes in any of its numbers.
        speed: v, m/s, one or one per lane.
        track: what `spectrum` takes (a name, a table, a formula); a `RandomTrack`, of which each line is a wave; or an
            `Excitation`.
        damper: what takes the place of rho_cy; by default the vehicle's own. It may have lanes too.
        record: channels, from `railjax.CHANNELS`.
        shortest: shortest wavelength of a spectrum, m; by default 2.
        longest: longest wavelength of a spectrum, m; by default 200.
        points: number of waves between the two, evenly spaced in the logarithm, 16 or more; the 400 by default resolve 1 % of
            critical damping.

    Raises:
        NumericalError: for a single vehicle that is unstable at this speed.
        InputError: for an unknown channel or spectrum, a track that is not one realisation made of lines, and in single
            precision.
    """
    require_double_precision("the frequency response")
    record = tuple(check_linear_channel(name) for name in record)
    waves = waves_of(track, shortest, longest, points)
    frequency, transfer, growth = transfers(vehicle, speed, waves.wavenumber, damper, record)
    if not isinstance(growth, jax.core.Tracer) and growth.ndim == 0 and not float(growth) < 0.0:
        raise NumericalError(
            f"no stationary response: straight running is unstable at {float(speed) * KMH:.1f} km/h (largest growth rate {float(growth):.3g} 1/s)"
        )
    return FrequencyResponse(frequency, transfer, waves, growth, speed, vehicle.name)


def waves_of(track: object, shortest: Scalar, longest: Scalar, points: int) -> Excitation:
    """What `frequency_response` takes for a track, as waves."""
    if isinstance(track, Excitation):
        return track
    if isinstance(track, SampledTrack):
        return _lines_of(track)
    if points < 16:
        raise InputError(f"points must be at least 16, not {points}")
    return excitation(spectrum(track), shortest, longest, points)


def _lines_of(track: SampledTrack) -> Excitation:
    """The lines of a realisation, without those that hold nothing where that is known."""
    if not hasattr(track, "lines") or jnp.ndim(track.coefficients) > 1:
        raise InputError(f"track: {track} is not one realisation made of lines; give a RandomTrack of one seed, or a spectrum")
    wavenumber, lines = track.wavenumbers[1:], track.lines[1:]
    variance = 0.5 * _squared(lines)
    if not isinstance(variance, jax.core.Tracer):
        held = np.asarray(variance) > 1e-20 * np.max(variance)
        wavenumber, variance = wavenumber[held], variance[held]
    return Excitation(jnp.asarray(wavenumber), variance, variance / (track.wavenumbers[1]))


def transfers(
    vehicle: Vehicle, speed: Scalar, wavenumber: Float[Array, "waves"], damper: Damper, record: tuple[str, ...]
) -> tuple[Float[Array, "waves ..."], dict[str, Complex[Array, "waves ..."]], Float[Array, "..."]]:
    """Frequencies (Hz), transfer functions of the channels at wavenumbers (rad/m), and the largest growth rate (1/s)."""
    vehicle, damper = bare(vehicle, damper)
    batch = Batch.of(vehicle, as_numbers(speed), wavenumber, damper, own={2: 1})
    return batch.each(functools.partial(_transfers, record=record))


@functools.partial(jax.jit, static_argnames="record")
def _transfers(vehicle: Vehicle, speed: Scalar, wavenumber: Float[Array, "waves"], damper: Damper, record: tuple[str, ...]):
    return respond(vehicle, speed, wavenumber, damper, functools.partial(read_channels, record))


def read_channels(record: tuple[str, ...], instant: Motion) -> dict[str, Float[Array, "..."]]:
    """Channels by name, (*lanes) or (parts, *lanes), wheelsets as one axis n m; for one axis of lanes."""
    values = {name: CHANNELS[name].read(instant) for name in record}
    return {name: value.reshape((-1, value.shape[-1])) if value.ndim > 1 else value for name, value in values.items()}


def respond(vehicle: Vehicle, speed: Scalar, wavenumber: Float[Array, "waves"], damper: Damper, read, *, flange: bool = False):
    """`transfers` for any dict of quantities that `read` takes from a `Motion`; with `flange` as in `linearised`."""
    states, sound = state_size(vehicle, damper), ~no_number((vehicle, speed, wavenumber, damper))
    vehicle, speed, wavenumber, damper = without_nan((vehicle, speed, wavenumber, damper))
    rates, outputs = linearised(
        vehicle, speed, damper, lambda instant: (state_rate(vehicle, instant), read(instant)), flange=flange
    )
    sound &= jnp.all(jnp.isfinite(rates))
    rates = jnp.where(sound, rates, -jnp.eye(*rates.shape))
    positions = wheelset_positions(vehicle, jnp.zeros(wheelset_shape(vehicle))).reshape(-1)
    delays = jnp.exp(1j * wavenumber * positions[:, None])  # (wheelsets, waves)
    response, growth = resolvent(rates[:, :states], wavenumber * speed, rates[:, states:] @ delays)

    def of(columns: Float[Array, "... columns"]) -> Complex[Array, "waves ..."]:
        return jnp.moveaxis(columns[..., :states] @ response + columns[..., states:] @ delays, -1, 0)

    transfer = nan_unless(sound & (growth < 0.0), jax.tree.map(of, outputs))
    return (*nan_unless(sound, (wavenumber * speed / (2.0 * jnp.pi),)), transfer, nan_unless(sound, growth))


def resolvent(
    matrix: Float[Array, "states states"], omega: Float[Array, "waves"], right: Complex[Array, "states waves"]
) -> tuple[Complex[Array, "states waves"], Float[Array, ""]]:
    """(i w - E)^-1 b for every w (rad/s), each with its own b, and the largest real part of E's eigenvalues.

    One eigendecomposition serves all frequencies and both modes of differentiation (`custom_linear_solve`); a step of iterative
    refinement makes up for ill-conditioned eigenvectors.
    """
    values, vectors = eig(jax.lax.stop_gradient(matrix))
    inverse = jnp.linalg.inv(vectors)
    shifted = 1.0 / (1j * jax.lax.stop_gradient(omega) - values[:, None])

    def times(x: Complex[Array, "states waves"]) -> Complex[Array, "states waves"]:
        return 1j * omega * x - matrix @ x

    def refined(apply, residual_of, b):
        x = apply(b)
        return x + apply(b - residual_of(x))

    def solve(matvec, b):
        return refined(lambda b: vectors @ (shifted * (inverse @ b)), matvec, b)

    def transpose_solve(vecmat, b):
        return refined(lambda b: inverse.T @ (shifted * (vectors.T @ b)), vecmat, b)

    return jax.lax.custom_linear_solve(times, right, solve, transpose_solve), jnp.max(values.real)


def _squared(values: Complex[Array, "..."]) -> Float[Array, "..."]:
    return values.real**2 + values.imag**2


@jax.jit
def _of_frequency(
    density: Float[Array, "waves"], frequency: Float[Array, "waves ..."], speed: Float[Array, "..."]
) -> Float[Array, "waves ..."]:
    """A density over wavenumber as one over frequency."""
    return density.reshape((-1,) + (1,) * (frequency.ndim - 1)) * (2.0 * jnp.pi) / speed


@functools.partial(jax.jit, static_argnames="weight")
def _shares(
    transfer: Complex[Array, "waves ..."],
    frequency: Float[Array, "waves ..."],
    values: Float[Array, "waves ..."],
    weight: str | None,
) -> Float[Array, "waves ..."]:
    """|H|^2, weighted, times values of each wave, or of each wave in each lane."""

    def spread(values: Float[Array, "waves ..."]) -> Float[Array, "waves ..."]:
        return values.reshape((values.shape[0],) + (1,) * (transfer.ndim - values.ndim) + values.shape[1:])

    power = _squared(transfer)
    return (power if weight is None else power * spread(_squared(weighting(weight, frequency)))) * spread(values)


@functools.partial(jax.jit, static_argnames="weight")
def _rms(
    transfer: Complex[Array, "waves ..."],
    frequency: Float[Array, "waves ..."],
    variance: Float[Array, "waves"],
    weight: str | None,
) -> Float[Array, "..."]:
    return sqrt_of_square(jnp.sum(_shares(transfer, frequency, variance, weight), axis=0))
