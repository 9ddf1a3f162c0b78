"""Submitted results: checked, matched to data sets, scored and ranked.

Submissions are data only: sabench executes nothing of them.
"""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from sabench import tasks
from sabench.dataset.reader import Dataset
from sabench.evaluation.leaderboard.archives import submitted_files
from sabench.evaluation.leaderboard.comparison import distinct
from sabench.evaluation.leaderboard.disclosure import describe_data
from sabench.evaluation.leaderboard.foreign_results import match_data_sets, score_safely
from sabench.evaluation.leaderboard.recognition import bundled_records, recognise
from sabench.evaluation.record_schema import Record
from sabench.evaluation.records import append, encode, latest, read_records, run_key, same_data
from sabench.evaluation.runner import build_board
from sabench.evaluation.solver_card import SolverCard, check_solvers, read_cards
from sabench.utils.errors import InputError
from sabench.utils.files import digest
from sabench.utils.progress import console, progress_bar
from sabench.utils.validation import printable
from sabench.utils.version import __version__

_LONGEST_NAME = 80


@dataclass(frozen=True)
class Standing:
    """Rank of a submitted result among the latest ones of its data set and task.

    Attributes
    ----------
    record : as it was appended.
    rank, of : 1 is the best; records without the first score, or that the task's gate
        does not admit, do not count.
    best : the best other entry's name and first score, or None where there is no other.
    """

    record: Record
    rank: int | None
    of: int
    best: tuple[str, float] | None


def submit(
    path: Path,
    name: str,
    data: Sequence[Path],
    leaderboard: Path,
    *,
    cards: Sequence[Path] = (),
    date: datetime.date | None = None,
) -> list[Standing]:
    """Score submitted results and add them to the leaderboard.

    If one of them is refused, none is added.

    Parameters
    ----------
    path : a result file, or an archive or a folder of some.
    name : of the submitter.
    data : folders of data sets, or of folders of them.
    leaderboard : folder of the records and the page.
    cards : solver cards, besides those in the archive or folder.
    date : by default today's.

    Raises
    ------
    InputError
        A bad name, archive, result or solver card, two results of one data set, solver and
        parameters, a result whose data set is not in `data`, or one that the submitter has sent
        today already.
    UncheckedError
        A file could not be checked in the time for it.
    """
    check_name(name)
    submission = {
        "name": name.strip(),
        "date": (date or datetime.datetime.now(datetime.UTC).date()).isoformat(),
    }
    known = read_records(leaderboard / "records")
    with submitted_files(path) as files:
        carded = read_cards(files.cards, cards)
        sets = match_data_sets(files.results, data)
        made = [
            _record(label, file, sets[label], known) | {"submission": submission}
            for label, file in progress_bar(files.results, "check and score")
        ]
    labels = [label for label, _ in files.results]
    check_solvers(carded, [record["solver"] for record in made])
    made = [_with_card(record, carded) for record in made]
    _refuse_twins(path, labels, made)
    _refuse_known(labels, made, known)
    for label, record in zip(labels, made, strict=True):
        _check_record(label, record)
    made = _recognised(labels, made, [*known, *bundled_records(leaderboard)])
    for record in made:
        append(leaderboard / "records" / "submitted.jsonl", record)
    build_board(leaderboard)
    every = latest(read_records(leaderboard / "records"))
    return [standing(record, every) for record in made]


def check_name(name: str) -> None:
    """Refuse a name that is empty, too long or cannot be printed."""
    if not name.strip() or len(name) > _LONGEST_NAME or not name.isprintable():
        raise InputError(
            f"name: expected 1 to {_LONGEST_NAME} printable characters, got {printable(name)!r}"
        )


def _with_card(record: Record, cards: dict[str, SolverCard]) -> Record:
    card = cards.get(record["solver"])
    return record if card is None else {**record, "card": card.model_dump()}


