"""Every comparison with a number from outside, as a Markdown table: `python benchmarks/validation.py` (20 s; --json for machines).

    python benchmarks/validation.py --page notebooks/pages/validation.md     # writes the table into the page

"Published" numbers could be read at the source that is named; those marked "recalled" could not. A comparison that was a target of a
calibration is marked "fitted" and says nothing about the model. What the paper on the hybrid damper reports beyond these rows (36
quantities and its figures) is compared by `railjax reproduce`.
"""

import argparse
import datetime
import json
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp

import railjax
from railjax.dampers.hardware import hydraulics
from railjax.model.contact.creep import saturation_factor

BEGIN, END = "<!-- table -->", "<!-- end of table -->"
PAPER, COOPERRIDER = "the paper, section 4", "bifurcation.de, exd10 (after Kaas-Petersen 1986)"
KALKER = "Kalker 1990, table E3"
#: a/b, Poisson's ratio, C11, C22, C23
KALKER_ENTRIES = [(0.3, 0.25, 3.44, 2.75, 0.715), (1.0, 0.25, 4.12, 3.67, 1.47), (1 / 0.7, 0.25, 4.54, 4.21, 1.95)]
#: u to F/(mu N), closed form 1 - (1 - u/3)^3
VERMEULEN_JOHNSON = {0.5: 0.4212963, 1.0: 0.7037037, 2.0: 0.9629630}
#: Hz to weighting factor x 1000
WD = {0.5: 853, 1: 1011, 2: 890, 4: 512, 8: 253, 16: 125}
WK = {1: 482, 4: 967, 8: 1036, 16: 768}
MISPRINT = "wrongly rounded there"


class Row(NamedTuple):
    """A comparison; `digits` to which the source gives its number."""

    quantity: str
    source: str
    published: float
    ours: float
    digits: str  # a format
    note: str = ""

    @property
    def difference(self) -> float:
        """Relative difference from what was published."""
        return self.ours / self.published - 1.0

    def __str__(self) -> str:
        ours = f"{self.ours:{self.digits}}"
        cells = (
            self.quantity,
            self.source,
            f"{self.published:{self.digits}}",
            ours,
            f"{100 * self.difference + 1e-9:+.2f} %",
            self.note,
        )
        return "| " + " | ".join(cells) + " |"


def contact() -> list[Row]:
    """Creep coefficients and saturation."""
    rows = []
    for ratio, poisson, *entries in KALKER_ENTRIES:
        found = railjax.kalker_coefficients(ratio, poisson)
        for name, published in zip(("c11", "c22", "c23"), entries, strict=True):
            label = f"Kalker's {name.upper()}, a/b = {ratio:.3g}, Poisson {poisson:g}"
            rows.append(Row(label, KALKER, published, float(getattr(found, name)), ".3g", "a node of the interpolation"))
    for u, published in VERMEULEN_JOHNSON.items():
        rows.append(
            Row(
                f"saturation F/(mu N) at u = {u:g}",
                "Vermeulen and Johnson",
                published,
                u * float(saturation_factor(jnp.asarray(u))),
                ".7f",
            )
        )
    return rows


def ride() -> list[Row]:
    """Frequency weightings of ride comfort."""
    rows = []
    for name, table in (("Wd", WD), ("Wk", WK)):
        for frequency, published in table.items():
            found = 1e3 * abs(complex(railjax.weighting(name, float(frequency))))
            note = MISPRINT if (name, frequency) == ("Wk", 16) else ""
            rows.append(Row(f"{name} x 1000 at {frequency} Hz", "ISO 2631-1 (1997)", published, found, ".0f", note))
    for frequency, published in ((1.0, 0.61307), (5.0, 1.01881)):
        found = abs(complex(railjax.weighting("sperling-lateral", frequency)))
        rows.append(Row(f"Sperling's B, lateral, {frequency:g} Hz", "closed form, recalled", published, found, ".5f"))
    return rows


def track() -> list[Row]:
    """Spectra of the lateral alignment."""
    levels = {"erri-low": 2.003277e-5, "erri-high": 5.790502e-5}
    return [
        Row(
            f"{name}, S(0.1 rad/m), m^2/(rad/m)",
            "ERRI B176, closed form, recalled",
            published,
            float(railjax.spectrum(name).density(0.1)),
            ".6e",
        )
        for name, published in levels.items()
    ]


