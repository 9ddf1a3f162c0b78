"""Gaussian fits of particle images, one by one: position, width and flux."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sabench.images.peaks import find_peaks
from sabench.images.repair import above_background, find_points
from sabench.utils.arrays import F32, F64, I64, U16

_CLEAR = 8.0  # standard deviations of noise by which a peak exceeds the background
_HALF = 2  # px: half the window in which a particle image is fitted
_NARROW_PX, _WIDEST_PX = 1.0, 10.0  # widths of fits by 3 x 3 pixels, and of those that fail
_FROM_MAD = 1.4826  # standard deviation of normal numbers, over their median distance
_MOST = 50.0  # ln of light; only of fits that fail
_PIXEL = 1.0 / 12.0  # px2: variance of a pixel


class ParticleImages(NamedTuple):
    """Gaussians that fit the particle images of one image.

    Attributes
    ----------
    pixel : (n, 2) column and row.
    width_px : (n,) geometric mean of both standard deviations, less the pixels' own width.
    flux : (n,) their integral, in grey values times px2.
    height : (n,) brightest pixel above the local background, in grey values.
    found : number of peaks, also saturated ones and those that no Gaussian fits.
    """

    pixel: F64
    width_px: F64
    flux: F64
    height: F64
    found: int


def image_noise(grey: U16) -> float:
    """Estimate the noise of an image from its darker half, at least 0.5.

    It follows from the median distance to the median of 3 x 3 pixels. A distance of k counts as
    evenly spread from k - 0.5 to k + 0.5, which also tells noise of less than a grey value.
    """
    import cv2

    smooth = cv2.medianBlur(grey, 3)
    away = cv2.absdiff(grey, smooth)[smooth <= np.median(smooth)]
    up_to = np.cumsum(np.bincount(away.ravel()))
    middle = np.interp(0.5 * up_to[-1], [0, *up_to], [0.0, *(np.arange(len(up_to)) + 0.5)])
    return max(0.5, _FROM_MAD * float(middle))


def fit_particle_images(grey: U16, white_dn: float) -> ParticleImages:
    """Fit a Gaussian at any angle to each peak of an image (row, column).

    Peaks exceed all of their 5 x 5 surroundings, and the local background by 8 standard deviations
    of the noise; hot pixels, saturated peaks and those at the border are left out. A quadratic is
    fitted to the logarithm of the light, with the light's square as weight (Guo, IEEE Signal
    Process. Mag. 28 (2011) 134-137): of 3 x 3 pixels, since neighbours overlap, or of 5 x 5 where
    the image is wider than 1 px.

    Parameters
    ----------
    white_dn : grey value of a saturated pixel.
    """
    noise = image_noise(grey)
    light = above_background(grey)[0] - np.float32(noise)  # the least of many values is that low
    row, column, windows = _windows(light, _CLEAR * noise)
    top = windows[:, _HALF, _HALF] >= windows.max(axis=(1, 2), initial=0.0)
    top &= ~find_points(grey, float(grey.min()))[row, column]
    around = np.arange(-_HALF, _HALF + 1)
    values = grey[row[:, None, None] + around[:, None], column[:, None, None] + around]
    good = np.asarray(top & (values < white_dn).all(axis=(1, 2)))
    narrow = _fit_gaussians(windows[good][:, 1:-1, 1:-1])
    wide = _fit_gaussians(windows[good])
    fit = np.where(narrow[:, :1] <= _NARROW_PX, narrow, wide)  # NaN is not narrow
    valid = fit[:, 0] < _WIDEST_PX
    pixel = np.stack([column[good], row[good]], axis=1) + fit[:, 2:]
    height = windows[good, _HALF, _HALF]
    return ParticleImages(pixel[valid], fit[valid, 0], fit[valid, 1], height[valid], int(top.sum()))


def _windows(light: F32, least: float) -> tuple[I64, I64, F64]:
    """Cut the light (n, 5, 5) around peaks above `least`.

    Returns their rows and columns, too.
    """
    peaks = find_peaks(light, least).pixels
    column, row = np.rint(peaks).astype(np.int64).T
    most = np.array(light.shape) - 1 - _HALF
    inner = (np.minimum(column, row) >= _HALF) & (row <= most[0]) & (column <= most[1])
    row, column = row[inner], column[inner]
    around = np.arange(-_HALF, _HALF + 1)
    windows = light[row[:, None, None] + around[:, None], column[:, None, None] + around]
    return row, column, windows.astype(np.float64)


def _fit_gaussians(windows: F64) -> F64:
    """Fit Gaussians to light (n, row, column).

    Returns (n, 4): width, integral, and the centre's column and row from the window's; NaN where
    the fit is no ellipse, or its centre is more than a pixel away.
    """
    half = windows.shape[1] // 2
    y, x = (one.ravel().astype(float) for one in np.mgrid[-half : half + 1, -half : half + 1])
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    light = windows.reshape(len(windows), len(x))
    floor = 1e-3 * light.max(axis=1, initial=1e-9, keepdims=True)
    weight = np.where(light > floor, light / floor, 0.0) ** 2
    matrix = np.einsum("np,pi,pj->nij", weight, terms, terms) + 1e-6 * np.eye(6)
    right = np.einsum("np,pi->ni", weight * np.log(np.maximum(light, floor)), terms)
    return _gaussians_of(np.linalg.solve(matrix, right[..., None])[..., 0])


def _gaussians_of(c: F64) -> F64:
    """Turn quadratics into Gaussians (n, 4).

    Coefficients (n, 6) are of 1, x, y, x2, x y and y2.
    """
    determinant = 4.0 * c[:, 3] * c[:, 5] - c[:, 4] ** 2
    valid = (c[:, 3] < 0.0) & (determinant > 1e-9)
    safe = np.where(valid, determinant, 1.0)
    across, down, both = -2.0 * c[:, 5] / safe, -2.0 * c[:, 3] / safe, c[:, 4] / safe
    x, y = across * c[:, 1] + both * c[:, 2], both * c[:, 1] + down * c[:, 2]
    top = c[:, 0] + 0.5 * (c[:, 1] * x + c[:, 2] * y)
    flux = np.exp(np.minimum(top, _MOST)) * 2.0 * np.pi / np.sqrt(safe)
    square = (across - _PIXEL) * (down - _PIXEL) - both**2
    valid &= (np.minimum(across, down) > _PIXEL) & (square > 0.0)
    valid &= np.maximum(np.abs(x), np.abs(y)) < 1.0
    width = np.sqrt(np.sqrt(np.where(valid, square, np.nan)))
    return np.stack([width, flux, x, y], axis=1)


def flux_near(images: ParticleImages, pixels: F64, reach_px: float, apart_px: float) -> F64:
    """Look up the flux (n,) of the particle image nearest to each pixel (n, 2).

    NaN where none is within `reach_px`, where another one is within `apart_px` of the pixel, or
    another pixel is.
    """
    from scipy.spatial import cKDTree

    out = np.full(len(pixels), np.nan)
    known = np.flatnonzero(np.isfinite(pixels).all(axis=1))
    if not len(known) or not len(images.pixel):
        return out
    asked, shown = cKDTree(pixels[known]), cKDTree(images.pixel)
    distance, nearest = shown.query(pixels[known])
    near = [len(one) for one in shown.query_ball_point(pixels[known], apart_px)]
    lone = [len(one) for one in asked.query_ball_point(pixels[known], apart_px)]
    good = (distance <= reach_px) & (np.array(near) == 1) & (np.array(lone) == 1)
    out[known[good]] = images.flux[nearest[good]]
    return out
