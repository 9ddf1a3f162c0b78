"""Challenge: private data sets, archives and pages; results of a participant.

The bundle for the server Codabench has the format of the server's documentation, version 2: "Yaml
Structure", "Competition Bundle Structure" and "Submission Docker Container Layout".
"""

import datetime
import json
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from string import Template
from typing import Any, cast

from sabench import tasks
from sabench.api.solvers import TaskName
from sabench.apps.challenge.scoring import (
    ADMITTED,
    PARTICIPANT_COSTS,
    Challenge,
    opened_challenge,
    read_challenge,
    write_challenge,
)
from sabench.dataset.copies import copy_observation, pack
from sabench.dataset.reader import Dataset, open_dataset
from sabench.dataset.results import open_result
from sabench.evaluation.leaderboard.archives import Submitted, check_archive_name, pack_results
from sabench.evaluation.leaderboard.page_content import gate_text
from sabench.evaluation.runner import dataset_of
from sabench.evaluation.solver_card import CARD, SolverCard, check_solvers, read_cards
from sabench.evaluation.suite_loading import load_suite, read_secret
from sabench.evaluation.suites import Case
from sabench.tasks.external_programs import is_program, solver_name
from sabench.tasks.solve_and_score import check_result_task, solve
from sabench.utils.errors import InputError
from sabench.utils.files import complete_or_nothing, digest, refuse_existing, zip_folder
from sabench.utils.processes.program import ProgramLimits
from sabench.utils.progress import say
from sabench.utils.version import __version__

_FOLDER = Path(__file__).with_name("pages")
_PAGES = ("overview", "data", "evaluation", "terms")
CARD_TEMPLATE = "".join(
    f'# {field.description}\n{name} = ""\n' for name, field in SolverCard.model_fields.items()
)


def page(name: str, challenge: Challenge) -> str:
    """Fill in a page in Markdown: one of `NAMES`."""
    task = tasks.of(challenge.task)
    shown = [column for column in task.columns if column.key not in PARTICIPANT_COSTS]
    scores = "\n".join(f"| {column.heading} | {column.meaning} |" for column in shown)
    values = {
        "title": challenge.title,
        "task": challenge.task,
        "count": len(challenge.data_sets),
        "first": task.columns[0].heading,
        "gate": gate_text(task),
        "scores": scores,
        "version": challenge.sabench,
    }
    text = (_FOLDER / f"{name}.md").read_text(encoding="utf-8")
    return Template(text).substitute(values)


_PROGRAM = Path(__file__).with_name("score.py")
_COMMAND = "command: python3 /app/program/score.py /app/input/ /app/output/\n"
_DIGITS = 6  # that the server's table shows
_DOCKERFILE = """# Image for the scoring program: put the wheel of sabench next to this file.
FROM python:3.12-slim
COPY sabench-{version}-py3-none-any.whl /tmp/
RUN pip install --no-cache-dir /tmp/sabench-{version}-py3-none-any.whl
"""


def write_bundle(
    challenge: Challenge, named: dict[str, Dataset], image: str, public: Path, folder: Path
) -> None:
    """Write the content of a bundle into a new folder.

    Parameters
    ----------
    named : the data sets with their truth, which go to the reference data alone.
    image : name of the server's Docker image for scoring.
    public : archive that participants receive.
    """
    reference = folder / "reference_data"
    reference.mkdir(parents=True)
    for name, data in named.items():
        pack(data, reference / name, blind=False)
    write_challenge(challenge, reference)
    program, kit = folder / "scoring_program", folder / "starting_kit"
    program.mkdir()
    shutil.copyfile(_PROGRAM, program / _PROGRAM.name)
    (program / "metadata.yaml").write_text(_COMMAND, encoding="utf-8")
    recipe = _DOCKERFILE.format(version=challenge.sabench)
    (program / "Dockerfile").write_text(recipe, encoding="utf-8")
    kit.mkdir()
    _write_instructions(challenge, kit)
    (folder / "pages").mkdir()
    for name in _PAGES:
        (folder / "pages" / f"{name}.md").write_text(page(name, challenge), encoding="utf-8")
    shutil.copyfile(public, folder / "public_data.zip")
    # images of the first data set, which participants receive anyway
    first = next(iter(named.values()))
    (folder / "logo.png").write_bytes(tasks.of_data(first).images(first))
    text = "\n".join(competition(challenge, image)) + "\n"
    (folder / "competition.yaml").write_text(text, encoding="utf-8")


def _write_instructions(challenge: Challenge, folder: Path) -> None:
    (folder / "README.md").write_text(page("data", challenge), encoding="utf-8")
    (folder / CARD).write_text(CARD_TEMPLATE, encoding="utf-8")


