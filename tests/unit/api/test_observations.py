"""Checks of a solver's input before it starts. One sentence for every input that no algorithm can
use."""

import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sabench
from sabench.api import Observation
from sabench.dataset.reader import Dataset
from sabench.geometry.grid import Grid
from sabench.images.tiff_exr import write_tiff
from sabench.simulation.in_memory import simulate
from sabench.tasks.reconstruction import TASK
from sabench.utils import memory
from sabench.utils.errors import InputError
from tests.conftest import pinholes
from tests.helpers.particle_scenes import make_scene


@pytest.fixture(scope="module")
def case() -> Observation:
    return simulate(make_scene(particles={"count": 30}), seed=1).observation


Change = Callable[[Observation], dict[str, Any]]


def with_nan(case: Observation) -> dict[str, Any]:
    images = case.images.astype(np.float32)
    images[1, 2, 3:6] = [np.nan, np.inf, -4.0]
    return {"images": images}


def with_other_camera(case: Observation) -> dict[str, Any]:
    return {
        "cameras": (*case.cameras[:2], replace(pinholes(case.cameras)[2], rows=90), case.cameras[3])
    }


REFUSED: list[tuple[Change, str]] = [
    (lambda case: {"images": case.images[:3]}, "images: expected one for each of 4 cameras, got"),
    (lambda case: {"images": case.images[:2]}, "images: expected one for each of 4 cameras, got"),
    (lambda case: {"cameras": case.cameras[:3]}, "images: expected one for each of 3 cameras"),
    (lambda case: {"images": case.images[:0], "cameras": ()}, "images: expected one for each of"),
    (lambda case: {"images": case.images[0]}, "images: expected the shape (camera, row, column)"),
    (lambda case: {"images": list(case.images)}, "images: expected one uint16 array"),
    (with_nan, "images: expected uint16 grey values, got float32, 2 of them NaN or infinite, 1"),
    (lambda case: {"images": case.images.astype(np.float64)}, "images: expected uint16 grey"),
    (
        lambda case: {"images": -case.images.astype(np.int32)},
        f"images: expected uint16 grey values, got int32, {4 * 110 * 170} of them negative",
    ),
    (lambda case: {"images": case.images[:, :100]}, "camera_00: expected an image of 110 x 170"),
    (with_other_camera, "camera_02: expected an image of 90 x 170 pixels (rows x columns), got"),
    (lambda case: {"black_dn": 4024.0, "white_dn": 4024.0}, "black_dn: expected it below"),
    (lambda case: {"white_dn": float("nan")}, "black_dn: expected it below white_dn, got 64 and"),
]


@pytest.mark.parametrize(("change", "sentence"), REFUSED)
def test_a_bad_observation_is_refused(case: Observation, change: Change, sentence: str) -> None:
    with pytest.raises(InputError, match=re.escape(sentence)):
        replace(case, **change(case))


def test_a_saturated_image_is_refused_and_a_black_one_is_not(case: Observation) -> None:
    images = case.images.copy()
    images[2] = int(case.white_dn)
    with pytest.raises(InputError, match="d: frame 0: camera_02: expected an image that shows"):
        TASK.check_case(replace(case, images=images), "d: frame 0")
    images[2, 50, 60] -= 1
    TASK.check_case(replace(case, images=images), "d: frame 0")
    images[2] = 0
    TASK.check_case(replace(case, images=images), "d: frame 0")
    TASK.check_case(replace(case, images=np.zeros_like(images)), "d: frame 0")


def test_a_grid_out_of_view_is_refused(case: Observation) -> None:
    grid = case.grid
    for low in (
        (50.0, 0.0, 30.0),
        (-1.0, -1.0, -3.0),
        (-1.0, -1.0, -2000.0),
    ):  # beside the images, in the glass, behind the cameras
        away = Grid(low, grid.voxel_mm, (40, 40, 40) if low[2] != -3.0 else (40, 40, 10))
        with pytest.raises(InputError, match="d: frame 0: grid: expected it in view of at least"):
            TASK.check_case(replace(case, grid=away), "d: frame 0")
    # a row that begins in view
    TASK.check_case(
        replace(case, grid=Grid((3.0, 0.0, 30.0), grid.voxel_mm, (1, 1, 300))), "d: frame 0"
    )


def test_a_grid_that_does_not_fit_is_refused_before_it_is_allocated(
    case: Observation, monkeypatch: pytest.MonkeyPatch
) -> None:
    huge = replace(case, grid=Grid(case.grid.low_mm, case.grid.voxel_mm, (4000, 5000, 6000)))
    monkeypatch.setattr(memory, "available_mb", lambda: 5000.0)
    with pytest.raises(InputError, match=r"960000 MB where 5000 MB .*: at most 20 of its planes"):
        TASK.check_case(huge, "d: frame 0")
    monkeypatch.setattr(memory, "available_mb", lambda: 100.0)
    count = (100_000_000 - 4 * case.images.size) // 8
    with pytest.raises(InputError, match=f"where 100 MB .*: at most {count} of its voxels fit"):
        TASK.check_case(huge, "d: frame 0")
    monkeypatch.setattr(memory, "available_mb", lambda: None)
    TASK.check_case(replace(case, grid=case.grid), "d: frame 0")


def test_the_largest_named_grid_fits(case: Observation, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "available_mb", lambda: 50.0)
    for planes, fits in ((62, True), (63, False)):
        grid = Grid(case.grid.low_mm, case.grid.voxel_mm, (planes, 300, 330))
        if fits:
            TASK.check_case(replace(case, grid=grid), "d")
        else:
            with pytest.raises(InputError, match=r"at most 62 of its planes fit$"):
                TASK.check_case(replace(case, grid=grid), "d")


def test_the_system_says_what_memory_is_there() -> None:
    there = memory.available_mb()
    assert there is not None
    assert 10.0 < there < 1e8


def test_a_refused_frame_leaves_nothing(tmp_path: Path) -> None:
    """A refused second frame leaves no result, and no part of one. The first frame is solved."""
    data: Dataset = sabench.generate(
        make_two_frames(), tmp_path / "set", seed=1, backend="splat", name="s"
    )
    white = np.full((110, 170), 4024, dtype=np.uint16)
    copy = Path(shutil.copytree(data.root, tmp_path / "copy"))
    write_tiff(copy / "images/frame_0001/camera_01.tif", white)
    with pytest.raises(InputError, match="copy: frame 1: camera_01: expected an image that shows"):
        sabench.solve("msa", copy, tmp_path / "r.h5")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["copy", "set"]


def make_two_frames() -> Any:
    return make_scene(particles={"count": 30}).model_copy(update={"frames": 2})
