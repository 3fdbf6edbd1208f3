"""What ten per cent more of each parameter do to a speed, by its exact gradient; and how engineers name the parameters."""

import re

from ...base.units import KMH
from ...model.parameters import get_parameter, parameters
from ...model.vehicle import Vehicle
from .limit_cycles import Branch
from .shooting import BY_AMPLITUDE, OrbitProblem, row_of, solved, speed_slopes

#: change by which parameters count that are zero, by unit
OF_ZERO = {"N s/m": (10e3, "10 kN s/m"), "N m/rad": (1e6, "1 MN m/rad")}


def counted(vehicle: Vehicle) -> dict[str, float]:
    """Parameters (numbers of the model, without tables and the widths of smooth twins) and their values, SI; those that are zero
    only where `OF_ZERO` says by how much they would be changed."""
    found = {}
    for path, entry in parameters(vehicle):
        about = entry.metadata
        if about["symbol"] and "axes" not in about:
            value = float(get_parameter(vehicle, path))
            if value or about["unit"] in OF_ZERO:
                found[path] = value
    return found


def changes(vehicle: Vehicle, gradient: Vehicle, share: float = 0.1) -> dict[str, float]:
    """Change (km/h) of a speed with this gradient (m/s per SI unit) for `share` more of every parameter that counts; parameters
    that are zero are changed as `OF_ZERO` says."""
    units = {path: entry.metadata["unit"] for path, entry in parameters(vehicle)}
    return {
        path: float(get_parameter(gradient, path)) * (share * value if value else OF_ZERO[units[path]][0]) * KMH
        for path, value in counted(vehicle).items()
    }


def parameter_label(vehicle: Vehicle, path: str) -> str:
    """Meaning and symbol, for matplotlib, and by how much it is changed where that is not a share of it."""
    about = dict(parameters(vehicle))[path].metadata
    symbol = re.sub(r"^(rho|mu|lambda|delta)", r"\\\1", re.sub(r"_(\w+)", r"_{\1}", about["symbol"]))
    added = "" if float(get_parameter(vehicle, path)) else f" (+{OF_ZERO[about['unit']][1]})"
    return f"{about['meaning']} ${symbol}${added}"


def fold_gradient(branch: Branch) -> Vehicle:
    """Gradient of the speed of a branch's lowest fold (m/s per SI unit), as that of `nonlinear_critical_speed`: by the implicit
    function, from the orbit that the branch has already found. The branch must have a fold."""
    model, shooting, fold = branch.model, branch.shooting, branch.fold
    assert fold is not None
    row = row_of(model, shooting, BY_AMPLITUDE)
    point = solved(model, shooting, OrbitProblem(fold.unknowns, row, float(row @ fold.unknowns)))
    return speed_slopes(model, shooting, point).vehicle
