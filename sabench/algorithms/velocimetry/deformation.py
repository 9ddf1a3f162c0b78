"""Deformation of volumes by a displacement field on the CPU, by cubic B-splines."""

import math
from typing import Any

import numpy as np

from sabench.algorithms.refocus.rectification import POLE, TERMS
from sabench.utils.arrays import F32
from sabench.utils.compiled import inner_kernel, numba
from sabench.utils.threads import on_cores


@inner_kernel()
def _mirror(index: int, count: int) -> int:
    """Mirror an index beyond the ends of a line into it, as often as it takes."""
    if count == 1:
        return 0
    index = abs(index) % (2 * count - 2)
    return min(index, 2 * count - 2 - index)


def spline_coefficients(volume: F32) -> F32:
    """Compute coefficients of the cubic B-spline through voxels (z, y, x).

    Voxels are mirrored at faces. Source: M. Unser, IEEE Signal Processing Magazine 16(6), 22-38,
    1999.
    """
    out, pole = volume.copy(), np.float32(POLE)
    on_cores(_filter_planes, out.shape[0], out, pole)
    on_cores(_filter_depths, out.shape[1], out, pole)
    return out


@numba.njit(cache=True, nogil=True, fastmath=True)
def _filter_planes(jobs: slice, out: Any, pole: Any) -> None:
    for z in range(jobs.start, jobs.stop):
        for y in range(out.shape[1]):
            _filter_line(out[z, y], pole)
        _filter_rows(out[z], pole)


@numba.njit(cache=True, nogil=True, fastmath=True)
def _filter_depths(jobs: slice, out: Any, pole: Any) -> None:
    for y in range(jobs.start, jobs.stop):
        _filter_rows(out[:, y], pole)


@inner_kernel(fastmath=True)
def _filter_line(line: Any, pole: Any) -> None:
    count = len(line)
    if count < 2:
        return
    start, power = line[0], pole
    for n in range(1, TERMS):
        start += power * line[_mirror(n, count)]
        power *= pole
    line[0] = start
    for n in range(1, count):
        line[n] += pole * line[n - 1]
    line[count - 1] = pole / (pole * pole - 1.0) * (line[count - 1] + pole * line[count - 2])
    for n in range(count - 2, -1, -1):
        line[n] = pole * (line[n + 1] - line[n])
    for n in range(count):
        line[n] *= np.float32(6.0)


@inner_kernel(fastmath=True)
def _filter_rows(plane: Any, pole: Any) -> None:
    count, width = plane.shape
    if count < 2:
        return
    start, power = plane[0].copy(), pole
    for n in range(1, TERMS):
        row = plane[_mirror(n, count)]
        for x in range(width):
            start[x] += power * row[x]
        power *= pole
    for x in range(width):
        plane[0, x] = start[x]
    for n in range(1, count):
        for x in range(width):
            plane[n, x] += pole * plane[n - 1, x]
    scale = pole / (pole * pole - np.float32(1.0))
    for x in range(width):
        plane[count - 1, x] = scale * (plane[count - 1, x] + pole * plane[count - 2, x])
    for n in range(count - 2, -1, -1):
        for x in range(width):
            plane[n, x] = pole * (plane[n + 1, x] - plane[n, x])
    for n in range(count):
        for x in range(width):
            plane[n, x] *= np.float32(6.0)


@inner_kernel(fastmath=True)
def _cubic(part: Any) -> Any:
    """Compute weights of the four nearest coefficients.

    The argument is the fraction from the second one.
    """
    rest = np.float32(1.0) - part
    sixth = np.float32(1.0 / 6.0)
    outer, inner = rest * rest * rest * sixth, part * part * part * sixth
    second = np.float32(2.0 / 3.0) - part * part * (np.float32(1.0) - np.float32(0.5) * part)
    return outer, second, np.float32(1.0) - outer - second - inner, inner


