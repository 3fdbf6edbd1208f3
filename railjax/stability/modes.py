"""Modes as engineers name them: frequencies, damping ratios, shapes, and their loci along the speed."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from ..base.arguments import ONE_SPEED, SPEED, guarded
from ..base.errors import InputError, NumericalError
from ..base.precision import require_double_precision
from ..base.style import COLOURS, legend_above
from ..base.typing import Scalar
from ..base.units import KMH
from ..model.damper import Damper
from ..model.kinematics import labels, layout, size
from ..model.motion import PASSIVE, inertias
from ..model.vehicle import Vehicle
from .along_speed import along_speed

if TYPE_CHECKING:
    from matplotlib.axes import Axes

EXTREME = "look for a mass or stiffness that is far from any vehicle's"


@dataclass(frozen=True)
class Modes:
    """Modes of straight running at one speed, one per pair of conjugate eigenvalues (and per real one), least damped first.

    `shapes` are the right eigenvectors' coordinates (n, modes), scaled to 1 at the coordinate with most kinetic energy;
    `condition` is that of the eigenvalue, 1/|w^H r| for unit left and right vectors: how many times a relative error of E is
    magnified.
    """

    speed: float  # m/s
    names: list[str]
    eigenvalues: Complex[np.ndarray, "modes"]  # 1/s
    shapes: Complex[np.ndarray, "n modes"]
    energy: Float[np.ndarray, "n modes"]  # share of the kinetic energy of each coordinate
    condition: Float[np.ndarray, "modes"]
    coordinates: list[str]
    right: Complex[np.ndarray, "states modes"]
    left: Complex[np.ndarray, "states modes"]

    @property
    def frequency(self) -> Float[np.ndarray, "modes"]:
        """Hz; 0 for an overdamped mode."""
        return np.abs(self.eigenvalues.imag) / (2.0 * np.pi)

    @property
    def damping_ratio(self) -> Float[np.ndarray, "modes"]:
        """zeta = -Re(lambda)/|lambda|; negative means unstable."""
        return damping_ratios(self.eigenvalues)

    def __str__(self) -> str:
        lines = [
            f"Modes at {self.speed * KMH:.1f} km/h",
            f"{'mode':42s} {'Hz':>8s} {'damping':>8s} {'1/s':>10s}",
        ]
        for name, frequency, damping, value in zip(self.names, self.frequency, self.damping_ratio, self.eigenvalues, strict=True):
            lines.append(f"{name:42s} {frequency:8.3f} {damping:8.4f} {value.real:10.4f}")
        return "\n".join(lines)

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers and lists, for JSON."""
        columns = self.names, self.frequency, self.damping_ratio, self.eigenvalues.real, self.condition
        keys = "name", "frequency_hz", "damping_ratio", "growth_per_s", "condition"
        rows = [(name, *map(float, numbers)) for name, *numbers in zip(*columns, strict=True)]
        return {"speed_kmh": self.speed * KMH, "modes": [dict(zip(keys, row, strict=True)) for row in rows]}


@guarded(speed=ONE_SPEED)
def modes(vehicle: Vehicle, speed: Scalar, damper: Damper = PASSIVE) -> Modes:
    """Eigenvalues and shapes of E (eq. 4) at one speed, named by their kinetic energy.

    Args:
        vehicle: a single vehicle, without lanes.
        speed: v, m/s.
        damper: what takes the place of rho_cy, linearised at rest; by default the vehicle's own.

    Raises:
        InputError: for a speed that is not positive, and in single precision.
    """
    require_double_precision("the modes")
    if not 0 < float(speed) < float("inf"):
        raise InputError(f"speed must be positive (m/s), not {float(speed):g}: creepage is a ratio to the speed")
    matrices, _ = along_speed(vehicle, damper)(np.array([speed], float))
    return _modes_of(vehicle, float(speed), matrices[0])


def _modes_of(vehicle: Vehicle, speed: float, matrix: Float[np.ndarray, "states states"]) -> Modes:
    from scipy.linalg import eig  # here, for a quick import of railjax

    if not np.all(np.isfinite(matrix)):
        raise NumericalError(f"the state matrix is not finite; {EXTREME}")
    try:
        values, left, right = eig(matrix, left=True, right=True)
    except np.linalg.LinAlgError:
        raise NumericalError(f"the eigenvalues of the state matrix do not converge; {EXTREME}") from None
    # complex even where all modes are overdamped
    values, left, right = (array.astype(complex) for array in (values, left, right))
    keep = np.flatnonzero(values.imag >= 0)
    keep = keep[np.argsort(-values[keep].real, kind="stable")]
    values, left, right = values[keep], left[:, keep], right[:, keep]
    n = size(vehicle)
    inertia = inertias(vehicle)
    mass = np.concatenate([np.full(math.prod(shape), float(inertia[group])) for group, shape in layout(vehicle).items()])
    energy = mass[:, None] * np.abs(right[n : 2 * n]) ** 2
    # a rigid-body mode at rest has no kinetic energy; it counts by its shape
    energy = np.where(energy.sum(axis=0) > 0, energy, np.abs(right[:n]) ** 2)
    with np.errstate(all="ignore"):
        energy = energy / energy.sum(axis=0)
        leading = np.argmax(energy, axis=0)
        shapes = right[:n] / right[:n][leading, np.arange(len(keep))]
        condition = 1.0 / np.abs(np.sum(left.conj() * right, axis=0))  # infinite for a double eigenvalue with one vector
    if not np.all(np.isfinite(energy)) or not np.all(np.isfinite(shapes)):
        raise NumericalError(f"the shapes of the modes are beyond floating point; {EXTREME}")
    names = _names(vehicle, values, shapes, energy)
    return Modes(speed, names, values, shapes, energy, condition, labels(vehicle), right, left)


