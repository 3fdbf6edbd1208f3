"""Does the suite see a wrong sign? Mutants of the physics and numerics, one at a time, against the tests that are to catch them.

    python benchmarks/mutants.py [--only NAME ...] [--jobs N] [--list]

The tree is copied into a temporary folder. There the tests named below must pass; then each mutant is written into it in turn,
its tests are run, and the text is put back. Prints "caught" with the test that failed, or "survived"; exit status 1 if one
survives, 2 if a mutant's text is no longer found exactly once, a test is gone, or the unmutated tree fails. What is compiled is
shared, so that mutants pay for what they change only. About 20 minutes of processor time; a job takes a core and up to 1.5 GB.

A mutant is a slip that a person makes: it must change numbers, not break the import. After a rewrite of its line, write the mutant
anew; where the tests miss one, write the test.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import SimpleQueue
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
COPIED = ("railjax", "tests", "benchmarks", "notebooks", "pyproject.toml", "README.md", "CHANGELOG.md", "LICENSE")

#: s; a mutant may loop for ever
LIMIT = 900.0


class Mutant(NamedTuple):
    """A slip: in railjax/`module`.py `text`, which is there once, becomes `slip`; `tests` below tests/ fail then."""

    name: str
    module: str
    text: str
    slip: str
    tests: str  # separated by spaces


HAND = "model/test_motion.py::test_right_hand_side_is_the_independent_one"
WEIGHTED = (
    "ride/test_weightings.py::test_iso_2631_1_at_every_third_octave ride/test_weightings.py::test_iso_8041_at_every_third_octave"
)

# fmt: off
MUTANTS = [
    # wheel and rail
    Mutant("spin couples with the wrong sign", "model/contact/creep", "longitudinal - contact.creep_lateral_spin * creepage.lateral",
           "longitudinal + contact.creep_lateral_spin * creepage.lateral", HAND),
    Mutant("lateral creepage: yaw angle added", "model/contact/creep", "y_rate * slowness - psi, spin", "y_rate * slowness + psi, spin",
           HAND),
    Mutant("saturation: 1/27 is 1/26", "model/contact/creep", "u * u * (1.0 / 27.0)", "u * u * (1.0 / 26.0)",
           "model/test_contact.py::test_vermeulen_johnson_values"),
    Mutant("saturation against the axle load", "model/contact/creep", "1.0 / (contact.friction * contact.wheel_load)",
           "1.0 / (2.0 * contact.friction * contact.wheel_load)", HAND),
    Mutant("gravitational stiffness destabilises", "model/contact/creep", "force = force + weight / half_gauge",
           "force = force - weight / half_gauge", "model/test_motion.py::test_gravitational_stiffness_by_hand"),
    Mutant("Kalker's table: digits swapped", "model/contact/kalker", "[4.06, 4.78, 5.80]", "[4.06, 4.87, 5.80]", "model/test_kalker.py"),
    Mutant("Kalker's table: linear in a/b", "model/contact/kalker", "jnp.interp(abscissa, np.log(_RATIOS), np.log(table[:, i]))",
           "jnp.interp(ratio, _RATIOS, np.log(table[:, i]))", "model/test_kalker.py"),
    Mutant("Kalker: f_12 by the square of the area", "model/contact/kalker", "shear * area**1.5 * c.c23", "shear * area**2 * c.c23",
           "model/test_kalker.py"),
    # kinematics
    Mutant("eq. (7): bogie's roll with the wrong sign", "model/kinematics", '"secondary_y": lateral_carbody - bogie_y + geometry',
           '"secondary_y": lateral_carbody - bogie_y - geometry', HAND),
    Mutant("primary suspension: yaw arm mirrored", "model/kinematics",
           "lateral_bogie[:, None] + axle_positions(vehicle, y) * bogie_psi",
           "lateral_bogie[:, None] - axle_positions(vehicle, y) * bogie_psi", HAND),
    Mutant("primary suspension: roll arm upside down", "model/kinematics", "bogie_y + geometry.bogie_to_primary * bogie_phi",
           "bogie_y - geometry.bogie_to_primary * bogie_phi", HAND),
    Mutant("lateral damper: its height on the bogie", "model/kinematics", "lateral_carbody - bogie_y + below * bogie_phi",
           "lateral_carbody - bogie_y - below * bogie_phi",
           "model/test_elements.py::test_generalised_forces_and_rates_are_the_independent_ones"),
    # elements
    Mutant("bump stop: slopes added up", "model/suspension", "jnp.sum(jnp.diff(slopes, axis=0) * over, axis=0)",
           "jnp.sum(slopes[1:] * over, axis=0)", "model/test_elements.py::test_bump_stop_is_the_interpolated_table"),
    Mutant("blow-off: no damping beyond", "model/suspension", "force - (damping - valve.damping_beyond) * over",
           "force - damping * over", "model/test_elements.py::test_blow_off_and_its_inverse"),
    Mutant("series stiffness: one yaw damper of two", "model/suspension", "return 2.0 * force[0], blow_off",
           "return force[0], blow_off", "model/test_elements.py::test_maxwell_harmonic_response_in_the_vehicle"),
    # motion
    Mutant("inertias: roll for yaw", "model/motion", '"bogie_psi": bogie.yaw_inertia', '"bogie_psi": bogie.roll_inertia', HAND),
    Mutant("anti-roll bar: arm not squared", "model/motion", "secondary.anti_roll_stiffness / geometry.half_secondary**2",
           "secondary.anti_roll_stiffness / geometry.half_secondary", "model/test_motion.py::test_optional_elements_act_as_stated"),
    Mutant("gyroscopic pair does work", "model/motion", 'forces["contact_psi"] + spin * rate["contact_y"]',
           'forces["contact_psi"] - spin * rate["contact_y"]',
           "model/test_motion.py::test_gyroscopic_coupling_does_no_work_and_shows_in_e"),
    Mutant("primary springs: four under any bogie", "model/motion", "springs = 2.0 * len(geometry.axle_pattern)", "springs = 4.0",
           "model/test_motion.py::test_six_axle_vehicle"),
    # integration
    Mutant("RK4: weights 1 3 1 1", "simulation/runge_kutta", "dt / (3.0 if k in (1, 2) else 6.0)",
           "dt / (2.0 if k == 1 else 6.0)", "simulation/test_integrate.py::test_the_step_in_a_loop_is_the_other_one"),
    Mutant("RK4: third stage sees the end's track", "simulation/integrate", "leaf[(k + 1) // 2]", "leaf[(k + 2) // 2]",
           "simulation/test_integrate.py::test_order_4_on_the_smooth_laws_against_dop853"),
    Mutant("RK4 in a loop: first weights exchanged", "simulation/runge_kutta", "jnp.where((k == 1) | (k == 2), dt / 3.0, dt / 6.0)",
           "jnp.where((k == 0) | (k == 2), dt / 3.0, dt / 6.0)", "simulation/test_integrate.py::test_the_step_in_a_loop_is_the_other_one"),
    Mutant("RK4: stable beyond its radius", "simulation/step_size", "STABLE_RADIUS = 2.61", "STABLE_RADIUS = 2.79",
           "simulation/test_integrate.py::test_stable_radius_is_that_of_rk4"),
    Mutant("peak: negative ones forgotten", "simulation/integrate", "jnp.maximum(total, jnp.abs(value) * counted)",
           "jnp.maximum(total, value * counted)", "simulation/test_simulate.py::test_reductions_are_sums_over_every_step"),
    Mutant("reductions: a step settled too long", "simulation/integrate", "jnp.where(time >= self.settle,", "jnp.where(time > self.settle,",
           "simulation/test_simulate.py::test_reductions_are_sums_over_every_step"),
    Mutant("checkpoints: none", "simulation/integrate", "block = jax.checkpoint(block)", "block = block",
           "simulation/test_integrate.py::test_nested_checkpoints_give_the_same_gradient"),
    # dampers and control
    Mutant("balance logic: acts while moving away", "dampers/balance_logic", "        return -travel", "        return travel",
           "dampers/test_semiactive.py::test_sharp_laws_by_hand"),
    Mutant("balance logic: one spring of two", "dampers/balance_logic", "return 2.0 * self.alpha * vehicle", "return self.alpha * vehicle",
           "dampers/test_semiactive.py::test_sharp_laws_by_hand"),
    Mutant("skyhook: opened where it should be shut", "dampers/controlled",
           "(self.damping_max - self.damping_min) * opening) * velocity",
           "(self.damping_max - self.damping_min) * (1.0 - opening)) * velocity",
           "dampers/test_semiactive.py::test_sharp_laws_by_hand"),
    Mutant("regulator: no cross weight", "dampers/clipped_lqr", "np.eye(bogies), s=state.T @ through",
           "np.eye(bogies), s=0.0 * (state.T @ through)", "dampers/test_semiactive.py::test_regulator_is_optimal"),
    Mutant("Bouc-Wen: z against the loop", "dampers/bouc_wen", "(p.A - p.beta * odd * jnp.sign(z))",
           "(p.A + p.beta * odd * jnp.sign(z))", "dampers/test_bouc_wen.py::test_rates"),
    Mutant("Bouc-Wen: loading for unloading", "dampers/bouc_wen", "unloading, loading = p.beta - p.gamma, p.beta + p.gamma",
           "unloading, loading = p.beta + p.gamma, p.beta - p.gamma", "dampers/test_bouc_wen.py::test_along_path_solves_eq_14"),
    Mutant("Bouc-Wen: half a time step's stiffness", "dampers/bouc_wen", "linear = c0 + c1 + 0.5 * dt * p.k0",
           "linear = c0 + c1 + dt * p.k0", "dampers/test_bouc_wen.py::test_the_solution_of_a_step_satisfies_its_equation"),
    Mutant("MR damper: one of two", "dampers/bouc_wen_damper", "force = 2.0 * bouc_wen.force(", "force = bouc_wen.force(",
           "dampers/test_mr_dampers.py::test_the_coach_s_bouc_wen_damper_is_as_strong_as_table_2_s"),
    Mutant("identification: rig pushes back", "dampers/identification/problem", "+ guess.inertia * problem.acceleration",
           "- guess.inertia * problem.acceleration", "dampers/test_identify.py::test_recovers_a_known_damper"),
    # track
    Mutant("sine: half its wavelength", "model/track/shapes", "wavenumber = 2.0 * jnp.pi / self.wavelength",
           "wavenumber = 4.0 * jnp.pi / self.wavelength", "simulation/test_simulate.py::test_sinusoid_and_tangent_alignment"),
    Mutant("wheelsets: the rear sees the track first", "model/track/shapes", "jnp.cos(wavenumber * start) * sine + jnp.sin",
           "-jnp.cos(wavenumber * start) * sine + jnp.sin",
           "simulation/test_simulate.py::test_each_wheelset_sees_the_track_delayed_by_its_position"),
    Mutant("ERRI: digits of the corner swapped", "model/track/spectra", "fourth power\", 0.8246,", "fourth power\", 0.8264,",
           "model/test_spectra.py::test_erri_at_a_tenth_of_a_radian_per_metre"),
    Mutant("FRA class 4: digits swapped", "model/track/spectra", '"fra-4": FraSpectrum(0.3027e-4)', '"fra-4": FraSpectrum(0.3072e-4)',
           "model/test_spectra.py"),
    Mutant("random track: half the variance", "model/track/random", "np.sqrt(2.0 * density * widths)", "np.sqrt(density * widths)",
           "model/test_tracks.py::test_bands_have_the_variance_of_the_closed_form"),
    Mutant("random track: phases of half a turn", "model/track/random", ".uniform(0.0, 2.0 * np.pi, numbers.size)",
           ".uniform(0.0, np.pi, numbers.size)", "model/test_tracks.py::test_the_same_seed_is_the_same_track"),
    Mutant("measured track: filter at half the wavelength", "model/track/measured", "butter(ORDER, 1.0 / wavelength, kind",
           "butter(ORDER, 2.0 / wavelength, kind",
           "model/test_tracks.py::test_the_filter_takes_out_long_and_short_waves_without_shifting_the_others"),
    Mutant("speed profile: distance by the end's speed", "simulation/speed",
           "0.5 * (speeds[last] + self.at(time)) * (time - knots[last])", "self.at(time) * (time - knots[last])",
           "simulation/test_simulate.py::test_speed_profile_distance_is_exact_and_reduces_to_constant_speed"),
    # profiles
    Mutant("profiles: spin of both wheels the same way", "model/contact/profile_contact", "spin = seen.turn - signs * at.sine / radius",
           "spin = seen.turn - at.sine / radius", "model/test_profile_contact.py::test_manchester_benchmark"),
    Mutant("profiles: lateral and spin couple the other way", "model/contact/profile_contact",
           "lateral = at.lateral * across + at.lateral_spin * spin", "lateral = at.lateral * across - at.lateral_spin * spin",
           "model/test_profile_contact.py::test_manchester_benchmark"),
    Mutant("profiles: creep forces act by the wrong share", "model/contact/profile_contact",
           "force, moment = at.acting * _both", "force, moment = _both", "model/test_profile_contact.py"),
    Mutant("profiles: springs lift the other way", "model/contact/profile_contact", "at.normal - lifting", "at.normal + lifting",
           "model/test_profile_contact.py::test_springs_and_the_roll_of_wheelsets_are_reciprocal"),
    Mutant("profiles: the load goes to the wrong wheel", "model/contact/profile_contact", "contact.wheel_load + _signs(lateral) * transfer",
           "contact.wheel_load - _signs(lateral) * transfer", "model/test_profile_contact.py::test_wheel_loads_carry_the_suspension"),
    Mutant("conicity: half the amplitude", "model/contact/conicity", "inside = middle[..., None] + amplitude",
           "inside = middle[..., None] + 0.5 * amplitude", "model/test_conicity.py"),
    # curves
    Mutant("curve: curvature not under the wheelsets", "model/track/curve", '"wheelset_y": 0.5 * curvature * wheelsets**2',
           '"wheelset_y": curvature * wheelsets**2', "model/test_curve.py"),
    Mutant("curve: cant adds to the curvature", "model/track/curve", "speed**2 * curvature - GRAVITY * cant_angle",
           "speed**2 * curvature + GRAVITY * cant_angle", "model/test_curve.py stability/test_curving.py::test_balanced_cant_and_mirrored_curves"),
    Mutant("layout: a ramp rolls the bodies with theta", "model/track/layout", 'place[f"{body}_phi"], rate[f"{body}_phi"] = -roll, -rolling',
           'place[f"{body}_phi"], rate[f"{body}_phi"] = roll, rolling', "model/test_layout.py"),
    Mutant("layout: the ramp's inertia", "model/track/layout", 'forced[f"{body}_phi"] = -twisting', 'forced[f"{body}_phi"] = twisting',
           "model/test_layout.py"),
    Mutant("layout: heading's cube", "model/track/layout", "k2 / 3.0 + x * k3 / 4.0", "k2 / 2.0 + x * k3 / 4.0", "model/test_layout.py"),
    # controllers
    Mutant("sensors: gravity with the wrong sign", "dampers/control/sensors", "rate - self.gravity * tilt", "rate + self.gravity * tilt",
           "dampers/test_controller.py::test_accelerometer_is_the_acceleration_behind_a_low_pass"),
    Mutant("device: half its force limit", "dampers/control/device", "jnp.clip(force, -2.0 * self.force_limit, 2.0 * self.force_limit)",
           "jnp.clip(force, -self.force_limit, self.force_limit)", "dampers/test_controller.py::test_a_device_gives_what_it_can_and_never_pushes"),
    Mutant("loop: a sample less of delay", "dampers/control/loop", "signals = jnp.stack([line[delay, k]",
           "signals = jnp.stack([line[max(delay - 1, 0), k]",
           "dampers/test_controller.py::test_delays_are_whole_samples_and_a_sample_is_taken_once"),
    Mutant("loop: faults begin at once", "dampers/control/device", "now >= faults.time", "now >= 0.0 * faults.time",
           "dampers/test_controller.py"),
    # ride
    Mutant("Wk: digits of f5 swapped", "ride/weightings", "f3=12.5, f4=12.5, q4=0.63, f5=2.37", "f3=12.5, f4=12.5, q4=0.63, f5=2.73",
           WEIGHTED),
    Mutant("Wd: Q4 of 0.60", "ride/weightings", "f3=2.0, f4=2.0, q4=0.63", "f3=2.0, f4=2.0, q4=0.60", WEIGHTED),
    Mutant("comfort: 90th percentile", "ride/comfort", 'np.percentile(values["blocks"], 95.0',
           'np.percentile(values["blocks"], 90.0', "ride/test_comfort.py::test_measures_against_plain_numpy"),
    Mutant("comfort: windows of 4 s", "ride/vibration", "BLOCK = 5.0", "BLOCK = 4.0",
           "ride/test_comfort.py::test_measures_against_plain_numpy"),
    Mutant("Sperling: exponent of the sum", "ride/vibration", "jnp.where(positive, total, 1.0) ** (1.0 / power)",
           "jnp.where(positive, total, 1.0) ** (2.0 / power)", "ride/test_comfort.py::test_sperlings_choices"),
    Mutant("frequency response: conjugate delays", "ride/frequency", "jnp.exp(1j * wavenumber * positions",
           "jnp.exp(-1j * wavenumber * positions", "ride/test_frequency.py::test_transfer_is_that_of_a_direct_solve"),
    Mutant("density per rad/s, not per Hz", "ride/frequency", "* (2.0 * jnp.pi) / speed\n",
           "/ speed\n", "ride/test_frequency.py::test_rms_is_the_integral_of_the_spectrum_and_points_enough"),
    Mutant("statistical linearisation: lateral by the other signal", "ride/statistical", "jnp.sum(WEIGHTS * factor * unit**2, -1)",
           "jnp.sum(WEIGHTS * factor * Z1 * unit, -1)", "ride/test_statistical.py::test_creep_gain_is_that_of_samples"),
    # stability
    Mutant("linear critical speed: implicit derivative's sign", "stability/linear_critical", "speed = -change.real",
           "speed = change.real", "stability/test_linear.py::test_gradient_by_left_and_right_eigenvectors"),
    Mutant("linear critical speed: frequency does not move along", "stability/linear_critical",
           "omega = change.imag + at.by_speed.imag * speed", "omega = change.imag",
           "stability/test_linear.py::test_batch_vmap_and_single_give_the_same_derivatives"),
    Mutant("lowest crossing: intervals are stable where their middle is", "stability/eigen_crossing", "holds = stable & holds", "holds = stable",
           "stability/test_linear.py::test_a_narrow_window_of_instability_is_not_stepped_over stability/test_linear.py::test_lowest_means_lowest_for_random_vehicles"),
    Mutant("limit cycles: none without a Hopf point", "stability/hunting/nonlinear_critical", "if code in (Stability.OK, Stability.STABLE):",
           "if code == Stability.OK:", "stability/test_hunting.py::test_hunting_without_a_hopf_point"),
    Mutant("orbits: half a period without mirror", "stability/hunting/orbits", "(0.5, model.mirror) if symmetric",
           "(0.5, 1.0) if symmetric", "stability/test_hunting.py::test_half_and_whole_period_agree"),
    Mutant("orbits: commands are mirrored too", "stability/hunting/orbits", "signs[start : start + bogies] = 1.0",
           "signs[start : start + bogies] = -1.0", "stability/test_hunting.py::test_states_without_a_side_are_not_mirrored"),
    Mutant("orbits: the adjoint's sign", "stability/hunting/shooting", "-weighted(model, shooting, point.unknowns, point.adjoint) * SPEED",
           "weighted(model, shooting, point.unknowns, point.adjoint) * SPEED", "stability/test_critical.py::test_gradient_against_central_differences"),
    Mutant("normal form: B once instead of twice", "stability/hunting/normal_form", "cubic - 2.0 * np.asarray(bent[0])",
           "cubic - np.asarray(bent[0])", "stability/test_hunting.py::test_lyapunov_coefficient_where_the_law_has_a_side"),
    # hardware
    Mutant("orifice: twice the drop", "dampers/hardware/hydraulics", "return 0.5 * density * flow * jnp.abs(flow)",
           "return density * flow * jnp.abs(flow)", "dampers/test_hydraulics.py::test_orifice_flow_and_drop_are_inverse_and_odd"),
    Mutant("magnetic circuit: whole poles", "dampers/hardware/magnetic_circuit", "steel_field(steel, pole) * 0.5 * (face",
           "steel_field(steel, pole) * (face", "dampers/test_mr_device.py::test_circuit_against_a_root_search"),
    # acceptance, files, studies
    Mutant("Prud'homme: P/3.5", "ride/acceptance/criteria", "10e3 + axle_load / 3.0", "10e3 + axle_load / 3.5",
           "ride/test_acceptance.py::test_limits"),
    Mutant("acceptance: ride filtered to 6 Hz", "ride/acceptance/criteria", '(0.4, 10.0), "percentiles"',
           '(0.4, 6.0), "percentiles"',
           "ride/test_acceptance.py::test_sines_give_their_amplitudes ride/test_acceptance.py::test_independent_evaluation_of_a_whole_run"),
    Mutant("acceptance: other percentiles", "ride/acceptance/signals", "PERCENTILES = (0.15, 99.85)", "PERCENTILES = (0.5, 99.5)",
           "ride/test_acceptance.py::test_the_estimate_is_mean_plus_k_standard_deviations_and_the_place_is_named"),
    Mutant("units: kN s/m as N s/m", "base/units", '"kNs_per_m": 1e3', '"kNs_per_m": 1.0',
           "vehicles/test_vehicle_files.py::test_table_1_in_si"),
    Mutant("km/h: 3.5 of them in a m/s", "base/units", "KMH = 3.6", "KMH = 3.5",
           "stability/test_hunting.py::test_bad_requests_are_one_line stability/test_linear.py::test_no_critical_speed_is_said"),
    Mutant("sweep: first parameter runs fastest", "sweeps/points", 'indexing="ij"', 'indexing="xy"',
           "sweeps/test_sweep.py::test_a_grid_has_all_combinations_with_the_last_parameter_running_fastest"),
    Mutant("design space: from zero instead of the lower bound", "tuning/design_space", "even = self.low + (self.high - self.low) * x",
           "even = self.high * x", "tuning/test_tune.py::test_design_space_maps_bounds_and_scales"),
]
# fmt: on


class Outcome(NamedTuple):
    """`word` is caught, survived, or says what is wrong with the mutant."""

    word: str
    by: str
    seconds: float


def run(tree: Path, tests: str, limit: float | None = None) -> tuple[int, str]:
    """pytest's exit status in a tree, and the first test that failed; 1 beyond `limit` seconds."""
    cache = {"JAX_COMPILATION_CACHE_DIR": str(tree.parent / "compiled"), "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.3"}
    own = {"PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:xdist", *(f"tests/{test}" for test in tests.split())]
    try:
        done = subprocess.run(command, cwd=tree, env=os.environ | cache | own, capture_output=True, text=True, timeout=limit)
    except subprocess.TimeoutExpired:
        return 1, f"no end within {limit:g} s"
    failed = re.search(r"^(?:FAILED|ERROR) (?:tests/)?(\S+)", done.stdout, re.MULTILINE)
    return done.returncode, failed[1] if failed else "\n".join((done.stdout + done.stderr).splitlines()[-3:])


