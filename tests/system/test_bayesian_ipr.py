"""The most probable particles of small scenes, and of scenes with hidden views."""

import tomllib
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from sabench.algorithms import particles
from sabench.algorithms.particles.bayesian_ipr import CAPS, search_frame, split_and_find
from sabench.algorithms.particles.learned_model import weigh_pixels
from sabench.algorithms.particles.particle_search import ParticleSearch
from sabench.api import FoundParticles, ImageSequence, Observation
from sabench.api.make import make_algorithm
from sabench.geometry.volume_polynomials import points_in_mm
from sabench.metrics.particle_detection import count_challenge
from sabench.scenes import Scene, find, parse_scene
from sabench.simulation.in_memory import Shot, simulate, simulate_sequence
from tests.helpers.small_particles import count_found, make_small

CROSS = {"layout": {"kind": "cross", "arm": 1, "spacing_mm": 204.0}}


def read(name: str) -> dict[str, Any]:
    return tomllib.loads(find(name, "scenes").read_text(encoding="utf-8"))


def make_shot(seed: int, **changes: Any) -> Shot:
    """A frame of 120 x 140 pixels."""
    sizes = {"rows": 120, "columns": 140} | changes.pop("cameras", {})
    box = {"volume": {"size_mm": [7.0, 6.0, 5.0]}, "grid": {"crop_mm": [0.8, 0.8, 0.3]}}
    return make_small(seed, cameras=sizes, **box | changes)


def find_in(case: Observation) -> FoundParticles:
    return particles.reconstruct_most_probable(
        case, particles.fit_cameras(case), particles.BayesianIprSettings()
    )


def search(case: Observation) -> ParticleSearch:
    found = search_frame(case, particles.fit_cameras(case), particles.BayesianIprSettings())
    assert found is not None
    return found


PLACES = [{"center_mm": [x, 0.0, -516.7]} for x in (-300.0, -90.0, 90.0, 300.0)]
NINE = {"kind": "grid", "columns": 3, "rows": 3, "spacing_mm": [204.0, 204.0]}
SIDEWAYS = {"scattering": "mie", "pulse_energy_mj": 220.0, "direction": [0.8, 0.6, 0.0]}
SCENES: dict[str, tuple[int, float, dict[str, Any], int, float, float]] = {
    # seed, particles per pixel, changes; least number of particles, recall and precision
    "many overlap": (11, 0.08, {}, 300, 0.99, 0.99),
    "light differs between cameras": (
        *(12, 0.04, {"illumination": SIDEWAYS}),
        *(150, 0.97, 0.97),
    ),
    # widths of 0.3 px are neither hot pixels nor glints, and found between pixels
    "narrower than pixels": (
        *(3, 0.05),
        {
            "cameras": {"pixel_mm": 0.02, "f_number": 11.0, "rows": 160, "columns": 200},
            "volume": {"size_mm": [18.0, 14.0, 2.0]},
            "grid": {"crop_mm": [4.0, 4.0, 0.0]},
        },
        *(400, 0.85, 0.97),
    ),
    # outer cameras of a row see more of a long volume than the inner ones, which is no fault
    "too few cameras see": (
        *(18, 0.03),
        {
            "cameras": {"layout": {"kind": "list", "places": PLACES}},
            "volume": {"size_mm": [14.0, 6.0, 5.0]},
            "grid": {"crop_mm": [4.5, 0.8, 0.3]},
        },
        *(0, 0.98, 0.98),
    ),
    # their brightest pixels are three to seven standard deviations of noise
    "faint, nine cameras": (
        *(19, 0.02),
        {
            "cameras": {"layout": NINE},
            "illumination": {"scattering": "mie", "pulse_energy_mj": 22.0},
        },
        *(60, 0.95, 0.98),
    ),
}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:camera_01. expected light of particles")  # narrow images
@pytest.mark.parametrize("name", SCENES)
def test_particles_are_found_and_no_ghosts(name: str) -> None:
    seed, per_pixel, changes, least, recall, precision = SCENES[name]
    shot = make_shot(seed, **{**changes, "particles": {"per_pixel": per_pixel}})
    counts = count_found(shot, find_in(shot.observation))
    assert counts.truths > least
    assert counts.recall > recall
    assert counts.precision > precision


