"""`LearnedDamper`: a law whose numbers are found by training, made of a classical one, behind the same sensors and device."""

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...base.arguments import guarded
from ...base.checks import a_path, whole
from ...base.errors import InputError
from ...base.fields import matrix, structure, table
from ...base.precision import require_double_precision
from ...base.pytrees import registered
from ...base.typing import Number
from ...model.damper import Bogies
from ...model.parameters import without_labels
from ...model.vehicle import Vehicle
from ..controlled import ForceControlled
from ..skyhook import ADD, Skyhook
from .controller import Controller
from .device import Device
from .export_c import write_c
from .kalman import product
from .law_files import save_law
from .loop import SampledLoop
from .sensors import Signals

Rows = Float[Array, "..."]

#: m/s; a demand is divided by the velocity rounded within this
WIDTH = 5e-3


@registered
@dataclass(frozen=True, kw_only=True)
class LearnedDamper(SampledLoop):
    """A law with memory, linear and a small network beside it; made by `LearnedDamper.of(controller, vehicle)` and trained by `railjax.train`.

    Of the estimator's features f of all bogies, each over its usual size, and of what is remembered of them,
    z_k' = (f - z_k)/τ_k, the force of each bogie's pair of dampers is demanded as

        D = D_0 (W [f, z] + V tanh(U [f, z])),

    which the device then gives as far as it can. No constant enters: of the mirrored motion it demands the mirrored force. It sees the
    readings of all bogies, so that the trailing one is told by the leading one what is to come. To begin with W is the classical law's and V is 0.

    `save` and `railjax.load_law` keep it in a file, `export_c` writes it in C.
    """

    estimator: Any = None
    scale: Number = table("1", "", "usual size of each feature of each bogie, in its own unit")
    demand: Number = table("N", "D_0", "unit of the demanded force, per bogie")
    time_constants: Number = table("s", "τ_k", "how long features are remembered")
    linear_gain: Number = matrix("1", "W", "demand of features and memory")
    hidden_gain: Number = matrix("1", "U", "features and memory to the hidden units")
    hidden_demand: Number = matrix("1", "V", "demand of the hidden units")
    origin: str = structure("", "the classical law that it is made of")

    #: what training changes
    TRAINED: ClassVar[tuple[str, ...]] = ("time_constants", "linear_gain", "hidden_gain", "hidden_demand")

    @classmethod
    @guarded(controller=None, hidden=whole(0), time_constants=None)
    def of(
        cls,
        controller: Any,
        vehicle: Vehicle,
        *,
        hidden: int = 16,
        time_constants: tuple[float, ...] = (0.08, 0.4),
        seed: int = 0,
    ) -> "LearnedDamper":
        """The law that does as the controller's does: so that training starts no worse.

        Args:
            controller: with a law whose demand is linear in what it knows: continuous skyhook, clipped LQR, balance logic (|D| sgn v where it resists is
                the clipped D); its sensors, estimator and device are taken over.
            vehicle: a single vehicle, from which the law takes its gains.
            hidden: number of units of the network; 0 leaves it out.
            time_constants: τ_k, s; each adds a memory of all features.
            seed: of the network's first weights, a whole number.

        Raises `InputError` for on/off and acceleration-driven laws, and in single precision.
        """
        require_double_precision("LearnedDamper.of")
        fault = controller.fault() if isinstance(controller, Controller) else "it must be a railjax.Controller"
        if fault:
            raise InputError(f"controller: {fault}")
        vehicle, n = without_labels(vehicle), len(vehicle.geometry.bogie_pattern)
        names = controller.estimator.names
        scale = controller.estimator.usually(n)
        # at rest the valve is shut, or hunting from small motions would be that of an open one: the coach's sets in 3 km/h later than with its own
        # damping at rest, for 0.2 % of comfort
        shut = controller.on.damping_max
        rest = float(vehicle.secondary.damping_y if shut is None else shut)
        device = dataclasses.replace(controller.on, width=max(float(controller.on.width), WIDTH), damping_rest=rest)
        demand = np.full(n, 1e4)

        def wanted(features: Float[Array, "features"]) -> Float[Array, "n"]:
            rows = features.reshape((len(names), n))
            return _demanded(controller, vehicle, rows)

        linear = np.asarray(jax.jit(jax.jacfwd(wanted))(jnp.zeros(len(scale)))) * scale / demand[:, None]
        inputs = len(scale) * (1 + len(time_constants))
        first = np.random.default_rng(seed).normal(size=(hidden, inputs)) / np.sqrt(inputs)
        return cls(
            sensors=controller.sensors,
            device=device,
            faults=controller.faults,
            sample_time=controller.sample_time,
            seed=controller.seed,
            estimator=controller.estimator,
            scale=scale,
            demand=demand,
            time_constants=np.array(time_constants, float),
            linear_gain=np.hstack([linear, np.zeros((n, inputs - len(scale)))]),
            hidden_gain=first if hidden else None,
            hidden_demand=np.zeros((n, hidden)) if hidden else None,
            origin=type(controller.wraps).__name__,
        )

    @property
    def on(self) -> Device:
        """The device."""
        return Device() if self.device is None else self.device

    @property
    def _features(self) -> int:
        """Features per bogie."""
        return len(self.estimator.names)

    @property
    def memory_rows(self) -> int:
        """Those of the estimator, and the features' memories."""
        return self.estimator.states + self._features * jnp.shape(self.time_constants)[0]

    def decide(self, vehicle: Vehicle, signals: Signals, memory: Rows, elapsed: Bogies) -> tuple[Bogies, Rows]:
        """The command on what is estimated and remembered.

        Args:
            vehicle: gives the places of the bogies.
            signals: readings, shape `(m, n, *lanes)`, each in its unit.
            memory: of estimator and features, shape `(rows, n, *lanes)`, SI.
            elapsed: time since the last sample, shape `(n, *lanes)`, s.
        """
        names, known = self.sensors.names, self.estimator.states
        estimated = self.estimator.advanced(names, signals, memory[:known], elapsed)
        features = self.estimator.features(names, signals, estimated)
        velocity = self.estimator.estimate(vehicle, features).velocity
        inputs, remembered = self.inputs(features, memory[known:], elapsed)
        command = self.on.command(self.demanded(inputs), velocity)
        estimated = self.estimator.told(estimated, self.on.delivered(command, velocity))
        return command, jnp.concatenate([estimated, remembered])

    def inputs(self, features: Rows, remembered: Rows, elapsed: Bogies) -> tuple[Rows, Rows]:
        """[f, z] of all bogies, (inputs, *lanes), and z as it is remembered, rows per bogie.

        Args:
            features: of the estimator, shape `(features, n, *lanes)`, SI.
            remembered: z before, shape `(features times memories, n, *lanes)`, dimensionless.
            elapsed: time since the last sample, shape `(n, *lanes)`, s.
        """
        usual = _padded(jnp.asarray(self.scale, features.dtype), features.ndim - 2)
        f = features / usual.reshape((self._features, features.shape[1], *usual.shape[1:]))
        z = remembered.reshape((-1, *f.shape))
        constants = jnp.asarray(self.time_constants, f.dtype)
        constants = constants.reshape((constants.shape[0], 1, 1, *constants.shape[1:], *(1,) * (f.ndim - 1 - constants.ndim)))
        z = z - (f[None] - z) * jnp.expm1(-elapsed / constants)
        everything = jnp.concatenate([f[None], z])
        return everything.reshape((-1, *f.shape[2:])), z.reshape((-1, *f.shape[1:]))

    def demanded(self, inputs: Rows) -> Bogies:
        """D of each bogie's pair, (n, *lanes), N, of the `inputs` [f, z], dimensionless."""
        wanted = product(self.linear_gain, inputs)
        if self.hidden_gain is not None:
            wanted = wanted + product(self.hidden_demand, jnp.tanh(product(self.hidden_gain, inputs)))
        return wanted * _padded(jnp.asarray(self.demand, inputs.dtype), inputs.ndim - 1)

    @guarded(path=a_path)
    def save(self, path: str | Path) -> None:
        """Write all numbers and what the law is made of to a file (.npz) for `railjax.load_law`. Raises `InputError`."""
        save_law(self, path)

    @guarded(path=a_path)
    def export_c(self, path: str | Path, name: str = "damper_law", vehicle: Vehicle | None = None) -> None:
        """Write the law as a C99 function of the readings of all sensors, in single precision and without dependencies, to a file that
        explains itself. Sensors and device are not in it.

        Args:
            path: of the file.
            name: of the function, a name in C.
            vehicle: that a law on a Kalman filter belongs to, which tells the velocity across the dampers by the filter's states; else None.

        Raises `InputError` where a Kalman filter's vehicle is not given, and where the file cannot be written.
        """
        write_c(self, path, name, vehicle)

    def fault(self) -> str | None:
        """What is wrong with the parts together."""
        if self.estimator is None or self.linear_gain is None:
            return "a LearnedDamper is made with LearnedDamper.of(controller, vehicle), or by railjax.load_law"
        return super().fault()


def _padded(numbers: Rows, lanes: int) -> Rows:
    """One axis of its own before `lanes` axes of lanes."""
    return numbers.reshape(numbers.shape + (1,) * (lanes + 1 - numbers.ndim))


def _demanded(controller: Controller, vehicle: Vehicle, features: Rows) -> Bogies:
    """What the law would have the dampers give, before anything is clipped: linear in the features."""
    law, guess = controller.wraps, controller.estimator.estimate(vehicle, features)
    if isinstance(law, ForceControlled):
        return law.gain(vehicle) * law.measured(vehicle, guess.travel, guess.seen)
    if isinstance(law, Skyhook) and law.damping is not None and not isinstance(law, ADD):
        return 2.0 * law.damping * law.measured(vehicle, guess.travel, guess.seen)
    raise InputError(f"controller: the demand of {type(law).__name__} is not linear; take Skyhook(damping=...) or clipped LQR")
