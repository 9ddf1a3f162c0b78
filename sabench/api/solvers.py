"""What a plug-in implements: a generator makes truth, a solver makes an estimate from what an experimenter would see.

A plug-in is a file in generators/ or solvers/ with one class; its `name` is the file's stem, the
first line of its docstring is what `sabench list` shows, its `Parameters` are what a scene or `-p
name=value` may set.
"""

from __future__ import annotations

from typing import ClassVar, Literal

from pydantic import Field

from sabench.api.estimates import Calibration, Detections, FoundParticles, Reconstruction, Velocity
from sabench.api.observations import CalibrationCase, Film, Observation, Shown, VolumePair
from sabench.api.parameters import Parameters, PlugIn

TaskName = Literal[
    "reconstruction", "particles", "calibration", "velocimetry", "bubbles", "see_through"
]


class Solver(PlugIn):
    """Base of a reconstruction algorithm: `solve` turns one observation into one reconstruction."""

    task: ClassVar[TaskName] = "reconstruction"
    sees: ClassVar[Shown] = "particles"

    def skip(self, case: Observation) -> str | None:
        """Why this algorithm cannot take the case, or None if it can."""
        return None

    def solve(self, case: Observation) -> Reconstruction:
        """Reconstruct one frame."""
        raise NotImplementedError(f"solver {type(self).__name__} must implement solve()")


class ParticleSolver(PlugIn):
    """Base of an algorithm that finds particles, or tracks them: `solve` turns a film into the particles of each of its frames."""

    task: ClassVar[TaskName] = "particles"
    sees: ClassVar[Shown] = "particles"

    def skip(self, case: Film) -> str | None:
        """Why this algorithm cannot take the case, or None if it can."""
        return None

    def solve(self, case: Film) -> list[FoundParticles]:
        """Find the particles of every frame; all of them with track numbers, or none."""
        raise NotImplementedError(f"solver {type(self).__name__} must implement solve()")


class CalibrationSolver(PlugIn):
    """Base of a calibration algorithm: `solve` turns all observations of a target into cameras."""

    task: ClassVar[TaskName] = "calibration"
    sees: ClassVar[Shown] = "target"

    def skip(self, case: CalibrationCase) -> str | None:
        """Why this algorithm cannot take the case, or None if it can."""
        return None

    def solve(self, case: CalibrationCase) -> Calibration:
        """Calibrate an array."""
        raise NotImplementedError(f"solver {type(self).__name__} must implement solve()")


class SelfCalibrationSolver(PlugIn):
    """Base of an algorithm that corrects cameras by images of particles: `solve` turns one observation into cameras."""

    task: ClassVar[TaskName] = "calibration"
    sees: ClassVar[Shown] = "particles"

    def skip(self, case: Observation) -> str | None:
        """Why this algorithm cannot take the case, or None if it can."""
        return None

    def solve(self, case: Observation) -> Calibration:
        """Correct the cameras of an array by one frame."""
        raise NotImplementedError(f"solver {type(self).__name__} must implement solve()")


class VelocimetryParameters(Parameters):
    """Which solver reconstructs the volumes."""

    reconstruction: str = Field(
        "block_mart", description="name of a reconstruction solver, with its own defaults"
    )


class VelocimetrySolver(PlugIn):
    """Base of a velocimetry algorithm: `solve` turns two volumes into a velocity field."""

    task: ClassVar[TaskName] = "velocimetry"
    sees: ClassVar[Shown] = "particles"
    Parameters = VelocimetryParameters

    def skip(self, case: VolumePair) -> str | None:
        """Why this algorithm cannot take the case, or None if it can."""
        return None

    def solve(self, case: VolumePair) -> Velocity:
        """Measure the velocity field of a pair."""
        raise NotImplementedError(f"solver {type(self).__name__} must implement solve()")


class BubbleSolver(PlugIn):
    """Base of an algorithm that finds bubbles: `solve` turns one observation into detections."""

    task: ClassVar[TaskName] = "bubbles"
    sees: ClassVar[Shown] = "bubbles"

    def skip(self, case: Observation) -> str | None:
        """Why this algorithm cannot take the case, or None if it can."""
        return None

    def solve(self, case: Observation) -> Detections:
        """Find the bubbles of one frame."""
        raise NotImplementedError(f"solver {type(self).__name__} must implement solve()")


class SeeThroughSolver(PlugIn):
    """Base of an algorithm that looks through what is in front of a body: `solve` turns one observation into a stack of planes."""

    task: ClassVar[TaskName] = "see_through"
    sees: ClassVar[Shown] = "code"

    def skip(self, case: Observation) -> str | None:
        """Why this algorithm cannot take the case, or None if it can."""
        return None

    def solve(self, case: Observation) -> Reconstruction:
        """Planes in which bright is what lets light through."""
        raise NotImplementedError(f"solver {type(self).__name__} must implement solve()")


AnySolver = (
    ParticleSolver
    | BubbleSolver
    | SeeThroughSolver
    | Solver
    | CalibrationSolver
    | SelfCalibrationSolver
    | VelocimetrySolver
)
