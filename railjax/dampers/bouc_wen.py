"""The modified Bouc-Wen damper, eqs. (12)-(17) of the paper (Spencer, Dyke, Sain and Carlson 1997): the laws as pure functions
and a step that is stable for any motion.

x is the displacement over the damper, y its inner one, z the hysteretic displacement, u the driver's voltage. All arrays
broadcast against each other and against the parameters, so lanes may trail anywhere.

Eq. (12) is printed F = c_1 y + k_1 (x - x_0); the units and the source want c_1 y'. What the paper calls k is k_0 there.
"""

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..base import smooth
from ..base.errors import InputError
from ..base.fields import optional, parameter, structure
from ..base.pytrees import registered
from ..base.typing import Number, Scalar
from . import power_loop

Values = Float[Array, "..."]


@registered
@dataclass(frozen=True)
class BoucWen:
    """Parameters of the modified Bouc-Wen damper; the defaults are Spencer's 3 kN prototype (1997; recalled, not read at the
    source), for voltages of 0 to 2.25 V. |z| stays below (A/(β + γ))^(1/n), 6.44 mm.
    """

    c0a: Number = parameter("N s/m", "c_0a", "viscous damping at high velocity, 0 V", 2100.0, positive=True)
    c0b: Number = parameter("N s/m/V", "c_0b", "its growth with voltage", 350.0, signed=True)
    c1a: Number = parameter("N s/m", "c_1a", "dashpot in series, 0 V (roll-off at low velocity)", 28300.0, positive=True)
    c1b: Number = parameter("N s/m/V", "c_1b", "its growth with voltage", 295.0, signed=True)
    alpha_a: Number = parameter("N/m", "α_a", "force per hysteretic displacement, 0 V", 14000.0, positive=True)
    alpha_b: Number = parameter("N/m/V", "α_b", "its growth with voltage", 69500.0, signed=True)
    k0: Number = parameter("N/m", "k", "stiffness at high velocity (k_0 of the source)", 4690.0)
    k1: Number = parameter("N/m", "k_1", "stiffness of the accumulator", 500.0)
    x0: Number = parameter("m", "x_0", "displacement at which the accumulator gives no force", 0.143, signed=True)
    gamma: Number = parameter("1/m^2", "γ", "shape of the loop", 3.63e6, signed=True)
    beta: Number = parameter("1/m^2", "β", "shape of the loop", 3.63e6, signed=True)
    A: Number = parameter("1", "A", "slope dz/dx at z = 0", 301.0, positive=True)
    eta: Number = parameter("1/s", "η", "rate at which the driver follows its command", 190.0, positive=True)
    saturation: Number = optional(
        "V", "u_s", "voltage at which the magnetic circuit saturates; without it eqs. (15)-(17) are linear"
    )
    n: float = structure(2.0)  # smoothness of the loop, 1 or more, dimensionless; β and γ are then in 1/m^n

    def __str__(self) -> str:
        return "\n".join(f"  {f.name:8s} {getattr(self, f.name):12.6g} {f.metadata['unit']}" for f in leaves(self))


def leaves(parameters: BoucWen) -> list[dataclasses.Field]:
    """The fields that are numbers, in order; without those that the damper does without."""
    fields = [f for f in dataclasses.fields(parameters) if not f.metadata.get("static")]
    return [f for f in fields if getattr(parameters, f.name) is not None]


def effective(u: Scalar, saturation: Scalar | None) -> Scalar:
    """The voltage that counts in eqs. (15)-(17): u itself, or u_s tanh(u/u_s), which the paper's "sigmoid function" allows."""
    return u if saturation is None else saturation * jnp.tanh(u / saturation)


def by_voltage(parameters: BoucWen, u: Scalar) -> tuple[Scalar, Scalar, Scalar]:
    """α(u), c_0(u) and c_1(u), eqs. (15)-(17)."""
    p = parameters
    w = effective(u, p.saturation)
    return p.alpha_a + p.alpha_b * w, p.c0a + p.c0b * w, p.c1a + p.c1b * w


def y_rate(parameters: BoucWen, x: Scalar, velocity: Scalar, y: Scalar, z: Scalar, u: Scalar) -> Scalar:
    """y' of eq. (13), m/s."""
    alpha, c0, c1 = by_voltage(parameters, u)
    return (alpha * z + c0 * velocity + parameters.k0 * (x - y)) / (c0 + c1)