@pytest.mark.slow
def test_no_true_particle_is_removed_because_others_are_not_fitted_yet() -> None:
    """Trials count what neighbours gain, which they would gain beside the particle, too."""
    shot = make_shot(31, particles={"per_pixel": 0.12})
    found, maps = search(shot.observation), particles.fit_cameras(shot.observation)
    place = (shot.particles.position_mm - maps.middle_mm) / maps.half_mm
    off = np.random.default_rng(1).normal(0.0, 0.005, place.shape) / maps.half_mm
    found.select(np.zeros(len(found.position), dtype=np.bool_))
    found.put(place + off, np.tile(found.typical, (len(place), 1)), np.full(len(place), -1))
    weigh_pixels(found, CAPS[1])
    found.remove(lone=False)
    assert len(found.position) > 0.995 * len(place)


@pytest.mark.slow
def test_pairs_are_tried_no_more_once_hardly_any_is_added(monkeypatch: pytest.MonkeyPatch) -> None:
    shot, rounds = make_shot(33, particles={"per_pixel": 0.03}), []

    def counted(search: ParticleSearch) -> int:
        rounds.append(split_and_find(search))
        return rounds[-1]

    monkeypatch.setattr(particles.bayesian_ipr, "split_and_find", counted)
    found = search(shot.observation)
    assert 1 <= len(rounds) < particles.BayesianIprSettings().splits
    assert rounds[-1] < 0.001 * len(found.position)


@pytest.mark.slow
def test_cameras_that_are_off_are_shifted_back() -> None:
    """Places are then as good as without the shifts but for what all cameras share."""
    shot = make_shot(13, particles={"per_pixel": 0.04}, calibration={"shift_px": 0.3})
    found, true = find_in(shot.observation), shot.particles.position_mm
    counts = count_found(shot, found)
    assert min(counts.recall, counts.precision) > 0.98
    distances, nearest = cKDTree(true).query(found.position_mm)
    off = found.position_mm - true[nearest]
    spread = off[distances < 0.2].std(axis=0)
    assert spread[:2].max() < 0.15 * 0.05  # of a pixel's size


@pytest.mark.slow
@pytest.mark.parametrize(("level", "noise"), [(64.0, 2.2), (4095.0, 0.0)])
def test_a_camera_without_particles_does_not_count(level: float, noise: float) -> None:
    shot = make_shot(15, particles={"per_pixel": 0.04})
    images = shot.observation.images.copy()
    drawn = np.random.default_rng(2).normal(level, noise, images[2].shape)
    images[2] = np.clip(np.rint(drawn), 0, 4095)
    counts = count_found(shot, find_in(replace(shot.observation, images=images)))
    assert min(counts.recall, counts.precision) > 0.95


def behind_a_post(per_pixel: float, exposure: float, **more: Any) -> Shot:
    post = {"generator": "cylinder", "radius_mm": 0.8, "length_mm": 3.0, "place_mm": [0.0] * 3}
    lamps = {"lamps": [{"center_mm": [0.0, -300.0, -600.0]}], "exposure": exposure}
    tables = {"particles": {"per_pixel": per_pixel}, "cameras": CROSS, "lighting": lamps}
    return make_shot(18, solids=[post | more], **tables)


@pytest.mark.slow
def test_particles_behind_a_body_are_found_by_the_cameras_that_see_them() -> None:
    """A cylinder stands amid the particles; their light is 0 where it hides them."""
    shot = behind_a_post(0.04, 0.005, material={"reflectance": 0.05})
    seen = np.stack([view.visible & (view.photons > 0.0) for view in shot.views], axis=1)
    found = find_in(shot.observation)
    off = np.linalg.norm(shot.particles.position_mm[:, None] - found.position_mm[None], axis=2)
    inner = (np.abs(shot.particles.position_mm[:, :2]) < [3.0, 2.5]).all(axis=1)  # in all images
    partly = inner & (seen.sum(axis=1) >= 3) & ~seen.all(axis=1)
    hit = off.min(axis=1) < 0.05
    assert partly.sum() > 20
    assert hit[partly].mean() > 0.8
    assert hit[seen.all(axis=1)].mean() > 0.99
    assert (off.min(axis=0) < 0.05).mean() > 0.98
    assert found.light is not None
    right = (found.light[off.argmin(axis=1)] > 0.0) == seen
    assert right[partly & hit].all(axis=1).mean() > 0.8
    assert right[inner & hit & seen.all(axis=1)].all(axis=1).mean() > 0.99


@pytest.mark.slow
def test_a_lit_body_is_not_made_of_particles() -> None:
    """It is 18 standard deviations of the noise brighter than black."""
    shot = behind_a_post(0.02, 0.02)
    found, true = find_in(shot.observation).position_mm, shot.particles.position_mm
    off = np.linalg.norm(true[:, None] - found[None], axis=2)
    free = np.all([view.visible for view in shot.views], axis=0)
    assert (off.min(axis=0) < 0.05).mean() > 0.95
    assert (off.min(axis=1) < 0.05)[free].mean() > 0.9


