"""Episodes of a training: a ride of some windows, the loss of each and its gradient, steps of the optimiser and of the limits' prices."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..base.batches import in_threads
from ..base.compilation import jit
from ..base.errors import InputError, NumericalError
from ..base.fingerprint import described, lines
from ..base.programs import return_memory
from ..dampers.control.learned import LearnedDamper
from ..model.motion import state_size
from ..model.track.sampled import MARGIN, SampledTrack
from ..model.vehicle import Vehicle
from ..ride.weightings import weighting_filter
from ..simulation.integrate import Plan, integrated
from .course import Course, Weights, with_weights
from .rides import RATE, Rides, mean_square, measured, picked, speed_of
from .robust import Scatter, scattered

#: parts of a batch, each in a thread of its own: the same numbers on any machine
SHARES = 2
#: how a limit's price grows with each window that is beyond it by its own size (mean square), and the price's curvature
PRICING, STIFFNESS = 1.0, 20.0


def filtered(
    sections: Float[np.ndarray, "sections 6"], memory: Float[Array, "sections 2 *places"], record: Float[Array, "samples *places"]
) -> tuple[Float[Array, "samples *places"], Float[Array, "sections 2 *places"]]:
    """A record through second-order sections, and what they remember after it: as `scipy.signal.sosfilt`, differentiable and in one kernel with a run.

    Args:
        sections: as `weighting_filter` gives them, dimensionless.
        memory: of what came before, in the record's unit, SI.
        record: samples at the filter's rate, SI.
    """

    def one(memory: Any, value: Any) -> tuple[Any, Any]:
        after = []
        for (b0, b1, b2, _, a1, a2), (first, second) in zip(sections, memory, strict=True):
            passed = b0 * value + first
            after.append(jnp.stack([b1 * value - a1 * passed + second, b2 * value - a2 * passed]))
            value = passed
        return jnp.stack(after), value

    memory, weighted = jax.lax.scan(one, jnp.asarray(memory), record)
    return weighted, memory


class Teacher:
    """Episodes: what is drawn, the ride of the law as it was, windows and steps."""

    def __init__(
        self, vehicle: Vehicle, law: LearnedDamper, track: SampledTrack, speeds: tuple[float, ...], scatter: Scatter | None,
        limits: dict[str, float], windows: int, window: float, lanes: int, dt: float, seed: int,
    ) -> None:  # fmt: skip
        self.vehicle, self.law, self.track, self.speeds = vehicle, law, track, speeds
        self.limits, self.windows, self.window, self.lanes, self.dt, self.seed = limits, windows, window, lanes, dt, seed
        self.scatter = None if scatter is None else scatter.drawn()
        every = round(1.0 / RATE / dt)
        if every < 1 or abs(every * dt * RATE - 1.0) > 1e-6:
            raise InputError(f"dt {dt:g} s: 5 ms must be a whole number of steps")
        self.plan = Plan(round(window * RATE), every, ("floor_acceleration", *limits), ())
        # all that the weights depend on, but the schedule
        told = {"speeds": speeds, "limits": limits, "windows": windows, "window": window, "lanes": lanes, "dt": dt, "seed": seed}
        self.fingerprint = {name: described(value) for name, value in told.items()}
        for name, value in {"vehicle": vehicle, "law": law, "track": track, "scatter": self.scatter}.items():
            self.fingerprint |= lines(name, value)
        self.sections = weighting_filter("Wd", RATE)
        self._compiled = False
        self.gradient = jit(jax.value_and_grad(self.loss, has_aux=True))

    def rides(self, episode: int) -> Rides:
        """What the lanes of an episode ride."""
        rng = np.random.default_rng((self.seed, episode))
        count = self.lanes
        speed = speed_of(self.speeds, rng, count)
        which = rng.integers(0, np.shape(self.track.coefficients)[1], count)
        length = ((np.shape(self.track.coefficients)[0] - MARGIN) * np.asarray(self.track.spacing))[which]
        room = length if self.track.periodic else np.maximum(length - speed * self.windows * self.window, 0.0)
        track = picked(self.track, which, rng.uniform(0.0, 1.0, count) * room)
        noise = rng.integers(0, 2**31 - 1, count).astype(float)
        vehicle = self.vehicle
        if self.scatter is not None:
            paths, factors, samples = self.scatter
            vehicle = scattered(vehicle, paths, factors, samples[:, rng.integers(0, samples.shape[1], count)])
        return Rides(vehicle, speed, track, noise)

    def loss(
        self, weights: Weights, rides: Rides, x: Any, echo: Any, base: dict[str, Any], prices: dict[str, Any]
    ) -> tuple[Any, Any]:
        law = dataclasses.replace(with_weights(self.law, weights), seed=rides.seed)
        run = integrated(rides.vehicle, law, rides.speed, rides.track, x, self.dt, 0.0, self.plan)
        weighted, echo = filtered(self.sections, echo, run.records["floor_acceleration"])
        ratios = {"comfort": mean_square(weighted) / base["comfort"]}
        ratios |= {name: mean_square(run.records[name]) / base[name] for name in self.limits}
        over = {name: jnp.mean(ratios[name]) - limit**2 for name, limit in self.limits.items()}
        # the augmented Lagrangian of inequalities
        felt = sum(jnp.maximum(prices[name] + STIFFNESS * by, 0.0) ** 2 / (2.0 * STIFFNESS) for name, by in over.items())
        return jnp.mean(ratios["comfort"]) + felt, (run.final, echo, over)

    def start(self, lanes: int) -> Float[np.ndarray, "states lanes"]:
        """Rest, of so many rides."""
        return np.zeros((state_size(self.vehicle, self.law), lanes))

    def silence(self, lanes: int) -> Float[np.ndarray, "sections 2 3 lanes"]:
        """What the weighting remembers before a ride."""
        return np.zeros((len(self.sections), 2, 3, lanes))

    def episode(self, course: Course, optimiser: Any) -> Course:
        """Where training stands after one more."""
        weights, memory, prices = course.weights, course.memory, course.prices
        rides = self.rides(course.episode)
        duration = self.windows * self.window
        base = measured(rides, self.law, duration, self.window, self.limits, self.dt)
        base |= {name: base[name] * course.aims[name] ** 2 for name in self.limits}
        parts = [slice(k * self.lanes // SHARES, (k + 1) * self.lanes // SHARES) for k in range(SHARES)]
        state = self.start(self.lanes // SHARES)
        held = [(state, self.silence(self.lanes // SHARES))] * SHARES
        for window in range(self.windows):
            here = rides.on(window * self.window)

            given = [
                (weights, here.part(part), *kept, {name: value[part] for name, value in base.items()}, prices)
                for part, kept in zip(parts, held, strict=True)
            ]
            # the first call compiles, which two threads would do twice
            each = in_threads if self._compiled else lambda function, shares: [function(share) for share in shares]
            found = each(self._of_share, given)
            if not self._compiled:
                self._compiled = True
                return_memory()
            values = [value for (value, _), _ in found]
            if not np.all(np.isfinite(values)):
                raise NumericalError("a ride in training diverged: its speed or scatter is beyond what this vehicle runs at")
            held = [(final, kept) for (_, (final, kept, _)), _ in found]
            if window == 0:  # from rest
                continue
            slope = jax.tree.map(lambda *part: sum(part) / SHARES, *[gradient for _, gradient in found])
            change, memory = optimiser.update(slope, memory, weights)
            weights = {name: weight + change[name] for name, weight in weights.items()}
            over = {name: sum(aux[2][name] for (_, aux), _ in found) / SHARES for name in prices}
            prices = {name: jnp.maximum(price + PRICING * over[name], 0.0) for name, price in prices.items()}
        return course._replace(weights=weights, memory=memory, prices=prices, episode=course.episode + 1)

    def _of_share(self, given: tuple) -> Any:
        """Value and gradient of one part of the batch."""
        return jax.device_get(self.gradient(*jax.tree.map(np.asarray, given)))
