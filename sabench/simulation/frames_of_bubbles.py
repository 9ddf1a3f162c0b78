"""One frame of bubbles, drops and bodies, with or without tracers: its world, and what each camera records of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sabench.api import Material
from sabench.api.truth import NOTHING, Bubbles, Particles, Sight, Solid
from sabench.geometry.camera import Camera
from sabench.geometry.refraction import Layer
from sabench.scenes import Rig, Scene
from sabench.simulation.rendering.bubbles_traced import Lights, Tank, photograph
from sabench.simulation.rendering.mesh_intersection import BodySearch
from sabench.simulation.rendering.mie import MieTable
from sabench.simulation.rendering.particle_images import (
    ParticleImages,
    image_particles,
    scattering_table,
)
from sabench.simulation.rendering.pixel_truth import depth_of, meets, see
from sabench.simulation.rendering.sensor import expose
from sabench.utils.arrays import F64, U16, Bool
from sabench.utils.errors import InputError
from sabench.utils.rng import stream
from sabench.worlds.bubbles_and_bodies import Phases
from sabench.worlds.tracers import Motion, pulse

_ERROR = 0.01  # of images, unless the scene says otherwise
_GLOW_ERROR = 1.0  # of tracers among bubbles: the fewest rays there are, as their images are smooth


@dataclass(frozen=True)
class PhaseWorld:
    """Everything in the fluid at one frame.

    Attributes
    ----------
    scene : with the laser as it is in this frame.
    particles, lit, table : tracers, which of them (n,) no bubble or body keeps the laser from, and
        how they scatter; None without any.
    """

    scene: Scene
    rig: Rig
    seed: int
    frame: int
    bubbles: Bubbles
    bodies: list[tuple[Solid, Material]]
    particles: Particles | None = None
    lit: Bool | None = None
    table: MieTable | None = None

    @property
    def solids(self) -> list[Solid]:
        """The bodies' surfaces."""
        return [solid for solid, _ in self.bodies]


@dataclass(frozen=True)
class PhaseView:
    """What one camera records: grey values, mean photons, what each pixel truly sees, the picture's relative standard error, tracers' images."""

    grey: U16
    photons: F64
    sight: Sight
    error: float
    images: ParticleImages | None


class Worlds:
    """All frames' worlds of a scene and seed."""

    def __init__(self, scene: Scene, rig: Rig, seed: int) -> None:
        if scene.particles and scene.timing and scene.timing.duration_s:
            raise InputError(
                f"{scene.title}: timing.duration_s: expected 0 for tracers among bubbles or solids, got {scene.timing.duration_s:g}"
            )
        self.scene, self.rig, self.seed = scene, rig, seed
        self._phases = Phases(scene, seed)
        self.motion = Motion(scene, seed) if scene.particles else None

    def at(self, frame: int) -> PhaseWorld:
        """A frame's world; tracers are in the fluid only. Raises as `Phases`."""
        bubbles = self._phases.bubbles(frame)
        world = self.recalled(frame, bubbles)
        if self.motion is None:
            return world
        every = self.motion.at(frame)
        wet = ~_in_bubbles(bubbles, every.position_mm) & ~_in_bodies(
            world.bodies, every.position_mm
        )
        particles = Particles(
            every.id[wet], every.position_mm[wet], every.diameter_mm[wet], every.velocity_mm_s[wet]
        )
        way = np.asarray(self.scene.light.direction) / np.linalg.norm(self.scene.light.direction)
        lit = ~_stopped(world, particles.position_mm, np.tile(-way, (len(particles), 1)))
        return self.recalled(frame, bubbles, particles, lit)

    def recalled(
        self,
        frame: int,
        bubbles: Bubbles,
        particles: Particles | None = None,
        lit: Bool | None = None,
    ) -> PhaseWorld:
        """A frame's world of bubbles, and of tracers of which some are lit, that `at` has found."""
        bodies = self._phases.bodies(frame)
        if particles is None:
            return PhaseWorld(self.scene, self.rig, self.seed, frame, bubbles, bodies)
        scene = self.scene.model_copy(update={"illumination": pulse(self.scene, self.seed, frame)})
        table = scattering_table(scene, self.rig.cameras, particles)
        return PhaseWorld(scene, self.rig, self.seed, frame, bubbles, bodies, particles, lit, table)


