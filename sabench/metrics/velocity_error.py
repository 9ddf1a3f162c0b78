"""Errors of velocity fields of any lattice, sampled at common nodes."""

import itertools
import math
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from sabench.api import Velocity
from sabench.geometry.grid import Grid, cut_box, divergence, gradient, inner, vorticity
from sabench.geometry.rigid_motion import frame_of_normal
from sabench.metrics.averages import root_mean_square
from sabench.utils.arrays import F64, I64, Bool, triple
from sabench.utils.errors import InputError

# voxels between nodes: 8 over the golden ratio. Windows are a whole number of voxels apart, so that
# the nodes lie everywhere between those of any estimate, and none gains by where its own lie
_SPACING = 8.0 * 2.0 / (1.0 + math.sqrt(5.0))
_MOST = 30_000  # nodes; a larger volume has them farther apart
_LEAST = 3  # nodes along an axis, where the volume has as many voxels
_ON_NODE = 1e-9  # of a step, within which a point lies on a node


def evaluation_lattice(grid: Grid) -> Velocity:
    """Make the lattice of nodes for scored velocities, all of them at rest.

    It fills the scored part of the grid and is centred in it.
    """
    crop, size = np.asarray(grid.crop), np.asarray(grid.shape[::-1])
    voxels = (size - 2 * crop).astype(np.float64)
    steps, counts = _spread(voxels, float(np.cbrt(voxels.prod() / _MOST)))
    first = (size - 1) / 2.0 - (counts - 1) / 2.0 * steps
    shape = tuple(counts[::-1].tolist())
    voxel_mm = np.asarray(grid.voxel_mm)
    return Velocity(
        triple(np.asarray(grid.low_mm) + first * voxel_mm),
        triple(steps * voxel_mm),
        np.zeros((*shape, 3)),
        np.ones(shape, dtype=np.bool_),
    )


def _spread(voxels: F64, least: float) -> tuple[F64, I64]:
    """Compute spacing, in voxels, and number of nodes along edges of a box."""
    steps = np.maximum(np.minimum(max(_SPACING, least), voxels / _LEAST), 1.0)
    return steps, np.maximum(1, np.floor(voxels / steps * (1.0 + 1e-12))).astype(np.int64)


def planar_lattice(grid: Grid, point_mm: F64, normal: F64) -> Velocity:
    """Make the lattice for scored velocities in a light sheet.

    It is centred in the rectangle around the part of the plane in the scored box; the nodes in the
    box are valid. Its `plane_axes` are as near to the grid's axes as the plane allows.

    Raises InputError: a plane outside the scored part of the grid.
    """
    low, high = grid.scored_box_mm
    outline = cut_box(low, high, point_mm, normal)
    if not len(outline):
        raise InputError(
            f"illumination: expected a light sheet through the scored part of the grid, from "
            f"{np.round(low, 3).tolist()} to {np.round(high, 3).tolist()} mm, got one beside it"
        )
    axes = frame_of_normal(normal)
    flat = outline @ axes.T
    edge_mm = lengths_along(axes, grid.voxel_mm)
    start, end = flat.min(axis=0), flat.max(axis=0)
    voxels = ((end - start) / edge_mm)[:2]
    steps, counts = _spread(voxels, math.sqrt(float(voxels.prod()) / _MOST))
    step_mm = [*(steps * edge_mm[:2]), edge_mm[2]]
    first = (start + end) / 2.0 - [*((counts - 1) / 2.0 * step_mm[:2]), 0.0]
    shape = (1, *counts[::-1].tolist())
    field = Velocity(
        triple(first @ axes), triple(step_mm), np.zeros((*shape, 3)), np.ones(shape, bool), axes[:2]
    )
    inside = ((field.positions_mm >= low) & (field.positions_mm <= high)).all(axis=-1)
    return replace(field, valid=np.asarray(inside))


def lengths_along(axes: F64, voxel_mm: tuple[float, float, float]) -> F64:
    """Compute lengths (n,) of a voxel along unit vectors (n, 3)."""
    return np.asarray(np.linalg.norm(axes * np.asarray(voxel_mm), axis=1))


