"""One data set's recording in a folder that all who work on it can see, and one task of it."""

from __future__ import annotations

import functools
import importlib.metadata
import threading
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sabench.scenes import Scene, parse_scene
from sabench.simulation.recording.parts import Parts
from sabench.simulation.recording.recorders import Recorder, recorder_of
from sabench.simulation.recording.schedule import Task
from sabench.utils import memory
from sabench.utils.code_hash import code_hash
from sabench.utils.errors import InputError
from sabench.utils.files import canonical_json, complete_or_nothing, digest, read_json

JOB, _SCENE = "job.json", "scene.toml"
_RENDERING = ("mitsuba", "drjit", "numpy", "scipy", "miepython", "numba", "opencv-python-headless")
_ONE_AT_A_TIME = threading.Lock()  # what renders does not bear two threads


@dataclass(frozen=True)
class Job:
    """A data set that is to be recorded: its scene, seed, renderer, and what it is called in errors."""

    scene: Scene
    seed: int
    renderer: str
    label: str

    @property
    def key(self) -> str:
        """What parts depend on: parts of one key may be put together, whoever made them."""
        versions = {package: importlib.metadata.version(package) for package in _RENDERING}
        return digest([self.scene.hash, self.seed, self.renderer, code_hash(), versions])

    def write(self, root: Path) -> None:
        """Put it into the folder in which its parts will lie."""
        root.mkdir(parents=True, exist_ok=True)
        values = {
            "seed": self.seed,
            "renderer": self.renderer,
            "label": self.label,
            "key": self.key,
        }
        for name, text in ((_SCENE, self.scene.to_toml()), (JOB, canonical_json(values))):
            with complete_or_nothing(
                root / name, overwrite=True
            ) as partial:  # a worker may be reading it
                partial.write_text(text, encoding="utf-8")


def read_job(root: Path) -> Job:
    """The job of a folder.

    Raises
    ------
    InputError
        A folder that this machine does not see, or another version of sabench than the one that
        wrote it.
    """
    if not (root / JOB).is_file():
        raise InputError(
            f"{root}: expected a data set that is being made, found none: all workers must see this folder"
        )
    values: dict[str, Any] = read_json(root / JOB)
    scene = parse_scene(
        tomllib.loads((root / _SCENE).read_text(encoding="utf-8")), values["label"], root
    )
    job = Job(scene, values["seed"], values["renderer"], values["label"])
    if job.key != values["key"]:
        raise InputError(
            f"{root}: expected the same versions of sabench and of what it renders with on all machines, got others here"
        )
    return job


def do(root: str, task: Task) -> None:
    """Do one task of the job in a folder, unless it has been done; raises what recording raises."""
    with _ONE_AT_A_TIME:
        record(*_opened(root), task)


@functools.lru_cache(maxsize=1)
def _opened(root: str) -> tuple[Recorder, Parts]:
    return recorder_of(*_values(read_job(Path(root)))), Parts(Path(root))


def _values(job: Job) -> tuple[Scene, int, str, str]:
    return job.scene, job.seed, job.renderer, job.label


def record(recorder: Recorder, parts: Parts, task: Task) -> None:
    """Do one task, unless it has been done."""
    if task.camera is None:
        if not parts.has_frame(task.frame):
            parts.put_frame(task.frame, recorder.frame(task.frame, parts.frame))
        return
    camera = recorder.cameras[task.camera].name
    if not parts.has_view(task.frame, camera):
        parts.put_view(task.frame, camera, recorder.view(task.frame, task.camera, parts.frame))
    memory.trim()
