"""Baselines: the figures of a suite as they were, how far each may move, and what has moved further."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from sabench import plugins, tasks
from sabench.tasks.task import Better
from sabench.utils.errors import InputError
from sabench.utils.files import canonical_json, complete_or_nothing, read_json
from sabench.utils.validation import validate

FORMAT, VERSION = "sabench-baseline", 1
DATA = "data set"  # stands in a solver's place where figures are of the data set itself
TIMES = ("seconds", "reconstruction_s")
COSTS = (*TIMES, "peak_mb")
Figures = dict[str, float | None]


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Tolerance(_Part):
    """A figure may move by the larger of `relative` times its baseline and `absolute`."""

    relative: float = Field(ge=0.0)
    absolute: float = Field(ge=0.0)

    def of(self, value: float) -> float:
        """How far a figure of this baseline may move."""
        return max(self.relative * abs(value), self.absolute)


class Entry(_Part):
    """What one solver made of a case, or why it failed."""

    figures: Figures = {}
    error: str | None = None
    reference_s: float | None = Field(
        None, gt=0.0, description="seconds of the reference kernel in the same process"
    )


class CaseEntry(_Part):
    """One data set: what it is, and what solvers made of it, by their names or labels."""

    case: str
    seed: int
    renderer: str
    scene_hash: str
    data: Figures
    solvers: dict[str, Entry]

    @property
    def key(self) -> tuple[str, int]:
        """What it is known by."""
        return self.case, self.seed


class Baseline(_Part):
    """A whole suite's figures, and their tolerances by task - or `data set` - and kind of figure."""

    format: Literal["sabench-baseline"] = "sabench-baseline"
    version: Literal[1] = 1
    suite: str
    sabench: str
    machine: dict[str, Any]
    versions: dict[str, str]
    tolerances: dict[str, dict[str, Tolerance]]
    cases: tuple[CaseEntry, ...]

    def case(self, key: tuple[str, int]) -> CaseEntry | None:
        """The case of a name and seed."""
        return next((case for case in self.cases if case.key == key), None)


Tolerances = Mapping[str, Mapping[str, Tolerance]]


@dataclass(frozen=True)
class Finding:
    """A figure that has moved beyond its tolerance, or a case or solver that is not what it was.

    Attributes
    ----------
    worse : it fails the gate; else it is news.
    before, now : the figure; None where there is none. Times are as the baseline's machine would
        have them.
    tolerance : how far it may move, None where that does not apply.
    text : what happened, where there is no figure.
    """

    case: str
    seed: int
    solver: str
    figure: str
    before: float | None
    now: float | None
    tolerance: float | None
    worse: bool
    text: str = ""

    @property
    def change(self) -> float | None:
        """By how much."""
        return None if self.before is None or self.now is None else self.now - self.before

    @property
    def sentence(self) -> str:
        """All of it in a line."""
        where = f"{self.case}, seed {self.seed}: {self.solver}"
        if self.text:
            return f"{where}: {self.text}"
        was, is_ = (
            "none" if value is None else f"{value:.6g}" for value in (self.before, self.now)
        )
        moved = "" if self.change is None else f", {self.change:+.3g}"
        beyond = "" if self.tolerance is None else f" where {self.tolerance:.3g} is allowed"
        return f"{where}: {self.figure}: {was} before, {is_} now{moved}{beyond}"


def default_tolerance(task: str, figure: str) -> Tolerance:
    """Apply the rule behind tolerances that nobody has edited; docs/developing/gates.md explains its numbers."""
    if task == DATA:
        return _data_tolerance(figure)
    score = tasks.of(task).score_of(figure)
    if score.unit == "MB":
        return Tolerance(relative=1.0, absolute=200.0)
    if score.unit == "s":
        return Tolerance(relative=2.0, absolute=0.5)
    if score.counted:
        return Tolerance(relative=0.0, absolute=2.0 if score.unit == "%" else 0.02)
    return Tolerance(relative=0.01, absolute=10.0**-score.decimals)


def kind_of(task: str, figure: str) -> str:
    """What a figure's tolerance is found by: its name, of a data set's figure what it has in common with those of other cameras and frames."""
    if task != DATA:
        return figure
    return "probe" if figure.startswith("probe.") else figure.rpartition(".")[2]


def _data_tolerance(kind: str) -> Tolerance:
    if kind == "probe":
        return Tolerance(relative=1e-3, absolute=1e-4)
    if kind in ("retraced_px", "sightline_mm"):
        return Tolerance(relative=0.0, absolute=1e-6)
    if kind.startswith(("grey_", "found")):
        return Tolerance(relative=1e-3, absolute=2e-3)
    return Tolerance(relative=1e-5, absolute=1e-6)


def default_path(suite: str) -> Path:
    """Where the bundled baseline of a suite is."""
    return plugins.bundled("leaderboard") / "baselines" / f"{suite}.json"


