"""Recordings in folders of image files, and statistics of a camera's images.

Light, noise, and particle images one by one need no calibration, and are computed alike from images
of data sets and of laboratories. Grey values are scaled so that a saturated pixel has 255.
"""

import itertools
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from sabench.images.image_files import camera_name, last_number_order
from sabench.images.image_reading import read_pages
from sabench.images.levels import DEPTHS
from sabench.images.peaks import CLEAR, find_peaks
from sabench.images.repair import above_background, find_points
from sabench.images.widths import PIXEL
from sabench.utils.arrays import F32, F64, FROM_MAD, U16
from sabench.utils.errors import InputError
from sabench.utils.progress import progress_bar

FORMATS = (".tif", ".tiff", ".png", ".bmp")
_SMALLEST = 16  # px: side of an image


@dataclass(frozen=True)
class _Recording:
    """Images that one camera took one after the other.

    Attributes
    ----------
    name : of the camera: that of its folder, or what its files' names have in common.
    frames : (row, column) grey values of each.
    white_dn : largest grey value of the bit depth.
    """

    name: str
    frames: tuple[U16, ...]
    white_dn: float


def list_image_files(folder: Path) -> dict[str, list[Path]]:
    """List the image files of each camera in a folder, in the order of their numbers.

    Each folder inside it with images is a camera. Images in the folder itself with names that
    differ in the last number alone are one camera's. No folder or no images is an InputError.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: expected a folder of images, got no folder")
    cameras: dict[str, list[Path]] = {}
    for path in _images_in(folder):
        cameras.setdefault(camera_name(path), []).append(path)
    for inner in sorted(path for path in folder.iterdir() if path.is_dir()):
        if files := _images_in(inner):
            cameras[inner.name] = files
    if not cameras:
        formats = ", ".join(FORMATS)
        raise InputError(f"{folder}: expected images ({formats}) in it or its folders, got none")
    return cameras


def _images_in(folder: Path) -> list[Path]:
    images = (path for path in folder.iterdir() if path.suffix.lower() in FORMATS)
    return sorted((path for path in images if path.is_file()), key=last_number_order)


def read_recordings(folder: Path, most: int, white_dn: float | None = None) -> Iterator[_Recording]:
    """Read the first images of every camera of a folder, camera by camera.

    Faults are as in `read_frames`.

    Parameters
    ----------
    most : number of images of each camera.
    white_dn : grey value of a saturated pixel; by default that of the least bit depth of 8, 10, 12,
        14 and 16 that all of a camera's grey values fit.
    """
    for name, paths in progress_bar(list(list_image_files(folder).items()), "measure recordings"):
        frames = read_frames(paths[:most], most)
        yield _Recording(name, frames, white_dn or guess_white(frames))


def guess_white(frames: Sequence[U16]) -> float:
    """Return the largest grey value of the least bit depth that holds all values.

    Values that are all multiples of 4, 16 or 64 fill the upper bits of 16.
    """
    highest = max(int(frame.max()) for frame in frames)
    step = int(np.bitwise_or.reduce([np.bitwise_or.reduce(frame, axis=None) for frame in frames]))
    low_bits = (step & -step).bit_length() - 1 if step else 0
    if highest >= 1 << 12 and low_bits in (2, 4, 6, 8):
        return float((1 << 16) - (1 << low_bits))
    return float(next((1 << depth) - 1 for depth in DEPTHS if highest < 1 << depth))


def read_frames(paths: Sequence[Path], most: int) -> tuple[U16, ...]:
    """Read up to so many grey images (row, column) of one size from files.

    Other files, colours and different sizes are InputErrors.
    """
    folder = paths[0].parent
    frames = tuple(image for _, image in itertools.islice(read_pages(paths, 0, most), most))
    sizes = Counter(frame.shape for frame in frames)
    if len(sizes) > 1:
        got = " and ".join(f"{n} of {rows} x {columns}" for (rows, columns), n in sizes.items())
        raise InputError(
            f"{folder}: expected images of one size from each camera, got {got} pixels (rows x "
            "columns); put each camera's images into a folder of its own"
        )
    rows, columns = frames[0].shape
    if min(rows, columns) < _SMALLEST:
        raise InputError(
            f"{folder}: expected images of {_SMALLEST} x {_SMALLEST} pixels or more, got "
            f"{rows} x {columns}"
        )
    return frames


# Light and noise:
SCALED_WHITE = 255.0  # scaled grey value of a saturated pixel
NOISE_FRAMES = 3  # for the noise of a stack
_MIDDLE = 1.2  # variance of the mean of the middle half of n normal numbers, times n
_FAR = 4.0  # standard deviations: clipped

# Fits of particle images:
_HALF = 2  # px: half the window of a particle image's fit
_NARROW_PX = 1.0  # widths of fits by 3 x 3 pixels


@dataclass(frozen=True)
class CameraStatistics:
    """Statistics of a camera's images.

    Grey values are of 255. NaN where images do not determine them.

    Attributes
    ----------
    saturated : share of the pixels.
    background_p5, background_p50, background_p95 : percentiles of the local background, the least
        value within 9 x 9 pixels of the image that a median over 3 x 3 pixels has smoothed.
    fixed : standard deviation of dim pixels' typical values, without what temporal noise adds. The
        typical value is the mean of the middle half of the frames' values; dim pixels are the half
        of all pixels with the lowest medians of 5 x 5 typical values around them.
    fixed_near : the same of each pixel less that median, without values more than four of it away,
        as hot pixels have: what differs from pixel to pixel.
    temporal : standard deviation of dim pixels from frame to frame, without particles that pass.
    width_p10, width_p50, width_p90 : percentiles of `ParticleImages.width_px`.
    ln_flux : standard deviation of ln flux of particle images.
    per_pixel : peaks per pixel.
    contrast : of a median peak: (its brightest pixel - background) / (their sum).
    """

    saturated: float
    background_p5: float
    background_p50: float
    background_p95: float
    fixed: float
    fixed_near: float
    temporal: float
    width_p10: float
    width_p50: float
    width_p90: float
    ln_flux: float
    per_pixel: float
    contrast: float


def measure_camera(frames: Sequence[U16], white_dn: float) -> CameraStatistics:
    """Measure one camera's images (row, column), saturated at `white_dn`."""
    stack = np.stack(frames)
    scale = SCALED_WHITE / white_dn
    low = [(frame - above_background(frame)[0]).astype(np.uint16) for frame in frames]
    fixed, near, temporal = measure_noise(stack) if len(stack) >= NOISE_FRAMES else [np.nan] * 3
    fits = [fit_particle_images(frame, white_dn) for frame in frames]
    _, width, flux, height = map(np.concatenate, list(zip(*fits, strict=True))[:4])
    background = (scale * np.percentile(low, [5.0, 50.0, 95.0])).tolist()
    median = scale * float(np.median(height)) if len(height) else np.nan
    widths = np.percentile(width, [10.0, 50.0, 90.0]).tolist() if len(width) else [np.nan] * 3
    return CameraStatistics(
        saturated=float((stack >= white_dn).mean()),
        **{f"background_p{p}": level for p, level in zip((5, 50, 95), background, strict=True)},
        fixed=scale * fixed,
        fixed_near=scale * near,
        temporal=scale * temporal,
        **{f"width_p{p}": value for p, value in zip((10, 50, 90), widths, strict=True)},
        ln_flux=float(np.std(np.log(flux))) if len(flux) > 1 else np.nan,
        per_pixel=sum(fit.found for fit in fits) / stack.size,
        contrast=median / (median + 2.0 * background[1]),
    )


