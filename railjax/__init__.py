"""railjax: a differentiable simulator of the lateral dynamics of rail vehicles, on JAX.

    import railjax

    railjax.use_double_precision()
    coach = railjax.load_vehicle("coach")
    print(railjax.linear_critical_speed(coach) * 3.6, "km/h")

Importing it changes no JAX configuration and starts no backend; a module is imported when a name of it is first used.
"""

import importlib
import importlib.util
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .base.batches import use_all_cores
    from .base.compilation import jit
    from .base.errors import InputError, NumericalError
    from .base.precision import use_double_precision
    from .base.programs import keep_compiled
    from .dampers.balance_logic import BalanceLogic
    from .dampers.bouc_wen import BoucWen
    from .dampers.bouc_wen_damper import BoucWenDamper, HybridDamper
    from .dampers.clipped_lqr import ClippedLQR
    from .dampers.control.controller import Controller
    from .dampers.control.device import Device, Faults
    from .dampers.control.estimators import ComplementaryFilter
    from .dampers.control.kalman import KalmanFilter
    from .dampers.control.law_files import load_law
    from .dampers.control.learned import LearnedDamper
    from .dampers.control.sensors import Sensors
    from .dampers.identification.identify import identify_damper
    from .dampers.identification.record import Record, read_record
    from .dampers.identification.result import Identification
    from .dampers.maxwell import MaxwellDamper
    from .dampers.skyhook import ADD, MixedSkyhookADD, Skyhook
    from .model.contact.conicity import equivalent_conicity, nonlinearity_parameter
    from .model.contact.geometry import ContactGeometry, contact_geometry
    from .model.contact.kalker import contact_ellipse, creep_coefficients, kalker_coefficients
    from .model.contact.profile_table import with_profiles
    from .model.contact.profiles import RailProfile, WheelProfile
    from .model.contact.table import ContactTable
    from .model.damper import Damper, PassiveDamper, Seen
    from .model.motion import matrices, state_matrix, track_matrix
    from .model.parameters import get_parameter, parameters, replace, set_parameter
    from .model.track.layout import Layout
    from .model.track.measured import MeasuredTrack
    from .model.track.random import RandomTrack
    from .model.track.sampled import spectrum_of
    from .model.track.segments import Segment
    from .model.track.shapes import BumpTrack, SinusoidTrack, TangentTrack, alignment
    from .model.track.spectra import ErriSpectrum, FormulaSpectrum, FraSpectrum, Spectrum, TableSpectrum, spectrum
    from .model.vehicle import BumpStop, CrossBracing, LateralDamper, Vehicle, YawDamper
    from .plots.animation import Film, animate
    from .plots.frames import animation_channels
    from .reports.vehicle.vehicle_report import VehicleReport, vehicle_report
    from .ride.acceptance.assess import acceptance, acceptance_of_record
    from .ride.acceptance.record import RunningRecord, acceptance_channels
    from .ride.acceptance.result import Acceptance
    from .ride.acceptance.zones import ZoneAcceptance, zone_acceptance
    from .ride.comfort import comfort, floor_acceleration
    from .ride.comfort_result import Comfort
    from .ride.frequency import FrequencyResponse, frequency_response
    from .ride.spectral_comfort import SpectralComfort, spectral_comfort
    from .ride.statistical import StatisticalResponse, statistical_linearisation
    from .ride.vibration import sperling, weighted_acceleration, weighted_rms
    from .ride.weightings import weighting, weighting_filter
    from .simulation.channels import CHANNELS
    from .simulation.simulate import Result, Simulation, simulate
    from .simulation.speed import SpeedProfile
    from .stability.curving.critical import CurveCritical, curve_critical
    from .stability.curving.nonlinear import CurveNonlinear, curve_nonlinear_critical
    from .stability.curving.result import Equilibrium, SteadyCurving
    from .stability.curving.steady import curving
    from .stability.hunting.branch import hunting_branch
    from .stability.hunting.limit_cycles import Branch, LimitCycle
    from .stability.hunting.nonlinear_critical import Hunting, NonlinearCritical, nonlinear_critical, nonlinear_critical_speed
    from .stability.hunting.normal_form import first_lyapunov_coefficient
    from .stability.hunting.ramp import Ramp, speed_ramp
    from .stability.linear_critical import Stability, linear_critical, linear_critical_speed
    from .stability.modes import Modes, RootLocus, modes, root_locus
    from .sweeps.conicity_map import EquivalentConicity
    from .sweeps.ready_made import CriticalSpeed, ForcedRun, LeastDamping, NonlinearCriticalSpeed, RideComfort, each_point
    from .sweeps.sweep import sweep
    from .tuning import objectives as objectives
    from .tuning.calibrate import Calibration, calibrate
    from .tuning.gain_schedule import GainSchedule, schedule_gain
    from .tuning.pareto import Front, pareto
    from .tuning.result import Tuning
    from .tuning.robust import Scatter, expected, worst
    from .tuning.train import Training, train
    from .tuning.tune import tune
    from .vehicles.check import VehicleCheck, check_vehicle
    from .vehicles.files import load_vehicle, packaged_vehicles
    from .vehicles.template import vehicle_toml

