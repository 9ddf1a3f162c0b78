"""Observations of raw images, with levels aligned and preprocessing applied."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sabench.api import Observation
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.grid import Grid
from sabench.images.flaws import Flaws, Repaired
from sabench.images.preprocessing import WHITE, Step, preprocess
from sabench.utils.arrays import U16, Bool


def build_observation(
    images: U16,
    cameras: tuple[CameraModel, ...],
    grid: Grid,
    levels: tuple[float, float],
    steps: Sequence[Step],
    *,
    lowest: U16 | None = None,
    by_camera: Sequence[tuple[float, float]] = (),
    backlit: bool = False,
    masked: Bool | None = None,
) -> Observation:
    """Build the observation of raw images, after the steps of preprocessing.

    Steps would spread hot pixels, and darken reflections: both are replaced before, unless the
    images are backlit.

    Parameters
    ----------
    levels : grey values of no light and of saturation.
    lowest : each pixel's least value over all frames; only where a step needs it.
    by_camera : those of each camera, where they differ: all images are brought to one black level.
    masked : pixels (camera, row, column) that do not count, as if a reflection covered them.
    """
    if by_camera:
        lowest = None if lowest is None else _align_levels(lowest, levels[0], by_camera)[0]
        images, levels = _align_levels(images, levels[0], by_camera)
    if not steps and masked is None:
        return Observation(images, cameras, grid, *levels)
    flaws = None
    if not backlit:
        images, flaws = _repaired(images, levels, masked)
    if steps:
        images, levels = preprocess(images, *levels, steps, lowest), (0.0, float(WHITE))
    return Observation(images, cameras, grid, *levels, flaws)


def _repaired(images: U16, levels: tuple[float, float], masked: Bool | None) -> Repaired:
    """Repair images and cover what a mask leaves out."""
    from sabench.images.repair import repair  # numba is loaded at the first use

    if masked is None:
        return repair(images, *levels)
    black = np.uint16(np.rint(levels[0]))
    good, flaws = repair(np.where(masked, black, images), *levels)
    return Repaired(np.where(masked, black, good), Flaws(flaws.points, flaws.covered | masked))


def _align_levels(
    images: U16, black_dn: float, by_camera: Sequence[tuple[float, float]]
) -> tuple[U16, tuple[float, float]]:
    """Subtract each camera's dark level and add `black_dn`, in whole grey values.

    Returns the images with one black and one white level, which saturated pixels have.
    """
    widest = max(round(own_white - black) for black, own_white in by_camera)
    white = min(round(black_dn) + widest, np.iinfo(np.uint16).max)
    aligned = np.empty_like(images)
    for image, out, (black, own_white) in zip(images, aligned, by_camera, strict=True):
        grey = image.astype(np.int64) - round(black) + round(black_dn)
        out[:] = np.where(image >= own_white, white, np.clip(grey, 0, white))
    return aligned, (black_dn, float(white))
