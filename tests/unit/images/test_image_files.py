"""Image files: cameras, frames and grey values."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from sabench.images.image_files import find_image_files
from sabench.images.image_reading import RawLayout, read_images
from sabench.utils.arrays import U16
from tests.helpers.refusals import refused

CAMERAS = ("left", "right")


def touch(folder: Path, *names: str) -> Path:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(b"")
    return folder


def found(folder: Path, pattern: str | None = None) -> dict[str, list[str]]:
    files = find_image_files(folder, CAMERAS, pattern)
    return {name: [path.name for path in paths] for name, paths in files.items()}


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["a/i2.png", "a/i10.png", "b/i1.bmp"], {"a": ["i2.png", "i10.png"], "b": ["i1.bmp"]}),
        (["c1_9.tif", "c1_10.tif", "d_9.tif"], {"c1": ["c1_9.tif", "c1_10.tif"], "d": ["d_9.tif"]}),
        (["left.tif", "right.tif"], {"left": ["left.tif"], "right": ["right.tif"]}),
        (["cam1.tif", "cam2.tif"], {"cam1": ["cam1.tif"], "cam2": ["cam2.tif"]}),
        (["m1.avi", "m2.avi", "m3.avi"], {"m1": ["m1.avi"], "m2": ["m2.avi"], "m3": ["m3.avi"]}),
        (["1.png", "2.png", "3.png"], {"camera": ["1.png", "2.png", "3.png"]}),
        (
            [f"f{n}/{side}.png" for n in (0, 1) for side in CAMERAS],
            {side: [f"{side}.png"] * 2 for side in CAMERAS},
        ),
        (["a/i1.png", "a/notes.txt", "a/.i2.png", "Thumbs.db"], {"a": ["i1.png"]}),
    ],
)
def test_folders(names: list[str], expected: dict[str, list[str]], tmp_path: Path) -> None:
    assert found(touch(tmp_path, *names)) == expected


def test_pattern(tmp_path: Path) -> None:
    touch(tmp_path, "r/B2_10_x.im.tif", "r/B2_9_y.im.tif", "r/B10_9_z.im.tif", "r/other.tif")
    expected = {"B2": ["B2_9_y.im.tif", "B2_10_x.im.tif"], "B10": ["B10_9_z.im.tif"]}
    assert found(tmp_path, "r/{camera}_{frame}_*.im.tif") == expected


def test_patterns_that_fail_and_folders_without_images(tmp_path: Path) -> None:
    touch(tmp_path, "in/a_1.tif", "in/a_1b.tif", "raw/B1.im7", "raw/B2.im7")
    for pattern in ("{frame}.tif", "{camera}{kind}.tif", "{camera}{camera}.tif"):
        with refused("{camera}"):
            found(tmp_path / "in", pattern)
    for pattern in ("x/{camera}.tif", "*{camera}_{frame}*.tif"):
        with refused("/in"):
            found(tmp_path / "in", pattern)
    with refused("raw", "2", ".im7"):
        found(tmp_path / "raw")
    with refused("none"):
        found(tmp_path / "none")


SHAPE = (20, 32)


def stack(count: int = 3, most: int = 4000) -> U16:
    return np.asarray(np.random.default_rng(4).integers(0, most, (count, *SHAPE)), dtype=np.uint16)


def read(*files: Path, raw: RawLayout | None = None) -> U16:
    return np.stack([image for _, image in read_images(files, SHAPE, raw)])


def write(path: Path, values: Any, **options: Any) -> Path:
    import tifffile

    tifffile.imwrite(path, values, **({"photometric": "minisblack"} | options))
    return path


KINDS: list[dict[str, Any]] = [{"byteorder": ">"}, {"compression": "zlib"}, {"imagej": True}]
KINDS += [{"compression": "zlib", "predictor": True}, {"bigtiff": True}]
KINDS += [{"tile": (16, 16)}, {"rowsperstrip": 3}]


@pytest.mark.parametrize("options", KINDS)
def test_tiff_of_many_kinds(options: dict[str, Any], tmp_path: Path) -> None:
    assert_array_equal(read(write(tmp_path / "a.tif", stack(), **options)), stack())


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_zero_may_be_white(dtype: Any, tmp_path: Path) -> None:
    values = stack(most=255).astype(dtype)
    negative = write(tmp_path / "a.tif", np.iinfo(dtype).max - values, photometric="miniswhite")
    assert_array_equal(read(negative), values)


def test_many_pages_in_several_files(tmp_path: Path) -> None:
    values = stack(100)
    files = [
        write(tmp_path / f"{n}.tif", values[first:last])
        for n, (first, last) in enumerate([(0, 1), (1, 70), (70, 71), (71, 100)])
    ]
    assert_array_equal(read(*files), values)


@pytest.mark.parametrize("suffix", ["png", "bmp", "pgm"])
def test_images_of_8_bits(suffix: str, tmp_path: Path) -> None:
    import cv2

    value = stack(1, 255)[0].astype(np.uint8)
    for name, image in (("grey", value), ("rgb", np.repeat(value[..., None], 3, axis=2))):
        if suffix == "pgm" and name == "rgb":
            continue
        cv2.imwrite(str(tmp_path / f"{name}.{suffix}"), image)
        assert_array_equal(read(tmp_path / f"{name}.{suffix}")[0], value)


def test_whole_floats_are_grey_values(tmp_path: Path) -> None:
    assert_array_equal(read(write(tmp_path / "a.tif", stack().astype(">f4"))), stack())


def test_movie_without_loss(tmp_path: Path) -> None:
    import cv2

    values, path = stack(3, 255), tmp_path / "a.avi"
    code = cv2.VideoWriter.fourcc(*"FFV1")
    movie = cv2.VideoWriter(str(path), code, 25.0, SHAPE[::-1], False)
    for image in values:
        movie.write(image.astype(np.uint8))
    movie.release()
    assert_array_equal(read(path), values)


@pytest.mark.parametrize(("name", "dtype"), [("uint16", "<u2"), ("uint16-big", ">u2")])
def test_raw(name: str, dtype: str, tmp_path: Path) -> None:
    path = tmp_path / "a.raw"
    path.write_bytes(b"head" + stack().astype(dtype).tobytes())
    assert_array_equal(read(path, raw=RawLayout(name, 4)), stack())
    with refused("a.raw", "20 x 32"):
        read(path, raw=RawLayout(name))
    with refused("a.raw"):
        read(path)


def test_faults(tmp_path: Path) -> None:
    colours = np.zeros((*SHAPE, 3), dtype=np.uint8)
    colours[3, 4, 1] = 9
    broken = tmp_path / "broken.png"
    broken.write_bytes(b"no image")
    cases = {
        write(tmp_path / "c.tif", colours, photometric="rgb"): "",
        write(tmp_path / "f.tif", stack().astype(np.float32) + 0.5): "float32",
        broken: "",
        write(tmp_path / "t.tif", stack().transpose(0, 2, 1)): "32 x 20",
        write(tmp_path / "s.tif", stack()[:, :, 1:]): "20 x 31",
    }
    for path, got in cases.items():
        with refused(got) as caught:
            read(path)
        assert str(caught.value).startswith(str(path))
        assert "\n" not in str(caught.value)
