"""Runner of suites: data sets, results, scores, records and the page.

It runs every solver on every case and seed.
"""

import shlex
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from sabench import tasks
from sabench.dataset.reader import Dataset, open_dataset
from sabench.dataset.results import estimate_hash, open_result
from sabench.dataset.verification import verify
from sabench.evaluation.leaderboard import board
from sabench.evaluation.leaderboard.board import stem_of
from sabench.evaluation.record_schema import Record, score_faults
from sabench.evaluation.records import (
    append,
    key_of,
    latest,
    machine,
    now,
    read_records,
    version_of,
    versions,
)
from sabench.evaluation.suite_loading import Judged, check_intact, judge, load_suite, read_secret
from sabench.evaluation.suites import WHOLE, Case, Only, RecordedCase, SceneCase, SolverEntry, Suite
from sabench.evaluation.timed_solving import solve_timed
from sabench.simulation.pipeline import generate
from sabench.tasks.quality import middle_residuals
from sabench.tasks.solve_and_score import check_result_task, score, score_iterations
from sabench.tasks.visible_files import hide_from_solvers
from sabench.utils.backend import Renderer
from sabench.utils.errors import DeclinedError, InputError
from sabench.utils.files import complete_or_nothing, digest
from sabench.utils.progress import say
from sabench.utils.version import SIMULATION, __version__

_RUN = ("scene_hash", "seed", "split", "renderer", "solver", "parameters", "code_hash")
COMPUTED = ("run_hash", "case", "label", "machine", "versions")


def run_suite(
    path: str | Path,
    work: Path,
    leaderboard: Path,
    *,
    fresh: bool = False,
    only: Only = WHOLE,
    secret: Path | None = None,
    jobs: int = 1,
) -> list[Record]:
    """Generate, solve, score and record a suite, then rebuild the page.

    Returns the records.

    A record is written as soon as its score is known. A solver that has a record for the same
    scene, seed, code and machine is not computed again; so run the same command again to resume an
    interrupted run. If a solver fails, its record gives the reason and the run continues; the next
    run tries it again.

    Parameters
    ----------
    fresh : compute everything again.
    only : a part of the suite.
    secret : run the private test set of this file, which no solver sees.
    jobs : processes that generate a data set.
    """
    with hide_from_solvers(secret):
        suite, cases = load_suite(path, read_secret(secret) if secret else None)
        existing = {} if fresh else known_records(leaderboard)
        records, wanted = [], only.select(cases)
        for number, case in enumerate(wanted, 1):
            heads = [(entry, describe_run(case, entry, str(path))) for entry in case.solvers]
            keys = [key_of(head, COMPUTED) for _, head in heads]
            missing = [pair for pair, key in zip(heads, keys, strict=True) if key not in existing]
            records += [existing[key] for key in keys if key in existing]
            done = "" if missing else ", known"
            say(f"data set {number} of {len(wanted)}: {case.name}, {case.words}{done}")
            _say_changed(heads[0][1], existing)
            if missing:
                dataset = dataset_of(case, work, fresh, jobs)
                for record in _rank(case, dataset, missing, suite, work, leaderboard):
                    append(leaderboard / "records" / "local.jsonl", record)
                    records.append(record)
                if not suite.keep_data:
                    discard(case, dataset)
    build_board(leaderboard)
    return records


def known_records(leaderboard: Path) -> dict[str, Record]:
    """Read the records without an error, by what they compute."""
    return {
        key_of(record, COMPUTED): record
        for record in read_records(leaderboard / "records")
        if not record["error"]
    }


def _say_changed(head: Record, existing: dict[str, Record]) -> None:
    """Print a message for a recording that differs from the one of earlier records."""
    same = ("suite", "case", "recorded")
    for record in existing.values() if head["recorded"] else ():
        if key_of(record, same) == key_of(head, same) and record["dataset"] != head["scene_hash"]:
            say(
                f"recording {head['case']}: it has changed since its record of {record['date']}, "
                "which stays on the page"
            )
            return


def build_board(leaderboard: Path) -> Path:
    """Build the page from the records; return its path."""
    page, records = leaderboard / "index.html", latest(read_records(leaderboard / "records"))
    say(f"page of {len(records)} records")
    board.build_page(records, leaderboard / "pictures", page)
    return page


def dataset_of(case: Case, work: Path, fresh: bool, jobs: int = 1) -> Dataset:
    """Open the case's data set, or generate it.

    An earlier data set is reused if it is intact and was made by these versions of sabench, its
    simulation and the renderer. A recording is checked.

    Raises InputError: a recording that is damaged or has changed. Raises UncheckedError: it could
    not be checked in the time for it. It stays as it is.
    """
    if isinstance(case, RecordedCase):
        return check_intact(case)
    folder = case.folder(work)
    if folder.is_dir() and not fresh and not verify(folder):
        dataset = open_dataset(folder)
        # the versions that the content of a data set depends on
        tools = {"sabench": __version__, "simulation": SIMULATION, "mitsuba": version_of("mitsuba")}
        if tools.items() <= dataset.manifest.versions.items():
            say(f"data set {folder} is intact: used again")
            return dataset
    renderer: Renderer = "mitsuba" if case.renderer == "mitsuba" else "splat"
    return generate(
        case.scene,
        folder,
        seed=case.seed,
        backend=renderer,
        name=case.name,
        overwrite=True,
        jobs=jobs,
    )


