"""Frequency weightings of vibration on man: ISO 2631-1, EN 12299, Sperling; analogue responses and digital filters."""

import functools
import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Complex, Float

from ..base.arguments import guarded
from ..base.errors import InputError, closest


class Weighting(NamedTuple):
    """Parameters of a weighting in the notation of ISO 8041: frequencies in Hz; an infinite one leaves its factor out."""

    use: str
    f1: float = 0.4
    f2: float = 100.0
    f3: float = math.inf
    f4: float = math.inf
    q4: float = 1.0
    f5: float = math.inf
    q5: float = 1.0
    f6: float = math.inf
    q6: float = 1.0
    gain: float = 1.0


#: published: table 3 of ISO 8041 (as reprinted in a maker's manual) and, for Wb, EN 12299 (as reprinted in an open
#: implementation); "Wb-iso" is that of ISO 2631-4 and BS 6841. Butterworth corners have Q1 = Q2 = 1/sqrt 2.
WEIGHTINGS: dict[str, Weighting] = {
    "Wk": Weighting("vertical, seat (ISO 2631-1)", f3=12.5, f4=12.5, q4=0.63, f5=2.37, q5=0.91, f6=3.35, q6=0.91),
    "Wd": Weighting("lateral and longitudinal (ISO 2631-1, EN 12299)", f3=2.0, f4=2.0, q4=0.63),
    "Wf": Weighting("motion sickness, vertical", f1=0.08, f2=0.63, f4=0.25, q4=0.86, f5=0.0625, q5=0.80, f6=0.1, q6=0.80),
    "Wc": Weighting("longitudinal, seat back (ISO 2631-1, EN 12299)", f3=8.0, f4=8.0, q4=0.63),
    "We": Weighting("rotation (ISO 2631-1)", f3=1.0, f4=1.0, q4=0.63),
    "Wj": Weighting("vertical, head of a recumbent person (ISO 2631-1)", f5=3.75, q5=0.91, f6=5.32, q6=0.91),
    "Wb": Weighting("vertical (EN 12299)", f3=16.0, f4=16.0, q4=0.63, f5=2.5, q5=0.8, f6=4.0, q6=0.8, gain=1.024),
    "Wb-iso": Weighting(
        "vertical, fixed guideways (ISO 2631-4)", f3=16.0, f4=16.0, q4=0.55, f5=2.5, q5=0.9, f6=4.0, q6=0.95, gain=1.024
    ),
}

#: name -> factor of Sperling's B(f); vertical is 0.588/0.737 of the lateral one
SPERLING = {"sperling-lateral": 0.737, "sperling-vertical": 0.588}


def check_weighting(name: str) -> str:
    """The name itself, or an `InputError` with the nearest one."""
    known = [*WEIGHTINGS, *SPERLING]
    if name not in known:
        near = closest(name, known)
        raise InputError(f"unknown weighting {name!r}; did you mean {near!r}? there are {', '.join(known)}")
    return name


def factors(name: str) -> list[tuple[tuple[float, float, float], tuple[float, float, float]]]:
    """The analogue filter as factors of second order: (numerator, denominator), each (b2, b1, b0) of b2 s^2 + b1 s + b0.

    With w = 2 pi f of each parameter:
        high-pass   s^2 / (s^2 + sqrt2 w1 s + w1^2),          low-pass  w2^2 / (s^2 + sqrt2 w2 s + w2^2),
        transition  (1 + s/w3) / (1 + s/(Q4 w4) + (s/w4)^2),  step  (s^2 + w5 s/Q5 + w5^2) / (s^2 + w6 s/Q6 + w6^2),
    times K (ISO 2631-1:1997 annex A; ISO 8041). EN 12299 writes the step with both polynomials divided by their constant, so
    that its K of Wb is (w5/w6)^2 of this one: 0.4 there, 1.024 here.
    """
    p = WEIGHTINGS[name]
    w1, w2, w3, w4, w5, w6 = (2.0 * math.pi * f for f in (p.f1, p.f2, p.f3, p.f4, p.f5, p.f6))
    root = math.sqrt(2.0)
    found = [
        ((p.gain, 0.0, 0.0), (1.0, root * w1, w1**2)),
        ((0.0, 0.0, 1.0), (w2**-2, root / w2, 1.0)),
    ]
    if math.isfinite(p.f4):
        found.append(((0.0, 1.0 / w3, 1.0), (w4**-2, 1.0 / (p.q4 * w4), 1.0)))
    if math.isfinite(p.f5):
        found.append(((1.0, w5 / p.q5, w5**2), (1.0, w6 / p.q6, w6**2)))
    return found


@guarded()
def weighting(name: str, frequency: ArrayLike) -> Complex[Array, "..."]:
    """Complex response of a frequency weighting at frequencies in Hz, of the same shape.

    `name`: "Wk", "Wd", "Wf", "Wc", "We", "Wj" (ISO 2631-1), "Wb" (EN 12299), "Wb-iso" (ISO 2631-4), in the analogue form of
    the standards (see `factors`); or "sperling-lateral", "sperling-vertical", which are real (a modulus has no phase):

        B(f) = c sqrt((1.911 f^2 + (0.25 f^2)^2) / ((1 - 0.277 f^2)^2 + (1.563 f - 0.0368 f^3)^2)),

    c = 0.737 lateral and 0.588 vertical (published; some codes have 0.735). Differentiable in the frequency; `jnp.abs` of it is
    the weighting factor of the standards' tables: ISO 2631-1:1997 prints it at the rounded third octaves (0.16, 1.25 ...),
    ISO 8041 at f = 10^(n/10) Hz. Raises `InputError` for an unknown name.
    """
    check_weighting(name)
    return _weighting(name, jnp.asarray(frequency, float))


