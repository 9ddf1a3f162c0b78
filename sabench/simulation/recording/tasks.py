"""Tasks of the job in a folder: frames and views, or shards of samples."""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable
from pathlib import Path

from sabench.simulation.recording.job import read_job, record_task
from sabench.simulation.recording.parts import Parts
from sabench.simulation.recording.recorders import recorder_of
from sabench.simulation.recording.schedule import Task
from sabench.simulation.shard_job import PLAN, ShardMaker, read_shard_job

_ONE_AT_A_TIME = threading.Lock()  # renderers cannot run in two threads


def run_task(root: str, task: Task) -> None:
    """Do one task of the job in a folder, unless its result is there."""
    with _ONE_AT_A_TIME:
        _open(root)(task)


@functools.lru_cache(maxsize=1)
def _open(root: str) -> Callable[[Task], None]:
    folder = Path(root)
    if (folder / PLAN).is_file():
        return ShardMaker(read_shard_job(folder), folder)
    job = read_job(folder)
    recorder = recorder_of(job.scene, job.seed, job.renderer, job.label)
    return functools.partial(record_task, recorder, Parts(folder))
