"""Dark level and noise of images by tiles, and thresholds of false alarms.

Model. Where no particle is, a grey value is level + noise, rounded to grey values and cut at black.
Level and noise change slowly over the image. The noise has a gamma distribution with one skewness,
that of few photons (Pearson's type III), which is normal without any.

Estimate. Particles only add light, so that the darker part of a tile's grey values is noise. The
borders between whole grey values are compared with the noise's distribution, quantile by quantile
(M. B. Wilk and R. Gnanadesikan, Biometrika 55, 1-17, 1968): a line through border over deviate has
the level where the deviate is 0, and the noise as slope. Rounding changes nothing, and what black
hides is left out. A tile's noise is the median of those around it; a tile with more shows light.
The skewness is the one whose line is straightest, for all pixels less their level, over their
noise.

Which pixels. Those with the darkest surroundings, 30 % of each tile, come first, and 10, 3 and 1 %
of larger tiles. If they show one noise, bright pixels are left out with a square around each, the
others measured again, and so on. If the darker ones show less noise, light covers the others: of
dense particles, if many pixels are brighter than the darkest ones' noise and neighbours are alike.
Then the largest share counts that shows as little noise as the smallest. Else noise is smoothed, or
the background has dark parts: bright pixels are left out, beginning with all. Where black hides
every quantile that counts, all would show light: the first 30 % begin, and may show too little.

Stopping. When the noise no longer falls, or when few pixels remain.

Threshold. The grey value that noise exceeds with the stated probability; rounding adds its
variance. `repair.above_background` measures one noise of an image, faster and coarser.
"""

import functools
import itertools
from dataclasses import dataclass

import numpy as np

from sabench.utils.arrays import F32, F64, I64, U16, Bool
from sabench.utils.errors import InputError

FALSE_ALARMS = 1e-5  # per pixel

_TILE_PX = 32  # edge of tiles: many pixels, without much change of the level
FEWEST = 10  # pixels, or peaks, that show a property of an image
LOW = 0.05  # of the pixels, the darkest ones, do not count; if more are black, black cuts noise
_HIGH_Z, _SPAN_Z = 0.25, 1.0  # largest normal deviate of pixels that count, and least range of it
_SHARES = 0.3, 0.1, 0.03, 0.01  # of the pixels, those with the darkest surroundings
_AROUND_PX = 5  # edge of a pixel's surroundings
_LIGHT = 1.3  # times as much noise as calmer pixels or tiles around show: light
# of neighbours, less their surroundings: 0.55 to 0.67 of particles, 0.51 of noise
_SAME_SIGN = 0.53
_SKEW_Z = np.linspace(-2.6, 0.4, 31)  # quantiles for the skewness, as normal deviates
_MOST_SKEW = 2.0


@dataclass(frozen=True)
class DarkNoise:
    """Dark level and noise of the images of one camera.

    Attributes
    ----------
    level : (row, column) mean grey value without particles.
    noise : (row, column) its standard deviation before rounding, with what differs from pixel to
        pixel.
    skewness : (row, column) of its distribution.
    step : difference of neighbouring grey values.
    """

    level: F32
    noise: F32
    skewness: F32
    step: float

    def threshold(self, false_alarms: float = FALSE_ALARMS) -> F32:
        """Compute grey values (row, column) that noise reaches with a probability.

        The probability is from 0 to 0.5.

        Local maxima of noise are fewer than pixels above the threshold: where neighbours are
        independent, the probability is nearly that of a false peak.
        """
        if not 0.0 < false_alarms < 0.5:
            raise InputError(
                f"false_alarms: expected a probability between 0 and 0.5, got {false_alarms:g}"
            )
        rounded = np.sqrt(self.noise**2 + np.float32(self.step**2 / 12.0))
        grid = np.linspace(0.0, _MOST_SKEW, 61)
        away = rounded * np.interp(
            self.skewness, grid, [-_deviates(-skewness, false_alarms) for skewness in grid]
        )
        return np.asarray(self.level + away, dtype=np.float32)

    @functools.cached_property
    def reach(self) -> float:
        """Typical distance of the usual threshold and the level."""
        return float(np.median(self.threshold() - self.level))


