"""Pairs of calibrated cameras and the image files of a recording."""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from sabench.geometry.camera_model import CameraModel
from sabench.images.image_files import Files
from sabench.utils.errors import InputError

Taken = tuple[CameraModel, tuple[Path, ...]]  # a camera and its files


def pair_images(
    folder: Path,
    files: Files,
    cameras: Sequence[CameraModel],
    pairs: Mapping[str, str] | None,
    notes: list[str],
) -> list[Taken]:
    """Find the files of each calibrated camera: as paired, by its name, or in order.

    Parameters
    ----------
    folder : of the recording, for errors.
    files : of each camera of the recording, by its name.
    pairs : calibrated camera of each camera of the recording; the others are left out.
    notes : list that gets a sentence where cameras are taken in order.

    Raises
    ------
    InputError
        Cameras without images, images without a calibration, or an unknown name in a pair.
    """
    named = {camera.name: camera for camera in cameras}
    if pairs is not None:
        return [
            (_known(named, own, "camera"), _known(files, of, "images")) for of, own in pairs.items()
        ]
    alike = {_plain(name): name for name in files}
    if any(_plain(name) in alike for name in named):
        _check_pairs(folder, list(files), list(named))
        return [(camera, files[alike[_plain(camera.name)]]) for camera in cameras]
    if len(files) != len(named):
        raise InputError(
            f"{folder}: expected images of {len(named)} cameras ({', '.join(named)}), got "
            f"{len(files)} ({', '.join(files)}); name the pairs, or the pattern of the files"
        )
    pairs_in_order = ", ".join(f"{of} = {own}" for of, own in zip(files, named, strict=True))
    notes.append(
        f"no images have a camera's name: taken in order, {pairs_in_order} (or name --pair)"
    )
    return list(zip(cameras, files.values(), strict=True))


def _check_pairs(folder: Path, images: Sequence[str], cameras: Sequence[str]) -> None:
    missing, spare = _without(cameras, images), _without(images, cameras)
    if missing:
        raise InputError(
            f"{folder}: expected images of all {len(cameras)} cameras, found none of "
            f"{', '.join(missing)}; name the pairs to leave cameras out"
        )
    if spare:
        raise InputError(
            f"{folder}: expected a calibration of each camera, found none of {', '.join(spare)}; "
            "name the pairs to leave images out"
        )


def _without(names: Sequence[str], others: Sequence[str]) -> list[str]:
    known = {_plain(one) for one in others}
    return [one for one in names if _plain(one) not in known]


def _known(known: Mapping[str, Any], name: str, kind: str) -> Any:
    if name not in known:
        raise InputError(f"{kind}: expected one of {', '.join(known)}, got {name!r}")
    return known[name]


def _plain(name: str) -> str:
    return "".join(mark for mark in name.lower() if mark.isalnum())


def check_numbers(files: Files, chosen: slice, notes: list[str]) -> None:
    """Check by numbers of files that no camera lacks a frame of the others.

    Frames are paired in order, so that all after a gap would be paired with other cameras' earlier
    ones. Files without numbers, those whose least step differs between cameras, as of times, and
    cameras of a single file are not checked.

    Parameters
    ----------
    files : of each camera, by its name.
    chosen : range of each camera's files to take.
    notes : list that gets a sentence where cameras begin with different numbers.

    Raises
    ------
    InputError
        A camera that lacks a number, counted from its first one, which another one has.
    """
    counters = {name: _counters_of(paths) for name, paths in files.items()}
    if len({_least_step(own) for own in counters.values() if len(own) > 1}) > 1:
        return  # times, say, and no numbers of frames
    known = {name: own[chosen] for name, own in counters.items() if len(own[chosen]) > 1}
    every = {number - own[0] for own in known.values() for number in own}
    for name, own in known.items():
        gaps = {own[0] + step for step in every if step < own[-1] - own[0]} - set(own)
        if gaps:
            raise InputError(
                f"{name}: expected an image of number {min(gaps)}, as other cameras have, got "
                "none; frames are paired in order: remove it from all cameras, or add it"
            )
    first = {name: own[0] for name, own in known.items()}
    if len(set(first.values())) > 1:
        begin = ", ".join(f"{number} of {name}" for name, number in first.items())
        notes.append(f"frames are paired in order, and images begin with numbers {begin}")


def _counters_of(paths: Sequence[Path]) -> list[int]:
    """Read the last number in files' names that differs in all, if any."""
    found = [[int(one) for one in re.findall(r"\d+", path.stem)] for path in paths]
    for place in reversed(range(min((len(one) for one in found), default=0))):
        numbers = [one[place] for one in found]
        if len(set(numbers)) == len(paths):
            return numbers
    return []


def _least_step(numbers: Sequence[int]) -> int:
    return min(after - before for before, after in itertools.pairwise(numbers))