def problem(mutant: Mutant, tree: Path) -> str:
    """Why the mutant cannot be made; empty where it can."""
    times = (tree / "railjax" / f"{mutant.module}.py").read_text(encoding="utf-8").count(mutant.text)
    return "" if times == 1 else f"its text occurs {times} times in railjax/{mutant.module}.py: write it anew"


def outcome(mutant: Mutant, tree: Path) -> Outcome:
    """Write it, run its tests, put the text back."""
    start, path = time.perf_counter(), tree / "railjax" / f"{mutant.module}.py"
    whole = path.read_text(encoding="utf-8")
    path.write_text(whole.replace(mutant.text, mutant.slip), encoding="utf-8")
    try:
        status, by = run(tree, mutant.tests, LIMIT)
    finally:
        path.write_text(whole, encoding="utf-8")
    word = {0: "survived", 1: "caught"}.get(status, "broken")  # it breaks the import, or a test is gone
    return Outcome(word, "" if status == 0 else by, time.perf_counter() - start)


def outcomes(mutants: list[Mutant], trees: list[Path]) -> Iterator[Outcome]:
    """In the order of the mutants, a tree for each of them that runs."""
    free: SimpleQueue[Path] = SimpleQueue()
    for tree in trees:
        free.put(tree)

    def one(mutant: Mutant) -> Outcome:
        tree = free.get()
        try:
            return outcome(mutant, tree)
        finally:
            free.put(tree)

    with ThreadPoolExecutor(len(trees)) as pool:
        yield from pool.map(one, mutants)


