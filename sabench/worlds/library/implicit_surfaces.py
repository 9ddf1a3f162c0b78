"""Bodies as implicit functions, negative inside: rounded cones and unions."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from sabench.api.truth import Solid
from sabench.utils.arrays import F32, F64
from sabench.utils.compiled import inner_kernel, numba
from sabench.utils.errors import InputError

# of a lattice: a quarter of a gigabyte, and about twice that while its surface is taken
_NODES = 64_000_000
# steps: nodes closer to the surface count as outside by this much, lest triangles there have no
# area
_OFF = 1e-3
_BAND = 10.0  # blends: what is that much farther than the nearest body adds 5e-5 of a blend

Points = Sequence[float] | F64


def surface_of(
    function: Callable[[F64], F64], low_mm: Points, high_mm: Points, step_mm: float
) -> Solid:
    """Extract the closed surface where a function is zero.

    Marching cubes (Lewiner et al. 2003) on a lattice.

    Parameters
    ----------
    function : of points (n, 3) in mm to (n,), negative inside; like a distance in mm near the
        surface. One call takes one plane of the lattice.
    low_mm, high_mm : corners (3,) of a box that the body does not reach; the lattice begins at the
        first and covers the second.
    step_mm : of the lattice. Where the body is smooth the surface is off by the order of its
        square; what is thinner than a step may be lost.

    Raises InputError: too many nodes, nothing inside, or a body that reaches the edge of the
    lattice, where its surface would be open.
    """
    from skimage.measure import marching_cubes

    low = np.asarray(low_mm, dtype=np.float64)
    counts = np.ceil((np.asarray(high_mm) - low) / step_mm - 1e-9).astype(np.int64) + 1
    if counts.prod(dtype=np.float64) > _NODES:
        raise InputError(
            f"step_mm: expected a lattice of at most {_NODES} nodes, got "
            f"{' x '.join(map(str, counts))} with {step_mm:g} mm"
        )
    axes = [start + step_mm * np.arange(count) for start, count in zip(low, counts, strict=True)]
    y, z = (axis.ravel() for axis in np.meshgrid(axes[1], axes[2], indexing="ij"))
    values = np.empty(counts, dtype=np.float32)
    for n, x in enumerate(axes[0]):
        plane = function(np.column_stack([np.full(len(y), x), y, z]))
        values[n] = plane.reshape(values.shape[1:])
    _check_inside(values, low, step_mm)
    values[np.abs(values) < _OFF * step_mm] = _OFF * step_mm
    vertices, faces, _, _ = marching_cubes(values, 0.0, gradient_direction="descent")
    return Solid(low + step_mm * vertices.astype(np.float64), faces.astype(np.int64))


def _check_inside(values: F32, low_mm: F64, step_mm: float) -> None:
    high = low_mm + step_mm * (np.array(values.shape) - 1)
    where = f"{np.round(low_mm, 3).tolist()} to {np.round(high, 3).tolist()} mm"
    if not values.min() < 0.0:
        raise InputError(
            f"expected a body in the lattice from {where}, got nothing: it may be thinner than the "
            f"step, {step_mm:g} mm"
        )
    sides = {
        f"{sign}{'XYZ'[axis]}": values.take(end, axis)
        for axis in range(3)
        for sign, end in (("-", 0), ("+", -1))
    }
    cut = [name for name, side in sides.items() if side.min() < _OFF * step_mm]
    if cut:
        raise InputError(
            f"expected a body that ends within the lattice from {where}, but it reaches its edge "
            f"at {', '.join(cut)}"
        )


def largest_part(solid: Solid) -> Solid:
    """Keep the connected surface that encloses the most.

    Parts that hang in the fluid are dropped, hollows without an opening filled.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    corners, faces = solid.vertices_mm[solid.faces], solid.faces
    count = len(solid.vertices_mm)
    joined = coo_matrix(
        (np.ones(2 * len(faces)), (faces[:, [0, 1]].ravel(), faces[:, [1, 2]].ravel())),
        shape=(count, count),
    )
    number, part = connected_components(joined, directed=False)
    volumes = np.bincount(
        part[faces[:, 0]], np.linalg.det(corners - solid.vertices_mm.mean(axis=0)) / 6.0, number
    )
    chosen = part == volumes.argmax()
    return Solid(solid.vertices_mm[chosen], (np.cumsum(chosen) - 1)[faces[chosen[faces[:, 0]]]])


