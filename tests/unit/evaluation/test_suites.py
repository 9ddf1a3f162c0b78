"""Suites of scenes and their changes, and statistics over seeds. Errors in a suite are reported
before any work starts."""

import re
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
from sabench.utils.errors import InputError
from tests.helpers.refusals import refused

SOLVER = '[[solvers]]\nname = "asa"\n'


def load(folder: Path, text: str) -> list[SceneCase]:
    file = folder / "suite.toml"
    file.write_text('title = "t"\nbackend = "splat"\n' + text + SOLVER)
    return scene_cases(file)


def scene_cases(suite: str | Path) -> list[SceneCase]:
    return [case for case in load_suite(suite)[1] if isinstance(case, SceneCase)]


# Statistics


def test_mean_and_interval_are_those_of_student() -> None:
    values = [0.71, 0.74, 0.69, 0.75, 0.72]
    found = mean_of(values)
    low, high = stats.t.interval(
        0.95, len(values) - 1, loc=np.mean(values), scale=stats.sem(values)
    )
    assert found is not None
    assert found.half_width is not None
    assert (found.mean - found.half_width, found.mean + found.half_width) == pytest.approx(
        (low, high), rel=1e-12
    )
    assert found.count == 5
    assert found.text(3) == "0.722 ± 0.030"


def test_one_value_has_no_interval_and_none_no_mean() -> None:
    lone = mean_of([0.5])
    assert lone is not None
    assert (lone.mean, lone.half_width, lone.text(2)) == (0.5, None, "0.50")
    assert mean_of([]) is None


def test_the_interval_holds_the_true_mean_as_often_as_it_says() -> None:
    rng = np.random.default_rng(1)
    found = [mean_of(rng.normal(2.0, 3.0, 4).tolist()) for _ in range(2000)]
    inside = [abs(mean.mean - 2.0) <= (mean.half_width or 0.0) for mean in found if mean]
    assert np.mean(inside) == pytest.approx(0.95, abs=0.015)


# Suites


def test_many_equal_names_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sabench.evaluation.suite_loading.load_scene", None)
    with refused():
        load(tmp_path, f"scenes = {['standard-particles'] * 500}\n")


def test_scenes_times_seeds(tmp_path: Path) -> None:
    cases = load(tmp_path, 'scenes = ["quick", "demo"]\nseeds = [3, 4, 3]\n')
    assert [
        (case.name, case.base, case.seed, case.renderer, dict(case.axes)) for case in cases
    ] == [
        ("quick", "quick", 3, "splat", {}),
        ("quick", "quick", 4, "splat", {}),
        ("demo", "demo", 3, "splat", {}),
        ("demo", "demo", 4, "splat", {}),
    ]
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
    assert list(found) == [
        "quick-bit_depth_8",
        "quick-bit_depth_10",
        "few-bit_depth_8",
        "few-bit_depth_10",
    ]
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
    for case in (case for case in cases if case.name.endswith("-everything")):
        own = case.scene.to_dict()
        for table in ("wall", "calibration", "background", "sensor", "tracer"):
            assert own[table] == real[table]
        given = ("pulse_energy_mj", "thickness_mm", "height_mm")
        assert (
            own["illumination"] | {key: real["illumination"][key] for key in given}
            == (real["illumination"])
        )
        given = ("rows", "columns", "layout")
        assert own["cameras"] | {key: real["cameras"][key] for key in given} == real["cameras"]
        assert own["particles"] | {"per_pixel": 0.05} == real["particles"]


def test_each_case_of_realism_is_a_data_set_of_its_own() -> None:
    cases = scene_cases("realism")
    assert len({case.scene.hash for case in cases}) == len({case.name for case in cases}) == 26


def test_a_value_replaces_the_whole_that_its_key_names() -> None:
    scene = load_scene("quick")
    line = override(
        scene, {"cameras.layout": {"kind": "line", "count": 3, "spacing_mm": 50.0}}, "s"
    )
    assert len(build_rig(line).cameras) == 3
    assert override(scene, {}, "s").hash == scene.hash


def test_a_case_may_have_a_renderer_and_solvers_of_its_own(tmp_path: Path) -> None:
    text = (
        'scenes = ["demo"]\n[[cases]]\nscene = "quick"\nbackend = "mitsuba"\n'
        'solvers = [{ name = "msa", parameters = { k = 2.0 } }]\n'
    )
    demo, quick = load(tmp_path, text)
    assert (demo.renderer, [one.name for one in demo.solvers]) == ("splat", ["asa"])
    assert (quick.renderer, [(one.name, one.parameters) for one in quick.solvers]) == (
        "mitsuba",
        [("msa", {"k": 2.0})],
    )


def test_a_case_without_solvers_is_named(tmp_path: Path) -> None:
    own = (
        'title = "t"\nbackend = "splat"\n[[cases]]\nscene = "quick"\nsolvers = [{ name = "msa" }]\n'
    )
    (tmp_path / "own.toml").write_text(own)
    assert len(load_suite(tmp_path / "own.toml")[1]) == 1
    (tmp_path / "none.toml").write_text(own + '[[cases]]\nscene = "demo"\n')
    with refused("solvers"):
        load_suite(tmp_path / "none.toml")


