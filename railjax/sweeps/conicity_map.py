"""Equivalent conicity of a pair of profiles as a study for `sweep`: a conicity map over gauge, inclination, wheels of unlike diameter."""

from dataclasses import dataclass
from enum import IntEnum
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array

from ..base.arguments import guarded
from ..base.batches import Batch
from ..base.checks import Range
from ..base.fields import parameter
from ..base.precision import require_double_precision
from ..base.typing import Scalar
from ..model.contact.conicity import equivalent_conicity, nonlinearity_parameter
from ..model.contact.geometry import contact_geometry
from ..model.contact.placing import NUMBERS, over_flanges
from ..model.contact.profiles import RailProfile, WheelProfile

#: points computed together: the places along a wheel of one are thousands of numbers
TOGETHER = 8
#: m from the back of the flange
TREAD_DATUM = 0.07


_NUMBERS = {name: rule for name, rule in NUMBERS.items() if name != "tread_datum"}


class Fit(IntEnum):
    """Whether a wheelset fits between the rails, and has a wave of the amplitude."""

    OK = 0
    DOES_NOT_FIT = 1
    NO_WAVE = 2


@dataclass(frozen=True)
class EquivalentConicity:
    """tan gamma_e (EN 15302) at `amplitude` (m) and the nonlinearity parameter between 2 and 4 mm, of a `wheel` on a `rail`: names of
    packaged profiles or files.

    Its arguments vary in a sweep: `gauge` and `flange_back` (m), `inclination` (1/40), `radius_difference` (m, right less left) and
    `radius` (m, mean). Points where the flanges do not fit between the rails, or without a wave of that amplitude, say so by their code.

    >>> railjax.sweep(  # doctest: +SKIP
    ...     railjax.EquivalentConicity("S1002", "60E1"),
    ...     over={"gauge": np.linspace(1.430, 1.440, 11), "inclination": [1 / 40, 1 / 20]},
    ... )["equivalent_conicity"].plot()
    """

    wheel: str = "S1002"
    rail: str = "60E1"
    amplitude: float = parameter("m", "", "half the width of the wheelset's wave", 3e-3, positive=True)

    units: ClassVar[dict[str, str]] = {
        "equivalent_conicity": "1",
        "nonlinearity": "1/m",
        "gauge": "m",
        "flange_back": "m",
        "inclination": "1",
        "radius": "m",
        "radius_difference": "m",
    }
    codes: ClassVar[type[IntEnum]] = Fit
    chunk: ClassVar[int] = 64

    @guarded(radius_difference=Range("m", -0.1, 0.1, axes=1, why="; is it in millimetres?"), **_NUMBERS)
    def __call__(
        self,
        gauge: Scalar = 1.435,
        inclination: Scalar = 1 / 40,
        flange_back: Scalar = 1.36,
        radius: Scalar = 0.46,
        radius_difference: Scalar = 0.0,
    ) -> dict[str, Array]:
        """All lanes, some together."""
        require_double_precision("an equivalent conicity")
        profiles = WheelProfile.load(self.wheel), RailProfile.load(self.rail)
        numbers = self.amplitude, gauge, inclination, flange_back, radius, radius_difference
        conicity, nonlinearity = _at_points(jax.tree.map(jnp.asarray, (profiles, *numbers)))
        base = 0.5 * jnp.asarray(flange_back) + TREAD_DATUM
        fits, wave = over_flanges((profiles[0],) * 2, (base, base)) < jnp.asarray(gauge), jnp.isfinite(conicity)
        code = jnp.where(fits, jnp.where(wave, int(Fit.OK), int(Fit.NO_WAVE)), int(Fit.DOES_NOT_FIT))
        found = {"equivalent_conicity": conicity, "nonlinearity": nonlinearity}
        return {name: jnp.where(fits, values, jnp.nan) for name, values in found.items()} | {"code": code}


@jax.jit
def _at_points(trees: tuple) -> tuple[Array, Array]:
    own = {0: jax.tree.map(jnp.ndim, trees[0])}

    def single(
        profiles: Any, amplitude: Scalar, gauge: Scalar, inclination: Scalar, back: Scalar, radius: Scalar, difference: Scalar
    ) -> Any:
        radii = radius + 0.5 * difference, radius - 0.5 * difference
        found = contact_geometry(
            *profiles, gauge=gauge, inclination=inclination, flange_back=back, radius=radii, tread_datum=TREAD_DATUM
        )
        wave = found.y, found.delta_r
        return equivalent_conicity(*wave, amplitude, radius=radius), nonlinearity_parameter(*wave, radius=radius)

    batch = Batch.of(*trees, own=own)
    if batch.lanes is None:
        return single(*trees)
    return batch.in_chunks(lambda *chunk: Batch.of(*chunk, own=own).each(single), TOGETHER)