def record(world: PhaseWorld, camera: Camera) -> PhaseView:
    """Render and expose one camera's picture, and say what it truly shows."""
    scene, number = world.scene, int(camera.name.rsplit("_", 1)[1])
    tank = tank_of(scene, world.rig)
    full = scene.sensor.full_well_e / scene.sensor.quantum_efficiency
    center = np.asarray(scene.volume.center_mm)
    error = scene.render.relative_error or _ERROR
    seed = int(stream(world.seed, "light paths", world.frame, number).integers(1 << 20))
    shown = photograph(
        camera,
        tank,
        world.bubbles,
        world.bodies,
        Lights(scene.backlight, scene.lighting, center, full),
        error,
        seed,
        occluders=world.rig.occluders,
        exposure_s=scene.sensor.exposure_s,
    )
    sight = see(camera, world.bubbles, world.solids)
    photons, images = shown.photons, None
    if world.particles is not None:
        images = _lit_particles(world, camera, sight)
        glow = photograph(
            camera,
            tank,
            world.bubbles,
            world.bodies,
            Lights(None, None, center, full),
            _GLOW_ERROR,
            seed + (1 << 20),
            occluders=world.rig.occluders,
            images=images,
            particles_mm=world.particles.position_mm,
        )
        photons = photons + glow.photons
    grey = expose(scene.sensor, photons.copy(), stream(world.seed, "sensor", world.frame, number))
    return PhaseView(grey, photons, sight, shown.error, images)


def tank_of(scene: Scene, rig: Rig) -> Tank:
    """The walls of a scene."""
    layers = (scene.wall.rear or ()) if scene.wall else ()
    return Tank(
        rig.wall, tuple(Layer(layer.name, layer.index, layer.thickness_mm) for layer in layers)
    )


def _lit_particles(world: PhaseWorld, camera: Camera, sight: Sight) -> ParticleImages:
    """Tracers' images: dark in the shadows that bubbles and bodies throw, not visible behind them."""
    assert world.particles is not None
    assert world.lit is not None
    images = image_particles(world.scene, camera, world.particles, world.table, world.rig.occluders)
    hidden = _hidden(camera, world.particles.position_mm, images.pixel, sight)
    return replace(
        images,
        photons=images.photons * world.lit,
        intensity=images.intensity * world.lit,
        visible=images.visible & ~hidden,
    )


def _hidden(camera: Camera, points_mm: F64, pixels: F64, sight: Sight) -> Bool:
    """Which points lie behind what their pixel sees first."""
    with np.errstate(invalid="ignore"):
        inside = camera.contains(pixels)
    column, row = (
        np.where(inside, np.rint(np.nan_to_num(pixels[:, axis])), 0).astype(np.int64)
        for axis in (0, 1)
    )
    column, row = np.clip(column, 0, camera.columns - 1), np.clip(row, 0, camera.rows - 1)
    first = sight.depth_mm[row, column]
    return np.asarray(
        inside & (sight.number[row, column] != NOTHING) & (first < depth_of(camera, points_mm))
    )


def _stopped(world: PhaseWorld, points_mm: F64, ways: F64) -> Bool:
    """Which lines (n,) from points (n, 3) meet a bubble or a body."""
    stopped = meets(world.bubbles, points_mm, ways)
    if world.bodies:
        stopped |= BodySearch(world.solids).first(points_mm, ways)[1] >= 0
    return stopped


def _in_bubbles(bubbles: Bubbles, points_mm: F64) -> Bool:
    from scipy.spatial import cKDTree

    inside = np.zeros(len(points_mm), dtype=np.bool_)
    if not len(bubbles) or not len(points_mm):
        return inside
    near = cKDTree(points_mm).query_ball_point(bubbles.center_mm, bubbles.semi_axes_mm.max(axis=1))
    for number, which in enumerate(near):
        offset = points_mm[which] - bubbles.center_mm[number]
        inside[
            np.asarray(which, dtype=np.int64)[
                np.linalg.norm(offset @ bubbles.to_ball[number].T, axis=1) < 1.0
            ]
        ] = True
    return inside


def _in_bodies(bodies: list[tuple[Solid, Material]], points_mm: F64) -> Bool:
    if not bodies:
        return np.zeros(len(points_mm), dtype=np.bool_)
    return BodySearch([solid for solid, _ in bodies]).enclosed(points_mm)
