"""Background, levels by camera and patterns on their way to the images that solvers receive."""

import json
import tomllib
from typing import Any

import numpy as np
import pytest

from sabench.dataset.reader import open_dataset
from sabench.scenes import Scene, parse_scene
from sabench.scenes.illumination import Background
from sabench.scenes.loading import find
from sabench.simulation.camera_view import flicker, static_light
from sabench.simulation.in_memory import simulate
from sabench.simulation.pipeline import generate
from sabench.utils.arrays import F64
from sabench.utils.rng import stream
from tests.helpers.refusals import refused


def quick_with(frames: int = 1, **tables: Any) -> Scene:
    values = tomllib.loads(find("quick", "scenes").read_text(encoding="utf-8"))
    values["cameras"] |= {"rows": 50, "columns": 70}
    values["volume"]["size_mm"] = [3.0, 2.0, 2.0]
    values["grid"]["crop_mm"] = [0.0, 0.0, 0.0]
    values["particles"]["count"] = 20
    values["frames"] = frames
    for name, given in tables.items():
        values[name] = values.get(name, {}) | given
    return parse_scene(values, "quick")


EXACT = {"shot_noise": False, "read_noise_e": 0.0}


def images_of(scene: Scene, frame: int = 0) -> F64:
    return simulate(scene, seed=3, frame=frame).observation.images.astype(np.float64)


def test_static_light_is_the_same_in_every_frame_and_another_in_every_camera() -> None:
    table = {"level": 0.1, "glints": 3, "dust": 5}
    scene = quick_with(frames=2, background=table, sensor=EXACT)
    plain = quick_with(frames=2, sensor=EXACT)
    added = [images_of(scene, frame) - images_of(plain, frame) for frame in (0, 1)]
    unsaturated = np.maximum(*(images_of(scene, frame) for frame in (0, 1))) < 3900
    assert np.abs((added[0] - added[1])[unsaturated]).max() <= 2.0  # rounding
    assert added[0].min() >= -1.0
    assert np.corrcoef(added[0][0].ravel(), added[0][1].ravel())[0, 1] < 0.5
    light = static_light(Background.model_validate(table), (50, 70), stream(3, "background", 2))
    grey = 0.22 * 0.6 * scene.sensor.full_well_photons * light
    np.testing.assert_allclose(added[0][2][unsaturated[2]], grey[unsaturated[2]], atol=2.0)


def test_both_renderers_have_the_same_background_and_pixels() -> None:
    scene = quick_with(
        background={"level": 0.05, "glints": 2}, sensor=EXACT | {"prnu": 0.05, "hot_pixels": 0.01}
    )
    drawn, traced = (
        simulate(scene, seed=3, backend=name).observation.images.astype(np.float64)
        for name in ("splat", "mitsuba")
    )
    plain = images_of(quick_with(sensor=EXACT))
    dark = plain < 66.0  # no particle there
    assert dark.sum() > 1000
    assert np.abs(drawn - traced)[dark].max() <= 3.0
    assert (drawn - plain)[dark].std() > 20.0


def test_patterns_of_pixels_stay_and_belong_to_one_camera() -> None:
    flat = {"level": 0.3, "variation": 0.0}
    scene = quick_with(frames=2, background=flat, sensor=EXACT | {"prnu": 0.05})
    plain = quick_with(frames=2, background=flat, sensor=EXACT)
    first, second = (images_of(scene, frame) - images_of(plain, frame) for frame in (0, 1))
    dark = np.maximum(images_of(plain, 0), images_of(plain, 1)) < 1300  # no particle there
    for camera in range(4):
        assert np.abs(first[camera] - second[camera])[dark[camera]].max() <= 2.0
        other = dark[camera] & dark[camera - 1]
        assert abs(np.corrcoef(first[camera][other], first[camera - 1][other])[0, 1]) < 0.1


def test_smooth_light_glints_and_dust_have_their_sizes() -> None:
    rng = np.random.default_rng(0)
    smooth = static_light(Background(level=0.2, variation=0.3), (80, 90), rng)
    assert smooth.mean() == pytest.approx(0.2)
    assert np.abs(smooth / 0.2 - 1.0).max() == pytest.approx(0.3)
    assert np.abs(np.diff(smooth, axis=1)).max() < 0.02
    glints = Background(glints=1, glint_level=1.5, glint_sigma_px=(2.0, 2.0))
    sums = [static_light(glints, (200, 200), np.random.default_rng(n)).sum() for n in range(5)]
    assert max(sums) == pytest.approx(1.5 * 2.0 * np.pi * 4.0, rel=1e-3)
    light = static_light(Background(dust=30, dust_level=0.05, dust_radius_px=4.0), (300, 300), rng)
    assert 0.0 < light.max() < 0.15
    assert 0.3 < (light > 0.0).sum() / (30 * np.pi * 16.0) < 1.3


def test_flicker_is_a_factor_of_the_frame() -> None:
    table = Background(level=0.1, flicker=0.1)
    drawn = [flicker(table, stream(1, "flicker", frame)) for frame in range(400)]
    assert np.mean(drawn) == pytest.approx(1.0, abs=0.02)
    assert np.std(drawn) == pytest.approx(0.1, rel=0.15)
    assert flicker(Background(level=0.1), np.random.default_rng(0)) == 1.0


