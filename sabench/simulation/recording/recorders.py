"""What a scene's frames and cameras record, for each kind of world: particles, bubbles and bodies, or a calibration target."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from typing import Protocol

import numpy as np

from sabench.api.truth import Bubbles, Particles
from sabench.dataset import schema
from sabench.dataset.writer import DatasetWriter
from sabench.geometry.camera import Camera
from sabench.scenes import Scene, build_rig
from sabench.scenes.nominal_cameras import nominal_cameras
from sabench.simulation.frames_of_bubbles import PhaseWorld, Worlds, record
from sabench.simulation.frames_of_tracers import World, make_world, shoot
from sabench.simulation.recording.parts import KEPT, Part, Parts, Recall, Taken
from sabench.simulation.rendering.particle_images import ParticleImages
from sabench.simulation.rendering.sensor import expose
from sabench.utils.arrays import F64, Bool
from sabench.utils.rng import stream
from sabench.worlds import calibration_targets
from sabench.worlds.tracers import Motion, lattice

_PARTICLES = ("id", "position_mm", "diameter_mm", "velocity_mm_s")
_BUBBLES = ("id", "center_mm", "semi_axes_mm", "turn", "velocity_mm_s")
_STATE = f"{KEPT}state"  # all tracers of a frame, of which the truth holds those in the fluid


class Recorder(Protocol):
    """Makes the parts of one data set, each the same whatever else was made before."""

    cameras: tuple[Camera, ...]
    chained: bool

    @property
    def views(self) -> int:
        """How many cameras take pictures."""

    def frame(self, number: int, recall: Recall) -> Part:
        """A frame's truth that no camera is needed for; where frames are chained, `recall` gives the one before."""

    def view(self, number: int, camera: int, recall: Recall) -> Taken:
        """What one camera records of a frame, whose part `recall` gives."""

    def finish(self, writer: DatasetWriter, parts: Parts) -> None:
        """Store what all parts together make."""


def recorder_of(scene: Scene, seed: int, renderer: str, label: str) -> Recorder:
    """The recorder of a scene."""
    if scene.targets:
        return TargetRecorder(scene, seed, renderer, label)
    if scene.bubbles is not None or scene.solids:
        return PhaseRecorder(scene, seed, label)
    return ParticleRecorder(scene, seed, renderer, label)


class ParticleRecorder:
    """Tracers alone."""

    def __init__(self, scene: Scene, seed: int, renderer: str, label: str) -> None:
        self._rig, self._scene, self._renderer = build_rig(scene, label), scene, renderer
        self._motion = Motion(scene, seed)
        self.cameras, self.chained, self.views = (
            self._rig.cameras,
            self._motion.chained,
            len(self._rig.cameras),
        )
        self._world: World | None = None

    def frame(self, number: int, recall: Recall) -> Part:
        """Particles, and the exact flow where the scene asks for it."""
        _go_on(
            self._motion,
            number,
            lambda: _particles(recall(number - 1), schema.frame_group(number - 1)),
        )
        return _tracers(self._motion.at(number), number) | _flow(self._scene, number)

    def view(self, number: int, camera: int, recall: Recall) -> Taken:
        """A picture, and how bright each particle is in it."""
        if self._world is None or self._world.frame != number:
            particles = _particles(recall(number), schema.frame_group(number))
            self._world = make_world(self._motion, self._rig, number, self._renderer, particles)
        seen = self.cameras[camera]
        images, grey, photons, radiance = shoot(self._world, seen)
        return Taken(
            _seen(number, seen, images),
            grey,
            (_radiance(seen, photons) if radiance is None else radiance).astype(np.float32),
        )

    def finish(self, writer: DatasetWriter, parts: Parts) -> None:
        """Nothing is left."""


