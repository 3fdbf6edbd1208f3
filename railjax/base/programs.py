"""What is compiled: kept on disk for later processes, let go of in memory.

JAX's own cache saves the compiler's time only; each process traces and lowers a program anew to learn which one it is, and that is most
of a first answer. The command line therefore keeps programs whole, by what they are made of: the package's source, the function and its
`parts`, the kinds of its arguments, the libraries, the processor and the settings. Where one of these cannot be told for certain, such as
a law of the user's own, JAX traces as ever.
"""

import contextlib
import ctypes
import dataclasses
import functools
import gc
import hashlib
import inspect
import os
import pickle
import platform
import re
import sys
import tempfile
import threading
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import jax
import jaxlib
import numpy as np
from jax.experimental import serialize_executable

from .arguments import guarded
from .checks import FLAG
from .packing import Unlike
from .source import digest_of_source
from .whole_file import write_whole

F = TypeVar("F", bound=Callable[..., Any])

#: bytes that the folder of compiled code may hold when a process begins; some 30 kB a program, and 200 kB a whole one
KEPT = 500e6

#: what XLA prints at every load on JAX 0.10, where two wishes of its compiler count as features that the processor lacks (XLA issue 44565)
FALSE_ALARM = re.compile(rb"Target machine feature \+prefer-no-(gather|scatter) is not +supported")
_listening = threading.Lock()

#: where whole programs are, if they are kept; those that this process has loaded or made, by each function
_folder: Path | None = None
_loaded: list[dict] = []
_heard = threading.local()


@guarded(whole=FLAG)
def keep_compiled(folder: str | Path | None = None, *, whole: bool = False) -> Path:
    """Keep what is compiled on disk, so that later processes need not compile it again; call it before anything is computed.

    The command line does it by itself. Deleting the folder is always safe, and what has not been used for longest is deleted beyond 500 MB.

    Args:
        folder: default a folder per machine below $XDG_CACHE_HOME or ~/.cache, as compiled code may use what another processor lacks. A
            folder that JAX has been given already ($JAX_COMPILATION_CACHE_DIR, jax.config) is kept.
        whole: also programs as a whole, which are not even traced again: half the time of a small first answer. As on the command line;
            not for a process that replaces functions of railjax while it runs, whose source they are known by.

    Returns:
        The folder.
    """
    global _folder
    if jax.__version_info__ < (0, 11):
        from jax._src import compilation_cache as cache

        load = cache.get_executable_and_time
        cache.get_executable_and_time = load if hasattr(load, "__wrapped__") else _without_false_alarm(load)
    given = jax.config.jax_compilation_cache_dir
    if given is None:
        base = os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser()
        folder = Path(folder or Path(base, "railjax", platform.node() or "this-machine"))
        jax.config.update("jax_compilation_cache_dir", str(folder))
        # also what compiles quickly: a hundred such programs are seconds
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
        _forget(folder)
    else:
        folder = Path(given)
    _folder = folder if whole else None
    return folder


def _forget(folder: Path) -> None:
    """Delete what was used longest ago, down to half of what may be kept, once there is more."""
    with contextlib.suppress(OSError):  # no folder yet, or another process does the same
        found = [(file, file.stat()) for file in folder.iterdir()]
        total = sum(about.st_size for _, about in found)
        if total > KEPT:
            for file, about in sorted(found, key=lambda entry: entry[1].st_atime):
                file.unlink()
                total -= about.st_size
                if total < KEPT / 2:
                    return


def _without_false_alarm(load: F) -> F:
    """The same function, without what XLA prints on standard error meanwhile that is no more than `FALSE_ALARM`."""

    @functools.wraps(load)
    def quiet(*arguments: Any, **named: Any) -> Any:
        with _listening, tempfile.TemporaryFile() as heard:
            kept = os.dup(2)
            os.dup2(heard.fileno(), 2)
            try:
                return load(*arguments, **named)
            finally:
                os.dup2(kept, 2)
                os.close(kept)
                heard.seek(0)
                for line in heard:
                    if not FALSE_ALARM.search(line):
                        os.write(2, line)

    return quiet  # type: ignore[return-value]


def forget_compiled() -> None:
    """Let go of everything compiled so far, between studies that have no program in common: it is most of a long process's memory.

    What is called again is compiled again, or read from the folder of `keep_compiled`.
    """
    jax.clear_caches()
    for programs in _loaded:
        programs.clear()
    return_memory()


def return_memory() -> None:
    """Give back to the system what is free: the C library keeps what the compiler needed, some 200 MB after a few large programs."""
    gc.collect()
    if sys.platform == "linux" and hasattr(library := ctypes.CDLL(None), "malloc_trim"):  # glibc's, not musl's
        library.malloc_trim(0)


def kept(function: Callable[..., Any], *parts: Any, **of_jit: Any) -> Callable[..., Any]:
    """`jax.jit(function, **of_jit)`, whose programs for known numbers are kept whole where `keep_compiled` says so.

    Args:
        function: of arrays and trees of them, from a module of railjax; it may depend on nothing but these, the source and `parts`. No
            solver or other code of a library but JAX.
        *parts: what it was made of, where it is a closure: forms of trees, structures, words, numbers, functions of modules.
        **of_jit: as `jax.jit` takes it, but for static arguments.
    """
    compiled, making = jax.jit(function, **of_jit), threading.Lock()
    programs: dict[Any, Callable[..., Any]] = {}
    _loaded.append(programs)

    @functools.wraps(function)
    def called(*arguments: Any) -> Any:
        if _folder is None or jax.config.jax_disable_jit:
            return compiled(*arguments)
        leaves, structure = jax.tree.flatten(arguments)
        if not all(_known(leaf) for leaf in leaves):
            return compiled(*arguments)
        kinds = structure, tuple((leaf.shape, leaf.dtype) for leaf in leaves)
        with making:
            if kinds not in programs:
                made_of = inspect.unwrap(function).__qualname__, function.__module__, parts, of_jit, *kinds
                whole = _program(_folder, function, of_jit, made_of, arguments)
                programs[kinds] = compiled if whole is None else whole
            program = programs[kinds]
        return program(*arguments)

    return called


