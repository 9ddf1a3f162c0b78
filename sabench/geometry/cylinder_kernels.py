"""Kernels of light through coaxial cylinders.

They work in a pinhole's own frame: x points from the pinhole to the axis, at right angles to it; z
along the axis; the origin is the point of the outer face nearest to the pinhole. A face of radius r
at the depth t is there the curve c (X^2 + y^2) = 2 X with X = x - t and c = 1 / r. This form stays
exact for any radius, and at c = 0 it is a plane.
"""

import math
from typing import Any

import numpy as np

from sabench.geometry.refraction import NEWTON
from sabench.utils.compiled import inner_kernel, numba

_LONGEST = 0.3  # rad: of one step
_MISS = 1e-12  # of the distance from the pinhole: largest miss of a path that counts as found


@numba.njit(cache=True, inline="always", error_model="numpy")
def _cross(
    face: Any, ratio: float, at: Any, along: Any, moved: Any, turned: Any
) -> tuple[float, float, float]:
    """Move a ray to a face and refract it, with its derivatives by two variables.

    Parameters
    ----------
    face : (curvature, depth).
    ratio : index before the face over that behind it.
    at, along : (3,) position and unit direction, replaced.
    moved, turned : (2, 3) their derivatives, replaced.

    Returns length of the way to the face, cosines before and behind it; cosine 0 before: no
    crossing.
    """
    c, x, y = face[0], at[0] - face[1], at[1]
    across = along[0] * along[0] + along[1] * along[1]
    towards = along[0] - c * (x * along[0] + y * along[1])
    outside = c * (x * x + y * y) - 2.0 * x
    square = towards * towards - c * outside * across
    if not (square > 0.0 and towards > 0.0):
        return 0.0, 0.0, 0.0
    cosine = math.sqrt(square)
    length = outside / (towards + cosine)
    for k in range(3):
        at[k] += length * along[k]
    nx, ny = 1.0 - c * (at[0] - face[1]), -c * at[1]
    behind = 1.0 - ratio * ratio * (1.0 - square)
    if not behind > 0.0:
        return length, 0.0, 0.0
    behind = math.sqrt(behind)
    bend = behind - ratio * cosine
    for i in range(2):
        for k in range(3):
            moved[i, k] += length * turned[i, k]
        more = -(nx * moved[i, 0] + ny * moved[i, 1]) / cosine
        for k in range(3):
            moved[i, k] += more * along[k]
        slope_x, slope_y = -c * moved[i, 0], -c * moved[i, 1]
        change = turned[i, 0] * nx + turned[i, 1] * ny + along[0] * slope_x + along[1] * slope_y
        swing = ratio * ratio * cosine * change / behind - ratio * change
        turned[i, 0] = ratio * turned[i, 0] + swing * nx + bend * slope_x
        turned[i, 1] = ratio * turned[i, 1] + swing * ny + bend * slope_y
        turned[i, 2] = ratio * turned[i, 2]
    along[0] = ratio * along[0] + bend * nx
    along[1] = ratio * along[1] + bend * ny
    along[2] = ratio * along[2]
    return length, cosine, behind


@numba.njit(cache=True, inline="always", error_model="numpy")
def _reflected(before: float, behind: float, cosine: float, cosine_behind: float) -> float:
    s = (before * cosine - behind * cosine_behind) / (before * cosine + behind * cosine_behind)
    p = (behind * cosine - before * cosine_behind) / (behind * cosine + before * cosine_behind)
    return 0.5 * (s * s + p * p)


@numba.njit(cache=True, error_model="numpy")
def follow(
    gap: float, faces: Any, indices: Any, along: Any, ends: Any, length: Any, passed: Any
) -> Any:
    """Follow rays from a pinhole into the fluid.

    Parameters
    ----------
    gap : distance of the pinhole from the outer face.
    faces : (m, 2) curvature and depth of each.
    indices : (m + 1,) of the media.
    along : (n, 3) unit directions at the pinhole; replaced by those in the fluid.
    ends : (n, 3) filled with positions on the inner face.
    length : (n,) filled with lengths up to there.
    passed : (n,) filled with the share of light that no face reflects.

    Returns (n,) whether the ray reaches the fluid.
    """
    valid = np.ones(len(along), dtype=np.bool_)
    moved, turned = np.zeros((2, 3)), np.zeros((2, 3))
    for n in range(len(along)):
        ends[n, 0], ends[n, 1], ends[n, 2] = -gap, 0.0, 0.0
        length[n], passed[n] = 0.0, 1.0
        for m in range(len(faces)):
            way, cosine, behind = _cross(
                faces[m], indices[m] / indices[m + 1], ends[n], along[n], moved, turned
            )
            if cosine == 0.0:
                valid[n] = False
                break
            length[n] += way
            passed[n] *= 1.0 - _reflected(indices[m], indices[m + 1], cosine, behind)
    return valid


