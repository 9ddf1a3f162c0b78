"""Cramer-Rao bounds of positions, in NumPy where numba is not installed.

The same bounds as `position_bounds`, by other means: windows of images by broadcasting, pairs by
trees, and the information of what is fitted beside each particle by a dense solution in place of
conjugate gradients, which stop at 1e-4 of it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from sabench.images.gaussians import gaussian_profiles
from sabench.images.particle_spots import (
    IMAGE_REACH,
    KNOWN,
    OVERLAP,
    SINGULAR,
    UNKNOWNS,
    ParticleSpots,
    where_seen,
)
from sabench.utils.arrays import F64, I64

_AT_ONCE = 4096  # pairs whose windows are held at a time
# which of the profiles (light, slope) an image's derivatives by column, row and light consist of
_ACROSS, _DOWN = np.array([1, 0, 0]), np.array([0, 1, 0])


def position_bounds(cameras: Sequence[ParticleSpots], rows: I64) -> F64:
    """Compute the least covariances (k, 3, 3) mm2 of some unbiased positions.

    NaN where the images do not fix the position. Source and arguments as for
    `position_bounds.position_bounds`.
    """
    pixels = [where_seen(camera) for camera in cameras]
    count = len(pixels[0])
    near = [
        _pairs(pixel, 2.0 * OVERLAP * float(camera.sigma_px.max(initial=0.0)))
        for camera, pixel in zip(cameras, pixels, strict=True)
    ]
    pairs = np.unique(np.concatenate([np.zeros((0, 2), dtype=np.int64), *near]), axis=0)
    own = np.zeros((count, UNKNOWNS, UNKNOWNS))
    both = np.zeros((len(pairs), UNKNOWNS, UNKNOWNS))
    alone = np.repeat(np.arange(count)[:, None], 2, axis=1)
    for camera, pixel in zip(cameras, pixels, strict=True):
        _add_information(camera, pixel, alone, own)
        _add_information(camera, pixel, pairs, both)
    known = own + np.eye(UNKNOWNS) * (KNOWN * own + np.finfo(float).tiny)
    links = _links(pairs, count)
    rests = [_rest(int(row), own, known, both, links) for row in rows]
    return _inverses(np.array(rests).reshape(-1, UNKNOWNS, UNKNOWNS))


def _pairs(pixel: F64, reach: float) -> I64:
    """List pairs (m, 2) of rows of near images (n, 2), the lower one first."""
    seen = np.flatnonzero(np.isfinite(pixel[:, 0]))
    found = cKDTree(pixel[seen]).query_pairs(reach, output_type="ndarray") if len(seen) else []
    return np.sort(seen[np.asarray(found, dtype=np.int64).reshape(-1, 2)], axis=1)


def _links(pairs: I64, count: int) -> csr_array:
    """Make the matrix (n, n) of pairs' numbers from 1 on.

    They are negative in its lower half.
    """
    number = np.arange(1, len(pairs) + 1)
    places = np.concatenate([pairs, pairs[:, ::-1]]).T
    return csr_array((np.concatenate([number, -number]), tuple(places)), shape=(count, count))


def _add_information(camera: ParticleSpots, pixel: F64, pairs: I64, blocks: F64) -> None:
    """Add the information (m, 4, 4) of pairs that overlap in a camera."""
    i, j = pairs.T
    apart = np.hypot(*(pixel[i] - pixel[j]).T)
    with np.errstate(invalid="ignore"):
        overlap = apart < OVERLAP * (camera.sigma_px[i] + camera.sigma_px[j])
    rows = np.flatnonzero(overlap & (np.isfinite(apart)))
    seen = np.where(np.isfinite(pixel[:, 0]), camera.sigma_px, 0.0)
    half = np.ceil(IMAGE_REACH * seen + 0.5).astype(np.int64)
    for begin in range(0, len(rows), _AT_ONCE):
        some = rows[begin : begin + _AT_ONCE]
        blocks[some] += _blocks(camera, pixel, half, i[some], j[some])


def _blocks(camera: ParticleSpots, pixel: F64, half: I64, i: I64, j: I64) -> F64:
    """Compute the Fisher information (m, 4, 4) of pairs.

    Its unknowns are the logarithm of the light, and the position. Windows of images reach `half`
    pixels from the centre's.
    """
    first = np.rint(pixel[i]).astype(np.int64) - half[i, None]
    size = 2 * int(half[i].max()) + 1
    one, other = (
        [_profiles(camera, pixel, half, rows, axis, first[:, axis], size) for axis in (0, 1)]
        for rows in (i, j)
    )
    places = [first[:, axis, None] + np.arange(size) for axis in (0, 1)]
    limits = camera.variance.shape[::-1]
    inside = [(at >= 0) & (at < limit) for at, limit in zip(places, limits, strict=True)]
    x, y = (np.clip(at, 0, limit - 1) for at, limit in zip(places, limits, strict=True))
    weight = 1.0 / camera.variance[y[:, :, None], x[:, None]]
    weight *= inside[1][:, :, None] & inside[0][:, None]
    along = np.einsum("myx,max,mbx->myab", weight, one[0], other[0], optimize=True)
    all_ = np.einsum("myab,mcy,mdy->mabcd", along, one[1], other[1], optimize=True)
    inner = all_[:, _ACROSS[:, None], _ACROSS, _DOWN[:, None], _DOWN]
    inner *= (camera.light[i] * camera.light[j])[:, None, None]
    by_i, by_j = _by_position(camera, i), _by_position(camera, j)
    return np.asarray(by_i.transpose(0, 2, 1) @ inner @ by_j)


def _profiles(
    camera: ParticleSpots, pixel: F64, half: I64, rows: I64, axis: int, first: I64, size: int
) -> F64:
    """Compute profiles and slopes (m, 2, size) in others' windows."""
    profiles = gaussian_profiles(pixel[rows, axis], camera.sigma_px[rows, None], first, size)
    at = first[:, None] + np.arange(size) - np.rint(pixel[rows, axis, None])
    return np.asarray(np.stack(profiles, axis=1) * (np.abs(at) <= half[rows, None])[:, None])


