"""Small PNG images for the page: camera images and slices of volumes."""

import math
from collections.abc import Mapping
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from sabench.plotting.kinds import rgb
from sabench.utils.arrays import F32, F64, U8, U16, Bool
from sabench.utils.number_text import round_down

AnyNumber = TypeVar("AnyNumber", bound=np.generic)

_MONTAGE_PX = 900  # widest mosaic
_CELLS = 12  # along the longer side of an image
_GAP_PX = 5  # between two cameras
_GAP_GREY = 200  # stands out from sparse and from crowded images
GAMMA = 1.0 / 2.2  # a particle of 1 % of the brightest is shown at 12 %
BRIGHTEST = 99.9  # percentile shown as white
_LEAST_RANGE = 0.01  # of black to white: below this, noise would be shown as light
_WINDOW = 200  # voxels of a slice that are shown, per side
ENLARGED_PX = 400  # side of a slice's image
# Blue, green, red of light: missing as missed particles, too much as ghosts
_MISSING, _TOO_MUCH = (np.array(rgb(kind)[::-1], np.float64) for kind in ("missed", "ghost"))
_RIGHT = np.full(3, 247.0)


def montage(images: U16, black_dn: float, white_dn: float) -> bytes:
    """Arrange all cameras' images of one frame in a near-square mosaic, as a PNG.

    Parameters
    ----------
    images : (camera, row, column) grey values.
    black_dn, white_dn : grey values of no light and of saturation. One scale holds for all cameras.

    Notes
    -----
    Pixels are joined by their maximum and not their mean, so that particles of two or three pixels
    do not fade.
    """
    small, across = _shrink("montage", images)
    least = black_dn + _LEAST_RANGE * (white_dn - black_dn)
    top = min(white_dn, max(least, float(np.percentile(small, BRIGHTEST))))
    light = small.astype(np.float64) - black_dn
    return _png(_mosaic(grey_levels(light, top - black_dn, GAMMA), across))


def backlit(images: U16, black_dn: float, white_dn: float) -> bytes:
    """Arrange bright images with dark objects in a near-square mosaic, as a PNG.

    Pixels are joined by their minimum; grey values are linear. Arguments as for `montage`.
    """
    dark = np.clip(white_dn - images.astype(np.float64), 0.0, white_dn - black_dn).astype(np.uint16)
    small, across = _shrink("backlit", dark)
    light = (white_dn - black_dn) - small.astype(np.float64)
    return _png(_mosaic(grey_levels(light, white_dn - black_dn, 1.0), across))


def thumbnail(image: U16, black_dn: float, white_dn: float, *, dark: bool = False) -> bytes:
    """Draw one image (row, column), of dark objects or bright ones, as a small PNG."""
    step = math.ceil(image.shape[1] / ENLARGED_PX)
    if dark:
        return backlit(image[None, ::step, ::step], black_dn, white_dn)
    return montage(join_blocks(image[None], step), black_dn, white_dn)


def _shrink(what: str, images: U16) -> tuple[U16, int]:
    """Join blocks until a mosaic fits; also gives the number of images in its rows."""
    if images.ndim != 3 or not images.size:
        raise ValueError(f"{what}: expected images (camera, row, column), got shape {images.shape}")
    across, width = _across(*images.shape), images.shape[2]
    block = math.ceil(across * width / (_MONTAGE_PX - _GAP_PX * (across - 1)))
    return join_blocks(images, block), across


def slice_picture(volume: F32, scored: tuple[slice, slice, slice]) -> bytes:
    """Draw the central window of a volume's middle z plane, as a PNG.

    The volume is (z, y, x); its plane is the middle one of the scored part. x points to the right,
    y down.

    The window depends on the grid only, and a voxel is a block of whole pixels, so images of one
    grid can be compared particle by particle. Brightness is the square root of the intensity, up to
    the window's own 99.9th percentile: faint ghosts stay visible next to bright particles.
    """
    window = _window(volume[scored])
    return _png(_enlarge(grey_levels(window, _top(window), 0.5)))


def error_slice(volume: F32, truth: F32, scored: tuple[slice, slice, slice]) -> bytes:
    """Draw the same window of a volume (z, y, x) minus the truth, as a PNG.

    White: right. Orange: too much light. Blue: missing light.

    The volume is first scaled so that its squared difference to the truth in the scored part is
    least, as its scale is arbitrary. Colours follow the square root of the difference, up to the
    99.9th percentile of the truth's window: all errors on one truth have one scale.
    """
    guess, true = (values[scored].astype(np.float64) for values in (volume, truth))
    window, power = _window(truth[scored]), float(np.vdot(guess, guess))
    off = (float(np.vdot(guess, true)) / power if power else 0.0) * _window(volume[scored]) - window
    strength = np.sqrt(np.clip(np.abs(off) / (_top(window) or 1.0), 0.0, 1.0))[..., None]
    ends = np.where(off[..., None] > 0.0, _TOO_MUCH, _MISSING)
    return _png(_enlarge(np.rint(_RIGHT + strength * (ends - _RIGHT)).astype(np.uint8)))


