"""Suite files, read and checked before any work starts, and private test sets.

A suite becomes a list of cases, one for each combination of its varied values and each seed, and
one for each recording, which is scored without truth. The seeds of a private test set come from a
file with a secret, which only the organiser has.
"""

import copy
import functools
import hashlib
import hmac
import itertools
import math
import os
import re
import tomllib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, Field

from sabench import plugins
from sabench.api.solvers import TaskName
from sabench.dataset.reader import Dataset, open_dataset
from sabench.dataset.results import open_result
from sabench.dataset.schema import MANIFEST
from sabench.dataset.verification import verify
from sabench.evaluation.record_schema import LONGEST_NAME
from sabench.evaluation.solver_card import MOST_CASES
from sabench.evaluation.suites import (
    Case,
    CaseSpec,
    RecordedCase,
    RecordingSpec,
    SceneCase,
    SolverEntry,
    Suite,
)
from sabench.scenes import Scene, build_rig, find, load_scene, parse_scene
from sabench.scenes.loading import read_kind, read_scene
from sabench.tasks.external_programs import find_program
from sabench.tasks.quality import FIGURES_OF, quality, residual_picture
from sabench.tasks.solve_and_score import costs_of, describe_solver
from sabench.utils.backend import choose_renderer
from sabench.utils.errors import InputError
from sabench.utils.files import digest, is_file, is_folder
from sabench.utils.progress import say
from sabench.utils.validation import printable, validate


def recording_name(spec: RecordingSpec, suite: Path) -> str:
    """Name the case of a recording: by default as its folder."""
    return spec.name or _UNSAFE.sub("_", _place(spec, suite).name)


def open_recording(spec: RecordingSpec, suite: Path) -> RecordedCase:
    """Open the recorded data set of a suite.

    Raises InputError: no folder, one that is no data set, or a data set that is not recorded.
    """
    data = _open(_place(spec, suite), f"{suite}: recordings: {spec.folder}")
    name = recording_name(spec, suite)
    return RecordedCase(name=name, base=name, data=data, quality=spec.quality, solvers=spec.solvers)


def _place(spec: RecordingSpec, suite: Path) -> Path:
    return Path(os.path.normpath(suite.parent.absolute() / Path(spec.folder).expanduser()))


def _open(root: Path, source: str) -> Dataset:
    if not is_file(root / MANIFEST):
        got = f"found one without {MANIFEST}" if is_folder(root) else "found none"
        raise InputError(
            f"{source}: expected the folder of a recorded data set, {got}; `sabench import` makes "
            "one of images and cameras"
        )
    data = open_dataset(root)
    if data.has_truth:
        raise InputError(
            f"{source}: expected a recorded data set, got one with truth; name its scene in "
            f"`scenes` and its seed, {data.manifest.seed}, in `seeds`"
        )
    if not data.recorded:
        raise InputError(
            f"{source}: expected a recorded data set, got the observation side of one alone"
        )
    return data


def check_intact(case: RecordedCase) -> Dataset:
    """Return the data set of a recorded case, with the bytes that its case is about.

    Raises InputError: files are missing or damaged, or the data set has changed since the suite was
    read.
    """
    root = case.data.root
    if faults := verify(root):
        raise InputError(
            f"recording {case.name}: expected the files that were imported, but {faults[0]}"
        )
    if open_dataset(root).content_hash != case.data_hash:
        raise InputError(f"{root}: expected no change of the recording during the run")
    return case.data


@dataclass(frozen=True)
class Judged:
    """Scores of a result, or its figures without truth.

    Attributes
    ----------
    scores : scores as in its record.
    residuals : a PNG of the residuals of recorded images; None for other results.
    """

    scores: dict[str, Any]
    residuals: bytes | None = None


def judge(case: RecordedCase, out: Path) -> Judged:
    """Score a result of a recorded case by its images; its costs come with it.

    Results of tasks that have no figures without truth have their costs alone.
    """
    result = open_result(out, case.data)
    scores = {"task": result.task, "quality": None, **costs_of(result)}
    if result.task not in FIGURES_OF:
        return Judged(scores)
    options = case.quality
    judged = quality(case.data, out, frames=options.frames, solve_again=options.again)
    for note in judged.notes:
        say(f"note: {note}")
    scores["quality"] = {**options.model_dump(), "figures": judged.figures}
    left = judged.left
    return Judged(scores, None if left is None else residual_picture(case.data, left))


