"""A damper fitted to a record: parameters, errors, what the record leaves open; prints and plots itself."""

import dataclasses
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float

from .. import bouc_wen
from ..bouc_wen import BoucWen
from .problem import Samples
from .record import Record

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FITTED = "modified Bouc-Wen damper, fitted to this record ({}): fitted, not predicted; valid for its motions and voltages"


@dataclass(frozen=True)
class Evolution:
    """What SciPy's differential evolution made of the same budget of simulated records."""

    fit_error: float
    heldout_error: float
    heldout_correlation: float
    simulations: int
    seconds: float


@dataclass(frozen=True)
class Identification:
    """A damper fitted to a record. `parameters` go into any damper that takes `BoucWen`.

    Errors are rms(F_measured - F)/std(F_measured). `standard_errors`, by name, are those of the data alone, of correlated residuals; where they
    are beyond a quarter of the value, half of what lies between it and the farther end of `intervals`: values whose profile likelihood is
    within two standard errors of the best. `posterior_errors` count the prior, a factor of e² about the published damper scaled to the record, as
    information. `correlations` (posterior) is the matrix in the order of `names`. `stretches`: x - y (m) at the start of each stretch of the
    record, `velocity_offset` (m/s) where it was fitted. `inertia` (kg) is that of the moving parts between damper and load cell: the test rig's, so no part of `parameters`.
    `starts` are the fit errors that each start reached; `simulations` counts simulated records, each tangent as one.
    """

    parameters: BoucWen
    inertia: float
    names: tuple[str, ...]
    standard_errors: dict[str, float]
    posterior_errors: dict[str, float]
    intervals: dict[str, tuple[float, float]]
    correlations: Float[np.ndarray, "names names"]
    fit_error: float  # relative
    heldout_error: float  # relative
    heldout_correlation: float  # dimensionless
    published_heldout_error: float  # relative; of the published parameters, scaled to the record
    starts: tuple[float, ...]
    method: str
    simulations: int
    seconds: float  # s
    record: Record = field(repr=False)
    force: Samples = field(repr=False)  # of the fitted damper, N
    fitted_samples: Bool[np.ndarray, "samples"] = field(repr=False)
    heldout_samples: Bool[np.ndarray, "samples"] = field(repr=False)
    stretches: tuple[float, ...] = (0.0,)  # m
    velocity_offset: float = 0.0  # m/s
    parts: int = 1  # of each sample, in which it was simulated
    evolution: Evolution | None = None

    @property
    def values(self) -> dict[str, float]:
        """Every parameter by name, `inertia` among them where it was fitted."""
        own = {f.name: float(getattr(self.parameters, f.name)) for f in bouc_wen.leaves(self.parameters)}
        return own | ({"inertia": self.inertia} if "inertia" in self.names else {})

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Parameters of which the record itself says less than half to twice: their values are the prior's as much as the record's."""
        return tuple(name for name, error in self.standard_errors.items() if not error < 0.5 * abs(self.values[name]))

    @property
    def warnings(self) -> list[str]:
        """Parameters that the record leaves open, and pairs that it cannot tell apart."""
        loose = []
        for name in self.undetermined:
            low, high = self.intervals.get(name, (-np.inf, np.inf))
            loose.append(
                f"{name}: standard error above half its value; the record hardly determines it ({low:.3g} to {high:.3g})"
            )
        rows, columns = np.nonzero(np.triu(np.abs(self.correlations) > 0.95, 1))
        pairs = [
            f"{self.names[i]} and {self.names[j]}: correlation {self.correlations[i, j]:+.3f}"
            for i, j in zip(rows, columns, strict=True)
        ]
        return loose + pairs

    def as_dict(self) -> dict[str, Any]:
        """As `railjax damper identify --json` prints it."""
        plain = {
            key: getattr(self, key) for key in ("fit_error", "heldout_error", "heldout_correlation", "published_heldout_error")
        }
        return {
            "parameters": self.values | {"n": float(self.parameters.n)},
            **plain,
            "standard_errors": self.standard_errors,
            "posterior_errors": self.posterior_errors,
            "intervals": {name: list(ends) for name, ends in self.intervals.items()},
            "undetermined": list(self.undetermined),
            "stretches": list(self.stretches),
            "velocity_offset": self.velocity_offset,
            "correlations": {"names": list(self.names), "matrix": self.correlations.tolist()},
            "warnings": self.warnings,
            "fitted": FITTED.format(self.record.name),
            "notes": list(self.record.notes),
            "method": self.method,
            "starts": list(self.starts),
            "simulations": self.simulations,
            "seconds": self.seconds,
            "evolution": None if self.evolution is None else dataclasses.asdict(self.evolution),
        }

    to_json = as_dict  # its name until 0.3

    def __str__(self) -> str:
        units = {f.name: f.metadata["unit"] for f in bouc_wen.leaves(self.parameters)} | {"inertia": "kg"}
        lines = [
            FITTED.format(self.record.name),
            f"error rms/std: fitted part {self.fit_error:.4f}, held-out part {self.heldout_error:.4f} "
            f"(published parameters: {self.published_heldout_error:.4f}); held-out correlation {self.heldout_correlation:.4f}",
            f"{self.method}, {len(self.starts)} starts that reached {min(self.starts):.4f} to {max(self.starts):.4f}; {self.seconds:.1f} s",
        ]
        for name, value in self.values.items():
            error = self.standard_errors.get(name)
            known = "  fixed " if error is None else f"± {error:<8.2g} (with the prior ± {self.posterior_errors[name]:<8.2g})"
            lines.append(f"  {name:10s} {value:12.5g} {known} {units[name]}")
        lines += [f"  beware: {entry}" for entry in self.warnings]
        if self.evolution is not None:
            e = self.evolution
            lines.append(
                f"differential evolution with as many simulations ({e.simulations}): fitted part {e.fit_error:.4f}, held-out part "
                f"{e.heldout_error:.4f}, correlation {e.heldout_correlation:.4f}; {e.seconds:.1f} s"
            )
        return "\n".join([*lines, *[f"note: {entry}" for entry in self.record.notes]])

    def plot(self, axes: "Axes", residual: "Axes | None" = None, seconds: float = 1.0) -> None:
        """Measured and fitted force over the first held-out seconds, and the residual.

        Args:
            axes: where the forces are drawn, kN over s.
            residual: where measured minus fitted is drawn over the whole record; None leaves it out.
            seconds: how much of the held-out part is shown, s.
        """
        time, force = self.record.time, self.record.force
        begin = time[np.argmax(self.heldout_samples)]
        shown = (time >= begin) & (time <= begin + seconds)
        axes.plot(time[shown], 1e-3 * force[shown], color="0.35", label="measured")
        axes.plot(time[shown], 1e-3 * self.force[shown], "--", label=f"fitted damper, held-out error {self.heldout_error:.3f}")
        axes.set(xlabel="time, s", ylabel="force, kN", xlim=(time[shown][0], time[shown][-1]))
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, borderaxespad=0.2)
        if residual is not None:
            residual.plot(time, 1e-3 * (force - self.force), linewidth=0.5)
            residual.axvline(begin, color="0.35", linestyle=":", label="held out from here")
            residual.set(xlabel="time, s", ylabel="measured - fitted, kN", xlim=(0.0, time[-1]))
            residual.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), borderaxespad=0.2)
