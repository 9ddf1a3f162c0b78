"""Hot pixels, glints and reflections that are added to finished images."""

import numpy as np

from sabench.api import Observation
from sabench.utils.arrays import F64, U16, Bool

HOT = 1e-3  # share of the pixels
_GLINTS, _SIGMA_PX = 4, (1.0, 2.0)
_PEAK = 5.0  # of a glint and of a reflection before they saturate, in full wells
_LENGTH, _WIDTH = 0.2, 0.012  # of the reflection, as parts of the diagonal
_VISIBLE = 0.02  # of the full well: less light counts as none


def static_light(shape: tuple[int, int], rng: np.random.Generator) -> F64:
    """Make the light (rows, columns) of four glints and a reflection, in full wells."""
    row, column = np.indices(shape, dtype=np.float64)
    light, diagonal = np.zeros(shape), float(np.hypot(*shape))
    for _ in range(_GLINTS):
        middle, sigma = rng.uniform(0.0, shape), rng.uniform(*_SIGMA_PX)
        square = (row - middle[0]) ** 2 + (column - middle[1]) ** 2
        light += _PEAK * np.exp(-square / (2.0 * sigma**2))
    middle, angle = rng.uniform(0.2, 0.8, 2) * shape, rng.uniform(0.0, np.pi)
    along = (column - middle[1]) * np.cos(angle) + (row - middle[0]) * np.sin(angle)
    across = (row - middle[0]) * np.cos(angle) - (column - middle[1]) * np.sin(angle)
    far = (np.abs(along) / (_LENGTH * diagonal / 2.0)) ** 8
    return np.asarray(light + _PEAK * np.exp(-far - (across / (_WIDTH * diagonal)) ** 2))


def covered_by(case: Observation, seed: int) -> Bool:
    """Mark the pixels (camera, row, column) that `add_flaws` of kind "all" covers with light."""
    shape = case.images.shape
    light = [static_light(shape[1:], np.random.default_rng([seed, c])) for c in range(shape[0])]
    return np.stack(light) > _VISIBLE


def add_flaws(case: Observation, kind: str, seed: int) -> U16:
    """Add flaws to a case's images: none for "clean", or "one", "each" or "all"."""
    images = case.images.astype(np.float64)
    for number, image in enumerate(images):
        rng = np.random.default_rng([seed, number])
        static = static_light(image.shape, rng)
        pixel = tuple(rng.integers(20, [side - 20 for side in image.shape]))
        if kind == "each" or (kind == "one" and number == 0):
            image[pixel] = case.white_dn
        if kind == "all":
            image += np.where(static > _VISIBLE / 10.0, static, 0.0) * (
                case.white_dn - case.black_dn
            )
            image[rng.random(image.shape) < HOT] = case.white_dn
    return np.asarray(np.rint(np.minimum(images, case.white_dn)), dtype=np.uint16)
