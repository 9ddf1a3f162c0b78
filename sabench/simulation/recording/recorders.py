"""Recorders of the parts of a data set: truth and images of every frame."""

from __future__ import annotations

import numpy as np

from sabench.algorithms.calibration.target_detection import detect
from sabench.api.truth import Bubbles, Particles
from sabench.dataset import schema
from sabench.dataset.writer import DatasetWriter
from sabench.scenes import Scene, TargetWorld, build_rig
from sabench.scenes.nominal_cameras import nominal_cameras
from sabench.simulation.camera_view import CameraView, render
from sabench.simulation.frame_content import FrameContent
from sabench.simulation.frames import Frames
from sabench.simulation.grey_values import record_image
from sabench.simulation.recording.parts import KEPT, Part, Parts, Recall, Taken
from sabench.utils.arrays import F64, Bool
from sabench.worlds import calibration_targets
from sabench.worlds.materials import material_numbers
from sabench.worlds.tracers import lattice

_PARTICLES = ("id", "position_mm", "diameter_mm", "velocity_mm_s")
_BUBBLES = ("id", "center_mm", "semi_axes_mm", "turn", "velocity_mm_s")
_SIGHT = ("number", "depth_mm", "path_mm", "visible", "pixel", "contour")
_STATE = f"{KEPT}state"  # all tracers of a frame; the truth holds only those in the fluid
_ILLUMINATED = f"{KEPT}illuminated"
_FOUND = f"{KEPT}found"


class Recorder:
    """Recorder of one data set's parts, which do not depend on each other.

    Attributes
    ----------
    cameras : the true ones.
    views : number of cameras that take images.
    chained : whether a frame's truth needs that of the frame before it.
    """

    def __init__(self, scene: Scene, seed: int, renderer: str, label: str) -> None:
        rig = build_rig(scene, label)
        self._scene, self._seed = scene, seed
        self._frames = Frames(scene, rig, seed, renderer)
        self._last: FrameContent | None = None
        self.cameras, self.views, self.chained = rig.cameras, len(rig.cameras), self._frames.chained

    def frame(self, number: int, recall: Recall) -> Part:
        """Make a frame's truth, apart from that of its cameras.

        `recall` gives the part of the frame before.
        """
        motion = self._frames.motion
        if motion is not None and self.chained and number and motion.last != number - 1:
            motion.resume(number - 1, self._state(number - 1, recall(number - 1)))
        self._last = self._frames.at(number)
        return (
            _truth(self._last)
            | _flow(self._scene, self._frames.seed, number)
            | self._kept(self._last)
        )

    def view(self, number: int, camera: int, recall: Recall) -> Taken:
        """Render one camera's image of a frame, and its truth.

        `recall` gives the frame's part.
        """
        if self._last is None or self._last.number != number:
            self._last = self._restore(number, recall(number))
        frame = self._last
        view = render(frame, camera)
        grey = record_image(frame, view, camera)
        return Taken(_view_truth(frame, view), grey, view.radiance().astype(np.float32))

    def finish(self, writer: DatasetWriter, parts: Parts) -> None:
        """Store what all parts together make: nothing, for most scenes."""

    def _kept(self, frame: FrameContent) -> Part:
        """Select what later tasks need besides the truth.

        Among bubbles, that is all tracers and which of them are illuminated.
        """
        if self._frames.motion is None or frame.tracers is None or frame.bubbles is None:
            return {}
        kept: Part = {}
        if self.chained:
            kept |= _fields(_STATE, self._frames.motion.at(frame.number), _PARTICLES)
        if frame.tracers.illuminated is not None:
            kept[_ILLUMINATED] = frame.tracers.illuminated
        return kept

    def _state(self, number: int, part: Part) -> Particles:
        """Read all tracers of a frame from its part."""
        group = _STATE if f"{_STATE}/id" in part else schema.frame_group(number)
        return _particles(part, group)

    def _restore(self, number: int, part: Part) -> FrameContent:
        """Restore a frame from its part."""
        group = schema.frame_group(number)
        particles = _particles(part, group) if f"{group}/id" in part else None
        bubbles = _bubbles(part, group) if f"{group}/bubbles/id" in part else None
        return self._frames.assemble(number, bubbles, particles, part.get(_ILLUMINATED))


