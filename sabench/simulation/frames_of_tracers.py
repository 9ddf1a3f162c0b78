"""One frame of tracers: its world, and what each camera records of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sabench.api.truth import Particles
from sabench.geometry.camera import Camera
from sabench.scenes import Rig, Scene
from sabench.simulation.rendering.mie import MieTable
from sabench.simulation.rendering.particle_images import (
    ParticleImages,
    image_particles,
    scattering_table,
)
from sabench.simulation.rendering.particles_splatted import splat
from sabench.simulation.rendering.sensor import expose
from sabench.utils.arrays import F64, U16
from sabench.utils.rng import stream
from sabench.worlds.tracers import Motion, moments, pulse

_STREAK_PX = 0.5  # of a streak for each place that stands for it


@dataclass(frozen=True)
class World:
    """One frame's world, and what records it.

    Attributes
    ----------
    scene : with the laser as it is in this frame.
    streaks : places of the particles in equal parts of the pulse; one, in its middle, for a short
        pulse.
    """

    scene: Scene
    rig: Rig
    seed: int
    frame: int
    renderer: str
    particles: Particles
    table: MieTable | None
    streaks: tuple[F64, ...]


def make_world(motion: Motion, rig: Rig, frame: int, renderer: str, particles: Particles) -> World:
    """What records a frame's particles."""
    scene = motion.scene.model_copy(
        update={"illumination": pulse(motion.scene, motion.seed, frame)}
    )
    table = scattering_table(scene, rig.cameras, particles)
    return World(
        scene,
        rig,
        motion.seed,
        frame,
        renderer,
        particles,
        table,
        _streaks(motion, rig, particles, frame),
    )


def _streaks(motion: Motion, rig: Rig, particles: Particles, frame: int) -> tuple[F64, ...]:
    """As many places along each path as its longest image has halves of a pixel."""
    duration = motion.scene.timing.duration_s if motion.scene.timing else 0.0
    if duration == 0.0 or not len(particles):
        return (particles.position_mm,)
    ends = [motion.moved(particles, frame, delay) for delay in (-duration / 2.0, duration / 2.0)]
    seen = [[camera.project(end)[0] for end in ends] for camera in rig.cameras]
    longest = max(float(np.nanmax(np.linalg.norm(late - early, axis=1))) for early, late in seen)
    steps = max(1, int(np.ceil(longest / _STREAK_PX)))
    return tuple(motion.moved(particles, frame, delay) for delay in moments(duration, steps))


def shoot(world: World, camera: Camera) -> tuple[ParticleImages, U16, F64, F64 | None]:
    """Render one camera's picture and expose its sensor: the particles' images, grey values, photons, and the radiance if the renderer gives it."""
    images = image_particles(world.scene, camera, world.particles, world.table, world.rig.occluders)
    photons, radiance = _exposed(world, camera, images)
    number = int(camera.name.rsplit("_", 1)[1])
    grey = expose(world.scene.sensor, photons, stream(world.seed, "sensor", world.frame, number))
    return images, grey, photons, radiance


def _exposed(world: World, camera: Camera, images: ParticleImages) -> tuple[F64, F64 | None]:
    """Photons on the sensor, and the radiance if the renderer gives it: the mean over the parts of the pulse."""
    parts = len(world.streaks)
    photons, radiance = (
        np.zeros((camera.rows, camera.columns)),
        None if world.renderer == "splat" else np.zeros((camera.rows, camera.columns)),
    )
    for places in world.streaks:
        there = replace(world.particles, position_mm=places)
        own = (
            images
            if parts == 1
            else image_particles(world.scene, camera, there, world.table, world.rig.occluders)
        )
        if radiance is None:
            photons += splat(camera, own) / parts
        else:
            radiance += _render(world, camera, own, places) / parts
    return (photons, None) if radiance is None else (radiance * camera.etendue(), radiance)


def _render(world: World, camera: Camera, images: ParticleImages, places: F64) -> F64:
    from sabench.simulation.rendering.particles_traced import render

    picture: F64 = render(
        camera, images, places, world.scene.render.samples_per_pixel, world.rig.occluders
    )
    return picture
