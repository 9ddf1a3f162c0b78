"""Search for particles with images near each other."""

from typing import Any

import numpy as np

from sabench.utils.arrays import F64, I64
from sabench.utils.compiled import numba
from sabench.utils.threads import share_rows

_CELLS = 4  # of a camera's grid for each particle
_FEW = 1.0  # percent of images on each side that may be far from all others


def near_images(pixels: F64, reach: F64) -> tuple[I64, I64]:
    """Find particles with images near each other in at least one camera.

    Returns where each particle's neighbours start in a list (n + 1,), and the list: in ascending
    order, without the particle itself.

    Parameters
    ----------
    pixels : (camera, n, 2) centres of images; NaN where there is none.
    reach : (camera,) largest distance of near images, px.
    """
    count = pixels.shape[1]
    if not count:
        return np.zeros(1, dtype=np.int64), np.zeros(0, dtype=np.int64)
    grids = [_grid(image, float(far)) for image, far in zip(pixels, reach, strict=True)]
    cells = np.stack([cell for cell, _, _ in grids])
    columns = np.array([width for _, width, _ in grids])
    rows = np.array([height for _, _, height in grids])
    # those without an image first; then where each cell's particles start
    order = np.argsort(cells, axis=1, kind="stable")
    every = np.arange(int((columns * rows).max()) + 1)
    starts = np.stack([np.searchsorted(c[o], every) for c, o in zip(cells, order, strict=True)])
    grid = cells, columns, rows, starts, order
    parts = share_rows(lambda part: _gather(part.start, part.stop, pixels, reach, *grid), count)
    first = np.concatenate([[0], *(counts for counts, _ in parts)])
    return np.cumsum(first).astype(np.int64), np.concatenate([near for _, near in parts])


def _grid(pixels: F64, reach: float) -> tuple[I64, int, int]:
    """Assign images (n, 2) to cells at least as wide as the reach; count cells.

    The cell of an image is -1 if it has none.
    """
    finite = np.isfinite(pixels).all(axis=1)
    if not finite.any():
        return np.full(len(pixels), -1), 1, 1
    low, high = np.percentile(pixels[finite], [_FEW, 100.0 - _FEW], axis=0)
    edge = max(reach, float(np.sqrt(np.prod(high - low) / (_CELLS * len(pixels)))))
    last = np.minimum((high - low) / edge, _CELLS * len(pixels)).astype(np.int64)
    # those beyond the grid are in its last cells: what is near stays in the next cell or nearer
    column, row = np.clip((pixels[finite] - low) / edge, 0, last).astype(np.int64).T
    width, height = last + 1
    cell = np.full(len(pixels), -1)
    cell[finite] = row * width + column
    return cell, int(width), int(height)


@numba.njit(cache=True, nogil=True)
def _gather(
    first: int,
    last: int,
    pixels: Any,
    reach: Any,
    cells: Any,
    columns: Any,
    rows: Any,
    starts: Any,
    order: Any,
) -> Any:
    """Return the numbers of neighbours of some particles, and the neighbours."""
    counts, near, total = np.zeros(last - first, dtype=np.int64), np.zeros(64, dtype=np.int64), 0
    listed = np.full(cells.shape[1], -1)
    for n in range(first, last):
        begun = total
        listed[n] = n
        for c in range(len(cells)):
            if cells[c, n] < 0:
                continue
            row, column = cells[c, n] // columns[c], cells[c, n] % columns[c]
            for i in range(max(row - 1, 0), min(row + 2, rows[c])):
                left = i * columns[c] + max(column - 1, 0)
                right = i * columns[c] + min(column + 2, columns[c])
                for place in range(starts[c, left], starts[c, right]):
                    other = order[c, place]
                    x = pixels[c, other, 0] - pixels[c, n, 0]
                    y = pixels[c, other, 1] - pixels[c, n, 1]
                    if listed[other] != n and x * x + y * y <= reach[c] * reach[c]:
                        listed[other] = n
                        if total == len(near):
                            near = np.concatenate((near, np.zeros_like(near)))
                        near[total] = other
                        total += 1
        near[begun:total].sort()
        counts[n - first] = total - begun
    return counts, near[:total]
