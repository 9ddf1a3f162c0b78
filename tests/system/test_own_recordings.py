"""Own recordings, as a stranger brings them: imported, verified, solved, judged. A generated data
set loses its truth: its images become files as recorders write them. All that solvers find must be
as on the original. Figures without truth are tried on data whose truth is known."""

import dataclasses
import json
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile

import sabench
from sabench.api import FoundParticles
from sabench.dataset.cameras import write_cameras
from sabench.dataset.copies import pack
from sabench.dataset.import_recording import ImportOptions, import_recording
from sabench.dataset.reader import Dataset, open_dataset
from sabench.dataset.results import open_result, result_writer
from sabench.dataset.verification import verify
from sabench.geometry.camera_model import CameraModel
from sabench.geometry.common_view import lattice_of
from sabench.geometry.polynomial_cameras import fit_planes, fit_soloff
from sabench.geometry.projective_camera import fit_projective
from sabench.interop.cameras import read_camera_source
from sabench.tasks.image_evidence import scramble_shift, with_scrambled_camera, without_camera
from sabench.tasks.quality import FIGURES, Quality, quality
from tests.conftest import Command
from tests.helpers.commands import refuse, succeed
from tests.helpers.recordings import (
    exact_options,
    import_exactly,
    make_scene_in_motion,
    stack_of,
    write_pngs,
    write_stacks,
)
from tests.helpers.refusals import check_sentence, refused


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    folder = tmp_path_factory.mktemp("original")
    return sabench.generate(make_scene_in_motion(), folder / "data", seed=5, backend="splat")