def copied(folder: Path) -> Path:
    for name in COPIED:
        source, target = ROOT / name, folder / name
        if source.is_dir():
            shutil.copytree(source, target, ignore=shutil.ignore_patterns("__pycache__", ".*"))
        else:
            target.parent.mkdir(exist_ok=True)
            shutil.copy(source, target)
    return folder


def main() -> int:
    parser = argparse.ArgumentParser(description="Mutants of the physics and numerics, which the tests must catch.")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="mutants by name, or a part of it")
    parser.add_argument("--jobs", type=int, default=1, help="mutants at a time")
    parser.add_argument("--list", action="store_true", help="name them and do nothing")
    options = parser.parse_args()
    mutants = [m for m in MUTANTS if not options.only or any(part in m.name for part in options.only)]
    if options.list or not mutants:
        print(*(f"{m.name}: railjax/{m.module}.py" for m in mutants or MUTANTS), sep="\n")
        return 0 if mutants else 2
    wrong = [f"{m.name}: {why}" for m in mutants if (why := problem(m, ROOT))]
    if wrong:
        print(*wrong, sep="\n")
        return 2
    with tempfile.TemporaryDirectory() as folder:
        trees = [copied(Path(folder) / f"tree{k}") for k in range(max(1, options.jobs))]
        start = time.perf_counter()
        status, by = run(trees[0], " ".join(dict.fromkeys(test for m in mutants for test in m.tests.split())))
        if status:
            print(f"unmutated, the tests do not pass: {by}")
            return 2
        print(f"unmutated: all pass, {time.perf_counter() - start:.0f} s", flush=True)
        found = []
        for mutant, result in zip(mutants, outcomes(mutants, trees), strict=True):
            print(f"{result.word:8s} {result.seconds:4.0f} s  {mutant.name}  {result.by}", flush=True)
            found.append(result.word)
    print(*(f"{found.count(word)} {word}" for word in ("caught", "survived", "broken")), sep=", ")
    return 2 if "broken" in found else int("survived" in found)


if __name__ == "__main__":
    sys.exit(main())