def discard(case: Case, dataset: Dataset) -> None:
    """Delete a generated data set; a recording stays."""
    if isinstance(case, SceneCase):
        shutil.rmtree(dataset.root)


def _rank(
    case: Case,
    dataset: Dataset,
    solver_entries: list[tuple[SolverEntry, Record]],
    suite: Suite,
    work: Path,
    leaderboard: Path,
) -> Iterator[Record]:
    """Make the records of solvers on one data set.

    Figures are drawn for recordings, and for the first seed of a public case.
    """
    pictured = isinstance(case, RecordedCase) or case.seed == suite.seeds[0]
    public = case.number is None
    folder = leaderboard / "pictures" / case.file_name if pictured and public else None
    if folder:
        # draw the images of the cameras and, if it is known, the truth
        task = tasks.of_data(dataset)
        _draw(folder / "images.png", task.images(dataset))
        if dataset.has_truth:
            _draw(folder / "truth.png", task.picture(dataset, "truth"))
    for solver_entry, head in solver_entries:
        # scores are null before any is known
        scores = (score.key for score in tasks.of(head["task"]).columns)
        record = {
            **head,
            **dict.fromkeys((*scores, "error", "reference_s")),
            "declined": False,
            "dataset": dataset.content_hash,
            "pictures": folder.name if folder else None,
            "identity": dataset.identity if public else None,
        }
        name = stem_of(head)
        out = work / "results" / f"{case.file_name}-{name}.h5"
        try:
            on_the_way = dataset.has_truth
            record["reference_s"] = solve_timed(solver_entry, dataset, out, iterations=on_the_way)
            judged = (
                judge(case, out) if isinstance(case, RecordedCase) else Judged(score(dataset, out))
            )
            record |= _checked(judged.scores, head) | {"estimate_hash": estimate_hash(out)}
            record["iterations"] = score_iterations(dataset, out) if dataset.has_truth else None
            if folder:
                _picture_result(folder / name, record["task"], dataset, out, judged.residuals)
        except InputError as error:
            say(f"error: {error}", "red")
            record["error"], record["declined"] = str(error), isinstance(error, DeclinedError)
        if not suite.keep_data:
            out.unlink(missing_ok=True)
        yield record | {"date": now()}


def _checked(scores: dict[str, Any], head: Record) -> dict[str, Any]:
    """Select what a record's head lacks; refuse scores that no record may have.

    Those of another task than the head's are refused, too.
    """
    check_result_task(scores["task"], head["task"], f"solver {head['solver']}")
    if faults := list(score_faults(head["task"], scores)):
        raise InputError.from_faults(f"solver {head['solver']}", faults)
    return {key: value for key, value in scores.items() if key not in head}


def _picture_result(
    stem: Path, name: str, dataset: Dataset, out: Path, residuals: bytes | None
) -> None:
    """Draw an estimate and its errors or residuals, as far as there are such figures."""
    task, result = tasks.of(name), open_result(out, dataset)
    if dataset.has_truth or not task.picture_has_truth:
        _draw(stem.with_name(f"{stem.name}.png"), task.picture(dataset, result))
    errors = task.error_picture(dataset, result) if dataset.has_truth else residuals
    if errors is not None:
        _draw(stem.with_name(f"{stem.name}.error.png"), errors)
    left = middle_residuals(dataset, result) if dataset.has_truth else None
    if left is not None:
        _draw(stem.with_name(f"{stem.name}.left.png"), left)


def describe_run(case: Case, solver_entry: SolverEntry, suite: str) -> Record:
    """Make the part of a record that is known before anything is computed."""
    solver, task, parameters = solver_entry.describe()
    head = {
        "suite": Path(suite).stem,
        "scene": case.base,
        "case": case.name,
        "difficulty": case.difficulty,
        "axis": case.axis,
        "axes": dict(case.axes),
        "scene_hash": case.data_hash,
        "seed": case.shown_seed,
        "split": "public" if case.number is None else "hidden",
        "renderer": case.renderer,
        "recorded": isinstance(case, RecordedCase),
        "task": task,
        "solver": solver,
        "label": solver_entry.label,
        "parameters": parameters,
        "code_hash": solver_entry.code_hash,
    }
    judged_by = [case.quality.model_dump()] if isinstance(case, RecordedCase) else []
    run_hash = digest([*(head[key] for key in _RUN), *judged_by])
    # list the words of the command that makes a record again
    seed = [] if isinstance(case, RecordedCase) else ["--seed", str(case.shown_seed)]
    more = [] if case.number is None else ["--hidden", "SECRET_FILE"]
    words = ["sabench", "run", suite, "--case", case.name, *seed]
    return {
        **head,
        "versions": versions(),
        "machine": machine(),
        "run_hash": run_hash,
        "command": shlex.join([*words, "--solver", solver_entry.shown, *more]),
    }


def _draw(path: Path, picture: bytes) -> None:
    with complete_or_nothing(path, overwrite=True) as partial:
        partial.write_bytes(picture)