def measure_dark_noise(images: U16, valid: Bool | None = None) -> DarkNoise:
    """Measure the dark level and noise of images (frame, row, column) of one camera.

    Only known pixels, of the same shape or (row, column), count. Noise is measured up to about one
    particle on two pixels.
    """
    import cv2  # takes long to load
    from scipy.special import ndtr

    if images.ndim != 3 or not images.size:
        raise InputError(f"images: expected the shape (frame, row, column), got {images.shape}")
    counts = np.array(np.broadcast_to(True if valid is None else valid, images.shape))
    step = _grey_step(images[counts])
    # each pixel's surroundings without itself, so that independent noise of pixels with dark
    # surroundings is distributed as that of all
    grey, size = images.astype(np.float32), (_AROUND_PX, _AROUND_PX)
    around = np.stack([cv2.boxFilter(frame, -1, size, normalize=False) - frame for frame in grey])
    known = counts.sum()
    shares = [share for share in _SHARES if share * known >= FEWEST] or _SHARES[:1]
    calm = [_measure_calm(images, counts, around, step, share) for share in shares]
    black = images == images.min(initial=np.iinfo(np.uint16).max, where=counts)
    hidden = (counts & black).sum() > ndtr(_HIGH_Z) * known  # all quantiles that count
    if hidden:
        return _leave_out_bright(images, counts, step, calm[0], most=np.inf)
    if calm[0].reach <= _LIGHT * min(noise.reach for noise in calm):
        return _leave_out_bright(images, counts, step, calm[0])
    bright = counts & (images > calm[-1].threshold())
    rest: F32 = np.asarray(grey - around / (_AROUND_PX**2 - 1), dtype=np.float32)
    if bright.sum() > _SHARES[0] * known and _show_particles(rest, bright):
        return next(noise for noise in calm if noise.reach <= _LIGHT * calm[-1].reach)
    return _leave_out_bright(images, counts, step, _measure(images, counts, step, _TILE_PX))


def noise_cut_by_black(grey: U16, valid: Bool, black_dn: float) -> float:
    """Measure the noise of an image (row, column) if black cuts it, otherwise 0."""
    least = grey[valid].min() if valid.any() else 0
    if least < black_dn or np.mean(grey[valid] == least) <= LOW:
        return 0.0
    return float(np.median(measure_dark_noise(grey[None], valid).noise))


def _measure_calm(images: U16, counts: Bool, around: F32, step: float, share: float) -> DarkNoise:
    edge, calm = _TILE_PX * (_SHARES[0] / share) ** 0.5, counts.copy()
    for light, marks in zip(around, calm, strict=True):
        for tile in _tiles(light.shape, edge).values():
            if marks[tile].any():
                marks[tile] &= light[tile] <= np.quantile(light[tile][marks[tile]], share)
    return _measure(images, calm, step, edge)


def _leave_out_bright(
    images: U16, counts: Bool, step: float, noise: DarkNoise, most: float = _LIGHT
) -> DarkNoise:
    """Measure pixels far from bright ones, as long as the noise falls.

    At first it may grow `most` times.
    """
    import cv2  # takes long to load

    halo = np.ones((_AROUND_PX, _AROUND_PX), np.uint8)
    while True:
        bright = (images >= noise.threshold()).astype(np.uint8)
        dark = counts & ~np.stack([cv2.dilate(frame, halo) > 0 for frame in bright])
        if dark.mean() < LOW:
            return noise
        now = _measure(images, dark, step, _TILE_PX, noise)
        if now.reach >= most * noise.reach:
            return noise
        noise, most = now, 1.0


