"""Vortex rings in measured fields: where their cores are, and the circulation about them."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from sabench.api import Velocity
from sabench.geometry.vector_calculus import gradient, vorticity
from sabench.utils.arrays import F64

Vector = tuple[float, float, float]
Sampled = Callable[[F64], F64]  # values (n, ...) at points (n, 3), NaN where nothing is known
_SIDE = 200  # points along each side of a contour
_FINE = 121  # points along each side of the square in which a core is looked for


def sampled(field: Velocity, values: F64) -> Sampled:
    """Values (z, y, x, ...) at a field's nodes between them: along straight lines; NaN beyond the nodes."""
    places = field.positions_mm
    axes = places[:, 0, 0, 2], places[0, :, 0, 1], places[0, 0, :, 0]
    inner = RegularGridInterpolator(axes, values, bounds_error=False, fill_value=np.nan)
    return lambda points: np.asarray(inner(points[:, ::-1]))


def spin_of(field: Velocity) -> Sampled:
    """A field's vorticity between its nodes."""
    return sampled(field, vorticity(gradient(field.velocity_mm_s, field.step_mm)))


@dataclass(frozen=True)
class HalfPlane:
    """Half of a plane through a ring's axis, which cuts its core once.

    Attributes
    ----------
    center_mm : the ring's middle.
    outward, axis, normal : unit vectors: away from the axis, along it, and across the plane,
        right-handed in this order.
    """

    center_mm: F64
    outward: F64
    axis: F64
    normal: F64

    def points(self, r: F64, z: F64) -> F64:
        """World points (n, 3) at distances (n,) from the axis and heights (n,) along it."""
        return np.asarray(self.center_mm + r[:, None] * self.outward + z[:, None] * self.axis)


def half_plane(center_mm: Vector, axis: Vector, start: Vector, degrees: float) -> HalfPlane:
    """The half plane at an angle about a ring's axis from the one that holds a direction, right-handed."""
    along = np.asarray(axis) / np.linalg.norm(axis)
    first = np.asarray(start) - np.dot(start, along) * along
    first /= np.linalg.norm(first)
    angle = np.deg2rad(degrees)
    outward = np.cos(angle) * first + np.sin(angle) * np.cross(along, first)
    return HalfPlane(np.asarray(center_mm), outward, along, np.cross(outward, along))


def core(
    spin: Sampled, half: HalfPlane, radius_mm: float, reach_mm: float
) -> tuple[float, float, float]:
    """Distance from the axis and height of a core, and the strongest vorticity across a half plane, near a place (radius, 0).

    The place is the centroid of the vorticity that exceeds half of the strongest: a maximum lies on
    a node of a coarse field. NaN if it is not known.
    """
    offsets = np.linspace(-reach_mm, reach_mm, _FINE)
    r, z = (part.ravel() for part in np.meshgrid(radius_mm + offsets, offsets))
    across = spin(half.points(r, z)) @ half.normal
    if np.isnan(across).all():
        return float("nan"), float("nan"), float("nan")
    top = float(across[np.nanargmax(np.abs(across))])
    weight = np.where(across / top > 0.5, across / top, 0.0)
    return float(np.average(r, weights=weight)), float(np.average(z, weights=weight)), top


def circulation(
    velocity: Sampled, half: HalfPlane, r_mm: float, z_mm: float, width_mm: float, height_mm: float
) -> float:
    """Line integral of the velocity around a rectangle about a place in a half plane, right-handed about its normal; NaN where it is not known all
    around. Source: thesis, section 2.3.3."""
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)]) * 0.5 * np.array(
        [width_mm, height_mm]
    ) + np.array([r_mm, z_mm])
    total = 0.0
    for start, end in itertools.pairwise(corners):
        parts = (np.arange(_SIDE) + 0.5)[:, None] / _SIDE
        r, z = (start + parts * (end - start)).T
        step = (end - start)[0] * half.outward + (end - start)[1] * half.axis
        total += float(np.mean(velocity(half.points(r, z)) @ step))
    return total
