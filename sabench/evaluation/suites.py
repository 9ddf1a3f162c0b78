"""Suites: scenes with changes, seeds and solvers, and the cases that they become."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import AliasChoices, BaseModel, ConfigDict, Field, model_validator

from sabench import plugins
from sabench.api.solvers import TaskName
from sabench.evaluation.record_schema import Difficulty, Name
from sabench.scenes import Scene
from sabench.simulation.renderer_choice import Renderer
from sabench.tasks.external_programs import is_program, solver_name
from sabench.tasks.solve_and_score import describe_solver
from sabench.utils.code_hash import code_hash
from sabench.utils.processes.limited import Limits, limits_of

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
    task: TaskName | None = Field(
        None,
        validation_alias=AliasChoices("task", "track"),
        description="of a program: task of its results",
    )
    time_limit_s: float | None = Field(None, gt=0, description="of a program, for a data set")
    memory_limit_mb: float | None = Field(
        None, gt=0, description="of a program's processes together"
    )

    @property
    def is_program(self) -> bool:
        """True if the name is the path of a program."""
        return is_program(self.name)

    @property
    def limits(self) -> Limits | None:
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


class Suite(Changes):
    """Suite file: cases x seeds x solvers.

    Its own `set` and `vary` apply to all cases, before the cases' own.
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
        if not self.scenes and not self.cases:
            raise ValueError("scenes, cases: expected at least one scene in either")
        if not self.solvers and (self.scenes or not all(case.solvers for case in self.cases)):
            raise ValueError("solvers: expected at least one for every case")
        return self


@dataclass(frozen=True)
class Case:
    """One data set of a suite.

    Attributes
    ----------
    name : unique in its suite but for the seed, and safe as a file name.
    base : name of the scene that was changed.
    axes : the varied keys of the scene with this case's values.
    solvers : the solver entries that run on it.
    difficulty, axis : as given in the suite.
    number : its number among the private data sets of its case; None: it is public.
    """

    name: str
    base: str
    axes: Mapping[str, Any]
    scene: Scene
    seed: int
    renderer: str
    solvers: tuple[SolverEntry, ...] = ()
    difficulty: Difficulty | None = None
    axis: str | None = None
    number: int | None = None

    @property
    def shown_seed(self) -> int:
        """Seed of a public data set, or number of a private one."""
        return self.seed if self.number is None else self.number

    @property
    def seed_label(self) -> str:
        """Name of the data set among those of its case; it never has a private seed."""
        return f"seed{self.seed}" if self.number is None else f"hidden{self.number}"

    def folder(self, work: Path) -> Path:
        """Return the folder of its data set."""
        return (
            work
            / "datasets"
            / f"{self.name}-{self.scene.hash[:8]}-{self.renderer}-{self.seed_label}"
        )
