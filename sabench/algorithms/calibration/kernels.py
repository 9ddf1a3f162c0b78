"""Projections through a wall with all derivatives.

A copy of `geometry.camera` and `geometry.refraction` for the sake of the derivatives; tied to them
by test_bundle_adjustment.py::test_the_kernel_projects_as_cameras_do.

Everything is computed in the wall's own frame: its outer face is Z = 0, its normal +Z, media are
numbered along the path of light from a camera. For a pinhole C and a point P, light leaves the
pinhole in the direction w = (G L, 1), where L is the lateral part of P - C and G the tangent of
its angle divided by |L|. G follows from the invariant p = n sin(angle) of the path, for which sum
d_i p / sqrt(n_i^2 - p^2) = |L|; the derivatives of p are those of an implicit function.
"""

import math
from typing import Any

from sabench.geometry.refraction import NEWTON
from sabench.utils.compiled import inner_kernel

# rotation 3, centre 3, focal length in px, principal point 2, k1, k2, p1, p2, k3, tilt 2
CAMERA = 16
BOARD = 6  # rotation 3, position 3
BEND = 3  # of a board: along its X, its twist, along its Y


@inner_kernel()
def _bend(indices: Any, depths: Any, radius: float) -> float:
    """Solve for the tangent of a path's angle in its rarest medium.

    Newton's iteration starts from the paraxial path. Negative depths are traversed backwards.
    """
    rarest = indices.min()
    paraxial = 0.0
    for i in range(len(indices)):
        paraxial += depths[i] * rarest / indices[i]
    slope = radius / paraxial
    for _ in range(NEWTON):
        value, gradient = -radius, 0.0
        for i in range(len(indices)):
            r = indices[i] / rarest
            inverse = 1.0 / math.sqrt(r * r + (r * r - 1.0) * slope * slope)
            value += depths[i] * inverse * slope
            gradient += depths[i] * r * r * inverse * inverse * inverse
        step = value / gradient
        slope -= step
        if abs(step) <= 1e-15 * slope:
            break
    return slope


@inner_kernel()
def _leave(
    indices: Any, depths: Any, radius: float, by_depth: Any, by_index: Any
) -> tuple[float, float]:
    """Compute G = tan(angle in the first medium) / r and (dG/dr) / r at the radius r.

    Fills in dG by depths and by indices. At r = 0 derivatives are those of the paraxial path.
    """
    slope = _bend(indices, depths, radius)
    rarest = indices.min()
    gain = 0.0  # d radius / d p
    stretch = 0.0  # sum of depth / sqrt(n^2 - p^2) = radius / p
    for i in range(len(indices)):
        n = indices[i]
        square = (n * n + (n * n - rarest * rarest) * slope * slope) / (1.0 + slope * slope)
        cosine = math.sqrt(square)
        stretch += depths[i] / cosine
        gain += depths[i] * n * n / (cosine * cosine * cosine)
        by_depth[i] = 1.0 / cosine
        by_index[i] = depths[i] * n / (cosine * cosine * cosine)
    n = indices[0]
    first = by_depth[0]  # 1 / sqrt(n^2 - p^2) in the cameras' medium
    turning = n * n * first * first * first / gain  # d tan / d radius
    tangent = first / stretch  # G
    for i in range(len(indices)):
        by_depth[i] *= -turning / stretch
        by_index[i] *= turning / stretch
    # the cameras' own index also turns p into another tangent
    by_index[0] -= n * first * first * first / stretch
    curved = (turning - tangent) / (radius * radius) if radius > 0.0 else 0.0
    return tangent, curved


@inner_kernel()
def observe(
    rotation: Any,
    center: Any,
    lens: Any,
    media: Any,
    lever: Any,
    position: Any,
    row: Any,
    work: Any,
) -> tuple[float, float, bool]:
    """Project position + lever to a pixel (column, row), with all derivatives.

    The derivatives go to `row` (2, CAMERA + BOARD + shared).

    Parameters
    ----------
    rotation : (3, 3) wall frame to camera frame; a small rotation d acts as exp(d) rotation.
    center : (3,) pinhole.
    lens : (10,) focal length in px, principal point, k1, k2, p1, p2, k3, the sensor's tilt in rad.
    media : indices (m,) and thicknesses (m - 2,).
    lever : (3,) the rotated point of the board; a small rotation d acts as exp(d) lever.
    position : (3,) the board's origin.
    row : columns in the order of `lens` after rotation and centre, then the board's rotation and
        position, then indices and thicknesses. Three more, of the wall's tilt and shift, stay 0:
        they move known places and no image. The last are those by the board's bend, which
        `normal_equations` fills in.
    work : depths, by_depth and by_index (3, m).

    Not ok: the path would not reach forward, or the point is behind the camera.
    """
    indices, thicknesses = media
    depths, by_depth, by_index = work[0], work[1], work[2]
    count = len(indices)
    thick, paraxial = 0.0, 0.0
    for i in range(count - 2):
        depths[i + 1] = thicknesses[i]
        thick += thicknesses[i]
        paraxial += thicknesses[i] / indices[i + 1]
    x, y = position[0] + lever[0] - center[0], position[1] + lever[1] - center[1]
    depths[0] = -center[2]
    depths[count - 1] = position[2] + lever[2] - thick
    paraxial += depths[0] / indices[0] + depths[count - 1] / indices[count - 1]
    if depths[0] <= 0.0 or paraxial * indices[0] <= 0.1 * depths[0]:
        return 0.0, 0.0, False
    radius = math.sqrt(x * x + y * y)
    tangent, curved = _leave(indices, depths, radius, by_depth, by_index)
    a, b = tangent * x, tangent * y
    u = rotation[0, 0] * a + rotation[0, 1] * b + rotation[0, 2]
    v = rotation[1, 0] * a + rotation[1, 1] * b + rotation[1, 2]
    w = rotation[2, 0] * a + rotation[2, 1] * b + rotation[2, 2]
    if w <= 1e-6:
        return 0.0, 0.0, False
    u, v = u / w, v / w
    du, dv, uu, uv, vv = _distort(u, v, lens)
    focal, swing = lens[0], (x, y, tangent, curved)
    du, dv = _tilt(du, dv, lens, row)
    for i in range(2):
        right, down = focal * row[i, 9], focal * row[i, 10]  # by the distorted coordinates
        first, second = (right * uu + down * uv) / w, (right * uv + down * vv) / w
        _fill(row[i], first, second, (u, v, w), rotation, swing, lever, work, count)
        _fill_lens(row[i], right, down, u, v)
        row[i, 14], row[i, 15] = focal * row[i, 14], focal * row[i, 15]
    row[0, 6], row[1, 6] = du, dv
    row[0, 7], row[1, 7] = 1.0, 0.0
    row[0, 8], row[1, 8] = 0.0, 1.0
    return focal * du + lens[1], focal * dv + lens[2], True