def damping_ratios(values: Complex[Array | np.ndarray, "..."]) -> Float[Array | np.ndarray, "..."]:
    """zeta = -Re(lambda)/|lambda| of eigenvalues, by the library that they are of; 0 for a rigid-body mode, lambda = 0."""
    size = abs(values)
    return -values.real / (np if isinstance(values, np.ndarray) else jnp).where(size > 0.0, size, 1.0)  # type: ignore[operator]


class LeastDamped(NamedTuple):
    """Of straight running: damping ratio and frequency of the mode that is damped least, and the largest growth rate of all."""

    ratio: Float[Array, "..."]  # zeta, dimensionless; -1 for one that runs away without oscillating
    frequency: Float[Array, "..."]  # Hz; 0 for a real mode
    growth: Float[Array, "..."]  # Re(lambda), 1/s; negative where running is stable


def least_damped(values: Complex[Array, "modes"]) -> LeastDamped:
    """The least damped of the modes that move, of their eigenvalues (1/s): oscillations, and real ones too, for a vehicle that leans over without
    oscillating is unstable as well. A rigid-body mode at rest, lambda = 0, has no damping ratio. Differentiable; NaN where the eigenvalues are."""
    ratio, size = damping_ratios(values), jnp.abs(values)
    moving = size > 1e-9 * jnp.max(size)
    least = jax.lax.stop_gradient(jnp.argmin(jnp.where(moving, ratio, jnp.inf)))
    return LeastDamped(ratio[least], jnp.abs(values.imag[least]) / (2.0 * jnp.pi), jnp.max(values.real))


def _names(vehicle: Vehicle, values: np.ndarray, shapes: np.ndarray, energy: np.ndarray) -> list[str]:
    """Names by participation: the part that carries the kinetic energy, and how the bogies move to each other."""
    rows: dict[str, slice] = {}
    start = 0
    for group, shape in layout(vehicle).items():
        rows[group] = slice(start, start + int(np.prod(shape)))
        start = rows[group].stop
    damping = damping_ratios(values)
    names = []
    hunting = []
    for k in range(len(values)):
        share = {group: energy[part, k].sum() for group, part in rows.items()}
        wheelsets = share["wheelset_y"] + share["wheelset_psi"]
        carbody = sum(share.get(f"carbody_{c}", 0.0) for c in ("y", "psi", "phi"))
        if carbody > 0.5:
            name = _carbody_name(share, shapes[:, k], rows)
        elif damping[k] > 0.9:
            name = "wheelset creep (overdamped)" if wheelsets > 0.4 else "overdamped"
        elif wheelsets > 0.3:
            name = "hunting"
            hunting.append(k)
        else:
            moving = max(("bogie_y", "bogie_psi", "bogie_phi"), key=lambda group: share.get(group, 0.0))
            name = {"bogie_y": "bogie lateral", "bogie_psi": "bogie yaw", "bogie_phi": "bogie roll"}[moving]
            name = name if share.get(moving, 0.0) > 0 else "wheelset lateral"
        names.append(name + _phase(shapes[:, k], share, rows) if not name.startswith("car body") else name)
    # of the hunting modes the least damped (and its twin of the other phase) is the bogie's, the others the wheelsets'
    seen: set[str] = set()
    for k in hunting:
        kind = "wheelset hunting" if names[k] in seen or "bogie_y" not in rows else "bogie hunting"
        seen.add(names[k])
        names[k] = names[k].replace("hunting", kind, 1)
    return _numbered(names)


def _carbody_name(share: dict[str, float], shape: np.ndarray, rows: dict[str, slice]) -> str:
    if share["carbody_psi"] > share["carbody_y"] + share["carbody_phi"]:
        return "car body yaw"
    y, phi = shape[rows["carbody_y"]][0], shape[rows["carbody_phi"]][0]
    # y + h phi is the displacement h below the centre: opposite signs put the centre of rotation below it
    return "car body lower sway" if (phi * y.conjugate()).real < 0 else "car body upper sway"


def _phase(shape: np.ndarray, share: dict[str, float], rows: dict[str, slice]) -> str:
    """How the two bogies move to each other, by the group that carries most energy."""
    if "bogie_y" not in rows or rows["bogie_y"].stop - rows["bogie_y"].start != 2:
        return ""
    group = max((name for name in share if not name.startswith("carbody")), key=lambda name: share[name])
    front, rear = np.split(shape[rows[group]], 2)
    together = np.sum(front * rear.conj()).real
    return ", bogies in phase" if together > 0 else ", bogies in opposition"


