"""Shapes and types of every annotated function are checked at run time; the tests run in double precision on all cores."""

import gc
import os
from importlib.metadata import version
from pathlib import Path

import pytest
from fuzz import EXAMPLES
from hypothesis import settings
from jaxtyping import install_import_hook

# nearly all of the tests' time is compilation: workers, subprocesses and later runs share what one of them has compiled, single
# operations too (20 ms each, hundreds of them in a file)
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(Path(__file__).parents[1] / ".pytest_cache" / "jax"))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
# nearly everything runs once: LLVM's first level for all, as the library has it for its largest kernels (QUICK), and on JAX 0.10, which
# can, the older emitter: a third less time. The numbers differ by rounding alone. `XLA_FLAGS= pytest` has XLA's own settings, which
# `.ci/run` has on the newest Python, and so has the canary of tests/test_package.py
OLDER = version("jax").startswith("0.10.")
os.environ.setdefault("XLA_FLAGS", "--xla_backend_optimization_level=1 --xla_cpu_use_fusion_emitters=false" if OLDER else "")
# JAX 0.10 warns on standard error that it may lack processor features which only its compiler knows by that name
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")

install_import_hook("railjax", "typechecks.checked")

import railjax  # noqa: E402
from railjax.base.programs import forget_compiled  # noqa: E402

railjax.use_double_precision()
railjax.use_all_cores()

# the same examples in every run, unless as many others are asked for (tests/fuzz.py)
settings.register_profile("railjax", deadline=None, database=None, derandomize=not EXAMPLES)
settings.load_profile("railjax")

#: bytes that a worker may hold between two tests; what is compiled is most of it, and comes back from the disk
HELD = 1.2e9


#: files that take longest, the longest first: with `--dist loadfile --no-loadscope-reorder` each worker takes the next file when it has
#: done one, so that none is left with a long one at the end, and what a file shares is made once
SLOWEST = [
    "notebooks", "tune_studies", "tune", "testing", "simulate", "identify", "train", "profile_hunting", "curving", "bouc_wen",
    "own_damper", "linear", "elements", "tracks", "statistical", "comfort", "contact_geometry", "profile_contact", "failed_lanes",
    "distribution", "semiactive", "critical", "damper_numerics", "calibrate", "robustness", "hunting", "vehicle_report", "frequency",
    "second_vehicle", "controller", "cli", "refusals", "attractors", "sweep_cluster", "house",
]  # fmt: skip


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    place = {f"test_{name}": k for k, name in enumerate(SLOWEST)}
    items.sort(key=lambda item: place.get(item.path.stem, len(place)))


def pytest_collection_finish() -> None:
    """What is imported stays: looking through it for garbage, every few hundred allocations of a tracer, was a tenth of the time."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)


@pytest.fixture(autouse=True)
def _memory():
    yield
    railjax.keep_compiled()  # what a command line in this process has kept whole is no other test's
    pages = Path("/proc/self/statm")
    if pages.exists() and int(pages.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") > HELD:
        forget_compiled()


@pytest.fixture(scope="session")
def coach() -> railjax.Vehicle:
    return railjax.load_vehicle("coach")


@pytest.fixture(scope="session")
def literal() -> railjax.Vehicle:
    return railjax.load_vehicle("coach-table1")


@pytest.fixture(scope="session")
def smooth(coach: railjax.Vehicle) -> railjax.Vehicle:
    return railjax.replace(coach, contact__law="smooth")


@pytest.fixture
def run(capsys):
    """Runs the command line: exit status, standard output, standard error."""

    from railjax.cli.application import status

    def run_and_capture(*arguments):
        code = status([str(argument) for argument in arguments])
        return code, *capsys.readouterr()

    return run_and_capture
