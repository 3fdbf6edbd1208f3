"""The Hopf point's normal form: the first Lyapunov coefficient of a smooth vehicle."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from ...base.arguments import guarded
from ...base.errors import InputError
from ...base.precision import require_double_precision
from ...base.typing import Scalar
from ...model.damper import Damper
from ...model.motion import PASSIVE, motion, state_matrix, state_rate, wheelset_shape
from ...model.parameters import without_labels
from ...model.vehicle import Vehicle
from ..linear_critical import LinearCritical, linear_critical


@guarded()
def first_lyapunov_coefficient(vehicle: Vehicle, damper: Damper = PASSIVE, hopf: LinearCritical | None = None) -> float:
    """l_1 (1/s): near the Hopf point |z|' = Re(lambda)|z| + l_1 |z|³, with x = z q + its conjugate and |q| scaled below.

    Negative is supercritical (stable limit cycles above the critical speed), positive subcritical. With A = E at the Hopf point,
    A q = i omega q, p^H A = i omega p^H, p^H q = 1, and B, C the second and third derivatives of x' (Kuznetsov, Elements of
    Applied Bifurcation Theory, sec. 5.4, without the factor 1/omega):

        l_1 = Re(p^H [C(q, q, q*) - 2 B(q, A^-1 B(q, q*)) + B(q*, (2 i omega - A)^-1 B(q, q))])/2

    q is scaled to 1 m of lateral displacement where that is largest, so that the amplitude is 2|z|. The formula holds for
    saturations u well below `creep_width`.

    Args:
        vehicle: a single vehicle with the smooth creep law: the Vermeulen-Johnson law has no third derivative at zero creep.
        damper: what takes the place of rho_cy; by default the vehicle's own.
        hopf: the Hopf point, where it is known already; by default what `linear_critical` finds.

    Raises:
        InputError: for other creep laws, and in single precision.
    """
    require_double_precision("the first Lyapunov coefficient")
    if vehicle.contact.law != "smooth":
        raise InputError(
            f'the first Lyapunov coefficient needs contact.law = "smooth", not "{vehicle.contact.law}": the Vermeulen-Johnson law '
            "has a kink at zero creep, which makes amplitude grow in proportion to the speed difference"
        )
    if vehicle.profiles is not None:
        raise InputError(
            "the first Lyapunov coefficient needs third derivatives, which the table of profiles has not; draw hunting_branch"
        )
    hopf = linear_critical(vehicle, damper=damper) if hopf is None else hopf
    speed, omega = float(hopf.speed), 2.0 * np.pi * float(hopf.frequency)
    matrix = np.asarray(state_matrix(vehicle, speed, damper))
    from scipy.linalg import eig

    values, left, right = eig(matrix, left=True, right=True)
    mode = int(np.argmin(np.abs(values - 1j * omega)))
    q = right[:, mode] / right[:, mode][np.argmax(np.abs(right[: len(right) // 2, mode]))]
    p = left[:, mode] / np.vdot(q, left[:, mode])
    cubic, square, mean = (np.asarray(value) for value in _derivatives(without_labels(vehicle), damper, speed, q))
    solved = np.linalg.solve(matrix, mean), np.linalg.solve(2j * omega * np.eye(len(q)) - matrix, square)
    bent = _products(without_labels(vehicle), damper, speed, q, *solved)
    return float(np.vdot(p, cubic - 2.0 * np.asarray(bent[0]) + np.asarray(bent[1])).real) / 2.0


def _rate(vehicle: Vehicle, damper: Damper, speed: Scalar, x: Array) -> Array:
    alignment = jnp.zeros(wheelset_shape(vehicle))
    return state_rate(vehicle, motion(vehicle, damper, 1.0 / jnp.asarray(speed), alignment, x))


def _second(vehicle: Vehicle, damper: Damper, speed: Scalar, one: Array, other: Array, x: Array | None = None) -> Array:
    """B(one, other) of real vectors, at rest or at x."""

    def first(x: Array) -> Array:
        return jax.jvp(lambda x: _rate(vehicle, damper, speed, x), (x,), (one,))[1]

    return jax.jvp(first, (jnp.zeros_like(one) if x is None else x,), (other,))[1]


def _second_complex(vehicle: Vehicle, damper: Damper, speed: Scalar, one: Array, other: Array) -> Array:
    """B of complex vectors, by its linearity in both."""
    product = functools.partial(_second, vehicle, damper, speed)
    real = product(one.real, other.real) - product(one.imag, other.imag)
    return real + 1j * (product(one.real, other.imag) + product(one.imag, other.real))


def _third(vehicle: Vehicle, damper: Damper, speed: Scalar, one: Array, other: Array) -> Array:
    """C(one, one, other) of real vectors."""

    second = functools.partial(_second, vehicle, damper, speed, one, one)
    return jax.jvp(second, (jnp.zeros_like(one),), (other,))[1]


@jax.jit
def _derivatives(
    vehicle: Vehicle, damper: Damper, speed: Scalar, q: Complex[Array, "states"]
) -> tuple[Complex[Array, "states"], Complex[Array, "states"], Complex[Array, "states"]]:
    """C(q, q, q*), B(q, q) and B(q, q*)."""
    third = functools.partial(_third, vehicle, damper, speed)
    a, b = q.real, q.imag
    # C(q, q, q*) = C(a,a,a) + C(b,b,a) + i (C(a,a,b) + C(b,b,b)), for q = a + i b
    cubic = third(a, a) + third(b, a) + 1j * (third(a, b) + third(b, b))
    square = _second_complex(vehicle, damper, speed, q, q)
    return cubic, square, _second_complex(vehicle, damper, speed, q, q.conj())


@jax.jit
def _products(
    vehicle: Vehicle,
    damper: Damper,
    speed: Scalar,
    q: Complex[Array, "states"],
    mean: Float[Array, "states"] | Complex[Array, "states"],
    double: Complex[Array, "states"],
) -> tuple[Complex[Array, "states"], Complex[Array, "states"]]:
    """B(q, A^-1 B(q, q*)) and B(q*, (2 i omega - A)^-1 B(q, q))."""
    product = functools.partial(_second_complex, vehicle, damper, speed)
    return product(q, mean), product(q.conj(), double)