def z_rate(parameters: BoucWen, relative: Scalar, z: Scalar) -> Scalar:
    """z' of eq. (14), m/s, for the relative velocity x' - y'. Derivatives are finite, also at z = 0."""
    p = parameters
    odd = smooth.odd_power(jnp.asarray(z, float), p.n)  # |z|^(n-1) z; times the sign of z it is |z|^n
    return relative * (p.A - p.beta * odd * jnp.sign(z)) - p.gamma * jnp.abs(relative) * odd


def u_rate(parameters: BoucWen, u: Scalar, command: Scalar) -> Scalar:
    """u' = -η (u - v): the driver's first-order lag behind its command v, V/s."""
    return parameters.eta * (command - u)


def force(parameters: BoucWen, x: Scalar, velocity: Scalar, y: Scalar, z: Scalar, u: Scalar) -> Scalar:
    """F of eq. (12), N, positive along x' when it resists."""
    p = parameters
    _, _, c1 = by_voltage(p, u)
    return c1 * y_rate(p, x, velocity, y, z, u) + p.k1 * (x - p.x0)


def lagged(parameters: BoucWen, u: Scalar, command: Scalar, dt: Scalar) -> Scalar:
    """The driver's voltage a time dt later, the command held: exact."""
    return command + (u - command) * jnp.exp(-parameters.eta * dt)


#: Newton iterations of a step: 3 reach rounding even at 5 ms
ITERATIONS = 3


def step(
    parameters: BoucWen, start: Scalar, end: Scalar, y: Scalar, z: Scalar, u: Scalar, dt: Scalar, steps: int = 1
) -> tuple[Values, Values]:
    """y and z a time dt later, while x goes evenly from `start` to `end` (m) at the voltage u; stable for every dt and x'.

    The loop's own rate, 2 √(A(β + γ))|x'|, is 9e3 1/s at 0.1 m/s, too much for explicit steps of 1 ms. But z depends on the
    path s = x - y alone, and that in closed form (`along_path`); so only the one number Δs is unknown:

        (c_0 + c_1) Δs = c_1 Δx - dt (α (z_0 + z_1)/2 + k (s_0 + Δs/2)),    z_1 = z(z_0, Δs)

    whose right side falls with Δs: Newton's method finds it. Second order; at 1 ms the force is within 0.05 % (r.m.s.) of the
    exact one at 0.1 m/s, 0.1 % at 0.5 m/s. `steps` cuts dt into equal parts; `response` finds how many are needed.
    """
    start, end, y, z = (jnp.asarray(value, float) for value in (start, end, y, z))
    part, h = (end - start) / steps, dt / steps
    for index in range(steps):
        y, z = _one_step(parameters, start + index * part, part, y, z, u, h)
    return y, z


def _one_step(p: BoucWen, start: Values, change: Values, y: Values, z: Values, u: Scalar, dt: Scalar) -> tuple[Values, Values]:
    alpha, c0, c1 = by_voltage(p, u)
    half = 0.5 * dt * alpha
    linear = c0 + c1 + 0.5 * dt * p.k0
    known = c1 * change - dt * p.k0 * (start - y) - half * z  # = linear Δs + half z_1

    def improved(path: Values) -> Values:
        after, slope = along_path(p, z, path)
        return path - (linear * path + half * after - known) / (linear + half * slope)

    # z_1 bends down along the path, so Newton's method climbs to the solution from below, without overshooting. Two bounds from
    # below are the tangent at Δs = 0 and the saturated loop, the one right for short paths, the other for long ones
    left = known - half * z
    direction = jnp.where(left < 0.0, -1.0, 1.0)
    tangent = jnp.abs(left) / (linear + half * _slope(p, direction * z))
    saturated = (direction * known - half * largest(p)) / linear
    path = direction * jnp.maximum(tangent, saturated)
    for _ in range(ITERATIONS - 1):
        path = improved(path)
    # at the solution Newton's map has the derivative of the solution, whatever the derivative of its argument
    path = improved(jax.lax.stop_gradient(path))
    return y + change - path, along_path(p, z, path)[0]


def largest(parameters: BoucWen) -> Scalar:
    """|z| of the saturated loop, m."""
    p = parameters
    return (p.A / (p.beta + p.gamma)) ** (1.0 / p.n) if p.n != 2 else jnp.sqrt(p.A / (p.beta + p.gamma))


