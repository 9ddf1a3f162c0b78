"""Search of the volume for positions where all cameras see light.

At every point of a lattice the images are looked up at its projections. Local maxima of a mean over
cameras are candidates for particles. The mean is that of logarithms, so that a particle may be dim
in one camera, and not more above the darkest camera than particles' scatter explains.

Lattices, orders of equal candidates and directions of splits follow the axes of the box that is
searched. Its axes are the world's, but images decide which of them is x, y and z, and in which
direction: a rig that is rotated together with its grid, axes onto axes, gives the same particles.
"""

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter

from sabench.api import FoundParticles
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.common_view import lattice_of
from sabench.geometry.grid import Grid
from sabench.geometry.volume_polynomials import (
    VolumePolynomials,
    project_point,
    project_points,
    project_row,
)
from sabench.utils.arrays import F32, F64, I64, Bool
from sabench.utils.compiled import numba
from sabench.utils.threads import on_cores

BRIGHTEST = 1.5  # of a typical peak: more light in one camera does not make up for another's lack
_NARROWEST = 0.4  # px: least width of images that a lattice of pixels' steps does not miss
_FLATTEST = 2.0  # pixels: longest step in space, of the lattice and of splits
_DARK = np.float32(-np.inf)
FEWEST = 3  # cameras that see a place: two lines of sight meet by chance too often

# Axes of the rig, shares of the volume, and faults of cameras:
_VECTORS = {"position_mm", "velocity_mm_s", "acceleration_mm_s2"}
_SQUARES = {"covariance_mm2", "velocity_covariance", "acceleration_covariance"}
_POINTS, _EACH = 140_000, 16  # in the box, and in a block of pixels on average
_LONELY = 0.05  # of a pixel's part of the box, which few cameras see


def wide_enough(images: F32, sigma: F64) -> tuple[F32, F64]:
    """Blur images (camera, row, column) of too narrow particles.

    Return them and the widths.
    """
    missing = np.sqrt(np.maximum(_NARROWEST**2 - sigma**2, 0.0))
    each = zip(images, missing, strict=True)
    blurred = np.stack([gaussian_filter(image, (down, across)) for image, (across, down) in each])
    return blurred, np.maximum(sigma, _NARROWEST)


def lattice_shape(maps: VolumePolynomials) -> tuple[int, int, int]:
    """Choose the lattice's points along z, y and x.

    Neighbours are one pixel apart in the camera that resolves their direction best, and at most
    two pixels' size in space.
    """
    slopes = slopes_per_mm(maps)
    finest = 1.0 / np.linalg.norm(slopes, ord=2, axis=(1, 2)).max()
    along = 1.0 / np.linalg.norm(slopes, axis=1).max(axis=0)
    step = np.minimum(along, _FLATTEST * finest)
    x, y, z = np.maximum((2.0 * maps.half_mm / step).astype(np.int64) + 1, 3).tolist()
    return z, y, x


def pixel_mm(maps: VolumePolynomials) -> float:
    """Compute the size in the volume of the best camera's pixel, in the middle."""
    return float(1.0 / np.linalg.norm(slopes_per_mm(maps), ord=2, axis=(1, 2)).max())


def mean_spacing(maps: VolumePolynomials, count: float) -> float:
    """Compute the edge of the cube that holds one of some particles on average, mm."""
    return float((np.prod(2.0 * maps.half_mm) / max(count, 1.0)) ** (1.0 / 3.0))


