"""Progress bars and notices on standard error.

Standard output is left to results.
"""

import contextlib
import functools
import math
import threading
from collections.abc import Callable, Iterable, Iterator, Sized
from datetime import timedelta
from typing import Any, TypeVar

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeElapsedColumn,
)
from rich.text import Text

T = TypeVar("T")
console = Console(stderr=True)
_PATIENCE_S = 0.5  # of compiling without a notice


def say(text: str, style: str | None = None) -> None:
    """Print a line on standard error as it is, however long."""
    console.print(text, style=style, markup=False, highlight=False, soft_wrap=True)


def progress_bar(items: Iterable[T], doing: str) -> Iterator[T]:
    """Yield items and show how many are done.

    A bar on a terminal, in a log one line at the end. If the caller's loop raises, this generator
    is closed by the garbage collector, in any thread. So the thread that refreshes the bar is
    signalled to end, but not joined: rich joins its own, and a thread that joins itself never
    returns.
    """
    total = len(items) if isinstance(items, Sized) else None
    ended = threading.Event()
    with _progress(refresh=False) as progress:
        task = progress.add_task(doing, total=total)

        def keep_alive() -> None:
            while not ended.wait(1.0 / progress.live.refresh_per_second):
                progress.refresh()

        if console.is_terminal:
            threading.Thread(target=keep_alive, daemon=True).start()
        try:
            for item in items:
                yield item
                progress.advance(task)
        finally:
            ended.set()


@contextlib.contextmanager
def bar(doing: str, total: int) -> Iterator[Callable[..., None]]:
    """Show a bar for work in any order; call the yielded function once per item."""
    with _progress(refresh=True) as progress:
        task = progress.add_task(doing, total=total)

        def show(share: float = 1.0) -> None:
            now = progress.tasks[0].completed
            progress.update(task, completed=max(now, math.floor(now) + share))

        _shown.append(show)
        try:
            yield show
        finally:
            _shown.remove(show)


_shown: list[Callable[[float], None]] = []


def report_share(share: float) -> None:
    """Move the bar of this process, if there is one, to a share of its current item."""
    for show in _shown:
        show(min(share, 0.99))


class _LeftColumn(ProgressColumn):
    """Estimate of the time that is left, from the items so far."""

    def render(self, task: Task) -> Text:
        """Show nothing before the second item and after the last one."""
        left = None if task.finished else task.time_remaining
        return Text("" if left is None else f"{timedelta(seconds=round(left))} left")


def _progress(*, refresh: bool, transient: bool = False) -> Progress:
    text = TextColumn("{task.description:<38}")
    columns = (text, BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), _LeftColumn())
    return Progress(*columns, console=console, auto_refresh=refresh, transient=transient)


@functools.cache
def announce_compiling(kernels: int | None = None) -> None:
    """Have this process show a bar, or a line in a log, while it compiles kernels.

    It counts those of sabench, of which so many are expected if none is stored.
    """
    from numba.core import event

    class CompileListener(event.Listener):  # type: ignore[misc]
        """Bar that shows while kernels compile; those from the cache send no events."""

        def __init__(self) -> None:
            self.depth = 0  # a kernel that calls others compiles them within its own compilation
            self.lock, self.timer = threading.Lock(), threading.Timer(0.0, self.show)
            self.bar = _progress(refresh=True, transient=True)
            self.task = self.bar.add_task("compile kernels, once", total=kernels, start=False)

        def show(self) -> None:
            """Show the bar, unless compilation has ended."""
            with self.lock:
                if self.depth:
                    self.bar.start() if console.is_terminal else _say_compiling()

        def on_start(self, event: Any) -> None:
            """Show the bar some time after the outermost compilation has begun."""
            self.depth += 1
            if self.depth == 1:
                self.bar.start_task(self.task)
                self.timer = threading.Timer(_PATIENCE_S, self.show)
                self.timer.daemon = True
                self.timer.start()

        def on_end(self, event: Any) -> None:
            """Count the kernel, and hide the bar with the outermost compilation."""
            if event.data["dispatcher"].py_func.__module__.startswith("sabench"):
                self.bar.advance(self.task)
            with self.lock:
                self.depth -= 1
                if not self.depth:
                    self.timer.cancel()
                    self.bar.stop()

    event.register("numba:compile", CompileListener())


@functools.cache
def _say_compiling() -> None:
    say("compiling kernels (once)", "dim")
