"""Units: SI inside, and the suffixes by which files and printed output name them."""

#: SI unit -> {suffix of a key in a vehicle file: factor to SI}
SUFFIXES: dict[str, dict[str, float]] = {
    "kg": {"kg": 1.0, "t": 1e3},
    "kg m^2": {"kgm2": 1.0, "tm2": 1e3},
    "m": {"m": 1.0, "mm": 1e-3},
    "m/s": {"m_per_s": 1.0, "mm_per_s": 1e-3},
    "N": {"N": 1.0, "kN": 1e3, "MN": 1e6},
    "N m": {"Nm": 1.0, "kNm": 1e3},
    "N m^2": {"Nm2": 1.0, "kNm2": 1e3},
    "N/m": {"N_per_m": 1.0, "kN_per_m": 1e3, "MN_per_m": 1e6},
    "N s/m": {"Ns_per_m": 1.0, "kNs_per_m": 1e3},
    "N m/rad": {"Nm_per_rad": 1.0, "kNm_per_rad": 1e3, "MNm_per_rad": 1e6},
    "Pa": {"Pa": 1.0, "MPa": 1e6, "GPa": 1e9},
    "s": {"s": 1.0, "ms": 1e-3},
    "1": {"": 1.0},
}

KMH = 3.6  #: km/h in one m/s


def keys_of(field: str, unit: str) -> dict[str, float]:
    """Every key by which a file may give `field`, with its factor to SI: `mass` -> {"mass_kg": 1, "mass_t": 1000}."""
    return {f"{field}_{suffix}" if suffix else field: factor for suffix, factor in SUFFIXES[unit].items()}


def handy(value: float, unit: str) -> tuple[str, float]:
    """Suffix and factor of the largest unit in which a value (SI) is not below 1, 35e3 N -> ("kN", 1e3); of 0, with a factor up to 1000."""
    suffixes = SUFFIXES.get(unit, {unit: 1.0})
    there = [(suffix, factor) for suffix, factor in suffixes.items() if factor <= (abs(value) * (1.0 + 1e-12) or 1e3)]
    return max(there or suffixes.items(), key=lambda entry: entry[1] if there else -entry[1])
