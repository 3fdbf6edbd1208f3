"""railjax: a differentiable simulator of the lateral dynamics of rail vehicles, on JAX.

    import railjax

    railjax.use_double_precision()
    coach = railjax.load_vehicle("coach")
    print(railjax.linear_critical_speed(coach) * 3.6, "km/h")

Importing it changes no JAX configuration and starts no backend.
"""

from . import objectives
from .acceptance import Acceptance, acceptance, acceptance_of_record
from .acceptance_record import RunningRecord, acceptance_channels
from .animation import Film, animate
from .bouc_wen import BoucWen
from .calibrate import Calibration, calibrate
from .channels import CHANNELS
from .comfort import Comfort, comfort, floor_acceleration
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

__version__ = "0.1.0"

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
    "creep_coefficients",
    "each_point",
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