def _by_position(camera: ParticleSpots, rows: I64) -> F64:
    """Differentiate column, row and logarithm of the light (m, 3, 4) by the unknowns."""
    by = np.zeros((len(rows), 3, UNKNOWNS))
    by[:, :2, 1:] = camera.slope[rows]
    by[:, 2, 0] = 1.0
    return by


def _rest(row: int, own: F64, known: F64, both: F64, links: csr_array) -> F64:
    """Compute a particle's information (4, 4) if its partners are fitted.

    It is the Schur complement.
    """
    ends = slice(links.indptr[row], links.indptr[row + 1])
    partners = links.indices[ends]
    if not len(partners):
        return np.asarray(own[row])
    among = links[partners][:, partners].tocoo()
    every = np.zeros((len(partners), UNKNOWNS, len(partners), UNKNOWNS))
    every[among.row, :, among.col] = _numbered(both, among.data)
    each = np.arange(len(partners))
    every[each, :, each] = known[partners]
    matrix = every.reshape(UNKNOWNS * len(partners), -1)
    shared = _numbered(both, links.data[ends]).transpose(1, 0, 2).reshape(UNKNOWNS, -1)
    scale = np.sqrt(np.diag(matrix))
    even, right = matrix / scale[:, None] / scale, (shared / scale).T
    return np.asarray(own[row] - right.T @ np.linalg.solve(even, right))


def _numbered(both: F64, numbers: I64) -> F64:
    """Return blocks of pairs by their numbers, transposed for negative ones."""
    blocks = both[np.abs(numbers) - 1]
    return np.asarray(np.where(numbers[:, None, None] > 0, blocks, blocks.transpose(0, 2, 1)))


def _inverses(rests: F64) -> F64:
    """Return covariances (k, 3, 3) of positions.

    NaN where the information is singular.
    """
    out = np.full((len(rests), 3, 3), np.nan)
    scale = np.sqrt(np.maximum(np.diagonal(rests, axis1=1, axis2=2), 0.0))
    rows = np.flatnonzero((scale > 0.0).all(axis=1))
    scale = scale[rows]
    even = rests[rows] / scale[:, :, None] / scale[:, None]
    even = 0.5 * (even + even.transpose(0, 2, 1))
    good = np.linalg.eigvalsh(even)[:, 0] > SINGULAR
    inverse = np.linalg.inv(even[good]) / scale[good, :, None] / scale[good, None]
    out[rows[good]] = inverse[:, 1:, 1:]
    return out
