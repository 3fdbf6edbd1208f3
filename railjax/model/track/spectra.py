"""Spectra of lateral alignment: one-sided densities S(Ω) in m²/(rad/m) over the wavenumber Ω = 2π/L in rad/m.

The variance of the alignment between two wavenumbers is the integral of S. A spectrum is a pytree with one method,
`density(wavenumber)`, differentiable in its parameters.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from ...base.arguments import guarded
from ...base.checks import positive, shown, traced
from ...base.csv_columns import IN_PYTHON, read_columns
from ...base.errors import InputError, closest
from ...base.fields import check_numbers, parameter, structure, table
from ...base.pytrees import registered
from ...base.text_table import is_table
from ...base.typing import Number, Scalar

Wavenumbers = Float[Array, "..."] | Float[np.ndarray, "..."] | float

#: the band of the irregularities that act on lateral dynamics, wavelengths in m; shorter ones are corrugation and longer ones layout
SHORTEST, LONGEST = 2.0, 200.0

WAVENUMBER = positive("rad/m", axes=9)


@runtime_checkable
class Spectrum(Protocol):
    """What a random track asks of a spectrum."""

    def density(self, wavenumber: Wavenumbers) -> Wavenumbers:
        """S(Ω) in m²/(rad/m), one-sided, at Ω = `wavenumber` in rad/m."""
        ...


@registered
@dataclass(frozen=True)
class ErriSpectrum:
    """ERRI B176 (the "German" spectrum): S = A Ωc²/((Ω² + Ωr²)(Ω² + Ωc²)).

    A = 2.119e-7 (low disturbance) and 6.125e-7 m rad (high), Ωc = 0.8246, Ωr = 0.0206 rad/m: recalled values of ERRI B176.
    """

    roughness: Number = parameter("m rad", "A", "roughness of the alignment", positive=True)
    corner: Number = parameter(
        "rad/m", "Ωc", "wavenumber above which the density falls with the fourth power", 0.8246, positive=True
    )
    long_corner: Number = parameter("rad/m", "Ωr", "wavenumber below which the density is flat", 0.0206, positive=True)

    @guarded(wavenumber=WAVENUMBER._replace(open=False))
    def density(self, wavenumber: Wavenumbers) -> Wavenumbers:
        """S(Ω), m²/(rad/m), at Ω = `wavenumber`, rad/m."""
        w, c, r = wavenumber**2, self.corner**2, self.long_corner**2
        return self.roughness * c / ((w + r) * (w + c))

    @guarded(("low", "high"), low=WAVENUMBER, high=WAVENUMBER)
    def variance(self, low: Scalar, high: Scalar) -> Float[Array, "..."]:
        """Integral of S from `low` to `high` (rad/m) in m², by partial fractions: A Ωc²/(Ωc² - Ωr²) [atan(Ω/Ωr)/Ωr - atan(Ω/Ωc)/Ωc]."""
        c, r = self.corner, self.long_corner
        low, high = jnp.asarray(low, float), jnp.asarray(high, float)
        of_corners = _arc(low, high, r) / r - _arc(low, high, c) / c
        return self.roughness * c**2 / (c**2 - r**2) * of_corners


@registered
@dataclass(frozen=True)
class FraSpectrum:
    """Federal Railroad Administration (Hamid and others, 1983): S = k A Ωc²/(Ω² (Ω² + Ωc²)), k = 0.25, Ωc = 0.8245 rad/m.

    A in m² rad/m for track classes 1 (worst) to 6: see `spectrum`. The density has no finite variance as Ω goes to 0.
    """

    roughness: Number = parameter("m^2 rad/m", "A", "roughness of the alignment", positive=True)
    corner: Number = parameter(
        "rad/m", "Ωc", "wavenumber above which the density falls with the fourth power", 0.8245, positive=True
    )
    factor: Number = parameter("1", "k", "factor of the class spectra", 0.25, positive=True)

    @guarded(wavenumber=WAVENUMBER)
    def density(self, wavenumber: Wavenumbers) -> Wavenumbers:
        """S(Ω), m²/(rad/m), at Ω = `wavenumber`, rad/m."""
        w, c = wavenumber**2, self.corner**2
        return self.factor * self.roughness * c / (w * (w + c))

    @guarded(("low", "high"), low=WAVENUMBER, high=WAVENUMBER)
    def variance(self, low: Scalar, high: Scalar) -> Float[Array, "..."]:
        """Integral of S from `low` to `high` (rad/m) in m²: k A [-1/Ω - atan(Ω/Ωc)/Ωc]."""
        low, high = jnp.asarray(low, float), jnp.asarray(high, float)
        return self.factor * self.roughness * (1.0 / low - 1.0 / high - _arc(low, high, self.corner) / self.corner)


def _arc(low: Float[Array, "..."], high: Float[Array, "..."], corner: Scalar) -> Float[Array, "..."]:
    """atan(high/corner) - atan(low/corner), without loss where both are large."""
    return jnp.arctan2((high - low) * corner, corner**2 + low * high)


@registered
@dataclass(frozen=True)
class TableSpectrum:
    """A spectrum given by points, straight lines between them in log S over log Ω; zero outside the table.

    `wavenumber` (rad/m, rising, at least two) and density `values` (m²/(rad/m), positive). Bad tables are refused by `checked`, and by
    `spectrum` and what uses it, random tracks among them.
    """

    wavenumber: Number = table("rad/m", "Ω", "wavenumbers of the table")
    values: Number = table("m^2/(rad/m)", "S", "densities of the table")

    @classmethod
    def checked(cls, wavenumber: ArrayLike | Sequence, density: ArrayLike | Sequence) -> "TableSpectrum":
        """A table of `density` (m²/(rad/m)) over `wavenumber` (rad/m), as `InputError` lets it pass: as many of each, at least two, finite, positive, wavenumbers rising."""
        w, s = (np.asarray(values, float) for values in (wavenumber, density))
        if w.ndim != 1 or w.shape != s.shape or w.size < 2:
            raise InputError(
                f"a spectrum's table takes at least two wavenumbers and as many densities, not {w.shape} and {s.shape}"
            )
        for name, values in (("wavenumber", w), ("density", s)):
            bad = np.flatnonzero(~(np.isfinite(values) & (values > 0)))
            if bad.size:
                raise InputError(f"spectrum: {name} must be positive and finite; point {bad[0] + 1} is {values[bad[0]]:g}")
        falls = np.flatnonzero(np.diff(w) <= 0)
        if falls.size:
            raise InputError(f"spectrum: the wavenumbers must rise; they do not from point {falls[0] + 1} to the next")
        return cls(w, s)

    @classmethod
    def from_csv(
        cls, path: str | Path, *, columns: Mapping[str, str] | None = None, units: Mapping[str, str] | None = None
    ) -> "TableSpectrum":
        """A table from a file with columns "wavenumber" (or "frequency", 1/m) and "density".

        Args:
            path: the file, of any separator, decimal mark and encoding.
            columns: name, or number from 1, of the columns of "wavenumber" and "density"; what is not named is looked up in the
                header.
            units: unit of each, "rad/m", "1/m" or "cycles/m" and "mm^2/(rad/m)" or the like; by default as the header says it.

        Raises:
            InputError: for a file that cannot be read, a column that is missing or does not say its unit, and a table that
                `checked` refuses.

        Examples:
            >>> TableSpectrum.from_csv("line.csv")  # wavenumber (rad/m),density (mm^2/(rad/m))  # doctest: +SKIP
        """
        path = Path(path)
        read = read_columns(
            path,
            NAMES,
            UNITS,
            columns=columns,
            given=units,
            purpose="make a spectrum",
            options=IN_PYTHON,
        )
        for kind in NAMES:
            if kind not in read.found:
                raise InputError(
                    f"{path}: no column of the {kind}; name it {' or '.join(NAMES[kind])} in the header; {read.there}"
                )
            if kind in read.assumed:
                raise InputError(
                    f"{path}: column {read.assumed[kind]!r} does not say its unit, as in '{kind} ({next(iter(UNITS[kind]))})'"
                )
        try:
            return cls.checked(read.found["wavenumber"], read.found["density"])
        except InputError as error:
            raise InputError(f"{path}: {error}") from None

    @guarded(wavenumber=WAVENUMBER._replace(open=False))
    def density(self, wavenumber: Wavenumbers) -> Float[Array, "..."]:
        """S(Ω), m²/(rad/m), at Ω = `wavenumber`, rad/m."""
        w = jnp.asarray(wavenumber)
        table_w, table_s = jnp.asarray(self.wavenumber), jnp.asarray(self.values)
        inside = (w >= table_w[0]) & (w <= table_w[-1])
        within = jnp.where(inside, w, table_w[0])
        beyond = jnp.where(jnp.isnan(w + table_w[0] + table_w[-1]), jnp.nan, 0.0)
        return jnp.where(inside, jnp.exp(jnp.interp(jnp.log(within), jnp.log(table_w), jnp.log(table_s))), beyond)


#: columns of a spectrum's file, and the factors of their units to rad/m and m²/(rad/m)
NAMES = {
    "wavenumber": ("wavenumber", "omega", "frequency", "spatial frequency"),
    "density": ("density", "psd", "s", "spectrum"),
}
_CYCLE = 2.0 * np.pi
UNITS = {
    "wavenumber": {"rad/m": 1.0, "1/m": _CYCLE, "cycles/m": _CYCLE},
    "density": {
        **{f"{unit}^2/(rad/m)": factor**2 for unit, factor in (("m", 1.0), ("mm", 1e-3), ("cm", 1e-2))},
        **{
            f"{unit}^2/({per})": factor**2 / _CYCLE
            for per in ("1/m", "cycles/m")
            for unit, factor in (("m", 1.0), ("mm", 1e-3), ("cm", 1e-2))
        },
    },
}


@registered
@dataclass(frozen=True)
class FormulaSpectrum:
    """A spectrum by a function of the user: Ω in rad/m to S in m²/(rad/m), in JAX or NumPy."""

    formula: Callable = structure(None)

    @guarded(wavenumber=WAVENUMBER._replace(open=False))
    def density(self, wavenumber: Wavenumbers) -> Float[Array, "..."]:
        """S(Ω), m²/(rad/m), at Ω = `wavenumber`, rad/m."""
        return jnp.asarray(self.formula(jnp.asarray(wavenumber)))


#: name -> spectrum. ERRI B176 and FRA classes 5 and 6 as the literature commonly gives them; classes 1 to 4 recalled (A in cm² rad/m
#: 3.3634, 1.2107, 0.4128, 0.3027), as tables of the "American spectrum" print them; none could be opened at its source
NAMED: dict[str, Spectrum] = {
    "erri-low": ErriSpectrum(2.119e-7),
    "erri-high": ErriSpectrum(6.125e-7),
    "fra-1": FraSpectrum(3.3634e-4),
    "fra-2": FraSpectrum(1.2107e-4),
    "fra-3": FraSpectrum(0.4128e-4),
    "fra-4": FraSpectrum(0.3027e-4),
    "fra-5": FraSpectrum(0.0762e-4),
    "fra-6": FraSpectrum(0.0339e-4),
}


def a_source(key: str, value: Any) -> None:
    """A spectrum or what makes one."""
    if not isinstance(value, (str, Path, Spectrum)) and not callable(value):
        raise InputError(
            f"{key} must be a spectrum: {', '.join(NAMED)}, a .csv file or a function of the wavenumber, not {shown(value)}"
        )


@guarded(source=a_source)
def spectrum(source: str | Path | Callable | Spectrum) -> Spectrum:
    """The spectrum of a name ("erri-low", "erri-high", "fra-1" to "fra-6"), a CSV file (`TableSpectrum.from_csv`), a function of Ω
    (`FormulaSpectrum`), or itself.

    Raises `InputError` for an unknown name (with the nearest one), a bad file, a bad table and parameters that are not positive.
    """
    if isinstance(source, Spectrum):
        check_spectrum(source)
        return source
    if callable(source):
        return FormulaSpectrum(source)
    if str(source) in NAMED:
        return NAMED[str(source)]
    if isinstance(source, Path) or is_table(str(source)):
        return TableSpectrum.from_csv(source)
    near = closest(source, NAMED)
    raise InputError(f"no spectrum {source!r}; the nearest is {near!r} (known: {', '.join(NAMED)}, or a .csv file)")


def variance(of: Spectrum, low: float, high: float) -> Float[Array, ""]:
    """Variance of the alignment (m²) between two wavenumbers (rad/m): in closed form where the spectrum has one, else by
    Simpson's rule over log Ω."""
    if hasattr(of, "variance"):
        return of.variance(low, high)
    w = jnp.geomspace(low, high, 4001)
    weights = jnp.full(4001, 2.0).at[1::2].set(4.0).at[jnp.array([0, -1])].set(1.0)
    return jnp.sum(weights * of.density(w) * w) * jnp.log(high / low) / (3 * 4000)


def check_spectrum(of: Spectrum) -> None:
    """Refuse parameters that are not finite and positive, and bad tables, where they are known. Raises `InputError`."""
    if traced(of):
        return
    if isinstance(of, TableSpectrum):
        TableSpectrum.checked(of.wavenumber, of.values)
    elif dataclasses.is_dataclass(of):
        check_numbers(of, "spectrum", undeclared="anything")
