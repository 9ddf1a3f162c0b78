"""Images of a backlit scene as transmission, and the profiles of bubbles in them.

Transmission is 1 where only the diffuser is seen, 0 where it is dark. A profile is the transmission
over the distance from a bubble's centre, by ray optics, blurred by lens and pixels.

A ray that meets a ball at a part b of its radius is reflected, by pi - 2 asin(b), or goes through,
by 2 (asin(b n) - asin(b)), n being the index of the fluid over that of the ball; what is reflected
inside is too little to be seen. A ray carries the diffuser's light if it leaves within the
diffuser's half angle of its direction, and no light otherwise. The rim is dark where light that
goes through is bent too far and light that is reflected not far enough.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.special import i0e

from sabench.api import Observation
from sabench.geometry.grid import REACH
from sabench.utils.arrays import F32, F64

_SOFT = 0.15  # of the diffuser's half angle: it is not round, and not seen from its axis
_SAMPLES = 160  # of the sharp profile, and of radii and distances in the table
SMALLEST, LARGEST = 0.4, 60.0  # px
DIM = 0.02  # of white, or of the diffuser: what is darker is as good as black


def sharp(b: F64, index: float, half_angle: float) -> F64:
    """Compute transmission (n,) at parts b (n,) of a ball's radius.

    Parameters
    ----------
    index : of the ball over that of the fluid.
    half_angle : of the diffuser as seen from the ball in the fluid, rad.
    """
    b = np.asarray(b, dtype=np.float64)
    inside = np.clip(b, 0.0, 1.0 - 1e-12)
    incident = np.arcsin(inside)
    sine = inside / index
    total = sine >= 1.0
    refracted = np.arcsin(np.where(total, 0.0, sine))
    part = np.where(total, 1.0, reflectance(incident, refracted, index))
    light = part * _diffuser_share(np.pi - 2.0 * incident, half_angle)
    light += (1.0 - part) ** 2 * _diffuser_share(2.0 * (refracted - incident), half_angle)
    return np.where(b >= 1.0, 1.0, light)


def reflectance(incident: F64, refracted: F64, index: float) -> F64:
    """Compute Fresnel's reflectance of light without polarisation, from the angles.

    The same law as `geometry.refraction.transmittance`, tied to it by
    test_projection_copies.py::test_bubbles_reflect_as_walls_do.
    """
    a, c = np.cos(incident), np.cos(refracted)
    across, along = (a - index * c) / (a + index * c), (c - index * a) / (c + index * a)
    return np.asarray(0.5 * (across**2 + along**2))


def _diffuser_share(angle: F64, half_angle: float) -> F64:
    """Compute the share of the light turned by an angle that is diffuser's."""
    away = np.abs((angle + np.pi) % (2.0 * np.pi) - np.pi)
    share = (half_angle * (1.0 + _SOFT) - away) / (2.0 * _SOFT * half_angle)
    return np.asarray(np.clip(share, 0.0, 1.0))


@dataclass(frozen=True)
class Profile:
    """Blurred transmission at geometric radii (rows) and uniform distances (columns)."""

    table: F32
    blur_px: float

    @classmethod
    @functools.lru_cache(maxsize=64)  # the same for every frame
    def tabulate(cls, index: float, half_angle: float, blur_px: float) -> Profile:
        """Tabulate blurred balls of a relative index in front of a diffuser's half angle."""
        parts = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
        dark = _blur_weights(blur_px) @ (1.0 - sharp(parts, index, half_angle))
        table = (1.0 - dark).astype(np.float32)
        table.flags.writeable = False
        return cls(table, blur_px)

    def __call__(self, distance: F64, radius_px: float) -> F64:
        """Interpolate transmission at distances (n,) in px from the centre of a ball."""
        position = np.log(radius_px / SMALLEST) / np.log(LARGEST / SMALLEST) * (_SAMPLES - 1)
        low = int(np.clip(np.floor(position), 0, _SAMPLES - 2))
        row = self.table[low] * (low + 1 - position) + self.table[low + 1] * (position - low)
        part = distance / (radius_px + REACH * self.blur_px)
        return np.asarray(np.interp(part, np.linspace(0.0, 1.0, _SAMPLES), row, right=1.0))


@functools.lru_cache(maxsize=1)  # 33 MB, and the same for all half angles
def _blur_weights(blur_px: float) -> F64:
    """Compute how much of a ball's ring reaches a distance: (radius, distance, ring)."""
    weights = np.empty((_SAMPLES,) * 3)
    radii = np.geomspace(SMALLEST, LARGEST, _SAMPLES)
    for weight, radius in zip(weights, radii, strict=True):
        step = radius / _SAMPLES
        middle = (np.arange(_SAMPLES) + 0.5) * step
        distance = np.linspace(0.0, 1.0, _SAMPLES)[:, None] * (radius + REACH * blur_px)
        near = np.exp(-((distance - middle) ** 2) / (2.0 * blur_px**2))
        weight[:] = near * i0e(distance * middle / blur_px**2) * middle * step / blur_px**2
    return weights


def transmission(case: Observation) -> F32:
    """Divide grey values less black by the diffuser's: (camera, row, column).

    An image that shows nothing becomes 1 everywhere. The diffuser's brightness is the smoothed
    maximum within a square wider than any bubble; a median filter first removes noise, which the
    maximum would follow.
    """
    out = np.ones(case.images.shape, dtype=np.float32)
    size = int(2.0 * LARGEST) | 1
    square = np.ones((size, size), dtype=np.uint8)
    for image, relative in zip(case.images, out, strict=True):
        light = image.astype(np.float32) - np.float32(case.black_dn)
        median = cv2.medianBlur(light, 5)
        closed = cv2.morphologyEx(median, cv2.MORPH_CLOSE, square)
        ground = cv2.GaussianBlur(closed, (0, 0), size / 3.0)
        if float(ground.max()) <= DIM * (case.white_dn - case.black_dn):
            continue
        np.divide(light, np.maximum(ground, DIM * float(ground.max())), out=relative)
        # the brightest of many noisy pixels is too bright
        relative /= np.median(relative[relative > 0.8]) if (relative > 0.8).any() else 1.0
    return out
