"""What UIC 518 / EN 14363 asks of the lateral running behaviour: quantities, their treatment, their limits, where each is from."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ...base.typing import Number

#: lowest sampling rate, Hz (EN 14363, recalled): ten times the highest corner
SAMPLING = 200.0
#: sections that a test zone must have (UIC 518, recalled)
SECTIONS = 25
#: shortest section of any test zone, m (that of tight curves; recalled)
SHORTEST = 70.0
#: (window, step) in m: of SumY (read in GENSYS' course page), of the instability criterion (recalled)
MEAN_OVER, RMS_OVER = (2.0, 0.5), (100.0, 10.0)
#: half width of the instability criterion's band, Hz, and its lowest frequency
HALF_BAND, LOWEST = 2.0, 0.4

#: of records without the forces of single wheels
NO_WHEELS = "Y/Q and the guiding force Y of one wheel: the record has the sum of both wheels only; vehicles on profiles have them"
NOT_ASSESSED = (
    "Q, its quasi-static value and vertical accelerations: no vertical dynamics",
    "worn profiles, the conicities, cant deficiencies and loads that the standard asks for",
)


class Given(NamedTuple):
    """What the limits depend on."""

    axle_load: Number | None  # P = 2 Q, N
    bogie_mass: Number | None  # M, with its wheelsets, kg
    prudhomme_factor: float  # α
    derailment_limit: Number = 0.8  # of Y/Q
    radius: Number = np.inf  # mean of a zone's curves, m


def prudhomme_limit(axle_load: Number, factor: float = 1.0) -> Number:
    """α (10 kN + P/3) in N, for P in N: 30.5 kN for 61.5 kN; α is 1, for wagons 0.85."""
    return factor * (10e3 + axle_load / 3.0)


def bogie_limit(bogie_mass: Number) -> Number:
    """12 - M/5 in m/s^2 with M in t; `bogie_mass` in kg."""
    return 12.0 - bogie_mass / 5e3


def nadal_limit(flange_angle: Number, friction: Number) -> Number:
    """Y/Q at which a wheel begins to climb (Nadal 1908): (tan δ - μ)/(1 + μ tan δ), of the flange's angle δ in rad; 1.2 for 70° and
    a friction of 0.3, 0.8 for 60° and 0.36."""
    slope = np.tan(flange_angle)
    return (slope - friction) / (1.0 + friction * slope)


def quasistatic_limit(radius: Number) -> Number:
    """30 kN + 10500 kN m/R_m in N, of a zone's mean `radius` in m (recalled): 65 kN at 300 m."""
    return 30e3 + 10.5e6 / radius


class Criterion(NamedTuple):
    """A quantity of the standard: how it is treated and what limits it."""

    name: str
    unit: str
    signal: str  # which array of `RunningRecord`
    band: tuple[float | None, float | None] | None  # Hz; None: f0 ± 2 Hz
    statistic: str  # "percentiles", "rms", "median", "sliding rms"
    k: float | None  # of x_mean + k s
    limit: Callable[[Given], Number]
    sources: str


_READ, _RECALLED = "published (course page of GENSYS on UIC 518 and EN 14363)", "recalled (UIC 518, EN 14363)"

