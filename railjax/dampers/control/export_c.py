"""A learned law as a C99 function without dependencies: readings of all sensors in, commands of all bogies out, once a sample.

Readings, commands, weights and the network's units are of single precision. The filters' states and the sums are of double precision: a filter
of a second would lose 2e-6 of its state to rounding, and where the damper's velocity is near zero the command magnifies that tenfold. On a
Kalman filter weights and inputs are double as well, as a demand is the small difference of many states' shares. About 1000 multiplications (4000
with a Kalman filter) and a tanhf for each hidden unit a sample: of the order of microseconds (stated; not measured on a controller's processor).
"""

import keyword
import re
from pathlib import Path
from typing import Any

import numpy as np

from ...base.errors import InputError
from ...model.vehicle import Vehicle
from .device import Device
from .estimators import ComplementaryFilter
from .kalman import KalmanFilter

HEADER = """/* {title}
 * Made of railjax.LearnedDamper, from {origin}. C99, no dependencies but tanhf of the C library.
 *
 * Once every {sample_time} s: {name}(&state, readings, commands), {name}_reset(&state) before the first.
 * readings[sensor][bogie]: {sensors}.
 * commands[bogie]: {commands}.
 */
#include <math.h>

enum {{ SENSORS = {sensors_count}, BOGIES = {bogies}, FEATURES = {features}, MEMORIES = {memories}, INPUTS = {inputs}, HIDDEN = {hidden}{sizes} }};

typedef struct {{
    double {estimated}, memory[{room}][FEATURES][BOGIES];
    double command[BOGIES];
}} {name}_state;
"""

BODY = """
void {name}_reset({name}_state *s) {{
    static const {name}_state zero;
    *s = zero;
}}

void {name}({name}_state *s, const float readings[SENSORS][BOGIES], float commands[BOGIES]) {{
    {real} inputs[INPUTS];
    double velocity[BOGIES];
{observe}    for (int j = 0; j < BOGIES; ++j) {{
{features}
        for (int k = 0; k < FEATURES; ++k) {{
            double f = features[k] * per_scale[k][j];
            inputs[k * BOGIES + j] = ({real})f;
            for (int m = 0; m < MEMORIES; ++m) {{
                s->memory[m][k][j] += follow[m] * (f - s->memory[m][k][j]);
                inputs[((m + 1) * FEATURES + k) * BOGIES + j] = ({real})s->memory[m][k][j];
            }}
        }}
    }}
{hidden_units}
    for (int j = 0; j < BOGIES; ++j) {{
        double wanted = 0.0;
        for (int i = 0; i < INPUTS; ++i) wanted += (double)linear_gain[j][i] * inputs[i];
{hidden_sum}        wanted *= demand[j];
{command}
        s->command[j] = wanted;
        commands[j] = (float)wanted;
    }}
}}
"""

#: features on a `ComplementaryFilter`, of one bogie
COMPLEMENTARY = """        double *estimate = s->estimate[j], above = readings[{above}][j], below = readings[{below}][j];
        double error = readings[{travel}][j] - estimate[0];
        estimate[1] += {sample_time} * (above - below + {fast_square} * error);
        estimate[3] += {slow_step} * (above - estimate[3]);
        estimate[0] += {sample_time} * (estimate[1] + {damped} * error);
        estimate[2] += {sample_time} * (above - estimate[3] - {slow} * estimate[2]);
        double features[FEATURES] = {{estimate[0], estimate[1], estimate[2], above - estimate[3], below}};
        velocity[j] = estimate[1];"""

#: a `KalmanFilter`'s next state, whose last room is zero, and its features of one bogie
OBSERVE = """    double next[FEATURES * BOGIES] = {0.0};
    for (int i = 0; i < STATES; ++i) {
        for (int k = 0; k < STATES; ++k) next[i] += transition[i][k] * s->estimate[k];
        for (int j = 0; j < BOGIES; ++j) next[i] += drive[i][j] * s->force[j];
        for (int k = 0; k < SENSORS * BOGIES; ++k) next[i] += gain[i][k] * (double)readings[k / BOGIES][k % BOGIES];
    }
    for (int i = 0; i < STATES; ++i) s->estimate[i] = next[i];
"""
OBSERVED = """        double features[FEATURES];
        for (int k = 0; k < FEATURES; ++k) features[k] = next[k * BOGIES + j];
        velocity[j] = 0.0;
        for (int i = 0; i < STATES; ++i) velocity[j] += across[j][i] * next[i];"""

