"""railjax: a differentiable simulator of the lateral dynamics of rail vehicles, on JAX.

    import railjax

    railjax.use_double_precision()
    coach = railjax.load_vehicle("coach")
    print(railjax.linear_critical_speed(coach) * 3.6, "km/h")

Importing it changes no JAX configuration and starts no backend.
"""

from .bouc_wen import BoucWen
from .calibrate import Calibration, calibrate
from .channels import CHANNELS
from .critical import Hunting, NonlinearCritical, nonlinear_critical, nonlinear_critical_speed
from .dampers import MaxwellDamper, PassiveDamper
from .errors import InputError, NumericalError
from .hunting import Branch, LimitCycle, hunting_branch
from .identify import Identification, identify_damper
from .kalker import contact_ellipse, creep_coefficients, kalker_coefficients
from .kernels import jit
from .lanes import use_all_cores
from .linear import Stability, linear_critical, linear_critical_speed
from .modes import Modes, RootLocus, modes, root_locus
from .motion import matrices, state_matrix, track_matrix
from .mr_dampers import BoucWenDamper, HybridDamper
from .normal_form import first_lyapunov_coefficient
from .precision import use_double_precision
from .ramp import Ramp, speed_ramp
from .record import Record, read_record
from .semiactive import ADD, BalanceLogic, ClippedLQR, MixedSkyhookADD, Skyhook
from .simulate import Result, Simulation, simulate
from .sweep import sweep
from .sweep_studies import CriticalSpeed, ForcedRun, LeastDamping, NonlinearCriticalSpeed, each_point
from .track import BumpTrack, SinusoidTrack, SpeedProfile, TangentTrack, alignment
from .vehicle import BumpStop, LateralDamper, Vehicle, YawDamper, get_parameter, parameters, replace, set_parameter
from .vehicle_files import load_vehicle, packaged_vehicles

__version__ = "0.1.0"

__all__ = [
    "ADD",
    "CHANNELS",
    "BalanceLogic",
    "BoucWen",
    "BoucWenDamper",
    "Branch",
    "BumpStop",
    "BumpTrack",
    "Calibration",
    "ClippedLQR",
    "CriticalSpeed",
    "ForcedRun",
    "Hunting",
    "HybridDamper",
    "Identification",
    "InputError",
    "LateralDamper",
    "LeastDamping",
    "LimitCycle",
    "MaxwellDamper",
    "MixedSkyhookADD",
    "Modes",
    "NonlinearCritical",
    "NonlinearCriticalSpeed",
    "NumericalError",
    "PassiveDamper",
    "Ramp",
    "Record",
    "Result",
    "RootLocus",
    "Simulation",
    "SinusoidTrack",
    "Skyhook",
    "SpeedProfile",
    "Stability",
    "TangentTrack",
    "Vehicle",
    "YawDamper",
    "alignment",
    "calibrate",
    "contact_ellipse",
    "creep_coefficients",
    "each_point",
    "first_lyapunov_coefficient",
    "get_parameter",
    "hunting_branch",
    "identify_damper",
    "jit",
    "kalker_coefficients",
    "linear_critical",
    "linear_critical_speed",
    "load_vehicle",
    "matrices",
    "modes",
    "nonlinear_critical",
    "nonlinear_critical_speed",
    "packaged_vehicles",
    "parameters",
    "read_record",
    "replace",
    "root_locus",
    "set_parameter",
    "simulate",
    "speed_ramp",
    "state_matrix",
    "sweep",
    "track_matrix",
    "use_all_cores",
    "use_double_precision",
]
