"""Recorded data sets: images, cameras and masks without any truth.

Images may stay where they were recorded: the data set then names their files, and each image is
read and converted when it is requested.
"""

import contextlib
import dataclasses
import platform
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from sabench.dataset import schema
from sabench.dataset.cameras import wall_entry, write_cameras
from sabench.geometry.camera_model import CameraModel
from sabench.images.image_files import MOVIES
from sabench.images.image_reading import RawLayout, read_page
from sabench.images.tiff_exr import write_tiff
from sabench.utils.arrays import U16, Bool
from sabench.utils.errors import InputError
from sabench.utils.files import canonical_json, complete_or_nothing, inside
from sabench.utils.version import __version__

Grey = TypeVar("Grey", U16, Bool)


class ReferencesFile(schema.VersionedFile):
    """images.json: files outside the data set, and the images in them.

    Attributes
    ----------
    folder : absolute path of the recording's folder.
    raw : layout of raw files.
    files : size and checksum of each file, by its path in the folder.
    shapes : rows and columns of each camera's images, by its name.
    images : file and number of the image in it for each frame, by the camera's name.
    """

    folder: str
    raw: RawLayout | None
    files: dict[str, schema.FileEntry]
    shapes: dict[str, tuple[int, int]]
    images: dict[str, tuple[tuple[str, int], ...]]

    def read(self, camera: str, frame: int, shape: tuple[int, int]) -> U16:
        """Read a camera's image (row, column), extended by zeros to a shape.

        Raises InputError for an unknown image, or anything that `read_page` refuses.
        """
        frames = self.images.get(camera, ())
        if camera not in self.shapes or not 0 <= frame < len(frames):
            raise InputError(f"{schema.REFERENCES}: {camera}: expected an image of frame {frame}")
        recorded = self.shapes[camera]
        if not all(0 < size <= most for size, most in zip(recorded, shape, strict=True)):
            raise InputError(
                f"{schema.REFERENCES}: {camera}: expected a shape of at most {shape[0]} x "
                f"{shape[1]} pixels (rows x columns), got {recorded[0]} x {recorded[1]}"
            )
        name, page = frames[frame]
        path = self._place(name)
        if not path.is_file():
            raise InputError(
                f"{path}: expected an image, found no such file; if the recording has moved, "
                "import it again"
            )
        return extended(read_page(path, page, recorded, self.raw), shape)

    def faults(self) -> Iterator[str]:
        """Find files that are missing or have changed."""
        for name, entry in self.files.items():
            path = self._place(name)
            if not path.is_file():
                yield f"{path}: missing"
            elif schema.FileEntry.of(path) != entry:
                yield f"{path}: its bytes are not those that were imported"

    def _place(self, name: str) -> Path:
        return inside(Path(self.folder), name)


class ReferenceList:
    """Collector of the images of a recording while it is imported."""

    def __init__(self, folder: Path, raw: RawLayout | None) -> None:
        self.folder, self.raw = folder.absolute(), raw
        self.shapes: dict[str, tuple[int, int]] = {}
        self.images: dict[str, list[tuple[str, int]]] = {}

    def add(self, camera: str, path: Path, page: int, image: U16) -> None:
        """Add the next image of a camera.

        Raises InputError for an image of a movie, which cannot be read alone.
        """
        if path.suffix.lower() in MOVIES:
            raise InputError(
                f"{path}: expected images that can be read alone, got a movie; copy it"
            )
        self.shapes[camera] = (image.shape[0], image.shape[1])
        name = path.absolute().relative_to(self.folder).as_posix()
        self.images.setdefault(camera, []).append((name, page))

    def text(self) -> str:
        """Serialise the list, with the checksums of all files."""
        names = sorted({name for images in self.images.values() for name, _ in images})
        paths = {name: self.folder / name for name in names}
        files = {name: schema.FileEntry.of(path).model_dump() for name, path in paths.items()}
        head = {"format": schema.FORMAT, "version": schema.VERSION, "folder": str(self.folder)}
        raw = self.raw and dataclasses.asdict(self.raw)
        lists = {"files": files, "shapes": self.shapes, "images": self.images}
        return canonical_json({**head, "raw": raw, **lists})


def read_references(root: Path) -> ReferencesFile:
    """Read the images.json of a data set."""
    return schema.read_versioned(ReferencesFile, inside(root, schema.REFERENCES))


def extended(image: Grey, shape: tuple[int, int]) -> Grey:
    """Extend an image (row, column) by zeros on the right and below."""
    more = [(0, size - own) for size, own in zip(shape, image.shape, strict=True)]
    made: Grey = np.pad(image, more)
    return made


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
    """Open a writer of the recorded data set at `target`.

    It appears when the block ends without an error; otherwise nothing is left of it.

    Parameters
    ----------
    source : name of the recording.
    """
    with complete_or_nothing(target, overwrite=overwrite) as root:
        root.mkdir()
        yield RecordedWriter(root)
        schema.write_manifest(
            root,
            schema.list_files(root),
            recorded=True,
            source=source,
            versions={"sabench": __version__, "python": platform.python_version()},
        )
