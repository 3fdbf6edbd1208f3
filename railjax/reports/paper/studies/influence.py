"""What the suspension's values decide: figs. 7-9 (critical speeds), what every parameter of Table 1 does to them, fig. 10."""

import jax
import jax.numpy as jnp
import numpy as np

from ....base.style import COLOURS, figure, legend_above, mark_paper
from ....base.units import KMH
from ....model.parameters import get_parameter, parameters, replace, set_parameter
from ....model.vehicle import Vehicle
from ....plots.charts import tornado
from ....stability.hunting.nonlinear_critical import Hunting, nonlinear_critical, nonlinear_critical_speed
from ....stability.hunting.sensitivity import changes, parameter_label
from ....stability.linear_critical import linear_critical_speed
from ..study import Context, Outcome, Picture, Statement, study
from .hunting import PAPER_NONLINEAR
from .passive import AMPLITUDE, ASSUMED_TRACK, PAPER_LINEAR, WAVELENGTH, periodic_run


def one_at_a_time(vehicle: Vehicle, values: dict[str, np.ndarray]) -> Vehicle:
    """Values (SI) of each parameter alone, the others the vehicle's own: one batch for all, in the order given, the vehicle itself last."""
    lanes = sum(len(own) for own in values.values()) + 1
    start = 0
    for path, own in values.items():
        column = np.full(lanes, float(get_parameter(vehicle, path)))
        column[start : start + len(own)] = own
        vehicle = set_parameter(vehicle, path, jnp.asarray(column))
        start += len(own)
    return vehicle


def _apart(values: dict[str, np.ndarray], lanes: np.ndarray) -> dict[str, np.ndarray]:
    """What a batch of `one_at_a_time` gave, by parameter."""
    return dict(zip(values, np.split(lanes[:-1], np.cumsum([len(own) for own in values.values()])[:-1]), strict=True))


#: slug, title, label, spacing, points (few where curves are almost straight), and per curve: parameter, label, range (SI); factor to the unit shown
INFLUENCES = (
    (
        "fig-7",
        "Fig. 7: primary suspension stiffness",
        "stiffness of primary suspension, MN/m",
        np.geomspace,
        24,
        (
            ("primary.stiffness_x", "$k_{ox}$ longitudinal", (0.25e6, 20e6)),
            ("primary.stiffness_y", "$k_{oy}$ lateral", (0.25e6, 20e6)),
        ),
        1e-6,
    ),
    (
        "fig-8",
        "Fig. 8: primary suspension damping",
        "damping of primary suspension, kN s/m",
        np.linspace,
        10,
        (
            ("primary.damping_x", r"$\rho_{ox}$ longitudinal", (0.0, 100e3)),
            ("primary.damping_y", r"$\rho_{oy}$ lateral", (0.0, 100e3)),
        ),
        1e-3,
    ),
    (
        "fig-9",
        "Fig. 9: secondary suspension stiffness",
        "lateral stiffness of secondary suspension, kN/m",
        np.linspace,
        8,
        (("secondary.stiffness_y", "$k_{cy}$ lateral", (20e3, 800e3)),),
        1e-3,
    ),
)