class TargetRecorder(Recorder):
    """Recorder of a data set for calibrations, with images or without."""

    def __init__(self, scene: Scene, seed: int, renderer: str, label: str) -> None:
        super().__init__(scene, seed, renderer, label)
        self._nominal = nominal_cameras(scene, self.cameras, seed)
        placed = self._frames.placed
        if placed is None:
            raise ValueError(f"{label}: expected a scene with a target")
        self._placed = placed
        self._prior = calibration_targets.prior(scene, placed, seed)
        self.views = len(self.cameras) if renderer == "mitsuba" else 0

    def view(self, number: int, camera: int, recall: Recall) -> Taken:
        """Render one camera's image of a frame, and detect the target's points in it."""
        taken = super().view(number, camera, recall)
        expected = self._nominal[camera].project(self._prior.initial_mm[number])[0]
        found = detect(taken.grey, self._placed.target, expected)
        return Taken({**taken.truth, _FOUND: found}, taken.grey, taken.radiance)

    def finish(self, writer: DatasetWriter, parts: Parts) -> None:
        """Store the target, the detected points, and the prior of its positions."""
        writer.add_target(self._placed.target)
        found = []
        for number, camera in enumerate(self.cameras):
            exact = calibration_targets.exact_pixels(camera, self._placed.points_mm)
            pixels, outliers = self._collect_points(parts, number, exact)
            writer.add_sighting(camera, exact, outliers)
            found.append(pixels)
        writer.add_points(np.stack(found), self._prior)

    def _collect_points(self, parts: Parts, camera: int, exact: F64) -> tuple[F64, Bool]:
        """Collect the points that a camera detected.

        Pixels (frame, point, 2), and which are outliers (frame, point).
        """
        if not self.views:
            detection = self._scene.detection
            return calibration_targets.found_pixels(detection, exact, self._seed, camera)
        name, frames = self.cameras[camera].name, range(self._scene.frames)
        found = np.stack([parts.view(frame, name)[_FOUND] for frame in frames])
        return found, np.zeros(exact.shape[:2], dtype=np.bool_)


def recorder_of(scene: Scene, seed: int, renderer: str, label: str) -> Recorder:
    """Choose the recorder of a scene."""
    kind = TargetRecorder if isinstance(scene.world, TargetWorld) else Recorder
    return kind(scene, seed, renderer, label)


def _truth(frame: FrameContent) -> Part:
    """Collect a frame's truth apart from its cameras', by names on disk."""
    group, part = schema.frame_group(frame.number), Part()
    if frame.bubbles is not None:
        part |= _fields(f"{group}/bubbles", frame.bubbles, _BUBBLES)
        part[f"{group}/bubbles/index"] = np.array([frame.bubbles.index])
    for number, solid in enumerate(frame.solids):
        part |= _fields(f"{group}/bodies/{number}", solid, ("vertices_mm", "faces"))
    if frame.tracers is not None:
        part |= _fields(group, frame.tracers.particles, _PARTICLES)
        if (tracer := frame.scene.tracer).mixture:
            ids = frame.tracers.particles.id
            part[f"{group}/material"] = material_numbers(tracer, frame.seed, ids)
    if frame.pose is not None:
        part |= {f"{group}/turn": frame.pose.rotation, f"{group}/place_mm": frame.pose.position_mm}
    return part


def _flow(scene: Scene, seed: int, number: int) -> Part:
    """Sample the exact flow of a frame, where the scene asks for it."""
    if not scene.flow_grid_mm:
        return {}
    field, gradient = lattice(scene, number, scene.flow_grid_mm, seed)
    group = f"{schema.frame_group(number)}/flow"
    return {
        f"{group}/velocity_mm_s": field.velocity_mm_s,
        f"{group}/gradient_1_s": gradient,
        f"{group}/low_mm": np.array(field.low_mm),
        f"{group}/step_mm": np.array(field.step_mm),
    }


def _view_truth(frame: FrameContent, view: CameraView) -> Part:
    """Collect the truth of one camera's view, by names on disk."""
    group, camera, part = schema.frame_group(frame.number), view.camera.name, Part()
    if view.sight is not None:
        part |= _fields(f"{group}/sights/{camera}", view.sight, _SIGHT)
        part[f"{group}/sights/{camera}/error"] = np.array([view.error])
    if view.particles is not None:
        images, own = view.particles, f"{group}/cameras/{camera}"
        part[f"{own}/pixel"] = images.pixel
        part[f"{own}/photons"] = images.photons
        part[f"{own}/sigma_px"] = images.sigma_px.astype(np.float32)
        part[f"{own}/spread_px2"] = images.spread_px2.astype(np.float32)
        part[f"{own}/visible"] = images.visible.astype(np.uint8)
    return part


def _fields(group: str, values: object, names: tuple[str, ...]) -> Part:
    return {f"{group}/{name}": getattr(values, name) for name in names}


def _particles(part: Part, group: str) -> Particles:
    return Particles(*(part[f"{group}/{name}"] for name in _PARTICLES))


def _bubbles(part: Part, group: str) -> Bubbles:
    shapes = {name: part[f"{group}/bubbles/{name}"] for name in _BUBBLES}
    return Bubbles(**shapes, index=float(part[f"{group}/bubbles/index"][0]))
