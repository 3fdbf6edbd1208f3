"""Statistical linearisation: creep saturation, the flange and the damper's law as the linear elements that serve a random track best.

Each nonlinear force F of local signals z (creepages, displacement on the track, travel and velocity of the secondary suspension) is
replaced by the linear one of least mean square error for Gaussian z, of gain E[F z]/E[z^2] (Booton 1954; Caughey 1963). The
variances follow from the response to the track with these gains, which is a fixed point. What it leaves out is all that is not
Gaussian: harmonics, hunting, rare large values. It is an approximation; compare with `simulate` before relying on it.
"""

import functools
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from ..base.arguments import guarded
from ..base.compilation import hasty
from ..base.errors import InputError, NumericalError
from ..base.failed_lanes import nan_unless, no_number, without_nan
from ..base.packing import as_numbers
from ..base.precision import require_double_precision
from ..base.typing import Scalar
from ..base.units import KMH
from ..model.contact.creep import flange_force, saturation, saturation_factor
from ..model.damper import Bogies, Damper, EquivalentDamper, Seen, answers, law_of
from ..model.kinematics import damper_point
from ..model.motion import PASSIVE, Motion, wheelset_shape
from ..model.parameters import bare
from ..model.track.spectra import LONGEST, SHORTEST
from ..model.vehicle import Vehicle
from ..simulation.channels import CHANNELS, check_linear_channel
from .frequency import POINTS, Excitation, FrequencyResponse, an_excitation, read_channels, respond, waves_of

#: of the fixed point: most iterations; share of the new gains that is taken over
ITERATIONS, SHARE = 60, 0.7
#: largest change of a gain, relative, at which the iteration stops, and that which counts as converged
AIM, CONVERGED = 1e-7, 1e-4


class Gains(NamedTuple):
    """Equivalent linear elements, in units of the small-amplitude ones where these exist."""

    longitudinal: Float[Array, "n m"]  # of f11: 1 without saturation
    lateral: Float[Array, "n m"]  # of f33 (and of f12, f22)
    flange: Float[Array, "n m"]  # of k_f: 0 while the flange is not touched
    stiffness: Float[Array, "n"]  # of a bogie's lateral dampers, N/m
    damping: Float[Array, "n"]  # N s/m


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class StatisticalResponse:
    """Result of `statistical_linearisation`: the response with the equivalent gains, these gains, and the largest relative change
    of a gain in the last iteration."""

    response: FrequencyResponse
    gains: Gains
    change: Float[Array, ""]  # relative, of the gains in the last iteration

    def __str__(self) -> str:
        g = jax.tree.map(np.asarray, self.gains)
        return (
            f"{self.response}\n  statistical linearisation: creep {100 * g.longitudinal.mean():.1f} % longitudinal, {100 * g.lateral.mean():.1f} % lateral of linear, "
            f"flange {100 * g.flange.mean():.2g} % of its stiffness, dampers of a bogie {g.stiffness.mean() / 1e3:.3g} kN/m and {g.damping.mean() / 1e3:.3g} kN s/m"
        )


@guarded(("shortest", "longest"), track=an_excitation)
def statistical_linearisation(
    vehicle: Vehicle,
    speed: Scalar,
    track: object = "erri-high",
    *,
    damper: Damper = PASSIVE,
    record: tuple[str, ...] | list[str] = ("carbody_acceleration",),
    shortest: Scalar = SHORTEST,
    longest: Scalar = LONGEST,
    points: int = POINTS,
) -> StatisticalResponse:
    """As `frequency_response`, with creep saturation, the flange and the damper's law replaced by their statistical equivalents.

    Bump stops and yaw dampers' blow-off stay linear. For balance logic without limit and least damping it gives k = -α k_cy and c
    = 2 α k_cy σ_y/(π σ_v) per bogie. Differentiable once (implicitly, at the fixed point), `jit`- and `vmap`-able over speed,
    track amplitude and any float; in a transformation, what does not settle is NaN, and `change` tells it.

    Args:
        vehicle: a single vehicle, without lanes.
        speed: v, m/s.
        track: what `spectrum` takes (a name, a table, a formula); a `RandomTrack`, of which each line is a wave; or an
            `Excitation`.
        damper: a law of travel and velocity without memory: `PassiveDamper` (blow-off), `BalanceLogic` without lags, or any of
            your own that has no internal states and observes nothing; by default the vehicle's own dampers.
        record: channels, from `railjax.CHANNELS`.
        shortest: shortest wavelength of a spectrum, m; by default 2.
        longest: longest wavelength of a spectrum, m; by default 200.
        points: number of waves between the two, evenly spaced in the logarithm, 16 or more; by default 400.

    Raises:
        NumericalError: where the equivalent vehicle is unstable or the iteration does not settle.
        InputError: for other laws, an unknown channel or spectrum, and in single precision.
    """
    require_double_precision("statistical linearisation")
    if vehicle.profiles is not None:
        raise InputError(
            "statistical linearisation takes a constant conicity and a flange's dead band, not profiles; simulate instead"
        )
    if not answers(damper).memoryless:
        raise InputError(
            f"statistical linearisation takes laws of travel and velocity without memory (PassiveDamper, BalanceLogic without lags), not {type(damper).__name__}"
        )
    record = tuple(check_linear_channel(name) for name in record)
    waves = waves_of(track, shortest, longest, points)
    frequency, transfer, growth, gains, change = _solved(*bare(vehicle, damper), as_numbers(speed), waves, record)
    if not isinstance(change, jax.core.Tracer) and not float(change) < CONVERGED:
        why = (
            "the equivalent vehicle is unstable" if not float(growth) < 0.0 else f"the gains still change by {float(change):.1g}"
        )
        raise NumericalError(f"statistical linearisation fails at {float(speed) * KMH:.1f} km/h: {why}; simulate instead")
    return StatisticalResponse(FrequencyResponse(frequency, transfer, waves, growth, speed, vehicle.name), gains, change)


