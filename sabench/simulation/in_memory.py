"""Simulation of frames in memory."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sabench.api import Observation
from sabench.api.truth import Particles, ParticleView
from sabench.dataset.reader import build_observation
from sabench.images.preprocessing import takes_all_frames
from sabench.plotting.card import Card
from sabench.scenes import Scene, build_rig, load_scene
from sabench.scenes.focusing import nominal_cameras
from sabench.simulation.camera_view import record_image, render_camera_view
from sabench.simulation.frames import FrameContent, Frames
from sabench.utils.arrays import U16
from sabench.utils.backend import Renderer, choose_renderer
from sabench.utils.errors import InputError
from sabench.worlds.tracers import Motion


@dataclass(frozen=True, repr=False)
class Shot(Card):
    """One frame in memory: an observation and the truth that scores it."""

    observation: Observation
    particles: Particles
    views: list[ParticleView]

    def _rows(self) -> Iterator[tuple[str, ...]]:
        _, *rows = self.observation._rows()
        yield from [("Shot",), *rows, ("truth", f"{len(self.particles)} particles")]

    def _picture(self) -> bytes:
        return self.observation._picture()


def simulate(
    scene: Scene | str | Path, *, seed: int = 0, frame: int = 0, backend: Renderer = "splat"
) -> Shot:
    """Simulate one frame of the data set that `generate` makes.

    Arguments and errors are those of `generate`.
    """
    return _simulate_frame(_frames(scene, seed, backend), frame)


def simulate_sequence(
    scene: Scene | str | Path, *, seed: int = 0, backend: Renderer = "splat"
) -> Iterator[Shot]:
    """Simulate all frames of the data set that `generate` makes.

    They come one after the other. Arguments and errors are those of `generate`.
    """
    frames = _frames(scene, seed, backend)
    for frame in range(frames.scene.frames):
        yield _simulate_frame(frames, frame)


def _frames(scene: Scene | str | Path, seed: int, backend: Renderer) -> Frames:
    loaded = scene if isinstance(scene, Scene) else load_scene(scene)
    if loaded.world.tracers is None:
        raise InputError(f"{loaded.title}: expected a scene with particles")
    return Frames(loaded, build_rig(loaded, loaded.title), seed, choose_renderer(backend))


def _simulate_frame(frames: Frames, frame: int) -> Shot:
    if frame not in range((scene := frames.scene).frames):
        raise InputError(f"frame: expected 0 to {scene.frames - 1}, got {frame!r}")
    content = frames.at(frame)
    assert content.tracers is not None
    images, views = record_frame(content)
    lowest = None
    if scene.preprocessing and takes_all_frames(scene.preprocessing):
        every = [record_frame(frames.at(number))[0] for number in range(scene.frames)]
        lowest = np.min(every, axis=0)
    return Shot(observation_of(content, images, lowest), content.tracers.particles, views)


def record_frame(frame: FrameContent) -> tuple[list[U16], list[ParticleView]]:
    """Record the images of a frame and the true particle images, camera by camera."""
    rendered = [render_camera_view(frame, camera) for camera in range(len(frame.rig.cameras))]
    images = [record_image(frame, view, camera) for camera, view in enumerate(rendered)]
    return images, [view.particles for view in rendered if view.particles is not None]


def observation_of(
    frame: FrameContent, images: list[U16], lowest: U16 | None = None
) -> Observation:
    """Build the observation of a frame's images, one for each camera.

    `lowest` are each pixel's least values over all frames, where a step needs them.
    """
    scene, rig = frame.scene, frame.rig
    return build_observation(
        np.stack(images),
        nominal_cameras(scene, rig.cameras, frame.seed),
        rig.grid,
        (scene.sensor.black_level_dn, scene.sensor.white_dn),
        scene.preprocessing or (),
        lowest=lowest,
        by_camera=scene.sensor.levels_by_camera(len(rig.cameras)),
    )


def make_particles(scene: Scene, seed: int, frame: int) -> Particles:
    """Make the particles of one frame."""
    return Motion(scene, seed).at(frame)