def damper() -> list[Row]:
    """The pilot of the hybrid damper, from the numbers as the paper rounds them."""
    exact = hydraulics.size_pilot(hydraulics.HydraulicDamper(), hydraulics.Pilot())
    sizes = hydraulics.size_pilot(hydraulics.HydraulicDamper(), hydraulics.Pilot(), flow=1.65e-4, drop=30.31e5)
    listed = [
        ("A_p, cm^2", 16.5, exact.area * 1e4, ".1f", ""),
        ("flow, 1e-4 m^3/s", 1.65, exact.flow * 1e4, ".2f", ""),
        ("pressure drop, bar", 30.31, exact.drop / 1e5, ".2f", "cut off there, not rounded: 30.3152"),
        ("A_o min, mm^2", 3.26, sizes.smallest_opening * 1e6, ".2f", ""),
        ("A_o max, mm^2", 10.36, sizes.largest_opening * 1e6, ".2f", ""),
        ("F min, N", 34, sizes.smallest_force, ".0f", ""),
        ("F max, N", 343, sizes.largest_force, ".0f", ""),
        ("stroke, closed, mm", 0.54, sizes.narrowest_stroke * 1e3, ".2f", ""),
        ("stroke, open, mm", 1.73, sizes.widest_stroke * 1e3, ".2f", ""),
    ]
    return [Row(name, PAPER, published, float(ours), digits, note) for name, published, ours, digits, note in listed]


def device() -> list[Row]:
    """The MR device as it is dimensioned in the paper: a number that does not follow from its inputs."""
    from railjax.dampers.hardware.mr_device import MrDevice, MrFluid, analyse

    force = analyse(MrDevice(), MrFluid()).total_force
    note = "does not follow from Tables 3 and 4; `railjax damper design` lists the readings"
    return [Row("total force of the MR device, N", "the paper, Table 5", 406.7, float(force), ".1f", note)]


def hunting() -> list[Row]:
    """Critical speeds, linear and nonlinear."""
    bogie, coach = railjax.load_vehicle("cooperrider-bogie"), railjax.load_vehicle("coach")
    hopf = float(railjax.linear_critical_speed(bogie))
    note = "half gauge, wheel radius, conicity and yaw stiffness recalled"
    rows = [Row("Hopf point of Cooperrider's bogie, m/s", COOPERRIDER, 68.66, hopf, ".2f", note)]
    linear, fold = railjax.linear_critical_speed(coach), railjax.nonlinear_critical(coach)
    fitted = [
        ("linear critical speed of the coach, km/h", 245.6, linear * 3.6, ".1f"),
        ("nonlinear critical speed, km/h", 234.2, fold.speed * 3.6, ".1f"),
        ("amplitude at the fold, mm", 9.0, fold.amplitude * 1e3, ".1f"),
    ]
    return rows + [
        Row(name, "the paper, figs. 5 and 6", published, float(ours), digits, "fitted")
        for name, published, ours, digits in fitted
    ]


#: cheap ones first
GROUPS = {"contact": contact, "ride": ride, "track": track, "damper": damper, "device": device, "hunting": hunting}


def table(rows: list[Row]) -> str:
    """As Markdown, with what it was made with."""
    head = "| quantity | source | published | railjax | difference | note |\n|---|---|---|---|---|---|"
    made = f"Made on {datetime.date.today():%Y-%m-%d} by railjax {railjax.__version__} with JAX {jax.__version__}."
    return "\n".join([made, "", head, *map(str, rows)])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    parser.add_argument("--page", type=Path, help="write the table into this page, between its two markers")
    options = parser.parse_args()
    railjax.use_double_precision()
    rows = [row for group in GROUPS.values() for row in group()]
    if options.json:
        print(json.dumps([row._asdict() | {"difference": row.difference} for row in rows]))
        return
    print(table(rows))
    if options.page:
        text = options.page.read_text(encoding="utf-8")
        before, after = text.partition(BEGIN)[0], text.partition(END)[2]
        options.page.write_text(f"{before}{BEGIN}\n\n{table(rows)}\n\n{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