@numba.njit(cache=True, nogil=True, fastmath=True)
def deform_pair(
    jobs: slice, first: Any, second: Any, field: Any, origin: Any, step: Any, out: Any, other: Any
) -> None:
    """Fill in two volumes moved towards each other by half of a field each.

    Objects that the field displaces coincide in the middle. Where one volume is read beyond its
    faces, both results are zero, since objects in only one of them would look like motion.

    Parameters
    ----------
    first, second : (z, y, x) `spline_coefficients` of the volumes.
    field : (z, y, x, 3) displacements in voxels (x, y, z) on a lattice, continued beyond it along
        straight lines.
    origin, step : position (z, y, x) of the lattice's first node and its spacing, voxels.
    out, other : (z, y, x).
    """
    _, height, width = out.shape
    for job in range(jobs.start, jobs.stop):
        z, y = job // height, job % height
        row = _row_field(field, (z - origin[0]) / step[0], (y - origin[1]) / step[1])
        positions = np.empty((3, width), dtype=np.float32)
        corners = np.empty((3, width), dtype=np.int32)
        beyond = np.zeros(width, dtype=np.bool_)
        _aim(row, origin[2], step[2], -0.5, y, z, positions, corners)
        _read_row(first, positions, corners, z, y, out, beyond)
        _aim(row, origin[2], step[2], 0.5, y, z, positions, corners)
        _read_row(second, positions, corners, z, y, other, beyond)
        for x in range(width):
            if beyond[x]:
                out[z, y, x] = other[z, y, x] = 0.0


@numba.njit(cache=True, nogil=True, fastmath=True)
def deform(
    jobs: slice, coefficients: Any, field: Any, origin: Any, step: Any, share: float, out: Any
) -> None:
    """Fill in a volume read at points a share of a field away from its voxels.

    Parameters
    ----------
    coefficients : (z, y, x) `spline_coefficients` of the volume.
    field, origin, step : as for `deform_pair`.
    share : of the field.
    out : (z, y, x). It keeps its values where the volume is read beyond its faces.
    """
    _, height, width = out.shape
    for job in range(jobs.start, jobs.stop):
        z, y = job // height, job % height
        row = _row_field(field, (z - origin[0]) / step[0], (y - origin[1]) / step[1])
        positions = np.empty((3, width), dtype=np.float32)
        corners = np.empty((3, width), dtype=np.int32)
        beyond = np.zeros(width, dtype=np.bool_)
        _aim(row, origin[2], step[2], share, y, z, positions, corners)
        _read_row(coefficients, positions, corners, z, y, out, beyond)


@inner_kernel(fastmath=True)
def _read_row(
    coefficients: Any, positions: Any, corners: Any, z: int, y: int, out: Any, beyond: Any
) -> None:
    """Read one row, and mark what lies beyond the volume."""
    depth, height, width = out.shape
    first = 0
    while first < width:
        end = _alike(corners, first)
        i, j, k = corners[0, first], corners[1, first], corners[2, first]
        low, high = first, first  # the part with all 4 x 4 x 4 neighbours
        if 1 <= j < height - 2 and 1 <= k < depth - 2:
            low = min(max(first, 1 - i), end)
            high = max(low, min(end, width - 2 - i))
            flat, corner = coefficients.ravel(), (k * height + j) * width + i
            _stretch(flat, corner, width, height * width, positions, low, high, out[z, y])
        _read_edge(coefficients, positions, corners, first, low, out[z, y], beyond)
        _read_edge(coefficients, positions, corners, high, end, out[z, y], beyond)
        first = end


@inner_kernel(fastmath=True)
def _read_edge(
    coefficients: Any, positions: Any, corners: Any, first: int, end: int, out: Any, beyond: Any
) -> None:
    depth, height, width = coefficients.shape
    for x in range(first, end):
        i, j, k = x + corners[0, x], corners[1, x], corners[2, x]
        if (
            _is_beyond(i, positions[0, x], width)
            or _is_beyond(j, positions[1, x], height)
            or _is_beyond(k, positions[2, x], depth)
        ):
            beyond[x] = True
        else:
            part = positions[0, x], positions[1, x], positions[2, x]
            out[x] = _sample(coefficients, (i, j, k), part)


@inner_kernel()
def _is_beyond(voxel: int, part: Any, count: int) -> bool:
    """Return whether a point, a part of a step after a voxel, is outside."""
    return voxel < 0 or voxel >= count or (voxel == count - 1 and part > 0.0)


