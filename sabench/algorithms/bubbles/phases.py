"""Separation of images of bubbles, a body and tracers before a diffuser.

Three facts separate the phases. Light of the diffuser that bubbles refract or a body reflects is
never brighter than the diffuser itself (radiance is conserved), so that small peaks above it are
tracers. Bubbles and bodies are darker than the diffuser. Bodies are wider than bubbles and have no
bright spots, so that peaks in front of them are tracers, too. Limit: tracers in front of bubbles
are lost unless they are brighter than the diffuser.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from sabench.algorithms.bubbles.backlit_images import DIM
from sabench.api.observations import Observation
from sabench.images.widths import SPOT_PX
from sabench.utils.arrays import F32, U8, U16, Bool

_SIGMAS = 5.0  # above the diffuser's noise: a tracer
_DARK = 0.6  # of the diffuser: bubbles' rims and bodies are darker


@dataclass(frozen=True)
class SeparatedPhases:
    """Images of each phase of one frame.

    Attributes
    ----------
    tracers : the frame with the tracers' light alone, above black.
    bubbles : the frame without tracers and without the body, which shows the diffuser instead.
    body : (camera, row, column) whether a pixel shows the body.
    """

    tracers: Observation
    bubbles: Observation
    body: Bool


def separate_phases(case: Observation, largest_px: float) -> SeparatedPhases:
    """Separate bubbles, a body and tracers in every image of a frame.

    Parameters
    ----------
    largest_px : diameter of the largest bubble's image; what is dark and wider is the body.
    """
    black = np.float32(case.black_dn)
    light = case.images.astype(np.float32) - black
    white = case.white_dn - case.black_dn
    parts = [_separate(image, largest_px, white) for image in light]
    tracers, shadows, body = (np.stack(part) for part in zip(*parts, strict=True))
    return SeparatedPhases(
        replace(case, images=_grey(tracers + black, case)),
        replace(case, images=_grey(shadows + black, case)),
        np.asarray(body, dtype=np.bool_),
    )


def image_diameter_px(case: Observation, radius_mm: float) -> float:
    """Compute the largest image's diameter of a ball in the middle of the volume."""
    grid = case.grid
    middle = np.asarray(grid.low_mm) + np.asarray(grid.voxel_mm) * grid.shape[::-1] / 2.0
    ends = np.stack([middle, *(middle + radius_mm * np.eye(3))])
    pixels = [camera.project(ends)[0] for camera in case.cameras]
    return 2.0 * max(float(np.linalg.norm(image[1:] - image[0], axis=1).max()) for image in pixels)


def _separate(light: F32, largest_px: float, white: float) -> tuple[F32, F32, Bool]:
    """Separate one image above black; without a diffuser all light is of tracers."""
    diffuser, noise = _diffuser(light)
    if diffuser < DIM * white:
        return light, np.zeros_like(light), np.zeros(light.shape, dtype=np.bool_)
    opened = np.asarray(cv2.morphologyEx(light, cv2.MORPH_OPEN, _disc(SPOT_PX)), dtype=np.float32)
    peaks = light - opened
    above = light - cv2.medianBlur(light, 5) > _SIGMAS * noise  # few tracers fill five pixels
    body = _wide(opened < _DARK * diffuser, largest_px)
    bright = above & (body | (light > diffuser + _SIGMAS * noise))
    around = cv2.dilate(bright.astype(np.uint8), _disc(SPOT_PX)) > 0
    shadows = _filled(np.minimum(light, diffuser + noise), around)
    body = _wide(shadows < _DARK * diffuser, largest_px)
    shadows[cv2.dilate(body.astype(np.uint8), _disc(3)) > 0] = diffuser
    return np.where(around, np.maximum(peaks, 0.0), 0.0).astype(np.float32), shadows, body


def _diffuser(light: F32) -> tuple[float, float]:
    """Estimate the most frequent brightness, the diffuser's, and its noise."""
    values = np.sort(cv2.medianBlur(light, 3).ravel())
    width = len(values) // 5  # the shortest interval that holds a fifth of the pixels: its mode
    first = int(np.argmin(values[width:] - values[:-width]))
    mode = float(np.median(values[first : first + width]))
    below = light[(light < mode) & (light > 0.8 * mode)]
    return mode, float(np.sqrt(np.mean((below - mode) ** 2))) if len(below) else 1.0


def _filled(light: F32, holes: Bool) -> F32:
    """Fill pixels from those around them."""
    valid = (~holes).astype(np.float32)
    weight = cv2.GaussianBlur(valid, (0, 0), SPOT_PX / 2.0)
    mean = cv2.GaussianBlur(light * valid, (0, 0), SPOT_PX / 2.0) / np.maximum(weight, 1e-6)
    return np.asarray(np.where(holes, mean, light), dtype=np.float32)


def _wide(dark: Bool, largest_px: float) -> Bool:
    """Keep the dark regions that hold a disc wider than any bubble."""
    size = int(np.ceil(1.2 * largest_px)) | 1
    solid = cv2.morphologyEx(dark.astype(np.uint8), cv2.MORPH_CLOSE, _disc(5))
    cores = cv2.morphologyEx(solid, cv2.MORPH_OPEN, _disc(size))
    reach = cv2.dilate(cores, _disc(size))
    return np.asarray((reach > 0) & (solid > 0))


def _disc(size: int) -> U8:
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)))


def _grey(values: F32, case: Observation) -> U16:
    return np.clip(np.rint(values), 0.0, case.white_dn).astype(np.uint16)