def split_directions(maps: VolumePolynomials) -> F64:
    """Make nine steps (n, 3) mm, trial differences of two particles.

    Depth is the direction that moves images the least. Steps across it are one pixel of the best
    camera, steps along it longer, as the cameras resolve it less.
    """
    slopes = slopes_per_mm(maps)
    values, vectors = np.linalg.eigh(np.einsum("cia,cib->ab", slopes, slopes))
    depth = vectors[:, 0] * np.sign(vectors[np.argmax(np.abs(vectors[:, 0])), 0])
    least = np.argsort(np.abs(depth), kind="stable")[0]  # the world's axis that is most across
    across = np.eye(3)[least] - depth[least] * depth
    across /= np.linalg.norm(across)
    longer = min(math.sqrt(values[1] / max(values[0], 1e-300)), _FLATTEST)
    frame = np.stack([across, np.cross(depth, across), longer * depth])
    # half of the neighbours of a cell in a lattice, but those across its corners
    cells = itertools.product((0.0, 1.0, -1.0), repeat=3)
    steps = np.array([cell for cell in cells if cell > (0.0,) * 3 and 0.0 in cell])
    steps /= np.linalg.norm(steps, axis=1, keepdims=True)
    return np.asarray(pixel_mm(maps) * steps @ frame)


def slopes_per_mm(maps: VolumePolynomials) -> F64:
    """Compute derivatives (camera, 2, 3) of pixels by mm in the middle of the box."""
    slopes = np.zeros((len(maps.coefficients), 2, 3))
    for camera in range(len(slopes)):
        project_point(maps, camera, np.zeros(3), np.zeros(2), slopes[camera])
    return np.asarray(slopes / maps.half_mm)


def find_candidates(maps: VolumePolynomials, logs: F32, floor: float, spread: float) -> F64:
    """Find positions (n, 3) in the box of the maps, the brightest first.

    Parameters
    ----------
    logs : (camera, row, column) logarithms of light over a typical particle's peak, at most that
        of `BRIGHTEST`; NaN where a camera shows nothing.
    floor : smallest mean of the cameras' logarithms.
    spread : the most that the mean may exceed the darkest camera's.
    """
    means, bounds = np.empty(lattice_shape(maps), dtype=np.float32), np.zeros_like(logs)
    floor32, spread32, most = np.float32(floor), np.float32(spread), np.float32(math.log(BRIGHTEST))
    known = np.where(np.isnan(logs), most, logs)  # the most between a pixel and the next ones
    pairs = np.maximum(known[:, :, :-1], known[:, :, 1:])
    bounds[:, :-1, :-1] = np.maximum(pairs[:, :-1], pairs[:, 1:])
    on_cores(_sweep, len(means), maps, logs, bounds, floor32, spread32, most, means)
    z, y, x = _find_maxima(means)
    order = np.argsort(-means[z, y, x], kind="stable")
    places = np.stack([x, y, z], axis=1)[order]
    return np.asarray(2.0 * places / (np.array(means.shape[::-1]) - 1.0) - 1.0)


def _find_maxima(means: F32) -> tuple[I64, ...]:
    """Find points (z, y, x) that exceed their 26 neighbours; of equal ones the first."""
    framed = np.pad(means, 1, constant_values=_DARK)
    values, strides = framed.ravel(), np.array(framed.strides) // framed.itemsize
    places = np.flatnonzero(values > _DARK)
    for step in itertools.product((-1, 0, 1), repeat=3):
        other = values[places + strides @ step]
        here = values[places]
        places = places[other < here if step < (0, 0, 0) else other <= here]
    return tuple(axis - 1 for axis in np.unravel_index(places, framed.shape))


@numba.njit(inline="always")
def _look_up(image: Any, column: float, row: float) -> Any:
    """Interpolate an image linearly; NaN outside."""
    rows, columns = image.shape
    if not (0.0 <= column < columns - 1 and 0.0 <= row < rows - 1):
        return np.nan
    j, i = int(column), int(row)
    right, down = column - j, row - i
    upper = image[i, j] * (1.0 - right) + image[i, j + 1] * right
    lower = image[i + 1, j] * (1.0 - right) + image[i + 1, j + 1] * right
    return upper * (1.0 - down) + lower * down