@inner_kernel(fastmath=True)
def _aim(
    row: Any, origin: float, step: float, share: float, y: int, z: int, positions: Any, corners: Any
) -> None:
    """Find the voxel (x, y, z) and fraction where each one is read.

    x is relative to its own.
    """
    last = len(row) - 1
    for x in range(positions.shape[1]):
        at = (x - origin) / step
        cell = min(max(int(at), 0), max(last - 1, 0))
        part, after = at - cell, min(cell + 1, last)
        for axis in range(3):
            move = share * (row[cell, axis] + part * (row[after, axis] - row[cell, axis])) + (
                y if axis == 1 else z if axis == 2 else 0
            )
            whole = math.floor(move)
            corners[axis, x], positions[axis, x] = whole, move - whole


@inner_kernel()
def _alike(corners: Any, first: int) -> int:
    """Find the next voxel that is not read next to its neighbour's position."""
    end = first + 1
    while end < corners.shape[1] and (
        corners[0, end] == corners[0, first]
        and corners[1, end] == corners[1, first]
        and corners[2, end] == corners[2, first]
    ):
        end += 1
    return end


@inner_kernel(fastmath=True, forceinline=True)
def _along(flat: Any, at: Any, w: Any) -> Any:
    one = np.uint64(1)
    return (
        w[0] * flat[at - one]
        + w[1] * flat[at]
        + w[2] * flat[at + one]
        + w[3] * flat[at + one + one]
    )


@inner_kernel(fastmath=True, forceinline=True)
def _across(flat: Any, at: Any, width: Any, w: Any, v: Any) -> Any:
    return (
        v[0] * _along(flat, at - width, w)
        + v[1] * _along(flat, at, w)
        + v[2] * _along(flat, at + width, w)
        + v[3] * _along(flat, at + width + width, w)
    )


@inner_kernel(fastmath=True, forceinline=True)
def _value(flat: Any, at: Any, width: Any, plane: Any, x: Any, y: Any, z: Any) -> Any:
    """Interpolate between a voxel and the next ones, out of 4 x 4 rows.

    Positions are unsigned: signed indices would be checked twice, and loops not vectorised.
    """
    w, v, u = _cubic(x), _cubic(y), _cubic(z)
    return (
        u[0] * _across(flat, at - plane, width, w, v)
        + u[1] * _across(flat, at, width, w, v)
        + u[2] * _across(flat, at + plane, width, w, v)
        + u[3] * _across(flat, at + plane + plane, width, w, v)
    )


@inner_kernel(fastmath=True)
def _stretch(
    flat: Any, at: int, width: int, plane: int, positions: Any, first: int, end: int, out: Any
) -> None:
    """Read adjacent voxels of a row, `at` + x: rows in one array vectorise the loop."""
    row, deep, start = np.uint64(width), np.uint64(plane), np.uint64(at + first)
    for n in range(np.uint64(end - first)):
        x = np.uint64(first) + n
        out[x] = _value(
            flat, start + n, row, deep, positions[0, x], positions[1, x], positions[2, x]
        )


@inner_kernel(fastmath=True)
def _row_field(field: Any, z: float, y: float) -> Any:
    """Interpolate the displacements of one row in z and y: (x, 3)."""
    above, back = (
        min(max(int(z), 0), max(field.shape[0] - 2, 0)),
        min(max(int(y), 0), max(field.shape[1] - 2, 0)),
    )
    below, front = min(above + 1, field.shape[0] - 1), min(back + 1, field.shape[1] - 1)
    p, q = z - above, y - back
    return (1.0 - p) * ((1.0 - q) * field[above, back] + q * field[above, front]) + p * (
        (1.0 - q) * field[below, back] + q * field[below, front]
    )


@inner_kernel(fastmath=True)
def _sample(c: Any, corner: Any, parts: Any) -> Any:
    """Interpolate one value, near a face of the volume."""
    depth, height, width = c.shape
    i, j, k = corner
    total = np.float32(0.0)
    wx, wy, wz = _cubic(parts[0]), _cubic(parts[1]), _cubic(parts[2])
    for n in range(4):
        for m in range(4):
            for o in range(4):
                value = c[
                    _mirror(k + n - 1, depth), _mirror(j + m - 1, height), _mirror(i + o - 1, width)
                ]
                total += wz[n] * wy[m] * wx[o] * value
    return total
