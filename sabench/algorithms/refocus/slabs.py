"""Slabs of planes that share one set of rectified images, and their affine maps.

A voxel and the point where its line of sight meets the slab's middle plane have the same pixel. For
a pinhole in air the map from one to the other is a scale and a shift, the same for a plane;
refraction changes it a little. Inside a tile of voxels an affine map is accurate enough.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from sabench.algorithms.refocus.cpu_kernels import TILE_COLUMNS, TILE_ROWS
from sabench.geometry import plane_polynomials as polynomials
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.grid import Grid
from sabench.utils.arrays import F64, I64

# largest distance, in a camera's pixels, between the tiles' affine maps and the exact lines of
# sight
DEVIATION_PX = 0.01
_MARGIN = 2.0  # voxels of a rectified image around the requested ones
_PROBES = 2000  # positions for a measurement of the deviation
_NODES = 7  # depths of computed displacements; between them they are interpolated


@dataclass(frozen=True)
class Slab:
    """Planes of a grid, and the rectified images for them.

    The planes are `first` to `first + count - 1`.

    Attributes
    ----------
    first, count : planes.
    z_mm : the plane of the rectified images.
    corners : (camera, 2) x, y of the rectified images' first pixel, in voxels of the grid.
    shape : (height, width) of the rectified images, with pixels as far apart as voxels.
    displacement : (camera, plane, 2, terms) polynomials in u, v across the grid: the displacement
        in x, y from a voxel to its image on `z_mm`, in voxels.
    degree : of these polynomials.
    """

    first: int
    count: int
    z_mm: float
    corners: F64
    shape: tuple[int, int]
    displacement: F64
    degree: int

    def tiles(self, grid: Grid) -> F64:
        """Compute affine maps (tile, plane, camera, 6) from the tiles' centres."""
        top, left = tile_origins(grid)
        origin = np.column_stack([left, top]).astype(np.float64)
        middle = origin + (tile_sizes(grid) - 1) / 2.0
        half = np.maximum(np.asarray(grid.shape[:0:-1]) - 1.0, 1.0) / 2.0
        unit = (middle - (np.asarray(grid.shape[:0:-1]) - 1) / 2.0) / half
        along_u, along_v = polynomials.slopes(unit, self.degree)
        bases = polynomials.terms(unit, self.degree), along_u / half[0], along_v / half[1]
        value, along_x, along_y = (self._evaluate(basis) for basis in bases)
        along_x[..., 0] += 1.0
        along_y[..., 1] += 1.0
        back = (origin - middle)[:, None, None]
        start = value + middle[:, None, None] - self.corners
        start = start + along_x * back[..., :1] + along_y * back[..., 1:]
        return np.stack([start, along_x, along_y], axis=-1).reshape(*start.shape[:3], 6)

    def positions(self, grid: Grid) -> F64:
        """Fit positions (camera, plane, 2, terms) in the rectified images as polynomials."""
        maps = self.displacement.copy()
        for axis, (count, linear) in enumerate(
            zip(grid.shape[:0:-1], (1, self.degree + 1), strict=True)
        ):
            half = (count - 1) / 2.0
            maps[:, :, axis, linear] += half
            maps[:, :, axis, 0] += half - self.corners[:, None, axis]
        return maps

    @property
    def middle_shifts(self) -> F64:
        """Displacements (camera, plane, 2) at the grid's middle."""
        return self.displacement[..., 0]  # the constant terms

    def _evaluate(self, basis: F64) -> F64:
        """Evaluate polynomials at n positions: (n, plane, camera, 2)."""
        cameras, planes = self.displacement.shape[:2]
        flat = self.displacement.transpose(1, 0, 2, 3).reshape(-1, self.displacement.shape[3])
        return np.asarray(basis @ flat.T).reshape(len(basis), planes, cameras, 2)


