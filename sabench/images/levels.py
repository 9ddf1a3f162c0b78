"""Grey values of no light, of saturation and of bright particles.

`GreyValues` estimates black and white from a histogram of raw images; `bright_dn` gives the scale
that makes all cameras count alike. The dark level and noise at each pixel are in `dark_noise`.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from sabench.images.dark_noise import FEWEST
from sabench.utils.arrays import F32, I64, U16, Bool

# Black and white:
DEPTHS = (8, 10, 12, 14, 16)
_DARKEST = 1e-4  # of the pixels of a backlit image
_TAIL = 0.02  # of the pixels: darker than nearly all
_NEAR = 0.02  # of the highest grey value: saturated pixels are that near to it
_CLIPPED = 5.0  # times as many pixels near the highest value as just below: saturation

# Bright particles:
PERCENTILE = 95.0  # of the illuminated pixels: becomes 1
ILLUMINATED = 0.1  # of the brightest pixel


@dataclass(frozen=True)
class GreyLevels:
    """Levels of one camera.

    Attributes
    ----------
    black_dn, white_dn : grey values of no light and of saturation.
    bit_depth : least of 8, 10, 12, 14 and 16 bits that hold all grey values.
    saturated : share of the pixels at `white_dn` or above.
    """

    black_dn: float
    white_dn: float
    bit_depth: int
    saturated: float


@dataclass
class GreyValues:
    """Histogram of the grey values of one camera's images."""

    counts: I64 = field(default_factory=lambda: np.zeros(1 << DEPTHS[-1], np.int64))

    def add(self, image: U16, counts: Bool | None = None) -> None:
        """Add an image (row, column), without the pixels that do not count."""
        used = image if counts is None else image[counts]
        self.counts += np.bincount(used.ravel(), minlength=len(self.counts))

    @property
    def bit_depth(self) -> int:
        """Least of 8, 10, 12, 14 and 16 bits that hold all grey values."""
        return next(depth for depth in DEPTHS if self._highest < 1 << depth)

    @property
    def _highest(self) -> int:
        return int(np.flatnonzero(self.counts)[-1]) if self.counts.any() else 0

    def levels(self, bit_depth: int, *, backlit: bool = False) -> GreyLevels:
        """Estimate the levels of a sensor of so many bits.

        Black is the mean of the most frequent values, those of the dark between particles; in
        backlit images, which have no dark, it is the least value but for one pixel in ten thousand.
        White is the median of the highest values if far more pixels have them than those just
        below, else the largest value of the bit depth.
        """
        white = self._white((1 << bit_depth) - 1)
        black = float(self._quantile(_DARKEST)) if backlit else self._most_frequent()
        saturated = self.counts[int(white) :].sum() / max(self.counts.sum(), 1)
        return GreyLevels(min(black, white - 1.0), white, bit_depth, float(saturated))

    def _quantile(self, share: float) -> int:
        up_to = np.cumsum(self.counts)
        return int(np.searchsorted(up_to, share * up_to[-1], side="right"))

    def _most_frequent(self) -> float:
        """Average values around the most frequent one, as far as the darkest are from it."""
        reach = max(int(np.argmax(self.counts)) - self._quantile(_TAIL), 1)
        wide = np.convolve(self.counts, np.ones(reach), mode="same")
        middle = int(np.argmax(wide)) if reach > 2 else int(np.argmax(self.counts))
        first, last = max(middle - reach, 0), middle + reach + 1
        counts = self.counts[first:last]
        if not counts.any():
            return 0.0
        return float(np.average(np.arange(first, first + len(counts)), weights=counts))

    def _white(self, largest: int) -> float:
        highest = self._highest
        near = max(1, round(_NEAR * highest))
        first = highest - near + 1
        top, below = self.counts[first : highest + 1], self.counts[max(first - near, 0) : first]
        clipped = top.sum() >= max(FEWEST, _CLIPPED * below.sum()) and 2 * highest > largest
        middle = np.searchsorted(np.cumsum(top), 0.5 * top.sum())
        return float(first + middle if clipped else largest)


def normalise(images: U16, black_dn: float, unknown: Bool | None = None) -> F32:
    """Scale images to a bright particle's peak in the same camera, `bright_dn`.

    Cameras record particles at different scattering angles and so at very different brightness; a
    common scale makes them count alike (the thesis matches histograms to the same end, section
    2.3). Returns (camera, row, column) fractions of the bright level, black level subtracted.

    Parameters
    ----------
    images : (camera, row, column) grey values.
    black_dn : grey value without light.
    unknown : (camera, row, column) pixels that do not count for the scale.
    """
    scaled: F32 = np.empty(images.shape, dtype=np.float32)
    for number, (grey, image) in enumerate(zip(images, scaled, strict=True)):
        level = bright_dn(grey, black_dn, None if unknown is None else unknown[number])
        image[:] = np.maximum(grey.astype(np.float64) - black_dn, 0.0) * (1.0 / max(level, 1.0))
    return scaled


def bright_dn(grey: U16, black_dn: float, unknown: Bool | None = None) -> float:
    """Compute the bright level of an image: a percentile of its illuminated pixels.

    It is the 95th percentile, interpolated linearly, of grey values less black of the pixels that
    exceed a tenth of the brightest, without unknown ones; 0 without any. Pixels brighter than four
    typical peaks (`repair.peak_light`) count as four: a few of them may be anything.
    """
    from sabench.images.repair import BRIGHT, above_background, peak_light  # loads numba

    peak = peak_light(*above_background(grey))
    pixels = grey.ravel() if unknown is None else grey[~unknown]
    counts = np.bincount(pixels, minlength=1)
    levels = np.maximum(np.arange(len(counts)) - black_dn, 0.0)
    brightest = min(levels[-1], BRIGHT * peak) if peak else levels[-1]
    counts[levels <= ILLUMINATED * brightest] = 0
    up_to = np.cumsum(counts)
    if up_to[-1] == 0:
        return 0.0
    rank = PERCENTILE / 100.0 * (up_to[-1] - 1)
    low, high = (
        levels[np.searchsorted(up_to, math.floor(rank) + step, side="right")]
        for step in (0, min(1, math.ceil(rank) - math.floor(rank)))
    )
    return float(low + (rank - math.floor(rank)) * (high - low))
