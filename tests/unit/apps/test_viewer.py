"""Pages of a data set: what they hold, and how far clouds of points are thinned."""

import base64
import json
import re
import zlib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import sabench
from sabench.api import Detections, FoundParticles, Velocity
from sabench.api.truth import Bubbles
from sabench.apps.viewer import page_content, points
from sabench.apps.viewer.contents import PageContents, of_dataset, of_scene
from sabench.apps.viewer.page_content import Packer, encode_contents
from sabench.apps.viewer.points import (
    ObjectCloud,
    classify_bubbles,
    classify_particles,
    link_to_earlier,
    place_vectors,
    with_velocities,
)
from sabench.apps.viewer.surroundings import draw_surroundings
from sabench.apps.viewer.view import render_contents
from sabench.dataset.reader import Dataset
from sabench.dataset.results import Result, open_result, result_writer
from sabench.geometry.common_view import lattice_of
from sabench.geometry.rigid_motion import rotation_matrices
from sabench.metrics.particle_detection import challenge_pairs, classify
from sabench.plotting.kinds import DUPLICATE, FOUND, GHOST, KINDS, MISSED, TRUE
from sabench.scenes import load_scene
from sabench.utils.arrays import F64
from tests.helpers.calibration_cases import calibration_scene

EVIL = '</script><img src=x onerror="document.title=1">'


