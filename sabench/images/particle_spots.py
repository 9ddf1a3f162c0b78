"""Images of particles with the noise of pixels, for bounds of positions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sabench.utils.arrays import F64

IMAGE_REACH = 4.0  # standard deviations from the centre of an image to its window's edge
OVERLAP = 2.0  # standard deviations of both: distance of images that overlap
_WIDEST = 32  # px: half a window
UNKNOWNS = 4  # logarithm of the light, and position
# share of its information by which each unknown of a neighbour is known before, so that neighbours
# that one camera alone sees make no matrix singular
KNOWN = 1e-9
SINGULAR = 1e-9  # least eigenvalue of information in units of each unknown's own


@dataclass(frozen=True)
class ParticleSpots:
    """Images of n particles in one camera.

    Attributes
    ----------
    pixel : (n, 2) column, row of the centres; NaN where there is none.
    slope : (n, 2, 3) derivatives of the centre by the position, px/mm.
    light : (n,) integral of the image; 0 where the camera does not see the particle.
    sigma_px : (n,) standard deviation.
    variance : (row, column) of the pixels' noise, in the square of the unit of the light; infinite
        where a pixel tells nothing.
    """

    pixel: F64
    slope: F64
    light: F64
    sigma_px: F64
    variance: F64


def where_seen(camera: ParticleSpots) -> F64:
    """Return the centres (n, 2) of images; NaN where none, or too wide a one, is."""
    seen = (camera.light > 0.0) & (IMAGE_REACH * camera.sigma_px + 1.0 < _WIDEST)
    return np.where(seen[:, None], camera.pixel, np.nan)
