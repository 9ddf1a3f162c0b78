"""Points in closed bodies, and overlap of ellipsoids with others and bodies.

Two ellipsoids are tested exactly, by the contact function of Perram and Wertheim (J. Comput. Phys.
58, 409, 1985).
"""

import math
from typing import Any

import numpy as np

from sabench.api.truth import Bubbles, Solid
from sabench.utils.arrays import F64, I64, Bool
from sabench.utils.compiled import inner_kernel, numba
from sabench.utils.threads import on_cores


def contains(body: Solid, points_mm: F64) -> Bool:
    """Find which points (n, 3) a closed body contains.

    By the winding number: the signed count of faces that a line along z from the point crosses.
    The body is cut into slabs along y, so that few faces are tried for each point.
    """
    low, high = body.vertices_mm.min(axis=0), body.vertices_mm.max(axis=0)
    near = np.flatnonzero(((points_mm >= low) & (points_mm <= high)).all(axis=1))
    corners, points = body.vertices_mm[body.faces], points_mm[near]
    many = math.isqrt(len(corners))  # about as many as faces lie across a slab
    per_mm = many / max(high[1] - low[1], np.finfo(float).tiny)
    first, last, slab = (
        np.clip((y - low[1]) * per_mm, 0, many - 1).astype(np.int64)
        for y in (corners[..., 1].min(axis=1), corners[..., 1].max(axis=1), points[:, 1])
    )
    count = last - first + 1
    slabs = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count - first, count)
    order = np.argsort(slabs, kind="stable")
    starts = np.searchsorted(slabs[order], np.arange(many + 1))
    faces = np.repeat(np.arange(len(corners)), count)[order]
    winding = np.zeros(len(near), dtype=np.int64)
    on_cores(_wind, len(near), points, corners, faces, starts, slab, winding)
    out = np.zeros(len(points_mm), dtype=np.bool_)
    out[near] = winding != 0
    return out


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _wind(
    jobs: slice, points: Any, corners: Any, faces: Any, starts: Any, slab: Any, winding: Any
) -> None:
    for n in range(jobs.start, jobs.stop):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        for entry in range(starts[slab[n]], starts[slab[n] + 1]):
            face = corners[faces[entry]]
            turns = 0
            for k in range(3):
                i, j = k, (k + 1) % 3
                if (face[i, 1] > y) == (face[j, 1] > y):
                    continue
                # both faces at an edge compute the same crossing: from its lower end
                up = 1 if face[j, 1] > y else -1
                if up < 0:
                    i, j = j, i
                way = (y - face[i, 1]) / (face[j, 1] - face[i, 1])
                if face[i, 0] + way * (face[j, 0] - face[i, 0]) > x:
                    turns += up
            if turns:
                ax, ay = face[1, 0] - face[0, 0], face[1, 1] - face[0, 1]
                bx, by = face[2, 0] - face[0, 0], face[2, 1] - face[0, 1]
                px, py = x - face[0, 0], y - face[0, 1]
                along_z = (px * by - py * bx) * (face[1, 2] - face[0, 2])
                along_z += (ax * py - ay * px) * (face[2, 2] - face[0, 2])
                if face[0, 2] + along_z / (ax * by - ay * bx) > z:
                    winding[n] += turns


# what rounding leaves of the place of a maximum: the golden section ends there
_NARROWEST = np.sqrt(np.finfo(np.float64).eps)


def shapes_of(semi_axes_mm: F64, rotation: F64) -> F64:
    """Compute the inverses (n, 3, 3) of the ellipsoids' quadratic forms."""
    return np.asarray(np.einsum("nki,nk,nkj->nij", rotation, semi_axes_mm**2, rotation))


def overlapping(bubbles: Bubbles) -> I64:
    """Find pairs (k, 2) of overlapping bubbles, the larger one first."""
    from scipy.spatial import cKDTree

    if len(bubbles) < 2:
        return np.zeros((0, 2), dtype=np.int64)
    largest = bubbles.semi_axes_mm.max(axis=1)
    tree = cKDTree(bubbles.center_mm)
    pairs = tree.query_pairs(2.0 * float(np.median(largest)), output_type="ndarray").tolist()
    # large ones reach further than the median's pairs
    for i in np.flatnonzero(largest > np.median(largest)):
        near = tree.query_ball_point(bubbles.center_mm[i], largest[i] + largest.max())
        pairs.extend((i, j) for j in near if j != i)
    both = np.unique(np.sort(np.array(pairs, dtype=np.int64).reshape(-1, 2), axis=1), axis=0)
    shapes = shapes_of(bubbles.semi_axes_mm, bubbles.turn)
    (first, second), centers = both.T, bubbles.center_mm
    apart = contact(centers[first], shapes[first], centers[second], shapes[second])
    close = both[apart < 1.0 - 1e-9]
    return np.where((largest[close[:, 0]] >= largest[close[:, 1]])[:, None], close, close[:, ::-1])


def touching(bubbles: Bubbles, solid: Solid) -> Bool:
    """Find which bubbles (n,) a body's surface crosses, not those wholly inside."""
    out = np.zeros(len(bubbles), dtype=np.bool_)
    radius = bubbles.semi_axes_mm.max(axis=1)
    _touch(bubbles.center_mm, bubbles.to_ball, radius, solid.vertices_mm, solid.faces, out)
    return out


