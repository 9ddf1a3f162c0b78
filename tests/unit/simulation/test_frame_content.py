"""Content of a frame: particles, views, and the skew between cameras."""

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sabench.dataset.verification import verify
from sabench.scenes import Scene, build_rig, load_scene, parse_scene
from sabench.scenes.exposures import recorded_part
from sabench.scenes.illumination import Timing
from sabench.scenes.sensor import Sensor
from sabench.simulation import camera_view
from sabench.simulation.frames import Frames
from sabench.simulation.in_memory import Shot, make_particles, simulate
from sabench.simulation.pipeline import generate
from sabench.simulation.rendering import particles_splatted
from sabench.simulation.rendering.particle_images import ParticleImages, image_particles
from sabench.utils.arrays import F64
from tests.helpers.refusals import refused


@pytest.fixture(scope="module")
def dark_scene() -> Scene:
    """Make a scene of four cameras that see next to nothing, so that images are noise."""
    values = load_scene("quick").to_dict()
    values["particles"] = {"generator": "uniform", "count": 1, "diameter_mm": 1e-4}
    values |= {"frames": 2, "interval_s": 0.01}
    values["cameras"] |= {"rows": 60, "columns": 80}
    values["sensor"] |= {"shot_noise": False, "read_noise_e": 40.0}
    return parse_scene(values, "dark")


def noise_of(scene: Scene, seed: int, frame: int) -> F64:
    """Return the cameras' noise (camera, pixel) with mean 0 and variance 1."""
    images = simulate(scene, seed=seed, frame=frame).observation.images
    flat = images.reshape(len(images), -1).astype(np.float64)
    flat -= flat.mean(axis=1, keepdims=True)
    return np.asarray(flat / flat.std(axis=1, keepdims=True))


def test_noise_of_seeds_frames_and_cameras_is_independent(dark_scene: Scene) -> None:
    draws = {
        (seed, frame, camera): noise
        for seed, frame in itertools.product((0, 1, 2), (0, 1))
        for camera, noise in enumerate(noise_of(dark_scene, seed, frame))
    }
    assert len(draws) == 3 * 2 * 4
    for one, other in itertools.combinations(draws, 2):
        together = float(np.mean(draws[one] * draws[other]))
        assert abs(together) < 6.0 / np.sqrt(draws[one].size), (one, other)


def test_images_of_a_short_pulse_are_computed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = load_scene("quick")
    frame = Frames(scene, build_rig(scene), 1, "splat").at(0)
    calls: list[ParticleImages] = []

    def counted(*given: Any) -> ParticleImages:
        calls.append(image_particles(*given))
        return calls[-1]

    monkeypatch.setattr(camera_view, "image_particles", counted)
    view = camera_view.render_camera_view(frame, 2)
    assert len(calls) == 1
    assert view.particles is calls[0]
    expected = particles_splatted.render(frame.rig.cameras[2], calls[0])
    np.testing.assert_array_equal(view.photons, expected)


US = 1e-6
SPEED = 100.0  # mm/s


def scene(timing: dict[str, Any], exposure_s: float = 1e-3, **changes: Any) -> Scene:
    values = load_scene("quick").to_dict()
    flow = {"generator": "linear_flow", "velocity_mm_s": [SPEED, 0.0, 0.0]}
    values |= {"frames": 2, "flow": flow, "timing": {"rate_hz": 10.0} | timing}
    values["sensor"] |= {"exposure_s": exposure_s}
    return parse_scene(values | changes, "skewed")


def skews(**delays: float) -> list[float]:
    count = len(build_rig(load_scene("quick")).cameras)
    return [delays.get(f"c{number}", 0.0) for number in range(count)]


@pytest.mark.parametrize(
    ("skew_us", "recorded"),
    [(0, (True, True)), (124, (True, True)), (126, (True, False)), (-126, (False, True))],
)
def test_a_pulse_beyond_the_margin_is_lost(skew_us: float, recorded: tuple[bool, bool]) -> None:
    """Figure 3-3: pulses 500 us apart about a gap of 250 us leave 125 us on either side."""
    timing = Timing(rate_hz=10.0, pulses_s=(0.0, 500 * US), gap_s=250 * US, skew_s=(skew_us * US,))
    parts = [recorded_part(timing, Sensor(exposure_s=20e-3), frame, 0) for frame in range(4)]
    assert tuple(part is not None for part in parts) == recorded * 2
    assert {part for part in parts if part} == {(0.0, 0.0)}


