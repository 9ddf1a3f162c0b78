"""points.csv as strangers write it, and a target's own points."""

from pathlib import Path

import numpy as np
import pytest

from sabench.apps.own_calibration.folder import (
    read_loose_points,
    read_sightings,
    read_target_points,
)
from tests.helpers.refusals import refused

NAMES = ("a", "b")
HEAD = "camera,frame,point,column,row"
TABS = """camera frame point column row x_mm y_mm z_mm sigma_x_mm sigma_y_mm sigma_z_mm
a 0 1 1.5 2.5 10 20 30 0.02 0.02 0.02
b 0 1 3.5 4.5 10 20 30 0.02 0.02 0.02"""


def write(folder: Path, text: str) -> Path:
    path = folder / "points.csv"
    path.write_bytes(text.encode())
    return path


@pytest.mark.parametrize(
    "text",
    [
        f"{HEAD},x_mm,y_mm,z_mm,sigma_mm\na,0,1,1.5,2.5,10,20,30,0.02\nb,0,1,3.5,4.5,,,,\n",
        f"\ufeff{HEAD},X,Y,Z,Sigma\r\na,0,1,1.5,2.5,10,20,30,.02\r\nb,0,1,3.5,4.5,,,,\r\n\r\n",
        "frame;point;camera;column;row;x;y;z;sigma\n0;1;a;1,5;2,5;10;20;30;0,02\n0;1;b;3,5;4,5;;;;\n",
        TABS.replace(" ", "\t"),
    ],
)
def test_separators_and_capitals_do_not_matter(text: str, tmp_path: Path) -> None:
    seen = read_sightings(write(tmp_path, text), NAMES, 3)
    assert seen.pixels.shape == (2, 1, 3, 2)
    np.testing.assert_array_equal(seen.pixels[:, 0, 1], [[1.5, 2.5], [3.5, 4.5]])
    np.testing.assert_array_equal(seen.known_mm[0, 1], [10.0, 20.0, 30.0])
    np.testing.assert_array_equal(seen.sigma_mm[0, 1], [0.02, 0.02, 0.02])
    assert np.isfinite(seen.pixels).sum() == 4
    assert np.isfinite(seen.known_mm).sum() == 3


def test_points_without_a_target_are_frames_of_their_own(tmp_path: Path) -> None:
    text = f"{HEAD},x_mm,y_mm,z_mm\na,4,7,1,2,0,0,1\na,2,9,3,4,0,0,2\nb,4,7,5,6,0,0,1\n"
    seen = read_loose_points(write(tmp_path, text), NAMES)
    assert seen.pixels.shape == (2, 2, 1, 2)
    assert (seen.frames.tolist(), seen.points.tolist()) == ([2, 4], [[9], [7]])
    np.testing.assert_array_equal(seen.known_mm[:, 0, 2], [2.0, 1.0])
    np.testing.assert_array_equal(seen.sigma_mm, 0.05)


@pytest.mark.parametrize(
    ("text", "key"),
    [
        (f"{HEAD},quality\n", "quality"),
        (f"{HEAD}\na,0,1,1\n", "line 2"),
        (f"{HEAD}\na,0,1,nan,2\n", "line 2: column"),
        (f"{HEAD}\na,-1,1,1,2\n", "line 2: frame"),
        (f"{HEAD}\na,0,3,1,2\n", "a, frame 0, point 3"),
        (f"{HEAD},x,y,z,sigma\na,0,1,1,2,1,1,1,0\n", "sigma_mm"),
        (f"{HEAD},x,y,z\na,0,1,1,2,1,1,1\nb,0,1,1,2,1,1,2\n", "line 3: frame 0"),
    ],
)
def test_a_fault_names_the_line(text: str, key: str, tmp_path: Path) -> None:
    with refused("points.csv", key):
        read_sightings(write(tmp_path, text), NAMES, 3)


def test_loose_points_need_places(tmp_path: Path) -> None:
    with refused("line 2"):
        read_loose_points(write(tmp_path, f"{HEAD}\na,0,1,1,2\n"), NAMES)


def test_a_target_of_any_shape(tmp_path: Path) -> None:
    path = write(tmp_path, "point,x_mm,y_mm,z_mm\n1,1,0,5\n0,0,0,0\n2,0,1,0\n")
    assert read_target_points(path) == ((0.0, 0.0, 0.0), (1.0, 0.0, 5.0), (0.0, 1.0, 0.0))
    with refused():
        read_target_points(write(tmp_path, "point,x_mm,y_mm,z_mm\n1,1,0,5\n0,0,0,0\n"))
    with refused("none.csv"):
        read_target_points(tmp_path / "none.csv")
