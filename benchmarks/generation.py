"""Speed-up of data set generation by processes, and cost of the scheduler.

`python benchmarks/generation.py [FRAMES]` prints JSON.

- **throughput**: forty frames of the demo's nine cameras and 20,000 particles that a flow carries,
  with one process and with one for each core, each of one thread, alternating three times. The gain
  is the median of the ratios. The gain of independent processes is measured for comparison, because
  cores share resources.
- **overhead**: FRAMES (1,000) frames of two small cameras whose partial results all exist, done
  once more by another process: the cost of a task, without the check of its partial result,
  relative to the mean time of the sequence's tasks.
- **growth**: a schedule of FRAMES frames, done by 1 to 1,000 simulated workers in simulated time.
  Each task takes as long as one of its kind in the sequence. The scheduler handles one task at a
  time and is busy for as long as that costs. Partial results are put together in the end. It says
  what limits the growth: the chain of frames, each made from the one before, the scheduler, or the
  end.
"""

import heapq
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sabench.scenes import Scene, load_scene, parse_scene
from sabench.simulation.pipeline import put_together
from sabench.simulation.recording.parts import Job, Parts
from sabench.simulation.recording.recorders import record_task, recorder_of
from sabench.simulation.recording.schedule import ProcessPool, RecordingTask, Schedule, run_schedule
from sabench.utils.progress import progress_bar

_FLOW = {
    "generator": "abc_flow",
    "wavelength_mm": 20.0,
    "a_mm_s": 100.0,
    "b_mm_s": 80.0,
    "c_mm_s": 60.0,
}
_WORKERS = (1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1000)
_ALONE = """
import time
import numpy as np
numbers, start, rounds = np.random.default_rng(1).random((600, 600)), time.perf_counter(), 0
while time.perf_counter() - start < 6.0:
    np.sort(numbers, axis=0), np.exp(numbers).sum()
    rounds += 1
print(rounds)
"""


def sequence(frames: int) -> Scene:
    """Make the scene: the demo's cameras, and particles that a flow carries."""
    values = load_scene("demo").to_dict()
    values["particles"] = {"generator": "uniform", "count": 20_000, "diameter_mm": 0.02}
    return parse_scene(values | {"frames": frames, "interval_s": 0.001, "flow": _FLOW}, "sequence")


def small(frames: int) -> Scene:
    """Make the scene: two cameras of few pixels, and few particles."""
    values = load_scene("quick").to_dict()
    values["cameras"] |= {
        "rows": 48,
        "columns": 64,
        "layout": {"kind": "grid", "columns": 2, "rows": 1, "spacing_mm": [240.0, 240.0]},
    }
    values["particles"] = {"generator": "uniform", "count": 50}
    return parse_scene(values | {"frames": frames, "interval_s": 0.001, "flow": _FLOW}, "small")


def worked_off(scene: Scene, folder: Path, jobs: int) -> float:
    """Measure the seconds that processes of one thread need once they run."""
    Job(scene, 1, "splat", "benchmark").write(folder)
    recorder, pool = (
        recorder_of(scene, 1, "splat", "benchmark"),
        ProcessPool(folder, jobs, threads=1),
    )
    for number in pool.idle():
        pool.give(number, RecordingTask(0))
    for _ in range(jobs):
        pool.wait()
    start = time.perf_counter()
    run_schedule(
        pool,
        Schedule(scene.frames, recorder.views, chained=recorder.chained, ahead=pool.ahead),
        f"processes: {jobs}",
    )
    seconds = time.perf_counter() - start
    pool.close()
    return seconds


def throughput(folder: Path) -> dict[str, Any]:
    """Compare one process with one for each core."""
    cores, scene = os.cpu_count() or 1, sequence(40)
    gains = [
        worked_off(scene, folder / f"one{k}", 1)
        / worked_off(scene, folder / f"all{k}", cores)
        / cores
        for k in range(3)
    ]
    alone = statistics.median(measure_independent(cores) / measure_independent(1) for _ in range(3))
    gain = statistics.median(gains)
    return {
        "cores": cores,
        "gain_over_cores": gain,
        "of": gains,
        "independent_processes": alone,
        "gain_over_independent": gain / alone,
    }


def measure_independent(count: int) -> float:
    """Measure rounds of work that each of several independent processes does."""
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    running = [
        subprocess.Popen(
            [sys.executable, "-c", _ALONE], stdout=subprocess.PIPE, text=True, env=environment
        )
        for _ in range(count)
    ]
    return statistics.fmean(int(process.communicate()[0]) for process in running)


@dataclass(frozen=True)
class Times:
    """Seconds of a frame's truth, view and assembly, and of a scheduled task."""

    truth: list[float]
    view: list[float]
    end: float
    scheduler: float = 0.0

    @property
    def mean(self) -> float:
        """Seconds of all tasks."""
        return statistics.fmean([*self.truth, *self.view])

    @property
    def frame(self) -> float:
        """Seconds of a frame's tasks."""
        return statistics.fmean(self.truth) + len(self.view) / len(self.truth) * statistics.fmean(
            self.view
        )


