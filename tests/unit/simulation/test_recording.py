"""Recording: the schedule of views, and the parts on disk."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from sabench.api.arrays import Array
from sabench.api.truth import Materials, ParticleView
from sabench.scenes import load_scene
from sabench.simulation.recording.parts import (
    CameraPart,
    Entry,
    Job,
    Parts,
    RecordingArrays,
    read_job,
)
from sabench.simulation.recording.schedule import TRIES, RecordingTask, Schedule
from sabench.utils.arrays import F64
from tests.helpers.refusals import refused


@dataclass(frozen=True)
class State(RecordingArrays):
    ARRAYS = (Array("state", (0,)),)

    state: F64


def numbers(count: int) -> Entry:
    return Materials(np.arange(count)), ""


def taken() -> CameraPart:
    rng = np.random.default_rng(1)
    seen = ParticleView(rng.random((5, 2)), np.ones(5), np.ones(5), np.ones(5, dtype=np.bool_))
    grey = rng.integers(0, 4095, (6, 8), dtype=np.uint16)
    return CameraPart([(seen, "a")], grey, rng.random((6, 8), dtype=np.float32))


def test_what_is_put_is_there_and_nothing_beside_it(tmp_path: Path) -> None:
    parts, view = Parts(tmp_path), taken()
    assert not list(tmp_path.glob("views/*.npz"))
    assert not parts.has_frame(3)
    parts.put_frame(3, [numbers(4), (State(np.zeros(0)), "")])
    parts.put_view(3, "a", view)
    assert parts.has_frame(3)
    assert parts.has_view(3, "a")
    assert list(tmp_path.glob("views/*.npz"))
    assert list(parts.frame(3).truth) == ["frames/0003/material"]
    np.testing.assert_array_equal(parts.frame(3).truth["frames/0003/material"], np.arange(4))
    (seen, _), stored = view.truth[0], parts.view(3, "a")
    assert isinstance(seen, ParticleView)
    np.testing.assert_array_equal(stored.truth["frames/0003/cameras/a/pixel"], seen.pixel)
    assert sorted(stored.files) == ["images/frame_0003/a.exr", "images/frame_0003/a.tif"]
    names = sorted(path.name for path in tmp_path.rglob("*") if path.is_file())
    assert names == ["0003-a.npz", "0003.npz", "a.exr", "a.tif"]


def test_a_part_with_one_byte_wrong_is_not_there_or_whole(tmp_path: Path) -> None:
    parts, path = Parts(tmp_path), tmp_path / "frames" / "0003.npz"
    parts.put_frame(3, [numbers(4)])
    whole = path.read_bytes()
    refused = 0
    for position in range(len(whole)):  # compression, encryption, length, names, checksum, ...
        damaged = bytearray(whole)
        damaged[position] ^= 0x49
        path.write_bytes(damaged)
        refused += not parts.has_frame(3)
    assert refused > len(whole) / 2


@pytest.mark.parametrize("file", ["images/frame_0003/a.exr", "images/frame_0003/a.tif"])
def test_a_view_with_one_bit_wrong_in_a_picture_is_not_there(tmp_path: Path, file: str) -> None:
    parts, rng, path = Parts(tmp_path), np.random.default_rng(2), tmp_path / file
    parts.put_view(3, "a", taken())
    whole = path.read_bytes()
    for position in rng.integers(0, len(whole), 8):
        damaged = bytearray(whole)
        damaged[position] ^= 4
        path.write_bytes(damaged)
        assert not parts.has_view(3, "a")


@pytest.mark.parametrize(
    "file", ["views/0003-a.npz", "images/frame_0003/a.exr", "images/frame_0003/a.tif"]
)
def test_a_view_with_a_torn_or_missing_file_is_made_again(tmp_path: Path, file: str) -> None:
    parts, path = Parts(tmp_path), tmp_path / file
    parts.put_view(3, "a", taken())
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    assert not parts.has_view(3, "a")
    path.unlink()
    assert not parts.has_view(3, "a")
    parts.put_view(3, "a", taken())
    assert parts.has_view(3, "a")


def test_a_number_of_the_truth_that_has_changed_is_not_taken_for_whole(tmp_path: Path) -> None:
    parts, path = Parts(tmp_path), tmp_path / "frames" / "0003.npz"
    parts.put_frame(3, [numbers(400)])
    damaged = bytearray(path.read_bytes())
    damaged[damaged.index(np.arange(200, 203).tobytes())] ^= 4
    path.write_bytes(damaged)
    assert not parts.has_frame(3)


def test_a_part_that_is_not_there_is_named(tmp_path: Path) -> None:
    with refused("0007.npz"):
        Parts(tmp_path).frame(7)


def test_a_job_is_read_as_it_was_written_and_only_by_the_same_code(tmp_path: Path) -> None:
    job, folder = Job(load_scene("quick"), 7, "splat", "quick"), tmp_path / "set"
    folder.mkdir()
    job.write(folder)
    again = read_job(folder)
    assert again.scene.hash == job.scene.hash
    assert (again.seed, again.renderer, again.label, again.key) == (7, "splat", "quick", job.key)
    others = [Job(job.scene, 8, "splat", "quick"), Job(job.scene, 7, "mitsuba", "quick")]
    assert len({one.key for one in [job, *others]}) == 3
    file = folder / "job.json"
    file.write_text(file.read_text().replace(job.key, "0" * 64))
    with refused():
        read_job(folder)
    with refused():
        read_job(tmp_path / "elsewhere")


def test_nothing_is_written_where_the_data_set_is_complete(tmp_path: Path) -> None:
    parts = Parts(tmp_path / "gone")
    with refused():
        parts.put_frame(0, [])
    with refused():
        parts.put_view(0, "a", taken())
    assert not list(tmp_path.iterdir())


def check_allowed(task: RecordingTask, finished: set[RecordingTask], *, chained: bool) -> None:
    """A camera comes after its frame's truth, which in a chain comes after that before."""
    if task.camera is not None:
        assert RecordingTask(task.frame) in finished
    elif chained and task.frame:
        assert RecordingTask(task.frame - 1) in finished


