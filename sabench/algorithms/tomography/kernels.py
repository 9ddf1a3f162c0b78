"""Loops over the voxels of a sparse volume and the four pixels around each.

The pixels are those around a voxel's projection. Two stages for every row of voxels and every
camera: `locate` finds the pixels, without branches, so that it runs in vector registers; then light
is moved. `locate` alone decides which pixels and which weights a voxel has, and it is compiled
without fast-math: forward projection, adjoint and all else see the same W to the last bit.
"""

from typing import Any, NamedTuple

import numpy as np

from sabench.utils.arrays import F64
from sabench.utils.compiled import inner_kernel, numba

_BITS = 10
STEPS = 1 << _BITS  # places inside a pixel, along either axis, that are distinguished
_ONE = np.float32(STEPS)
_LARGEST_EXPONENT = np.float32(60.0)


class KernelGeometry(NamedTuple):
    """Cameras and grid as arrays for the kernels.

    Attributes
    ----------
    maps : (camera, z, 2, terms) column and row on every plane, as polynomials in u and v
        (`geometry.plane_polynomials.PlaneMap`).
    degree : of these polynomials.
    height, width : voxels of a plane along y and x.
    rows, columns : pixels of an image.
    margin : pixels at an image's border that do not count as seen.
    shift, mask : shift of positions, in pixels, before they are split into whole pixels and STEPS;
        bits of the steps that count. No bits count for the nearest pixel.
    """

    maps: F64
    degree: int
    height: int
    width: int
    rows: int
    columns: int
    margin: int
    shift: float = 0.5 / STEPS
    mask: int = STEPS - 1


@inner_kernel()
def scratch(geometry: Any) -> Any:
    """Allocate the scratch arrays of `locate`."""
    width, terms = geometry.width, geometry.degree + 1
    return (
        np.empty(terms),
        np.empty((2, terms), dtype=np.float32),
        np.empty((3, width), dtype=np.float32),
        np.empty(width, dtype=np.int32),
        np.empty(width, dtype=np.uint16),
        np.empty(width, dtype=np.uint16),
    )


