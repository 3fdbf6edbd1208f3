"""Random tracks: seeded realisations of a spectrum of the lateral alignment."""

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Complex, Float

from ...base.checks import traced
from ...base.errors import InputError
from ...base.fields import parameter, structure
from ...base.typing import Scalar
from .sampled import MARGIN, SampledTrack, register
from .spectra import LONGEST, SHORTEST, Spectrum, spectrum

#: spacings of the spline in the shortest wavelength: 8 leave 5e-6 of the r.m.s. alignment of "erri-high" in images, 4 leave 1.3e-4
CELLS_PER_WAVE = 8

#: default period, m: 100 s at 360 km/h
LENGTH = 10e3

#: m; a longer period is a slip of units, and would fill the memory
FARTHEST = 1e6


@dataclass(frozen=True)
class RandomOptions:
    """What files and the command line may say of a random track."""

    spectrum: str = structure("erri-high", "name of a spectrum, or its file")
    seed: int = structure(0, "which realisation")
    length: float = parameter("m", "", "length after which it repeats itself", LENGTH, positive=True)
    amplitude: float = parameter("1", "a", "factor on the alignment", 1.0, signed=True)

    def track(self) -> "RandomTrack":
        """The realisation of these options."""
        return RandomTrack(self.spectrum, seed=self.seed, length=self.length, amplitude=self.amplitude)


class Recipe(NamedTuple):
    """What a realisation is made from."""

    spectrum: str
    seed: int | tuple[int, ...]
    shortest: float
    longest: float


