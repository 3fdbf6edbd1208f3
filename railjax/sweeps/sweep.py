"""`sweep`: a study over named parameters, chunk by chunk, on all devices or on the workers of an executor.

On a cluster, with dask (extra `cluster`); a worker that dies costs the chunks that it had, which others then compute:

    with dask.distributed.Client(address) as client:
        railjax.sweep(study, over, ..., out="results.zarr", executor=client.get_executor(), in_flight=2 * workers)

On several hosts, without a scheduler: the same script on each, with a store that all of them see. Each takes its share of the
chunks; a host that fell out is made good by running the script again, with as many hosts as there are:

    jax.distributed.initialize()                       # finds its place by itself under Slurm, MPI and in the clouds
    data = railjax.sweep(study, over, ..., out="/shared/results.zarr")
    jax.experimental.multihost_utils.sync_global_devices("swept")     # before anybody reads the results of all

On the GPUs of one host nothing is to be done: `simulate` and `each_point` shard a chunk over all local devices.
"""

import contextlib
import logging
import os
import platform
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import jax

from ..base.arguments import guarded
from ..base.checks import a_function, a_table
from ..base.errors import InputError, closest
from ..base.fingerprint import described, lines
from ..base.progress import Clock, Report, bar, stoppable
from ..base.source import digest_of_source
from ..model.damper import Damper
from ..model.parameters import without_labels
from ..model.track.shapes import Track
from ..model.vehicle import Vehicle
from ..simulation.speed import Speed, a_speed
from .chunks import Computed, Job, compute
from .names import check_range, owner, unit_of
from .points import SAMPLED, Blocks, Design, make_design
from .ready_made import READY_MADE, arguments_of
from .store import SweepStore
from .workers import Settings, in_workers

if TYPE_CHECKING:
    import xarray

#: points of a chunk where neither the caller nor the study says how many
CHUNK = 1024

log = logging.getLogger("railjax")