def measure_noise(stack: U16) -> tuple[float, float, float]:
    """Measure `fixed`, `fixed_near` and `temporal` noise of a stack.

    See `CameraStatistics`.
    """
    import cv2

    quarter = len(stack) // 4
    middle = np.sort(stack, axis=0)[quarter : len(stack) - quarter].mean(axis=0, dtype=np.float32)
    around = cv2.medianBlur(middle, 5)  # selects without a view to a pixel's own flaws
    dim = around <= np.median(around)
    temporal = _clipped_deviation(np.diff(stack.astype(np.float32), axis=0)[:, dim]) / np.sqrt(2.0)
    rest = _MIDDLE / len(stack) * temporal**2
    spread = float(middle[dim].std(dtype=np.float64))
    deviations = spread, _clipped_deviation((middle - around)[dim])
    fixed, fixed_near = (float(np.sqrt(max(deviation**2 - rest, 0.0))) for deviation in deviations)
    return fixed, fixed_near, temporal


def _clipped_deviation(values: F32) -> float:
    """Compute a standard deviation without outliers, also below one grey value."""
    away = np.abs(values - np.median(values))
    limit, before = max(float(np.percentile(away, 68.0)), 1.0), np.inf
    while limit < before:
        deviation = float(values[away <= _FAR * limit].std(dtype=np.float64))
        limit, before = max(deviation, 1.0 / _FAR), limit
    return deviation


