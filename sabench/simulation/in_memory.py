"""Simulation of one frame in memory."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sabench.api import Observation
from sabench.api.truth import Particles, View
from sabench.dataset.reader import build_observation
from sabench.scenes import Scene, build_rig
from sabench.scenes.nominal_cameras import nominal_cameras
from sabench.simulation.camera_view import render
from sabench.simulation.frame_content import FrameContent
from sabench.simulation.frames import Frames
from sabench.simulation.renderer_choice import Renderer, choose_renderer
from sabench.simulation.rendering.sensor import expose
from sabench.utils.arrays import U16
from sabench.worlds.tracers import Motion


@dataclass(frozen=True)
class Shot:
    """One frame in memory: an observation and the truth that scores it."""

    observation: Observation
    particles: Particles
    views: list[View]


def simulate(scene: Scene, *, seed: int = 0, frame: int = 0, backend: Renderer = "splat") -> Shot:
    """Simulate one frame of the data set that `generate` would make.

    Raises
    ------
    InputError
        As `generate`.
    """
    rig = build_rig(scene, scene.title)
    content = Frames(scene, rig, seed, choose_renderer(backend)).at(frame)
    if content.tracers is None:
        raise ValueError(f"{scene.title}: expected a scene with particles")
    images, views = [], []
    for number in range(len(rig.cameras)):
        view = render(content, number)
        images.append(expose(scene.sensor, view.photons, content.sensor_noise(number)))
        if view.particles is not None:
            views.append(view.particles)
    return Shot(observation_of(content, images), content.tracers.particles, list(views))


def observation_of(frame: FrameContent, images: list[U16]) -> Observation:
    """Build the observation of a frame's images, one for each camera."""
    scene, rig = frame.scene, frame.rig
    return build_observation(
        np.stack(images),
        nominal_cameras(scene, rig.cameras, frame.seed),
        rig.grid,
        (scene.sensor.black_level_dn, scene.sensor.white_dn),
        scene.preprocessing or (),
    )


def make_particles(scene: Scene, seed: int, frame: int) -> Particles:
    """Make the particles of one frame."""
    return Motion(scene, seed).at(frame)
