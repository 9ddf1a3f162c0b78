"""The workers of a Dask cluster, which see the folder of the data set."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from pathlib import Path
from typing import Any

from dask import config
from distributed import Client, wait

from sabench.simulation.recording.job import do
from sabench.simulation.recording.schedule import Outcome, Task
from sabench.utils.errors import InputError
from sabench.utils.progress import console

_PATIENCE_S = 20.0  # before it says that it waits
_SILENT_S = 8.0  # that an address may be at first


class DaskPool:
    """All workers of a Dask scheduler, those that come later as well, one task each at a time."""

    def __init__(self, address: str, root: Path) -> None:
        self._root = str(root)
        with config.set({"distributed.comm.timeouts.connect": _SILENT_S}):
            try:
                self._client = Client(address, timeout=_SILENT_S)
            except (OSError, ValueError, TimeoutError) as error:
                raise InputError(
                    f"scheduler: expected a Dask scheduler at {address}, got {type(error).__name__}: {error}"
                ) from error
        self._tasks: dict[Any, tuple[Hashable, Task]] = {}

    @property
    def ahead(self) -> int:
        """One frame for each, and one more for whoever comes first."""
        return len(self._addresses()) + 1

    def idle(self) -> Sequence[Hashable]:
        """Workers without a task."""
        busy = {worker for worker, _ in self._tasks.values()}
        return [address for address in self._addresses() if address not in busy]

    def give(self, worker: Hashable, task: Task) -> None:
        """Have a worker do a task; another one does it if that worker dies."""
        future = self._client.submit(
            _do,
            self._root,
            task.frame,
            task.camera,
            workers=[worker],
            allow_other_workers=True,
            pure=False,
        )
        self._tasks[future] = worker, task

    def wait(self) -> list[Outcome]:
        """What has ended; says so if nothing does for lack of workers."""
        if not self._tasks:
            self._client.wait_for_workers(1)
            return []
        try:
            ended = wait(list(self._tasks), timeout=_PATIENCE_S, return_when="FIRST_COMPLETED").done
        except TimeoutError:
            if not self._addresses():
                console.print(
                    "waiting for workers: the scheduler has none", style="dim", highlight=False
                )
            return []
        return [self._outcome(future) for future in ended]

    def _outcome(self, future: Any) -> Outcome:
        worker, task = self._tasks.pop(future)
        error = future.exception()
        if isinstance(error, InputError | OSError) and not isinstance(error, TimeoutError):
            raise error
        return Outcome(worker, task, None if error is None else f"{type(error).__name__}: {error}")

    def close(self) -> None:
        """Take back what has not begun, and leave the workers to others."""
        self._client.cancel(list(self._tasks))
        self._client.close()

    def _addresses(self) -> list[str]:
        return list(self._client.scheduler_info(n_workers=-1)["workers"])


def _do(root: str, frame: int, camera: int | None) -> None:
    do(root, Task(frame, camera))