@study("figs-7-9", "Figs. 7-9: influence of the suspension on the critical speeds")
def suspension_influence(context: Context) -> Outcome:
    """Linear and nonlinear critical speed over k_ox and k_oy, rho_ox and rho_oy, k_cy."""
    values = {path: spacing(*ends, points) for *_, spacing, points, curves, _ in INFLUENCES for path, _, ends in curves}
    found = nonlinear_critical(one_at_a_time(context.coach, values))
    both = [np.where(np.isfinite(v), v, np.nan) for v in (np.asarray(v) * KMH for v in (found.linear.speed, found.speed))]
    (crossing, fold), codes = (_apart(values, v) for v in both), _apart(values, np.asarray(found.code))
    own = [v[-1] for v in both]
    pictures, change = [], {}
    for slug, title, label, *_, curves, factor in INFLUENCES:
        with figure() as (page, axes):
            for k, (path, name, _) in enumerate(curves):
                for of, style, kind in ((crossing, "--", "linear"), (fold, "-", "nonlinear")):
                    axes[0, 0].plot(values[path] * factor, of[path], style, color=COLOURS[k], label=f"{name}, {kind}")
                here = float(get_parameter(context.coach, path)) * factor
                axes[0, 0].plot([here] * 2, own, "o", color=COLOURS[k])
                change[path] = [(np.nanmin(v), np.nanmax(v)) for v in (crossing[path], fold[path])]
            mark_paper(axes[0, 0], PAPER_LINEAR, f"paper, Table 1: {PAPER_LINEAR} and {PAPER_NONLINEAR} km/h")
            mark_paper(axes[0, 0], PAPER_NONLINEAR, "_")
            axes[0, 0].set(xlabel=label, ylabel="critical speed, km/h")
            if slug == "fig-7":
                axes[0, 0].set_xscale("log")
            legend_above(axes[0, 0], 2)
        met = np.concatenate([codes[path] for path, *_ in curves])
        missed = int(np.sum((met != Hunting.OK) & (met != Hunting.SUPERCRITICAL)))
        gaps = f" {missed} of {len(met)} folds could not be followed: gaps." if missed else ""
        joined = " Where the two are one there is no fold (supercritical)." if np.any(met == Hunting.SUPERCRITICAL) else ""
        pictures.append(
            Picture(
                slug,
                f"{title} and the critical speeds",
                "Each parameter alone is varied, the others stay at the calibrated coach's values (dots: its own value). Dashed: linear "
                "critical speed; solid: nonlinear, the fold of the limit cycles. The levels at the dots are fitted, slopes and shapes "
                f"are predicted.{joined}{gaps}",
                f"{title}: linear (dashed) and nonlinear (solid) critical speed in km/h over {label}.",
                page,
            )
        )
    ranges = {
        path: f"{linear[0]:.0f} to {linear[1]:.0f} km/h (nonlinear {nonlinear[0]:.0f} to {nonlinear[1]:.0f})"
        for path, (linear, nonlinear) in change.items()
    }

    def strong(path: str) -> bool:
        """Read as: over the whole range it moves one of the critical speeds by more than a tenth."""
        return any(high - low > 0.1 * PAPER_LINEAR for low, high in change[path])

    statements = [
        Statement(
            "The critical speed is strongly influenced by k_ox.",
            "section 2, fig. 7",
            strong("primary.stiffness_x"),
            f"0.25 to 20 MN/m: {ranges['primary.stiffness_x']}; k_oy: {ranges['primary.stiffness_y']}",
        ),
        Statement(
            "The critical speed is strongly influenced by rho_oy.",
            "section 2, fig. 8",
            strong("primary.damping_y"),
            f"0 to 100 kN s/m: {ranges['primary.damping_y']}; it is the longitudinal damper rho_ox that moves it: "
            f"{ranges['primary.damping_x']}",
        ),
        Statement(
            "The critical speed is strongly influenced by the secondary lateral stiffness k_cy.",
            "section 2, fig. 9",
            strong("secondary.stiffness_y"),
            f"20 to 800 kN/m: {ranges['secondary.stiffness_y']} for a fortyfold change",
        ),
    ]
    assumptions = [
        "'Strongly influenced' is read as: over the range shown the linear or the nonlinear critical speed changes by more than a tenth.",
        "rho_ox and rho_oy of the coach itself: zero (Table 1 does not list them, although fig. 8 varies rho_oy).",
    ]
    return Outcome(statements=statements, pictures=pictures, assumptions=assumptions)


SHOWN = 0.2  # km/h; parameters that move neither critical speed by more are listed, not drawn


def sensitivities(vehicle: Vehicle, share: float = 0.1) -> dict[str, tuple[float, float]]:
    """Change of the linear and the nonlinear critical speed (km/h) by the gradient, for `share` more of every parameter that counts."""
    gradients = jax.grad(linear_critical_speed)(vehicle), jax.grad(nonlinear_critical_speed)(vehicle)
    linear, nonlinear = (changes(vehicle, gradient, share) for gradient in gradients)
    return {path: (linear[path], nonlinear[path]) for path in linear}


