"""The reader for napari: layers of images that are read when asked for, and of true particles."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np

from sabench.dataset.reader import Dataset
from sabench.interop.napari_reader import get_reader, read_layers
from tests.conftest import ROOT


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
