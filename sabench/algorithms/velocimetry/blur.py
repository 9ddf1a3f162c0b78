"""Blur of volumes, so that splines can resolve the particles between voxels."""

from __future__ import annotations

import math

import cv2
import numpy as np

from sabench.utils.arrays import F32

Widths = tuple[float, float, float]
_REACH = 3.0  # standard deviations of a Gaussian that count


def widths(volume: F32) -> Widths:
    """Estimate the particles' widths (z, y, x) in voxels as Gaussian sigmas.

    The estimate uses the volume's autocorrelation at a shift of one voxel: randomly placed
    Gaussians are correlated like exp(-s^2 / (4 sigma^2)) over a shift s.
    """
    mean, total = float(volume.mean(dtype=np.float64)), _inner(volume, volume)
    z, y, x = (
        _width(_inner(one, other) / one.size - mean**2, total / volume.size - mean**2)
        if one.size
        else math.inf  # a single voxel along this axis
        for one, other in (
            (volume[1:], volume[:-1]),
            (volume[:, 1:], volume[:, :-1]),
            (volume[..., 1:], volume[..., :-1]),
        )
    )
    return z, y, x


def _inner(one: F32, other: F32) -> float:
    return math.fsum(float(np.einsum("yx,yx->", a, b)) for a, b in zip(one, other, strict=True))


def _width(shifted: float, own: float) -> float:
    if own <= 0.0 or shifted >= own:
        return math.inf  # it does not change from one voxel to the next
    return 0.5 / math.sqrt(-math.log(max(shifted / own, 1e-6)))


def widen(volume: F32, given: Widths, least: float) -> F32:
    """Blur the volume (z, y, x) where its particles are too narrow.

    A Gaussian along every such axis raises the given widths to the least one.
    """
    sigma = [math.sqrt(max(0.0, least**2 - own**2)) for own in given]
    if not any(sigma):
        return volume
    out = _blur(volume.reshape(len(volume), -1), sigma[0], 0.0).reshape(volume.shape)
    return np.stack([_blur(plane, sigma[1], sigma[2]) for plane in out])


def _blur(plane: F32, down: float, across: float) -> F32:
    """Blur a plane by a Gaussian down its columns and across its rows."""
    kernels = [_kernel(sigma) for sigma in (across, down)]
    return np.asarray(
        cv2.sepFilter2D(
            plane, cv2.CV_32F, kernels[0], kernels[1], borderType=cv2.BORDER_REFLECT_101
        )
    )


def _kernel(sigma: float) -> F32:
    offsets = np.arange(-math.ceil(_REACH * sigma), math.ceil(_REACH * sigma) + 1)
    weights = np.exp(-0.5 * (offsets / max(sigma, 1e-9)) ** 2)
    return np.asarray(weights / weights.sum(), dtype=np.float32)