def along_path(parameters: BoucWen, z: Scalar, path: Scalar) -> tuple[Values, Values]:
    """z after the path Δs = ∫(x' - y')dt travelled without turning, and dz/dΔs there: eq. (14) in closed form.

    Against the sign of z it unloads, dz/ds = A - (β - γ)|z|^n, with it loads, dz/ds = A - (β + γ)|z|^n. For n = 2 these are Riccati
    equations, each solved by z(s) = (z_0 + A τ)/(1 + b z_0 τ), τ = tanh(κs)/κ, κ² = A b; κ may be imaginary (tan) or vanish. For
    other n >= 1 see `power_loop`; a z_0 outside the saturated loop then counts as on it. Raises `InputError` for n below 1.
    """
    p = parameters
    z, path = jnp.asarray(z, float), jnp.asarray(path, float)
    direction = jnp.where(path < 0.0, -1.0, 1.0)
    length, along = direction * path, direction * z
    after = _riccati_path(p, along, length) if p.n == 2 else _power_path(p, along, length)
    return direction * after, _slope(p, after)


def _riccati_path(p: BoucWen, along: Values, length: Values) -> Values:
    """z, counted positive in the direction of the path, after a length of it, m; n = 2."""
    unloading, loading = p.beta - p.gamma, p.beta + p.gamma
    to_zero = -along / p.A * smooth.artanhc(jnp.asarray(unloading / p.A * along**2))
    first = jnp.clip(to_zero, 0.0, length)
    return _riccati(p.A, loading, _riccati(p.A, unloading, along, first), length - first)


def _power_path(p: BoucWen, along: Values, length: Values) -> Values:
    """The same for any n: z is shifted along one curve, of the loop that unloads before z = 0 and of the one that loads after it."""
    if not p.n >= 1:
        raise InputError(f"damper.parameters.n must be at least 1, not {p.n:g}; 2 is usual")
    size = largest(p)
    ratio = (p.beta - p.gamma) / (p.beta + p.gamma)

    def either(function: Callable[..., Values], value: Values) -> Values:
        """An odd function but for its κ."""
        before = value < 0.0
        found = function(jnp.where(before, -value, value), jnp.where(before, ratio, 1.0), p.n)
        return jnp.where(before, -found, found)

    start = either(power_loop.path_to, jnp.clip(along / size, -1.0, 1.0))
    return size * either(power_loop.reached, start + p.A / size * length)


def _slope(p: BoucWen, along: Values) -> Values:
    """dz/ds, `along` being z counted positive in the direction of the path."""
    power = along**2 if p.n == 2 else jnp.abs(along) ** p.n
    return p.A - jnp.where(along < 0.0, p.beta - p.gamma, p.beta + p.gamma) * power


def _riccati(a: Scalar, b: Scalar, z: Values, s: Values) -> Values:
    """z(s) of dz/ds = a - b z²."""
    tau = s * smooth.tanhc(a * b * s**2)
    return (z + a * tau) / (1.0 + b * z * tau)


class Motion(NamedTuple):
    """Prescribed motion, as `march` takes it: arrays of as many samples; several stretches may lie one after another."""

    x: Float[Array, "samples"]  # m
    velocity: Float[Array, "samples"]  # m/s
    command: Float[Array, "samples"]  # V
    travel: Float[
        Array, "samples 5"
    ]  # of the velocity's integral until the next sample, over the time in samples, highest power first
    begins: Int[Array, "samples"]  # number of the stretch that begins here, else -1


def motion_of(
    x: Float[Array, "samples"], velocity: Float[Array, "samples"], command: Float[Array, "samples"], stretch: int = 0
) -> Motion:
    """One stretch, the velocity between samples by the cubic through four of them."""
    wide = jnp.pad(velocity, (1, 2), mode="edge")
    before, here, after, later = (wide[k : k + len(velocity)] for k in range(4))
    before, later = before.at[0].set(2.0 * here[0] - after[0]), later.at[-2].set(2.0 * after[-2] - here[-2])
    cubic = (3.0 * (here - after) + later - before) / 6.0
    square = 0.5 * (before + after) - here
    slope = after - 0.5 * here - before / 3.0 - later / 6.0
    travel = jnp.stack([cubic / 4.0, square / 3.0, slope / 2.0, here, jnp.zeros_like(here)], axis=1)
    return Motion(x, velocity, command, travel, jnp.where(jnp.arange(len(x)) == 0, stretch, -1))


