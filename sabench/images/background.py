"""Background of images, and bright things that are no particles.

Images may be brighter than black between particles, differently from place to place: scattered
light, or what a sliding minimum leaves of noise. The background of a tile is its mode, estimated by
clipping (E. Bertin and S. Arnouts, SExtractor, Astron. Astrophys. Suppl. 117, 393, 1996). Patches
with sharp edges and hardly any dark pixel are brighter on top of it: a sliding minimum
leaves them around dead pixels, and bodies are lit.
"""

from typing import Any, NamedTuple

import cv2
import numpy as np

from sabench.images.flaws import Flaws
from sabench.images.widths import measure_images, noise_below_black
from sabench.utils.arrays import F32, I64, Bool
from sabench.utils.compiled import numba
from sabench.utils.threads import on_cores

_TILE = 24  # px: many particles' spacings, and few of them in the background's changes
_BLACK = 0.02  # share of a tile's values at or below black: there it is dark between particles
_CLIP, _CLIPS = 3.0, 12  # standard deviations, and the most rounds
_FEW = 20  # too few values
_DENSE = 0.04  # scatter of the background over the image's bright pixels: above, it is particles
_EVEN = 0.08  # mean less median over the scatter, after clipping: below, it is all background
_BRIGHT = 99.0  # percentile that stands for bright particles' pixels
_SPOT = 7  # px: a particle's image is narrower
_SPOT_LIGHT = 0.5  # of bright pixels, in all of a square: no particle
_MANY, _CHANCE = 8.0, 6.0  # typical particles, and standard deviations of overlapping ones
_LIT = 0.5  # typical particles in a square: less is noise
_SEARCHES = 4  # for bright spots, as each makes typical light a little too large
_HALO = 6  # px around bright spots
_PATCH = 12  # px: edge of a square that detects a patch
_DIMMEST, _BELOW = 0.1, 1.2816  # share of its pixels, and how far dark noise has them below zero
_RAISED = 4.0  # standard deviations: a patch is that much brighter than the background
_UNUSUAL = 6.0  # standard deviations below the middle level: a patch is that far above it
_ONE_SIGMA = 15.9  # percentile, one standard deviation below the mean of normal values
_BORDER, _WIDE = 2, 11  # px: around patches, and the diameter of a disc wider than particles
_LOW = 0.5  # standard deviations: how far an opening of the smoothed noise is below its mean
_UNEVEN = 2.0  # standard deviations: what is that much above a patch's level is its own shading
_ROUGH = 0.6  # of a patch's level: how far its median may be above the level; particles vary more


class ClearImages(NamedTuple):
    """Images of all cameras that show particles alone.

    Attributes
    ----------
    images : (camera, row, column) less black and background.
    flaws : pixels that show nothing of the particles.
    saturated : (camera, row, column) pixels that show less light than there is.
    """

    images: F32
    flaws: Flaws
    saturated: Bool


def clear_images(images: F32, flaws: Flaws) -> tuple[F32, Flaws]:
    """Subtract the background of images (camera, row, column); cover bright spots."""
    cleared, covered = images.copy(), flaws.covered.copy()
    for camera, image in enumerate(cleared):
        valid = ~flaws.unknown[camera]
        spots = find_bright_spots(image, valid)
        background = estimate_background(image, valid & ~spots)
        if background is not None:
            image -= background
        image -= find_patches(image, valid & ~spots)
        for _ in range(_SEARCHES):
            light = float(measure_images(image[None], (valid & ~spots)[None]).light[0])
            more = find_bright_spots(image, valid & ~spots, light) & ~spots
            if not more.any():
                break
            spots |= more
        covered[camera] |= spots
    return cleared, Flaws(flaws.points, covered)