@numba.njit(cache=True, nogil=True)
def _sweep(
    jobs: slice,
    maps: Any,
    logs: Any,
    bounds: Any,
    floor: Any,
    spread: Any,
    most: Any,
    means: Any,
) -> None:
    """Fill in mean logarithms (z, y, x), `_DARK` if the bounds or means are low."""
    slices, rows, columns = means.shape
    cameras, last_row, last_column = len(logs), logs.shape[1] - 1.0, logs.shape[2] - 1.0
    least = floor - spread
    for z in range(jobs.start, jobs.stop):
        pixels = np.zeros((cameras, 2, columns))
        above = np.zeros(columns, dtype=np.float32)
        for y in range(rows):
            above[:] = 0.0
            for c in range(cameras):
                project_row(
                    maps,
                    c,
                    -1.0 + 2.0 * y / (rows - 1),
                    -1.0 + 2.0 * z / (slices - 1),
                    -1.0,
                    2.0 / (columns - 1),
                    pixels[c],
                )
                room, bright = (cameras - c - 1) * (most - floor), False
                for x in range(columns):
                    column, row = pixels[c, 0, x], pixels[c, 1, x]
                    inside = 0.0 <= column < last_column and 0.0 <= row < last_row
                    if inside and above[x] > _DARK:
                        bound = bounds[c, int(row), int(column)]
                        above[x] += bound - floor
                        if bound < least or above[x] + room < 0.0:
                            above[x] = _DARK
                    bright = bright or above[x] > _DARK
                if not bright:
                    break
            for x in range(columns):
                means[z, y, x] = _DARK
                if above[x] > _DARK:
                    means[z, y, x] = _mean_log(logs, pixels, x, floor, spread, most)


@numba.njit(inline="always")
def _mean_log(logs: Any, pixels: Any, x: int, floor: Any, spread: Any, most: Any) -> Any:
    """Average the cameras' logarithms at a point."""
    total, count, cameras, darkest = 0.0, 0, len(logs), np.inf
    for c in range(cameras):
        value = _look_up(logs[c], pixels[c, 0, x], pixels[c, 1, x])
        if np.isnan(value):
            continue
        total, count, darkest = total + value, count + 1, min(darkest, value)
        if (
            darkest + spread < floor
            or total + (cameras - c - 1) * most < (count + cameras - c - 1) * floor
        ):
            return _DARK
    if count < FEWEST:
        return _DARK
    mean = min(total / count, darkest + spread)
    return np.float32(mean) if mean >= floor else _DARK


def rig_axes(maps: VolumePolynomials) -> F64:
    """Choose directions (3, 3) of the box's axes as x, y and z, one a row.

    Along x the columns of all cameras' images grow the most, along y, of the other two, the rows;
    x, y and z are right-handed.
    """
    growth = slopes_per_mm(maps).sum(axis=0)
    x = int(np.argmax(np.abs(growth[0])))
    y = int(np.argmax(np.where(np.arange(3) == x, -1.0, np.abs(growth[1]))))
    axes = np.zeros((3, 3))
    for row, column in enumerate((x, y)):
        axes[row, column] = 1.0 if growth[row, column] >= 0.0 else -1.0
    axes[2] = np.cross(axes[0], axes[1])
    return axes


def turn_maps(maps: VolumePolynomials, axes: F64) -> VolumePolynomials:
    """Rewrite polynomials for coordinates along other axes (3, 3) of the same box."""
    order = np.abs(axes).argmax(axis=1)
    row_of = {tuple(power): row for row, power in enumerate(maps.powers[:, order].tolist())}
    rows = [row_of[tuple(power)] for power in maps.powers.tolist()]
    signs = np.prod(axes.sum(axis=1) ** maps.powers, axis=1)
    turned = np.ascontiguousarray(maps.coefficients[:, rows] * signs[:, None])
    return VolumePolynomials(
        turned, maps.powers, axes @ maps.middle_mm, np.ascontiguousarray(maps.half_mm[order])
    )