def march(
    parameters: BoucWen, motion: Motion, dt: Scalar, parts: int | Int[Array, ""], starts: Float[Array, "stretches 3 *lanes"]
) -> Float[Array, "samples *lanes"]:
    """Force in N over a motion sampled every dt seconds, each sample cut into `parts` steps; from x - y (m), z (m) and u (V) at the
    first sample of each stretch. Reverse mode wants a Python int for `parts`."""
    p = parameters

    def sample(state: Float[Array, "3 *lanes"], now: Motion) -> tuple[Float[Array, "3 *lanes"], Values]:
        path, z, u = jnp.where(now.begins < 0, state, starts[now.begins])
        out = force(p, now.x, now.velocity, now.x - path, z, u)

        def part(index: Any, inner: tuple[Values, Values]) -> tuple[Values, Values]:
            path, z = inner
            begin, end = (now.x + dt * jnp.polyval(now.travel, (index + k) / parts) for k in (0, 1))
            y, z = step(p, begin, end, begin - path, z, lagged(p, u, now.command, (index + 0.5) / parts * dt), dt / parts)
            return end - y, z

        path, z = jax.lax.fori_loop(0, parts, part, (path, z))
        return jnp.stack(jnp.broadcast_arrays(path, z, lagged(p, u, now.command, dt))), out

    return jax.lax.scan(sample, jnp.zeros_like(starts[0]), motion)[1]


def response(
    parameters: BoucWen,
    x: Float[Array, "samples"],
    velocity: Float[Array, "samples"],
    command: Float[Array, "samples"],
    dt: Scalar,
    parts: int | Int[Array, ""] = 1,
    start: Float[Array, "3 *lanes"] | None = None,
) -> Float[Array, "samples *lanes"]:
    """Force in N over a prescribed motion sampled every dt seconds; parameters may have lanes.

    `x` in m and `velocity` in m/s are the motion, `command` the voltage that the driver is told, held over each sample. Within a
    sample the damper is moved by the integral of the velocity, not by the difference of x: a measured x is the noisier. Each sample is
    cut into `parts` steps: `parts_needed` of them. `start`: x - y (m), z (m) and u (V) at the first sample, 0 without.
    """
    lanes = jnp.broadcast_shapes(*(jnp.shape(leaf) for leaf in jax.tree.leaves(parameters)))
    first = jnp.zeros((3, *lanes)) if start is None else start
    return march(parameters, motion_of(x, velocity, command), dt, parts, first[None])


_march = jax.jit(march)

#: parts of a sample beyond which a record is too coarse for its motion
MOST_PARTS = 64


def parts_needed(
    parameters: BoucWen, motion: Motion, dt: Scalar, starts: Float[Array, "stretches 3"], tolerance: float = 1e-3
) -> int:
    """Into how many parts `march` has to cut each sample of a known motion: doubled until the force would change by less than
    `tolerance` of its standard deviation (r.m.s.), at most 64."""
    parameters = jax.tree.map(
        lambda leaf: jnp.asarray(leaf, motion.x.dtype), parameters
    )  # numbers and arrays alike, for one program
    found, parts = _march(parameters, motion, dt, jnp.asarray(1), starts), 1
    while parts < MOST_PARTS:
        finer = _march(parameters, motion, dt, jnp.asarray(2 * parts), starts)
        # of second order: the error is 4/3 of the change
        if jnp.sqrt(jnp.mean((finer - found) ** 2)) < 0.75 * tolerance * jnp.std(finer):
            break
        found, parts = finer, 2 * parts
    return parts


def scaled(parameters: BoucWen, force: Scalar = 1.0, displacement: Scalar = 1.0) -> BoucWen:
    """The damper whose force at x(t) is `force` times that of `parameters` at x(t)/`displacement`; voltage and time alike.

    Forces scale c, α and k; displacements, z among them, stretch c, α, k, x_0 and the loop (β, γ). A, a slope, stays.
    """
    p = parameters
    keys = ("c0a", "c0b", "c1a", "c1b", "alpha_a", "alpha_b", "k0", "k1")
    by_both = {name: getattr(p, name) * force / displacement for name in keys}
    by_power = {name: getattr(p, name) / displacement**p.n for name in ("gamma", "beta")}
    return dataclasses.replace(p, x0=p.x0 * displacement, **by_both, **by_power)
