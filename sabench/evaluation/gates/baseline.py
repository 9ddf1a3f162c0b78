"""Baselines: earlier figures of a suite, with the tolerance of each.

A comparison finds the figures that moved by more than their tolerance.
"""

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
DATA = "data set"  # stands for a solver where the figures are those of the data set itself
TIMES = ("seconds", "reconstruction_s")
COSTS = (*TIMES, "peak_mb")
Figures = dict[str, float | None]


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Tolerance(_Part):
    """Tolerance of a figure: `relative` times its baseline, or `absolute`.

    The larger of the two applies.
    """

    relative: float = Field(ge=0.0)
    absolute: float = Field(ge=0.0)

    def allowed(self, value: float) -> float:
        """Compute how far a figure with this baseline may move."""
        return max(self.relative * abs(value), self.absolute)


class Entry(_Part):
    """Figures of one solver on a case, or the reason why it failed."""

    figures: Figures = {}
    error: str | None = None
    reference_s: float | None = Field(
        None, gt=0.0, description="seconds of the reference kernel in the same process"
    )


class CaseEntry(_Part):
    """One data set: its statistics, and the entries of solvers.

    Solvers go by their names or labels.
    """

    case: str
    seed: int
    renderer: str
    scene_hash: str
    data: Figures
    solvers: dict[str, Entry]

    @property
    def key(self) -> tuple[str, int]:
        """Case and seed."""
        return self.case, self.seed


class Baseline(_Part):
    """Figures of a whole suite, and their tolerances.

    Tolerances go by task - or `data set` - and kind of figure.
    """

    format: Literal["sabench-baseline"] = "sabench-baseline"
    version: Literal[1] = 1
    suite: str
    sabench: str
    machine: dict[str, Any]
    versions: dict[str, str]
    tolerances: dict[str, dict[str, Tolerance]]
    cases: tuple[CaseEntry, ...]

    def case(self, key: tuple[str, int]) -> CaseEntry | None:
        """Find the case of a name and seed."""
        return next((case for case in self.cases if case.key == key), None)


Tolerances = Mapping[str, Mapping[str, Tolerance]]


@dataclass(frozen=True)
class Finding:
    """Figure that moved beyond its tolerance, or case or solver that changed.

    Attributes
    ----------
    worse : whether it fails the gate; else it is news.
    before, now : the figure; None where there is none. Times are scaled to the baseline's machine.
    tolerance : how far it may move, None where that does not apply.
    text : description, where there is no figure.
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
        """Change of the figure."""
        return None if self.before is None or self.now is None else self.now - self.before

    @property
    def sentence(self) -> str:
        """The finding in one line."""
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
    """Compute the tolerance of a figure by the rule, unless it was edited.

    docs/developing/gates.md explains the numbers.
    """
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
    """Return the kind of a figure, by which its tolerance is found.

    It is the figure's name; for a figure of a data set it is the part of the name that cameras and
    frames have in common.
    """
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
    """Return the path of a suite's bundled baseline."""
    return plugins.bundled_folder("leaderboard") / "baselines" / f"{suite}.json"


def read_baseline(path: Path, suite: str) -> Baseline:
    """Read the baseline of a suite.

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
    """Write a baseline atomically.

    It is canonical JSON: equal baselines give equal bytes.
    """
    with complete_or_nothing(path, overwrite=True) as partial:
        partial.write_text(canonical_json(baseline.model_dump(mode="json")), encoding="utf-8")


def tolerance_of(tolerances: Tolerances, task: str, figure: str) -> Tolerance:
    """Look a tolerance up in the baseline's table; else use the default."""
    kind = kind_of(task, figure)
    return tolerances.get(task, {}).get(kind) or default_tolerance(task, kind)


def loss(better: Better, before: float, now: float) -> float:
    """Compute by how much a figure got worse; negative: better.

    Signed errors count by their absolute values.
    """
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
    """Compare the figures of one case with the baseline's.

    `served` has each solver's task. A solver of the baseline that did not run counts as worse; a
    new solver is news.
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
    """Compare whether a solver ran and failed before and now.

    Returns whether the gate fails, and the text, for a solver that is missing, new, failed or
    mended; else None.
    """
    if new is None:
        return True, "it is in the baseline but did not run"
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
    """Scale the times of a new entry to the machine and load of the old one.

    The factor is the ratio of the reference kernel's times.
    """
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
    """List the figures beyond tolerance: name, tolerance and loss.

    The loss is infinite for a figure that is missing now, and minus infinity for a new one.
    """
    for figure in sorted({**before, **now}):
        old, new = before.get(figure), now.get(figure)
        if old is None or new is None:
            if old is not new:
                yield figure, None, math.inf if new is None else -math.inf
            continue
        allowed = tolerance_of(tolerances, task, figure).allowed(old)
        better: Better = "steady" if task == DATA else tasks.of(task).score_of(figure).better
        change = loss(better, old, new)
        if abs(change) > allowed:
            yield figure, allowed, change
