"""Writer of recorded data sets: images, cameras and masks without any truth."""

from __future__ import annotations

import contextlib
import platform
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sabench.dataset import schema
from sabench.dataset.camera_files import write_cameras
from sabench.dataset.references import ReferenceList
from sabench.dataset.wall_entries import wall_entry
from sabench.geometry.camera_model import CameraModel
from sabench.images.tiff_exr import write_tiff
from sabench.utils.arrays import U16, Bool
from sabench.utils.files import complete_or_nothing, sha256
from sabench.utils.version import __version__


class RecordedWriter:
    """Writer of the parts of one recorded data set, made by `recorded_writer`."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def add_image(self, camera: str, frame: int, image: U16) -> None:
        """Store the grey values (row, column) of a camera's frame."""
        self._write(schema.image_name(camera, frame, "tif"), image)

    def set_references(self, references: ReferenceList) -> None:
        """Store the names of image files that stay where they are."""
        (self.root / schema.REFERENCES).write_text(references.text(), encoding="utf-8")

    def add_mask(self, camera: str, counts: Bool) -> None:
        """Store which pixels (row, column) of a camera count."""
        self._write(schema.mask_name(camera), counts.astype(np.uint16))

    def set_cameras(self, cameras: Sequence[CameraModel], **keys: Any) -> None:
        """Store the cameras with their walls, and the further keys of cameras.json."""
        write_cameras(self.root / schema.CAMERAS, cameras, wall=wall_entry(cameras), **keys)

    def _write(self, name: str, image: U16) -> None:
        path = self.root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        write_tiff(path, image)


@contextlib.contextmanager
def recorded_writer(
    target: Path, source: str, *, overwrite: bool = False
) -> Iterator[RecordedWriter]:
    """Open a writer whose parts become the recorded data set at `target`.

    It appears when the block ends without an error; otherwise nothing is left of it.

    Parameters
    ----------
    source : name of the recording.
    """
    with complete_or_nothing(target, overwrite=overwrite) as root:
        root.mkdir()
        yield RecordedWriter(root)
        (root / schema.MANIFEST).write_text(_manifest(root, source), encoding="utf-8")


def _manifest(root: Path, source: str) -> str:
    paths = sorted(path for path in root.rglob("*") if path.is_file())
    files = {
        path.relative_to(root).as_posix(): schema.FileEntry(
            bytes=path.stat().st_size, sha256=sha256(path)
        )
        for path in paths
    }
    return schema.seal(
        {
            "format": schema.FORMAT,
            "version": schema.VERSION,
            "recorded": True,
            "source": source,
            "content_hash": schema.content_hash(files),
            "versions": {"sabench": __version__, "python": platform.python_version()},
            "files": {name: entry.model_dump() for name, entry in files.items()},
        }
    )
