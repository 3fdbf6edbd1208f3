"""Chunks of a sweep on the workers of an executor: what is sent, what a worker does, what comes back."""

import concurrent.futures
import contextlib
import hashlib
import logging
import os
import pickle
import threading
from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import numpy as np

from ..base.errors import InputError, NumericalError
from .chunks import Computed, Job, Points, compute
from .points import Blocks
from .store import SweepStore

#: how often a chunk is given to an executor whose workers die over it
TRIES = 4

log = logging.getLogger("railjax")

_turn = threading.Lock()
_known: dict[str, Job] = {}


class Settings(NamedTuple):
    """JAX as workers are to set it: double precision, CPU devices."""

    double: bool
    devices: int


class Fault(NamedTuple):
    """An error of the study as a worker reports it: its text, and whether it is an `InputError`."""

    text: str
    of_input: bool


def packed(job: Job) -> bytes:
    """The job as workers get it. Raises `InputError` where the study cannot be pickled."""
    # NumPy, for unpickling a JAX array would start JAX before its settings are made
    given = jax.tree.map(lambda leaf: np.asarray(leaf) if isinstance(leaf, jax.Array) else leaf, job.given)
    job = replace(job, given=given)
    try:
        try:
            import cloudpickle  # comes with dask; sends functions of a script or notebook by value

            return cloudpickle.dumps(job)
        except ImportError:
            return pickle.dumps(job)
    except Exception as error:
        reason = " ".join(str(error).split())
        raise InputError(f"the study cannot be sent to workers ({reason}): define it in a module of its own") from None


def work(settings: Settings, key: str, job: bytes, points: Points, first: bool) -> Computed | Fault:
    """`compute` in a worker: the job is unpacked once, JAX is set as in the process that asked, one chunk runs at a time."""
    with _turn:
        if key not in _known:
            if jax.config.jax_enable_x64 != settings.double:
                jax.config.update("jax_enable_x64", settings.double)
            # where JAX has started already it has as many devices as it has
            with contextlib.suppress(RuntimeError):
                jax.config.update("jax_num_cpu_devices", settings.devices)
            _known.clear()
            _known[key] = pickle.loads(job)
        try:
            return compute(_known[key], points, first)
        except Exception as error:
            of_input = isinstance(error, InputError)
            return Fault(str(error) if of_input else f"{type(error).__name__}: {error}", of_input)


def in_workers(
    executor: Any,
    job: Job,
    settings: Settings,
    blocks: Blocks,
    todo: list[int],
    store: SweepStore,
    in_flight: int | None,
) -> Iterator[tuple[int, Computed]]:
    """Chunks as they come back from the workers, with at most `in_flight` at a time; one whose worker died is given out again."""
    parcel = packed(job)
    key = hashlib.sha256(parcel).hexdigest()
    most = in_flight or 2 * (getattr(executor, "_max_workers", None) or os.cpu_count() or 1)
    waiting: dict[concurrent.futures.Future, int] = {}
    tries = dict.fromkeys(todo, 0)
    left = iter(todo)

    def submit(index: int) -> None:
        tries[index] += 1
        try:
            future = executor.submit(work, settings, key, parcel, blocks.points(index), store.group is None)
        except concurrent.futures.BrokenExecutor as error:
            raise NumericalError(f"a worker of the executor died ({error}); finished chunks are kept") from None
        waiting[future] = index

    try:
        while True:
            while len(waiting) < most and (index := next(left, None)) is not None:
                submit(index)
            if not waiting:
                return
            finished, _ = concurrent.futures.wait(waiting, return_when=concurrent.futures.FIRST_COMPLETED)
            for future in finished:
                index = waiting.pop(future)
                try:
                    found = future.result()
                except (Exception, concurrent.futures.CancelledError) as error:
                    if tries[index] >= TRIES:
                        raise NumericalError(
                            f"chunk {index} failed {TRIES} times on the executor's workers "
                            f"({type(error).__name__}: {error}); finished chunks are kept"
                        ) from None
                    log.warning("chunk %d is computed again: %s: %s", index, type(error).__name__, error)
                    submit(index)
                    continue
                if isinstance(found, Fault):
                    if found.of_input:
                        raise InputError(found.text)
                    raise NumericalError(f"the study raises an error at every point tried of chunk {index}: {found.text}")
                yield index, found
    finally:
        for future in waiting:
            future.cancel()
