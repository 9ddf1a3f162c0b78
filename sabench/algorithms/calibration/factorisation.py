"""Cameras and points from images alone, by projective factorisation.

Sources: P. Sturm and B. Triggs, ECCV 1996; R. Hartley and A. Zisserman, Multiple View Geometry,
section 19.3; T. Svoboda, D. Martinec and T. Pajdla, Presence 14, 2005.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from sabench.algorithms.calibration.bundle_adjustment import HARDLY, STEPS
from sabench.utils.arrays import F64, Bool
from sabench.utils.errors import InputError

_ROUNDS = 50
_FOCAL = 0.01  # weight of focal lengths against principal points and square pixels


@dataclass(frozen=True)
class Factors:
    """Matrices (camera, 3, 4) and points (n, 4); products are images."""

    matrices: F64
    points: F64

    def transform(self, frame: F64) -> Factors:
        """Express the factors in another frame (4, 4), with the same images."""
        return Factors(self.matrices @ frame, np.asarray(np.linalg.solve(frame, self.points.T).T))


def factorise(images: F64, seen: Bool) -> Factors:
    """Factorise images (camera, n, 2), scaled to about 1, into matrices and points.

    Images that are not `seen` (camera, n) are filled in from the others. The depths of all points
    start equal and follow from the product of rank 4 that is nearest.
    """
    cameras, count = seen.shape
    filled = np.where(seen[..., None], images, 0.0)
    if not seen.all():
        filled = _guess_unseen(filled, seen)
    homogeneous = np.concatenate([filled, np.ones((cameras, count, 1))], axis=2)
    depths = np.ones((cameras, count))
    for _ in range(_ROUNDS):
        depths = _balance(depths, homogeneous)
        table = (depths[..., None] * homogeneous).transpose(0, 2, 1).reshape(3 * cameras, count)
        left, values, right = np.linalg.svd(table, full_matrices=False)
        scaled = left[:, :4] * values[:4]
        product = (scaled @ right[:4]).reshape(cameras, 3, count).transpose(0, 2, 1)
        new = product[..., 2]
        image = product / np.where(np.abs(new) > 1e-12, new, 1.0)[..., None]
        homogeneous = np.where(seen[..., None], homogeneous, image)
        depths = new
    return Factors(np.asarray(scaled.reshape(cameras, 3, 4)), np.asarray(right[:4].T))


def adjust_factors(factors: Factors, images: F64, seen: Bool) -> Factors:
    """Minimise the images' squared errors over matrices and points.

    This is a projective bundle adjustment that finds the minimum near the given factors.
    Factorisation leaves an algebraic error and converges slowly; Levenberg and Marquardt's steps
    with eliminated points improve its result.
    """
    frame, ones = np.eye(4), np.ones(len(factors.points))
    frame[:, 3] = np.linalg.lstsq(factors.points, ones, rcond=None)[0]  # last coordinates near 1
    frame[:, :3] = np.linalg.svd(frame[None, :, 3])[2][1:].T
    matrices, points = _rescale(factors.matrices, factors.points, frame)
    cost, damping = _cost(matrices, points, images, seen), 1e-3
    for _ in range(STEPS):
        step = _projective_step(matrices, points, images, seen, damping)
        changed, moved = matrices + step[0], points + step[1]
        new = _cost(changed, moved, images, seen)
        gain, better = cost - new, new < cost
        if better:
            matrices = changed / np.linalg.norm(changed, axis=(1, 2), keepdims=True)
            points, cost = moved, new
        damping *= 0.1 if better else 10.0
        if (better and gain < HARDLY * cost) or damping > 1e9:
            break
    return Factors(matrices, np.column_stack([points, np.ones(len(points))]))


def _rescale(matrices: F64, points: F64, frame: F64) -> tuple[F64, F64]:
    """Rescale points (n, 3) to about 1 and matrices to norm 1, with the same images."""
    inner = points @ frame
    positions = inner[:, :3] / inner[:, 3:]
    middle, scale = positions.mean(axis=0), positions.std(axis=0)
    back = np.linalg.inv(frame.T)  # points = back @ inner
    unit = np.diag([*scale, 1.0])
    unit[:3, 3] = middle
    changed = matrices @ back @ unit
    changed = changed / np.linalg.norm(changed, axis=(1, 2), keepdims=True)
    return changed, (positions - middle) / scale


def _cost(matrices: F64, points: F64, images: F64, visible: Bool) -> float:
    miss = images - _images(matrices, points)[0]
    return float(np.sum(np.where(visible[..., None], miss, 0.0) ** 2))


def _images(matrices: F64, points: F64) -> tuple[F64, F64]:
    """Compute images (camera, n, 2) and their depths (camera, n)."""
    projected = np.einsum("cij,nj->cni", matrices[:, :, :3], points) + matrices[:, None, :, 3]
    return projected[..., :2] / projected[..., 2:], projected[..., 2]


def _projective_step(
    matrices: F64, points: F64, images: F64, visible: Bool, damping: float
) -> tuple[F64, F64]:
    cameras, count = visible.shape
    computed, depth = _images(matrices, points)
    miss = np.where(visible[..., None], images - computed, 0.0)
    rows = np.empty((cameras, count, 2, 3))  # derivatives of the image by the projected vector
    rows[..., :2], rows[..., 2] = np.eye(2), -computed
    rows = np.where(visible[..., None, None], rows / depth[..., None, None], 0.0)
    full = np.column_stack([points, np.ones(count)])
    by_matrix = np.einsum("cnki,nj->cnkij", rows, full).reshape(cameras, count, 2, 12)
    by_point = np.einsum("cnki,cij->cnkj", rows, matrices[:, :, :3])
    aa = np.einsum("cnkp,cnkq->cpq", by_matrix, by_matrix)
    aa[:, np.arange(12), np.arange(12)] *= 1.0 + damping
    aa += 1e-12 * np.trace(aa, axis1=1, axis2=2)[:, None, None] * np.eye(12)
    bb = np.einsum("cnkp,cnkq->npq", by_point, by_point)
    bb[:, np.arange(3), np.arange(3)] *= 1.0 + damping
    ab = np.einsum("cnkp,cnkq->cnpq", by_matrix, by_point)
    a, d = np.einsum("cnkp,cnk->cp", by_matrix, miss), np.einsum("cnkp,cnk->np", by_point, miss)
    inverse = np.linalg.inv(bb)
    eliminated = np.einsum("cnpq,nqr->cnpr", ab, inverse)
    whole = -np.einsum("cnpr,enqr->cpeq", eliminated, ab, optimize=True)
    whole[np.arange(cameras), :, np.arange(cameras)] += aa
    whole = whole.reshape(12 * cameras, 12 * cameras)
    right = (a - np.einsum("cnpr,nr->cp", eliminated, d)).ravel()
    change = np.linalg.solve(whole, right).reshape(cameras, 12)
    moved = np.einsum("npq,nq->np", inverse, d - np.einsum("cnpq,cp->nq", ab, change))
    return change.reshape(cameras, 3, 4), moved


def upgrade_to_euclidean(factors: Factors) -> Factors:
    """Find the frame, up to a similarity, that gives the cameras square pixels.

    Their principal point is at zero there and their focal length about 1.

    Sources: the dual absolute quadric (Hartley and Zisserman, section 19.3.1), with guessed focal
    lengths as M. Pollefeys et al. (IJCV 59, 2004) use them: cameras with axes that meet in one
    point, as in arrays around a volume, leave a family of quadrics open otherwise.

    Raises
    ------
    InputError
        Images that determine no such frame: refraction or noise is too strong, or the cameras
        are too similar.
    """
    rows = []
    for matrix in factors.matrices:
        square = [_product(row, row) for row in matrix]
        rows += [_product(*pair) for pair in itertools.combinations(matrix, 2)]
        rows.append(square[0] - square[1])
        rows += [_FOCAL * (square[0] - square[2]), _FOCAL * (square[1] - square[2])]
    quadric = np.zeros((4, 4))
    quadric[np.triu_indices(4)] = np.linalg.svd(np.stack(rows))[2][-1]
    quadric += np.triu(quadric, 1).T
    values, vectors = np.linalg.eigh(quadric)
    if np.sum(values) < 0.0:
        values, vectors = -values[::-1], vectors[:, ::-1]
    if values[1] <= 0.0:
        raise InputError(
            "expected images from which a Euclidean frame follows, got some that no pinholes "
            "with square pixels can have"
        )
    frame = np.column_stack([vectors[:, 1:] * np.sqrt(values[1:]), vectors[:, 0]])
    return _forward(factors.transform(frame))


def _guess_unseen(images: F64, visible: Bool) -> F64:
    """Guess unseen images as an affine product of rank 3 about the cameras' means."""
    count = np.maximum(visible.sum(axis=1), 1)[:, None, None]
    means = np.nansum(images * visible[..., None], axis=1, keepdims=True) / count
    filled = np.where(visible[..., None], images, means)
    for _ in range(_ROUNDS):
        table = (filled - means).transpose(0, 2, 1).reshape(-1, filled.shape[1])
        left, values, right = np.linalg.svd(table, full_matrices=False)
        product = ((left[:, :3] * values[:3]) @ right[:3]).reshape(len(filled), 2, -1)
        filled = np.where(visible[..., None], images, product.transpose(0, 2, 1) + means)
    return np.asarray(filled)


