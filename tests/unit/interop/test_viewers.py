"""Files for other viewers: COCO, napari and ParaView."""

import ast
import contextlib
import inspect
import io
import json
import re
import tomllib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, strategies as st

import sabench
from sabench.apps.detections import mask_pixels, score_detections
from sabench.dataset.reader import Dataset
from sabench.interop import vtkhdf
from sabench.interop.coco import run_lengths
from sabench.interop.export import NAME, write_state
from sabench.interop.napari_reader import get_reader, read_layers
from tests.conftest import ROOT
from tests.helpers.bubble_scenes import small
from tests.helpers.refusals import refused
from tests.unit.simulation.test_streaming import make_scene


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    scene = small(render={"relative_error": 0.2})
    return sabench.generate(scene, tmp_path_factory.mktemp("bubbles") / "set", seed=2)


@pytest.fixture(scope="module")
def coco(data: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return sabench.export(data, tmp_path_factory.mktemp("coco") / "out", to="coco")


def spread(lengths: list[int], shape: tuple[int, int]) -> Any:
    """Decode run lengths by COCO's definition."""
    flat = np.concatenate([np.full(n, place % 2) for place, n in enumerate(lengths)])
    return flat.reshape(shape, order="F") > 0


@given(st.integers(0, 2**12 - 1))
def test_run_lengths_are_read_back(bits: int) -> None:
    mask = np.array([bits >> place & 1 for place in range(12)], dtype=np.bool_).reshape(3, 4)
    lengths = run_lengths(mask)
    np.testing.assert_array_equal(spread(lengths, (3, 4)), mask)
    assert all(lengths[1:])


@pytest.mark.slow
def test_every_visible_bubble_has_its_mask_and_box(data: Dataset, coco: Path) -> None:
    values = json.loads((coco / "annotations.json").read_text())
    assert len(values["images"]) == 5
    bubbles, found = data.bubbles(0), 0
    for image, camera in zip(values["images"], data.setup.cameras, strict=True):
        sight = data.sight(0, camera)
        own = [one for one in values["annotations"] if one["image_id"] == image["id"]]
        for one in own:
            row = bubbles.id.tolist().index(one["bubble"])
            mask = spread(one["segmentation"]["counts"], sight.number.shape)
            np.testing.assert_array_equal(mask, sight.number == row)
            left, top, width, height = one["bbox"]
            inside = mask[top : top + height, left : left + width]
            assert inside.sum() == mask.sum() == one["area"] > 0
            assert inside[0].any() & inside[-1].any() & inside[:, 0].any() & inside[:, -1].any()
        found += len(own)
        assert len(own) == len(set(sight.number[sight.number >= 0].tolist()))
    assert found > 50
    assert len({one["id"] for one in values["annotations"]}) == found


@pytest.mark.slow
def test_images_show_what_the_camera_recorded(data: Dataset, coco: Path) -> None:
    file = coco / json.loads((coco / "annotations.json").read_text())["images"][2]["file_name"]
    image = np.asarray(cv2.imread(str(file), cv2.IMREAD_UNCHANGED))
    raw = data.raw_image(2, 0).astype(np.float64)
    assert image.shape == raw.shape
    assert image.dtype == np.uint8
    assert np.corrcoef(image.ravel(), raw.ravel())[0, 1] > 0.999


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of pycocotools with numpy 2
@pytest.mark.parametrize("key", ["bbox", "segmentation"])
def test_pycocotools_scores_alike(data: Dataset, coco: Path, tmp_path: Path, key: str) -> None:
    names = ("coco", "cocoeval", "mask")
    tools, evaluation, mask = (pytest.importorskip(f"pycocotools.{name}") for name in names)
    found, values, rng = [], {}, np.random.default_rng(3)
    with contextlib.redirect_stdout(io.StringIO()):
        true = tools.COCO(str(coco / "annotations.json"))
        for one in true.loadAnns(true.getAnnIds()):
            row = data.bubbles(0).id.tolist().index(one["bubble"])
            seen = data.sight(0, data.setup.cameras[one["image_id"] - 1]).number == row
            np.testing.assert_array_equal(true.annToMask(one) > 0, seen)
            runs = mask.encode(np.asfortranarray(np.roll(seen, rng.integers(-1, 2)), np.uint8))
            values["segmentation"] = runs | {"counts": runs["counts"].decode()}
            values["bbox"] = np.add(one["bbox"], rng.uniform(0.0, 1.0, 4)).tolist()
            ids = {"image_id": one["image_id"], "category_id": 1, "score": rng.random()}
            found += [ids | {key: values[key]}] * (rng.random() < 0.9)
        scores = scored(data, tmp_path, found)
        judged = evaluation.COCOeval(true, true.loadRes(found), key[:4])
        for step in (judged.evaluate, judged.accumulate, judged.summarize):
            step()
    assert (scores["ap"], scores["ap_50"]) == pytest.approx(judged.stats[:2], abs=1e-9)


def scored(data: Dataset, folder: Path, found: list[dict[str, Any]]) -> dict[str, Any]:
    (folder / "found.json").write_text(json.dumps(found))
    return score_detections(data, folder / "found.json")


@pytest.mark.slow
def test_the_truth_scores_best(data: Dataset, coco: Path, tmp_path: Path) -> None:
    values = json.loads((coco / "annotations.json").read_text())
    true = [one | {"score": 1} for one in values["annotations"]]
    true[0]["image_id"] = Path(values["images"][0]["file_name"]).stem
    for found in (true, [one | {"segmentation": None} for one in true]):
        scores = scored(data, tmp_path, found)
        assert (scores["ap"], scores["f1"], scores["diameter_rms_px"]) == (1.0, 1.0, 0.0)
    with refused("image_id"):
        scored(data, tmp_path, [{**true[0], "image_id": 6}])
    corners = [[10.2, 20.2, 13.8, 20.2, 13.8, 25.8, 10.2, 25.8]]
    expected = np.add.outer(128 * np.arange(10, 14), np.arange(20, 26)).ravel()
    np.testing.assert_array_equal(mask_pixels("", corners, 128, 160), expected)


def test_particles_alone_are_refused(data: Dataset, tmp_path: Path) -> None:
    plain = sabench.generate(make_scene(), tmp_path / "plain", backend="splat")
    with refused():
        sabench.export(plain, tmp_path / "out", to="coco")
    assert not (tmp_path / "out").exists()


def test_layers_are_images_and_true_particles(quick: Dataset) -> None:
    assert get_reader(str(quick.root)) is read_layers
    layers = read_layers(str(quick.root))
    images, _, kind = layers[0]
    assert (kind, len(layers)) == ("image", 2 * len(quick.setup.cameras))
    assert images.shape == (1, 240, 320)
    np.testing.assert_array_equal(images[0], quick.raw_image(0, 0))
    np.testing.assert_array_equal(images[0, 10:12, 5], quick.raw_image(0, 0)[10:12, 5])
    np.testing.assert_array_equal(np.asarray(images)[0], quick.raw_image(0, 0))
    places, _, kind = layers[1]
    assert kind == "points"
    inside = places[((places[:, 1:] > 3) & (places[:, 1:] < [236, 316])).all(axis=1)]
    row, column = np.rint(inside[:, 1:]).astype(int).T
    assert len(inside) > 200
    assert np.median(images[0][row, column]) > 3 * np.median(images[0])


def test_the_manifest_names_the_reader() -> None:
    text = (ROOT / "sabench" / "napari.yaml").read_text(encoding="utf-8")
    assert f"python_name: {get_reader.__module__}:{get_reader.__name__}" in text
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert project["entry-points"]["napari.manifest"] == {"sabench": "sabench:napari.yaml"}


def test_other_folders_are_left_to_other_readers(tmp_path: Path) -> None:
    assert get_reader(str(tmp_path)) is None
    assert get_reader([str(tmp_path)]) is None
    (tmp_path / "manifest.json").write_text('{"name": "an extension of a browser"}')
    assert get_reader(str(tmp_path)) is None


def _value(tree: ast.Module, name: str) -> ast.expr:
    """Find what a module assigns to a name, at whatever depth."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == name:
            found = node.value
    return found


def test_a_state_is_python_that_finds_its_files_and_draws_every_kind(tmp_path: Path) -> None:
    """Quotes in the folder's name do no harm. A kind without a drawing would stop the state."""
    home = Path('/some where\'s "data"')
    write_state(tmp_path, home)
    tree = ast.parse((tmp_path / NAME).read_text(encoding="utf-8"))
    folder, drawn = _value(tree, "FOLDER"), _value(tree, "DRAW")
    assert isinstance(folder, ast.Call)
    assert ast.literal_eval(folder.args[0]) == str(home)
    assert isinstance(drawn, ast.Dict)
    written = set(re.findall(r'"(\w+)_\{frame:04d\}\.vtkhdf"', inspect.getsource(vtkhdf)))
    assert len(written) >= 7
    assert {ast.literal_eval(key) for key in drawn.keys if key} == written | {"rig"}