FAULTS = [
    ("", "scenes, cases, recordings: expected at least one of them"),
    ('scenes = ["quik"]\n', "did you mean quick?"),
    ('scenes = ["quick"]\nseeds = [-1]\n', "seeds.0"),
    ('scenes = ["quick"]\nkeep = false\n', "keep: unknown key"),
    ('[[cases]]\nscene = "quick"\nnames = "x"\n', "cases.0.names: unknown key; did you mean name?"),
    ('[[cases]]\nscene = "quick"\nname = "a/b"\n', "cases.0.name"),
    ('[[cases]]\nscene = "quick"\nname = "../b"\n', "cases.0.name"),
    ('[[cases]]\nscene = "quick"\n[cases.vary]\n"particles.count" = []\n', "cases.0.vary.particle"),
    ('[[cases]]\nscene = "quick"\n[cases.vary]\n"particles.cuont" = [1]\n', "case quick-cuont_1:"),
    ('[[cases]]\nscene = "quick"\n[cases.set]\n"title.x" = 1\n', "case quick: title.x: expected"),
    (
        '[[cases]]\nscene = "quick"\n[cases.set]\n"volume.center_mm" = [0.0, 0.0, 1.0]\n',
        "case quick: volume: expected it to lie behind",
    ),
    ('[[cases]]\nscene = "quick"\n[[cases]]\nscene = "quick"\n', "2 cases are named quick"),
    ('scenes = ["quick"]\n[[cases]]\nscene = "demo"\nname = "Quick"\n', "2 cases are named quick"),
    ('scenes = ["quick"]\n[[solvers]]\nname = "msaa"\n', "did you mean msa?"),
    ('scenes = ["quick"]\n[[solvers]]\nname = "msa"\nparameters = { kk = 1 }\n', "did you mean k?"),
]


@pytest.mark.parametrize(("text", "sentence"), FAULTS)
def test_a_fault_is_named_before_any_work(tmp_path: Path, text: str, sentence: str) -> None:
    with pytest.raises(InputError, match=re.escape(sentence)):
        load(tmp_path, text)


SUITES = list_suites()


@pytest.mark.slow_but_first
@pytest.mark.parametrize("name", SUITES)
def test_bundled_suites_are_sound(name: str) -> None:
    suite, cases = load_suite(name)
    assert len({case.file_name for case in cases}) == len(cases)
    assert name in ("demo", "quick", "ci") or len(suite.seeds) >= 5


# The thesis's arrays


THESIS = [
    ("thesis-50x50x10", 0.2, 25, 0.4, 0.05),
    ("thesis-40x40x30", 0.2, 25, 0.4, 0.05),
    ("thesis-50x50x50", 0.2, 25, 0.4, 0.05),
    ("thesis-100x100x100", 0.1, 25, 0.32, 0.1),
    ("array-9", 0.2, 9, 0.4, 0.05),
    ("array-13", 0.2, 13, 0.4, 0.05),
    ("array-17", 0.2, 17, 0.4, 0.05),
    ("array-21", 0.2, 21, 0.4, 0.05),
]


@pytest.mark.parametrize(("name", "magnification", "count", "baseline", "voxel_mm"), THESIS)
def test_the_thesis_arrays_are_as_it_says(
    name: str, magnification: float, count: int, baseline: float, voxel_mm: float
) -> None:
    scene = load_scene(name)
    rig = build_rig(scene)
    places = np.array([camera.center_mm for camera in rig.cameras])
    center = rig.cameras[int(np.argmin(np.linalg.norm(places, axis=1)))]
    distance = -center.center_mm[2]
    assert len(rig.cameras) == count
    assert center.principal_distance_mm / distance == pytest.approx(magnification, rel=1e-9)
    assert distance == pytest.approx(85.0 * (1.0 + 1.0 / magnification))
    assert set(places[:, 2]) == {-distance}
    assert min(x for x in places[:, 0] if x > 0.0) / distance == pytest.approx(baseline, rel=0.02)
    assert (
        rig.grid.voxel_mm[0]
        == rig.grid.voxel_mm[1]
        == pytest.approx(0.01 / magnification)
        == voxel_mm
    )
    for camera in rig.cameras:
        np.testing.assert_allclose(
            camera.project([[0.0, 0.0, 0.0]])[0], [[499.5, 499.5]], atol=1e-9
        )


@pytest.mark.parametrize(
    ("name", "share"), [*((name, 1.0 / 16.0) for name, *_ in THESIS), ("elsinga-35x35x7", 0.25)]
)
def test_a_lone_particle_is_as_bright_as_the_scene_says(name: str, share: float) -> None:
    """A lone particle has its brightest pixel at the share that the scene says. As a share of the
    full well, for a particle whose image lies on a pixel's centre, in the camera that sees most
    light."""
    scene = load_scene(name)
    lone = Particles(
        np.array([0]),
        np.zeros((1, 3)),
        np.array([(scene.particles or {})["diameter_mm"]]),
        np.zeros((1, 3)),
    )
    photons = max(
        image_particles(scene, camera, lone, None).photons[0] for camera in build_rig(scene).cameras
    )
    assert scene.cameras.particle_sigma_px is not None
    pixel = erf(0.5 / (scene.cameras.particle_sigma_px * np.sqrt(2.0))) ** 2
    assert (
        photons * scene.sensor.quantum_efficiency * pixel / scene.sensor.full_well_e
        == pytest.approx(share, rel=1e-4)
    )