class RatioSpread(NamedTuple):
    """Spread of the logarithm of the ratio of a particle's flux in two cameras.

    Attributes
    ----------
    plain : standard deviation.
    robust : that of normal numbers with the same median absolute deviation.
    pairs : number of ratios.
    """

    plain: float
    robust: float
    pairs: int


def flux_ratio_spread(flux: F64) -> RatioSpread:
    """Measure how a particle's flux (camera, particle) differs between cameras.

    NaN where a camera does not show one. Each pair of cameras has its own median ratio, which does
    not count: cameras differ in gain and in angle.
    """
    logs, ratios = np.log(flux), []
    for first in range(len(flux)):
        for second in range(first):
            ratio = logs[first] - logs[second]
            ratio = ratio[np.isfinite(ratio)]
            if len(ratio) > 1:
                ratios.append(ratio - np.median(ratio))
    if not ratios:
        return RatioSpread(np.nan, np.nan, 0)
    every = np.concatenate(ratios)
    robust = FROM_MAD * float(np.median(np.abs(every)))
    return RatioSpread(float(np.std(every)), robust, len(every))


class FittedImages(NamedTuple):
    """Gaussians that fit the particle images of one image.

    Attributes
    ----------
    pixel : (n, 2) column and row.
    width_px : (n,) geometric mean of both standard deviations, less the pixels' own width.
    flux : (n,) their integral, in grey values times px2.
    height : (n,) brightest pixel above the local background, in grey values.
    found : number of peaks, also saturated ones and those that no Gaussian fits.
    """

    pixel: F64
    width_px: F64
    flux: F64
    height: F64
    found: int


def fit_particle_images(grey: U16, white_dn: float) -> FittedImages:
    """Fit a Gaussian at any angle to each peak of an image (row, column).

    Peaks exceed all of their 5 x 5 surroundings, and the local background by 8 standard deviations
    of the noise; hot pixels, peaks saturated at `white_dn` and those at the border are left out. A
    quadratic is fitted to the logarithm of the light, with the light's square as weight (Guo, IEEE
    Signal Process. Mag. 28 (2011) 134-137): of 3 x 3 pixels, since neighbours overlap, or of 5 x 5
    where the image is wider than 1 px.
    """
    light, noise = above_background(grey)
    light -= np.float32(noise)  # the least of many values is that low
    column, row = np.rint(find_peaks(light, CLEAR * noise).pixels).astype(np.int64).T
    most = np.array(light.shape) - 1 - _HALF
    inner = (np.minimum(column, row) >= _HALF) & (row <= most[0]) & (column <= most[1])
    row, column = row[inner], column[inner]
    around = np.arange(-_HALF, _HALF + 1)
    near = row[:, None, None] + around[:, None], column[:, None, None] + around
    windows = light[near].astype(np.float64)
    top = windows[:, _HALF, _HALF] >= windows.max(axis=(1, 2), initial=0.0)
    top &= ~find_points(grey, float(grey.min()))[row, column]
    good = np.asarray(top & (grey[near] < white_dn).all(axis=(1, 2)))
    narrow = _fit_gaussians(windows[good][:, 1:-1, 1:-1])
    wide = _fit_gaussians(windows[good])
    fit = np.where(narrow[:, :1] <= _NARROW_PX, narrow, wide)  # NaN is not narrow
    valid = fit[:, 0] < len(around)  # wider ones than their window are no fits
    pixel = np.stack([column[good], row[good]], axis=1) + fit[:, 2:]
    height = windows[good, _HALF, _HALF]
    return FittedImages(pixel[valid], fit[valid, 0], fit[valid, 1], height[valid], int(top.sum()))


