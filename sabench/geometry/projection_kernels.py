"""Refractive projection of many points in vector registers.

A copy of `camera.pixels_of` and `refraction.trace_to_points` for speed; tied to them by
tests/unit/geometry/test_camera.py::test_the_projection_kernel_and_the_traced_path_agree.

Points come as separate x, y and z, block by block, and no loop over points branches. The path's
unknown is q = t / R, the tangent in the rarest medium (as in `refraction`) over the lateral
distance: only R^2 is needed, and the axis is no special case. Halley's step from the paraxial path
costs one square root and one division per medium, as Newton's does, and triples the right digits. A
block is finished when its last step was so small that the next one would be lost in rounding. Where
that takes too long (grazing rays in thin rare layers), the block starts again with Newton's steps,
which converge to the root for any indices (see `refraction`).
"""

import math
from typing import Any

import numpy as np

from sabench.geometry.refraction import HALLEY, NEWTON, Wall
from sabench.utils.arrays import F64
from sabench.utils.compiled import inner_kernel, numba

BLOCK = 256
# relative change after which Halley's next would be below rounding; Newton's is asked for the
# square root of rounding
_SMALL, _SMALLER = np.cbrt(np.finfo(float).eps), np.sqrt(np.finfo(float).eps)

Media = tuple[float, tuple[tuple[float, float], ...], float, float, float]


def media_of(wall: Wall, center_mm: F64) -> Media:
    """Collect what `project` needs of a wall in front of a pinhole (3,)."""
    ratios = (wall.indices / wall.indices.min()) ** 2
    before = -float(wall.depth_of(center_mm))
    depths = (before, *(float(layer.thickness_mm) for layer in wall.layers))
    constant = [(float(r), depth) for r, depth in zip(ratios[:-1], depths, strict=True)]
    rare = float(sum(depth for ratio, depth in constant if ratio == 1.0))  # 0 would be another type
    # numba cannot go through an empty tuple
    others = tuple(pair for pair in constant if pair[0] != 1.0) or ((1.0, 0.0),)
    return rare, others, float(ratios[-1]), float(ratios[0]), before + wall.thickness_mm


@inner_kernel(fastmath={"contract", "nsz", "arcp"}, error_model="numpy")
def _step(
    slope: Any, square: Any, deep: Any, size: int, rare: float, others: Any, fluid: float
) -> int:
    """Apply one of Halley's steps to a block and count the unknowns that still moved."""
    moving = 0
    for i in range(size):
        q = slope[i]
        t2 = q * q * square[i]
        inverse = 1.0 / math.sqrt(fluid + (fluid - 1.0) * t2)
        part = deep[i] * inverse
        value, gain = rare + part, part * inverse * inverse * fluid
        bow = gain * inverse * inverse * (fluid - 1.0)
        gain += rare
        for ratio, depth in others:
            inverse = 1.0 / math.sqrt(ratio + (ratio - 1.0) * t2)
            part = depth * inverse
            value += part
            part *= inverse * inverse * ratio
            gain += part
            bow += part * inverse * inverse * (ratio - 1.0)
        miss = 1.0 - value * q
        change = 2.0 * miss * gain / (2.0 * gain * gain - 3.0 * miss * bow * q * square[i])
        slope[i] = q + change
        moving += abs(change) > _SMALL * abs(q)
    return moving


@inner_kernel(error_model="numpy")
def _climb(
    slope: Any, square: Any, deep: Any, size: int, rare: float, others: Any, fluid: float
) -> None:
    for _ in range(NEWTON):
        moving = 0
        for i in range(size):
            q = slope[i]
            t2 = q * q * square[i]
            inverse = 1.0 / math.sqrt(fluid + (fluid - 1.0) * t2)
            value, gain = rare + deep[i] * inverse, rare + deep[i] * inverse**3 * fluid
            for ratio, depth in others:
                inverse = 1.0 / math.sqrt(ratio + (ratio - 1.0) * t2)
                value += depth * inverse
                gain += depth * inverse**3 * ratio
            change = (1.0 - value * q) / gain
            slope[i] = q + change
            moving += abs(change) > _SMALLER * abs(q)
        if moving == 0:
            break


@inner_kernel(fastmath={"contract", "nsz", "arcp"}, error_model="numpy")
def _paraxial(deep: Any, size: int, rare: float, others: Any, fluid: float, slope: Any) -> None:
    constant = rare
    for ratio, depth in others:
        constant += depth / math.sqrt(ratio)
    scale = 1.0 / math.sqrt(fluid)
    for i in range(size):
        slope[i] = 1.0 / (constant + deep[i] * scale)


@inner_kernel(fastmath={"contract", "nsz", "arcp"}, error_model="numpy")
def _tangents(slope: Any, square: Any, size: int, first: float) -> None:
    """Convert q to the tangent in the cameras' medium, given the lateral distance.

    It is returned unchanged where that medium is the rarest.
    """
    if first > 1.0:
        for i in range(size):
            slope[i] /= math.sqrt(first + (first - 1.0) * slope[i] * slope[i] * square[i])


@numba.njit(cache=True, fastmath={"contract", "nsz", "arcp"}, error_model="numpy")
def project(
    x: Any, y: Any, z: Any, center: Any, frame: Any, media: Any, lens: Any, column: Any, row: Any
) -> None:
    """Compute ideal pixels of points through a wall.

    NaN for points that are not in the fluid or behind the camera.

    Parameters
    ----------
    x, y, z : (n,) world points.
    center : the pinhole, as three numbers; it must be in front of the wall.
    frame : nine numbers: two unit vectors along the wall and its normal, world frame.
    media : as `media_of` gives them.
    lens : eleven numbers: the camera's rotation from that frame with its first two rows times the
        focal length, and the principal point.
    column, row : (n,) the result.
    """
    rare, others, fluid, first, gap = media
    cx, cy, cz = center
    ax, ay, az, bx, by, bz, nx, ny, nz = frame
    m00, m01, m02, m10, m11, m12, m20, m21, m22, pu, pv = lens
    across, down, deep, square, slope = (
        np.empty(BLOCK),
        np.empty(BLOCK),
        np.empty(BLOCK),
        np.empty(BLOCK),
        np.empty(BLOCK),
    )
    for start in range(0, len(x), BLOCK):
        size = min(BLOCK, len(x) - start)
        for i in range(size):
            px, py, pz = x[start + i] - cx, y[start + i] - cy, z[start + i] - cz
            a, b = px * ax + py * ay + pz * az, px * bx + py * by + pz * bz
            across[i], down[i], deep[i] = a, b, px * nx + py * ny + pz * nz - gap
            square[i] = a * a + b * b
        _paraxial(deep, size, rare, others, fluid, slope)
        moving = 1
        for _ in range(HALLEY):
            moving = _step(slope, square, deep, size, rare, others, fluid)
            if moving == 0:
                break
        if moving != 0:
            _paraxial(deep, size, rare, others, fluid, slope)
            _climb(slope, square, deep, size, rare, others, fluid)
        _tangents(slope, square, size, first)
        for i in range(size):
            a, b = across[i] * slope[i], down[i] * slope[i]
            w = m20 * a + m21 * b + m22
            good = 1.0 / w if deep[i] > 0.0 and w > 1e-9 else math.nan
            column[start + i] = (m00 * a + m01 * b + m02) * good + pu
            row[start + i] = (m10 * a + m11 * b + m12) * good + pv
