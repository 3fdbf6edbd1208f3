"""`railjax damper ...`: verbs about the hybrid damper, each in a function of its own."""

from pathlib import Path
from typing import Annotated

import typer

from ...base.errors import InputError
from ..common import AsJson, completing, finite, prepare, show, working
from ..files import BridgeS
from ..out import PICTURES, OutJson, as_picture, check_out, out_option

damper_app = typer.Typer(help="The hybrid magnetorheological damper: its design, its model.", no_args_is_help=True)


@damper_app.command("design")
def damper_design(
    force_n: Annotated[float, typer.Option(help="Maximal force of the hydraulic damper in N.")] = 5000.0,
    velocity_mm_per_s: Annotated[float, typer.Option(help="Velocity of that force in mm/s.")] = 100.0,
    piston_diameter_mm: Annotated[float, typer.Option(help="Piston diameter of the hydraulic damper in mm.")] = 50.0,
    rod_diameter_mm: Annotated[float, typer.Option(help="Its piston rod's diameter in mm.")] = 20.0,
    minimum_drop_bar: Annotated[float, typer.Option(help="Pressure drop of the free circuit in bar.")] = 3.0,
    pilot_diameter_mm: Annotated[float, typer.Option(help="Diameter of the pilot's piston in mm.")] = 12.0,
    opening_width_mm: Annotated[float, typer.Option(help="Opening's leg across the pilot's piston in mm.")] = 6.0,
    bore_mm: Annotated[float, typer.Option(help="Interior diameter of the MR device in mm.")] = 22.0,
    device_rod_mm: Annotated[float, typer.Option(help="Diameter of its piston rod in mm.")] = 8.0,
    device_velocity_mm_per_s: Annotated[float, typer.Option(help="Maximal velocity of its piston in mm/s.")] = 15.0,
    gap_mm: Annotated[float, typer.Option(help="Gap of the device to analyse in mm.")] = 0.4,
    pole_width_mm: Annotated[float, typer.Option(help="Pole width of the device to analyse in mm.")] = 2.0,
    coil_diameter_mm: Annotated[float, typer.Option(help="Maximal diameter of the solenoid in mm.")] = 16.0,
    coil_length_mm: Annotated[float, typer.Option(help="Length of the solenoid in mm.")] = 30.0,
    wire_diameter_mm: Annotated[float, typer.Option(help="Diameter of the wire in mm.")] = 0.6,
    current_a: Annotated[float, typer.Option(help="Maximal current in A.")] = 1.5,
    field_ka_per_m: Annotated[float, typer.Option(help="Field in the gap to design for in kA/m.")] = 250.0,
    yield_stress_kpa: Annotated[float, typer.Option(help="Yield stress of the MR fluid at that field in kPa.")] = 44.1,
    viscosity_pa_s: Annotated[float, typer.Option(help="Viscosity of the MR fluid in Pa s.")] = 0.25,
    iron_limit_t: Annotated[float, typer.Option(help="Flux density allowed in the iron in T (assumed).")] = 1.5,
    out: OutJson = None,
    as_json: AsJson = False,
) -> None:
    """Design of the hybrid damper: the pilot's hydraulics, the MR device given, and the MR device that meets the force best.

    Every number of Tables 2-5 beside the paper's, as long as the inputs are the paper's.

    Example: railjax damper design --force-n 6000
    """
    options = {name: value for name, value in locals().items() if name not in ("as_json", "out")}
    check_out(out)
    finite(**options)

    from ...dampers.hardware.design import Requirements, design_hybrid
    from ...dampers.hardware.hydraulics import HydraulicDamper, Pilot
    from ...dampers.hardware.mr_device import MrDevice, MrFluid
    from ...reports.paper.studies.damper import ASSUMED, inputs, lines, quantities

    prepare()
    damper = HydraulicDamper(piston_diameter_mm / 1e3, rod_diameter_mm / 1e3, force_n, velocity_mm_per_s / 1e3)
    pilot = Pilot(pilot_diameter_mm / 1e3, opening_width_mm / 1e3, minimum_drop_bar * 1e5)
    device = MrDevice(
        bore=bore_mm / 1e3,
        rod_diameter=device_rod_mm / 1e3,
        gap=gap_mm / 1e3,
        pole_width=pole_width_mm / 1e3,
        coil_diameter=coil_diameter_mm / 1e3,
        coil_length=coil_length_mm / 1e3,
        wire_diameter=wire_diameter_mm / 1e3,
    )
    fluid = MrFluid(yield_stress_kpa * 1e3, field_ka_per_m * 1e3, viscosity_pa_s)
    requirements = Requirements(velocity=device_velocity_mm_per_s / 1e3, current=current_a, iron_limit=iron_limit_t)
    design = design_hybrid(damper, pilot, device, fluid, requirements=requirements)
    given, computed = inputs(design), quantities(design)
    content = {
        "inputs": [q.as_dict() for q in given],
        "quantities": [q.as_dict() for q in computed],
        "design": {
            "gap_mm": design.designed.device.gap * 1e3,
            "pole_width_mm": design.designed.device.pole_width * 1e3,
            "core_diameter_mm": design.designed.device.core_diameter * 1e3,
            "layers": design.designed.layers,
            "turns": design.designed.device.turns,
            "force_n": float(design.designed.forces.total_force),
            "dynamic_range": float(design.designed.forces.dynamic_range),
            "fluid_volume_mm3": float(design.designed.forces.active_volume) * 1e9,
        },
        "assumed": ASSUMED,
    }
    same = all(q.paper == q.computed for q in given)
    remark = [] if same else ["The inputs are not the paper's, so its results are left out."]
    head = f"{'':54s} {'paper':>8s} {'railjax':>9s}"
    text = [head, *lines(given, given=True), "", *lines(computed), "", *remark, *[f"assumed: {entry}" for entry in ASSUMED]]
    show(content, text, as_json, out)


