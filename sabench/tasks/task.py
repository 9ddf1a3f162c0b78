"""Base of tasks: inputs and estimates of solvers, and the scores of estimates.

A task is one object. Every difference between kinds of contests is an attribute or a method of it;
suites, records, the leaderboard, the gates and the command use nothing else.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Literal

import numpy as np

from sabench.api.estimates import Detections, Estimate, FoundParticles
from sabench.api.observations import Observation, Shown
from sabench.api.solvers import AnySolver, TaskName
from sabench.dataset.arrays import group_of
from sabench.dataset.reader import Dataset
from sabench.dataset.results import Result, ResultWriter
from sabench.plotting import pictures
from sabench.tasks.solver_call import call_solver
from sabench.utils import memory
from sabench.utils.arrays import F32, F64
from sabench.utils.errors import InputError

Better = Literal["larger", "smaller", "unity", "steady"]
BETTER = {"larger": "the larger, the better", "smaller": "the smaller, the better"}
BETTER |= {"unity": "best at 1", "steady": "neither large nor small is better"}
Source = Result | Literal["truth", "empty"]
Figures = dict[str, float | None]
_TIMES = 100  # detections of a frame that are scored: per true one, and per one of as many more

LARGEST = 1e15  # no meaningful score is beyond it
# least correlation of volumes, and share of particles or bubbles that agree, if cameras are in
# another order
ALIKE, AGREEING = 0.95, 0.9
# ranges of scores
ANY = (-LARGEST, LARGEST)
ERROR, SHARE, PERCENT = (0.0, LARGEST), (0.0, 1.0), (0.0, 100.0)


# units of scores by the ends of their keys
_UNITS = {
    "_percent": "%", "_mm_s": "mm/s", "_1_s": "1/s", "_mm": "mm", "_px": "px", "_deg": "deg",
    "_voxel": "voxel", "_s": "s",
}  # fmt: skip


@dataclass(frozen=True)
class Score:
    """One score of a task.

    Attributes
    ----------
    key : its name in records, baselines and JSON.
    better : the direction of improvement: towards larger or smaller absolute values, towards 1, or
        neither ("steady": it describes the data, and any change is worth a look).
    decimals : shown in tables.
    meaning : one phrase.
    heading, unit : of its column in tables; by default as the key says, "z mean mm" for z_mean_mm.
    counted : whether it is a share of things that are counted, and so changes in steps.
    hidden : whether tables leave it out.
    range : smallest and largest possible value; by default that of an unsigned error.
    """

    key: str
    better: Better
    decimals: int
    meaning: str
    heading: str = ""
    unit: str = ""
    counted: bool = False
    hidden: bool = False
    range: tuple[float, float] = ERROR

    def __post_init__(self) -> None:
        end = next((end for end in _UNITS if self.key.endswith(end)), "")
        unit = _UNITS.get(end, "")
        heading = f"{self.key.removesuffix(end).replace('_', ' ')} {unit}".strip()
        object.__setattr__(self, "unit", self.unit or unit)
        object.__setattr__(self, "heading", self.heading or heading)


def share(
    key: str, decimals: int, meaning: str, heading: str = "", *, hidden: bool = False
) -> Score:
    """Make the score of a share of things that are counted, the larger, the better."""
    return Score(key, "larger", decimals, meaning, heading, "", True, hidden, SHARE)


@dataclass(frozen=True)
class Gate:
    """Condition for the first score to rank an estimate.

    Estimates that do not meet it share the last rank: their first score could be good by chance, or
    by what they leave out.

    Attributes
    ----------
    key : of the score that it is about.
    least : smallest figure that meets it.
    """

    key: str
    least: float

    def admits(self, figures: Mapping[str, object]) -> bool:
        """Check figures; those that lack the score, as old records may, are admitted."""
        value = figures.get(self.key)
        return self.key not in figures or (
            isinstance(value, int | float) and float(value) >= self.least
        )


COSTS = (
    Score("seconds", "smaller", 2, "time of the solver alone", unit="s"),
    Score("peak_mb", "smaller", 0, "largest memory of the solver's process", "peak MB", "MB"),
    Score("compile_s", "steady", 1, "time in which kernels were compiled or loaded, no part of the "
          "seconds", hidden=True, range=ANY),
)  # fmt: skip


@dataclass(frozen=True)
class MatchingCurve:
    """Curve of a score over the matching distance of detections.

    Attributes
    ----------
    of : key of the score, as it is at one of the distances.
    heading : of the score.
    unit : of the distances.
    distances : rising.
    """

    of: str
    heading: str
    unit: str
    distances: tuple[float, ...]

    @cached_property
    def scores(self) -> tuple[Score, ...]:
        """The curve's values as scores, which records have and tables do not."""
        meaning = "a point of the curve over the matching distance"
        within = {f"{radius:g}": f"within {radius:g} {self.unit}" for radius in self.distances}
        return tuple(
            share(f"{self.of}_within_{key}", 3, meaning, f"{self.heading} {words}", hidden=True)
            for key, words in within.items()
        )

    def figures(self, values: F64) -> Figures:
        """Name the values of the curve."""
        return {score.key: float(value) for score, value in zip(self.scores, values, strict=True)}


