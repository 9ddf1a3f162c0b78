"""Vortex rings in measured fields: positions of their cores, and circulation."""

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from sabench.api import Velocity
from sabench.geometry.grid import gradient, vorticity
from sabench.utils.arrays import F64

_Vector = tuple[float, float, float]
Sampled = Callable[[F64], F64]  # values (n, ...) at points (n, 3), NaN where unknown
_SIDE = 200  # points along each side of a contour
_FINE = 121  # points along each side of the square that is searched for a core


def interpolate_field(field: Velocity, values: F64) -> Sampled:
    """Interpolate values (z, y, x, ...) linearly between a field's nodes.

    NaN beyond the nodes. A planar field stands for its depth, half of it on either side.
    """
    low, step, counts = field.low_mm, np.asarray(field.step_mm), field.valid.shape[::-1]
    along = [2, 1, 0] if field.plane_axes is None else [1, 0]
    inner = RegularGridInterpolator(
        [np.arange(counts[axis]) for axis in along],
        values.reshape(*(counts[axis] for axis in along), *values.shape[3:]),
        bounds_error=False,
        fill_value=np.nan,
    )

    def at(points: F64) -> F64:
        places = (points - np.asarray(low)) @ field.axes.T / step
        sampled = np.asarray(inner(places[:, along]))
        if field.plane_axes is not None:
            sampled[np.abs(places[:, 2]) > 0.5] = np.nan
        return sampled

    return at


def spin_of(field: Velocity) -> Sampled:
    """Interpolate a field's vorticity linearly, or its part about a plane's normal."""
    aligned = field.in_own_axes()
    spin = vorticity(gradient(aligned.velocity_mm_s, aligned.step_mm))
    if field.plane_axes is not None:
        spin[..., :2] = 0.0
    return interpolate_field(field, spin @ field.axes)


@dataclass(frozen=True)
class HalfPlane:
    """Half of a plane through a ring's axis, which cuts its core once.

    Attributes
    ----------
    center_mm : the ring's centre.
    outward, axis, normal : unit vectors: away from the axis, along it, and across the plane,
        right-handed in this order.
    """

    center_mm: F64
    outward: F64
    axis: F64
    normal: F64

    def points(self, r: F64, z: F64) -> F64:
        """Compute world points (n, 3) at distances and heights (n,)."""
        return np.asarray(self.center_mm + r[:, None] * self.outward + z[:, None] * self.axis)


def half_plane(center_mm: _Vector, axis: _Vector, start: _Vector, degrees: float) -> HalfPlane:
    """Make the half plane at an angle about a ring's axis.

    The angle is right-handed, from the half plane that holds the start direction.
    """
    along = np.asarray(axis) / np.linalg.norm(axis)
    first = np.asarray(start) - np.dot(start, along) * along
    first /= np.linalg.norm(first)
    angle = np.deg2rad(degrees)
    outward = np.cos(angle) * first + np.sin(angle) * np.cross(along, first)
    return HalfPlane(np.asarray(center_mm), outward, along, np.cross(outward, along))


def core(
    spin: Sampled, half: HalfPlane, radius_mm: float, search_mm: float
) -> tuple[float, float, float]:
    """Locate a core in a half plane: radius, height, and peak vorticity.

    The position is the centroid of the vorticity that exceeds half of the peak, because a maximum
    lies on a node of a coarse field. NaN where the vorticity is unknown.
    Of the vorticity `spin`, a square of half the side `search_mm` is searched around the distance
    `radius_mm` from the axis and the height 0, where the core is expected.
    """
    offsets = np.linspace(-search_mm, search_mm, _FINE)
    r, z = (part.ravel() for part in np.meshgrid(radius_mm + offsets, offsets))
    across = spin(half.points(r, z)) @ half.normal
    if np.isnan(across).all():
        return float("nan"), float("nan"), float("nan")
    top = float(across[np.nanargmax(np.abs(across))])
    weight = np.where(across / top > 0.5, across, 0.0)
    return float(np.average(r, weights=weight)), float(np.average(z, weights=weight)), top


def circulation(
    velocity: Sampled, half: HalfPlane, r_mm: float, z_mm: float, width_mm: float, height_mm: float
) -> float:
    """Integrate the velocity along a rectangle in a half plane.

    NaN if the velocity is not known all around. Source: thesis, section 2.3.3.
    The rectangle has its centre at `r_mm` from the axis and the height `z_mm`, and the sides
    `width_mm` across the axis and `height_mm` along it.
    """
    signs = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)])
    corners = signs * 0.5 * [width_mm, height_mm] + [r_mm, z_mm]
    total = 0.0
    for start, end in itertools.pairwise(corners):
        parts = (np.arange(_SIDE) + 0.5)[:, None] / _SIDE
        r, z = (start + parts * (end - start)).T
        step = (end - start)[0] * half.outward + (end - start)[1] * half.axis
        total += float(np.mean(velocity(half.points(r, z)) @ step))
    return total
