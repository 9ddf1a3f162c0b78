"""Small scenes with particles, and rigs that are rotated as a whole."""

import tomllib
from dataclasses import replace
from typing import Any

import numpy as np

from sabench.api import Camera, FoundParticles, Observation
from sabench.geometry.grid import Grid
from sabench.geometry.refraction import Wall
from sabench.metrics.particle_detection import Counts, count_challenge
from sabench.scenes import find, parse_scene
from sabench.simulation.in_memory import Shot, simulate
from sabench.utils.arrays import F64, triple


def make_small(
    seed: int, per_pixel: float = 0.03, layout: tuple[int, int] = (2, 2), **changes: Any
) -> Shot:
    """A frame of 60 x 80 pixels behind glass, of columns and rows of cameras."""
    values = tomllib.loads(find("standard-particles", "scenes").read_text(encoding="utf-8"))
    values["volume"]["size_mm"] = [4.0, 3.0, 2.0]
    values["grid"]["crop_mm"] = [0.4, 0.4, 0.0]
    values["cameras"] |= {"rows": 60, "columns": 80}
    values["cameras"]["layout"] |= {"columns": layout[0], "rows": layout[1]}
    values["illumination"] |= {"scattering": "isotropic", "pulse_energy_mj": 6.5}
    values["particles"]["per_pixel"] = per_pixel
    for table, update in changes.items():
        values[table] = values.get(table, {}) | update if isinstance(update, dict) else update
    return simulate(parse_scene(values, "small"), seed=seed)


def count_found(shot: Shot, found: FoundParticles) -> Counts:
    grid = shot.observation.grid
    here, there = grid.to_voxels(found.position_mm), grid.to_voxels(shot.particles.position_mm)
    return count_challenge(here, there, grid.in_scored(here), grid.in_scored(there))


def rotate_cameras(cameras: tuple[Any, ...], rotation: F64) -> tuple[Camera, ...]:
    made = []
    for camera in cameras:
        assert isinstance(camera, Camera)
        wall = camera.wall
        if wall is not None:
            assert isinstance(wall, Wall)
            wall = replace(
                wall,
                point_mm=triple(rotation @ np.asarray(wall.point_mm)),
                normal=triple(rotation @ np.asarray(wall.normal)),
            )
        x, y, z = np.asarray(camera.rotation) @ rotation.T
        center = triple(rotation @ np.asarray(camera.center_mm))
        axes = triple(x), triple(y), triple(z)
        made.append(replace(camera, center_mm=center, rotation=axes, wall=wall))
    return tuple(made)


def rotate_rig(case: Observation, rotation: F64) -> Observation:
    """Rotate cameras, walls and grid; the grid becomes the box around the rotated one."""
    grid = case.grid
    voxel, last = np.asarray(grid.voxel_mm), np.asarray(grid.shape[::-1]) - 1
    ends = np.stack([np.asarray(grid.low_mm), np.asarray(grid.low_mm) + voxel * last])
    corners = np.stack(np.meshgrid(*ends.T), axis=-1).reshape(-1, 3) @ rotation.T
    low, high = corners.min(axis=0), corners.max(axis=0)
    edges = np.abs(rotation) @ voxel
    z, y, x = np.rint((high - low) / edges).astype(int)[::-1].tolist()
    turned = Grid(triple(low), triple(edges), (z + 1, y + 1, x + 1))
    return replace(case, cameras=rotate_cameras(case.cameras, rotation), grid=turned)