@pytest.fixture(scope="module")
def pngs(original: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_pngs(original, tmp_path_factory.mktemp("pngs") / "images")


def import_like(original: Dataset, folder: Path, out: Path, **changes: Any) -> Dataset:
    import_exactly(original, folder, out, **changes)
    assert verify(out) == []
    return open_dataset(out)


def solved(solver: str, data: Dataset, out: Path) -> list[FoundParticles]:
    sabench.solve(solver, data, out)
    result = open_result(out, data)
    return [result.read(FoundParticles, frame) for frame in range(data.setup.frames)]


@pytest.mark.slow
def test_solvers_find_the_same(original: Dataset, pngs: Path, tmp_path: Path) -> None:
    stacks = write_stacks(original, tmp_path / "stacks", byteorder=">", compression="zlib")
    tanks = [
        import_like(original, folder, tmp_path / name)
        for name, folder in (("one", pngs), ("two", stacks))
    ]
    for solver in ("bayesian_ipr", "shake_the_box"):
        expected = solved(solver, original, tmp_path / "expected.h5")
        (tmp_path / "expected.h5").unlink()
        assert min(len(one.position_mm) for one in expected) > 50
        for number, tank in enumerate(tanks):
            found = solved(solver, tank, tmp_path / f"{solver}-{number}.h5")
            for here, there in zip(found, expected, strict=True):
                for (name, value), (_, same) in zip(here.arrays(), there.arrays(), strict=True):
                    np.testing.assert_allclose(value, same, rtol=1e-9, atol=1e-9, err_msg=name)


@pytest.mark.slow
def test_commands(original: Dataset, pngs: Path, tmp_path: Path, command: Command) -> None:
    done = succeed(
        command("import", pngs, "--cameras", original.root, "-o", "tank", "--interval", 0.01)
    )
    assert "tank: 4 frame(s) of 4 camera(s), recorded, without truth" in done.stdout
    assert command("verify", "tank").stdout == (
        "tank: intact; recorded: 4 frame(s) of 4 camera(s); no truth, no scene\n"
    )
    done = succeed(command("solve", "ray_triangulation", "tank", "-o", "r.h5"))
    for word in ("r.h5", "truth", "empty"):
        refuse(command("score", "tank", word), "tank")
    done = succeed(command("pack", "tank", "-o", "copy"))
    assert verify(tmp_path / "copy") == []
    refuse(command("import", pngs, "--cameras", original.root, "-o", "tank"), "tank")


@pytest.mark.slow
def test_export_needs_no_truth(original: Dataset, pngs: Path, tmp_path: Path) -> None:
    tank = import_like(original, pngs, tmp_path / "tank")
    for solver in ("ray_triangulation", "msa", "piv3d"):
        out = tmp_path / f"{solver}.h5"
        sabench.solve(solver, tank, out)
        assert any(sabench.export(tank, tmp_path / solver, out).iterdir())
    with refused("tank"):
        sabench.export(tank, tmp_path / "truth")


def test_changed_files_are_found(original: Dataset, pngs: Path, tmp_path: Path) -> None:
    tank = import_like(original, pngs, tmp_path / "tank")
    image = tank.root / "images/frame_0001/camera_02.tif"
    image.write_bytes(image.read_bytes()[:-1] + b"\x01")
    (fault,) = verify(tank.root)
    check_sentence(fault, image.name)
    path = tank.root / "manifest.json"
    path.write_text(path.read_text(encoding="utf-8").replace("true", "false"), encoding="utf-8")
    assert "recorded" in verify(tank.root)[0]


def models(cameras: tuple[CameraModel, ...], points: Any) -> list[CameraModel]:
    one, two, three, four = (
        (camera.name, camera.rows, camera.columns, points, camera.project(points)[0])
        for camera in cameras
    )
    planes = [points[points[:, 2] == z] for z in np.unique(points[:, 2])]
    pixels = [cameras[1].project(plane)[0] for plane in planes]
    return [
        fit_soloff(*one),
        fit_planes(*two[:3], planes, pixels),
        fit_projective(*three),
        fit_soloff(*four),
    ]


@pytest.mark.slow
def test_cameras_of_any_model(original: Dataset, pngs: Path, tmp_path: Path) -> None:
    grid = original.setup.grid
    middle = np.asarray(grid.low_mm) + 0.5 * np.asarray(grid.voxel_mm) * grid.shape[::-1]
    other = models(original.setup.cameras, middle + 1.2 * (lattice_of(grid, 7) - middle))
    write_cameras(tmp_path / "cameras.json", other)
    source = read_camera_source(tmp_path / "cameras.json")
    assert list(source.cameras) == other
    import_recording(pngs, source.cameras, tmp_path / "tank", exact_options(original), grid)
    assert verify(tmp_path / "tank") == []
    tank = open_dataset(tmp_path / "tank")
    assert list(tank.setup.cameras) == other
    found = solved("bayesian_ipr", tank, tmp_path / "r.h5")
    expected = solved("bayesian_ipr", original, tmp_path / "e.h5")
    assert len(found[0].position_mm) == pytest.approx(len(expected[0].position_mm), abs=3)
    for solver in ("ray_triangulation", "msa", "mart"):
        sabench.solve(solver, tank, tmp_path / f"{solver}.h5")


@pytest.mark.parametrize(
    "change",
    [
        *({"model": "fisheye"}, {"matrix": [[1.0, 0.0, 0.0]] * 3}, {"matrix": [[0.0] * 4] * 3}),
        *({"rows": 0}, {"scale": 2.0}, {"name": "a b"}),
    ],
)
def test_broken_cameras(change: dict[str, Any], tmp_path: Path) -> None:
    matrix = [[100.0, 0.0, 0.0, 50.0], [0.0, 100.0, 0.0, 40.0], [0.0, 0.0, 0.01, 1.0]]
    camera = {"model": "projective", "name": "a", "rows": 80, "columns": 100, "matrix": matrix}
    head = {"format": "sabench-dataset", "version": 1}
    path = tmp_path / "cameras.json"
    path.write_text(json.dumps(head | {"cameras": [camera | change]}), encoding="utf-8")
    with refused("cameras.json"):
        read_camera_source(path)


@pytest.mark.slow
def test_masks_and_smaller_sensors(original: Dataset, tmp_path: Path) -> None:
    masks = tmp_path / "masks"
    masks.mkdir()
    rows, columns = original.setup.cameras[0].rows, original.setup.cameras[0].columns
    counts = np.full((rows, columns), 255, dtype=np.uint8)
    counts[:, :40] = 0
    cv2.imwrite(str(masks / "camera_02.png"), counts)
    folder = write_stacks(original, tmp_path / "stacks")
    tifffile.imwrite(
        folder / "camera_01.tif", stack_of(original, 1)[:, :-6, :-9], photometric="minisblack"
    )
    cameras: list[Any] = list(original.setup.cameras)
    cameras[1] = dataclasses.replace(cameras[1], rows=rows - 6, columns=columns - 9)
    options = exact_options(original, masks=masks)
    import_recording(folder, cameras, tmp_path / "tank", options, original.setup.grid)
    assert verify(tmp_path / "tank") == []
    tank = open_dataset(tmp_path / "tank")
    seen = tank.observation(0)
    unknown = seen.repaired.flaws.covered
    assert not unknown[0].any()
    assert unknown[1, -6:].all()
    assert unknown[1, :, -9:].all()
    assert unknown[2, :, :40].all()
    assert (seen.images[unknown] == seen.black_dn).all()
    np.testing.assert_array_equal(seen.images[3], original.observation(0).images[3])
    assert len(solved("bayesian_ipr", tank, tmp_path / "r.h5")[0].position_mm) > 50


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"volume_mm": (500.0, 501.0, 0.0, 1.0, 0.0, 1.0)}, "camera_00"),
        ({"pairs": {"left": "camera_00"}}, "images"),
        ({"frames": slice(9, 12)}, "camera_00"),
        ({"pulses": 3}, "3 frames"),
        ({"black_dn": 5000.0}, "camera_00"),
    ],
)
def test_import_refuses(
    changes: dict[str, Any], key: str, original: Dataset, pngs: Path, tmp_path: Path
) -> None:
    with refused(key) as caught:
        import_like(original, pngs, tmp_path / "tank", **changes)
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_missing_images(original: Dataset, tmp_path: Path) -> None:
    folder = write_stacks(original, tmp_path / "stacks")
    tifffile.imwrite(folder / "camera_03.tif", stack_of(original, 3)[:2], photometric="minisblack")
    with refused("camera_00", "camera_03"):
        import_like(original, folder, tmp_path / "tank")
    tank = import_like(original, folder, tmp_path / "short", frames=slice(0, 2))
    assert tank.setup.frames == 2
    (folder / "camera_01.tif").rename(folder / "spare.tif")
    with refused("camera_01"):
        import_like(original, folder, tmp_path / "tank")
    pairs = {f"camera_0{n}": f"camera_0{n}" for n in (0, 2)} | {"spare": "camera_01"}
    tank = import_like(original, folder, tmp_path / "three", pairs=pairs)
    assert [one.name for one in tank.setup.cameras] == ["camera_00", "camera_02", "camera_01"]
    np.testing.assert_array_equal(tank.raw_image(2, 3), original.raw_image(1, 3))