@register
@dataclass(frozen=True, init=False, repr=False)
class RandomTrack(SampledTrack):
    """A realisation of a spectrum: η(s) = g(s) a Σ_k √(2 S(Ω_k) ΔΩ) cos(Ω_k s + φ_k), Ω_k = k ΔΩ, ΔΩ = 2π/length.

    The phases φ_k are uniform, from NumPy's PCG64, so a seed means the same track everywhere; the amplitudes are not random, so
    every band has its variance exactly, in every realisation. The waves are summed on points `shortest`/8 apart by FFT and
    carried by a cubic spline whose coefficients are divided by its own spectrum sinc⁴(Ω h/2π): every wave keeps its amplitude,
    and what the spline adds are images of it, below 6.2e-4 of the shortest wave's amplitude and 4e-5 of one's twice as long.

    In single precision the distance is rounded to 6e-8 of itself: the alignment is off by 0.1 µm after 1 km and by 5 µm after 100
    km. `scaled` gives the same track with another amplitude.

    Args:
        spectrum: a name ("erri-low", "erri-high", "fra-1" to "fra-6"), a CSV file, a function of Ω or a spectrum.
        seed: a whole number from 0 on, or several, which become lanes of a batch.
        length: beyond which the track repeats itself, m, rounded up; by default 10e3, 100 s at 360 km/h.
        amplitude: factor a, dimensionless, one or one per lane.
        shortest: shortest wavelength of the band, m; by default 2.
        longest: longest wavelength of the band, m; by default 200.
        fade: straight up to 0.4 of it, so that a run starts from rest, and full beyond it, m; 0 for full from the start.

    Raises:
        InputError: for unknown spectra, seeds that are no whole numbers, a band that is empty and a length that does not hold the
            longest wave five times.

    Examples:
        >>> track = RandomTrack("erri-high", seed=range(100))  # a hundred lanes  # doctest: +SKIP
    """

    def __init__(
        self,
        spectrum: str | Path | Callable | Spectrum = "erri-high",
        *,
        seed: ArrayLike | Sequence = 0,
        length: float = LENGTH,
        amplitude: Scalar = 1.0,
        shortest: float = SHORTEST,
        longest: float = LONGEST,
        fade: Scalar = 50.0,
    ) -> None:
        seeds = _seeds(seed)
        _check_band(length, shortest, longest)
        spacing = shortest / CELLS_PER_WAVE
        cells = _smooth_number(math.ceil(length / spacing))
        coefficients = _coefficients(spectrum, seeds, cells, spacing, shortest, longest)
        name = spectrum if isinstance(spectrum, str) else getattr(spectrum, "__name__", type(spectrum).__name__)
        self._set(
            coefficients=coefficients[:, 0] if np.ndim(seed) == 0 else coefficients,
            spacing=spacing,
            start=0.0,
            amplitude=amplitude,
            fade=None if isinstance(fade, int | float) and fade == 0 else fade,
            periodic=True,
            label=Recipe(str(name), seeds[0] if len(seeds) == 1 else seeds, shortest, longest),
        )

    def __str__(self) -> str:
        made = ""
        if self.label is not None:
            made = f" of {self.label.spectrum!r}, seed {self.label.seed}, wavelengths {self.label.shortest:g} to {self.label.longest:g} m"
        return f"RandomTrack{made}, period {self.length:g} m, points every {self.spacing:g} m"

    __repr__ = __str__

    @property
    def wavenumbers(self) -> Float[np.ndarray, "lines"]:
        """Ω_k = k ΔΩ, rad/m, k from 0 to half the number of cells: all lines that the table can hold."""
        cells = np.shape(self.coefficients)[0] - MARGIN
        return 2.0 * np.pi / (cells * self.spacing) * np.arange(cells // 2 + 1)

    @property
    def lines(self) -> Complex[Array, "lines *lanes"]:
        """Complex amplitudes c_k in m of the realisation, amplitude factor included, fade-in not: η(s) = Re Σ_k c_k exp(i Ω_k s).

        Lines outside the band are zero but for rounding. With them a frequency response gives the vehicle's motion on exactly this track.
        """
        table = jnp.asarray(self.coefficients)[:-MARGIN]
        cells = table.shape[0]
        lines = jnp.fft.rfft(jnp.roll(table, -1, axis=0), axis=0) * (2.0 / cells)
        response = jnp.asarray(np.sinc(np.arange(cells // 2 + 1) / cells) ** 4)
        return self.amplitude * lines * response.reshape((-1,) + (1,) * (table.ndim - 1))


def _seeds(seed: ArrayLike | Sequence) -> tuple[int, ...]:
    seeds = np.asarray(seed)
    if seeds.ndim > 1 or seeds.size == 0 or not np.issubdtype(seeds.dtype, np.integer) or np.any(seeds < 0):
        raise InputError(f"seed must be a whole number from 0 on, or several of them, not {seed!r}")
    return tuple(seeds.ravel().tolist())


def _check_band(length: float, shortest: float, longest: float) -> None:
    for key, value in (("length", length), ("shortest", shortest), ("longest", longest)):
        if not (isinstance(value, int | float) and math.isfinite(value) and value > 0):
            raise InputError(f"{key} must be a positive number of metres, not {value!r}")
    if not shortest < longest:
        raise InputError(f"the band is empty: shortest {shortest:g} m is not below longest {longest:g} m")
    if length > FARTHEST:
        raise InputError(f"length {length:g} m is more than any track; give at most {FARTHEST:g} m")
    if length < 5 * longest:
        raise InputError(f"length {length:g} m is too short for waves of {longest:g} m: give at least {5 * longest:g} m")


def _smooth_number(least: int) -> int:
    """The next even number whose FFT is fast."""
    from scipy.fft import next_fast_len

    return 2 * next_fast_len(-(-least // 2), real=True)


def _coefficients(
    source: str | Path | Callable | Spectrum,
    seeds: tuple[int, ...],
    cells: int,
    spacing: float,
    shortest: float,
    longest: float,
) -> Float[np.ndarray, "k seeds"]:
    of = spectrum(source)
    if traced(of):
        raise InputError("a random track takes a spectrum of plain numbers; differentiate with respect to its amplitude")
    try:
        return _synthesised(of, seeds, cells, spacing, shortest, longest)
    except TypeError:  # a spectrum of arrays has no hash
        return _synthesised.__wrapped__(of, seeds, cells, spacing, shortest, longest)


@functools.lru_cache(maxsize=8)
def _synthesised(
    of: Spectrum, seeds: tuple[int, ...], cells: int, spacing: float, shortest: float, longest: float
) -> Float[np.ndarray, "k seeds"]:
    """Coefficients of the spline, (cells + 3, seeds), m."""
    step = 2.0 * np.pi / (cells * spacing)
    low, high = 2.0 * np.pi / longest, 2.0 * np.pi / shortest
    numbers = np.arange(max(1, math.floor(low / step)), math.ceil(high / step) + 1)
    # the lines at the ends of the band stand for the part of their interval that is inside
    widths = np.minimum((numbers + 0.5) * step, high) - np.maximum((numbers - 0.5) * step, low)
    numbers, widths = numbers[widths > 0], widths[widths > 0]
    # double precision, whatever the user's, and numbers rather than tracers under `jit`
    with jax.ensure_compile_time_eval(), jax.enable_x64(True):
        density = np.asarray(of.density(numbers * step), float)
    bad = np.flatnonzero(~(np.isfinite(density) & (density >= 0)))
    if density.shape != numbers.shape or bad.size:
        what = f"at {numbers[bad[0]] * step:.4g} rad/m it is {density[bad[0]]:g}" if bad.size else f"not of shape {density.shape}"
        raise InputError(f"the spectrum's density must be finite and not negative, one value per wavenumber; {what}")
    amplitudes = np.sqrt(2.0 * density * widths)
    table = np.empty((cells + MARGIN, len(seeds)))
    for lane, seed in enumerate(seeds):
        phases = np.random.Generator(np.random.PCG64(seed)).uniform(0.0, 2.0 * np.pi, numbers.size)
        lines = np.zeros(cells // 2 + 1, complex)
        lines[numbers] = 0.5 * cells * amplitudes * np.exp(1j * phases) / np.sinc(numbers / cells) ** 4
        table[:, lane] = np.fft.irfft(lines, cells)[np.arange(-1, cells + MARGIN - 1) % cells]
    table.setflags(write=False)  # shared by all tracks of this recipe
    return table
