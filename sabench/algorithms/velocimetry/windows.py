"""Windows of a volume, their correlation, and its peaks, on the CPU.

Overlapping windows share their voxels. A volume is cut into blocks with edges of the windows'
spacing. The products of one volume with the other, shifted, are summed over each block once, and a
window is a sum of blocks: the time does not depend on the overlap.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.fft

from sabench.utils.arrays import F32, F64
from sabench.utils.compiled import inner_kernel, numba
from sabench.utils.errors import InputError
from sabench.utils.progress import progress_bar
from sabench.utils.threads import on_cores


@numba.njit(cache=True, nogil=True, fastmath=True)
def block_sums(
    jobs: slice, first: Any, second: Any, block: Any, search: Any, products: Any, squares: Any
) -> None:
    """Fill in block sums of first x shifted second, and of the latter's square.

    The sums are filled in for every shift.

    Parameters
    ----------
    first, second : (z, y, x) float32.
    block : voxels (z, y, x) of a block.
    search : largest shift (z, y, x).
    products, squares : (block z, block y, block x, shifts), the shifts in the order of z, y, x from
        -search to search. Voxels beyond the volume count as zero.
    """
    _, high, wide = products.shape[:3]
    rz, ry, rx = search
    across = 2 * rx + 1
    for job in range(jobs.start, jobs.stop):
        bz, by = job // high, job % high
        rows = np.zeros(
            (across + 1, second.shape[2] + 2 * rx), dtype=np.float32
        )  # products for every shift along x, and squares
        for dz in range(-rz, rz + 1):
            for dy in range(-ry, ry + 1):
                rows[:] = 0.0
                for z in range(bz * block[0], (bz + 1) * block[0]):
                    for y in range(by * block[1], (by + 1) * block[1]):
                        if 0 <= z + dz < second.shape[0] and 0 <= y + dy < second.shape[1]:
                            _add_rows(first[z, y], second[z + dz, y + dy], rx, rows)
                position = ((dz + rz) * (2 * ry + 1) + dy + ry) * across
                for bx in range(wide):
                    for n in range(across):
                        product, square = np.float32(0.0), np.float32(0.0)
                        for x in range(bx * block[2], (bx + 1) * block[2]):
                            product += rows[n, x]
                            square += rows[across, x + n]
                        products[bz, by, bx, position + n] = product
                        squares[bz, by, bx, position + n] = square


@inner_kernel(fastmath=True)
def _add_rows(first: Any, second: Any, search: int, rows: Any) -> None:
    """Add products of rows and the second's squares.

    The second row lies `search` voxels further right.
    """
    count = len(first)
    for n in range(2 * search + 1):
        dx = n - search
        low, high = max(0, -dx), min(count, count - dx)
        target, left, right = rows[n, low:high], first[low:high], second[low + dx : high + dx]
        for x in range(len(target)):
            target[x] += left[x] * right[x]
    target = rows[2 * search + 1, search : search + count]
    for x in range(count):
        target[x] += second[x] * second[x]


@numba.njit(cache=True, nogil=True, fastmath=True)
def small_peaks(
    jobs: slice,
    products: Any,
    squares: Any,
    weights: Any,
    search: Any,
    floor: float,
    shift: Any,
    height: Any,
) -> None:
    """Fill in the peaks of the normalised correlation of windows.

    The windows are weighted sums of blocks.

    Parameters
    ----------
    products, squares : two each of what `block_sums` fills in, of the second volume shifted and of
        the first one.
    weights : three lines of the blocks of a window, along z, y and x.
    search : largest shift (z, y, x).
    floor : mean of both volumes' squares over a window below which there is no signal.
    shift, height : (z, y, x, 3) displacements (x, y, z), and (z, y, x) the correlation there, 0
        without signal.
    """
    _, high, wide = height.shape
    count = products[0].shape[3]
    for job in range(jobs.start, jobs.stop):
        z, y = job // high, job % high
        sums, curve = np.empty((4, count), dtype=np.float32), np.empty(count, dtype=np.float32)
        for x in range(wide):
            sums[:] = 0.0
            for i in range(len(weights[0])):
                for j in range(len(weights[1])):
                    for k in range(len(weights[2])):
                        weight = weights[0][i] * weights[1][j] * weights[2][k]
                        _add(weight, products[0][z + i, y + j, x + k], sums[0])
                        _add(weight, products[1][z + i, y + j, x + k], sums[1])
                        _add(weight, squares[0][z + i, y + j, x + k], sums[2])
                        _add(weight, squares[1][z + i, y + j, x + k], sums[3])
            _normalise(sums, floor, curve)
            height[z, y, x] = _highest(curve, search, shift[z, y, x])


@inner_kernel(fastmath=True)
def _add(weight: Any, values: Any, total: Any) -> None:
    for n in range(len(total)):
        total[n] += weight * values[n]


@inner_kernel(fastmath=True)
def _normalise(sums: Any, floor: float, curve: Any) -> None:
    """Compute the correlation over shifts.

    It is the mean of opposite ones at opposite ends.
    """
    count = len(curve)
    rest = sums[2, count // 2], sums[3, count // 2]
    for n in range(count):
        square = (sums[2, n] + rest[0]) * (sums[3, count - 1 - n] + rest[1])
        scale = np.sqrt(max(square, np.float32(0.0)))
        curve[n] = (sums[0, n] + sums[1, count - 1 - n]) / scale if scale > 2.0 * floor else 0.0


@inner_kernel(fastmath=True)
def _highest(curve: Any, search: Any, shift: Any) -> Any:
    """Fill in the best small shift's refined position (x, y, z); return its height."""
    top = 0
    for n in range(len(curve)):
        if curve[n] > curve[top]:
            top = n
    across, along = 2 * search[2] + 1, (2 * search[2] + 1) * (2 * search[1] + 1)
    x, y, z = top % across, top % along // across, top // along
    position = x - search[2], y - search[1], z - search[0]
    strides, ends = (1, across, along), (search[2], search[1], search[0])
    for axis in range(3):
        shift[axis] = position[axis]
        # at the edge of the search: the whole step, no more is known
        if abs(position[axis]) < ends[axis]:
            before, after = curve[top - strides[axis]], curve[top + strides[axis]]
            shift[axis] += _vertex(before, curve[top], after)
        if curve[top] <= 0.0:
            shift[axis] = 0.0
    return curve[top]


