"""Passes over all particles of a model, on all cores.

The results are the same for any number of cores. Painting particles in one camera does not change
another camera's images, and measuring particles changes nothing. A fit of a particle reads and
changes the pixels of its images, and those of its neighbours if they are fitted, too: threads fit
particles of cells that share no pixel in any camera. The order of rows counts, as the first
take most light, so that rows of one portion are fitted before those of the next.
"""

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from sabench.algorithms.particles import model_moves
from sabench.algorithms.particles.image_model import (
    MARGIN_PX,
    ImageModel,
    ModelParticles,
    Room,
    make_room,
    paint_all,
)
from sabench.geometry.volume_polynomials import VolumePolynomials, project_points
from sabench.utils.arrays import F64, I64
from sabench.utils.compiled import inner_kernel, numba
from sabench.utils.threads import for_each, share_rows

_CELLS = 1500  # the most
_FEW = 20_000  # rows: fewer are fitted in their order, which matters more than the time saved
_MOVE_PX = 3.0  # largest shift of images by fits

Groups = Sequence[I64]


def side_by_side(work: Callable[[I64], None], turns: Iterable[Groups]) -> None:
    """Work on one turn after the other; all cores share the groups of a turn."""
    threads = numba.get_num_threads()
    with ThreadPoolExecutor(threads) as pool:
        for groups in turns:
            shares: list[list[I64]] = [[] for _ in range(threads)]
            for group in sorted(groups, key=len, reverse=True):
                min(shares, key=lambda share: sum(map(len, share))).append(group)
            list(pool.map(work, [np.concatenate(share) for share in shares if share]))


def disjoint_groups(
    maps: VolumePolynomials,
    position: F64,
    rows: I64,
    window: int,
    pixel: float,
    portions: int,
    neighbours: tuple[I64, I64] | None = None,
) -> list[list[I64]]:
    """Divide rows into groups, and list those that share no pixel together.

    Rows keep their order within groups, and few rows in one group all of theirs.

    Parameters
    ----------
    position : (n, 3) of all particles in the box of the maps.
    rows : particles that are fitted.
    window : pixels along a row of a particle's image.
    pixel : mm in the box.
    portions : of the rows; the rows of one come before those of the next.
    neighbours : where each particle's neighbours start in a list (n + 1,), and the list, if they
        are fitted, too.
    """
    if len(rows) < _FEW:
        return [[rows]]
    cell = _cells(maps, position[rows], pixel)
    order = np.argsort(cell, kind="stable")
    starts = np.flatnonzero(np.diff(cell[order], prepend=-1))
    ends = _ends(maps, position, rows, neighbours)[order]
    low = np.minimum.reduceat(ends[:, :, 0], starts) - window - _MOVE_PX
    high = np.maximum.reduceat(ends[:, :, 1], starts) + window + _MOVE_PX
    colours = _colours(low, high)
    colour = np.zeros(len(rows), dtype=np.int64)
    colour[order] = np.repeat(colours, np.diff(starts, append=len(rows)))
    turns = int(colours.max()) + 1
    turn = np.arange(len(rows)) * portions // len(rows) * turns + colour
    order = np.lexsort((cell, turn))
    cuts = np.flatnonzero(np.diff(cell[order]) | np.diff(turn[order])) + 1
    groups: list[list[I64]] = [[] for _ in range(portions * turns)]
    for group in np.split(order, cuts):
        groups[turn[group[0]]].append(rows[group])
    return [batch for batch in groups if batch]


def order_in_memory(maps: VolumePolynomials, position: F64, pixel: float) -> I64:
    """Return the rows (n,) of many particles cell by cell, for the processor's cache."""
    if len(position) < _FEW:
        return np.arange(len(position))
    return np.argsort(_cells(maps, position, pixel), kind="stable")


def _cells(maps: VolumePolynomials, position: F64, pixel: float) -> I64:
    """Find the numbers (n,) of the cubes of the box that positions lie in."""
    size = 2.0 * maps.half_mm
    edge = max(MARGIN_PX * pixel, float((np.prod(size) / _CELLS) ** (1.0 / 3.0)))
    counts = np.maximum(size / edge, 1.0).astype(np.int64)
    index = np.minimum(0.5 * (position + 1.0) * counts, counts - 1).astype(np.int64)
    return np.asarray((index[:, 2] * counts[1] + index[:, 1]) * counts[0] + index[:, 0])