def class_slice(parts: Mapping[str, F32], scored: tuple[slice, slice, slice]) -> bytes:
    """Draw the same window of volumes, each in its kind's colour, as a PNG.

    Brightness is the square root of the intensity, up to the largest; colours add.

    Parameters
    ----------
    parts : volumes (z, y, x) by their kinds.
    """
    windows = {kind: _window(volume[scored]) for kind, volume in parts.items()}
    top = max(float(window.max()) for window in windows.values()) or 1.0
    light = sum(
        np.sqrt(np.maximum(window, 0.0) / top)[..., None] * np.array(rgb(kind)[::-1])
        for kind, window in windows.items()
    )
    return _png(_enlarge(np.rint(np.clip(light, 0.0, 255.0)).astype(np.uint8)))


def slice_voxels(scored: tuple[slice, slice, slice]) -> int:
    """Return the number of voxels along x that the window of a slice shows."""
    return int(min(scored[2].stop - scored[2].start, _WINDOW))


def with_scale_bar(picture: bytes, width_mm: float) -> bytes:
    """Draw a scale bar into a PNG.

    Its length is 1, 2 or 5 times a power of ten mm, at most a third of the width.

    Parameters
    ----------
    width_mm : of the whole picture.
    """
    import cv2

    pixels = cv2.imdecode(np.frombuffer(picture, dtype=np.uint8), cv2.IMREAD_COLOR)
    assert pixels is not None  # this module encoded it
    rows, columns = pixels.shape[:2]
    length = round_down(width_mm / 3.0)
    start, end = (10, rows - 10), (10 + round(length / width_mm * columns), rows - 10)
    text, place = f"{length:g} mm", (10, rows - 18)
    ink = 0.0 if pixels.mean() > 127.0 else 255.0
    for grey, width in ((255.0 - ink, 4), (ink, 1)):  # the outline, then the bar
        cv2.line(pixels, start, end, (grey,) * 3, width + 1)
        cv2.putText(pixels, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.5, (grey,) * 3, width)
    return _png(pixels)