@inner_kernel(fastmath=True)
def _vertex(before: float, here: float, after: float) -> float:
    """Locate the peak of the Gaussian, or of a parabola, through three values."""
    if min(before, here, after) > 0.0:
        before, here, after = math.log(before), math.log(here), math.log(after)
    bend = before - 2.0 * here + after
    return min(max(0.5 * (before - after) / bend, -1.0), 1.0) if bend < 0.0 else 0.0


@numba.njit(cache=True, fastmath=True, nogil=True)
def cut_windows(volume: Any, corners: Any, out: Any, energy: Any) -> None:
    """Fill in windows (n, z, y, x) at corners (n, 3) less means, and square sums."""
    _, deep, high, wide = out.shape
    for n in range(len(corners)):
        z, y, x = corners[n]
        total = 0.0
        for k in range(deep):
            for j in range(high):
                row, to = volume[z + k, y + j, x : x + wide], out[n, k, j]
                for i in range(wide):
                    to[i] = row[i]
                    total += row[i]
        mean, flat, squares = np.float32(total / (deep * high * wide)), out[n].ravel(), 0.0
        for i in range(len(flat)):
            flat[i] -= mean
            squares += flat[i] * flat[i]
        energy[n] = squares


@numba.njit(cache=True, fastmath=True, nogil=True)
def circular_peaks(planes: Any, shift: Any, height: Any, ratio: Any) -> None:
    """Fill in the highest peaks of circular correlations (n, z, y, x).

    Displacements (n, 3) as x, y, z, heights, and their ratios to the highest values elsewhere; the
    surroundings of the peaks are set to zero.
    """
    count, deep, high, wide = planes.shape
    for n in range(count):
        plane = planes[n]
        flat = plane.ravel()
        top = _largest(flat)
        z, y, x = top // (high * wide), top // wide % high, top % wide
        here = flat[top]
        right, below, behind = (x + 1) % wide, (y + 1) % high, (z + 1) % deep
        part = _vertex(plane[z, y, x - 1], here, plane[z, y, right])
        shift[n, 0] = _to_displacement(x, wide) + part
        part = _vertex(plane[z, y - 1, x], here, plane[z, below, x])
        shift[n, 1] = _to_displacement(y, high) + part
        part = _vertex(plane[z - 1, y, x], here, plane[behind, y, x])
        shift[n, 2] = _to_displacement(z, deep) + part
        for k in range(-1, 2):
            for j in range(-1, 2):
                for i in range(-1, 2):
                    plane[(z + k) % deep, (y + j) % high, (x + i) % wide] = 0.0
        height[n], ratio[n] = here, here / max(flat[_largest(flat)], 1e-12 * here, 1e-30)


