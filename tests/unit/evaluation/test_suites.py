"""Suites of scenes and their changes, their faults, and statistics over seeds."""

from pathlib import Path

import numpy as np
import pytest
from scipy import stats
from scipy.special import erf

from sabench.api.truth import Particles
from sabench.evaluation.suite_loading import load_suite, override
from sabench.evaluation.suites import SceneCase
from sabench.plugins import list_suites
from sabench.scenes import build_rig, load_scene
from sabench.simulation.rendering.particle_images import image_particles
from sabench.utils.confidence import mean_of
from tests.helpers.refusals import refused

SOLVER = '[[solvers]]\nname = "asa"\n'


def load(folder: Path, text: str) -> list[SceneCase]:
    file = folder / "suite.toml"
    file.write_text('title = "t"\nbackend = "splat"\n' + text + SOLVER)
    return scene_cases(file)


def scene_cases(suite: str | Path) -> list[SceneCase]:
    return [case for case in load_suite(suite)[1] if isinstance(case, SceneCase)]


def test_mean_and_interval_are_those_of_student_and_one_value_has_none() -> None:
    values = [0.71, 0.74, 0.69, 0.75, 0.72]
    found, error = mean_of(values), stats.sem(values)
    assert found is not None
    assert found.mean == pytest.approx(np.mean(values))
    assert found.half_width == pytest.approx(stats.t.ppf(0.975, 4) * error, rel=1e-12)
    assert found.count == 5
    assert found.text(3) == "0.722 ± 0.030"
    lone = mean_of([0.5])
    assert lone is not None
    assert (lone.mean, lone.half_width, lone.text(2)) == (0.5, None, "0.50")
    assert mean_of([]) is None


def test_the_interval_holds_the_true_mean_as_often_as_it_says() -> None:
    rng = np.random.default_rng(1)
    found = [mean_of(rng.normal(2.0, 3.0, 4).tolist()) for _ in range(2000)]
    inside = [abs(mean.mean - 2.0) <= (mean.half_width or 0.0) for mean in found if mean]
    assert np.mean(inside) == pytest.approx(0.95, abs=0.015)


def test_many_equal_names_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sabench.evaluation.suite_loading.load_scene", None)
    with refused():
        load(tmp_path, f"scenes = {['standard-particles'] * 500}\n")


def test_scenes_times_seeds(tmp_path: Path) -> None:
    cases = load(tmp_path, 'scenes = ["quick", "demo"]\nseeds = [3, 4, 3]\n')
    found = [(case.name, case.base, case.seed, case.renderer, dict(case.axes)) for case in cases]
    names = ("quick", "demo")
    assert found == [(name, name, seed, "splat", {}) for name in names for seed in (3, 4)]
    assert cases[0].scene == load_scene("quick")


def test_varied_values_make_one_case_for_each_combination(tmp_path: Path) -> None:
    text = (
        '[[cases]]\nscene = "quick"\nname = "q"\n[cases.vary]\n"particles.count" = [10, 20]\n'
        '"calibration.shift_px" = [0.0, 0.5, 1.0]\n'
    )
    cases = load(tmp_path, text)
    assert len(cases) == 6
    assert cases[1].name == "q-count_10-shift_px_0.5"
    assert dict(cases[1].axes) == {"particles.count": 10, "calibration.shift_px": 0.5}
    assert (cases[1].scene.particles or {})["count"] == 10
    assert cases[1].scene.calibration is not None
    assert cases[1].scene.calibration.shift_px == 0.5
    assert len({case.folder(Path("work")) for case in cases}) == 6


