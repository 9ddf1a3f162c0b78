"""Schema of records: types, lengths and ranges.

A record may come from anybody.
"""

from __future__ import annotations

import datetime
import json
import math
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import PurePosixPath
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    ValidationError,
    field_validator,
    model_validator,
)

from sabench import tasks
from sabench.api.solvers import TaskName
from sabench.dataset.results import MOST_ITERATIONS
from sabench.evaluation.solver_card import LONGEST_TEXT, SolverCard
from sabench.tasks.quality import FIGURES
from sabench.tasks.task import LARGEST, Score
from sabench.utils.errors import LISTED, one_line
from sabench.utils.files import LONGEST_PART
from sabench.utils.validation import printable, sentences

Record = dict[str, Any]
Difficulty = Literal["easy", "standard", "hard"]

LONGEST_NAME = 200  # characters
_DEEPEST = 20  # tables and lists within each other
_ROUNDING = 1e-6  # margin of rounding around the range of a score


def _check_printable(text: str) -> str:
    if not text.isprintable():
        raise ValueError(f"expected printable characters, got {printable(text)!r}")
    return text


def _check_date(text: str) -> str:
    try:
        datetime.datetime.fromisoformat(text)
    except ValueError:
        raise ValueError(f"expected a date, got {text!r}") from None
    return text


Name = Annotated[
    str, Field(min_length=1, max_length=LONGEST_NAME), AfterValidator(_check_printable)
]
_Line = Annotated[str, AfterValidator(_check_printable)]
_Time = Annotated[
    str, Field(pattern=r"^\d{4}-\d{2}-\d{2}T\d{2}:\d{2}:\d{2}Z$"), AfterValidator(_check_date)
]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, strict=True, allow_inf_nan=False)


def _check_iteration(values: list[float]) -> list[float]:
    number, seconds, score = values
    if not (number >= 1 and 0.0 <= seconds <= LARGEST and -1.0 <= score <= 1.0):
        raise ValueError(f"expected an iteration, seconds and a score up to 1, got {values}")
    return values


Iteration = Annotated[
    list[float], Field(min_length=3, max_length=3), AfterValidator(_check_iteration)
]


class Submission(_Part):
    """Name of the sender of a result, and the date."""

    name: Name
    date: Annotated[str, Field(pattern=r"^\d{4}-\d{2}-\d{2}$"), AfterValidator(_check_date)]


class JudgedQuality(_Part):
    """Figures of a result that need no truth, and the options that they depend on."""

    frames: int = Field(ge=1, description="number that was compared with their images")
    again: bool = Field(description="whether the solver ran again with fewer cameras")
    figures: dict[str, Any]

    @field_validator("figures")
    @classmethod
    def _check_figures(cls, values: dict[str, Any]) -> dict[str, Any]:
        if unknown := [key for key in values if key not in FIGURES]:
            raise ValueError(f"expected {', '.join(FIGURES)}, got {printable(unknown[0])!r}")
        if faults := list(_faults(FIGURES.values(), values)):
            raise ValueError("; ".join(faults))
        return values