@pytest.fixture(scope="module")
def moving(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    folder = tmp_path_factory.mktemp("view") / "quick"
    scene = load_scene("quick").model_copy(update={"frames": 2})
    return sabench.generate(scene, folder, seed=1, backend="splat")


@pytest.fixture(scope="module")
def found(moving: Dataset) -> Result:
    path = moving.root.parent / "found.h5"
    with result_writer(path, moving, EVIL, "particles", {}) as writer:
        for frame in range(2):
            writer.add(estimate_of(moving, frame), frame)
    return open_result(path, moving)


def estimate_of(data: Dataset, frame: int) -> FoundParticles:
    true, voxel = data.particles(frame).position_mm, np.asarray(data.setup.grid.voxel_mm)
    duplicates = true[20:25] + 0.4 * voxel
    ghosts = np.asarray(data.setup.grid.low_mm) - voxel * [[3.0], [5.0], [7.0]]
    position = np.concatenate([true[10:] + 0.1 * voxel, duplicates, ghosts])
    return FoundParticles(position, trajectory=np.arange(len(position)))


@pytest.fixture(scope="module")
def shown(moving: Dataset, found: Result) -> PageContents:
    return replace(of_dataset(moving, found), title=EVIL)


@pytest.fixture(scope="module")
def html(shown: PageContents) -> str:
    return render_contents(shown)[0]


def values_of(html: str) -> dict[str, Any]:
    text = re.findall(r'<script type="application/json" id="data">(.*?)</script>', html)
    values: dict[str, Any] = json.loads(text[0])
    return values


def test_particles_are_classified_as_they_are_scored(moving: Dataset) -> None:
    estimate = estimate_of(moving, 0)
    cloud = classify_particles(estimate, moving, 0)
    counts = dict(zip(KINDS, cloud.counts(), strict=True))
    assert counts == {"true": 290, "found": 290, "missed": 10, "ghost": 3, "duplicate": 5}
    to_voxels = moving.setup.grid.to_voxels
    true = moving.particles(0).position_mm
    voxels, true_voxels = to_voxels(estimate.position_mm), to_voxels(true)
    assert counts["found"] == len(challenge_pairs(voxels, true_voxels)[0])
    assert counts["duplicate"] == np.sum(classify(voxels, true_voxels)[0] == DUPLICATE)
    missed = cloud.position_mm[cloud.kind == MISSED]
    assert np.array_equal(np.sort(missed, axis=0), np.sort(true[:10], 0))
    assert cloud.select(cloud.kind == GHOST).position_mm == pytest.approx(estimate.position_mm[-3:])
    assert (cloud.kind == DUPLICATE).sum() == 5


def test_the_truth_finds_everything_and_an_empty_result_nothing(moving: Dataset) -> None:
    best = classify_particles(FoundParticles(moving.particles(0).position_mm), moving, 0)
    assert set(best.kind) == {TRUE, FOUND}
    assert set(classify_particles(FoundParticles(np.zeros((0, 3))), moving, 0).kind) == {MISSED}


def some_bubbles(count: int) -> Bubbles:
    rng = np.random.default_rng(3)
    turn = rotation_matrices(rng.normal(size=(count, 3)))
    center = np.arange(count)[:, None] * np.array([10.0, 1.0, -2.0])
    semi_axes = rng.uniform(0.5, 2.0, (count, 3))
    return Bubbles(np.arange(count), center, semi_axes, turn, np.ones((count, 3)))


def test_bubbles_are_classified_and_keep_their_shapes() -> None:
    true = some_bubbles(6)
    data: Any = SimpleNamespace(has_truth=True, bubbles=lambda frame: true)
    moved = true.center_mm[1:] + np.array([[0.1], [50.0], [0.1], [0.0], [0.0]])
    cloud = classify_bubbles(Detections(moved, true.semi_axes_mm[1:], true.turn[1:]), data, 0)
    counts = dict(zip(KINDS, cloud.counts(), strict=True))
    assert counts == {"true": 4, "found": 4, "missed": 2, "ghost": 1, "duplicate": 0}
    assert np.flatnonzero(cloud.kind == MISSED).tolist() == [0, 2]
    assert cloud.shape_mm is not None
    rim = cloud.shape_mm[:6] @ np.array([0.6, 0.0, 0.8])
    assert np.linalg.norm(np.einsum("nij,nj->ni", true.to_ball, rim), axis=1) == pytest.approx(1.0)


def test_a_page_of_a_result_has_trajectories_counts_and_labels(
    shown: PageContents, html: str
) -> None:
    values = values_of(html)
    assert values["totals"]["particles"]["ghost"] == [3, 3]
    assert values["linked"]
    assert values["labels"]["missed"] == "missed"
    assert dict(shown.facts)["result"].startswith("found.h5, </script>")
    assert [one["particles"]["count"] for one in values["frames"]] == [598, 598]
    assert len(values["pictures"]["1"]) == 4


def test_projections_are_those_of_the_cameras(moving: Dataset, html: str) -> None:
    points = lattice_of(moving.setup.grid, 5)
    for camera, own in zip(moving.true_cameras, values_of(html)["maps"], strict=True):
        at = (points - own["middle"]) / np.array(own["half"])
        terms = np.prod(at[:, None] ** np.array(own["powers"]), axis=2)
        exact, valid = camera.project(points)
        assert valid.all()
        assert np.abs(terms @ np.array(own["coefficients"]) - exact).max() < 5e-3


def value_at(stack: page_content.PlaneStack, points_mm: F64) -> F64:
    place, shape = stack.place, np.array(stack.pictures.shape)
    off = points_mm - place.corner_mm
    shares = [off @ one / (one @ one) for one in (place.down_mm, place.across_mm)]
    plane = np.rint(off @ place.step_mm / (place.step_mm @ place.step_mm)).astype(int)
    row, column = (
        np.clip((share * count).astype(int), 0, count - 1)
        for share, count in zip(shares, shape[1:], strict=True)
    )
    return np.asarray(stack.pictures[np.clip(plane, 0, shape[0] - 1), row, column], np.float64)


@pytest.mark.parametrize("by_slabs", [True, False])
def test_refocused_planes_are_bright_at_the_particles(
    moving: Dataset, monkeypatch: pytest.MonkeyPatch, by_slabs: bool
) -> None:
    if not by_slabs:
        monkeypatch.setattr(page_content, "find_edge_on", lambda *_: "edge-on")
        monkeypatch.setattr(page_content, "_PLANES", 8)
    stack = page_content.refocused_stack(moving, 0)
    true = moving.particles(0).position_mm
    elsewhere = true * [1.0, 1.0, -1.0] + [0.0, 0.0, 2.0 * moving.scene.volume.center_mm[2]]
    assert value_at(stack, true).mean() > 1.4 * value_at(stack, elsewhere).mean()
    assert value_at(stack, true).mean() > 3.0 * stack.pictures.mean()


@pytest.mark.parametrize(("axis", "sign"), [(0, -1), (1, 1), (2, -1), (2, 1)])
def test_planes_of_any_axis_fill_the_volume_and_face_the_cameras(axis: int, sign: int) -> None:
    low, high = np.array([-1.0, -2.0, -3.0]), np.array([3.0, 4.0, 5.0])
    place = page_content._place_planes(low, high, axis, sign)
    assert np.cross(place.across_mm, place.down_mm) @ place.step_mm > 0.0
    assert np.sign(place.step_mm[axis]) == sign
    count = page_content._PLANES
    ends = [place.corner_mm - place.step_mm / 2.0, place.corner_mm + (count - 0.5) * place.step_mm]
    ends[1] = ends[1] + place.across_mm + place.down_mm
    assert np.min(ends, axis=0) == pytest.approx(low)
    assert np.max(ends, axis=0) == pytest.approx(high)


def test_the_planes_of_a_reconstruction_show_its_voxels(moving: Dataset) -> None:
    grid = moving.setup.grid
    volume = np.zeros(grid.shape, dtype=np.float32)
    volume[25, 30, 200] = 1.0
    stack = page_content.volume_stack(volume, grid)
    place = np.array([[axis[n] for axis, n in zip(grid.axes_mm, (200, 30, 25), strict=True)]])
    assert value_at(stack, place)[0] == 255
    assert (stack.pictures > 0).sum() == 1


def test_pictures_are_compressed_until_they_fit(moving: Dataset) -> None:
    made, complete = page_content.camera_pictures(moving, [0, 1], 10_000_000)
    assert complete
    assert [len(one) for one in made.values()] == [4, 4]
    size = sum(map(len, made[0]))
    few, complete = page_content.camera_pictures(moving, [0, 1], size + 10)
    assert not complete
    assert list(few) == [0]
    assert sum(map(len, few[0])) == size


def test_particles_far_outside_are_left_out_and_it_is_said(moving: Dataset) -> None:
    contents = of_dataset(moving)
    far = np.concatenate([contents.frames[0].particles.position_mm, [[1e6, 0.0, 0.0]]])
    frame = replace(contents.frames[0], particles=ObjectCloud.of_kind(far, TRUE))
    values, _, notes = encode_contents(replace(contents, frames=(frame,), data=None))
    assert values["frames"][0]["particles"]["count"] == 300
    assert notes == ["1 particles farther outside the volume than its size are left out."]
    assert max(values["box"]["size"]) < 20.0


def test_vectors_are_measured_interpolated_and_true(moving: Dataset) -> None:
    valid = np.ones((1, 2, 3), dtype=np.bool_)
    valid[0, 1, 2] = False
    field = Velocity((-2.0, -1.0, 30.0), (2.0, 2.0, 1.0), np.full((1, 2, 3, 3), 4.0), valid)
    cloud = place_vectors(field, moving, (0, 1))
    assert cloud.counts() == [6, 5, 0, 1, 0]
    measured = cloud.select(cloud.kind != TRUE)
    assert measured.position_mm[5] == pytest.approx([2.0, 1.0, 30.0])
    assert measured.velocity_mm_s == pytest.approx(np.full((6, 3), 4.0))
    true = cloud.select(cloud.kind == TRUE)
    # the scene's particles are at rest
    assert true.velocity_mm_s == pytest.approx(np.zeros((6, 3)))


def test_a_target_without_images_shows_its_points(tmp_path: Path) -> None:
    data = sabench.generate(calibration_scene(), tmp_path / "b", seed=1, backend="splat")
    contents = of_dataset(data)
    assert contents.sort == "Target"
    assert not page_content.has_images(data)
    assert contents.frames[1].particles.position_mm == pytest.approx(data.placed().points_mm[1])


@pytest.mark.parametrize(
    ("scene", "walls"), [("quick", 1), ("cylinder-tank", 1), ("two-faces", 2), ("occlusion", 0)]
)
def test_a_rig_has_all_its_parts(scene: str, walls: int) -> None:
    contents = of_scene(load_scene(scene), scene)
    rig = contents.surroundings.describe()
    assert len(rig["walls"]) == walls
    assert len(rig["discs"]) == len(load_scene(scene).occluders or ())
    for wall in rig["walls"]:
        if wall["kind"] == "plane":
            first, second = np.array(wall["axes"])
            assert np.cross(first, second) == pytest.approx(wall["normal"], abs=1e-5)
    assert len(draw_surroundings(contents.surroundings)) == 2


def test_names_become_text_and_never_markup(html: str) -> None:
    assert "<img" not in html
    assert html.count("</script>") == 4
    assert html.count("&lt;img src=x onerror=") >= 3


def cloud_of(numbers: list[int], kind: int = FOUND, shift: float = 0.0) -> ObjectCloud:
    position = np.array(numbers, dtype=np.float64)[:, None] + np.array([0.0, 10.0, 20.0]) + shift
    return ObjectCloud.of_kind(position, kind, np.array(numbers, dtype=np.int64))


def test_links_follow_trajectories_of_the_truth_or_of_the_estimate_in_any_order() -> None:
    earlier, later = cloud_of([3, 1, 2]), cloud_of([2, 7, 3])
    assert link_to_earlier(later, earlier).tolist() == [2, -1, 0]
    assert link_to_earlier(later, None).tolist() == [-1, -1, -1]
    earlier = cloud_of([1], TRUE) + cloud_of([1], GHOST)
    later = cloud_of([1], FOUND) + cloud_of([1], MISSED)
    assert link_to_earlier(later, earlier).tolist() == [1, 0]


def test_unknown_velocities_come_from_positions_and_known_ones_stay() -> None:
    first, second = cloud_of([1, 2]), cloud_of([2, 1, 5], shift=0.3)
    second.velocity_mm_s[0] = 7.0
    made = with_velocities([first, second], [0.0, 0.1])
    assert made[0].velocity_mm_s == pytest.approx(np.full((2, 3), 3.0))
    assert made[1].velocity_mm_s[:2] == pytest.approx(np.array([[7.0] * 3, [3.0] * 3]))
    assert np.isnan(made[1].velocity_mm_s[2]).all()
    assert np.isnan(first.velocity_mm_s).all()  # the clouds stay as they were


def test_thinning_keeps_trajectories_and_shares_of_kinds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(points, "MOST", 8000)
    rng = np.random.default_rng(2)
    numbers = np.arange(10_000)
    clouds = [cloud_of(rng.permutation(numbers).tolist()) for _ in range(2)]
    clouds[1].kind[::4] = GHOST
    share = points.shown_share(clouds)
    assert share == pytest.approx(0.4)
    first, second = points.thin(clouds, share)
    assert set(first.trajectory) == set(second.trajectory)
    assert len(first) == pytest.approx(4000, rel=0.05)
    assert (second.kind == GHOST).sum() == pytest.approx(1000, rel=0.1)


def test_objects_without_a_trajectory_are_thinned_at_random_but_repeatably() -> None:
    alone = ObjectCloud.of_kind(np.random.default_rng(1).random((10_000, 3)), FOUND)
    one, other = (points.thin([alone], 0.25)[0] for _ in range(2))
    assert len(one) == pytest.approx(2500, rel=0.1)
    assert np.array_equal(one.position_mm, other.position_mm)


def unpack(packer: Packer) -> list[npt.NDArray[Any]]:
    content = zlib.decompress(base64.b64decode(packer.text()))
    types = {"Uint8": "u1", "Int16": "<i2", "Uint16": "<u2", "Int32": "<i4", "Float32": "<f4"}
    index = packer.index
    return [np.frombuffer(content, types[kind], count, offset) for kind, offset, count in index]


def test_arrays_come_back_from_a_page() -> None:
    arrays: list[npt.NDArray[Any]] = [
        np.array([1, 2, 3], dtype=np.uint8),
        np.array([[-5, 7]], dtype=np.int16),
        np.array([0.5, -2.5], dtype=np.float32),
        np.zeros(0, dtype=np.int32),
    ]
    packer = Packer()
    places = [packer.add(one) for one in arrays]
    back = unpack(packer)
    for array, place in zip(arrays, places, strict=True):
        assert np.array_equal(back[place], array.ravel())
    sizes = {"Uint8": 1, "Int16": 2, "Float32": 4, "Int32": 4}
    assert all(offset % sizes[kind] == 0 for kind, offset, _ in packer.index)
