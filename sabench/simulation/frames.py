"""Frames of a scene: objects from the generators, under the laser."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sabench.api import Material
from sabench.api.truth import NOTHING, Bubbles, Particles, Sight, Solid, Target
from sabench.geometry.camera import Camera
from sabench.geometry.rigid_motion import Pose
from sabench.scenes import BubbleWorld, Rig, Scene, TargetWorld
from sabench.scenes.exposures import recorded_part
from sabench.simulation.rendering.lamps import enter_fluid
from sabench.simulation.rendering.mesh_intersection import BodySearch
from sabench.simulation.rendering.particle_light import Scatterers, scatterers_of
from sabench.simulation.rendering.pixel_truth import depth_of, meets
from sabench.utils.arrays import F64, Bool
from sabench.utils.errors import InputError
from sabench.utils.rng import stream
from sabench.worlds import calibration_targets
from sabench.worlds.bubbles_and_bodies import Phases
from sabench.worlds.tracers import Motion, moments, pulse


@dataclass(frozen=True)
class Tracers:
    """Tracers of one frame and how they scatter.

    Attributes
    ----------
    particles : at the middle of the pulse.
    positions_mm : their positions (n, 3) in the middle of equal parts of the pulse; one array for a
        short pulse.
    scatterers : how they scatter; None for isotropic scattering.
    illuminated : (n,) whether the laser reaches each; None where nothing throws shadows.
    share : of the pulse that is recorded.
    exposed : gives the particles and positions of the part of the pulse that a camera records, by
        its number in the rig, and its share; None where all cameras record the whole pulse.
    """

    particles: Particles
    positions_mm: tuple[F64, ...]
    scatterers: Scatterers | None
    illuminated: Bool | None = None
    share: float = 1.0
    exposed: Callable[[int], tuple[Particles, tuple[F64, ...], float]] | None = None

    def of_camera(self, number: int) -> Tracers:
        """Give the tracers as one camera records them, by its number in the rig."""
        if self.exposed is None:
            return self
        particles, positions, share = self.exposed(number)
        return replace(self, particles=particles, positions_mm=positions, share=share, exposed=None)


@dataclass(frozen=True)
class FrameContent:
    """Objects of one frame, with the optics, the seed and the renderer.

    Attributes
    ----------
    scene : with the laser as it is in this frame.
    rig : the true optics.
    seed, number : of the data set, and of the frame.
    renderer : mitsuba or splat.
    bubbles : None in a scene without bubbles and bodies.
    bodies : closed surfaces and what they are made of.
    target, pose : the calibration target, and its position and rotation.
    """

    scene: Scene
    rig: Rig
    seed: int
    number: int
    renderer: str
    bubbles: Bubbles | None = None
    bodies: tuple[tuple[Solid, Material], ...] = ()
    tracers: Tracers | None = None
    target: Target | None = None
    pose: Pose | None = None

    @property
    def solids(self) -> list[Solid]:
        """Surfaces of the bodies."""
        return [solid for solid, _ in self.bodies]

    def sensor_noise(self, camera: int) -> np.random.Generator:
        """Random numbers of one camera's sensor, by its number in the rig."""
        return stream(self.seed, "sensor", self.number, camera)


def _inside(bubbles: Bubbles, solids: Sequence[Solid], points_mm: F64) -> Bool:
    """Find which points (n, 3) lie in a bubble or a body."""
    if not solids:
        return _in_bubbles(bubbles, points_mm)
    return _in_bubbles(bubbles, points_mm) | BodySearch(solids).contains(points_mm)


def find_hidden(camera: Camera, points_mm: F64, pixels: F64, sight: Sight) -> Bool:
    """Find which points (n, 3) lie behind what their pixels (n, 2) show first."""
    with np.errstate(invalid="ignore"):
        on_sensor = camera.contains(pixels)
    rounded = np.where(on_sensor[:, None], np.rint(np.nan_to_num(pixels)), 0).astype(np.int64)
    column = np.clip(rounded[:, 0], 0, camera.columns - 1)
    row = np.clip(rounded[:, 1], 0, camera.rows - 1)
    behind = sight.depth_mm[row, column] < depth_of(camera, points_mm)
    return np.asarray(on_sensor & (sight.number[row, column] != NOTHING) & behind)


def _in_bubbles(bubbles: Bubbles, points_mm: F64) -> Bool:
    from scipy.spatial import cKDTree

    found = np.zeros(len(points_mm), dtype=np.bool_)
    if not len(bubbles) or not len(points_mm):
        return found
    near = cKDTree(points_mm).query_ball_point(bubbles.center_mm, bubbles.semi_axes_mm.max(axis=1))
    for number, neighbours in enumerate(near):
        which = np.asarray(neighbours, dtype=np.int64)
        offset = points_mm[which] - bubbles.center_mm[number]
        in_ball = offset @ bubbles.to_ball[number].T
        found[which[np.linalg.norm(in_ball, axis=1) < 1.0]] = True
    return found


_STREAK_PX = 0.5  # of a streak, for each position that stands for it