def smooth_minimum(values: npt.ArrayLike, blend_mm: float) -> F64:
    """Smooth minimum of values (k, ...) over the first axis.

    It is -b log(sum(exp(-v / b))), at most b log(k) below the least.

    The same whatever their order, and in whatever groups it is taken; with a blend of 0 the minimum
    itself.
    """
    every = np.asarray(values, dtype=np.float64)
    least = every.min(axis=0)
    if not blend_mm:
        return np.asarray(least)
    return np.asarray(least - blend_mm * np.log(np.exp((least - every) / blend_mm).sum(axis=0)))


def capsules(
    points_mm: F64,
    starts_mm: F64,
    ends_mm: F64,
    start_radii_mm: F64,
    end_radii_mm: F64,
    blend_mm: float = 0.0,
) -> F64:
    """Compute signed distances (n,) of points to a smooth union of rounded cones.

    Points are (n, 3). A cone is the union of balls with a radius linear from end to end.

    Outside, and with a blend of 0, it is the distance; inside it is the largest depth in any one of
    them. A ball has both ends in one place.

    Parameters
    ----------
    starts_mm, ends_mm, start_radii_mm, end_radii_mm : (k, 3), (k, 3), (k,), (k,).
    blend_mm : as of `smooth_minimum`: joints of two are filled, and what lies twice in one place
        grows by 0.69 of it.
    """
    directions = ends_mm - starts_mm
    lengths = np.linalg.norm(directions, axis=1)
    fall = start_radii_mm - end_radii_mm
    ball = lengths <= np.abs(fall)  # one end's ball holds the other
    starts = np.where((ball & (fall < 0.0))[:, None], ends_mm, starts_mm)
    radii = np.where(ball, np.maximum(start_radii_mm, end_radii_mm), start_radii_mm)
    over = np.divide(1.0, lengths, out=np.zeros_like(lengths), where=~ball)
    sines, lengths = fall * over, np.where(ball, 0.0, lengths)
    extents = lengths + np.maximum(start_radii_mm, end_radii_mm)
    out = np.empty(len(points_mm))
    cones = starts, directions * over[:, None], lengths, radii, sines, extents
    _union(points_mm, cones, blend_mm, out)
    return out


@numba.njit(cache=True, error_model="numpy")
def _union(points: Any, cones: Any, blend: float, out: Any) -> None:
    """Smooth minimum of distances to rounded cones, relative to the least so far."""
    starts, directions, lengths, radii, sines, extents = cones
    nearest = 0
    for n in range(len(points)):
        # the neighbour's nearest one first: what is far beyond it needs no distance
        least, total, first = np.inf, 0.0, nearest
        for rank in range(len(starts)):
            k = first if rank == 0 else rank - 1 if rank <= first else rank
            x, y = points[n, 0] - starts[k, 0], points[n, 1] - starts[k, 1]
            z = points[n, 2] - starts[k, 2]
            square = x * x + y * y + z * z
            far = least + _BAND * blend + extents[k]
            if square > far * abs(far):
                continue
            along = x * directions[k, 0] + y * directions[k, 1] + z * directions[k, 2]
            value = _distance(square, along, lengths[k], radii[k], sines[k])
            if value < least:
                total = total * np.exp((value - least) / blend) + 1.0
                least, nearest = value, k
            elif value < least + _BAND * blend:
                total += np.exp((least - value) / blend)
        out[n] = least - blend * np.log(max(total, 1.0))  # 1 is the least one's own


@inner_kernel(error_model="numpy")
def _distance(square: float, along: float, length: float, radius: float, sine: float) -> float:
    """Compute the least distance to a cone's balls.

    Their radius is radius - s sine at s along the axis; the least is where d/ds is 0, or at an end.
    """
    across = np.sqrt(max(square - along * along, 0.0))
    s = min(max(along - across * sine / np.sqrt(1.0 - sine * sine), 0.0), length)
    off = along - s
    return float(np.sqrt(across * across + off * off) - radius + s * sine)