def _recognised(labels: list[str], made: list[Record], known: list[Record]) -> list[Record]:
    """Note in records, and say, whose estimates they repeat."""
    noted: list[Record] = []
    for label, record in zip(labels, made, strict=True):
        if twin := recognise(record, [*known, *noted]):
            text = f"{printable(label)}: its estimates are those of {twin}; the record says so"
            console.print(text, markup=False, highlight=False, soft_wrap=True)
        noted.append({**record, "same_estimates_as": twin})
    return noted


def _record(label: str, file: Path, data: Dataset, known: list[Record]) -> Record:
    """Make the record of one result, which is scored in a child process."""
    scores = score_safely(label, file, data)
    head = describe_data(data, known) | {
        key: scores[key] for key in ("task", "solver", "parameters")
    }
    identity = data.identity if head["split"] == "public" else None
    run_hash = digest([identity or data.content_hash, head["solver"], head["parameters"]])
    costs = {"seconds": None, "peak_mb": None}  # measured on an unknown machine
    task = tasks.of(head["task"])
    figures = {one.key: scores[one.key] for one in (*task.columns, *task.curve)}
    rest = {
        "dataset": data.content_hash,
        "identity": identity,
        "run_hash": run_hash,
        "estimate_hash": scores["estimate_hash"],
        "versions": {"sabench": __version__},
        "machine": {},
        "error": None,
        "declined": False,
    }
    return head | rest | figures | costs


def _check_record(label: str, record: Record) -> None:
    """Refuse a result whose solver, parameters or scores no record may have."""
    try:
        encode(record)
    except InputError as error:
        raise InputError(f"{printable(label)}: {error}") from error


def _refuse_known(labels: list[str], made: list[Record], known: list[Record]) -> None:
    """Refuse a result that its submitter has sent today already."""
    there = {run_key(record) for record in known}
    for label, record in zip(labels, made, strict=True):
        if run_key(record) in there:
            raise InputError(
                f"{printable(label)}: expected the first result of today by "
                f"{record['submission']['name']} of this data set, solver "
                f"{printable(record['solver'])} and parameters, but the leaderboard has one: "
                "submit it under another name, with other parameters, or on another day"
            )


def _refuse_twins(path: Path, labels: list[str], made: list[Record]) -> None:
    seen: dict[str, str] = {}
    for label, record in zip(labels, made, strict=True):
        if record["run_hash"] in seen:
            first, second = printable(seen[record["run_hash"]]), printable(label)
            raise InputError(
                f"{path}: expected one result for each data set, solver and parameters, got "
                f"{first} and {second}"
            )
        seen[record["run_hash"]] = label


def standing(record: Record, every: Sequence[Record]) -> Standing:
    """Rank a record among those of its data set and task.

    The task's first score decides among those that its gate admits; equal scores share the better
    rank. A result that was sent several times counts once.
    """
    task = tasks.of(record["task"])
    score = task.columns[0]
    key, sign = score.key, 1.0 if score.better == "larger" else -1.0
    rivals = [
        one
        for one in every
        if same_data(one, record)
        and one["task"] == record["task"]
        and _has(one, key)
        and task.admits(one)
    ]
    own = record.get(key) if task.admits(record) else None
    better = [one for one in rivals if own is not None and sign * one[key] > sign * own]
    rank = None if own is None else 1 + len(distinct(better))
    others = [
        one
        for one in rivals
        if (one["run_hash"], one.get("submission")) != (record["run_hash"], record["submission"])
    ]
    best = max(others, key=lambda one: sign * one[key], default=None)
    count = len(distinct(rivals))
    return Standing(record, rank, count, (entry_name(best), best[key]) if best else None)


def _has(record: Record, key: str) -> bool:
    value = record.get(key)
    return (
        isinstance(value, int | float) and not isinstance(value, bool) and not record.get("error")
    )


def entry_name(record: Record) -> str:
    """Name a solver and its submitter."""
    who = f" ({record['submission']['name']})" if record.get("submission") else ""
    return printable(f"{record.get('label') or record['solver']}{who}", 200)
