"""railjax: a differentiable simulator of the lateral dynamics of rail vehicles, on JAX.

    import railjax

    railjax.use_double_precision()
    coach = railjax.load_vehicle("coach")
    print(railjax.linear_critical_speed(coach) * 3.6, "km/h")

Importing it changes no JAX configuration and starts no backend; a module is imported when a name of it is first used.
"""

import importlib
import importlib.util
import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from . import objectives
    from .acceptance import Acceptance, acceptance, acceptance_of_record
    from .acceptance_record import RunningRecord, acceptance_channels
    from .animation import Film, animate
    from .bouc_wen import BoucWen
    from .calibrate import Calibration, calibrate
    from .channels import CHANNELS
    from .comfort import comfort, floor_acceleration
    from .comfort_result import Comfort
    from .conicity import equivalent_conicity, nonlinearity_parameter
    from .contact_geometry import ContactGeometry, contact_geometry
    from .contact_table import ContactTable
    from .courses import animation_channels
    from .critical import Hunting, NonlinearCritical, nonlinear_critical, nonlinear_critical_speed
    from .dampers import Damper, MaxwellDamper, PassiveDamper, Seen
    from .errors import InputError, NumericalError
    from .frequency import FrequencyResponse, frequency_response
    from .hunting import hunting_branch
    from .identification import Identification
    from .identify import identify_damper
    from .kalker import contact_ellipse, creep_coefficients, kalker_coefficients
    from .kernels import jit, keep_compiled
    from .lanes import use_all_cores
    from .limit_cycles import Branch, LimitCycle
    from .linear import Stability, linear_critical, linear_critical_speed
    from .measured_track import MeasuredTrack
    from .modes import Modes, RootLocus, modes, root_locus
    from .motion import matrices, state_matrix, track_matrix
    from .mr_dampers import BoucWenDamper, HybridDamper
    from .normal_form import first_lyapunov_coefficient
    from .pareto import Front, pareto
    from .precision import use_double_precision
    from .profiles import RailProfile, WheelProfile
    from .ramp import Ramp, speed_ramp
    from .random_track import RandomTrack
    from .record import Record, read_record
    from .robust import Scatter, expected, worst
    from .sampled_track import spectrum_of
    from .schedule import GainSchedule, schedule_gain
    from .semiactive import ADD, BalanceLogic, ClippedLQR, MixedSkyhookADD, Skyhook
    from .simulate import Result, Simulation, simulate
    from .spectra import ErriSpectrum, FormulaSpectrum, FraSpectrum, Spectrum, TableSpectrum, spectrum
    from .spectral_comfort import SpectralComfort, spectral_comfort
    from .speed_profile import SpeedProfile
    from .statistical import StatisticalResponse, statistical_linearisation
    from .sweep import sweep
    from .sweep_studies import CriticalSpeed, ForcedRun, LeastDamping, NonlinearCriticalSpeed, RideComfort, each_point
    from .track import BumpTrack, SinusoidTrack, TangentTrack, alignment
    from .tuning import tune
    from .tuning_result import Tuning
    from .vehicle import BumpStop, LateralDamper, Vehicle, YawDamper, get_parameter, parameters, replace, set_parameter
    from .vehicle_check import VehicleCheck, check_vehicle
    from .vehicle_files import load_vehicle, packaged_vehicles
    from .vehicle_report import VehicleReport, vehicle_report
    from .vehicle_template import vehicle_toml
    from .vibration import sperling, weighted_acceleration, weighted_rms
    from .weightings import weighting, weighting_filter

__version__ = "0.3.0"

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
    "ContactGeometry",
    "ContactTable",
    "CriticalSpeed",
    "Damper",
    "ErriSpectrum",
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
    "LateralDamper",
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
    "Simulation",
    "SinusoidTrack",
    "Skyhook",
    "SpectralComfort",
    "Spectrum",
    "SpeedProfile",
    "Stability",
    "StatisticalResponse",
    "TableSpectrum",
    "TangentTrack",
    "Tuning",
    "Vehicle",
    "VehicleCheck",
    "VehicleReport",
    "WheelProfile",
    "YawDamper",
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
    "tune",
    "use_all_cores",
    "use_double_precision",
    "vehicle_report",
    "vehicle_toml",
    "weighted_acceleration",
    "weighted_rms",
    "weighting",
    "weighting_filter",
    "worst",
]