def test_double_frames(original: Dataset, pngs: Path, tmp_path: Path) -> None:
    tank = import_like(original, pngs, tmp_path / "tank", pulses=2, interval_s=0.001, period_s=0.1)
    assert tank.setup.times_s == pytest.approx((0.0, 0.001, 0.1, 0.101))
    assert tank.setup.pairs() == [(0, 1), (2, 3)]


@pytest.mark.slow
def test_images_stay_where_they_are(original: Dataset, pngs: Path, tmp_path: Path) -> None:
    folder = tmp_path / "images"
    shutil.copytree(pngs, folder)
    tank = import_like(original, folder, tmp_path / "tank", referenced=True)
    assert not (tank.root / "images").exists()
    copied = import_like(original, folder, tmp_path / "copied")
    for one, other in zip(
        solved("ray_triangulation", tank, tmp_path / "one.h5"),
        solved("ray_triangulation", copied, tmp_path / "other.h5"),
        strict=True,
    ):
        np.testing.assert_array_equal(one.position_mm, other.position_mm)
    with refused("tank", "--blind"):
        pack(tank, tmp_path / "whole", blind=False)
    pack(tank, tmp_path / "blind", blind=True)
    assert verify(tmp_path / "blind") == []
    image = folder / "camera_01" / "img_2.png"
    image.write_bytes(image.read_bytes() + b"x")
    check_sentence(verify(tank.root)[0], image.name)
    image.unlink()
    check_sentence(verify(tank.root)[0], image.name)


def test_references_are_checked(original: Dataset, pngs: Path, tmp_path: Path) -> None:
    tank = import_like(original, pngs, tmp_path / "tank", referenced=True)
    assert tank.references is not None
    first = tank.references
    shape = first.shapes["camera_00"]
    changes: tuple[dict[str, Any], ...] = (
        {"shapes": first.shapes | {"camera_00": (500, 500)}},
        {"images": {"camera_00": (("../secret.png", 0),)}},
        {"images": {}},
        {"images": {"camera_00": (("camera_00/img_0.png", 7),)}},
        {"folder": str(tmp_path / "moved")},
    )
    for change in changes:
        with refused():
            first.model_copy(update=change).read("camera_00", 0, shape)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    scene = make_scene_in_motion(particles={"per_pixel": 0.02})
    return sabench.generate(
        scene, tmp_path_factory.mktemp("quality") / "data", seed=6, backend="splat"
    )


