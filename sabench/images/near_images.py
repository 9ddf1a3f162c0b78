"""Search for particles with images near each other."""

import numpy as np

from sabench.utils.arrays import F64, I64


def near_images(pixels: F64, reach: F64) -> tuple[I64, I64]:
    """Find particles with images near each other in at least one camera.

    Returns where each particle's neighbours start in a list (n + 1,), and the list: in ascending
    order, without the particle itself.

    Parameters
    ----------
    pixels : (camera, n, 2) centres of images; NaN where there is none.
    reach : (camera,) largest distance of near images, px.
    """
    from scipy.spatial import cKDTree

    count, links = pixels.shape[1], [np.zeros(0, dtype=np.int64)]
    for image, far in zip(pixels, reach, strict=True):
        shown = np.flatnonzero(np.isfinite(image).all(axis=1))
        one, other = shown[cKDTree(image[shown]).query_pairs(far, output_type="ndarray")].T
        links += [one * count + other, other * count + one]
    each = np.unique(np.concatenate(links))
    starts = np.searchsorted(each, count * np.arange(count + 1)).astype(np.int64)
    return starts, each % max(count, 1)
