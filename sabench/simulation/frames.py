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
from sabench.simulation.rendering.particle_light import Scatterers, scatterers_of
from sabench.simulation.rendering.pixel_truth import BodySearch, depth_of, meets
from sabench.utils.arrays import F64, Bool
from sabench.utils.errors import InputError
from sabench.utils.rng import stream
from sabench.worlds import calibration_targets
from sabench.worlds.bubbles_and_bodies import Phases
from sabench.worlds.tracers import Motion, pulse


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


def find_hidden(camera: Camera, points_mm: F64, pixels: F64, sight: Sight) -> Bool:
    """Find which points (n, 3) lie behind what their pixels (n, 2) show first."""
    with np.errstate(invalid="ignore"):
        on_sensor = camera.contains(pixels)
    rounded = np.where(on_sensor[:, None], np.rint(np.nan_to_num(pixels)), 0).astype(np.int64)
    column = np.clip(rounded[:, 0], 0, camera.columns - 1)
    row = np.clip(rounded[:, 1], 0, camera.rows - 1)
    behind = sight.depth_mm[row, column] < depth_of(camera, points_mm)
    return np.asarray(on_sensor & (sight.number[row, column] != NOTHING) & behind)


def _inside(bubbles: Bubbles, solids: Sequence[Solid], points_mm: F64) -> Bool:
    """Find which points (n, 3) lie in a bubble or a body."""
    from scipy.spatial import cKDTree

    found = np.zeros(len(points_mm), dtype=np.bool_)
    if len(bubbles) and len(points_mm):
        widest = bubbles.semi_axes_mm.max(axis=1)
        near = cKDTree(points_mm).query_ball_point(bubbles.center_mm, widest)
        for number, neighbours in enumerate(near):
            which = np.asarray(neighbours, dtype=np.int64)
            offset = points_mm[which] - bubbles.center_mm[number]
            in_ball = offset @ bubbles.to_ball[number].T
            found[which[np.linalg.norm(in_ball, axis=1) < 1.0]] = True
    return found | BodySearch(solids).contains(points_mm) if solids else found


_STREAK_PX = 0.5  # of a streak, for each position that stands for it


class Frames:
    """All frames of a scene and seed.

    Parameters
    ----------
    rig : the true optics.
    renderer : mitsuba or splat.

    Raises InputError for tracers among bubbles or bodies under a pulse of finite duration; a scene
    of samples that vary, which `sabench.stream` draws.
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
        """Make a frame, without tracers in bubbles and bodies; raises as `Phases`."""
        bubbles = self._phases.bubbles(number) if self._phases else None
        particles = self.motion.at(number) if self.motion else None
        if self._phases is None or bubbles is None or particles is None:
            return self.assemble(number, bubbles, particles)
        solids = [solid for solid, _ in self._phases.bodies(number)]
        particles = particles.rows(~_inside(bubbles, solids, particles.position_mm))
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
        scene, motion, tracers = self.scene, self.motion, None
        if particles is not None and motion is not None:
            scene = scene.model_copy(update={"illumination": pulse(scene, self.seed, number)})
            duration = scene.timing.duration_s if scene.timing else 0.0
            move = functools.partial(motion.move, particles, number)
            positions = _streak(move, (-duration / 2.0, duration / 2.0), self.rig.cameras)
            skewed = scene.timing is not None and scene.timing.skew_s is not None
            exposed = functools.partial(self._expose, particles, number, move) if skewed else None
            scatterers = scatterers_of(self.scene, self.rig.cameras, self.seed)
            tracers = Tracers(particles, positions, scatterers, illuminated, exposed=exposed)
        bodies = tuple(self._phases.bodies(number)) if self._phases else ()
        content = FrameContent(
            scene, self.rig, self.seed, number, self.renderer, bubbles, bodies, tracers
        )
        if self.placed is None:
            return content
        return replace(content, target=self.placed.target, pose=self.placed.poses[number])

    def _expose(
        self, particles: Particles, number: int, move: Callable[[float], F64], camera: int
    ) -> tuple[Particles, tuple[F64, ...], float]:
        """Compute what `Tracers.exposed` gives; particles are at the middle of the part."""
        timing = self.scene.timing
        part = recorded_part(timing, self.scene.sensor, number, camera) if timing else None
        if timing is None or part is None:
            return particles, (particles.position_mm,), 0.0
        positions = _streak(move, part, [self.rig.cameras[camera]])
        share = (part[1] - part[0]) / timing.duration_s if timing.duration_s else 1.0
        return replace(particles, position_mm=move((part[0] + part[1]) / 2.0)), positions, share


def _streak(
    move: Callable[[float], F64], part_s: tuple[float, float], cameras: Sequence[Camera]
) -> tuple[F64, ...]:
    """Compute positions in the middles of equal parts of an exposure.

    Longer streaks need more of them. `move` gives the particles' positions some time from the
    middle of the pulse.
    """
    (start, end), middle = part_s, (part_s[0] + part_s[1]) / 2.0
    if start == end or not len(early := move(start)):
        return (move(middle),)
    late = move(end)
    streaks_px = [
        np.linalg.norm(camera.project(late)[0] - camera.project(early)[0], axis=1)
        for camera in cameras
    ]
    longest = max(float(np.nanmax(streak)) for streak in streaks_px)
    steps = max(1, int(np.ceil(longest / _STREAK_PX)))
    places = [(end - start) * ((number + 0.5) / steps - 0.5) for number in range(steps)]
    return tuple(move(middle + place) for place in places)


def light_in_fluid(scene: Scene) -> Scene:
    """Return a scene with its laser light past the window; raises as `enter_fluid`."""
    if scene.world.tracers is None or scene.light.entry is None:
        return scene
    light = enter_fluid(scene.light, np.asarray(scene.volume.center_mm), scene.fluid_index)
    return scene.model_copy(update={"illumination": light})
