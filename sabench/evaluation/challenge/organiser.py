"""The organiser's part of a challenge: private data sets and archives."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import cast

from sabench.api.solvers import TaskName
from sabench.dataset.copies import copy_observation
from sabench.dataset.reader import Dataset
from sabench.evaluation.challenge.codabench import write_bundle
from sabench.evaluation.challenge.contents import Challenge, write_challenge
from sabench.evaluation.challenge.pages import CARD_TEMPLATE, page
from sabench.evaluation.hidden_split import read_secret
from sabench.evaluation.runner import dataset_of
from sabench.evaluation.solver_card import CARD
from sabench.evaluation.suite_loading import load_suite
from sabench.evaluation.suites import Case, Suite
from sabench.utils.errors import InputError
from sabench.utils.files import complete_or_nothing
from sabench.utils.progress import console
from sabench.utils.version import __version__
from sabench.utils.zip_archives import zip_folder

PARTICIPANT, BUNDLE = "participant.zip", "codabench.zip"


def make_challenge(
    suite: str | Path,
    secret: Path,
    out: Path,
    *,
    task: TaskName | None = None,
    image: str | None = None,
    jobs: int = 1,
) -> Challenge:
    """Make the private data sets of a suite, and the archives for others.

    Data sets that are there and intact are used again, so that an interrupted call is resumed.

    Parameters
    ----------
    suite : name or file of a suite. The cases that a solver of the task solves are used.
    secret : the organiser's file, from which the seeds come.
    out : folder of `private` data sets, `participant.zip` and `codabench.zip`.
    task : of all results; None: the only one of the suite's solvers.
    image : Docker image with sabench for a bundle for Codabench; None: no bundle.
    jobs : processes that generate a data set.

    Raises
    ------
    InputError
        Anything wrong in suite or secret, or a suite of several tasks where none is chosen.
    """
    loaded, cases = load_suite(suite, read_secret(secret))
    chosen = _choose_task(cases, task, str(suite))
    wanted = [case for case in cases if chosen in _tasks(case)]
    # by hash, so that the order tells no case
    made = sorted(_data_sets(wanted, out / "private", jobs), key=lambda one: one.content_hash)
    named = {f"data_{number:03d}": data for number, data in enumerate(made)}
    challenge = _describe(loaded, chosen, named)
    with tempfile.TemporaryDirectory(prefix="sabench-", dir=out) as scratch:
        folder = Path(scratch) / "participant"
        _write_participant(challenge, named, folder)
        _archive(folder, out / PARTICIPANT)
        if image is not None:
            bundle = Path(scratch) / "codabench"
            write_bundle(challenge, named, image, out / PARTICIPANT, bundle)
            _archive(bundle, out / BUNDLE)
    return challenge


def _choose_task(cases: list[Case], task: TaskName | None, suite: str) -> TaskName:
    known = sorted({one for case in cases for one in _tasks(case)})
    if task is None and len(known) > 1:
        raise InputError(
            f"{suite}: expected solvers of one task, or --task with one of {', '.join(known)}"
        )
    chosen = task or known[0]
    if chosen not in known:
        raise InputError(f"--task: expected one of {', '.join(known)}, got {chosen!r}")
    return cast("TaskName", chosen)


def _tasks(case: Case) -> set[str]:
    return {entry.describe()[1] for entry in case.solvers}


def _data_sets(cases: list[Case], work: Path, jobs: int) -> Iterator[Dataset]:
    for number, case in enumerate(cases, 1):
        text = f"data set {number} of {len(cases)}: {case.name}, {case.words}"
        console.print(text, markup=False, highlight=False)
        yield dataset_of(case, work, False, jobs)


def _describe(suite: Suite, task: TaskName, named: dict[str, Dataset]) -> Challenge:
    hashes = {name: data.content_hash for name, data in named.items()}
    return Challenge(title=suite.title, task=task, sabench=__version__, data_sets=hashes)


def _write_participant(challenge: Challenge, named: dict[str, Dataset], folder: Path) -> None:
    """Write the observation sides of the data sets, and how to take part."""
    for name, data in named.items():
        place = folder / name
        place.mkdir(parents=True)
        copy_observation(data, place)
    write_challenge(challenge, folder)
    (folder / CARD).write_text(CARD_TEMPLATE, encoding="utf-8")
    (folder / "README.md").write_text(page("data", challenge), encoding="utf-8")


def _archive(folder: Path, out: Path) -> None:
    with complete_or_nothing(out, overwrite=True) as partial:
        zip_folder(folder, partial)
