"""Estimates of a result as the page shows them, frame by frame."""

from __future__ import annotations

from typing import Any

from sabench import tasks
from sabench.api import Calibration, Detections, FoundParticles, Reconstruction, Velocity
from sabench.dataset.reader import Dataset
from sabench.dataset.results import Result
from sabench.evaluation.viewer import classification as classify
from sabench.evaluation.viewer.clouds import Cloud
from sabench.geometry.camera_model import CameraModel
from sabench.utils.arrays import F32


class Estimates:
    """Reader of a result's estimates.

    Attributes
    ----------
    cameras : that a solver has calibrated; none for other results.
    volume : reconstruction (z, y, x) of the first frame, when it has been read; else None.
    peaks : whether particles are local maxima of volumes.

    Raises
    ------
    InputError
        A result of a task that the data set does not serve.
    """

    def __init__(self, data: Dataset, result: Result) -> None:
        self._data, self._result, self._task = data, result, tasks.of(result.task)
        if data.has_truth:
            tasks.check_task(result.task, data, result.path)
        self._pairs = dict(data.setup.pairs())
        self._calibration: Calibration | None = None
        self.volume: F32 | None = None
        self.peaks = False
        if self._task.estimate is Calibration:
            self._calibration = self._read(0)

    @property
    def cameras(self) -> tuple[CameraModel, ...]:
        """Calibrated cameras."""
        return () if self._calibration is None else self._calibration.cameras

    def particles(self, frame: int) -> Cloud | None:
        """Read a frame's particles, vectors or points; None where there are none."""
        data, kind = self._data, self._task.estimate
        if kind is FoundParticles:
            return classify.classify_particles(self._read(frame), data, frame)
        if kind is Reconstruction:
            return self._of_volume(frame)
        if kind is Velocity and frame in self._pairs:
            return classify.place_vectors(self._read(frame), data, (frame, self._pairs[frame]))
        if self._calibration is not None:
            return classify.place_target(self._calibration, data, frame)
        return None

    def bubbles(self, frame: int) -> Cloud | None:
        """Read a frame's bubbles; None where there are none."""
        if self._task.estimate is not Detections:
            return None
        return classify.classify_bubbles(self._read(frame), self._data, frame)

    def _of_volume(self, frame: int) -> Cloud | None:
        """Read a volume's particles; a volume without particles shows a code."""
        found: Reconstruction = self._read(frame)
        if frame == 0:
            self.volume = found.volume
        if self._result.task != "reconstruction":
            return None
        self.peaks = found.particles_mm is None
        peaks = classify.find_peaks(found, self._data)
        return classify.classify_particles(peaks, self._data, frame)

    def _read(self, frame: int) -> Any:
        return self._task.read(self._data, self._result, frame)
