"""Recording by many: the same bytes, whoever does the work and dies over it."""

import contextlib
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import tomli_w
from filelock import FileLock

import sabench
from sabench.scenes import Scene, load_scene, parse_scene
from sabench.simulation import pipeline
from sabench.simulation.camera_view import render_camera_view
from sabench.simulation.pipeline import generate
from sabench.simulation.recording import recorders, schedule
from sabench.simulation.recording.parts import Job
from sabench.simulation.recording.schedule import ProcessPool
from sabench.utils import backend
from tests.conftest import Command
from tests.helpers.bubble_scenes import LASER, small
from tests.helpers.commands import refuse
from tests.helpers.plug_ins import write_plug_in
from tests.helpers.refusals import refused

SPEEDS = {"a_mm_s": 40.0, "b_mm_s": 30.0, "c_mm_s": 20.0}
ABC = {"generator": "abc_flow", "wavelength_mm": 30.0} | SPEEDS


def moving(frames: int = 6) -> Scene:
    values = load_scene("quick").to_dict()
    values["particles"] = {"generator": "uniform", "count": 150}
    values |= {"frames": frames, "interval_s": 0.02, "flow": ABC, "flow_grid_mm": [4.0, 4.0, 4.0]}
    return parse_scene(values, "moving")


def bubbly() -> Scene:
    tracers = {"particles": {"generator": "uniform", "count": 30}, "illumination": LASER}
    flow = {"frames": 2, "interval_s": 0.01, "flow": ABC}
    return small(**flow, **tracers, render={"relative_error": 0.2})


def made(scene: Scene, folder: Path, **how: Any) -> str:
    how = {"seed": 4, "backend": "auto" if scene.bubbles else "splat"} | how
    return generate(scene, folder, name="s", **how).content_hash


@pytest.fixture
def two_rendering_threads() -> Iterator[None]:
    backend.limit_threads(2)
    yield
    backend.limit_threads(1)


@pytest.mark.slow
@pytest.mark.parametrize("scene", [bubbly(), load_scene("calibration")], ids=["bubbly", "target"])
def test_two_processes_make_one(tmp_path: Path, scene: Scene, two_rendering_threads: None) -> None:
    assert made(scene, tmp_path / "two", jobs=2) == made(scene, tmp_path / "one")
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["one", "two"]


@contextlib.contextmanager
def killing(
    folder: Path, pids: Callable[[], list[int]], count: int = 3, views: int = 3
) -> Iterator[None]:
    """Kill some workers, each once more than so many views were recorded since the last kill."""
    killed: list[int] = []

    def kill() -> None:
        seen, end = 0, time.monotonic() + 60.0
        while len(killed) < count and time.monotonic() < end:
            recorded = len(list(folder.glob(".*.parts-*/views/*.npz")))
            if recorded > seen and (alive := pids()):
                seen = recorded + views
                os.kill(alive[0], signal.SIGKILL)
                killed.append(alive[0])
            time.sleep(0.02)

    killer = threading.Thread(target=kill)
    killer.start()
    yield
    killer.join()
    assert len(set(killed)) == count


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> str:
    return made(moving(20), tmp_path_factory.mktemp("expected") / "set")


@pytest.mark.slow
def test_killed_workers_are_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, expected: str
) -> None:
    pools: list[ProcessPool] = []
    start = ProcessPool.__init__

    def noted(self: ProcessPool, *how: Any) -> None:
        start(self, *how)
        pools.append(self)

    monkeypatch.setattr(ProcessPool, "__init__", noted)
    with killing(tmp_path, lambda: list(pools[0].pids) if pools else []):
        assert made(moving(20), tmp_path / "two", jobs=2) == expected
    assert [entry.name for entry in tmp_path.iterdir()] == ["two"]


BROKEN = '''
class Parameters(Parameters):
    """When it breaks."""

    until: str

def particles(self, domain, seed, frame, time_s):
    if frame == 1 and not pathlib.Path(self.parameters.until).exists():
        os._exit(11)
    rng = np.random.default_rng(frame)
    place = domain.low_mm + rng.random((20, 3)) * domain.size_mm
    return Particles(np.arange(20), place, np.full(20, 0.02), np.zeros((20, 3)))
'''