def measure_tasks(scene: Scene, folder: Path) -> Times:
    """Measure the seconds of one process's tasks, one after another."""
    job, parts = Job(scene, 1, "splat", "benchmark"), Parts(folder)
    job.write(folder)
    recorder = recorder_of(scene, 1, "splat", "benchmark")
    schedule = Schedule(scene.frames, recorder.views, chained=recorder.chained, ahead=1)
    took: list[tuple[RecordingTask, float]] = []
    for _ in progress_bar(range(schedule.tasks), "time tasks"):
        task = schedule.take(took[-1][0].frame if took else None)
        assert task is not None
        start = time.perf_counter()
        record_task(recorder, parts, task)
        took.append((task, time.perf_counter() - start))
        schedule.complete(task)
    start = time.perf_counter()
    put_together(folder.with_name(f"{folder.name}-set"), job, recorder, parts, overwrite=False)
    end = (time.perf_counter() - start) / scene.frames
    truths, views = (
        [seconds for task, seconds in took[11:] if (task.camera is None) == truth]
        for truth in (True, False)
    )  # but for the first frame
    return Times(truths, views, end)


def exchange(folder: Path, frames: int) -> float:
    """Measure the extra seconds of a task that another process does."""
    scene = small(frames)
    recorder, parts = recorder_of(scene, 1, "splat", "benchmark"), Parts(folder)
    worked_off(scene, folder, 1)
    again, start = worked_off(scene, folder, 1), time.perf_counter()
    for frame in range(frames):
        parts.has_frame(frame)
        for camera in recorder.cameras:
            parts.has_view(frame, camera.name)
    return max(again - (time.perf_counter() - start), 0.0) / (frames * (1 + recorder.views))


def simulate_workers(
    frames: int, cameras: int, workers: int, times: Times, *, chained: bool
) -> float:
    """Simulate the seconds that workers need with one serial scheduler."""
    schedule, rng, now, free = (
        Schedule(frames, cameras, chained=chained, ahead=workers + 1),
        np.random.default_rng(1),
        0.0,
        0.0,
    )
    idle, last = list(range(workers)), dict.fromkeys(range(workers), -1)
    running: list[tuple[float, int, RecordingTask]] = []
    while not schedule.finished:
        while idle and (task := schedule.take(last[idle[-1]])) is not None:
            worker, kind = idle.pop(), times.truth if task.camera is None else times.view
            last[worker], free = task.frame, max(free, now) + times.scheduler
            heapq.heappush(running, (free + float(rng.choice(kind)), worker, task))
        now, worker, task = heapq.heappop(running)
        schedule.complete(task)
        idle.append(worker)
    return now


def growth(times: Times, frames: int, cameras: int) -> dict[str, Any]:
    """Compute the speed of workers relative to one, and its limits.

    Speeds are before and after the partial results are put together.
    """
    speed, end = {}, times.end * frames
    for chained in (True, False):
        took = {
            n: simulate_workers(frames, cameras, n, times, chained=chained)
            for n in progress_bar(_WORKERS, "simulate workers")
        }
        name = "frames from the one before" if chained else "frames by themselves"
        speed[name] = {
            n: [took[1] / seconds, (took[1] + end) / (seconds + end)] for n, seconds in took.items()
        }
    chain, scheduler = (
        times.frame / statistics.fmean(times.truth),
        times.frame / ((1 + cameras) * times.scheduler),
    )
    return {
        "speed": speed,
        "limits": {
            "chain": chain,
            "scheduler": scheduler,
            "putting together": times.frame / times.end + 1.0,
        },
    }


def round_all(value: Any) -> Any:
    """Round to four digits."""
    if isinstance(value, dict):
        return {str(key): round_all(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [round_all(inner) for inner in value]
    return float(f"{value:.4g}") if isinstance(value, float) else value


def main() -> None:
    """Print one JSON object."""
    frames = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    with tempfile.TemporaryDirectory() as work:
        folder = Path(work)
        first = measure_tasks(sequence(20), folder / "timed")
        times = Times(first.truth, first.view, first.end, exchange(folder / "small", frames))
        report = {
            "seconds": {
                "truth": statistics.fmean(times.truth),
                "view": statistics.fmean(times.view),
                "putting a frame together": times.end,
            },
            "overhead": {
                "frames": frames,
                "ms_per_task": 1e3 * times.scheduler,
                "percent_of_the_work": 100.0 * times.scheduler / times.mean,
            },
            "throughput": throughput(folder),
            "growth": growth(times, frames, 9),
        }
    print(json.dumps(round_all(report), indent=1))


if __name__ == "__main__":
    main()
