"""Figures of plans against the thesis's, against light paths and against simulated images."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sabench.apps.planning.plan import Plan, Recorder, plan
from sabench.evaluation.suite_loading import override
from sabench.scenes import Scene, find, load_scene, parse_scene
from sabench.simulation.in_memory import simulate
from sabench.simulation.rendering.particle_images import defocus_px
from tests.conftest import Command


def value(made: Plan, key: str) -> float:
    """Return a figure that must be there."""
    found = made.to_dict()["figures"][key]["value"]
    assert found is not None
    return float(found)


def changed(name: str = "quick", **keys: Any) -> Scene:
    """Change keys of a bundled scene; two underscores stand for a dot."""
    values = {key.replace("__", "."): new for key, new in keys.items()}
    return override(load_scene(name), values, name)


def parallel_cameras(**camera: Any) -> Scene:
    """Make two cameras in plain air that look along Z, 200 mm apart, 500 mm before the volume."""
    values = tomllib.loads(find("quick", "scenes").read_text(encoding="utf-8"))
    del values["wall"]
    values["volume"] = {"center_mm": [0.0, 0.0, 0.0], "size_mm": [14.0, 10.0, 4.0]}
    upright = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    places = [{"center_mm": [x, 0.0, -502.0], "rotation": upright} for x in (-100.0, 100.0)]
    values["cameras"] |= {"columns": 4000, "layout": {"kind": "list", "places": places}} | camera
    return parse_scene(values, "parallel")


@pytest.mark.parametrize(
    ("scene", "ratio", "pixel", "per_pixel"),
    [("thesis-50x50x10", 2.50, 0.05, 0.125), ("array-9", 2.50, 0.05, 0.075)],
)
def test_figures_are_those_of_table_2_1(
    scene: str, ratio: float, pixel: float, per_pixel: float
) -> None:
    made = plan(scene)
    assert value(made, "plane_spacing_ratio") == pytest.approx(ratio, abs=0.01)
    assert value(made, "pixel_center_mm") == pytest.approx(pixel, rel=1e-3)
    assert value(made, "planes") == pytest.approx(10.0 / (ratio * pixel), rel=1e-2)
    assert value(made, "ppp") == pytest.approx(per_pixel, rel=0.02)


def test_parallel_cameras_in_air_obey_the_thesis_s_equations() -> None:
    made = plan(parallel_cameras())
    front, focus = 500.0, 502.0
    image = 1.0 / (1.0 / 85.0 - 1.0 / focus)
    baseline = 200.0 / front
    assert value(made, "baseline_ratio") == pytest.approx(baseline, rel=1e-4)
    oblique = math.cos(math.atan(100.0 / focus))  # a pixel is foreshortened along one axis
    pixel = 0.01 * focus / image * math.sqrt(oblique)  # (2.5)
    assert value(made, "pixel_center_mm") == pytest.approx(pixel, rel=1e-4)
    expected = 1.0 / baseline + 2.0 / (baseline * front)  # (2.11), Z = 2 mm behind the front
    assert value(made, "plane_spacing_ratio") == pytest.approx(expected, rel=1e-6)


def test_a_step_of_plane_spacing_moves_lines_of_sight_apart_by_a_pixel() -> None:
    made = plan("standard-particles")
    view, pair = made.viewing, made.viewing.inner_pair
    assert pair is not None
    step = value(made, "plane_spacing_mm")
    ends = [
        made.rig.cameras[number].carry(view.center_mm[None], float(view.center_mm[2]) + step)
        for number in pair
    ]
    apart = float(np.linalg.norm(ends[0] - ends[1]))
    assert apart == pytest.approx(value(made, "pixel_center_mm"), rel=1e-6)


def test_figures_do_not_depend_on_the_direction_of_the_axes() -> None:
    scene = load_scene("standard-particles")
    values = scene.to_dict()
    order = (2, 0, 1)  # the old axes that become the new x, y and z

    def turned(vector: list[float]) -> list[float]:
        return [vector[axis] for axis in order]

    for table, key in [
        ("volume", "center_mm"),
        ("volume", "size_mm"),
        ("grid", "voxel_mm"),
        ("grid", "crop_mm"),
        ("wall", "point_mm"),
        ("wall", "normal"),
        ("cameras", "center_mm"),
        ("cameras", "x_axis"),
        ("cameras", "y_axis"),
        ("illumination", "direction"),
        ("illumination", "sheet_normal"),
    ]:
        values[table][key] = turned(values[table][key])
    made, other = plan(scene), plan(parse_scene(values, "turned"))
    assert other.viewing.axis == 0
    for key in ("plane_spacing_ratio", "planes", "elongation", "common_depth_mm", "blur_back_px"):
        assert value(other, key) == pytest.approx(value(made, key), rel=1e-3), key


def test_defocus_at_the_end_of_the_depth_of_field_is_as_wide_as_diffraction() -> None:
    made = plan(parallel_cameras())
    camera = made.rig.cameras[0]
    half = value(made, "depth_of_field_mm") / 2.0
    point = np.asarray(camera.center_mm) + np.array([0.0, 0.0, camera.focus_mm + half])
    magnification = camera.principal_distance_mm / camera.focus_mm
    airy = 2.44 * 532e-6 * camera.f_number * (1.0 + magnification) / camera.pixel_mm
    disc = 4.0 * float(defocus_px(camera, point[None])[0])  # diameter of a uniform disc
    assert disc == pytest.approx(airy, rel=0.1)


def test_defocus_falls_as_the_f_number_rises() -> None:
    wide, narrow = (plan(changed(cameras__f_number=stop)) for stop in (4.0, 8.0))
    assert value(wide, "blur_back_px") == pytest.approx(2 * value(narrow, "blur_back_px"), rel=0.01)
    assert value(narrow, "diffraction_px") == pytest.approx(2 * value(wide, "diffraction_px"))


@pytest.mark.slow
def test_photons_and_diameters_are_those_of_simulated_images() -> None:
    scene = load_scene("quick")
    made, shot = plan(scene), simulate(scene)
    medians = [float(np.median(view.photons[view.visible])) for view in shot.views]
    widths = [float(np.median(view.sigma_px[view.visible])) for view in shot.views]
    assert value(made, "photons") == pytest.approx(min(medians))
    assert value(made, "light_ratio") == pytest.approx(min(medians) / max(medians))
    assert value(made, "image_px") == pytest.approx(4.0 * np.mean(widths))


@pytest.mark.slow
def test_the_brightest_pixel_is_that_of_a_simulated_particle_at_a_pixel_s_centre() -> None:
    scene = changed(
        particles__count=1,
        sensor__shot_noise=False,
        sensor__read_noise_e=0.0,
        volume__size_mm=[2, 2, 2],
    )
    made, shot = plan(scene), simulate(scene)
    brightest = float(shot.observation.images.max())
    grey = value(made, "peak_dn")
    assert 0.55 * grey < brightest <= 1.01 * grey  # in a corner of four pixels, at a centre


def test_density_counts_the_particles_on_the_images() -> None:
    scene = load_scene("quick")
    made, shot = plan(scene), simulate(scene)
    seen = np.mean([view.visible.sum() for view in shot.views])
    assert value(made, "ppp") == pytest.approx(seen / (240 * 320))
    assert value(made, "per_mm3") == pytest.approx(300 / (14.0 * 10.0 * 4.0))
    area = math.pi / 4.0 * value(made, "image_px") ** 2
    expected = value(made, "ppp_center") ** 3 * area**4 * 40  # (3.14), 40 planes of voxels
    assert value(made, "ghosts_per_particle") == pytest.approx(expected)


def test_two_pulses_straddle_the_gap_between_exposures() -> None:
    made = plan("vortex-ring-experiment", Recorder(gap_us=250.0))
    first, second = (value(made, f"{name}_pulse_us") for name in ("first", "second"))
    assert second - first == pytest.approx(8000.0)
    period = 1e6 / 20.0  # two frames ten times a second
    assert first < period - 250.0 < period < second


def test_calibration_errors_are_measured_in_the_images() -> None:
    assert value(plan("quick"), "calibration_px") == 0.0
    off = changed(calibration={"shift_px": 0.3})
    assert value(plan(off), "calibration_px") == pytest.approx(0.3)


WARNED = [
    ("grid.voxel_mm", {"grid__voxel_mm": [0.2, 0.2, 0.1]}),
    ("grid.voxel_mm", {"grid__voxel_mm": [0.05, 0.05, 0.5]}),
    ("cameras.focal_length_mm", {"cameras__focal_length_mm": 200.0}),
    ("cameras.f_number", {"cameras__f_number": 2.8}),
    ("cameras.f_number", {"cameras__f_number": 64.0}),
    ("cameras.particle_sigma_px", {"cameras__particle_sigma_px": 0.2}),
    ("illumination.pulse_energy_mj", {"illumination__pulse_energy_mj": 0.01}),
    ("illumination.pulse_energy_mj", {"illumination__pulse_energy_mj": 500.0}),
    ("illumination.thickness_mm", {"illumination__thickness_mm": 1.0}),
    ("particles.count", {"particles__count": 60000}),
    ("interval_s", {"frames": 2, "interval_s": 1e-4}),
    ("timing.rate_hz", {"frames": 2, "timing": {"rate_hz": 3000.0}}),
    ("timing.pulses_s", {"frames": 2, "timing": {"rate_hz": 5.0, "pulses_s": [0.0, 1e-5]}}),
    ("sensor.exposure_s", {"frames": 2, "interval_s": 0.01, "sensor__exposure_s": 0.0099}),
]


@pytest.mark.parametrize(("key", "changes"), WARNED)
def test_warnings_name_the_key_to_change(key: str, changes: dict[str, Any]) -> None:
    advice = plan(changed(**changes)).advice
    sentences = [one.sentence for one in advice if one.key == key]
    assert sentences
    assert any(key in sentence for sentence in sentences)


def test_a_remedy_is_enough() -> None:
    dim = plan(changed(illumination__pulse_energy_mj=0.01))
    (sentence,) = (one.sentence for one in dim.advice if "raise illumination.pulse" in one.sentence)
    energy = float(sentence.split(" to ")[1].split(",")[0])
    cured = plan(changed(illumination__pulse_energy_mj=1.01 * energy))
    assert value(cured, "peak_snr") == pytest.approx(5.0, rel=0.02)


def test_a_good_scene_has_no_warnings() -> None:
    assert plan("standard-particles").advice == ()


def test_an_impossible_scene_gets_the_sentence_of_generate(
    command: Command, tmp_path: Path
) -> None:
    text = find("quick", "scenes").read_text(encoding="utf-8")
    file = tmp_path / "mine.toml"
    file.write_text(text.replace("[0.0, 0.0, 30.0]", "[0.0, 0.0, 3.0]"), encoding="utf-8")
    planned = command("plan", str(file), "--json")
    made = command("generate", str(file), "-o", str(tmp_path / "made"))
    assert planned.returncode == made.returncode == 2
    assert planned.stdout == ""
    assert "behind the wall's inner face" in planned.stderr
    assert planned.stderr.splitlines()[-1] == made.stderr.splitlines()[-1]
