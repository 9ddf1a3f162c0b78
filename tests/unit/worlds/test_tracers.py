"""Particles from frame to frame: moved, replaced where they leave, and lit by pulses."""

import itertools
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import kstest, lognorm, norm

from sabench.scenes import Scene, load_scene, parse_scene
from sabench.simulation.in_memory import make_particles, simulate
from sabench.simulation.pipeline import generate
from sabench.worlds.advection import advect
from sabench.worlds.tracers import (
    Motion,
    lattice_diameters_mm,
    material_numbers,
    pulse,
    require_flow,
    size_numbers,
)
from tests.helpers.refusals import refused

ABC = {"generator": "abc_flow", "wavelength_mm": 12.0}
WIND = {"generator": "linear_flow", "velocity_mm_s": [40.0, -20.0, 10.0]}


def moving_scene(**changes: Any) -> Scene:
    values = load_scene("quick").to_dict()
    values["particles"] = {"generator": "uniform", "count": 800}
    values |= {"frames": 4, "interval_s": 0.02, "flow": ABC}
    for key, value in changes.items():
        joined = key != "flow" and isinstance(value, dict) and isinstance(values.get(key), dict)
        values[key] = values[key] | value if joined else value
    return parse_scene({key: value for key, value in values.items() if value is not None}, "moving")


def test_particles_follow_the_flow_and_keep_their_ids() -> None:
    scene = moving_scene()
    frames = [make_particles(scene, 3, frame) for frame in range(3)]
    flow = require_flow(scene)
    for frame, (before, after) in enumerate(itertools.pairwise(frames)):
        _, first, second = np.intersect1d(before.id, after.id, return_indices=True)
        assert 0.5 * len(before) < len(first) < len(before)
        times = scene.time_s(frame), scene.time_s(frame + 1)
        carried = advect(flow, before.position_mm[first], *times, 1e-9)
        assert_allclose(after.position_mm[second], carried, atol=1e-6)
        assert_allclose(after.velocity_mm_s, flow.velocity(after.position_mm, 0.0))
        assert_array_equal(after.diameter_mm[second], before.diameter_mm[first])


def test_any_frame_is_the_same_by_itself() -> None:
    motion, scene = Motion(moving_scene(), 5), moving_scene()
    ordered = [motion.at(frame) for frame in range(4)]
    for frame in (3, 1):
        alone = make_particles(scene, 5, frame)
        assert_array_equal(alone.id, ordered[frame].id)
        assert_array_equal(alone.position_mm, ordered[frame].position_mm)
    assert_array_equal(motion.at(1).position_mm, ordered[1].position_mm)


@pytest.mark.slow
@pytest.mark.parametrize("flow", [ABC, WIND])
def test_the_density_stays_even(flow: dict[str, Any]) -> None:
    scene = moving_scene(flow=flow, frames=40)
    motion = Motion(scene, 1)
    particles = [motion.at(frame) for frame in range(40)][-1]
    assert len(np.intersect1d(particles.id, motion.at(0).id)) < 100
    assert abs(len(particles) - 800) < 4.0 * np.sqrt(800.0)
    size = np.asarray(scene.volume.size_mm)
    shares = (particles.position_mm - scene.volume.center_mm) / size + 0.5
    for share in shares.T:
        assert kstest(share, "uniform").pvalue > 1e-3


def test_a_flow_carries_only_what_rests() -> None:
    scene = moving_scene(particles={"velocity_mm_s": [1.0, 0.0, 0.0]})
    with refused():
        make_particles(scene, 1, 0)


def test_double_frames_and_four_pulses() -> None:
    double = moving_scene(timing={"rate_hz": 10.0, "pulses_s": [0.0, 0.002]})
    assert [double.time_s(frame) for frame in range(4)] == pytest.approx([0.0, 0.002, 0.1, 0.102])
    four = moving_scene(timing={"rate_hz": 5.0, "pulses_s": [0.0, 0.001, 0.003, 0.004]})
    assert four.time_s(6) == pytest.approx(0.203)