class Frames:
    """All frames of a scene and seed.

    Parameters
    ----------
    rig : the true optics.
    renderer : mitsuba or splat.

    Raises InputError for tracers among bubbles or bodies under a pulse of finite duration; a scene
    of samples that vary, which `streaming` draws.
    """

    def __init__(self, scene: Scene, rig: Rig, seed: int, renderer: str = "mitsuba") -> None:
        if scene.vary is not None:
            raise InputError(
                f"{scene.title}: vary: expected a scene whose values are fixed; --samples and "
                "sabench.stream draw samples of one whose values vary"
            )
        self.scene, self.rig, self.seed, self.renderer = light_in_fluid(scene), rig, seed, renderer
        world, timing = scene.world, scene.timing
        among = isinstance(world, BubbleWorld) and world.tracers is not None
        if among and timing is not None and timing.duration_s:
            raise InputError(
                f"{scene.title}: timing.duration_s: expected 0 for tracers among bubbles or "
                f"solids, got {timing.duration_s:g}"
            )
        self._phases = Phases(scene, seed) if isinstance(world, BubbleWorld) else None
        self.motion = Motion(scene, seed) if world.tracers else None
        is_target = isinstance(world, TargetWorld)
        self.placed = calibration_targets.pose_target(scene, seed) if is_target else None

    @property
    def chained(self) -> bool:
        """True if a frame can only be made after the one before it."""
        return self.motion is not None and self.motion.chained

    def at(self, number: int) -> FrameContent:
        """Make a frame; tracers inside bubbles and bodies are left out.

        Raises as `Phases`.
        """
        bubbles = self._phases.bubbles(number) if self._phases else None
        particles = self.motion.at(number) if self.motion else None
        if self._phases is None or bubbles is None or particles is None:
            return self.assemble(number, bubbles, particles)
        solids = [solid for solid, _ in self._phases.bodies(number)]
        which = ~_inside(bubbles, solids, particles.position_mm)
        particles = Particles(
            particles.id[which],
            particles.position_mm[which],
            particles.diameter_mm[which],
            particles.velocity_mm_s[which],
        )
        direction = np.asarray(self.scene.particle_world.illumination.direction)
        back = np.tile(-direction / np.linalg.norm(direction), (len(particles), 1))
        dark = meets(bubbles, particles.position_mm, back)
        if solids:
            dark |= BodySearch(solids).first(particles.position_mm, back)[1] >= 0
        return self.assemble(number, bubbles, particles, ~dark)

    def assemble(
        self,
        number: int,
        bubbles: Bubbles | None = None,
        particles: Particles | None = None,
        illuminated: Bool | None = None,
    ) -> FrameContent:
        """Put a frame together from its bubbles and tracers, as `at` has made them."""
        scene, tracers = self.scene, None
        if particles is not None:
            scene = scene.model_copy(update={"illumination": pulse(scene, self.seed, number)})
            duration = scene.timing.duration_s if scene.timing else 0.0
            pulse_s = -duration / 2.0, duration / 2.0
            positions = self._along(particles, number, pulse_s, self.rig.cameras)
            skewed = scene.timing is not None and scene.timing.skew_s is not None
            exposed = functools.partial(self._expose, particles, number) if skewed else None
            tracers = Tracers(particles, positions, self._scatterers, illuminated, exposed=exposed)
        bodies = tuple(self._phases.bodies(number)) if self._phases else ()
        content = FrameContent(
            scene, self.rig, self.seed, number, self.renderer, bubbles, bodies, tracers
        )
        if self.placed is None:
            return content
        return replace(content, target=self.placed.target, pose=self.placed.poses[number])

    @functools.cached_property
    def _scatterers(self) -> Scatterers | None:
        return scatterers_of(self.scene, self.rig.cameras, self.seed)

    def _along(
        self,
        particles: Particles,
        number: int,
        part_s: tuple[float, float],
        cameras: Sequence[Camera],
    ) -> tuple[F64, ...]:
        duration, middle = part_s[1] - part_s[0], (part_s[0] + part_s[1]) / 2.0
        if duration == 0.0 or not len(particles):
            return (self._move(particles, number, middle),)
        early, late = (self._move(particles, number, delay) for delay in part_s)
        streaks_px = [
            np.linalg.norm(camera.project(late)[0] - camera.project(early)[0], axis=1)
            for camera in cameras
        ]
        longest = max(float(np.nanmax(streak)) for streak in streaks_px)
        steps = max(1, int(np.ceil(longest / _STREAK_PX)))
        return tuple(
            self._move(particles, number, middle + delay) for delay in moments(duration, steps)
        )

    def _expose(
        self, particles: Particles, number: int, camera: int
    ) -> tuple[Particles, tuple[F64, ...], float]:
        """Compute what `Tracers.exposed` gives; particles are at the middle of the part."""
        timing = self.scene.timing
        part = recorded_part(timing, self.scene.sensor, number, camera) if timing else None
        if timing is None or part is None:
            return particles, (particles.position_mm,), 0.0
        positions = self._along(particles, number, part, [self.rig.cameras[camera]])
        middle = self._move(particles, number, (part[0] + part[1]) / 2.0)
        share = (part[1] - part[0]) / timing.duration_s if timing.duration_s else 1.0
        return replace(particles, position_mm=middle), positions, share

    def _move(self, particles: Particles, number: int, delay_s: float) -> F64:
        if self.motion is None or delay_s == 0.0:
            return particles.position_mm
        return self.motion.move(particles, number, delay_s)


def light_in_fluid(scene: Scene) -> Scene:
    """Return a scene with its laser light as it leaves the window.

    Raises as `enter_fluid`.
    """
    if scene.world.tracers is None or scene.light.entry is None:
        return scene
    light = enter_fluid(scene.light, np.asarray(scene.volume.center_mm), scene.fluid_index)
    return scene.model_copy(update={"illumination": light})
