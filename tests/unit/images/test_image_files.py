"""Cameras and frames of image files."""

from __future__ import annotations

from pathlib import Path

import pytest

from sabench.images.image_files import find_image_files
from sabench.utils.errors import InputError

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
        (
            ["c1_9.tif", "c1_10.tif", "c2_9.tif"],
            {"c1": ["c1_9.tif", "c1_10.tif"], "c2": ["c2_9.tif"]},
        ),
        (["left.tif", "right.tif"], {"left": ["left.tif"], "right": ["right.tif"]}),
        (["cam1.tif", "cam2.tif"], {"cam1": ["cam1.tif"], "cam2": ["cam2.tif"]}),
        (["m1.avi", "m2.avi", "m3.avi"], {"m1": ["m1.avi"], "m2": ["m2.avi"], "m3": ["m3.avi"]}),
        (["1.png", "2.png", "3.png"], {"camera": ["1.png", "2.png", "3.png"]}),
        (
            ["f0/left.png", "f0/right.png", "f1/left.png", "f1/right.png"],
            {"left": ["left.png"] * 2, "right": ["right.png"] * 2},
        ),
        (["a/i1.png", "a/notes.txt", "a/.i2.png", "Thumbs.db"], {"a": ["i1.png"]}),
    ],
)
def test_folders_of_recorders(
    names: list[str], expected: dict[str, list[str]], tmp_path: Path
) -> None:
    assert found(touch(tmp_path, *names)) == expected


def test_pattern(tmp_path: Path) -> None:
    touch(tmp_path, "r/B2_10_x.im.tif", "r/B2_9_y.im.tif", "r/B10_9_z.im.tif", "r/other.tif")
    expected = {"B2": ["B2_9_y.im.tif", "B2_10_x.im.tif"], "B10": ["B10_9_z.im.tif"]}
    assert found(tmp_path, "r/{camera}_{frame}_*.im.tif") == expected


@pytest.mark.parametrize(
    ("pattern", "expected"),
    [
        ("{frame}.tif", "{camera}"),
        ("{camera}{kind}.tif", "{camera}"),
        ("{camera}{camera}.tif", "{camera}"),
        ("x/{camera}.tif", "got none"),
        ("*{camera}_{frame}*.tif", "one file for each camera and frame"),
    ],
)
def test_patterns_that_fail(pattern: str, expected: str, tmp_path: Path) -> None:
    touch(tmp_path, "a_1.tif", "a_1b.tif")
    with pytest.raises(InputError, match=expected):
        found(tmp_path, pattern)


def test_no_images(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"got 2 x \.im7"):
        found(touch(tmp_path, "B1.im7", "B2.im7"))
    with pytest.raises(InputError, match="got no folder"):
        found(tmp_path / "none")