def turn_to_world(particles: FoundParticles, axes: F64) -> FoundParticles:
    """Convert particles from coordinates along axes (3, 3) to the world's."""
    turned: dict[str, Any] = {declared.name: value for declared, value in particles.arrays()}
    for name in turned.keys() & _VECTORS:
        turned[name] = turned[name] @ axes
    for name in turned.keys() & _SQUARES:
        turned[name] = axes.T @ turned[name] @ axes
    return FoundParticles(**turned)


def volume_shares(maps: VolumePolynomials, shape: tuple[int, ...]) -> F64:
    """Compute shares (camera, row, column) of the box that pixels show.

    They are counted by points in blocks.
    """
    import cv2  # takes long to load

    out = np.zeros((len(maps.coefficients), *shape))
    for block, share in zip(_blocks(maps, shape), out, strict=True):
        counts = np.bincount(block.of[block.shown], minlength=block.rows * block.columns)
        blocks = counts.reshape(block.rows, block.columns) / (_POINTS * block.edge**2)
        size = block.columns * block.edge, block.rows * block.edge
        fine = cv2.resize(blocks, size, interpolation=cv2.INTER_LINEAR)
        share[:] = fine[: shape[0], : shape[1]]
    return out


def shared_views(maps: VolumePolynomials, shape: tuple[int, ...], fewest: int) -> Bool:
    """Mark pixels of parts of the box that `fewest` cameras see almost in full.

    Pixels that show no part of the box are marked, too.
    """
    blocks = list(_blocks(maps, shape))
    lonely = np.sum([block.shown for block in blocks], axis=0) < fewest
    out = np.zeros((len(blocks), *shape), dtype=np.bool_)
    for block, marked in zip(blocks, out, strict=True):
        size = block.rows * block.columns
        all_points = np.bincount(block.of[block.shown], minlength=size)
        few = np.bincount(block.of[block.shown & lonely], minlength=size)
        shared = few <= _LONELY * all_points
        fine = shared.reshape(block.rows, block.columns).repeat(block.edge, 0).repeat(block.edge, 1)
        marked[:] = fine[: shape[0], : shape[1]]
    return out


class _Blocks(NamedTuple):
    """Blocks of `edge` pixels of a camera, and the one `of` each point shown (n,)."""

    edge: int
    rows: int
    columns: int
    of: I64
    shown: Bool


def _blocks(maps: VolumePolynomials, shape: tuple[int, ...]) -> Iterator[_Blocks]:
    """Find the blocks of each camera's pixels that hold points in the box."""
    # multiples of powers of the root of x^4 = x + 1 fill a cube evenly (M. Roberts, The
    # unreasonable effectiveness of quasirandom sequences, 2018)
    step = np.roots([1.0, 0.0, 0.0, -1.0, -1.0]).real.max() ** -np.arange(1.0, 4.0)
    points = 2.0 * ((np.arange(_POINTS)[:, None] * step) % 1.0) - 1.0
    edge = math.ceil(math.sqrt(_EACH * math.prod(shape) / _POINTS))
    rows, columns = (math.ceil(size / edge) for size in shape)
    for camera in range(len(maps.coefficients)):
        pixels = project_points(maps, camera, points)
        column, row = np.floor((pixels + 0.5) / edge).astype(np.int64).T
        shown = (column >= 0) & (row >= 0) & (column < columns) & (row < rows)
        yield _Blocks(edge, rows, columns, row * columns + column, shown)


def find_fault(cameras: Sequence[CameraModel], grid: Grid) -> str | None:
    """Say why particles cannot be searched for with these cameras; None if they can."""
    if len(cameras) < FEWEST:
        return "it needs three cameras"
    points = lattice_of(grid)
    count = np.zeros(len(points), dtype=np.int64)
    for camera in cameras:
        pixels, valid = camera.project(points)
        if not valid.all():
            return f"it needs a light path from all of the grid to {camera.name}"
        count += camera.contains(pixels)
    if count.max() < FEWEST:
        return f"it needs three cameras that see the same part of the grid, got {count.max()}"
    return None
