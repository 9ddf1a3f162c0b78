"""A progress bar on standard error for whatever takes longer than a moment; standard output stays for results."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterable, Iterator, Sized
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

T = TypeVar("T")
console = Console(stderr=True)
_REFRESH_S = 0.2


def track(items: Iterable[T], doing: str) -> Iterator[T]:
    """Pass `items` through and show how many are done; on a terminal as a bar, in a log as one line when finished.

    Where the caller's loop raises, this generator ends when Python's garbage collector finds it, in
    whichever thread that runs. So the thread that keeps the clock running is told to end and never
    waited for; rich's own is joined, which from within that very thread never returns.
    """
    total = len(items) if isinstance(items, Sized) else None
    ended = threading.Event()
    with _progress(refresh=False) as progress:
        task = progress.add_task(doing, total=total)
        if console.is_terminal:
            threading.Thread(target=_keep_alive, args=(progress, ended), daemon=True).start()
        try:
            for item in items:
                yield item
                progress.advance(task)
        finally:
            ended.set()


def _keep_alive(progress: Progress, ended: threading.Event) -> None:
    while not ended.wait(_REFRESH_S):
        progress.refresh()


@contextlib.contextmanager
def bar(doing: str, total: int) -> Iterator[Callable[[], None]]:
    """The same for things that are done in no order: what it gives is called once for each."""
    with _progress(refresh=True) as progress:
        task = progress.add_task(doing, total=total)
        yield lambda: progress.advance(task)


def _progress(*, refresh: bool) -> Progress:
    columns = (
        TextColumn("{task.description:<38}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    return Progress(*columns, console=console, auto_refresh=refresh)