def _balance(depths: F64, homogeneous: F64) -> F64:
    """Scale depths so that every camera and every point has the same weight."""
    lengths = np.linalg.norm(homogeneous, axis=2)
    for _ in range(3):
        depths = depths / np.sqrt(np.mean((depths * lengths) ** 2, axis=0))
        depths = depths / np.sqrt(np.mean((depths * lengths) ** 2, axis=1))[:, None]
    return np.asarray(depths)


def _product(a: F64, b: F64) -> F64:
    """Compute coefficients of a^T Q b in the ten entries of a symmetric Q."""
    full = np.outer(a, b)
    return np.array(
        [full[i, j] + (full[j, i] if i != j else 0.0) for i in range(4) for j in range(i, 4)]
    )


def _forward(factors: Factors) -> Factors:
    """Mirror the factors if that puts the points in front of the cameras."""
    signs = np.sign(np.linalg.det(factors.matrices[:, :, :3]))
    matrices = factors.matrices * signs[:, None, None]
    ahead = np.einsum("cj,nj->cn", matrices[:, 2], factors.points / factors.points[:, 3:])
    if np.median(ahead) > 0.0:
        return Factors(matrices, factors.points)
    mirror = np.diag([-1.0, -1.0, -1.0, 1.0])
    return Factors(-matrices @ mirror, factors.points @ mirror)
