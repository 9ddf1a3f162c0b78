"""Solver cards of submissions, and estimates that are sent under another name."""

from __future__ import annotations

import json
import shutil
import zipfile
from pathlib import Path

import h5py
import numpy as np
import pytest

from sabench.dataset.reader import Dataset
from sabench.dataset.results import estimate_hash
from sabench.evaluation.leaderboard.submissions import submit
from sabench.evaluation.records import read_records
from sabench.evaluation.solver_card import read_card
from sabench.utils.errors import InputError
from tests.conftest import Command

CARD = """solver = "mine"
paper = "Somebody, Some Journal 1 (2026) 2"
code = "closed"
licence = "none"
hardware = "a laptop, 3 s"
parameters = "k = 3, by eye on the scene quick"
training_data = "none"
"""
SUITE = """title = "t"
backend = "splat"
scenes = ["quick"]
solvers = [{ name = "asa" }]
"""


def renamed(result: Path, place: Path, solver: str) -> Path:
    """Copy a result under the name of another solver, packed in another way."""
    with h5py.File(result, "r") as old, h5py.File(place, "w") as new:
        new.attrs.update({**old.attrs, "solver": solver, "parameters": "{}"})
        for frame in old["frames"]:
            for name, node in old[f"frames/{frame}"].items():
                new.create_dataset(f"frames/{frame}/{name}", data=node[...])
    return place


@pytest.mark.slow
def test_a_card_is_packed_recorded_and_shown(
    quick: Dataset, quick_result: Path, command: Command, tmp_path: Path
) -> None:
    (tmp_path / "c.toml").write_text(CARD, encoding="utf-8")
    renamed(quick_result, tmp_path / "r.h5", "mine")
    done = command("pack", "r.h5", "--card", "c.toml", "-o", "sent.zip")
    assert done.stdout == "sent.zip: 1 result(s), the card of mine\n", done.stderr
    with zipfile.ZipFile(tmp_path / "sent.zip") as archive:
        assert archive.namelist() == ["card.toml", "r.h5"]
    done = command("submit", "sent.zip", "--name", "Ann", "--data", quick.root.parent, "--json")
    assert done.returncode == 0, done.stderr
    (printed,) = json.loads(done.stdout)
    (record,) = read_records(tmp_path / "leaderboard" / "records")
    assert printed["card"] == record["card"] == read_card(tmp_path / "c.toml").model_dump()
    page = (tmp_path / "leaderboard" / "index.html").read_text(encoding="utf-8")
    assert "Somebody, Some Journal" in page


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (CARD.replace("licence", "license"), "license: unknown key; did you mean licence?"),
        (CARD.replace('code = "closed"\n', ""), "code: this key is missing"),
        (CARD.replace('"none"', "3", 1), "licence: expected a valid string"),
        (CARD.replace("by eye", r"\u0007"), "parameters: expected one line of printable text"),
        (CARD.replace("closed", ""), "code: expected one line"),
        ("x" * 200_000, "expected a solver card in TOML, got more than 100000 bytes"),
        (CARD.replace('"mine"', '"other"'), "expected the solver of a result"),
        (None, "expected a solver card in TOML, got No such file"),
    ],
)
def test_a_bad_card_is_one_sentence(
    text: str | None, words: str, quick: Dataset, quick_result: Path, tmp_path: Path
) -> None:
    card = tmp_path / "card.toml"
    if text is not None:
        card.write_text(text, encoding="utf-8")
    result = renamed(quick_result, tmp_path / "r.h5", "mine")
    with pytest.raises(InputError) as fault:
        submit(result, "Ann", [quick.root], tmp_path / "board", cards=[card])
    assert words in str(fault.value)
    assert "\n" not in str(fault.value)
    assert not (tmp_path / "board").exists()


@pytest.mark.slow
def test_a_bundled_solvers_result_is_recognised(command: Command, tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text(SUITE, encoding="utf-8")
    assert command("run", "s.toml").returncode == 0
    (result,) = (tmp_path / "work" / "results").glob("*.h5")
    renamed(result, tmp_path / "mine.h5", "mine")
    done = command("submit", "mine.h5", "--name", "Ann")
    assert "mine.h5: its estimates are those of asa; the record says so" in done.stderr
    honest = command("submit", result, "--name", "Ann")
    assert honest.returncode == 0, honest.stderr
    assert "its estimates are" not in honest.stderr
    mine, own = read_records(tmp_path / "leaderboard" / "records")[1:]
    assert (mine["solver"], mine["same_estimates_as"]) == ("mine", "asa")
    assert (own["solver"], own["same_estimates_as"]) == ("asa", None)


@pytest.mark.slow
def test_anothers_earlier_result_is_recognised(
    quick: Dataset, quick_result: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    board = tmp_path / "board"
    result = renamed(quick_result, tmp_path / "r.h5", "mine")
    submit(result, "Ann", [quick.root], board)
    (standing,) = submit(result, "Bob", [quick.root], board)
    assert standing.record["same_estimates_as"] == "mine of Ann"
    assert "r.h5: its estimates are those of mine of Ann" in capfd.readouterr().err


def test_a_changed_value_changes_the_hash(quick_result: Path, tmp_path: Path) -> None:
    same = renamed(quick_result, tmp_path / "a.h5", "other")
    assert estimate_hash(same) == estimate_hash(quick_result)
    shutil.copyfile(same, tmp_path / "b.h5")
    with h5py.File(tmp_path / "b.h5", "r+") as file:
        volume = file["frames/0000/volume"]
        place = np.unravel_index(volume[...].argmax(), volume.shape)
        volume[place] = np.nextafter(volume[place], np.float32(0.0))
    assert estimate_hash(tmp_path / "b.h5") != estimate_hash(quick_result)
