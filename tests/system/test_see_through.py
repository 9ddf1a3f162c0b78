"""A code behind bubbles, from scene to score.

Single views show less of it than a refocused plane.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from sabench.api.truth import NOTHING
from sabench.dataset.reader import Dataset
from sabench.dataset.verification import verify
from sabench.interop.export import export
from sabench.metrics.code_reading import single_views
from sabench.plugins import load
from sabench.scenes import Scene
from sabench.simulation.pipeline import generate
from sabench.tasks.see_through import TASK
from sabench.tasks.solve_and_score import score, solve
from sabench.utils.errors import InputError
from sabench.worlds.readable_codes import code_of
from tests.helpers.bubble_scenes import small

PLATE = {
    "generator": "code_plate",
    "columns": 6,
    "rows": 5,
    "cell_mm": 2.0,
    "place_mm": [0.0, 0.0, 66.0],
    "material": {"reflectance": 0.0},
}
CURTAIN = {
    "generator": "bubble_field",
    "count": 14,
    "radius_mm": 1.2,
    "radius_spread": 0.1,
    "radius_range_mm": [0.9, 1.6],
    "low_mm": [-9.0, -8.0, 28.0],
    "high_mm": [9.0, 8.0, 40.0],
}
VOLUME = {"center_mm": [0.0, 0.0, 48.0], "size_mm": [24.0, 18.0, 40.0]}


def behind(curtain: dict[str, Any] | None = CURTAIN, **plate: Any) -> Scene:
    """The small scene with a code."""
    grid = {"voxel_mm": [0.25, 0.25, 2.0]}
    return small(
        volume=VOLUME,
        grid=grid,
        bubbles=curtain,
        solids=[PLATE | plate],
        render={"relative_error": 0.1},
    )


@pytest.fixture(scope="module")
def veiled(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return generate(behind(), tmp_path_factory.mktemp("veiled") / "data", seed=3)


def coloured(png: bytes) -> float:
    """Percentage of a picture's pixels that are not grey."""
    image = cv2.imdecode(np.frombuffer(png, dtype=np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    return 100.0 * float((np.ptp(image, axis=2) > 0).mean())


def test_a_refocused_plane_shows_what_single_views_do_not(veiled: Dataset, tmp_path: Path) -> None:
    assert verify(veiled.root) == []
    assert veiled.shows == ("bubbles", "code")
    scores = {}
    for method in ("additive", "multiplicative", "dark", "mart"):
        result = solve(
            "see_through", veiled, tmp_path / f"{method}.h5", parameters={"method": method}
        )
        assert result.task == "see_through"
        scores[method] = score(veiled, tmp_path / f"{method}.h5")
        assert coloured(TASK.error_picture(veiled, result)) == pytest.approx(
            100.0 - scores[method]["read_percent"], abs=3.0
        )
    export(veiled, tmp_path / "vtk", tmp_path / "dark.h5")
    assert [file.name for file in (tmp_path / "vtk").iterdir()] == ["volume_0000.vtkhdf"]
    for method in ("additive", "dark"):
        assert scores[method]["separation"] > 1.5 * scores[method]["single_separation"]
        assert scores[method]["read_percent"] > scores[method]["single_percent"]
    assert scores["dark"]["read_percent"] > 95.0


def test_without_bubbles_every_view_shows_the_code(tmp_path: Path) -> None:
    """The code is where the images are dark.

    At a tilt, behind the wall, by the cameras' own lines of sight.
    """
    data = generate(behind(None, turn_deg=[0.0, 30.0, 10.0]), tmp_path / "data", seed=4)
    code = code_of(data.scene, 4, 0)
    assert code.dark.sum() == 15
    cells = single_views(data.observation(0).images, data.true_cameras, code.points_mm)
    assert cells[:, code.dark].max() < 0.2 * cells[:, ~code.dark].min()
    seen = data.sight(0, data.true_cameras[0]).number
    assert (seen[seen != NOTHING] == NOTHING - 1).all()
    assert score(data, "truth")["best_single_percent"] == 100.0


def test_both_ends_of_the_scale(veiled: Dataset) -> None:
    assert score(veiled, "truth")["read_percent"] == 100.0
    assert score(veiled, "empty")["read_percent"] == 50.0


def test_the_code_comes_from_the_seed() -> None:
    plugin = load("generators", "code_plate")
    plate = plugin(plugin.Parameters())
    np.testing.assert_array_equal(plate.code(1).dark, plate.code(1).dark)
    assert (plate.code(1).dark != plate.code(2).dark).sum() > 50
    solid = plate.body(1)
    assert len(solid.faces) == 12 * plate.code(1).dark.sum()


def test_what_has_no_code_is_refused(veiled: Dataset, tmp_path: Path) -> None:
    data = generate(
        small(bubbles={"generator": "bubble_field", "count": 0}, render={"relative_error": 0.2}),
        tmp_path / "data",
        seed=1,
    )
    with pytest.raises(
        InputError,
        match=r"solver see_through: expected a data set that shows a code, but .* shows bubbles",
    ):
        solve("see_through", data, tmp_path / "r.h5")
    with pytest.raises(
        InputError, match="low_mm, high_mm: expected rising corners within the volume"
    ):
        generate(behind(CURTAIN | {"high_mm": [9.0, 8.0, 80.0]}), tmp_path / "other", seed=1)
