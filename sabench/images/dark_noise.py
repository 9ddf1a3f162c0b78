"""Dark level and noise of images by tiles, and thresholds of false alarms.

Model. Where no particle is, a grey value is level + noise, rounded to grey values and cut at black.
Level and noise change slowly over the image; the noise's distribution is a gamma distribution with
one skewness, that of few photons (Pearson's type III), which is normal without any.

Estimate. Particles only add light, so that the darker part of a tile's grey values is noise. The
borders between whole grey values are compared with a normal distribution, quantile by quantile
(M. B. Wilk and R. Gnanadesikan, Biometrika 55, 1-17, 1968): a line through border over normal
deviate has the level where the deviate is 0, and the noise as slope. Rounding changes nothing, and
what black hides is left out. The level comes from tiles of 32 pixels; the noise, and what the level
lacks, from tiles of 64; the skewness from all pixels less their level, over their noise (`_shape`).

Which pixels. `measure_dark_noise` begins with the pixels that have the darkest surroundings, 30 %
of each tile. If these show much more than 10, 3 or 1 % of them do, light covers the image: the
largest share that agrees with the darkest is taken, unless the bright pixels look like a
background (`_show_particles`). Otherwise bright pixels are left out with a square of 7 pixels
around each, the others measured again, and so on.

Stopping. When fewer than 2 % of the pixels go, when the noise no longer falls (the first time: when
it rises by half, as from dim particles where black cuts the noise), or when fewer than 5 % remain.

Threshold. The grey value that the distribution exceeds with the stated probability, plus half a
grey value for the rounding: an upper bound of false alarms per pixel.

Other modules measure one noise of an image, faster and coarser, and thresholds depend on
their digits: `repair.above_background` (median distance of the darker half to the median of 3 x 3
pixels), `widths.noise_below_black` (values below black, where the background is subtracted), and
`interop.image_statistics.background_noise` (median distance of dark pixels to the median).
"""

import itertools
from dataclasses import dataclass

import numpy as np

from sabench.utils.arrays import F32, F64, I64, U16, Bool
from sabench.utils.errors import InputError

FALSE_ALARMS = 1e-5  # per pixel

