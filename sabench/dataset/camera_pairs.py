"""Pairs of calibrated cameras and the image files of a recording."""

from __future__ import annotations

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
    notes.append(f"no images have a camera's name: taken in order, {pairs_in_order}")
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
