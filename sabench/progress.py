"""A progress bar on standard error for whatever takes longer than a moment; standard output stays for results."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sized
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

T = TypeVar("T")
console = Console(stderr=True)


def track(items: Iterable[T], doing: str) -> Iterator[T]:
    """Pass `items` through and show how many are done; on a terminal as a bar, in a log as one line when finished."""
    total = len(items) if isinstance(items, Sized) else None
    columns = (TextColumn("{task.description:<38}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console) as progress:
        yield from progress.track(items, description=doing, total=total)
