"""Laws in files: every number of a controller or a learned law in an .npz, with a description that says what it is made of.

`description` is JSON: of each dataclass its name and fields, of which numbers are names of arrays in the file. Nothing in it is code, and
nothing is unpickled.
"""

import dataclasses
import json
import zipfile
from pathlib import Path
from typing import Any

import jax
import numpy as np

from ...base.arguments import guarded
from ...base.by_name import Maker
from ...base.checks import a_path
from ...base.errors import InputError
from ...base.version import __version__

FORMAT = 1
#: what a law may be made of, by the name of its class
KINDS = {
    "ADD": Maker("dampers.skyhook", "ADD"),
    "BalanceLogic": Maker("dampers.balance_logic", "BalanceLogic"),
    "ClippedLQR": Maker("dampers.clipped_lqr", "ClippedLQR"),
    "ComplementaryFilter": Maker("dampers.control.estimators", "ComplementaryFilter"),
    "Controller": Maker("dampers.control.controller", "Controller"),
    "Device": Maker("dampers.control.device", "Device"),
    "Faults": Maker("dampers.control.device", "Faults"),
    "KalmanFilter": Maker("dampers.control.kalman", "KalmanFilter"),
    "LearnedDamper": Maker("dampers.control.learned", "LearnedDamper"),
    "MixedSkyhookADD": Maker("dampers.skyhook", "MixedSkyhookADD"),
    "PassiveDamper": Maker("model.damper", "PassiveDamper"),
    "Sensors": Maker("dampers.control.sensors", "Sensors"),
    "Skyhook": Maker("dampers.skyhook", "Skyhook"),
}


def save_law(law: Any, path: str | Path) -> None:
    """Write a law; `path` as it is given. Raises `InputError` where it cannot be written, and for laws of one's own."""
    arrays: dict[str, np.ndarray] = {}
    described = {"railjax": __version__, "format": FORMAT, "law": _described(law, "law", arrays)}
    try:
        with open(path, "wb") as file:
            np.savez(file, description=json.dumps(described), **arrays)  # type: ignore[arg-type]
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from None


@guarded(path=a_path)
def load_law(path: str | Path) -> Any:
    """The law of a file that `save` wrote, a `LearnedDamper` or a `Controller`; numbers are the same to the bit.

    Raises `InputError` for a file that is none, is damaged, or is of a later format.
    """
    try:
        with np.load(path, allow_pickle=False) as kept:
            arrays = {name: kept[name] for name in kept.files}
        described = json.loads(str(arrays["description"]))
        if described["format"] != FORMAT:
            raise InputError(
                f"{path} is of format {described['format']}, which railjax {described['railjax']} writes; this is {__version__}"
            )
        return _made(described["law"], arrays)
    except OSError as error:
        raise InputError(f"{path}: no law can be read there ({error.strerror or error})") from None
    except (KeyError, ValueError, TypeError, zipfile.BadZipFile, EOFError):
        raise InputError(f"{path} is no file of a law, such as law.save(path) writes, or is damaged") from None


def _described(value: Any, name: str, arrays: dict[str, np.ndarray]) -> Any:
    if value is None:
        return None
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        kind = type(value).__name__
        if kind not in KINDS:
            raise InputError(f"{kind} is none of railjax's own laws; a file cannot say how to make it")
        fields = {
            entry.name: {"static": getattr(value, entry.name)}
            if entry.metadata.get("static")
            else _described(getattr(value, entry.name), f"{name}.{entry.name}", arrays)
            for entry in dataclasses.fields(value)
        }
        return {"kind": kind, "fields": fields}
    if isinstance(value, jax.core.Tracer):
        raise InputError("a law is written once its numbers are known, not inside jax.jit or jax.grad")
    arrays[name] = np.asarray(value, float)
    return {"array": name}


def _made(described: Any, arrays: dict[str, np.ndarray]) -> Any:
    if described is None:
        return None
    if "array" in described:
        value = arrays[described["array"]]
        return float(value) if value.ndim == 0 else value
    if "static" in described:
        static = described["static"]
        return tuple(static) if isinstance(static, list) else static
    return KINDS[described["kind"]].found()(**{name: _made(value, arrays) for name, value in described["fields"].items()})
