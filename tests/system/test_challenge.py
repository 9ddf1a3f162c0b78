"""A challenge from the secret to the scores, on this machine and as a server scores it."""

import json
import shutil
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sabench
from sabench.apps.challenge.board import make_challenge
from sabench.apps.challenge.scoring import PARTICIPANT_COSTS, score_submission
from sabench.evaluation.records import read_records
from sabench.utils.errors import InputError
from sabench.utils.files import read_json
from tests.conftest import Command
from tests.helpers.commands import refuse, run_python, succeed
from tests.helpers.refusals import refused

SECRET = 'secret = "0123456789abcdef"\nseeds = 2\n'
SUITE = """title = "Tracers: a \\"challenge\\" ü 😀"
backend = "splat"
scenes = ["quick"]
solvers = [{ name = "asa" }]
"""
CARD = """solver = "asa"
paper = "none"
code = "bundled"
licence = "BSD-3-Clause"
hardware = "a laptop"
parameters = "defaults"
training_data = "none"
"""


@pytest.fixture(scope="module")
def organised(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("organiser")
    (folder / "secret.toml").write_text(SECRET, encoding="utf-8")
    (folder / "suite.toml").write_text(SUITE, encoding="utf-8")
    make_challenge(
        folder / "suite.toml", folder / "secret.toml", folder / "out", image="somewhere/sabench:1"
    )
    return folder


@pytest.fixture
def submission(organised: Path, command: Command, tmp_path: Path) -> Path:
    shutil.copyfile(organised / "out" / "participant.zip", tmp_path / "participant.zip")
    (tmp_path / "card.toml").write_text(CARD, encoding="utf-8")
    done = command("participate", "participant.zip", "asa", "-o", "s.zip", "--card", "card.toml")
    assert done.stdout == "s.zip: 2 result(s); send it to the organiser\n", done.stderr
    return tmp_path / "s.zip"


def unzipped(archive: Path, folder: Path) -> Path:
    with zipfile.ZipFile(archive) as packed:
        packed.extractall(folder)
    return folder


@pytest.mark.slow
def test_participants_receive_no_truth(organised: Path, tmp_path: Path) -> None:
    folder = unzipped(organised / "out" / "participant.zip", tmp_path / "p")
    kinds = {path.suffix for path in folder.rglob("*") if path.is_file()}
    assert kinds == {".json", ".tif", ".md", ".toml"}
    seeds = [str(sabench.open_dataset(one).manifest.seed) for one in private(organised)]
    hashes = [sabench.open_dataset(one).manifest.scene_hash for one in private(organised)]
    assert len(seeds) == 2
    for path in folder.rglob("*"):
        content = path.read_bytes() if path.is_file() and path.suffix != ".tif" else b""
        assert not [one for one in (*seeds, *hashes, "0123456789abcdef") if one.encode() in content]
    for name in read_json(folder / "challenge.json")["data_sets"]:
        assert not sabench.open_dataset(folder / name).has_truth
        assert sabench.verify(folder / name) == []


def private(organised: Path) -> list[Path]:
    return sorted((organised / "out" / "private" / "datasets").iterdir())


@pytest.mark.slow
def test_the_organiser_scores_what_the_participant_sent(
    organised: Path, submission: Path, command: Command, tmp_path: Path
) -> None:
    where = organised / "out" / "private" / "datasets"
    succeed(command("submit", submission, "--name", "Ann", "--data", where))
    records = read_records(tmp_path / "leaderboard" / "records")
    assert {one["split"] for one in records} == {"hidden"}
    assert {one["card"]["hardware"] for one in records} == {"a laptop"}


@pytest.mark.slow
def test_a_server_scores_exactly(organised: Path, submission: Path, tmp_path: Path) -> None:
    bundle = unzipped(organised / "out" / "codabench.zip", tmp_path / "bundle")
    place = tmp_path / "server" / "input"
    shutil.copytree(bundle / "reference_data", place / "ref")
    unzipped(submission, place / "res")
    shutil.copytree(bundle / "scoring_program", tmp_path / "server" / "program")
    words = ("score.py", place, tmp_path / "server" / "output")
    succeed(run_python(*words, cwd=tmp_path / "server" / "program"))
    found = read_json(tmp_path / "server" / "output" / "scores.json")
    each = read_json(tmp_path / "server" / "output" / "scores_of_data_sets.json")
    own = {name: sabench.score(place / "ref" / name, place / "res" / f"{name}.h5") for name in each}
    for name, scores in each.items():
        assert scores == {key: one for key, one in own[name].items() if key in scores}
        left_out = {*PARTICIPANT_COSTS, "compile_s", "isolated", "whole_process"}
        assert set(own[name]) - set(scores) <= left_out
    assert found["admitted"] == 1.0
    assert found["q"] == float(np.mean([one["q"] for one in own.values()]))
    assert not set(found) & set(PARTICIPANT_COSTS)
    assert {"q", "precision", "recall"} <= set(found)


@pytest.mark.slow
def test_the_bundle_is_as_the_server_documents_it(organised: Path, tmp_path: Path) -> None:
    yaml = pytest.importorskip("yaml", reason="PyYAML is not installed")
    bundle = unzipped(organised / "out" / "codabench.zip", tmp_path / "bundle")
    read: dict[str, Any] = yaml.safe_load((bundle / "competition.yaml").read_text("utf-8"))
    assert read["title"] == 'Tracers: a "challenge" ü 😀'
    assert read["version"] == 2
    assert read["docker_image"] == "somewhere/sabench:1"
    (task,), (phase,), (board,) = read["tasks"], read["phases"], read["leaderboards"]
    files = [read["image"], read["terms"], *(one["file"] for one in read["pages"])]
    files += [task["scoring_program"], task["reference_data"]]
    files += [phase["public_data"], phase["starting_kit"]]
    assert [name for name in files if not (bundle / name).exists()] == []
    assert all((bundle / one["file"]).read_text("utf-8") for one in read["pages"])
    assert [one["index"] for one in board["columns"]] == list(range(len(board["columns"])))
    assert board["columns"][0]["key"] == "q"
    assert board["columns"][0]["sorting"] == "desc"
    program = yaml.safe_load((bundle / "scoring_program" / "metadata.yaml").read_text("utf-8"))
    assert program["command"] == "python3 /app/program/score.py /app/input/ /app/output/"
    public = [one for one in bundle.rglob("*") if one.parts[len(bundle.parts)] != "reference_data"]
    assert not [one for one in public if one.suffix in (".h5", ".exr")]


@pytest.mark.slow
def test_each_data_set_needs_one_result(organised: Path, submission: Path, tmp_path: Path) -> None:
    reference = unzipped(organised / "out" / "codabench.zip", tmp_path / "b") / "reference_data"
    sent = unzipped(submission, tmp_path / "sent")
    shutil.copyfile(sent / "data_000.h5", sent / "more.h5")
    with refused("data_000", "more.h5"):
        score_submission(reference, sent, tmp_path / "scores")
    for name in ("more.h5", "data_000.h5"):
        (sent / name).unlink()
    with refused("data_000"):
        score_submission(reference, sent, tmp_path / "scores")
    listed = read_json(reference / "challenge.json")
    (reference / "challenge.json").write_text(json.dumps(listed | {"sabench": "0"}), "utf-8")
    with pytest.raises(InputError, match="sabench 0"):  # the sentence has the version
        score_submission(reference, sent, tmp_path / "scores")
    assert not (tmp_path / "scores").exists()


@pytest.mark.slow
def test_commands_resume(
    organised: Path, submission: Path, command: Command, tmp_path: Path
) -> None:
    made = {path: path.stat().st_mtime_ns for path in (tmp_path / "work/challenge").iterdir()}
    succeed(command("participate", "participant.zip", "asa", "-o", "s.zip", "--overwrite"))
    assert made == {path: path.stat().st_mtime_ns for path in made}
    kept = {path: path.stat().st_mtime_ns for path in private(organised)}
    archive = (organised / "out" / "participant.zip").read_bytes()
    words = ("--hidden", organised / "secret.toml", "-o", organised / "out")
    succeed(command("challenge", organised / "suite.toml", *words))
    assert kept == {path: path.stat().st_mtime_ns for path in kept}
    assert (organised / "out" / "participant.zip").read_bytes() == archive


@pytest.mark.parametrize(
    ("words", "key"),
    [
        ("participate none.zip asa -o s.zip", "none.zip"),
        ("participate . asa -o s.zip", "challenge.json"),
        ("participate bad.zip asa -o s.tar", "s.tar"),
        ("participate bad.zip asa -o s.zip", "bad.zip"),
        ("challenge standard --hidden secret.toml -o out", "standard"),
        ("challenge suite.toml --hidden secret.toml -o o --task bubbles", "--task"),
    ],
)
def test_wrong_words_are_one_sentence(
    words: str, key: str, command: Command, tmp_path: Path
) -> None:
    (tmp_path / "bad.zip").write_bytes(b"PK no archive")
    (tmp_path / "secret.toml").write_text(SECRET, encoding="utf-8")
    (tmp_path / "suite.toml").write_text(SUITE, encoding="utf-8")
    refuse(command(*words.split()), key)