def test_solvers_receive_one_black_and_one_white_level() -> None:
    exact = EXACT | {"full_well_e": 6000.0}
    plain = quick_with(sensor=exact)
    own = {"camera_black_dn": [64.0, 70.0, 64.0, 90.0], "camera_gain": [1.0, 1.0, 1.5, 1.0]}
    shot = simulate(quick_with(sensor=exact | own), seed=3).observation
    before = images_of(plain)
    white = before.max()
    assert shot.black_dn == 64.0
    for camera in (0, 1, 3):
        lit = before[camera] < white
        np.testing.assert_array_equal(shot.images[camera][lit], before[camera][lit])
        assert (shot.images[camera][~lit] == shot.white_dn).all()
    signal = shot.images[2].astype(float) - 64.0
    lit = before[2] < white
    np.testing.assert_allclose(signal[lit], 1.5 * (before[2][lit] - 64.0), atol=1.3)


def test_exposure_by_camera_scales_light() -> None:
    exact = EXACT | {"dark_current_e_s": 0.0, "bit_depth": 16, "full_well_e": 1e6}
    plain, factors = images_of(quick_with(sensor=exact)), [1.0, 0.5, 2.0, 1.0]
    scaled = quick_with(sensor=exact | {"camera_exposure": factors})
    for camera, factor in enumerate(factors):
        signal = images_of(scaled)[camera] - 64.0
        np.testing.assert_allclose(signal, factor * (plain[camera] - 64.0), atol=2.0)


def test_a_data_set_has_the_same_images_and_levels(tmp_path: Any) -> None:
    own = {"camera_black_dn": [60.0, 64.0, 70.0, 64.0], "camera_gain": [1.0, 0.9, 1.0, 1.1]}
    flaws, light = {"prnu": 0.02, "hot_pixels": 0.01}, {"level": 0.05, "flicker": 0.1}
    scene = quick_with(frames=2, sensor=flaws | own, background=light)
    data = generate(scene, tmp_path / "data", seed=3, backend="splat")
    for frame in (0, 1):
        stored, made = data.observation(frame), simulate(scene, seed=3, frame=frame).observation
        np.testing.assert_array_equal(stored.images, made.images)
        assert (stored.black_dn, stored.white_dn) == (made.black_dn, made.white_dn)


@pytest.mark.parametrize(
    ("key", "levels"),
    [
        ("4 cameras, got 1", [[60, 4000]]),
        ("camera_03", [[60, 4000]] * 3 + [[70, 70]]),
        ("camera_03", [[60, 4000]] * 3 + [[0, 1e300]]),
    ],
)
def test_impossible_levels_by_camera_are_refused(tmp_path: Any, key: str, levels: Any) -> None:
    scene = quick_with(sensor={"camera_black_dn": [60.0, 64.0, 70.0, 64.0]})
    root = generate(scene, tmp_path / "data", seed=3, backend="splat").root
    content = json.loads((root / "cameras.json").read_text(encoding="utf-8"))
    assert [black for black, _ in content["sensor"]["by_camera"]] == [60.0, 64.0, 70.0, 64.0]
    content["sensor"]["by_camera"] = levels
    (root / "cameras.json").write_text(json.dumps(content), encoding="utf-8")
    with refused(key):
        _ = open_dataset(root).setup


def test_the_temporal_minimum_takes_static_light_away(tmp_path: Any) -> None:
    values = quick_with(frames=3, background={"level": 0.1}).to_dict()
    values["preprocessing"] = [{"step": "temporal_minimum"}]
    scene = parse_scene(values, "quick")
    data = generate(scene, tmp_path / "data", seed=3, backend="splat")
    made = [simulate(scene, seed=3, frame=frame).observation.images for frame in range(3)]
    for frame in range(3):
        np.testing.assert_array_equal(data.observation(frame).images, made[frame])
    assert (np.min(made, axis=0) == 0).all()  # the darkest frame of every pixel is its background
    assert np.median(made) < 0.02 * 65535 < 0.1 * 65535


@pytest.mark.parametrize(
    ("frames", "steps"), [(1, ["temporal_minimum"]), (2, ["stretch", "temporal_minimum"])]
)
def test_a_temporal_minimum_needs_raw_frames(frames: int, steps: list[str]) -> None:
    values = quick_with(frames=frames).to_dict()
    values["preprocessing"] = [{"step": name} for name in steps]
    with refused("temporal_minimum"):
        parse_scene(values, "quick")


@pytest.mark.parametrize(
    ("table", "key", "given"),
    [
        ("sensor", "camera_gain", {"camera_gain": [1.0, 1.0]}),
        ("background", "flicker", {"flicker": 0.1}),
        ("background", "glint_sigma_px", {"glints": 2, "glint_sigma_px": [3.0, 1.0]}),
    ],
)
def test_impossible_tables_are_refused(table: str, key: str, given: dict[str, Any]) -> None:
    tables: dict[str, Any] = {table: given}
    with refused(f"{table}.{key}"):
        simulate(quick_with(**tables))