def _show_particles(rest: F32, bright: Bool) -> bool:
    """Return whether bright pixels look like dense particles, not a background.

    Less their surroundings, neighbours often have the same sign (N. Blomqvist, Ann. Math. Statist.
    21, 593-600, 1950); those of photon noise are independent.
    """
    both = bright[:, :, 1:] & bright[:, :, :-1]
    if not both.any():
        return False
    above = rest > np.median(rest[bright])
    return bool(np.mean((above[:, :, 1:] == above[:, :, :-1])[both]) > _SAME_SIGN)


def _grey_step(values: U16) -> float:
    """Compute the usual difference of neighbouring values of darker pixels."""
    counts = np.bincount(values) if len(values) else np.ones(1, dtype=np.int64)
    levels = np.flatnonzero(counts)
    share = np.cumsum(counts[levels]) / counts.sum()
    apart = np.diff(levels[: max(int(np.searchsorted(share, 0.9)) + 1, 2)])
    return float(np.median(apart)) if len(apart) else 1.0


def _measure(
    images: U16, counts: Bool, step: float, edge: float, before: DarkNoise | None = None
) -> DarkNoise:
    """Measure noise by tiles, less a level that was measured before."""
    if before is None:
        nothing = np.zeros(images.shape[1:], dtype=np.int64)
        level, noise = _by_tile(images, counts, nothing, edge, 0.0)
    else:
        level, noise = before.level, before.noise
    skewness = _skewness(images, counts, level, noise, step)
    whole = (step * np.rint(level / step)).astype(np.int64)
    level, noise = _by_tile(images, counts, whole, edge, skewness)
    # few photons: the third moment grows as the variance
    skewed = abs(skewness) * np.median(noise) / np.maximum(noise, np.finfo(np.float32).tiny)
    return DarkNoise(level, noise, np.minimum(skewed, np.float32(_MOST_SKEW)), step)


def _by_tile(
    images: U16, counts: Bool, whole: I64, edge: float, skewness: float
) -> tuple[F32, F32]:
    """Measure level and noise (row, column) of images less whole numbers, by tiles.

    Tiles with few pixels, and the levels of those with much more noise than those around, are the
    nearest other tile's.
    """
    from scipy.ndimage import median_filter

    rest, size = images - whole, whole.shape
    tiles = _tiles(size, edge)
    mean, deviation = np.full((2, *np.add(max(tiles), 1)), np.nan)
    for number, where in tiles.items():
        sample = rest[:, *where][counts[:, *where]]
        if len(sample) >= FEWEST:
            black = -int(whole[where].min())
            mean[number], deviation[number] = _fit_quantiles(sample, black, skewness)
    if np.isnan(mean).all():
        sample = rest[counts] if counts.any() else rest.ravel()
        mean[:], deviation[:] = _fit_quantiles(sample, -int(whole.min()), skewness)
    deviation = _fill(deviation)
    noise = median_filter(deviation, 3, mode="nearest")
    mean[deviation > _LIGHT * noise] = np.nan
    spread = np.clip(_spread(noise, size), noise.min(), noise.max())
    return (whole + _spread(_fill(mean), size)).astype(np.float32), spread.astype(np.float32)


def _fill(tiles: F64) -> F64:
    """Give tiles without a value that of the nearest other one."""
    from scipy.ndimage import distance_transform_edt

    nearest = distance_transform_edt(np.isnan(tiles), return_distances=False, return_indices=True)
    return np.asarray(tiles[tuple(nearest)])


def _tiles(size: tuple[int, ...], edge: float) -> dict[tuple[int, int], tuple[slice, slice]]:
    """Cut an image into tiles of about so many pixels along an edge."""
    down, across = (
        [slice(int(a), int(b)) for a, b in itertools.pairwise(np.linspace(0, n, count + 1).round())]
        for n, count in ((n, max(round(n / edge), 1)) for n in size)
    )
    return {(i, j): (a, b) for i, a in enumerate(down) for j, b in enumerate(across)}


