"""Suite files: scenes with changes, seeds and solvers.

Everything in a suite is checked before any work starts.
"""

from __future__ import annotations

import itertools
import math
import re
import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, get_args

from pydantic import AliasChoices, BaseModel, ConfigDict, Field, model_validator

from sabench import plugins
from sabench.api.make import make_algorithm
from sabench.api.solvers import TaskName
from sabench.evaluation.hidden_split import Secret
from sabench.evaluation.records import Difficulty
from sabench.scenes import Scene, build_rig, find, load_scene, parse_scene
from sabench.simulation.renderer_choice import Renderer, choose_renderer
from sabench.tasks.external_programs import find_program, is_program, solver_name
from sabench.utils.code_hash import code_hash
from sabench.utils.errors import InputError
from sabench.utils.files import digest, is_file
from sabench.utils.processes.limited import Limits, limits_of
from sabench.utils.validation import validate

_SAFE = r"[A-Za-z0-9][A-Za-z0-9._-]*"  # as a part of a file name on every system
_MOST_CASES = 1000
_UNSAFE = re.compile(r"[^A-Za-z0-9._-]+")


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
    label: str | None = Field(None, description="shown in place of the name")
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
        algorithm = make_algorithm(self.name, self.parameters)
        return self.name, algorithm.task, algorithm.parameters.model_dump(mode="json")


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


def load_suite(path: str | Path, secret: Secret | None = None) -> tuple[Suite, list[Case]]:
    """Read a suite and check all its cases and solvers before any work starts.

    Parameters
    ----------
    secret : makes the private data sets of its cases, in place of the public ones.

    Raises
    ------
    InputError
        Anything wrong in the suite, in one of its scenes or in its changes, two cases of one name,
        or cases that differ from the frozen ones.
    """
    file = find(path, "scenes/suites")
    try:
        values = tomllib.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{file}: expected a TOML file, got {error}") from error
    suite = validate(Suite, values, str(file))
    own = suite.model_copy(
        update={"solvers": tuple(_resolve(solver_entry, file) for solver_entry in suite.solvers)}
    )
    specs = [
        spec.model_copy(
            update={"solvers": tuple(_resolve(solver_entry, file) for solver_entry in spec.solvers)}
        )
        for spec in _specs(own)
    ]
    if len(specs) > _MOST_CASES:
        raise InputError(f"{file}: scenes, cases: expected at most {_MOST_CASES}, got {len(specs)}")
    first = [case for spec in specs for case in _cases(spec, own, file)]
    _check_names([case.name for case in first], file)
    _check_frozen(own, first, file)
    return own, [
        replace(case, seed=seed, number=number)
        for case in first
        for number, seed in _seeds(own, case, file.stem, secret)
    ]


def _cases(spec: CaseSpec, suite: Suite, file: Path) -> Iterator[Case]:
    """Make all cases of a specification, with the suite's first seed."""
    renderer = choose_renderer(spec.backend or suite.backend)
    for name, base, axes, scene in _variants(spec, file):
        yield Case(
            name,
            base,
            axes,
            scene,
            suite.seeds[0],
            renderer,
            spec.solvers,
            spec.difficulty,
            spec.axis,
        )


def _seeds(
    suite: Suite, case: Case, name: str, secret: Secret | None
) -> list[tuple[int | None, int]]:
    """List the numbers and seeds of a case's data sets."""
    if secret is None:
        return [(None, seed) for seed in dict.fromkeys(suite.seeds)]
    return list(enumerate(secret.seeds_of(name, suite.version, case.name)))


def _check_frozen(suite: Suite, cases: list[Case], file: Path) -> None:
    """Check that the data sets of a frozen suite have not changed."""
    found = digest(
        [
            suite.version,
            list(suite.seeds),
            [[case.name, case.scene.hash, case.difficulty, case.axis] for case in cases],
        ]
    )
    if suite.frozen not in (None, found):
        raise InputError(
            f"{file}: frozen: expected the cases and seeds of version {suite.version}, whose hash "
            f"is {suite.frozen}, got others with {found}: "
            "a change needs a new version and its hash"
        )