from .base.version import __version__ as __version__

__all__ = [
    "ADD",
    "CHANNELS",
    "Acceptance",
    "BalanceLogic",
    "BoucWen",
    "BoucWenDamper",
    "Branch",
    "BumpStop",
    "BumpTrack",
    "Calibration",
    "ClippedLQR",
    "Comfort",
    "ComplementaryFilter",
    "ContactGeometry",
    "ContactTable",
    "Controller",
    "CriticalSpeed",
    "CrossBracing",
    "CurveCritical",
    "CurveNonlinear",
    "Damper",
    "Device",
    "Equilibrium",
    "EquivalentConicity",
    "ErriSpectrum",
    "Faults",
    "Film",
    "ForcedRun",
    "FormulaSpectrum",
    "FraSpectrum",
    "FrequencyResponse",
    "Front",
    "GainSchedule",
    "Hunting",
    "HybridDamper",
    "Identification",
    "InputError",
    "KalmanFilter",
    "LateralDamper",
    "Layout",
    "LearnedDamper",
    "LeastDamping",
    "LimitCycle",
    "MaxwellDamper",
    "MeasuredTrack",
    "MixedSkyhookADD",
    "Modes",
    "NonlinearCritical",
    "NonlinearCriticalSpeed",
    "NumericalError",
    "PassiveDamper",
    "RailProfile",
    "Ramp",
    "RandomTrack",
    "Record",
    "Result",
    "RideComfort",
    "RootLocus",
    "RunningRecord",
    "Scatter",
    "Seen",
    "Segment",
    "Sensors",
    "Simulation",
    "SinusoidTrack",
    "Skyhook",
    "SpectralComfort",
    "Spectrum",
    "SpeedProfile",
    "Stability",
    "StatisticalResponse",
    "SteadyCurving",
    "TableSpectrum",
    "TangentTrack",
    "Training",
    "Tuning",
    "Vehicle",
    "VehicleCheck",
    "VehicleReport",
    "WheelProfile",
    "YawDamper",
    "ZoneAcceptance",
    "acceptance",
    "acceptance_channels",
    "acceptance_of_record",
    "alignment",
    "animate",
    "animation_channels",
    "calibrate",
    "check_vehicle",
    "comfort",
    "contact_ellipse",
    "contact_geometry",
    "creep_coefficients",
    "curve_critical",
    "curve_nonlinear_critical",
    "curving",
    "each_point",
    "equivalent_conicity",
    "expected",
    "first_lyapunov_coefficient",
    "floor_acceleration",
    "frequency_response",
    "get_parameter",
    "hunting_branch",
    "identify_damper",
    "jit",
    "kalker_coefficients",
    "keep_compiled",
    "linear_critical",
    "linear_critical_speed",
    "load_law",
    "load_vehicle",
    "matrices",
    "modes",
    "nonlinear_critical",
    "nonlinear_critical_speed",
    "nonlinearity_parameter",
    "objectives",
    "packaged_vehicles",
    "parameters",
    "pareto",
    "read_record",
    "replace",
    "root_locus",
    "schedule_gain",
    "set_parameter",
    "simulate",
    "spectral_comfort",
    "spectrum",
    "spectrum_of",
    "speed_ramp",
    "sperling",
    "state_matrix",
    "statistical_linearisation",
    "sweep",
    "track_matrix",
    "train",
    "tune",
    "use_all_cores",
    "use_double_precision",
    "vehicle_report",
    "vehicle_toml",
    "weighted_acceleration",
    "weighted_rms",
    "weighting",
    "weighting_filter",
    "with_profiles",
    "worst",
    "zone_acceptance",
]