@pytest.mark.slow
def test_a_frame_that_breaks_is_reported_alone(tmp_path: Path, own_process: Command) -> None:
    cure, head = tmp_path / "cure", "from sabench.api.truth import Particles"
    write_plug_in(tmp_path / "mine", "generators", "breaker", BROKEN, head, "Generator")
    values = load_scene("quick").to_dict() | {
        "particles": {"generator": "breaker", "until": str(cure)}
    }
    (tmp_path / "s.toml").write_text(tomli_w.dumps(values))
    words = ("generate", "s.toml", "-o", "set", "--backend", "splat", "--frames", 3, "--jobs", 2)
    environment = {"SABENCH_PLUGINS": str(tmp_path / "mine")}
    refuse(own_process(*words, env=environment), "frame 1", "exit code 11")
    (left,) = tmp_path.glob(".set.parts-*")
    assert len(list(left.glob("views/*.npz"))) == 8
    cure.touch()
    assert own_process(*words, env=environment).returncode == 0
    assert sabench.open_dataset(tmp_path / "set").setup.frames == 3
    assert not list(tmp_path.glob(".set.*"))


def test_what_is_there_is_not_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene, shots = moving(3), []

    def interrupted(recorder: Any, parts: Any, task: Any) -> None:
        if task.frame == 2:
            raise KeyboardInterrupt
        recorders.record_task(recorder, parts, task)

    def counted(frame: Any, camera: int) -> Any:
        shots.append((frame.number, camera))
        return render_camera_view(frame, camera)

    with monkeypatch.context() as patch:
        patch.setattr(pipeline, "record_task", interrupted)
        with pytest.raises(KeyboardInterrupt):
            made(scene, tmp_path / "set")
    monkeypatch.setattr(recorders, "render_camera_view", counted)
    again = made(scene, tmp_path / "set")
    assert [frame for frame, _ in shots] == [2] * 4
    assert again == made(scene, tmp_path / "anew")


def test_another_scene_or_seed_starts_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run_schedule = schedule.run_schedule

    def stop(*arguments: Any) -> None:
        run_schedule(*arguments)
        raise KeyboardInterrupt

    monkeypatch.setattr("sabench.simulation.pipeline.run_schedule", stop)
    with pytest.raises(KeyboardInterrupt):
        made(moving(2), tmp_path / "set")
    monkeypatch.setattr("sabench.simulation.pipeline.run_schedule", run_schedule)
    assert made(moving(2), tmp_path / "set", seed=5) == made(moving(2), tmp_path / "fresh", seed=5)
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["fresh", "set"]


def test_two_who_make_the_same_do_not_meet(tmp_path: Path) -> None:
    scene = moving(2)
    root = tmp_path / f".set.parts-{Job(scene, 4, 'splat', 's').key[:16]}"
    root.mkdir()
    with FileLock(root / "lock"), refused("set"):
        made(scene, tmp_path / "set")
    assert made(scene, tmp_path / "set")


@pytest.mark.slow
def test_bad_numbers_are_refused(tmp_path: Path, command: Command) -> None:
    with refused("jobs"):
        made(moving(1), tmp_path / "set", jobs=0)
    words = "generate quick -o set --backend splat --scheduler tcp://127.0.0.1:9"
    refuse(command(*words.split()), "scheduler", "tcp://127.0.0.1:9")
    assert not list(tmp_path.iterdir())


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    distributed = pytest.importorskip("distributed")
    options = {"processes": True, "dashboard_address": None, "scheduler_port": 0}
    with distributed.LocalCluster(2, threads_per_worker=1, silence_logs=50, **options) as running:
        yield running


@pytest.mark.slow
def test_a_cluster_of_killed_workers_makes_the_same_bytes(
    tmp_path: Path, cluster: Any, expected: str
) -> None:
    def pids() -> list[int]:
        return [nanny.pid for nanny in cluster.workers.values() if nanny.pid]

    with killing(tmp_path, pids, count=2, views=10):
        assert made(moving(20), tmp_path / "there", scheduler=cluster.scheduler_address) == expected
    assert [entry.name for entry in tmp_path.iterdir()] == ["there"]


@pytest.mark.slow
def test_bad_input_on_a_cluster_is_a_sentence(tmp_path: Path, cluster: Any) -> None:
    drift = {"generator": "uniform", "count": 5, "velocity_mm_s": [1.0, 0.0, 0.0]}
    scene = parse_scene(moving(2).to_dict() | {"particles": drift}, "m")
    with refused("particles"):
        made(scene, tmp_path / "set", scheduler=cluster.scheduler_address)
    assert not list(tmp_path.iterdir())
