"""The command view and sabench.view."""

import json
import shutil
from pathlib import Path

import pytest

import sabench
from sabench.dataset.copies import copy_observation
from sabench.dataset.reader import Dataset
from tests.conftest import Command
from tests.helpers.commands import refuse, succeed
from tests.helpers.refusals import refused


@pytest.mark.slow
def test_a_result_is_shown_next_to_its_data_set(
    command: Command, quick: Dataset, quick_result: Path, tmp_path: Path
) -> None:
    done = succeed(command("view", quick.root, quick_result, "-o", "mine.html", "--json"))
    summary = json.loads(done.stdout)
    assert summary["cameras"] == 4
    assert summary["particles"] >= 600
    assert summary["notes"] == ["Particles of the result are local maxima of its volume."]
    page = (tmp_path / "mine.html").read_text(encoding="utf-8")
    assert summary["bytes"] == len(page.encode()) < 15_000_000
    succeed(command("view", quick_result, "-o", "alone.html"))
    assert (tmp_path / "alone.html").read_text(encoding="utf-8") == page
    refuse(command("view", quick.root, "-o", "mine.html"), "mine.html")


@pytest.mark.parametrize("what", ["cylinder-tank", "quick.toml"])
def test_a_rig_is_shown(command: Command, tmp_path: Path, quick_toml: str, what: str) -> None:
    (tmp_path / "quick.toml").write_text(quick_toml, encoding="utf-8")
    done = succeed(command("view", what))
    assert done.stdout.startswith("view.html: 4 camera(s), 0 frame(s), 0 particles, 0 bubbles, 0.")


def test_cameras_of_a_data_set_are_shown_without_its_images(quick: Dataset) -> None:
    made = sabench.view(quick.root / "cameras.json")
    assert made.summary["cameras"] == 4
    assert made.summary["frames"] == 0


@pytest.mark.slow
def test_the_observation_side_shows_finds(
    quick: Dataset, quick_result: Path, tmp_path: Path
) -> None:
    copy_observation(quick, tmp_path / "blind")
    blind = sabench.open_dataset(tmp_path / "blind")
    made = sabench.view(blind, quick_result)
    assert made.summary["particles"] > 300
    assert "found; no truth is known" in made.html
    assert sabench.view(blind).summary["particles"] == 0


@pytest.mark.parametrize(
    "words", ["nothing", "nothing.h5", "quick result.h5", ".", "broken.h5", "away.h5"]
)
def test_errors_of_view(command: Command, quick_result: Path, tmp_path: Path, words: str) -> None:
    (tmp_path / "broken.h5").write_bytes(b"no HDF5")
    shutil.copy(quick_result, tmp_path / "away.h5")
    done = command("view", *words.split())
    assert (done.stdout, done.stderr.count("\n")) == ("", 1)
    refuse(done, words.split()[0])
    assert not (tmp_path / "view.html").exists()


def test_notebooks_show_the_page_in_a_frame_of_its_own(tmp_path: Path) -> None:
    made = sabench.view(sabench.load_scene("quick"))
    shown = made._repr_html_()
    assert shown.startswith('<iframe sandbox="allow-scripts" srcdoc="&lt;!DOCTYPE html&gt;')
    assert shown.count("<") == 2  # the page is text of an attribute
    path = made.save(tmp_path / "rig.html")
    assert path.read_text(encoding="utf-8") == made.html
    with refused("rig.html"):
        made.save(path)
    made.save(path, overwrite=True)