@pytest.mark.parametrize(
    ("timing", "key"),
    [
        ({"pulses_s": [0.0, 0.2]}, "pulses_s: "),
        ({"pulses_s": [0.002, 0.0]}, "pulses_s: "),
        ({"pulses_s": [0.0, 0.002], "energy": [1.0]}, "energy: "),
    ],
)
def test_impossible_timing_is_named(timing: dict[str, Any], key: str) -> None:
    with refused(key):
        moving_scene(timing={"rate_hz": 10.0, **timing})


def test_pulses_differ() -> None:
    pulses = {"pulses_s": [0.0, 0.002], "energy": [1.0, 0.5], "shift_mm": [0.0, 1.5]}
    scene = moving_scene(timing={"rate_hz": 10.0, **pulses})
    first, second, third = (pulse(scene, 1, frame) for frame in (0, 1, 2))
    assert second.pulse_energy_mj == pytest.approx(0.5 * first.pulse_energy_mj)
    assert (first.shift_mm, second.shift_mm) == (0.0, 1.5)
    assert third == first
    spread = moving_scene(timing={"rate_hz": 10.0, "energy_spread": 0.1})
    energies = np.array([pulse(spread, 1, frame).pulse_energy_mj for frame in range(400)])
    energies /= scene.light.pulse_energy_mj
    assert energies.mean() == pytest.approx(1.0, abs=0.02)
    assert energies.std() == pytest.approx(0.1, rel=0.15)


def test_a_sheet_beside_another_lights_other_particles() -> None:
    """Two thin sheets: what the first frame shows bright is dark in the second."""
    timing = {"rate_hz": 10.0, "pulses_s": [0.0, 1e-6], "shift_mm": [-0.6, 0.6]}
    scene = moving_scene(illumination={"thickness_mm": 1.0, "profile": "top-hat"}, timing=timing)
    frames = [simulate(scene, seed=1, frame=frame) for frame in (0, 1)]
    lit = [set(shot.particles.id[shot.views[0].photons > 0.0].tolist()) for shot in frames]
    assert len(lit[0]) > 20
    assert len(lit[1]) > 20
    assert not lit[0] & lit[1]


@pytest.mark.slow
def test_long_pulses_leave_streaks() -> None:
    """A streak of length s adds the variance s^2 / 12 along it, and no light."""
    noise = dict.fromkeys(("read_noise_e", "dark_current_e_s"), 0.0) | {"shot_noise": False}
    values = {
        "sensor": noise | {"full_well_e": 1e6, "gain_dn_e": 0.06, "bit_depth": 16},
        "particles": {"generator": "uniform", "count": 1},
        "flow": {"generator": "linear_flow", "velocity_mm_s": [100.0, 0.0, 0.0]},
    }
    pictures = []
    for duration in (0.0, 0.01):
        scene = moving_scene(timing={"rate_hz": 10.0, "duration_s": duration}, **values)
        seen = simulate(scene, seed=4).observation
        pictures.append(seen.images[0].astype(np.float64) - seen.black_dn)
    place = make_particles(moving_scene(**values), 4, 0).position_mm
    half = np.array([0.5, 0.0, 0.0])
    ends = [seen.cameras[0].project(place + move)[0][0] for move in (half, -half)]
    length = float(np.linalg.norm(ends[0] - ends[1]))
    assert length > 5.0
    still, moving = (_variance(picture) for picture in pictures)
    assert moving - still == pytest.approx(length**2 / 12.0, rel=0.05)
    assert pictures[1].sum() == pytest.approx(pictures[0].sum(), rel=0.05)


