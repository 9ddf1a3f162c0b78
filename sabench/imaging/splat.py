"""Analytic renderer: every particle's Gaussian, integrated over each pixel, at its refracted position."""

from __future__ import annotations

import numpy as np
from scipy.special import erf

from sabench.arrays import F64
from sabench.imaging.particle_images import ParticleImages
from sabench.optics.camera import Camera

_REACH = 4.5  # standard deviations from the centre to the window's edge: less than 2e-5 of the light is left out
_BATCH = 1 << 16


def splat(camera: Camera, images: ParticleImages) -> F64:
    """Photon image (rows, columns) of one exposure.

    Light outside a particle's window of `_REACH` standard deviations is left out; particles whose centre lies outside
    the sensor still light the pixels that their window reaches.
    """
    reach = np.ceil(_REACH * images.sigma_px + 0.5)
    lit = images.photons > 0.0
    lit[lit] &= camera.contains(images.pixel[lit], float(reach[lit].max()) if lit.any() else 0.0)
    image = np.zeros(camera.rows * camera.columns)
    for half in np.unique(reach[lit]):
        chosen = np.flatnonzero(lit & (reach == half))
        for start in range(0, len(chosen), _BATCH):
            _add(image, camera, images, chosen[start : start + _BATCH], int(half))
    return image.reshape(camera.rows, camera.columns)


def _add(image: F64, camera: Camera, images: ParticleImages, chosen: np.ndarray[tuple[int], np.dtype[np.intp]], half: int) -> None:
    """Add the windows of 2 half + 1 pixels of the chosen particles to a flat image."""
    nearest = np.rint(images.pixel[chosen]).astype(np.int64)
    offsets = np.arange(-half, half + 1)
    sigma = images.sigma_px[chosen, None, None] * np.sqrt(2.0)
    edges = np.append(offsets - 0.5, half + 0.5)[None, None] + (nearest - images.pixel[chosen])[:, :, None]
    share = 0.5 * np.diff(erf(edges / sigma), axis=2)
    light = images.photons[chosen, None, None] * share[:, 1, :, None] * share[:, 0, None, :]
    column = nearest[:, 0, None, None] + offsets[None, None, :]
    row = nearest[:, 1, None, None] + offsets[None, :, None]
    inside = (column >= 0) & (column < camera.columns) & (row >= 0) & (row < camera.rows)
    flat = (row * camera.columns + column)[inside]
    image += np.bincount(flat, weights=light[inside], minlength=len(image))