def test_the_suites_changes_hold_for_all_cases_and_a_case_has_the_last_word(tmp_path: Path) -> None:
    text = (
        'scenes = ["quick"]\n[set]\n"particles.count" = 7\n"cameras.f_number" = 8.0\n[vary]\n'
        '"sensor.bit_depth" = [8, 10]\n'
        '[[cases]]\nscene = "quick"\nname = "few"\nset = { "particles.count" = 5 }\n'
    )
    found = {case.name: case.scene for case in load(tmp_path, text)}
    assert list(found) == [f"{name}-bit_depth_{n}" for name in ("quick", "few") for n in (8, 10)]
    assert [(scene.particles or {})["count"] for scene in found.values()] == [7, 7, 5, 5]
    assert {scene.cameras.f_number for scene in found.values()} == {8.0}


def test_a_case_does_not_change_a_table_of_the_suite_for_the_next_one(tmp_path: Path) -> None:
    text = (
        '[set]\n"sensor" = { bit_depth = 12 }\n[[cases]]\nscene = "quick"\nname = "a"\n'
        '[cases.set]\n"sensor.bit_depth" = 8\n[[cases]]\nscene = "quick"\nname = "b"\n'
    )
    assert [case.scene.sensor.bit_depth for case in load(tmp_path, text)] == [8, 12]


def test_realism_adds_up_to_the_realistic_scene() -> None:
    """All effects together are those of the scene; size, cameras and laser fit the smaller one."""
    real = load_scene("realistic-particles").to_dict()
    cases = scene_cases("realism")
    assert len({case.scene.hash for case in cases}) == len({case.name for case in cases}) == 26
    for case in (case for case in cases if case.name.endswith("-everything")):
        own = case.scene.to_dict()
        for table in ("wall", "calibration", "background", "sensor", "tracer"):
            assert own[table] == real[table]
        for table, given in (
            ("illumination", ("pulse_energy_mj", "thickness_mm", "height_mm")),
            ("cameras", ("rows", "columns", "layout")),
        ):
            assert own[table] | {key: real[table][key] for key in given} == real[table]
        assert own["particles"] | {"per_pixel": 0.05} == real["particles"]


def test_a_value_replaces_the_whole_that_its_key_names() -> None:
    scene = load_scene("quick")
    layout = {"kind": "line", "count": 3, "spacing_mm": 50.0}
    assert len(build_rig(override(scene, {"cameras.layout": layout}, "s")).cameras) == 3
    assert override(scene, {}, "s").hash == scene.hash


def test_a_case_may_have_a_renderer_and_solvers_of_its_own(tmp_path: Path) -> None:
    text = (
        'scenes = ["demo"]\n[[cases]]\nscene = "quick"\nbackend = "mitsuba"\n'
        'solvers = [{ name = "msa", parameters = { k = 2.0 } }]\n'
    )
    demo, quick = load(tmp_path, text)
    assert (demo.renderer, [one.name for one in demo.solvers]) == ("splat", ["asa"])
    assert quick.renderer == "mitsuba"
    assert [(one.name, one.parameters) for one in quick.solvers] == [("msa", {"k": 2.0})]


def test_a_case_without_solvers_is_named(tmp_path: Path) -> None:
    own = 'title = "t"\nbackend = "splat"\n[[cases]]\nscene = "quick"\n'
    own += 'solvers = [{ name = "msa" }]\n'
    (tmp_path / "own.toml").write_text(own)
    assert len(load_suite(tmp_path / "own.toml")[1]) == 1
    (tmp_path / "none.toml").write_text(own + '[[cases]]\nscene = "demo"\n')
    with refused("solvers"):
        load_suite(tmp_path / "none.toml")


