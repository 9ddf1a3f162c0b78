"""A progress bar on standard error for whatever takes longer than a moment; standard output stays for results."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator, Sized
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

T = TypeVar("T")
console = Console(stderr=True)


def track(items: Iterable[T], doing: str) -> Iterator[T]:
    """Pass `items` through and show how many are done; on a terminal as a bar, in a log as one line when finished."""
    with _progress() as progress:
        yield from progress.track(items, description=doing, total=len(items) if isinstance(items, Sized) else None)


@contextlib.contextmanager
def bar(doing: str, total: int) -> Iterator[Callable[[], None]]:
    """The same for things that are done in no order: what it gives is called once for each."""
    with _progress() as progress:
        task = progress.add_task(doing, total=total)
        yield lambda: progress.advance(task)


def _progress() -> Progress:
    return Progress(TextColumn("{task.description:<38}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), console=console)
