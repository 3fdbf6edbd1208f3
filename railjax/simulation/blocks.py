"""Runs of known numbers, block by block: compiled once for each kind of vehicle, damper and track, whatever the length of the run and
what is read off it.

A compiled block takes up to some number of samples further and leaves the states; `Sampled` reads channels off them afterwards.
"""

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..base.batches import Batch, chunk_for
from ..base.compilation import QUICK, one_kernel, options
from ..base.fields import structure
from ..base.packing import Packed
from ..base.programs import kept
from .channels import CHANNELS, parse_reduction, rows_of_motion, rows_of_state, shape_of
from .integrate import STATES, Block, Integrated, Plan, Progress, advance, burst_of, read

#: samples of a block, the same for runs of any length; of a batch fewer, what takes about `ROOM` bytes
FEWEST_SAMPLES, SAMPLES = 64, 1024
ROOM = 2**20
#: bytes of states that a run alone keeps, and a batch; where they are more, only what `record` names is kept
KEPT_ALONE, KEPT_TOGETHER = 2**28, 2**20


def lane_shape(tree: Any, axes: Any) -> tuple[int, ...]:
    """() of one run, (lanes,) where a leaf has lanes."""
    shapes = [jnp.shape(leaf)[own:] for leaf, own in zip(jax.tree.leaves(tree), jax.tree.leaves(axes), strict=True)]
    return jnp.broadcast_shapes(*shapes) if shapes else ()


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Sampled:
    """The states of a finished run and all that its channels follow from."""

    parameters: tuple  # vehicle, damper, speed, track
    states: Float[np.ndarray | jax.Array, "samples states ..."]
    dt: Any  # s
    every: Any  # steps from sample to sample
    chunk: int = structure(0)

    def channels(self, names: tuple[str, ...]) -> dict[str, np.ndarray]:
        """Histories by name, (samples, ...); wheelsets as one axis."""
        lanes = self.states.shape[2] if self.states.ndim > 2 else None
        room = room_for(self.states[0].nbytes, lanes)
        pieces = []
        for first in range(0, len(self.states), room):
            piece = self.states[first : first + room]
            filled = np.concatenate([piece, np.zeros((room - len(piece), *piece.shape[1:]), piece.dtype)])
            pieces.append(channels_of(self.parameters, names, filled, self.dt, first, len(piece), self.every, self.chunk))
        return joined(pieces)


def channels_of(
    parameters: tuple,
    names: tuple[str, ...],
    states: Any,
    dt: np.ndarray,
    first: int,
    count: int,
    every: int,
    chunk: int,
) -> dict[str, np.ndarray]:
    """Channels of the first `count` states of a block whose samples are numbered from `first`."""
    vehicle = parameters[0]
    in_state = rows_of_state(vehicle)
    here = np.asarray(states)[:count]
    found = {name: here[:, in_state[name]] for name in names if name in in_state}
    if len(found) < len(set(names)):
        numbers = dt, np.asarray(first), np.asarray(count), np.asarray(int(every))
        if states.ndim == 2:
            rows = _read_alone(Packed.of(parameters), states, *numbers)
        else:
            states = np.asarray(states)  # not spread over devices, which would compile anew
            rows = Batch.of(*parameters, states, *numbers, own={len(parameters): 2}).in_chunks(read, chunk, spread=True)
        rows, others = np.asarray(rows)[:count], rows_of_motion(vehicle)
        found |= {name: rows[:, others[name]] for name in names if name in others}
    return {name: found[name] if shape_of(name, vehicle) else found[name][:, 0] for name in names}