@hasty(static_argnums=4)
def _solved(vehicle: Vehicle, damper: Damper, speed: Scalar, waves: Excitation, record: tuple[str, ...]):
    sound = ~no_number((vehicle, speed, damper, waves))
    vehicle, speed, damper, waves = given = without_nan((vehicle, speed, damper, waves))
    fixed = jax.lax.stop_gradient(given)

    def response(given: tuple, gains: Gains, read):
        vehicle, speed, _, waves = given
        equivalent, element = _equivalent(vehicle, gains)
        return respond(equivalent, speed, waves.wavenumber, element, read, flange=True)

    def new_gains(given: tuple, gains: Gains, usable: Any = True) -> Gains:
        vehicle, _, damper, waves = given
        _, signals, _ = response(given, gains, _local)
        signals = jax.tree.map(lambda signal: jnp.where(usable, signal, 1.0), signals)
        return _gains(vehicle, damper, signals, waves.variance)

    def improved(carry: tuple[Gains, Array, Array]) -> tuple[Gains, Array, Array]:
        gains, _, count = carry
        mixed = jax.tree.map(lambda old, new: old + SHARE * (new - old), gains, new_gains(fixed, gains))
        # against the gain itself, or its linear element: a flange that is never touched changes nothing
        secondary = fixed[0].secondary
        scales = Gains(1.0, 1.0, 1.0, secondary.stiffness_y, jnp.abs(gains.damping) + secondary.damping_y)
        changes = jax.tree.map(lambda old, new, scale: jnp.max(jnp.abs(new - old) / scale), gains, mixed, scales)
        return mixed, jnp.max(jnp.stack(changes)), count + 1

    n, m = wheelset_shape(vehicle)
    start = Gains(
        jnp.ones((n, m)), jnp.ones((n, m)), jnp.zeros((n, m)), jnp.zeros(n), jnp.full(n, 2.0 * vehicle.secondary.damping_y)
    )
    start = jax.lax.stop_gradient(jax.tree.map(lambda gain: jnp.asarray(gain, float), start))
    first = start, jnp.asarray(jnp.inf), jnp.asarray(0)
    # NaN ends it
    gains, change, _ = jax.lax.while_loop(lambda now: (now[1] > AIM) & (now[2] < ITERATIONS), improved, first)
    usable = sound & (change < CONVERGED)
    gains = jax.tree.map(lambda gain, begun: jnp.where(usable, gain, begun), gains, start)
    # one step of Newton from the converged gains; its derivative is that of the implicit function
    flat, gains_of = ravel_pytree(gains)
    slope = jax.jacfwd(lambda flat: ravel_pytree(new_gains(fixed, gains_of(flat)))[0])(flat)
    residual = ravel_pytree(new_gains(given, gains, usable))[0] - flat
    gains = gains_of(flat + jnp.linalg.solve(jnp.eye(flat.size) - jnp.where(usable, slope, 0.0), residual))
    frequency, transfer, growth = response(given, gains, functools.partial(read_channels, record))
    return *nan_unless(usable, (frequency, transfer, growth, gains)), nan_unless(sound, change)


