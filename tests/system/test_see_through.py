"""A code behind bubbles, from scene to score."""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from sabench.api.truth import NOTHING
from sabench.dataset.reader import Dataset
from sabench.dataset.verification import verify
from sabench.geometry.grid import Grid
from sabench.images.tiff_exr import read_exr
from sabench.interop.export import export
from sabench.metrics.code_reading import read_volume, reading, single_views
from sabench.plugins import load
from sabench.scenes import Scene
from sabench.simulation.pipeline import generate
from sabench.tasks.see_through import TASK
from sabench.tasks.solve_and_score import score, solve
from sabench.worlds.bubbles_and_bodies import code_of
from tests.conftest import Command
from tests.helpers.bubble_scenes import CURTAIN, PLATE, VOLUME, small
from tests.helpers.commands import refuse, succeed
from tests.helpers.refusals import refused


def behind(curtain: dict[str, Any] | None = CURTAIN, **plate: Any) -> Scene:
    tables = {"volume": VOLUME, "grid": {"voxel_mm": [0.25, 0.25, 2.0]}}
    return small(**tables, bubbles=curtain, solids=[PLATE | plate], render={"relative_error": 0.1})


@pytest.fixture(scope="module")
def veiled(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return generate(behind(), tmp_path_factory.mktemp("veiled") / "data", seed=3)


def coloured(png: bytes) -> float:
    image = cv2.imdecode(np.frombuffer(png, dtype=np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    return 100.0 * float((np.ptp(image, axis=2) > 0).mean())


@pytest.mark.slow
def test_a_refocused_plane_shows_what_single_views_do_not(veiled: Dataset, tmp_path: Path) -> None:
    assert verify(veiled.root) == []
    assert veiled.shows == ("bubbles", "code")
    scores = {}
    for method in ("additive", "multiplicative", "dark", "mart"):
        own = {"method": method}
        result = solve("see_through", veiled, tmp_path / f"{method}.h5", parameters=own)
        assert result.task == "see_through"
        scores[method] = score(veiled, tmp_path / f"{method}.h5")
        assert coloured(TASK.error_picture(veiled, result)) == pytest.approx(
            100.0 - scores[method]["read_percent"], abs=3.0
        )
    export(veiled, tmp_path / "vtk", tmp_path / "dark.h5")
    assert {file.stem for file in (tmp_path / "vtk").glob("*.vtkhdf")} == {"rig", "volume_0000"}
    for method in ("additive", "dark"):
        assert scores[method]["separation"] > 1.5 * scores[method]["single_separation"]
        assert scores[method]["read_percent"] > scores[method]["single_percent"]
    assert scores["dark"]["read_percent"] > 95.0


@pytest.mark.slow
def test_without_bubbles_every_view_shows_the_code(tmp_path: Path) -> None:
    """At a tilt, behind the wall, the code is dark along the cameras' own lines of sight."""
    data = generate(behind(None, turn_deg=[0.0, 30.0, 10.0]), tmp_path / "data", seed=4)
    code = code_of(data.scene, 4, 0)
    assert code.dark.sum() == 15
    cells = single_views(data.observation(0).images, data.true_cameras, code.points_mm)
    assert cells[:, code.dark].max() < 0.2 * cells[:, ~code.dark].min()
    seen = data.sight(0, data.true_cameras[0]).number
    assert (seen[seen != NOTHING] == NOTHING - 1).all()
    assert score(data, "truth")["best_single_percent"] == 100.0


@pytest.mark.slow
def test_a_bent_code_is_read_on_its_cylinder(tmp_path: Path, command: Command) -> None:
    """Refocused by the command; the task reads the same code in the stack of planes."""
    scene = behind(None, bend_radius_mm=6.0, place_mm=[0.0, 0.0, 62.0])
    data = generate(scene, tmp_path / "data", seed=4)
    words = ["--surface", "cylinder", "-p", "radius_mm=6", "-p", "center_mm=[0,0,62]"]
    size = ["-p", "size_mm=[12,10]", "-p", "pixel_mm=0.1", "--json"]
    summary = json.loads(succeed(command("refocus", "data", "-o", "wall", *words, *size)).stdout)
    assert (summary["rows"], summary["columns"]) == (101, 121)
    assert summary["seen_percent"] == 100.0
    image = read_exr(tmp_path / "wall" / "image.exr", (101, 121))
    code = code_of(data.scene, 4, 0)
    grid = Grid((-6.0, -5.0, 0.0), (0.1, 0.1, 1.0), (1, 101, 121))
    flat = code.points_mm - [0.0, 0.0, 68.0]
    own = np.stack([6.0 * np.arctan2(flat[..., 0], -flat[..., 2]), flat[..., 1]], axis=-1)
    own = np.concatenate([own, np.zeros((*own.shape[:2], 1))], axis=-1)
    assert reading(read_volume(grid, image[None], own), code.dark)["read_percent"] == 100.0
    solve("see_through", data, tmp_path / "dark.h5")
    assert score(data, tmp_path / "dark.h5")["read_percent"] == 100.0
    refuse(command("refocus", "data", "-o", "wall"), "wall")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "key"),
    [
        (["--surface", "sphere"], "--surface"),
        (["--join", "sum"], "--join"),
        (["-p", "radius_mm=3"], "plane: radius_mm"),
        (["--surface", "height_map"], "height_map: file"),
        (["-p", "turn_deg=[0,180,0]"], "cameras"),
        (["--frame", "7"], "frame 7"),
    ],
)
def test_wrong_surfaces_are_one_sentence(
    veiled: Dataset, command: Command, tmp_path: Path, words: list[str], key: str
) -> None:
    refuse(command("refocus", str(veiled.root), "-o", "wall", *words), key)
    assert not (tmp_path / "wall").exists()


def test_the_code_comes_from_the_seed() -> None:
    plugin = load("generators", "code_plate")
    plate = plugin(plugin.Parameters())
    np.testing.assert_array_equal(plate.code(1).dark, plate.code(1).dark)
    assert (plate.code(1).dark != plate.code(2).dark).sum() > 50
    assert len(plate.body(1).faces) == 12 * plate.code(1).dark.sum()


@pytest.mark.slow
def test_what_has_no_code_is_refused(tmp_path: Path) -> None:
    none = {"generator": "bubble_field", "count": 0}
    data = generate(small(bubbles=none, render={"relative_error": 0.2}), tmp_path / "data", seed=1)
    with refused("see_through"):
        solve("see_through", data, tmp_path / "r.h5")
    with refused("low_mm, high_mm"):
        generate(behind(CURTAIN | {"high_mm": [9.0, 8.0, 80.0]}), tmp_path / "other", seed=1)
