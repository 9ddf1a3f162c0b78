"""Cameras whose images contradict the others'.

A camera whose calibration is wrong by many pixels, or is another camera's, shows little where the
particles of the others are. What the search leaves of its image tells.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence

import cv2
import numpy as np

from sabench.algorithms.particles.light_prior import scatter_between
from sabench.algorithms.particles.particle_search import ParticleSearch
from sabench.algorithms.particles.search_state import MOST_TILT
from sabench.algorithms.particles.volume_shares import shared_views
from sabench.utils.arrays import F32, F64, Bool

_FEWEST = 3  # cameras that may be left
_MANY = 50  # particles that tell of their images
_LEFT = 0.1  # of the squared light of an image: more that is left has a reason
_CHANCE = 1.0  # over the square root of the particles' number: share that few leave by chance
_SCATTER, _LITTLE = 0.7, 0.03  # of light between cameras; with less left, it is particles' own
_CLEAR = 6.0  # standard deviations of noise: light
_WORST = 2.0  # times the median camera's: what a camera leaves that contradicts the others


def without_wrong_cameras(
    search: ParticleSearch,
    names: Sequence[str],
    search_without: Callable[[Bool], ParticleSearch | None],
) -> ParticleSearch:
    """Search again without the cameras that contradict the others.

    A warning names each. If no choice of cameras explains the images, one warning says so, and the
    search stays.

    Parameters
    ----------
    names : of all cameras.
    search_without : searches the frame without the cameras (all cameras,) that are marked.
    """
    wrong = np.zeros(len(search.shown), dtype=np.bool_)
    now: ParticleSearch | None = search
    while now is not None and not explains(now):
        left, worst = left_of_images(now), _worst(now)
        if now.shown.sum() <= _FEWEST or left.max() < _WORST * np.median(left):
            now = None
        else:
            wrong[worst] = True
            now = search_without(wrong)
    if now is None:
        _warn(
            f"{names[_worst(search)]}: expected light of particles in the grid, got light that "
            "they do not explain, as in other cameras; check the calibration, and that the grid "
            "holds all particles that the cameras see"
        )
        return search
    for camera in np.flatnonzero(wrong).tolist():
        _warn(
            f"{names[camera]}: expected light where the other cameras' particles are, got it "
            "elsewhere; the camera is left out: check its calibration"
        )
    return now


def warn_of_tilt(search: ParticleSearch, names: Sequence[str]) -> None:
    """Warn of cameras whose particle images are longer streaks than the model's.

    Few particles tell nothing.
    """
    if search.number < _MANY:
        return
    for camera, tilt in zip(np.flatnonzero(search.shown).tolist(), search.tilt, strict=True):
        if abs(tilt) > MOST_TILT:
            _warn(
                f"{names[camera]}: expected particle images that are spots, got streaks across "
                f"rows and columns (correlation {tilt:+.2f}, up to {MOST_TILT} is fitted); some "
                "particles may be missed or found as two: check the focus, the camera's angle to "
                "the wall, and that particles do not move while they are lit"
            )


def explains(search: ParticleSearch) -> bool:
    """Say whether the particles explain the images, with light as particles have it."""
    left = float(left_of_images(search).max())
    most = _LEFT + _CHANCE / math.sqrt(max(len(search.position), 1))
    return left < _LITTLE or (left < most and scatter_between(search.covariance) < _SCATTER)


def left_of_images(search: ParticleSearch) -> F64:
    """Compute the share (camera,) of each image's squared light that is left.

    Light that is not clear of noise does not count, nor that of a pixel alone, which may be hot.
    Where much is left, pixels count alone of whose part of the box enough cameras see all. Without
    particles, noise is the scatter of all pixels about their median, as a background may have
    passed for light.
    """
    if not len(search.position):
        seen = zip(search.images, search.known, strict=True)
        return np.array([_stands_out(image[known]) for image, known in seen])
    shares = _left_where(search, search.known)
    if shares.max() < _LITTLE:
        return shares
    shape = search.images.shape[1:]
    return _left_where(search, search.known & shared_views(search.maps, shape, _FEWEST))


def _left_where(search: ParticleSearch, counts: Bool) -> F64:
    """Compute what is left of squared light (camera,) in the pixels that count."""
    shares = []
    for camera, (image, known, noise) in enumerate(
        zip(search.images, counts, search.noise, strict=True)
    ):
        both = search.miss(camera), image
        rest, whole = (_squares(np.where(known, one, 0.0), _CLEAR * noise) for one in both)
        shares.append(rest / max(whole, rest, 1e-6))
    return np.array(shares)


def _stands_out(light: F32) -> float:
    """Return 1 if pixels stand out from the others, else 0."""
    off = light - np.median(light)
    return float((off > 1.4826 * _CLEAR * np.median(np.abs(off))).any())


def _squares(light: F32, floor: float) -> float:
    """Add up squares of light above a floor, where a neighbour is above it, too."""
    above = np.abs(light) > floor
    together = cv2.boxFilter(above.astype(np.float32), -1, (3, 3), normalize=False) > 1.5
    return float(np.square(light[above & together], dtype=np.float64).sum())


def _worst(search: ParticleSearch) -> int:
    """Return the camera, among all, of whose image most is left."""
    return int(np.flatnonzero(search.shown)[np.argmax(left_of_images(search))])


def _warn(sentence: str) -> None:
    warnings.warn(sentence, stacklevel=2)
