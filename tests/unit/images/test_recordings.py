"""Folders of images as strangers leave them."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from sabench.images.statistics import guess_white, list_cameras, read_recordings
from sabench.utils.arrays import U16
from sabench.utils.errors import InputError


def image(most: int = 255, shape: tuple[int, int] = (24, 30), seed: int = 0) -> U16:
    rng = np.random.default_rng(seed)
    values = rng.integers(0, most + 1, shape)
    values[0, 0] = most
    return values.astype(np.uint16)


def write(path: Path, grey: U16, depth: type = np.uint16) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), grey.astype(depth))


@pytest.mark.parametrize("ending", ["tif", "TIFF", "png", "bmp"])
def test_a_folder_for_each_camera(tmp_path: Path, ending: str) -> None:
    for camera in ("left", "right"):
        for number in (10, 9, 8):
            path = tmp_path / camera / f"run2_{number}.{ending}"
            write(path, image(seed=number), np.uint8)
    (tmp_path / "left" / "notes.txt").write_text("mine")
    left, right = read_recordings(tmp_path, 2)
    assert (left.name, right.name) == ("left", "right")
    assert (len(left.frames), left.white_dn) == (2, 255.0)
    assert_array_equal(left.frames[0], image(seed=8))  # by number, not by letters
    assert_array_equal(left.frames[1], image(seed=9))


def test_all_cameras_in_one_folder(tmp_path: Path) -> None:
    for camera in (1, 2):
        for number in range(3):
            write(tmp_path / f"cam{camera}_{number:03}.png", image(seed=camera))
    assert {name: len(paths) for name, paths in list_cameras(tmp_path).items()} == {
        "cam1": 3,
        "cam2": 3,
    }


def test_names_of_numbers_alone_are_one_camera(tmp_path: Path) -> None:
    for number in range(4):
        write(tmp_path / f"{number}.tif", image())
    assert {name: len(paths) for name, paths in list_cameras(tmp_path).items()} == {"camera": 4}


def test_a_file_of_many_pages_is_a_stack(tmp_path: Path) -> None:
    pages = [image(4095, seed=number) for number in range(5)]
    assert cv2.imwritemulti(str(tmp_path / "stack.tif"), pages)
    (one,) = read_recordings(tmp_path, 3)
    assert one.white_dn == 4095.0
    assert_array_equal(np.stack(one.frames), np.stack(pages[:3]))


@pytest.mark.parametrize("depth", [8, 10, 12, 14, 16])
def test_white_is_that_of_the_least_depth(depth: int) -> None:
    assert guess_white([image((1 << depth) - 1)]) == (1 << depth) - 1


@pytest.mark.parametrize("depth", [10, 12, 14])
def test_values_in_the_upper_bits_of_sixteen(depth: int) -> None:
    shift = 16 - depth
    grey = image((1 << depth) - 1) << shift
    assert guess_white([grey.astype(np.uint16)]) == ((1 << depth) - 1) << shift


def test_a_given_white_is_taken(tmp_path: Path) -> None:
    write(tmp_path / "a.png", image(900))
    (one,) = read_recordings(tmp_path, 9, 1000.0)
    assert one.white_dn == 1000.0


def test_a_grey_image_of_three_channels_is_grey(tmp_path: Path) -> None:
    grey = image()
    assert cv2.imwrite(str(tmp_path / "a.png"), np.repeat(grey[..., None], 3, 2).astype(np.uint8))
    (one,) = read_recordings(tmp_path, 9)
    assert_array_equal(one.frames[0], grey)


def sentence(folder: Path) -> str:
    """The one sentence by which a folder is refused."""
    with pytest.raises(InputError) as error:
        list(read_recordings(folder, 9))
    assert "\n" not in str(error.value)
    return str(error.value).removeprefix(f"{folder}")


def test_what_is_no_folder_of_images_is_refused_in_a_sentence(tmp_path: Path) -> None:
    assert sentence(tmp_path / "none") == ": expected a folder of images, got no folder"
    expected = ": expected images (.tif, .tiff, .png, .bmp) in it or its folders, got none"
    assert sentence(tmp_path) == expected
    (tmp_path / "a.tif").write_bytes(b"no image at all")
    assert sentence(tmp_path) == "/a.tif: expected an image of a kind that OpenCV reads, got none"
    (tmp_path / "a.tif").write_bytes(b"")
    assert sentence(tmp_path) == "/a.tif: expected an image of a kind that OpenCV reads, got none"


def test_images_that_do_not_belong_together_are_refused_in_a_sentence(tmp_path: Path) -> None:
    write(tmp_path / "a_1.tif", image())
    write(tmp_path / "a_2.tif", image(shape=(30, 24)))
    got = sentence(tmp_path)
    assert "expected images of one size from each camera, got 1 of 24 x 30 and 1 of 30 x 24" in got


def test_colours_and_floats_are_refused_in_a_sentence(tmp_path: Path) -> None:
    colours = np.random.default_rng(1).integers(0, 255, (20, 20, 3)).astype(np.uint8)
    assert cv2.imwrite(str(tmp_path / "a.png"), colours)
    assert "/a.png: expected a grey image, got one with colours" in sentence(tmp_path)
    (tmp_path / "a.png").unlink()
    assert cv2.imwrite(str(tmp_path / "a.tif"), colours[..., 0].astype(np.float32) + 0.5)
    assert (
        sentence(tmp_path)
        == "/a.tif: expected whole grey values of 8 or 16 bits, got float32; convert it to 16 bits"
    )


def test_tiny_images_are_refused_in_a_sentence(tmp_path: Path) -> None:
    write(tmp_path / "a.png", image(shape=(8, 40)))
    assert sentence(tmp_path) == ": expected images of 16 x 16 pixels or more, got 8 x 40"