@guarded(speed=a_speed, over=a_table, study=a_function, progress=None, samples=None)
def sweep(
    study: Callable[..., Any],
    over: Mapping[str, Any],
    *,
    vehicle: Vehicle | None = None,
    speed: Speed | None = None,
    track: Track | None = None,
    damper: Damper | None = None,
    design: str = "grid",
    samples: int | None = None,
    seed: int = 0,
    units: Mapping[str, str] | None = None,
    out: str | os.PathLike | None = None,
    chunk: int | None = None,
    executor: Any = None,
    in_flight: int | None = None,
    worker_devices: int | None = None,
    part: tuple[int, int] | None = None,
    progress: bool | Report = False,
) -> "xarray.Dataset":
    """A study at every point of a design, as a labelled dataset with units and a result code per point.

    A study is a function of any of `vehicle`, `speed`, `track` and `damper`, which it gets by name, as it takes them; what varies
    in them is an array with one value per point of a chunk (lanes). `simulate`, `linear_critical` and the like take lanes, so

        def study(vehicle, speed):
            return railjax.simulate(vehicle, speed, track=track, record=(), reduce=["peak:guiding_force"])

    is one. It returns a dictionary (or named tuple) of arrays with the points on the last axis, an optional "code" (0: ok) among
    them, or a `Simulation`, of which the reductions are kept. What is written for one point is wrapped in `each_point`.
    Ready-made: `ForcedRun`, `CriticalSpeed`, `NonlinearCriticalSpeed`, `LeastDamping`. As these, a study may have attributes
    `units` and `dims` (of the axes before the points) by result, `codes` (an `IntEnum`) and `chunk`.

    The results have a variable "code", with its meaning in the attributes: 0 ok, above it the study's own, below it: -1 the study
    raised an error at this point (logged, results NaN), -2 a result is NaN, -3 not yet computed. What the study raises at every
    point tried of the first chunk is raised. Stopped at any moment, the same call with the same store goes on where it was, to
    the same bits; a store of another study (or release of railjax or JAX) is refused.

    Chunks are computed on all local devices (`use_all_cores`), on an executor's workers, or, after `jax.distributed.initialize`,
    by several processes that each take a share and write to one store.

    Args:
        study: the function, or one of the ready-made.
        over: what varies, in SI: "speed" (m/s), "primary.stiffness_x" (of the vehicle), "track.amplitude", "damper.alpha", or an
            argument of the study's own, with its values or range as `design` takes them.
        vehicle: where the study takes one; what does not vary of it stays as it is.
        speed: m/s, where the study takes one and it does not vary.
        track: where the study takes one.
        damper: where the study takes one.
        design: "grid" of {name: values} (one dimension per parameter), "points" of {name: column}, "latin-hypercube" or "sobol"
            of {name: (low, high)} or {name: (low, high, "log")}.
        samples: number of points of the last two designs, of Sobol's sequence best a power of two.
        seed: of the last two designs, a whole number from 0 on.
        units: of results and of arguments of the study's own, by name, where the study does not say them.
        out: Zarr store, written chunk by chunk and returned lazily opened, so that memory does not grow with the study; by
            default all is in memory.
        chunk: number of points of a chunk, at most; by default the study's own, else 1024.
        executor: anything with the `submit` of concurrent.futures (dask: `client.get_executor()`), on whose workers chunks are
            computed.
        in_flight: number of chunks at a time that the executor holds; by default two per worker or core.
        worker_devices: number of CPU devices of each worker; by default as many as here.
        part: (k, n), this process takes the k-th, from 0, of a number of n shares of the chunks; by default as `jax.distributed`
            says.
        progress: True for a bar, or a function of a `Progress`.

    Raises:
        InputError: for anything that cannot be swept.
        NumericalError: for a chunk that fails on the executor's workers again and again.

    Examples:
        >>> railjax.sweep(  # doctest: +SKIP
        ...     railjax.ForcedRun(reduce=("rms:carbody_acceleration",), duration=2.0),
        ...     over={"speed": np.linspace(40.0, 80.0, 41), "damper.alpha": [0.2, 0.5, 1.0]},
        ...     vehicle=coach, damper=railjax.BalanceLogic(), track=railjax.SinusoidTrack(5e-3, 20.0), out="results.zarr",
        ... )
    """
    points = make_design(over, design, samples, seed)
    given = {"vehicle": vehicle, "speed": speed, "track": track, "damper": damper}
    given = {name: value for name, value in given.items() if value is not None}
    _check(study, given, points)
    largest = getattr(study, "chunk", CHUNK) if chunk is None else chunk
    _check_work(largest, executor, in_flight)
    share, shares = _part(part, out)
    blocks = Blocks(points, largest)
    if shares > blocks.count:
        raise InputError(f"{shares} processes share {blocks.count} chunk(s), so some have nothing to do: give a smaller chunk")
    named = {**getattr(study, "units", {}), **(units or {})}
    parameter_units = {name: named.get(name) or unit_of(given, name) for name in points.names}
    attributes = _attributes(study, given, points, samples, seed)
    fingerprint = _fingerprint(study, given, blocks, named)
    job = Job(study, given, blocks.lanes, named)
    with stoppable("stopping after this chunk; Ctrl-C again stops at once") as stop:
        store = SweepStore(out, blocks, parameter_units, attributes, fingerprint)
        done = store.done()
        ours = range(share, blocks.count, shares)
        todo = [index for index in ours if not done[index]]
        if executor is None:
            results = _here(job, blocks, todo, store)
        else:
            devices = jax.config.jax_num_cpu_devices if worker_devices is None else worker_devices
            settings = Settings(bool(jax.config.jax_enable_x64), devices)
            results = in_workers(executor, job, settings, blocks, todo, store, in_flight)
        clock = Clock(sum(blocks.size(k) for k in ours if done[k]), sum(blocks.size(k) for k in ours))
        with contextlib.closing(results), _reporting(progress) as report:  # type: ignore[type-var]
            try:
                _write(results, store, blocks, clock, report, stop)
            except KeyboardInterrupt:
                kept = f"{clock.done} of {clock.total} points are in {out}; the same again goes on from there"
                raise KeyboardInterrupt(f"stopped: {kept if out else 'nothing is kept without out='}") from None
        return store.dataset()


def _reporting(progress: bool | Report) -> contextlib.AbstractContextManager[Report]:
    return contextlib.nullcontext(progress) if callable(progress) else bar(bool(progress), "sweep")


def _write(
    results: Iterator[tuple[int, Computed]],
    store: SweepStore,
    blocks: Blocks,
    clock: Clock,
    report: Report,
    stop: Callable[[], bool],
) -> None:
    """Every chunk as it comes; `KeyboardInterrupt` after the one that was running when Ctrl-C came."""
    for index, computed in results:
        _log_errors(blocks, index, computed)
        store.write(index, computed)
        report(clock.advance(len(computed.code)))
        if stop() and clock.done < clock.total:
            raise KeyboardInterrupt


def _check_work(largest: Any, executor: Any, in_flight: int | None) -> None:
    """Refuse what says how the chunks are computed and cannot be."""
    if not isinstance(largest, int) or largest < 1:
        raise InputError(f"chunk must be a number of points, at least 1, not {largest!r}")
    if executor is not None and not callable(getattr(executor, "submit", None)):
        raise InputError("executor must have a submit method, as a ProcessPoolExecutor or dask's client.get_executor()")
    if in_flight is not None and not in_flight >= 1:
        raise InputError(f"in_flight must be a number of chunks, at least 1, not {in_flight}")


