"""Recording of one data set in a shared folder: its job, truth and images.

Each file is complete or absent, so that a process that writes them may be killed at any time, and
what is there need not be made again.
"""

import importlib.metadata
import json
import tomllib
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sabench.api.arrays import Arrays
from sabench.api.truth import Truth
from sabench.dataset import schema
from sabench.dataset.arrays import AnyArrays, Named, group_of, name_of, named_arrays, read_declared
from sabench.images.tiff_exr import write_exr, write_tiff
from sabench.scenes import Scene, parse_scene
from sabench.utils.arrays import F32, U16
from sabench.utils.code_hash import code_hash
from sabench.utils.errors import InputError
from sabench.utils.files import (
    atomic_file,
    canonical_json,
    complete_or_nothing,
    digest,
    read_json,
    sha256,
)

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
        """Hash of all that parts depend on: those of equal keys may be combined."""
        versions = {package: importlib.metadata.version(package) for package in _RENDERING}
        return digest([self.scene.hash, self.seed, self.renderer, code_hash(), versions])

    def write(self, root: Path) -> None:
        """Write it to the folder of its partial results."""
        root.mkdir(parents=True, exist_ok=True)
        values = {key: getattr(self, key) for key in ("seed", "renderer", "label", "key")}
        for name, text in ((_SCENE, self.scene.to_toml()), (JOB, canonical_json(values))):
            # atomic: a worker may be reading it
            with complete_or_nothing(root / name, overwrite=True) as partial:
                partial.write_text(text, encoding="utf-8")


def read_job(root: Path) -> Job:
    """Read the job of a folder.

    Raises InputError if this machine does not see the folder, or has other versions of sabench or
    of the packages that render than the one that wrote it.
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


Entry = tuple[Arrays, str | int]  # arrays, and which of several they are: see `group_of`
_KEPT = "kept"  # group of what serves the recording only
_FILES = f"{_KEPT}/files"
# what numpy and zipfile raise of a damaged archive; encrypted entries are a RuntimeError
_DAMAGED = (OSError, EOFError, ValueError, RuntimeError, zipfile.BadZipFile, zlib.error)


@dataclass(frozen=True)
class CameraPart:
    """One camera's part of a frame: its truth, grey values and radiance."""

    truth: list[Entry]
    grey: U16
    radiance: F32


class RecordingArrays(Truth):
    """Base of arrays that serve the recording only."""

    GROUP = _KEPT
    OF_FRAME = False


@dataclass(frozen=True)
class Part:
    """Part of a data set in the making: arrays by their names in the file of truth."""

    arrays: Named

    @property
    def truth(self) -> Named:
        """Arrays that the data set keeps."""
        return {name: one for name, one in self.arrays.items() if not name.startswith(_KEPT)}

    @property
    def files(self) -> dict[str, schema.FileEntry]:
        """Images of a camera's part: paths in the data set, sizes and checksums."""
        entries = json.loads(self.arrays[_FILES].tobytes())
        return {name: schema.FileEntry(**entry) for name, entry in entries.items()}

    def find(self, kind: type[AnyArrays], frame: int = 0) -> AnyArrays | None:
        """Read what a class declares; None where it is not in the part."""
        group = group_of(kind, frame)
        if name_of(group, kind.ARRAYS[0]) not in self.arrays:
            return None
        return read_declared(kind, lambda name, shape, kinds: self.arrays[name], group, "part")


Recall = Callable[[int], Part]  # a frame's part


class Parts:
    """Parts of one data set in a folder."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def has_frame(self, frame: int) -> bool:
        """Return whether a frame's part is there and intact."""
        return _load(self._frame(frame)) is not None

    def frame(self, frame: int) -> Part:
        """Read a frame's part; InputError if it is not there."""
        return _load_needed(self._frame(frame))

    def put_frame(self, frame: int, entries: list[Entry]) -> None:
        """Keep a frame's part."""
        self._check()
        _save(self._frame(frame), _part(frame, entries))

    def has_view(self, frame: int, camera: str) -> bool:
        """Return whether a camera's part of a frame is there and intact, bit by bit."""
        part = _load(self._view(frame, camera))
        if part is None or _FILES not in part.arrays:
            return False
        return all(
            (self.root / name).is_file() and sha256(self.root / name) == entry.sha256
            for name, entry in part.files.items()
        )

    def view(self, frame: int, camera: str) -> Part:
        """Read a camera's part of a frame; InputError if it is not there."""
        return _load_needed(self._view(frame, camera))

    def put_view(self, frame: int, camera: str, taken: CameraPart) -> None:
        """Keep a camera's part of a frame; its truth is written last and completes it."""
        self._check()
        tif, exr = (schema.image_name(camera, frame, suffix) for suffix in ("tif", "exr"))
        with atomic_file(self.root / tif) as partial:
            write_tiff(partial, taken.grey)
        with atomic_file(self.root / exr) as partial:
            write_exr(partial, taken.radiance)
        files = {name: schema.FileEntry.of(self.root / name).model_dump() for name in (tif, exr)}
        text = np.frombuffer(json.dumps(files).encode(), dtype=np.uint8)
        _save(self._view(frame, camera), Part(_part(frame, taken.truth).arrays | {_FILES: text}))

    def _check(self) -> None:
        """Refuse to write for a data set that another process has completed meanwhile."""
        if not self.root.is_dir():
            raise InputError(f"{self.root}: expected a data set that is being made, but it is gone")

    def _frame(self, frame: int) -> Path:
        return self.root / "frames" / f"{frame:04d}.npz"

    def _view(self, frame: int, camera: str) -> Path:
        return self.root / "views" / f"{frame:04d}-{camera}.npz"


def _part(frame: int, entries: list[Entry]) -> Part:
    arrays: Named = {}
    for value, which in entries:
        arrays |= named_arrays(value, group_of(type(value), frame, which))
    return Part(arrays)


def _load_needed(path: Path) -> Part:
    part = _load(path)
    if part is None:
        sentence = f"{path}: expected an intact part of a data set that is being made, found none"
        raise InputError(sentence)
    return part


def _load(path: Path) -> Part | None:
    """Load a part; None where it is not there or not intact: it is made again."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
            # reading tests the archive's checksums
            return Part({name: arrays[name] for name in arrays.files})
    except _DAMAGED:
        return None


def _save(path: Path, part: Part) -> None:
    with atomic_file(path) as partial, partial.open("wb") as file:
        np.savez(file, allow_pickle=False, **part.arrays)
