"""Grey values of image files in common formats, one image after the other."""

import itertools
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sabench.images.image_files import MOVIES, RAW
from sabench.utils.arrays import U16
from sabench.utils.errors import InputError
from sabench.utils.processes.call import read_isolated

_BATCH = 32  # images that one child process reads
_EXPANDED = 100  # times a movie's size that its frames may take
_NEARLY_GREY = 6  # of 255: difference of colours that a movie's compression makes of grey
_NO_IMAGE = "expected an image of a kind that OpenCV reads, got none"


@dataclass(frozen=True)
class RawLayout:
    """Layout of raw files: images one after the other behind a header.

    Attributes
    ----------
    dtype : of a pixel: "uint8", "uint16" (little end first) or "uint16-big" (big end first).
    header_bytes : before the first image.
    """

    dtype: str
    header_bytes: int = 0

    def __post_init__(self) -> None:
        """Check the type of a pixel."""
        if self.dtype not in _RAW_TYPES or self.header_bytes < 0:
            types = ", ".join(_RAW_TYPES)
            raise InputError(
                f"raw: expected one of {types} and a header of 0 bytes or more, got "
                f"{self.dtype!r} and {self.header_bytes}"
            )


_RAW_TYPES = {"uint8": "u1", "uint16": "<u2", "uint16-big": ">u2"}


def read_images(
    files: Sequence[Path], shape: tuple[int, int], raw: RawLayout | None = None
) -> Iterator[tuple[Path, U16]]:
    """Read all images in files, one after the other, in limited child processes.

    Yields the file and the grey values (row, column) of each. A file may hold several.

    Parameters
    ----------
    shape : rows and columns that each image must have.
    raw : layout of raw files.

    Raises InputError for a file that is not an image, shows colours, has another size, more than 16
    bits a pixel or negative values; a raw file without a layout.
    """
    for kind, group in itertools.groupby(files, key=_kind):
        paths = list(group)
        parts: Iterator[Iterator[tuple[Path, U16]]]
        if kind == "raw":
            parts = (_read_raw(path, shape, raw) for path in paths)
        elif kind == "movie":
            parts = (_in_child(_store_movie, [path]) for path in paths)
        else:
            parts = (_read_stills(paths[at : at + _BATCH]) for at in range(0, len(paths), _BATCH))
        for path, image in itertools.chain.from_iterable(parts):
            yield path, _checked(path, image, shape)


def read_page(path: Path, page: int, shape: tuple[int, int], raw: RawLayout | None = None) -> U16:
    """Read one image (row, column) of a file; pages count from 0.

    Movies (their images cannot be read alone), missing pages, and anything that `read_images`
    refuses are an InputError.
    """
    kind = _kind(path)
    if kind == "movie":
        raise InputError(f"{path}: expected a file whose images can be read alone, got a movie")
    if kind == "raw":
        return next(itertools.islice(_read_raw(path, shape, raw), page, None))[1]
    for _, image in read_pages([path], page, 1):
        return _checked(path, image, shape)
    raise InputError(f"{path}: expected image {page} in it, got fewer")


def read_pages(paths: Sequence[Path], first: int, count: int) -> Iterator[tuple[Path, U16]]:
    """Read up to so many images of each file, from number `first` on, of any size."""
    return _in_child(_store_stills, paths, first, count)


def read_photographs(paths: Sequence[Path], shape: tuple[int, int]) -> list[U16]:
    """Read grey values (rows, columns) of images of that shape; colours become grey.

    Other files, shapes and too large images are an InputError.
    """
    images = _in_child(_store_photographs, paths) if paths else ()
    return [_checked(path, image, shape) for path, image in images]


def image_size(path: Path) -> tuple[int, int] | None:
    """Read rows and columns of a file's first image; None for movies and raw."""
    if _kind(path) != "still":
        return None
    return next((image.shape for _, image in read_pages([path], 0, 1)), None)


def _kind(path: Path) -> str:
    suffix = path.suffix.lower()
    return "raw" if suffix in RAW else "movie" if suffix in MOVIES else "still"


def _read_stills(paths: Sequence[Path]) -> Iterator[tuple[Path, U16]]:
    """Read the first pages of files, and further ones of those that are full."""
    first, left = 0, list(paths)
    while left:
        pages: dict[Path, list[U16]] = {path: [] for path in left}
        for path, image in read_pages(left, first, _BATCH):
            pages[path].append(image)
        full = [path for path in left if len(pages[path]) == _BATCH]
        if len(left) > 1 and full:
            # files with many pages: one after the other, in the order of the files
            yield from itertools.chain.from_iterable(_read_stills([path]) for path in left)
            return
        for path in left:
            yield from ((path, image) for image in pages[path])
        first, left = first + _BATCH, full


