"""Nominal cameras of solvers, which are off by a given length."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import sabench
from sabench.dataset.reader import Dataset, open_dataset
from sabench.dataset.schema import content_hash, seal
from sabench.dataset.verification import verify
from sabench.geometry.camera import Camera
from sabench.scenes import Scene, build_rig, parse_scene
from sabench.scenes.focusing import nominal_cameras
from sabench.simulation.in_memory import simulate
from sabench.utils.arrays import F64
from sabench.utils.files import canonical_json, sha256
from tests.helpers.particle_scenes import make_scene
from tests.helpers.refusals import check_sentence, refused

LENS = {"distortion": {"k1": -60.0, "k2": 2000.0, "p1": 0.3, "p2": -0.2, "k3": 0.0}}


def shifted_scene(shift_px: float, **changes: Any) -> Scene:
    values = make_scene(particles={"count": 30}, **changes).to_dict()
    return parse_scene(values | {"calibration": {"shift_px": shift_px}}, "test")


def moves(nominal: tuple[Camera, ...], true: tuple[Camera, ...]) -> F64:
    """Told minus true projection of points in the volume: (camera, point, 2)."""
    points = np.random.default_rng(3).uniform([-2.0, -1.5, 28.0], [2.0, 1.5, 32.0], (50, 3))
    both = [[camera.project(points) for camera in cameras] for cameras in (nominal, true)]
    assert all(valid.all() for group in both for _, valid in group)
    return np.array([a[0] - b[0] for a, b in zip(*both, strict=True)])


@pytest.mark.parametrize("shift", [0.45, 3.0])
def test_every_projection_is_off_by_the_given_length(shift: float) -> None:
    scene = shifted_scene(shift, cameras=LENS)
    true = build_rig(scene).cameras
    found = moves(nominal_cameras(scene, true, 7), true)
    assert_allclose(np.linalg.norm(found, axis=2), shift, rtol=1e-10)
    assert_allclose(found, np.broadcast_to(found[:, :1], found.shape), atol=1e-10)


def test_directions_are_random_and_belong_to_the_seed_and_the_camera() -> None:
    layout = {"kind": "grid", "columns": 10, "rows": 10, "spacing_mm": [30.0, 30.0]}
    scene = shifted_scene(1.0, cameras={"layout": layout})
    true = build_rig(scene).cameras

    def points(count: int, seed: int) -> F64:
        nominal = nominal_cameras(scene, true[:count], seed)
        return np.array([camera.principal_point_px for camera in nominal])

    first, other = points(100, 1), points(100, 2)
    assert_array_equal(first, points(100, 1))
    assert_array_equal(first[:3], points(3, 1))
    assert np.abs(first - other).min() > 0.0
    for drawn in (first, other):
        ways = drawn - true[0].principal_point_px
        assert len(np.unique(ways, axis=0)) == 100
        assert np.linalg.norm(ways.mean(axis=0)) < 0.3  # 100 random unit vectors: 0.1 on average


@pytest.fixture
def wrong(tmp_path: Path) -> Dataset:
    scene = shifted_scene(1.5)
    return sabench.generate(scene, tmp_path / "wrong", seed=9, backend="splat", name="s")


def test_a_data_set_keeps_nominal_and_true_cameras(wrong: Dataset, tmp_path: Path) -> None:
    scene = make_scene(particles={"count": 30})
    exact = sabench.generate(scene, tmp_path / "exact", seed=9, backend="splat", name="s")
    rig = build_rig(shifted_scene(1.5))
    nominal = nominal_cameras(shifted_scene(1.5), rig.cameras, 9)
    assert wrong.true_cameras == rig.cameras == exact.true_cameras == exact.setup.cameras
    assert wrong.observation(0).cameras == wrong.setup.cameras == nominal
    assert simulate(shifted_scene(1.5), seed=9).observation.cameras == nominal
    assert_allclose(np.linalg.norm(moves(wrong.setup.pinholes, wrong.true_cameras), axis=2), 1.5)
    for view, camera in zip(wrong.views(0), wrong.true_cameras, strict=True):
        assert_allclose(view.pixel, camera.project(wrong.particles(0).position_mm)[0], atol=1e-9)
    assert verify(wrong.root) == []
    ours, plain = wrong.manifest.files, exact.manifest.files
    assert set(ours) - set(plain) == {"true_cameras.json"}
    assert {name for name in plain if plain[name] != ours[name]} == {"cameras.json", "scene.toml"}


def rewrite(data: Dataset, name: str, change: dict[str, Any]) -> Dataset:
    """The data set with one JSON file changed and its manifest made to match."""
    path = data.root / name
    path.write_text(canonical_json(json.loads(path.read_text()) | change))
    manifest = data.manifest.model_dump(mode="json")
    manifest["files"][name] = {"bytes": path.stat().st_size, "sha256": sha256(path)}
    manifest["content_hash"] = content_hash(type(data.manifest).model_validate(manifest).files)
    (data.root / "manifest.json").write_text(seal(manifest))
    return open_dataset(data.root)


def test_true_cameras_must_match_the_nominal_ones(wrong: Dataset) -> None:
    cameras = json.loads((wrong.root / "true_cameras.json").read_text())["cameras"]
    cameras[1]["name"] = "camera_77"
    broken = rewrite(wrong, "true_cameras.json", {"cameras": cameras})
    (fault,) = verify(broken.root)
    check_sentence(fault, "true_cameras.json: cameras", "camera_77")
    (broken.root / "true_cameras.json").unlink()
    with refused("true_cameras.json"):
        _ = open_dataset(broken.root).true_cameras


@pytest.mark.parametrize("shift", [-0.1, float("nan"), "much"])
def test_a_shift_is_a_length(shift: Any) -> None:
    with refused("test: calibration.shift_px"):
        shifted_scene(shift)
