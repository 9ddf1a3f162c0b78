"""Windows of a volume, their correlation, and its peaks."""

from __future__ import annotations

import itertools
import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import scipy.fft

from sabench.algorithms.velocimetry.correlation_kernels import (
    block_sums,
    circular_peaks,
    cut_windows,
    small_peaks,
)
from sabench.utils.arrays import F32, F64, I64
from sabench.utils.compiled import numba
from sabench.utils.errors import InputError
from sabench.utils.progress import progress_bar

Size = tuple[int, int, int]
_AT_ONCE = 1 << 20  # voxels of the windows that a thread transforms at once
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
    def over(cls, shape: Size, size: Size, overlap: float) -> Windows:
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
        parts = [1 if own == 1 else round(own * (1.0 - overlap)) for own in size]
        if any(part < 1 or own % part for own, part in zip(size, parts, strict=True)):
            raise InputError(
                f"overlap: expected a part of {_xyz(size)} voxels that leaves whole steps which "
                f"divide it, got {overlap:g}"
            )
        counts = [
            (there - own) // part + 1 for there, own, part in zip(shape, size, parts, strict=True)
        ]
        return cls(size, (parts[0], parts[1], parts[2]), (counts[0], counts[1], counts[2]))

    @property
    def origin(self) -> tuple[float, float, float]:
        """Middle (z, y, x) of the first window, voxels."""
        z, y, x = ((own - 1) / 2.0 for own in self.size)
        return z, y, x

    @property
    def blocks(self) -> Size:
        """Blocks (z, y, x) of one step each that the windows cover."""
        z, y, x = (
            n - 1 + own // part
            for n, own, part in zip(self.counts, self.size, self.step, strict=True)
        )
        return z, y, x


def _xyz(values: Size) -> str:
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

    The correlation is computed through sums over blocks. The second volume is shifted against the
    window, and the first one in the opposite direction; the mean of both is taken. Two equal
    volumes then have equal correlations at opposite shifts, whatever the window's faces cut.

    Parameters
    ----------
    taper : standard deviation of the Gaussian that weights a window's blocks, as a part of the
        window; None: all count alike.
    """
    shape = (*windows.blocks, math.prod(2 * r + 1 for r in search))
    products, squares = (
        (np.empty(shape, dtype=np.float32), np.empty(shape, dtype=np.float32)) for _ in range(2)
    )
    block_sums(first, second, windows.step, search, products[0], squares[0])
    block_sums(second, first, windows.step, search, products[1], squares[1])
    weights = tuple(
        _weights(own // part, taper) for own, part in zip(windows.size, windows.step, strict=True)
    )
    energies = [float(np.mean(part[..., shape[3] // 2])) for part in squares]
    floor = (
        _EMPTY
        * math.sqrt(energies[0] * energies[1])
        * math.prod(float(line.sum()) for line in weights)
        + 1e-30
    )
    shift, height = np.empty((*windows.counts, 3)), np.empty(windows.counts)
    small_peaks(products, squares, weights, search, floor, shift, height)
    return CorrelationPeaks(shift, height, None)


def _weights(blocks: int, taper: float | None) -> F32:
    """Compute the weights of a window's blocks along one axis."""
    middles = (np.arange(blocks) + 0.5) / blocks - 0.5
    return np.asarray(
        np.ones(blocks) if taper is None else np.exp(-0.5 * (middles / taper) ** 2),
        dtype=np.float32,
    )


def by_spectra(first: F32, second: F32, windows: Windows) -> CorrelationPeaks:
    """Correlate windows circularly by their Fourier transforms.

    This finds displacements up to half a window.
    """
    corners = np.array(
        list(
            itertools.product(
                *(
                    part * np.arange(count)
                    for part, count in zip(windows.step, windows.counts, strict=True)
                )
            )
        )
    )
    shift, height, ratio = (
        np.zeros((len(corners), 3)),
        np.zeros(len(corners)),
        np.zeros(len(corners)),
    )
    batch = max(1, _AT_ONCE // math.prod(windows.size))

    def correlate(start: int) -> None:
        part = slice(start, start + batch)
        planes, scale = _correlate(first, second, corners[part], windows.size)
        circular_peaks(planes, shift[part], height[part], ratio[part])
        height[part] /= np.where(scale > 0.0, scale, np.inf)

    with ThreadPoolExecutor(numba.get_num_threads()) as pool:
        for done in progress_bar(
            [pool.submit(correlate, start) for start in range(0, len(corners), batch)],
            "correlate by spectra",
        ):
            done.result()
    textured = height > 0.0
    return CorrelationPeaks(
        (shift * textured[:, None]).reshape(*windows.counts, 3),
        height.reshape(windows.counts),
        (ratio * textured).reshape(windows.counts),
    )


def _correlate(first: F32, second: F32, corners: I64, size: Size) -> tuple[F32, F64]:
    """Correlate windows (n, z, y, x) circularly and multiply their norms."""
    spectra, energies = [], []
    for volume in (first, second):
        cut, energy = np.empty((len(corners), *size), dtype=np.float32), np.empty(len(corners))
        cut_windows(volume, corners, cut, energy)
        spectra.append(scipy.fft.rfftn(cut, axes=(1, 2, 3)))
        energies.append(energy)
    product = np.conjugate(spectra[0], out=spectra[0])
    product *= spectra[1]
    return scipy.fft.irfftn(product, s=size, axes=(1, 2, 3), overwrite_x=True), np.sqrt(
        energies[0] * energies[1]
    )