def sample_velocity(field: Velocity, points_mm: F64) -> tuple[F64, Bool]:
    """Interpolate velocities at points (n, 3), and mark the measured ones.

    Each node stands for the cell around it, half a step in every direction, as a voxel does. A
    point is measured where the node of its cell is. Its velocity is interpolated linearly along
    every axis between the measured ones of the eight nodes around it, and constant beyond the
    outermost nodes. A lattice of a single node measures nothing.
    """
    counts = np.asarray(field.valid.shape[::-1])
    places = (points_mm - np.asarray(field.low_mm)) @ field.axes.T / np.asarray(field.step_mm)
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


_PRECISION = 90.0  # percent; thesis, table 2.2
_AXES = ("u", "v", "w")


def velocity_scores(
    estimate: F64,
    truth: F64,
    valid: Bool,
    fluid: Bool,
    step_mm: tuple[float, float, float],
    interval_s: float,
    voxel_mm: tuple[float, float, float],
) -> dict[str, float]:
    """Score a velocity field on a lattice; NaN where nothing was measured.

    Derivatives are compared at nodes with measured neighbours along all axes. In a
    lattice of one plane these are four, and the vorticity is the one about the plane's normal.

    Parameters
    ----------
    estimate, truth : (z, y, x, 3) velocities, mm/s.
    valid : (z, y, x) where the estimate was measured.
    fluid : (z, y, x) where there is fluid; what was measured in bodies does not count.
    step_mm : spacing of the nodes, as (x, y, z).
    interval_s : time between the two frames, which turns velocities into displacements.
    voxel_mm : spacing of the voxels, the unit of displacements, as (x, y, z).
    """
    valid = valid & fluid
    errors = ((estimate - truth) * interval_s / np.asarray(voxel_mm))[valid]
    if not len(errors):
        errors = np.full((1, 3), np.nan)
    bias = errors.mean(axis=0)
    figures = {
        "p90": precision_interval(errors),
        "bias": bias,
        "rms": np.sqrt((errors**2).mean(axis=0)),
    }
    scores = {
        f"{axis}_{name}_voxel": float(value)
        for name, values in figures.items()
        for axis, value in zip(_AXES, values, strict=True)
    }
    scores["bias_voxel"] = float(np.linalg.norm(bias))
    scores["rms_voxel"] = float(np.sqrt((errors**2).sum(axis=1).mean()))
    scores["yield_percent"] = 100.0 * float(valid.sum() / max(fluid.sum(), 1))
    scores["response"] = response(estimate[valid], truth[valid])
    return scores | _derivative_figures(estimate, truth, valid, step_mm)


def _derivative_figures(
    estimate: F64, truth: F64, valid: Bool, step_mm: tuple[float, float, float]
) -> dict[str, float]:
    """Compute rms errors of divergence, and of vorticity in percent."""
    inside = valid & inner(valid.shape)  # with neighbours that were measured
    for axis in np.flatnonzero(np.asarray(valid.shape) > 1):
        for shift in (1, -1):
            inside &= np.roll(valid, shift, axis=axis)
    slopes, true = (gradient(field, step_mm)[inside] for field in (estimate, truth))
    several = np.asarray(valid.shape[::-1]) > 1
    about = [axis for axis in range(3) if np.delete(several, axis).all()]
    spin, true_spin = vorticity(slopes)[..., about], vorticity(true)[..., about]
    off, typical = root_mean_square(spin - true_spin), max(root_mean_square(true_spin), 1e-300)
    return {
        "divergence_1_s": root_mean_square(divergence(slopes) - divergence(true)),
        "vorticity_percent": 100.0 * off / typical,
    }


def precision_interval(errors: F64) -> F64:
    """Compute half widths (3,) of intervals with 90 % of errors (thesis, 2.3.3)."""
    return np.asarray(np.percentile(np.abs(errors), _PRECISION, axis=0))


def response(estimate: F64, truth: F64) -> float:
    """Compute the fraction of the true variation that an estimate shows.

    For a wave it is the ratio of the amplitudes. It is the slope of the estimated over the true
    velocities (n, 3), each less its mean.
    """
    if not len(truth):
        return float("nan")
    estimated, true = (values - values.mean(axis=0) for values in (estimate, truth))
    power = float(np.sum(true**2))
    return float(np.sum(estimated * true)) / power if power > 0.0 else float("nan")