@inner_kernel()
def locate(geometry: Any, camera: int, row: int, x: Any, work: Any) -> Any:
    """Locate the voxels x of a row, counted over (z, y), in a camera's image.

    Returns
    -------
    base : (n,) int32, the upper left of the four pixels around each; -1 where these, with the
        margin, are not inside the image: this camera does not see the voxel.
    across, down : (n,) uint16, position among these pixels in steps.
    """
    total, line, position, base, across, down = work
    v = 2.0 * (row % geometry.height) / (geometry.height - 1) - 1.0 if geometry.height > 1 else 0.0
    for axis in range(2):
        _collapse(
            geometry.maps[camera, row // geometry.height, axis],
            geometry.degree,
            geometry.shift,
            v,
            total,
        )
        for i in range(len(total)):
            line[axis, i] = total[i]
    _evaluate(line, x, geometry.width, position)
    _fix(position, len(x), geometry, base, across, down)
    return base[: len(x)], across[: len(x)], down[: len(x)]


@inner_kernel()
def _collapse(plane: Any, degree: int, shift: float, v: float, total: Any) -> None:
    """Evaluate a plane's polynomials in steps, shifted by `shift`, at one v."""
    total[:] = 0.0
    total[0] = STEPS * shift
    first, power = 0, float(STEPS)
    for j in range(degree + 1):
        for i in range(degree + 1 - j):
            total[i] += power * plane[first + i]
        first += degree + 1 - j
        power *= v


@inner_kernel()
def _evaluate(line: Any, x: Any, width: int, position: Any) -> None:
    """Fill in u, column and row by Horner's rule, with the voxels in the inner loop."""
    u, column, row = position[0], position[1], position[2]
    step, half = np.float32(2.0 / max(width - 1, 1)), np.float32(1.0 if width > 1 else 0.0)
    last = line.shape[1] - 1
    for i in range(len(x)):
        u[i] = np.float32(x[i]) * step - half
        column[i] = line[0, last]
        row[i] = line[1, last]
    for power in range(last - 1, -1, -1):
        a, b = line[0, power], line[1, power]
        for i in range(len(x)):
            column[i] = column[i] * u[i] + a
            row[i] = row[i] * u[i] + b


@inner_kernel()
def _fix(position: Any, count: int, geometry: Any, base: Any, across: Any, down: Any) -> None:
    column, row = position[1], position[2]
    low, mask, stride = (
        np.float32(geometry.margin) * _ONE,
        np.int32(geometry.mask),
        np.int32(geometry.columns),
    )
    right, bottom = (
        np.float32(geometry.columns - 1 - geometry.margin) * _ONE,
        np.float32(geometry.rows - 1 - geometry.margin) * _ONE,
    )
    for i in range(count):
        inside = (column[i] >= low) & (column[i] < right) & (row[i] >= low) & (row[i] < bottom)
        p, q = np.int32(min(max(column[i], low), right)), np.int32(min(max(row[i], low), bottom))
        base[i] = (
            np.int32(np.int32(q >> _BITS) * stride) + np.int32(p >> _BITS)
            if inside
            else np.int32(-1)
        )
        across[i] = np.uint16(p & mask)
        down[i] = np.uint16(q & mask)


@inner_kernel(fastmath=True)
def sample_image(image: Any, columns: int, base: Any, across: Any, down: Any) -> Any:
    """Interpolate bilinearly in an image (flat)."""
    corner, below = np.uint32(base), np.uint32(base + columns)
    right, lower = np.float32(across) / _ONE, np.float32(down) / _ONE
    over = image[corner] + right * (image[corner + np.uint32(1)] - image[corner])
    under = image[below] + right * (image[below + np.uint32(1)] - image[below])
    return over + lower * (under - over)


@inner_kernel(fastmath=True)
def _scatter(value: Any, places: Any, columns: int, image: Any) -> None:
    """Add voxels' light to an image (flat): the transpose of `sample`."""
    base, across, down = places
    for i in range(len(value)):
        if base[i] >= 0:
            corner, below = np.uint32(base[i]), np.uint32(base[i] + columns)
            right = np.float32(across[i]) / _ONE
            under = value[i] * (np.float32(down[i]) / _ONE)
            over = value[i] - under
            image[corner] += over - right * over
            image[corner + np.uint32(1)] += right * over
            image[below] += under - right * under
            image[below + np.uint32(1)] += right * under


@numba.njit(cache=True, nogil=True)
def project_volume(
    jobs: slice, geometry: Any, cameras: Any, parts: Any, start: Any, x: Any, values: Any, out: Any
) -> None:
    """Project parts of a volume, each into an image of its own.

    Adding these up in order gives the same sum for any order of threads.

    Parameters
    ----------
    cameras : (n,) numbers.
    parts : (part + 1,) first rows of the parts.
    start, x, values : the voxels, see `Support`.
    out : (n, part, rows * columns) float32, zero on entry.
    """
    count = len(parts) - 1
    for task in range(jobs.start, jobs.stop):
        number, part = task // count, task % count
        work = scratch(geometry)
        for row in range(parts[part], parts[part + 1]):
            first, last = start[row], start[row + 1]
            if last > first:
                _scatter(
                    values[first:last],
                    locate(geometry, cameras[number], row, x[first:last], work),
                    geometry.columns,
                    out[number, part],
                )


@numba.njit(cache=True, nogil=True)
def back_project(
    jobs: slice, geometry: Any, cameras: Any, parts: Any, start: Any, x: Any, images: Any, out: Any
) -> None:
    """Add images (n, rows * columns), interpolated bilinearly, to voxels.

    See `project`.
    """
    for part in range(jobs.start, jobs.stop):
        work = scratch(geometry)
        for number in range(len(cameras)):
            for row in range(parts[part], parts[part + 1]):
                first, last = start[row], start[row + 1]
                if last > first:
                    _collect(
                        images[number],
                        geometry.columns,
                        locate(geometry, cameras[number], row, x[first:last], work),
                        out[first:last],
                    )


@inner_kernel(fastmath=True)
def _collect(image: Any, columns: int, places: Any, out: Any) -> None:
    """Add an image (flat), bilinearly interpolated, to voxels: transposed `_scatter`."""
    base, across, down = places
    for i in range(len(out)):
        if base[i] >= 0:
            out[i] += sample_image(image, columns, base[i], across[i], down[i])


@inner_kernel(fastmath=True)
def exp2(exponent: Any) -> Any:
    """Compute 2^x within 2e-7 of its value, x clipped to +-60, in vector registers."""
    x = min(max(exponent, -_LARGEST_EXPONENT), _LARGEST_EXPONENT)
    whole = np.int32(x + np.float32(256.5)) - np.int32(256)  # rounded
    t = x - np.float32(whole)
    p = np.float32(1.5403530e-4)
    p = p * t + np.float32(1.3333558e-3)
    p = p * t + np.float32(9.6181291e-3)
    p = p * t + np.float32(5.5504109e-2)
    p = p * t + np.float32(2.4022651e-1)
    p = p * t + np.float32(6.9314718e-1)
    p = p * t + np.float32(1.0)
    return p * np.int32((whole + np.int32(127)) << 23).view(np.float32)


@numba.njit(cache=True, nogil=True, fastmath=True)
def multiply(jobs: slice, values: Any, exponents: Any, factor: Any) -> None:
    """Multiply values by 2^(factor * exponents), in place."""
    for j in range(jobs.start, jobs.stop):
        values[j] *= exp2(factor * exponents[j])
