"""Figures without truth on data whose truth is known."""

import json
from pathlib import Path

import numpy as np
import pytest

import sabench
from sabench.api import FoundParticles
from sabench.dataset.import_recording import ImportOptions, import_recording
from sabench.dataset.reader import Dataset, open_dataset
from sabench.dataset.results import result_writer
from sabench.tasks.image_evidence import scramble_shift, with_scrambled_camera, without_camera
from sabench.tasks.quality import FIGURES, Quality, quality
from tests.conftest import Command
from tests.helpers.commands import succeed
from tests.helpers.recordings import make_scene_in_motion, write_pngs
from tests.helpers.refusals import check_sentence, refused


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    scene = make_scene_in_motion(particles={"per_pixel": 0.02})
    return sabench.generate(
        scene, tmp_path_factory.mktemp("quality") / "data", seed=6, backend="splat"
    )


@pytest.fixture(scope="module")
def solved(data: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("solved") / "r.h5"
    sabench.solve("ray_triangulation", data, out)
    return out


def judged(data: Dataset, out: Path, found: list[FoundParticles]) -> Quality:
    out.unlink(missing_ok=True)
    with result_writer(out, data, "none", "particles", {}) as writer:
        for frame, one in enumerate(found):
            writer.add(one, frame)
    return quality(data, out, solve_again=False)


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
def test_held_out_and_scrambled_cameras(data: Dataset, solved: Path) -> None:
    true = sabench.score(data, solved)
    figures = quality(data, solved).figures
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
def test_without_truth(data: Dataset, solved: Path, tmp_path: Path, command: Command) -> None:
    folder = write_pngs(data, tmp_path / "images")
    sensor = data.setup.sensor
    options = ImportOptions(black_dn=sensor.black_dn, white_dn=sensor.white_dn)
    import_recording(folder, data.setup.cameras, tmp_path / "tank", options, data.setup.grid)
    sabench.solve("ray_triangulation", tmp_path / "tank", tmp_path / "r.h5")
    words = ("quality", "tank", "r.h5", "--no-again")
    done = succeed(command(*words, "-o", "q", "--frames", 2, "--json"))
    figures = json.loads(done.stdout)["figures"]
    expected = quality(data, solved, frames=2, solve_again=False).figures
    for key, value in expected.items():
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