def _window(part: F32) -> F64:
    if part.ndim != 3 or not part.size:
        raise ValueError(
            f"slice_picture: expected a scored part (z, y, x) with voxels, got shape {part.shape}"
        )
    starts = [max(count - _WINDOW, 0) // 2 for count in part.shape[1:]]
    rows, columns = (slice(start, start + _WINDOW) for start in starts)
    return np.asarray(part[part.shape[0] // 2][rows, columns], dtype=np.float64)


def _top(window: F64) -> float:
    # a few isolated particles can fill less than 0.1 %
    return float(np.percentile(window, BRIGHTEST)) or float(window.max())


def _enlarge(pixels: U8, size_px: int = ENLARGED_PX) -> U8:
    block = max(1, size_px // max(pixels.shape[:2]))
    return pixels.repeat(block, axis=0).repeat(block, axis=1)


def read_picture(dark: Bool, right: Bool) -> bytes:
    """Draw the cells (rows, columns) of a code that are read right, as a PNG.

    Black and white: right. Orange: a dark cell read as bright. Blue: a bright one read as dark.
    """
    truth = np.where(dark[..., None], 0.0, _RIGHT)
    wrong = np.where(dark[..., None], _TOO_MUCH, _MISSING)
    return _png(_enlarge(np.where(right[..., None], truth, wrong).astype(np.uint8)))


def grey_picture(values: F64, size_px: int = ENLARGED_PX) -> bytes:
    """Draw a plane (rows, columns), enlarged to about `size_px`, as a PNG.

    Grey values extend from its 1st to its 99th percentile; each value is a block of whole pixels.
    """
    low, high = np.percentile(values, [1.0, 99.0])
    return _png(_enlarge(grey_levels(values - low, high - low, 1.0), size_px))


def dots(pixels: F64, rows: int, columns: int) -> bytes:
    """Draw points in every camera's image, in a near-square mosaic, as a PNG.

    Each frame of a target has its own grey value.

    Parameters
    ----------
    pixels : (camera, frame, point, 2) columns and rows; NaN for none.
    """
    sheets, across, scale = _blank_sheets(len(pixels), rows, columns)
    for sheet, frames in zip(sheets, pixels, strict=True):
        for number, frame in enumerate(frames):
            points = frame[np.isfinite(frame).all(axis=1)] * scale
            _lines(sheet, points, points, 255 - 130 * number // max(len(frames) - 1, 1), 2)
    return _png(_mosaic(sheets, across))


def arrows(positions: F64, errors: F64, rows: int, columns: int) -> bytes:
    """Draw errors as lines in every camera's image, in a near-square mosaic.

    Lines are longer than the errors by a factor, written into the image: 1, 2 or 5 times a power of
    ten that makes the median one at most as long as a thirtieth of the image. Positions without an
    error are dim dots.

    Parameters
    ----------
    positions, errors : (camera, frame, point, 2) in px; NaN for none.
    """
    import cv2

    sheets, across, scale = _blank_sheets(len(positions), rows, columns)
    lengths = np.linalg.norm(errors, axis=-1)
    median = float(np.nanmedian(lengths)) if np.isfinite(lengths).any() else 0.0
    longer = round_down(columns / 30.0 / median) if median > 1e-12 else 1.0
    for sheet, at, off in zip(sheets, positions, errors, strict=True):
        finite = np.isfinite(at).all(axis=-1)
        good = finite & np.isfinite(off).all(axis=-1)
        alone = at[finite & ~good] * scale
        _lines(sheet, alone, alone, 90, 2)
        points = at[good] * scale
        _lines(sheet, points, points + off[good] * scale * longer, 170, 1)
        _lines(sheet, points, points, 255, 2)
    font, place = cv2.FONT_HERSHEY_SIMPLEX, (6, 18)
    cv2.putText(sheets[0], f"x {longer:g}", place, font, 0.5, 255, 1, cv2.LINE_AA)
    return _png(_mosaic(sheets, across))


def with_cell_means(positions: F64, errors: F64, rows: int, columns: int) -> tuple[F64, F64]:
    """Add a second image for `arrows`, with the mean error in each cell.

    Noise disappears in the means, and what a model lacks stays.

    Parameters
    ----------
    positions, errors : (n, 2) in px; NaN for none.

    Returns positions and errors (2, 1, n, 2), in cells of a twelfth of the longer side.
    """
    side = max(rows, columns) / _CELLS
    finite = np.isfinite(positions).all(axis=1) & np.isfinite(errors).all(axis=1)
    cells, member = np.unique(np.floor(positions[finite] / side), axis=0, return_inverse=True)
    both = np.full((2, 2, 1, len(positions), 2), np.nan)
    both[0, 0, 0], both[1, 0, 0] = positions, errors
    counts = np.bincount(member.ravel(), minlength=len(cells))
    both[0, 1, 0, : len(cells)] = (cells + 0.5) * side
    for axis in range(2):
        sums = np.bincount(member.ravel(), errors[finite, axis], len(cells))
        both[1, 1, 0, : len(cells), axis] = sums / counts
    return both[0], both[1]


def _blank_sheets(cameras: int, rows: int, columns: int) -> tuple[U8, int, float]:
    """Make black images for a mosaic; also give the images per row and the scale."""
    across = _across(cameras, rows, columns)
    scale = min(1.0, (_MONTAGE_PX - _GAP_PX * (across - 1)) / across / columns)
    shape = (cameras, math.ceil(rows * scale), math.ceil(columns * scale))
    return np.zeros(shape, dtype=np.uint8), across, scale


def _lines(sheet: U8, starts: F64, ends: F64, grey: int, width: int) -> None:
    import cv2

    finer = 16.0  # four fractional bits
    pairs = np.clip(np.stack([starts, ends], axis=1) * finer, -1e6, 1e6).astype(np.int32)
    cv2.polylines(sheet, list(pairs), False, grey, width, cv2.LINE_AA, 4)


def _across(cameras: int, rows: int, columns: int) -> int:
    """Choose the number of images per row: near-square, with few empty places."""

    def badness(across: int) -> float:
        down = math.ceil(cameras / across)
        return abs(math.log(across * columns / (down * rows))) + (across * down - cameras) / cameras

    return min(range(cameras, 0, -1), key=badness)


def join_blocks(images: npt.NDArray[AnyNumber], block: int) -> npt.NDArray[AnyNumber]:
    """Join block x block pixels of images (n, row, column) by their maximum.

    The last row and column of blocks may be cut.
    """
    _, rows, columns = images.shape
    padded = np.pad(images, ((0, 0), (0, -rows % block), (0, -columns % block)))
    shape = (len(images), padded.shape[1] // block, block, padded.shape[2] // block, block)
    return np.asarray(padded.reshape(shape).max(axis=(2, 4)))


def grey_levels(values: F64 | F32, top: float, gamma: float) -> U8:
    """Scale values from 0 to a top to grey values of 8 bits."""
    scaled = np.clip(values / top, 0.0, 1.0) if top > 0.0 else np.zeros_like(values)
    return np.rint(255.0 * scaled**gamma).astype(np.uint8)


def _mosaic(images: U8, across: int) -> U8:
    count, rows, columns = images.shape
    down = math.ceil(count / across)
    shape = (down * (rows + _GAP_PX) - _GAP_PX, across * (columns + _GAP_PX) - _GAP_PX)
    sheet = np.full(shape, _GAP_GREY, dtype=np.uint8)
    for i, image in enumerate(images):
        y, x = (i // across) * (rows + _GAP_PX), (i % across) * (columns + _GAP_PX)
        sheet[y : y + rows, x : x + columns] = image
    return sheet


def _png(grey: U8) -> bytes:
    import cv2

    done, data = cv2.imencode(".png", grey, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    if not done:
        raise ValueError(f"expected an image that can be a PNG, got shape {grey.shape}")
    return bytes(data)
