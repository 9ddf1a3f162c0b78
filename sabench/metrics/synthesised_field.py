"""Synthesised field E_s: the volume that a reconstruction is compared with."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sabench.api.truth import Particles, View
from sabench.geometry.grid import Grid, check_volume, synthesise
from sabench.utils.arrays import F32, F64


def true_field(grid: Grid, particles: Particles, views: Sequence[View]) -> F32:
    """Synthesise the field E_s (z, y, x) of a frame's particles.

    Every particle, visible or not, is a Gaussian sphere in mm. Its peak is its `brightness`, its
    standard deviation the median size of the particle images, converted from pixels to mm with the
    grid's spacing along x.

    Parameters
    ----------
    views : what each camera receives of the same particles.

    Raises
    ------
    InputError
        The field does not fit into memory.
    """
    check_volume(grid)
    if not len(particles):
        return np.zeros(grid.shape, dtype=np.float32)
    sigma_px = float(np.nanmedian(np.concatenate([view.sigma_px for view in views])))
    return synthesise(grid, particles.position_mm, brightness(views), sigma_px * grid.voxel_mm[0])


def brightness(views: Sequence[View]) -> F64:
    """Average each particle's relative photon count over cameras that see its light.

    The count of a camera is relative to the mean of all particles illuminated in it. Returns
    (particle,); 0 for a particle that is illuminated in no camera.
    """
    photons = np.stack([view.photons for view in views])
    illuminated = photons > 0.0
    typical = photons.sum(axis=1) / np.maximum(illuminated.sum(axis=1), 1)
    relative = photons / np.maximum(typical, 1e-300)[:, None]
    return np.asarray(relative.sum(axis=0) / np.maximum(illuminated.sum(axis=0), 1))