def _numbered(names: list[str]) -> list[str]:
    counts: dict[str, int] = {}
    result = []
    for name in names:
        counts[name] = counts.get(name, 0) + 1
        result.append(name if counts[name] == 1 else f"{name} ({counts[name]})")
    return result


@dataclass(frozen=True)
class RootLocus:
    """Eigenvalues (speeds, modes) over speed (m/s), each column one mode tracked by its eigenvectors.

    `overlap` (speeds, modes) is the biorthogonal overlap with the same mode at the speed before; well below 1 it says
    that the tracking is doubtful there (modes that exchange their shapes, or pairs that become real).
    """

    speeds: Float[np.ndarray, "speeds"]  # m/s
    names: list[str]
    eigenvalues: Complex[np.ndarray, "speeds modes"]  # 1/s
    overlap: Float[np.ndarray, "speeds modes"]  # dimensionless, 0 to 1

    @property
    def damping_ratio(self) -> Float[np.ndarray, "speeds modes"]:
        """zeta = -Re(lambda)/|lambda| of each mode at each speed; negative means unstable."""
        return damping_ratios(self.eigenvalues)

    def plot(self, axes: "Axes", limit: float = 0.6, marks: Mapping[str, float] | None = None) -> None:
        """Damping ratio in % over speed in km/h, a line a mode; twins that differ by the phase of the bogies share a colour.

        Args:
            axes: where it is drawn.
            limit: damping ratio, dimensionless; modes that are never less damped are left out.
            marks: speeds in km/h by the name that each gets beside a line across the diagram; the first two are drawn.
        """
        damping = self.damping_ratio
        order = np.argsort(damping.min(axis=0))
        colours: dict[str, str] = {}
        for k in [k for k in order if damping[:, k].min() < limit]:
            # twins, alike but for the phase of the bogies, share a colour
            kind, _, phase = self.names[k].partition(", ")
            if kind not in colours and len(colours) == len(COLOURS):
                break
            colour = colours.setdefault(kind, COLOURS[len(colours) % len(COLOURS)])
            style = (0, (4, 3)) if phase.startswith("bogies in opposition") else "-"
            axes.plot(self.speeds * KMH, 100 * damping[:, k], color=colour, linestyle=style, label=self.names[k])
        axes.axhline(0.0, color="0.2", linewidth=0.8)
        for (name, speed), style in zip((marks or {}).items(), (":", "-."), strict=False):
            axes.axvline(speed, color="0.35", linestyle=style, linewidth=1.2, label=f"{name}, {speed:.1f} km/h")
        axes.set(
            xlabel="speed, km/h",
            ylabel="damping ratio, %",
            xlim=(self.speeds[0] * KMH, self.speeds[-1] * KMH),
        )
        legend_above(axes, 2)


@guarded(speeds=SPEED)
def root_locus(vehicle: Vehicle, speeds: Float[np.ndarray, "speeds"], damper: Damper = PASSIVE) -> RootLocus:
    """Every oscillating mode over the speed, tracked from the highest down to the lowest.

    Modes of neighbouring speeds belong together by the overlap |w_i^H r_j| of left and right eigenvectors. Names are those at the
    highest speed, where the parts are told apart best.

    Args:
        vehicle: a single vehicle, without lanes.
        speeds: two or more in rising order, shape `(speeds,)`, m/s; where `overlap` of the result is well below 1 a finer step is
            needed.
        damper: what takes the place of rho_cy, linearised at rest; by default the vehicle's own.

    Raises:
        InputError: for speeds that are not positive or do not rise, and in single precision.
    """
    from scipy.optimize import linear_sum_assignment

    speeds = np.asarray(speeds, float)
    if speeds.ndim != 1 or len(speeds) < 2 or not np.all(np.diff(speeds) > 0) or not speeds[0] > 0:
        raise InputError("speeds must be at least two positive numbers (m/s) in rising order")
    require_double_precision("the modes")
    matrices, _ = along_speed(vehicle, damper)(speeds)
    here = _modes_of(vehicle, float(speeds[-1]), matrices[-1])
    count = int(np.sum(here.eigenvalues.imag > 0))
    order = np.flatnonzero(here.eigenvalues.imag > 0)
    names = [here.names[k] for k in order]
    columns = [here.eigenvalues[order]]
    overlaps = [np.ones(count)]
    left = here.left[:, order]
    for speed, matrix in zip(speeds[-2::-1], matrices[-2::-1], strict=True):
        below = _modes_of(vehicle, float(speed), matrix)
        scale = np.linalg.norm(left, axis=0)[:, None] * np.linalg.norm(below.right, axis=0)
        match = np.abs(left.conj().T @ below.right) / scale
        match = match / np.maximum(match.max(axis=1, keepdims=True), 1e-300)
        _, chosen = linear_sum_assignment(match, maximize=True)
        columns.append(below.eigenvalues[chosen])
        overlaps.append(match[np.arange(count), chosen])
        left = below.left[:, chosen]
    return RootLocus(speeds, names, np.array(columns[::-1]), np.array(overlaps[::-1]))
