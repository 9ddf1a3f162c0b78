"""Submitted results: checked, matched to data sets, scored and ranked.

Submissions are data only: sabench executes nothing of them. A record discloses neither scene nor
seed of a private test set, and names an earlier record with the same estimates.
"""

import datetime
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from sabench import plugins, tasks
from sabench.dataset.reader import Dataset
from sabench.evaluation.leaderboard.archives import submitted_files
from sabench.evaluation.leaderboard.cells import distinct
from sabench.evaluation.leaderboard.foreign_results import match_data_sets, score_safely
from sabench.evaluation.record_schema import LONGEST_NAME, Record
from sabench.evaluation.records import append, encode, latest, read_records, run_key, same_data
from sabench.evaluation.runner import build_board
from sabench.evaluation.solver_card import check_solvers, read_cards
from sabench.evaluation.suite_loading import is_public
from sabench.utils.errors import InputError
from sabench.utils.files import digest
from sabench.utils.progress import progress_bar, say
from sabench.utils.validation import printable
from sabench.utils.version import __version__

# keys of a record that describe the data set
_CASE = (
    *("suite", "case", "scene", "difficulty", "axis", "axes"),
    *("scene_hash", "seed", "split", "renderer"),
)


def describe_data(data: Dataset, known: list[Record]) -> Record:
    """Describe the data set of a record.

    The values are those of a run's record of the same data set, if there is one. Else they are
    those of its manifest, but only if its scene and seed are public.
    """
    runs = [record for record in known if not record["submission"] and not record["recorded"]]
    here = {"dataset": data.content_hash, "identity": data.identity}
    twin = next((record for record in runs if same_data(record, here)), None)
    if twin:
        return {key: twin.get(key) for key in _CASE if key in twin}
    manifest = data.manifest
    # check whether a data set's scene and seed are public already
    recorded = any(
        (run["scene_hash"], run["seed"], run["split"])
        == (manifest.scene_hash, manifest.seed, "public")
        for run in runs
    )
    case = scene = manifest.scene
    scene_hash, seed, split = manifest.scene_hash, manifest.seed, "public"
    if not (recorded or is_public(scene_hash, seed)):
        # describe a private data set by its content hash alone
        case, scene = f"private-{data.content_hash[:12]}", "private"
        scene_hash, seed, split = data.content_hash, 0, "hidden"
        reason = "no public record and no bundled suite has its scene with its seed"
        say(f"{data.root}: recorded as {case}: {reason}")
    head = {"case": case, "scene": scene, "axes": {}, "scene_hash": scene_hash, "seed": seed}
    return head | {"split": split, "renderer": manifest.renderer}


def bundled_records(leaderboard: Path) -> list[Record]:
    """Read the records that sabench brings, unless they are the leaderboard's own."""
    folder = plugins.bundled_folder("leaderboard") / "records"
    bundled = folder.resolve() == (leaderboard / "records").resolve()
    return [] if bundled or not folder.is_dir() else read_records(folder)


def recognise(record: Record, known: Sequence[Record]) -> str | None:
    """Name the other solver entry with the same estimates, if any.

    Estimates are the same if they are of the same data set and have the same content hash. A run of
    a solver and a result of the same solver name are one entry. Records that repeat others'
    estimates themselves do not count.
    """
    first = [
        earlier
        for earlier in known
        if earlier.get("estimate_hash") == record["estimate_hash"]
        and same_data(earlier, record)
        and not earlier.get("same_estimates_as")
    ]
    other = all(_is_other(earlier, record) for earlier in first)
    return entry_name(first[0]) if first and other else None