CASE = '[[cases]]\nscene = "quick"\n'
FAULTS = [
    ("", ""),
    ('scenes = ["quik"]\n', "quik"),
    ('scenes = ["quick"]\nseeds = [-1]\n', "seeds.0"),
    ('scenes = ["quick"]\nkeep = false\n', "keep"),
    (CASE + 'names = "x"\n', "cases.0.names"),
    (CASE + 'name = "a/b"\n', "cases.0.name"),
    (CASE + 'name = "../b"\n', "cases.0.name"),
    (CASE + '[cases.vary]\n"particles.count" = []\n', "cases.0.vary.particle"),
    (CASE + '[cases.vary]\n"particles.cuont" = [1]\n', "case quick-cuont_1"),
    (CASE + '[cases.set]\n"title.x" = 1\n', "case quick: title.x"),
    (CASE + '[cases.set]\n"volume.center_mm" = [0.0, 0.0, 1.0]\n', "case quick: volume"),
    (CASE + CASE, "quick"),
    ('scenes = ["quick"]\n[[cases]]\nscene = "demo"\nname = "Quick"\n', "quick"),
    ('scenes = ["quick"]\n[[solvers]]\nname = "msaa"\n', "msaa"),
    ('scenes = ["quick"]\n[[solvers]]\nname = "msa"\nparameters = { kk = 1 }\n', "kk"),
]


@pytest.mark.parametrize(("text", "key"), FAULTS)
def test_a_fault_is_named_before_any_work(tmp_path: Path, text: str, key: str) -> None:
    with refused(key):
        load(tmp_path, text)


SUITES = list_suites()


@pytest.mark.slow_but_first
@pytest.mark.parametrize("name", SUITES)
def test_bundled_suites_are_sound(name: str) -> None:
    suite, cases = load_suite(name)
    assert len({case.file_name for case in cases}) == len(cases)
    assert name in ("demo", "quick", "ci") or len(suite.seeds) >= 5


THESIS = [
    *((f"thesis-{size}", 0.2, 25, 0.4, 0.05) for size in ("50x50x10", "40x40x30", "50x50x50")),
    ("thesis-100x100x100", 0.1, 25, 0.32, 0.1),
    *((f"array-{count}", 0.2, count, 0.4, 0.05) for count in (9, 13, 17, 21)),
]


@pytest.mark.parametrize(("name", "magnification", "count", "baseline", "voxel_mm"), THESIS)
def test_the_thesis_arrays_are_as_it_says(
    name: str, magnification: float, count: int, baseline: float, voxel_mm: float
) -> None:
    rig = build_rig(load_scene(name))
    places = np.array([camera.center_mm for camera in rig.cameras])
    center = rig.cameras[int(np.argmin(np.linalg.norm(places, axis=1)))]
    distance = -center.center_mm[2]
    assert len(rig.cameras) == count
    assert center.principal_distance_mm / distance == pytest.approx(magnification, rel=1e-9)
    assert distance == pytest.approx(85.0 * (1.0 + 1.0 / magnification))
    assert set(places[:, 2]) == {-distance}
    assert min(x for x in places[:, 0] if x > 0.0) / distance == pytest.approx(baseline, rel=0.02)
    across, down, _ = rig.grid.voxel_mm
    assert across == down == pytest.approx(0.01 / magnification) == voxel_mm
    for camera in rig.cameras:
        assert camera.project([[0.0, 0.0, 0.0]])[0] == pytest.approx(499.5, abs=1e-9)


@pytest.mark.parametrize(
    ("name", "share"), [*((name, 1.0 / 16.0) for name, *_ in THESIS), ("elsinga-35x35x7", 0.25)]
)
def test_a_lone_particle_is_as_bright_as_the_scene_says(name: str, share: float) -> None:
    """As a share of the full well, on a pixel's centre, in the camera that sees most light."""
    scene = load_scene(name)
    diameter, zero = np.array([(scene.particles or {})["diameter_mm"]]), np.zeros((1, 3))
    lone = Particles(np.array([0]), zero, diameter, zero)
    cameras = build_rig(scene).cameras
    photons = max(image_particles(scene, one, lone, None).photons[0] for one in cameras)
    assert scene.cameras.particle_sigma_px is not None
    pixel = erf(0.5 / (scene.cameras.particle_sigma_px * np.sqrt(2.0))) ** 2
    electrons = photons * scene.sensor.quantum_efficiency * pixel
    assert electrons / scene.sensor.full_well_e == pytest.approx(share, rel=1e-4)
