"""Light on the sensor that does not come from the volume."""

from __future__ import annotations

import numpy as np

from sabench.scenes.illumination import Background
from sabench.utils.arrays import F64

_WAVES = 3  # of the smooth light along either axis
_REACH = 6.0  # standard deviations of a glint beyond which it is dark
_LEAST_FLICKER = 0.05  # of the mean: light does not become negative


def static_light(background: Background, shape: tuple[int, int], rng: np.random.Generator) -> F64:
    """Make the light (row, column) of one camera, in fractions of the full well.

    Smooth light is a sum of cosines, glints are Gaussians and dust is uniform discs, all at random
    positions.
    """
    weights, phases = rng.standard_normal((_WAVES,) * 2), rng.uniform(0.0, np.pi, (2, _WAVES))
    down, across = (
        np.cos(np.pi * np.arange(_WAVES)[:, None] * np.arange(size) / size + phase[:, None])
        for size, phase in zip(shape, phases, strict=True)
    )
    field = np.einsum("ij,ir,jc->rc", weights, down, across)
    field -= field.mean()
    field *= background.variation / np.abs(field).max(initial=1e-300)
    light = np.asarray((background.level or 0.0) * (1.0 + field))
    for _ in range(background.glints):
        middle, sigma = rng.uniform(0.0, shape), rng.uniform(*background.glint_sigma_px)
        window, square = _around(middle, _REACH * sigma, shape)
        light[window] += background.glint_level * np.exp(-square / (2.0 * sigma**2))
    for _ in range(background.dust):
        middle, level = rng.uniform(0.0, shape), rng.uniform(0.0, background.dust_level)
        window, square = _around(middle, background.dust_radius_px + 1.0, shape)
        light[window] += level * np.clip(background.dust_radius_px - np.sqrt(square) + 0.5, 0, 1)
    return light


def flicker(background: Background, rng: np.random.Generator) -> float:
    """Draw the factor of a frame.

    It is the same for all cameras, since the laser's pulses differ.
    """
    return max(1.0 + (background.flicker or 0.0) * rng.standard_normal(), _LEAST_FLICKER)


def _around(middle: F64, radius: float, shape: tuple[int, int]) -> tuple[tuple[slice, slice], F64]:
    """Cut the window of a radius around a point.

    Also returns the squared distances (row, column) in it.
    """
    low = np.clip(np.floor(middle - radius), 0, shape).astype(int)
    high = np.clip(np.ceil(middle + radius) + 1, 0, shape).astype(int)
    row, column = (np.arange(a, b) for a, b in zip(low, high, strict=True))
    window = slice(low[0], high[0]), slice(low[1], high[1])
    return window, (row[:, None] - middle[0]) ** 2 + (column - middle[1]) ** 2