class PhaseRecorder:
    """Bubbles and bodies, with or without tracers."""

    def __init__(self, scene: Scene, seed: int, label: str) -> None:
        self._scene, self._worlds = scene, Worlds(scene, build_rig(scene, label), seed)
        self.cameras, self.views = self._worlds.rig.cameras, len(self._worlds.rig.cameras)
        self.chained = self._worlds.motion is not None and self._worlds.motion.chained
        self._world: PhaseWorld | None = None

    def frame(self, number: int, recall: Recall) -> Part:
        """Bubbles, bodies and tracers, and the exact flow where the scene asks for it."""
        motion = self._worlds.motion
        if motion is not None:
            _go_on(motion, number, lambda: _particles(recall(number - 1), _STATE))
        world = self._world = self._worlds.at(number)
        part = _phases(world, number)
        if motion is None or world.particles is None or world.lit is None:
            return part | _flow(self._scene, number)
        kept = (
            {f"{_STATE}/{name}": getattr(motion.at(number), name) for name in _PARTICLES}
            if self.chained
            else {}
        )
        return (
            part
            | _tracers(world.particles, number)
            | _flow(self._scene, number)
            | kept
            | {f"{KEPT}lit": world.lit}
        )

    def view(self, number: int, camera: int, recall: Recall) -> Taken:
        """A picture, and what each pixel sees."""
        if self._world is None or self._world.frame != number:
            self._world = self._recalled(number, recall(number))
        seen = self.cameras[camera]
        view, group = record(self._world, seen), f"{schema.frame_group(number)}/sights/{seen.name}"
        sight = {
            name: getattr(view.sight, name)
            for name in ("number", "depth_mm", "path_mm", "visible", "pixel", "contour")
        }
        truth: Part = {f"{group}/{name}": value for name, value in sight.items()} | {
            f"{group}/error": np.array([view.error])
        }
        images = {} if view.images is None else _seen(number, seen, view.images)
        return Taken(truth | images, view.grey, _radiance(seen, view.photons).astype(np.float32))

    def _recalled(self, number: int, part: Part) -> PhaseWorld:
        group = schema.frame_group(number)
        shapes = {name: part[f"{group}/bubbles/{name}"] for name in _BUBBLES}
        bubbles = Bubbles(**shapes, index=float(part[f"{group}/bubbles/index"][0]))
        if self._worlds.motion is None:
            return self._worlds.recalled(number, bubbles)
        return self._worlds.recalled(number, bubbles, _particles(part, group), part[f"{KEPT}lit"])

    def finish(self, writer: DatasetWriter, parts: Parts) -> None:
        """Nothing is left."""