#: the imports above, as they are made
_NAMES = {
    "ride.acceptance.assess": "acceptance acceptance_of_record",
    "ride.acceptance.record": "RunningRecord acceptance_channels",
    "ride.acceptance.result": "Acceptance",
    "ride.acceptance.zones": "ZoneAcceptance zone_acceptance",
    "plots.animation": "Film animate",
    "dampers.bouc_wen": "BoucWen",
    "tuning.calibrate": "Calibration calibrate",
    "simulation.channels": "CHANNELS",
    "ride.comfort": "comfort floor_acceleration",
    "ride.comfort_result": "Comfort",
    "plots.frames": "animation_channels",
    "stability.hunting.nonlinear_critical": "Hunting NonlinearCritical nonlinear_critical nonlinear_critical_speed",
    "model.damper": "Damper PassiveDamper Seen",
    "base.errors": "InputError NumericalError",
    "ride.frequency": "FrequencyResponse frequency_response",
    "stability.hunting.branch": "hunting_branch",
    "dampers.identification.result": "Identification",
    "dampers.identification.identify": "identify_damper",
    "model.contact.kalker": "contact_ellipse creep_coefficients kalker_coefficients",
    "base.compilation": "jit",
    "base.programs": "keep_compiled",
    "base.batches": "use_all_cores",
    "stability.hunting.limit_cycles": "Branch LimitCycle",
    "stability.linear_critical": "Stability linear_critical linear_critical_speed",
    "model.track.layout": "Layout",
    "model.track.segments": "Segment",
    "model.track.measured": "MeasuredTrack",
    "stability.modes": "Modes RootLocus modes root_locus",
    "model.motion": "matrices state_matrix track_matrix",
    "dampers.bouc_wen_damper": "BoucWenDamper HybridDamper",
    "stability.hunting.normal_form": "first_lyapunov_coefficient",
    "tuning.pareto": "Front pareto",
    "base.precision": "use_double_precision",
    "stability.hunting.ramp": "Ramp speed_ramp",
    "model.track.random": "RandomTrack",
    "dampers.identification.record": "Record read_record",
    "tuning.robust": "Scatter expected worst",
    "model.track.sampled": "spectrum_of",
    "tuning.gain_schedule": "GainSchedule schedule_gain",
    "dampers.balance_logic": "BalanceLogic",
    "dampers.clipped_lqr": "ClippedLQR",
    "dampers.control.controller": "Controller",
    "dampers.control.device": "Device Faults",
    "dampers.control.estimators": "ComplementaryFilter",
    "dampers.control.kalman": "KalmanFilter",
    "dampers.control.law_files": "load_law",
    "dampers.control.learned": "LearnedDamper",
    "dampers.control.sensors": "Sensors",
    "dampers.maxwell": "MaxwellDamper",
    "dampers.skyhook": "ADD MixedSkyhookADD Skyhook",
    "simulation.simulate": "Result Simulation simulate",
    "model.track.spectra": "ErriSpectrum FormulaSpectrum FraSpectrum Spectrum TableSpectrum spectrum",
    "ride.spectral_comfort": "SpectralComfort spectral_comfort",
    "simulation.speed": "SpeedProfile",
    "ride.statistical": "StatisticalResponse statistical_linearisation",
    "sweeps.sweep": "sweep",
    "sweeps.conicity_map": "EquivalentConicity",
    "sweeps.ready_made": "CriticalSpeed ForcedRun LeastDamping NonlinearCriticalSpeed RideComfort each_point",
    "model.track.shapes": "BumpTrack SinusoidTrack TangentTrack alignment",
    "tuning.train": "Training train",
    "tuning.tune": "tune",
    "tuning.result": "Tuning",
    "model.parameters": "get_parameter parameters replace set_parameter",
    "model.vehicle": "BumpStop CrossBracing LateralDamper Vehicle YawDamper",
    "vehicles.check": "VehicleCheck check_vehicle",
    "vehicles.files": "load_vehicle packaged_vehicles",
    "reports.vehicle.vehicle_report": "VehicleReport vehicle_report",
    "vehicles.template": "vehicle_toml",
    "ride.vibration": "sperling weighted_acceleration weighted_rms",
    "ride.weightings": "weighting weighting_filter",
    "model.contact.conicity": "equivalent_conicity nonlinearity_parameter",
    "stability.curving.critical": "CurveCritical curve_critical",
    "stability.curving.nonlinear": "CurveNonlinear curve_nonlinear_critical",
    "stability.curving.result": "Equilibrium SteadyCurving",
    "stability.curving.steady": "curving",
    "model.contact.geometry": "ContactGeometry contact_geometry",
    "model.contact.profile_table": "with_profiles",
    "model.contact.profiles": "RailProfile WheelProfile",
    "model.contact.table": "ContactTable",
}
_HOME = {name: module for module, names in _NAMES.items() for name in names.split()}


#: modules that are public by a name of their own
_MODULES = {"objectives": "tuning.objectives"}


def __getattr__(name: str) -> Any:
    """A public name out of its module, a module, or a package."""
    if name in _HOME:
        value = getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
    elif not name.startswith("_") and importlib.util.find_spec(f"{__name__}.{(inner := _MODULES.get(name, name))}"):
        value = importlib.import_module(f"{__name__}.{inner}")
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