def competition(challenge: Challenge, image: str) -> Iterator[str]:
    """Give the lines of competition.yaml; texts are quoted as JSON, which YAML reads."""
    start = datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M:%S")
    pages = "\n".join(
        f"  - {{title: {name.capitalize()}, file: pages/{name}.md}}" for name in _PAGES
    )
    yield f"""version: 2
title: {_quoted(challenge.title)}
description: {_quoted(f"Task {challenge.task} on private data sets")}
image: logo.png
terms: pages/terms.md
docker_image: {_quoted(image)}
make_programs_available: true
pages:
{pages}
tasks:
  - index: 0
    name: {_quoted(challenge.title)}
    scoring_program: scoring_program
    reference_data: reference_data
phases:
  - index: 0
    name: Challenge
    start: {start}
    execution_time_limit: {ProgramLimits.time_s:.0f}
    public_data: public_data.zip
    starting_kit: starting_kit
    accepts_only_result_submissions: true
    tasks: [0]
leaderboards:
  - title: Results
    key: main
    submission_rule: Force_Last
    columns:"""
    scores = [
        column for column in tasks.of(challenge.task).columns if column.key not in PARTICIPANT_COSTS
    ]
    for number, column in enumerate(scores):
        order = "asc" if column.better == "smaller" else "desc"
        yield _column(number, column.key, column.heading, order)
    yield _column(len(scores), ADMITTED, "admitted", "desc")


def _quoted(text: str) -> str:
    """Quote a text for YAML, which has JSON's escapes but no surrogate pairs."""
    return json.dumps(text, ensure_ascii=False)


def _column(number: int, key: str, title: str, sorting: str) -> str:
    values = f"title: {_quoted(title)}, key: {key}, index: {number}, sorting: {sorting}"
    return f"      - {{{values}, precision: {_DIGITS}}}"


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
    secret : the organiser's file, the source of the seeds.
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
    # sorted by hash, so that the order does not disclose the case
    datasets = sorted(_data_sets(wanted, out / "private", jobs), key=lambda data: data.content_hash)
    named = {f"data_{number:03d}": data for number, data in enumerate(datasets)}
    hashes = {name: data.content_hash for name, data in named.items()}
    challenge = Challenge(title=loaded.title, task=chosen, sabench=__version__, data_sets=hashes)
    with tempfile.TemporaryDirectory(prefix="sabench-", dir=out) as scratch:
        folder = Path(scratch) / "participant"
        for name, data in named.items():
            (folder / name).mkdir(parents=True)
            copy_observation(data, folder / name)
        write_challenge(challenge, folder)
        _write_instructions(challenge, folder)
        _archive(folder, out / PARTICIPANT)
        if image is not None:
            bundle = Path(scratch) / "codabench"
            write_bundle(challenge, named, image, out / PARTICIPANT, bundle)
            _archive(bundle, out / BUNDLE)
    return challenge


def _choose_task(cases: list[Case], task: TaskName | None, suite: str) -> TaskName:
    choices = sorted({name for case in cases for name in _tasks(case)})
    if task is None and len(choices) > 1:
        raise InputError(
            f"{suite}: expected solvers of one task, or --task with one of {', '.join(choices)}"
        )
    chosen = task or choices[0]
    if chosen not in choices:
        raise InputError(f"--task: expected one of {', '.join(choices)}, got {chosen!r}")
    return cast("TaskName", chosen)


def _tasks(case: Case) -> set[str]:
    return {entry.describe()[1] for entry in case.solvers}


def _data_sets(cases: list[Case], work: Path, jobs: int) -> Iterator[Dataset]:
    for number, case in enumerate(cases, 1):
        say(f"data set {number} of {len(cases)}: {case.name}, {case.words}")
        yield dataset_of(case, work, False, jobs)


def _archive(folder: Path, out: Path) -> None:
    with complete_or_nothing(out, overwrite=True) as partial:
        zip_folder(folder, partial)


def participate(
    path: Path,
    solver: str,
    out: Path,
    *,
    results: Path,
    cards: Sequence[Path] = (),
    parameters: dict[str, Any] | None = None,
    limits: ProgramLimits | None = None,
    overwrite: bool = False,
) -> int:
    """Solve all data sets of a challenge, pack the results, and return their number.

    Results that are there are used again, so that an interrupted call is resumed.

    Parameters
    ----------
    path : archive or folder of the challenge.
    solver : its name, or the path of a program.
    out : archive to create, by the name .zip.
    results : folder where the results are stored.
    cards : of the solver.
    parameters, limits : as `solve` takes them.

    Raises
    ------
    InputError
        As `solve` and `pack_results`, or a solver of another task.
    """
    check_archive_name(out)
    refuse_existing(out, overwrite=overwrite)
    shown = solver_name(solver) if is_program(solver) else solver
    check_solvers(read_cards([], cards), [shown])  # before hours of solving
    with opened_challenge(path) as folder:
        challenge = read_challenge(folder)
        tag = digest([solver, parameters or {}])[:8]
        files = []
        for number, name in enumerate(challenge.data_sets, 1):
            say(f"data set {number} of {len(challenge.data_sets)}: {name}")
            data = open_dataset(folder / name)
            place = results / f"{name}-{data.content_hash[:8]}-{shown}-{tag}.h5"
            if not _is_there(place, data):
                solve(solver, data, place, parameters=parameters, limits=limits)
            _check_task(place, data, challenge, shown)
            files.append((f"{name}.h5", place))
    pack_results(Submitted(files, []), out, cards, overwrite=overwrite)
    return len(files)


def _is_there(place: Path, data: Dataset) -> bool:
    """Check for an earlier result; one of another data set is refused."""
    if not place.exists():
        place.parent.mkdir(parents=True, exist_ok=True)
        return False
    open_result(place, data)
    return True


def _check_task(place: Path, data: Dataset, challenge: Challenge, solver: str) -> None:
    try:
        check_result_task(open_result(place, data).task, challenge.task, f"solver {solver}")
    except InputError:
        place.unlink()
        raise
