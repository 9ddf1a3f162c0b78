"""Repair of images of particles: hot pixels, dead pixels and reflections.

They are found in a single image. The neighbours of a hot pixel, which has no width, are darker than
those of particles' peaks. A dead pixel is darker than the light on all of its sides. A reflection
is a bright area wider than any particle's image.
"""

import cv2
import numpy as np

from sabench.images.flaws import Flaws, Repaired
from sabench.images.peaks import CLEAR, maxima
from sabench.images.widths import LEAST_NOISE, SPOT_PX
from sabench.utils.arrays import F32, FROM_MAD, I64, U16, Bool

# of the typical peak's sharpness: neighbours of hot pixels, and dead ones, are darker
_NARROW = 0.25
_FAINT = 0.5  # of the median peak: the light of dimmer flaws does no harm
_MARGIN = 1.5  # standard deviations by which both are certain
_SHARPEST = 0.1  # sharpness of images that are as narrow as pixels, as those of 0.35 px
BRIGHT = 4.0  # of a typical peak: more is no particle
GLARE = 8.0  # of a typical particle: brighter than particles are


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
        good = _fill(grey, points) if points.any() else grey
        covered[:] = find_reflections(good, white_dn)
        if points.any() or covered.any():
            out = images.copy() if out is images else out
            out[number] = np.where(covered, np.uint16(np.rint(black_dn)), good)
    return Repaired(out, flaws)


def above_background(grey: U16) -> tuple[F32, float]:
    """Subtract the darkest part, without single dead pixels, and estimate the noise.

    The noise, at least 0.5, follows from the median distance of the darker half to the median of
    3 x 3 pixels. A distance of k counts as spread evenly from k - 0.5 to k + 0.5, which resolves
    noise of less than a grey value.
    """
    smooth = cv2.medianBlur(grey, 3)
    low = cv2.erode(smooth, np.ones((SPOT_PX + 2,) * 2, dtype=np.uint8))
    away = cv2.absdiff(grey, smooth)[smooth <= np.median(smooth)]
    up_to = np.cumsum(np.bincount(away))
    middle = np.interp(0.5 * up_to[-1], [0, *up_to], [0.0, *(np.arange(len(up_to)) + 0.5)])
    return grey.astype(np.float32) - low, max(FROM_MAD * float(middle), LEAST_NOISE)


def peak_light(light: F32, noise: float) -> float:
    """Compute the height that a quarter of the peaks exceed.

    Peaks are those clear of noise; 0 without any. A few peaks of any height hardly change it.
    """
    row, column = maxima(light, CLEAR * noise)
    heights = light[row, column]
    return float(np.quantile(heights, 0.75)) if len(heights) else 0.0


def find_points(grey: U16, black_dn: float) -> Bool:
    """Find hot and dead pixels (row, column)."""
    light, noise = above_background(grey)
    points = np.zeros(light.shape, dtype=np.bool_)
    row, column = maxima(light, CLEAR * noise)
    if len(row):
        # light beside typical peaks, which must be particles', over theirs: 0.2 for Gaussians of
        # 0.5 px, 0.45 for those of 0.75 px
        sides = _dim_sides(light)
        ratios = sides[row, column] / light[row, column]
        sharpness = max(float(np.quantile(ratios, 0.6)), 0.0)
        least = max(CLEAR * noise, _FAINT * float(np.median(light[row, column])))
        narrow, margin = _NARROW * sharpness, _MARGIN * noise
        if sharpness > _SHARPEST:
            points = _find_hot(light, least, sides, narrow, margin)
        # dead ones: light above black too dark for that on all of their sides
        above = grey.astype(np.float32) - np.float32(black_dn)
        wide = cv2.copyMakeBorder(np.maximum(above, 0.0), 1, 1, 1, 1, cv2.BORDER_REFLECT_101)
        across, down = wide[1:-1, :-2] * wide[1:-1, 2:], wide[:-2, 1:-1] * wide[2:, 1:-1]
        beside = np.minimum(across, down, out=across)
        limit = np.float32(narrow) * np.sqrt(beside, out=down)
        points |= (above + np.float32(margin) < limit) & (beside > (0.5 * least) ** 2)
    return points


def find_reflections(grey: U16, white_dn: float) -> Bool:
    """Find areas (row, column) of light that is no particle's."""
    light, noise = above_background(grey)
    peak = peak_light(light, noise)
    if peak == 0.0:
        return np.zeros(grey.shape, dtype=np.bool_)
    dark = float(np.median(grey))
    square = np.ones((SPOT_PX, SPOT_PX), dtype=np.uint8)
    least = cv2.erode(grey, square)
    seeds = least >= min(dark + BRIGHT * peak, white_dn)
    covered = np.zeros(grey.shape, dtype=np.uint8)
    if seeds.any():
        _, areas = cv2.connectedComponents((least > dark + peak).astype(np.uint8))
        skirts = np.isin(areas, np.unique(areas[seeds & (areas > 0)]))
        covered = cv2.dilate(skirts.astype(np.uint8), np.ones((SPOT_PX + 2,) * 2, dtype=np.uint8))
    glare = light > GLARE * peak
    covered |= cv2.dilate(glare.astype(np.uint8), square)
    return covered.astype(np.bool_)


def _dim_sides(light: F32) -> F32:
    """Average the three darkest of each pixel's four neighbours.

    Those beyond the border are mirrored. Two hot pixels may touch.
    """
    wide = cv2.copyMakeBorder(light, 1, 1, 1, 1, cv2.BORDER_REFLECT_101)
    across, down = (wide[1:-1, :-2], wide[1:-1, 2:]), (wide[:-2, 1:-1], wide[2:, 1:-1])
    brightest = np.maximum(np.maximum(*across), np.maximum(*down))
    return np.asarray((sum(across) + sum(down) - brightest) / np.float32(3.0))


def _neighbours(row: I64, column: I64, shape: tuple[int, ...]) -> tuple[I64, I64, Bool]:
    """Return pixels' neighbours (4, n): rows, columns, and whether they are inside."""
    rows = np.array([row - 1, row + 1, row, row])
    columns = np.array([column, column, column - 1, column + 1])
    inside = (rows >= 0) & (rows < shape[0]) & (columns >= 0) & (columns < shape[1])
    return np.where(inside, rows, 0), np.where(inside, columns, 0), inside


def _find_hot(light: F32, least: float, sides: F32, narrow: float, margin: float) -> Bool:
    """Mark pixels too bright for their neighbours, alone or with the brightest one."""
    narrower = sides + margin < narrow * light
    row, column = np.nonzero((light > least) & narrower)
    rows, columns, inside = _neighbours(row, column, light.shape)
    beside = np.where(inside, light[rows, columns], -np.inf)
    first = beside.argmax(axis=0), np.arange(len(row))
    alone = beside[first] <= np.maximum(light[row, column], least)
    hot = np.zeros(light.shape, dtype=np.bool_)
    hot[row, column] = alone | narrower[rows[first], columns[first]]
    return hot


def _fill(grey: U16, points: Bool) -> U16:
    """Replace marked pixels by the mean of their neighbours that are not marked."""
    row, column = np.nonzero(points)
    rows, columns, inside = _neighbours(row, column, grey.shape)
    good = inside & ~points[rows, columns]
    count = good.sum(axis=0)
    mean = np.where(good, grey[rows, columns], 0).sum(axis=0) / np.maximum(count, 1)
    out = grey.copy()
    out[row, column] = np.where(count > 0, np.rint(mean), grey[row, column])
    return out