@inner_kernel(fastmath=True)
def _largest(values: Any) -> int:
    """Find the first of the largest values, which is found without branches."""
    most = values[0]
    for n in range(len(values)):
        most = max(most, values[n])
    for n in range(len(values)):
        if values[n] == most:
            return n
    return 0


@inner_kernel()
def _to_displacement(position: int, count: int) -> int:
    return position - count if position > count // 2 else position


Size = tuple[int, int, int]
_AT_ONCE = 1 << 20  # voxels of the windows that a thread transforms simultaneously
# of the windows' mean square: one with less has no signal; what a spline's ringing leaves of bright
# neighbours is less
_EMPTY = 1e-3


@dataclass(frozen=True)
class Windows:
    """Overlapping windows of a volume, all inside it.

    Attributes
    ----------
    size : voxels (z, y, x).
    step : voxels (z, y, x) from one to the next; sizes are whole multiples.
    counts : windows (z, y, x).
    """

    size: Size
    step: Size
    counts: Size

    @classmethod
    def over(cls, shape: tuple[int, ...], size: Size, overlap: float) -> Windows:
        """Make as many windows as fit; those of one voxel do not overlap along its axis.

        Raises
        ------
        InputError
            A window larger than the volume, or an overlap that leaves no whole number of steps in a
            window.
        """
        if np.any(np.greater(size, shape)):
            raise InputError(
                f"window: expected one that fits into the volume of {_xyz(shape)} voxels, got "
                f"{_xyz(size)}"
            )
        parts = [1 if edge == 1 else round(edge * (1.0 - overlap)) for edge in size]
        if any(part < 1 or edge % part for edge, part in zip(size, parts, strict=True)):
            raise InputError(
                f"overlap: expected a part of {_xyz(size)} voxels that leaves whole steps which "
                f"divide it, got {overlap:g}"
            )
        counts = [
            (total - edge) // part + 1 for total, edge, part in zip(shape, size, parts, strict=True)
        ]
        return cls(size, (parts[0], parts[1], parts[2]), (counts[0], counts[1], counts[2]))

    @property
    def origin(self) -> tuple[float, float, float]:
        """Middle (z, y, x) of the first window, voxels."""
        z, y, x = ((edge - 1) / 2.0 for edge in self.size)
        return z, y, x

    @property
    def blocks(self) -> Size:
        """Blocks (z, y, x) of one step each that the windows cover."""
        axes = zip(self.counts, self.size, self.step, strict=True)
        z, y, x = (count - 1 + size // step for count, size, step in axes)
        return z, y, x


def _xyz(values: tuple[int, ...]) -> str:
    return " x ".join(str(value) for value in values[::-1])


@dataclass(frozen=True)
class CorrelationPeaks:
    """Correlation peaks of windows.

    Attributes
    ----------
    shift : (z, y, x, 3) displacement (x, y, z) in voxels of the second volume against the first.
    height : (z, y, x) normalised correlation there, from -1 to 1; 0 where there is no signal.
    ratio : (z, y, x) of the highest to the second highest peak, or None where only small shifts
        were looked at.
    """

    shift: F64
    height: F64
    ratio: F64 | None


def by_shifts(
    first: F32, second: F32, windows: Windows, search: Size, taper: float | None = None
) -> CorrelationPeaks:
    """Compute the normalised correlation at all shifts up to `search` (z, y, x).

    The second volume is shifted against the window, and the first one in the opposite direction;
    the mean of both is taken. Two equal volumes then have equal correlations at opposite shifts,
    whatever the window's faces cut.

    Parameters
    ----------
    taper : standard deviation of the Gaussian that weights a window's blocks, as a part of the
        window; None: all count alike.
    """
    shape = (*windows.blocks, math.prod(2 * r + 1 for r in search))
    products, squares = (
        (np.empty(shape, dtype=np.float32), np.empty(shape, dtype=np.float32)) for _ in range(2)
    )
    rows, limits = math.prod(windows.blocks[:2]), (windows.step, search)
    on_cores(block_sums, rows, first, second, *limits, products[0], squares[0])
    on_cores(block_sums, rows, second, first, *limits, products[1], squares[1])
    weights = tuple(
        _weights(edge // step, taper) for edge, step in zip(windows.size, windows.step, strict=True)
    )
    energies = [float(np.mean(step[..., shape[3] // 2])) for step in squares]
    weight = math.prod(float(line.sum()) for line in weights)
    floor = _EMPTY * math.sqrt(energies[0] * energies[1]) * weight + 1e-30
    shift, height = np.empty((*windows.counts, 3)), np.empty(windows.counts)
    rows = math.prod(windows.counts[:2])
    on_cores(small_peaks, rows, products, squares, weights, search, floor, shift, height)
    return CorrelationPeaks(shift, height, None)


def _weights(blocks: int, taper: float | None) -> F32:
    """Compute the weights of a window's blocks along one axis."""
    middles = (np.arange(blocks) + 0.5) / blocks - 0.5
    weights = np.ones(blocks) if taper is None else np.exp(-0.5 * (middles / taper) ** 2)
    return weights.astype(np.float32)


def by_spectra(first: F32, second: F32, windows: Windows) -> CorrelationPeaks:
    """Correlate windows circularly by spectra, for displacements up to half a window."""
    corners = np.ascontiguousarray(np.indices(windows.counts).reshape(3, -1).T * windows.step)
    shift, (height, ratio) = np.zeros(corners.shape), np.zeros((2, len(corners)))
    batch = max(1, _AT_ONCE // math.prod(windows.size))

    def correlate(start: int) -> None:
        part = slice(start, start + batch)
        spectra, energies = [], []
        for volume in (first, second):
            cut = np.empty((len(corners[part]), *windows.size), dtype=np.float32)
            energy = np.empty(len(cut))
            cut_windows(volume, corners[part], cut, energy)
            spectra.append(scipy.fft.rfftn(cut, axes=(1, 2, 3)))
            energies.append(energy)
        product = np.conjugate(spectra[0], out=spectra[0])
        product *= spectra[1]
        planes = scipy.fft.irfftn(product, s=windows.size, axes=(1, 2, 3), overwrite_x=True)
        scale = np.sqrt(energies[0] * energies[1])
        circular_peaks(planes, shift[part], height[part], ratio[part])
        height[part] /= np.where(scale > 0.0, scale, np.inf)

    with ThreadPoolExecutor(numba.get_num_threads()) as pool:
        jobs = [pool.submit(correlate, start) for start in range(0, len(corners), batch)]
        for job in progress_bar(jobs, "correlate by spectra"):
            job.result()
    textured = height > 0.0
    shifts = (shift * textured[:, None]).reshape(*windows.counts, 3)
    heights, ratios = (values.reshape(windows.counts) for values in (height, ratio * textured))
    return CorrelationPeaks(shifts, heights, ratios)