@inner_kernel()
def _fill_lens(row: Any, right: float, down: float, u: float, v: float) -> None:
    """Fill in derivatives by coefficients of distortion at (u, v)."""
    s = u * u + v * v
    radial = right * u + down * v
    row[9], row[10], row[13] = radial * s, radial * s * s, radial * s * s * s
    row[11] = right * 2.0 * u * v + down * (s + 2.0 * v * v)
    row[12] = right * (s + 2.0 * u * u) + down * 2.0 * u * v


@inner_kernel()
def _tilt(u: float, v: float, lens: Any, row: Any) -> tuple[float, float]:
    """Take distorted coordinates to a tilted sensor.

    A copy of `sensor_tilt.onto_sensor` for the sake of the derivatives. Those by the distorted
    coordinates go to columns 9 and 10 of `row`, those by the tilt to 14 and 15.
    """
    ca, sa, cb, sb = math.cos(lens[8]), math.sin(lens[8]), math.cos(lens[9]), math.sin(lens[9])
    nx, ny, nz = sb, -cb * sa, cb * ca
    approach = nx * u + ny * v + nz
    depth = nz / approach
    across = (cb * u + sb * sa * v - sb * ca) / approach
    along = (ca * v + sa) / approach
    x, y = nz * across + sb * ca, nz * along - sa
    row[0, 9], row[0, 10] = depth * (cb - across * nx), depth * (sb * sa - across * ny)
    row[1, 9], row[1, 10] = depth * (-along * nx), depth * (ca - along * ny)
    row[0, 14], row[0, 15] = sb * y + across * cb * y, -across * x
    row[1, 14], row[1, 15] = -sb * x + along * cb * y, -along * x
    return x, y


@inner_kernel()
def _distort(u: float, v: float, lens: Any) -> tuple[float, float, float, float, float]:
    """Distort coordinates by Brown and Conrady's model, with derivatives."""
    k1, k2, p1, p2, k3 = lens[3], lens[4], lens[5], lens[6], lens[7]
    s = u * u + v * v
    radial = 1.0 + s * (k1 + s * (k2 + s * k3))
    slope = k1 + s * (2.0 * k2 + 3.0 * k3 * s)
    du = u * radial + 2.0 * p1 * u * v + p2 * (s + 2.0 * u * u)
    dv = v * radial + p1 * (s + 2.0 * v * v) + 2.0 * p2 * u * v
    uu = radial + 2.0 * u * u * slope + 2.0 * p1 * v + 6.0 * p2 * u
    uv = 2.0 * u * v * slope + 2.0 * p1 * u + 2.0 * p2 * v
    vv = radial + 2.0 * v * v * slope + 6.0 * p1 * v + 2.0 * p2 * u
    return du, dv, uu, uv, vv


@inner_kernel()
def _fill(
    row: Any,
    first: float,
    second: float,
    view: Any,
    rotation: Any,
    swing: Any,
    lever: Any,
    work: Any,
    count: int,
) -> None:
    """Fill in derivatives of a pixel coordinate by rotation, centre, board and media."""
    (u, v, w), (x, y, tangent, curved) = view, swing
    by_depth, by_index = work[1], work[2]
    third = -(first * u + second * v)  # by the camera frame's z; its vector is (u, v, 1) w
    row[0], row[1] = w * (third * v - second), w * (first - third * u)
    row[2] = w * (second * u - first * v)
    # by the lateral parts of the direction of light
    left = first * rotation[0, 0] + second * rotation[1, 0] + third * rotation[2, 0]
    down = first * rotation[0, 1] + second * rotation[1, 1] + third * rotation[2, 1]
    along = left * x + down * y
    by_x, by_y = tangent * left + along * curved * x, tangent * down + along * curved * y
    by_z = along * by_depth[count - 1]
    row[3], row[4], row[5] = -by_x, -by_y, -along * by_depth[0]
    row[CAMERA] = by_z * lever[1] - by_y * lever[2]
    row[CAMERA + 1] = by_x * lever[2] - by_z * lever[0]
    row[CAMERA + 2] = by_y * lever[0] - by_x * lever[1]
    row[CAMERA + 3], row[CAMERA + 4], row[CAMERA + 5] = by_x, by_y, by_z
    for i in range(count):
        row[CAMERA + BOARD + i] = along * by_index[i]
    for i in range(count - 2):
        row[CAMERA + BOARD + count + i] = along * (by_depth[i + 1] - by_depth[count - 1])