@functools.partial(jax.jit, static_argnums=0)
def _weighting(name: str, f: Float[Array, "..."]) -> Complex[Array, "..."]:
    if name in SPERLING:
        below = (1.0 - 0.277 * f**2) ** 2 + (1.563 * f - 0.0368 * f**3) ** 2
        # |f| drawn out of the root, whose slope is infinite at 0
        return SPERLING[name] * jnp.abs(f) * jnp.sqrt((1.911 + (0.25 * f) ** 2) / below) + 0j
    s = 2j * jnp.pi * f
    response = jnp.ones_like(s)
    for (b2, b1, b0), (a2, a1, a0) in factors(name):
        response = response * ((b2 * s + b1) * s + b0) / ((a2 * s + a1) * s + a0)
    return response


#: how far a digital weighting may be from the analogue one, and up to which frequency (Hz)
TOLERANCE, UP_TO = 5e-3, 40.0


@guarded()
def weighting_filter(name: str, sampling_rate: float | int) -> Float[np.ndarray, "sections 6"]:
    """A weighting of ISO 2631-1 or EN 12299 as second-order sections for `scipy.signal.sosfilt(sections, record, axis=0)`.

    `sampling_rate` in Hz. Up to 40 Hz the modulus follows the analogue form to 0.5 %, which is measured at each call: about
    0.17 % at 200 Hz, 0.004 % at 500 Hz and 0.0003 % at 1 kHz (the bilinear transform alone: 14, 2.2 and 0.55 %). 160 Hz is
    enough for any weighting; at 100 Hz the deviation is 4 %, and the rate is refused: `weighted_acceleration`, in the
    frequency domain, holds at any rate. The phase is ahead of the analogue one by about a sample at all frequencies.

    Poles are exp(p/f_s) of the analogue poles p. The numerator's squared modulus is linear in three numbers, B0 cos^2 +
    B1 sin^2 + B2 sin^2(2.) of w/(2 f_s), found by least squares of its relative error up to 40 Hz, and b of it in closed
    form (after Vicanek, "Matched second order digital filters", 2016).

    Raises `InputError` for an unknown name, Sperling's weightings (a modulus only) and a rate at which 0.5 % is not held.
    """
    check_weighting(name)
    if name in SPERLING:
        raise InputError(f"{name}: Sperling's weighting has no filter; use weighted_acceleration, in the frequency domain")
    check_rate(sampling_rate)
    f = np.geomspace(0.1 * WEIGHTINGS[name].f1, UP_TO, 400)
    s, delay = 2j * np.pi * f, np.exp(-2j * np.pi * f / sampling_rate)
    sine = np.sin(np.pi * f / sampling_rate) ** 2
    sections, ratio = [], np.ones_like(f)
    for above, below in factors(name):
        a = np.real(np.poly(np.exp(np.roots(below) / sampling_rate)))
        wanted = np.abs(np.polyval(above, s) / np.polyval(below, s) * np.polyval(a[::-1], delay)) ** 2
        if above[2] == 0.0:  # the high-pass keeps both its zeros at 0 Hz
            b = np.array([1.0, -2.0, 1.0]) / math.sqrt(np.mean((4.0 * sine) ** 2 / wanted))
        else:
            columns = np.stack([1.0 - sine, sine, 4.0 * sine * (1.0 - sine)], axis=1) / wanted[:, None]
            scale = np.linalg.norm(columns, axis=0)
            b = _of_squared_modulus(*(np.linalg.lstsq(columns / scale, np.ones_like(f), rcond=None)[0] / scale))
        sections.append([*b, *a])
        ratio *= np.abs(np.polyval(b[::-1], delay)) / np.sqrt(wanted)
    error = np.max(np.abs(ratio - 1.0))
    if not error < TOLERANCE:
        raise InputError(
            f"sampling_rate {sampling_rate:g} Hz: the filter of {name} would be {error:.1%} off below {UP_TO:g} Hz; "
            f"use weighted_acceleration, or a record of 160 Hz or more"
        )
    return np.array(sections)


def _of_squared_modulus(b0: float, b1: float, b2: float) -> Float[np.ndarray, "3"]:
    """The numerator with all zeros inside the unit circle whose squared modulus is b0 cos^2 + b1 sin^2 + b2 sin^2(2.)."""
    at_zero, at_nyquist = math.sqrt(max(b0, 0.0)), math.sqrt(max(b1, 0.0))
    mean = 0.5 * (at_zero + at_nyquist)
    first = 0.5 * (mean + math.sqrt(max(mean**2 + b2, 0.0)))
    return np.array([first, 0.5 * (at_zero - at_nyquist), -b2 / (4.0 * first)])


def check_rate(sampling_rate: Any) -> None:
    """Refuse a sampling rate that is no positive, finite number of Hz."""
    if not (isinstance(sampling_rate, (int, float, np.number)) and math.isfinite(sampling_rate) and sampling_rate > 0):
        raise InputError(f"sampling_rate must be a positive number of Hz, not {sampling_rate!r}")