@dataclass(frozen=True)
class Captions:
    """Headings and captions of a task's figures on the page.

    Attributes
    ----------
    heading, estimates : of the figures of estimates.
    cameras : caption of the camera images.
    errors : caption of the error maps; "" for a task without.
    wide : whether a figure takes the page's whole width.
    truth : whether the true one is drawn next to them.
    """

    heading: str
    estimates: str
    cameras: str
    errors: str = ""
    wide: bool = False
    truth: bool = True


class Task(ABC):
    """Base of tasks.

    Attributes
    ----------
    name : of the task, as in solvers and result files.
    shown : kind of objects in the frames of its data sets.
    estimate : class of the estimates that its solvers return.
    scores : its own, the most important one first; `all_scores` adds the costs.
    gate : which estimates the first score ranks; None: all that have it.
    tolerance : curve that its results have besides; None: no score depends on a distance.
    sufficient : first score needed for a rank by run time.
    captions : of its figures.
    picture_has_truth : whether the figure of an estimate needs the truth.
    """

    name: ClassVar[TaskName]
    shown: ClassVar[Shown]
    estimate: ClassVar[type[Estimate]]
    scores: ClassVar[tuple[Score, ...]]
    gate: ClassVar[Gate | None] = None
    tolerance: ClassVar[MatchingCurve | None] = None
    sufficient: ClassVar[float]
    captions: ClassVar[Captions]
    picture_has_truth: ClassVar[bool] = False

    @property
    def all_scores(self) -> tuple[Score, ...]:
        """The task's scores and what a solver costs."""
        return (*self.scores, *COSTS)

    @property
    def columns(self) -> tuple[Score, ...]:
        """Scores that tables show, the one that ranks first."""
        return tuple(score for score in self.all_scores if not score.hidden)

    @property
    def curve(self) -> tuple[Score, ...]:
        """Points of its curve over the matching distance."""
        return self.tolerance.scores if self.tolerance else ()

    def score_of(self, key: str) -> Score:
        """Look a score up by its key; a KeyError names one that the task does not have."""
        return {score.key: score for score in (*self.all_scores, *self.curve)}[key]

    def admits(self, figures: Mapping[str, object]) -> bool:
        """Check whether the first score ranks an estimate with these figures."""
        return self.gate is None or self.gate.admits(figures)

    def rank(self, figures: Mapping[str, Any]) -> tuple[bool, float]:
        """Compute the sort key of an estimate: the smaller, the better.

        All that have no first score, or that the gate does not admit, share the last rank.
        """
        first = self.columns[0]
        value = figures.get(first.key)
        if value is None or not self.admits(figures):
            return True, 0.0
        return False, -float(value) if first.better == "larger" else float(value)

    def accepts(self, data: Dataset) -> bool:
        """Check whether a data set has all that the task's solvers and scores need."""
        return self.shown in data.shows

    def scores_data(self, data: Dataset) -> bool:
        """Check whether results of the task can be scored on a data set."""
        return self.accepts(data)

    def frames(self, data: Dataset) -> Sequence[int]:
        """List the frames that have an estimate each; [0] where one serves all frames."""
        return range(data.setup.frames)

    @abstractmethod
    def case(self, data: Dataset) -> Any:
        """Make the first case of a data set as a solver receives it."""

    def case_for(self, algorithm: Any, data: Dataset) -> Any:
        """Make the first case as one of the task's solvers receives it."""
        return self.case(data)

    def seen_by(self, plugin: type[AnySolver]) -> str:
        """Name the kind of objects for the example of one of the task's solvers."""
        return plugin.sees

    @abstractmethod
    def run(self, algorithm: Any, name: str, data: Dataset, writer: ResultWriter) -> list[float]:
        """Call a solver on the observation side of a data set and write its estimates.

        Returns
        -------
        Seconds of every call, or of every frame.

        Raises InputError for a solver that declines, raises, or returns something else than the
        task's estimate.
        """

    def copy(self, data: Dataset, result: Result, writer: ResultWriter) -> None:
        """Write every estimate of a foreign result anew; reading checks it."""
        for frame in self.frames(data):
            writer.add(self.read(data, result, frame), frame)
            memory.trim()
        for number, seconds, estimate in result.iterations(self.estimate):
            writer.add_iteration(estimate, number, seconds)

    def read(self, data: Dataset, source: Source, frame: int) -> Any:
        """Read a frame's estimate of a result, or make the best or worst possible one."""
        if isinstance(source, Result):
            return source.read(self.estimate, frame)
        return self.truth(data, frame) if source == "truth" else self.empty(data, frame)

    @abstractmethod
    def truth(self, data: Dataset, frame: int) -> Any:
        """Make the best possible estimate."""

    @abstractmethod
    def empty(self, data: Dataset, frame: int) -> Any:
        """Make an empty estimate."""

    @abstractmethod
    def wrong(self, data: Dataset, frame: int) -> Any:
        """Make an estimate that is wrong in a known way.

        Gates compare its scores with a baseline.
        """

    @abstractmethod
    def score(self, data: Dataset, source: Source) -> Figures:
        """Score a result, or the best ("truth") or worst ("empty") possible estimates."""

    def score_iterations(self, data: Dataset, result: Result) -> list[list[float]]:
        """Compute [iteration, seconds, first score] of estimates on the way."""
        return []

    def alike(self, data: Dataset, one: Any, other: Any) -> bool:
        """Compare estimates of one case with its cameras in opposite orders.

        They may differ as far as algorithms depend on the order of the cameras.
        """
        pairs = zip(one.arrays(), other.arrays(), strict=True)
        return all(np.allclose(a, b, rtol=1e-6) for (_, a), (_, b) in pairs)

    def images(self, data: Dataset) -> bytes:
        """Draw the first frame of every camera as a PNG."""
        case, backlit = data.observation(0), self.shown in ("bubbles", "code")
        draw = pictures.backlit if backlit else pictures.montage
        return draw(case.images, case.black_dn, case.white_dn)

    @abstractmethod
    def picture(self, data: Dataset, source: Source) -> bytes:
        """Draw an estimate of the first frame as a PNG."""

    def error_picture(self, data: Dataset, result: Result) -> bytes | None:
        """Draw the errors of the same estimate as a PNG; None for a task without them."""
        return None


