"""Bundle of a challenge for the server Codabench.

Its format is that of the server's documentation, version 2: "Yaml Structure", "Competition Bundle
Structure" and "Submission Docker Container Layout".
"""

from __future__ import annotations

import datetime
import json
import shutil
from collections.abc import Iterator
from pathlib import Path

from sabench import tasks
from sabench.dataset.copies import pack
from sabench.dataset.reader import Dataset
from sabench.evaluation.challenge.contents import Challenge, write_challenge
from sabench.evaluation.challenge.pages import CARD_TEMPLATE, NAMES, page
from sabench.evaluation.challenge.scoring import ADMITTED, COSTS
from sabench.evaluation.solver_card import CARD
from sabench.tasks.task import Score

_PROGRAM = Path(__file__).with_name("score.py")
_COMMAND = "command: python3 /app/program/score.py /app/input/ /app/output/\n"
_DIGITS = 6  # that the server's table shows
_LIMIT_S = 3600  # for the scores of one submission
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
    image : name of the Docker image in which the server scores.
    public : archive that participants receive.
    """
    reference = folder / "reference_data"
    reference.mkdir(parents=True)
    for name, data in named.items():
        pack(data, reference / name, blind=False)
    write_challenge(challenge, reference)
    _write_program(challenge, folder / "scoring_program")
    _write_kit(challenge, folder / "starting_kit")
    (folder / "pages").mkdir()
    for name in NAMES:
        (folder / "pages" / f"{name}.md").write_text(page(name, challenge), encoding="utf-8")
    shutil.copyfile(public, folder / "public_data.zip")
    (folder / "logo.png").write_bytes(_logo(next(iter(named.values()))))
    text = "\n".join(competition(challenge, image)) + "\n"
    (folder / "competition.yaml").write_text(text, encoding="utf-8")


def _write_program(challenge: Challenge, folder: Path) -> None:
    folder.mkdir()
    shutil.copyfile(_PROGRAM, folder / _PROGRAM.name)
    (folder / "metadata.yaml").write_text(_COMMAND, encoding="utf-8")
    recipe = _DOCKERFILE.format(version=challenge.sabench)
    (folder / "Dockerfile").write_text(recipe, encoding="utf-8")


def _write_kit(challenge: Challenge, folder: Path) -> None:
    folder.mkdir()
    (folder / "README.md").write_text(page("data", challenge), encoding="utf-8")
    (folder / CARD).write_text(CARD_TEMPLATE, encoding="utf-8")


def _logo(data: Dataset) -> bytes:
    """Draw the images of the first data set, which participants receive anyway."""
    return tasks.of_data(data).images(data)


def competition(challenge: Challenge, image: str) -> Iterator[str]:
    """Give the lines of competition.yaml; texts are quoted as JSON, which YAML reads."""
    start = datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M:%S")
    yield "version: 2"
    yield f"title: {_quoted(challenge.title)}"
    yield f"description: {_quoted(f'Task {challenge.task} on private data sets')}"
    yield "image: logo.png"
    yield "terms: pages/terms.md"
    yield f"docker_image: {_quoted(image)}"
    yield "make_programs_available: true"
    yield "pages:"
    for name in NAMES:
        yield f"  - {{title: {name.capitalize()}, file: pages/{name}.md}}"
    yield "tasks:"
    yield "  - index: 0"
    yield f"    name: {_quoted(challenge.title)}"
    yield "    scoring_program: scoring_program"
    yield "    reference_data: reference_data"
    yield "phases:"
    yield "  - index: 0"
    yield "    name: Challenge"
    yield f"    start: {start}"
    yield f"    execution_time_limit: {_LIMIT_S}"
    yield "    public_data: public_data.zip"
    yield "    starting_kit: starting_kit"
    yield "    accepts_only_result_submissions: true"
    yield "    tasks: [0]"
    yield "leaderboards:"
    yield "  - title: Results"
    yield "    key: main"
    yield "    submission_rule: Force_Last"
    yield "    columns:"
    yield from _columns(challenge)


def _quoted(text: str) -> str:
    """Quote a text for YAML, which has JSON's escapes but no surrogate pairs."""
    return json.dumps(text, ensure_ascii=False)


def _columns(challenge: Challenge) -> Iterator[str]:
    scores = [one for one in tasks.of(challenge.task).columns if one.key not in COSTS]
    for number, one in enumerate(scores):
        yield _column(number, one.key, one.heading, _sorting(one))
    yield _column(len(scores), ADMITTED, "admitted", "desc")


def _sorting(score: Score) -> str:
    return "asc" if score.better == "smaller" else "desc"


def _column(number: int, key: str, title: str, sorting: str) -> str:
    values = f"title: {_quoted(title)}, key: {key}, index: {number}, sorting: {sorting}"
    return f"      - {{{values}, precision: {_DIGITS}}}"
