"""Baselines: earlier figures of a suite, with the tolerance of each."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from sabench import plugins, tasks
from sabench.tasks.quality import FIGURES
from sabench.tasks.task import Figures, Score
from sabench.utils.errors import InputError
from sabench.utils.files import canonical_json, complete_or_nothing, read_json
from sabench.utils.validation import validate

DATA = "data set"  # in place of a solver for the figures of the data set itself
TIMES = ("seconds", "reconstruction_s")
COMPARED_COSTS = (*TIMES, "peak_mb")
QUALITY = "quality."  # begins the names of figures that need no truth


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


def default_tolerance(task: str, figure: str) -> Tolerance:
    """Compute the tolerance of a figure by the rule, unless it was edited.

    docs/developing/gates.md explains the numbers.
    """
    if task == DATA:
        return _data_tolerance(figure)
    score = score_of(task, figure)
    if score.unit == "MB":
        return Tolerance(relative=1.0, absolute=200.0)
    if score.unit == "s":
        return Tolerance(relative=2.0, absolute=0.5)
    if score.counted:
        return Tolerance(relative=0.0, absolute=2.0 if score.unit == "%" else 0.02)
    return Tolerance(relative=0.01, absolute=10.0**-score.decimals)


def score_of(task: str, figure: str) -> Score:
    """Look up a score of a task, or a figure without truth."""
    if figure.startswith(QUALITY):
        return FIGURES[figure.removeprefix(QUALITY)]
    return tasks.of(task).score_of(figure)


def kind_of(task: str, figure: str) -> str:
    """Return the kind of a figure, which selects its tolerance.

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


def default_path(suite: Path) -> Path:
    """Return the path of a suite's baseline: bundled, or else next to its file."""
    if suite.resolve().parent in [folder.resolve() for folder in plugins.suite_folders()]:
        return plugins.bundled_folder("leaderboard") / "baselines" / f"{suite.stem}.json"
    return suite.with_suffix(".baseline.json")


def read_baseline(path: Path, suite: str) -> Baseline:
    """Read the baseline of a suite.

    Raises InputError: no such file, not a baseline, one of another version or of another suite, or
    one with missing entries.
    """
    if not path.exists():
        raise InputError(
            f"{path}: expected a baseline of suite {suite}, but there is no file: make it "
            "with --update, in pytest with --sabench-update, and commit it"
        )
    values = read_json(path)
    form, version = (Baseline.model_fields[key].default for key in ("format", "version"))
    if not isinstance(values, dict) or values.get("format") != form:
        raise InputError(
            f"{path}: expected a baseline, that is a JSON object of the format {form!r}"
        )
    if values.get("version") != version:
        raise InputError(
            f"{path}: expected version {version}, got {values.get('version')!r}: make it anew with "
            "--update"
        )
    baseline = validate(Baseline, values, str(path))
    if baseline.suite != suite:
        raise InputError(
            f"{path}: expected a baseline of the suite {suite}, got one of {baseline.suite}"
        )
    return baseline


def write_baseline(path: Path, baseline: Baseline) -> None:
    """Write a baseline atomically as canonical JSON: equal ones give equal bytes."""
    with complete_or_nothing(path, overwrite=True) as partial:
        partial.write_text(canonical_json(baseline.model_dump(mode="json")), encoding="utf-8")


def tolerance_of(tolerances: Tolerances, task: str, figure: str) -> Tolerance:
    """Look a tolerance up in the baseline's table; else use the default."""
    kind = kind_of(task, figure)
    return tolerances.get(task, {}).get(kind) or default_tolerance(task, kind)