class Secret(BaseModel):
    """Content of the file: a secret, and the number of seeds of each case."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    secret: str = Field(min_length=16, description="random text, as from `openssl rand -hex 16`")
    seeds: int = Field(5, ge=1, description="data sets of each case")

    def seeds_of(self, suite: str, version: int, case: str) -> tuple[int, ...]:
        """Derive the seeds of a case from the secret.

        A seed is HMAC-SHA256 (RFC 2104) of suite, version, case and number, so that seeds disclose
        neither the secret nor each other.
        """
        purposes = (f"{suite}\0{version}\0{case}\0{number}" for number in range(self.seeds))
        drawn = (
            hmac.new(self.secret.encode(), purpose.encode(), hashlib.sha256).digest()
            for purpose in purposes
        )
        return tuple(int.from_bytes(mac[:8], "big") >> 1 for mac in drawn)


def read_secret(path: Path) -> Secret:
    """Read the secret of a TOML file.

    Raises InputError: no such file, no TOML, or a secret of fewer than 16 characters, which the
    error does not repeat.
    """
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{path}: expected a TOML file, got {type(error).__name__}") from error
    if isinstance(values.get("secret"), str) and len(values["secret"]) < 16:
        raise InputError(
            f"{path}: secret: expected 16 characters or more, got {len(values['secret'])}"
        )
    return validate(Secret, values, str(path))


_UNSAFE = re.compile(r"[^A-Za-z0-9._-]+")
Load = Callable[[str | Path], Scene]
_Table = TypeVar("_Table", Suite, CaseSpec, RecordingSpec)


def load_suite(path: str | Path, secret: Secret | None = None) -> tuple[Suite, list[Case]]:
    """Read a suite and check all its cases and solvers before any work starts.

    Parameters
    ----------
    secret : makes the private data sets of its scenes, in place of the public ones. Recordings
        have no seeds, and so no private ones.

    Raises InputError: anything wrong in the suite, in one of its scenes, changes or recordings, two
    cases of one name, or cases that differ from the frozen ones.
    """
    file = find(path, "scenes/suites")
    suite = _resolve(_read_suite(file), file)
    specs = [_resolve(spec, file) for spec in _specs(suite)]
    recordings = [
        _resolve(spec.model_copy(update={"solvers": spec.solvers or suite.solvers}), file)
        for spec in suite.recordings
    ]
    if (count := len(specs) + len(recordings)) > MOST_CASES:
        raise InputError(f"{file}: scenes, cases: expected at most {MOST_CASES}, got {count}")
    # before the scenes are built, which takes long
    names = [name for spec in specs for name, _ in _names(spec, file)]
    _check_names([*names, *(recording_name(spec, file) for spec in recordings)], file)
    recorded = [open_recording(spec, file) for spec in recordings]
    load = functools.cache(load_scene)  # most cases of a suite share their scene
    first = [case for spec in specs for case in _cases(spec, suite, file, load)]
    _check_frozen(suite, [*first, *recorded], file)
    if secret is not None and not first:
        raise InputError(
            f"{file}: expected scenes, of which a private test set is made, got recordings alone"
        )
    seeded = [
        replace(case, seed=seed, number=number)
        for case in first
        for number, seed in _seeds(suite, case, file.stem, secret)
    ]
    return suite, [*seeded, *([] if secret else recorded)]


def _read_suite(file: Path) -> Suite:
    return validate(Suite, read_kind(file, "suite"), str(file))


def is_public(scene_hash: str, seed: int) -> bool:
    """Check whether a bundled suite has a scene of that hash with that seed."""
    for entry in plugins.tables("suite"):
        seeds = tomllib.loads(entry.file.read_text(encoding="utf-8")).get("seeds", [1])
        if seed in seeds and scene_hash in scenes_of(entry.file):
            return True
    return False


@functools.cache
def scenes_of(file: Path) -> Mapping[str, Scene]:
    """Read a bundled suite's scenes by hash; their geometry needs no check."""
    read = functools.cache(read_scene)
    variants = (_variants(spec, file, read) for spec in _specs(_read_suite(file)))
    return {scene.hash: scene for *_, scene in itertools.chain.from_iterable(variants)}