def _is_other(earlier: Record, record: Record) -> bool:
    if earlier["solver"] != record["solver"]:
        return True
    sender = (earlier.get("submission") or {}).get("name")
    return sender not in (None, record["submission"]["name"])


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

    Raises InputError: a bad name, archive, result or solver card, two results of one data set,
    solver and parameters, a result of a data set that is not in `data`, or one that the submitter
    has sent today already. Raises UncheckedError: a file could not be checked in the time for it.
    """
    _check_name(name)
    submission = {
        "name": name.strip(),
        "date": (date or datetime.datetime.now(datetime.UTC).date()).isoformat(),
    }
    existing = read_records(leaderboard / "records")
    with submitted_files(path) as files:
        carded = read_cards(files.cards, cards)
        sets = match_data_sets(files.results, data)
        records = [
            _record(label, file, sets[label], existing) | {"submission": submission}
            for label, file in progress_bar(files.results, "check and score")
        ]
    labels = [label for label, _ in files.results]
    check_solvers(carded, [record["solver"] for record in records])
    records = [
        record | {"card": card.model_dump()} if (card := carded.get(record["solver"])) else record
        for record in records
    ]
    _refuse_twins(path, labels, records)
    _refuse_known(labels, records, existing)
    for label, record in zip(labels, records, strict=True):
        try:
            encode(record)
        except InputError as error:
            raise InputError(f"{printable(label)}: {error}") from error
    records = _recognised(labels, records, [*existing, *bundled_records(leaderboard)])
    for record in records:
        append(leaderboard / "records" / "submitted.jsonl", record)
    build_board(leaderboard)
    every = latest(read_records(leaderboard / "records"))
    return [standing(record, every) for record in records]


def _check_name(name: str) -> None:
    """Refuse a name that is empty, too long or cannot be printed."""
    if not name.strip() or len(name) > LONGEST_NAME or not name.isprintable():
        raise InputError(
            f"name: expected 1 to {LONGEST_NAME} printable characters, got {printable(name)!r}"
        )


def _recognised(labels: list[str], records: list[Record], existing: list[Record]) -> list[Record]:
    """Note and print which records repeat the estimates of others."""
    noted: list[Record] = []
    for label, record in zip(labels, records, strict=True):
        if twin := recognise(record, [*existing, *noted]):
            say(f"{printable(label)}: its estimates are those of {twin}; the record says so")
        noted.append({**record, "same_estimates_as": twin})
    return noted


def _record(label: str, file: Path, data: Dataset, existing: list[Record]) -> Record:
    """Make the record of one result, which is scored in a child process."""
    scores = score_safely(label, file, data)
    head = describe_data(data, existing) | {
        key: scores[key] for key in ("task", "solver", "parameters")
    }
    identity = data.identity if head["split"] == "public" else None
    run_hash = digest([identity or data.content_hash, head["solver"], head["parameters"]])
    costs = {"seconds": None, "peak_mb": None}  # measured on an unknown machine
    task = tasks.of(head["task"])
    figures = {score.key: scores[score.key] for score in (*task.columns, *task.curve)}
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


def _refuse_known(labels: list[str], records: list[Record], existing: list[Record]) -> None:
    """Refuse a result that its submitter has sent today already."""
    keys = {run_key(record) for record in existing}
    for label, record in zip(labels, records, strict=True):
        if run_key(record) in keys:
            raise InputError(
                f"{printable(label)}: expected the first result of today by "
                f"{record['submission']['name']} of this data set, solver "
                f"{printable(record['solver'])} and parameters, but the leaderboard has one: "
                "submit it under another name, with other parameters, or on another day"
            )


def _refuse_twins(path: Path, labels: list[str], records: list[Record]) -> None:
    by_hash: dict[str, str] = {}
    for label, record in zip(labels, records, strict=True):
        if record["run_hash"] in by_hash:
            first, second = printable(by_hash[record["run_hash"]]), printable(label)
            raise InputError(
                f"{path}: expected one result for each data set, solver and parameters, got "
                f"{first} and {second}"
            )
        by_hash[record["run_hash"]] = label


def standing(record: Record, every: Sequence[Record]) -> Standing:
    """Rank a record among those of its data set and task.

    The task's first score decides among those that its gate admits; equal scores share the better
    rank. A result that was sent several times counts once.
    """
    task = tasks.of(record["task"])
    score = task.columns[0]
    key, sign = score.key, 1.0 if score.better == "larger" else -1.0
    rivals = [
        rival
        for rival in every
        if same_data(rival, record)
        and rival["task"] == record["task"]
        and isinstance(rival.get(key), int | float)
        and not (isinstance(rival[key], bool) or rival.get("error"))
        and task.admits(rival)
    ]
    value = record.get(key) if task.admits(record) else None
    better = [rival for rival in rivals if value is not None and sign * rival[key] > sign * value]
    rank = None if value is None else 1 + len(distinct(better))
    others = [
        rival
        for rival in rivals
        if (rival["run_hash"], rival.get("submission"))
        != (record["run_hash"], record["submission"])
    ]
    best = max(others, key=lambda rival: sign * rival[key], default=None)
    count = len(distinct(rivals))
    return Standing(record, rank, count, (entry_name(best), best[key]) if best else None)


def entry_name(record: Record) -> str:
    """Name a solver and its submitter."""
    who = f" ({record['submission']['name']})" if record.get("submission") else ""
    return printable(f"{record.get('label') or record['solver']}{who}", 200)