UNITS = """    float units[HIDDEN];
    for (int h = 0; h < HIDDEN; ++h) {
        double sum = 0.0;
        for (int i = 0; i < INPUTS; ++i) sum += (double)hidden_gain[h][i] * inputs[i];
        units[h] = tanhf((float)sum);
    }
"""
UNITS_SUM = "        for (int h = 0; h < HIDDEN; ++h) wanted += (double)hidden_demand[j][h] * units[h];\n"
VALVE = """        wanted = (0.5 * wanted * velocity[j] + {at_rest}) / (velocity[j] * velocity[j] + {width_square});
        wanted = (wanted - {least}) * {per_span};
        wanted = wanted < 0.0 ? 0.0 : wanted > 1.0 ? 1.0 : wanted;"""
FORCE = "        wanted = wanted < -{limit} ? -{limit} : wanted > {limit} ? {limit} : wanted;"
SLEW = """
        double change = wanted - s->command[j];
        wanted = s->command[j] + (change < -{most} ? -{most} : change > {most} ? {most} : change);"""


#: the force that the device will give, which a Kalman filter is told; by the device's kind
VALVE_TOLD = """
        double given = 2.0 * ({least} + {span} * wanted) * velocity[j];"""
FORCE_TOLD = """
        double sign = (velocity[j] > 0.0) - (velocity[j] < 0.0), size = 2.0 * velocity[j] * sign, along = wanted * sign;{most}
        double given = (along > {least} * size ? along : {least} * size) * sign;"""
MOST_TOLD = """
        along = along < {most} * size ? along : {most} * size;"""
LIMIT_TOLD = """
        given = given < -{limit} ? -{limit} : given > {limit} ? {limit} : given;"""


def source_of(law: Any, name: str, vehicle: Vehicle | None = None) -> str:
    """The text of the C file: `name`_state, `name`_reset and `name`; on a Kalman filter by the `vehicle` that it belongs to. Raises `InputError`."""
    if not re.fullmatch(r"[A-Za-z_]\w*", name) or keyword.iskeyword(name):
        raise InputError(f"name must be a name in C, such as damper_law, not {name!r}")
    whole = isinstance(law.estimator, KalmanFilter)
    if not whole and not isinstance(law.estimator, ComplementaryFilter):
        raise InputError(
            f"export_c writes laws on a ComplementaryFilter or a KalmanFilter, not on a {type(law.estimator).__name__}"
        )
    sensors, device, filters = law.sensors.names, law.on, law.estimator
    tables = {key: np.asarray(getattr(law, key), float) for key in ("scale", "demand", "time_constants", "linear_gain")}
    bogies, features, step = len(tables["demand"]), len(filters.names), float(law.sample_time)
    constants = {
        "demand[BOGIES]": tables["demand"],
        "linear_gain[BOGIES][INPUTS]": tables["linear_gain"],
    }
    memories = len(tables["time_constants"])
    hidden = 0 if law.hidden_gain is None else len(law.hidden_gain)
    if hidden:
        constants["hidden_gain[HIDDEN][INPUTS]"] = np.asarray(law.hidden_gain, float)
        constants["hidden_demand[BOGIES][HIDDEN]"] = np.asarray(law.hidden_demand, float)
    doubles = {"per_scale[FEATURES][BOGIES]": 1.0 / tables["scale"].reshape(features, bogies)}
    doubles["follow[MEMORIES]" if memories else "follow[1]"] = (
        -np.expm1(-step / tables["time_constants"]) if memories else np.zeros(1)
    )
    if whole:
        if vehicle is None:
            raise InputError("vehicle: a law on a KalmanFilter is written with the vehicle that the filter belongs to: give it")
        doubles |= {
            "transition[STATES][STATES]": np.asarray(filters.transition, float),
            "drive[STATES][BOGIES]": np.asarray(filters.drive, float),
            "gain[STATES][SENSORS * BOGIES]": np.asarray(filters.gain, float),
            "across[BOGIES][STATES]": filters.across(vehicle),
        }
        sizes, estimated = f", STATES = {len(np.asarray(filters.transition))}", "estimate[STATES], force[BOGIES]"
        observe, of_bogie = OBSERVE, OBSERVED
    else:
        sizes, estimated, observe = "", f"estimate[BOGIES][{filters.states}]", ""
        above, below, travel = (sensors.index(sensor) for sensor in filters.needs)
        fast, slow = (2 * np.pi * float(value) for value in (filters.crossover, filters.drift))
        of_bogie = COMPLEMENTARY.format(
            above=above, below=below, travel=travel, sample_time=repr(step), fast_square=repr(fast**2), slow_step=repr(step * slow),
            damped=repr(float(np.sqrt(2.0)) * fast), slow=repr(slow),
        )  # fmt: skip
    head = HEADER.format(
        title=f"{name}: law of the secondary lateral dampers", origin=law.origin or "a law", name=name, sample_time=_float(step),
        sensors=", ".join(sensors), commands="opening of the valve, 0 to 1" if device.kind == "valve" else "force of the pair of dampers, N",
        sensors_count=len(sensors), bogies=bogies, features=features, memories=memories, inputs=tables["linear_gain"].shape[1],
        hidden=hidden, sizes=sizes, estimated=estimated, room=max(memories, 1),
    )  # fmt: skip
    real = "double" if whole else "float"
    body = BODY.format(
        name=name, real=real, observe=observe, features=of_bogie, hidden_units=(UNITS if hidden else ""),
        hidden_sum=UNITS_SUM if hidden else "", command=_command(device, step, whole),
    )  # fmt: skip
    tables_text = [_table(real, key, value) for key, value in constants.items()]
    tables_text += [_table("double", key, value) for key, value in doubles.items()]
    return head + "\n" + "".join(tables_text) + body


