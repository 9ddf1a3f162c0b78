"""Suites of scenes, recordings, seeds and solvers, their cases and parts of them.

The scenes of a suite may have changes.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, model_validator

from sabench import plugins
from sabench.api.solvers import TaskName
from sabench.dataset.reader import Dataset
from sabench.evaluation.record_schema import Difficulty, Name
from sabench.scenes import Scene
from sabench.tasks.external_programs import is_program, solver_name
from sabench.tasks.solve_and_score import describe_solver
from sabench.utils.backend import Renderer
from sabench.utils.code_hash import code_hash
from sabench.utils.errors import InputError
from sabench.utils.processes.program import ProgramLimits, limits_of

RECORDED = "recorded"  # in place of the renderer of a recording
_SAFE = r"[A-Za-z0-9][A-Za-z0-9._-]*"  # as a part of a file name on every system


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Changes(_Table):
    """Changes of a scene.

    Keys are the scene's, with dots between tables: "cameras.layout.x_mm".
    """

    set: dict[str, Any] = Field({}, description="values that replace the scene's")
    vary: dict[str, Annotated[list[Any], Field(min_length=1)]] = Field(
        {}, description="lists of values: one case for each, or for each combination"
    )


class SolverEntry(_Table):
    """Solver entry: one solver with its parameters, or a program with its limits."""

    name: str = Field(description="of a solver, or the path of a program next to the suite")
    parameters: dict[str, Any] = {}
    label: Name | None = Field(None, description="shown in place of the name")
    task: TaskName | None = Field(None, description="of a program: task of its results")
    time_limit_s: float | None = Field(None, gt=0, description="of a program, for a data set")
    memory_limit_mb: float | None = Field(
        None, gt=0, description="of a program's processes together"
    )

    @property
    def is_program(self) -> bool:
        """True if the name is the path of a program."""
        return is_program(self.name)

    @property
    def limits(self) -> ProgramLimits | None:
        """Limits of a program."""
        return limits_of(self.time_limit_s, self.memory_limit_mb)

    @property
    def shown(self) -> str:
        """Name in tables."""
        return self.label or (solver_name(self.name) if self.is_program else self.name)

    @property
    def code_hash(self) -> str:
        """Hash of sabench and of the solver's or program's file."""
        return code_hash(
            Path(self.name) if self.is_program else plugins.file_of("solvers", self.name)
        )

    def describe(self) -> tuple[str, str, dict[str, Any]]:
        """Return its name in tables, its task and all its parameters."""
        if self.is_program:
            return solver_name(self.name), str(self.task), self.parameters
        return self.name, *describe_solver(self.name, self.parameters)


class CaseSpec(Changes):
    """One scene with its changes."""

    scene: str = Field(description="name of a bundled scene, or a path next to the suite")
    name: str | None = Field(
        None,
        pattern=f"^{_SAFE}$",
        description="by default the scene's; the varied values are appended",
    )
    backend: Renderer | None = Field(None, description="by default the suite's")
    solvers: tuple[SolverEntry, ...] = Field((), description="by default the suite's")
    difficulty: Difficulty | None = None
    axis: str | None = Field(
        None,
        pattern=r"^[a-z][a-z ]*$",
        description="the one property that differs from the standard case: density, ...",
    )


class QualityOptions(_Table):
    """Options of the quality figures of a recording without truth."""

    frames: int = Field(1, ge=1, description="first frames that are compared with their images")
    again: bool = Field(
        False, description="solve again without each camera, and with each one scrambled"
    )


class RecordingSpec(_Table):
    """One recorded data set; a text is short for a table with its folder alone."""

    folder: str = Field(min_length=1, description="absolute, or next to the suite")
    name: str | None = Field(None, pattern=f"^{_SAFE}$", description="by default the folder's")
    solvers: tuple[SolverEntry, ...] = Field((), description="by default the suite's")
    quality: QualityOptions = QualityOptions()

    @model_validator(mode="before")
    @classmethod
    def _from_text(cls, values: Any) -> Any:
        return {"folder": values} if isinstance(values, str) else values


class Suite(Changes):
    """Suite file: cases x seeds x solvers, and recordings x solvers.

    Its own `set` and `vary` apply to all cases of scenes, before the cases' own.
    """

    title: str
    version: int = Field(1, ge=1)
    frozen: str | None = Field(
        None,
        pattern="^[0-9a-f]{64}$",
        description="hash of its cases and seeds: with it, a change needs a new version",
    )
    scenes: tuple[str, ...] = Field((), description="cases that change no more than the suite does")
    cases: tuple[CaseSpec, ...] = ()
    recordings: tuple[RecordingSpec, ...] = Field(
        (), description="recorded data sets, whatever the seeds are"
    )
    seeds: tuple[Annotated[int, Field(ge=0, lt=2**63)], ...] = Field((1,), min_length=1)
    backend: Renderer = "auto"
    keep_data: bool = Field(
        True, description="false: a data set and its results are deleted when they are scored"
    )
    solvers: tuple[SolverEntry, ...] = Field(
        (), description="of all cases that do not have their own"
    )

    @model_validator(mode="after")
    def _has_cases(self) -> Suite:
        if not self.scenes and not self.cases and not self.recordings:
            raise ValueError("scenes, cases, recordings: expected at least one of them")
        solvers = [case.solvers for case in self.cases]
        solvers += [recording.solvers for recording in self.recordings]
        if not self.solvers and (self.scenes or not all(solvers)):
            raise ValueError("solvers: expected at least one for every case")
        return self


@dataclass(frozen=True, kw_only=True)
class _Case(ABC):
    """One data set of a suite.

    Attributes
    ----------
    name : unique in its suite but for the seed, and safe as a file name.
    base : name of the scene that was changed, or of the recording.
    seed : of the data set; 0 for a recording.
    renderer : by which images are made.
    axes : the varied keys of the scene with this case's values.
    solvers : the solver entries that run on it.
    difficulty, axis : as given in the suite.
    number : its number among the private data sets of its case; None: it is public.
    """

    name: str
    base: str
    seed: int
    renderer: str
    axes: Mapping[str, Any] = field(default_factory=dict)
    solvers: tuple[SolverEntry, ...] = ()
    difficulty: Difficulty | None = None
    axis: str | None = None
    number: int | None = None

    @property
    @abstractmethod
    def data_hash(self) -> str:
        """Hash of what its data set is made of."""

    @property
    def shown_seed(self) -> int:
        """Seed of a public data set, or number of a private one."""
        return self.seed if self.number is None else self.number

    @property
    def seed_label(self) -> str:
        """Name of the data set among those of its case; it never has a private seed."""
        return f"seed{self.seed}" if self.number is None else f"hidden{self.number}"

    @property
    def words(self) -> str:
        """Words for its data set in messages."""
        return f"seed {self.seed}" if self.number is None else f"hidden {self.number}"

    @property
    def file_name(self) -> str:
        """Name of its files: data set, figures, results."""
        return f"{self.name}-{self.data_hash[:8]}-{self.renderer}-{self.seed_label}"


@dataclass(frozen=True, kw_only=True)
class SceneCase(_Case):
    """Data set that is generated from a scene and a seed."""

    scene: Scene

    @property
    def data_hash(self) -> str:
        """Hash of the scene."""
        return self.scene.hash

    def folder(self, work: Path) -> Path:
        """Return the folder of its data set."""
        return work / "datasets" / self.file_name


@dataclass(frozen=True, kw_only=True)
class RecordedCase(_Case):
    """Recorded data set, without truth.

    Attributes
    ----------
    data : the data set where it lies; sabench never changes it.
    quality : how results are judged.
    """

    data: Dataset
    quality: QualityOptions
    seed: int = 0
    renderer: str = RECORDED

    @property
    def data_hash(self) -> str:
        """Hash of the data set's content."""
        return self.data.content_hash

    @property
    def words(self) -> str:
        """Words for its data set in messages."""
        return "recorded"


