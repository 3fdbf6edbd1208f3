"""Results of a sweep in a Zarr store (or in memory), one Zarr chunk per computed chunk: always readable, always resumable.

The store appears whole under its name, empty; chunks are then written one by one, each file under another name first and
renamed. The code of a chunk is written last, when its results are on the disk: a chunk is done where its codes are there.
"""

import json
import os
import shutil
import tempfile
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..base.errors import InputError
from ..base.fingerprint import differing
from .chunks import Computed, PointCode, Variable, nothing
from .points import Blocks

if TYPE_CHECKING:
    import xarray
    import zarr

MARK = "railjax_sweep"  # attribute that holds the fingerprint


class SweepStore:
    """The store of one sweep; `path` None keeps it in memory. Raises `InputError` if the path holds anything else."""

    def __init__(
        self,
        path: str | os.PathLike | None,
        blocks: Blocks,
        units: dict[str, str],
        attributes: dict[str, Any],
        fingerprint: dict[str, str],
    ):
        self.path = None if path is None else Path(path)
        self.blocks, self.design, self.units = blocks, blocks.design, units
        self.attributes, self.fingerprint = attributes, fingerprint
        self.group: zarr.Group | None = None
        self.arrays: dict[str, zarr.Array] = {}
        if self.path is None:
            return
        if not self.path.parent.is_dir():
            raise InputError(f"{self.path}: the folder {self.path.parent} does not exist")
        if os.path.lexists(self.path):
            self._open()

    def done(self) -> list[bool]:
        """Which chunks are there."""
        if self.group is None:
            return [False] * self.blocks.count
        return [self._is_done(k) for k in range(self.blocks.count)]

    def _is_done(self, index: int) -> bool:
        where, cut = self.blocks.position(index), self.blocks.slices(index)
        if self.path is not None and not self._file("code", where).exists():
            return False
        try:
            return not np.any(self.arrays["code"][cut] == PointCode.NOT_COMPUTED)
        except Exception:  # a file that a loss of power left in pieces
            return False

    def write(self, index: int, computed: Computed) -> None:
        """Keep a chunk's results; the first that has any also says what the store holds."""
        try:
            if self.group is None:
                self._create(computed)
            self._write(index, computed)
        except OSError as error:
            raise InputError(f"{self.path}: cannot be written ({error.strerror}); what is there is kept") from None

    def _write(self, index: int, computed: Computed) -> None:
        where, cut = self.blocks.position(index), self.blocks.slices(index)
        lengths = tuple(c.stop - c.start for c in cut)
        results = {name: array for name, array in self.arrays.items() if name not in (*self.design.names, "code")}
        found = results if computed.variables is None else computed.variables
        if sorted(found) != sorted(results):
            raise InputError(f"the study returned {sorted(found)} where it returned {sorted(results)} before")
        for name, array in results.items():
            own = array.shape[len(lengths) :]
            if computed.variables is None:
                values = nothing(Variable(np.empty((*own, 0), array.dtype), (), ""), len(computed.code))
            else:
                values = computed.variables[name].values
            self._put(name, where, (*cut, ...), np.moveaxis(values, -1, 0).reshape(*lengths, *own))
        self._put("code", where, cut, computed.code.reshape(lengths))

    def dataset(self) -> "xarray.Dataset":
        """What is there: opened lazily where it is on the disk, whole where it is in memory."""
        import xarray

        store = self.group.store if self.path is None else str(self.path)
        found = xarray.open_zarr(store, chunks=None, consolidated=self.path is not None)
        found = found[[*sorted(name for name in found.data_vars if name != "code"), "code"]]
        return found if self.path is not None else found.load()

    def _open(self) -> None:
        import zarr

        try:
            group = zarr.open_group(self.path, mode="r+")
            there = json.loads(group.attrs[MARK])
        except Exception:
            raise InputError(f"{self.path} is there already and holds no sweep: give another name or remove it") from None
        if told := differing(there, self.fingerprint):
            raise InputError(f"{self.path} holds another study: {told}; give another name or remove it")
        self._use(group)

    def _use(self, group: "zarr.Group") -> None:
        self.group, self.arrays = group, dict(group.arrays())

    def _create(self, computed: Computed) -> None:
        """All of the store but the chunks, under another name first; another process may have been quicker."""
        import zarr

        if self.path is None:
            self._use(self._filled(zarr.open_group(zarr.storage.MemoryStore(), mode="w"), computed))
            return
        new = Path(tempfile.mkdtemp(prefix=f".{self.path.name}-", dir=self.path.parent))
        try:
            new.chmod(0o755)  # mkdtemp's is for its owner only
            self._filled(zarr.open_group(new, mode="w"), computed)
            for file in (file for file in new.rglob("*") if file.is_file()):
                _to_disk(file)
            os.rename(new, self.path)
        except BaseException as error:
            shutil.rmtree(new, ignore_errors=True)
            if not (isinstance(error, OSError) and self.path.exists()):
                raise
        _to_disk(self.path)
        self._open()

    def _filled(self, group: "zarr.Group", computed: Computed) -> "zarr.Group":
        import zarr

        design = self.design
        for name in computed.variables:
            if name in (*design.names, "point", "code") or "/" in name or not name:
                raise InputError(f"the study's result {name!r} cannot have that name: it is a parameter's, or no name")
        meanings = {code.value: code.name.lower() for code in PointCode} | computed.meanings
        attributes = {MARK: json.dumps(self.fingerprint), **self.attributes}
        if design.kind != "grid":
            attributes["coordinates"] = " ".join(design.names)  # CF: these variables are coordinates
        group.attrs.update(attributes)
        for name, column in zip(design.names, design.columns, strict=True):
            dims = (name,) if design.kind == "grid" else design.dims
            unit = {"units": self.units[name]}
            group.create_array(name, data=column, chunks=column.shape, dimension_names=dims, attributes=unit)
        for name, variable in computed.variables.items():
            own = variable.values.shape[:-1]
            dtype = variable.values.dtype
            group.create_array(
                name,
                shape=(*design.shape, *own),
                chunks=(*self.blocks.shape, *(max(n, 1) for n in own)),
                dtype=dtype,
                fill_value=np.array(np.nan if dtype.kind in "fc" else 0, dtype)[()],
                dimension_names=(*design.dims, *variable.dims),
                attributes={"units": variable.unit},
            )
        ordered = dict(sorted(meanings.items()))
        group.create_array(
            "code",
            shape=design.shape,
            chunks=self.blocks.shape,
            dtype="int16",
            fill_value=int(PointCode.NOT_COMPUTED),
            dimension_names=design.dims,
            attributes={"meaning": ", ".join(f"{value} {word}" for value, word in ordered.items())},
        )
        if self.path is not None:
            with warnings.catch_warnings():
                # xarray asks for it, Zarr warns that its format does not know it yet
                warnings.simplefilter("ignore", zarr.errors.ZarrUserWarning)
                zarr.consolidate_metadata(group.store, zarr_format=3)
        return group

    def _put(self, name: str, where: tuple[int, ...], cut: tuple, values: np.ndarray) -> None:
        array = self.arrays[name]
        if self.path is None:
            array[cut] = values
            return
        file = self._file(name, where)
        # Zarr reads a chunk at an edge before it writes it, and what is left of an earlier one may be in pieces
        file.unlink(missing_ok=True)
        array[cut] = values
        if file.exists():  # not where all values are the fill value
            _to_disk(file)

    def _file(self, name: str, where: tuple[int, ...]) -> Path:
        array = self.arrays[name]
        return self.path / name / array.metadata.encode_chunk_key((*where, *(0,) * (array.ndim - len(where))))  # type: ignore[operator]


def _to_disk(path: Path) -> None:
    """Wait until a file (and its name) is on the disk, not only in the system's memory."""
    for there in (path, path.parent) if os.name != "nt" else (path,):
        number = os.open(there, os.O_RDONLY)
        try:
            os.fsync(number)
        finally:
            os.close(number)
