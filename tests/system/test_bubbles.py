"""Bubbles from scene to score.

Data sets with all phases, the detections of solvers, and errors for bad input.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sabench.api import Detections, Observation
from sabench.api.make import make_algorithm
from sabench.api.truth import NOTHING
from sabench.dataset.reader import Dataset
from sabench.dataset.verification import verify
from sabench.plugins import load, names
from sabench.scenes import build_rig
from sabench.simulation.frames import Frames
from sabench.simulation.pipeline import generate
from sabench.tasks.solve_and_score import score, solve
from sabench.utils.arrays import F64
from sabench.utils.errors import InputError
from tests.helpers.bubble_scenes import LASER, small

SOLVERS = [name for name in names("solvers") if load("solvers", name).task == "bubbles"]


@pytest.fixture(scope="module")
def bubbly(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return generate(small(), tmp_path_factory.mktemp("bubbly") / "data", seed=2)


@pytest.mark.slow
def test_a_data_set_keeps_what_was_made(bubbly: Dataset) -> None:
    assert verify(bubbly.root) == []
    assert bubbly.shows == ("bubbles",)
    made, kept = Frames(small(), build_rig(small()), 2).at(0).bubbles, bubbly.bubbles(0)
    for name in ("id", "center_mm", "semi_axes_mm", "turn", "velocity_mm_s"):
        np.testing.assert_array_equal(getattr(made, name), getattr(kept, name))
    assert kept.index == 1.0
    for camera in bubbly.setup.cameras:
        sight = bubbly.sight(0, camera)
        assert sight.error is not None
        assert 0.02 < sight.error <= 0.04  # as asked for by default
        assert sight.visible.max() == pytest.approx(1.0, abs=0.02)
        image = bubbly.observation(0).images[bubbly.setup.cameras.index(camera)]
        shown = np.median(image[sight.number == NOTHING])
        assert shown == pytest.approx(0.7 * 4000.0, rel=0.06)
        assert image[sight.number != NOTHING].mean() < 0.6 * shown


@pytest.mark.slow
def test_the_same_seed_makes_the_same_bytes(tmp_path: Path) -> None:
    scene = small(render={"relative_error": 0.2})
    one, again, other = (
        generate(scene, tmp_path / name, seed=seed).content_hash
        for name, seed in (("one", 2), ("again", 2), ("other", 3))
    )
    assert again == one
    assert other != one


@pytest.mark.slow
def test_the_truth_scores_one_and_nothing_scores_nothing(bubbly: Dataset) -> None:
    true, nothing = score(bubbly, "truth"), score(bubbly, "empty")
    assert true["task"] == "bubbles"
    assert true["f1"] == true["f1_large"] == true["precision"] == 1.0
    assert true["depth_mm"] == true["radius_percent"] == 0.0
    assert nothing["f1"] == 0.0
    assert nothing["void_percent"] == 100.0
    assert nothing["penetration_percent"] is None


@pytest.mark.slow
@pytest.mark.parametrize("name", SOLVERS)
def test_solvers_find_bubbles_that_nothing_hides(
    name: str, bubbly: Dataset, tmp_path: Path
) -> None:
    plugin = load("solvers", name)
    assert plugin.references
    assert all(field.description for field in plugin.Parameters.model_fields.values())
    result = solve(name, bubbly, tmp_path / "found.h5")
    found = score(bubbly, tmp_path / "found.h5")
    assert result.task == "bubbles"
    assert found["f1"] > {"rim_fit": 0.9}.get(name, 0.5)
    assert found["plane_mm"] < 0.15
    assert found["radius_percent"] < {"rim_fit": 3.0}.get(name, 20.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", SOLVERS)
@pytest.mark.parametrize("level", ["black", "bright", "saturated"])
def test_images_without_bubbles_have_none(name: str, level: str, bubbly: Dataset) -> None:
    case = bubbly.observation(0)
    value = {"black": case.black_dn, "bright": 0.7 * case.white_dn, "saturated": case.white_dn}[
        level
    ]
    empty = Observation(
        np.full_like(case.images, int(value)), case.cameras, case.grid, case.black_dn, case.white_dn
    )
    algorithm: Any = make_algorithm(name, {})
    found: Detections = algorithm.solve(empty)
    assert len(found.center_mm) == 0


def test_no_bubbles_make_a_whole_data_set(tmp_path: Path) -> None:
    data = generate(
        small(bubbles={"generator": "bubble_field", "count": 0}), tmp_path / "none", seed=1
    )
    assert verify(data.root) == []
    assert len(data.bubbles(0)) == 0
    assert score(data, "truth")["f1"] is None


@pytest.mark.slow
def test_three_phases_in_one_image(tmp_path: Path) -> None:
    """Tracers, bubbles and a cylinder in one scene.

    Tracers are outside the bodies, and dark in their shadows.
    """
    solid = {
        "generator": "cylinder",
        "radius_mm": 2.0,
        "length_mm": 17.0,
        "place_mm": [-6.0, 0.0, 60.0],
        "material": {"reflectance": 0.0},
    }
    field = {"generator": "bubble_list", "center_mm": [[4.0, 0.0, 60.0]], "radius_mm": [2.5]}
    tracers_too = {"generator": "uniform", "count": 2500, "diameter_mm": 0.05}
    light = {"center_mm": [0.0, 0.0, 400.0], "size_mm": [260.0, 260.0], "exposure": 0.05}
    scene = small(
        render={"relative_error": 0.05},
        bubbles=field,
        solids=[solid],
        illumination=LASER,
        particles=tracers_too,
        backlight=light,
    )
    data = generate(scene, tmp_path / "three", seed=1)
    assert verify(data.root) == []
    assert data.shows == ("particles", "bubbles")
    tracers = data.particles(0).position_mm
    assert len(tracers) < 2500
    assert np.linalg.norm(tracers - [4.0, 0.0, 60.0], axis=1).min() > 2.5
    beside = np.abs(tracers[:, 1]) < 8.5
    assert np.hypot(tracers[beside, 0] + 6.0, tracers[beside, 2] - 60.0).min() > 1.99
    view = data.views(0)[0]
    across = np.hypot(tracers[:, 1], tracers[:, 2] - 60.0)
    behind_bubble = (across < 2.3) & (tracers[:, 0] > 6.6)
    behind_body = (
        (np.abs(tracers[:, 2] - 60.0) < 1.9)
        & (np.abs(tracers[:, 1]) < 8.0)
        & (tracers[:, 0] > -4.0)
    )
    free = (
        (np.abs(tracers[:, 2] - 60.0) > 3.0)
        & (np.abs(tracers[:, 2] - 60.0) < 7.0)
        & (np.abs(tracers[:, 1]) < 8.0)
    )
    assert (view.photons[behind_bubble | behind_body] == 0.0).all()
    assert (view.photons[free] > 0.0).mean() > 0.99
    (body,) = data.solids(0)
    assert np.ptp(body.vertices_mm, axis=0) == pytest.approx([4.0, 17.0, 4.0], abs=0.02)
    middle = next(camera for camera in data.setup.cameras if np.allclose(camera.center_mm[:2], 0.0))
    sight = data.sight(0, middle)
    assert (sight.number == NOTHING - 1).mean() > 0.05
    hidden = data.views(0)[data.setup.cameras.index(middle)]
    back = (
        (np.abs(tracers[:, 0] + 6.0) < 1.0) & (tracers[:, 2] > 64.0) & (np.abs(tracers[:, 1]) < 6.0)
    )
    assert back.sum() > 10
    assert (hidden.visible[back] == 0.0).mean() > 0.95


def places(*centers: list[float], radius: float = 1.0, **more: Any) -> dict[str, Any]:
    return {
        "generator": "bubble_list",
        "center_mm": [list(c) for c in centers],
        "radius_mm": [radius] * len(centers),
        **more,
    }


def cube(folder: Path, scale: float = 1.0, *, whole: bool = True) -> dict[str, Any]:
    import trimesh

    mesh = trimesh.creation.box(extents=(scale * 4.0, scale * 4.0, scale * 4.0))
    if not whole:
        mesh.update_faces(np.arange(len(mesh.faces)) > 0)
    mesh.export(folder / "body.stl")
    return {
        "generator": "mesh_file",
        "file": str(folder / "body.stl"),
        "unit": "mm",
        "place_mm": [0.0, 0.0, 60.0],
    }


def lit(z: float) -> dict[str, Any]:
    return {"center_mm": [0.0, 0.0, z], "size_mm": [200.0, 200.0]}


FAULTS: dict[str, tuple[Any, str]] = {
    "overlap": (
        lambda _: {"bubbles": places([0, 0, 60], [1.5, 0, 60])},
        "expected none to reach into another",
    ),
    "front wall": (
        lambda _: {"bubbles": places([0, 0, 8.5])},
        r"a wall cuts 1: 0 at \[0.0, 0.0, 8.5\] mm",
    ),
    "back wall": (lambda _: {"bubbles": places([0, 0, 127.5])}, r"a wall cuts 1"),
    "into a body": (
        lambda f: {"bubbles": places([2.5, 0, 60]), "solids": [cube(f)]},
        r"1 reach into solids.0: 0 at",
    ),
    "index": (
        lambda _: {"bubbles": places([0, 0, 60], index=0.9)},
        r"bubbles.index: .*greater than or equal to 1",
    ),
    "light in front": (
        lambda _: {"backlight": lit(-600.0)},
        "backlight.center_mm: expected it behind the back wall",
    ),
    "light in the tank": (
        lambda _: {"backlight": lit(100.0)},
        r"backlight.center_mm: expected it behind the back wall",
    ),
    "no light": (
        lambda _: {"backlight": None},
        r"expected a backlight or a lighting for bubbles and solids",
    ),
    "open mesh": (
        lambda f: {"solids": [cube(f, whole=False)]},
        "solids.0: expected a closed surface",
    ),
    "metres": (
        lambda f: {"solids": [cube(f, 0.001)]},
        "solids.0: expected a body of a size like the volume's",
    ),
    "outside": (
        lambda f: {"solids": [cube(f) | {"place_mm": [0, 0, 9.0]}]},
        "solids.0 in frame 0: expected it in the tank",
    ),
    "no generator": (
        lambda _: {"solids": [{"generator": "uniform"}]},
        "solids.0.generator: expected a generator of solids",
    ),
    "no file": (
        lambda _: {"solids": [{"generator": "mesh_file", "file": "none.stl", "unit": "mm"}]},
        "solids.0.file: expected a file",
    ),
    "unequal lists": (
        lambda _: {"bubbles": places([0, 0, 60]) | {"radius_mm": [1.0, 2.0]}},
        "expected one radius for each of 1 centres",
    ),
}


@pytest.mark.parametrize("name", FAULTS)
def test_what_cannot_be_is_said(name: str, tmp_path: Path) -> None:
    change, sentence = FAULTS[name]
    with pytest.raises(InputError, match=sentence):
        generate(small(**change(tmp_path)), tmp_path / "data", seed=1)
    assert not (tmp_path / "data").exists()


@pytest.mark.slow
def test_a_suite_of_bubbles_ends_in_a_page(tmp_path: Path) -> None:
    from sabench.evaluation.runner import run_suite

    (tmp_path / "small.toml").write_text(
        small(render={"relative_error": 0.05}).to_toml(), encoding="utf-8"
    )
    text = (
        'title = "bubbles"\nscenes = ["small.toml"]\nbackend = "mitsuba"\nseeds = [2]\n'
        '[[solvers]]\nname = "minimum_image"\n'
    )
    (tmp_path / "suite.toml").write_text(text, encoding="utf-8")
    (record,) = run_suite(tmp_path / "suite.toml", tmp_path / "work", tmp_path / "board")
    assert record["error"] is None
    assert record["f1"] > 0.5
    page = (tmp_path / "board" / "index.html").read_text(encoding="utf-8")
    assert "Bubbles from the front and from the side" in page
    assert "F1, large" in page


@pytest.mark.parametrize(
    ("suffix", "unit", "scale"),
    [("stl", "mm", 1.0), ("ply", "m", 1e-3), ("obj", "cm", 0.1), ("glb", "m", 1e-3)],
)
def test_bodies_come_from_files(suffix: str, unit: str, scale: float, tmp_path: Path) -> None:
    import trimesh

    trimesh.creation.box(extents=scale * np.array([4.0, 3.0, 2.0])).export(
        tmp_path / f"body.{suffix}"
    )
    solid = {
        "generator": "mesh_file",
        "file": str(tmp_path / f"body.{suffix}"),
        "unit": unit,
        "place_mm": [0.0, 0.0, 60.0],
    }
    scene = small(bubbles=None, solids=[solid], render={"relative_error": 0.2})
    (body,) = Frames(scene, build_rig(scene), 1).at(0).solids
    assert np.ptp(body.vertices_mm, axis=0) == pytest.approx([4.0, 3.0, 2.0], abs=1e-5)


@pytest.mark.slow
def test_a_data_set_has_its_own_copies_of_files(tmp_path: Path) -> None:
    scene = small(bubbles=None, solids=[cube(tmp_path)], render={"relative_error": 0.2})
    data = generate(scene, tmp_path / "data", seed=1)
    (tmp_path / "body.stl").unlink()
    again = generate(data.scene, tmp_path / "again", seed=1)
    assert again.content_hash == data.content_hash


def test_bodies_turn_and_move() -> None:
    solid = {
        "generator": "cylinder",
        "radius_mm": 1.0,
        "length_mm": 6.0,
        "place_mm": [0.0, 0.0, 60.0],
        "spin_deg_s": [0.0, 0.0, 90.0],
        "velocity_mm_s": [5, 0, 0],
    }
    scene = small(bubbles=None, solids=[solid], frames=2, interval_s=1.0)
    frames = Frames(scene, build_rig(scene), 1)
    sizes: list[F64] = [np.ptp(frames.at(frame).solids[0].vertices_mm, axis=0) for frame in (0, 1)]
    assert sizes[0] == pytest.approx([2.0, 6.0, 2.0], abs=0.01)
    assert sizes[1] == pytest.approx([6.0, 2.0, 2.0], abs=0.01)
    assert frames.at(1).solids[0].vertices_mm.mean(axis=0) == pytest.approx(
        [5.0, 0.0, 60.0], abs=1e-6
    )
