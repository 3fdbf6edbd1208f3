"""How far a long computation is: rate and time left, for a callback or as a bar; and how it is stopped."""

import contextlib
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import NamedTuple


class Progress(NamedTuple):
    """Points done of all, points per second (of this session, without its first chunk, which compiles), seconds left."""

    done: int
    total: int
    rate: float
    left: float


Report = Callable[[Progress], None]


class Clock:
    """Makes `Progress` of counts of points as they are done."""

    def __init__(self, done: int, total: int):
        self.done, self.total = done, total
        self._since, self._from, self._compiled = time.monotonic(), done, False

    def advance(self, points: int) -> Progress:
        """After some more points."""
        self.done += points
        now = time.monotonic()
        rate = (self.done - self._from) / max(now - self._since, 1e-9)
        if not self._compiled:
            self._since, self._from, self._compiled = now, self.done, True
        return Progress(self.done, self.total, rate, (self.total - self.done) / rate)


@contextlib.contextmanager
def bar(shown: bool, what: str) -> Iterator[Report]:
    """A report that draws a bar on standard error, if `shown` and if that is a terminal (or a notebook)."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn
    from rich.progress import Progress as Bar

    console = Console(stderr="ipykernel" not in sys.modules)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[pace]}"))
    disable = not (shown and (console.is_terminal or console.is_jupyter))
    with Bar(*columns, console=console, disable=disable) as drawn:
        task = drawn.add_task(what, total=None, pace="")

        def report(at: Progress) -> None:
            pace = f"{at.rate:,.0f} points/s, {_spoken(at.left)} left"
            drawn.update(task, completed=at.done, total=at.total, pace=pace)

        yield report


@contextlib.contextmanager
def parts_bar(telling: bool = False) -> Iterator[Callable[[str, int, int], None]]:
    """A report (title, done, total) of parts, drawn as a bar where standard error is a terminal: not into a file or a pipe, where errors are
    to be the only line. When `telling`, what each part took stays above it."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Bar(*columns, console=Console(stderr=True), disable=not sys.stderr.isatty()) as drawn:
        task = drawn.add_task("", total=None)
        running, since = "", time.perf_counter()

        def report(title: str, done: int, total: int) -> None:
            nonlocal running, since
            now = time.perf_counter()
            if telling and running and not drawn.disable:
                drawn.console.print(f"{now - since:6.1f} s  {running}")
            running, since = title, now
            drawn.update(task, description=title, completed=done, total=total)

        yield report


def _spoken(seconds: float) -> str:
    minutes, seconds = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{seconds:02d}"


#: exit status after Ctrl-C, as shells give it
INTERRUPTED = 130
#: what is said then, innermost last
_said = ["stopped"]


def leave() -> None:
    """End the process after Ctrl-C, at once: XLA's threads, if they compile, crash or hold up an interpreter that is taken down."""
    os._exit(INTERRUPTED)


def end_at_ctrl_c() -> None:
    """From here on Ctrl-C ends the process with one line on standard error, wherever it comes: a `KeyboardInterrupt` would be lost in
    a destructor or where Python calls back from JAX."""
    error = os.dup(2)  # which `compilation` listens to now and then

    def end(number: int, frame: object) -> None:
        # past Python's buffer, which may be in use; progress bars hide the cursor
        shown = "\x1b[?25h\n" if sys.stderr.isatty() else ""
        os.write(error, f"{shown}railjax: {_said[-1]}\n".encode())
        leave()

    signal.signal(signal.SIGINT, end)


@contextlib.contextmanager
def when_stopped(message: str) -> Iterator[None]:
    """Within it `message` is what Ctrl-C says before it ends the process."""
    _said.append(message)
    try:
        yield
    finally:
        _said.pop()


@contextlib.contextmanager
def stoppable(message: str) -> Iterator[Callable[[], bool]]:
    """Within it the first Ctrl-C only says `message`, and the function given tells that it came; the second interrupts.

    A `KeyboardInterrupt` anywhere would be lost where Python calls back from JAX, and would tear a file that is being written.
    """
    came = threading.Event()

    def note(number: int, frame: object) -> None:
        if came.is_set():
            raise KeyboardInterrupt
        came.set()
        print(f"railjax: {message}", file=sys.stderr)

    if threading.current_thread() is not threading.main_thread():
        yield came.is_set  # signals are for the main thread
        return
    before = signal.signal(signal.SIGINT, note)
    try:
        yield came.is_set
    finally:
        signal.signal(signal.SIGINT, before)