_TILE_PX = 32  # edge of tiles for the dark level: many pixels, without much change of it
_GROUP = 2  # tiles for the noise have so many times that edge
_FEW = 64  # too few pixels of a tile
_LOW = 0.02  # share of a tile's pixels, the darkest ones, that does not count
_HIGH_Z = 0.25  # largest normal deviate of pixels that count
# how many normal deviates they span at least: few while there are particles among them
_NARROW_Z, _WIDE_Z = 0.5, 1.3
_OUTLIER = 1.5  # times the noise around a tile: what it shows is something else
_FINEST = 0.15  # grey values: least noise that rounding leaves visible
_ROUNDS = 4  # of leaving out particles
_BRIGHT = 2.0  # times the threshold above the dark level: particles
_HALO_PX = 7  # edge of the square around each bright pixel that is left out
_AROUND_PX = 5  # edge of a pixel's surroundings
_CALM = 0.3  # of a tile's pixels, those with the darkest surroundings
# where light covers most of an image, fewer of them, among which are fewer particles
_CALMER = (0.1, 0.03, 0.01)
_FEW_CALM = 500  # too few pixels of all images
_COVERED = 0.5  # of the pixels are above the threshold of the calmest ones
# of particles, in pixels less their surroundings: skewness, and share of neighbours with one sign
_SKEWED, _SAME_SIGN = 0.05, 0.55
_LIGHT = 1.3  # times the distance of threshold and level of the calmest: light of particles
_SETTLED = 0.98  # of the pixels remain: those left out change nothing
_LEAST_SHARE = 0.05  # of the pixels: if fewer remain, the search for darker ones ends
_SKEW_Z = np.linspace(-2.6, 0.4, 31)  # quantiles for the skewness, as normal deviates
_BRIGHT_Z = np.linspace(0.3, 1.2, 10)  # those that hold where the darker ones are cut
_ODD_SKEW = 0.6  # of fewer than three photons a pixel: the darker part has been cut
_TOP_SHARE, _TOP_Z = 0.97725, 2.0  # a quantile beyond them
_BEND = 1.4  # times as far as on a line: there is light of particles
_PARTICLES = 8.0  # times the scale of the darker part: particles, and no noise
_SKEW_STEPS = 1.0  # noise in grey values below which the shape of its distribution is not seen
_CUT = 0.05  # of the pixels are black: half of the distribution is not seen
_CUT_TILE = 0.1  # the same for a tile
_MOST_SKEW = 2.0
_LOWEST = 3.0  # standard deviations of the dark level below zero, where black hides nearly all
_GOLDEN = 0.6180339887498949


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

        The distribution is a gamma distribution with the noise's skewness (Pearson's type III),
        which is normal without any, rounded to grey values. Local maxima of noise are fewer than
        pixels above the threshold: the probability is an upper bound of false peaks per pixel,
        nearly reached where neighbours are independent.
        """
        if not 0.0 < false_alarms < 0.5:
            raise InputError(
                f"false_alarms: expected a probability between 0 and 0.5, got {false_alarms:g}"
            )
        away = self.noise * _deviates(self.skewness, false_alarms)
        return np.asarray(self.level + away + np.float32(0.5 * self.step), dtype=np.float32)


def measure_dark_noise(images: U16, valid: Bool | None = None) -> DarkNoise:
    """Measure the dark level and noise of images (frame, row, column) of one camera.

    Bright pixels and their surroundings are left out, again and again, as long as darker ones
    remain. If particles are too dense for that, the pixels with the darkest surroundings are
    measured, which show noise up to about one particle on two pixels. Only known pixels, of the
    same shape or (row, column), count.
    """
    import cv2  # takes long to load

    if images.ndim != 3 or not images.size:
        raise InputError(f"images: expected the shape (frame, row, column), got {images.shape}")
    counts = np.array(np.broadcast_to(True if valid is None else valid, images.shape))
    step = _grey_step(images[counts])
    # each pixel's surroundings without itself, so that independent noise of pixels with dark
    # surroundings is distributed as that of all
    grey, size = images.astype(np.float32), (_AROUND_PX, _AROUND_PX)
    around = np.stack([cv2.boxFilter(frame, -1, size, normalize=False) - frame for frame in grey])
    calm = _measure_calm(images, counts, around, step, _CALM)
    dense = _measure_dense(images, counts, around, step, calm)
    return _leave_out_bright(images, counts, step, calm) if dense is None else dense


def noise_cut_by_black(grey: U16, valid: Bool, black_dn: float) -> float:
    """Measure the noise of an image (row, column) if black cuts it.

    It is 0 if the noise shows below black.
    """
    least = grey[valid].min() if valid.any() else 0
    if least < black_dn or np.mean(grey[valid] == least) <= _CUT:
        return 0.0
    return float(np.median(measure_dark_noise(grey[None], valid).noise))


def _measure_calm(images: U16, counts: Bool, around: F32, step: float, share: float) -> DarkNoise:
    edge = _TILE_PX * (_CALM / share) ** 0.5
    calm = counts.copy()
    for light, marks in zip(around, calm, strict=True):
        for tile in _tiles(light.shape, edge).values():
            if marks[tile].any():
                marks[tile] &= light[tile] <= np.quantile(light[tile][marks[tile]], share)
    return _measure(images, calm, step, _NARROW_Z, edge)


def _measure_dense(
    images: U16, counts: Bool, around: F32, step: float, usual: DarkNoise
) -> DarkNoise | None:
    """Measure as many calm pixels as show no light, if it covers most others.

    None if it does not, if it is a background, or if the usual share of the pixels is calm enough.
    A background may have dark, calm bodies before it, but its pixels are spread evenly about those
    around them, while particles are brighter than what is around them.
    """
    shares = [share for share in _CALMER if share * counts.sum() >= _FEW_CALM]
    if not shares:
        return None
    least = _measure_calm(images, counts, around, step, shares[-1])
    bright = counts & (images > least.threshold())
    covered = bright.sum() >= _COVERED * counts.sum()
    if not covered or not _show_particles(images, around, bright, step):
        return None
    more = (_measure_calm(images, counts, around, step, share) for share in shares[:-1])
    far = float(np.median(least.threshold() - least.level))
    for calm in (usual, *more):
        reach = float(np.median(calm.threshold() - calm.level))
        if reach <= _LIGHT * far and far <= _LIGHT * reach:
            return None if calm is usual else calm
    return least


def _leave_out_bright(images: U16, counts: Bool, step: float, noise: DarkNoise) -> DarkNoise:
    """Measure pixels far from bright ones, which are left out again and again."""
    import cv2  # takes long to load

    dark, halo = counts, np.ones((_HALO_PX, _HALO_PX), np.uint8)
    for round_ in range(_ROUNDS):
        limit = noise.level + np.float32(_BRIGHT) * (noise.threshold() - noise.level)
        bright = (images >= limit).astype(np.uint8)
        darker = dark & ~np.stack([cv2.dilate(frame, halo) > 0 for frame in bright])
        if darker.sum() < _LEAST_SHARE * counts.sum():
            break
        now = _measure(images, darker, step, _WIDE_Z)
        rise = np.median(now.threshold() - now.level) / np.median(noise.threshold() - noise.level)
        if rise >= (1.0 if round_ else _OUTLIER):
            break
        noise = now
        if darker.sum() > _SETTLED * dark.sum():
            break
        dark = darker
    return noise


def _show_particles(images: U16, around: F32, bright: Bool, step: float) -> bool:
    """Return whether bright pixels look like dense particles, not a background.

    Compared with their surroundings, those of particles are skewed (by quartiles: A. L. Bowley,
    Elements of Statistics, 1901), and neighbours often have the same sign (N. Blomqvist, Ann. Math.
    Statist. 21, 593-600, 1950). Photon noise has independent signs, smoothed noise is not skewed.
    Tails that edges of bodies make change neither.
    """
    rest = images - around / np.float32(_AROUND_PX**2 - 1)
    values = _dithered(rest[bright], step)
    low, middle, high = np.quantile(values, [0.25, 0.5, 0.75])
    skewness = (low + high - 2.0 * middle) / max(high - low, 1e-9)
    both = bright[:, :, 1:] & bright[:, :, :-1]
    above = rest > middle
    same = np.mean((above[:, :, 1:] == above[:, :, :-1])[both])
    return bool(skewness > _SKEWED and same > _SAME_SIGN)


def _dithered(values: F64 | F32, width: float) -> F64:
    """Spread whole numbers evenly over a width around them."""
    return np.asarray(values + width * (np.modf(_GOLDEN * np.arange(len(values)))[0] - 0.5))


def _grey_step(values: U16) -> float:
    """Compute the usual difference of neighbouring values of darker pixels."""
    counts = np.bincount(values) if len(values) else np.ones(1, dtype=np.int64)
    levels = np.flatnonzero(counts)
    share = np.cumsum(counts[levels]) / counts.sum()
    apart = np.diff(levels[: max(int(np.searchsorted(share, 0.9)) + 1, 2)])
    return float(np.median(apart)) if len(apart) else 1.0


def _measure(
    images: U16, counts: Bool, step: float, span: float, edge: float = _TILE_PX
) -> DarkNoise:
    """Measure the level by tiles, and the noise of the rest by larger ones."""
    size = images.shape[1:]
    black = np.zeros(size, dtype=np.int64)
    level = _spread(_by_tile(images, counts, edge, black, span)[0], size)
    whole = (step * np.rint(level / step)).astype(np.int64)
    rest = images - whole
    offset, noise = _by_tile(rest, counts, _GROUP * edge, -whole, span)
    noise = np.maximum(noise, _FINEST * step)
    least, most = float(noise.min()), float(noise.max())
    wide = [_spread(offset, size), np.clip(_spread(noise, size), least, most)]
    shift, scale, skewness = _shape(images, rest, counts, wide[0], wide[1], step)
    deviation = np.maximum(scale * wide[1], _FINEST * step)
    level = np.maximum(whole + wide[0] + shift * wide[1], -_LOWEST * deviation)
    # few photons: the third moment grows as the variance
    skewed = np.minimum(skewness * float(np.median(deviation)) / deviation, _MOST_SKEW)
    to = np.float32
    return DarkNoise(level.astype(to), deviation.astype(to), skewed.astype(to), step)


def _by_tile(
    values: I64 | U16, counts: Bool, edge: float, black: I64, span: float
) -> tuple[F64, F64]:
    """Measure mean and standard deviation of each tile.

    Tiles with few pixels, or with unusual noise, get those of the nearest other one. Black (row,
    column) is the least of all possible values.
    """
    from scipy.ndimage import median_filter

    tiles = _tiles(values.shape[1:], edge)
    mean, deviation = (np.full(np.add(max(tiles), 1), np.nan) for _ in range(2))
    for number, where in tiles.items():
        sample = values[:, *where][counts[:, *where]]
        if len(sample) >= _FEW:
            mean[number], deviation[number] = _fit_quantiles(sample, int(black[where].max()), span)
    if np.isnan(mean).all():
        sample = values[counts] if counts.any() else values.ravel()
        mean[:], deviation[:] = _fit_quantiles(sample, int(black.max()), span)
    mean, deviation = _fill(mean), _fill(deviation)
    around = median_filter(deviation, 3, mode="nearest")
    far = np.maximum(deviation, around) > _OUTLIER * np.minimum(deviation, around)
    far &= np.abs(deviation - around) > _FINEST * _OUTLIER
    if not far.all():
        mean[far] = deviation[far] = np.nan
    return _fill(mean), _fill(deviation)


def _tiles(size: tuple[int, ...], edge: float) -> dict[tuple[int, int], tuple[slice, slice]]:
    """Cut an image into tiles of about so many pixels along an edge."""
    down, across = (
        [slice(int(a), int(b)) for a, b in itertools.pairwise(np.linspace(0, n, count + 1).round())]
        for n, count in ((n, max(round(n / edge), 1)) for n in size)
    )
    return {(i, j): (a, b) for i, a in enumerate(down) for j, b in enumerate(across)}


def _fill(tiles: F64) -> F64:
    from scipy.ndimage import distance_transform_edt

    missing = np.isnan(tiles)
    if not missing.any():
        return tiles
    nearest = distance_transform_edt(missing, return_distances=False, return_indices=True)
    return np.asarray(tiles[tuple(nearest)])


def _fit_quantiles(values: I64 | U16, black: int, span: float) -> tuple[float, float]:
    """Fit a normal distribution to the darker part of whole numbers.

    A line is fitted to the borders between them over the normal deviates of the shares below. Where
    noise is cut at black, borders farther up count, too, and none below it.
    """
    from scipy.special import ndtri

    least = int(values.min())
    counts = np.bincount(values.astype(np.int64) - least)
    levels = np.flatnonzero(counts)
    if len(levels) == 1:
        return float(least), 0.0
    share = np.cumsum(counts[levels])[:-1] / len(values)
    border, z = least + 0.5 * (levels[1:] + levels[:-1]), ndtri(share)
    if len(z) == 1:  # the more frequent value is the mean
        middle = least + levels[0 if share[0] > 0.5 else 1]
        return float(middle), abs(float((border[0] - middle) / (z[0] or 1.0)))
    first = max(int(np.searchsorted(share, _LOW)), int(np.searchsorted(border, black)))
    first = min(first, len(share) - 2)
    high = z[first] + span if share[0] > _CUT_TILE else max(_HIGH_Z, z[first] + span)
    last = int(np.searchsorted(z, high, side="right"))
    used = np.s_[first : max(last, first + 2)]
    share, border, z = share[used], border[used], z[used]
    weight = np.exp(-z * z) / (share * (1.0 - share))
    center, middle = np.average(z, weights=weight), np.average(border, weights=weight)
    slope = np.sum(weight * (z - center) * (border - middle)) / np.sum(weight * (z - center) ** 2)
    return float(middle - slope * center), float(slope)


def _shape(
    images: U16, rest: I64, counts: Bool, offset: F64, noise: F64, step: float
) -> tuple[float, float, float]:
    """Fit shift, scale and skewness to the distribution of all tiles.

    Quantiles of a skewed distribution follow a parabola over the normal deviates (E. A. Cornish and
    R. A. Fisher, Rev. Inst. Int. Stat. 5, 307-320, 1938); those of the darker part are fitted. A
    longer tail to the dark counts as one to the bright. If black cuts the darker part, or if it was
    cut and then smoothed, a line through brighter quantiles is used, unless these bend upwards as
    those of particles do. Pixels are spread over their grey value.
    """
    values = ((rest - offset) / noise)[counts]
    if len(values) < _FEW or np.median(noise) < _SKEW_STEPS * step:
        return 0.0, 1.0, 0.0
    values = _dithered(values, step / float(np.median(noise)))
    fit = _fit_parabola(values, _SKEW_Z, 2)
    skewness = abs(6.0 * fit[2] / fit[1]) if fit[1] > 0.0 else np.inf
    cut = np.mean(images[counts] == images[counts].min()) > _CUT
    if not cut and skewness < _ODD_SKEW:
        return fit[0], fit[1], skewness
    line = _fit_parabola(values, _BRIGHT_Z, 1)
    straight = np.quantile(values, _TOP_SHARE) < line[0] + _BEND * line[1] * _TOP_Z
    options = [(0.0, 1.0, 0.0)] if cut else [(fit[0], max(fit[1], 0.1), min(skewness, _MOST_SKEW))]
    if straight and line[1] < _PARTICLES:
        options.append((line[0], line[1], 0.0))
    # the one with the noise that reaches farthest at the usual probability
    far = _deviates(np.array([skew for *_, skew in options], dtype=np.float32), FALSE_ALARMS)
    reach = [shift + scale * float(z) for (shift, scale, _), z in zip(options, far, strict=True)]
    return options[int(np.argmax(reach))]


def _fit_parabola(values: F64, z: F64, degree: int) -> list[float]:
    """Fit quantiles by 1, z and z2 - 1 of normal deviates, up to a degree."""
    from scipy.special import ndtr

    share = ndtr(z)
    weight = np.exp(-0.5 * z**2) / np.sqrt(share * (1.0 - share))
    terms = np.stack([np.ones_like(z), z, z**2 - 1.0][: degree + 1], axis=1)
    quantiles = np.quantile(values, share)
    fit = np.linalg.lstsq(weight[:, None] * terms, weight * quantiles, rcond=None)[0]
    return [float(coefficient) for coefficient in fit]


def _deviates(skewness: F32, probability: float) -> F64:
    """Compute how many deviations skewed noise exceeds with a probability."""
    from scipy.special import gammainccinv, ndtri

    grid = np.linspace(0.0, _MOST_SKEW, 61)
    shape = 4.0 / np.maximum(grid[1:], 1e-6) ** 2
    skewed = (gammainccinv(shape, probability) - shape) / np.sqrt(shape)
    return np.asarray(np.interp(skewness, grid, [-float(ndtri(probability)), *skewed]))


def _spread(tiles: F64, size: tuple[int, ...]) -> F64:
    """Interpolate tiles' values linearly, also beyond the outer centres."""
    rows, columns = size
    return _lengthen(np.ascontiguousarray(_lengthen(tiles, rows).T), columns).T


def _lengthen(tiles: F64, size: int) -> F64:
    """Interpolate between the first axis's tiles, at so many pixels."""
    count = len(tiles)
    if count == 1:
        return np.repeat(tiles, size, axis=0)
    place = (np.arange(size) + 0.5) * count / size - 0.5
    left = np.clip(np.floor(place), 0, count - 2).astype(np.int64)
    share = (place - left)[:, None]
    return np.asarray(tiles[left] + share * (tiles[left + 1] - tiles[left]))