# such images leave light that a wrong calibration would leave, too


@pytest.mark.slow
def test_a_thin_recording_with_a_background_has_no_ghosts() -> None:
    # What a sliding minimum leaves: a raised background, and patches around dead pixels. A glint no
    # wider than two particles outshines them, and no camera is said to be wrong
    values = read("realistic-particles")
    values["particles"]["per_pixel"] = 0.001
    shot = simulate(parse_scene(values, "test"), seed=2)
    counts = count_found(shot, find_in(shot.observation))
    assert counts.recall > 0.98
    assert counts.precision > 0.99


@pytest.mark.slow
def test_wide_images_that_look_flat_by_chance_are_gaussians() -> None:
    """A fit to some fifty particles may say otherwise at first."""
    shot = make_small(12, per_pixel=0.02)
    wide = gaussian_filter(shot.observation.images.astype(np.float64), (0.0, 1.0, 1.0))
    noise = 2.0 * np.random.default_rng(12).standard_normal(wide.shape)
    grey = np.clip(np.rint(wide + noise), 0, 4095).astype(np.uint16)
    found = search(replace(shot.observation, images=grey))
    assert not found.shapes[:, 3].any()


TOP_LEFT = {3: (-151.5, -158.0), 2: (-72.5, -79.0)}  # of discs, by the cameras in a row


def make_scene(in_a_row: int) -> Scene:
    values = read("standard-particles")
    values["cameras"]["layout"] |= {"columns": in_a_row, "rows": in_a_row}
    values["illumination"] |= {"scattering": "isotropic", "pulse_energy_mj": 6.5}
    values["occluders"] = [{"center_mm": [*TOP_LEFT[in_a_row], -400.0], "radius_mm": 6.0}]
    return parse_scene(values, f"{in_a_row} x {in_a_row} cameras")


@pytest.mark.slow
@pytest.mark.parametrize(("in_a_row", "seed"), [(3, 2), (2, 1)])
def test_particles_are_found_where_a_camera_is_blind(in_a_row: int, seed: int) -> None:
    """Of nine cameras, one hardly shows in the light that is left; of four, ghosts hide it."""
    shot = simulate(make_scene(in_a_row), seed=seed)
    found = search(shot.observation)
    assert found.hidden is not None
    assert 0.35 < found.hidden[0].mean() < 0.6
    assert not found.hidden[1:].any()
    grid, true = shot.observation.grid, shot.particles.position_mm
    here = grid.to_voxels(points_in_mm(found.maps, found.position))
    there = grid.to_voxels(true)
    inside = np.abs((true - found.maps.middle_mm) / found.maps.half_mm).max(axis=1) < 1.0
    all_found = count_challenge(here, there, np.ones(len(here), dtype=np.bool_), inside)
    assert all_found.recall > 0.985  # also at the edges of the volume
    counts = count_challenge(here, there, grid.in_scored(here), grid.in_scored(there))
    assert counts.recall > 0.995
    assert counts.detections - counts.matched < 0.005 * counts.truths


@pytest.mark.slow
def test_dark_areas_of_few_particles_hide_nothing() -> None:
    values = read("realistic-particles")
    values["particles"]["per_pixel"] = 0.005
    assert search(simulate(parse_scene(values, "few"), seed=1).observation).hidden is None


@pytest.mark.slow
def test_trajectories_go_on_when_something_moves_in_front_of_a_camera() -> None:
    """From the fourth of six frames on, one of four cameras sees half of the volume."""
    values = read("particle-tracking") | {"frames": 6}
    values["illumination"] |= {"scattering": "isotropic"}
    before = list(simulate_sequence(parse_scene(values, "free"), seed=2))
    disc = {"center_mm": [-156.6, -164.6, -400.0], "radius_mm": 8.0}
    after = list(simulate_sequence(parse_scene(values | {"occluders": [disc]}, "hidden"), seed=2))
    shots = [*before[:3], *after[3:]]
    case = ImageSequence.of([one.observation for one in shots], 0.01)
    solver: Any = make_algorithm("shake_the_box", {})
    found: list[FoundParticles] = list(solver.solve(case))
    for shot, one in zip(shots, found, strict=True):
        counts = count_found(shot, one)
        assert counts.recall > 0.995
        assert counts.detections - counts.matched < 0.005 * counts.truths