@pytest.fixture(scope="module")
def known_result(data: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("known_result") / "r.h5"
    sabench.solve("ray_triangulation", data, out)
    return out


def judged(data: Dataset, out: Path, found: list[FoundParticles]) -> Quality:
    out.unlink(missing_ok=True)
    with result_writer(out, data, "none", "particles", {}) as writer:
        for frame, one in enumerate(found):
            writer.add(one, frame)
    return quality(data, out, solve_again=False)


@pytest.mark.slow
def test_the_truth_explains_the_images(data: Dataset, tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    truth = [data.particles(frame) for frame in range(data.setup.frames)]
    figures = {}
    for noise in (0.0, 0.01, 0.03):
        moved = [
            FoundParticles(
                one.position_mm + noise * rng.standard_normal(one.position_mm.shape), None, one.id
            )
            for one in truth
        ]
        figures[noise] = judged(data, tmp_path / "r.h5", moved).figures
    for key, sign in (("residual_px", 1.0), ("explained", -1.0), ("jitter_mm", 1.0)):
        values = [sign * float(one[key] or 0.0) for one in figures.values()]
        assert values == sorted(values), key
    assert figures[0.0]["explained"] == pytest.approx(1.0, abs=0.03)
    assert figures[0.03]["jitter_mm"] == pytest.approx(0.03, rel=0.2)
    half = [FoundParticles(one.position_mm[::2], None, one.id[::2]) for one in truth]
    share = judged(data, tmp_path / "r.h5", half).figures["explained"]
    assert share is not None
    assert 0.2 < share < 0.8


def test_nothing_found(data: Dataset, tmp_path: Path) -> None:
    none = FoundParticles(np.zeros((0, 3)), None, np.zeros(0, dtype=np.int64))
    found = judged(data, tmp_path / "r.h5", [none] * data.setup.frames)
    assert found.figures["explained"] == 0.0
    assert found.figures["residual_px"] is None


@pytest.mark.slow
def test_held_out_and_scrambled_cameras(data: Dataset, known_result: Path) -> None:
    true = sabench.score(data, known_result)
    figures = quality(data, known_result).figures
    assert figures["held_out"] == pytest.approx(true["precision"], abs=0.06)
    assert figures["ghost_percent"] == pytest.approx(true["ghost_percent"], abs=2.0)
    assert figures["held_out_correlation"] == pytest.approx(0.8, abs=0.2)
    assert figures["chance_percent"] is not None
    assert 1.0 < figures["chance_percent"] < 40.0
    assert all(figures[key] is not None for key in FIGURES)


@pytest.mark.slow
def test_reduced_data_sets(data: Dataset, tmp_path: Path) -> None:
    less = without_camera(data, 1, 2, tmp_path / "less")
    assert [one.name for one in less.setup.cameras] == ["camera_00", "camera_02", "camera_03"]
    assert (less.setup.frames, less.setup.grid) == (2, data.setup.grid)
    assert less.setup.times_s == data.setup.times_s[:2] if data.setup.times_s else None
    np.testing.assert_array_equal(less.raw_image(1, 1), data.raw_image(2, 1))
    mixed = with_scrambled_camera(data, 2, 1, tmp_path / "mixed")
    np.testing.assert_array_equal(mixed.raw_image(1, 0), data.raw_image(1, 0))
    down, right = scramble_shift(data.setup.cameras[2])
    image, moved = data.raw_image(2, 0), mixed.raw_image(2, 0)
    assert moved[down + 3, right + 4] == image[3, 4]
    assert moved[0, 0] == image[-down, -right]
    for one in (less, mixed):
        assert not one.has_truth


@pytest.mark.slow
def test_volumes(data: Dataset, tmp_path: Path) -> None:
    sabench.solve("mart", data, tmp_path / "mart.h5")
    figures = quality(data, tmp_path / "mart.h5").figures
    assert figures["residual_px"] is None
    for key in ("explained", "held_out_correlation"):
        assert 0.5 < float(figures[key] or 0.0) < 1.0
    assert 0.0 < float(figures["chance_percent"] or 0.0) < 60.0


@pytest.mark.slow
def test_without_truth(data: Dataset, known_result: Path, tmp_path: Path, command: Command) -> None:
    folder = write_pngs(data, tmp_path / "images")
    sensor = data.setup.sensor
    options = ImportOptions(black_dn=sensor.black_dn, white_dn=sensor.white_dn)
    import_recording(folder, data.setup.cameras, tmp_path / "tank", options, data.setup.grid)
    sabench.solve("ray_triangulation", tmp_path / "tank", tmp_path / "r.h5")
    words = ("quality", "tank", "r.h5", "--no-again")
    done = succeed(command(*words, "-o", "q", "--frames", 2, "--json"))
    figures = json.loads(done.stdout)["figures"]
    for key, value in quality(data, known_result, frames=2, solve_again=False).figures.items():
        assert figures[key] == (None if value is None else pytest.approx(value, rel=1e-6)), key
    names = {path.name for path in (tmp_path / "q").iterdir()}
    assert names == {"quality.json", "residuals.png"}
    assert "explained" in command(*words).stdout


@pytest.mark.slow
def test_refusals(data: Dataset, tmp_path: Path) -> None:
    sabench.solve("piv3d", data, tmp_path / "v.h5")
    with refused("task"):
        quality(data, tmp_path / "v.h5")
    with result_writer(tmp_path / "p.h5", data, "elsewhere", "particles", {}) as writer:
        for frame in range(data.setup.frames):
            writer.add(FoundParticles(data.particles(frame).position_mm), frame)
    found = quality(data, tmp_path / "p.h5")
    assert found.figures["held_out"] is None
    check_sentence(found.notes[0], "elsewhere")
    assert open_dataset(data.root).has_truth