LAWS, METHODS = ("saturating", "linear"), ("levenberg-marquardt", "adam")
Column = Annotated[
    str | None, typer.Option(help="Its column, or its number from 1; else the header is searched.", show_default=False)
]
Unit = Annotated[str | None, typer.Option(help="Its unit; else as the header says, else SI.", show_default=False)]


@damper_app.command("identify")
def damper_identify(
    files: Annotated[
        list[Path],
        typer.Argument(metavar="FILE.csv...", help="Test records of one damper: motion, command and force; fitted as one."),
    ],
    time: Column = None,
    displacement: Column = None,
    velocity: Column = None,
    command: Column = None,
    force: Column = None,
    time_unit: Unit = None,
    displacement_unit: Unit = None,
    velocity_unit: Unit = None,
    command_unit: Unit = None,
    force_unit: Unit = None,
    sample_rate: Annotated[
        float | None,
        typer.Option("--sample-rate", "--sample-rate-hz", help="Sampling rate in Hz; it has the last word over the time."),
    ] = None,
    bridge_s: BridgeS = None,
    voltage_law: Annotated[
        str, typer.Option(help="saturating or linear (the paper's eqs. 15-17).", autocompletion=completing(lambda: LAWS))
    ] = "saturating",
    inertia: Annotated[bool, typer.Option(help="Fit an inertia between damper and load cell.")] = True,
    method: Annotated[
        str, typer.Option(help="levenberg-marquardt or adam.", autocompletion=completing(lambda: METHODS))
    ] = "levenberg-marquardt",
    starts: Annotated[int, typer.Option(help="Starts in one batch.")] = 4,
    fit_share: Annotated[float, typer.Option(help="Share of the record that is fitted; the rest is held out.")] = 0.7,
    settle_s: Annotated[float, typer.Option(help="Seconds at the start that are not scored.")] = 1.0,
    leave_out_jolts: Annotated[
        bool, typer.Option("--leave-out-jolts", help="Neither fit nor score where a rig runs into its stops.")
    ] = False,
    evolution: Annotated[bool, typer.Option(help="Compare with differential evolution on the same budget.")] = True,
    seed: Annotated[int, typer.Option(help="Of the random starts.")] = 0,
    out: Annotated[Path | None, out_option("fit and residual, drawn, or the result", *PICTURES)] = None,
    as_json: AsJson = False,
) -> None:
    """Parameters of a modified Bouc-Wen damper from a test record, with standard errors, scored on a held-out part.

    --command none says that the record has none.

    Example: railjax damper identify test.csv --displacement D --displacement-unit mm --command U --force F
    """
    for name, value, known in (
        ("voltage-law", voltage_law, LAWS),
        ("method", method, METHODS),
    ):
        if value not in known:
            raise InputError(f"--{name} must be one of {', '.join(known)}, not {value!r}")
    finite(sample_rate=sample_rate)
    finite(positive=False, fit_share=fit_share, settle_s=settle_s, bridge_s=bridge_s)
    check_out(out, *PICTURES)

    from ...base.stamps import BRIDGE
    from ...dampers.identification.identify import identify_damper
    from ...dampers.identification.record import read_record

    prepare()
    bridge = BRIDGE if bridge_s is None else bridge_s
    columns = {"time": time, "displacement": displacement, "velocity": velocity, "command": command, "force": force}
    units = {
        "time": time_unit,
        "displacement": displacement_unit,
        "velocity": velocity_unit,
        "command": command_unit,
        "force": force_unit,
    }
    with working(f"identifying {', '.join(file.name for file in files)}"):
        found = identify_damper(
            [read_record(file, columns=columns, units=units, sample_rate=sample_rate, bridge=bridge) for file in files],
            voltage_law=voltage_law,
            inertia=inertia,
            method=method,
            starts=starts,
            fit_share=fit_share,
            settle=settle_s,
            leave_out_jolts=leave_out_jolts,
            evolution=evolution,
            seed=seed,
        )
    drawn = as_picture(lambda axes: found.plot(axes[0, 0], residual=axes[1, 0]), rows=2, height=2.7)
    show(found.as_dict(), [str(found)], as_json, out, drawn)
