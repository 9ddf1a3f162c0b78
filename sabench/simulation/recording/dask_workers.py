"""Workers of a Dask cluster, which must see the folder of the data set."""

from collections.abc import Hashable, Sequence
from pathlib import Path
from typing import Any

from dask import config
from distributed import Client, wait

from sabench.simulation.recording.schedule import Outcome, RecordingTask
from sabench.simulation.recording.worker import run_task
from sabench.utils.errors import InputError
from sabench.utils.progress import say

_REPORT_S = 20.0  # time without an outcome after which it reports a lack of workers
_CONNECT_S = 8.0  # time limit of the first connection


class DaskPool:
    """Pool of all workers of a Dask scheduler, including those that join later.

    Each does one task at a time.
    """

    def __init__(self, address: str, root: Path) -> None:
        self._root = str(root)
        with config.set({"distributed.comm.timeouts.connect": _CONNECT_S}):
            try:
                self._client = Client(address, timeout=_CONNECT_S)
            except (OSError, ValueError, TimeoutError) as error:
                got = f"{type(error).__name__}: {error}"
                sentence = f"scheduler: expected a Dask scheduler at {address}, got {got}"
                raise InputError(sentence) from error
        self._tasks: dict[Any, tuple[Hashable, RecordingTask]] = {}

    @property
    def ahead(self) -> int:
        """One frame for each worker, and one for the first that is done."""
        return len(self._addresses()) + 1

    def idle(self) -> Sequence[Hashable]:
        """Return the workers without a task."""
        busy = {worker for worker, _ in self._tasks.values()}
        return [address for address in self._addresses() if address not in busy]

    def give(self, worker: Hashable, task: RecordingTask) -> None:
        """Submit a task to a worker; Dask gives it to another one if that worker dies."""
        future = self._client.submit(
            _run_task,
            self._root,
            task.frame,
            task.camera,
            workers=[worker],
            allow_other_workers=True,
            pure=False,
        )
        self._tasks[future] = worker, task

    def wait(self) -> list[Outcome]:
        """Wait for tasks to end, and report a lack of workers after a while."""
        if not self._tasks:
            self._client.wait_for_workers(1)
            return []
        try:
            ended = wait(list(self._tasks), timeout=_REPORT_S, return_when="FIRST_COMPLETED").done
        except TimeoutError:
            if not self._addresses():
                say("waiting for workers: the scheduler has none", "dim")
            return []
        return [self._outcome(future) for future in ended]

    def _outcome(self, future: Any) -> Outcome:
        worker, task = self._tasks.pop(future)
        error = future.exception()
        if isinstance(error, InputError | OSError) and not isinstance(error, TimeoutError):
            raise error
        return Outcome(worker, task, None if error is None else f"{type(error).__name__}: {error}")

    def close(self) -> None:
        """Cancel tasks that have not begun, and disconnect."""
        self._client.cancel(list(self._tasks))
        self._client.close()

    def _addresses(self) -> list[str]:
        return list(self._client.scheduler_info(n_workers=-1)["workers"])


def _run_task(root: str, frame: int, camera: int | None) -> None:
    run_task(root, RecordingTask(frame, camera))
