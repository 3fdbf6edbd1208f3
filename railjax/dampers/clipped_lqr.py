"""Clipped optimal control: a linear quadratic regulator's force, where dampers can give it."""

from dataclasses import dataclass
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..base.arguments import guarded
from ..base.checks import from_zero, positive
from ..base.errors import InputError
from ..base.fields import matrix, optional
from ..base.precision import require_double_precision
from ..base.pytrees import registered
from ..base.typing import Number, Scalar
from ..base.units import KMH
from ..model.damper import Bogies, Law, Seen
from ..model.kinematics import damper_point, deflections, join, of_carbody, size, split
from ..model.motion import state_matrix
from ..model.vehicle import Vehicle
from .controlled import ForceControlled


@registered
@dataclass(frozen=True)
class ClippedLQR(ForceControlled):
    """Clipped optimal control: the force of a linear quadratic regulator with all states known, where dampers can give it.

    Made with `ClippedLQR.design(vehicle, speed)`; `feedback` (n, 2N) is its gain, D = K [q, q'] per bogie's pair, N; with yaw dampers in
    series (n, 2N + n), as their elongations count. It belongs to that vehicle; at other speeds it is no longer optimal. What full knowledge could buy, not something to be built:
    a train does not measure its wheelsets' lateral positions. Signal: D, N.
    """

    feedback: Number = matrix("N/m, N s/m", "K", "feedback of all states to the force of each bogie's pair")
    force_limit: Number = optional("N", "", "largest force per damper", default=5e3)
    signal_scale: ClassVar[float] = 1e3

    @classmethod
    @guarded(speed=positive("m/s"), travel_weight=from_zero("1/s²"), force_weight=positive("m/s² per kN"))
    def design(
        cls, vehicle: Vehicle, speed: float, travel_weight: float = 10.0, force_weight: float = 0.05, **options: Number
    ) -> "ClippedLQR":
        """The regulator of least ∫ a_1² + a_2² + (w_t Δy_1)² + (w_t Δy_2)² + (w_f F_1)² + (w_f F_2)² dt.

        a_j is the car body's lateral acceleration above bogie j (m/s^2), Δy_j its secondary travel, F_j in kN. Straight running
        with linear creep, the dampers taken out; by SciPy's `solve_continuous_are`.

        Args:
            vehicle: a single vehicle, to which the regulator then belongs.
            speed: v, m/s.
            travel_weight: w_t, 1/s².
            force_weight: w_f, m/s² per kN.
            **options: the other fields of `ClippedLQR`, such as `force_limit` in N per damper.

        Raises:
            InputError: where there is no regulator, for weights out of range, and in single precision.
        """
        import scipy.linalg

        require_double_precision("ClippedLQR.design")
        n, bogies = size(vehicle), len(vehicle.geometry.bogie_pattern)
        whole = np.asarray(state_matrix(vehicle, speed, _Actuator()))
        # the actuators' states stand before those of the yaw dampers
        inputs, rates = np.arange(2 * n, 2 * n + bogies), slice(n, 2 * n)
        plant = np.delete(whole, inputs, axis=0)
        a, b = np.delete(plant, inputs, axis=1), plant[:, inputs]
        travel, above = (np.asarray(rows) for rows in _outputs(vehicle, n))
        acceleration, direct = above @ a[rates], above @ b[rates]
        state = np.vstack([acceleration, np.hstack([travel_weight * travel, np.zeros((bogies, len(a) - n))])])
        through = np.vstack([direct, np.zeros((bogies, bogies))])
        try:
            cost = scipy.linalg.solve_continuous_are(
                a, b, state.T @ state, through.T @ through + force_weight**2 * np.eye(bogies), s=state.T @ through
            )
        except np.linalg.LinAlgError as error:
            raise InputError(f"no regulator at {speed * KMH:g} km/h with force_weight {force_weight:g}: {error}") from None
        gain = np.linalg.solve(through.T @ through + force_weight**2 * np.eye(bogies), b.T @ cost + through.T @ state)
        # u = -K x in kN; the damper's force is D
        return cls(feedback=-1e3 * gain, **options)

    def fault(self) -> str | None:
        """What is wrong where there is no gain."""
        return "ClippedLQR has no feedback; make it with ClippedLQR.design(vehicle, speed)" if self.feedback is None else None

    def measured(self, vehicle: Vehicle, travel: Bogies, seen: Seen) -> Bogies:
        """D = K x, the force that the regulator wants.

        Args:
            vehicle: tells the order of the coordinates.
            travel: Δy_c over each bogie, shape `(n, *lanes)`, m; plays no part, as it is in x.
            seen: all coordinates, rates and states of yaw dampers, which together are x.

        Returns:
            D of each bogie's pair of dampers, `(n, *lanes)`, N.
        """
        own = [] if seen.yaw_dampers is None else [*seen.yaw_dampers]
        x = jnp.concatenate(join(vehicle, seen.coordinates) + join(vehicle, seen.rates) + own)
        feedback = jnp.asarray(self.feedback)
        # lanes of its own on the last axis, or none
        return jnp.sum(feedback.reshape(feedback.shape + (1,) * (x.ndim + 1 - feedback.ndim)) * x, axis=1)

    def gain(self, vehicle: Vehicle) -> Scalar:
        """1: the signal is the force, N."""
        return 1.0

    @property
    def largest_signal(self) -> Scalar:
        """Unlimited forces are bounded as if they were 20 kN."""
        return 20e3


@registered
@dataclass(frozen=True)
class _Actuator(Law):
    """Forces from outside, kN per bogie: their columns of the state matrix are B of x' = A x + B u."""

    internal_states: ClassVar[int] = 1

    def force(self, vehicle: Vehicle, travel: Bogies, velocity: Bogies, internal: Bogies) -> tuple[Bogies, Bogies]:
        return 1e3 * internal[0], jnp.zeros_like(internal)


def _outputs(vehicle: Vehicle, n: int) -> tuple[Float[Array, "bogies n"], Float[Array, "bogies n"]]:
    """Rows that make of q the damper's travel and the car body's displacement above it, per bogie."""
    unit = split(vehicle, jnp.eye(n))
    travel = deflections(vehicle, unit)
    return travel[damper_point(travel)], of_carbody(vehicle, unit)