def _ends(
    maps: VolumePolynomials, position: F64, rows: I64, neighbours: tuple[I64, I64] | None
) -> F64:
    """Return the first and last pixels (k, camera, 2, 2) that fits touch."""
    cameras = range(len(maps.coefficients))
    if neighbours is None:
        pixels = [project_points(maps, camera, position[rows]) for camera in cameras]
        return np.repeat(np.stack(pixels, axis=1)[:, :, None], 2, axis=2)
    stacked = np.stack([project_points(maps, camera, position) for camera in cameras], axis=1)
    out = np.zeros((len(rows), len(cameras), 2, 2))
    share_rows(lambda part: _fill_ends(stacked, rows[part], *neighbours, out[part]), len(rows))
    return out


@numba.njit(cache=True, nogil=True)
def _fill_ends(pixels: Any, rows: Any, starts: Any, near: Any, out: Any) -> None:
    for k in range(len(rows)):
        n = rows[k]
        out[k, :, 0], out[k, :, 1] = pixels[n], pixels[n]
        for slot in range(starts[n], starts[n + 1]):
            for c in range(pixels.shape[1]):
                for a in range(2):
                    value = pixels[near[slot], c, a]
                    out[k, c, 0, a] = min(out[k, c, 0, a], value)
                    out[k, c, 1, a] = max(out[k, c, 1, a], value)


@numba.njit(cache=True)
def _colours(low: Any, high: Any) -> Any:
    """Give rectangles (group, camera, 2) the least number that none they overlap has."""
    count = len(low)
    colour, taken = np.zeros(count, dtype=np.int64), np.full(count + 1, -1)
    for g in range(count):
        for other in range(g):
            if taken[colour[other]] < g and _overlap(low, high, g, other):
                taken[colour[other]] = g
        while taken[colour[g]] == g:
            colour[g] += 1
    return colour


@inner_kernel()
def _overlap(low: Any, high: Any, first: int, other: int) -> bool:
    for c in range(low.shape[1]):
        if (
            low[first, c, 0] <= high[other, c, 0]
            and low[other, c, 0] <= high[first, c, 0]
            and low[first, c, 1] <= high[other, c, 1]
            and low[other, c, 1] <= high[first, c, 1]
        ):
            return True
    return False


def paint_particles(model: ImageModel, sigma: F64, particles: ModelParticles, sign: float) -> None:
    """Add the light of particles times a sign to what is left of the images."""

    def paint(camera: int) -> None:
        view, room = _of_camera(model, sigma, camera)
        paint_all(view, room, _in_camera(particles, camera), sign)

    for_each(paint, len(sigma))


def sum_in_cameras(
    add: Callable[..., None],
    model: ImageModel,
    sigma: F64,
    particles: ModelParticles,
    shape: tuple[int, ...],
) -> F64:
    """Sum up (camera, ...) what a kernel adds for particles."""
    sums = np.zeros((len(sigma), *shape))

    def add_camera(camera: int) -> None:
        view, room = _of_camera(model, sigma, camera)
        add(view, room, _in_camera(particles, camera), sums[camera : camera + 1])

    for_each(add_camera, len(sigma))
    return sums


def split_gains(model: ImageModel, sigma: F64, particles: ModelParticles, steps: F64) -> F64:
    """Predict (n,) the decrease of the cost by a split along the best step (k, 3)."""
    gains = np.zeros(len(particles.position))
    return _measure(model_moves.measure_split_gains, model, sigma, particles, gains, steps)


def light_gains(model: ImageModel, sigma: F64, particles: ModelParticles) -> F64:
    """Compute (n, camera) the decrease of the cost by light in each camera."""
    return _measure(
        model_moves.measure_light_gains, model, sigma, particles, np.zeros(particles.light.shape)
    )


def _measure(
    kernel: Callable[..., None],
    model: ImageModel,
    sigma: F64,
    particles: ModelParticles,
    out: F64,
    *more: F64,
) -> F64:
    def measure(rows: slice) -> None:
        kernel(model, make_room(sigma), some_rows(particles, rows), *more, out[rows])

    share_rows(measure, len(out))
    return out


def _of_camera(model: ImageModel, sigma: F64, camera: int) -> tuple[ImageModel, Room]:
    """Return a view of one camera alone, and room with windows as wide as in all."""
    part = slice(camera, camera + 1)
    maps = model.maps._replace(coefficients=model.maps.coefficients[part])
    arrays = ("shapes", "typical", "images", "weight", "left")
    view = model._replace(maps=maps, **{name: getattr(model, name)[part] for name in arrays})
    return view, make_room(np.full((1, 2), sigma.max()))


def _in_camera(particles: ModelParticles, camera: int) -> ModelParticles:
    light = np.ascontiguousarray(particles.light[:, camera : camera + 1])
    return particles._replace(light=light)


def some_rows(particles: ModelParticles, rows: slice) -> ModelParticles:
    """Return a view of some of the particles."""
    return ModelParticles(particles.position[rows], particles.light[rows], particles.alive[rows])