def slabs(cameras: Sequence[CameraModel], grid: Grid) -> list[Slab]:
    """Cut the grid into as few slabs as keep affine maps within `DEVIATION_PX`.

    Raises
    ------
    ValueError
        Some of the grid has no light path to a camera, or a single plane cannot be mapped within
        tolerance.
    """
    done, waiting = [], [(0, grid.shape[0])]
    while waiting:
        first, count = waiting.pop()
        slab = make_slab(cameras, grid, first, count)
        # a single plane is its own middle: nothing deviates
        if deviation_px(slab, cameras, grid) <= DEVIATION_PX or count == 1:
            done.append(slab)
        else:
            waiting += [(first + count // 2, count - count // 2), (first, count // 2)]
    return done


def make_slab(cameras: Sequence[CameraModel], grid: Grid, first: int, planes: int) -> Slab:
    """Make a slab of the given planes, whatever its deviation is."""
    depths = grid.axes_mm[2][first : first + planes]
    z_mm = float(depths[0] + depths[-1]) / 2.0
    # displacements are computed at Chebyshev nodes, and interpolated between them: (plane, node)
    count = min(_NODES, len(depths))
    nodes, interpolation = depths, np.ones((1, 1))
    if count > 1:
        half, vander = (depths[-1] - depths[0]) / 2.0, np.polynomial.chebyshev.chebvander
        unit = np.cos(np.pi * (np.arange(count) + 0.5) / count)
        nodes, inverse = z_mm + half * unit, np.linalg.inv(vander(unit, count - 1))
        interpolation = vander((depths - z_mm) / half, count - 1) @ inverse
    functions = [_displacement(camera, grid, nodes, z_mm) for camera in cameras]
    degree = max(polynomials.lowest_degree(function) for function in functions)
    at_nodes = np.stack(
        [
            polynomials.fit_polynomials(function, degree)[0].reshape(len(nodes), 2, -1)
            for function in functions
        ]
    )
    displacement = np.einsum("pn,cnik->cpik", interpolation, at_nodes)
    corners, shape = _boxes(cameras, grid, z_mm, displacement, degree)
    return Slab(first, planes, z_mm, corners, shape, displacement, degree)


def deviation_px(slab: Slab, cameras: Sequence[CameraModel], grid: Grid) -> float:
    """Measure the largest distance of affine maps from the exact lines of sight, px.

    Only voxels that a camera sees count. Random voxels are tried, every other one in a corner of
    its tile and most on the slab's outer planes: the deviation grows towards both.
    """
    rng = np.random.default_rng(0)
    top, left = tile_origins(grid)
    maps, tile = slab.tiles(grid), rng.integers(len(top), size=_PROBES)
    number = np.arange(_PROBES)
    outer = rng.choice([0, slab.count - 1], size=_PROBES)
    plane = np.where(number % 4, outer, rng.integers(slab.count, size=_PROBES))
    inner = rng.random((_PROBES, 2))
    share = np.where(number[:, None] % 2, inner, rng.integers(2, size=(_PROBES, 2)))
    column, row = np.rint(share * (tile_sizes(grid)[tile] - 1)).astype(int).T
    step, low = np.asarray(grid.voxel_mm), np.asarray(grid.low_mm)
    exact = low + step * np.column_stack([left[tile] + column, top[tile] + row, slab.first + plane])
    worst = 0.0
    for camera, affines, corner in zip(cameras, np.moveaxis(maps, 2, 0), slab.corners, strict=True):
        affine = affines[tile, plane]
        mapped = affine[:, [0, 3]] + affine[:, [1, 4]] * column[:, None]
        mapped = mapped + affine[:, [2, 5]] * row[:, None] + corner
        on_plane = np.column_stack([low[:2] + step[:2] * mapped, np.full(_PROBES, slab.z_mm)])
        pixel = camera.project(exact)[0]
        distance = np.linalg.norm(pixel - camera.project(on_plane)[0], axis=1)
        worst = max(worst, float(distance[camera.contains(pixel)].max(initial=0.0)))
    return worst


def rectifying_maps(slab: Slab, cameras: Sequence[CameraModel], grid: Grid) -> tuple[F64, int]:
    """Fit pixels over rectified images as polynomials (camera, 2, terms).

    Their degree is the second value.
    """
    height, width = slab.shape
    step, low = np.asarray(grid.voxel_mm), np.asarray(grid.low_mm)
    functions = []
    for camera, (left, top) in zip(cameras, slab.corners, strict=True):
        corner = (low[0] + step[0] * left, low[1] + step[1] * top, slab.z_mm)
        box = Grid(corner, grid.voxel_mm, (1, height, width))
        functions.append(partial(_pixels, camera, box, slab.z_mm))
    degree = max(polynomials.lowest_degree(function) for function in functions)
    return np.stack(
        [polynomials.fit_polynomials(function, degree)[0] for function in functions]
    ), degree


def _pixels(camera: CameraModel, box: Grid, z_mm: float, unit: F64) -> F64:
    return camera.project(polynomials.plane_points(box, z_mm, unit))[0]


def tile_origins(grid: Grid) -> tuple[I64, I64]:
    """List first row and first column of every tile, in the order of the kernels."""
    _, rows, columns = grid.shape
    starts = np.arange(0, rows, TILE_ROWS), np.arange(0, columns, TILE_COLUMNS)
    top, left = np.meshgrid(*starts, indexing="ij")
    return top.ravel(), left.ravel()


def tile_sizes(grid: Grid) -> I64:
    """List columns and rows of every tile: (tile, 2)."""
    top, left = tile_origins(grid)
    return np.column_stack(
        [np.minimum(TILE_COLUMNS, grid.shape[2] - left), np.minimum(TILE_ROWS, grid.shape[1] - top)]
    )


def _displacement(camera: CameraModel, grid: Grid, depths: F64, z_mm: float) -> polynomials.Smooth:
    """Make the function of shifts (n, 2 planes) along the line of sight, in voxels.

    The shifts are those to the plane `z_mm`.
    """

    def shifts(unit: F64) -> F64:
        parts = []
        for z in depths:
            points = polynomials.plane_points(grid, float(z), unit)
            carried = camera.carry(points, z_mm)
            if not np.isfinite(carried).all():
                raise ValueError(
                    f"{camera.name}: expected a light path to every voxel, but the plane z = "
                    f"{z:g} mm has points without one"
                )
            parts.append((carried - points[:, :2]) / np.asarray(grid.voxel_mm)[:2])
        return np.column_stack(parts)

    return shifts


def _boxes(
    cameras: Sequence[CameraModel], grid: Grid, z_mm: float, displacement: F64, degree: int
) -> tuple[F64, tuple[int, int]]:
    """Find first pixels (camera, 2) and common shape of the rectified images."""
    axis = np.linspace(-1.0, 1.0, 9)
    unit = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    voxels = (unit + 1.0) / 2.0 * (np.asarray(grid.shape[:0:-1]) - 1)
    ways = np.einsum("nk,cpik->cpni", polynomials.terms(unit, degree), displacement[:, [0, -1]])
    needed = (voxels + ways).reshape(len(cameras), -1, 2)
    low, high = needed.min(axis=1), needed.max(axis=1)
    for number, camera in enumerate(cameras):
        border = _border(camera, grid, z_mm)
        low[number] = np.clip(border.min(axis=0), low[number], high[number])
        high[number] = np.clip(border.max(axis=0), low[number], high[number])
    corners = np.floor(low - _MARGIN)
    width, height = (np.ceil(high + _MARGIN) - corners).max(axis=0).astype(int) + 1
    return corners, (int(height), int(width))


def _border(camera: CameraModel, grid: Grid, z_mm: float) -> F64:
    """Project the border of an image to a plane, in voxels (n, 2).

    Values are infinite without a path.
    """
    along = np.linspace(-0.5, 0.5, 33)
    sides = [
        np.column_stack(pair)
        for end in (-0.5, 0.5)
        for pair in ((along, np.full(33, end)), (np.full(33, end), along))
    ]
    size = np.array([camera.columns, camera.rows])
    pixels = np.vstack(sides) * size + (size - 1) / 2.0
    rays = camera.back_project(pixels)
    if not rays.valid.all() or (rays.directions[:, 2] <= 0.0).any():
        return np.array([[-np.inf, -np.inf], [np.inf, np.inf]])
    distance = (z_mm - rays.origins_mm[:, 2:]) / rays.directions[:, 2:]
    return grid.to_voxels(rays.origins_mm + distance * rays.directions)[:, :2]
