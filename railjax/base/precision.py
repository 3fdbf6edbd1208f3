"""Double precision: never switched on by import, asked for by the user, demanded where float32 would mislead."""

import jax

from .errors import InputError


def use_double_precision() -> None:
    """Switch JAX to float64 for the whole process (`jax_enable_x64`); call it before building any array.

    Stability margins, limit cycles and gradients of critical speeds need it: the eigenvalues of a vehicle spread over
    four decades and their real parts cross zero slowly, so float32 moves a critical speed by up to 1 km/h.
    """
    jax.config.update("jax_enable_x64", True)


def require_double_precision(what: str) -> None:
    """Refuse float32 for `what`, naming the fix."""
    if not jax.config.jax_enable_x64:
        raise InputError(f"{what} needs double precision: call railjax.use_double_precision() first")