Case = SceneCase | RecordedCase


@dataclass(frozen=True)
class Only:
    """Selection of cases, seeds and solvers of a suite; an empty tuple selects all.

    Solvers have the names that tables show.
    """

    cases: tuple[str, ...] = ()
    seeds: tuple[int, ...] = ()
    solvers: tuple[str, ...] = ()

    def select(self, cases: list[Case]) -> list[Case]:
        """Select the wanted cases, each with the wanted solvers.

        Raises InputError: a case, seed or solver that the suite does not have.
        """
        _check_known("case", self.cases, {case.name for case in cases})
        _check_known("seed", self.seeds, {case.shown_seed for case in cases})
        shown = {entry.shown for case in cases for entry in case.solvers}
        _check_known("solver", self.solvers, shown)
        wanted = (
            case
            for case in cases
            if _among(case.name, self.cases) and _among(case.shown_seed, self.seeds)
        )
        selected = [
            replace(
                case,
                solvers=tuple(entry for entry in case.solvers if _among(entry.shown, self.solvers)),
            )
            for case in wanted
        ]
        return [case for case in selected if case.solvers]


def _among(value: Any, wanted: tuple[Any, ...]) -> bool:
    return not wanted or value in wanted


def _check_known(what: str, wanted: tuple[Any, ...], available: set[Any]) -> None:
    for value in wanted:
        if value not in available:
            raise InputError(
                f"--{what} {value}: expected one of {', '.join(map(str, sorted(available)))}"
            )


WHOLE = Only()  # the whole suite
