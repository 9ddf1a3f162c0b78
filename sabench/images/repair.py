"""Repair of images of particles: hot pixels, dead pixels and reflections.

They are found in a single image. The neighbours of a hot pixel, which has no width, are darker than
those of particles' peaks. A dead pixel is darker than the light on all of its sides. A reflection
is a bright area wider than any particle's image.
"""

from typing import Any

import numpy as np

from sabench.images.flaws import Flaws, Repaired
from sabench.images.peaks import maxima
from sabench.images.widths import LEAST_NOISE
from sabench.utils.arrays import F32, FROM_MAD, U16, Bool
from sabench.utils.compiled import numba

_WINDOW = 9  # px: edge of the square whose darkest part is the background
_CLEAR = 8.0  # standard deviations of noise by which a peak exceeds the background
_NARROW = 0.25  # of the typical peak's sharpness: the neighbours of hot pixels are darker
_SHARPEST = 0.1  # sharpness of images that are as narrow as pixels, as those of 0.35 px
_DARK, _HOLE = 0.15, 0.4  # of the light on both sides: the limit for dead pixels, and by sharpness
_FAINT = 0.5  # of the median peak: the light of dimmer flaws does no harm
_MARGIN = 1.5  # standard deviations by which both are certain
_WIDE = 7  # px: edge of a square that no particle fills with light
_BRIGHT, _SKIRT = 4.0, 0.5  # of a typical peak: a reflection, and the light around it
_GLARE = 10.0  # of a typical peak: brighter than particles are
_REACH = 3  # px around it


def repair(images: U16, black_dn: float, white_dn: float) -> Repaired:
    """Replace hot pixels, dead pixels and reflections in images of particles.

    Images (camera, row, column) without any are not copied.

    Parameters
    ----------
    black_dn, white_dn : grey values of no light and of saturation.
    """
    out, flaws = images, Flaws.none(images.shape)
    for number, (grey, points, covered) in enumerate(zip(images, *flaws, strict=True)):
        points[:] = find_points(grey, black_dn)
        good = grey
        if points.any():
            good = grey.copy()
            _fill(grey, points, good)
        covered[:] = find_reflections(good, white_dn)
        if points.any() or covered.any():
            out = images.copy() if out is images else out
            out[number] = np.where(covered, np.uint16(np.rint(black_dn)), good)
    return Repaired(out, flaws)


def above_background(grey: U16) -> tuple[F32, float]:
    """Subtract the darkest part, without single dead pixels, and estimate the noise."""
    import cv2  # takes long to load

    smooth = cv2.medianBlur(grey, 3)
    low = cv2.erode(smooth, np.ones((_WINDOW, _WINDOW), dtype=np.uint8))
    light = grey.astype(np.float32) - low
    return light, max(FROM_MAD * _middle(cv2.absdiff(grey, smooth)), LEAST_NOISE)


def _middle(grey: U16) -> int:
    return int(np.searchsorted(np.cumsum(np.bincount(grey.ravel())), grey.size / 2.0))


def peak_light(light: F32, noise: float) -> float:
    """Compute the height that a quarter of the peaks exceed.

    Peaks are those clear of noise; 0 without any. A few peaks of any height hardly change it.
    """
    row, column = maxima(light, np.float32(_CLEAR * noise))
    heights = light[row, column]
    return float(np.quantile(heights, 0.75)) if len(heights) else 0.0


def find_points(grey: U16, black_dn: float) -> Bool:
    """Find hot and dead pixels (row, column)."""
    import cv2

    light, noise = above_background(grey)
    points = np.zeros(light.shape, dtype=np.bool_)
    row, column = maxima(light, np.float32(_CLEAR * noise))
    if len(row):
        # light beside typical peaks, which must be particles', over theirs: 0.2 for Gaussians of
        # 0.5 px, 0.45 for those of 0.75 px
        ratios = np.empty(len(row))
        _measure_ratios(light, row, column, ratios)
        sharpness = max(float(np.quantile(ratios, 0.6)), 0.0)
        least = max(_CLEAR * noise, _FAINT * float(np.median(light[row, column])))
        margin, hole = _MARGIN * noise, min(_DARK, _HOLE * sharpness)
        if sharpness > _SHARPEST:
            _mark_hot(light, least, _NARROW * sharpness, margin, points)
        # dead ones: light above black too dark for that on all of their sides
        above = grey.astype(np.float32) - np.float32(black_dn)
        wide = cv2.copyMakeBorder(np.maximum(above, 0.0), 1, 1, 1, 1, cv2.BORDER_REFLECT_101)
        across, down = wide[1:-1, :-2] * wide[1:-1, 2:], wide[:-2, 1:-1] * wide[2:, 1:-1]
        beside = np.minimum(across, down, out=across)
        limit = np.float32(hole) * np.sqrt(beside, out=down)
        points |= (above + np.float32(margin) < limit) & (beside > (0.5 * least) ** 2)
    return points


