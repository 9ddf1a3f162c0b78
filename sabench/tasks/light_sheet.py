"""Light sheets of data sets, in which velocities are scored."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sabench.dataset.reader import Dataset
from sabench.geometry.grid import Grid
from sabench.simulation.rendering.laser_sheet import enter_fluid
from sabench.utils.arrays import F64

_POINTS = 5  # of the quadrature across a sheet
_THIN = 0.5  # of the grid's extent across it: light that is thinner is a sheet


@dataclass(frozen=True)
class LightSheet:
    """Plane of a thin laser sheet, and the weights of its light across it.

    Attributes
    ----------
    point_mm, normal : (3,) a point in its middle, and its unit normal.
    offsets_mm, weights : (k,) distances from the plane and shares of the light there.
    """

    point_mm: F64
    normal: F64
    offsets_mm: F64
    weights: F64

    def average(self, velocity: Callable[[F64], F64], points_mm: F64) -> F64:
        """Average a velocity at points (n, 3) of the plane over the light across it."""
        layers = (velocity(points_mm + offset * self.normal) for offset in self.offsets_mm)
        return np.asarray(sum(w * one for w, one in zip(self.weights, layers, strict=True)))


def light_sheet(data: Dataset) -> LightSheet | None:
    """Find the light sheet of a data set with particles; None where a volume is lit.

    Light is a sheet where its thickness is at most half of the grid's extent along its normal, or
    where the grid has a single plane of voxels across it.
    """
    scene, grid = data.scene, data.setup.grid
    center = np.asarray(scene.volume.center_mm)
    light = enter_fluid(scene.light, center, scene.fluid_index)
    normal = np.asarray(light.sheet_normal) / np.linalg.norm(light.sheet_normal)
    if light.thickness_mm > _thickest(grid, normal):
        return None
    shifts = scene.timing.shift_mm if scene.timing and scene.timing.shift_mm else (0.0,)
    offset = (light.shift_mm or 0.0) + float(np.mean(shifts))
    offsets, weights = _across(light.profile, light.thickness_mm)
    return LightSheet(center + offset * normal, normal, offsets, weights)


def _thickest(grid: Grid, normal: F64) -> float:
    voxel, across = np.asarray(grid.voxel_mm), np.abs(normal)
    single = np.asarray(grid.shape[::-1]) == 1
    share = np.where(single, 1.0, _THIN)
    return float(across @ (share * voxel * grid.shape[::-1]))


def _across(profile: str, thickness_mm: float) -> tuple[F64, F64]:
    """Place points (k,) across a sheet, with weights (k,) by Gaussian quadrature."""
    if profile == "top-hat":
        points, weights = np.polynomial.legendre.leggauss(_POINTS)
        return points * thickness_mm / 2.0, weights / 2.0
    points, weights = np.polynomial.hermite_e.hermegauss(_POINTS)
    return points * thickness_mm / 4.0, weights / weights.sum()