def work(
    schedule: Schedule,
    workers: int,
    *,
    chained: bool,
    seed: int,
    dying: float = 0.0,
    before: tuple[RecordingTask, ...] = (),
) -> tuple[list[RecordingTask], int]:
    rng, most = np.random.default_rng(seed), 0
    running: dict[int, RecordingTask] = {}
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
    ("frames", "cameras", "workers"), [(1, 1, 1), (7, 3, 1), (40, 4, 5), (5, 9, 30), (9, 0, 3)]
)
def test_everything_is_done_once_in_order(
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
    assert ended == [RecordingTask(n, camera) for n in range(4) for camera in (None, 0, 1, 2)]


def test_two_workers_take_a_frame_each_and_share_the_last() -> None:
    schedule = Schedule(3, 2, chained=False, ahead=3)
    assert [schedule.take(None), schedule.take(None)] == [RecordingTask(0), RecordingTask(1)]
    schedule.complete(RecordingTask(0))
    schedule.complete(RecordingTask(1))
    first = RecordingTask(0, 0)
    assert [schedule.take(1), schedule.take(0)] == [RecordingTask(1, 0), first]
    schedule.complete(RecordingTask(1, 0))
    for task in (RecordingTask(1, 1), RecordingTask(2)):
        assert schedule.take(1) == task
        schedule.complete(task)
    assert schedule.take(1) == RecordingTask(2, 0)
    schedule.complete(first)
    assert schedule.take(0) == RecordingTask(0, 1)
    schedule.complete(RecordingTask(0, 1))
    assert schedule.take(0) == RecordingTask(2, 1)


def fail(schedule: Schedule, task: RecordingTask) -> None:
    for _ in range(TRIES):
        while schedule.take(None) != task:
            pass
        schedule.fail(task, "broken")


def test_a_camera_that_always_fails_is_a_failure_and_the_rest_is_done() -> None:
    schedule = Schedule(2, 2, chained=True, ahead=1)
    assert schedule.take(None) == RecordingTask(0)
    schedule.complete(RecordingTask(0))
    assert schedule.take(0) == RecordingTask(0, 0)
    for _ in range(TRIES):
        schedule.fail(RecordingTask(0, 0), "broken")
        if not schedule.failures:
            assert schedule.take(0) == RecordingTask(0, 0)
    assert schedule.failures == [(RecordingTask(0, 0), "broken")]
    ended, _ = work(schedule, 1, chained=True, seed=0, before=(RecordingTask(0),))
    rest = [(0, None), (0, 1), (1, None), (1, 0), (1, 1)]
    assert ended == [RecordingTask(*one) for one in rest]


@pytest.mark.parametrize(
    ("chained", "rest"),
    [
        (False, [RecordingTask(1), RecordingTask(1, 0), RecordingTask(2), RecordingTask(2, 0)]),
        (True, []),
    ],
)
def test_a_truth_that_always_fails_stops_what_stands_on_it(
    chained: bool, rest: list[RecordingTask]
) -> None:
    schedule = Schedule(3, 1, chained=chained, ahead=1)
    fail(schedule, RecordingTask(0))
    ended, _ = work(schedule, 1, chained=chained and bool(rest), seed=0)
    assert ended == rest
    assert schedule.failures == [(RecordingTask(0), "broken")]
