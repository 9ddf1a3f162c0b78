"""Image files of a recording: which camera and frame each one is.

Recorders name files in many ways: a folder for each camera, a folder for each frame, all in one
folder with numbers, one file for each camera with all its frames.
"""

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

from sabench.utils.errors import InputError

STILLS = (".tif", ".tiff", ".png", ".bmp", ".pgm", ".jpg", ".jpeg")
MOVIES = (".avi", ".mp4", ".mov", ".mkv")
RAW = (".raw", ".bin")
READABLE = (*STILLS, *MOVIES, *RAW)
_DIGITS = re.compile(r"(\d+)")
_LAST_NUMBER = re.compile(r"\d+(?=\D*$)")
_UNNAMED = "camera"  # of a camera without a name in its files
_FIELDS = {"{camera}": r"(?P<camera>[^/]+?)", "{frame}": r"(?P<frame>\d+)", "*": r"[^/]*?"}

Files = dict[str, tuple[Path, ...]]


def find_image_files(folder: Path, cameras: Sequence[str], pattern: str | None = None) -> Files:
    """Find the image files of each camera of a recording, in the order of frames.

    Without a pattern, each folder inside it with images is a camera; where these folders hold one
    file for each of the cameras, by their names, each is a frame. Of files in the folder itself,
    one with a camera's name is all of that camera's, and so is each file where there are as many
    as cameras, or a movie; else files that differ in the last number alone are one camera's.

    Parameters
    ----------
    cameras : names of the calibrated cameras.
    pattern : path below the folder with `{camera}` and `{frame}` (a number), and `*` for anything
        within a name, as in "run1/{camera}_*_{frame}.tif".

    Raises InputError for a missing folder, no images in it, an invalid pattern or one that matches
    nothing, or two files of one frame and camera.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: expected a folder of images, got no folder")
    if pattern is not None:
        return _by_pattern(folder, pattern)
    files = _by_folder(folder, cameras) | _in_one_folder(_images_in(folder), cameras)
    if not files:
        others = Counter(path.suffix.lower() for path in folder.rglob("*") if path.is_file())
        got = ", ".join(f"{count} x {kind or 'no suffix'}" for kind, count in others.most_common(3))
        raise InputError(
            f"{folder}: expected images ({', '.join(READABLE)}) in it or its folders, got "
            f"{got or 'no files'}"
        )
    return {name: files[name] for name in sorted(files, key=natural_order)}


def natural_order(name: str) -> list[tuple[int, str]]:
    """Give a key that sorts names with their numbers as numbers."""
    return [(int(run), "") if run.isdigit() else (0, run) for run in _DIGITS.split(name.lower())]


def camera_name(path: Path) -> str:
    """Return a file's name without its last number, which is that of the frame."""
    return _LAST_NUMBER.sub("", path.stem).strip(" ._-") or _UNNAMED


def last_number_order(path: Path) -> tuple[str, int, str]:
    """Give a key that sorts files by name without the last number, then by it."""
    number = _LAST_NUMBER.search(path.stem)
    return _LAST_NUMBER.sub("", path.stem), int(number.group()) if number else -1, path.name


def _by_pattern(folder: Path, pattern: str) -> Files:
    matcher = _compile(pattern)
    numbered: dict[str, dict[int, Path]] = {}
    for path in sorted(folder.rglob("*")):
        match = matcher.fullmatch(path.relative_to(folder).as_posix())
        if match is None or not path.is_file():
            continue
        fields = match.groupdict()
        frames = numbered.setdefault(fields.get("camera") or _UNNAMED, {})
        number = int(fields.get("frame") or 0)
        if number in frames:
            raise InputError(
                f"{path}: expected one file for each camera and frame, but {frames[number].name} "
                f"is frame {number} of the same camera"
            )
        frames[number] = path
    if not numbered:
        raise InputError(f"{folder}: expected files like {pattern}, got none")
    return {
        name: tuple(path for _, path in sorted(numbered[name].items()))
        for name in sorted(numbered, key=natural_order)
    }


def _compile(pattern: str) -> re.Pattern[str]:
    parts = re.split(r"(\{[^}]*\}|\*)", pattern)
    fields = sorted(part.strip("{}") for part in parts if part[:1] == "{")
    if fields not in (["camera"], ["camera", "frame"]):
        raise InputError(
            "pattern: expected a path with {camera} and, for files of one frame, {frame}, each "
            f"once, got {pattern!r}"
        )
    return re.compile("".join(_FIELDS.get(part) or re.escape(part) for part in parts))


def _by_folder(folder: Path, cameras: Sequence[str]) -> Files:
    """Find folders of cameras, or of frames with a file for each camera."""
    inner = _sorted(path for path in folder.iterdir() if path.is_dir())
    held = {path.name: files for path in inner if (files := _images_in(path))}
    every = [path for files in held.values() for path in files]
    if not held or not {path.stem for path in every} <= set(cameras) or set(held) & set(cameras):
        return held
    return {name: tuple(path for path in every if path.stem == name) for name in cameras}


def _in_one_folder(files: Sequence[Path], cameras: Sequence[str]) -> Files:
    stems = Counter(path.stem for path in files)
    each = len(files) == len(cameras) and len(stems) == len(files)
    by_camera: dict[str, list[Path]] = {}
    for path in files:
        whole = each or path.stem in cameras or path.suffix.lower() in MOVIES or _is_numbered(path)
        name = path.stem if whole else camera_name(path)
        by_camera.setdefault(name, []).append(path)
    return {name: tuple(paths) for name, paths in by_camera.items()}


def _images_in(folder: Path) -> tuple[Path, ...]:
    shown = (path for path in folder.iterdir() if path.is_file() and path.name[:1] != ".")
    images = (path for path in shown if path.suffix.lower() in READABLE or _is_numbered(path))
    return tuple(_sorted(images))


def _sorted(paths: Iterable[Path]) -> list[Path]:
    return sorted(paths, key=lambda path: natural_order(path.name))


def _is_numbered(path: Path) -> bool:
    """Return whether the suffix is a frame's number, as OpenPTV names images."""
    return path.suffix[1:].isdigit()
