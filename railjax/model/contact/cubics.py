"""Tables of cubics over equal steps: a row of powers for each interval, from values and slopes at its ends (Hermite)."""

from types import ModuleType

from ...base.typing import Values


def cubic_rows(xp: ModuleType, values: Values, slopes: Values, axis: int = -1) -> Values:
    """Coefficients of each interval in powers of (y - y_i)/step, from 0 on, along a new `axis`; intervals first.

    Args:
        xp: numpy or jax.numpy.
        values: at the ends of the intervals, along the first axis, in any unit.
        slopes: there, times the step, in that unit.
        axis: of the powers.
    """
    low, high, out, into = values[:-1], values[1:], slopes[:-1], slopes[1:]
    return xp.stack([low, out, 3.0 * (high - low) - 2.0 * out - into, 2.0 * (low - high) + out + into], axis=axis)