def _fit_quantiles(values: I64, black: int, skewness: float) -> tuple[float, float]:
    """Fit noise of a skewness to the darker part of whole numbers.

    A line is fitted to the borders between them over the deviates of the shares below. Where noise
    is cut at black, borders farther up count, too, and none below it.
    """
    from scipy.special import ndtri

    least = int(values.min())
    counts = np.bincount(values - least)
    levels = np.flatnonzero(counts)
    if len(levels) == 1:
        return float(least), 0.0
    share = np.cumsum(counts[levels])[:-1] / len(values)
    z: F64 = ndtri(share)
    border: F64 = (least + 0.5 * (levels[1:] + levels[:-1])).astype(np.float64)
    if len(z) == 1:  # the more frequent value is the mean
        middle = least + levels[0 if share[0] > 0.5 else 1]
        return float(middle), abs(float((border[0] - middle) / (z[0] or 1.0)))
    first = max(int(np.searchsorted(share, LOW)), int(np.searchsorted(border, black)))
    first = min(first, len(share) - 2)
    last = int(np.searchsorted(z, max(_HIGH_Z, z[first] + _SPAN_Z), side="right"))
    used = np.s_[first : max(last, first + 2)]
    level, noise, _ = _fit_line(border[used], share[used], skewness)
    return level, noise


def _fit_line(quantiles: F64, share: F64, skewness: float) -> tuple[float, float, float]:
    """Fit level and noise to quantiles; return the mean square of what is left, too."""
    from scipy.special import ndtri

    weight = np.exp(-(ndtri(share) ** 2)) / (share * (1.0 - share))
    weight /= weight.sum()
    z = _deviates(skewness, share)
    center, middle = weight @ z, weight @ quantiles
    noise = weight @ ((z - center) * (quantiles - middle)) / (weight @ (z - center) ** 2)
    rest = quantiles - middle - noise * (z - center)
    return float(middle - noise * center), float(noise), float(weight @ rest**2)


def _skewness(images: U16, counts: Bool, level: F32, noise: F32, step: float) -> float:
    """Fit the skewness of all dark pixels to their quantiles.

    It is 0 where black cuts them, or where the noise is less than a grey value. Pixels are spread
    over theirs.
    """
    from scipy.optimize import minimize_scalar
    from scipy.special import ndtr

    dark = images[counts]
    if len(dark) < FEWEST or np.mean(dark == dark.min()) > LOW or noise.min() < step:
        return 0.0
    spread = dark + step * (np.random.default_rng(0).random(len(dark)) - 0.5)
    of = np.nonzero(counts)[1:]
    share = ndtr(_SKEW_Z)
    quantiles: F64 = np.quantile((spread - level[of]) / noise[of], share).astype(np.float64)
    bounds = -_MOST_SKEW, _MOST_SKEW
    return float(minimize_scalar(lambda one: _fit_line(quantiles, share, one)[2], bounds=bounds).x)


def _deviates(skewness: float, share: F64 | float) -> F64:
    """Compute how many deviations a share of noise of a skewness lies below."""
    from scipy.special import gammainccinv, gammaincinv, ndtri

    if not skewness:
        return np.asarray(ndtri(share))
    shape = 4.0 / skewness**2
    mirrored = skewness < 0.0
    away = (gammainccinv if mirrored else gammaincinv)(shape, share) - shape
    return np.asarray((-away if mirrored else away) / np.sqrt(shape))


def _spread(tiles: F64, size: tuple[int, ...]) -> F64:
    """Interpolate tiles' values linearly, also beyond the outer centres."""
    from scipy.interpolate import make_interp_spline

    for axis, (count, pixels) in enumerate(zip(tiles.shape, size, strict=True)):
        if count == 1:
            tiles = np.repeat(tiles, pixels, axis)
        else:
            centers = (np.arange(count) + 0.5) * pixels / count - 0.5
            tiles = make_interp_spline(centers, tiles, 1, axis=axis)(np.arange(pixels))
    return tiles