class TargetRecorder:
    """A calibration target at all its places, in pictures or without."""

    def __init__(self, scene: Scene, seed: int, renderer: str, label: str) -> None:
        rig = build_rig(scene, label)
        self._scene, self._seed, self.cameras, self.chained = scene, seed, rig.cameras, False
        self._told, self._placed = (
            nominal_cameras(scene, rig.cameras, seed),
            calibration_targets.place(scene, seed),
        )
        self._known = calibration_targets.prior(scene, self._placed, seed)
        self.views = len(rig.cameras) if renderer == "mitsuba" else 0

    def frame(self, number: int, recall: Recall) -> Part:
        """Where the target is."""
        return {
            f"{schema.frame_group(number)}/{name}": value
            for name, value in asdict(self._placed.poses[number]).items()
        }

    def view(self, number: int, camera: int, recall: Recall) -> Taken:
        """A picture, and the target's points as they are found in it."""
        from sabench.algorithms.calibration.target_detection import detect
        from sabench.simulation.rendering.targets_traced import photograph

        scene, seen = self._scene, self.cameras[camera]
        lighting, center, pose = (
            scene.lighting,
            np.asarray(scene.volume.center_mm),
            self._placed.poses[number],
        )
        assert lighting is not None  # who chose the renderer has checked it
        full = scene.sensor.full_well_e / scene.sensor.quantum_efficiency
        photons = full * photograph(
            seen, self._placed.target, pose, lighting, center, scene.render.samples_per_pixel
        )
        grey = expose(scene.sensor, photons.copy(), stream(self._seed, "sensor", number, camera))
        found = detect(grey, self._placed.target, self._expected(camera)[number])
        return Taken({f"{KEPT}found": found}, grey, _radiance(seen, photons).astype(np.float32))

    def _expected(self, camera: int) -> F64:
        """Roughly known pixels (frame, point, 2)."""
        rough = self._known.rough_mm
        return np.asarray(
            self._told[camera].project(rough.reshape(-1, 3))[0].reshape(*rough.shape[:2], 2)
        )

    def finish(self, writer: DatasetWriter, parts: Parts) -> None:
        """The target, what each camera found of it, and what is known of its places."""
        writer.add_target(self._placed.target)
        found = []
        for number, camera in enumerate(self.cameras):
            exact = calibration_targets.exact_pixels(camera, self._placed.points_mm)
            pixels, outliers = self._found(parts, number, exact)
            writer.add_sighting(camera, exact, outliers)
            found.append(pixels)
        writer.add_points(np.stack(found), self._known)

    def _found(self, parts: Parts, camera: int, exact: F64) -> tuple[F64, Bool]:
        if not self.views:
            return calibration_targets.found_pixels(
                self._scene.detection, exact, self._seed, camera
            )
        name = self.cameras[camera].name
        return np.stack(
            [parts.view(frame, name)[f"{KEPT}found"] for frame in range(self._scene.frames)]
        ), np.zeros(exact.shape[:2], dtype=np.bool_)


def _go_on(motion: Motion, number: int, before: Callable[[], Particles]) -> None:
    """Have a chained motion stand at the frame before."""
    if motion.chained and number and motion.last != number - 1:
        motion.resume(number - 1, before())


def _particles(part: Part, group: str) -> Particles:
    return Particles(*(part[f"{group}/{name}"] for name in _PARTICLES))


def _tracers(particles: Particles, number: int) -> Part:
    return {f"{schema.frame_group(number)}/{name}": getattr(particles, name) for name in _PARTICLES}


def _flow(scene: Scene, number: int) -> Part:
    if not scene.flow_grid_mm:
        return {}
    field, gradient = lattice(scene, number, scene.flow_grid_mm)
    values = {
        "velocity_mm_s": field.velocity_mm_s,
        "gradient_1_s": gradient,
        "low_mm": np.array(field.low_mm),
        "step_mm": np.array(field.step_mm),
    }
    return {f"{schema.frame_group(number)}/flow/{name}": value for name, value in values.items()}


def _phases(world: PhaseWorld, number: int) -> Part:
    group = schema.frame_group(number)
    bubbles = {f"{group}/bubbles/{name}": getattr(world.bubbles, name) for name in _BUBBLES}
    part: Part = bubbles | {f"{group}/bubbles/index": np.array([world.bubbles.index])}
    for place, solid in enumerate(world.solids):
        part |= {
            f"{group}/bodies/{place}/vertices_mm": solid.vertices_mm,
            f"{group}/bodies/{place}/faces": solid.faces,
        }
    return part


def _seen(number: int, camera: Camera, images: ParticleImages) -> Part:
    """Where and how bright one camera receives a frame's particles."""
    group = f"{schema.frame_group(number)}/cameras/{camera.name}"
    small: Part = {
        f"{group}/sigma_px": images.sigma_px.astype(np.float32),
        f"{group}/visible": images.visible.astype(np.uint8),
    }
    return {f"{group}/pixel": images.pixel, f"{group}/photons": images.photons} | small


def _radiance(camera: Camera, photons: F64) -> F64:
    """Photons / (mm2 sr) in front of the lens; 0 where a distorted lens shows nothing."""
    etendue = camera.etendue()
    return np.divide(photons, etendue, out=np.zeros_like(photons), where=etendue > 0.0)
