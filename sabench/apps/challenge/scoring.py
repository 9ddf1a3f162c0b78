"""Data sets of a challenge, and the scores of a submission on the server."""

import contextlib
import shutil
import tempfile
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from sabench import tasks
from sabench.api.solvers import TaskName
from sabench.dataset.reader import Dataset
from sabench.evaluation.leaderboard.archives import submitted_files
from sabench.evaluation.leaderboard.foreign_results import match_data_sets, score_safely
from sabench.tasks.solve_and_score import check_result_task
from sabench.utils.confidence import mean_of
from sabench.utils.errors import InputError
from sabench.utils.files import canonical_json, inside, read_json
from sabench.utils.validation import printable, validate
from sabench.utils.version import __version__

_FILE = "challenge.json"


class Challenge(BaseModel):
    """Content of the file, which participants receive, too."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    format: Literal["sabench-challenge"] = "sabench-challenge"
    version: Literal[1] = 1
    title: str
    task: TaskName
    sabench: str = Field(description="version that made the data sets and scores the results")
    data_sets: dict[str, str] = Field(description="content hashes by the names of the folders")


def write_challenge(challenge: Challenge, folder: Path) -> None:
    """Write the file into a folder of data sets."""
    text = canonical_json(challenge.model_dump(mode="json"))
    (folder / _FILE).write_text(text, encoding="utf-8")


def read_challenge(folder: Path) -> Challenge:
    """Read the file of a folder of data sets.

    Raises
    ------
    InputError
        No such file, another format, or a folder that is missing or outside.
    """
    path = folder / _FILE
    if not path.is_file():
        raise InputError(f"{folder}: expected a challenge, with a file {_FILE}, found none")
    challenge = validate(Challenge, read_json(path), str(path))
    for name in challenge.data_sets:
        if not inside(folder, name).is_dir():
            raise InputError(f"{path}: data_sets: expected a folder {printable(name)}, found none")
    return challenge


@contextlib.contextmanager
def opened_challenge(path: Path) -> Iterator[Path]:
    """Give the folder of a challenge, unpacked for a while if it is an archive.

    Raises
    ------
    InputError
        Neither a folder nor an intact archive, or one that does not fit onto the disk.
    """
    if path.is_dir():
        yield path
        return
    if not path.is_file():
        raise InputError(f"{path}: expected a challenge's folder or archive, found none")
    with tempfile.TemporaryDirectory(prefix="sabench-") as folder:
        _unpack(path, Path(folder))
        yield Path(folder)


def _unpack(path: Path, folder: Path) -> None:
    try:
        with zipfile.ZipFile(path) as archive:
            needed = sum(one.file_size for one in archive.infolist())
            if needed > shutil.disk_usage(folder).free:
                raise InputError(f"{path}: expected {needed / 1e6:.0f} MB of free disk in {folder}")
            archive.extractall(folder)
    except (zipfile.BadZipFile, ValueError, RuntimeError, EOFError) as error:
        raise InputError(f"{path}: expected an intact .zip archive, got {error}") from error


PARTICIPANT_COSTS = ("seconds", "peak_mb", "reconstruction_s")  # of the participants' machines
_LEFT_OUT = (*PARTICIPANT_COSTS, "compile_s", "isolated", "whole_process", "estimate_hash")
ADMITTED = "admitted"


def score_submission(reference: Path, submission: Path, out: Path) -> dict[str, float]:
    """Score a submission and write the files that the server reads.

    `scores.json` holds the mean of each score over the data sets, and the share of them whose
    result is admitted to the ranking. A score that a data set lacks has no mean.
    `scores_of_data_sets.json` holds what `sabench score --json` prints for each result, but no
    costs.

    Parameters
    ----------
    reference : folder of the challenge's data sets with their truth.
    submission : folder or archive of result files.
    out : folder of the two files.

    Raises
    ------
    InputError
        Another version of sabench, a result that is refused, or not one for each data set.
    """
    challenge = read_challenge(reference)
    if challenge.sabench != __version__:
        raise InputError(f"expected sabench {challenge.sabench}, got {__version__}")
    with submitted_files(submission) as files:
        sets = match_data_sets(files.results, [reference])
        names = _names(challenge, sets)
        found = {
            names[label]: _checked(label, score_safely(label, file, sets[label]), challenge)
            for label, file in files.results
        }
    means = average(challenge, list(found.values()))
    out.mkdir(parents=True, exist_ok=True)
    for name, values in (("scores", means), ("scores_of_data_sets", found)):
        (out / f"{name}.json").write_text(canonical_json(values), encoding="utf-8")
    return means


def average(challenge: Challenge, scores: list[dict[str, Any]]) -> dict[str, float]:
    """Average the scores of all data sets."""
    task, means = tasks.of(challenge.task), {}
    for key in (one.key for one in task.columns if one.key not in PARTICIPANT_COSTS):
        values = [one[key] for one in scores if one[key] is not None]
        mean = mean_of(values)
        if mean is not None and len(values) == len(scores):
            means[key] = mean.mean
    return {**means, ADMITTED: sum(task.admits(one) for one in scores) / len(scores)}


def _names(challenge: Challenge, sets: dict[str, Dataset]) -> dict[str, str]:
    """Name the data set of each result; there must be one result for each."""
    by_hash = {one: name for name, one in challenge.data_sets.items()}
    names = {label: by_hash[data.content_hash] for label, data in sets.items()}
    first: dict[str, str] = {}
    for label, name in names.items():
        if name in first:
            raise InputError(
                f"{name}: expected one result, got {printable(first[name])} and {printable(label)}"
            )
        first[name] = label
    missing = [name for name in challenge.data_sets if name not in first]
    if missing:
        raise InputError(
            f"expected a result for each of {len(challenge.data_sets)} data sets, got none for "
            f"{', '.join(missing)}"
        )
    return names


def _checked(label: str, scores: dict[str, Any], challenge: Challenge) -> dict[str, Any]:
    check_result_task(scores["task"], challenge.task, printable(label))
    return {key: one for key, one in scores.items() if key not in _LEFT_OUT}