def joined(pieces: list[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Histories one after the other."""
    if len(pieces) == 1:
        return pieces[0]
    return {name: np.concatenate([piece[name] for piece in pieces]) for name in pieces[0]}


@functools.partial(kept, compiler_options=QUICK)
@one_kernel
def _read_alone(packed: Packed, *rest: Any) -> jax.Array:
    return read(*packed.unpacked(), *rest)


def room_for(bytes_of_sample: int, lanes: int | None) -> int:
    """Samples of a block."""
    if lanes is None:
        return SAMPLES
    return int(np.clip(2 ** int(np.log2(ROOM / max(bytes_of_sample, 1))), FEWEST_SAMPLES, SAMPLES))


@functools.cache
def _block(block: Block) -> Callable[[tuple], tuple[Integrated, Progress]]:
    """One run, or all lanes of a chunk together; the same object for the same block."""

    def function(*trees: Any) -> tuple[Integrated, Progress]:
        *parameters, progress, dt, settle, first, count, bursts = trees
        shape = progress.diverged.shape
        x = progress.x
        progress = progress._replace(
            x=jnp.broadcast_to(x.reshape(x.shape + (1,) * (len(shape) + 1 - x.ndim)), (x.shape[0], *shape))
        )
        return advance(*parameters, progress, dt, settle, first, count, bursts, block)  # type: ignore[call-arg]

    return function


@functools.cache
def _block_alone(block: Block) -> Callable[..., tuple[Integrated, Progress]]:
    kernel = one_kernel(lambda packed, *rest: _block(block)(*packed.unpacked(), *rest))
    return kept(kernel, block, compiler_options=options(QUICK))


def finished(
    parameters: tuple, x: np.ndarray, dt: float, settle: float, plan: Plan, lanes: int | None, chunk: int | None
) -> tuple[Integrated, Sampled | None]:
    """The run of `parameters` (vehicle, damper, speed, track: trees of arrays) from the state x, and its states where they are kept."""
    vehicle, dtype = parameters[0], x.dtype
    chunk = chunk_for(dtype) if chunk is None else chunk
    burst = burst_of(plan.every)
    along = () if lanes is None else (lanes,)
    bytes_of_states = x.shape[0] * math.prod(along) * dtype.itemsize
    kept = plan.samples * bytes_of_states <= (KEPT_ALONE if lanes is None else KEPT_TOGETHER)
    record = None if kept or lanes is None else plan.record
    rows = x.shape[0] if record is None else sum(math.prod(shape_of(name, vehicle)) for name in record)
    room = room_for(rows * math.prod(along) * dtype.itemsize, lanes) if rows else plan.samples
    block = Block(room if rows else 0, burst, record, plan.reduce)

    sums = tuple(np.zeros((*shape_of(parse_reduction(name)[1], vehicle), *along), dtype) for name in plan.reduce)
    progress = Progress(x, sums, np.zeros(along, bool))
    dt, settle = np.asarray(dt, dtype), np.asarray(settle, dtype)  # type: ignore[assignment]
    if lanes is None:
        work = functools.partial(_block_alone(block), Packed.of(parameters))
    else:
        own = {len(parameters): Progress(1, tuple(s.ndim - 1 for s in sums), 0)}  # type: ignore[misc]

        def work(*rest: Any) -> tuple[Integrated, Progress]:  # type: ignore[misc]
            return Batch.of(*parameters, *rest, own=own).in_chunks(_block(block), chunk, spread=True)

    pieces, states = [], []
    for first in range(0, plan.samples, room):
        count = min(room, plan.samples - first)
        run, progress = work(progress, dt, settle, np.asarray(first), np.asarray(count), np.asarray(plan.every // burst))
        if first + count < plan.samples:
            progress = jax.tree.map(np.asarray, progress)  # as it began: not spread over devices, which would compile anew
        if record is None:
            here = run.records[STATES]
            pieces.append(channels_of(parameters, plan.record, here, dt, first, count, plan.every, chunk))
            states += [np.asarray(here)[:count]] if kept else []
        else:
            pieces.append({name: np.asarray(values)[:count] for name, values in run.records.items()})
    sampled = None
    if states:
        together = states[0] if len(states) == 1 else np.concatenate(states)
        sampled = Sampled(parameters, together, dt, plan.every, chunk)
    return wheelsets_flat(run._replace(records=joined(pieces)), len(along)), sampled


def wheelsets_flat(result: Integrated, lanes: int) -> Integrated:
    """Records and reductions with wheelsets (n, m) as one axis n·m, and wheels likewise; what has it already stays."""

    def flat(name: str, values: Any, lead: int) -> Any:
        channel = name.rpartition(":")[2]
        if CHANNELS[channel].part not in ("wheelset", "wheel"):
            return values
        return values.reshape((*values.shape[:lead], -1, *values.shape[values.ndim - lanes :]))

    records = {name: flat(name, values, 1) for name, values in result.records.items()}
    reductions = {name: flat(name, values, 0) for name, values in result.reductions.items()}
    return result._replace(records=records, reductions=reductions)