@study("sensitivity", "Which parameters decide the critical speeds", beyond=True)
def sensitivity(context: Context) -> Outcome:
    """Exact gradients of both critical speeds with respect to every parameter."""
    changes = sensitivities(context.coach)
    paths = sorted(changes, key=lambda path: -max(abs(change) for change in changes[path]))
    shown = [path for path in paths if max(abs(change) for change in changes[path]) >= SHOWN]
    symbols = {path: entry.metadata["symbol"] for path, entry in parameters()}
    rest = ", ".join(symbols[path] for path in paths if path not in shown)
    bars = np.array([changes[path] for path in shown])
    with figure(height=0.6 + 0.3 * len(shown)) as (page, axes):
        kinds = {"linear critical speed": bars[:, 0], "nonlinear critical speed": bars[:, 1]}
        tornado(
            axes[0, 0],
            [parameter_label(context.coach, path) for path in shown],
            kinds,
            "change for 10 % more of the parameter, km/h",
        )
    picture = Picture(
        "sensitivity",
        "Change of the critical speeds by ten per cent more of each parameter",
        "Exact gradients (reverse mode; through the fold of the limit cycles by the implicit function) of the calibrated coach, times a "
        f"tenth of each value, or a stated amount where it is zero: predicted. Not drawn, below {SHOWN:g} km/h: {rest}. Friction "
        "and flange have no part in the linear critical speed.",
        "Bars of the change of linear and nonlinear critical speed in km/h, one pair per parameter, sorted by size: "
        f"{', '.join(symbols[path] for path in shown[:5])} lead.",
        page,
    )
    note = "mu, k_f and delta are not in Table 1 (fitted or assumed), k_ox and k_oy are the calibrated ones."
    return Outcome(pictures=[picture], assumptions=[f"Sensitivities: {note}"])


@study("fig-10", "Fig. 10: lateral acceleration of the car body for several dampers")
def damper_and_acceleration(context: Context) -> Outcome:
    """Time histories for three values of rho_cy and the r.m.s. over rho_cy, at 180 km/h on the periodic track."""
    shown = np.array([1.0, 2.0, 4.0])
    own = float(context.coach.secondary.damping_y)
    scale = np.concatenate([shown, np.geomspace(0.1, 10.0, 61)])
    damping = own * scale
    vehicle = replace(context.coach, secondary__damping_y=jnp.asarray(damping))
    run = periodic_run(vehicle, record=["carbody_acceleration"], reduce=["rms:carbody_acceleration"], sample=0.01)
    acceleration, rms = np.asarray(run["carbody_acceleration"]), np.asarray(run["rms:carbody_acceleration"])
    time = np.asarray(run.time)
    last = time >= time[-1] - 2.0
    with figure(rows=2, height=2.7) as (page, axes):
        for k in range(len(shown)):
            axes[0, 0].plot(time[last], acceleration[last, k], label=rf"$\rho_{{cy}}$ = {1e-3 * damping[k]:g} kN s/m")
        axes[0, 0].set(xlabel="time, s", ylabel="car body acceleration,\nm/s²", xlim=(time[last][0], time[-1]))
        legend_above(axes[0, 0])
        axes[1, 0].semilogx(1e-3 * damping[3:], rms[3:], color=COLOURS[3])
        axes[1, 0].plot(1e-3 * damping[:3], rms[:3], "o", color=COLOURS[3])
        axes[1, 0].axvline(1e-3 * own, label="Table 1: 25 kN s/m", color="0.35", linestyle=":")
        axes[1, 0].set(
            xlabel=r"secondary lateral damping $\rho_{cy}$ per side, kN s/m",
            ylabel="r.m.s. of acceleration,\nm/s²",
            ylim=(0, None),
        )
        axes[1, 0].legend()
    best = 1e-3 * damping[3:][np.argmin(rms[3:])]
    numbers = ", ".join(f"{1e-3 * d:g} kN s/m: {r:.3f} m/s²" for d, r in zip(damping[:3], rms[:3], strict=True))
    return Outcome(
        statements=[
            Statement(
                "More rigid dampers in the central suspension are worse for comfort.",
                "section 2, fig. 10",
                bool(np.all(np.diff(rms[:3]) > 0)),
                f"r.m.s. at 180 km/h: {numbers}; least at {best:.3g} kN s/m",
            )
        ],
        pictures=[
            Picture(
                "fig-10",
                "Fig. 10: lateral acceleration of the car body for several dampers",
                f"180 km/h, {1e3 * AMPLITUDE:g} mm and {WAVELENGTH:g} m (assumed). The paper does not say which values it compares; here once, twice and "
                "four times Table 1's, and the r.m.s. over a hundredfold range. Predicted.",
                "Above: acceleration over 2 s for three damper values. Below: r.m.s. acceleration over damping.",
                page,
            )
        ],
        assumptions=[ASSUMED_TRACK],
    )