def _resolve(solver: SolverEntry, file: Path) -> SolverEntry:
    """Check a solver entry, and find its program.

    The solver must exist and take its parameters. A program must have a task; its path becomes
    absolute.
    """
    if not solver.is_program:
        if any(
            value is not None
            for value in (
                solver.task,
                solver.time_limit_s,
                solver.memory_limit_mb,
            )
        ):
            raise InputError(
                f"{file}: solver {solver.name}: expected task, time_limit_s and memory_limit_mb "
                "for programs only"
            )
        make_algorithm(solver.name, solver.parameters)
        return solver
    if solver.task is None:
        known = ", ".join(get_args(TaskName))
        raise InputError(f"{file}: program {solver.name}: task: expected one of {known}, got none")
    return solver.model_copy(update={"name": str(find_program(solver.name, file.parent))})


def override(scene: Scene, values: Mapping[str, Any], source: str) -> Scene:
    """Replace values of a scene at some of its dotted keys.

    The new scene is checked as a scene file is; errors name `source`.
    """
    table = scene.to_dict()
    for key, value in values.items():
        _assign(table, key, value, source)
    changed = parse_scene(table, source)
    build_rig(changed, source)
    return changed


def _assign(table: dict[str, Any], key: str, value: Any, source: str) -> None:
    *path, last = key.split(".")
    for part in path:
        table = table.setdefault(part, {})
        if not isinstance(table, dict):
            raise InputError(f"{source}: {key}: expected a table at {part}, got {table!r}")
    table[last] = value


def _specs(suite: Suite) -> list[CaseSpec]:
    """List all cases, with the suite's own changes before theirs."""
    specs = (*(CaseSpec(scene=name) for name in suite.scenes), *suite.cases)
    inherited = (
        {
            "set": suite.set | spec.set,
            "vary": suite.vary | spec.vary,
            "solvers": spec.solvers or suite.solvers,
        }
        for spec in specs
    )
    return [spec.model_copy(update=update) for spec, update in zip(specs, inherited, strict=True)]


def _variants(spec: CaseSpec, suite: Path) -> Iterator[tuple[str, str, dict[str, Any], Scene]]:
    """Make name, base, axes and scene for every combination of the varied values."""
    beside = suite.parent / spec.scene
    count = math.prod(len(values) for values in spec.vary.values())
    if count > _MOST_CASES:
        raise InputError(
            f"{suite}: {spec.scene}: vary: expected at most {_MOST_CASES} cases, got {count}"
        )
    base, scene = Path(spec.scene).stem, load_scene(beside if is_file(beside) else spec.scene)
    for choice in itertools.product(*(enumerate(values, 1) for values in spec.vary.values())):
        axes = {key: value for key, (_, value) in zip(spec.vary, choice, strict=True)}
        tags = [
            _tag(key, value, number) for key, (number, value) in zip(spec.vary, choice, strict=True)
        ]
        name = "-".join([spec.name or _UNSAFE.sub("_", base), *tags])
        yield name, base, axes, override(scene, spec.set | axes, f"{suite}: case {name}")


def _tag(key: str, value: Any, number: int) -> str:
    """Name a varied value: `per_pixel_0.05`; lists and tables have their numbers."""
    shown = str(number) if isinstance(value, list | dict) else _UNSAFE.sub("_", str(value))
    return f"{key.rpartition('.')[2]}_{shown}"


def _check_names(names: list[str], file: Path) -> None:
    # some file systems do not distinguish a from A
    name, count = Counter(name.casefold() for name in names).most_common(1)[0]
    if count > 1:
        raise InputError(f"{file}: {count} cases are named {name}: give them names of their own")
