"""A second vehicle of the same shape compiles nothing, whether its numbers are Python's, NumPy's or JAX's."""

import jax
import jax.monitoring
import numpy as np
import pytest

import railjax

COMPILED: list[str] = []
jax.monitoring.register_event_duration_secs_listener(
    lambda event, seconds, **_: COMPILED.append(event) if event.endswith("backend_compile_duration") else None
)

FLOOR = ["floor_acceleration"]
STUDIES = {
    "linear critical speed": lambda vehicle, speed, damper: railjax.linear_critical_speed(vehicle, damper=damper),
    "its gradient": lambda vehicle, speed, damper: jax.grad(
        lambda stiffness: railjax.linear_critical_speed(railjax.replace(vehicle, primary__stiffness_y=stiffness), damper=damper)
    )(np.float64(1e5 * float(speed))),
    "nonlinear critical speed": lambda vehicle, speed, damper: railjax.nonlinear_critical_speed(
        vehicle, damper=damper, steps=100
    ),
    "its gradient by a batch": lambda vehicle, speed, damper: jax.grad(
        lambda mass: jax.numpy.sum(railjax.nonlinear_critical(railjax.replace(vehicle, carbody__mass=mass), steps=100).speed)
    )(jax.numpy.array([600.0, 610.0]) * float(speed)),
    "hunting": lambda vehicle, speed, damper: str(railjax.hunting_branch(vehicle, damper=damper, steps=100, largest_step=0.5)),
    "modes": lambda vehicle, speed, damper: railjax.modes(vehicle, speed, damper),
    "root locus": lambda vehicle, speed, damper: railjax.root_locus(vehicle, np.linspace(0.5, 1.0, 4) * float(speed), damper),
    "frequency response": lambda vehicle, speed, damper: str(railjax.frequency_response(vehicle, speed, damper=damper)),
    "spectral comfort": lambda vehicle, speed, damper: railjax.spectral_comfort(
        railjax.frequency_response(vehicle, speed, damper=damper, record=FLOOR)
    ),
    "statistical linearisation": lambda vehicle, speed, damper: str(
        railjax.statistical_linearisation(vehicle, speed, damper=damper)
    ),
}


def compiled(work):
    before = len(COMPILED)
    jax.block_until_ready(work())
    return len(COMPILED) - before


@pytest.mark.parametrize("name", STUDIES)
def test_a_second_vehicle_compiles_nothing(coach, name):
    assert compiled(lambda: jax.jit(lambda x: x + len(name))(1.0)) == 1, "the count is none"
    study = STUDIES[name]
    study(coach, 50.0, railjax.PassiveDamper(1.5e4))
    other = railjax.replace(coach, contact__conicity=0.15, primary__stiffness_x=np.float64(4e6), carbody__mass=31000)
    other = railjax.replace(other, name="other", note="of another name")
    assert compiled(lambda: study(other, np.float64(48.0), railjax.PassiveDamper(np.float64(2e4)))) == 0
    on_device = jax.device_put(jax.tree.map(np.float64, coach))
    assert compiled(lambda: study(on_device, jax.device_put(np.float64(52.0)), railjax.PassiveDamper(3e4))) == 0


def test_a_second_record_compiles_nothing():
    random = np.random.default_rng(0)
    first, second = random.normal(size=(2, 12000))
    on_device = jax.device_put(second)
    railjax.comfort(first, 120.0)
    assert compiled(lambda: railjax.comfort(second.astype(np.float32), np.float64(120.0))) == 0
    assert compiled(lambda: railjax.comfort(on_device, 120)) == 0
