"""Values show themselves: lines, tables, one picture of one frame; nothing is raised."""

import base64
import json
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

import sabench
from sabench.api import Detections, FoundParticles, Reconstruction, Velocity
from sabench.api.arrays import Arrays
from sabench.dataset.reader import Dataset, open_dataset
from sabench.plotting.card import Card
from sabench.tasks.solve_and_score import score
from sabench.utils.arrays import U16

RNG = np.random.default_rng(3)
POINTS = RNG.uniform(-3.0, 3.0, (20, 3))
ESTIMATES = (
    Reconstruction(RNG.uniform(0.0, 1.0, (3, 5, 7)).astype(np.float32)),
    FoundParticles(POINTS),
    Velocity(
        (0.0, 1.0, 2.0), (1.0, 1.0, 1.0), RNG.normal(size=(3, 5, 7, 3)), np.ones((3, 5, 7), bool)
    ),
    Detections.balls(POINTS, RNG.uniform(0.1, 0.3, 20)),
)


def pictures(card: Card) -> list[tuple[int, ...]]:
    codes = re.findall(r'src="data:image/png;base64,([^"]+)"', card._repr_html_())
    decoded = (np.frombuffer(base64.b64decode(code), np.uint8) for code in codes)
    return [np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR)).shape for data in decoded]


class Broken(Card):
    def _rows(self) -> Iterator[tuple[str, ...]]:
        yield ("a < b",)
        yield "long", "1", "x"
        yield "s", "22", "y"
        raise OSError("gone")


def test_rows_are_aligned_and_those_before_an_error_stay() -> None:
    assert repr(Broken()) == "a < b\n  long  1   x\n  s     22  y"
    html = Broken()._repr_html_()
    assert "a &lt; b" in html
    assert html.count("<tr>") == 3
    assert "<img" not in html


@pytest.mark.parametrize("estimate", ESTIMATES, ids=lambda one: type(one).__name__)
def test_estimates_list_their_arrays_and_draw_one_picture(estimate: Arrays) -> None:
    for array, value in estimate.arrays():
        shape = " x ".join(map(str, value.shape))
        assert re.search(rf"^  {array.name} +{shape} ", repr(estimate), re.MULTILINE)
    assert len(pictures(estimate)) == 1


def test_nothing_found_is_shown_without_a_picture() -> None:
    nothing = FoundParticles(np.zeros((0, 3)))
    assert "position_mm  0 x 3" in repr(nothing)
    assert not pictures(nothing)


def test_a_data_set_shows_one_image_and_survives_its_files(
    quick: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = Path(shutil.copytree(quick.root, tmp_path / "data"))
    read: list[tuple[int, int]] = []
    raw_image = Dataset.raw_image

    def count(data: Dataset, number: int, frame: int) -> U16:
        read.append((number, frame))
        return raw_image(data, number, frame)

    monkeypatch.setattr(Dataset, "raw_image", count)
    assert pictures(open_dataset(root)) == [(240, 320, 3)]
    assert read == [(0, 0)]
    data = open_dataset(root)
    shutil.rmtree(root)
    assert repr(data) == f"Dataset {root}"
    assert not pictures(data)


def test_scores_are_a_mapping_and_a_table(quick: Dataset) -> None:
    scores = score(quick, "truth")
    again = json.loads(json.dumps(scores))
    assert again == dict(scores)
    title, first, *_ = repr(scores).splitlines()
    assert title == f"truth, reconstruction, data set {quick.content_hash[:12]}"
    assert first.split() == ["q", "1.000", "the", "larger,", "the", "better"]
    assert re.search(
        r"^  rms_px +0\.\d+ +voxel +the smaller, the better$", repr(scores), re.MULTILINE
    )
    assert scores._repr_html_().count("<tr>") == len(repr(scores).splitlines())
    assert scores["q"] == pytest.approx(1.0)


def test_a_plan_draws_its_rig() -> None:
    planned = sabench.plan("quick")
    assert repr(planned).startswith("Plan of Quick start")
    assert pictures(planned) == pictures(planned.rig)
    assert len(pictures(planned)) == 1


def test_a_shot_shows_its_observation_and_a_result_its_estimate(
    quick: Dataset, quick_result: Path
) -> None:
    shot = sabench.simulate("quick")
    assert "300 particles" in repr(shot)
    assert pictures(shot) == pictures(shot.observation) == [(240, 320, 3)]
    found = sabench.open_result(quick_result, quick)
    assert f"Result {found.path}\n  task:   reconstruction\n  solver: msa\n" in repr(found)
    assert pictures(found) == pictures(found.read(Reconstruction))