class RecordHead(_Part):
    """Record without its scores.

    They follow as further keys: one for each score of its task, a number or null.
    """

    model_config = ConfigDict(extra="allow")

    format: Literal["sabench-record"] = "sabench-record"
    version: Literal[2] = 2
    suite: Name | None = Field(None, description="the suite that made it")
    case: Name | None = Field(None, description="by default the scene's name")
    scene: Name = Field(description='its name; "private" if it is not disclosed')
    difficulty: Difficulty | None = None
    axis: Name | None = Field(
        None, description="property that differs from the standard case: density, cameras, ..."
    )
    axes: dict[str, Any] = Field({}, description="dotted keys of the scene with this case's values")
    scene_hash: Name = Field(
        description="the data set's hash if the scene is not disclosed, or for a recording"
    )
    dataset: Name = Field(description="content hash of the data set")
    identity: Name | None = Field(
        None, description="of the data set on every processor; missing for private test sets"
    )
    seed: int = Field(
        ge=0,
        lt=2**63,
        description="of the data set; its number in a private test set; 0 for a recording",
    )
    split: Literal["public", "hidden"] = "public"
    renderer: Name
    recorded: bool = Field(False, description="whether the data set is recorded: without truth")
    quality: JudgedQuality | None = Field(None, description="of a recorded data set's result")
    task: TaskName = "reconstruction"
    solver: Name
    label: Name | None = Field(None, description="shown in place of the solver's name")
    parameters: dict[str, Any]
    code_hash: Name | None = Field(
        None, description="of the program that solved: sabench and the solver's file"
    )
    run_hash: Name
    estimate_hash: Name | None = Field(None, description="of the arrays that the solver returned")
    submission: Submission | None = None
    card: SolverCard | None = Field(None, description="of a submission's solver")
    same_estimates_as: Name | None = Field(
        None, description="solver entry whose estimates a submission repeats under another name"
    )
    date: _Time | None = Field(None, description="when the score was known; UTC")
    versions: dict[str, Any]
    machine: dict[str, Any]
    pictures: Name | None = Field(None, description="folder of the case's figures")
    command: _Line | None = Field(None, description="command that reproduces this record")
    reference_s: float | None = Field(
        None, ge=0, le=LARGEST, description="seconds of the reference kernel, timed in the same run"
    )
    iterations: list[Iteration] | None = Field(
        None,
        max_length=MOST_ITERATIONS,
        description="number, seconds so far and first score after iterations of the first frame",
    )
    isolated: bool | None = Field(
        None, description="whether the solver ran confined to the observation side"
    )
    whole_process: bool | None = Field(
        None, description="whether `seconds` are those of a program's whole process, from its start"
    )
    error: str | None = None
    declined: bool = Field(False, description="whether the solver declined the case")

    @field_validator("pictures")
    @classmethod
    def _check_folder(cls, name: str | None) -> str | None:
        parts = PurePosixPath(name or "a").parts
        long = any(len(part.encode("utf-8", "replace")) > LONGEST_PART for part in parts)
        if long or ".." in parts or "/" in parts or "\\" in (name or ""):
            raise ValueError(f"expected a folder among the figures, got {printable(str(name))!r}")
        return name

    @model_validator(mode="after")
    def _check_scores(self) -> RecordHead:
        values = self.model_extra or {}
        faults = [*score_faults(self.task, values), *_other_faults(self.task, values)]
        if faults := [*faults, *self._truth_faults(values)]:
            raise ValueError("; ".join(faults))
        return self

    def _truth_faults(self, values: Record) -> Iterator[str]:
        """Find scores that need truth where there is none, and the opposite."""
        if self.quality is not None and not self.recorded:
            yield "quality: expected none of a data set that is not recorded"
        for score in tasks.of(self.task).scores if self.recorded else ():
            if values.get(score.key) is not None:
                yield f"{score.key}: expected no score of a recorded data set, which has no truth"


def parse_record(line: bytes) -> Record:
    """Parse one line as a record.

    Raises ValueError: anything else than a record; the text gives the reason in one short sentence.
    """
    if len(line) > LONGEST_TEXT:
        raise ValueError(f"more than {LONGEST_TEXT} bytes")
    value = json.loads(
        line.decode("utf-8"),
        parse_constant=_refuse,
        parse_float=_parse_number,
        object_pairs_hook=_make_table,
    )
    if not isinstance(value, dict):
        raise ValueError(f"a {type(value).__name__}")
    # count tables and lists within each other, without recursion
    depth, level = 0, [value]
    while level := [part for part in level if isinstance(part, dict | list)]:
        depth += 1
        level = [
            inner for part in level for inner in (part.values() if isinstance(part, dict) else part)
        ]
    if depth > _DEEPEST:
        raise ValueError(f"more than {_DEEPEST} tables and lists within each other")
    try:
        return RecordHead.model_validate(value).model_dump()
    except ValidationError as error:
        raise ValueError(one_line("; ".join(sentences(RecordHead, error)), LISTED)) from error


def score_faults(task: str, values: Record) -> Iterator[str]:
    """Find values that scores of a task cannot have, one sentence each."""
    yield from _faults((*tasks.of(task).all_scores, *tasks.of(task).curve), values)


def _faults(scores: Iterable[Score], values: Record) -> Iterator[str]:
    for score in scores:
        value = values.get(score.key)
        low, high = score.range
        if value is None:
            continue
        if isinstance(value, bool) or not isinstance(value, int | float):
            yield f"{score.key}: expected a number or null, got {printable(repr(value))}"
        elif not low - _ROUNDING <= value <= high + _ROUNDING:
            bounds = f"at least {low:g}" if high == LARGEST else f"{low:g} to {high:g}"
            yield f"{score.key}: expected {bounds}, got {printable(repr(value))}"


def _other_faults(task: str, values: Record) -> Iterator[str]:
    """Find faults of unknown keys: each holds one short value."""
    keys = {score.key for score in tasks.of(task).all_scores}
    for key, value in values.items():
        if key in keys:
            continue
        if len(key) > LONGEST_NAME or not key.isprintable():
            yield f"expected short printable keys, got {printable(key)!r}"
        elif isinstance(value, dict | list) or len(str(value)) > LONGEST_NAME:
            yield f"{printable(key)}: expected one short value, got {printable(repr(value))}"


def _refuse(constant: str) -> None:
    raise ValueError(f"the number {constant}, which JSON does not have")


def _parse_number(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"the number {printable(text, 30)}, which is too large")
    return value


def _make_table(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table = dict(pairs)
    if len(table) < len(pairs):
        twice = Counter(key for key, _ in pairs).most_common(1)[0][0]
        raise ValueError(f"the key {printable(twice)!r} twice")
    return table
