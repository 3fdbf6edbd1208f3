"""A steady Kalman filter of the whole vehicle: all states from a few sensors, by the vehicle's own equations of motion."""

import dataclasses
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...base.arguments import guarded
from ...base.checks import Kind, from_zero, positive
from ...base.errors import InputError
from ...base.fields import matrix
from ...base.precision import require_double_precision
from ...base.pytrees import registered
from ...base.typing import Number
from ...model.damper import Bogies, Law, Seen
from ...model.kinematics import damper_point, deflections, size, split
from ...model.motion import state_matrix, track_matrix
from ...model.parameters import without_labels
from ...model.suspension import yaw_damper_states
from ...model.vehicle import Vehicle
from .estimators import Estimate
from .sensors import KINDS, Sensors, Signals

Rows = Float[Array, "..."]

#: wavenumber below which the alignment of a line is flat, rad/m: Ω_r of ERRI's spectra
FLAT = 0.0206
#: 1/s; how fast a bias may wander
WANDERS = 0.05
#: least noise of a sensor, of what is usual: without any there is no gain
LEAST = 0.02
#: what moves less than this has no usual size
LEAST_USUAL = 1e-9


@registered
@dataclass(frozen=True, kw_only=True)
class KalmanFilter:
    """x̂ after a sample from the one before: x̂ = F x̂ + H u + K y, with the forces u of the dampers (N per pair) and the readings y.

    Made by `KalmanFilter.design(vehicle, speed, sensors)`; it belongs to that vehicle, speed, suite of sensors and sample time. x̂ is
    [q, q', w of the sensors, elongations of yaw dampers, η of the wheelsets, biases], spread over the bogies' internal states.
    """

    transition: Number = matrix("1", "F", "what x̂ becomes by itself, in SI")
    drive: Number = matrix("1", "H", "what the dampers' forces do to x̂")
    gain: Number = matrix("1", "K", "what the readings do to x̂")
    usual: Number = matrix("1", "", "usual size of each of x̂, a column, in SI")

    needs: ClassVar[tuple[str, ...]] = ()
    whole: ClassVar[bool] = True

    @classmethod
    @guarded(
        speed=positive("m/s"),
        sensors=Kind(Sensors, "railjax.Sensors"),
        sample_time=positive("s"),
        roughness=positive("m"),
        disturbance=from_zero(),
    )
    def design(
        cls,
        vehicle: Vehicle,
        speed: float,
        sensors: Sensors,
        sample_time: float = 1e-3,
        roughness: float = 6e-7,
        disturbance: float = 1e-3,
    ) -> "KalmanFilter":
        """The steady gain for straight running with linear creep, the dampers' forces known, by SciPy's `solve_discrete_are`.

        The alignment under each wheelset is white noise through a low-pass, η' = -v Ω_r η + w, of the spectrum A/(Ω² + Ω_r²); the wheelsets'
            are taken as independent. A bias of each sensor's usual size wanders slowly; the filter estimates it. All rates have a white disturbance besides, for what the model does not know.

        Args:
            vehicle: a single vehicle, to which the filter then belongs.
            speed: v, m/s.
            sensors: whose noise, quanta, bandwidths and size of bias it goes by; of delays it does not know.
            sample_time: T, s.
            roughness: A, m (rad/m)²·m per rad: 2e-7 of ERRI's low and 6e-7 of its high spectrum.
            disturbance: r.m.s. change of each rate in 1 s, m/s or rad/s.

        Raises `InputError` where there is no steady gain, and in single precision.
        """
        import scipy.linalg

        require_double_precision("KalmanFilter.design")
        vehicle = without_labels(vehicle)
        model = linear_model(vehicle, speed, sensors, roughness, disturbance)
        a, n = model.a, model.b.shape[1]
        # over a sample, by one exponential (Van Loan 1978)
        zero = np.zeros_like(a)
        both = scipy.linalg.expm(np.block([[-a, np.diag(model.noise)], [zero, a.T]]) * sample_time)
        transition = both[len(a) :, len(a) :].T
        spread = transition @ both[: len(a), len(a) :]
        driven = scipy.linalg.expm(np.block([[a, model.b], [np.zeros((n, len(a) + n))]]) * sample_time)[: len(a), len(a) :]
        read, measured = model.read, np.diag(model.measured)
        try:
            cost = scipy.linalg.solve_discrete_are(transition.T, read.T, 0.5 * (spread + spread.T), measured)
        except (np.linalg.LinAlgError, ValueError) as error:
            raise InputError(f"no steady Kalman filter at {3.6 * speed:g} km/h with these sensors: {error}") from None
        gain = np.linalg.solve((read @ cost @ read.T + measured).T, (cost @ read.T).T).T
        keep = np.eye(len(a)) - gain @ read
        made = cls(transition=keep @ transition, drive=keep @ driven, gain=gain)
        # the model's r.m.s. with the vehicle's own damper; where that does not hold it, or nothing moves it, 1
        closed = a + model.b @ (2.0 * float(vehicle.secondary.damping_y) * made.across(vehicle))
        sizes = np.ones(len(a))
        if np.linalg.eigvals(closed).real.max() < 0.0:
            square = np.diag(scipy.linalg.solve_continuous_lyapunov(closed, -np.diag(model.noise)))
            sizes = np.where(square > LEAST_USUAL**2, np.sqrt(np.maximum(square, 0.0)), 1.0)
        return dataclasses.replace(made, usual=sizes[:, None])

    @property
    def states(self) -> int:
        """Rows per bogie: x̂ spread over them, and the force."""
        return self._spread + 1

    @property
    def _spread(self) -> int:
        return -(-jnp.shape(self.transition)[0] // jnp.shape(self.drive)[1])

    @property
    def names(self) -> tuple[str, ...]:
        """What the features are called."""
        return tuple(f"state {k}" for k in range(self._spread))

    def usually(self, bogies: int) -> Float[np.ndarray, "features"]:
        """Usual size of each feature of each bogie, in its SI unit; `bogies`: how many there are, a whole number (dimensionless)."""
        sizes = np.ones(self._spread * bogies)
        if self.usual is not None:
            sizes[: len(self.usual)] = np.asarray(self.usual)[:, 0]
        return sizes

    def across(self, vehicle: Vehicle) -> Float[np.ndarray, "n states"]:
        """What makes of x̂ the velocity across each bogie's dampers, m/s, by the `vehicle` that the filter belongs to."""
        states, n = np.shape(self.drive)
        rows = np.zeros((self._spread * n, states))
        rows[:states] = np.eye(states)
        return np.asarray(self.estimate(vehicle, jnp.asarray(rows.reshape(-1, n, states))).velocity)

    def _joined(self, rows: Rows) -> Rows:
        """x̂, (states, *lanes), of its rows (rows, n, *lanes)."""
        return rows.reshape((-1, *rows.shape[2:]))[: jnp.shape(self.transition)[0]]

    def advanced(self, names: tuple[str, ...], signals: Signals, memory: Rows, elapsed: Bogies) -> Rows:
        """x̂ with this sample's readings, and the force as it came.

        Args:
            names: of the sensors, in the order of their signals.
            signals: readings, shape `(m, n, *lanes)`, SI.
            memory: what this gave at the last sample, shape `(rows, n, *lanes)`, SI.
            elapsed: time since then, s; a filter is made for one sample time.
        """
        x, force, readings = self._joined(memory[:-1]), memory[-1], signals.reshape((-1, *signals.shape[2:]))
        x = product(self.transition, x) + product(self.drive, force) + product(self.gain, readings)
        room = self._spread * force.shape[0] - x.shape[0]
        x = jnp.concatenate([x, jnp.zeros((room, *x.shape[1:]), x.dtype)])
        return jnp.concatenate([x.reshape((self._spread, *force.shape)), force[None]])

    def told(self, memory: Rows, force: Bogies) -> Rows:
        """The `memory`, SI, with the `force` that will act until the next sample, N."""
        return jnp.concatenate([memory[:-1], force[None]])

    def features(self, names: tuple[str, ...], signals: Signals, memory: Rows) -> Rows:
        """x̂, spread over the bogies, SI.

        Args:
            names: of the sensors.
            signals: readings, shape `(m, n, *lanes)`, SI.
            memory: after them, shape `(rows, n, *lanes)`, SI.
        """
        return memory[:-1]

    def estimate(self, vehicle: Vehicle, features: Rows) -> Estimate:
        """Travel, velocity and all coordinates, rates and yaw dampers by the `features`, which are x̂, SI."""
        x, n = self._joined(features), features.shape[1]
        count, elastic = size(vehicle), yaw_damper_states(vehicle)
        q, rates = split(vehicle, x[:count]), split(vehicle, x[count : 2 * count])
        end = x.shape[0] - vehicle_wheels(vehicle) - jnp.shape(self.gain)[1]
        elongation = x[end - elastic * n : end].reshape((elastic, n, *x.shape[1:])) if elastic else None
        deflected = [deflections(vehicle, part) for part in (q, rates)]
        travel, velocity = (part[damper_point(part)] for part in deflected)
        return Estimate(travel, velocity, Seen(q, rates, elongation))


class LinearModel(NamedTuple):
    """x' = A x + B u + w, y = C x + e, with w white of the densities `noise` and e of the variances `measured`, all in SI."""

    a: Float[np.ndarray, "states states"]
    b: Float[np.ndarray, "states bogies"]
    read: Float[np.ndarray, "readings states"]  # C
    noise: Float[np.ndarray, "states"]
    measured: Float[np.ndarray, "readings"]


def linear_model(vehicle: Vehicle, speed: float, sensors: Sensors, roughness: float, disturbance: float) -> LinearModel:
    """What `KalmanFilter.design`, whose arguments these are, takes vehicle, track and sensors for.

    Args:
        vehicle: a single vehicle.
        speed: m/s.
        sensors: what is read.
        roughness: A, m (rad/m)²·m per rad.
        disturbance: r.m.s. change of each rate in 1 s, m/s or rad/s.
    """
    plant, n = _Plant(sensors), len(vehicle.geometry.bogie_pattern)
    count = size(vehicle)
    forces = np.arange(2 * count, 2 * count + n)
    whole, track = (np.asarray(part(vehicle, speed, plant)) for part in (state_matrix, track_matrix))
    a = np.delete(np.delete(whole, forces, axis=0), forces, axis=1)
    b, e = (np.delete(part, forces, axis=0) for part in (whole[:, forces], track))
    read = np.delete(np.asarray(jax.jacfwd(lambda x: _readings(vehicle, sensors, x))(jnp.zeros(len(whole)))), forces, axis=1)
    # the track's low-pass and the biases as states of their own, which nothing moves but noise
    wheels, readings, biased = e.shape[1], len(read), np.repeat(np.asarray(sensors.bias, float), n)
    slow = np.concatenate([np.full(wheels, speed * FLAT), np.full(readings, WANDERS)])
    outside = np.hstack([e, np.zeros((len(a), readings))])
    a = np.block([[a, outside], [np.zeros((len(slow), len(a))), -np.diag(slow)]])
    b = np.vstack([b, np.zeros((len(slow), n))])
    read = np.hstack([read, np.zeros((readings, wheels)), np.eye(readings)])
    noise = np.zeros(len(a))
    noise[count : 2 * count] = disturbance**2
    noise[-len(slow) :] = np.concatenate([np.full(wheels, np.pi * roughness * speed), 2.0 * WANDERS * biased**2])
    measured = np.repeat(np.asarray(sensors.noise) ** 2 + np.asarray(sensors.quantum) ** 2 / 12.0, n)
    least = np.repeat([LEAST * KINDS[name].noise for name in sensors.names], n)
    return LinearModel(a, b, read, noise, np.maximum(measured, least**2))


def vehicle_wheels(vehicle: Vehicle) -> int:
    """Number of wheelsets."""
    return len(vehicle.geometry.bogie_pattern) * len(vehicle.geometry.axle_pattern)


def product(numbers: Number, x: Rows) -> Rows:
    """A matrix, (rows, columns) or with lanes of its own, times x (columns, *lanes)."""
    numbers = jnp.asarray(numbers, x.dtype)
    return jnp.sum(numbers.reshape(numbers.shape + (1,) * (x.ndim + 1 - numbers.ndim)) * x, axis=1)


@registered
@dataclass(frozen=True)
class _Plant(Law):
    """Forces from outside, N per bogie, and the sensors' filters."""

    sensors: Sensors

    observes: ClassVar[bool] = True

    @property
    def internal_states(self) -> int:
        return 1 + len(self.sensors.names)

    def force(self, vehicle: Vehicle, travel: Bogies, velocity: Bogies, internal: Bogies, seen: Seen) -> tuple[Bogies, Bogies]:
        _, rate = self.sensors.reading(vehicle, travel, velocity, seen, internal[1:])
        return internal[0], jnp.concatenate([jnp.zeros_like(internal[:1]), rate])


def _readings(vehicle: Vehicle, sensors: Sensors, x: Float[Array, "states"]) -> Float[Array, "readings"]:
    """What the sensors read of a state of the plant, (m n,)."""
    count, n = size(vehicle), len(vehicle.geometry.bogie_pattern)
    internal = x[2 * count : 2 * count + (1 + len(sensors.names)) * n].reshape((-1, n))
    q, rates = split(vehicle, x[:count]), split(vehicle, x[count : 2 * count])
    deflected = [deflections(vehicle, part) for part in (q, rates)]
    travel, velocity = (part[damper_point(part)] for part in deflected)
    reading, _ = sensors.reading(vehicle, travel, velocity, Seen(q, rates), internal[1:])
    return reading.reshape(-1)
