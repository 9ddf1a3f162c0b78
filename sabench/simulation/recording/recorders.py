"""Recorders of the parts of a data set: truth and images of every frame."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from sabench.algorithms.calibration.target_detection import detect_target
from sabench.api.arrays import Array
from sabench.api.truth import (
    Bubbles,
    ExactFlow,
    Materials,
    Particles,
    Sighting,
    TargetPoints,
    TargetPose,
)
from sabench.dataset.writer import DatasetWriter
from sabench.scenes import Scene, TargetWorld, build_rig
from sabench.scenes.focusing import nominal_cameras
from sabench.simulation.camera_view import record_image, render_camera_view
from sabench.simulation.frames import FrameContent, Frames
from sabench.simulation.recording.parts import (
    CameraPart,
    Entry,
    Part,
    Parts,
    Recall,
    RecordingArrays,
)
from sabench.simulation.recording.schedule import RecordingTask
from sabench.utils import memory
from sabench.utils.arrays import F64, Bool
from sabench.utils.errors import InputError
from sabench.worlds import calibration_targets
from sabench.worlds.tracers import material_numbers, sample_lattice


@dataclass(frozen=True)
class _State(Particles):
    """All tracers of a frame; the truth holds only those in the fluid."""

    GROUP = f"{RecordingArrays.GROUP}/state"
    OF_FRAME = False


@dataclass(frozen=True)
class _Illuminated(RecordingArrays):
    """Flags (n,) of the tracers that the laser reaches."""

    ARRAYS = (Array("illuminated", ("n",), np.bool_),)

    illuminated: Bool


@dataclass(frozen=True)
class _Detected(RecordingArrays):
    """Pixels (point, 2) of a target's points in one camera; NaN if undetected."""

    ARRAYS = (Array("detected", ("point", 2), finite=False),)

    detected: F64


class Recorder:
    """Recorder of one data set's parts, which do not depend on each other.

    Attributes
    ----------
    cameras : the true ones.
    views : number of cameras that take images.
    chained : whether a frame's truth needs that of the frame before it.
    last : content of the last frame that was made.
    """

    def __init__(self, scene: Scene, seed: int, renderer: str, label: str) -> None:
        rig = build_rig(scene, label)
        self._scene, self._seed = scene, seed
        self._frames = Frames(scene, rig, seed, renderer)
        self.last: FrameContent | None = None
        self.cameras, self.views, self.chained = rig.cameras, len(rig.cameras), self._frames.chained

    def frame(self, number: int, recall: Recall) -> list[Entry]:
        """Make a frame's truth, apart from that of its cameras.

        `recall` gives the part of the frame before.
        """
        motion = self._frames.motion
        if motion is not None and self.chained and number and motion.last != number - 1:
            motion.resume(number - 1, _tracers(recall(number - 1), number - 1))
        self.last = self._frames.at(number)
        return [*self._truth(self.last), *self._kept(self.last)]

    def view(self, number: int, camera: int, recall: Recall) -> CameraPart:
        """Render a camera's image of a frame, and truth; `recall` gives the frame's part."""
        if self.last is None or self.last.number != number:
            part = recall(number)
            lit = part.find(_Illuminated)
            self.last = self._frames.assemble(
                number,
                part.find(Bubbles, number),
                part.find(Particles, number),
                None if lit is None else lit.illuminated,
            )
        frame = self.last
        view = render_camera_view(frame, camera)
        grey = record_image(frame, view, camera)
        truth: list[Entry] = [
            (part, view.camera.name) for part in (view.sight, view.particles) if part is not None
        ]
        return CameraPart(truth, grey, view.radiance().astype(np.float32))

    def finish(self, writer: DatasetWriter, parts: Parts) -> None:
        """Store what all parts together make: nothing, for most scenes."""

    def _truth(self, frame: FrameContent) -> Iterator[Entry]:
        if frame.bubbles is not None:
            yield frame.bubbles, ""
        for number, solid in enumerate(frame.solids):
            yield solid, number
        if frame.tracers is not None:
            yield frame.tracers.particles, ""
            if (tracer := frame.scene.tracer).mixture:
                ids = frame.tracers.particles.id
                yield Materials(material_numbers(tracer, frame.seed, ids)), ""
        if frame.pose is not None:
            yield TargetPose(frame.pose.rotation, frame.pose.position_mm), ""
        if step_mm := self._scene.flow_grid_mm:
            field, gradient = sample_lattice(self._scene, frame.number, step_mm, self._seed)
            yield ExactFlow(field.velocity_mm_s, gradient, field.low_mm, field.step_mm), ""

    def _kept(self, frame: FrameContent) -> Iterator[Entry]:
        """Select what later tasks need besides the truth.

        Among bubbles, that is all tracers and which of them are illuminated.
        """
        if self._frames.motion is None or frame.tracers is None or frame.bubbles is None:
            return
        if self.chained:
            every = self._frames.motion.at(frame.number)
            yield _State(every.id, every.position_mm, every.diameter_mm, every.velocity_mm_s), ""
        if frame.tracers.illuminated is not None:
            yield _Illuminated(frame.tracers.illuminated), ""


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

    def view(self, number: int, camera: int, recall: Recall) -> CameraPart:
        """Render one camera's image of a frame, and detect the target's points in it."""
        taken = super().view(number, camera, recall)
        expected = self._nominal[camera].project(self._prior.initial_mm[number])[0]
        found = detect_target(taken.grey, self._placed.target, expected)
        return replace(taken, truth=[*taken.truth, (_Detected(found), "")])

    def finish(self, writer: DatasetWriter, parts: Parts) -> None:
        """Store the target, the detected points, and the prior of its positions."""
        writer.add_target(self._placed.target)
        found = []
        for number, camera in enumerate(self.cameras):
            exact = calibration_targets.exact_pixels(camera, self._placed.points_mm)
            if self.views:
                pixels = self._collect_points(parts, camera.name)
                outliers = np.zeros(exact.shape[:2], dtype=np.bool_)
            else:
                pixels, outliers = calibration_targets.found_pixels(
                    self._scene.detection, exact, self._seed, number
                )
            writer.add_sighting(camera.name, Sighting(exact, outliers))
            found.append(pixels)
        prior = self._prior
        points = np.stack(found), prior.initial_mm, prior.known_mm, prior.known_sigma_mm
        writer.add_points(TargetPoints(*points))

    def _collect_points(self, parts: Parts, camera: str) -> F64:
        frames = range(self._scene.frames)
        detected = [parts.view(frame, camera).find(_Detected) for frame in frames]
        return np.stack([part.detected for part in detected if part is not None])


def recorder_of(scene: Scene, seed: int, renderer: str, label: str) -> Recorder:
    """Choose the recorder of a scene."""
    kind = TargetRecorder if isinstance(scene.world, TargetWorld) else Recorder
    return kind(scene, seed, renderer, label)


def record_task(recorder: Recorder, parts: Parts, task: RecordingTask) -> None:
    """Record a frame's truth or one camera's view of it, unless that is there."""
    if task.camera is None:
        if not parts.has_frame(task.frame):
            parts.put_frame(task.frame, recorder.frame(task.frame, parts.frame))
        return
    camera = recorder.cameras[task.camera].name
    if not parts.has_view(task.frame, camera):
        parts.put_view(task.frame, camera, recorder.view(task.frame, task.camera, parts.frame))
    memory.trim()


def _tracers(part: Part, number: int) -> Particles:
    particles: Particles | None = part.find(_State)
    particles = part.find(Particles, number) if particles is None else particles
    if particles is None:
        raise InputError(f"frame {number}: expected a part with tracers, got one without")
    return particles
