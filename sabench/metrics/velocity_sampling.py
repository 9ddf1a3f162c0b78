"""Evaluation nodes of velocity fields, and fields of any lattice sampled there."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import numpy.typing as npt

from sabench.api import Velocity
from sabench.geometry.grid import Grid
from sabench.utils.arrays import F64, I64, Bool, triple

# voxels between nodes: 8 over the golden ratio. Windows are a whole number of voxels apart, so that
# the nodes lie everywhere between those of any estimate, and none gains by where its own lie
_SPACING = 8.0 * 2.0 / (1.0 + math.sqrt(5.0))
_MOST = 30_000  # nodes; a larger volume has them farther apart
_LEAST = 3  # nodes along an axis, where the volume has as many voxels
_ON_NODE = 1e-9  # of a step, within which a point lies on a node


def evaluation_lattice(grid: Grid) -> Velocity:
    """Make the lattice of nodes at which velocities are scored, all of them at rest.

    It fills the scored part of the grid and is centred in it.
    """
    crop, size = np.asarray(grid.crop), np.asarray(grid.shape[::-1])
    voxels = (size - 2 * crop).astype(np.float64)
    spacing = max(_SPACING, float(np.cbrt(voxels.prod() / _MOST)))
    steps = np.maximum(np.minimum(spacing, voxels / _LEAST), 1.0)
    counts = np.maximum(1, np.floor(voxels / steps * (1.0 + 1e-12))).astype(np.int64)
    first = (size - 1) / 2.0 - (counts - 1) / 2.0 * steps
    shape = tuple(counts[::-1].tolist())
    voxel_mm = np.asarray(grid.voxel_mm)
    return Velocity(
        triple(np.asarray(grid.low_mm) + first * voxel_mm),
        triple(steps * voxel_mm),
        np.zeros((*shape, 3)),
        np.ones(shape, dtype=np.bool_),
    )


def sample_velocity(field: Velocity, points_mm: F64) -> tuple[F64, Bool]:
    """Interpolate a field at points (n, 3).

    Returns velocities (n, 3), and where (n,) they were measured.

    Each node stands for the cell around it, half a step in every direction, as a voxel does. A
    point is measured where the node of its cell is. Its velocity is interpolated linearly along
    every axis between the measured ones of the eight nodes around it, and constant beyond the
    outermost nodes. A lattice of a single node measures nothing.
    """
    counts = np.asarray(field.valid.shape[::-1])
    places = (points_mm - np.asarray(field.low_mm)) / np.asarray(field.step_mm)
    inside = ((places >= -0.5) & (places <= counts - 0.5)).all(axis=1) & (counts.prod() > 1)
    velocity = np.zeros((len(points_mm), 3))
    measured = np.zeros(len(points_mm), dtype=np.bool_)
    places = np.clip(places[inside], 0.0, counts - 1.0)
    whole = np.rint(places)
    places = np.where(np.abs(places - whole) < _ON_NODE, whole, places)
    measured[inside] = _at(field.valid, whole.astype(np.int64))
    velocity[inside] = _interpolate(field, places, counts)
    velocity[~measured] = 0.0
    return velocity, measured


def _interpolate(field: Velocity, places: F64, counts: I64) -> F64:
    """Interpolate between the measured nodes around fractional indices (n, 3)."""
    low = np.minimum(np.floor(places), np.maximum(counts - 2, 0)).astype(np.int64)
    away = places - low
    total, weights = np.zeros((len(places), 3)), np.zeros(len(places))
    for corner in itertools.product((0, 1), repeat=3):
        node = np.minimum(low + corner, counts - 1)
        weight = np.where(corner, away, 1.0 - away).prod(axis=1) * _at(field.valid, node)
        total += weight[:, None] * _at(field.velocity_mm_s, node)
        weights += weight
    return np.asarray(total / np.where(weights > 0.0, weights, 1.0)[:, None])


def _at(values: npt.NDArray[Any], nodes: I64) -> npt.NDArray[Any]:
    """Look values (z, y, x, ...) up at nodes (n, 3) of x, y, z."""
    x, y, z = nodes.T
    return np.asarray(values[z, y, x])
