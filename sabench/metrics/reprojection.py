"""Found particles against the images that they came from; no truth is needed.

Particles are projected, and their images, Gaussians of the width that the image's statistics show,
receive the light that fits the image best. The remaining image shows how much is explained, and in
which direction each particle's images are off.
"""

from typing import NamedTuple

import numpy as np

from sabench.images.gaussians import gaussian_profiles
from sabench.utils.arrays import F64, I64, Bool

_REACH = 3.0  # standard deviations of a particle's image: half its window
_ROUNDS = 60  # of the fit of light
FARTHEST_PX = 1.0  # shift of an image: more is another particle's


class Patches(NamedTuple):
    """Windows of particles' images in one camera's image.

    Attributes
    ----------
    rows : (m,) rows of the particles that the camera sees.
    at : (m, k) pixels of each window in the flattened image; -1 beyond its edges and where pixels
        are unknown.
    image : (m, k) shares of a particle's light in these pixels; 0 where `at` is -1.
    slope : (m, k, 2) their derivatives by the column and row of the centre.
    """

    rows: I64
    at: I64
    image: F64
    slope: F64


class LightFit(NamedTuple):
    """Light of particles in one camera, and what is left of its image.

    Attributes
    ----------
    light : (n,) sum of the grey values of each particle's image; NaN for those not in view.
    left : (row, column) the image less all particles.
    shift_px : (n, 2) column and row from where a particle is projected to its image; NaN for those
        not in view, and where the image is further away than a pixel or the window shows nothing.
    """

    light: F64
    left: F64
    shift_px: F64


def cut_patches(shape: tuple[int, int], pixels: F64, sigma_px: F64, valid: Bool) -> Patches:
    """Cut the windows of particles at pixels (n, 2) out of an image.

    Parameters
    ----------
    shape : rows and columns.
    pixels : column and row; NaN for a particle without a pixel.
    sigma_px : (2,) standard deviations of images along columns and rows.
    valid : (row, column) pixels that count.
    """
    size = np.array(shape[::-1])
    with np.errstate(invalid="ignore"):
        rows = np.flatnonzero(((pixels >= -0.5) & (pixels < size - 0.5)).all(axis=1))
    half = np.ceil(_REACH * sigma_px).astype(np.int64)
    first = np.rint(pixels[rows]).astype(np.int64) - half
    (x, by_x), (y, by_y) = (
        gaussian_profiles(pixels[rows, axis], sigma_px[axis], first[:, axis], 2 * int(reach) + 1)
        for axis, reach in enumerate(half)
    )
    column = first[:, 0, None, None] + np.arange(x.shape[1])
    row = first[:, 1, None, None] + np.arange(y.shape[1])[:, None]
    inside = (column >= 0) & (column < size[0]) & (row >= 0) & (row < size[1])
    at = np.where(inside, row * size[0] + column, 0)
    counts = inside & valid.ravel()[at]
    image = np.where(counts, y[:, :, None] * x[:, None], 0.0)
    slope = np.stack([y[:, :, None] * by_x[:, None], by_y[:, :, None] * x[:, None]], axis=-1)
    slope *= counts[..., None]
    flat, at = (len(rows), x.shape[1] * y.shape[1]), np.where(counts, at, -1)
    return Patches(rows, at.reshape(flat), image.reshape(flat), slope.reshape(*flat, 2))


def fit_light(image: F64, patches: Patches, count: int) -> LightFit:
    """Fit the light of all particles in one image (row, column), none of it negative.

    By the image space reconstruction algorithm (Daube-Witherspoon and Muehllehner, IEEE Trans. Med.
    Imaging 5 (1986) 61-66), which lowers the sum of squared differences.

    Parameters
    ----------
    image : less black and background.
    count : n, the number of all particles.
    """
    positive = _read(np.maximum(image, 0.0), patches)
    given = (patches.image * positive).sum(axis=1)
    square = (patches.image**2).sum(axis=1)
    light = given / np.maximum(square, 1e-12)
    for _ in range(_ROUNDS):
        shown = (
            patches.image * _read(draw_reprojection(image.shape, patches, light), patches)
        ).sum(axis=1)
        light *= given / np.maximum(shown, 1e-12)
    left = image - draw_reprojection(image.shape, patches, light)
    all_light, shift = np.full(count, np.nan), np.full((count, 2), np.nan)
    all_light[patches.rows] = light
    shift[patches.rows] = _shifts(left, patches, light)
    return LightFit(all_light, left, shift)


def _shifts(left: F64, patches: Patches, light: F64) -> F64:
    """Compute by how much (m, 2) each image must move to fit what is left around it."""
    slope = light[:, None, None] * patches.slope
    matrix = np.einsum("nki,nkj->nij", slope, slope)
    right = np.einsum("nki,nk->ni", slope, _read(left, patches))
    good = np.linalg.det(matrix) > 1e-9 * np.trace(matrix, axis1=1, axis2=2) ** 2
    shift = np.full((len(light), 2), np.nan)
    shift[good] = np.linalg.solve(matrix[good], right[good, :, None])[:, :, 0]
    far = np.linalg.norm(shift, axis=1) > FARTHEST_PX
    shift[far] = np.nan
    return shift


def matched_light(image: F64, patches: Patches) -> F64:
    """Fit the light (m,) of each particle in view alone; NaN without pixels."""
    square = (patches.image**2).sum(axis=1)
    light = (patches.image * _read(image, patches)).sum(axis=1) / np.maximum(square, 1e-12)
    return np.where(square > 0.0, light, np.nan)


def draw_reprojection(shape: tuple[int, ...], patches: Patches, light: F64) -> F64:
    """Draw the image (row, column) of particles in view with light (m,)."""
    values = patches.image * light[:, None]
    inside = patches.at >= 0
    total = np.bincount(patches.at[inside], values[inside], shape[0] * shape[1])
    return total.reshape(shape).astype(np.float64)


def explained_share(image: F64, left: F64, valid: Bool, noise: float) -> float:
    """Compute the share of an image's light that is explained.

    It is 1 - sum(left^2) / sum(image^2), both without what noise adds; NaN for an image that shows
    no more than noise.

    Parameters
    ----------
    image, left : (row, column) less black and background; what particles leave of it.
    noise : standard deviation of a pixel.
    """
    added = noise**2 * valid.sum()
    total, rest = (float((light[valid] ** 2).sum()) - added for light in (image, left))
    return 1.0 - max(rest, 0.0) / total if total > 0.0 else float("nan")


def _read(image: F64, patches: Patches) -> F64:
    """Read an image in all windows (m, k); pixels that do not count are 0."""
    return np.where(patches.at >= 0, image.ravel()[patches.at], 0.0)
