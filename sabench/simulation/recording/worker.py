"""Process that does tasks of a job: frames and views, or shards of samples.

Run as `python -m sabench.simulation.recording.worker FOLDER THREADS`. It reads lines of JSON,
[frame, camera], and answers each with [kind, reason].
"""

import functools
import json
import os
import sys
import threading
from collections.abc import Callable
from pathlib import Path

from sabench.simulation.recording.parts import JOB, Parts, read_job
from sabench.simulation.recording.recorders import record_task, recorder_of
from sabench.simulation.recording.schedule import RecordingTask
from sabench.simulation.shard_job import PLAN, ShardMaker, read_shard_job
from sabench.utils import backend
from sabench.utils.errors import InputError
from sabench.utils.files import read_json

_ONE_AT_A_TIME = threading.Lock()  # renderers cannot run in two threads


def run_task(root: str, task: RecordingTask) -> None:
    """Do one task of the job in a folder, unless its result is there."""
    with _ONE_AT_A_TIME:
        _open(root)(task)


@functools.lru_cache(maxsize=1)
def _open(root: str) -> Callable[[RecordingTask], None]:
    folder = Path(root)
    if (folder / PLAN).is_file():
        return ShardMaker(read_shard_job(folder), folder)
    job = read_job(folder)
    recorder = recorder_of(job.scene, job.seed, job.renderer, job.label)
    return functools.partial(record_task, recorder, Parts(folder))


def _main() -> None:
    root, threads = sys.argv[1], int(sys.argv[2])
    with os.fdopen(os.dup(1), "w", encoding="utf-8") as answers:
        os.dup2(2, 1)  # libraries that print must not answer
        import cv2

        cv2.setNumThreads(threads)  # OpenCV and Mitsuba do not read the number in the environment
        if read_json(Path(root) / JOB)["renderer"] == "mitsuba":
            backend.limit_threads(threads)
        for line in sys.stdin:
            try:
                print(
                    json.dumps(_try(root, RecordingTask(*json.loads(line)))),
                    file=answers,
                    flush=True,
                )
            except BrokenPipeError:  # the parent process has been killed
                return


def _try(root: str, task: RecordingTask) -> tuple[str, str | None]:
    try:
        run_task(root, task)
    except InputError as error:
        return "input", str(error)
    except OSError as error:
        return "system", f"{error.filename}: {error.strerror}" if error.filename else str(error)
    except Exception as error:
        return "other", f"{type(error).__name__}: {error}"
    return "done", None


if __name__ == "__main__":
    _main()
