"""Simulate one frame in memory."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sabench.api import Observation
from sabench.api.truth import Particles, View
from sabench.dataset.reader import observed
from sabench.scenes import Scene, build_rig
from sabench.scenes.nominal_cameras import nominal_cameras
from sabench.scenes.sensor import white_level
from sabench.simulation.frames_of_tracers import make_world, shoot
from sabench.simulation.renderer_choice import Renderer, choose_renderer
from sabench.worlds.tracers import Motion


@dataclass(frozen=True)
class Shot:
    """One frame in memory: what a solver may see, and the truth that it is scored with."""

    observation: Observation
    particles: Particles
    views: list[View]


def simulate(scene: Scene, *, seed: int = 0, frame: int = 0, backend: Renderer = "splat") -> Shot:
    """One frame of the data set that `generate` would make of the scene and seed, without writing anything.

    Raises
    ------
    InputError
        As `generate`.
    """
    rig = build_rig(scene, scene.title)
    motion = Motion(scene, seed)
    world = make_world(motion, rig, frame, choose_renderer(backend), motion.at(frame))
    pictures, views = [], []
    for camera in rig.cameras:
        images, grey, _, _ = shoot(world, camera)
        pictures.append(grey)
        views.append(
            View(images.pixel, images.photons, images.sigma_px, images.visible.astype(np.float64))
        )
    told = nominal_cameras(scene, rig.cameras, seed)
    levels = scene.sensor.black_level_dn, white_level(scene.sensor)
    observation = observed(np.stack(pictures), told, rig.grid, levels, scene.preprocessing or ())
    return Shot(observation, world.particles, views)


def make_particles(scene: Scene, seed: int, frame: int) -> Particles:
    """The particles of one frame, whatever else is generated."""
    return Motion(scene, seed).at(frame)
