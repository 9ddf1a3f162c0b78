"""The order of tasks of a recording.

Each is done once, in an allowed order, whichever workers come and die; and how far workers carry
it.
"""

from __future__ import annotations

import numpy as np
import pytest

from sabench.simulation.recording.schedule import TRIES, Schedule, Task


def check_allowed(task: Task, finished: set[Task], *, chained: bool) -> None:
    """Check that a task's predecessors are finished.

    A camera comes after its frame's truth. In a chain, a frame's truth comes after that of the
    frame before.
    """
    if task.camera is not None:
        assert Task(task.frame) in finished
    elif chained and task.frame:
        assert Task(task.frame - 1) in finished


def work(
    schedule: Schedule,
    workers: int,
    *,
    chained: bool,
    seed: int,
    dying: float = 0.0,
    before: tuple[Task, ...] = (),
) -> tuple[list[Task], int]:
    """Run workers that take random times and now and then fail.

    Returns the tasks in the order of their ends, and the largest number of simultaneous frames.
    """
    rng, most = np.random.default_rng(seed), 0
    running: dict[int, Task] = {}
    last: dict[int, int] = {}
    ended = list(before)
    while not schedule.finished:
        for worker in range(workers):
            if worker not in running and (task := schedule.take(last.get(worker))) is not None:
                check_allowed(task, set(ended), chained=chained)
                running[worker], last[worker] = task, task.frame
        most = max(most, len({task.frame for task in running.values()}))
        assert running, "all wait for each other"
        worker = int(rng.choice(list(running)))
        task = running.pop(worker)
        if rng.random() < dying:
            schedule.fail(task, "died")
            continue
        schedule.complete(task)
        ended.append(task)
    assert not running
    return ended, most


@pytest.mark.parametrize("chained", [False, True])
@pytest.mark.parametrize(
    ("frames", "cameras", "workers"),
    [(1, 1, 1), (7, 3, 1), (7, 3, 2), (40, 4, 5), (5, 9, 30), (9, 0, 3)],
)
def test_everything_is_done_once_in_an_order_that_it_allows(
    frames: int, cameras: int, workers: int, chained: bool
) -> None:
    for seed in range(5):
        schedule = Schedule(frames, cameras, chained=chained, ahead=workers + 1)
        ended, most = work(schedule, workers, chained=chained, seed=seed)
        assert len(ended) == len(set(ended)) == schedule.tasks == frames * (1 + cameras)
        assert most <= workers + 1
        assert schedule.failures == []


def test_a_task_that_fails_now_and_then_is_done_in_the_end() -> None:
    schedule = Schedule(60, 3, chained=True, ahead=4)
    ended, _ = work(schedule, 3, chained=True, seed=1, dying=0.05)
    assert len(set(ended)) == len(ended) == schedule.tasks
    assert schedule.failures == []


def test_one_worker_stays_with_a_frame() -> None:
    ended, _ = work(Schedule(4, 3, chained=False, ahead=1), 1, chained=False, seed=0)
    assert ended == [Task(frame, camera) for frame in range(4) for camera in (None, 0, 1, 2)]


def test_two_workers_take_a_frame_each_and_share_the_last() -> None:
    schedule = Schedule(3, 2, chained=False, ahead=3)
    assert [schedule.take(None), schedule.take(None)] == [Task(0), Task(1)]
    schedule.complete(Task(0))
    schedule.complete(Task(1))
    assert [schedule.take(1), schedule.take(0)] == [Task(1, 0), Task(0, 0)]
    schedule.complete(Task(1, 0))
    assert schedule.take(1) == Task(1, 1)
    schedule.complete(Task(1, 1))
    assert schedule.take(1) == Task(2)
    schedule.complete(Task(2))
    assert schedule.take(1) == Task(2, 0)
    schedule.complete(Task(0, 0))
    assert schedule.take(0) == Task(0, 1)
    schedule.complete(Task(0, 1))
    assert schedule.take(0) == Task(2, 1)


def fail(schedule: Schedule, task: Task) -> None:
    for _ in range(TRIES):
        while schedule.take(None) != task:
            pass
        schedule.fail(task, "broken")


def test_a_camera_that_always_fails_is_a_failure_and_the_rest_is_done() -> None:
    schedule = Schedule(2, 2, chained=True, ahead=1)
    assert schedule.take(None) == Task(0)
    schedule.complete(Task(0))
    assert schedule.take(0) == Task(0, 0)
    for _ in range(TRIES):
        schedule.fail(Task(0, 0), "broken")
        if not schedule.failures:
            assert schedule.take(0) == Task(0, 0)
    assert schedule.failures == [(Task(0, 0), "broken")]
    ended, _ = work(schedule, 1, chained=True, seed=0, before=(Task(0),))
    assert ended == [Task(0), Task(0, 1), Task(1), Task(1, 0), Task(1, 1)]


@pytest.mark.parametrize(
    ("chained", "rest"), [(False, [Task(1), Task(1, 0), Task(2), Task(2, 0)]), (True, [])]
)
def test_a_truth_that_always_fails_stops_what_stands_on_it(chained: bool, rest: list[Task]) -> None:
    schedule = Schedule(3, 1, chained=chained, ahead=1)
    fail(schedule, Task(0))
    ended, _ = work(schedule, 1, chained=chained and bool(rest), seed=0)
    assert ended == rest
    assert schedule.failures == [(Task(0), "broken")]