def find_reflections(grey: U16, white_dn: float) -> Bool:
    """Find areas (row, column) of light that is no particle's."""
    import cv2

    light, noise = above_background(grey)
    peak = peak_light(light, noise)
    if peak == 0.0:
        return np.zeros(grey.shape, dtype=np.bool_)
    dark = _middle(grey)
    square = np.ones((_WIDE, _WIDE), dtype=np.uint8)
    least = cv2.erode(grey, square)
    seeds = least >= min(dark + _BRIGHT * peak, white_dn)
    covered = np.zeros(grey.shape, dtype=np.uint8)
    if seeds.any():
        _, areas = cv2.connectedComponents((least > dark + _SKIRT * peak).astype(np.uint8))
        skirts = np.isin(areas, np.unique(areas[seeds & (areas > 0)]))
        covered = cv2.dilate(skirts.astype(np.uint8), np.ones((_WIDE + 2,) * 2, dtype=np.uint8))
    glare = light > _GLARE * peak
    if glare.any():
        covered |= cv2.dilate(glare.astype(np.uint8), np.ones((2 * _REACH + 1,) * 2, np.uint8))
    return covered.astype(np.bool_)


@numba.njit(cache=True)
def _dim_side(light: Any, r: int, c: int) -> Any:
    """Average the three darkest of a pixel's four neighbours, around the border.

    Two hot pixels may touch.
    """
    rows, columns = light.shape
    left, right = c - 1 if c > 0 else c + 1, c + 1 if c < columns - 1 else c - 1
    above, below = r - 1 if r > 0 else r + 1, r + 1 if r < rows - 1 else r - 1
    a, b, c, d = light[r, left], light[r, right], light[above, c], light[below, c]
    return (a + b + c + d - max(max(a, b), max(c, d))) / 3.0


@numba.njit(cache=True)
def _measure_ratios(light: Any, row: Any, column: Any, ratios: Any) -> None:
    for n in range(len(row)):
        ratios[n] = _dim_side(light, row[n], column[n]) / light[row[n], column[n]]


@numba.njit(cache=True)
def _mark_hot(light: Any, least: float, narrow: float, margin: float, points: Any) -> None:
    """Mark pixels too bright for their neighbours, alone or with the brightest one."""
    rows, columns = light.shape
    for r in range(rows):
        for c in range(columns):
            here = light[r, c]
            if here <= least or not _dim_side(light, r, c) + margin < narrow * here:
                continue
            y, x, most = r, c, -np.inf  # the brightest of the four neighbours
            for i, j in ((r - 1, c), (r + 1, c), (r, c - 1), (r, c + 1)):
                if 0 <= i < rows and 0 <= j < columns and light[i, j] > most:
                    y, x, most = i, j, light[i, j]
            narrower = _dim_side(light, y, x) + margin < narrow * light[y, x]
            points[r, c] = most <= max(here, least) or narrower


@numba.njit(cache=True)
def _fill(grey: Any, points: Any, good: Any) -> None:
    """Replace marked pixels by the mean of their neighbours that are not marked."""
    rows, columns = grey.shape
    for r in range(rows):
        for c in range(columns):
            if not points[r, c]:
                continue
            total, count = 0.0, 0
            for i, j in ((-1, 0), (1, 0), (0, -1), (0, 1)):
                y, x = r + i, c + j
                if 0 <= y < rows and 0 <= x < columns and not points[y, x]:
                    total, count = total + grey[y, x], count + 1
            if count:
                good[r, c] = np.rint(total / count)