#: the quantities, their treatment and their limits; k = 3 for safety, 2.2 for ride
CRITERIA: dict[str, Criterion] = {
    "guiding_force_sum": Criterion(
        "sum of guiding forces SumY, 2 m mean", "N", "guiding_force", (None, 20.0), "percentiles", 3.0,
        lambda given: prudhomme_limit(given.axle_load, given.prudhomme_factor),
        f"filter, mean and percentiles {_READ}; limit published (Prud'homme; read in secondary texts); alpha and k {_RECALLED}",
    ),
    "derailment": Criterion(
        "derailment quotient Y/Q, 2 m mean", "1", "derailment_quotient", (None, 20.0), "percentiles", 3.0,
        lambda given: given.derailment_limit,
        f"filter, mean and percentiles {_READ}; k {_RECALLED}; limit Nadal's of flange angle and friction, or 0.8 {_RECALLED}",
    ),
    "bogie_safety": Criterion(
        "bogie frame acceleration over the axles", "m/s^2", "bogie_acceleration", (None, 10.0), "percentiles", 3.0,
        lambda given: bogie_limit(given.bogie_mass), f"all {_RECALLED}, simplified measuring method",
    ),
    "carbody_safety": Criterion(
        "car body acceleration over the bogies, safety", "m/s^2", "carbody_acceleration", (None, 6.0), "percentiles", 3.0,
        lambda given: 3.0, f"all {_RECALLED}, simplified measuring method",
    ),
    "carbody_ride": Criterion(
        "car body acceleration over the bogies, ride", "m/s^2", "carbody_acceleration", (0.4, 10.0), "percentiles", 2.2,
        lambda given: 2.5, f"filter and percentiles {_READ}; limit and k {_RECALLED}",
    ),
    "carbody_ride_rms": Criterion(
        "car body acceleration over the bogies, r.m.s.", "m/s^2", "carbody_acceleration", (0.4, 10.0), "rms", 2.2,
        lambda given: 0.5, f"filter and r.m.s. {_READ}; limit and k {_RECALLED}",
    ),
    "instability_force": Criterion(
        "instability: SumY, 100 m r.m.s.", "N", "guiding_force", None, "sliding rms", None,
        lambda given: 0.5 * prudhomme_limit(given.axle_load, given.prudhomme_factor),
        f"band and sliding r.m.s. {_READ}; window and limit {_RECALLED}",
    ),
    "instability_bogie": Criterion(
        "instability: bogie frame, 100 m r.m.s.", "m/s^2", "bogie_acceleration", None, "sliding rms", None,
        lambda given: 0.5 * bogie_limit(given.bogie_mass), f"all {_RECALLED}, simplified measuring method",
    ),
}  # fmt: skip

#: signal -> how its second axis is counted
PLACES = {
    "guiding_force": "wheelset",
    "derailment_quotient": "wheel",
    "wheel_lateral_force": "wheel",
    "bogie_acceleration": "axle",
    "carbody_acceleration": "bogie",
}

#: what stands in curves beside these: medians of the sections, k = 0
QUASI_STATIC: dict[str, Criterion] = {
    "carbody_quasistatic": Criterion(
        "car body acceleration over the bogies, quasi-static", "m/s^2", "carbody_acceleration", (None, 20.0), "median", 0.0,
        lambda given: 1.5, f"all {_RECALLED}",
    ),
    "guiding_force_quasistatic": Criterion(
        "guiding force Y of a wheel, quasi-static", "N", "wheel_lateral_force", (None, 20.0), "median", 0.0,
        lambda given: quasistatic_limit(given.radius), f"all {_RECALLED}",
    ),
}  # fmt: skip


class Zone(NamedTuple):
    """A test zone: its curves, the length of its sections (m; None: by speed) and how many a full assessment takes, what is assessed."""

    name: str
    radii: tuple[float, float]  # from and below, m
    section: float | None
    sections: int
    criteria: dict[str, Criterion]


def _in_curves(bogie: float, carbody: float) -> dict[str, Criterion]:
    """Of small radii: limits as told, no instability."""
    found = {key: criterion for key, criterion in CRITERIA.items() if not key.startswith("instability")} | QUASI_STATIC
    found["bogie_safety"] = found["bogie_safety"]._replace(limit=lambda given: bogie_limit(given.bogie_mass) - bogie)
    found["carbody_safety"] = found["carbody_safety"]._replace(limit=lambda given: carbody)
    return found


#: of EN 14363, all recalled (UIC 518)
ZONES: dict[int, Zone] = {
    1: Zone("straight track", (np.inf, np.inf), None, SECTIONS, CRITERIA),
    2: Zone(
        "large radius", (600.0, np.inf), 100.0, SECTIONS, CRITERIA | {"carbody_quasistatic": QUASI_STATIC["carbody_quasistatic"]}
    ),
    3: Zone("small radius", (400.0, 600.0), 100.0, 2 * SECTIONS, _in_curves(3.0, 2.8)),
    4: Zone("very small radius", (250.0, 400.0), SHORTEST, SECTIONS, _in_curves(3.0, 2.6)),
}