def _local(instant: Motion) -> dict[str, Float[Array, "..."]]:
    """The signals on which the nonlinear laws depend."""
    deflection, rate = instant.deflection, instant.deflection_rate
    signals = {
        "longitudinal": instant.creepage.longitudinal,
        "lateral": instant.creepage.lateral,
        "on_track": CHANNELS["wheelset_on_track"].read(instant),
    }
    if "secondary_y" in deflection:
        at = damper_point(deflection)
        signals |= {"travel": deflection[at], "velocity": rate[at]}
    return signals


def _equivalent(vehicle: Vehicle, gains: Gains) -> tuple[Vehicle, EquivalentDamper]:
    """A linear vehicle: per wheelset creep coefficients and a spring at the flange, per bogie a damper; a column for lanes."""
    longitudinal, lateral, flange = (gain[..., None] for gain in gains[:3])
    contact = vehicle.contact
    contact = replace(
        contact,
        creep_longitudinal=contact.creep_longitudinal * longitudinal,
        creep_lateral=contact.creep_lateral * lateral,
        creep_lateral_spin=contact.creep_lateral_spin * lateral,
        creep_spin=contact.creep_spin * lateral,
        flange_stiffness=contact.flange_stiffness * flange,
    )
    return replace(vehicle, contact=contact), EquivalentDamper(gains.stiffness[:, None], gains.damping[:, None])


def _plane() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes (z1, z2) and weights of the standard normal plane: Gauss-Legendre in radius and in each quadrant's angle, because laws
    switch where a signal changes its sign."""
    node, weight = np.polynomial.legendre.leggauss(24)
    radius, angle = 4.0 * (node + 1.0), 0.25 * np.pi * (node + 1.0)
    radial = 4.0 * weight * radius * np.exp(-0.5 * radius**2)
    angles = np.concatenate([angle + 0.5 * np.pi * quadrant for quadrant in range(4)])
    around = np.tile(0.25 * np.pi * weight, 4) / (2.0 * np.pi)
    z = radius[:, None] * np.stack([np.cos(angles), np.sin(angles)])[:, None]
    weights = (radial[:, None] * around).ravel()
    return z[0].ravel(), z[1].ravel(), weights


Z1, Z2, WEIGHTS = _plane()
#: the standard normal line, in fine steps because of the dead band's corners
LINE = np.linspace(-7.0, 7.0, 561)
LINE_WEIGHTS = np.exp(-0.5 * LINE**2) * (LINE[1] - LINE[0]) / np.sqrt(2.0 * np.pi)


def _gains(vehicle: Vehicle, damper: Damper, signals: dict, variance: Float[Array, "waves"]) -> Gains:
    """Equivalent gains from the transfer functions of the local signals, each (waves, n, m) or (waves, n)."""
    contact = vehicle.contact

    def covariance(one: str, other: str) -> Float[Array, "..."]:
        return jnp.tensordot(variance, (signals[one] * signals[other].conj()).real, axes=1)

    def deviation(name: str) -> Float[Array, "..."]:
        return jnp.sqrt(covariance(name, name))

    x, y = deviation("longitudinal"), deviation("lateral")
    correlation = jnp.clip(covariance("longitudinal", "lateral") / (x * y), -1.0, 1.0)[..., None]
    unit = correlation * Z1 + jnp.sqrt(1.0 - correlation**2) * Z2
    if contact.law == "linear":
        factor = jnp.ones_like(unit)
    else:
        u = saturation(contact, contact.creep_longitudinal * x[..., None] * Z1, contact.creep_lateral * y[..., None] * unit)
        factor = saturation_factor(u)
    on_track = deviation("on_track")[..., None]
    flange = jnp.sum(LINE_WEIGHTS * LINE * flange_force(contact, on_track * LINE), -1) / on_track[..., 0]
    n, _ = x.shape
    stiffness = damping = jnp.zeros(n)
    if "travel" in signals:
        travel, velocity = deviation("travel")[:, None], deviation("velocity")[:, None]
        force = _force(vehicle, damper, travel * Z1, velocity * Z2)
        stiffness, damping = (jnp.sum(WEIGHTS * force * z, -1) / s[:, 0] for z, s in ((Z1, travel), (Z2, velocity)))
    return Gains(
        jnp.sum(WEIGHTS * factor * Z1**2, -1),
        jnp.sum(WEIGHTS * factor * unit**2, -1),
        flange / contact.flange_stiffness,
        stiffness,
        damping,
    )


def _force(vehicle: Vehicle, damper: Damper, travel: Bogies, velocity: Bogies) -> Bogies:
    """The damper's force where its controller has just decided, N."""
    seen = Seen({}, {})
    internal = jnp.zeros((damper.internal_states, *travel.shape))
    internal = answers(damper).held(vehicle, travel, velocity, internal, seen)
    return law_of(damper, seen)(vehicle, travel, velocity, internal)[0]