def _cases(spec: CaseSpec, suite: Suite, file: Path, load: Load) -> Iterator[SceneCase]:
    """Make all cases of a specification, with the suite's first seed."""
    renderer = choose_renderer(spec.backend or suite.backend)
    for name, base, axes, scene in _variants(spec, file, load):
        build_rig(scene, f"{file}: case {name}")
        yield SceneCase(
            name=name,
            base=base,
            axes=axes,
            scene=scene,
            seed=suite.seeds[0],
            renderer=renderer,
            solvers=spec.solvers,
            difficulty=spec.difficulty,
            axis=spec.axis,
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
    current = digest(
        [
            suite.version,
            list(suite.seeds),
            [[case.name, case.data_hash, case.difficulty, case.axis] for case in cases],
        ]
    )
    if suite.frozen not in (None, current):
        raise InputError(
            f"{file}: frozen: expected the cases and seeds of version {suite.version}, whose hash "
            f"is {suite.frozen}, got others with {current}: "
            "a change needs a new version and its hash"
        )


def _resolve(table: _Table, file: Path) -> _Table:
    """Check the solver entries of a suite or of one of its cases."""
    solvers = tuple(_resolve_solver(entry, file) for entry in table.solvers)
    return table.model_copy(update={"solvers": solvers})


def _resolve_solver(solver: SolverEntry, file: Path) -> SolverEntry:
    """Check a solver entry, and find its program.

    The solver must exist and take its parameters. A program must have a task; its path becomes
    absolute.
    """
    if not solver.is_program:
        if any(
            value is not None
            for value in (solver.task, solver.time_limit_s, solver.memory_limit_mb)
        ):
            raise InputError(
                f"{file}: solver {solver.name}: expected task, time_limit_s and memory_limit_mb "
                "for programs only"
            )
        describe_solver(solver.name, solver.parameters)
        return solver
    if solver.task is None:
        names = ", ".join(get_args(TaskName))
        raise InputError(f"{file}: program {solver.name}: task: expected one of {names}, got none")
    return solver.model_copy(update={"name": str(find_program(solver.name, file.parent))})


def override(scene: Scene, values: Mapping[str, Any], source: str) -> Scene:
    """Replace values of a scene at some of its dotted keys.

    The new scene is checked as a scene file is; errors name `source`.
    """
    changed = _change(scene, values, source)
    build_rig(changed, source)
    return changed


def _change(scene: Scene, values: Mapping[str, Any], source: str) -> Scene:
    table = scene.to_dict()
    for key, value in values.items():
        _assign(table, key, copy.deepcopy(value), source)  # a later key may change this table
    return parse_scene(table, source)


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


def _variants(
    spec: CaseSpec, suite: Path, load: Load
) -> Iterator[tuple[str, str, dict[str, Any], Scene]]:
    """Make name, base, axes and scene for every combination of the varied values."""
    beside = suite.parent / spec.scene
    base, scene = Path(spec.scene).stem, load(beside if is_file(beside) else spec.scene)
    for name, axes in _names(spec, suite):
        yield name, base, axes, _change(scene, spec.set | axes, f"{suite}: case {name}")


def _names(spec: CaseSpec, suite: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    """Make name and axes for every combination of the varied values."""
    count = math.prod(len(values) for values in spec.vary.values())
    if count > MOST_CASES:
        raise InputError(
            f"{suite}: {spec.scene}: vary: expected at most {MOST_CASES} cases, got {count}"
        )
    base = _UNSAFE.sub("_", Path(spec.scene).stem)
    for choice in itertools.product(*(enumerate(values, 1) for values in spec.vary.values())):
        axes = {key: value for key, (_, value) in zip(spec.vary, choice, strict=True)}
        name = spec.name or base
        for key, (number, value) in zip(spec.vary, choice, strict=True):  # lists have numbers
            shown = number if isinstance(value, list | dict) else _UNSAFE.sub("_", str(value))
            name += f"-{key.rpartition('.')[2]}_{shown}"
        yield name, axes


def _check_names(names: list[str], file: Path) -> None:
    longest = max(names, key=len)
    if len(longest) > LONGEST_NAME:
        raise InputError(
            f"{file}: case {printable(longest)}: expected a name of at most {LONGEST_NAME} "
            f"characters, got {len(longest)}: give it a shorter one"
        )
    # some file systems do not distinguish a from A
    name, count = Counter(name.casefold() for name in names).most_common(1)[0]
    if count > 1:
        raise InputError(f"{file}: {count} cases are named {name}: give them names of their own")
