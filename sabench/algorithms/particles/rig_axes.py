"""Axes of an array of cameras, so that results do not depend on the world's.

Lattices, orders of equal candidates and directions of splits follow the axes of the box that is
searched. Its axes are the world's, but images decide which of them is x, y and z, and in which
direction: a rig that is rotated together with its grid, axes onto axes, gives the same particles.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from sabench.algorithms.particles.candidate_search import slopes_per_mm
from sabench.api import FoundParticles
from sabench.geometry.volume_polynomials import VolumePolynomials
from sabench.utils.arrays import F64

_VECTORS = {"position_mm", "velocity_mm_s", "acceleration_mm_s2"}
_SQUARES = {"covariance_mm2", "velocity_covariance", "acceleration_covariance"}


def rig_axes(maps: VolumePolynomials) -> F64:
    """Choose directions (3, 3) of the box's axes as x, y and z, one a row.

    Along x the columns of all cameras' images grow the most, along y, of the other two, the rows;
    x, y and z are right-handed.
    """
    growth = slopes_per_mm(maps).sum(axis=0)
    x = int(np.argmax(np.abs(growth[0])))
    y = int(np.argmax(np.where(np.arange(3) == x, -1.0, np.abs(growth[1]))))
    axes = np.zeros((3, 3))
    axes[0, x] = 1.0 if growth[0, x] >= 0.0 else -1.0
    axes[1, y] = 1.0 if growth[1, y] >= 0.0 else -1.0
    axes[2] = np.cross(axes[0], axes[1])
    return axes


def turn_maps(maps: VolumePolynomials, axes: F64) -> VolumePolynomials:
    """Rewrite polynomials for coordinates along other axes (3, 3) of the same box."""
    order = np.abs(axes).argmax(axis=1)
    there = {tuple(power): row for row, power in enumerate(maps.powers[:, order].tolist())}
    rows = [there[tuple(power)] for power in maps.powers.tolist()]
    signs = np.prod(axes.sum(axis=1) ** maps.powers, axis=1)
    turned = np.ascontiguousarray(maps.coefficients[:, rows] * signs[:, None])
    return VolumePolynomials(
        turned, maps.powers, axes @ maps.middle_mm, np.ascontiguousarray(maps.half_mm[order])
    )


def turn_to_world(found: FoundParticles, axes: F64) -> FoundParticles:
    """Convert particles from coordinates along axes (3, 3) to the world's."""
    turned: dict[str, Any] = {declared.name: value for declared, value in found.arrays()}
    for name in turned.keys() & _VECTORS:
        turned[name] = turned[name] @ axes
    for name in turned.keys() & _SQUARES:
        turned[name] = axes.T @ turned[name] @ axes
    return FoundParticles(**turned)