def test_a_part_of_a_long_pulse_is_recorded() -> None:
    timing = Timing(rate_hz=10.0, duration_s=4e-3, skew_s=(0.0, 1e-3, -2e-3, 2.4e-3))
    parts = [recorded_part(timing, Sensor(exposure_s=1e-3), 0, camera) for camera in range(4)]
    expected = [(-0.5e-3, 0.5e-3), (0.5e-3, 1.5e-3), (-2e-3, -1.5e-3), (1.9e-3, 2e-3)]
    np.testing.assert_allclose(np.array(parts), expected, atol=1e-12)


def test_short_pulses_in_all_exposures_are_recorded_alike() -> None:
    one = simulate(scene({}), seed=3)
    other = simulate(scene({"skew_s": skews(c0=400 * US, c1=-300 * US)}), seed=3)
    np.testing.assert_array_equal(one.observation.images, other.observation.images)
    for a, b in zip(one.views, other.views, strict=True):
        np.testing.assert_array_equal(a.pixel, b.pixel)


@pytest.mark.slow
def test_continuous_light_shows_particles_where_they_are_when_a_camera_is_open() -> None:
    delay, exposure, light = 2e-3, 0.2e-3, 8e-3
    skewed = scene({"duration_s": light, "skew_s": skews(c1=delay)}, exposure)
    shot = simulate(skewed, seed=3)
    cameras, place = build_rig(skewed).cameras, shot.particles.position_mm
    np.testing.assert_array_equal(place, make_particles(skewed, 3, 0).position_mm)
    for number, moved in ((0, 0.0), (1, SPEED * delay)):
        expected = cameras[number].project(place + np.array([moved, 0.0, 0.0]))[0]
        np.testing.assert_allclose(shot.views[number].pixel, expected, atol=1e-4)
    whole = simulate(scene({"duration_s": light}, exposure), seed=3)
    ratio = shot.views[0].photons.sum() / whole.views[0].photons.sum()
    assert ratio == pytest.approx(exposure / light, rel=1e-6)


def _signal(shot: Shot) -> list[float]:
    black = shot.observation.black_dn
    return [float(np.clip(image - black, 0, None).max()) for image in shot.observation.images * 1.0]


def test_a_camera_outside_its_margin_shows_nothing_of_that_pulse(tmp_path: Path) -> None:
    skew = skews(c0=200 * US, c1=-200 * US)
    lost = scene({"pulses_s": [0.0, 500 * US], "gap_s": 250 * US, "skew_s": skew})
    shots = [simulate(lost, seed=3, frame=frame) for frame in range(2)]
    for shot, dark in zip(shots, (1, 0), strict=True):
        signal = _signal(shot)
        assert signal[dark] < 0.2 * np.median(signal)
        assert [bool(view.visible.any()) for view in shot.views] == [
            number != dark for number in range(len(signal))
        ]
    data = generate(lost, tmp_path / "data", seed=3, backend="splat")
    assert not verify(tmp_path / "data")
    np.testing.assert_array_equal(data.observation(0).images, shots[0].observation.images)
    assert data.scene.timing == lost.timing
    assert "skew" not in (tmp_path / "data" / "cameras.json").read_text(encoding="utf-8")


PAIR = {"pulses_s": [0.0, 5e-4]}


@pytest.mark.parametrize(
    ("timing", "exposure_s", "keys"),
    [
        ({"skew_s": [0.0]}, 1e-3, ("timing.skew_s",)),
        (PAIR | {"gap_s": 1e-4}, 1e-3, ("timing.gap_s",)),
        ({"gap_s": 1e-4, "skew_s": skews()}, 1e-3, ("timing.gap_s",)),
        (PAIR | {"gap_s": 2.5e-4, "skew_s": skews(c2=4e-4)}, 1e-3, ("timing.skew_s", "camera_02")),
        (PAIR | {"skew_s": skews()}, 2e-3, ("timing.skew_s", "camera_00")),
    ],
)
def test_faults_are_one_sentence(
    timing: dict[str, Any], exposure_s: float, keys: tuple[str, ...]
) -> None:
    with refused(*keys):
        build_rig(scene(timing, exposure_s))


def test_only_particles_are_timed() -> None:
    values = load_scene("standard-bubbles").to_dict()
    values["timing"] = {"rate_hz": 10.0, "skew_s": [0.0] * 8}
    with refused("timing.skew_s"):
        parse_scene(values, "bubbles")
