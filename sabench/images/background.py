"""Background of images, and bright things that are no particles.

What is wider than a particle's image is no particle: scattered light, lit bodies, reflections, what
a sliding minimum leaves of noise or around dead pixels. An opening (J. Serra, Image Analysis and
Mathematical Morphology, 1982) by an octagon wider than particles' images shows it, with its edges.
Between dense particles few pixels are dark, so the octagon is the wider, the fewer they are.

Glints no wider than particles, and the edges of others, are many times as bright as a particle.
"""

import math
from typing import NamedTuple

import cv2
import numpy as np

from sabench.images.dark_noise import LOW
from sabench.images.flaws import Flaws
from sabench.images.peaks import CLEAR
from sabench.images.repair import GLARE
from sabench.images.widths import LEAST_NOISE, LOCAL_PX, MOST_SIGMA, SPOT_PX, measure_images
from sabench.utils.arrays import F32, FROM_MAD, Bool

_SMOOTH = 1.0  # px: of noise, before the opening
# px: width of the octagon if all pixels were dark: wider than particles' images, and narrow enough
# for shadows and bars; widths that are tried
_WIDTH, _WIDTHS = 7.0, (11, 15, 21, 31, 43, 61, 87, 123, 175, 247)
_BELOW, _SLOPE = 0.32, 0.29  # noise of 1 above its opening of 9 px, and more by the width's log
_DARK = 1.5  # standard deviations above the background: dark pixels
# standard deviations: less background is noise, or, where no pixel is dark, particles' tails
_SHOWN, _TAILS = 1.0, 3.0
_STEEP = 6.0  # standard deviations within 3 x 3 pixels


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
    """Subtract the background of images (camera, row, column); cover glints."""
    cleared, covered = images.copy(), flaws.covered.copy()
    for camera, image in enumerate(cleared):
        valid = ~flaws.unknown[camera]
        background, noise = estimate_background(image, valid)
        image -= background
        edges = mark_edges(background, noise)
        covered[camera] |= edges
        valid &= ~edges
        while valid.any():  # glints make typical light too large: fainter ones are found later
            light = float(measure_images(image[None], valid[None]).light[0])
            more = find_glints(image, valid, light)
            if not (more & valid).any():
                break
            covered[camera] |= more
            valid &= ~more
    return cleared, Flaws(flaws.points, covered)


def estimate_background(image: F32, valid: Bool) -> tuple[F32, float]:
    """Estimate the background (row, column) of an image less black, and the noise.

    The background is 0 where none shows.
    """
    if not valid.any():
        return np.zeros_like(image), 0.0
    known = cv2.GaussianBlur(valid.astype(np.float32), (0, 0), _SMOOTH)
    smooth = cv2.GaussianBlur(np.where(valid, image, np.float32(0.0)), (0, 0), _SMOOTH)
    smooth = np.where(known > 0.1, smooth / np.maximum(known, 0.1), np.float32(np.inf))
    noise = _dark_noise(image, valid, smooth)
    out, sparse = np.zeros_like(image), np.zeros_like(image)
    known, todo, around = valid.astype(np.float32), valid.copy(), (LOCAL_PX, LOCAL_PX)
    for width in _WIDTHS:
        if width > min(image.shape) or not todo.any():
            break  # so few pixels are dark that no background shows there
        background = _open(smooth, width) + np.float32(noise * lift(width))
        dark = valid & (smooth < background + _DARK * noise)
        number, of = (cv2.boxFilter(np.float32(each), -1, around) for each in (dark, known))
        share = cv2.erode(number / np.maximum(of, 1e-6), np.ones(around, np.uint8))
        now = todo & (width * share >= _WIDTH)
        out[now], sparse[now] = background[now], share[now]
        todo &= ~now
    # a bright one has shades of its own, which hardly any particles fill: worth .004 of realistic
    # images and .003 of lit bodies (five seeds)
    details = _open(smooth, _WIDTHS[0]) + np.float32(noise * lift(_WIDTHS[0]))
    out = np.where(out > CLEAR * noise, np.maximum(out, details), out)
    limit = np.float32(noise) * (_TAILS + (_SHOWN - _TAILS) * sparse**2)
    return _lower(np.where(out > limit, out, np.float32(0.0)), image, valid, noise), noise


def _lower(background: F32, image: F32, valid: Bool, noise: float) -> F32:
    """Lower a background where the dark pixels around clearly lie below it.

    On a slope, an opening lies as high as the slope's upper side of each particle. Worth a third
    of the particles' errors over an uneven background without noise.
    """
    valid = valid & (background > 0.0)
    for _ in range(2):
        below = background - image
        dark = (valid & (below > -_TAILS * noise)).astype(np.float32)
        share, mean = (cv2.GaussianBlur(each, (0, 0), MOST_SIGMA) for each in (dark, dark * below))
        share = np.maximum(share, 0.1)
        mean /= share
        error = noise / (2.0 * math.sqrt(math.pi) * MOST_SIGMA * np.sqrt(share))
        background = background - np.where(mean > CLEAR * error, mean, np.float32(0.0))
    return np.maximum(background, np.float32(0.0))


def mark_edges(background: F32, noise: float) -> Bool:
    """Mark where a background changes too fast to be known to the noise."""
    square = np.ones((3, 3), np.uint8)
    change = cv2.dilate(background, square) - cv2.erode(background, square)
    return np.asarray(change > _STEEP * noise)


def lift(width: int) -> float:
    """Return how far smoothed noise of 1 lies above its opening by a width, px."""
    return _BELOW + _SLOPE * math.log(width / 9.0)


def _dark_noise(image: F32, valid: Bool, smooth: F32) -> float:
    """Measure the noise of the darkest pixels by their distances to medians of 3 x 3."""
    away = np.abs(image - cv2.medianBlur(image, 3))
    darker = valid & (smooth <= np.quantile(smooth[valid], LOW))
    return max(math.sqrt(0.5 * math.pi) * float(away[darker].mean()), LEAST_NOISE)


def _open(image: F32, width: int) -> F32:
    """Open an image by a regular octagon: a square, and rounds of a cross."""
    rounds = round(0.29 * width)
    edge = max(width - 2 * rounds, 1)
    square = np.ones((edge, edge), np.uint8)
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    lowest = cv2.erode(cv2.erode(image, square), cross, iterations=rounds)
    return np.asarray(cv2.dilate(cv2.dilate(lowest, cross, iterations=rounds), square))


def find_glints(image: F32, valid: Bool, light: float) -> Bool:
    """Mark what is many times as bright as a particle of some light, with a halo.

    Nothing is marked where the light is 0: no particle shows.
    """
    if not light:
        return np.zeros(image.shape, dtype=np.bool_)
    shown = np.where(valid, image, np.float32(0.0))
    sums = cv2.boxFilter(shown, -1, (SPOT_PX, SPOT_PX), normalize=False)
    middle = float(np.median(sums))
    scatter = FROM_MAD * float(np.median(np.abs(sums - middle)))
    spots = sums > middle + GLARE * light + CLEAR * scatter  # overlapping particles scatter
    halo = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * SPOT_PX - 1,) * 2)
    return np.asarray(cv2.dilate(spots.astype(np.uint8), halo) > 0)
