"""Edges in refocused planes, and the depths where they are sharpest.

On the plane of an opaque object's depth the images of all cameras coincide: its edge is in focus.
On other planes they are displaced against each other and the edge is blurred. Source: J. Belden's
thesis, chapter 6 (figure 6-6), which shows edges without their depths.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates, maximum_filter1d

from sabench.geometry.grid import Grid
from sabench.utils.arrays import F32, F64, I64, Bool

_LEAST_PART = 0.5  # of the largest gradient, above which planes take part in the fit of the depth


@dataclass(frozen=True)
class Edges:
    """Points of edges in a refocused stack.

    Attributes
    ----------
    position_mm : (n, 3), world frame.
    normal : (n, 2) unit vectors in the plane, towards larger values.
    height : (n,) step of the stack, in its unit, that would have the same gradient if it were
        sharp.
    """

    position_mm: F64
    normal: F64
    height: F64

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.height)


def find_edges(stack: F32, grid: Grid, *, least: float, reach_mm: float) -> Edges:
    """Find the points where an edge is sharpest, in its plane and over depth.

    They are maxima of the gradient in the plane along its own direction, and over depth. A parabola
    in the gradient refines the position in the plane, one in its logarithm that in depth.

    Parameters
    ----------
    stack : (z, y, x) refocused images, voxels as wide as long.
    least : least height of a step that is an edge.
    reach_mm : depth around an edge without a sharper one; the planes there are fitted.
    """
    planes = max(1, round(reach_mm / grid.voxel_mm[2]))
    height = np.empty_like(stack)
    for plane, out in zip(stack, height, strict=True):
        np.hypot(*plane_gradient(plane), out=out)
    highest = maximum_filter1d(height, 2 * planes + 1, axis=0, mode="nearest")
    z, y, x = np.nonzero((height >= least) & (height == highest))
    # edges that are sharpest on the first or last plane lie beyond it
    inner = np.flatnonzero((z > 0) & (z < len(stack) - 1))
    z, y, x = z[inner], y[inner], x[inner]
    normal = _directions(stack, z, y, x)
    aside, sharpest = _refine_across(height, z, y, x, normal)
    z, y, x = z[sharpest], y[sharpest], x[sharpest]
    normal, aside = normal[sharpest], aside[sharpest]
    depth = _refine_depth(height, z, y, x, planes)
    voxels = np.column_stack([x + aside * normal[:, 0], y + aside * normal[:, 1], z + depth])
    position = voxels * np.asarray(grid.voxel_mm) + np.asarray(grid.low_mm)
    return Edges(position, normal, np.asarray(height[z, y, x], dtype=np.float64))


def plane_gradient(planes: F32) -> tuple[F32, F32]:
    """Differentiate planes (..., y, x) along x and y by a Gaussian of one voxel.

    A sharp edge of height 1 gives 1.
    """
    scaled = np.sqrt(np.float32(2.0 * np.pi)) * planes
    nearest: dict[str, Any] = {"mode": "nearest", "axes": (-2, -1)}
    x, y = (gaussian_filter(scaled, 1.0, order, **nearest) for order in ((0, 1), (1, 0)))
    return x, y


def _directions(stack: F32, z: I64, y: I64, x: I64) -> F64:
    """Compute unit vectors (n, 2) along the gradients at some voxels."""
    out = np.zeros((len(z), 2))
    for plane in np.unique(z).tolist():
        inside = np.flatnonzero(z == plane)
        slopes = plane_gradient(stack[plane])
        out[inside] = np.column_stack([slope[y[inside], x[inside]] for slope in slopes])
    return np.asarray(out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-12))


def _refine_across(height: F32, z: I64, y: I64, x: I64, normal: F64) -> tuple[F64, Bool]:
    """Find how far (n,) the maximum along the normal is, and if it is in the voxel."""
    before, after = (
        map_coordinates(height, [z, y + sign * normal[:, 1], x + sign * normal[:, 0]], order=1)
        for sign in (-1.0, 1.0)
    )
    middle = height[z, y, x]
    bend = np.maximum(2.0 * middle - before - after, 1e-12)
    aside = np.asarray((after - before) / bend / 2.0, dtype=np.float64)
    return aside, (middle >= before) & (middle >= after) & (np.abs(aside) <= 0.5)


def _refine_depth(height: F32, z: I64, y: I64, x: I64, planes: int) -> F64:
    """Refine the depths (n,) of the sharpest planes, in planes.

    A parabola is fitted to the logarithms of the heights around, weighted by their squares, since
    noise is the same for all heights.
    """
    offsets = np.arange(-planes, planes + 1)
    at = z[:, None] + offsets
    values = height[np.clip(at, 0, len(height) - 1), y[:, None], x[:, None]].astype(np.float64)
    used = (at >= 0) & (at < len(height)) & (values > _LEAST_PART * height[z, y, x][:, None])
    weights = np.where(used, values**2, 0.0)
    powers = offsets[:, None] ** np.arange(3.0)
    normal = np.einsum("no,oi,oj->nij", weights, powers, powers)
    right = np.einsum("no,no,oi->ni", weights, np.log(np.maximum(values, 1e-9)), powers)
    enough = used.sum(axis=1) >= 3
    normal[~enough] = np.eye(3)
    _, slope, bend = np.linalg.solve(normal, right[..., None])[..., 0].T
    peak = -slope / np.minimum(2.0 * bend, -1e-9)
    return np.where(enough & (np.abs(peak) <= 1.0), peak, 0.0)