def _known(leaf: Any) -> bool:
    """Whether it is an array of numbers, of NumPy or on the first device."""
    if isinstance(leaf, np.ndarray | np.generic):
        return True
    return (
        isinstance(leaf, jax.Array)
        and not isinstance(leaf, jax.core.Tracer)
        and not leaf.weak_type
        and leaf.devices() == {jax.devices()[0]}
    )


def _program(
    folder: Path, function: Callable[..., Any], of_jit: dict, made_of: tuple, arguments: tuple
) -> Callable[..., Any] | None:
    """The program for such arguments from the folder, or compiled and put there; None where it cannot be told from others, or is for another
    device than the processor, whose kind and driver it would depend on."""
    if jax.default_backend() != "cpu":
        return None
    try:
        name = hashlib.sha256(_told((made_of, _surroundings())).encode()).hexdigest()
    except _Untold:
        return None
    file = folder / f"{name}.program"
    # a damaged file is as good as none, whatever it makes of the loading
    with contextlib.suppress(Exception):
        return _load(file, jax.tree.structure((arguments, {})))

    def named(*arguments: Any) -> Any:
        return function(*arguments)

    # JAX's own cache must not have it: what was loaded from there lacks its code when it is written again (JAX 0.10)
    _listen()
    named.__name__, before = f"railjax_{name}", _hits()
    program = jax.jit(named, **of_jit).lower(*arguments).compile()
    with contextlib.suppress(Exception):  # what cannot be written is made again
        if _hits() == before:
            code, _, results = serialize_executable.serialize(program)
            folder.mkdir(parents=True, exist_ok=True)
            write_whole(file, zlib.compress(pickle.dumps((code, results)), 1))
    return program


def _hits() -> int:
    """Programs that this thread has had from JAX's own cache."""
    return getattr(_heard, "hits", 0)


@functools.cache
def _listen() -> None:
    def listener(event: str, **_: Any) -> None:
        if event.endswith("/cache_hits"):
            _heard.hits = _hits() + 1

    jax.monitoring.register_event_listener(listener)


def _load(file: Path, structure: Any) -> Callable[..., Any]:
    """The program from its file, for arguments of this structure."""
    load = serialize_executable.deserialize_and_load
    if jax.__version_info__ < (0, 11):
        load = _without_false_alarm(load)
    code, results = pickle.loads(zlib.decompress(file.read_bytes()))
    return load(code, structure, results, execution_devices=jax.devices()[:1])


def _surroundings() -> tuple:
    """What compiled code depends on beside what is compiled."""
    states = "enable_x64", "debug_nans", "default_matmul_precision"
    settings = {name: value for name, value in os.environ.items() if name.startswith(("JAX_", "XLA_"))}
    here = jax.default_backend(), len(jax.local_devices())
    return _machine(), here, tuple(getattr(jax.config, f"jax_{state}") for state in states), settings


@functools.cache
def _machine() -> tuple:
    """Source, libraries and processor."""
    processor = ""
    with contextlib.suppress(OSError):
        processor = "".join(re.findall(r"^(?:flags|Features)\b.*$", Path("/proc/cpuinfo").read_text(), re.MULTILINE)[:1])
    libraries = jax.__version__, jaxlib.__version__, np.__version__, sys.version
    return digest_of_source("cli"), libraries, platform.machine(), processor


class _Untold(Exception):
    """Something of which words do not say all."""


def _told(thing: Any) -> str:
    """All that a program can depend on of a thing, in words; stricter than `fingerprint.described`, which names by its class what it does
    not know."""
    if isinstance(thing, Unlike):
        return ""
    if thing is None or isinstance(thing, bool | int | float | str | bytes):
        return f"{type(thing).__name__} {thing!r}"
    if isinstance(thing, np.dtype):
        return thing.str
    if isinstance(thing, tuple | list):
        return f"{_named(type(thing))}({', '.join(_told(part) for part in thing)})"
    if isinstance(thing, dict):
        return _told(("dict", *((key, thing[key]) for key in sorted(thing))))
    if isinstance(thing, jax.tree_util.PyTreeDef):
        node = thing.node_data()
        return "*" if node is None else _told((_named(node[0]), node[1], *thing.children()))
    if isinstance(thing, type) or inspect.isfunction(thing):
        return _named(thing)
    if dataclasses.is_dataclass(thing):
        return _told((_named(type(thing)), *(getattr(thing, field.name) for field in dataclasses.fields(thing))))
    raise _Untold


def _named(thing: Any) -> str:
    """The full name of a class or function that stands under it in a module of railjax, or of Python's own."""
    module, name = thing.__module__, thing.__qualname__
    if module != "builtins" and (
        not module.startswith("railjax.") or "<" in name or "." in name or vars(sys.modules[module]).get(name) is not thing
    ):
        raise _Untold
    return f"{module}.{name}"
