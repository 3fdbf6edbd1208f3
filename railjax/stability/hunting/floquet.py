"""Floquet multipliers of a limit cycle: whether nearby motions come back to it."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from .orbits import Shooting


class Floquet(NamedTuple):
    """Floquet multipliers of the whole period, and what they say."""

    multipliers: Complex[np.ndarray, "states"]  # the trivial one first, then by falling magnitude
    error: float  # |mu_1 - 1|: the trivial multiplier's distance from 1, the error bar of the others
    half: Complex[np.ndarray, "states"]  # of the half period with mirror, in the same order (whole period if not symmetric)

    @property
    def largest(self) -> float:
        """Magnitude of the largest multiplier but the trivial one."""
        return float(np.abs(self.multipliers[1])) if len(self.multipliers) > 1 else 0.0

    @property
    def stable(self) -> bool:
        """Whether nearby motions come back to the orbit."""
        return self.largest < 1.0 - 1e-9  # neither at a fold nor at the Hopf point


def floquet(shooting: Shooting, half: Complex[np.ndarray, "states"]) -> Floquet:
    """Multipliers from the eigenvalues of the monodromy matrix, of which a symmetric orbit has that of half a period."""
    trivial = int(np.argmin(np.abs(half - 1.0)))
    rest = np.delete(half, trivial)
    half = np.concatenate([half[trivial : trivial + 1], rest[np.argsort(-np.abs(rest), kind="stable")]])
    multipliers = half**2 if shooting.symmetric else half
    return Floquet(multipliers, float(abs(multipliers[0] - 1.0)), half)


def multipliers_of(shooting: Shooting, monodromy: Float[np.ndarray, "states states"]) -> Floquet:
    """Multipliers from the monodromy matrix."""
    return floquet(shooting, np.linalg.eigvals(monodromy).astype(complex))
