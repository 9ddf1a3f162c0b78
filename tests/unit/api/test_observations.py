"""Checks of a solver's input before it starts."""

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sabench
from sabench.api import Observation
from sabench.geometry.grid import Grid
from sabench.images.tiff_exr import write_tiff
from sabench.simulation.in_memory import simulate
from sabench.tasks.reconstruction import TASK
from sabench.utils import memory
from tests.conftest import pinholes
from tests.helpers.particle_scenes import make_scene
from tests.helpers.refusals import refused


@pytest.fixture(scope="module")
def case() -> Observation:
    return simulate(make_scene(particles={"count": 30}), seed=1).observation


Change = Callable[[Observation], dict[str, Any]]


def with_nan(case: Observation) -> dict[str, Any]:
    images = case.images.astype(np.float32)
    images[1, 2, 3:6] = [np.nan, np.inf, -4.0]
    return {"images": images}


def with_other_camera(case: Observation) -> dict[str, Any]:
    own = replace(pinholes(case.cameras)[2], rows=90)
    return {"cameras": (*case.cameras[:2], own, case.cameras[3])}


REFUSED: list[tuple[Change, str]] = [
    (lambda case: {"images": case.images[:3]}, "images"),
    (lambda case: {"cameras": case.cameras[:3]}, "images"),
    (lambda case: {"images": case.images[:0], "cameras": ()}, "images"),
    (lambda case: {"images": case.images[0]}, "images"),
    (lambda case: {"images": list(case.images)}, "images"),
    (with_nan, "2 of them NaN or infinite, 1"),
    (lambda case: {"images": case.images.astype(np.float64)}, "images"),
    (lambda case: {"images": -case.images.astype(np.int32)}, f"{4 * 110 * 170} of them negative"),
    (lambda case: {"images": case.images[:, :100]}, "camera_00"),
    (with_other_camera, "camera_02"),
    (lambda case: {"black_dn": 4024.0, "white_dn": 4024.0}, "black_dn"),
    (lambda case: {"white_dn": float("nan")}, "black_dn"),
]


@pytest.mark.parametrize(("change", "key"), REFUSED)
def test_a_bad_observation_is_refused(case: Observation, change: Change, key: str) -> None:
    with refused(key):
        replace(case, **change(case))


def test_a_saturated_image_is_refused_and_a_black_one_is_not(case: Observation) -> None:
    images = case.images.copy()
    images[2] = int(case.white_dn)
    with refused("d: frame 0", "camera_02"):
        TASK.check_case(replace(case, images=images), "d: frame 0")
    images[2, 50, 60] -= 1
    TASK.check_case(replace(case, images=images), "d")
    images[2] = 0
    TASK.check_case(replace(case, images=images), "d")
    TASK.check_case(replace(case, images=np.zeros_like(images)), "d")


def test_a_grid_out_of_view_is_refused(case: Observation) -> None:
    voxel_mm = case.grid.voxel_mm
    beside, behind = (50.0, 0.0, 30.0), (-1.0, -1.0, -2000.0)
    for low, columns in ((beside, 40), ((-1.0, -1.0, -3.0), 10), (behind, 40)):
        with refused("d: frame 0", "grid"):
            away = Grid(low, voxel_mm, (40, 40, columns))
            TASK.check_case(replace(case, grid=away), "d: frame 0")
    from_view = Grid((3.0, 0.0, 30.0), voxel_mm, (1, 1, 300))  # a row that begins in view
    TASK.check_case(replace(case, grid=from_view), "d")


def test_a_grid_that_does_not_fit_is_refused_before_it_is_allocated(
    case: Observation, monkeypatch: pytest.MonkeyPatch
) -> None:
    huge = replace(case, grid=Grid(case.grid.low_mm, case.grid.voxel_mm, (4000, 5000, 6000)))
    monkeypatch.setattr(memory, "available_mb", lambda: 5000.0)
    with refused("960000 MB", "5000 MB", "20"):
        TASK.check_case(huge, "d: frame 0")
    monkeypatch.setattr(memory, "available_mb", lambda: 100.0)
    count = (100_000_000 - 4 * case.images.size) // 8
    with refused("100 MB", str(count)):
        TASK.check_case(huge, "d: frame 0")
    monkeypatch.setattr(memory, "available_mb", lambda: None)
    TASK.check_case(replace(case, grid=case.grid), "d: frame 0")


def test_the_largest_named_grid_fits(case: Observation, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "available_mb", lambda: 50.0)
    largest = Grid(case.grid.low_mm, case.grid.voxel_mm, (62, 300, 330))
    TASK.check_case(replace(case, grid=largest), "d")
    with refused("62"):
        TASK.check_case(replace(case, grid=replace(largest, shape=(63, 300, 330))), "d")


def test_the_system_says_what_memory_is_there() -> None:
    assert 10.0 < (memory.available_mb() or 0.0) < 1e8


def test_a_refused_frame_leaves_nothing(tmp_path: Path) -> None:
    """A refused second frame leaves no result, and no part of one. The first frame is solved."""
    scene = make_scene(particles={"count": 30}).model_copy(update={"frames": 2})
    data = sabench.generate(scene, tmp_path / "set", seed=1, backend="splat", name="s")
    copy = Path(shutil.copytree(data.root, tmp_path / "copy"))
    write_tiff(copy / "images/frame_0001/camera_01.tif", np.full((110, 170), 4024, dtype=np.uint16))
    with refused("copy: frame 1", "camera_01"):
        sabench.solve("msa", copy, tmp_path / "r.h5")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["copy", "set"]