@numba.njit(cache=True, error_model="numpy")
def _touch(centers: Any, to_ball: Any, radius: Any, vertices: Any, faces: Any, out: Any) -> None:
    """Mark bubbles that a triangle touches.

    Where the bubble is a unit ball, the triangle then comes nearer than 1 to the origin.
    """
    corners = np.empty((3, 3))
    for n in range(len(centers)):
        for f in range(len(faces)):
            away, p, q, r = False, faces[f, 0], faces[f, 1], faces[f, 2]
            for axis in range(3):
                a, b, c = vertices[p, axis], vertices[q, axis], vertices[r, axis]
                away |= max(a, b, c) < centers[n, axis] - radius[n]
                away |= min(a, b, c) > centers[n, axis] + radius[n]
            if away:
                continue
            for k in range(3):
                for i in range(3):
                    corners[k, i] = 0.0
                    for j in range(3):
                        corners[k, i] += to_ball[n, i, j] * (
                            vertices[faces[f, k], j] - centers[n, j]
                        )
            if _nearest(corners) < 1.0:
                out[n] = True
                break


@inner_kernel(error_model="numpy")
def _nearest(t: Any) -> Any:
    """Compute the squared distance of a triangle (3, 3) from the origin."""
    best = np.inf
    u, v = t[1] - t[0], t[2] - t[0]
    uu, vv, uv = np.dot(u, u), np.dot(v, v), np.dot(u, v)
    pu, pv = -np.dot(t[0], u), -np.dot(t[0], v)
    determinant = uu * vv - uv * uv
    if determinant > 0.0:
        a, b = (vv * pu - uv * pv) / determinant, (uu * pv - uv * pu) / determinant
        if a >= 0.0 and b >= 0.0 and a + b <= 1.0:
            foot = t[0] + a * u + b * v
            return np.dot(foot, foot)
    for k in range(3):
        start, edge = t[k], t[(k + 1) % 3] - t[k]
        length = np.dot(edge, edge)
        part = min(max(-np.dot(start, edge) / length, 0.0), 1.0) if length > 0.0 else 0.0
        foot = start + part * edge
        best = min(best, np.dot(foot, foot))
    return best


def contact(center: F64, first: F64, other: F64, second: F64) -> F64:
    """Compute the squared factor (n,) that makes two ellipsoids touch.

    They grow about their centres; below 1 they overlap.

    Parameters
    ----------
    center, other : centres (n, 3).
    first, second : shape matrices (n, 3, 3), as from `shapes_of`.
    """
    out = np.empty(len(center))
    _contacts(center, first, other, second, out)
    return out


@numba.njit(cache=True, error_model="numpy")
def _contacts(center: Any, first: Any, other: Any, second: Any, out: Any) -> None:
    for n in range(len(out)):
        out[n] = contact_factor(center[n], first[n], other[n], second[n])


@inner_kernel(error_model="numpy")
def contact_factor(center: Any, first: Any, other: Any, second: Any) -> Any:
    """Maximise the contact function over x from 0 to 1.

    It is x (1 - x) r' ((1 - x) A + x B)^-1 r, which is concave in x.
    """
    ratio = 0.6180339887498949
    low, high = 0.0, 1.0
    a, b = high - ratio, ratio
    fa, fb = _at(a, center, first, other, second), _at(b, center, first, other, second)
    while high - low > _NARROWEST:
        if fa < fb:
            low, a, fa = a, b, fb
            b = low + ratio * (high - low)
            fb = _at(b, center, first, other, second)
        else:
            high, b, fb = b, a, fa
            a = high - ratio * (high - low)
            fa = _at(a, center, first, other, second)
    return max(fa, fb)


@inner_kernel(error_model="numpy")
def _at(x: float, center: Any, first: Any, other: Any, second: Any) -> Any:
    """Evaluate the contact function at one x, by Cramer's rule."""
    y, m = 1.0 - x, np.empty(6)
    for i in range(3):
        m[i] = y * first[i, i] + x * second[i, i]
    m[3] = y * first[0, 1] + x * second[0, 1]
    m[4] = y * first[0, 2] + x * second[0, 2]
    m[5] = y * first[1, 2] + x * second[1, 2]
    r0, r1, r2 = other[0] - center[0], other[1] - center[1], other[2] - center[2]
    c00, c11, c22 = m[1] * m[2] - m[5] * m[5], m[0] * m[2] - m[4] * m[4], m[0] * m[1] - m[3] * m[3]
    c01, c02, c12 = m[4] * m[5] - m[3] * m[2], m[3] * m[5] - m[4] * m[1], m[3] * m[4] - m[0] * m[5]
    determinant = m[0] * c00 + m[3] * c01 + m[4] * c02
    form = (
        r0 * r0 * c00
        + r1 * r1 * c11
        + r2 * r2 * c22
        + 2.0 * (r0 * r1 * c01 + r0 * r2 * c02 + r1 * r2 * c12)
    )
    return x * (1.0 - x) * form / determinant