def _check(study: Callable[..., Any], given: dict[str, Any], design: Design) -> None:
    """Refuse a study that is none, arguments that it does not take or lacks, and names and values that cannot be."""
    if isinstance(study, type) or not callable(study):
        known = ", ".join(kind.__name__ for kind in READY_MADE.values())
        raise InputError(f"study must be a function or an object like {known} with its options, as in CriticalSpeed()")
    arguments = arguments_of(study)
    name_of_study = getattr(study, "__name__", type(study).__name__)
    for name in given:
        if name not in arguments:
            raise InputError(f"{name}= is given, but the study {name_of_study} takes no {name}")
    for name, column in zip(design.names, design.columns, strict=True):
        whose = owner(name)
        if whose is None and name not in arguments:
            near = closest(name, [*arguments, "speed"])
            raise InputError(
                f"over {name!r}: neither speed, a parameter like primary.stiffness_x, track.amplitude or damper.alpha, nor an "
                f"argument of the study; the nearest is {near!r}"
            )
        if whose is not None and whose not in arguments:
            raise InputError(f"over {name!r}: the study {name_of_study} takes no {whose}")
        if name in given:
            raise InputError(f"{name} is given by {name}= and varies in over as well; keep one")
        check_range(given, name, float(column.min()), float(column.max()))
    for name, optional in arguments.items():
        if not optional and name not in given and name not in design.names:
            raise InputError(
                f"the study {name_of_study} needs {name}: give {name}=" + (" or put it in over" if name == "speed" else "")
            )


def _attributes(study: Any, given: dict[str, Any], design: Design, samples: int | None, seed: int) -> dict[str, Any]:
    """What a reader of the results must know: study, vehicle and what of it is fitted, everything that was fixed, releases."""
    from ..base.version import __version__

    found = {"study": described(study), "design": design.kind}
    if design.kind in SAMPLED:
        found |= {"samples": samples, "seed": seed}
    if "vehicle" in given:
        vehicle = given["vehicle"]
        found |= {"vehicle": vehicle.name, "note": vehicle.note}
        for status in ("calibrated", "assumed"):
            which = [p for p in vehicle.provenance if p.status == status and p.parameter not in design.names]
            found[status] = "; ".join(f"{p.parameter}: {p.note}" for p in which)
    found |= {name: described(given[name]) for name in ("speed", "track", "damper") if name in given}
    devices = jax.local_devices()
    return found | {
        "railjax": __version__,
        "jax": jax.__version__,
        "double_precision": int(jax.config.jax_enable_x64),
        "computed_on": f"{len(devices)} {devices[0].device_kind} device(s), {platform.machine()}",
    }


def _fingerprint(study: Any, given: dict[str, Any], blocks: Blocks, units: dict[str, str]) -> dict[str, str]:
    """Everything that the numbers depend on, line by line."""
    from ..base.version import __version__

    design = blocks.design
    found = {"study": described(study), "units": described(units), "design": design.kind}
    for name, value in given.items():
        found |= lines(name, without_labels(value) if isinstance(value, Vehicle) else value)
    found |= {f"over {name}": described(column) for name, column in zip(design.names, design.columns, strict=True)}
    return found | {
        "chunk": described(blocks.shape),
        "double precision": str(bool(jax.config.jax_enable_x64)),
        "railjax": f"{__version__} ({digest_of_source('cli', 'plots', 'reports')})",
        "jax": jax.__version__,
    }


def _part(part: tuple[int, int] | None, out: Any) -> tuple[int, int]:
    """Which share of the chunks is this process's: (0, 1) unless there are several."""
    share, shares = (jax.process_index(), jax.process_count()) if part is None else part
    if not (isinstance(share, int) and isinstance(shares, int) and 0 <= share < shares):
        raise InputError(f"part must be (k, n) with k from 0 to n - 1, not {part}")
    if shares > 1 and out is None:
        raise InputError("processes that share a sweep need one store: give out=")
    return share, shares


def _here(job: Job, blocks: Blocks, todo: list[int], store: SweepStore) -> Iterator[tuple[int, Computed]]:
    for index in todo:
        yield index, compute(job, blocks.points(index), first=store.group is None)


def _log_errors(blocks: Blocks, index: int, computed: Computed) -> None:
    if not computed.errors:
        return
    first = min(computed.errors)
    where = ", ".join(f"{name} = {values[first]:g}" for name, values in blocks.points(index).items())
    count = len(computed.errors)
    log.warning("%d point(s) of chunk %d raised an error; the first, at %s: %s", count, index, where, computed.errors[first])