def estimate_background(image: F32, valid: Bool) -> F32 | None:
    """Estimate the background (row, column) of an image less black.

    It is None if none shows.
    """
    rows, columns = (max(size // _TILE, 1) for size in image.shape)
    tiles = _ends(image.shape[0], rows), _ends(image.shape[1], columns)
    modes = np.full((rows * columns, 4), np.nan)
    on_cores(_measure_modes, len(modes), image, valid, *tiles, modes)
    levels, scatter, skew, black = modes.T
    bright = float(np.percentile(image[valid], _BRIGHT)) if valid.any() else 0.0
    clear = scatter < _DENSE * bright
    told = np.isfinite(skew)
    if told.any() and np.median(skew[told]) < _EVEN:  # few particles: bright pixels may be noise
        clear = told
    if not clear.any() or np.nanmedian(black) > _BLACK:
        return None
    level = np.where(clear, levels, np.median(levels[clear])).reshape(rows, columns)
    grid = cv2.medianBlur(level.astype(np.float32), 3) if min(level.shape) > 2 else level
    size = image.shape[::-1]
    smooth = cv2.resize(np.float32(grid), size, interpolation=cv2.INTER_LINEAR)
    return np.asarray(np.maximum(smooth, np.float32(0.0)))


def find_patches(image: F32, valid: Bool) -> F32:
    """Measure patches that are brighter than the background around them.

    The result (row, column) is by how much, and 0 elsewhere. Particles that leave few pixels dark
    are less even than a patch, and where they leave none, no dimmer elsewhere.
    """
    noise = noise_below_black(image[valid])
    dark = valid & (image <= (_RAISED - _BELOW) * noise)
    if min(image.shape) < _PATCH:
        return np.zeros_like(image)
    size = (_PATCH, _PATCH)
    sums = (
        cv2.boxFilter(mask.astype(np.float32), -1, size, anchor=(0, 0), normalize=False)
        for mask in (dark, valid)
    )
    few, all_valid = (counts[: 1 - _PATCH, : 1 - _PATCH] for counts in sums)
    lit = (few < _DIMMEST * all_valid) & (all_valid > 0.5 * _PATCH**2)
    total, count = np.zeros_like(image), np.zeros_like(image)
    _add_patches(image, valid, lit, _BELOW * noise, total, count)
    raised = total / np.maximum(count, np.float32(1.0)) + np.float32(_BELOW * noise)
    levels = _levels(image, valid)
    levels, usual = levels[np.isfinite(levels)], 0.0
    if len(levels):  # the highest level by chance, some standard deviations above the middle one
        low, middle = np.percentile(levels, [_ONE_SIGMA, 50.0])
        usual = float(middle + _UNUSUAL * (middle - low))
    least = max(_RAISED * noise, usual + _BELOW * noise)
    patches = (count > 0) & (raised > least)
    if not patches.any():
        return np.zeros_like(image)
    square = np.ones((2 * _BORDER + 1, 2 * _BORDER + 1), np.uint8)
    around = cv2.dilate(patches.astype(np.uint8), square) > 0
    even = np.where(patches, raised, np.float32(0.0))
    # light that is wider than particles' images, as of lit bodies
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (_WIDE, _WIDE))
    opened = cv2.morphologyEx(cv2.GaussianBlur(image, (0, 0), 1.0), cv2.MORPH_OPEN, disc)
    wide = np.asarray(opened + np.float32(_LOW * noise))
    uneven = around & (wide > even + np.float32(_UNEVEN * noise))
    return np.where(uneven, wide, even)


@numba.njit(cache=True)
def _levels(image: Any, valid: Any) -> Any:
    """Return low percentiles of squares side by side, NaN if few pixels are known."""
    rows, columns = image.shape[0] // _PATCH, image.shape[1] // _PATCH
    levels, values = np.full(rows * columns, np.nan), np.zeros(_PATCH * _PATCH)
    for square in range(rows * columns):
        top, left = square // columns * _PATCH, square % columns * _PATCH
        level, _ = _percentiles(image, valid, top, left, values)
        levels[square] = level
    return levels


@numba.njit(cache=True)
def _add_patches(image: Any, valid: Any, lit: Any, below: float, total: Any, count: Any) -> None:
    """Add up, and count, the dimmest values of even squares.

    Squares of every second row and column are tried first, then all near the even ones of these.
    """
    near = np.zeros(lit.shape, dtype=np.bool_)
    values = np.zeros(_PATCH * _PATCH)
    for i in range(0, lit.shape[0], 2):
        for j in range(0, lit.shape[1], 2):
            if lit[i, j] and _level(image, valid, i, j, below, values) > -np.inf:
                for row in range(max(i - 1, 0), min(i + 2, lit.shape[0])):
                    for column in range(max(j - 1, 0), min(j + 2, lit.shape[1])):
                        near[row, column] = True
    for i in range(lit.shape[0]):
        for j in range(lit.shape[1]):
            if lit[i, j] and near[i, j]:
                level = _level(image, valid, i, j, below, values)
                if level > -np.inf:
                    for row in range(i, i + _PATCH):
                        for column in range(j, j + _PATCH):
                            total[row, column] += level
                            count[row, column] += 1.0


@numba.njit(cache=True)
def _level(image: Any, valid: Any, i: int, j: int, below: float, values: Any) -> float:
    """Return a low percentile of a square; minus infinity if it is not even."""
    level, middle = _percentiles(image, valid, i, j, values)
    return level if middle - level < _ROUGH * (level + below) else -np.inf


@numba.njit(cache=True)
def _percentiles(image: Any, valid: Any, i: int, j: int, values: Any) -> tuple[float, float]:
    """Return a low percentile and the median of a square's known pixels; NaN if few."""
    number = 0
    for row in range(i, i + _PATCH):
        for column in range(j, j + _PATCH):
            if valid[row, column]:
                values[number] = image[row, column]
                number += 1
    if number <= _PATCH**2 // 2:
        return np.nan, np.nan
    ranked = np.sort(values[:number])
    return ranked[int(_DIMMEST * number)], ranked[number // 2]


def _ends(size: int, tiles: int) -> I64:
    """Return where tiles start along an axis, and its end (tiles + 1,)."""
    return np.arange(tiles + 1) * size // tiles


@numba.njit(cache=True, nogil=True)
def _measure_modes(
    jobs: slice, image: Any, valid: Any, downs: Any, acrosses: Any, modes: Any
) -> None:
    """Fill in each tile's mode, scatter and skew after clipping, and share of black.

    Tiles of few values keep what they have in the first three, those without any in all.
    """
    columns = len(acrosses) - 1
    for tile in range(jobs.start, jobs.stop):
        down, across = tile // columns, tile % columns
        top, bottom = downs[down], downs[down + 1]
        left, right = acrosses[across], acrosses[across + 1]
        values, count = np.zeros((bottom - top) * (right - left)), 0
        for i in range(top, bottom):
            for j in range(left, right):
                if valid[i, j] and np.isfinite(image[i, j]):
                    values[count] = image[i, j]
                    count += 1
        if count:
            values = np.sort(values[:count])
            black = 0
            while black < count and values[black] <= 0.0:
                black += 1
            modes[tile, 3] = black / count
        if count > _FEW:
            modes[tile, 0], modes[tile, 1], modes[tile, 2] = _mode(values)


@numba.njit(cache=True)
def _mode(values: Any) -> tuple[float, float, float]:
    """Estimate the mode of sorted values, and their scatter and skew after clipping."""
    first, last = 0, len(values)
    middle, mean, scatter = _moments(values)
    for _ in range(_CLIPS):
        low, high = first, last
        while low < high and values[low] < middle - _CLIP * scatter:
            low += 1
        while high > low and values[high - 1] > middle + _CLIP * scatter:
            high -= 1
        if high - low == last - first or high - low < _FEW:
            break
        first, last = low, high
        middle, mean, scatter = _moments(values[first:last])
    off = mean - middle
    return middle - 1.5 * off, scatter, off / scatter if scatter > 0.0 else 0.0


@numba.njit(cache=True)
def _moments(values: Any) -> tuple[float, float, float]:
    """Return median, mean and standard deviation of sorted values.

    numba compiles these loops faster than numpy's functions.
    """
    size = len(values)
    total = squares = 0.0
    for value in values:
        total += value
    mean = total / size
    for value in values:
        squares += (value - mean) ** 2
    middle = 0.5 * (values[(size - 1) // 2] + values[size // 2])
    return middle, mean, np.sqrt(squares / size)


def find_bright_spots(image: F32, valid: Bool, light: float = 0.0) -> Bool:
    """Mark glints (row, column): wider or many times as bright as a particle.

    Brightness counts only if the light of a particle is known.
    """
    shown = np.where(valid, image, np.float32(0.0))
    bright = max(float(np.percentile(image[valid], _BRIGHT)) if valid.any() else 0.0, 1e-6)
    square = np.ones((_SPOT, _SPOT), np.uint8)
    spots = cv2.morphologyEx(shown, cv2.MORPH_OPEN, square) > _SPOT_LIGHT * bright
    if light:
        sums = cv2.boxFilter(shown, -1, (_SPOT, _SPOT), normalize=False)
        partly = np.median(sums) <= _LIT * light  # the particles fill a part of the image only
        lit = sums[sums > _LIT * light] if partly else sums
        middle = float(np.median(lit)) if len(lit) else 0.0
        scatter = 1.4826 * float(np.median(np.abs(lit - middle))) if len(lit) else 0.0
        spots |= sums > middle + _MANY * light + _CHANCE * scatter
    halo = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * _HALO + 1, 2 * _HALO + 1))
    return np.asarray(cv2.dilate(spots.astype(np.uint8), halo) > 0)
