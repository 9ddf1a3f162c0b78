"""Lower bounds on a data set's memory and disk space."""

from __future__ import annotations

import shutil
from pathlib import Path

from sabench.scenes import Rig, Scene, TargetWorld
from sabench.utils import memory
from sabench.utils.errors import InputError

# per pixel of the picture in work: photons, radiance and noise in double precision, then grey
# values
_WORKING_BYTES = 40
_STORED_BYTES = 2  # per pixel of each picture on the disk: grey values are not compressed


def check_affordable(name: str, scene: Scene, rig: Rig, folder: Path, *, copies: int = 1) -> None:
    """Refuse a scene that cannot fit into memory or on the disk.

    One image at a time must fit into memory, and all images on the disk of the folder.

    Both are lower bounds: a scene that passes may still need too much, one that does not pass would
    have failed.

    Parameters
    ----------
    copies : number of samples of the scene.
    """
    pixels = scene.cameras.rows * scene.cameras.columns
    pictures = copies * scene.frames * len(rig.cameras)
    there, need = memory.available_mb(), pixels * _WORKING_BYTES / 1e6
    if there is not None and need > there:
        size = f"{scene.cameras.rows} x {scene.cameras.columns}"
        raise InputError(
            f"{name}: cameras: expected pictures that fit into memory, but one of {size} pixels "
            f"needs {need:.0f} MB where {there:.0f} are there"
        )
    world = scene.world
    if isinstance(world, TargetWorld) and world.lighting is None:  # without images
        return
    there_now = next(path for path in (folder, *folder.parents) if path.exists())
    free, stored = shutil.disk_usage(there_now).free / 1e6, pixels * pictures * _STORED_BYTES / 1e6
    if stored > free:
        key = "frames" if copies == 1 else "samples"
        raise InputError(
            f"{name}: {key}: expected a data set that fits on the disk, but {pictures} pictures "
            f"need {stored:.0f} MB where {free:.0f} are free"
        )
