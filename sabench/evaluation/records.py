"""Records of runs, as JSON lines.

Many processes may append to a file without losing or tearing a line. Readers do not trust its
content.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

from filelock import FileLock
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from sabench.api.solvers import TaskName
from sabench.utils.progress import console
from sabench.utils.validation import sentences

Record = dict[str, Any]
FORMAT, VERSION = "sabench-record", 2
Difficulty = Literal["easy", "standard", "hard"]

_RUN = ("scene_hash", "seed", "split", "renderer", "solver", "parameters", "machine", "submission")


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, strict=True, allow_inf_nan=False)


class Submission(_Part):
    """Name of the sender of a result, and the date."""

    name: str = Field(min_length=1, max_length=80)
    date: str = Field(pattern=r"^\d{4}-\d{2}-\d{2}$")


class Head(_Part):
    """Record without its scores.

    They follow as further keys: one for each score of its task, a number or null.
    """

    model_config = ConfigDict(extra="allow")

    format: Literal["sabench-record"] = "sabench-record"
    version: Literal[1, 2] = 2
    suite: str | None = Field(None, description="the suite that made it")
    case: str | None = Field(None, description="by default the scene's name")
    scene: str
    difficulty: Difficulty | None = None
    axis: str | None = Field(
        None, description="property that differs from the standard case: density, cameras, ..."
    )
    axes: dict[str, Any] = Field({}, description="dotted keys of the scene with this case's values")
    scene_hash: str
    dataset: str = Field(description="content hash of the data set")
    identity: str | None = Field(
        None, description="of the data set on every processor; missing for private test sets"
    )
    seed: int = Field(description="of the data set; its number in a private test set")
    split: Literal["public", "hidden"] = "public"
    renderer: str
    task: TaskName = "reconstruction"
    solver: str
    label: str | None = Field(None, description="shown in place of the solver's name")
    parameters: dict[str, Any]
    code_hash: str | None = Field(
        None, description="of the program that solved: sabench and the solver's file"
    )
    run_hash: str
    submission: Submission | None = None
    versions: dict[str, Any]
    machine: dict[str, Any]
    pictures: str | None = Field(None, description="folder of the case's figures")
    command: str | None = Field(None, description="command that reproduces this record")
    reference_s: float | None = Field(
        None, description="seconds of the reference kernel, timed in the same run"
    )
    error: str | None = None
    declined: bool = Field(False, description="whether the solver declined the case")

    @model_validator(mode="before")
    @classmethod
    def _from_version_1(cls, values: Any) -> Any:
        """Rename the key that version 1 used for the task."""
        if isinstance(values, dict) and values.get("version", 1) == 1:
            values = {"task" if key == "track" else key: one for key, one in values.items()}
            values["version"] = VERSION
        return values


def read_records(folder: Path) -> list[Record]:
    """Read all records of a folder's *.jsonl files and fill in defaults.

    The order is that of the files' names and of their lines. A line that is no record is left out,
    with a message on standard error; the torn last line of a killed run is left out without a
    message.
    """
    return [record for path in sorted(folder.glob("*.jsonl")) for record in _read_file(path)]


def _read_file(path: Path) -> Iterator[Record]:
    lines = path.read_bytes().split(b"\n")
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        try:
            yield parse(line)
        except (ValueError, RecursionError) as error:
            if number < len(lines):  # the last piece of the split follows the last newline
                text = f"{path}: line {number} is left out: expected a record, got {error}"
                console.print(text, style="red", markup=False, highlight=False, soft_wrap=True)


def parse(line: bytes) -> Record:
    """Parse one line as a record.

    Raises
    ------
    ValueError
        Anything else than a record; the text gives the reason.
    """
    value = json.loads(line.decode("utf-8"), parse_constant=_refuse)
    if not isinstance(value, dict):
        raise ValueError(f"a {type(value).__name__}")
    try:
        return Head.model_validate(value).model_dump()
    except ValidationError as error:
        raise ValueError("; ".join(sentences(Head, error))) from error


def _refuse(constant: str) -> None:
    raise ValueError(f"the number {constant}, which JSON does not have")


def append(path: Path, record: Record) -> None:
    """Append one line and flush it to the disk.

    The torn last line of a killed run is removed first. Many processes may append simultaneously.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    line = (
        json.dumps(
            {"format": FORMAT, "version": VERSION, **record}, sort_keys=True, allow_nan=False
        ).encode()
        + b"\n"
    )
    with FileLock(path.with_name(f".{path.name}.lock")), path.open("a+b") as file:
        file.truncate(_whole(file))
        file.write(line)
        file.flush()
        os.fsync(file.fileno())


def _whole(file: Any) -> int:
    """Count the bytes up to the last newline, which is searched from the end."""
    end, piece = file.seek(0, os.SEEK_END), 1 << 16
    while end > 0:
        start = max(0, end - piece)
        file.seek(start)
        newline = file.read(end - start).rfind(b"\n")
        if newline >= 0:
            return int(start + newline + 1)
        end = start
    return 0


def latest(records: list[Record]) -> list[Record]:
    """Select the last record of each run, in the order of the first ones.

    Records of one run have the same scene, seed, split, renderer, solver, parameters, machine and
    submission.
    """
    return list({key_of(record, _RUN): record for record in records}.values())


def key_of(record: Record, names: tuple[str, ...]) -> str:
    """Combine the given values of a record in one text."""
    return json.dumps([record.get(name) for name in names], sort_keys=True)
