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
        lambda mass: jax.numpy.sum(railjax.nonlinear_critical(railjax.replace(vehicle, wheelset__mass=mass), steps=100).speed)
    )(jax.numpy.array([20.0, 20.5]) * float(speed)),
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


#: of one bogie, whose limit cycles take a tenth of the coach's time
OF_A_BOGIE = ("nonlinear critical speed", "its gradient by a batch", "hunting")


def compiled(work):
    before = len(COMPILED)
    jax.block_until_ready(work())
    return len(COMPILED) - before


@pytest.mark.parametrize("name", STUDIES)
def test_a_second_vehicle_compiles_nothing(coach, name):
    assert compiled(lambda: jax.jit(lambda x: x + len(name))(1.0)) == 1, "the count is none"
    study, first = STUDIES[name], railjax.load_vehicle("cooperrider-bogie") if name in OF_A_BOGIE else coach
    study(first, 50.0, railjax.PassiveDamper(1.5e4))
    conicity, stiffness = 1.05 * first.contact.conicity, np.float64(1.2 * first.primary.stiffness_x)
    other = railjax.replace(first, contact__conicity=conicity, primary__stiffness_x=stiffness, carbody__mass=31000)
    other = railjax.replace(other, name="other", note="of another name")
    assert compiled(lambda: study(other, np.float64(48.0), railjax.PassiveDamper(np.float64(2e4)))) == 0
    on_device = jax.device_put(jax.tree.map(np.float64, first))
    assert compiled(lambda: study(on_device, jax.device_put(np.float64(52.0)), railjax.PassiveDamper(3e4))) == 0


def test_a_second_record_compiles_nothing():
    random = np.random.default_rng(0)
    first, second = random.normal(size=(2, 12000))
    on_device = jax.device_put(second)
    railjax.comfort(first, 120.0)
    assert compiled(lambda: railjax.comfort(second.astype(np.float32), np.float64(120.0))) == 0
    assert compiled(lambda: railjax.comfort(on_device, 120)) == 0