def _variance(picture: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> float:
    """Of light along columns and rows together."""
    row, column = np.mgrid[: picture.shape[0], : picture.shape[1]]
    weight = np.clip(picture, 0.0, None)
    weight /= weight.sum()
    return float(sum((weight * (x - (weight * x).sum()) ** 2).sum() for x in (row, column)))


def test_a_data_set_tells_times_and_keeps_the_flow(tmp_path: Path) -> None:
    scene = moving_scene(timing={"rate_hz": 10.0, "pulses_s": [0.0, 0.002]}, frames=2)
    data = generate(scene, tmp_path / "data", seed=2, backend="splat")
    assert [data.setup.time_s(frame) for frame in range(2)] == [0.0, 0.002]
    assert data.scene.flow == scene.flow
    flow = require_flow(data.scene)
    for frame in range(2):
        particles = data.particles(frame)
        assert_allclose(particles.velocity_mm_s, flow.velocity(particles.position_mm, 0.0))


def test_a_data_set_keeps_the_flow_on_a_lattice(tmp_path: Path) -> None:
    scene = moving_scene(frames=2, flow_grid_mm=[2.0, 2.5, 1.5])
    data = generate(scene, tmp_path / "data", seed=2, backend="splat")
    flow = require_flow(scene)
    with h5py.File(data.root / "truth.h5") as file:
        group = file["frames/0001/flow"]
        low, step, velocity, gradient = (
            group[name][()] for name in ("low_mm", "step_mm", "velocity_mm_s", "gradient_1_s")
        )
    assert velocity.shape == (3, 5, 8, 3)  # 4, 10 and 14 mm along z, y, x
    assert_allclose(low + step * (np.array([8, 5, 3]) - 1) / 2.0, scene.volume.center_mm)
    place = low + step * np.array([6, 2, 1])
    assert_allclose(velocity[1, 2, 6], flow.velocity(place[None], scene.time_s(1))[0])
    assert_allclose(gradient[1, 2, 6], flow.gradient(place[None], scene.time_s(1))[0])


def test_diameters_lie_on_the_lattice_of_sizes_where_mie_s_series_asks_for_it() -> None:
    exact = make_particles(moving_scene(illumination={"scattering": "isotropic"}), 3, 0)
    rounded = make_particles(moving_scene(), 3, 0)
    assert_array_equal(rounded.diameter_mm, lattice_diameters_mm(size_numbers(exact.diameter_mm)))
    assert_array_equal(rounded.position_mm, exact.position_mm)


@pytest.mark.parametrize("diameter_mm", [1e-7, 5.0])
def test_diameters_beyond_mie_s_series_are_refused(diameter_mm: float) -> None:
    scene = moving_scene(particles={"diameter_mm": diameter_mm})
    with refused("particles", "1.3e-06 to 0.51 mm"):
        make_particles(scene, 3, 0)


@pytest.mark.parametrize(
    ("kind", "law"), [("normal", norm(0.05, 0.01)), ("log-normal", lognorm(0.2, 0.0, 0.05))]
)
def test_diameters_follow_their_distribution(kind: str, law: Any) -> None:
    sizes = {"diameter_mm": 0.05, "diameter_spread": 0.2, "diameter_distribution": kind}
    scene = moving_scene(particles=sizes, illumination={"scattering": "isotropic"}, flow=None)
    assert kstest(make_particles(scene, 3, 0).diameter_mm, law.cdf).pvalue > 0.01


def test_listed_sizes_occur_alike() -> None:
    listed = {"diameters_mm": [0.01, 0.01, 0.03, 0.05], "count": 4000}
    scene = moving_scene(particles=listed, illumination={"scattering": "isotropic"}, flow=None)
    sizes, counts = np.unique(make_particles(scene, 3, 0).diameter_mm, return_counts=True)
    assert_array_equal(sizes, [0.01, 0.03, 0.05])
    assert_allclose(counts / 4000, [0.5, 0.25, 0.25], atol=0.03)


def test_a_data_set_tells_the_materials_of_a_mixture(tmp_path: Path) -> None:
    mixture = [{"index": 1.4, "share": 0.4}]
    scene = moving_scene(tracer={"mixture": mixture}, frames=2, particles={"count": 40})
    data = generate(scene, tmp_path / "data", seed=3, backend="splat")
    with h5py.File(data.root / "truth.h5") as truth:
        for frame in ("0000", "0001"):
            group = truth[f"frames/{frame}"]
            expected = material_numbers(scene.tracer, 3, group["id"][:])
            assert_array_equal(group["material"][:], expected)
            assert 0.1 < expected.mean() < 0.7
