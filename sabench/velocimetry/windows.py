"""Windows of a volume, what their correlation looks like, and where its peak is."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import scipy.fft

from sabench.arrays import F32, F64, Bool
from sabench.errors import InputError
from sabench.velocimetry.kernels import block_sums

_BATCH = 256  # windows transformed at once: they fit into the cache together with their spectra
_EMPTY = 1e-3  # of the windows' mean square: one with less has no signal; what a spline's ringing leaves of bright neighbours is less


@dataclass(frozen=True)
class Windows:
    """Overlapping windows of a volume, all inside it.

    Attributes
    ----------
    size : voxels (z, y, x).
    step : voxels (z, y, x) from one to the next; sizes are whole multiples.
    counts : windows (z, y, x).
    """

    size: tuple[int, int, int]
    step: tuple[int, int, int]
    counts: tuple[int, int, int]

    @classmethod
    def over(cls, shape: tuple[int, int, int], size: tuple[int, int, int], overlap: float) -> Windows:
        """As many as fit.

        Raises
        ------
        InputError
            A window larger than the volume, or an overlap that leaves no whole number of steps in a window.
        """
        if any(own > there for own, there in zip(size, shape, strict=True)):
            raise InputError(f"window: expected one that fits into the volume of {_xyz(shape)} voxels, got {_xyz(size)}")
        parts = [round(own * (1.0 - overlap)) for own in size]
        if any(part < 1 or own % part for own, part in zip(size, parts, strict=True)):
            raise InputError(f"overlap: expected a part of {_xyz(size)} voxels that leaves whole steps which divide it, got {overlap:g}")
        counts = [(there - own) // part + 1 for there, own, part in zip(shape, size, parts, strict=True)]
        return cls(size, (parts[0], parts[1], parts[2]), (counts[0], counts[1], counts[2]))

    @property
    def origin(self) -> tuple[float, float, float]:
        """Middle (z, y, x) of the first window, voxels."""
        z, y, x = ((own - 1) / 2.0 for own in self.size)
        return z, y, x

    @property
    def blocks(self) -> tuple[int, int, int]:
        """Blocks (z, y, x) of one step each that the windows cover."""
        z, y, x = (n - 1 + own // part for n, own, part in zip(self.counts, self.size, self.step, strict=True))
        return z, y, x


def _xyz(values: tuple[int, int, int]) -> str:
    return " x ".join(str(value) for value in values[::-1])


@dataclass(frozen=True)
class Peaks:
    """What windows show.

    Attributes
    ----------
    shift : (z, y, x, 3) displacement (x, y, z) in voxels of the second volume against the first.
    height : (z, y, x) normalised correlation there, from -1 to 1; 0 where there is no signal.
    ratio : (z, y, x) of the highest to the second highest peak, or None where only small shifts were looked at.
    """

    shift: F64
    height: F64
    ratio: F64 | None


def by_shifts(first: F32, second: F32, windows: Windows, reach: tuple[int, int, int]) -> Peaks:
    """Normalised correlation at all shifts within reach (z, y, x), through sums over blocks.

    The second volume is shifted against the window, and the first one the other way, and the mean is taken: two equal volumes then correlate alike at
    opposite shifts, whatever is cut by the window's faces.
    """
    shifts = tuple(2 * r + 1 for r in reach)
    middle = int(np.prod(shifts)) // 2
    there, back = (_sums(*pair, windows, reach) for pair in ((first, second), (second, first)))
    product = there[0] + back[0][..., ::-1]
    square = (there[1] + there[1][..., middle, None]) * (back[1][..., ::-1] + back[1][..., middle, None])
    scale = np.sqrt(np.maximum(square, 0.0))
    lit = scale > _EMPTY * float(np.mean(scale)) + 1e-30
    height = np.where(lit, 2.0 * product / np.where(lit, 2.0 * scale, 1.0), 0.0).reshape(*windows.counts, *shifts)
    return _peaks(np.asarray(height, dtype=np.float32), reach)


def _sums(first: F32, second: F32, windows: Windows, reach: tuple[int, int, int]) -> tuple[F32, F32]:
    """Sums over windows of the products, and of the squares of what is shifted: (z, y, x, shifts)."""
    shape = (*windows.blocks, int(np.prod([2 * r + 1 for r in reach])))
    products, squares = np.empty(shape, dtype=np.float32), np.empty(shape, dtype=np.float32)
    block_sums(first, second, windows.step, reach, products, squares)
    return _windowed(products, windows), _windowed(squares, windows)


def _windowed(sums: F32, windows: Windows) -> F32:
    """Sums over windows from sums over blocks (z, y, x, ...)."""
    for axis, (own, part, count) in enumerate(zip(windows.size, windows.step, windows.counts, strict=True)):
        parts = [np.take(sums, range(n, n + count), axis=axis) for n in range(own // part)]
        sums = np.asarray(sum(parts[1:], start=parts[0]))
    return sums


def by_spectra(first: F32, second: F32, windows: Windows) -> Peaks:
    """Circular correlation of whole windows by their Fourier transforms, for displacements up to half a window."""
    corners = np.array(list(itertools.product(*(part * np.arange(count) for part, count in zip(windows.step, windows.counts, strict=True)))))
    views = [np.lib.stride_tricks.sliding_window_view(volume, windows.size) for volume in (first, second)]
    shift, height, ratio = np.zeros((len(corners), 3)), np.zeros(len(corners)), np.zeros(len(corners))
    for start in range(0, len(corners), _BATCH):
        part = slice(start, start + _BATCH)
        z, y, x = corners[part].T
        shift[part], height[part], ratio[part] = _correlated(*(np.ascontiguousarray(view[z, y, x]) for view in views))
    return Peaks(shift.reshape(*windows.counts, 3), height.reshape(windows.counts), ratio.reshape(windows.counts))


def _correlated(one: F32, other: F32) -> tuple[F64, F64, F64]:
    """Displacements (n, 3) in x, y, z, heights and peak ratios of pairs of windows (n, z, y, x)."""
    axes, size = (1, 2, 3), one.shape[1:]
    for windows in (one, other):
        windows -= windows.mean(axis=axes, keepdims=True)
    scale = np.sqrt((one**2).sum(axis=axes, dtype=np.float64) * (other**2).sum(axis=axes, dtype=np.float64))
    spectrum = np.conj(scipy.fft.rfftn(one, axes=axes, workers=-1)) * scipy.fft.rfftn(other, axes=axes, workers=-1)
    plane = scipy.fft.irfftn(spectrum, s=size, axes=axes, workers=-1).astype(np.float32)
    count = len(plane)
    flat = plane.reshape(count, -1)
    top = flat.argmax(axis=1)
    where = np.stack(np.unravel_index(top, size), axis=1)
    rows = np.arange(count)
    near = [(where[:, axis, None] + np.arange(-1, 2)) % size[axis] for axis in range(3)]
    cube = plane[rows[:, None, None, None], near[0][:, :, None, None], near[1][:, None, :, None], near[2][:, None, None, :]]
    signed = np.where(where > np.array(size) // 2, where - np.array(size), where)
    found = signed + _vertices(cube)
    highest = flat[rows, top].astype(np.float64)
    plane[rows[:, None, None, None], near[0][:, :, None, None], near[1][:, None, :, None], near[2][:, None, None, :]] = 0.0
    second = np.maximum(flat.max(axis=1), 1e-12 * np.maximum(highest, 1e-30))
    there = scale > 0.0
    return found[:, ::-1] * there[:, None], np.where(there, highest / np.where(there, scale, 1.0), 0.0), np.where(there, highest / second, 0.0)


def _peaks(height: F32, reach: tuple[int, int, int]) -> Peaks:
    """The highest of small shifts, to parts of a voxel where its neighbours were looked at, too."""
    counts, shifts = height.shape[:3], height.shape[3:]
    flat = height.reshape(-1, *shifts)
    top = np.stack(np.unravel_index(flat.reshape(len(flat), -1).argmax(axis=1), shifts), axis=1)
    inner = np.stack([np.clip(top[:, axis], 1, shifts[axis] - 2) if shifts[axis] > 2 else top[:, axis] for axis in range(3)], axis=1)
    rows = np.arange(len(flat))
    near = [inner[:, axis, None] + (np.arange(-1, 2) if shifts[axis] > 2 else np.zeros(3, dtype=np.int64)) for axis in range(3)]
    cube = flat[rows[:, None, None, None], near[0][:, :, None, None], near[1][:, None, :, None], near[2][:, None, None, :]]
    parts = np.where(top == inner, _vertices(cube), (top - inner).astype(np.float64))  # at the edge of the search: the whole step, no more is known
    found = inner - np.asarray(reach) + parts
    highest = flat[rows, top[:, 0], top[:, 1], top[:, 2]].astype(np.float64)
    found *= (highest > 0.0)[:, None]
    return Peaks(found[:, ::-1].reshape(*counts, 3), highest.reshape(counts), None)


def _vertices(cube: F32) -> F64:
    """Where Gaussians through three values along each axis peak, from the middle of cubes (n, 3, 3, 3): (n, 3) in z, y, x."""
    middle = cube[:, 1, 1, 1].astype(np.float64)
    out = np.zeros((len(cube), 3))
    for axis in range(3):
        line = np.take(np.take(cube, 1, axis=[2, 1, 1][axis]), 1, axis=[2, 2, 1][axis]).astype(np.float64)
        positive: Bool = (line > 0.0).all(axis=1)
        logs = np.log(np.where(positive[:, None], line, 1.0))
        before, here, after = np.where(positive[:, None], logs, line).T
        bend = before - 2.0 * here + after
        out[:, axis] = np.where(bend < 0.0, 0.5 * (before - after) / np.where(bend < 0.0, bend, -1.0), 0.0)
    return np.clip(out, -1.0, 1.0) * (middle > 0.0)[:, None]