def _command(device: Device, step: float, told: bool) -> str:
    """From the demanded force to the command, and, where it is `told`, to the force that the device will give."""
    limit = None if device.force_limit is None else repr(2.0 * float(device.force_limit))
    least = float(device.damping_min)
    if device.kind == "valve":
        span = float(device.damping_max) - least
        text = VALVE.format(
            at_rest=repr(float(device.damping_rest) * float(device.width) ** 2),
            width_square=repr(float(device.width) ** 2),
            least=repr(least),
            per_span=repr(1.0 / span),
        )
        given = VALVE_TOLD.format(least=repr(least), span=repr(span)) + ("" if limit is None else LIMIT_TOLD.format(limit=limit))
    else:
        text = "" if limit is None else FORCE.format(limit=limit)
        most = "" if device.damping_max is None else MOST_TOLD.format(most=repr(float(device.damping_max)))
        given = FORCE_TOLD.format(least=repr(least), most=most)
    if told:
        text += given + "\n        s->force[j] = given;"
    if device.slew is not None:
        span = 1.0 if device.kind == "valve" else 2.0 * float(device.force_limit)
        text += SLEW.format(most=repr(float(device.slew) * step * span))
    return text


def _float(value: float) -> str:
    """A number of single precision, with all its digits and a point, as C wants it before its f."""
    text = f"{np.float32(value):.9g}"
    return text if any(mark in text for mark in ".e") else text + ".0"


def _table(kind: str, key: str, values: np.ndarray) -> str:
    def nested(part: np.ndarray) -> str:
        if part.ndim == 1:
            return "{" + ", ".join(repr(float(value)) if kind == "double" else _float(value) + "f" for value in part) + "}"
        return "{" + ",\n    ".join(nested(row) for row in part) + "}"

    return f"static const {kind} {key} = {nested(values)};\n"


def write_c(law: Any, path: str | Path, name: str, vehicle: Vehicle | None) -> None:
    """Write `source_of` to a file. Raises `InputError` where it cannot be written."""
    text = source_of(law, name, vehicle)
    try:
        Path(path).write_text(text, encoding="ascii")
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from None