def _fit_gaussians(windows: F64) -> F64:
    """Fit Gaussians (n, 4) to light (n, row, column).

    Returns width, integral, and the centre's column and row from the window's; NaN where the fit is
    no ellipse, or its centre is more than a pixel away.
    """
    half = windows.shape[1] // 2
    y, x = (axis.ravel().astype(float) for axis in np.mgrid[-half : half + 1, -half : half + 1])
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    light = windows.reshape(len(windows), len(x))
    floor = 1e-3 * light.max(axis=1, initial=1e-9, keepdims=True)
    weight = np.where(light > floor, light / floor, 0.0) ** 2
    matrix = np.einsum("np,pi,pj->nij", weight, terms, terms) + 1e-6 * np.eye(6)
    right = np.einsum("np,pi->ni", weight * np.log(np.maximum(light, floor)), terms)
    # coefficients (n, 6) of 1, x, y, x2, x y and y2, turned into Gaussians
    c = np.linalg.solve(matrix, right[..., None])[..., 0]
    determinant = 4.0 * c[:, 3] * c[:, 5] - c[:, 4] ** 2
    valid = (c[:, 3] < 0.0) & (determinant > 1e-9)
    safe = np.where(valid, determinant, 1.0)
    across, down, both = -2.0 * c[:, 5] / safe, -2.0 * c[:, 3] / safe, c[:, 4] / safe
    x, y = across * c[:, 1] + both * c[:, 2], both * c[:, 1] + down * c[:, 2]
    top = c[:, 0] + 0.5 * (c[:, 1] * x + c[:, 2] * y)
    with np.errstate(over="ignore"):  # of fits that fail
        flux = np.exp(top) * 2.0 * np.pi / np.sqrt(safe)
    square = (across - PIXEL) * (down - PIXEL) - both**2
    valid &= (np.minimum(across, down) > PIXEL) & (square > 0.0)
    valid &= np.maximum(np.abs(x), np.abs(y)) < 1.0
    width = np.sqrt(np.sqrt(np.where(valid, square, np.nan)))
    return np.stack([width, flux, x, y], axis=1)


def flux_near(images: FittedImages, pixels: F64, reach_px: float, apart_px: float) -> F64:
    """Look up the flux (n,) of the particle image nearest to each pixel (n, 2).

    NaN if none is within `reach_px`, or if another image or pixel is within `apart_px`.
    """
    from scipy.spatial import cKDTree

    out = np.full(len(pixels), np.nan)
    finite = np.flatnonzero(np.isfinite(pixels).all(axis=1))
    if not len(finite) or not len(images.pixel):
        return out
    asked, shown = cKDTree(pixels[finite]), cKDTree(images.pixel)
    distance, nearest = shown.query(pixels[finite])
    good = distance <= reach_px
    for tree in (asked, shown):
        good &= tree.query_ball_point(pixels[finite], apart_px, return_length=True) == 1
    out[finite[good]] = images.flux[nearest[good]]
    return out