def _in_child(store: Any, paths: Sequence[Path], *arguments: Any) -> Iterator[tuple[Path, U16]]:
    """Let a child process save images as .npy files, and read these."""
    with tempfile.TemporaryDirectory(prefix="sabench-") as name:
        folder = Path(name)
        size = sum(path.stat().st_size for path in paths)
        size *= _EXPANDED if store is _store_movie else 1
        read_isolated(store, paths[0], tuple(paths), folder, *arguments, size_bytes=size)
        for number, path in enumerate(paths):
            stored = folder.glob(f"{number}-*.npy")
            for file in sorted(stored, key=lambda file: int(file.stem.partition("-")[2])):
                yield path, np.load(file, allow_pickle=False)
                file.unlink()


def _store_stills(_: Path, paths: Sequence[Path], folder: Path, first: int, count: int) -> None:
    import cv2

    for number, path in enumerate(paths):
        try:
            done, pages = cv2.imreadmulti(str(path), first, count, flags=cv2.IMREAD_UNCHANGED)
        except (cv2.error, MemoryError):  # no page is left, or too many pixels
            done, pages = False, ()
        if not done and first == 0:
            raise InputError(f"{path}: {_NO_IMAGE}")
        for page, image in enumerate(pages):
            grey = _grey(path, image)
            light = ~grey if _is_negative(path, image) else grey
            np.save(folder / f"{number}-{page}.npy", light)


def _store_photographs(_: Path, paths: Sequence[Path], folder: Path) -> None:
    import cv2

    for number, path in enumerate(paths):
        try:
            image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH)
        except (cv2.error, MemoryError):  # too many pixels
            image = None
        if image is None:
            raise InputError(f"{path}: {_NO_IMAGE}")
        np.save(folder / f"{number}-0.npy", _grey(path, image))


def _is_negative(path: Path, image: Any) -> bool:
    """Return whether 0 is white in a TIFF of 16 bits, which OpenCV does not invert."""
    import tifffile

    if path.suffix.lower() not in (".tif", ".tiff") or image.dtype != np.uint16:
        return False
    with tifffile.TiffFile(path) as file:
        return bool(file.pages.first.photometric == tifffile.PHOTOMETRIC.MINISWHITE)


def _store_movie(path: Path, _: Sequence[Path], folder: Path) -> None:
    import cv2

    movie = cv2.VideoCapture(str(path))
    for page in itertools.count():
        shown, image = movie.read()
        if not shown and not page:
            raise InputError(f"{path}: expected a movie that OpenCV can decode, got none")
        if not shown:
            break
        image = np.asarray(image)
        if image.ndim == 3:
            if int(np.ptp(image.astype(np.int16), axis=2).max()) > _NEARLY_GREY:
                raise InputError(f"{path}: expected a grey movie, got one with colours; convert it")
            image = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))
        np.save(folder / f"0-{page}.npy", np.asarray(image, dtype=np.uint16))


def _grey(path: Path, image: Any) -> U16:
    most = np.iinfo(np.uint16).max
    if image.dtype.kind == "f" and (image == np.clip(np.rint(image), 0, most)).all():
        image = image.astype(np.uint16)
    if image.dtype.kind not in "ui" or image.dtype.itemsize > 2:
        raise InputError(
            f"{path}: expected whole grey values of 8 or 16 bits, got {image.dtype}; convert it to "
            "16 bits"
        )
    if image.dtype.kind == "i" and image.min() < 0:
        raise InputError(f"{path}: expected grey values of 0 or more, got {int(image.min())}")
    if image.ndim == 3:
        if (image[..., :3] != image[..., :1]).any():
            raise InputError(f"{path}: expected a grey image, got one with colours; convert it")
        image = image[..., 0]
    return np.asarray(image, dtype=np.uint16)


def _read_raw(
    path: Path, shape: tuple[int, int], raw: RawLayout | None
) -> Iterator[tuple[Path, U16]]:
    if raw is None:
        types = ", ".join(_RAW_TYPES)
        raise InputError(f"{path}: expected the type of raw pixels to be given ({types}), got none")
    dtype = np.dtype(_RAW_TYPES[raw.dtype])
    size = shape[0] * shape[1] * dtype.itemsize
    count, rest = divmod(path.stat().st_size - raw.header_bytes, size)
    if count < 1 or rest:
        raise InputError(
            f"{path}: expected whole images of {shape[0]} x {shape[1]} pixels (rows x columns) of "
            f"{raw.dtype} behind {raw.header_bytes} bytes, got {path.stat().st_size} bytes"
        )
    for number in range(count):
        offset = raw.header_bytes + number * size
        image = np.fromfile(path, dtype, shape[0] * shape[1], offset=offset)
        yield path, image.astype(np.uint16).reshape(shape)


def _checked(path: Path, image: U16, shape: tuple[int, int]) -> U16:
    if image.shape == shape:
        return image
    rows, columns = image.shape
    turned = "; they are turned by 90 degrees" if image.shape == shape[::-1] else ""
    raise InputError(
        f"{path}: expected {shape[0]} x {shape[1]} pixels (rows x columns) as in the calibration, "
        f"got {rows} x {columns}{turned}"
    )
