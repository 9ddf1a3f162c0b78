"""Base classes of solvers, one for each kind of algorithm.

A solver makes an estimate from the data that an experimenter would have; a generator makes truth.
Each of them is a plug-in.

A plug-in is a file in generators/ or solvers/ with one class. Its `name` is the stem of the file,
the first line of its docstring is its summary in `sabench list`, and its `Parameters` are the
values that a scene or `-p name=value` may set.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import ClassVar, Generic, Literal, TypeVar

from pydantic import Field

from sabench.api.estimates import Calibration, Detections, FoundParticles, Reconstruction, Velocity
from sabench.api.observations import (
    CalibrationCase,
    ImagePair,
    ImageSequence,
    Observation,
    Shown,
    VolumePair,
)
from sabench.api.parameters import Parameters, PlugIn
from sabench.utils.errors import InputError

TaskName = Literal[
    "reconstruction", "particles", "calibration", "velocimetry", "bubbles", "see_through"
]


_Case = TypeVar("_Case")
_Answer = TypeVar("_Answer")


class SolverOf(PlugIn, Generic[_Case, _Answer]):
    """Base of all solvers, for one kind of cases and one of answers."""

    task: ClassVar[TaskName]
    sees: ClassVar[Shown] = "particles"

    def skip(self, case: _Case) -> str | None:
        """Give the reason why this algorithm cannot take the case; None if it can."""
        return None

    def solve(self, case: _Case) -> _Answer:
        """Return the answer to one case."""
        raise NotImplementedError(f"solver {type(self).__name__} must implement solve()")


class Solver(SolverOf[Observation, Reconstruction]):
    """Base of a reconstruction algorithm.

    `solve` turns one observation into one reconstruction.
    """

    task: ClassVar[TaskName] = "reconstruction"


class IterativeSolver(Solver):
    """Base of a reconstruction algorithm that improves one estimate again and again.

    It hands control back after each iteration, so that one run gives accuracy over time.
    """

    def iterations(self, case: Observation) -> Iterator[Callable[[], Reconstruction]]:
        """Reconstruct one frame; yield what makes the estimate after each iteration."""
        raise NotImplementedError(f"solver {type(self).__name__} must implement iterations()")

    def solve(self, case: Observation) -> Reconstruction:
        """Return the estimate after the last iteration."""
        last = deque(self.iterations(case), maxlen=1)
        if not last:
            raise InputError("expected an iteration at least, got none")
        return last[0]()


class SequenceSolver(SolverOf[ImageSequence, Iterable[Reconstruction]]):
    """Base of a reconstruction algorithm that takes several frames together.

    `solve` turns an image sequence into the reconstruction of each of its frames: a list, or an
    iterator that yields them in order.
    """

    task: ClassVar[TaskName] = "reconstruction"


class ParticleSolver(SolverOf[ImageSequence, Iterable[FoundParticles]]):
    """Base of an algorithm that finds particles, with or without trajectories.

    `solve` turns an image sequence into the particles of each of its frames: a list, or an iterator
    that yields them in order, so that a long sequence needs no more memory than a short one. Either
    all have trajectories, or none.
    """

    task: ClassVar[TaskName] = "particles"


class CalibrationSolver(SolverOf[CalibrationCase, Calibration]):
    """Base of a calibration algorithm.

    `solve` turns all observations of a target into cameras. `needs_places` says that it takes the
    target's nominal positions as exact, so that they must have been measured.
    """

    task: ClassVar[TaskName] = "calibration"
    sees: ClassVar[Shown] = "target"
    needs_places: ClassVar[bool] = False


class SelfCalibrationSolver(SolverOf[Observation, Calibration]):
    """Base of an algorithm that corrects cameras by images of particles.

    `solve` turns one observation into cameras.
    """

    task: ClassVar[TaskName] = "calibration"


class VelocimetryParameters(Parameters):
    """Parameters of velocimetry: the solver that reconstructs the volumes."""

    reconstruction: str = Field(
        "block_mart", description="name of a reconstruction solver, with its own defaults"
    )


class VelocimetrySolver(SolverOf[VolumePair, Velocity]):
    """Base of a velocimetry algorithm.

    `solve` turns two volumes into a velocity field.
    """

    task: ClassVar[TaskName] = "velocimetry"
    Parameters = VelocimetryParameters


class PlanarVelocimetrySolver(SolverOf[ImagePair, Velocity]):
    """Base of a velocimetry algorithm that needs no volumes.

    `solve` turns two frames into a velocity field in a plane, with `plane_axes`.
    """

    task: ClassVar[TaskName] = "velocimetry"


class BubbleSolver(SolverOf[Observation, Detections]):
    """Base of an algorithm that finds bubbles.

    `solve` turns one observation into detections.
    """

    task: ClassVar[TaskName] = "bubbles"
    sees: ClassVar[Shown] = "bubbles"


class SeeThroughSolver(SolverOf[Observation, Reconstruction]):
    """Base of an algorithm that sees through the objects in front of a body.

    `solve` turns one observation into planes, bright where voxels let light through.
    """

    task: ClassVar[TaskName] = "see_through"
    sees: ClassVar[Shown] = "code"


AnySolver = (
    ParticleSolver
    | BubbleSolver
    | SeeThroughSolver
    | Solver
    | SequenceSolver
    | CalibrationSolver
    | SelfCalibrationSolver
    | VelocimetrySolver
    | PlanarVelocimetrySolver
)