def read_baseline(path: Path, suite: str) -> Baseline:
    """The baseline of a suite.

    Raises
    ------
    InputError
        No such file, not a baseline, one of another version or of another suite, or one with
        missing entries.
    """
    if not path.exists():
        raise InputError(
            f"{path}: expected a baseline of the suite {suite}, but there is no file: --update "
            "makes one (in pytest --sabench-update)"
        )
    values = read_json(path)
    if not isinstance(values, dict) or values.get("format") != FORMAT:
        raise InputError(
            f"{path}: expected a baseline, that is a JSON object of the format {FORMAT!r}"
        )
    if values.get("version") != VERSION:
        raise InputError(
            f"{path}: expected version {VERSION}, got {values.get('version')!r}: make it anew with "
            "--update"
        )
    found = validate(Baseline, values, str(path))
    if found.suite != suite:
        raise InputError(
            f"{path}: expected a baseline of the suite {suite}, got one of {found.suite}"
        )
    return found


def write_baseline(path: Path, baseline: Baseline) -> None:
    """Write it whole or not at all, as canonical JSON: equal baselines give equal bytes."""
    with complete_or_nothing(path, overwrite=True) as partial:
        partial.write_text(canonical_json(baseline.model_dump(mode="json")), encoding="utf-8")


def tolerance_of(tolerances: Tolerances, task: str, figure: str) -> Tolerance:
    """As the baseline's table says, else the default."""
    kind = kind_of(task, figure)
    return tolerances.get(task, {}).get(kind) or default_tolerance(task, kind)


def loss(better: Better, before: float, now: float) -> float:
    """Say by how much a figure got worse; negative: better. Signed errors count by their size."""
    if better == "steady":
        return abs(now - before)
    if better == "larger":
        return before - now
    if better == "unity":
        return abs(now - 1.0) - abs(before - 1.0)
    return abs(now) - abs(before)


def compare(
    before: CaseEntry, now: CaseEntry, served: Mapping[str, str], tolerances: Tolerances
) -> Iterator[Finding]:
    """What has moved too far in one case; `served` has each solver's task.

    Solvers of the baseline that did not run now are worse, those that are new are news.
    """
    case, seed = now.key
    for figure, allowed, change in _moved(before.data, now.data, tolerances, DATA):
        yield Finding(
            case,
            seed,
            DATA,
            figure,
            before.data.get(figure),
            now.data.get(figure),
            allowed,
            worse=change > 0.0,
        )
    for solver in {**before.solvers, **now.solvers}:
        old, new = before.solvers.get(solver), now.solvers.get(solver)
        said = _standing(old, new)
        if said is not None:
            worse, text = said
            yield Finding(case, seed, solver, "", None, None, None, worse=worse, text=text)
        elif old is not None and new is not None:
            yield from _of_solver(now, solver, served[solver], old, scaled(new, old), tolerances)


def _standing(old: Entry | None, new: Entry | None) -> tuple[bool, str] | None:
    """Whether a solver that is missing, new, failed or mended makes the gate fail, and what to say."""
    if new is None:
        return True, "it is in the baseline and did not run"
    if old is None:
        return False, f"not in the baseline{': ' + new.error if new.error else ''}"
    if new.error and not old.error:
        return True, f"failed: {new.error}"
    if old.error and not new.error:
        return False, "it failed before and does not now"
    return None


def _of_solver(
    case: CaseEntry, solver: str, task: str, old: Entry, new: Entry, tolerances: Tolerances
) -> Iterator[Finding]:
    for figure, allowed, change in _moved(old.figures, new.figures, tolerances, task):
        yield Finding(
            *case.key,
            solver,
            figure,
            old.figures.get(figure),
            new.figures.get(figure),
            allowed,
            worse=change > 0.0,
        )


def scaled(new: Entry, old: Entry) -> Entry:
    """Times as the machine and moment of the old entry would have them: by the reference kernel's."""
    if not new.reference_s or not old.reference_s:
        return new
    times = {
        key: value * old.reference_s / new.reference_s
        for key in TIMES
        if (value := new.figures.get(key)) is not None
    }
    return new.model_copy(update={"figures": new.figures | times, "reference_s": old.reference_s})


def _moved(
    before: Figures, now: Figures, tolerances: Tolerances, task: str
) -> Iterator[tuple[str, float | None, float]]:
    """Figures beyond tolerance, what is allowed, and by how much they got worse: infinitely if they are lost, minus that if they are new."""
    for figure in sorted({**before, **now}):
        old, new = before.get(figure), now.get(figure)
        if old is None or new is None:
            if old is not new:
                yield figure, None, math.inf if new is None else -math.inf
            continue
        allowed = tolerance_of(tolerances, task, figure).of(old)
        better: Better = "steady" if task == DATA else tasks.of(task).score_of(figure).better
        change = loss(better, old, new)
        if abs(change) > allowed:
            yield figure, allowed, change
