"""Images of a backlit scene as transmission.

Transmission is 1 where only the diffuser is seen, 0 where it is dark.
"""

from __future__ import annotations

import cv2
import numpy as np

from sabench.api import Observation
from sabench.utils.arrays import F32

_SHRINK = 4  # the background is smooth
_REACH = 121  # px: wider than any bubble
_DARKEST = 0.02  # of white: images that are darker everywhere show nothing


def transmission(case: Observation) -> F32:
    """Divide grey values less black by the diffuser's: (camera, row, column).

    An image that shows nothing becomes 1 everywhere. The diffuser's brightness is the smoothed
    maximum within a wide neighbourhood; a median filter first removes noise, which the maximum
    would follow.
    """
    out = np.ones(case.images.shape, dtype=np.float32)
    for image, made in zip(case.images, out, strict=True):
        light = image.astype(np.float32) - np.float32(case.black_dn)
        small = cv2.resize(
            cv2.medianBlur(light, 5),
            None,
            fx=1.0 / _SHRINK,
            fy=1.0 / _SHRINK,
            interpolation=cv2.INTER_AREA,
        )
        size = _REACH // _SHRINK | 1
        closed = cv2.morphologyEx(
            small, cv2.MORPH_CLOSE, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
        )
        ground = cv2.resize(
            cv2.GaussianBlur(closed, (0, 0), size / 3.0),
            light.shape[::-1],
            interpolation=cv2.INTER_LINEAR,
        )
        if float(ground.max()) <= _DARKEST * (case.white_dn - case.black_dn):
            continue
        np.divide(light, np.maximum(ground, _DARKEST * float(ground.max())), out=made)
        made /= (
            np.median(made[made > 0.8]) if (made > 0.8).any() else 1.0
        )  # the brightest of many noisy pixels is too bright
    return out