class FrameByFrame(Task):
    """Base of tasks with solvers that receive one observation at a time."""

    def case(self, data: Dataset) -> Observation:
        """Read the first frame's observation."""
        return data.observation(0)

    def run(self, algorithm: Any, name: str, data: Dataset, writer: ResultWriter) -> list[float]:
        """Call the solver on every frame; return the seconds of each."""
        return self.run_frames(algorithm, name, data, writer, self.frames(data))

    def run_frames(
        self, algorithm: Any, name: str, data: Dataset, writer: ResultWriter, frames: Sequence[int]
    ) -> list[float]:
        """Call the solver on some frames; return the seconds of each."""
        seconds = []
        for frame in frames:
            estimate, took = self.call(algorithm, name, data, frame)
            seconds.append(took)
            writer.add(estimate, frame)
            del estimate
            memory.trim()
        return seconds

    def call(self, algorithm: Any, name: str, data: Dataset, frame: int) -> tuple[Any, float]:
        """Call the solver on one frame; return its checked estimate and the seconds."""
        case = data.observation(frame)
        self.check_case(case, f"{data.root}: frame {frame}")
        estimate, took = call_solver(algorithm, name, case, self.estimate, f" on frame {frame}")
        check_estimate(estimate, name, data, frame)
        return estimate, took

    def check_case(self, case: Observation, source: str) -> None:
        """Raise an InputError for an observation that no solver can use.

        `source` opens the sentence.
        """


def share_near(one: F64, other: F64, near: F64 | float) -> float:
    """Share of the points (n, 3) that have one of the other points (m, 3) near them."""
    if not len(one) or not len(other):
        return float(len(one) == len(other))
    apart = np.linalg.norm(one[:, None] - other, axis=2).min(axis=1)
    return float((apart < near).mean())


def correlation(one: F32, other: F32) -> float:
    """Correlation of two volumes, without subtraction of their means."""
    norms = float(np.sqrt((one**2).sum() * (other**2).sum()))
    return float((one * other).sum()) / norms if norms else 1.0


def check_number(found: int, true: int, where: str) -> None:
    """Raise an InputError for far more detections than there is anything to find.

    `where` opens the sentence.
    """
    most = _TIMES * (true + _TIMES)
    if found > most:
        raise InputError(
            f"{where}: expected at most {most} detections, {_TIMES} for each of those that there "
            f"are and of {_TIMES} more, got {found}"
        )


def check_tracks(result: Result, estimates: Sequence[Detections | FoundParticles]) -> None:
    """Raise an InputError for a result that has trajectories in some frames only."""
    missing = [number for number, one in enumerate(estimates) if one.trajectory is None]
    if 0 < len(missing) < len(estimates):
        group = group_of(type(estimates[0]), missing[0])
        raise InputError(
            f"{result.path}: {group}/track: expected one in every frame or in none, found none here"
        )


def check_estimate(found: Estimate, solver: str, data: Dataset, frame: int) -> None:
    """Raise an InputError if an array of an estimate is not as its class declares."""
    try:
        found.check(**dict(zip("zyx", data.setup.grid.shape, strict=True)))
    except InputError as error:
        raise InputError(f"solver {solver}: frame {frame}: {error}") from error