@inner_kernel(error_model="numpy")
def _aim(
    gap: float, faces: Any, indices: Any, start: Any, point: Any, rays: Any, steps: Any
) -> tuple[float, float]:
    """Follow one ray and find how to turn it towards a point.

    Parameters
    ----------
    start : (3,) unit direction at the pinhole.
    rays : (8, 3) filled: position and direction in the fluid, derivatives of both, and the unit
        vectors across the start that these are by.
    steps : (3,) filled with the change of the start that brings the ray to the point.

    Returns distance by which the ray misses the point, and the area that a bundle of rays covers
    there: negative behind a caustic. A ray that does not come near has an infinite miss.
    """
    at, along, moved, turned = rays[0], rays[1], rays[2:4], rays[4:6]
    at[0], at[1], at[2] = -gap, 0.0, 0.0
    along[0], along[1], along[2] = start[0], start[1], start[2]
    moved[:] = 0.0
    flat = math.hypot(start[0], start[1])  # two unit vectors across the ray, right-handed
    turned[0, 0], turned[0, 1], turned[0, 2] = -start[1] / flat, start[0] / flat, 0.0
    turned[1, 0], turned[1, 1] = -start[2] * start[0] / flat, -start[2] * start[1] / flat
    turned[1, 2] = flat
    for k in range(3):
        rays[6, k], rays[7, k] = turned[0, k], turned[1, k]
    for m in range(len(faces)):
        if _cross(faces[m], indices[m] / indices[m + 1], at, along, moved, turned)[1] == 0.0:
            return math.inf, 0.0
    way = 0.0
    for k in range(3):
        way += (point[k] - at[k]) * along[k]
    if not way >= 0.0:
        return math.inf, 0.0
    aa = ab = bb = ea = eb = square = 0.0
    along_a = along_b = 0.0
    for k in range(3):
        moved[0, k] += way * turned[0, k]
        moved[1, k] += way * turned[1, k]
        along_a += moved[0, k] * along[k]
        along_b += moved[1, k] * along[k]
    for k in range(3):
        moved[0, k] -= along_a * along[k]
        moved[1, k] -= along_b * along[k]
        miss = point[k] - at[k] - way * along[k]
        square += miss * miss
        aa += moved[0, k] * moved[0, k]
        ab += moved[0, k] * moved[1, k]
        bb += moved[1, k] * moved[1, k]
        ea += moved[0, k] * miss
        eb += moved[1, k] * miss
    determinant = aa * bb - ab * ab
    first, second = (bb * ea - ab * eb) / determinant, (aa * eb - ab * ea) / determinant
    for k in range(3):
        steps[k] = first * rays[6, k] + second * rays[7, k]
    area = 0.0
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        area += along[k] * (moved[0, i] * moved[1, j] - moved[0, j] * moved[1, i])
    return math.sqrt(square), area


@numba.njit(cache=True, error_model="numpy")
def find_light_paths(
    gap: float, faces: Any, indices: Any, points: Any, leaving: Any, arriving: Any
) -> Any:
    """Find light paths from a pinhole to points (n, 3) in the fluid.

    Newton's iteration for the direction at the pinhole, two unknowns, with the exact derivatives of
    the ray. It starts on the straight line to the point; a step that brings the ray no nearer is
    halved.

    Parameters
    ----------
    leaving, arriving : (n, 3) filled with unit directions at the pinhole and in the fluid.

    Returns (n,) whether there is such a path. A path behind a caustic does not count: there another
    one leads to the same point.
    """
    valid = np.zeros(len(points), dtype=np.bool_)
    work = np.zeros((11, 3))
    for n in range(len(points)):
        valid[n] = _solve(gap, faces, indices, points[n], work, leaving[n], arriving[n])
    return valid


@inner_kernel(error_model="numpy")
def _solve(
    gap: float, faces: Any, indices: Any, point: Any, work: Any, leaving: Any, arriving: Any
) -> bool:
    """Find the path to one point (3,); `work` is (11, 3), to be used freely."""
    trial, steps, change, rays = work[0], work[1], work[2], work[3:11]
    trial[0], trial[1], trial[2] = point[0] + gap, point[1], point[2]
    far = _normalise(trial)
    best, area, share = math.inf, 0.0, 1.0
    for _ in range(NEWTON):
        miss, covered = _aim(gap, faces, indices, trial, point, rays, steps)
        if miss < best:
            best, area, share = miss, covered, 1.0
            size = math.sqrt(steps[0] ** 2 + steps[1] ** 2 + steps[2] ** 2)
            for k in range(3):
                leaving[k], arriving[k] = trial[k], rays[1, k]
                change[k] = steps[k] * min(1.0, _LONGEST / size) if size > 0.0 else 0.0
        elif best <= _MISS * far:
            break  # rounding alone is left
        else:
            share *= 0.5
        if math.isinf(best):  # the straight line is no path: start anew, straight at the axis
            trial[0], trial[1], trial[2] = 1.0, 0.0, 0.0
            continue
        for k in range(3):
            trial[k] = leaving[k] + share * change[k]
        _normalise(trial)
    return best <= _MISS * far and area > 0.0


@numba.njit(cache=True, inline="always")
def _normalise(vector: Any) -> float:
    length = math.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
    for k in range(3):
        vector[k] /= length
    return length
