"""Image files of a recording: which camera and frame each one is.

Recorders name files in many ways: a folder for each camera, a folder for each frame, all in one
folder with numbers, one file for each camera with all its frames.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from sabench.utils.errors import InputError

STILLS = (".tif", ".tiff", ".png", ".bmp", ".pgm", ".jpg", ".jpeg")
MOVIES = (".avi", ".mp4", ".mov", ".mkv")
RAW = (".raw", ".bin")
READABLE = (*STILLS, *MOVIES, *RAW)
_DIGITS = re.compile(r"(\d+)")
_LAST_NUMBER = re.compile(r"\d+(?=\D*$)")
_ALONE = "camera"  # name of a camera whose files do not give it one
_FIELDS = {"camera": r"(?P<camera>[^/]+?)", "frame": r"(?P<frame>\d+)", "*": r"[^/]*?"}

Files = dict[str, tuple[Path, ...]]


def find_image_files(folder: Path, cameras: Sequence[str], pattern: str | None = None) -> Files:
    """Find the image files of each camera of a recording, in the order of frames.

    Without a pattern, each folder inside it with images is a camera; where these folders hold one
    file for each of the cameras, by their names, each is a frame. Of files in the folder itself,
    one with a camera's name is all of that camera's, and so is each file where there are as many
    as cameras, or a movie; else files whose names differ in the last number alone are one camera's.

    Parameters
    ----------
    cameras : names of the calibrated cameras.
    pattern : path below the folder with `{camera}` and `{frame}` (a number), and `*` for anything
        within a name, as in "run1/{camera}_*_{frame}.tif".

    Raises
    ------
    InputError
        No folder there, no images in it, a pattern that is none or that matches nothing, or two
        files of one frame and camera.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: expected a folder of images, got no folder")
    if pattern is not None:
        return _by_pattern(folder, pattern)
    found = _by_folder(folder, cameras) | _in_one_folder(_images_in(folder), cameras)
    if not found:
        raise InputError(_none_found(folder))
    return {name: found[name] for name in sorted(found, key=natural_order)}


def natural_order(name: str) -> list[tuple[int, str]]:
    """Give a key that sorts names with their numbers as numbers."""
    return [(int(one), "") if one.isdigit() else (0, one) for one in _DIGITS.split(name.lower())]


def _by_pattern(folder: Path, pattern: str) -> Files:
    matcher = _compile(pattern)
    found: dict[str, dict[int, Path]] = {}
    for path in sorted(folder.rglob("*")):
        match = matcher.fullmatch(path.relative_to(folder).as_posix())
        if match is None or not path.is_file():
            continue
        fields = match.groupdict()
        frames = found.setdefault(fields.get("camera") or _ALONE, {})
        number = int(fields.get("frame") or 0)
        if number in frames:
            raise InputError(
                f"{path}: expected one file for each camera and frame, but {frames[number].name} "
                f"is frame {number} of the same camera"
            )
        frames[number] = path
    if not found:
        raise InputError(f"{folder}: expected files like {pattern}, got none")
    ordered = sorted(found, key=natural_order)
    return {name: tuple(path for _, path in sorted(found[name].items())) for name in ordered}


def _compile(pattern: str) -> re.Pattern[str]:
    """Make a regular expression of a pattern."""
    parts = re.split(r"(\{[^}]*\}|\*)", pattern)
    fields = [part.strip("{}") for part in parts if part[:1] == "{"]
    if (
        "camera" not in fields
        or not {*fields} <= {"camera", "frame"}
        or len({*fields}) < len(fields)
    ):
        raise InputError(
            "pattern: expected a path with {camera} and, for files of one frame, {frame}, each "
            f"once, got {pattern!r}"
        )
    return re.compile(
        "".join(
            _FIELDS[part.strip("{}")] if part[:1] == "{" or part == "*" else re.escape(part)
            for part in parts
        )
    )


def _by_folder(folder: Path, cameras: Sequence[str]) -> Files:
    """Find folders of cameras, or of frames with a file for each camera."""
    inner = sorted((one for one in folder.iterdir() if one.is_dir()), key=_order)
    held = {one.name: files for one in inner if (files := _images_in(one))}
    of_frames = held and all(_are_cameras(files, cameras) for files in held.values())
    if not of_frames or set(held) & set(cameras):
        return held
    found: dict[str, list[Path]] = {name: [] for name in cameras}
    for files in held.values():
        for path in files:
            found[path.stem].append(path)
    return {name: tuple(files) for name, files in found.items()}


def _are_cameras(files: Sequence[Path], cameras: Sequence[str]) -> bool:
    return {path.stem for path in files} <= set(cameras)


def _in_one_folder(files: Sequence[Path], cameras: Sequence[str]) -> Files:
    stems = Counter(path.stem for path in files)
    each = len(files) == len(cameras) and len(stems) == len(files)
    found: dict[str, list[Path]] = {}
    for path in files:
        own = each or path.stem in cameras or path.suffix.lower() in MOVIES or _is_numbered(path)
        name = path.stem if own else _LAST_NUMBER.sub("", path.stem).strip(" ._-") or _ALONE
        found.setdefault(name, []).append(path)
    return {name: tuple(paths) for name, paths in found.items()}


def _images_in(folder: Path) -> tuple[Path, ...]:
    files = (one for one in folder.iterdir() if _is_readable(one) and one.is_file())
    shown = (one for one in files if not one.name.startswith("."))
    return tuple(sorted(shown, key=_order))


def _is_readable(path: Path) -> bool:
    return path.suffix.lower() in READABLE or _is_numbered(path)


def _is_numbered(path: Path) -> bool:
    """Say whether the suffix is a frame's number, as OpenPTV names images."""
    return path.suffix[1:].isdigit()


def _order(path: Path) -> list[tuple[int, str]]:
    return natural_order(path.name)


def _none_found(folder: Path) -> str:
    others = Counter(one.suffix.lower() for one in folder.rglob("*") if one.is_file())
    got = ", ".join(f"{count} x {kind or 'no suffix'}" for kind, count in others.most_common(3))
    known = ", ".join(READABLE)
    return f"{folder}: expected images ({known}) in it or its folders, got {got or 'no files'}"
