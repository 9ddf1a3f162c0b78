"""Recording of one data set in a folder that all workers see, and one task of it."""

from __future__ import annotations

import importlib.metadata
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sabench.scenes import Scene, parse_scene
from sabench.simulation.recording.parts import Parts
from sabench.simulation.recording.recorders import Recorder
from sabench.simulation.recording.schedule import Task
from sabench.utils import memory
from sabench.utils.code_hash import code_hash
from sabench.utils.errors import InputError
from sabench.utils.files import canonical_json, complete_or_nothing, digest, read_json

JOB, _SCENE = "job.json", "scene.toml"
_RENDERING = ("mitsuba", "drjit", "numpy", "scipy", "numba", "opencv-python-headless")


@dataclass(frozen=True)
class Job:
    """Data set to be recorded: scene, seed, renderer, and the scene's name in errors."""

    scene: Scene
    seed: int
    renderer: str
    label: str

    @property
    def key(self) -> str:
        """Hash of all that partial results depend on.

        Partial results of equal keys may be combined.
        """
        versions = {package: importlib.metadata.version(package) for package in _RENDERING}
        return digest([self.scene.hash, self.seed, self.renderer, code_hash(), versions])

    def write(self, root: Path) -> None:
        """Write it to the folder of its partial results."""
        root.mkdir(parents=True, exist_ok=True)
        values = {
            "seed": self.seed,
            "renderer": self.renderer,
            "label": self.label,
            "key": self.key,
        }
        for name, text in ((_SCENE, self.scene.to_toml()), (JOB, canonical_json(values))):
            # atomic: a worker may be reading it
            with complete_or_nothing(root / name, overwrite=True) as partial:
                partial.write_text(text, encoding="utf-8")


def read_job(root: Path) -> Job:
    """Read the job of a folder.

    Raises
    ------
    InputError
        This machine does not see the folder, or has other versions of sabench or of the packages
        that render than the one that wrote it.
    """
    if not (root / JOB).is_file():
        raise InputError(
            f"{root}: expected a data set that is being made, found none: "
            "use a folder that all workers see"
        )
    values: dict[str, Any] = read_json(root / JOB)
    text = (root / _SCENE).read_text(encoding="utf-8")
    scene = parse_scene(tomllib.loads(text), values["label"], root)
    job = Job(scene, values["seed"], values["renderer"], values["label"])
    if job.key != values["key"]:
        raise InputError(
            f"{root}: expected the same versions of sabench and of the packages that render "
            "on all machines, got others here"
        )
    return job


def record_task(recorder: Recorder, parts: Parts, task: Task) -> None:
    """Record a frame's truth or one camera's view of it, unless that is there."""
    if task.camera is None:
        if not parts.has_frame(task.frame):
            parts.put_frame(task.frame, recorder.frame(task.frame, parts.frame))
        return
    camera = recorder.cameras[task.camera].name
    if not parts.has_view(task.frame, camera):
        parts.put_view(task.frame, camera, recorder.view(task.frame, task.camera, parts.frame))
    memory.trim()