#: the imports above, as they are made
_NAMES = {
    "acceptance": "Acceptance acceptance acceptance_of_record",
    "acceptance_record": "RunningRecord acceptance_channels",
    "animation": "Film animate",
    "bouc_wen": "BoucWen",
    "calibrate": "Calibration calibrate",
    "channels": "CHANNELS",
    "comfort": "comfort floor_acceleration",
    "comfort_result": "Comfort",
    "conicity": "equivalent_conicity nonlinearity_parameter",
    "contact_geometry": "ContactGeometry contact_geometry",
    "contact_table": "ContactTable",
    "courses": "animation_channels",
    "critical": "Hunting NonlinearCritical nonlinear_critical nonlinear_critical_speed",
    "dampers": "Damper MaxwellDamper PassiveDamper Seen",
    "errors": "InputError NumericalError",
    "frequency": "FrequencyResponse frequency_response",
    "hunting": "hunting_branch",
    "identification": "Identification",
    "identify": "identify_damper",
    "kalker": "contact_ellipse creep_coefficients kalker_coefficients",
    "kernels": "jit keep_compiled",
    "lanes": "use_all_cores",
    "limit_cycles": "Branch LimitCycle",
    "linear": "Stability linear_critical linear_critical_speed",
    "measured_track": "MeasuredTrack",
    "modes": "Modes RootLocus modes root_locus",
    "motion": "matrices state_matrix track_matrix",
    "mr_dampers": "BoucWenDamper HybridDamper",
    "normal_form": "first_lyapunov_coefficient",
    "pareto": "Front pareto",
    "precision": "use_double_precision",
    "profiles": "RailProfile WheelProfile",
    "ramp": "Ramp speed_ramp",
    "random_track": "RandomTrack",
    "record": "Record read_record",
    "robust": "Scatter expected worst",
    "sampled_track": "spectrum_of",
    "schedule": "GainSchedule schedule_gain",
    "semiactive": "ADD BalanceLogic ClippedLQR MixedSkyhookADD Skyhook",
    "simulate": "Result Simulation simulate",
    "spectra": "ErriSpectrum FormulaSpectrum FraSpectrum Spectrum TableSpectrum spectrum",
    "spectral_comfort": "SpectralComfort spectral_comfort",
    "speed_profile": "SpeedProfile",
    "statistical": "StatisticalResponse statistical_linearisation",
    "sweep": "sweep",
    "sweep_studies": "CriticalSpeed ForcedRun LeastDamping NonlinearCriticalSpeed RideComfort each_point",
    "track": "BumpTrack SinusoidTrack TangentTrack alignment",
    "tuning": "tune",
    "tuning_result": "Tuning",
    "vehicle": "BumpStop LateralDamper Vehicle YawDamper get_parameter parameters replace set_parameter",
    "vehicle_check": "VehicleCheck check_vehicle",
    "vehicle_files": "load_vehicle packaged_vehicles",
    "vehicle_report": "VehicleReport vehicle_report",
    "vehicle_template": "vehicle_toml",
    "vibration": "sperling weighted_acceleration weighted_rms",
    "weightings": "weighting weighting_filter",
}
_HOME = {name: module for module, names in _NAMES.items() for name in names.split()}


class _Package(ModuleType):
    """A package whose functions keep their names: importing `railjax.simulate`, the module, would put it in the place of the function."""

    def __setattr__(self, name: str, value: Any) -> None:
        if isinstance(value, ModuleType) and _HOME.get(name) == name:
            value = getattr(value, name)
        super().__setattr__(name, value)

    def __reduce__(self) -> tuple:
        """By its name, as any module; functions that use the package are sent to the workers of a sweep."""
        return importlib.import_module, (self.__name__,)


sys.modules[__name__].__class__ = _Package


def __getattr__(name: str) -> Any:
    """A public name out of its module, or a module."""
    if name in _HOME:
        value = getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
    elif not name.startswith("_") and importlib.util.find_spec(f"{__name__}.{name}"):
        value = importlib.import_module(f"{__name__}.{name}")
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
