"""Folders of images as strangers leave them."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from sabench.images.statistics import guess_white, list_image_files, read_recordings
from sabench.utils.arrays import U16
from tests.helpers.refusals import refused


def image(most: int = 255, shape: tuple[int, int] = (24, 30), seed: int = 0) -> U16:
    values = np.random.default_rng(seed).integers(0, most + 1, shape)
    values[0, 0] = most
    return values.astype(np.uint16)


def write(path: Path, grey: U16, depth: type = np.uint16) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), grey.astype(depth))


@pytest.mark.parametrize("ending", ["TIFF", "png", "bmp"])
def test_a_folder_for_each_camera(tmp_path: Path, ending: str) -> None:
    for camera in ("left", "right"):
        for number in (10, 9, 8):
            write(tmp_path / camera / f"run2_{number}.{ending}", image(seed=number), np.uint8)
    (tmp_path / "left" / "notes.txt").write_text("mine")
    left, right = read_recordings(tmp_path, 2)
    assert (left.name, right.name) == ("left", "right")
    assert (len(left.frames), left.white_dn) == (2, 255.0)
    assert_array_equal(left.frames[0], image(seed=8))  # by number, not by letters
    assert_array_equal(left.frames[1], image(seed=9))


def test_all_cameras_in_one_folder(tmp_path: Path) -> None:
    for number in range(3):
        for camera in (1, 2):
            write(tmp_path / f"both/cam{camera}_{number:03}.png", image(seed=camera))
        write(tmp_path / f"numbers/{number}.tif", image())
    for folder, names in (("both", ["cam1", "cam2"]), ("numbers", ["camera"])):
        found = list_image_files(tmp_path / folder)
        assert {name: len(paths) for name, paths in found.items()} == dict.fromkeys(names, 3)


def test_a_file_of_many_pages_is_a_stack(tmp_path: Path) -> None:
    pages = [image(4095, seed=number) for number in range(5)]
    assert cv2.imwritemulti(str(tmp_path / "stack.tif"), pages)
    (one,) = read_recordings(tmp_path, 3)
    assert one.white_dn == 4095.0
    assert_array_equal(np.stack(one.frames), np.stack(pages[:3]))


@pytest.mark.parametrize("depth", [8, 10, 12, 14, 16])
def test_white_is_that_of_the_least_depth_also_in_the_upper_bits(depth: int) -> None:
    white, shift = (1 << depth) - 1, 16 - depth
    assert guess_white([image(white)]) == white
    if 8 < depth < 16:
        assert guess_white([(image(white) << shift).astype(np.uint16)]) == white << shift


def test_a_given_white_is_taken(tmp_path: Path) -> None:
    write(tmp_path / "a.png", image(900))
    (one,) = read_recordings(tmp_path, 9, 1000.0)
    assert one.white_dn == 1000.0


def test_a_grey_image_of_three_channels_is_grey(tmp_path: Path) -> None:
    grey = image()
    assert cv2.imwrite(str(tmp_path / "a.png"), np.repeat(grey[..., None], 3, 2).astype(np.uint8))
    (one,) = read_recordings(tmp_path, 9)
    assert_array_equal(one.frames[0], grey)


def refuse(folder: Path, *keys: str) -> None:
    with refused(*keys) as error:
        list(read_recordings(folder, 9))
    assert "\n" not in str(error.value)


def test_what_is_no_recording_is_refused_in_a_sentence(tmp_path: Path) -> None:
    refuse(tmp_path / "none", "none")
    tmp_path = tmp_path / "in"
    tmp_path.mkdir()
    refuse(tmp_path, "in")
    for content in (b"no image at all", b""):
        (tmp_path / "a.tif").write_bytes(content)
        refuse(tmp_path, "a.tif")
    colours = np.random.default_rng(1).integers(0, 255, (20, 20, 3)).astype(np.uint8)
    assert cv2.imwrite(str(tmp_path / "a.tif"), colours[..., 0].astype(np.float32) + 0.5)
    refuse(tmp_path, "a.tif", "float32")
    (tmp_path / "a.tif").unlink()
    assert cv2.imwrite(str(tmp_path / "a.png"), colours)
    refuse(tmp_path, "a.png")
    write(tmp_path / "a.png", image(shape=(8, 40)))
    refuse(tmp_path, "8 x 40")
    (tmp_path / "a.png").unlink()
    write(tmp_path / "a_1.tif", image())
    write(tmp_path / "a_2.tif", image(shape=(30, 24)))
    refuse(tmp_path, "24 x 30", "30 x 24")
